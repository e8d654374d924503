"""A gesture as motion of the reference body's 22 joints: its key poses as arrays, all frames posed at once, and the
standing person who makes it, captured or made by code.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bunraku.core.body.layout import JOINT_COUNT, JOINT_MIRROR, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import (
    axis_angle_from_matrix,
    heading,
    matrix_from_axis_angle,
    matrix_y,
    nearest_rotation,
)
from bunraku.core.motion import SkeletalMotion, local_rotations
from bunraku.gestures.pose import HANGING, STEP, Foot, Gesture, Hand, Key, Pose

AT = {name: index for index, name in enumerate(JOINT_NAMES)}
"""Numbers of the joints by their names."""
SIDES = (("left", 1.0), ("right", -1.0))
"""Both sides, with the sign of x on them."""
PALM = 0.09
"""From the wrist to the middle of the palm, chosen by eye on sheets of gestures [m]."""
ANKLE, APART, BESIDE, TURNED = 0.035, 0.55, 0.12, 30.0
"""How far an ankle of a standing foot is from its height at rest at the most, how far apart feet are at the most, and
from side to side at the least [m], and how far the head is turned from the pelvis at the most [degrees]; chosen by eye.
"""
_STILL = np.tile(np.eye(3), (JOINT_COUNT, 1, 1))


@dataclass(frozen=True)
class Hanging:
    """A hand that does nothing, in N frames."""

    palm: np.ndarray  # in the frame of the chest, from its joint [m], shape (N, 3)
    ways: np.ndarray  # where fingers point, palm faces and elbow is bent, in that frame, shape (N, 3, 3)


@dataclass(frozen=True)
class Planted:
    """A foot that stands, in N frames."""

    ankle: np.ndarray  # position [m], shape (N, 3)
    knee: np.ndarray  # direction to which the knee is bent, shape (N, 3)
    rotation: np.ndarray  # of the foot in the world, shape (N, 3, 3)
    toes: np.ndarray  # of the toes in the world, shape (N, 3, 3)


@dataclass(frozen=True)
class Standing:
    """A standing person in N frames, facing +z."""

    hips: np.ndarray  # where the pelvis is from where it is at rest [m], shape (N, 3)
    # of the joints relative to their parents; those of arms and legs are not read, shape (N, 22, 3, 3)
    rotations: np.ndarray
    lean: np.ndarray  # added to that of the keys, shape (N, 3) [degrees]
    head: np.ndarray  # the same of the head
    hands: dict[str, Hanging | None]  # by side; None where they hang as the keys say
    feet: dict[str, Planted | None]  # by side; None where they stand as the keys say
    sways: bool = False  # the pelvis sways even where the feet step


def still(frames: int) -> Standing:
    """A person who does not move at all, for this many frames."""
    none = np.zeros((frames, 3))
    return Standing(none, np.tile(_STILL, (frames, 1, 1, 1)), none, none, *_as_keys())


def _as_keys() -> tuple[dict[str, Hanging | None], dict[str, Planted | None]]:
    """Hands and feet that are as the keys say."""
    return {side: None for side, _ in SIDES}, {side: None for side, _ in SIDES}


def swaying(seed: int, moments: np.ndarray) -> Standing:
    """Small slow movements of a standing person, made by code.

    Args:
        seed: Of their phases.
        moments: Of the frames, shape (N,) [s].
    """
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, 6)
    slow = np.array([0.17, 0.13, 0.27, 0.11, 0.19, 0.15])  # breaths are the third, sixteen a minute
    # of the pelvis to the left and ahead [m], the lean of the chest and the three angles of the head [degrees]
    large = np.array([0.010, 0.006, 0.9, 1.5, 2.0, 1.0])
    sway = large * np.sin(2 * np.pi * slow * moments[:, None] + phases)
    none = np.zeros(len(moments))
    hips, lean = np.stack([sway[:, 0], none, sway[:, 1]], axis=1), np.stack([sway[:, 2], none, none], axis=1)
    return Standing(hips, np.tile(_STILL, (len(moments), 1, 1, 1)), lean, sway[:, 3:], *_as_keys(), sways=True)


def stands_well(motion: SkeletalMotion) -> bool:
    """Whether both feet stand flat side by side in all frames and the head looks ahead, as a gesture needs it."""
    rest = reference_body().joints
    rotations, positions = motion.world()
    across = positions[:, AT["left_hip"]] - positions[:, AT["right_hip"]]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    looks = (rotations[:, AT["head"], :, 2] * across).sum(axis=1)
    ankles = positions[:, [AT["left_ankle"], AT["right_ankle"]]]
    level = np.abs(ankles[..., 1] - rest[AT["left_ankle"], 1]).max() < ANKLE
    beside = ((ankles[:, 0] - ankles[:, 1]) * across).sum(axis=1).min() > BESIDE
    ahead = np.abs(looks).max() < np.sin(np.radians(TURNED))
    return bool(level and beside and ahead and np.linalg.norm(ankles[:, 0] - ankles[:, 1], axis=1).max() < APART)


def mirrored(motion: SkeletalMotion) -> SkeletalMotion:
    """The mirror image of a motion of the reference body's 22 joints."""
    flip = np.array([-1.0, 1, 1])
    rotations = motion.rotations[:, list(JOINT_MIRROR)] * np.outer(flip, flip)
    return SkeletalMotion(motion.skeleton, rotations, motion.root_translation * flip, motion.fps)


