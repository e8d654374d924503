"""Motions put together: two denoised together, limbs laid over a motion, and motions spliced, looped and held; and
small repairs of a sampled motion.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bunraku.core.body.layout import CHEST, PARTS, kept_handles
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.curves import correlated, gaussian, smooth_step
from bunraku.core.geometry.rotations import matrix_from_6d, matrix_to_6d
from bunraku.generation.features import HANDLE_SIZE, ROOT_SIZE, FeatureStatistics, decode, feature_mask
from bunraku.generation.verifier import BEGUN, Track, activity, asks_to_turn
from bunraku.language.posing import Posing
from bunraku.language.sentence import Clause

_SAVITZKY_GOLAY = np.array([-3, 12, 17, 12, -3]) / 35
"""Least-squares parabolas through five frames (Savitzky & Golay 1964): nothing changes below 3 Hz, half goes at 6."""
# Chosen by eye on sheets of generated motion.
STRENGTH = 0.6
MOST = 1.6  # largest factor by which a turn is made faster or slower
INSIDE = np.radians(10)  # how far within the requested bounds it then ends
TURN = np.radians(20)
"""Turn that is left to a motion that is not told to turn. On 144 takes none then turned by more than 60 degrees."""
SWAY = 1.0  # standard deviation of the mean that counts as the course [s]; a stride sways within
WAIT = 0.3  # s for which a motion may rest before it begins and after its end (`verifier.activity`); chosen by eye
SHORTEST_LOOP = 12  # shorter loops are a part of a movement, half a punch [frames]
SLOWED = 1.25  # largest factor by which what is done is slowed down to fill its time; chosen by eye


def steadied(features: np.ndarray, loop: bool = False) -> np.ndarray:
    """A motion with less of what is faster than people move, shape (N, D), float32; its travel over the ground stays.
    In a `loop` the last frame is followed by the first.
    """
    pose = features[:, 3:]
    smooth = correlated(pose, _SAVITZKY_GOLAY, edge="wrap" if loop else "nearest")
    return np.concatenate([features[:, :3], pose + STRENGTH * (smooth - pose)], axis=1).astype(np.float32)


def turned_as_asked(features: np.ndarray, script: Sequence[tuple[Clause, int]], fps: float) -> np.ndarray:
    """A motion whose turns go as far as its clauses say, where they nearly do: faster or slower by at most `MOST`,
    shape (N, D), float32. The course of a person who goes another way is bent.

    Args:
        features: Features of each frame, the root's yaw velocity [rad/s] first, shape (N, D).
        script: Its clauses with the frames that each lasts.
        fps: Frames a second [1/s].
    """
    out = features.copy()
    for clause, part in clause_spans(script):
        requested, angle = clause.turn, float(out[part, 0].sum()) / fps
        if requested is None or not angle:
            continue
        side, least, most = requested.side or np.sign(angle), requested.least, requested.most
        wanted = side * np.clip(abs(angle), least + INSIDE, max(most - INSIDE, least + INSIDE))
        if 1 / MOST <= wanted / angle <= MOST:
            out[part, 0] *= wanted / angle
        elif clause.locomotion:
            along = np.hanning(len(out[part]) + 2)[1:-1]
            middle = (least + min(most, least + 2 * np.pi)) / 2
            out[part, 0] += (side * middle - angle) * fps * along / along.sum()
    return out


def straightened(features: np.ndarray, script: Sequence[tuple[Clause, int]], fps: float) -> np.ndarray:
    """A motion on its course where a clause says "forward", and that hardly turns where a clause speaks of no turn;
    arguments as of `turned_as_asked`.
    """
    out = features.copy()
    for clause, part in clause_spans(script):
        if clause.straight and len(out[part]):
            out[part, 0] -= gaussian(out[part, 0], SWAY * fps)
        elif not asks_to_turn(clause):
            out[part] = unturned(out[part], fps)
    return out


def unturned(features: np.ndarray, fps: float) -> np.ndarray:
    """A motion (N, D) that turns by `TURN` at the most from its first frame to its last. What is too much is taken away
    where it turns, so that nothing turns that did not.
    """
    angle = float(features[:, 0].sum()) / fps
    excess = abs(angle) - TURN
    if excess <= 0:
        return features
    along = np.maximum(gaussian(features[:, 0], SWAY / 2 * fps) * np.sign(angle), 1e-6)
    out = features.copy()
    out[:, 0] -= np.sign(angle) * excess * fps * along / along.sum()
    return out


def lively(features: np.ndarray, fps: float) -> slice:
    """The frames of a motion (N, D) from shortly before it begins until shortly after its end."""
    if len(features) < SHORTEST_LOOP:
        return slice(0, len(features))
    first, last = activity(Track.of(decode(features, fps)))
    return slice(max(first - round(WAIT * fps), 0), min(last + round(WAIT * fps), len(features)))


def at_once(features: np.ndarray, script: Sequence[tuple[Clause, int]], fps: float) -> np.ndarray:
    """A motion that begins as soon as is asked for (`verifier.BEGUN`), where what comes after the wait fills the time
    of the first clause when it is slowed down a little; arguments as of `turned_as_asked`.
    """
    clause, part = next(clause_spans(script))
    frames = len(features[part])
    late = lively(features[part], fps).start if clause.actions != ("idle",) else 0
    if late <= (BEGUN - WAIT) * fps or late > frames * (1 - 1 / SLOWED):
        return features
    return np.concatenate([warped(features[part][late:], frames), features[part.stop :]])


def warped(features: np.ndarray, frames: int) -> np.ndarray:
    """The same motion faster or slower, in so many frames, shape (frames, D)."""
    at = np.linspace(0, len(features) - 1, frames)
    low = np.minimum(at.astype(int), len(features) - 2)
    share = (at - low)[:, None].astype(np.float32)
    out = features[low] * (1 - share) + features[low + 1] * share
    out[:, :3] *= (len(features) - 1) / max(frames - 1, 1)
    return np.asarray(out, np.float32)


def clause_spans(script: Iterable[tuple[Clause, int]]) -> Iterator[tuple[Clause, slice]]:
    """The clauses of a script that have frames each, with those frames as slices."""
    start = 0
    for clause, frames in script:
        yield clause, slice(start, start + frames)
        start += frames


@dataclass(frozen=True)
class PartTrack:
    """A second time line for a motion with an action at the same time: it is conditioned on the gestures, and moves as
    the first one otherwise.

    The first does not see the second: a walk with waving arms would soon stand still, as people do while they wave.
    """

    motion: int  # number of the motion of the batch that it belongs to
    sentences: tuple[str, ...]  # its conditions, a sentence for each of the motion's
    handles: np.ndarray  # the handles that are its own, shape (K,), bool

    @classmethod
    def of(cls, motion: int, script: Sequence[Clause], limbs: bool = True) -> PartTrack | None:
        """A motion's second time line; None without simultaneous actions. Described limbs count with `limbs`."""
        voices = [clause.meanwhile for clause in script]
        voices = [
            voice if voice is not None and (limbs or not isinstance(voice.detail, Posing)) else None for voice in voices
        ]
        kept = [kept_handles(voice.part.split(" and ")) for voice in voices if voice is not None]
        texts = tuple((voice or clause.body).text for voice, clause in zip(voices, script, strict=True))
        return cls(motion, texts, np.any(kept, axis=0)) if kept else None

    def follow(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """The second time line's features, shape (N, 271), with all that is not its own as in the first."""
        return np.where(feature_mask(self.handles), second, first)

    def adapt(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """The same of the adaptation, shape (N, K, 3)."""
        return np.where(self.handles[:, None], second, first)


_HEAD = PARTS["head"]


class _Affine(NamedTuple):
    """Affine maps of points at rest: v -> turn v + shift, shapes (..., 3, 3) and (..., 3)."""

    turn: np.ndarray
    shift: np.ndarray

    def at(self, handle: int) -> _Affine:
        return _Affine(self.turn[:, handle], self.shift[:, handle])

    def after(self, other: _Affine) -> _Affine:
        """First the other, then this."""
        return _Affine(self.turn @ other.turn, (self.turn @ other.shift[..., None])[..., 0] + self.shift)

    def inverse(self) -> _Affine:
        back = np.swapaxes(self.turn, -1, -2)
        return _Affine(back, -(back @ self.shift[..., None])[..., 0])


def with_limbs(features: np.ndarray, gesture: np.ndarray, script: Sequence[tuple[Clause, int]]) -> np.ndarray:
    """A motion (N, D) with the limbs of a gesture wherever its clauses say so."""
    out = features.copy()
    for clause, span in clause_spans(script):
        if clause.limbs_meanwhile is not None:
            out[span] = overlaid(out[span], gesture[span], clause.limbs_meanwhile.parts)
    return out


def overlaid(features: np.ndarray, gesture: np.ndarray, parts: Collection[str]) -> np.ndarray:
    """A motion with named parts of the body ("head", "left arm", "lower body" ...) as in a gesture, both (N, D)."""
    base, added = _transforms(features), _transforms(gesture)
    turn, shift = base.turn.copy(), base.shift.copy()

    def put(handle: int, value: _Affine) -> None:
        turn[:, handle], shift[:, handle] = value

    chest = base.at(CHEST)
    if "upper body" in parts:
        for handle in PARTS["torso"]:
            put(handle, added.at(handle).after(base.at(handle)))
        chest = added.at(CHEST).after(chest)
    from_own, from_made = base.at(CHEST).inverse(), added.at(CHEST).inverse()
    replaced = {handle for part in parts if part.endswith(("arm", "arms")) for handle in PARTS[part]}
    for handle in PARTS["upper body"]:
        if handle in PARTS["torso"]:
            continue
        local = from_own.after(base.at(handle))
        if handle in replaced:
            local = from_made.after(added.at(handle))
        elif handle in _HEAD and ("head" in parts or "upper body" in parts):
            local = from_made.after(added.at(handle)).after(local)
        put(handle, chest.after(local))
    out = _features(features, _Affine(turn, shift))
    if "lower body" in parts:
        out[:, :ROOT_SIZE] = gesture[:, :ROOT_SIZE]
        for handle in PARTS["legs"][1:]:
            own_numbers = slice(ROOT_SIZE + HANDLE_SIZE * (handle - 1), ROOT_SIZE + HANDLE_SIZE * handle)
            out[:, own_numbers] = gesture[:, own_numbers]
    return out


def _transforms(features: np.ndarray) -> _Affine:
    """What the handles do beside the root, which is 0 of them."""
    local = features[:, ROOT_SIZE:].reshape(len(features), -1, HANDLE_SIZE).astype(float)
    rest = reference_body().handles.positions.astype(float)
    turn = np.concatenate([np.tile(np.eye(3), (len(features), 1, 1, 1)), matrix_from_6d(local[..., 3:])], axis=1)
    moved = np.concatenate([np.zeros((len(features), 1, 3)), local[..., :3]], axis=1)
    return _Affine(turn, rest + moved - (turn @ rest[..., None])[..., 0])


def _features(features: np.ndarray, handles: _Affine) -> np.ndarray:
    """Features whose handles do this."""
    rest = reference_body().handles.positions.astype(float)
    moved = handles.shift - rest + (handles.turn @ rest[..., None])[..., 0]
    local = np.concatenate([moved[:, 1:], matrix_to_6d(handles.turn[:, 1:])], axis=2)
    return np.concatenate([features[:, :ROOT_SIZE], local.reshape(len(features), -1)], axis=1).astype(np.float32)


END = 4  # frames that tell whether a motion rests
_BLEND = 6


def join_point(
    tail: np.ndarray, head: np.ndarray, weights: np.ndarray, blend: int = _BLEND,
    most: tuple[int | None, int | None] = (None, None),
) -> tuple[int, int, float]:  # fmt: skip
    """Frame i of a tail to leave, frame j of a head to enter, such that pose and velocity agree best, and the mean
    squared difference there.

    Args:
        tail: Motion to leave in its last quarter, shape (N, D), network units.
        head: Motion to enter in its first quarter, shape (M, D).
        weights: Share of each feature, shape (D,).
        blend: Frames that both must still have after that.
        most: Most frames, beside the blend, that are lost of the tail's end and of the head's beginning; None for a
            quarter.
    """
    last = max(len(tail) - blend + 1, 1)
    first = min(3 * len(tail) // 4, last - 1) if most[0] is None else max(last - 1 - most[0], 0)
    stop = max(1, min(len(head) // 4 if most[1] is None else most[1] + 1, len(head) - blend))
    scale = np.sqrt(weights / weights.sum())
    a, b = tail[first:last] * scale, head[:stop] * scale
    distance = (a**2).sum(1)[:, None] + (b**2).sum(1) - 2 * a @ b.T
    i, j = np.unravel_index(int(distance.argmin()), distance.shape)
    return first + int(i), int(j), float(max(distance[i, j], 0))


def splice(tail: np.ndarray, head: np.ndarray, i: int, j: int, blend: int = _BLEND) -> np.ndarray:
    """`tail` up to frame i, then `head` from frame j, cross-faded over the next `blend` frames of both."""
    blend = min(blend, len(tail) - i, len(head) - j)
    share = smooth_step(np.linspace(0, 1, blend + 2, dtype=np.float32)[1:-1, None])
    mixed = tail[i : i + blend] * (1 - share) + head[j : j + blend] * share
    return np.concatenate([tail[:i], mixed, head[j + blend :]])


def played(values: np.ndarray, loop: tuple[int, int], target: int) -> np.ndarray:
    """A motion repeated from frame j after frame i until it has at least `target` frames."""
    i, j = loop
    longer = values
    while len(longer) < target:
        longer = splice(longer, values, len(longer) - len(values) + i, j)
    return longer


def held(values: np.ndarray, frames: int, still: np.ndarray, ease: float = 0.0) -> np.ndarray:
    """A motion (N, D) with its last pose held for this many more frames, its root coming to the velocities of a resting
    one (3,). `ease` is the share of the pose's change that is left from frame to frame; 0 stops it at once.
    """
    hold = np.repeat(values[-1:], frames, axis=0)
    count = np.arange(1, len(hold) + 1, dtype=np.float32)[:, None]
    hold[:, :3] = still + (hold[:, :3] - still) * 0.5**count
    if ease > 0 and len(values) > 1:
        hold[:, 3:] += (values[-1:, 3:] - values[-2:-1, 3:]) * (ease * (1 - ease**count) / (1 - ease))
    return np.concatenate([values, hold])


def rests(values: np.ndarray, statistics: FeatureStatistics) -> bool:
    """Whether a body that moves like this could stay so, by frames at an end of a motion in network units, (N, D)."""
    speed = np.abs(statistics.restore(values)[:, :3]).max()
    return bool(speed < 0.5 and (np.diff(values, axis=0)[:, 4:] ** 2).mean() < 0.02)


LIFTED = 0.15  # height of an ankle over the other [m] with which a foot is up; chosen by eye


def on_one_leg(features: np.ndarray) -> bool:
    """Whether a foot is up in a frame of a motion, as at the height of a kick, by its features (N, 271)."""
    points = Track.of(decode(features)).points
    return bool(np.abs(points["left_ankle"][:, 1] - points["right_ankle"][:, 1]).max() > LIFTED)
