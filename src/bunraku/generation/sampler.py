"""Sampling: from seeded noise and sentences to motions, with solvers, classifier-free guidance and values that are
known beforehand; and motions longer than the denoiser's window, in windows that overlap and are denoised together.

A motion is cut into pieces, each within one sentence and short enough for the denoiser. The window of a piece reaches
over both its ends into its neighbours, and at every step the predictions of two windows fade into each other there. A
loop is the same on a circle.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from bunraku.core.nn.layers import parallel
from bunraku.generation.denoiser import TRAINING_STEPS, Denoiser, RetrievedExamples
from bunraku.generation.features import FeatureStatistics
from bunraku.language.encoders import TextBatch

_BITS = 24
_LANES = 16
"""Numbers that are drawn together: the first half are lengths, the second angles (Box & Muller 1958)."""


class Noise:
    """Normal numbers from a Mersenne twister (Matsumoto & Nishimura 1998); the lowest 32 bits of the seed count."""

    def __init__(self, seed: int):
        self._twister = np.random.RandomState(seed & 0xFFFFFFFF)

    def draw(self, *shape: int) -> np.ndarray:
        """The next numbers of this shape, float32: at least 16 at a time."""
        count = int(np.prod(shape))
        uniform = self._uniform(count)
        full = count // _LANES * _LANES
        out = np.empty(count, np.float32)
        out[:full] = _normal(uniform[:full])
        if full < count:  # the last 16 are drawn anew
            out[count - _LANES :] = _normal(self._uniform(_LANES))
        return out.reshape(shape)

    def _uniform(self, count: int) -> np.ndarray:
        """Numbers from 0 to below 1, float32."""
        drawn = self._twister.randint(0, 1 << _BITS, count, np.uint32)
        return drawn.astype(np.float32) * np.float32(2.0**-_BITS)


def _normal(uniform: np.ndarray) -> np.ndarray:
    first, second = np.split(uniform.reshape(-1, _LANES), 2, axis=1)
    length = np.sqrt(np.float32(-2) * np.log(np.float32(1) - first))
    angle = np.float32(2 * np.pi) * second
    return np.concatenate([length * np.cos(angle), length * np.sin(angle)], axis=1).reshape(-1)


def generator(seed: int, row: int) -> Noise:
    """The noise of one row of a batch, so that a row is the same in any batch."""
    return Noise((seed + row * 0x9E3779B97F4A7C15) % 2**63)


def row_noise(frames: int, features: int, seed: int, row: int = 0) -> np.ndarray:
    """x_T of one row of a batch, from a generator of (seed, row) of its own, shape (frames, features)."""
    return generator(seed, row).draw(frames, features)


FEW, MANY = (4, (-3.5, 2.0)), (20, (-6.0, 4.0))
"""Of how many steps, the lambda near the first that a sampler visits and at the last: 980 and 78 of four, 999 and 5 of
twenty. Beyond them little changes from step to step, and few steps are better spent between. Tried for four: 1.6 in
place of 2.
"""


def alphas_cumprod() -> np.ndarray:
    """Share of signal power left after each step, shape (1000,), float64, falling; betas are capped at 0.999."""
    time = np.arange(TRAINING_STEPS + 1) / TRAINING_STEPS
    curve = np.cos((time + 0.008) / 1.008 * math.pi / 2) ** 2
    betas = np.minimum(1 - curve[1:] / curve[:-1], 0.999)
    return np.cumprod(1 - betas)


def sampling_steps(count: int) -> list[int]:
    """Training steps that a sampler of `count` steps, 1 to 1,000, visits: falling, even in the log of the
    signal-to-noise ratio.

    The high end decides what happens and the low end how crisply, and both get more of such steps than of even ones: 20
    even steps lose a sixth of the motion's spread and end four times as far from the limit of many steps. 12 of these
    end nearer to it than 20 that are dense at both ends as a cosine is. Twenty and more begin with the last training
    step; fewer end their range earlier at both sides.
    """
    curve = alphas_cumprod()
    ratio = 0.5 * np.log(curve / (1 - curve))  # the lambda of DPM-Solver++, falling
    ends = np.array([np.interp(count, (FEW[0], MANY[0]), pair) for pair in zip(FEW[1], MANY[1], strict=True)])
    wanted = np.interp(np.linspace(ends[0], ends[1], count), ratio[::-1], np.arange(TRAINING_STEPS)[::-1])
    steps: list[int] = []
    for index, step in enumerate(wanted):
        below = steps[-1] - 1 if steps else TRAINING_STEPS - 1
        even = below if count >= MANY[0] and not steps else round(float(step))
        steps.append(max(min(even, below), count - 1 - index))  # no step twice, and room for those to come
    return steps


Predict = Callable[[np.ndarray, int], np.ndarray]
Progress = Callable[[int, int], None]


def _moments(step: int, curve: np.ndarray) -> tuple[float, float, float]:
    """alpha, sigma and half the log of their ratio's square after `step`; step -1 is the clean motion."""
    share = float(curve[step]) if step >= 0 else 1.0
    alpha, sigma = math.sqrt(share), math.sqrt(1 - share)
    return alpha, sigma, math.log(alpha / sigma) if sigma > 0 else math.inf