def captured(motion: SkeletalMotion, at: np.ndarray) -> Standing:
    """A person who was captured standing.

    Args:
        motion: Of the reference body's 22 joints, at rest where its feet are.
        at: Frames of it, which need not be whole, shape (N,).
    """
    last = len(motion) - 1
    low = np.clip(at.astype(int), 0, max(last - 1, 0))
    share = np.clip(at - low, 0, 1)
    high = np.minimum(low + 1, last)
    rest = reference_body().joints.astype(float)
    rotations, positions = (value.astype(float) for value in motion.world())
    facing = matrix_y(np.array(-np.mean(heading(rotations[:, 0], motion.fps))))
    ankles = positions[:, [AT["left_ankle"], AT["right_ankle"]]].mean(axis=(0, 1))
    positions = (positions - ankles * [1, 0, 1]) @ facing.T
    rotations = facing @ rotations
    mixed = (1 - share)[:, None, None, None] * rotations[low] + share[:, None, None, None] * rotations[high]
    world = _orthonormal(mixed)
    where = (1 - share)[:, None, None] * positions[low] + share[:, None, None] * positions[high]
    parents = motion.skeleton.parents
    local = world.copy()
    local[:, 1:] = np.swapaxes(world[:, parents[1:]], -1, -2) @ world[:, 1:]
    hands: dict[str, Hanging | None] = {}
    feet: dict[str, Planted | None] = {}
    chest = AT["spine3"]
    for side, sign in SIDES:
        wrist, elbow, shoulder = (AT[f"{side}_{part}"] for part in ("wrist", "elbow", "shoulder"))
        pointing = world[:, wrist] @ [sign, 0, 0]
        bent = _aside(where[:, shoulder], where[:, elbow], where[:, wrist], world[:, shoulder] @ [0, 0, -1.0])
        ways = np.stack([pointing, world[:, wrist] @ [0, -1.0, 0], bent], axis=1)
        palm = where[:, wrist] + PALM * pointing - where[:, chest]
        hands[side] = Hanging((palm[:, None] @ world[:, chest])[:, 0], ways @ world[:, chest])
        ankle, toes = AT[f"{side}_ankle"], AT[f"{side}_foot"]
        # knees bend over the toes when the person sits down, wherever those of a straight leg happen to point
        bend = world[:, ankle] @ [0.15 * sign, 0, 1.0] * [1, 0, 1]
        feet[side] = Planted(where[:, ankle], bend, world[:, ankle], world[:, toes])
    still = np.zeros((len(at), 3))
    return Standing(where[:, 0] - rest[0], local, still, still, hands, feet)


def _orthonormal(matrices: np.ndarray) -> np.ndarray:
    """Rotations nearest to means of two that are near each other."""
    first = matrices[..., 0] / np.linalg.norm(matrices[..., 0], axis=-1, keepdims=True)
    second = matrices[..., 1] - (matrices[..., 1] * first).sum(-1, keepdims=True) * first
    second = second / np.linalg.norm(second, axis=-1, keepdims=True)
    return np.stack([first, second, np.cross(first, second)], axis=-1)


