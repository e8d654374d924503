"""Limbs held, or moved, as a sentence says while something else goes on: a gesture's trunk, head and arms on a motion.

What the motion does itself stays: who walks with a head that is tilted still sways, and arms that are crossed go with
the chest of who walks. Legs that are to stay are those of the gesture, with the ground that they stand on.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.parts import PARTS
from bunraku.body.reference import reference_body
from bunraku.diffusion.features import HANDLE_SIZE, ROOT_SIZE
from bunraku.diffusion.generation.finishing import clause_spans
from bunraku.geometry.rotations import matrix_from_6d, matrix_to_6d
from bunraku.language.sentence import Clause

__all__ = ["overlaid", "with_limbs"]

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
