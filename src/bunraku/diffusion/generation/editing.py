"""Editing: keep chosen handles, or all but a span of frames, and generate the rest (section A.3 of TapMo, Figure 8).

What is kept overwrites the predicted x0 at every step, so the rest is made to fit it, and its own arrays are put back
at the end, so it comes back bit for bit. Where a span meets what is kept, the model's own idea of the last kept frame
tells how far off it is there; the difference is added to the frames of the span, fading out, before the next step. A
span's root is led to where the kept frames after it go on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.body.layout import HANDLE_COUNT
from bunraku.body.parts import kept_handles
from bunraku.core.motion import HandleMotion
from bunraku.core.travel import FADE, _fade, placed_at, put_back, put_back_runs
from bunraku.diffusion.features import FEATURE_SIZE, FeatureStatistics, decode, encode, feature_mask
from bunraku.diffusion.generation.drawing import Drawing, frames_of
from bunraku.diffusion.generation.generate import adapt
from bunraku.diffusion.sampling.root_path import arrive
from bunraku.errors import MotionError, OptionError
from bunraku.language.sentence import Clause

if TYPE_CHECKING:
    from bunraku.diffusion.inference.denoiser import Denoiser

__all__ = ["continue_motion", "edit_motion", "generated_runs", "pose_frames", "span_frames"]

AROUND = 60  # kept frames on either side of a span that the model sees
HISTORY = 20  # frames of another clip that its continuation is made to follow


def span_frames(span: tuple[float, float], frames: int, fps: float) -> tuple[int, int]:
    """The first frame of a span of seconds and the one after its last.

    Raises:
        OptionError: The span is empty, or outside the motion.
    """
    start, end = span
    seconds = frames / fps
    if not (math.isfinite(start) and math.isfinite(end) and 0 <= start < end and start < seconds):
        raise OptionError(
            f"a span goes from one second of the motion to a later one, such as 1.0:3.0; it has {seconds:g} s, not "
            f"{start:g}:{end:g}"
        )
    first, after = round(start * fps), min(round(end * fps), frames)
    if after <= first:
        raise OptionError(f"the span {start:g}:{end:g} holds no frame; there are {fps:g} a second")
    return first, after


def pose_frames(poses: Sequence[float], frames: int, fps: float) -> list[int]:
    """The frames of poses that stay, in order.

    Raises:
        OptionError: A time is outside the motion.
    """
    for time in poses:
        if not (math.isfinite(time) and 0 <= time <= frames / fps):
            raise OptionError(f"a pose that stays is at a second of the motion, 0 to {frames / fps:g}, not {time:g}")
    return sorted({min(round(time * fps), frames - 1) for time in poses})


def generated_runs(first: int, after: int, kept: Sequence[int]) -> list[tuple[int, int]]:
    """Runs of frames from `first` to before `after` that are generated between single frames that are kept."""
    bounds = [first - 1, *(frame for frame in kept if first <= frame < after), after]
    return [(low + 1, high) for low, high in zip(bounds, bounds[1:], strict=False) if high > low + 1]


def edit_motion(
    motion: HandleMotion,
    clause: Clause,
    *,
    keep: str | Sequence[str] = (),
    span: tuple[float, float] | None = None,
    poses: Sequence[float] = (),
    seed: int = 0,
    **sampling: Any,
) -> HandleMotion:
    """The motion with all but what is kept generated anew from a clause.

    Args:
        motion: Motion of the reference body at the model's 20 frames a second.
        clause: What it does instead.
        keep: Parts or handles that stay as they are.
        span: Seconds from and to which is generated; all of the motion by default. The frames outside stay as they are.
        poses: Seconds of single frames in it that stay too: what is between them is generated.
        seed: The same seed and version give the same motion.
        sampling: See `Drawing`.

    Returns:
        As many frames; those outside the span, those of `poses`, and the handles that are kept, hold the arrays of
        `motion` bit for bit.

    Raises:
        OptionError: Nothing is kept, or everything; or a setting is outside what can be done.
        MotionError: The motion has another number of handles or frames a second than the model.
        WeightsError: The weights are missing or broken.
    """
    how = Drawing(**sampling)
    handles = kept_handles(keep) if keep else np.zeros(HANDLE_COUNT, bool)
    first, after = (0, len(motion)) if span is None else span_frames(span, len(motion), motion.fps)
    runs = generated_runs(first, after, pose_frames(poses, len(motion), motion.fps))
    if not handles.any() and runs == [(0, len(motion))]:
        raise OptionError(
            "nothing is kept of the motion; name what stays with keep (such as 'legs'), the span of seconds that "
            "changes, or the times of poses that stay"
        )
    model = how.networks.denoiser
    _check(motion, model)
    low, high = max(first - AROUND, 0), min(after + AROUND, len(motion))
    part = motion.take(slice(low, high))
    made = _generate(
        part, [(start - low, stop - low) for start, stop in runs], handles, [clause.text], [high - low], seed, how
    )
    kept = np.setdiff1d(np.arange(low, high), np.concatenate([np.arange(*run) for run in runs]))
    anchor = int(kept[0]) - low if len(kept) else 0  # a kept frame where there is one
    made = placed_at(made, anchor, part, anchor)
    whole = made.take(
        np.clip(np.arange(len(motion)) - low, 0, len(made) - 1)
    )  # what is kept beyond the part comes next
    own = {name: getattr(motion, name) for name in ("own_kind", "own_height", "soft")}
    return replace(put_back_runs(whole, motion, handles, runs, fade=0), **own)


def continue_motion(motion: HandleMotion, script: Sequence[Clause], *, seed: int = 0, **sampling: Any) -> HandleMotion:
    """A motion that starts in the last pose of another, at its position and speed.

    Args:
        motion: Motion of the reference body at the model's 20 frames a second.
        script: What is done, clause by clause.
        seed: The same seed and version give the same motion.
        sampling: See `Drawing`.

    Returns:
        The new motion alone; its first frame is the last one of `motion`, bit for bit.

    Raises:
        OptionError: A setting is outside what can be done.
        MotionError: The motion has another number of handles or frames a second than the model.
        WeightsError: The weights are missing or broken.
    """
    how = Drawing(**sampling)
    model = how.networks.denoiser
    _check(motion, model)
    lengths = frames_of([clause.seconds for clause in script], model.config.fps)
    past = min(len(motion), HISTORY)
    history = motion.take(slice(len(motion) - past, len(motion)))
    frames = np.minimum(np.arange(past - 1 + sum(lengths)), past - 1)
    still = history.take(frames)
    lengths[0] += past - 1
    made = _generate(
        still,
        [(past, len(frames))],
        np.zeros(HANDLE_COUNT, bool),
        [clause.text for clause in script],
        lengths,
        seed,
        how,
    )
    made = placed_at(made, past - 1, history, past - 1).take(slice(past - 1, len(made)))
    return put_back(made, still.take(slice(past - 1, len(still))), np.zeros(HANDLE_COUNT, bool), 1, len(made), fade=0)


def _check(motion: HandleMotion, model: Denoiser) -> None:
    if motion.translations.shape[1] != HANDLE_COUNT or model.config.features != FEATURE_SIZE:
        raise MotionError(f"a motion that is edited has {HANDLE_COUNT} handles, not {motion.translations.shape[1]}")
    if abs(motion.fps - model.config.fps) > 1e-3:
        raise MotionError(
            f"a motion that is edited has {model.config.fps:g} frames a second, not {motion.fps:g}; save it at that "
            "rate"
        )


def _generate(
    original: HandleMotion,
    runs: Sequence[tuple[int, int]],
    handles: np.ndarray,
    texts: list[str],
    lengths: list[int],
    seed: int,
    how: Drawing,
) -> HandleMotion:
    """All frames of the original with some runs of frames made anew, but for the kept handles; the root's path from x
    = z = 0 facing +Z.
    """
    from bunraku.diffusion.sampling.sampler import Steering
    from bunraku.diffusion.sampling.windows import plan_windows, sample_plans
    from bunraku.nn.threads import one_thread

    if how.progress:
        how.progress("generate", 0.0)
    networks = how.networks
    model, encoder = networks.denoiser, networks.encoder
    text = encoder.encode(texts)
    plan = plan_windows(lengths, model.config.frames)
    frames = len(original)
    statistics = FeatureStatistics(model.mean, model.std)
    features = encode(original)
    mask = np.zeros((plan.frames, FEATURE_SIZE), bool)
    mask[:frames] = True
    for first, after in runs:
        mask[first:after] = False
    mask[:frames, feature_mask(handles)] = True
    values = np.zeros((plan.frames, FEATURE_SIZE), np.float32)
    values[:frames] = statistics.normalise(features)
    held, share = values, mask.astype(np.float32)
    reaches = [_reach(first, after, frames) for first, after in runs]
    goals = [
        _goal(features, first, after, model.config.fps) if len(reach) == 2 and not handles[0] else None
        for (first, after), reach in zip(runs, reaches, strict=True)
    ]

    def refine(x0: np.ndarray) -> np.ndarray:
        x0 = x0.copy()
        mean, std = model.mean[:3], model.std[:3]
        for (first, after), reach, goal in zip(runs, reaches, goals, strict=True):
            for edge, near in reach:
                fade = _fade(len(near)).astype(x0.dtype)[:, None]
                x0[near] += fade * (held[edge] - x0[edge])
            if goal is not None:
                x0[first:after, :3] = (arrive(x0[first:after, :3] * std + mean, model.config.fps, *goal) - mean) / std
        return x0

    with one_thread():
        mesh = how.mesh_features(model, len(text.mask))
        steering = Steering(refine=refine, known=(held, share))
        (found,) = sample_plans(model, text, [plan], how.solver, steering, seeds=seed, mesh_features=mesh)
    made = statistics.restore(found.values[:frames])
    made[mask[:frames]] = features[mask[:frames]]
    adaptation = found.adaptation[:frames].copy()
    made_anew = np.zeros(frames, bool)
    for (first, after), reach in zip(runs, reaches, strict=True):
        made_anew[first:after] = True
        for _, near in reach:  # the adaptation sets in as smoothly as what it is added to
            adaptation[near] *= (1 - _fade(len(near)))[:, None, None]
    adaptation[~made_anew] = 0
    adaptation[:, handles] = 0
    return adapt(decode(made, model.config.fps).of_own_body(how.of_body(model)), adaptation)


def _reach(first: int, after: int, frames: int) -> list[tuple[int, np.ndarray]]:
    """The kept frames that a run meets, each with the frames of the run that are led to it, nearest first."""
    edges = [(first - 1, 1)] * (first > 0) + [(after, -1)] * (after < frames)
    return [(edge, edge + way * np.arange(1, min(FADE, after - first) + 1)) for edge, way in edges]


def _goal(features: np.ndarray, first: int, after: int, fps: float) -> tuple[float, tuple[float, float]]:
    """Turn [rad] and way [m] of the original over the frames of a span, seen from the heading before it."""
    path = decode(np.concatenate([features[first - 1 : first], features[first:after]]), fps)
    return float(features[first:after, 0].sum() / fps), (
        float(path.root_translation[-1, 0]),
        float(path.root_translation[-1, 2]),
    )