def dpm_solver(
    predict: Predict, noise: np.ndarray, steps: list[int], progress: Progress | None = None, order: int = 2
) -> np.ndarray:
    """DPM-Solver++ (2M): from x_T to x_0 with one prediction of x0 a step.

    Args:
        predict: (x_t, t) -> x0.
        noise: x_T, of any shape.
        steps: Training steps to visit, falling.
        progress: Called with (done, total).
        order: 2; of order 1 it is DDIM (Song et al. 2021), which networks learn few steps by.
    """
    curve, x = alphas_cumprod(), noise
    before: tuple[np.ndarray, float] | None = None  # the last prediction and its lambda
    for index, step in enumerate(steps):
        _, sigma, here = _moments(step, curve)
        alpha_next, sigma_next, there = _moments(steps[index + 1] if index + 1 < len(steps) else -1, curve)
        clean = predict(x, step)
        direction = clean
        if order > 1 and before is not None and math.isfinite(there):  # second order: extrapolate in lambda
            ratio = (there - here) / (here - before[1])
            direction = clean + 0.5 * ratio * (clean - before[0])
        x = (sigma_next / sigma) * x - alpha_next * math.expm1(here - there) * direction
        before = (clean, here)
        if progress is not None:
            progress(index + 1, len(steps))
    return x


# Guidance acts while the diffusion step, 0 to 999, is at least this; below it the sentence's own prediction is taken,
# which costs half. The early, noisy steps decide what is done. In the late ones the scale only enlarges details: waves
# trembled above 5 Hz. (Guidance on an interval of noise: Kynkaanniemi et al. 2024.)
GUIDED_FROM = 500
# Down to this step a guide stands for what the network would predict; the next one visited has a log signal-to-noise
# ratio of about -0.4. The root's way, height and tilt are the guide's to the end: the network halves the height of a
# jump even where there is no noise left.
LED_UNTIL = 600
ROOT = slice(0, 10)  # its features (`diffusion.features`)
GROUP = 16  # windows that go through the denoiser at once; more gain nothing on a CPU and take memory


@dataclass(frozen=True)
class Window:
    """A stretch of the time line that the denoiser sees at once."""

    # frames of the time line, shape (L,); a loop's run on from its end to its start, and may come twice
    frames: np.ndarray
    share: np.ndarray  # weight of the window's prediction of each frame among those of all windows, shape (L,)
    row: int  # its sentence, and mesh feature


@dataclass(frozen=True)
class Sample:
    """Motions in network units, shape (..., N, D), and offsets on local translations [m], shape (..., N, K, 3)."""

    values: np.ndarray
    adaptation: np.ndarray


def between(first: np.ndarray, second: np.ndarray, share: np.ndarray) -> np.ndarray:
    """The first, and the second by its share; exact where that is 0 or 1."""
    way = second - first
    return np.where(share < 0.5, first + share * way, second - way * (1 - share))


