"""Masses and shapes of rigid bodies, as MuJoCo takes them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bunraku.core.mmd_model import MmdBody

__all__ = ["add_rods", "add_shape", "inertia", "loss_rate"]

THINNEST = 5e-3  # half extents below are taken as this for inertia [m]: thin rods spin faster than any time step
SMALLEST = 1e-3  # a shape that is smaller collides with nothing [m]
MOST_RODS = 3  # capsules that stand for a box
_ABOUT_X = np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0])  # wxyz; MuJoCo's capsules lie along z, MMD's along y


def inertia(body: MmdBody) -> np.ndarray:
    """Moments of inertia about the body's own axes [kg m^2], shape (3,); a capsule's are those of its box, as in
    Bullet.
    """
    if body.shape == "sphere":
        return np.full(3, 0.4 * body.mass * max(float(body.size[0]), THINNEST) ** 2)
    half = body.size if body.shape == "box" else np.array([body.size[0], body.size[0] + body.size[1] / 2, body.size[0]])
    square = np.maximum(half, THINNEST) ** 2
    return np.asarray(body.mass / 3 * (square.sum() - square))


def loss_rate(damping: float, most: float) -> float:
    """The rate at which speed is lost [1/s] by Bullet's `v *= (1 - damping) ** dt`, at most `most`."""
    return float(min(-np.log1p(-min(max(damping, 0.0), 1 - 1e-16)), most))


def add_shape(owner: Any, body: MmdBody, position: np.ndarray, name: str, settings: dict[str, object]) -> bool:
    """Add a body's shape to one of MuJoCo's bodies, whose axes are the world's at rest.

    Args:
        owner: Of an `MjSpec`.
        body: The body.
        position: Where `owner` is at rest [m], shape (3,).
        name: Of the shape.
        settings: Other attributes of the shape.

    Returns:
        Whether there is a shape; one without extent is none.
    """
    import mujoco

    if body.size[0] < SMALLEST and not (body.shape == "box" and body.size.max() >= SMALLEST):
        return False
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(body.rotation, float).ravel())
    size = np.zeros(3)
    if body.shape == "box":
        kind, size = mujoco.mjtGeom.mjGEOM_BOX, np.maximum(body.size, SMALLEST)
    elif body.shape == "capsule" and body.size[1] >= SMALLEST:
        kind = mujoco.mjtGeom.mjGEOM_CAPSULE
        size[:2] = body.size[0], body.size[1] / 2
        mujoco.mju_mulQuat(quaternion, quaternion.copy(), _ABOUT_X)
    else:
        kind = mujoco.mjtGeom.mjGEOM_SPHERE
        size[0] = body.size[0]
    owner.add_geom(name=name, type=kind, size=size, pos=body.position - position, quat=quaternion, mass=0.0, **settings)
    return True


def add_rods(owner: Any, body: MmdBody, position: np.ndarray, name: str, settings: dict[str, object]) -> bool:
    """Add a body's shape as capsules only: up to three side by side, along its longest side, fill a box.

    Arguments and result are those of `add_shape`; the shapes are named `name`, an "r" and a number.
    """
    if body.shape != "box":
        return add_shape(owner, body, position, f"{name}r0", settings)
    order = np.argsort(-body.size, kind="stable")
    long, wide, thin = np.maximum(body.size[order], SMALLEST)
    axes = body.rotation[:, order[[1, 0, 2]]] * [1.0, 1.0, np.linalg.det(body.rotation[:, order[[1, 0, 2]]])]
    count = int(np.clip(np.ceil(wide / thin), 1, MOST_RODS))
    added = False
    for number, across in enumerate(np.linspace(thin - wide, wide - thin, count) if count > 1 else [0.0]):
        rod = replace(
            body,
            shape="capsule",
            size=np.array([thin, 2 * (long - thin), 0.0]),
            rotation=axes,
            position=body.position + across * axes[:, 0],
        )
        added |= add_shape(owner, rod, position, f"{name}r{number}", settings)
    return added
