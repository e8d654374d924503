"""A gesture as motion of the reference body's 22 joints.

Between key poses hands go as people's do, slow at both ends and a little ahead of the straight way; arms and legs are
bent by two-bone inverse kinematics, and a body that only stands sways and breathes.
"""

from __future__ import annotations

import functools
import hashlib
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from bunraku.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.body.reference import reference_body
from bunraku.core.motion import SkeletalMotion, local_rotations
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku_lab.synthetic.gestures.pose import Foot, Gesture, Hand, Pose

__all__ = ["gesture_motion"]

FPS = 20.0
_PALM = 0.09
"""From the wrist to the middle of the palm [m]."""
_AHEAD = 0.15
"""How far ahead of the straight way a hand goes, over that way's length."""
_TOES = 65.0
"""How far toes bend up [degrees]."""
_ROLLED = 0.6
"""Share of the hand's roll that the forearm takes."""
_AT = {name: index for index, name in enumerate(JOINT_NAMES)}
_PARENTS = np.array(JOINT_PARENTS)
_CARRIES = {"head": _AT["head"], "chest": _AT["spine3"], "hips": _AT["pelvis"]}


@functools.cache  # gestures are constants of the catalogue, and half a second each
def gesture_motion(gesture: Gesture, fps: float = FPS) -> SkeletalMotion:
    """The motion of a gesture, which begins and ends where its keys say; feet stand on y = 0.

    Args:
        gesture: What is done.
        fps: Frames a second [1/s].
    """
    body = reference_body()
    rest = body.joints.astype(float)
    count = round(gesture.seconds * fps) + 1
    times = np.array([time for time, _ in gesture.keys])
    sway = _sway(gesture.name)
    world = np.empty((count, JOINT_COUNT, 3, 3))
    root = np.empty((count, 3))
    for frame in range(count):
        moment = min(frame / fps, gesture.seconds)
        after = int(np.clip(np.searchsorted(times, moment, side="right"), 1, len(times) - 1))
        share = _eased((moment - times[after - 1]) / max(times[after] - times[after - 1], 1e-6))
        first, second = gesture.keys[after - 1][1], gesture.keys[after][1]
        world[frame], root[frame] = _posed(first, second, share, sway(moment), rest)
    return SkeletalMotion(body.skeleton, local_rotations(world, _PARENTS), root, fps)


def _eased(share: float) -> float:
    """Minimum jerk (Flash and Hogan 1985)."""
    share = float(np.clip(share, 0, 1))
    return share**3 * (10 - 15 * share + 6 * share**2)


