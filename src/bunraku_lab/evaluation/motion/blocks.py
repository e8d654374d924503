"""What `bunraku evaluate motion` measures beside its table: speed, Handle-FID, seams, feet, distortion.

Each block is a function of the result, the settings and a progress callback that returns figures by key; one that
cannot run says why in "left_out". `BARS` lists the figures with the value that each should reach.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from bunraku.errors import BunrakuError, OptionError
from bunraku_lab.evaluation.motion.samples import (
    Request,
    Window,
    checkpoint_digest,
    draw_windows,
    make_motions,
    window_features,
)
from bunraku_lab.evaluation.motion.table import MotionEvalConfig, Report
from bunraku_lab.evaluation.report import Bar
from bunraku_lab.training.rows.clips import ClipEntry, load_clips, people

__all__ = ["BARS", "add_blocks", "arap_block", "foot_block", "handle_fid_block", "seam_block", "speed_block"]

Clips = Mapping[str, ClipEntry]
Progress = Callable[[float], None]
SCRIPT = (
    "a person walks forward", "a person turns around", "a person dances", "a person walks backwards",
    "a person waves with the right hand",
)  # fmt: skip
"""The clip of 60 s of five prompts, 12 s each."""
FAST_SCRIPT = (
    "a person walks forward", "a person runs", "a person jumps up", "a person dances",
    "a person waves with the right hand",
)  # fmt: skip
"""The same with what is many times as fast as the median by nature."""
SEAM_SEEDS = 3

# Goals, set before anything was measured.
BARS = {
    "r_precision_1_over_real": Bar("R-Precision top-1 over that of the real data, one sample of the network", 0.80),
    "r_precision_1_over_real_distilled": Bar("- one sample of the four distilled steps alone", 0.80),
    "r_precision_1_over_real_guided": Bar("- one sample that is guided towards its sentence", 1.0),
    "r_precision_1_over_real_led": Bar("- one sample that is guided and starts from an example", 1.0),
    "r_precision_1_over_real_chosen": Bar("- as `animate` chooses (--best-of 3)", 1.08),
    "fid_real": Bar("FID of the real data (what a perfect generator reaches)"),
    "fid_real_halves": Bar("FID between two halves of the real clips"),
    "arap_ratio_seen": Bar("ARAP-Loss with the adaptation over without, seen", most=0.87),
    "arap_ratio_unseen": Bar("ARAP-Loss with the adaptation over without, unseen", most=0.92),
    "arap_ratio_learned_seen": Bar("the network's share of that alone, seen"),
    "arap_ratio_learned_unseen": Bar("the network's share of that alone, unseen"),
    "handle_fid": Bar("Handle-FID on two bodies"),
    "foot_sliding_cm": Bar("sliding of a foot that is down [cm a frame]", most=1.0),
    "foot_sliding_without_cm": Bar("the same without the stage [cm a frame]"),
    "seam_jump_prompts": Bar("60 s of five prompts: largest frame-to-frame jump over median", most=3.0),
    "seam_jump_prompts_elsewhere": Bar("the same away from the seams"),
    "seam_jump_fast": Bar("the same with running and jumping"),
    "seam_jump_fast_elsewhere": Bar("the same away from the seams"),
    "seconds_196": Bar("196 frames from cached text [s]", most=3.0),
    "seconds_batch8": Bar("the same in a batch of 8, each [s]", most=1.5),
}


def speed_block(config: MotionEvalConfig) -> dict[str, float]:
    """Seconds from a known sentence to 196 frames, alone (best of three) and in a batch of 8 (best of two)."""
    from bunraku.generation.generate import generate_motion, generate_motions
    from bunraku.language.parse import clauses_of

    def best(count: int, work: Callable[[], object]) -> float:
        found = []
        for _ in range(count):
            start = time.perf_counter()
            work()
            found.append(time.perf_counter() - start)
        return min(found)

    how: dict[str, Any] = {"steps": config.steps, "guidance": config.guidance, "checkpoint": config.checkpoint}
    prompts = [*SCRIPT, "a person kicks", "a person sits down", "a person turns left"]
    generate_motions(
        [clauses_of([(prompt, 0.5)]) for prompt in prompts], **{**how, "steps": 1}
    )  # encodes the sentences
    one = best(3, lambda: generate_motion(prompts[0], 9.8, **how))
    eight = best(2, lambda: generate_motions([clauses_of([(prompt, 9.8)]) for prompt in prompts], **how))
    return {"seconds_196": one, "seconds_batch8": eight / len(prompts)}


def seam_block(config: MotionEvalConfig) -> dict[str, float]:
    """60 s of five prompts: the largest step of the handles near a seam over the median of the clip; means of seeds."""
    from bunraku.generation.generate import generate_motions
    from bunraku.language.parse import clauses_of
    from bunraku_lab.evaluation.motion.metrics import measure_seams

    out: dict[str, float] = {}
    for suffix, script in (("_prompts", SCRIPT), ("_fast", FAST_SCRIPT)):
        parts = clauses_of((prompt, 12.0) for prompt in script)
        seeds = [config.seed + number for number in range(SEAM_SEEDS)]
        motions = generate_motions(
            [parts] * SEAM_SEEDS, seeds=seeds, steps=config.steps, guidance=config.guidance,
            checkpoint=config.checkpoint,
        )  # fmt: skip
        found = [
            measure_seams(motion, [round(12 * number * motion.fps) for number in range(1, len(script))])
            for motion in motions
        ]
        out[f"seam_jump{suffix}"] = float(np.mean([report.displacement for report in found]))
        out[f"seam_jump{suffix}_elsewhere"] = float(np.mean([report.displacement_elsewhere for report in found]))
        out[f"seam_acceleration{suffix}"] = float(np.mean([report.jump for report in found]))
        out[f"seam_acceleration{suffix}_elsewhere"] = float(np.mean([report.jump_elsewhere for report in found]))
    return out


def handle_fid_block(config: MotionEvalConfig, count: int, progress: Progress) -> dict[str, float]:
    """Handle-FID of our model's motions, made for each body, and that of the real motions of other windows."""
    from bunraku.anatomy.handles.predict import mesh_feature
    from bunraku.core.body.reference import reference_body
    from bunraku_lab.evaluation.motion.metrics import BODIES, body_handles, handle_fid

    clips, windows = _windows(config, count, 21)
    others = _windows(config, count, 22, clips)[1]
    made, real, again = {}, {}, {}
    for number, shape in enumerate(BODIES):
        feature = mesh_feature(reference_body(shape).character())
        made[shape] = body_handles(_motions(config, windows, feature), shape)
        progress((3 * number + 1) / (3 * len(BODIES)))
        real[shape] = body_handles([window_features(clips, window) for window in windows], shape)
        progress((3 * number + 2) / (3 * len(BODIES)))
        again[shape] = body_handles([window_features(clips, window) for window in others], shape)
        progress((3 * number + 3) / (3 * len(BODIES)))
    return {"handle_fid": handle_fid(made, real), "handle_fid_real": handle_fid(again, real)}


