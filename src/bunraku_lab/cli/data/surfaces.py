"""`bunraku data surfaces`: surfaces that the orientation network trains on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.output.checks import check_folder, check_range, check_source
from bunraku.cli.output.progress import stages

__all__ = ["Surfaces"]


@dataclass(frozen=True)
class Surfaces:
    """Make surfaces to train the orientation network on: characters in poses of their clips, some with limbs fused,
    some of blocks, some on plinths.

    Example: bunraku data surfaces --source archive/characters -o data/surfaces.npz
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

    def run(self) -> None:
        check_source(self.source, "name the one of the unpacked character archive")
        check_folder(self.output.parent)
        check_range("--poses", self.poses, 0, 1000)
        check_range("--forms", self.forms, 1, 100)
        from bunraku_lab.datasets.characters.surfaces import build_surfaces

        with stages() as report:
            bank = build_surfaces(
                self.source,
                self.output,
                self.poses,
                self.forms,
                self.seed,
                lambda done, total, name: report("surfaces", done / total),
            )
        print(f"wrote {len(bank)} surfaces of {len(set(bank.names))} characters to {self.output}")
