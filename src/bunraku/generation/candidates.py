"""Candidates of one motion: sampled in one batch, guided by a network that knows which motion belongs to which
sentence, and the best of them chosen, by a network that was trained apart from the judge of the tables and by rule.

Each sentence of a script is compared with its own part of the motion; a motion's score is the mean of their cosines.
What a sentence plainly says and does not say (`verifier`) weighs more: a punch with the wrong hand is no choice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from bunraku.core.geometry.curves import gaussian
from bunraku.core.request import CANDIDATES, check_all
from bunraku.core.request import GUIDANCE as GUIDANCE_LIMIT
from bunraku.core.request import STEPS as STEP_LIMIT
from bunraku.core.travel import GroundPath
from bunraku.errors import OptionError
from bunraku.generation.composition import at_once, clause_spans, steadied, straightened, turned_as_asked
from bunraku.generation.denoiser import Denoiser
from bunraku.generation.extractor import LONGEST, RADIUS, SHORTEST, Extractor, embed_motions
from bunraku.generation.features import FEATURE_SIZE, FeatureStatistics, decode, root_velocities
from bunraku.generation.networks import Networks
from bunraku.generation.sampler import ROOT
from bunraku.generation.verifier import Verdict, verify
from bunraku.language.sentence import Clause

if TYPE_CHECKING:
    from bunraku.generation.denoiser import Denoiser
    from bunraku.generation.guide import GuidanceExample
    from bunraku.generation.networks import Texts
    from bunraku.generation.sampler import Solver

# Chosen by eye on sheets of generated motion.
WEIGHT = 0.5
"""Of the agreement beside a cosine; candidates' cosines differ by a tenth. Chosen by eye, as are the next two."""
CAPTURED = 0.1  # for a candidate that starts from a captured example: the ranker hardly sees that a motion is too small
ENOUGH = 0.75  # agreement below which a motion is drawn again
ATTEMPTS = 4  # most draws of candidates


@dataclass(frozen=True)
class Candidate:
    """One candidate."""

    motion: np.ndarray  # features of each frame, shape (N, 271)
    adaptation: np.ndarray  # offsets of local translations [m], shape (N, K, 3)
    script: Sequence[tuple[Clause, int]]  # its clauses with the frames that each lasts
    verdict: Verdict | None = None  # the claim of theirs that holds least; None where they make no claim
    captured: bool = False  # it starts from a captured example
    origin: tuple[int, int] = (0, 0)  # its motion, and its number among that one's candidates
    complete: bool = True  # the network has said its adaptation; it need not for what examples lead to the end


