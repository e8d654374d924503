"""All tables of a paper, measured: MMDMC's figures, groups of rows, what each needs, and which row is whose."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bunraku.errors import BunrakuError, OptionError, WeightsError
from bunraku_lab.evaluation.apparel.rivals import BEST, FILES, NBS, OURS, PARTS, SPT, UNTRAINED
from bunraku_lab.evaluation.report import Parts
from bunraku_lab.evaluation.tables.paper_table import (
    EITHER_WAY,
    Figures,
    Group,
    NotRun,
    PaperRow,
    PaperTable,
    half_interval,
    measured_table,
)
from bunraku_lab.evaluation.tables.tapmo import HANDLE_FID, MDM, TAPMO
from bunraku_lab.nn.checkpoints import lab_checkpoint

_COLUMNS = ("PMD", "PMD_a", "PMD_b", "ELS")
_NBS = "--baselines has no such weights: bunraku train nbs"
_SPT = "--baselines has no such weights: bunraku train transfer-baseline --preset spt"
_BODY = "--baselines has no such body network: bunraku train apparel-body --network.geodesics"

# The numbers are the paper's.
_TABLE_2 = (
    PaperRow(NBS, (4.63, 8.90, 1.84, 0.73), _NBS),
    PaperRow(f"{NBS}, {UNTRAINED}", None, _NBS),
    PaperRow(BEST),
    PaperRow(SPT, (2.53, 6.62, 0.83, 0.81), _SPT),
    PaperRow(f"{SPT}, {UNTRAINED}", None, _SPT),
    PaperRow(PARTS),
    PaperRow(OURS, (1.08, 1.91, 0.75, 0.94)),
)
_FLOORS = (
    "NBS and SPT were trained on the same data for minutes on a processor. The best skinning is fitted to the truth "
    "itself. SPT shares parts with our handle predictor. Its floor moves the predicted parts as the character's own "
    "joints move, so the ratio to the floor is the fair one."
)

# The numbers are the paper's.
MMDMC: tuple[PaperTable, ...] = (
    PaperTable(
        "mmdmc", 2, "apparel and body in motion, ten frames from a true state", _COLUMNS, _TABLE_2,
        "SPT", _FLOORS, "ten", PARTS,
    ),
    PaperTable(
        "mmdmc", 2, "apparel and body in motion, 6 s from rest", _COLUMNS,
        (*(PaperRow(row.name, None, row.missing) for row in _TABLE_2), PaperRow("our skinning alone")),
        "SPT", "", "rest", PARTS,
    ),
    PaperTable(
        "mmdmc", 3, "modules", _COLUMNS,
        (
            PaperRow("body", (2.37, 5.42, 0.78, 0.82)),
            PaperRow("body + apparel", (1.15, 2.15, 0.77, 0.85)),
            PaperRow("full", (1.08, 1.91, 0.75, 0.94)),
            PaperRow("full, true mask", (1.02, 1.85, 0.74, 0.96)),
        ),
        "body",
        "The true mask comes with our network's guess of how stiff its parts are.",
    ),
    PaperTable(
        "mmdmc", 4, "geodesic attention, the truth without physics", _COLUMNS,
        (
            PaperRow("none", (1.35, 3.17, 0.74, 0.84), _BODY),
            PaperRow("sorted", (1.27, 2.82, 0.76, 0.91), _BODY),
            PaperRow("attention", (1.14, 2.29, 0.69, 0.93)),
        ),
        "none",
        "With --baselines, all three were trained for a minute on 50 characters; otherwise attention is the shipped "
        "network. After only a minute, the result depends on the characters.",
    ),
)  # fmt: skip

PAPERS: dict[str, tuple[PaperTable, ...]] = {"tapmo": TAPMO, "mmdmc": MMDMC}
_NETWORKS = ("diffusion", "extractor", "ranker", "critic", "handles")
_APPAREL = ("apparel", "apparel-guessed", "parts", "apparel-body", "apparel-refinement")
_MEASURES = {
    "R-Precision 1": "r_precision_1", "R-Precision 3": "r_precision_3", "FID": "fid", "MM-Dist": "mm_dist",
    "Diversity": "diversity", "MModality": "multimodality",
}  # fmt: skip
_MOTION_ROWS = {
    "real": "real", "tapmo": "ours, one sample", "tapmo_chosen": "ours, as animate chooses",
}  # fmt: skip
_OURS = {"with joint refinement": OURS, "body module": "our skinning alone"}
TRANSFER = "sfpt.safetensors"
"""Of the pose transfer of MDM-SFR."""
_MODULES = {
    "body module": "body", "body + apparel": "body + apparel", "with joint refinement": "full",
    "with joint refinement, true mask": "full, true mask",
}  # fmt: skip
ADAPTERS = {
    "ours with L_h": "adaptation-spring.safetensors", "ours with L_a": "adaptation-adversarial.safetensors",
    "ours, adaptation not fine-tuned": "adaptation-both.safetensors",
    "ours, adaptation of the network alone": "adaptation-all.safetensors",
}  # fmt: skip
"""Last layers of the adaptation by the rows of TapMo's table 2."""
MOTIONS = {"pool": 1600, "references": 3000, "clips": 1000, "runs": 20}
QUICK_MOTIONS = {"pool": 96, "references": 300, "clips": 80, "runs": 3, "prompts": 4, "repeats": 4}
"""Sizes of TapMo's table 1."""
WINDOWS, QUICK_WINDOWS = 96, 8
"""Of the Handle-FID of TapMo's table 2."""
BODIES = (
    "apparel-body-none.safetensors", "apparel-body-sorted.safetensors", "apparel-body-attention.safetensors",
)  # fmt: skip
"""Body networks of MMDMC's table 4 that were trained for equally long; the last takes the shipped one's place there."""
CHARACTERS = 24
"""That MMDMC's tables are measured on at the least."""

