"""Small characters of bodies and joints, by hand."""

import numpy as np

from bunraku.apparel.physics.rig import ApparelRig, PhysicsSettings
from bunraku.core.animation import RigAnimation
from bunraku.core.avatars import MmdBody, MmdJoint
from bunraku.core.character import Character, Rig

BARE = PhysicsSettings(air=0.0, least_ratio=0.0, limbs=False, gravity=9.81)
"""Nothing but gravity."""


def body(name, bone, position, mode=1, **changes):
    values = {
        "shape": "sphere",
        "size": np.array([0.02, 0, 0]),
        "rotation": np.eye(3),
        "mass": 1.0,
        "linear_damping": 0.0,
        "angular_damping": 0.0,
    }
    values |= {"restitution": 0.0, "friction": 0.0, "group": 0, "mask": 0}
    return MmdBody(name=name, bone=bone, position=np.array(position, float), mode=mode, **(values | changes))


def joint(a, b, position, **changes):
    none, free = np.zeros(3), (np.ones(3), -np.ones(3))
    values = {
        "rotation": np.eye(3),
        "lower": none,
        "upper": none,
        "angle_lower": free[0],
        "angle_upper": free[1],
        "spring": none,
    }
    return MmdJoint(
        name=f"{a}-{b}", bodies=(a, b), position=np.array(position, float),
        **(values | {"angle_spring": none} | changes),
    )  # fmt: skip


def character(heads, parents):
    """A tetrahedron on each bone, which holds it."""
    heads = np.array(heads, float)
    corner = np.array([[0, 0, 0], [1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    count = len(heads)
    transforms = np.tile(np.eye(4), (count, 1, 1))
    transforms[:, :3, 3] = heads
    indices = np.repeat(np.arange(count), 4)[:, None]
    rig = Rig(tuple(f"bone{n}" for n in range(count)), np.array(parents), transforms, indices, np.ones((4 * count, 1)))
    vertices = (heads[:, None] + corner).reshape(-1, 3).astype(np.float32)
    return Character("doll", vertices, np.concatenate([faces + 4 * n for n in range(count)]), rig)


def still(doll, frames=60, fps=30.0):
    count = len(doll.rig.names)
    return RigAnimation(doll, np.tile(np.eye(3), (frames, count, 1, 1)), np.zeros((frames, count, 3)), fps)


def chain(links=3, drop=0.2, **changes):
    """A bone at a height of 2 m, and bones with bodies that hang on it one below the other."""
    heads = [[0, 2, 0]] + [[0, 2 - drop * n, 0] for n in range(links)]
    doll = character(heads, list(range(-1, links)))
    bodies = [body("root", 0, [0, 2, 0], 0)] + [
        body(f"link{n}", n + 1, [0, 2 - drop * (n + 0.5), 0], **changes) for n in range(links)
    ]
    joints = [joint(n, n + 1, [0, 2 - drop * n, 0]) for n in range(links)]
    return doll, ApparelRig(tuple(bodies), tuple(joints))
