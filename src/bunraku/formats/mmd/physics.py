"""Rigid bodies and joints of PMX and PMD: the bytes that both have in common, and what of them cannot be used."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bunraku.core.mmd_model import BODY_SHAPES, MMD_METRE, MmdBody, MmdJoint, mmd_angles, mmd_points, mmd_turn
from bunraku.formats.mmd.reader import MmdReader

__all__ = ["check_physics", "read_body", "read_joint"]

Note = Callable[[str, str], None]


def read_body(reader: MmdReader, name: str, bone: int, origin: np.ndarray) -> MmdBody:
    """A rigid body from its group on.

    Args:
        reader: Behind its bone.
        name: Its name.
        bone: Its bone.
        origin: What its position counts from [m], shape (3,).
    """
    group, mask, shape = reader.values("BHB")
    size, position, angles = reader.floats(3), reader.floats(3), reader.floats(3)
    mass, linear, angular, restitution, friction, mode = reader.values("5fB")
    return MmdBody(
        name, bone, BODY_SHAPES[shape] if shape < len(BODY_SHAPES) else "", size * MMD_METRE,
        origin + mmd_points(position), mmd_turn(angles),
        mass, linear, angular, restitution, friction, mode, group, mask,
    )  # fmt: skip


def read_joint(reader: MmdReader, name: str, bodies: tuple[int, int]) -> MmdJoint:
    """A joint from its position on."""
    position, angles, lower, upper, angle_lower, angle_upper, spring, angle_spring = reader.floats(24).reshape(8, 3)
    low, high = mmd_points([lower, upper])
    low[2], high[2] = high[2], low[2]  # z is turned round
    turned = mmd_angles(angle_lower, angle_upper)
    return MmdJoint(name, bodies, mmd_points(position), mmd_turn(angles), low, high, *turned, spring, angle_spring)


def check_physics(
    bodies: list[MmdBody], joints: list[MmdJoint], bones: int, note: Note
) -> tuple[tuple[MmdBody, ...], tuple[MmdJoint, ...]]:
    """The bodies and joints that can be used.

    Args:
        bodies: As the file has them.
        joints: As the file has them.
        bones: How many bones there are.
        note: Called with what is wrong and the name of what it is wrong with.
    """
    kept: dict[int, MmdBody] = {}
    for index, body in enumerate(bodies):
        numbers = [body.mass, body.linear_damping, body.angular_damping, body.restitution, body.friction]
        if not (np.isfinite(numbers).all() and np.isfinite([body.size, body.position, *body.rotation]).all()):
            note("rigid bodies hold values that are not numbers and are left out", body.name)
        elif not body.shape or body.mode > 2 or body.group > 15:
            note("rigid bodies have a shape, mode or group that there is not and are left out", body.name)
        elif (body.size[: (1 if body.shape == "sphere" else 3 if body.shape == "box" else 2)] < 0).any():
            note("rigid bodies have a negative size and are left out", body.name)
        else:
            kept[index] = _repaired(body, bones, note)
    number = {index: row for row, index in enumerate(kept)}
    good = []
    for joint in joints:
        a, b = joint.bodies
        if a not in kept or b not in kept:
            note("joints are between rigid bodies that do not exist and are left out", joint.name)
        elif a == b:
            note("joints tie a rigid body to itself and are left out", joint.name)
        elif not all(np.isfinite(value).all() for value in vars(joint).values() if isinstance(value, np.ndarray)):
            note("joints hold values that are not numbers and are left out", joint.name)
        else:
            good.append(replace(joint, bodies=(number[a], number[b])))
    return tuple(kept.values()), tuple(good)


def _repaired(body: MmdBody, bones: int, note: Note) -> MmdBody:
    if not -1 <= body.bone < bones:
        note("rigid bodies are on a bone that does not exist and hang on none", body.name)
        body = replace(body, bone=-1)
    if body.dynamic and body.mass <= 0:
        note("rigid bodies have no mass and follow their bones", body.name)
        body = replace(body, mode=0, mass=0.0)
    return body
