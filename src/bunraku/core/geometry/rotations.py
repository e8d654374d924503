"""Rotations: conversions between matrices, 6D, quaternions and axis-angle, and their values at another frame rate."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np

Array = Any  # numpy.ndarray, or a tensor


def _library(value: Array) -> Any:
    return sys.modules[type(value).__module__.partition(".")[0]]


def _unit(xp: Any, vector: Array) -> Array:
    length = xp.sqrt((vector * vector).sum(-1))[..., None]
    return vector / xp.where(length > 1e-12, length, xp.ones_like(length))


def matrix_to_6d(matrix: Array) -> Array:
    """First two columns of rotation matrices, shape [..., 3, 3] -> [..., 6] (Zhou et al. 2019)."""
    xp = np if isinstance(matrix, np.ndarray) else _library(matrix)
    return xp.concatenate([matrix[..., 0], matrix[..., 1]], -1)


def matrix_from_6d(six: Array) -> Array:
    """Rotation matrices from two columns made orthonormal by Gram-Schmidt, shape [..., 6] -> [..., 3, 3]."""
    xp = np if isinstance(six, np.ndarray) else _library(six)
    x = _unit(xp, six[..., :3])
    y = _unit(xp, six[..., 3:] - (x * six[..., 3:]).sum(-1)[..., None] * x)
    z = np.cross(x, y) if xp is np else xp.linalg.cross(x, y)
    return xp.stack([x, y, z], -1)


def matrix_from_quaternion(quaternion: Array) -> Array:
    """Rotation matrices from xyzw quaternions of any non-zero length, shape [..., 4] -> [..., 3, 3]."""
    xp = np if isinstance(quaternion, np.ndarray) else _library(quaternion)
    q = _unit(xp, quaternion)
    x, y, z, w = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    entries = [
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return xp.stack(entries, -1).reshape(*q.shape[:-1], 3, 3)


def quaternion_from_matrix(matrix: Array) -> Array:
    """xyzw quaternions of rotation matrices, shape [..., 3, 3] -> [..., 4], w >= 0. Of the four ways to divide, each
    matrix takes the one with the largest divisor, so half turns lose no precision.
    """
    xp = np if isinstance(matrix, np.ndarray) else _library(matrix)
    m = matrix
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    a, b, c = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    d, e, f = m[..., 1, 0] + m[..., 0, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 2, 1] + m[..., 1, 2]
    squares = [1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz, 1 + xx + yy + zz]
    diagonal = xp.stack(squares, -1)
    entries = [squares[0], d, e, a, d, squares[1], f, b, e, f, squares[2], c, a, b, c, squares[3]]
    candidates = xp.stack(entries, -1).reshape(*diagonal.shape, 4)
    best = diagonal.argmax(-1)[..., None, None]
    if xp is np:
        chosen = np.take_along_axis(candidates, np.broadcast_to(best, (*best.shape[:-1], 4)), axis=-2)[..., 0, :]
    else:
        chosen = candidates.gather(-2, best.expand(*best.shape[:-1], 4))[..., 0, :]
    q = _unit(xp, chosen)
    return q * xp.where(q[..., 3:] < 0, -xp.ones_like(q[..., 3:]), xp.ones_like(q[..., 3:]))


def matrix_from_axis_angle(rotvec: Array) -> Array:
    """Rotation matrices from axis times angle [rad], shape [..., 3] -> [..., 3, 3] (Rodrigues)."""
    xp = np if isinstance(rotvec, np.ndarray) else _library(rotvec)
    half = 0.5 * xp.sqrt((rotvec * rotvec).sum(-1))[..., None]
    small = half < 1e-6
    scale = xp.where(small, 0.5 - half * half / 12, xp.sin(half) / xp.where(small, xp.ones_like(half), 2 * half))
    quaternion = (
        np.concatenate([rotvec * scale, np.cos(half)], -1) if xp is np else xp.cat([rotvec * scale, xp.cos(half)], -1)
    )
    return matrix_from_quaternion(quaternion)


def axis_angle_from_matrix(matrix: Array) -> Array:
    """Axis times angle [rad] with the angle in [0, pi], shape [..., 3, 3] -> [..., 3]."""
    xp = np if isinstance(matrix, np.ndarray) else _library(matrix)
    q = quaternion_from_matrix(matrix)
    length = xp.sqrt((q[..., :3] * q[..., :3]).sum(-1))[..., None]
    angle = 2 * (np.arctan2(length, q[..., 3:]) if xp is np else xp.atan2(length, q[..., 3:]))
    small = length < 1e-9
    return q[..., :3] * xp.where(small, 2 * xp.ones_like(length), angle / xp.where(small, xp.ones_like(length), length))


def matrix_y(angle: Array) -> Array:
    """Rotations about +Y by an angle [rad], shape [...] -> [..., 3, 3]; positive angles take +Z towards +X."""
    xp = np if isinstance(angle, np.ndarray) else _library(angle)
    c, s, zero, one = xp.cos(angle), xp.sin(angle), xp.zeros_like(angle), xp.ones_like(angle)
    return xp.stack([c, zero, s, zero, one, zero, -s, zero, c], -1).reshape(*c.shape, 3, 3)


def rotation_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The smallest rotation from one direction to another, shape [..., 3] x 2 -> [..., 3, 3]; of opposite directions
    about some perpendicular axis. A zero vector gives the identity.
    """
    a, b = _unit(np, np.asarray(start, float)), _unit(np, np.asarray(end, float))
    xyz = np.cross(a, b)
    w = 1 + (a * b).sum(-1)[..., None]
    other = np.cross(a, np.where(np.abs(a[..., :1]) < 0.9, [1.0, 0, 0], [0, 1.0, 0]))
    opposite = w < 1e-9
    quaternion = np.concatenate([np.where(opposite, other, xyz), np.where(opposite, 0.0, w)], -1)
    zero = ((a * a).sum(-1) < 0.5) | ((b * b).sum(-1) < 0.5)
    quaternion = np.where(zero[..., None], np.array([0.0, 0, 0, 1]), quaternion)
    return matrix_from_quaternion(quaternion)