def foot_block(config: MotionEvalConfig, count: int, progress: Progress) -> dict[str, float]:
    """Feet of motions of held-out sentences, on the reference body and on unseen humanoids."""
    from bunraku_lab.evaluation.motion.characters import chosen_files, foot_figures, load_named

    characters = []
    if config.characters is not None:
        characters = load_named(chosen_files(config.characters, True, 8), config.characters, humanoids=True)[:4]
    return foot_figures(_motions(config, _windows(config, count, 23)[1]), characters, progress)


def arap_block(config: MotionEvalConfig, quick: bool, progress: Progress) -> dict[str, float | None]:
    """ARAP-Loss with and without the adaptation on seen and unseen characters.

    Raises:
        OptionError: No folder of characters was named.
    """
    from bunraku_lab.evaluation.motion.characters import arap_figures, chosen_files, load_named

    if config.characters is None:
        raise OptionError("--characters names no folder")
    files = [file for unseen in (False, True) for file in chosen_files(config.characters, unseen, 3 if quick else 15)]
    characters = load_named(files, config.characters, progress=lambda done: progress(0.3 * done))
    return arap_figures(
        characters, config.checkpoint, 2 if quick else 6, config.steps, config.seed,
        lambda done: progress(0.3 + 0.7 * done),
    )  # fmt: skip


def _windows(
    config: MotionEvalConfig, count: int, stream: int, clips: Clips | None = None
) -> tuple[Clips, list[Window]]:
    """The held-out clips and some windows of them."""
    clips = clips or people(load_clips(config.data, splits={config.split}), config.split)
    return clips, draw_windows(clips, count, np.random.default_rng([config.seed, stream]))


def _motions(
    config: MotionEvalConfig, windows: list[Window], mesh_feature: np.ndarray | None = None
) -> list[np.ndarray]:
    """Our model's motions of windows; for a character with its adaptation."""
    from bunraku.core.nn.checkpoints import shipped_checkpoint
    from bunraku.generation.networks import load_generator

    path = config.checkpoint or shipped_checkpoint("diffusion")
    model, encoder = load_generator(path)
    requests = [Request(window.sentence, window.frames) for window in windows]
    return make_motions(
        model, encoder, requests, config.sampler(), folder=config.work, digest=checkpoint_digest(path),
        mesh_feature=mesh_feature,
    )  # fmt: skip


def add_blocks(result: dict[str, object], config: MotionEvalConfig, quick: bool, report: Report) -> None:
    """Add the figures of all blocks to a result of `evaluate_motion`.

    Args:
        result: Gets the figures, None where a block could not run, and "left_out" with the reasons.
        config: Settings.
        quick: Measure on few motions.
    """
    left_out = result.setdefault("left_out", {})
    assert isinstance(left_out, dict)
    blocks: Mapping[str, Callable[[], Mapping[str, Any]]] = {
        "speed": lambda: speed_block(config),
        "seams": lambda: seam_block(config),
        "handles": lambda: handle_fid_block(config, 12 if quick else 96, lambda done: report("handles", done)),
        "feet": lambda: foot_block(config, 4 if quick else 24, lambda done: report("feet", done)),
        "distortion": lambda: arap_block(config, quick, lambda done: report("distortion", done)),
    }
    for key in BARS:
        result.setdefault(key, None)
    for name, block in blocks.items():
        report(name, 0.0)
        try:
            result.update(block())
        except (BunrakuError, ImportError) as error:
            left_out[name] = str(error)
        report(name, 1.0)
