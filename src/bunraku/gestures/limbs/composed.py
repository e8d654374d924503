"""A pose in which limbs are where a sentence says: angles of head and trunk, feet, and hands in their directions.

Everything is worked out from the reference body in the pose as it is so far (legs first, then trunk, head and arms): a
hand on a knee is where that knee is, whether somebody stands, sits or kneels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bunraku.gestures.limbs.arms import ARM, hand_of, low_place, postures
from bunraku.gestures.limbs.legs import with_legs
from bunraku.gestures.play import posed
from bunraku.gestures.pose import HANGING, Foot, Gesture, Pose, Vector, mirrored_pose, vector
from bunraku.gestures.standing import AT, SIDES, still
from bunraku.gestures.tracks import Tracks
from bunraku.language.limbs.phrases import Target
from bunraku.language.limbs.posing import Stance

__all__ = ["in_stance", "limbed", "stance_pose", "way_down"]

AHEAD, SIDE, BACK, TWIST = 28.0, 25.0, 34.0, 46.0
"""How far the trunk leans or twists as usual [degrees]."""
BENDS, BOWS = 2.2, 1.9
"""How much farther who bends, or bows, goes than who leans."""
NODS, TURNS, TILTS = 38.0, 58.0, 28.0
"""The same of the head."""
MOST_LEAN = 80.0
BEHIND = 0.1
"""How far behind the pelvis a place is that nobody bends for [m]."""
_THROUGH = {"back": "floor", "belly": "both knees"}
HANGS = 24.0
"""Lean from which on arms that nothing is said of hang down from the shoulders [degrees]."""


def limbed(stance: Stance, targets: Sequence[Target]) -> Pose:
    """Somebody with limbs where some targets say; where two say something of the same limb, both count.

    Args:
        stance: How somebody is.
        targets: Of single ways: where something goes to and fro, one of its ends.
    """
    stance = stance._replace(name="chair") if stance.name == "seat" else stance
    pose = with_legs(
        stance_pose(stance), stance, [one for one in targets if one.limb in ("leg", "knee", "heel", "hips")]
    )
    for one in targets:
        if one.limb == "trunk":
            pose = _with_trunk(pose, stance, one)
        elif one.limb == "head":
            pose = _with_head(pose, one)
        elif one.limb == "shoulders":
            pose = replace(pose, shrug=0.0 if "down" in one.ways else 1.3 * min(one.amount, 1.1))
    arms = [one for one in targets if one.limb in ("arm", "elbow")]
    arms += [
        Target("arm", "both", frozenset(["back"]), "floor", "on") for one in targets
        if one.limb == "trunk" and one.at == "arm"
    ]  # fmt: skip
    pose = _reaching(pose, stance, arms)
    return _with_arms(pose, stance, arms)


def stance_pose(stance: Stance) -> Pose:
    """Somebody who is so, and of whose limbs nothing is said."""
    pose = postures("stances")["chair" if stance.name == "seat" else stance.name]
    return mirrored_pose(pose) if stance.side == "left" else pose


def in_stance(gesture: Gesture, stance: Stance) -> Gesture:
    """A gesture of who stands, done by who sits, kneels or lies; one that moves the legs as it is."""
    poses = [pose for _, pose in gesture.keys]
    if gesture.steps or any(pose.tilt or Foot() != pose.right_foot or Foot() != pose.left_foot for pose in poses):
        return gesture
    base = stance_pose(stance)

    def placed(pose: Pose) -> Pose:
        right = base.right if pose.right == HANGING else pose.right
        left = base.left if pose.left == HANGING else pose.left
        lean, head = _sum(pose.lean, base.lean), _sum(pose.head, base.head)
        return replace(base, right=right, left=left, lean=lean, head=head, shrug=pose.shrug)

    return replace(gesture, keys=tuple([(time, placed(pose)) for time, pose in gesture.keys]))


def way_down(stance: Stance) -> list[Pose]:
    """Poses on the way from standing."""
    if stance.name in _THROUGH:  # who lies down sits or kneels first
        other = Stance(_THROUGH[stance.name])
        return [*way_down(other), stance_pose(other)]
    found = postures("ways").get("chair" if stance.name == "seat" else stance.name)
    return [] if found is None else [mirrored_pose(found) if stance.side == "left" else found]


def joints_of(pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """World rotations (22, 3, 3) and positions (22, 3) [m] of the joints in a pose."""
    moments = np.zeros(1)
    motion = posed(Tracks.of([(0.0, pose), (1.0, pose)]), np.array([0.0, 1.0]), moments, still(1), 20.0)
    rotations, positions = motion.world()
    return rotations[0].astype(float), positions[0].astype(float)


def _with_trunk(pose: Pose, stance: Stance, target: Target) -> Pose:
    """The trunk leant, bent or twisted; who stands keeps the balance with the pelvis."""
    far, ways = target.amount, target.ways
    ahead = aside = turn = 0.0
    more = BENDS if "bent" in ways else BOWS if "bowed" in ways else 1.0
    if ways & {"ahead", "down"}:
        ahead = (max(more, BENDS) if "down" in ways else more) * AHEAD * far
    elif "back" in ways:
        ahead = -BACK * far * (1.4 if more > 1 else 1.0)
    side = float("right" in ways) - float(bool(ways & {"left", "side"}))
    if "turned" in ways:
        turn = -side * TWIST * far
    else:
        aside = side * SIDE * far * (1.3 if "bent" in ways else 1.0)
    ahead = float(np.clip(ahead, -65, 115))
    over = max(ahead - 45, 0) * 0.5 if stance.name == "stand" else 0.0  # the pelvis takes what the spine does not
    x, y, z = pose.hips
    hips = (x + 0.0025 * aside, y, z - 0.0022 * ahead) if stance.name in ("stand", "squat") else pose.hips
    lean = _sum(pose.lean, (ahead - over, turn, aside))
    head = _sum(pose.head, (0.3 * max(-ahead, 0.0), 0.3 * turn, 0.0))
    return replace(pose, lean=lean, hips=hips, tilt=pose.tilt + over, head=head)


def _with_head(pose: Pose, target: Target) -> Pose:
    far, ways = target.amount, target.ways
    ahead = NODS * far * (float(bool(ways & {"down", "ahead"})) - float(bool(ways & {"back", "up"})))
    side = float("left" in ways) - float(bool(ways & {"right", "side"}))
    turned = "turned" in ways
    angles = (ahead, side * TURNS * min(far, 1.3), 0.0) if turned else (ahead, 0.0, -side * TILTS * far)
    return replace(pose, head=_sum(pose.head, angles))


def _reaching(pose: Pose, stance: Stance, arms: Sequence[Target]) -> Pose:
    """A pose bent so far that hands reach what is low ahead, if bending brings them nearer."""
    before, nearest = pose, np.inf
    while pose.lean[0] <= MOST_LEAN:
        _, positions = joints_of(pose)
        far = 0.0
        for one in arms:
            for side in _sides(one):
                goal = low_place(one, side, positions)
                if goal is not None and goal[2] > positions[AT["pelvis"], 2] - BEHIND:
                    far = max(far, float(np.linalg.norm(goal - positions[AT[f"{side}_shoulder"]])) - ARM)
        if far <= 0 or far >= nearest:
            return pose if far <= 0 else before
        before, nearest = pose, far
        x, y, z = pose.hips
        hips = (x, y - 0.012, z - 0.009) if stance.name == "stand" else pose.hips
        pose = replace(pose, lean=_sum(pose.lean, (5.0, 0.0, 0.0)), hips=hips)
    return before


def _sides(target: Target) -> tuple[str, ...]:
    """The sides that a target is of; of either the right one."""
    return ("left", "right") if target.side == "both" else ("right",) if target.side == "one" else (target.side,)


def _with_arms(pose: Pose, stance: Stance, arms: Sequence[Target]) -> Pose:
    said = {side: [one for one in arms if side in _sides(one)] for side, _ in SIDES}
    rotations, positions = joints_of(pose)
    made = {"left": pose.left, "right": pose.right}
    for side, sign in SIDES:
        own = said[side]
        default = made[side]
        hangs = default == HANGING and abs(pose.lean[0]) + abs(pose.tilt) > HANGS and stance.name in ("stand", "squat")
        if not own and hangs:
            own = [Target("arm", side, frozenset(["down"]))]
        if own:
            made[side] = hand_of(_joined(own), side, sign, stance, rotations, positions)
    return replace(pose, left=made["left"], right=made["right"])


def _joined(targets: Sequence[Target]) -> Target:
    """What several targets say of one limb."""
    ways = frozenset[str]().union(*(one.ways for one in targets))
    last = next((one for one in reversed(targets) if one.at), targets[-1])
    return last._replace(ways=ways, limb="elbow" if any(one.limb == "elbow" for one in targets) else "arm")


def _sum(one: Vector, other: Vector) -> Vector:
    return vector(np.add(one, other))
