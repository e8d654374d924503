"""The transform of an FBX model: translation, rotation of any order between pre- and post-rotation, scale, and two
pivots.

With offsets O, pivots P and `Rpost` inverted, a point x of a model goes to

    T + O_r + P_r + R_pre R R_post^-1 ( S (x - P_s) + P_s + O_s - P_r )

in its parent's frame. Meshes have a geometric transform below that, which their children do not inherit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.formats.fbx.scene import FbxObject, FbxScene

__all__ = ["PROPERTIES", "Values", "default_world", "euler_matrices", "geometric_matrix", "world_matrices"]

PROPERTIES: dict[str, tuple[float, float, float]] = {
    "Lcl Translation": (0, 0, 0),
    "Lcl Rotation": (0, 0, 0),
    "Lcl Scaling": (1, 1, 1),
}
"""The properties that clips move, with their defaults; rotations in degrees."""

_ORDERS = ("XYZ", "XZY", "YZX", "YXZ", "ZXY", "ZYX", "XYZ")  # the first letter turns first; spheric XYZ is read as XYZ

Values = dict[tuple[int, str], np.ndarray]
"""Values of (model, property) at N moments, shape (N, 3)."""


@dataclass(frozen=True)
class _World:
    matrix: np.ndarray  # (N, 4, 4), or (1, 4, 4) of what never moves
    rotation: np.ndarray  # (N, 3, 3), of all rotations above and here
    scale: np.ndarray  # (N, 3), own


def euler_matrices(degrees: np.ndarray, order: str = "XYZ") -> np.ndarray:
    """Rotations of Euler angles about fixed axes, shape (..., 3) -> (..., 3, 3).

    Args:
        degrees: Angles about X, Y and Z [degrees].
        order: The axis that turns first, then the others.
    """
    out = np.eye(3)
    for axis in order:
        k = "XYZ".index(axis)
        i, j = (k + 1) % 3, (k + 2) % 3
        angle = np.radians(degrees[..., k])
        turn = np.zeros((*degrees.shape, 3))
        turn[..., k, k] = 1
        turn[..., i, i] = turn[..., j, j] = np.cos(angle)
        turn[..., j, i], turn[..., i, j] = np.sin(angle), -np.sin(angle)
        out = turn @ out
    return out


def geometric_matrix(model: FbxObject) -> np.ndarray:
    """What moves the mesh of a model but not its children, shape (4, 4)."""
    out = np.eye(4)
    out[:3, :3] = euler_matrices(model.numbers("GeometricRotation", (0, 0, 0))) * model.numbers(
        "GeometricScaling", (1, 1, 1)
    )
    out[:3, 3] = model.numbers("GeometricTranslation", (0, 0, 0))
    return out


def default_world(scene: FbxScene) -> np.ndarray:
    """World transforms of all models in the default pose, in the file's frame and unit, shape (M, 4, 4)."""
    return (
        np.concatenate(world_matrices(scene, {}, list(range(len(scene.models)))))
        if scene.models
        else np.zeros((0, 4, 4))
    )


def world_matrices(scene: FbxScene, values: Values, chosen: list[int]) -> list[np.ndarray]:
    """World transforms of chosen models where some properties take other values than the default ones.

    Args:
        scene: The file.
        values: What moves, each with as many moments N.
        chosen: Models, by index.

    Returns:
        For each a transform in the file's frame and unit, shape (N, 4, 4), or (1, 4, 4) of what never moves.
    """
    needed = set()
    for model in chosen:
        while model >= 0 and model not in needed:
            needed.add(model)
            model = int(scene.parents[model])
    known: dict[int, _World] = {}
    for model in sorted(needed):  # parents come first
        parent = int(scene.parents[model])
        known[model] = _placed(scene.models[model], model, values, known[parent] if parent >= 0 else None)
    return [known[model].matrix for model in chosen]


def _placed(model: FbxObject, index: int, values: Values, parent: _World | None) -> _World:
    moving = [values.get((index, name), model.numbers(name, default)[None]) for name, default in PROPERTIES.items()]
    translation, degrees, scale = moving
    if model.number("RotationActive", 0) and not model.number("RotationSpaceForLimitOnly", 0):
        order = _ORDERS[min(max(int(model.number("RotationOrder", 0)), 0), 6)]
        before = euler_matrices(model.numbers("PreRotation", (0, 0, 0)))
        after = euler_matrices(model.numbers("PostRotation", (0, 0, 0))).T
    else:
        order, before, after = "XYZ", np.eye(3), np.eye(3)
    rotation = before @ euler_matrices(degrees, order) @ after
    turn_offset, turn_pivot, scale_offset, scale_pivot = (
        model.numbers(name, (0, 0, 0)) for name in ("RotationOffset", "RotationPivot", "ScalingOffset", "ScalingPivot")
    )
    inner = scale_offset + scale_pivot - turn_pivot - scale * scale_pivot
    count = max(len(translation), len(rotation), len(scale), 1 if parent is None else len(parent.matrix))
    matrix = np.zeros((count, 4, 4))
    matrix[:, 3, 3] = 1
    matrix[:, :3, 3] = translation + turn_offset + turn_pivot + np.einsum("nij,nj->ni", *_same(rotation, inner))
    if parent is None:
        matrix[:, :3, :3] = rotation * scale[:, None, :]
        return _World(matrix, rotation, scale)
    matrix[:, :3, 3] = (
        np.einsum("nij,nj->ni", *_same(parent.matrix[:, :3, :3], matrix[:, :3, 3])) + parent.matrix[:, :3, 3]
    )
    inherit = int(model.number("InheritType", 1))
    if inherit == 1:
        matrix[:, :3, :3] = parent.matrix[:, :3, :3] @ (rotation * scale[:, None, :])
    else:  # scales of parents come after the own rotation (0), or those of the very parent not at all (2)
        above = np.swapaxes(parent.rotation, 1, 2) @ parent.matrix[:, :3, :3]
        if inherit == 2:
            above = above / np.where(np.abs(parent.scale) > 1e-12, parent.scale, 1)[:, None, :]
        matrix[:, :3, :3] = parent.rotation @ rotation @ above * scale[:, None, :]
    return _World(matrix, parent.rotation @ rotation, scale)


def _same(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both with as many rows: one of a single row is repeated."""
    count = max(len(first), len(second))
    return np.broadcast_to(first, (count, *first.shape[1:])), np.broadcast_to(second, (count, *second.shape[1:]))
