"""`bunraku data examples`: captured stretches that generated motion may start from, in one file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.output.checks import check_output, check_range, check_source
from bunraku.cli.output.progress import stages

__all__ = ["Examples"]

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

    def run(self) -> None:
        check_range("--stretches", self.stretches, 1, 1000)
        check_range("--events", self.events, 0, 1000)
        if self.add_to is None or self.data != _DATA:
            check_source(self.data, "name the folder that 'bunraku data motions' wrote")
        check_output(self.output, [".safetensors"])
        from bunraku.nn.checkpoints import shipped_checkpoint
        from bunraku_lab.training.diffusion.config import SHIPPED
        from bunraku_lab.training.example_pack import ExampleSettings, build_examples

        base = shipped_checkpoint("examples") if self.add_to == SHIPPED else self.add_to
        with stages() as report:
            pack = build_examples(
                ExampleSettings(self.data, self.output, self.stretches, self.events, ranker=self.ranker, add_to=base),
                progress=report,
            )
        seconds = sum(example.frames for example in pack.examples) / 20
        print(f"wrote {len(pack.examples)} stretches, {seconds / 60:.0f} minutes, to {self.output}")
