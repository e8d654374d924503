"""How the bones that drive apparel move: the way from the rest pose into a clip, and what lies between its frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.core.rig_animation import RigAnimation, bone_order
from bunraku.geometry.rotations import matrix_from_quaternion, matrix_y, quaternion_from_matrix, quaternion_slerp

__all__ = ["Drive", "lead_in"]

BLEND = 0.6  # share of the warm-up in which the pose changes; in the rest of it apparel settles


def lead_in(animation: RigAnimation, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Frames that lead from the rest pose into the first frame of a clip.

    The rest pose stands where the first frame does and looks where it looks, so that apparel is not thrown about.

    Args:
        animation: The clip.
        frames: How many.

    Returns:
        World rotations of the bones (frames, J, 3, 3) and positions of their heads [m] (frames, J, 3).
    """
    rig = animation.character.rig
    assert rig is not None
    first = RigAnimation(animation.character, animation.rotations[:1], animation.translations[:1], animation.fps)
    rotations, positions = (array[0] for array in first.world())
    rest = rig.positions
    mean = rotations.mean(axis=0)
    yaw = np.asarray(matrix_y(np.array(np.arctan2(mean[0, 2] - mean[2, 0], mean[0, 0] + mean[2, 2]))))
    shift = positions.mean(axis=0) - yaw @ rest.mean(axis=0)
    count = len(rest)
    share = np.clip(np.arange(frames) / max(BLEND * frames, 1), 0, 1)
    share = share * share * (3 - 2 * share)
    roots = rig.parents < 0
    local = np.tile(np.eye(3), (count, 1, 1))
    local[roots] = yaw
    away = np.zeros((count, 3))
    away[roots] = rest[roots] @ yaw.T + shift - rest[roots]
    start, end = quaternion_from_matrix(local), quaternion_from_matrix(animation.rotations[0].astype(float))
    blended = quaternion_slerp(start[None], end[None], np.broadcast_to(share[:, None], (frames, count)))
    moved = away + share[:, None, None] * (animation.translations[0] - away)
    return _forward(rig.parents, rest, matrix_from_quaternion(blended), moved)


def _forward(
    parents: np.ndarray, rest: np.ndarray, local: np.ndarray, moved: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    rotations, positions = np.array(local), rest + moved
    for bone in bone_order(parents):
        parent = int(parents[bone])
        if parent >= 0:
            rotations[:, bone] = rotations[:, parent] @ local[:, bone]
            away = rest[bone] - rest[parent] + moved[:, bone]
            positions[:, bone] = positions[:, parent] + np.einsum("nij,nj->ni", rotations[:, parent], away)
    return rotations, positions


@dataclass
class Drive:
    """The motion of driven bones, by frames.

    Between frames places go along cubic curves (Catmull and Rom's) and so do quaternions, which are normalised: at 30
    frames a second that is a slerp whose speed does not jump. Where a bone jumps, faster than `cut`, nothing lies
    between.

    Args:
        positions: Of the bones [m], shape (F, R, 3).
        quaternions: wxyz, shape (F, R, 4), without jumps of sign.
        jumps: Whether the way from a frame to the next one is a jump, shape (F - 1,).
    """

    positions: np.ndarray
    quaternions: np.ndarray
    jumps: np.ndarray

    @classmethod
    def of(cls, rotations: np.ndarray, positions: np.ndarray, fps: float, cut: float) -> Drive:
        """From world rotations (F, R, 3, 3) and positions (F, R, 3) of the bones."""
        quaternions = quaternion_from_matrix(np.asarray(rotations, float))[..., [3, 0, 1, 2]]
        signs = np.where((quaternions[1:] * quaternions[:-1]).sum(-1) < 0, -1.0, 1.0)
        quaternions[1:] *= np.cumprod(signs, axis=0)[..., None]
        speed = np.linalg.norm(np.diff(positions, axis=0), axis=-1) * fps
        jumps = (speed > cut).any(axis=1) if speed.size else np.zeros(len(speed), bool)
        return cls(np.asarray(positions, float), quaternions, jumps)

    def between(self, frame: int, parts: int) -> tuple[np.ndarray, np.ndarray]:
        """Places (parts, R, 3) and quaternions (parts, R, 4) on the way from a frame, which is left out, to the next
        one.
        """
        if self.jumps[frame]:
            return np.repeat(self.positions[frame + 1][None], parts, 0), np.repeat(
                self.quaternions[frame + 1][None], parts, 0
            )
        share = (np.arange(1, parts + 1) / parts)[:, None, None]
        positions = self._curve(self.positions, frame, share)
        quaternions = self._curve(self.quaternions, frame, share)
        return positions, quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)

    def _curve(self, values: np.ndarray, frame: int, s: np.ndarray) -> np.ndarray:
        start, end = values[frame], values[frame + 1]
        before, after = self._tangent(values, frame), self._tangent(values, frame + 1)
        s2, s3 = s * s, s * s * s
        return np.asarray(
            (2 * s3 - 3 * s2 + 1) * start + (s3 - 2 * s2 + s) * before + (3 * s2 - 2 * s3) * end + (s3 - s2) * after
        )

    def _tangent(self, values: np.ndarray, frame: int) -> np.ndarray:
        if frame == 0:  # from rest
            return np.zeros_like(values[frame])
        back = not self.jumps[frame - 1]
        on = frame < len(values) - 1 and not self.jumps[frame]
        if back and on:
            return np.asarray((values[frame + 1] - values[frame - 1]) / 2)
        return np.asarray(
            values[frame] - values[frame - 1]
            if back
            else values[frame + 1] - values[frame]
            if on
            else np.zeros_like(values[frame])
        )
