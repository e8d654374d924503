"""Inputs of the displacement networks for each node, in the frame of the joint that carries it.

All of it is vectors and plain numbers, so that a character's mirror image is its features with x turned round.
Lengths are over the character's size (`ClothedCharacter.scale`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.apparel.clothed import GRAVITY, ClothedCharacter
from bunraku.apparel.displacement.body_points import BodyPoints, body_points, nearest_point
from bunraku.apparel.displacement.filters import FREQUENCIES, LAGS, PENDULUMS, MotionFilters, Pendulums
from bunraku.apparel.displacement.lead_in import lead_in_transforms, rest_transforms
from bunraku.apparel.displacement.own_pendulum import SHORT, OwnPendulum
from bunraku.apparel.nodes import ApparelNodes
from bunraku.apparel.skinning import eq4_transforms
from bunraku.apparel.stiffness import node_swing
from bunraku.apparel.swing import Swing
from bunraku.body.layout import JOINT_COUNT, JOINT_MIRROR

__all__ = [
    "BASIS", "GLOBAL", "LEAD_IN", "OWN", "RATE", "STATIC_SCALARS", "STATIC_VECTORS", "VECTORS", "Frame",
    "MotionFeatures", "clip_features", "mirror_global", "static_features",
]  # fmt: skip

RATE = 30.0
"""Frames a second that the networks know [1/s]."""
LEAD_IN = 30
"""Frames from the rest pose into a clip."""
OWN = ((1.0, 0.0), (0.25, 0.0), (1.0, 6.0))
"""Factor on the friction of the pendulums of a node's own, and further friction [1/s]: as its chain is if all its
joints turn alike, as where the first one turns most, and one that does not swing on.
"""
BASIS = len(FREQUENCIES) + len(LAGS) + len(PENDULUMS) + 4 + len(OWN)
"""Vectors that a displacement may be made of: sways, lagging rotations, pendulums, the tilt, three pushes out of the
body, and the pendulums that swing as the node's own chain would.
"""
VECTORS = BASIS + 7
"""Beside these: up, spin, velocity, acceleration, the body's normals at the node and where it hangs, and how fast its
own pendulum goes.
"""
SCALARS = 4
STATIC_VECTORS = 5
STATIC_SCALARS = 20
GLOBAL = JOINT_COUNT * 9 + 3
_GROUPS = (0, 1, 1, 0, 1, 1, 2, 1, 1, 2, 1, 1, 3, 4, 4, 3, 4, 4, 4, 4, 4, 4)  # hips, legs, trunk, head, arms
DAMPINGS = (0.7, 0.978)  # of the parts that the networks have seen; files hold 0.4 to 0.999
CLEAR = 0.01  # how near to the body apparel may come that was farther off at rest [m]


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame of a clothed character.

    Args:
        vectors: In the frames of the carrying joints, shape (M, VECTORS, 3); the first BASIS of them are a basis of
            displacements.
        scalars: Signed distances from the body of the carried node and of where it hangs; how far its own pendulum
            turns, and how far it presses against its limits; shape (M, SCALARS).
        whole: The body's pose seen from the pelvis, shape (GLOBAL,).
        turns: Frames R of the carrying joints, shape (M, 3, 3).
        positions: Carried positions LBS(rest) [m], shape (M, 3).
        body: Positions and normals of the body's points [m], shape (B, 3) each.
    """

    vectors: np.ndarray
    scalars: np.ndarray
    whole: np.ndarray
    turns: np.ndarray
    positions: np.ndarray
    body: tuple[np.ndarray, np.ndarray]


def static_features(clothed: ClothedCharacter, nodes: ApparelNodes) -> tuple[np.ndarray, np.ndarray]:
    """What of the nodes never changes: vectors (M, STATIC_VECTORS, 3) and numbers (M, STATIC_SCALARS), float32."""
    size = clothed.scale
    points = body_points(clothed)
    distance, normal = nearest_point(nodes.rest, points.rest, points.normals)
    groups = np.eye(5, dtype=np.float32)[np.array(_GROUPS)[nodes.joint]]
    swing = node_swing(clothed, nodes)
    middle = np.einsum("mab,mb->ma", swing.axes, (swing.lower + swing.upper) / 2)
    vectors = np.stack([
        (nodes.rest - clothed.joints[nodes.joint]) / size, nodes.held / size, normal, swing.lever / size,
        swing.share[:, None] * _cross(middle, swing.lever) / size,
    ], axis=1)  # fmt: skip
    share = nodes.distance / nodes.length
    sizes = np.bincount(nodes.part, minlength=len(clothed.stiffness))[nodes.part]
    damping = np.clip(clothed.damping[nodes.part], *DAMPINGS)
    scalars = np.column_stack([
        nodes.distance / size, nodes.length / size, share, share**2, np.clip(distance / size, -0.2, 0.3) * 5,
        clothed.stiffness[nodes.part], np.log10(1.0 - damping), np.log(sizes + 1.0) / 5, groups,
        _manners(swing, np.linalg.norm(nodes.held, axis=1), clothed.swing is not None),
    ])  # fmt: skip
    return vectors.astype(np.float32), scalars.astype(np.float32)


