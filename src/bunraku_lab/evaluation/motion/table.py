"""The table of generated motion (A.2 of TapMo): real data and our denoiser in one protocol.

Windows of clips that no training saw are drawn once (`motion_windows`); each model makes a motion of each window's
length from its sentence, once. A run then draws `clips` of the windows without repetition, and for each 31 sentences
that mean something
else: all rows of the table see the same windows and the same sentences in a run. FID compares the drawn motions with
`references` other windows of the same clips, so the FID of the real row, which is the drawn windows themselves, is what
a perfect generator would reach. Means over the runs come with 95 % intervals, which tell how far the choice of windows,
sentences and pairs matters; runs share motions unless the pool has `clips` for each of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.errors import OptionError
from bunraku.generation.extractor import embed_motions, load_extractor
from bunraku.language.encoders import encoder_of
from bunraku_lab.evaluation.motion.metrics import (
    diversity,
    fid,
    interval,
    multimodal_distance,
    multimodality,
    r_precision,
)
from bunraku_lab.evaluation.motion.samples import (
    Request,
    SamplerSettings,
    Window,
    candidate_sentences,
    checkpoint_digest,
    choose_motions,
    draw_windows,
    make_motions,
    window_features,
)
from bunraku_lab.evaluation.report import Bar
from bunraku_lab.nn.checkpoints import lab_checkpoint
from bunraku_lab.nn.text import embed_sentences
from bunraku_lab.training.rows.clips import ClipEntry, load_clips, people

Report = Callable[[str, float], None]

# Goals, set before anything was measured.
TABLE_BARS = {
    "r_precision_1_over_real": Bar("R-Precision top-1 over that of the real data, one sample of the network", 0.80),
    "r_precision_1_over_real_distilled": Bar("- one sample of the four distilled steps alone", 0.80),
    "r_precision_1_over_real_guided": Bar("- one sample that is guided towards its sentence", 1.0),
    "r_precision_1_over_real_led": Bar("- one sample that is guided and starts from an example", 1.0),
    "r_precision_1_over_real_chosen": Bar("- as `animate` chooses (--best-of 3)", 1.08),
    "fid_real": Bar("FID of the real data (what a perfect generator reaches)"),
    "fid_real_halves": Bar("FID between two halves of the real clips"),
}
"""Figures of the table with the value that each should reach, which was set before measuring."""


@dataclass(frozen=True)
class MotionEvalConfig:
    """Settings of an evaluation.

    Args:
        data: Folder that `bunraku data motions` wrote.
        checkpoint: Weights of the denoiser; None takes the shipped ones.
        extractor: Weights of the feature extractor; None takes the shipped ones.
        work: Folder in which generated motions are kept.
        split: Split of the clips, of the data's index.
        pool: Windows, and motions of each model.
        references: Other real windows, which FID compares with.
        clips: Windows that a run draws.
        runs: Runs.
        candidates: Sentences that a motion is tried with, its own included.
        prompts: Sentences of MModality.
        repeats: Motions of each of them.
        steps: Steps of the sampler; None takes those of `animate`, and 8 of the network alone.
        guidance: Scale of classifier-free guidance; None takes the default.
        best_of: Of how many the ranker chooses each motion of the second table, and of a row of the first, as `animate`
            does; 1 for none, and no such row.
        examples: What is chosen from starts from captured examples, as in `animate`.
        classifier_guidance: What is predicted is guided towards its sentence, as in `animate`.
        seed: Of everything random.
    """

    data: Path = Path("runs/data/motions")
    checkpoint: Path | None = None
    extractor: Path | None = None
    work: Path = Path("runs/evaluation")
    split: str = "test"
    pool: int = 1600
    references: int = 3000
    clips: int = 1000
    runs: int = 20
    candidates: int = 32
    prompts: int = 20
    repeats: int = 10
    steps: int | None = None
    guidance: float | None = None
    best_of: int = 1
    examples: bool = True
    classifier_guidance: bool = True
    seed: int = 0

    def sampler(self) -> SamplerSettings:
        """The sampler of what the network says alone."""
        from bunraku.generation.candidates import GUIDANCE, STEPS

        steps, guidance = (
            STEPS if self.steps is None else self.steps,
            GUIDANCE if self.guidance is None else self.guidance,
        )
        return SamplerSettings(steps, guidance, seed=self.seed)


@dataclass
class Row:
    """A row of the table: vectors of the motions of all windows (P, E), and of MModality's (S, M, E)."""

    vectors: np.ndarray
    repeated: np.ndarray | None = None
    values: dict[str, list[float]] = field(default_factory=dict)

    def add(self, name: str, value: float) -> None:
        self.values.setdefault(name, []).append(value)


