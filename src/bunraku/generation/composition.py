"""What happens at the same time: two motions denoised together, and limbs laid over a motion; and small repairs of a
drawn motion.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bunraku.core.body.layout import HANDLE_NAMES, PARTS, kept_handles
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.curves import correlated, gaussian
from bunraku.core.geometry.rotations import matrix_from_6d, matrix_to_6d
from bunraku.generation.features import HANDLE_SIZE, ROOT_SIZE, feature_mask
from bunraku.language.posing import Posing
from bunraku.language.sentence import Clause

__all__ = ["PartTrack", "clause_spans", "overlaid", "steadied", "straightened", "turned_as_asked", "with_limbs"]

_SAVITZKY_GOLAY = np.array([-3, 12, 17, 12, -3]) / 35
"""Least-squares parabolas through five frames (Savitzky & Golay 1964): nothing changes below 3 Hz, half goes at 6."""
STRENGTH = 0.6
MOST = 1.6
"""Factor by which a turn is made faster or slower at the most."""
INSIDE = np.radians(10)
"""How far within the bounds of what was requested it then ends."""
SWAY = 1.0
"""Deviation of the mean that counts as the course [s]; a stride sways within."""


def steadied(features: np.ndarray, loop: bool = False) -> np.ndarray:
    """A motion with less of what is faster than people move; its travel over the ground stays.

    Args:
        features: Features of each frame (see `diffusion.features`), shape (N, D).
        loop: The last frame is followed by the first.

    Returns:
        Shape (N, D), float32.
    """
    pose = features[:, 3:]
    smooth = correlated(pose, _SAVITZKY_GOLAY, edge="wrap" if loop else "nearest")
    return np.concatenate([features[:, :3], pose + STRENGTH * (smooth - pose)], axis=1).astype(np.float32)


def turned_as_asked(features: np.ndarray, script: Sequence[tuple[Clause, int]], fps: float) -> np.ndarray:
    """A motion whose turns go as far as its clauses say, where they nearly do: faster or slower by at most `MOST`.

    Args:
        features: Features of each frame, the root's yaw velocity [rad/s] first, shape (N, D).
        script: Its clauses with the frames that each lasts.
        fps: Frames a second [1/s].

    Returns:
        Shape (N, D), float32.
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
    """A motion that keeps its course wherever a clause says "forward" and nothing of a turn.

    Args:
        features: Features of each frame, the root's yaw velocity [rad/s] first, shape (N, D).
        script: Its clauses with the frames that each lasts.
        fps: Frames a second [1/s].

    Returns:
        Shape (N, D), float32.
    """
    out = features.copy()
    for clause, part in clause_spans(script):
        if clause.straight and len(out[part]):
            out[part, 0] -= gaussian(out[part, 0], SWAY * fps)
    return out


def clause_spans(script: Iterable[tuple[Clause, int]]) -> Iterator[tuple[Clause, slice]]:
    """The clauses of a script that have frames each, with those frames as slices."""
    start = 0
    for clause, frames in script:
        yield clause, slice(start, start + frames)
        start += frames


@dataclass(frozen=True)
class PartTrack:
    """A second time line for a motion in which something happens at the same time: it is conditioned on the gestures,
    and moves as the first one else.

    The first does not see the second: a walk whose arms wave would soon stand still, as people do who wave.

    Args:
        motion: Which motion of the batch it belongs to.
        sentences: What it is conditioned on, a sentence for each of the motion's.
        handles: The handles that are its own, shape (K,), bool.
    """

    motion: int
    sentences: tuple[str, ...]
    handles: np.ndarray

    @classmethod
    def of(cls, motion: int, script: Sequence[Clause], limbs: bool = True) -> PartTrack | None:
        """The second time line of a motion with these clauses; None where nothing is done meanwhile in any.

        Args:
            motion: Its number.
            script: Its clauses.
            limbs: What limbs are told to do is on that line, too; else it is laid over the motion (`overlay`).
        """
        voices = [clause.meanwhile for clause in script]
        voices = [one if one is not None and (limbs or not isinstance(one.told, Posing)) else None for one in voices]
        own = [kept_handles(made.part.split(" and ")) for made in voices if made is not None]
        texts = tuple((made or clause.body).text for made, clause in zip(voices, script, strict=True))
        return cls(motion, texts, np.any(own, axis=0)) if own else None

    def follow(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """The second time line's features, shape (N, 271), with all that is not its own as in the first."""
        return np.where(feature_mask(self.handles), second, first)

    def adapt(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """The same of the adaptation, shape (N, K, 3)."""
        return np.where(self.handles[:, None], second, first)


_CHEST = HANDLE_NAMES.index("spine3")
_HEAD = PARTS["head"]


class _Affine(NamedTuple):
    """What handles do to points at rest: v -> turn v + shift, shapes (..., 3, 3) and (..., 3)."""

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
    """A motion with the limbs of a gesture wherever its clauses say so.

    Args:
        features: Of each frame (`diffusion.features`), shape (N, D).
        gesture: The same of somebody who does nothing else.
        script: The motion's clauses with the frames that each lasts.
    """
    out = features.copy()
    for clause, span in clause_spans(script):
        if clause.limbs_meanwhile is not None:
            out[span] = overlaid(out[span], gesture[span], clause.limbs_meanwhile.parts)
    return out


def overlaid(features: np.ndarray, gesture: np.ndarray, parts: Collection[str]) -> np.ndarray:
    """A motion with some parts of the body as in a gesture.

    Args:
        features: Shape (N, D).
        gesture: Shape (N, D).
        parts: "upper body" of a trunk that leans, "head", "arms", "left arm", "right arm", "lower body".
    """
    own, made = _transforms(features), _transforms(gesture)
    turn, shift = own.turn.copy(), own.shift.copy()

    def put(handle: int, value: _Affine) -> None:
        turn[:, handle], shift[:, handle] = value

    chest = own.at(_CHEST)
    if "upper body" in parts:
        for handle in PARTS["torso"]:
            put(handle, made.at(handle).after(own.at(handle)))
        chest = made.at(_CHEST).after(chest)
    from_own, from_made = own.at(_CHEST).inverse(), made.at(_CHEST).inverse()
    replaced = {handle for part in parts if part.endswith(("arm", "arms")) for handle in PARTS[part]}
    for handle in PARTS["upper body"]:
        if handle in PARTS["torso"]:
            continue
        local = from_own.after(own.at(handle))
        if handle in replaced:
            local = from_made.after(made.at(handle))
        elif handle in _HEAD and ("head" in parts or "upper body" in parts):
            local = from_made.after(made.at(handle)).after(local)
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
