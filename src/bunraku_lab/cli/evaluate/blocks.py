"""`bunraku evaluate blocks`: whether figures of rigid blocks stay rigid and jointed."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import tyro

from bunraku.cli.output.checks import check_input, check_range

__all__ = ["EvaluateBlocks"]


@dataclass(frozen=True)
class EvaluateBlocks:
    """Measure what an animation does to figures of rigid blocks: shear inside a block, and gaps at joints.

    Each file does what a sentence says, is written as GLB, and is read back at a rate that falls between its frames.
    Exits with 1 where shear is over 0.01 % of the height, or a gap over 1 %.

    Example: bunraku evaluate blocks robot.glb cube-pet.glb
    """

    files: tyro.conf.Positional[tuple[Path, ...]]
    """Characters."""
    sentence: str = "walks forward, then waves with the left hand"
    """What they do."""
    seconds: float = 5.0
    """For how long, 1 to 9.8."""
    seed: int = 1
    """Of the motion."""
    json: bool = False
    """Print JSON for programs."""

    def run(self) -> int:
        check_range("--seconds", self.seconds, 1, 9.8)
        for path in self.files:
            check_input(path)
        from bunraku_lab.evaluation.handles.block_files import GAP, SHEAR, block_file

        rows = [block_file(path, self.sentence, self.seconds, self.seed) for path in self.files]
        if self.json:
            print(json.dumps(rows, indent=2))
        else:
            for row in rows:
                if row["blocks"]:
                    shear, gap = f"{row['shear']:.1e}", f"{100 * row['gap']:.2f} %"
                    print(f"{row['file']}: {row['blocks']} blocks, shear {shear} of the height, largest gap {gap}")
                else:
                    print(f"{row['file']}: no figure of rigid blocks")
        bad = [row for row in rows if row["blocks"] and (row["shear"] > SHEAR or row["gap"] > GAP)]
        return int(bool(bad))