def measure_rows(
    rows: Mapping[str, Row], references: np.ndarray, windows: list[Window], clips: Mapping[str, ClipEntry],
    sentences: Mapping[str, np.ndarray], config: MotionEvalConfig, report: Report,
) -> None:  # fmt: skip
    """All runs: adds the measures of each to the rows.

    Args:
        rows: By name.
        references: Vectors of the real windows that FID compares with, shape (R, E).
        windows: The P windows.
        clips: What `load_clips` returned.
        sentences: The vector of each sentence.
        config: Settings.
    """
    for run in range(config.runs):
        drawn = np.random.default_rng([config.seed, run, 1]).permutation(len(windows))[: config.clips]
        table = candidate_sentences(
            [windows[i] for i in drawn], clips, config.candidates, np.random.default_rng([config.seed, run, 2])
        )
        text = np.stack([[sentences[sentence] for sentence in row] for row in table])
        for row in rows.values():
            motions = row.vectors[drawn]
            for index, share in enumerate(r_precision(motions, text), 1):
                row.add(f"r_precision_{index}", share)
            row.add("fid", fid(motions, references))
            row.add("mm_dist", multimodal_distance(motions, text[:, 0]))
            row.add(
                "diversity", diversity(motions, np.random.default_rng([config.seed, run, 3]))
            )  # the same pairs in all rows
            if row.repeated is not None:
                row.add("multimodality", multimodality(row.repeated, np.random.default_rng([config.seed, run, 4])))
        report("measures", (run + 1) / config.runs)


