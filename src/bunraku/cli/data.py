"""`bunraku data`: training samples from archives."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.checks import check_folder, check_range
from bunraku.cli.progress import stages
from bunraku.errors import FormatError

__all__ = ["Characters", "Motions"]


@dataclass(frozen=True)
class Motions:
    """Turn a motion archive into handle motions of the reference body, to train on.

    One file a clip; a second run goes on where the first one stopped.

    Example: bunraku data motions --source archive -o data/motions --jobs 2
    """

    source: Path
    """Folder that holds motions.npz and motions.json."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write to, made when it is not there."""
    jobs: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Processes. Default: one for each core."""
    characters: Path | None = None
    """Folder of the unpacked character archive, whose labelled clips of waving, clapping and the like are added."""

    def run(self) -> None:
        _check(self.source, self.output, self.jobs)
        if self.characters is not None and not self.characters.is_dir():
            raise FormatError(self.characters, "there is no such folder; name the one of the unpacked character archive")
        from bunraku.datasets.motions import build_motions
        from bunraku.datasets.turns import add_turns

        failed: dict[str, str] = {}
        with stages() as report:
            index = build_motions(self.source, self.output, self.jobs, report)
            add_turns(self.output)
            if self.characters is not None:
                from bunraku.datasets.game_clips import add_game_clips

                failed = add_game_clips(self.characters, self.output, report)[1]
        for reason in failed.values():
            print(f"left out {reason}", file=sys.stderr)
        print(f"wrote {index}")


@dataclass(frozen=True)
class Characters:
    """Turn rigged characters into samples to train on: simplified meshes whose bones are named after the 30 handles.

    One file a character; a second run goes on where the first one stopped. Files that cannot be used are named.

    Example: bunraku data characters --source archive/characters -o data/characters
    """

    source: Path
    """Folder of rigged GLB files, searched through."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write to, made when it is not there."""
    vertices: int = 2400
    """Most vertices of a simplified mesh, 200 to 20000."""

    def run(self) -> None:
        _check(self.source, self.output)
        check_range("--vertices", self.vertices, 200, 20000)
        from bunraku.datasets.characters import build_characters

        with stages() as report:
            files, failed = build_characters(
                self.source, self.output, self.vertices, progress=lambda done, total, name: report("characters", done / total)
            )
        if not files:
            raise FormatError(self.source, f"none of its {len(failed)} characters can be trained on; they need a skin with named bones")
        print(f"wrote {len(files)} files to {self.output}, left out {len(failed)}")


def _check(source: Path, output: Path, jobs: int | None = None) -> None:
    check_range("--jobs", jobs, 1, 1024)
    if not source.is_dir():
        raise FormatError(source, "there is no such folder; name the one that holds the archive")
    check_folder(output)
