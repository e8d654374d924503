"""Inputs of the displacement network: oscillators and pendulums that hang on the motion, and a lead-in from rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.constants import g

from bunraku.apparel.body import BodyPoints, body_points, eq4_transforms, nearest_point
from bunraku.apparel.clothed import GRAVITY, RATE, ClothedCharacter, Swing
from bunraku.apparel.nodes import ApparelNodes, node_swing
from bunraku.apparel.physics.rig import SHORTEST, PhysicsSettings
from bunraku.apparel.physics.simulate import BLEND
from bunraku.core.body.layout import JOINT_COUNT, JOINT_PARENTS
from bunraku.core.geometry.rotations import matrix_from_quaternion, matrix_y, quaternion_from_matrix, quaternion_slerp

# What follows is part of what the displacement networks were trained on; other values need other weights.
FREQUENCIES = (0.4, 0.7, 1.2, 2.0, 3.4)
"""Of the oscillators [1/s]: apparel of the wardrobe swings at 0.6 on average, stiff pieces at 4."""
DAMPING = 0.3
LAGS = (0.08, 0.25, 0.8)  # time constants with which a lagging rotation follows [s]
PENDULUMS = ((0.0, 3.0), (20.0, 3.0), (80.0, 5.0), (200.0, 12.0))
"""Of each, the stiffness of the spring to its carried position [1/s^2] and the damping [1/s], for a unit of mass."""
SUBSTEPS = 4


class MotionFilters:
    """The filters' state for M carried nodes (M, 3), over the character's size, and J joints' rotations (J, 3, 3)."""

    def __init__(self, positions: np.ndarray, turns: np.ndarray, fps: float = 30.0):
        self.step = 1 / fps
        self.omega = 2 * np.pi * np.array(FREQUENCIES, np.float32)[:, None, None]
        self.positions = np.stack([positions, positions]).astype(np.float32)  # the last two
        self.sway = np.zeros((len(FREQUENCIES), len(positions), 3), np.float32)
        self.speed = np.zeros_like(self.sway)
        self.late = np.repeat(np.asarray(turns, np.float32)[None], len(LAGS), axis=0)
        self.follow = (1 - np.exp(-self.step / np.array(LAGS, np.float32)))[:, None, None, None]

    def advance(self, positions: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The next frame: velocity and acceleration of the nodes, shape (M, 3) each; `sway` and `late` hold the rest.
        The sway y of each oscillator is where a mass on a spring is, seen from its carrier: `y'' + 2 zeta omega y' +
        omega^2 y = -p''`, by semi-implicit Euler steps.
        """
        velocity = (positions - self.positions[1]) / self.step
        acceleration = (positions - 2 * self.positions[1] + self.positions[0]) / self.step**2
        force = -acceleration - 2 * DAMPING * self.omega * self.speed - self.omega**2 * self.sway
        self.speed += self.step * force
        self.sway += self.step * self.speed
        self.late += self.follow * (turns - self.late)
        self.positions = np.stack([self.positions[1], np.asarray(positions, np.float32)])
        return velocity, acceleration


class Pendulums:
    """Masses on rods of fixed length, which hang where the parts of the nodes are held, under gravity, with damping
    against their carrier and springs to where it takes them.

    Args:
        positions: Of the M carried nodes in the first frame, over the character's size, shape (M, 3).
        held: From where its part is held to each node, over the size, shape (M, 3).
        turns: Frames of the carrying joints, shape (M, 3, 3).
    """

    def __init__(self, positions: np.ndarray, held: np.ndarray, turns: np.ndarray, size: float, fps: float = 30.0):
        count = len(PENDULUMS)
        self.held, self.step = np.asarray(held, np.float32), np.float32(1 / (fps * SUBSTEPS))
        self.length = np.linalg.norm(self.held, axis=1)[:, None].astype(np.float32)
        self.spring, self.damping = np.array(PENDULUMS, np.float32).T[:, :, None, None]
        self.gravity = np.array([0, -g / size, 0], np.float32)
        self.positions = np.asarray(positions, np.float32)
        self.rods = np.matmul(turns, self.held[..., None])[..., 0].astype(np.float32)
        self.points = np.repeat(self.positions[None], count, axis=0)
        self.speed = np.zeros_like(self.points)

    def advance(self, positions: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """The next frame: positions of the masses from the carried nodes, in the world over the size, shape (P, M, 3),
        by semi-implicit Euler steps, after each of which the rods have their lengths again.
        """
        positions = np.asarray(positions, np.float32)
        rods = np.matmul(turns, self.held[..., None])[..., 0].astype(np.float32)
        carried = (positions - self.positions) / (self.step * SUBSTEPS)
        for number in range(1, SUBSTEPS + 1):
            share = np.float32(number / SUBSTEPS)
            here = self.positions + share * (positions - self.positions)
            hung = here - (self.rods + share * (rods - self.rods))
            force = self.gravity - self.spring * (self.points - here) - self.damping * (self.speed - carried)
            self.speed += self.step * force
            away = self.points + self.step * self.speed - hung
            away *= self.length / np.maximum(np.sqrt(np.einsum("pma,pma->pm", away, away))[..., None], 1e-6)
            self.speed = (hung + away - self.points) / self.step
            self.points = hung + away
        self.positions, self.rods = positions, rods
        return self.points - positions


def rest_transforms(joints: np.ndarray, first: np.ndarray) -> np.ndarray:
    """`[R | t]` of the rest pose with joints J (22, 3) at a frame's position and heading, both shape (22, 3, 4)."""
    mean = first[:, :, :3].mean(axis=0)
    yaw = np.asarray(matrix_y(np.array(np.arctan2(mean[0, 2] - mean[2, 0], mean[0, 0] + mean[2, 2]))))
    positions = joints @ yaw.T
    positions = positions + first[:, :, 3].mean(axis=0) - positions.mean(axis=0)
    return np.concatenate([np.broadcast_to(yaw, (JOINT_COUNT, 3, 3)), positions[..., None]], axis=2)


def lead_in_transforms(joints: np.ndarray, first: np.ndarray, frames: int) -> np.ndarray:
    """Frames from the rest pose with joints J (22, 3) to the first frame of a clip, (22, 3, 4), shape (frames, 22, 3,
    4), float32; the pose changes in the first 60 % of them.
    """
    start, end = rest_transforms(joints, first), np.asarray(first, np.float64)
    share = np.clip(np.arange(frames) / max(BLEND * frames, 1), 0, 1)
    share = share * share * (3 - 2 * share)
    parents = np.array(JOINT_PARENTS)
    locals_ = [_local(pose, parents) for pose in (start, end)]
    turns = quaternion_slerp(
        quaternion_from_matrix(locals_[0])[None], quaternion_from_matrix(locals_[1])[None],
        np.broadcast_to(share[:, None], (frames, JOINT_COUNT)),
    )  # fmt: skip
    local = matrix_from_quaternion(turns)
    # bones as in the clip's frame, so that the way ends exactly there
    bones = np.einsum("jba,jb->ja", end[parents, :, :3], end[:, :, 3] - end[parents, :, 3])
    rest_bones = joints - joints[parents]
    world, positions = np.array(local), np.zeros((frames, JOINT_COUNT, 3))
    positions[:, 0] = start[0, :, 3] + share[:, None] * (end[0, :, 3] - start[0, :, 3])
    for joint in range(1, JOINT_COUNT):
        parent = parents[joint]
        world[:, joint] = world[:, parent] @ local[:, joint]
        bone = rest_bones[joint] + share[:, None] * (bones[joint] - rest_bones[joint])
        positions[:, joint] = positions[:, parent] + np.einsum("nab,nb->na", world[:, parent], bone)
    return np.concatenate([world, positions[..., None]], axis=3).astype(np.float32)


def _local(pose: np.ndarray, parents: np.ndarray) -> np.ndarray:
    turns = np.asarray(pose[:, :, :3], np.float64)
    local = np.swapaxes(turns[parents], 1, 2) @ turns
    local[0] = turns[0]
    return np.asarray(local)


# What the networks were trained on.
STIFFEST = 900.0  # spring [1/s^2]


class OwnPendulum:
    """Masses on arms of fixed length that rotate about the pivots of M nodes, which are carried as for `Pendulums`.
    `ease` is a factor on the friction against their carriers, `calm` further such friction [1/s], each of shape (M,) or
    one for all.

    Attributes:
        bent: Rotation of each about its axes [rad], shape (3, M).
        beyond: How much farther it would rotate without limits [rad], shape (M,).
    """

    def __init__(
        self, swing: Swing, positions: np.ndarray, turns: np.ndarray, fps: float = 30.0,
        ease: np.ndarray | float = 1.0, calm: np.ndarray | float = 0.0,
    ):  # fmt: skip
        self.step = 1 / (fps * SUBSTEPS)
        # a column for each node, so that a step is a few long operations
        self.axes = np.asarray(swing.axes, np.float64)
        arm = np.einsum("mba,mb->am", self.axes, swing.arm)
        length = np.linalg.norm(arm, axis=0)
        self.arm, self.length = arm / np.maximum(length, 1e-9), np.maximum(length, SHORTEST)
        self.lever = np.einsum("mba,mb->am", self.axes, swing.lever)
        self.away, self.share = np.asarray(swing.away, np.float64), np.asarray(swing.share, np.float64)
        weight = np.asarray(swing.weight, np.float64)
        fall = GRAVITY * weight / self.length
        self.spring = np.minimum(np.asarray(swing.spring, np.float64), STIFFEST).T
        self.lower, self.upper = np.asarray(swing.lower, np.float64).T, np.asarray(swing.upper, np.float64).T
        self.gravity = np.array([0, -GRAVITY, 0])[:, None] * weight
        least = 2 * PhysicsSettings.least_ratio * np.sqrt(self.spring.mean(axis=0) + fall)
        self.friction = np.maximum(ease * swing.friction, least) + calm
        self.drag = np.asarray(swing.drag, np.float64)
        self.bent, self.beyond = np.zeros((3, len(positions))), np.zeros(len(positions))
        self.frames, self.pivots = self._hung(positions, turns)
        self.points = self.pivots + _out(self.frames, self.arm * self.length)
        self.speed = np.zeros_like(self.points)

    def _hung(self, positions: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        frames = np.matmul(turns, self.axes).transpose(1, 2, 0)
        away = np.matmul(turns, self.away[..., None])[..., 0]
        return np.ascontiguousarray(frames), np.ascontiguousarray((positions - away).T)

    def advance(self, positions: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """The next frame: how far each node is from its carried position, in the world [m], shape (M, 3)."""
        frames, pivots = self._hung(positions, turns)
        frame_change, pivot_change = (frames - self.frames) / SUBSTEPS, (pivots - self.pivots) / SUBSTEPS
        held = (pivot_change + _out(frame_change, self.arm * self.length)) / self.step
        frame, pivot = self.frames, self.pivots
        for _ in range(SUBSTEPS):
            frame, pivot = frame + frame_change, pivot + pivot_change
            pull = _cross_by_axis(_out(frame, -self.spring * self.bent), self.points - pivot)
            force = self.gravity + pull - self.friction * (self.speed - held) - self.drag * self.speed
            away = self.points + self.step * (self.speed + self.step * force) - pivot
            # the least turn from where it is carried to where it would be, within its limits
            turn = _turn(self.arm, (frame * away[:, None]).sum(axis=0))
            self.bent = np.minimum(np.maximum(turn, self.lower), self.upper)
            there = pivot + _out(frame, _rotated_by(self.bent, self.arm) * self.length)
            self.speed = (there - self.points) / self.step
            self.points = there
        self.beyond = _length(turn) - _length(self.bent)
        self.frames, self.pivots = frames, pivots
        return np.ascontiguousarray(_out(frames, self.share * (_rotated_by(self.bent, self.lever) - self.lever)).T)


def _out(frames: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors of frames in the world, shapes (3, 3, M) and (3, M)."""
    return np.asarray((frames * vectors).sum(axis=1))


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("am,am->m", vectors, vectors))


def _cross_by_axis(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Rotation vectors of the least rotations from unit vectors to the directions of others, shape (3, M)."""
    axis = _cross_by_axis(start, end)
    sine = _length(axis)
    angle = np.arctan2(sine, np.einsum("am,am->m", start, end))
    return np.asarray(axis * (angle / np.maximum(sine, 1e-12)))


def _rotated_by(turn: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors rotated by rotation vectors, shapes (3, M)."""
    square = np.einsum("am,am->m", turn, turn)
    angle = np.sqrt(square)
    sine = np.where(angle > 1e-6, np.sin(angle) / np.maximum(angle, 1e-9), 1.0)
    cosine = np.where(angle > 1e-4, (1 - np.cos(angle)) / np.maximum(square, 1e-12), 0.5)
    once = _cross_by_axis(turn, vectors)
    return np.asarray(vectors + sine * once + cosine * _cross_by_axis(turn, once))


LEAD_IN = int(RATE)  # frames from the rest pose into a clip

# What the networks were trained on.
OWN = ((1.0, 0.0), (0.25, 0.0), (1.0, 6.0))
"""Factor on the friction of a node's own pendulums, and further friction [1/s]: its chain if all joints rotate alike;
if the first one rotates most; and if it does not swing on.
"""
BASIS = len(FREQUENCIES) + len(LAGS) + len(PENDULUMS) + 4 + len(OWN)
"""Vectors that a displacement may be made of: sways, lagging rotations, pendulums, the tilt, three pushes out of the
body, and the node's own pendulums.
"""
VECTORS = BASIS + 7
"""Beside these: up, spin, velocity, acceleration, the body's normals at the node and where it hangs, and the velocity
of its own pendulum.
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
    """One frame of a clothed character."""

    # in the frames of the carrying joints, shape (M, VECTORS, 3); the first BASIS of them are a basis of displacements
    vectors: np.ndarray
    # signed distances from the body of the carried node and of where it hangs; how far its own pendulum rotates, and
    # how far it presses against its limits; shape (M, SCALARS)
    scalars: np.ndarray
    whole: np.ndarray  # the body's pose seen from the pelvis, shape (GLOBAL,)
    turns: np.ndarray  # frames R of the carrying joints, shape (M, 3, 3)
    positions: np.ndarray  # carried positions LBS(rest) [m], shape (M, 3)
    body: tuple[np.ndarray, np.ndarray]  # positions and normals of the body's points [m], shape (B, 3) each


def static_features(clothed: ClothedCharacter, nodes: ApparelNodes) -> tuple[np.ndarray, np.ndarray]:
    """What never changes of nodes: vectors (M, STATIC_VECTORS, 3) and numbers (M, STATIC_SCALARS), float32."""
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
        _swing_features(swing, np.linalg.norm(nodes.held, axis=1), clothed.swing is not None),
    ])  # fmt: skip
    return vectors.astype(np.float32), scalars.astype(np.float32)


def _swing_features(swing: Swing, held: np.ndarray, from_file: bool) -> np.ndarray:
    """How nodes swing, as numbers, shape (M, 7): how far by limits and by springs, how fast, how damped, their share,
    their lever over that of the whole part, and whether a file says so.
    """
    arm = np.maximum(np.linalg.norm(swing.arm, axis=1), SHORTEST)
    rate = np.sqrt(GRAVITY * swing.weight / arm + swing.spring.mean(axis=1))
    lever = np.linalg.norm(swing.lever, axis=1) / np.maximum(held, SHORTEST)
    return np.column_stack([
        np.log10(swing.turns() + 1e-3), np.log10(np.maximum(rate, 0.1)),
        np.log10(swing.friction + swing.drag + 0.01), swing.share, np.minimum(lever, 3.0), np.full(len(arm), from_file),
    ])  # fmt: skip


class MotionFeatures:
    """The features of a clothed character, frame by frame; call `advance` with one pose after the other. Before the
    first pose, `[R | t]` of the joints (Eq. 1), shape (22, 3, 4), all is at rest there.
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
        """The features of the next frame, by `[R | t]` of the joints, shape (22, 3, 4)."""
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
        swings = self.own.advance(positions[self.repeated], turns[self.repeated]).reshape(len(OWN), -1, 3) / size
        own_velocity, self.swung = (swings[0] - self.swung) * self.fps, swings[0]
        world = np.stack([
            *self.filters.sway, *late, *swung, normal, normal_hang, spun * 0.2, velocity * 0.3, acceleration * 0.05,
            *swings, own_velocity * 0.3,
        ], axis=2)  # fmt: skip
        inside = np.matmul(turns.transpose(0, 2, 1), world).transpose(0, 2, 1)
        sways, count = len(FREQUENCIES), len(FREQUENCIES) + len(LAGS) + len(PENDULUMS)
        late_inside = inside[:, sways : sways + len(LAGS)] - held[:, None]
        normals = inside[:, count : count + 2]
        gaps = np.stack([near, near_hang], axis=1)
        push = normals * (np.clip(self.gap[:, None] - gaps, 0, 0.4 * size) / size)[..., None]
        self.push = self.push + self.follow * (push[:, 0] - self.push)
        vectors = np.concatenate([
            inside[:, :sways], late_inside, inside[:, sways + len(LAGS) : count], tilt[:, None], push,
            self.push[:, None], inside[:, count + 5 : count + 5 + len(OWN)], up[:, None],
            inside[:, count + 2 : count + 5], normals, inside[:, count + 5 + len(OWN) :],
        ], axis=1)  # fmt: skip
        bent = self.own.bent[:, : len(nodes)]
        scalars = np.column_stack([
            np.clip(gaps / size, -0.3, 0.3) * 5, np.sqrt((bent**2).sum(axis=0)),
            np.minimum(self.own.beyond[: len(nodes)], 1.0),
        ])  # fmt: skip
        return Frame(
            vectors.astype(np.float32), scalars.astype(np.float32), _whole(transforms, float(size)), turns, positions,
            body,
        )  # fmt: skip

    def _spin(self, joints: np.ndarray) -> np.ndarray:
        """Angular velocity of each joint [rad/s], shape (22, 3)."""
        change = np.matmul(joints, self.before.transpose(0, 2, 1)) * self.fps
        self.before = joints
        skew = change - change.transpose(0, 2, 1)
        return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1) / 2


def _turned(turns: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """A rotation for each vector, shapes (M, 3, 3) and (M, 3) -> (M, 3)."""
    return np.asarray((turns * vectors[:, None, :]).sum(axis=-1))


def _tilted(vectors: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Vectors rotated by the least rotation that takes +Y to `up`, by less than that near upside down."""
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
