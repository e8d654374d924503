"""`bunraku evaluate motion`, `study` and `tables`: what generated motion is worth, and how evaluations print."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from bunraku.cli.shared import check_input, check_range, check_source, stages
from bunraku.core.files import writing
from bunraku.errors import OptionError
from bunraku_lab.evaluation.report import Report, Table, bar_table


@dataclass(frozen=True, kw_only=True)
class Printed:
    """The options that all evaluations have for what they print."""

    json: bool = False
    """Print JSON for programs, with all that was measured."""
    markdown: bool = False
    """Print the tables as Markdown, for a page."""

    def __post_init__(self) -> None:
        if self.json and self.markdown:
            raise OptionError("--json and --markdown are two forms of the same report; choose one")

    def show(self, result: dict[str, Any], report: Callable[[dict[str, Any]], Report]) -> None:
        """Print a result in the requested form."""
        if self.json:
            print(json.dumps(result, indent=2))
        else:
            made = report(result)
            print(made.markdown() if self.markdown else made.text())


_COLUMNS = (
    ("r_precision_1", "R-Prec. 1"), ("r_precision_2", "R-Prec. 2"), ("r_precision_3", "R-Prec. 3"), ("fid", "FID"),
    ("mm_dist", "MM-Dist"), ("diversity", "Diversity"), ("multimodality", "MModality"),
)  # fmt: skip
_NAMES = {
    "real": "Real", "tapmo": "TapMo (ours)",
    "tapmo_distilled": "- four steps", "tapmo_guided": "- guided",
    "tapmo_led": "- from examples", "tapmo_chosen": "- as chosen",
}  # fmt: skip


@dataclass(frozen=True)
class EvaluateMotion(Printed):
    """Measure generated motion on held-out clips, as TapMo's Tables 1 and 2 do, and what a viewer sees of it.

    Motions of the table are kept in the folder --work, so the same command goes on where a run was stopped.

    Example: bunraku evaluate motion --data data/motions --json
    """

    data: Path
    """Folder that `bunraku data motions` wrote."""
    checkpoint: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Weights of the diffusion model. Default: the shipped ones."""
    extractor: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")] = None
    """Weights of the feature extractor. Default: the shipped ones."""
    work: Path = Path("runs/evaluation")
    """Folder in which generated motions are kept."""
    split: Literal["test", "val"] = "test"
    """Which clips."""
    runs: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Runs of the 95 % intervals. Default: 20, or 3 with --quick."""
    clips: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Windows that a run draws. Default: 1000, or 200 with --quick."""
    pool: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Windows to draw from, and motions of each model. Default: 1600, or 256 with --quick."""
    candidates: int = 32
    """Sentences that a motion is tried with, 4 to 100."""
    steps: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Sampling steps, 1 to 1000. Default: the sampler's."""
    guidance: Annotated[float | None, tyro.conf.arg(metavar="FLOAT", help_behavior_hint="")] = None
    """Classifier-free guidance scale, 0 to 20. Default: the sampler's."""
    best_of: int = 1
    """Of how many the ranker chooses each motion, 1 to 16; `bunraku animate` takes 3."""
    examples: bool = True
    """What is chosen from starts from captured examples."""
    classifier_guidance: bool = True
    """What is predicted is guided towards its sentence by the ranker's gradient, in the rows beside the network's."""
    quick: bool = False
    """Few motions, 3 runs, and only what is fast: minutes, and wide intervals."""
    only: Annotated[Literal["table", "viewer"] | None, tyro.conf.arg(help_behavior_hint="")] = None
    """The paper's table alone, or what a viewer sees alone, which takes minutes. Default: both."""
    seed: int = 0
    """Of everything random."""

    def run(self) -> None:
        check_range("--runs", self.runs, 1, 1000)
        check_range("--clips", self.clips, 32, 100_000)
        check_range("--pool", self.pool, 32, 100_000)
        check_range("--candidates", self.candidates, 4, 100)
        check_range("--steps", self.steps, 1, 1000)
        check_range("--guidance", self.guidance, 0, 20)
        check_range("--best-of", self.best_of, 1, 16)
        check_range("--seed", self.seed, 0, 2**31)
        check_source(self.data, "make it with `bunraku data motions`")
        for path in (self.checkpoint, self.extractor):
            if path is not None:
                check_input(path)
        from bunraku_lab.evaluation.motion.table import MotionEvalConfig, evaluate_motion
        from bunraku_lab.evaluation.motion.viewer_prompts import viewer_figures

        pool = self.pool or max(256 if self.quick else 1600, self.clips or 0)
        config = MotionEvalConfig(
            data=self.data, checkpoint=self.checkpoint,
            extractor=self.extractor, work=self.work,
            split=self.split, pool=pool, clips=min(self.clips or (200 if self.quick else 1000), pool),
            runs=self.runs or (3 if self.quick else 20),
            references=1000 if self.quick else 3000, prompts=8 if self.quick else 20, repeats=4 if self.quick else 10,
            candidates=self.candidates,
            steps=self.steps, guidance=self.guidance, best_of=self.best_of, examples=self.examples,
            classifier_guidance=self.classifier_guidance,
            seed=self.seed,
        )  # fmt: skip
        with stages() as report:
            result = {} if self.only == "viewer" else evaluate_motion(config, report)
            if self.only != "table":
                result |= viewer_figures(config, self.quick, report)
        self.show(result, _motion_report)