def _manners(swing: Swing, held: np.ndarray, told: bool) -> np.ndarray:
    """How nodes swing, as numbers: how far by limits and by springs, how fast, how damped, how much of them, by what
    lever beside that of the whole part, and whether a file says so, shape (M, 7).
    """
    arm = np.maximum(np.linalg.norm(swing.arm, axis=1), SHORT)
    rate = np.sqrt(GRAVITY * swing.weight / arm + swing.spring.mean(axis=1))
    lever = np.linalg.norm(swing.lever, axis=1) / np.maximum(held, SHORT)
    return np.column_stack([
        np.log10(swing.turns() + 1e-3), np.log10(np.maximum(rate, 0.1)),
        np.log10(swing.friction + swing.drag + 0.01), swing.share, np.minimum(lever, 3.0), np.full(len(arm), told),
    ])  # fmt: skip


class MotionFeatures:
    """The features of a clothed character, frame by frame; `advance` with one pose after the other.

    Args:
        clothed: The character.
        nodes: Its nodes.
        first: The first pose, `[R | t]` of the joints (Eq. 1), shape (22, 3, 4); what lies before it is taken to be at
            rest there.
        fps: Frames a second [1/s].
    """

    def __init__(self, clothed: ClothedCharacter, nodes: ApparelNodes, first: np.ndarray, fps: float = RATE):
        self.clothed, self.nodes, self.size = clothed, nodes, np.float32(clothed.scale)
        self.points: BodyPoints = body_points(clothed)
        rest_gap = nearest_point(nodes.rest, self.points.rest, self.points.normals)[0]
        self.gap = np.minimum(rest_gap, CLEAR * self.size)
        self.push = np.zeros((len(nodes), 3), np.float32)
        self.follow = np.float32(1 - np.exp(-1 / (fps * 0.2)))
        self.before = np.asarray(first[:, :, :3], np.float32)
        self.fps = fps
        positions, turns = self._carried(self._affine(first))
        self.filters = MotionFilters(positions / self.size, first[:, :, :3], fps)
        self.pendulums = Pendulums(positions / self.size, nodes.held / self.size, turns, clothed.scale, fps)
        swing, self.repeated = node_swing(clothed, nodes), np.tile(np.arange(len(nodes)), len(OWN))
        ease, calm = np.repeat(np.array(OWN), len(nodes), axis=0).T
        self.own = OwnPendulum(
            swing.take(self.repeated), positions[self.repeated], turns[self.repeated], fps, ease, calm
        )
        self.swung = np.zeros((len(nodes), 3), np.float32)

    def _affine(self, transforms: np.ndarray) -> np.ndarray:
        return eq4_transforms(transforms[None], self.clothed.joints)[0]

    def _carried(self, affine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        blend = (self.nodes.weights @ affine.reshape(JOINT_COUNT, 12)).reshape(-1, 3, 4)
        return _turned(blend[..., :3], self.nodes.rest) + blend[..., 3], affine[self.nodes.joint, :, :3]

    def advance(self, transforms: np.ndarray) -> Frame:
        """The features of the next frame.

        Args:
            transforms: `[R | t]` of the joints, shape (22, 3, 4).
        """
        nodes, size = self.nodes, self.size
        affine = self._affine(np.asarray(transforms, np.float32))
        positions, turns = self._carried(affine)
        joints = np.asarray(transforms[:, :, :3], np.float32)
        velocity, acceleration = self.filters.advance(positions / size, joints)
        held = nodes.held / size
        up = turns[:, 1, :]
        tilt = _tilted(held, up) - held
        body = self.points.posed(affine)
        near, normal = nearest_point(positions, *body)
        near_hang, normal_hang = nearest_point(positions + size * _turned(turns, tilt), *body)
        late = [_turned(late[nodes.joint], held) for late in self.filters.late]
        spun = _cross(self._spin(joints)[nodes.joint], _turned(turns, held))
        swung = self.pendulums.advance(positions / size, turns)
        own = self.own.advance(positions[self.repeated], turns[self.repeated]).reshape(len(OWN), -1, 3) / size
        own_velocity, self.swung = (own[0] - self.swung) * self.fps, own[0]
        world = np.stack(
            [
                *self.filters.sway, *late, *swung, normal, normal_hang, spun * 0.2, velocity * 0.3, acceleration * 0.05,
                *own, own_velocity * 0.3,
            ],
            axis=2,
        )  # fmt: skip
        inside = np.matmul(turns.transpose(0, 2, 1), world).transpose(0, 2, 1)
        sways, count = len(FREQUENCIES), len(FREQUENCIES) + len(LAGS) + len(PENDULUMS)
        late_inside = inside[:, sways : sways + len(LAGS)] - held[:, None]
        normals = inside[:, count : count + 2]
        gaps = np.stack([near, near_hang], axis=1)
        push = normals * (np.clip(self.gap[:, None] - gaps, 0, 0.4 * size) / size)[..., None]
        self.push = self.push + self.follow * (push[:, 0] - self.push)
        vectors = np.concatenate(
            [
                inside[:, :sways], late_inside, inside[:, sways + len(LAGS) : count], tilt[:, None], push,
                self.push[:, None], inside[:, count + 5 : count + 5 + len(OWN)], up[:, None],
                inside[:, count + 2 : count + 5], normals, inside[:, count + 5 + len(OWN) :],
            ],
            axis=1,
        )  # fmt: skip
        bent = self.own.bent[:, : len(nodes)]
        scalars = np.column_stack([
            np.clip(gaps / size, -0.3, 0.3) * 5, np.sqrt((bent**2).sum(axis=0)),
            np.minimum(self.own.beyond[: len(nodes)], 1.0),
        ])  # fmt: skip
        return Frame(
            vectors.astype(np.float32),
            scalars.astype(np.float32),
            _whole(transforms, float(size)),
            turns,
            positions,
            body,
        )

    def _spin(self, joints: np.ndarray) -> np.ndarray:
        """How fast each joint turns [rad/s], shape (22, 3)."""
        change = np.matmul(joints, self.before.transpose(0, 2, 1)) * self.fps
        self.before = joints
        return np.stack(
            [change[:, 2, 1] - change[:, 1, 2], change[:, 0, 2] - change[:, 2, 0], change[:, 1, 0] - change[:, 0, 1]],
            axis=1,
        ) / 2  # fmt: skip


def _turned(turns: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """A rotation for each vector, shapes (M, 3, 3) and (M, 3) -> (M, 3)."""
    return np.asarray((turns * vectors[:, None, :]).sum(axis=-1))


def _tilted(vectors: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Vectors turned by the least turn that takes +Y to `up`; near to head over heels by less than that."""
    axis = np.stack([up[:, 2], np.zeros(len(up)), -up[:, 0]], axis=1)  # +Y x up
    once = _cross(axis, vectors)
    return np.asarray(vectors + once + _cross(axis, once) / np.maximum(1 + up[:, 1], 0.15)[:, None])


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """`np.cross` of (M, 3) arrays, without its overhead."""
    ax, ay, az = a.T
    bx, by, bz = b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def _whole(transforms: np.ndarray, size: float) -> np.ndarray:
    """T seen from the pelvis: positions over the size and the first two columns of the rotations; and the up axis."""
    root = transforms[0, :, :3]
    positions = (transforms[:, :, 3] - transforms[0, :, 3]) @ root / size
    turns = np.einsum("ba,jbc->jac", root, transforms[:, :, :3])[:, :, :2]
    joints = np.concatenate([positions, turns.transpose(0, 2, 1).reshape(-1, 6)], axis=1)
    return np.append(joints.reshape(-1), root[1]).astype(np.float32)


def mirror_global(whole: np.ndarray) -> np.ndarray:
    """`Frame.whole` of the mirror image in the plane x = 0, shape (..., GLOBAL)."""
    joints = whole[..., :-3].reshape(*whole.shape[:-1], JOINT_COUNT, 9)[..., list(JOINT_MIRROR), :]
    sign = np.array([-1, 1, 1, 1, -1, -1, -1, 1, 1], whole.dtype)
    up = whole[..., -3:] * np.array([-1, 1, 1], whole.dtype)
    return np.concatenate([(joints * sign).reshape(*whole.shape[:-1], -1), up], axis=-1)


def clip_features(clothed: ClothedCharacter, nodes: ApparelNodes, transforms: np.ndarray) -> list[Frame]:
    """Features of all frames of a clip at 30 frames a second that begins from the rest pose, after `LEAD_IN` frames
    that lead there.

    Args:
        clothed: The character.
        nodes: Its nodes.
        transforms: `[R | t]` of the joints, shape (N, 22, 3, 4).
    """
    start = rest_transforms(clothed.joints, transforms[0])
    state = MotionFeatures(clothed, nodes, start)
    for pose in lead_in_transforms(clothed.joints, transforms[0], LEAD_IN):
        state.advance(pose)
    return [state.advance(pose) for pose in transforms]
