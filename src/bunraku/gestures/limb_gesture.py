"""What a sentence says limbs do, as a gesture: poses of a stance, of limbs that are held, and of those that move.

Constants here were chosen by eye on the reference body, 1.84 m tall.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bunraku.gestures.limb_poses import ARM, hand_of, low_place, postures, postures_file, with_legs
from bunraku.gestures.play import AT, SIDES, Tracks, posed, still
from bunraku.gestures.pose import (
    HANGING,
    STEP,
    Foot,
    Gesture,
    Key,
    Pose,
    Repeat,
    added,
    mirrored_pose,
    repeated_gesture,
    through,
)
from bunraku.language.limb_phrases import Target
from bunraku.language.posing import Posing, Stance, Step

AHEAD, SIDE, BACK, TWIST = 28.0, 25.0, 34.0, 46.0
"""How far the trunk leans or twists as usual [degrees]."""

# Chosen by eye on sheets of the sentences of benchmarks/limbs.txt.
BENDS, BOWS = 2.2, 1.9
"""How much farther bending and bowing go than leaning."""
NODS, TURNS, TILTS = 38.0, 58.0, 28.0
"""The same of the head."""
MOST_LEAN, HANGS = 80.0, 24.0
"""How far the trunk leans to reach something, and the lean from which on other arms hang down [degrees]."""
BEHIND = 0.1
"""How far behind the pelvis a place is that the trunk does not bend for [m]."""


def limbed(stance: Stance, targets: Sequence[Target]) -> Pose:
    """The body with limbs where some targets say; where two say something of the same limb, both count.

    Args:
        stance: Of the body.
        targets: Of single ways: where something goes to and fro, one of its ends.
    """
    stance = stance._replace(name="chair") if stance.name == "seat" else stance
    pose = with_legs(stance_pose(stance), stance, [aim for aim in targets if aim.whole in ("leg", "hips")])
    arms = [aim for aim in targets if aim.limb in ("arm", "elbow")]
    for target in targets:
        if target.limb == "trunk":
            pose = _with_trunk(pose, stance, target)
            arms += [Target("arm", "both", frozenset(["back"]), "floor", "on")] * (target.at == "arm")
        elif target.limb == "head":
            pose = _with_head(pose, target)
        elif target.limb == "shoulders":
            pose = replace(pose, shrug=0.0 if "down" in target.ways else 1.3 * min(target.amount, 1.1))
    return _with_arms(_reaching(pose, stance, arms), stance, arms)


def stance_pose(stance: Stance) -> Pose:
    """The body in a stance, with limbs of which nothing is said."""
    pose = postures("stances")["chair" if stance.name == "seat" else stance.name]
    return mirrored_pose(pose) if stance.side == "left" else pose


def in_stance(gesture: Gesture, stance: Stance) -> Gesture:
    """A gesture of a standing person, done sitting, kneeling or lying; one that moves the legs as it is."""
    poses = [pose for _, pose in gesture.keys]
    if gesture.steps or any(pose.tilt or Foot() != pose.right_foot or Foot() != pose.left_foot for pose in poses):
        return gesture
    base = stance_pose(stance)

    def placed(pose: Pose) -> Pose:
        right = base.right if pose.right == HANGING else pose.right
        left = base.left if pose.left == HANGING else pose.left
        lean, head = added(pose.lean, base.lean), added(pose.head, base.head)
        return replace(base, right=right, left=left, lean=lean, head=head, shrug=pose.shrug)

    return replace(gesture, keys=tuple([(time, placed(pose)) for time, pose in gesture.keys]))


def way_down(stance: Stance) -> list[Pose]:
    """Poses on the way from standing."""
    if stance.name in ("back", "belly"):
        between = Stance("floor" if stance.name == "back" else "both knees")
        return [*way_down(between), stance_pose(between)]
    ways = postures("ways").get("chair" if stance.name == "seat" else stance.name)
    return [] if ways is None else [mirrored_pose(ways) if stance.side == "left" else ways]


def joints_of(pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """World rotations (22, 3, 3) and positions (22, 3) [m] of the joints in a pose."""
    motion = posed(Tracks.of([(0.0, pose), (1.0, pose)]), np.array([0.0, 1.0]), np.zeros(1), still(1), 20.0)
    rotations, positions = motion.world()
    return rotations[0].astype(float), positions[0].astype(float)


def _with_trunk(pose: Pose, stance: Stance, target: Target) -> Pose:
    """The trunk leant, bent or twisted; a standing body keeps the balance with the pelvis."""
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
    lean = added(pose.lean, (ahead - over, turn, aside))
    head = added(pose.head, (0.3 * max(-ahead, 0.0), 0.3 * turn, 0.0))
    return replace(pose, lean=lean, hips=hips, tilt=pose.tilt + over, head=head)


def _with_head(pose: Pose, target: Target) -> Pose:
    far, ways = target.amount, target.ways
    ahead = NODS * far * (float(bool(ways & {"down", "ahead"})) - float(bool(ways & {"back", "up"})))
    side = float("left" in ways) - float(bool(ways & {"right", "side"}))
    angles = (side * TURNS * min(far, 1.3), 0.0) if "turned" in ways else (0.0, -side * TILTS * far)
    return replace(pose, head=added(pose.head, (ahead, *angles)))


def _reaching(pose: Pose, stance: Stance, arms: Sequence[Target]) -> Pose:
    """A pose bent so far that hands reach what is low ahead, if bending brings them nearer."""
    before, nearest = pose, np.inf
    while pose.lean[0] <= MOST_LEAN:
        _, positions = joints_of(pose)
        far = 0.0
        for aim in arms:
            for side in _sides(aim):
                goal = low_place(aim, side, positions)
                if goal is not None and goal[2] > positions[AT["pelvis"], 2] - BEHIND:
                    far = max(far, float(np.linalg.norm(goal - positions[AT[f"{side}_shoulder"]])) - ARM)
        if far <= 0 or far >= nearest:
            return pose if far <= 0 else before
        before, nearest = pose, far
        x, y, z = pose.hips
        hips = (x, y - 0.012, z - 0.009) if stance.name == "stand" else pose.hips
        pose = replace(pose, lean=added(pose.lean, (5.0, 0.0, 0.0)), hips=hips)
    return before


def _sides(target: Target) -> tuple[str, ...]:
    """The sides that a target is of; of either the right one."""
    return ("left", "right") if target.side == "both" else ("right",) if target.side == "one" else (target.side,)


def _with_arms(pose: Pose, stance: Stance, arms: Sequence[Target]) -> Pose:
    rotations, positions = joints_of(pose)
    leant = abs(pose.lean[0]) + abs(pose.tilt) > HANGS and stance.name in ("stand", "squat")
    hands: dict[str, Any] = {}
    for side, sign in SIDES:
        arm_targets = [aim for aim in arms if side in _sides(aim)]
        if not arm_targets and leant and getattr(pose, side) == HANGING:
            arm_targets = [Target("arm", side, frozenset(["down"]))]
        if arm_targets:
            hands[side] = hand_of(_joined(arm_targets), side, sign, stance, rotations, positions)
    return replace(pose, **hands)


def _joined(targets: Sequence[Target]) -> Target:
    """What several targets say of one limb."""
    ways = frozenset[str]().union(*(aim.ways for aim in targets))
    last = next((aim for aim in reversed(targets) if aim.at), targets[-1])
    return last._replace(ways=ways, limb="elbow" if any(aim.limb == "elbow" for aim in targets) else "arm")


NAME = "limbs"

# Chosen by eye on sheets of the sentences of benchmarks/limbs.txt.
THERE, RETURN = 0.95, 1.0
"""Seconds to where a limb goes, and back."""
STAYS, SHORTLY, DOWN, ALIVE = 1.8, 0.9, 0.8, 4.0
"""Seconds that a limb is there at the end, and before something else is done; of each part of the way down from
standing; and of the small movement of a body that holds its limbs.
"""
LIES = 60.0
"""Tilt of the pelvis from which on the body lies [degrees]."""
ROUND, TIMES = 8, 4
"""Poses of a circle, and how often something is done that is done again and again."""


@functools.lru_cache(maxsize=64)
def limb_gesture(posing: Posing) -> Gesture:
    """What a sentence says limbs do, by a person who stands or is in the stance that it says."""
    stance = posing.stance or Stance()
    posing = _bent_together(posing)
    base = limbed(stance, posing.held)
    low = stance.name != "stand"
    legs = any(aim.whole == "leg" for aim in posing.targets) and not low
    keys: list[Key] = []
    if low and stance.goes:
        keys = [(0.0, Pose())]
        for pose in way_down(stance):
            keys.append((keys[-1][0] + DOWN, pose))
        keys.append((keys[-1][0] + DOWN, stance_pose(stance)))
    start = keys[-1][0] + THERE if keys else 0.0
    if not posing.steps:
        keys += [(start, base), (start + ALIVE / 2, _alive(base)), (start + ALIVE, base)]
        return Gesture(NAME, (), tuple(keys), (start, start + ALIVE), legs, begins=True)
    if len(posing.steps) == 1 and posing.steps[0].again and not keys:
        poses, period = _cycle(stance, posing.held, posing.steps[0])
        if len(poses) > 2:
            return _circled(base, poses, period, legs)
        return repeated_gesture(NAME, poses, period, TIMES, steps=legs, start=THERE, end=RETURN, rest=base)
    keys.append((start, base))
    lowered = [aim for aim in posing.steps[0].targets if aim.limb in ("arm", "leg", "knee") and aim.ways == {"down"}]
    if lowered:  # what is lowered is up before
        raised = [aim._replace(ways=frozenset(["up"])) for aim in lowered]
        keys = [(time, pose if time < start else limbed(stance, [*posing.held, *raised])) for time, pose in keys]
    stays = posing.steps[-1].stays or bool(lowered)
    moment, before = start + 0.3, list(posing.held)
    keys.append((moment, keys[-1][1]))
    for number, step in enumerate(posing.steps):
        last = number == len(posing.steps) - 1
        if not step.besides:
            before = list(posing.held)
        if step.again:
            poses, period = _cycle(stance, before, step)
            for turn in range(2 if not last else 3):
                for share, pose in enumerate(poses):
                    keys.append((moment + THERE + period * (turn + share / len(poses)), pose))
            moment = keys[-1][0]
            continue
        before = _replaced(before, step.targets)
        pose = limbed(stance, [*posing.held, *_of_side(step.targets, "left")] if step.alternately else before)
        keys.append((moment + THERE, pose))
        moment += THERE
        moment += STAYS if last else SHORTLY
        keys.append((moment, pose))
    if stays:
        pose = keys[-1][1]
        keys += [(moment + ALIVE / 2, _alive(pose)), (moment + ALIVE, pose)]
        return Gesture(NAME, (), tuple(keys), (moment, moment + ALIVE), legs, begins=True)
    keys.append((moment + RETURN, base))
    return Gesture(NAME, (), tuple(keys), None, legs)


def _bent_together(posing: Posing) -> Posing:
    """Hands on the knees of a bending person are there only while the trunk is bent."""
    bends = any(aim.limb == "trunk" and aim.ways & {"ahead", "down"} for step in posing.steps for aim in step.targets)
    low = [aim for aim in posing.held if aim.low is not None] if bends else []
    if not low:
        return posing
    first, *others = posing.steps
    held = tuple(aim for aim in posing.held if aim not in low)
    return replace(posing, held=held, steps=(first._replace(targets=(*first.targets, *low)), *others))


def _replaced(targets: Sequence[Target], others: Sequence[Target]) -> list[Target]:
    """Targets without those of limbs that others move elsewhere, and these others; legs apart may be bent so."""
    kept = [
        aim for aim in targets
        if not any(
            not (other.ways <= {"bent", "tiptoe"} and aim.ways & {"apart", "together"})
            and aim.whole == other.whole and (aim.side == other.side or "both" in (aim.side, other.side))
            for other in others
        )
    ]  # fmt: skip
    return [*kept, *others]


def _of_side(targets: Sequence[Target], side: str) -> list[Target]:
    return [aim._replace(side=side) if aim.side in ("both", "one") else aim for aim in targets]


def _cycle(stance: Stance, held: Sequence[Target], step: Step) -> tuple[list[Pose], float]:
    """The poses of once to and fro, or once round, and its seconds."""
    periods = postures_file()["periods"]
    period = max(periods[aim.whole] for aim in step.targets)
    if step.alternately:
        right, left = (limbed(stance, _replaced(held, _of_side(step.targets, side))) for side in ("right", "left"))
        rest = limbed(stance, held)
        return [right, rest, left, rest], 1.4 * period
    if any("round" in aim.to for aim in step.targets):
        plain = [aim for aim in step.targets if "round" not in aim.to]
        circled = [aim for aim in step.targets if "round" in aim.to]
        ways = [[_on_circle(aim, number / ROUND) for aim in circled] for number in range(ROUND)]
        return [_mixed_pose(stance, held, plain, some) for some in ways], 1.2 * period
    common = [aim._replace(to=frozenset()) for aim in step.targets]
    first = limbed(stance, _replaced(held, common))
    ends = [_other_end(aim) for aim in step.targets if aim.to]
    second = limbed(stance, _replaced(held, ends) if ends else held)
    return [first, second], period if ends else 1.5 * period


def _other_end(target: Target) -> Target:
    """The other end of what goes to and fro: what is said of both stays."""
    opposite = {"back": "ahead", "ahead": "back", "down": "up", "right": "left", "left": "right", "in": "side"}
    (to,) = target.to
    ways = target.ways - {opposite.get(to)} | {"together" if to == "in" else to}
    return target._replace(ways=frozenset(ways), to=frozenset())


def _on_circle(target: Target, share: float) -> tuple[Target, Target, float]:
    """Two ways between which a limb is at this share of a circle, and how far on from the one to the other."""
    ways = postures_file()["circles"].get(target.whole, ("ahead", "right", "back", "left"))
    at = share * len(ways)
    plain = target._replace(to=frozenset())
    kept = target.ways - {"ahead", "back"}
    first, second = (plain._replace(ways=frozenset({ways[int(at + more) % len(ways)]} | kept)) for more in (0, 1))
    return first, second, at % 1


def _mixed_pose(
    stance: Stance, held: Sequence[Target], plain: Sequence[Target], circled: Sequence[tuple[Target, Target, float]]
) -> Pose:
    """A pose with each limb that circles at its place between two ways."""
    first = limbed(stance, _replaced(held, [*plain, *[aim for aim, _, _ in circled]]))
    second = limbed(stance, _replaced(held, [*plain, *[other for _, other, _ in circled]]))
    share = circled[0][2]
    return through([(0.0, first), (1.0, second)])[round(share / STEP)][1] if share else first


def _circled(base: Pose, poses: Sequence[Pose], period: float, legs: bool) -> Gesture:
    """Poses of a circle passed through without a stop."""
    keys: list[Key] = [(0.0, base)]
    length = round(period / STEP) * STEP
    for turn in range(TIMES):
        keys += [(THERE + length * (turn + number / len(poses)), pose) for number, pose in enumerate(poses)]
    over = THERE + length * TIMES
    keys += [(over, poses[0]), (over + RETURN, base)]
    flowing = through([(round(time / STEP) * STEP, pose) for time, pose in keys])
    repeat = Repeat(THERE, length, TIMES)
    return Gesture(NAME, (), flowing, (repeat.start, repeat.stop - repeat.period), legs, repeat)


def _alive(pose: Pose) -> Pose:
    """A pose a little later in a body that holds it, since no body is quite still."""
    x, y, z = pose.hips
    ahead, turn, aside = pose.lean
    nod, look, tilt = pose.head
    if abs(pose.tilt) > LIES:
        return replace(pose, head=(nod, look + 16, tilt))
    head = (nod + 3, look - 8, tilt + 2)
    return replace(pose, lean=(ahead + 2, turn + 4, aside + 1.5), head=head, hips=(x + 0.015, y, z))