def script_scores(
    ranker: Extractor, text: Mapping[str, np.ndarray], motions: Sequence[np.ndarray],
    scripts: Sequence[Sequence[tuple[Clause, int]]],
) -> np.ndarray:  # fmt: skip
    """How well each motion (N, 271) does what its script says, (M,): the ranker's mean cosine over its sentences."""
    pieces: list[np.ndarray] = []
    owners: list[tuple[int, str, int]] = []
    for index, (features, script) in enumerate(zip(motions, scripts, strict=True)):
        for clause, span in clause_spans(script):
            part = features[span]
            for cut in np.array_split(part, -(-len(part) // LONGEST)) if len(part) >= SHORTEST else ():
                pieces.append(cut)
                owners.append((index, clause.text, len(cut)))
    if not pieces:
        return np.zeros(len(motions))
    vectors = embed_motions(ranker, pieces)
    total, weight = np.zeros(len(motions)), np.zeros(len(motions))
    for vector, (index, sentence, frames) in zip(vectors, owners, strict=True):
        total[index] += frames * float(vector @ text[sentence]) / RADIUS**2
        weight[index] += frames
    return total / np.maximum(weight, 1)


def script_verdict(motion: np.ndarray, script: Sequence[tuple[Clause, int]], led: bool = False) -> Verdict | None:
    """The claim of a script that holds least of a motion (N, 271); None where it makes none. `led` motions start from
    examples, so that limbs go where the sentence says.
    """
    parts = [(clause, motion[span]) for clause, span in clause_spans(script)]
    verdicts = [verify(clause, decode(part), not led) for clause, part in parts if len(part) >= SHORTEST]
    return min((one for one in verdicts if one is not None), key=lambda one: one.agreement, default=None)


def choose(
    draw: Callable[[list[int], list[int]], list[Candidate]], motions: int, candidates: int,
    score: Callable[[Sequence[Candidate]], np.ndarray],
) -> list[Candidate]:  # fmt: skip
    """The best candidate of each motion, the same whatever motions stand beside it; where not even that does what is
    plainly said, more are drawn.

    Args:
        draw: Draws candidates of motions, by the motion and the index of each, but for those that were drawn before.
        motions: How many there are.
        candidates: Of each, at a time.
        score: The ranker's scores, shape (M,).
    """
    best: dict[int, tuple[float, Candidate]] = {}
    wanted = list(range(motions))
    for attempt in range(ATTEMPTS):
        rows = [motion for motion in wanted for _ in range(candidates)]
        indices = [attempt * candidates + index for _ in wanted for index in range(candidates)]
        drawn = draw(rows, indices)
        for candidate, cosine in zip(drawn, score(drawn).tolist() if drawn else (), strict=True):
            motion = candidate.origin[0]
            total = cosine + WEIGHT * min(_agreement(candidate), ENOUGH) + CAPTURED * candidate.captured
            if motion not in best or total > best[motion][0]:
                best[motion] = (total, candidate)
        wanted = [motion for motion in wanted if _agreement(best[motion][1]) < ENOUGH]
        if not wanted or not drawn:
            break
    return [best[motion][1] for motion in range(motions)]


def _agreement(candidate: Candidate) -> float:
    return 1.0 if candidate.verdict is None else candidate.verdict.agreement


STILL = 0.3  # m/s; a loop whose root goes no faster than this, all in all, is meant to stay where it is


def arrive(root: np.ndarray, fps: float, turn: float | None, travel: tuple[float, float] | None) -> np.ndarray:
    """Root velocities changed as little and as evenly as possible so that they lead to a goal, shape (N, 3).

    Args:
        root: Yaw velocity [rad/s] and planar velocity in the heading of each frame [m/s], shape (N, 3), as in
            `features`.
        fps: Frames a second [1/s].
        turn: Rotation over all frames [rad]; None for the nearest whole number of rotations.
        travel: Way (x, z) over all frames [m], seen from the heading before the first; None keeps the way unless it is
            so short that it is meant to be none.
    """
    count = len(root)
    weight = np.ones(count)
    if travel is not None:  # little at both ends, so that the velocities stay smooth where these frames meet others
        weight = np.sin(math.pi * (np.arange(count) + 1) / (count + 1))
    weight = (weight / weight.sum()).astype(root.dtype)
    yaw = root[:, 0]
    total = float(yaw.sum()) / fps
    target = round(total / (2 * math.pi)) * 2 * math.pi if turn is None else turn
    yaw = yaw + (target - total) * fps * weight
    angle = yaw.cumsum() / fps
    cos, sin = np.cos(angle), np.sin(angle)
    x, z = root[:, 1] * cos + root[:, 2] * sin, root[:, 2] * cos - root[:, 1] * sin
    displacement = (float(x.sum()) / fps, float(z.sum()) / fps)
    if travel is None:
        travel = displacement if math.hypot(*displacement) > STILL * count / fps else (0.0, 0.0)
    x, z = x + (travel[0] - displacement[0]) * fps * weight, z + (travel[1] - displacement[1]) * fps * weight
    return np.stack([yaw, x * cos - z * sin, z * cos + x * sin], -1).astype(root.dtype)


STEPS = 8
GUIDANCE = 3.5  # measured: docs/history.md has 2.5 and 3.5
MADE_UNTIL = 0
"""Step of the sampler down to which a gesture made by code stands for the network's prediction. The network has seen no
gestures: from 100 on it already stills the hands of a person who claps.
"""


class SamplingFields(TypedDict, total=False):
    """`SamplingSettings` as arguments."""

    steps: int | None
    guidance: float | None
    mesh_feature: object | None
    progress: Callable[[str, float], None] | None
    checkpoint: str | Path | None
    candidates: int
    examples: bool
    all_led: bool
    classifier_guidance: bool
    note: Callable[[str], None] | None
    held: Networks | None


@dataclass(frozen=True)
class SamplingSettings:
    """How a motion is sampled.

    Args:
        steps: Sampling steps, 1 to 1,000; None takes the few that the denoiser was distilled into, or 8.
        guidance: Classifier-free guidance scale, 0 to 20; None takes 3.5, which few steps hold in their weights.
        mesh_feature: f_phi of the character, shape (448,); None, or weights that were trained without characters,
            generate for no mesh in particular.
        progress: Called with a stage's name and the share done.
        checkpoint: Weights of the denoiser in place of the shipped ones.
        candidates: Motions that are drawn for each that is given back, 1 to 16; the ranker chooses (`choose`). The
            first has the noise that it has alone. Where none does what the sentence says and nothing else
            (`verifier`), as many are drawn again, at most three times.
        examples: All candidates but the first start from captured examples of people where any fit (`guide`).
        all_led: The first does so too.
        classifier_guidance: Predictions are guided towards their sentences, as people do them (`ClassifierGuidance`).
        note: Called with notes on a motion, one line each.
        held: The networks; None loads those of `checkpoint` when they are needed.

    Raises:
        OptionError: A setting is outside its range.
    """

    steps: int | None = None
    guidance: float | None = None
    mesh_feature: object | None = None
    progress: Callable[[str, float], None] | None = None
    checkpoint: str | Path | None = None
    candidates: int = 1
    examples: bool = True
    all_led: bool = False
    classifier_guidance: bool = True
    note: Callable[[str], None] | None = None
    held: Networks | None = None

    def __post_init__(self) -> None:
        check_all(((CANDIDATES, self.candidates), (STEP_LIMIT, self.steps), (GUIDANCE_LIMIT, self.guidance)))

    @property
    def networks(self) -> Networks:
        """The networks that sample."""
        return self.held or Networks(self.checkpoint)

    @property
    def denoiser(self) -> Denoiser:
        """The denoiser of few steps without another number of steps or guidance; else the denoiser."""
        few = self.networks.few_steps if self.steps is None and self.guidance is None else None
        return few or self.networks.denoiser

    def of_body(self, model: Denoiser) -> bool:
        """Whether the motion is a body's own: see `HandleMotion`."""
        return self.mesh_feature is not None and bool(model.notes.get("creatures"))

    @property
    def solver(self) -> Solver:
        """How motions are denoised."""
        from bunraku.generation.sampler import Solver

        progress = self.progress
        return Solver(
            STEPS if self.steps is None else self.steps,
            GUIDANCE if self.guidance is None else self.guidance,
            progress=(lambda done, total: progress("generate", done / total)) if progress else None,
        )

    def mesh_features(self, model: Denoiser, rows: int) -> np.ndarray | None:
        """The character's f_phi for this many sentences, shape (rows, 448)."""
        if self.mesh_feature is None or not model.knows_meshes:
            return None
        mesh = np.asarray(self.mesh_feature, np.float32)
        if mesh.shape != (model.config.mesh_features,) or not bool(np.isfinite(mesh).all()):
            raise OptionError(f"the mesh feature must be {model.config.mesh_features} finite numbers")
        return np.broadcast_to(mesh, (rows, len(mesh)))


@dataclass(frozen=True)
class Beginning:
    """What a candidate is drawn from."""

    script: Sequence[Clause]  # its clauses
    noise: tuple[int, int]  # seed and row (see `drawn_noise`)
    body: GuidanceExample | None  # the example that it starts from; None for none
    limbs: GuidanceExample | None  # that of the gestures that are made at the same time; None for none


def draw_candidates(
    texts: Texts, beginnings: Sequence[Beginning], how: SamplingSettings, loop: bool, path: GroundPath | None,
    critic: Critic | None = None, complete: bool = True,
) -> list[Candidate]:  # fmt: skip
    """One candidate from each beginning, all in one batch.

    Args:
        texts: The scripts as the denoiser reads them.
        beginnings: One of each candidate.
        how: The settings.
        loop: Make loops.
        path: Path of the root, in metres of the reference body; None for its own way.
        critic: Guides them towards their sentences; None for no guidance.
        complete: Ask for the adaptation of what examples lead to the end, too: nothing else of it is the network's.
    """
    from bunraku.core.nn.layers import one_thread
    from bunraku.generation.composition import PartTrack, with_limbs
    from bunraku.generation.sampler import Steering, plan_windows, sample_plans

    model = how.denoiser
    scripts = [beginning.script for beginning in beginnings]
    lengths = [frames_of([clause.seconds for clause in script], model.config.fps) for script in scripts]
    plans = [plan_windows(parts, model.config.frames, loop=loop) for parts in lengths]
    tracks = [  # limbs with an example are laid over the motion
        track
        for row, beginning in enumerate(beginnings)
        if (track := PartTrack.of(row, beginning.script, beginning.limbs is None))
    ]
    sentences = [clause.body.text for script in scripts for clause in script]
    text = texts.batch(sentences + [sentence for track in tracks for sentence in track.sentences])
    statistics = FeatureStatistics(model.mean, model.std)
    plans += [plans[track.motion] for track in tracks]
    sizes = [plan.frames for plan in plans]

    owners = [*range(len(scripts)), *(track.motion for track in tracks)]
    noise = [beginnings[row].noise for row in owners]
    ways: list[np.ndarray] = []
    if path is not None:
        ways = [way_of(path, sum(own), model.config.fps, script) for own, script in zip(lengths, scripts, strict=True)]
    held = _held([ways[row] for row in owners], sizes, statistics, model.config.fps) if ways else None

    starts = [beginning.body for beginning in beginnings] + [beginnings[track.motion].limbs for track in tracks]
    guide = _guided(starts, [lengths[row] for row in owners], sizes, statistics, loop, complete or bool(tracks))
    asked = [part.max() >= 0 for part in _split(guide[2], sizes)] if guide else [True] * len(sizes)
    classifier_guidance = None
    if critic is not None:
        clauses = [[clause.body.text for clause in script] for script in scripts]
        classifier_guidance = critic.guidance(model, clauses, lengths, sizes[: len(scripts)], guide, how.solver.steps)

    def refine(values: np.ndarray) -> np.ndarray:
        parts = _split(values, sizes)
        for own, track in enumerate(tracks, len(scripts)):
            parts[own] = track.follow(parts[track.motion], parts[own])
        return np.concatenate([closed(part, model) for part in parts] if loop else parts)

    steering = Steering(classifier_guidance, guide, refine if loop or tracks else None, held)
    mesh = how.mesh_features(model, len(text.mask))
    with one_thread():
        samples = sample_plans(model, text, plans, how.solver, steering, seeds=noise, mesh_features=mesh)
    for track, own in zip(tracks, samples[len(scripts) :], strict=True):
        samples[track.motion] = replace(own, adaptation=track.adapt(samples[track.motion].adaptation, own.adaptation))
    drawn = []
    for row, (part, script, own_lengths, example) in enumerate(zip(samples, scripts, lengths, starts, strict=False)):
        frames = np.arange(sum(own_lengths) + loop) % len(part.values)
        timed = list(zip(script, own_lengths, strict=True))
        features = steadied(statistics.restore(part.values), loop)
        if not loop and path is None:
            features = straightened(features, timed, model.config.fps)
            features = turned_as_asked(features, timed, model.config.fps)
            features = at_once(features, timed, model.config.fps)
        limbs = beginnings[row].limbs
        if limbs is not None and any(clause.limbs_meanwhile for clause in script):
            gesture = statistics.restore(limbs.on(own_lengths, sizes[row], statistics, closed=loop).values)
            features = with_limbs(features, gesture, timed)
        features = features[frames]
        said = script_verdict(features, timed, example is not None) if how.candidates > 1 and path is None else None
        adaptation = part.adaptation[frames]
        drawn.append(Candidate(features, adaptation, timed, said, example is not None, complete=asked[row]))
    return drawn


def way_of(path: GroundPath, frames: int, fps: float, script: Sequence[Clause]) -> np.ndarray:
    """Position (x, z) [m] and heading [rad] of a root that follows a path in each frame, shape (N, 3)."""
    back = "backward" in script[0].traits
    return np.column_stack([path.positions(frames, fps), path.headings(frames, fps, back)])


def _held(
    ways: Sequence[np.ndarray], sizes: Sequence[int], statistics: FeatureStatistics, fps: float
) -> tuple[np.ndarray, np.ndarray]:
    """The velocities of roots that follow paths, in network units, and which features these are: both (F, D)."""
    values, share = (np.zeros((sum(sizes), FEATURE_SIZE), np.float32) for _ in range(2))
    start = 0
    for way, size in zip(ways, sizes, strict=True):
        values[start : start + len(way), :3] = root_velocities(way, fps)
        share[start : start + len(way), :3] = 1
        start += size
    normalised = np.where(share > 0, statistics.normalise(values), 0).astype(np.float32)
    return normalised, share


def _guided(
    examples: Sequence[GuidanceExample | None], lengths: Sequence[list[int]], sizes: Sequence[int],
    statistics: FeatureStatistics, loop: bool, complete: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:  # fmt: skip
    """Motions that candidates start from, in network units, (F, D), how far, (F, 1), and down to which step of the
    sampler, (F, 1); None without examples. What is led to the end does without the network unless it is to be
    `complete`.
    """
    from bunraku.generation.sampler import LED_UNTIL

    if not any(examples):
        return None
    values, share = np.zeros((sum(sizes), FEATURE_SIZE), np.float32), np.zeros((sum(sizes), 1), np.float32)
    until = np.full((sum(sizes), 1), LED_UNTIL, np.int64)
    ends = np.cumsum(sizes)
    for example, own, stop, size in zip(examples, lengths, ends, sizes, strict=True):
        if example is not None:
            guide = example.on(own, size, statistics, closed=loop)
            values[stop - size : stop], share[stop - size : stop, 0] = guide.values, guide.share
            to_the_end = not complete and bool((guide.made & (guide.share >= 1)).all())
            until[stop - size : stop, 0] = -1 if to_the_end else np.where(guide.made, MADE_UNTIL, LED_UNTIL)
    return values, share, until


def _split(values: np.ndarray, sizes: Sequence[int]) -> list[np.ndarray]:
    """The time lines of motions with so many frames each, which lie one after the other."""
    return np.split(values, np.cumsum(sizes)[:-1])


def frames_of(seconds: Sequence[float], fps: float) -> list[int]:
    """Frames of each part, at least one, so that the parts end at the rounded sums of their seconds."""
    ends = [round(float(end) * fps) for end in np.cumsum(seconds)]
    out = [max(1, after - before) for before, after in zip([0, *ends], ends, strict=False)]
    return out


def closed(values: np.ndarray, model: Denoiser) -> np.ndarray:
    """Values of a loop, (N, D) in network units, that end with its first heading, and position if it hardly travels."""

    mean, std = model.mean[:3], model.std[:3]
    root = arrive(values[:, :3] * std + mean, model.config.fps, None, None)
    return np.concatenate([(root - mean) / std, values[:, 3:]], axis=-1)


STRENGTH = 0.2  # root mean square of a step, in standard deviations of the features
LAST = 100  # step of the sampler below which nothing is guided: what is left there are details
SPREAD = 2.0  # standard deviation of the smoothing [frames]
FEW = 10  # where fewer steps than this predict a motion, each prediction is guided twice
GROUP = 16  # stretches that go through the network at once


@dataclass(frozen=True)
class Spoken:
    """A stretch of the time line with its sentence."""

    frames: tuple[int, int]  # its first frame, and the one after its last
    vector: np.ndarray  # of the sentence, of length 1, shape (E,)
    # step of the sampler down to which it is not guided, because it is given; 1,000 where it never is
    until: int = 1000


class ClassifierGuidance:
    """Guides each predicted x0 towards the sentences of its stretches, `rounds` times by steps with a root mean square
    of `strength`; mean and deviation are those of the features, shape (D,). Each step goes up the gradient of the
    cosine of their vectors (as classifier guidance, Dhariwal and Nichol 2021, but on x0).

    The gradient is smoothed in time, so that it changes the action and not the details, in which such a network can be
    deceived. It has one size whatever its length, since a prediction of the first steps resembles no motion and is far
    from any sentence. The root is not guided: with it walks became slower and nothing better.
    """

    def __init__(
        self, network: Extractor, mean: np.ndarray, std: np.ndarray, stretches: Sequence[Spoken],
        strength: float = STRENGTH, rounds: int = 1,
    ):  # fmt: skip
        self.network, self.mean, self.std, self.strength, self.rounds = network, mean, std, strength, rounds
        self.stretches = sorted(stretches, key=lambda one: one.frames[1] - one.frames[0])

    def __call__(self, x0: np.ndarray, step: int) -> np.ndarray:
        """x0 (F, D) in network units, nearer to the sentences."""
        guided = [stretch for stretch in self.stretches if LAST <= step < stretch.until]
        if not guided:
            return x0
        out = x0.copy()
        for start in range(0, len(guided), GROUP):
            group = guided[start : start + GROUP]
            for _ in range(self.rounds):
                for stretch, way in zip(group, self.gradients(out, group), strict=True):
                    size = max(float(np.sqrt((way * way).mean())), 1e-9)
                    out[slice(*stretch.frames)] += np.float32(self.strength / size) * way
        return out

    def gradients(self, x0: np.ndarray, stretches: Sequence[Spoken]) -> list[np.ndarray]:
        """The smoothed gradient of the cosine of each stretch with its sentence, without the root's, shape (N, D)."""
        parts = [x0[slice(*stretch.frames)] for stretch in stretches]
        lengths = np.array([len(part) for part in parts])
        values = np.zeros((len(parts), int(lengths.max()), x0.shape[1]), np.float32)
        for row, part in zip(values, parts, strict=True):
            row[: len(part)] = part
        goals = np.stack([stretch.vector for stretch in stretches])
        gradient = self.network.cosine_gradient(values * self.std + self.mean, lengths, goals) * self.std
        gradient[..., ROOT] = 0
        if (lengths == lengths[0]).all():  # as the candidates of one sentence are
            return list(gaussian(gradient.swapaxes(0, 1), SPREAD).swapaxes(0, 1))
        return [gaussian(row[:length], SPREAD) for row, length in zip(gradient, lengths, strict=True)]


@dataclass(frozen=True)
class Critic:
    """Guides the motions of a batch."""

    network: Extractor  # trained with motions and sentences of people
    vectors: Mapping[str, np.ndarray]  # of all their sentences, of length 1, shape (E,)
    strength: float = STRENGTH  # root mean square of a step

    def guidance(
        self, model: Denoiser, scripts: Sequence[Sequence[str]], lengths: Sequence[Sequence[int]], sizes: Sequence[int],
        guide: tuple[np.ndarray, np.ndarray, np.ndarray] | None, steps: int = FEW,
    ) -> ClassifierGuidance:  # fmt: skip
        """For motions one after the other on the time line: sentences of each, frames of each sentence, frames of each
        motion, the guide as of `Steering`, and the steps of the sampler.
        """
        stretches: list[Spoken] = []
        begin = 0
        for script, frames, size in zip(scripts, lengths, sizes, strict=True):
            first, end = begin, begin + size
            for sentence, length in zip(script, frames, strict=True):
                pieces = -(-length // LONGEST)
                bounds = [first + round(length * piece / pieces) for piece in range(pieces + 1)]
                for low, high in zip(bounds, bounds[1:], strict=False):
                    if min(high, end) - low >= SHORTEST:  # as the ranker looks at it
                        until = 1000
                        if guide is not None:
                            share, down_to = guide[1][low:high], guide[2][low:high]
                            until = int(np.where(share >= 1, down_to, 1000).max())
                        stretches.append(Spoken((low, min(high, end)), self.vectors[sentence], until))
                first += length
            begin = end
        return ClassifierGuidance(
            self.network, model.mean, model.std, stretches, self.strength, rounds=2 if steps < FEW else 1
        )