def _sway(name: str) -> Callable[[float], np.ndarray]:
    """Small slow movements of who stands: of the pelvis to the left and ahead [m], the lean of the chest and the three
    angles of the head [degrees].
    """
    random = np.random.default_rng(int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little"))
    phases = random.uniform(0, 2 * np.pi, 6)
    slow = np.array([0.17, 0.13, 0.27, 0.11, 0.19, 0.15])  # breaths are the third, sixteen a minute
    large = np.array([0.010, 0.006, 0.9, 1.5, 2.0, 1.0])
    return lambda moment: large * np.sin(2 * np.pi * slow * moment + phases)


def _between(one: Any, other: Any, share: float) -> np.ndarray:
    return (1 - share) * np.asarray(one, float) + share * np.asarray(other, float)


def _posed(
    first: Pose, second: Pose, share: float, sway: np.ndarray, rest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """World rotations of the joints (22, 3, 3) and the root's position (3,) between two poses."""
    turns = np.tile(np.eye(3), (JOINT_COUNT, 1, 1))
    lean = _between(first.lean, second.lean, share) + [sway[2], 0, 0]
    head = _between(first.head, second.head, share) + sway[3:]
    tilt = (1 - share) * first.tilt + share * second.tilt
    turn = _angles(np.array([tilt, (1 - share) * first.turn + share * second.turn, 0.0]))
    for name, part in (("spine1", 0.3), ("spine2", 0.35), ("spine3", 0.35)):
        turns[_AT[name]] = _angles(part * lean)
    for name, part in (("neck", 0.4), ("head", 0.6)):
        turns[_AT[name]] = _angles(part * head)
    shrug = (1 - share) * first.shrug + share * second.shrug
    for side, sign in (("left", 1.0), ("right", -1.0)):
        raised = _between(_raised(getattr(first, side)), _raised(getattr(second, side)), share)
        turns[_AT[f"{side}_collar"]] = _angles(np.array([0, -sign * raised[1], sign * (22 * shrug + raised[0])]))
    turns[0] = turn
    position = rest[0] + _between(first.hips, second.hips, share) + [sway[0], 0, sway[1]]
    world = turns.copy()
    where = np.empty((JOINT_COUNT, 3))
    where[0] = position
    for joint in range(1, JOINT_COUNT):
        parent = JOINT_PARENTS[joint]
        world[joint] = world[parent] @ turns[joint]
        where[joint] = where[parent] + world[parent] @ (rest[joint] - rest[parent])
    for side, sign in (("left", 1.0), ("right", -1.0)):
        _set_arm(world, where, rest, side, sign, (getattr(first, side), getattr(second, side)), share)
        feet = getattr(first, f"{side}_foot"), getattr(second, f"{side}_foot")
        _set_leg(world, where, rest, side, sign, feet, share)
    return world, position


def _raised(hand: Hand) -> tuple[float, float]:
    """How far a shoulder goes up and ahead with its hand [degrees]."""
    _, height, ahead = hand.palm
    if hand.on == "ground":
        return 0.0, 0.0
    return 18 * float(np.clip((height - 1.45) / 0.45, 0, 1)), 10 * float(np.clip((ahead - 0.3) / 0.4, 0, 1))


def _angles(degrees: np.ndarray) -> np.ndarray:
    """Pitch ahead, yaw to the left, roll to the right side, as one rotation."""
    pitch, yaw, roll = np.radians(degrees).tolist()
    return _about(1, yaw) @ _about(0, pitch) @ _about(2, roll)


def _about(axis: int, angle: float) -> np.ndarray:
    """Rotation about one of the three axes."""
    cosine, sine = math.cos(angle), math.sin(angle)
    rotation = np.eye(3)
    one, other = (axis + 1) % 3, (axis + 2) % 3
    rotation[one, one] = rotation[other, other] = cosine
    rotation[one, other], rotation[other, one] = -sine, sine
    return rotation


def _unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector / max(math.sqrt(vector @ vector), 1e-9))


def _across(vector: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Unit vector of what is at right angles to an axis."""
    return _unit(vector - axis * float(vector @ axis))


def _frame(along: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """Rotation whose first column is `along` and whose second is nearest to `beside`."""
    along = _unit(along)
    second = _across(beside, along)
    (a, b, c), (x, y, z) = along.tolist(), second.tolist()
    # written out: numpy's cross takes longer than all else of a pose, and there are twenty a frame
    return np.array([[a, x, b * z - c * y], [b, y, c * x - a * z], [c, z, a * y - b * x]])


def _bent(start: np.ndarray, goal: np.ndarray, one: float, two: float, towards: np.ndarray) -> np.ndarray:
    """Where the joint between two bones is that reach from a start towards a goal, bent towards a direction."""
    direction = goal - start
    reach = float(np.clip(np.linalg.norm(direction), abs(one - two) + 1e-3, 0.998 * (one + two)))
    along = _unit(direction)
    cosine = (one**2 + reach**2 - two**2) / (2 * one * reach)
    return np.asarray(start + one * (cosine * along + np.sqrt(max(1 - cosine**2, 0)) * _across(towards, along)))


def _set_arm(
    world: np.ndarray,
    where: np.ndarray,
    rest: np.ndarray,
    side: str,
    sign: float,
    hands: tuple[Hand, Hand],
    share: float,
) -> None:
    """Turns the joints of an arm, in place."""
    shoulder, elbow, wrist = (_AT[f"{side}_{name}"] for name in ("shoulder", "elbow", "wrist"))
    outward = np.array([sign, 1, 1])
    positions, ways = [], []
    for hand in hands:
        directions = np.array([hand.fingers, hand.faces, hand.elbow], float)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        if hand.on == "ground":
            positions.append(outward * hand.palm)
            ways.append(outward * directions)
            continue
        carrier = _CARRIES[hand.on]
        positions.append(where[carrier] + world[carrier] @ (outward * hand.palm - rest[carrier]))
        ways.append((outward * directions) @ world[carrier].T)
    direction = np.linalg.norm(positions[1] - positions[0])
    palm = (
        _between(positions[0], positions[1], share)
        + _AHEAD * direction * np.sin(np.pi * share) * world[_CARRIES["chest"]][:, 2]
    )
    pointing, facing, towards = map(_unit, _between(ways[0], ways[1], share))
    goal = palm - _PALM * pointing
    one = float(np.linalg.norm(rest[elbow] - rest[shoulder]))
    two = float(np.linalg.norm(rest[wrist] - rest[elbow]))
    bend = _bent(where[shoulder], goal, one, two, towards)
    reached = bend + two * _unit(goal - bend)
    out, back, down = np.array([sign, 0, 0]), np.array([0, 0, -1.0]), np.array([0, -1.0, 0])
    hinge = _across(towards, _unit(goal - where[shoulder]))
    world[shoulder] = _frame(bend - where[shoulder], hinge) @ _frame(out, back).T
    forearm = _frame(reached - bend, hinge) @ _frame(out, back).T
    hand = _frame(pointing, facing) @ _frame(out, down).T
    along = _unit(reached - bend)
    roll = float(axis_angle_from_matrix(hand @ forearm.T) @ along)
    world[elbow] = matrix_from_axis_angle(_ROLLED * roll * along) @ forearm
    world[wrist] = hand
    where[elbow], where[wrist] = bend, reached


def _set_leg(
    world: np.ndarray,
    where: np.ndarray,
    rest: np.ndarray,
    side: str,
    sign: float,
    feet: tuple[Foot, Foot],
    share: float,
) -> None:
    """Turns the joints of a leg, in place; feet stand in the world."""
    hip, knee, ankle, toes = (_AT[f"{side}_{name}"] for name in ("hip", "knee", "ankle", "foot"))
    outward = np.array([sign, 1, 1])
    goal = outward * _between(feet[0].ankle, feet[1].ankle, share)
    towards = outward * _between(feet[0].knee, feet[1].knee, share)
    one = float(np.linalg.norm(rest[knee] - rest[hip]))
    two = float(np.linalg.norm(rest[ankle] - rest[knee]))
    bend = _bent(where[hip], goal, one, two, towards)
    down, ahead = np.array([0, -1.0, 0]), np.array([0, 0, 1.0])
    world[hip] = _frame(bend - where[hip], towards) @ _frame(down, ahead).T
    world[knee] = _frame(goal - bend, towards) @ _frame(down, ahead).T
    pitch = (1 - share) * feet[0].pitch + share * feet[1].pitch
    turn = sign * _between(feet[0].turn, feet[1].turn, share)
    world[ankle] = _angles(np.array([pitch, turn, 0.0]))
    # toes stay on the ground where the heel is up, as far as they bend
    world[toes] = _angles(np.array([max(0.2 * pitch, pitch - _TOES) if pitch > 0 else pitch, turn, 0.0]))