Report = Callable[[str, float], None]


@dataclass(frozen=True)
class TablesConfig:
    """What is measured, and from what.

    Args:
        paper: "tapmo" or "mmdmc".
        number: Of the table; None for all of the paper.
        data: Folder that `bunraku data motions` wrote.
        characters: Folder of rigged characters.
        apparel: Folder that `bunraku data apparel` wrote; a quick measurement without it simulates some clips.
        bodies: Body networks of MMDMC's table 4.
        baselines: Folder of the other methods' weights: those of `rivals.FILES`, "sfpt.safetensors" for MDM-SFR, the
            last layers of `ADAPTERS`, and those of `BODIES`.
        work: Folder that keeps what was measured.
        quick: On few windows, characters and clips.
        pool: Windows of TapMo's table 1; None takes as many as are usual.
        seed: Of everything random.
    """

    paper: str = "tapmo"
    number: int | None = None
    data: Path | None = None
    characters: Path | None = None
    apparel: Path | None = None
    bodies: tuple[Path, ...] = ()
    baselines: Path | None = None
    work: Path = Path("runs/tables")
    quick: bool = False
    pool: int | None = None
    seed: int = 0


def measure_tables(config: TablesConfig, report: Report | None = None) -> list[dict[str, Any]]:
    """The tables as JSON can say them (`measured_table`). What cannot be run says why, and all else is measured.

    Raises:
        OptionError: The paper has no such table.
    """
    report = report or (lambda stage, done: None)
    tables = [table for table in PAPERS[config.paper] if config.number in (None, table.number)]
    if not tables:
        numbers = ", ".join(str(table.number) for table in PAPERS[config.paper])
        raise OptionError(f"{config.paper} has no table {config.number} of figures; choose one of: {numbers}")
    out = []
    for table in tables:
        figures: Figures = {}
        reason = ""
        try:
            group = _group(table, config, report)
            figures = _rows(table, group.figures(config.work)) if group is not None else {}
        except (NotRun, BunrakuError, ImportError) as error:
            reason = str(error)
        out.append(measured_table(table, figures, reason) | {"counts": dict(figures.get("counts", {}))})
    return out


def _group(table: PaperTable, config: TablesConfig, report: Report) -> Group | None:
    if table.paper == "mmdmc":
        return _apparel_group(config, report)
    groups = {"1": _motion_group, "2": _distortion_group}
    return groups[table.key](config, report) if table.key in groups else None


def _rows(table: PaperTable, figures: Figures) -> Figures:
    """The figures of a group that are this table's."""
    if table.paper == "tapmo":
        return figures
    first = f"{table.key}: "
    counts = {"counts": figures["counts"]} if "counts" in figures else {}
    return counts | {name.removeprefix(first): values for name, values in figures.items() if name.startswith(first)}


def _needed(path: Path | None, option: str, what: str) -> Path:
    if path is None:
        raise NotRun(f"{option} names no {what}")
    return path


def _weights(config: TablesConfig, names: Iterable[str]) -> dict[str, Path]:
    """Those of some files that the folder of the baselines has, by their names."""
    folder = config.baselines
    return {} if folder is None else {name: folder / name for name in names if (folder / name).is_file()}


def _seen(config: TablesConfig, *names: str) -> dict[str, Any]:
    """What figures depend on: the shipped networks, the clips that there are, and the settings."""
    found: dict[str, Any] = {"quick": config.quick, "seed": config.seed}
    for name in names:
        try:
            found[name] = lab_checkpoint(name)
        except WeightsError:
            found[name] = "missing"
    return found