def nearest_rotation(linear: np.ndarray) -> np.ndarray:
    """The rotations nearest to linear maps, shape (..., 3, 3)."""
    u, _, v = np.linalg.svd(linear)
    u[..., :, 2] *= np.linalg.det(u @ v)[..., None]
    return np.asarray(u @ v)


def quaternion_slerp(start: np.ndarray, end: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Shortest-way interpolation between xyzw quaternions, shapes [..., 4], [..., 4], [...] -> [..., 4]."""
    dot = (start * end).sum(-1, keepdims=True)
    end = np.where(dot < 0, -end, end)
    angle = np.arccos(np.clip(np.abs(dot), 0, 1))
    share = np.asarray(share)[..., None]
    near = angle < 1e-4
    safe = np.where(near, 1.0, np.sin(angle))
    a = np.where(near, 1 - share, np.sin((1 - share) * angle) / safe)
    b = np.where(near, share, np.sin(share * angle) / safe)
    return _unit(np, a * start + b * end)


def matrix_slerp(start: np.ndarray, end: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Rotations so far on the way from some to others, shapes [..., 3, 3], [..., 3, 3], [...] -> [..., 3, 3]."""
    return matrix_from_quaternion(quaternion_slerp(quaternion_from_matrix(start), quaternion_from_matrix(end), share))


def continuous(quaternions: np.ndarray) -> np.ndarray:
    """Quaternions of N frames, shape (N, ..., 4), with signs that never jump, so that they can be interpolated."""
    flips = np.where((quaternions[1:] * quaternions[:-1]).sum(-1) < 0, -1.0, 1.0)
    out = quaternions.copy()
    out[1:] *= np.cumprod(flips, axis=0)[..., None]
    return out


def adjugates(matrices: np.ndarray) -> np.ndarray:
    """Inverse times determinant of 3x3 matrices, shape (..., 3, 3); of many matrices much faster than `linalg.inv`."""
    rows = [(matrices[..., row, 0], matrices[..., row, 1], matrices[..., row, 2]) for row in range(3)]
    out = np.empty_like(matrices)
    for column in range(3):  # the cross product of the two other rows
        (ax, ay, az), (bx, by, bz) = rows[(column + 1) % 3], rows[(column + 2) % 3]
        out[..., 0, column] = ay * bz - az * by
        out[..., 1, column] = az * bx - ax * bz
        out[..., 2, column] = ax * by - ay * bx
    return out


def inverses(matrices: np.ndarray) -> np.ndarray:
    """Inverses of 3x3 matrices, shape (..., 3, 3), by their adjugates."""
    out = adjugates(matrices)
    out /= np.einsum("...i,...i->...", matrices[..., 0, :], out[..., :, 0])[..., None, None]
    return out


def heading(root_rotation: np.ndarray, fps: float = 20.0) -> np.ndarray:
    """Heading of the root, (N, 3, 3), at a rate [1/s]: its rotation about +Y [rad], unwrapped and smooth, shape (N,),
    float64; 0 faces +Z, positive angles go towards +X. Always finite.

    The angle is the twist of the rotation about +Y, which stays well defined for a body on its back, front or side,
    unlike the projection of +Z, with which it agrees when upright. It is lost only upside down: frames count by how
    well defined it is in a Gaussian mean over 0.1 s, and stretches without any are bridged.
    """
    from bunraku.core.geometry.curves import gaussian

    quaternion = quaternion_from_matrix(np.asarray(root_rotation, float))
    y, w = quaternion[:, 1], quaternion[:, 3]
    vector = np.stack([w * w - y * y, 2 * w * y], -1)  # (cos, sin) of the twist times w^2 + y^2
    vector = gaussian(vector, 0.1 * fps)
    sure = np.hypot(vector[:, 0], vector[:, 1]) > 0.05
    if not sure.any():
        return np.zeros(len(vector))
    frames = np.arange(len(vector))
    return np.interp(frames, frames[sure], np.unwrap(np.arctan2(vector[sure, 1], vector[sure, 0])))


def facing_and_tilt(rotations: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (N, 3, 3) as the product of one about +Y, by the smooth `heading`, and the tilt that is left."""
    facing = np.asarray(matrix_y(heading(rotations, fps)), np.float64)
    return facing, facing.transpose(0, 2, 1) @ rotations


@dataclass(frozen=True, eq=False)
class Resampling:
    """The frames of a clip between which those of the result lie."""

    # low, high: the frame before and after each, shape (M,)
    low: np.ndarray
    high: np.ndarray
    share: np.ndarray  # its position between the two, 0 to 1, shape (M,)

    @classmethod
    def of(cls, frames: int, have: float, want: float) -> Resampling:
        """The frames in the duration of a clip of some frames, at least one, at the rates `have` and `want` [1/s]."""
        last = frames - 1
        at = np.minimum(np.arange(int(last / have * want + 1e-6) + 1) * (have / want), last)
        low = np.minimum(at.astype(np.int64), max(last - 1, 0))
        return cls(low, np.minimum(low + 1, last), at - low)

    def __len__(self) -> int:
        return len(self.low)

    def linear(self, values: np.ndarray) -> np.ndarray:
        """Floats of each frame, shape (N, ...) -> (M, ...), in their own precision."""
        share = self.share.astype(values.dtype).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(values[self.low] * (1 - share) + values[self.high] * share)

    def quaternions(self, values: np.ndarray) -> np.ndarray:
        """Unit quaternions xyzw of each frame, shape (N, ..., 4) -> (M, ..., 4)."""
        return quaternion_slerp(values[self.low], values[self.high], self.share.reshape(-1, *[1] * (values.ndim - 2)))

    def rotations(self, values: np.ndarray) -> np.ndarray:
        """Rotations of each frame, shape (N, ..., 3, 3) -> (M, ..., 3, 3), float64."""
        return np.asarray(matrix_from_quaternion(self.quaternions(quaternion_from_matrix(values.astype(float)))))