def _halves(windows: Sequence[Window], vectors: np.ndarray, runs: int, seed: int) -> float:
    """FID between the windows of one half of the clips and those of the other, mean over `runs` ways to part them."""
    names = np.array(sorted({window.clip for window in windows}))
    found = []
    for run in range(runs):
        first = set(np.random.default_rng([seed, run, 5]).permutation(names)[: len(names) // 2].tolist())
        side = np.array([window.clip in first for window in windows])
        if min(side.sum(), (~side).sum()) >= 2:
            found.append(fid(vectors[side], vectors[~side]))
    return float(np.mean(found)) if found else 0.0


def _distinct(windows: Sequence[Window], count: int) -> list[Window]:
    """Windows of different meanings, the longest first of each, in the order of the draw."""
    seen: dict[str, Window] = {}
    for window in windows:
        if window.meaning not in seen:
            seen[window.meaning] = window
    return list(seen.values())[:count]


def evaluate_motion(config: MotionEvalConfig, report: Report | None = None) -> dict[str, Any]:
    """The table.

    Returns:
        Numbers and lists that JSON can say: "rows" by name ("real", "tapmo"), each measure with "mean" and
        "half" (of the 95 % interval); "counts"; and at the top level the figures that the bars are about:
        "r_precision_1" and "r_precision_1_over_real" (2 and 3 likewise), "fid", "fid_distilled",
        "fid_real_halves", "mm_dist", "diversity", "multimodality". A figure that was not measured is
        None.

    Raises:
        OptionError: A setting is out of range, or the held-out clips have too few meanings.
        FormatError: The data are missing or damaged.
        WeightsError: Weights are missing or broken.
    """
    from bunraku.core.nn.checkpoints import load_checkpoint, shipped_checkpoint
    from bunraku.generation.denoiser import KIND
    from bunraku.generation.networks import Networks

    _check(config)
    report = report or (lambda stage, done: None)
    extractor = load_extractor(config.extractor or lab_checkpoint("extractor"))
    checkpoint = config.checkpoint or shipped_checkpoint("diffusion")
    model, own_encoder = Networks(checkpoint).denoiser, Networks(checkpoint).encoder
    clips = people(
        load_clips(config.data, lambda done, total: report("clips", done / total), {config.split}), config.split
    )
    windows = draw_windows(clips, config.pool, np.random.default_rng([config.seed, 11]))
    elsewhere = draw_windows(clips, config.references, np.random.default_rng([config.seed, 12]))
    named = _distinct(windows, config.prompts)
    sampling = config.sampler()

    encoder = encoder_of(extractor.config.text_encoder, own_encoder)
    sentences = embed_sentences(extractor, encoder, [window.sentence for window in windows])
    real, references = (
        embed_motions(extractor, [window_features(clips, window) for window in part]) for part in (windows, elsewhere)
    )
    make = partial(
        make_motions, model, own_encoder, sampling=sampling, folder=config.work, digest=checkpoint_digest(checkpoint)
    )
    requests = [Request(window.sentence, window.frames) for window in windows]
    motions = make(requests, progress=partial(_report_stage, report, "motions of tapmo"))
    again = [Request(window.sentence, window.frames) for window in named for _ in range(config.repeats)]
    repeated = make(again) if config.repeats > 1 else []
    vectors = embed_motions(extractor, repeated).reshape(len(named), config.repeats, -1) if repeated else None
    rows = {"real": Row(real), "tapmo": Row(embed_motions(extractor, motions), vectors)}
    for name, candidates, examples, guided in _ways(config, checkpoint):
        found = choose_motions(
            requests,
            replace(
                sampling, steps=config.steps, guidance=config.guidance, candidates=candidates, examples=examples,
                classifier_guidance=guided,
            ), checkpoint,
            folder=config.work, progress=partial(_report_stage, report, f"motions of {name}"),
        )  # fmt: skip
        rows[name] = Row(embed_motions(extractor, found))
    measure_rows(rows, references, windows, clips, sentences, config, report)

    result = _summary(rows)
    result["fid_real_halves"] = _halves(elsewhere, references, config.runs, config.seed)
    counts = {
        "clips": len({window.clip for window in windows}),
        "meanings": len({window.meaning for window in windows}),
    }
    seconds = sum(len(clips[name]["features"]) for name in {window.clip for window in windows}) / 20
    result["counts"] = counts | {
        "seconds": seconds,
        "windows": len(windows),
        "drawn": min(config.clips, len(windows)),
        "runs": config.runs,
    }
    result["counts"] |= {"candidates": config.candidates, "steps": sampling.steps, "guidance": sampling.guidance}
    state = load_checkpoint(checkpoint, KIND)[0]
    result["parameters"] = sum(value.size for name, value in state.items() if name not in ("mean", "std"))
    result["notes"] = {"tapmo": model.notes, "extractor": extractor.notes}
    result["settings"] = {
        key: str(value) if isinstance(value, Path) else value for key, value in asdict(config).items()
    }
    return result


def _ways(config: MotionEvalConfig, checkpoint: Path) -> list[tuple[str, int, bool, bool]]:
    """Rows of motions made as `animate` makes them: name, candidates, whether they start from examples, and whether the
    critic guides them. The few steps that were distilled hold guidance of their own, so they have a row without any.
    """
    from bunraku.generation.networks import Networks

    if config.best_of == 1:
        return []
    critic, ways = config.classifier_guidance, []
    if config.steps is None and config.guidance is None and Networks(checkpoint).few_steps is not None:
        ways.append(("tapmo_distilled", 1, False, False))
    if critic:
        ways.append(("tapmo_guided", 1, False, True))
    if config.examples:
        ways.append(("tapmo_led", 1, True, critic))
    return [*ways, ("tapmo_chosen", config.best_of, config.examples, critic)]


def _report_stage(report: Report, stage: str, done: int, total: int) -> None:
    report(stage, done / total)


def _check(config: MotionEvalConfig) -> None:
    if (
        min(config.pool, config.references) < 4
        or not 2 <= config.clips <= config.pool
        or config.runs < 1
        or config.candidates < 4
    ):
        raise OptionError(
            "an evaluation needs a pool of 4 or more, from 2 to all of it drawn a run, 1 or more runs, and 4 or more "
            "candidates"
        )
    if (config.steps is not None and not 1 <= config.steps <= 1000) or config.prompts < 1 or config.repeats < 0:
        raise OptionError("steps must be 1 to 1,000, prompts 1 or more, repeats 0 or more")


def _summary(rows: Mapping[str, Row]) -> dict[str, Any]:
    """The table, and the figures of our row with their ratios."""
    table = {name: {key: asdict(interval(values)) for key, values in row.values.items()} for name, row in rows.items()}
    result: dict[str, Any] = {"rows": table}
    ours, real = table["tapmo"], table["real"]
    for key in ("r_precision_1", "r_precision_2", "r_precision_3", "fid", "mm_dist", "diversity", "multimodality"):
        result[key] = ours[key]["mean"] if key in ours else None
    for index in (1, 2, 3):
        key = f"r_precision_{index}"
        result[f"{key}_over_real"] = ours[key]["mean"] / max(real[key]["mean"], 1e-12)
    for name in ("distilled", "guided", "led", "chosen"):
        row = table.get(f"tapmo_{name}")
        share = None if row is None else row["r_precision_1"]["mean"] / max(real["r_precision_1"]["mean"], 1e-12)
        result[f"r_precision_1_over_real_{name}"] = share
    result["fid_distilled"] = table["tapmo_distilled"]["fid"]["mean"] if "tapmo_distilled" in table else None
    result["fid_real"] = real["fid"]["mean"]
    return result