def _motion_report(result: dict[str, Any]) -> Report:
    from bunraku_lab.evaluation.motion.table import TABLE_BARS
    from bunraku_lab.evaluation.motion.viewer_prompts import VIEWER_BARS

    parts: list[Table | str] = []
    if "rows" in result:
        parts += [*_paper_rows(result), bar_table(TABLE_BARS, result)]
    if VIEWER_BARS.keys() & result:
        parts += [bar_table(VIEWER_BARS, result, "what a viewer sees"), *_actions(result)]
    return Report(parts)


def _paper_rows(result: dict[str, Any]) -> list[Table | str]:
    """The paper's table, after what it was measured on."""
    counts = result["counts"]
    rows = [["", *(title for _, title in _COLUMNS)]]
    rows += [
        [name, *(_cell(result["rows"][key].get(column)) for column, _ in _COLUMNS)]
        for key, name in _NAMES.items()
        if key in result["rows"]
    ]
    return [
        f"{counts['clips']} clips of {counts['meanings']} meanings ({counts['seconds']:,.0f} s), "
        f"{counts['windows']:,} windows, {counts['drawn']:,} a run, {counts['runs']} runs, {counts['candidates']} "
        f"sentences each, {counts['steps']} steps",
        Table(rows),
    ]


def _actions(result: dict[str, Any]) -> list[Table | str]:
    """What lies behind the figures of sides, speed and trembling."""
    sides = ", ".join(f"{action} {share:.0%}" for action, share in result["side_accuracy_by_action"].items())
    parts: list[Table | str] = [f"the side that the sentence has: {sides}"]
    names = ("generated", "captured", "ratio")
    for title, key in (("speed [m/s]", "speed_by_action"), ("third difference [cm]", "jitter_by_action")):
        rows = [[title, *names, "clips"]]
        for action, row in result[key].items():
            rows.append([action, *(_figure(row[name]) for name in names), str(row["clips"])])
        parts.append(Table(rows))
    return parts


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _cell(value: dict[str, float] | None) -> str:
    return "-" if value is None else f"{value['mean']:.3f} ±{value['half']:.3f}"


@dataclass(frozen=True)
class EvaluateTables(Printed):
    """Measure every row of a paper's tables that can be measured here, beside the paper's own figures.

    Ratios are to the same row on both sides, since the data are others. What is not run says what it lacks. Rows are
    kept in --work by what they depend on, so a second run, or one that was stopped, does only what is new.

    Example: bunraku evaluate tables --paper tapmo --table 2 --characters archive
    --baselines runs/baselines
    """

    paper: Literal["tapmo", "mmdmc"] = "tapmo"
    """Whose tables."""
    table: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Number of one table. Default: all."""
    data: Path | None = None
    """Folder that `bunraku data motions` wrote."""
    characters: Path | None = None
    """Folder of rigged characters, searched through."""
    apparel: Path | None = None
    """Folder that `bunraku data apparel` wrote; with --quick some clips are simulated without it."""
    bodies: tuple[Path, ...] = ()
    """Body networks of MMDMC's table 4. Default: the shipped one, and those of --baselines."""
    baselines: Path | None = None
    """Folder of the other methods' weights, which the commands in `benchmarks/baselines.md` make; without it their
    rows are left empty."""
    work: Path = Path("runs/tables")
    """Folder that keeps what was measured."""
    quick: bool = False
    """On few windows, characters and clips."""
    pool: Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")] = None
    """Windows of TapMo's table 1, 4 to 100000. Default: 1600, or 96 with --quick."""
    seed: int = 0
    """Of everything random."""

    def run(self) -> None:
        for path in self.bodies:
            check_input(path)
        check_source(self.data, "name the folder that `bunraku data motions` wrote")
        check_source(self.characters, "name a folder of rigged characters")
        check_source(self.baselines, "name a folder of weights")
        check_source(self.apparel, "name the folder that `bunraku data apparel` wrote")
        with writing(self.work, "folder"):
            self.work.mkdir(parents=True, exist_ok=True)
        check_range("--pool", self.pool, 4, 100_000)
        from bunraku_lab.evaluation.tables.measured import TablesConfig, measure_tables

        config = TablesConfig(
            self.paper, self.table, self.data, self.characters, self.apparel, self.bodies,
            self.baselines, self.work, self.quick, self.pool,
            self.seed,
        )  # fmt: skip
        with stages() as report:
            found = measure_tables(config, report)
        self.show({"tables": found}, _tables_report)


def _tables_report(result: dict[str, Any]) -> Report:
    from bunraku_lab.evaluation.tables.paper_table import shown_table

    return Report([part for table in result["tables"] for part in shown_table(table)])
