"""`bunraku data character-bank`: characters packed for the losses that look at meshes."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.output.checks import check_folder, check_range, check_source
from bunraku.cli.output.progress import stages
from bunraku.errors import OptionError

__all__ = ["CharacterBank"]


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
        from bunraku_lab.datasets.characters.character_bank import build_character_bank

        with stages() as report:
            path, failed = build_character_bank(
                self.source,
                self.output,
                rig,
                self.code_made,
                self.variants,
                lambda done, total, name: report("characters", done / total),
            )
        for name, reason in failed.items():
            print(f"left out {name}: {reason}", file=sys.stderr)
        print(f"wrote {path}")