def _aside(start: np.ndarray, bend: np.ndarray, end: np.ndarray, straight: np.ndarray) -> np.ndarray:
    """To where a limb is bent; where it is straight, to where it would be, unit vectors (N, 3)."""
    along = end - start
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    off = bend - start
    off = off - (off * along).sum(1, keepdims=True) * along
    off = off + 0.02 * (straight - (straight * along).sum(1, keepdims=True) * along)
    return np.asarray(off / np.maximum(np.linalg.norm(off, axis=1, keepdims=True), 1e-9))


CARRIERS: dict[str, int | None] = {"head": AT["head"], "chest": AT["spine3"], "hips": AT["pelvis"], "ground": None}
"""The joint that carries a hand, by what carries it; none for the ground."""


@dataclass(frozen=True)
class HandTrack:
    """A hand in L key poses."""

    palm: np.ndarray  # shape (L, 3) [m]
    # unit vectors: where fingers point, where the palm faces, to where the elbow is bent, shape (L, 3, 3)
    ways: np.ndarray
    on: np.ndarray  # what carries it (the number of a row of `CARRIERS`), shape (L,)
    rests: np.ndarray  # whether it hangs as that of a body that only stands, shape (L,)
    raised: np.ndarray  # how far the shoulder goes up and ahead with it [degrees], shape (L, 2)

    @classmethod
    def of(cls, hands: Sequence[Hand]) -> HandTrack:
        """The hands of some poses."""
        ways = np.array([[hand.fingers, hand.faces, hand.elbow] for hand in hands], float)
        return cls(
            np.array([hand.palm for hand in hands], float),
            ways / np.linalg.norm(ways, axis=-1, keepdims=True),
            np.array([list(CARRIERS).index(hand.on) for hand in hands]),
            np.array([replace(hand, on=HANGING.on) == HANGING for hand in hands]),
            np.array([_raised(hand) for hand in hands]),
        )


@dataclass(frozen=True)
class FootTrack:
    """A foot in L key poses."""

    ankle: np.ndarray  # shape (L, 3) [m]
    knee: np.ndarray  # direction to which the knee is bent, shape (L, 3)
    pitch: np.ndarray  # how far the heel is up over the toes, shape (L,) [degrees]
    turn: np.ndarray  # how far the toes point outwards, shape (L,) [degrees]
    rests: np.ndarray  # whether it stands as that of a body that only stands, shape (L,)

    @classmethod
    def of(cls, feet: Sequence[Foot]) -> FootTrack:
        """The feet of some poses."""
        ankle, knee, pitch, turn = (
            np.array([getattr(foot, name) for foot in feet], float) for name in ("ankle", "knee", "pitch", "turn")
        )
        return cls(ankle, knee, pitch, turn, np.array([foot == Foot() for foot in feet]))


@dataclass(frozen=True)
class Tracks:
    """L key poses (`pose.Pose` says what the fields mean), shapes (L, 3) and (L,)."""

    lean: np.ndarray
    head: np.ndarray
    shrug: np.ndarray
    hips: np.ndarray
    turn: np.ndarray
    tilt: np.ndarray
    hands: dict[str, HandTrack]
    feet: dict[str, FootTrack]

    @classmethod
    def of(cls, keys: Sequence[Key]) -> Tracks:
        """The poses of some keys."""
        columns = {name: [getattr(pose, name) for _, pose in keys] for name in Pose.__dataclass_fields__}
        hands = {side: HandTrack.of(columns[side]) for side, _ in SIDES}
        feet = {side: FootTrack.of(columns[f"{side}_foot"]) for side, _ in SIDES}
        lean, head, shrug, hips, turn, tilt = (
            np.array(columns[name], float) for name in ("lean", "head", "shrug", "hips", "turn", "tilt")
        )
        return cls(lean, head, shrug, hips, turn, tilt, hands, feet)


