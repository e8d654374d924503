"""From sentences to handle motions; and edits that keep chosen handles, or all but a span (section A.3 of TapMo)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Unpack

import numpy as np

from bunraku.core.body.layout import HANDLE_COUNT, kept_handles
from bunraku.core.geometry.curves import smooth_step
from bunraku.core.motion import HandleMotion
from bunraku.core.travel import FADE, GroundPath, _fade, moved, placed_at, put_back, put_back_runs
from bunraku.errors import MotionError, OptionError
from bunraku.generation.candidates import (
    MADE_UNTIL,
    Beginning,
    SamplingFields,
    SamplingSettings,
    arrive,
    draw_candidates,
    frames_of,
    way_of,
)
from bunraku.generation.features import FEATURE_SIZE, FeatureStatistics, decode, encode, feature_mask
from bunraku.language.sentence import Clause

if TYPE_CHECKING:
    from bunraku.generation.candidates import Candidate
    from bunraku.generation.denoiser import Denoiser
    from bunraku.generation.guide import GuidanceExample, GuidanceExamples, Guide

_APART = 1_000_003  # between the noise of a motion's candidates, so that none is that of another motion of the batch


def generate_motions(
    scripts: Sequence[Sequence[Clause]], *, seeds: int | Sequence[int] = 0, loop: bool = False,
    path: GroundPath | None = None, **sampling: Unpack[SamplingFields],
) -> list[HandleMotion]:  # fmt: skip
    """Handle motions of the reference body, all in one batch, each from one clause or several in a row.

    Args:
        scripts: For each motion its clauses.
        seeds: One for each motion; a single number gives each motion noise of its own, the first as when it is alone.
        loop: Make loops: each motion's last frame is its first again, at another position where it travels.
        path: Path of the root, in metres of the reference body; each motion then starts where the path does, and faces
            back along it where its first clause goes backwards.
        sampling: See `SamplingSettings`.

    Raises:
        OptionError: A length or a setting is outside its range.
        WeightsError: The weights are missing or broken.
    """
    how = SamplingSettings(**sampling)
    for clause in (clause for script in scripts for clause in script):
        if not (math.isfinite(clause.seconds) and clause.seconds > 0):
            raise OptionError(f"a motion needs a length of more than 0 seconds, not {clause.seconds:g}")
    if not isinstance(seeds, int) and len(seeds) != len(scripts):
        raise OptionError(f"{len(scripts)} motions need as many seeds, not {len(seeds)}")
    if not scripts:
        return []

    from bunraku.core.nn.layers import one_thread
    from bunraku.generation.candidates import Critic
    from bunraku.generation.guide import GuidanceExamples
    from bunraku.generation.networks import Texts
    from bunraku.generation.sampler import drawn_noise

    if how.progress:
        how.progress("generate", 0.0)
    networks = how.networks
    how = replace(how, held=networks)
    model = how.denoiser
    noise = drawn_noise(seeds, len(scripts))
    plain = 0 if how.all_led else 1  # candidates of a turn that start from no example
    pack = networks.examples if how.candidates > plain and how.examples else None
    critic = networks.critic if how.classifier_guidance else None
    texts = Texts.of(networks, scripts, how.candidates > 1, pack is not None, critic)
    guidance = None if pack is None else GuidanceExamples(pack, texts.shown)
    if guidance is not None and not loop:
        parted = [[part for clause in script for part in guidance.parted(clause)] for script in scripts]
        scripts = [guidance.fitted(guidance.needed(script)) for script in parted]
    if guidance is not None and how.note:
        for note in dict.fromkeys(_left_out(guidance, clause) for script in scripts for clause in script):
            if note:
                how.note(note)
    guided = {text: vector.astype(np.float32) for text, vector in texts.guided.items()}
    guides = None if critic is None else Critic(critic, guided)

    def example(row: int, index: int) -> tuple[GuidanceExample | None, GuidanceExample | None]:
        """What a candidate starts from, and what the gestures do that are made at the same time."""
        attempt, number = divmod(index, how.candidates)
        if guidance is None or (loop and len(scripts[row]) > 1):
            return None, None
        lengths = frames_of([clause.seconds for clause in scripts[row]], model.config.fps)
        shown = [clause if guidance.shows(clause) else clause.body for clause in scripts[row]]
        second = [clause.meanwhile or clause for clause in scripts[row]]
        script, gestures = (list(zip(clauses, lengths, strict=True)) for clauses in (shown, second))
        led = guidance.led_by(script) or guidance.led_by(gestures)
        if number < plain and not led:
            return None, None
        turn, drawn = (number, how.candidates) if led else (number - plain, how.candidates - plain)
        others = (attempt - 1) * drawn if attempt else None
        return guidance.of(script, noise[row], turn, others), guidance.of(gestures, noise[row], turn, others, True)

    before: list[tuple[int, GuidanceExample | None, GuidanceExample | None]] = []

    def draw(rows: list[int], indices: list[int], complete: bool = False) -> list[Candidate]:
        """Candidates, without those that would start from what one did before."""
        origins: list[tuple[int, int]] = []
        beginnings: list[Beginning] = []
        for row, index in zip(rows, indices, strict=True):
            start = example(row, index)
            if complete or start == (None, None) or (row, *start) not in before:
                origins.append((row, index))
                own_noise = noise[row][0], noise[row][1] + _APART * index
                beginnings.append(Beginning(scripts[row], own_noise, *start))
                before.append((row, *start))
        if not origins:
            return []
        first = how.candidates == 1 or not (complete or any(index >= how.candidates for _, index in origins))
        again = how if first else replace(how, progress=None)
        drawn = draw_candidates(texts, beginnings, again, loop, path, guides, complete)
        return [replace(candidate, origin=origin) for candidate, origin in zip(drawn, origins, strict=True)]

    rows = list(range(len(scripts)))
    if how.candidates > 1:
        from bunraku.generation.candidates import choose, script_scores

        def score(drawn: Sequence[Candidate]) -> np.ndarray:
            with one_thread():
                motions = [candidate.motion for candidate in drawn]
                return script_scores(networks.ranker, texts.ranked, motions, [candidate.script for candidate in drawn])

        chosen = choose(draw, len(scripts), how.candidates, score)
        later = [candidate.origin for candidate in chosen if not candidate.complete]
        for candidate in draw([row for row, _ in later], [index for _, index in later], True):
            chosen[candidate.origin[0]] = candidate
        for missed in dict.fromkeys(
            verdict.missed for one in chosen if (verdict := one.verdict) and verdict.agreement < 0
        ):
            if how.note:
                how.note(f"none of the motions that were drawn does all that was asked; the kept one misses: {missed}")
    else:
        chosen = draw(rows, [0] * len(rows), True)
    of_body = how.of_body(model)
    motions = []
    for candidate, script in zip(chosen, scripts, strict=True):
        motion = decode(candidate.motion, model.config.fps).of_own_body(of_body)
        if path is not None:
            x, z, heading = way_of(path, len(motion), model.config.fps, script)[0]
            motion = moved(motion, heading, np.array([x, 0, z]))
        motions.append(adapt(motion, candidate.adaptation))
    return motions


def _left_out(guidance: GuidanceExamples, clause: Clause) -> str:
    """A line on what of a clause no motion, or no gesture, shows; "" for nothing."""
    if instead := guidance.retrieved(clause).instead:
        unknown = ", ".join(f"'{action}'" for action in clause.actions if action not in instead)
        return f"no motion of {unknown} is known; shown by what is nearest: {', '.join(instead)}"
    word, action = guidance.unseen(clause)
    if word:
        return f"no motion of '{word}' is known; this is one of '{action}'"
    lacking = ", ".join(f"'{word}'" for word in guidance.retrieved(clause).lacking)
    if not lacking:
        return ""
    return f"no gesture of '{clause.text}' has {lacking}, and it may be left out"


def adapt(motion: HandleMotion, adaptation: np.ndarray) -> HandleMotion:
    """The motion with the adaptation [m], shape (N, K, 3), added to local translations (section 3.2 of TapMo)."""
    if not adaptation.any():
        return motion
    translations = motion.translations + adaptation
    translations[:, 0] = 0
    return replace(motion, translations=translations)


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
    motion: HandleMotion, clause: Clause, *, keep: str | Sequence[str] = (), span: tuple[float, float] | None = None,
    poses: Sequence[float] = (), seed: int = 0, **sampling: Unpack[SamplingFields],
) -> HandleMotion:  # fmt: skip
    """The motion with all but what is kept generated anew from a clause. Frames outside the span, those of `poses`, and
    kept handles hold the arrays of `motion` bit for bit.

    Args:
        motion: Motion of the reference body at the model's 20 frames a second.
        clause: The new action.
        keep: Parts or handles that stay as they are.
        span: Seconds between which frames are generated; the whole motion by default.
        poses: Seconds of single frames in it that stay too.
        seed: The same seed and version give the same motion.
        sampling: See `SamplingSettings`.

    Raises:
        OptionError: Nothing is kept, or everything; or a setting is outside its range.
        MotionError: The motion has another number of handles or frames a second than the model.
        WeightsError: The weights are missing or broken.
    """
    how = SamplingSettings(**sampling)
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
    generated = _generate(
        part, [(start - low, stop - low) for start, stop in runs], handles, [(clause.text, high - low)], seed, how,
        model,
    )  # fmt: skip
    kept = np.setdiff1d(np.arange(low, high), np.concatenate([np.arange(*run) for run in runs]))
    anchor = int(kept[0]) - low if len(kept) else 0  # a kept frame where there is one
    generated = placed_at(generated, anchor, part, anchor)
    # beyond the part all is kept
    extended = generated.take(np.clip(np.arange(len(motion)) - low, 0, len(generated) - 1))
    of_motion = {name: getattr(motion, name) for name in ("own_kind", "own_height", "soft")}
    return replace(put_back_runs(extended, motion, handles, runs, fade=0), **of_motion)


def continue_motion(
    motion: HandleMotion, script: Sequence[Clause], *, seed: int = 0, **sampling: Unpack[SamplingFields]
) -> HandleMotion:
    """A new motion that starts in the last pose of another, bit for bit, at its position and speed.

    Args:
        motion: Motion of the reference body at the model's 20 frames a second.
        script: The actions, clause by clause.
        seed: The same seed and version give the same motion.
        sampling: See `SamplingSettings`.

    Raises:
        OptionError: A setting is outside its range.
        MotionError: The motion has another number of handles or frames a second than the model.
        WeightsError: The weights are missing or broken.
    """
    how = SamplingSettings(**sampling)
    model = how.denoiser
    _check(motion, model)
    past = min(len(motion), HISTORY)
    history = motion.take(slice(len(motion) - past, len(motion)))
    script, guide = _following(history, script, seed, how, model)
    lengths = frames_of([clause.seconds for clause in script], model.config.fps)
    frames = np.minimum(np.arange(past - 1 + sum(lengths)), past - 1)
    still = history.take(frames)
    lengths[0] += past - 1
    generated = _generate(
        still, [(past, len(frames))], np.zeros(HANDLE_COUNT, bool),
        list(zip([clause.text for clause in script], lengths, strict=True)), seed, how, model, guide,
    )  # fmt: skip
    generated = placed_at(generated, past - 1, history, past - 1).take(slice(past - 1, len(generated)))
    still = still.take(slice(past - 1, len(still)))
    return put_back(generated, still, np.zeros(HANDLE_COUNT, bool), 1, len(generated), fade=0)


LOOKED = 30
"""Frames of an action that goes on in which its continuation may be entered: a stride and a half at a walk."""
AGO = 3
"""Frames between the two poses in which what goes on should agree with what was before: legs then swing the same way.
Chosen by eye.
"""


def _following(
    history: HandleMotion, script: Sequence[Clause], seed: int, how: SamplingSettings, model: Denoiser
) -> tuple[Sequence[Clause], Guide | None]:
    """The clauses of a script as examples show them, and what its frames start from: the examples, of which one that
    goes on is entered where it is most like the last poses. None where no example fits.
    """
    from bunraku.generation.guide import WEIGHTS, GuidanceExamples, Guide, goes_on
    from bunraku.generation.networks import Texts

    pack = how.networks.examples if how.examples else None
    if pack is None or len(history) <= AGO:
        return script, None
    guidance = GuidanceExamples(pack, Texts.of(how.networks, [script], False, True, None).shown)
    script = [part for clause in script for part in guidance.parted(clause)]
    lengths = frames_of([clause.seconds for clause in script], model.config.fps)
    shown = [clause if guidance.shows(clause) else clause.body for clause in script]
    example = guidance.of(list(zip(shown, lengths, strict=True)), (seed, 0), 0)
    if example is None:
        return script, None
    first = example.found[0]
    more = LOOKED if first is not None and goes_on(pack, first) else 0
    statistics, count = FeatureStatistics(model.mean, model.std), sum(lengths)
    laid = example.on([lengths[0] + more, *lengths[1:]], count + more, statistics)
    start = 0
    if more:
        past, scale = statistics.normalise(encode(history)), np.sqrt(WEIGHTS)
        away = [
            float(np.square((laid.values[[at, at + AGO]] - past[[-1 - AGO, -1]]) * scale).sum())
            for at in range(more - AGO)
        ]
        start = int(np.argmin(away)) + AGO + 1
    rise = smooth_step(np.minimum(np.arange(1, count + 1) / FADE, 1)).astype(np.float32)
    rows = slice(start, start + count)
    return script, Guide(laid.values[rows], laid.share[rows] * rise, laid.made[rows])


def _check(motion: HandleMotion, model: Denoiser) -> None:
    if motion.translations.shape[1] != HANDLE_COUNT or model.config.features != FEATURE_SIZE:
        raise MotionError(f"a motion that is edited has {HANDLE_COUNT} handles, not {motion.translations.shape[1]}")
    if abs(motion.fps - model.config.fps) > 1e-3:
        raise MotionError(
            f"a motion that is edited has {model.config.fps:g} frames a second, not {motion.fps:g}; save it at that "
            "rate"
        )


def _generate(
    original: HandleMotion, runs: Sequence[tuple[int, int]], handles: np.ndarray, script: Sequence[tuple[str, int]],
    seed: int, how: SamplingSettings, model: Denoiser, guide: Guide | None = None,
) -> HandleMotion:  # fmt: skip
    """All frames of the original with runs of frames generated anew, but for the kept handles; the root's path from x =
    z = 0 facing +Z. A guide is of the last frames.
    """
    from bunraku.core.nn.layers import one_thread
    from bunraku.generation.sampler import LED_UNTIL, Steering, plan_windows, sample_plans

    if how.progress:
        how.progress("generate", 0.0)
    text = how.networks.encoder.encode([sentence for sentence, _ in script])
    plan = plan_windows([length for _, length in script], model.config.frames)
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

    led = None
    if guide is not None:
        start = frames - len(guide.values)
        led = np.zeros((plan.frames, FEATURE_SIZE), np.float32), *np.zeros((2, plan.frames, 1), np.float32)
        until = np.where(guide.made, MADE_UNTIL, LED_UNTIL)
        for array, of_guide in zip(led, (guide.values, guide.share[:, None], until[:, None]), strict=True):
            array[start:frames] = of_guide

    with one_thread():
        mesh = how.mesh_features(model, len(text.mask))
        steering = Steering(guide=led, refine=refine, known=(held, share))
        (sample,) = sample_plans(model, text, [plan], how.solver, steering, seeds=seed, mesh_features=mesh)
    made = statistics.restore(sample.values[:frames])
    made[mask[:frames]] = features[mask[:frames]]
    adaptation = sample.adaptation[:frames].copy()
    made_anew = np.zeros(frames, bool)
    for (first, after), reach in zip(runs, reaches, strict=True):
        made_anew[first:after] = True
        for _, near in reach:  # the adaptation sets in as smoothly as what it is added to
            adaptation[near] *= (1 - _fade(len(near)))[:, None, None]
    adaptation[~made_anew] = 0
    adaptation[:, handles] = 0
    return adapt(decode(made, model.config.fps).of_own_body(how.of_body(model)), adaptation)


def _reach(first: int, after: int, frames: int) -> list[tuple[int, np.ndarray]]:
    """The kept frames that a run meets, each with the frames of the run that blend into it, nearest first."""
    edges = [(first - 1, 1)] * (first > 0) + [(after, -1)] * (after < frames)
    return [(edge, edge + way * np.arange(1, min(FADE, after - first) + 1)) for edge, way in edges]


def _goal(features: np.ndarray, first: int, after: int, fps: float) -> tuple[float, tuple[float, float]]:
    """Rotation [rad] and way [m] of the original over the frames of a span, seen from the heading before it."""
    path = decode(np.concatenate([features[first - 1 : first], features[first:after]]), fps)
    x, _, z = path.root_translation[-1].tolist()
    return float(features[first:after, 0].sum() / fps), (x, z)