def guided(
    conditional: np.ndarray, unconditional: np.ndarray, guidance: float, rescale: float = 0.0,
    real: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """Classifier-free guidance on x0 (Ho & Salimans 2022), brought back towards the conditional's deviation by the
    share `rescale` (Lin et al. 2023), shape (B, N, D); `real` (B, N) is False in padding, which does not count in the
    deviation.
    """
    x0 = unconditional + np.float32(guidance) * (conditional - unconditional)
    if rescale > 0:
        factor = _deviation(conditional, real) / np.maximum(_deviation(x0, real), np.float32(1e-8))
        x0 = x0 * (np.float32(rescale) * factor + np.float32(1 - rescale))
    return np.asarray(x0)


def _deviation(x: np.ndarray, real: np.ndarray | None) -> np.ndarray:
    rows = x if real is None else [row[keep] for row, keep in zip(x, real, strict=True)]
    return np.array([row.std(ddof=1) for row in rows], np.float32)[:, None, None]


def token_share(frames: int, patch: int) -> np.ndarray:
    """How far each frame trusts its token, shape (frames,): most in the middle, least at the edges."""
    return (1 - np.abs((np.arange(frames) % patch + 0.5) * 2 / patch - 1)).astype(np.float32)


@dataclass(frozen=True)
class Solver:
    """How motions are denoised."""

    steps: int = 8  # predictions of x0, one after the other
    guidance: float = 3.0  # scale of classifier-free guidance; 1 is the conditional model alone and takes half the time
    rescale: float = 0.0  # share of guidance rescaling, 0 to 1
    progress: Progress | None = None  # called with (done, total) steps


@dataclass(frozen=True)
class Steering:
    """What acts on the predicted x0 of a time line at each step, in this order.

    Args:
        classifier_guidance: Changes the network's prediction (F, D) at a step.
        guide: The start of the motion, which replaces predictions while the noise is strong, how far, and down to which
            step, at most `LED_UNTIL`, shapes (F, D), (F, 1) and (F, 1). Where it leads down to less than 0, the network
            is not asked, and says no adaptation.
        refine: Changes the predicted x0 (F, D).
        known: Values to keep and how far, shapes (F, D) and (F, D) or (F, 1).
    """

    classifier_guidance: Callable[[np.ndarray, int], np.ndarray] | None = None
    guide: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
    refine: Callable[[np.ndarray], np.ndarray] | None = None
    known: tuple[np.ndarray, np.ndarray] | None = None


def sample_windows(
    model: Denoiser, text: TextBatch, windows: Sequence[Window], noise: np.ndarray, solver: Solver = Solver(),
    steering: Steering = Steering(), *, mesh_features: np.ndarray | None = None,
) -> Sample:  # fmt: skip
    """Denoise a time line through windows, all of them at each step: where they overlap, x0 is the mean of their
    predictions. Values (F, D) and adaptation (F, K, 3) are zero in frames that no window counts in.

    Neighbours thus agree while the motion takes shape, and not only afterwards (as in DiffCollage, Zhang et al. 2023,
    and the first take of DoubleTake, Shafir et al. 2023). Motions of a batch lie one after the other on the time line,
    no window reaching from one into another.

    Args:
        model: The denoiser.
        text: Encoded sentences, which the windows name by their rows.
        windows: What the denoiser sees at once.
        noise: x_T on the time line, shape (F, D).
        solver: How it is denoised.
        steering: What acts on the predictions.
        mesh_features: f_phi of each sentence's character, shape (B, 448).
    """
    predictor = Predictor(model, text, windows, len(noise), solver, steering, mesh_features)
    values = dpm_solver(predictor, noise, predictor.visited, solver.progress, 1 if model.visited else 2)
    return Sample(values, predictor.adaptation)


class Predictor:
    """x0 of a time line at a step, by all windows and all that steers; a model that learned few steps visits those and
    takes its guidance from its weights. `frames` are those of the time line, other arguments as of `sample_windows`.

    Attributes:
        visited: The steps, falling; the last one gives the adaptation.
        adaptation: Of the last step, shape (F, K, 3).
    """

    def __init__(
        self, model: Denoiser, text: TextBatch, windows: Sequence[Window], frames: int, solver: Solver = Solver(),
        steering: Steering = Steering(), mesh_features: np.ndarray | None = None,
    ):  # fmt: skip
        self.model, self.steering = model, steering
        self.visited = list(model.visited) or sampling_steps(solver.steps)
        guide = steering.guide
        until = [TRAINING_STEPS] * len(windows)
        if guide is not None:
            _, share, down_to = guide
            until = [
                int(down_to[window.frames].max()) if (share[window.frames] >= 1).all() else TRAINING_STEPS
                for window in windows
            ]
        seen = [(window, led) for window, led in zip(windows, until, strict=True) if led >= 0]
        seen.sort(key=lambda pair: (-pair[1], len(pair[0].frames)))  # a group pads to its longest
        examples = None
        if model.config.examples and seen:
            from bunraku.generation.retrieve import example_bank

            examples = example_bank(model.config, FeatureStatistics(model.mean, model.std))(text)
        total = np.zeros(frames, np.float32)
        for window in windows:
            np.add.at(total, window.frames, window.share)
        if model.visited:
            solver = replace(solver, guidance=1.0)
        self._groups = [
            _Group(model, text, some[start : start + GROUP], mesh_features, examples, solver, total, led)
            for led, pairs in itertools.groupby(seen, key=lambda pair: pair[1])
            for some in [[window for window, _ in pairs]]
            for start in range(0, len(some), GROUP)
        ]
        self.adaptation = np.zeros((frames, model.config.handles, 3), np.float32)

    def __call__(self, x: np.ndarray, step: int) -> np.ndarray:
        """x0 (F, D) from x_t on the time line (F, D)."""
        x0, final = np.zeros_like(x), step == self.visited[-1]
        for group in self._groups:
            if step >= group.until and not final:
                continue  # whatever the network says, the guide overwrites it
            values, offsets = group.predict(self.model, x, step, final)
            x0 += group.laid(values)
            if offsets is not None:
                laid = group.laid(offsets.reshape(*offsets.shape[:2], -1))
                self.adaptation += laid.reshape(self.adaptation.shape)
        steering = self.steering
        if steering.classifier_guidance is not None:
            x0 = steering.classifier_guidance(x0, step)
        if steering.guide is not None:
            values, share, until = steering.guide
            pose = slice(ROOT.stop, None)
            x0[:, ROOT] = between(x0[:, ROOT], values[:, ROOT], share)
            x0[:, pose] = between(x0[:, pose], values[:, pose], share * (step >= until))
        if steering.refine is not None:
            x0 = steering.refine(x0)
        return x0 if steering.known is None else between(x0, *steering.known)


class _Group:
    """Windows that go through the denoiser together, with what does not depend on the step. A guide leads all of a
    group in all of their frames down to one step.
    """

    def __init__(
        self, model: Denoiser, text: TextBatch, windows: Sequence[Window], mesh_features: np.ndarray | None,
        examples: RetrievedExamples | None, solver: Solver, total: np.ndarray, until: int,
    ):  # fmt: skip
        self.until = until
        count, longest = len(windows), max(len(window.frames) for window in windows)
        self.guidance, self.rescale = solver.guidance, solver.rescale
        self.twice = 1 if solver.guidance == 1 else 2
        self.lengths = np.array([len(window.frames) for window in windows])
        self.real = np.arange(longest) < self.lengths[:, None]
        self.frames = np.zeros((count, longest), np.int64)
        share = np.zeros((count, longest), np.float32)
        for row, window in enumerate(windows):
            self.frames[row, : len(window.frames)], share[row, : len(window.frames)] = window.frames, window.share
        share /= np.maximum(total[self.frames], np.float32(1e-8))
        seen = np.flatnonzero(self.real)
        self._laid = csr_matrix(
            (share.reshape(-1)[seen], (self.frames.reshape(-1)[seen], seen)), (len(total), share.size)
        )
        rows = np.array([window.row for window in windows])
        both = np.tile(rows, self.twice)
        mesh = None if mesh_features is None else mesh_features.astype(np.float32)[both]
        keep_text = np.arange(len(both)) < count
        self.condition = model.condition(
            text.tokens[both], text.mask[both], text.pooled[both], mesh, keep_text,
            np.full_like(keep_text, mesh is not None), None if examples is None else examples.rows(both),
        )  # fmt: skip

    def laid(self, values: np.ndarray) -> np.ndarray:
        """The windows' values (G, L, C) on the time line, each by its share of all that see a frame, shape (F, C)."""
        return np.asarray(self._laid @ values.reshape(-1, values.shape[-1]))

    def predict(self, model: Denoiser, x: np.ndarray, step: int, final: bool) -> tuple[np.ndarray, np.ndarray | None]:
        """x0 (G, L, D) of each window, from x_t on the time line (F, D); at the final step also the adaptation."""
        seen, patch = x[self.frames], model.config.frames_per_token
        x0, adaptation = self._run(model, seen, step, self.lengths, final)
        if final and patch > 1 and adaptation is not None:
            # Frames of one token agree better than neighbours across two: a second grid, moved by half a token, heals
            # the seams.
            ahead = patch // 2
            moved = np.concatenate([seen[:, :ahead][:, ::-1], seen], axis=1)
            other, other_adaptation = self._run(model, moved, step, self.lengths + ahead, final)
            assert other_adaptation is not None
            share = token_share(seen.shape[1], patch)[:, None]
            x0 = between(other[:, ahead:], x0, share)
            adaptation = between(other_adaptation[:, ahead:], adaptation, share[..., None])
        return x0, adaptation

    def _run(
        self, model: Denoiser, x: np.ndarray, step: int, lengths: np.ndarray, final: bool
    ) -> tuple[np.ndarray, np.ndarray | None]:
        count, twice = len(x), self.twice if step >= GUIDED_FROM else 1
        seen, lengths = np.tile(x, (twice, 1, 1)), np.tile(lengths, twice)

        def run(rows: slice) -> tuple[np.ndarray, np.ndarray | None]:
            return model(seen[rows], step, lengths[rows], self.condition.rows(rows), final)

        if len(seen) == 1:
            motion, adaptation = run(slice(1))
        else:  # in halves on every processor, whether or not they run at once, so that all give the same
            half = (len(seen) + 1) // 2
            first, second = parallel(lambda: run(slice(half)), lambda: run(slice(half, len(seen))))
            motion = np.concatenate([first[0], second[0]])
            both = first[1] is not None and second[1] is not None
            adaptation = np.concatenate([first[1], second[1]]) if both else None  # type: ignore[list-item]
        if twice == 2:
            real = np.arange(x.shape[1]) < lengths[:count, None]
            motion = guided(motion[:count], motion[count:], self.guidance, self.rescale, real)
        return motion, None if adaptation is None else adaptation[:count]


OVERLAP = 28  # frames that two windows share
SHORTEST = 40  # frames; training saw hardly anything shorter


@dataclass(frozen=True)
class Plan:
    """How one motion is made."""

    frames: int  # frames on the time line; more than wanted where the motion is very short, and the rest is cut off
    windows: tuple[Window, ...]  # frames counted from the motion's first and rows from its first sentence
    # frames where one window hands over to the next, falling between this one and the one before
    seams: tuple[int, ...]


def plan_windows(lengths: Sequence[int], longest: int, *, loop: bool = False, overlap: int = OVERLAP) -> Plan:
    """Plan one motion.

    Args:
        lengths: Frames of each sentence, in a row.
        longest: Frames that the denoiser sees at most.
        loop: Whether the first frame follows the last.
        overlap: Frames that neighbouring windows share, where both are as long.
    """
    overlap = min(overlap, longest // 3)
    shortest = min(SHORTEST, longest)
    lengths = list(lengths)
    if not loop:
        lengths[-1] += max(shortest - sum(lengths), 0)
    total = sum(lengths)
    pieces: list[tuple[int, int, int]] = []  # first frame, frame after the last, sentence
    start = 0
    for row, length in enumerate(lengths):
        ends = 2 if loop else (row > 0) + (row < len(lengths) - 1)  # where it meets another sentence
        fits = length + ends * (overlap // 2) <= longest
        count = 1 if fits else -(-length // (longest - overlap))
        if loop and len(lengths) == 1:
            count = max(count, 2)  # the seam of one window is in the middle of the other
        bounds = [start + round(length * part / count) for part in range(count + 1)]
        pieces += [(first, after, row) for first, after in zip(bounds, bounds[1:], strict=False)]
        start += length
    count = len(pieces)
    halves = [(after - first) // 2 for first, after, _ in pieces]
    # half of what piece i shares with the next one
    fades = [min(overlap // 2, halves[i], halves[(i + 1) % count]) for i in range(count)]
    if not loop:
        fades[-1] = 0
    windows = []
    for i, (first, after, row) in enumerate(pieces):
        before, behind = (fades[i - 1] if loop or i else 0), fades[i]
        missing = max(shortest - (after - first + before + behind), 0)
        low, high = first - before - missing // 2, after + behind + missing - missing // 2
        if not loop:
            low, high = max(low - max(high - total, 0), 0), min(high + max(-low, 0), total)
        frames = np.arange(low, high)
        share = _rise(frames - (first - before), 2 * before) * (1 - _rise(frames - (after - behind), 2 * behind))
        windows.append(Window(frames % total, share, row))
    seams = tuple(first for first, _, _ in pieces[0 if loop else 1 :])
    return Plan(total, tuple(windows), seams)


def _rise(frames: np.ndarray, length: int) -> np.ndarray:
    """0 before frame 0, 1 from frame `length` on, and a smooth rise between."""
    share = np.clip((frames + 0.5) / max(length, 1), 0, 1) if length else (frames >= 0).astype(float)
    return np.asarray(share * share * (3 - 2 * share), np.float32)


def sample_plans(
    model: Denoiser, text: TextBatch, plans: Sequence[Plan], solver: Solver, steering: Steering | None = None, *,
    seeds: int | Sequence[int] | Sequence[tuple[int, int]] = 0, mesh_features: np.ndarray | None = None,
) -> list[Sample]:  # fmt: skip
    """Make several motions in one batch: one sample for each plan, values (N, D) and adaptation (N, K, 3).

    Args:
        model: The denoiser.
        text: The sentences of the first plan, then those of the second, and so on.
        plans: One for each motion.
        solver: How they are denoised.
        steering: What acts on the predictions; their time lines stand one after the other in it.
        seeds: Of the starting noise; one number gives each motion noise of its own, the first as when it is alone. See
            `drawn_noise`.
        mesh_features: f_phi for each sentence, shape (B, 448).
    """
    windows: list[Window] = []
    frame = row = 0
    for plan in plans:
        windows += [Window(window.frames + frame, window.share, window.row + row) for window in plan.windows]
        frame, row = frame + plan.frames, row + 1 + max(window.row for window in plan.windows)
    lengths, size = [plan.frames for plan in plans], model.config.features
    drawn = drawn_noise(seeds, len(plans))
    noise = [row_noise(length, size, *pair) for length, pair in zip(lengths, drawn, strict=True)]
    sample = sample_windows(
        model, text, windows, np.concatenate(noise), solver, steering or Steering(), mesh_features=mesh_features
    )
    ends = np.cumsum(lengths)[:-1]
    parts = np.split(sample.values, ends), np.split(sample.adaptation, ends)
    return [Sample(*part) for part in zip(*parts, strict=True)]


def drawn_noise(seeds: int | Sequence[int] | Sequence[tuple[int, int]], count: int) -> list[tuple[int, int]]:
    """Seed and row (see `row_noise`) of each of `count` motions, from one seed, a seed for each, or the very pairs."""
    if isinstance(seeds, int):
        return [(seeds, index) for index in range(count)]
    return [(seed, 0) if isinstance(seed, int) else seed for seed in seeds]