def _raised(hand: Hand) -> tuple[float, float]:
    """How far a shoulder goes up and ahead with its hand [degrees]."""
    _, height, ahead = hand.palm
    if hand.on == "ground":
        return 0.0, 0.0
    return 18 * float(np.clip((height - 1.45) / 0.45, 0, 1)), 10 * float(np.clip((ahead - 0.3) / 0.4, 0, 1))


FPS = 20.0
_AHEAD, _ROLLED, _TOES = 0.15, 0.6, 65.0
"""How far ahead of the straight way a hand goes, over that way's length, the share of its roll that the forearm takes,
and how far toes bend up [degrees]; chosen by eye.
"""

# Chosen by eye on sheets of gestures.
SPINE, _SHARES = ("spine1", "spine2", "spine3", "neck", "head"), (0.3, 0.35, 0.35, 0.4, 0.6)
"""Its joints, and the share of each: three of the trunk's lean and two of the head's."""


@functools.cache  # gestures are constants of the catalogue
def gesture_motion(gesture: Gesture, fps: float = FPS) -> SkeletalMotion:
    """The motion of a gesture, which begins and ends where its keys say; feet stand on y = 0.

    Args:
        gesture: What is done.
        fps: Frames a second [1/s].
    """
    moments = np.minimum(np.arange(round(gesture.seconds * fps) + 1) / fps, gesture.seconds)
    seed = int.from_bytes(hashlib.sha256(gesture.name.encode()).digest()[:8], "little")
    return posed(Tracks.of(gesture.keys), _times(gesture.keys), moments, swaying(seed, moments), fps)


def _times(keys: Sequence[Key]) -> np.ndarray:
    return np.array([time for time, _ in keys])


def posed(tracks: Tracks, times: np.ndarray, moments: np.ndarray, standing: Standing, fps: float) -> SkeletalMotion:
    """The motion through key poses.

    Args:
        tracks: L key poses.
        times: When each is reached, rising, shape (L,) [s].
        moments: Of the frames, shape (N,) [s].
        standing: The person, in those frames.
        fps: Frames a second [1/s].
    """
    body = reference_body()
    rest = body.joints.astype(float)
    after = np.clip(np.searchsorted(times, moments, side="right"), 1, max(len(times) - 1, 1))
    after = np.minimum(after, len(times) - 1)
    before = np.maximum(after - 1, 0)
    span = times[after] - times[before]
    share = np.clip((moments - times[before]) / np.maximum(span, 1e-6), 0, 1)
    # poses a twentieth of a second apart flow through each other; others are reached at minimum jerk
    share = np.where(span > 1.5 * STEP, share**3 * (10 - 15 * share + 6 * share**2), share)
    world, root = _posed(_Between(tracks, before, after, share), standing, rest)
    return SkeletalMotion(body.skeleton, local_rotations(world, np.array(JOINT_PARENTS)), root, fps)


