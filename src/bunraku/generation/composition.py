"""Actions at the same time: two motions denoised together, and limbs laid over a motion; and small repairs of a sampled
motion.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bunraku.core.body.layout import CHEST, PARTS, kept_handles
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.curves import correlated, gaussian
from bunraku.core.geometry.rotations import matrix_from_6d, matrix_to_6d
from bunraku.generation.features import HANDLE_SIZE, ROOT_SIZE, feature_mask
from bunraku.generation.verifier import asks_to_turn
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


def steadied(features: np.ndarray, loop: bool = False) -> np.ndarray:
    """A motion with less of what is faster than people move, shape (N, D), float32; its travel over the ground stays.
    In a `loop` the last frame is followed by the first.
    """
    pose = features[:, 3:]
    smooth = correlated(pose, _SAVITZKY_GOLAY, edge="wrap" if loop else "nearest")
    return np.concatenate([features[:, :3], pose + STRENGTH * (smooth - pose)], axis=1).astype(np.float32)


def turned_as_asked(features: np.ndarray, script: Sequence[tuple[Clause, int]], fps: float) -> np.ndarray:
    """A motion whose turns go as far as its clauses say, where they nearly do: faster or slower by at most `MOST`,
    shape (N, D), float32.

    Args:
        features: Features of each frame, the root's yaw velocity [rad/s] first, shape (N, D).
        script: Its clauses with the frames that each lasts.
        fps: Frames a second [1/s].
    """
    out = features.copy()
    for clause, part in clause_spans(script):
        requested, angle = clause.turn, float(out[part, 0].sum()) / fps
        if requested is None or not angle or requested.side * angle < 0:
            continue
        wanted = float(
            np.clip(abs(angle), requested.least + INSIDE, max(requested.most - INSIDE, requested.least + INSIDE))
        )
        factor = wanted / abs(angle)
        if 1 / MOST <= factor <= MOST:
            out[part, 0] *= factor
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
        """The second time line of a motion; None without simultaneous actions. Without `limbs`, described limbs are
        left out.
        """
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
