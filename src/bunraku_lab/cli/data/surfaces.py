"""`bunraku data surfaces`: surfaces that the orientation network trains on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.output.checks import check_folder, check_range, check_source
from bunraku.cli.output.progress import stages
from bunraku.errors import OptionError

__all__ = ["Surfaces"]


@dataclass(frozen=True)
class Surfaces:
    """Make surfaces to train the orientation network on: characters in poses of their clips, people made by code in
    poses of captured ones, some with limbs fused, some of blocks, some on plinths.

    Example: bunraku data surfaces --source archive/characters --people 300 --motions data/motions -o data/surfaces.npz
    """

    source: Path
    """Folder of rigged GLB files, searched through."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """File to write, an NPZ."""
    poses: int = 5
    """Poses of each character's clips at most, beside its bind pose, 0 to 1000."""
    forms: int = 3
    """How often each pose is remade, 1 to 100."""
    seed: int = 0
    """Of all choices."""
    people: int = 0
    """Dressed people made by code to add, 0 to 10000; about nine surfaces each."""
    motions: Path | None = None
    """Folder of `bunraku data motions` with the clips that people are posed by."""

    def run(self) -> None:
        check_source(self.source, "name the one of the unpacked character archive")
        check_folder(self.output.parent)
        check_range("--poses", self.poses, 0, 1000)
        check_range("--forms", self.forms, 1, 100)
        check_range("--people", self.people, 0, 10_000)
        if self.people:
            if self.motions is None:
                raise OptionError(
                    "--people needs clips: name their folder with --motions, as in --motions data/motions"
                )
            check_source(self.motions, "name the one of `bunraku data motions`")
        from bunraku_lab.datasets.characters.surfaces import build_surfaces
        from bunraku_lab.datasets.motions.posed_people import FIRST, clips_of_people, posed_people

        clips = clips_of_people(self.motions) if self.people and self.motions is not None else []

        with stages() as report:
            bank = build_surfaces(
                self.source,
                self.output,
                self.poses,
                self.forms,
                self.seed,
                lambda done, total, name: report("surfaces", done / total),
                self.people,
                lambda number: posed_people(FIRST + number, clips),
            )
        print(f"wrote {len(bank)} surfaces of {len(set(bank.names))} characters to {self.output}")
