"""A handle motion as the numbers that the denoiser sees, and motions of SMPL's 22 joints as handle motions.

Each frame holds the root without its place and heading, then each other handle, D = 10 + 9 (K - 1) = 271 numbers:

====== ==========================================================================
0      yaw velocity [rad/s], from the frame before to this one
1:3    planar velocity (x, z) in this frame's heading [m/s], from the frame before
3      height of the root over its rest height [m]
4:10   rotation of the root with its heading removed, 6D
10:    for handles 1..K-1, local translation [m] (3) and local rotation, 6D (6)
====== ==========================================================================

The first frame's velocities say how it was reached (a copy of the second's when nothing is known) and do not count when
a motion is put together, so any cut of a clip is a clip.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_MIRROR, HANDLE_PARENTS, JOINT_COUNT, JOINT_NAMES
from bunraku.core.body.reference import leg_length, reference_body
from bunraku.core.geometry.curves import STANDS
from bunraku.core.geometry.rotations import heading, matrix_from_6d, matrix_to_6d, matrix_y
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.errors import MotionError

ROOT_SIZE, HANDLE_SIZE = 10, 9
FEATURE_SIZE = ROOT_SIZE + HANDLE_SIZE * (HANDLE_COUNT - 1)
_SIX_SIGNS = np.array([1, -1, -1, -1, 1, 1], np.float32)


def body_handle_motion(motion: SkeletalMotion) -> HandleMotion:
    """Handle motion of the reference body, which stands on y = 0, of SMPL's 22 joints relative to its T-pose.

    Raises:
        MotionError: It has other joints.
    """
    from bunraku.anatomy.anatomy import reference_anatomy

    if motion.skeleton.names != JOINT_NAMES:
        raise MotionError("the reference body takes motions of SMPL's 22 joints only; map the skeleton first")
    body, anatomy = reference_body(), reference_anatomy()
    world = motion.world()[0].astype(np.float64)
    root = world[:, 0]
    rotations = np.tile(np.eye(3), (len(world), HANDLE_COUNT, 1, 1))
    rotations[:, 1:JOINT_COUNT] = np.swapaxes(root, -1, -2)[:, None] @ world[:, 1:]
    for handle in range(JOINT_COUNT, HANDLE_COUNT):
        rotations[:, handle] = rotations[:, HANDLE_PARENTS[handle]]
    rotations, translations = anatomy.attached(rotations)
    scale = body.legs / max(leg_length(motion.skeleton.positions), 1e-9)
    pelvis, position = body.joints[0].astype(np.float64), body.handles.positions[0].astype(np.float64)
    path = motion.root_translation * scale + np.einsum("nij,j->ni", root, position - pelvis) - position
    out = HandleMotion(translations, rotations, path, root, motion.fps)
    path[:, 1] -= np.quantile(anatomy.surface_reach.lowest(out.transforms(body.handles.positions)), STANDS)
    return replace(out, root_translation=path)


def encode(motion: HandleMotion) -> np.ndarray:
    """Features of a handle motion, shape (N, 271), float32.

    Raises:
        MotionError: The motion has another number of handles than 30.
    """
    frames, count = motion.translations.shape[:2]
    if count != HANDLE_COUNT:
        raise MotionError(f"the denoiser knows {HANDLE_COUNT} handles but the motion has {count}")
    angle = heading(motion.root_rotation, motion.fps)
    back = matrix_y(-angle)
    out = np.empty((frames, FEATURE_SIZE), np.float32)
    step = np.diff(np.asarray(motion.root_translation, float), axis=0, prepend=0)
    out[:, 0] = np.diff(angle, prepend=0) * motion.fps
    out[:, 1:3] = np.einsum("nij,nj->ni", back, step)[:, [0, 2]] * motion.fps
    out[0, :3] = out[1, :3] if frames > 1 else 0
    out[:, 3] = motion.root_translation[:, 1]
    sixes = matrix_to_6d(np.concatenate([(back @ motion.root_rotation)[:, None], motion.rotations[:, 1:]], axis=1))
    out[:, 4:10] = sixes[:, 0]
    local = out[:, ROOT_SIZE:].reshape(frames, HANDLE_COUNT - 1, 9)
    local[..., :3], local[..., 3:] = motion.translations[:, 1:], sixes[:, 1:]
    return out


def decode(features: np.ndarray, fps: float = 20.0) -> HandleMotion:
    """The handle motion of features (N, 271): velocities are summed up from a canonical start at x = z = 0 that faces
    +Z.

    Raises:
        MotionError: The shape is another one, or a value is not finite.
    """
    x = np.asarray(features, float)
    if x.ndim != 2 or x.shape[1] != FEATURE_SIZE:
        raise MotionError(f"motion features must have shape (frames, {FEATURE_SIZE}), not {x.shape}")
    frames = len(x)
    turns, velocity = x[:, 0] / fps, np.zeros((frames, 3))
    velocity[:, [0, 2]] = x[:, 1:3] / fps
    turns[:1], velocity[:1] = 0, 0
    facing = matrix_y(np.cumsum(turns))
    position = np.cumsum(np.einsum("nij,nj->ni", facing, velocity), axis=0)
    position[:, 1] = x[:, 3]
    local = x[:, ROOT_SIZE:].reshape(frames, HANDLE_COUNT - 1, 9)
    translations = np.zeros((frames, HANDLE_COUNT, 3))
    translations[:, 1:] = local[..., :3]
    rotations = np.broadcast_to(np.eye(3), (frames, HANDLE_COUNT, 3, 3)).copy()
    rotations[:, 1:] = matrix_from_6d(local[..., 3:])
    return HandleMotion(translations, rotations, position, facing @ matrix_from_6d(x[:, 4:10]), fps)


def root_velocities(path: np.ndarray, fps: float) -> np.ndarray:
    """The first three features of a root on a path of positions (x, z) [m] and headings [rad], both shape (N, 3)."""
    step, angle = np.diff(path[:, :2], axis=0, prepend=path[:1, :2]), path[:, 2]
    out = np.empty((len(path), 3))
    out[:, 0] = np.diff(angle, prepend=angle[:1]) * fps
    out[:, 1] = (step[:, 0] * np.cos(angle) - step[:, 1] * np.sin(angle)) * fps
    out[:, 2] = (step[:, 0] * np.sin(angle) + step[:, 1] * np.cos(angle)) * fps
    if len(path) > 1:
        out[0] = out[1]
    return out


def _mirror_map() -> tuple[np.ndarray, np.ndarray]:
    order, sign = np.arange(FEATURE_SIZE), np.ones(FEATURE_SIZE, np.float32)
    sign[:2] = -1
    sign[4:10] = _SIX_SIGNS
    for handle in range(1, HANDLE_COUNT):
        here, there = ROOT_SIZE + 9 * (handle - 1), ROOT_SIZE + 9 * (HANDLE_MIRROR[handle] - 1)
        order[here : here + 9] = np.arange(there, there + 9)
        sign[here : here + 9] = [-1, 1, 1, *_SIX_SIGNS]
    return order, sign


_MIRROR_ORDER, _MIRROR_SIGN = _mirror_map()


def mirror(features: np.ndarray) -> np.ndarray:
    """Features of the motion in a mirror (x -> -x, left handles become right ones), shape [..., 271]."""
    return features[..., _MIRROR_ORDER] * _MIRROR_SIGN


def _groups() -> list[slice]:
    groups = [slice(0, 1), slice(1, 3), slice(3, 4), slice(4, 10)]
    for start in range(ROOT_SIZE, FEATURE_SIZE, 9):
        groups += [slice(start, start + 3), slice(start + 3, start + 9)]
    return groups


def feature_weights() -> np.ndarray:
    """Weight of each feature in the motion loss, shape (271,), mean 1.

    Fingers, head top, face and wings repeat their parents' motion on the reference body and its tail does not move, so
    they count less; the root moves everything, so it counts more.
    """
    weights = np.ones(FEATURE_SIZE, np.float32)
    weights[:3], weights[3:10] = 6, 3
    for handle in range(22, HANDLE_COUNT):
        start = ROOT_SIZE + 9 * (handle - 1)
        weights[start : start + 9] = 0.25 if handle < 28 else 0.1
    return weights / weights.mean()


@dataclass(frozen=True)
class FeatureStatistics:
    """Mean and deviation that bring features to about zero and one, shape (271,) each. The deviation has one value for
    each group of a kind (the three coordinates of a translation, the six numbers of a rotation), with a floor of 3 cm
    and 0.12, so that a handle that hardly moves is not amplified.
    """

    mean: np.ndarray
    std: np.ndarray

    @classmethod
    def measure(cls, clips: list[np.ndarray]) -> FeatureStatistics:
        """Statistics of clips and their mirror images, each frame counting the same."""
        frames = sum(len(clip) for clip in clips)
        if frames == 0:
            raise MotionError("there are no frames to measure the features of")
        total, square = np.zeros(FEATURE_SIZE), np.zeros(FEATURE_SIZE)
        for clip in clips:
            total += clip.sum(0, dtype=float)
            square += np.square(clip, dtype=float).sum(0)
        mean = 0.5 * (total + mirror(total)) / frames
        variance = 0.5 * (square + square[_MIRROR_ORDER]) / frames - mean**2
        std = np.empty(FEATURE_SIZE)
        for group in _groups():
            floor = 0.12 if group.stop - group.start == 6 else 0.03
            std[group] = max(float(np.sqrt(max(variance[group].mean(), 0.0))), floor)
        return cls(mean.astype(np.float32), std.astype(np.float32))

    def normalise(self, features: np.ndarray) -> np.ndarray:
        """Features to network units, shape [..., 271]."""
        return (features - self.mean) / self.std

    def restore(self, values: np.ndarray) -> np.ndarray:
        """Network units back to features, shape [..., 271]."""
        return values * self.std + self.mean


def feature_mask(handles: np.ndarray) -> np.ndarray:
    """Which features these handles decide, shape (271,), bool: ten numbers for the root, nine for each other."""
    return np.concatenate([np.repeat(handles[:1], ROOT_SIZE), np.repeat(handles[1:], HANDLE_SIZE)])