def _motion_group(config: TablesConfig, report: Report) -> Group:
    data = _needed(config.data, "--data", "folder that `bunraku data motions` wrote")

    def run(parts: Parts) -> Figures:
        from bunraku_lab.evaluation.motion.table import MotionEvalConfig, evaluate_motion

        settings: dict[str, Any] = {**sizes, "seed": config.seed, "best_of": 3, "work": config.work / "motions"}
        result = evaluate_motion(MotionEvalConfig(data=data, **settings), report)
        found = result["rows"]
        rows = {title: _over_runs(found[name]) for name, title in _MOTION_ROWS.items() if name in found}
        return rows | MDM | {"counts": {key: result["counts"][key] for key in ("windows", "runs")}}

    sizes = QUICK_MOTIONS if config.quick else MOTIONS
    if config.pool is not None:
        sizes = {**sizes, "pool": config.pool, "clips": max(2, round(config.pool * sizes["clips"] / sizes["pool"]))}
    return Group("motion", run, {**_seen(config, *_NETWORKS), **sizes, "data": data / "index.json"})


def _over_runs(row: dict[str, dict[str, float]]) -> dict[str, float]:
    """Means of a row's measures over the runs, and half of their 95 % intervals."""
    known = {column: row[key] for column, key in _MEASURES.items() if key in row}
    out = {column: values["mean"] for column, values in known.items()}
    return out | {f"{column} {EITHER_WAY}": values["half"] for column, values in known.items()}


def _distortion_group(config: TablesConfig, report: Report) -> Group:
    characters = _needed(config.characters, "--characters", "folder of rigged characters")

    def run(parts: Parts) -> Figures:
        from bunraku_lab.evaluation.tables.tapmo import DistortionConfig, measure_distortion

        count, prompts = (4, 3) if config.quick else (15, 6)
        heads = {row: trained[file] for row, file in ADAPTERS.items() if file in trained}
        how = DistortionConfig(
            characters, adapters=heads, transfer=trained.get(TRANSFER), work=config.work, count=count, prompts=prompts,
            seed=config.seed,
        )  # fmt: skip
        found = measure_distortion(how, report, parts)
        if config.data is not None:
            from bunraku_lab.evaluation.tables.tapmo import measure_handles

            windows = QUICK_WINDOWS if config.quick else WINDOWS
            for row, value in measure_handles(how, config.data, windows, report, parts).items():
                found.setdefault(row, {})[HANDLE_FID] = value
        return found

    trained = _weights(config, (TRANSFER, *ADAPTERS.values()))
    files = ",".join(sorted(path.name for path in characters.rglob("*") if path.is_file()))
    others = {**trained, **({} if config.data is None else {"data": config.data / "index.json"})}
    return Group("distortion", run, {**_seen(config, "diffusion", "handles"), "characters": files}, others)


def _apparel_group(config: TablesConfig, report: Report) -> Group:
    data = config.apparel
    if not config.quick:
        data = _needed(data, "--apparel", "folder that `bunraku data apparel` wrote")

    clips, least = (4, 0) if config.quick else (CHARACTERS, CHARACTERS)

    def run(parts: Parts) -> Figures:
        from bunraku_lab.evaluation.apparel.table import ApparelEvalConfig, evaluate_apparel

        settings = ApparelEvalConfig(
            data, clips=clips, whole=clips, least=least, bodies=bodies, quick=True, whole_only=True,
            baselines=config.baselines,
        )  # fmt: skip
        found = evaluate_apparel(settings, report, parts)
        rest, ten = _over_characters(found["whole"]), _over_characters(found["whole_ten_frames"])
        out = {f"3: {title}": rest[name] for name, title in _MODULES.items() if name in rest}
        out |= {f"2 rest: {title}": rest[name] for name, title in _OURS.items() if name in rest}
        out |= {f"2 rest: {name}": row for name, row in rest.items() if name in ten}
        out |= {f"2 ten: {name}": row for name, row in ten.items()}
        tables = {title.partition(" (")[2].partition(")")[0]: rows for title, rows in found["tables"].items()}
        out |= {f"4: {name}": row for name, row in tables.get("Table 4", {}).items()}
        names = found["names"]
        return out | {"counts": {"clips": len(names), "characters": len(set(names))}}

    trained = _weights(config, (*FILES.values(), *BODIES))
    others = [path for name, path in trained.items() if name in BODIES]
    bodies = config.bodies or ((lab_checkpoint("apparel-body"), *others) if others else ())
    given = {f"body {number}": path for number, path in enumerate(bodies)}
    index = "simulated" if data is None else next(iter(sorted(data.glob("*.json"))), data)
    sizes = {"clips": clips, "least": least}
    return Group("apparel", run, {**_seen(config, *_APPAREL, "handles"), **sizes, "data": index}, {**given, **trained})


def _over_characters(rows: list[dict[str, dict[str, float]]]) -> dict[str, dict[str, float]]:
    """Means over clips, which are of as many characters, and half of their 95 % intervals."""
    out: dict[str, dict[str, float]] = {}
    for name in rows[0] if rows else ():
        columns = {key: [row[name][key] for row in rows] for key in rows[0][name]}
        out[name] = {key: sum(values) / len(values) for key, values in columns.items()}
        out[name] |= {f"{key} {EITHER_WAY}": half_interval(values) for key, values in columns.items()}
    return out