class _Between:
    """Key poses before and after each frame."""

    def __init__(self, tracks: Tracks, before: np.ndarray, after: np.ndarray, share: np.ndarray):
        self.tracks, self.before, self.after, self.share = tracks, before, after, share

    def of(self, values: np.ndarray) -> np.ndarray:
        """Values of the keys in each frame."""
        return self.mixed(values[self.before], values[self.after])

    def mixed(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Values of the frames of the key before and of the one after."""
        share = self.share.reshape(-1, *[1] * (one.ndim - 1))
        return (1 - share) * one + share * other


def _posed(keys: _Between, standing: Standing, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World rotations of the joints (N, 22, 3, 3) and the root's position (N, 3)."""
    tracks = keys.tracks
    local = standing.rotations.copy()
    upright = np.clip(1 - np.abs(keys.of(tracks.tilt)) / 20, 0, 1)  # a body that lies does not sway
    local[:, 1:] = _share(local[:, 1:], upright)
    lean, head = (keys.of(row) + angle for row, angle in ((tracks.lean, standing.lean), (tracks.head, standing.head)))
    bends = _angles(np.stack([part * of for part, of in zip(_SHARES, (lean, lean, lean, head, head), strict=True)]))
    for name, bend in zip(SPINE, bends, strict=True):
        local[:, AT[name]] = local[:, AT[name]] @ bend
    shrug = keys.of(tracks.shrug)
    for side, sign in SIDES:
        raised = keys.of(tracks.hands[side].raised)
        turns = np.stack([0 * shrug, -sign * raised[:, 1], sign * (22 * shrug + raised[:, 0])], axis=1)
        local[:, AT[f"{side}_collar"]] = local[:, AT[f"{side}_collar"]] @ _angles(turns)
    pelvis = np.stack([keys.of(tracks.tilt), keys.of(tracks.turn), 0 * shrug], axis=1)
    stands = np.minimum(*[keys.of(tracks.feet[side].rests.astype(float)) for side, _ in SIDES])[:, None]
    local[:, 0] = _share(local[:, 0], stands[:, 0]) @ _angles(pelvis)
    position = rest[0] + keys.of(tracks.hips) + np.maximum(stands, standing.sways) * standing.hips
    world, where = local.copy(), np.empty((len(local), JOINT_COUNT, 3))
    where[:, 0] = position
    for joint in range(1, JOINT_COUNT):
        parent = JOINT_PARENTS[joint]
        world[:, joint] = world[:, parent] @ local[:, joint]
        where[:, joint] = where[:, parent] + world[:, parent] @ (rest[joint] - rest[parent])
    for side, sign in SIDES:
        _set_arm(world, where, rest, side, sign, keys, standing)
        _set_leg(world, where, rest, side, sign, keys, standing)
    return world, position


def _share(rotations: np.ndarray, share: np.ndarray) -> np.ndarray:
    """A share of rotations, shape (N, ..., 3, 3) and (N,)."""
    if (share == 1).all():
        return rotations
    return matrix_from_axis_angle(axis_angle_from_matrix(rotations) * share.reshape(-1, *[1] * (rotations.ndim - 2)))


def _angles(degrees: np.ndarray) -> np.ndarray:
    """Pitch ahead, yaw to the left, roll to the right side, as one rotation, shape (..., 3) -> (..., 3, 3)."""
    x, y, z = np.moveaxis(matrix_from_axis_angle(np.radians(degrees)[..., None] * np.eye(3)), -3, 0)
    return np.asarray(y @ x @ z)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9))


def _across(vectors: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Unit vectors of what is at right angles to axes."""
    return _unit(vectors - axis * (vectors * axis).sum(axis=-1, keepdims=True))


def _frame(along: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """Rotations whose first column is `along` and whose second is nearest to `beside`, shape (..., 3, 3)."""
    along, beside = np.broadcast_arrays(_unit(along), beside)
    second = _across(beside, along)
    return np.stack([along, second, np.cross(along, second)], axis=-1)


def _bent(start: np.ndarray, goal: np.ndarray, one: float, two: float, towards: np.ndarray) -> np.ndarray:
    """Where the joint between two bones is that reach from a start towards a goal, bent towards a direction, (N, 3)."""
    direction = goal - start
    reach = np.clip(np.linalg.norm(direction, axis=-1, keepdims=True), abs(one - two) + 1e-3, 0.998 * (one + two))
    along = _unit(direction)
    cosine = (one**2 + reach**2 - two**2) / (2 * one * reach)
    sine = np.sqrt(np.maximum(1 - cosine**2, 0))
    return np.asarray(start + one * (cosine * along + sine * _across(towards, along)))


def _set_arm(
    world: np.ndarray, where: np.ndarray, rest: np.ndarray, side: str, sign: float, keys: _Between, standing: Standing
) -> None:
    """Turns the joints of an arm, in place."""
    shoulder, elbow, wrist = (AT[f"{side}_{name}"] for name in ("shoulder", "elbow", "wrist"))
    hand, outward = keys.tracks.hands[side], np.array([dict(SIDES)[side], 1, 1])
    hanging = standing.hands[side]
    ends = []
    for which in (keys.before, keys.after):
        palm, ways = outward * hand.palm[which], outward * hand.ways[which]
        for carrier, joint in enumerate(CARRIERS.values()):
            carried = hand.on[which] == carrier
            if joint is None or not carried.any():
                continue
            turn = world[carried, joint]
            palm[carried] = where[carried, joint] + (turn @ (palm[carried] - rest[joint])[..., None])[..., 0]
            ways[carried] = ways[carried] @ np.swapaxes(turn, -1, -2)
        if hanging is not None:
            carried = hand.rests[which]
            chest = AT["spine3"]
            turn = world[carried, chest]
            palm[carried] = where[carried, chest] + (turn @ hanging.palm[carried][..., None])[..., 0]
            ways[carried] = hanging.ways[carried] @ np.swapaxes(turn, -1, -2)
        ends.append((palm, ways))
    length = np.linalg.norm(ends[1][0] - ends[0][0], axis=1) * ~(hand.rests[keys.before] & hand.rests[keys.after])
    arc = _AHEAD * length * np.sin(np.pi * keys.share)
    palm = keys.mixed(ends[0][0], ends[1][0]) + arc[:, None] * world[:, AT["spine3"], :, 2]
    pointing, facing, towards = (_unit(keys.mixed(ends[0][1], ends[1][1])[:, part]) for part in range(3))
    goal = palm - PALM * pointing
    upper_length = float(np.linalg.norm(rest[elbow] - rest[shoulder]))
    two = float(np.linalg.norm(rest[wrist] - rest[elbow]))
    bend = _bent(where[:, shoulder], goal, upper_length, two, towards)
    reached = bend + two * _unit(goal - bend)
    out, back, down = np.array([sign, 0, 0]), np.array([0, 0, -1.0]), np.array([0, -1.0, 0])
    hinge = _across(towards, _unit(goal - where[:, shoulder]))
    world[:, shoulder] = _frame(bend - where[:, shoulder], hinge) @ _frame(out, back).T
    forearm = _frame(reached - bend, hinge) @ _frame(out, back).T
    turned = _frame(pointing, facing) @ _frame(out, down).T
    along = _unit(reached - bend)
    roll = (axis_angle_from_matrix(turned @ np.swapaxes(forearm, -1, -2)) * along).sum(axis=1, keepdims=True)
    world[:, elbow] = matrix_from_axis_angle(_ROLLED * roll * along) @ forearm
    world[:, wrist] = turned
    where[:, elbow], where[:, wrist] = bend, reached


def _set_leg(
    world: np.ndarray, where: np.ndarray, rest: np.ndarray, side: str, sign: float, keys: _Between, standing: Standing
) -> None:
    """Turns the joints of a leg, in place; feet stand in the world."""
    hip, knee, ankle, toes = (AT[f"{side}_{name}"] for name in ("hip", "knee", "ankle", "foot"))
    foot, outward = keys.tracks.feet[side], np.array([dict(SIDES)[side], 1, 1])
    planted = standing.feet[side]
    ends = []
    for which in (keys.before, keys.after):
        goal, towards = outward * foot.ankle[which], outward * foot.knee[which]
        if planted is not None:
            own = foot.rests[which]
            goal[own], towards[own] = planted.ankle[own], planted.knee[own]
        ends.append((goal, towards))
    goal, towards = (keys.mixed(*pair) for pair in zip(*ends, strict=True))
    upper_length = float(np.linalg.norm(rest[knee] - rest[hip]))
    two = float(np.linalg.norm(rest[ankle] - rest[knee]))
    bend = _bent(where[:, hip], goal, upper_length, two, towards)
    down, ahead = np.array([0, -1.0, 0]), np.array([0, 0, 1.0])
    world[:, hip] = _frame(bend - where[:, hip], towards) @ _frame(down, ahead).T
    world[:, knee] = _frame(goal - bend, towards) @ _frame(down, ahead).T
    pitch, turn = keys.of(foot.pitch), sign * keys.of(foot.turn)
    world[:, ankle] = _angles(np.stack([pitch, turn, 0 * turn], axis=1))
    # toes stay on the ground where the heel is up, as far as they bend
    bent = np.where(pitch > 0, np.maximum(0.2 * pitch, pitch - _TOES), pitch)
    world[:, toes] = _angles(np.stack([bent, turn, 0 * turn], axis=1))
    if planted is not None:
        share = keys.of(foot.rests.astype(float))[:, None, None]
        for joint, own in ((ankle, planted.rotation), (toes, planted.toes)):
            world[:, joint] = nearest_rotation((1 - share) * world[:, joint] + share * own)
