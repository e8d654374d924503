"""Motions of animals: the pose in which an animal's skeleton stands, its motion relative to that pose, and that motion
on another animal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.anatomy.handles.limbs import FAMILIES, SIDES, limb_handles
from bunraku.anatomy.joints import downwards
from bunraku.anatomy.legs import BodyPlan, Reach, check_plans
from bunraku.anatomy.names.bone_names import NO_HANDLE, handle_of_joints
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.body.layout import HANDLE_NAMES, HANDLE_PARENTS, JOINT_NAMES
from bunraku.core.character import Character, Rig
from bunraku.core.geometry.curves import STANDS, tallest_steady
from bunraku.core.geometry.rotations import Resampling, matrix_y, nearest_rotation, rotation_between
from bunraku.core.motion import HandleMotion, SkeletalMotion, local_rotations, resample, resample_motion
from bunraku.errors import MotionError
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.locomotion import BEATS, in_air, reached, wing_swing
from bunraku.retarget.rig_parts import RigParts
from bunraku.retarget.to_reference import bones_to_handles, motion_to_reference
from bunraku.retarget.to_rig import fit_rig, on_bones, stiff

WIDTH = 0.12  # of a bone, over its length
STUB = 0.3  # length of what a joint without children carries, over the bone above it
_FACES = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1], [5, 2, 1], [5, 3, 2], [5, 4, 3], [5, 1, 4]])


def stick_character(
    name: str, names: tuple[str, ...], parents: np.ndarray, positions: np.ndarray, known: np.ndarray
) -> Character:
    """A body of an octahedron for each bone, wholly moved by the joint that the bone leaves from.

    Args:
        name: Of the character.
        names: Of the joints, length J.
        parents: Parent of each joint, before its children; -1 for the root, shape (J,).
        positions: Of the joints in the pose that becomes the rest pose [m], shape (J, 3).
        known: Which joints are parts of a body, shape (J,), bool. Bones that lead to none are left out, such as those
            to the poles of inverse kinematics.
    """
    pieces, owners = [], []
    body = known.copy()
    for joint in range(len(names) - 1, 0, -1):  # parents stand before their children
        body[parents[joint]] |= body[joint]
    joints = np.flatnonzero(body & (parents >= 0))
    bones = [(int(parents[joint]), positions[joint]) for joint in joints]
    for joint in np.setdiff1d(joints, parents[joints]):
        bones.append((int(joint), positions[joint] + STUB * (positions[joint] - positions[parents[joint]])))
    for joint, end in bones:
        start = positions[joint]
        length = float(np.linalg.norm(end - start))
        if length > 1e-9:
            pieces.append(_octahedron(start, end, WIDTH * length))
            owners.append(joint)
    faces = np.concatenate([_FACES + 6 * number for number in range(len(pieces))])
    transforms = np.tile(np.eye(4), (len(names), 1, 1))
    transforms[:, :3, 3] = positions
    indices = np.repeat(owners, 6)[:, None]
    rig = Rig(names, parents, transforms, indices, np.ones(indices.shape))
    return Character(name, np.concatenate(pieces), faces, rig)


def _octahedron(start: np.ndarray, end: np.ndarray, width: float) -> np.ndarray:
    along = (end - start) / np.linalg.norm(end - start)
    side = np.cross(along, np.eye(3)[int(np.abs(along).argmin())])
    side /= np.linalg.norm(side)
    other = np.cross(along, side)
    middle = start + 0.3 * (end - start)
    ring = [middle + width * offset for offset in (side, other, -side, -other)]
    return np.array([start, *ring, end])


LEVEL = 40.0  # a trunk whose slope is less is level [degrees]

# Chosen on the captured animals of `bunraku evaluate transfer`.
DOWN = 0.55  # a leg stands whose end is so far below its top, over its length along the bones
CLEAR = 0.12  # height of the knees over the feet, over that of the hips, from which on an animal does not crawl
NEAR = 0.35  # the ends of front legs are so near to those of the hind legs in height, over the height of the hips
LEAST = 0.15  # share of the frames in which an animal stands on four legs, at the least
MIRROR = np.array([-1.0, 1.0, 1.0])
UPRIGHT = 55.0  # a rest pose whose trunk is steeper is that of a person [degrees]


@dataclass(frozen=True)
class Limbs:
    """The joints of the four legs of a skeleton, left and right, each from the hip or the shoulder outwards."""

    hind: tuple[list[int], list[int]]
    front: tuple[list[int], list[int]]


@dataclass(frozen=True, eq=False)
class Stance:
    """How an animal stands, facing +Z: world rotations (J, 3, 3) and positions [m] (J, 3) of the joints, in the rest
    pose, or else in the mean of the tallest steady frames in which it stands, and of its left and right legs.
    """

    turns: np.ndarray
    positions: np.ndarray


def find_limbs(parts: np.ndarray, parents: np.ndarray) -> Limbs | None:
    """The four legs by the handle of each joint, -1 for none, and its parent, shape (J,) each; None where one of them
    has less than two joints.
    """
    families = []
    for family in FAMILIES:
        sides = []
        for side in SIDES:
            members = np.isin(parts, limb_handles(side, family))
            inner = [joint for joint in np.flatnonzero(members) if parents[joint] < 0 or not members[parents[joint]]]
            lines = [_longest(int(joint), members, parents) for joint in inner]
            sides.append(max(lines, key=len, default=[]))
        families.append((sides[0], sides[1]))
    if min(len(line) for family in families for line in family) < 2:
        return None
    return Limbs(*families)


def _longest(joint: int, own: np.ndarray, parents: np.ndarray) -> list[int]:
    below = [_longest(int(child), own, parents) for child in np.flatnonzero((parents == joint) & own)]
    return [joint, *max(below, key=len, default=[])]


def find_stance(motion: SkeletalMotion, limbs: Limbs, parts: np.ndarray) -> Stance | None:
    """How an animal stands in a motion with +Y up, by its legs and the handle of each joint, -1 for none, shape (J,);
    None of a person, and where four legs are not seen to stand.
    """
    rest = motion.skeleton.positions.astype(np.float64)[None]
    if bool(_stands(rest, limbs)[0]):
        turn = np.asarray(matrix_y(-_heading(rest, limbs)))[0]
        positions = rest[0] @ turn.T
        return Stance(np.broadcast_to(turn, (len(positions), 3, 3)), positions)
    if _person(rest[0], limbs, parts):
        return None
    world, positions = motion.world()
    standing = _stands(positions.astype(np.float64), limbs)
    if standing.mean() < LEAST:
        return None
    # a trunk may be as level in a sitting or a crouching animal
    standing[standing] = tallest_steady(_heights(positions[standing].astype(np.float64), limbs), motion.fps)
    return _mean_stance(motion, world[standing].astype(np.float64), _heading(positions[standing], limbs), limbs)


def _mean_stance(motion: SkeletalMotion, world: np.ndarray, headings: np.ndarray, limbs: Limbs) -> Stance:
    """The mean of some frames, with legs as far ahead on the left as on the right: a clip that ends amid a stride, or
    that begins with a leg ahead, has another mean on either side.
    """
    parents, offsets = motion.skeleton.parents, motion.skeleton.offsets.astype(np.float64)
    local = local_rotations(np.swapaxes(matrix_y(headings), -1, -2)[:, None] @ world, parents)
    turns = nearest_rotation(local.mean(axis=0))
    positions = np.zeros((len(parents), 3))
    for joint in range(1, len(parents)):
        above = int(parents[joint])
        turns[joint] = turns[above] @ turns[joint]
        positions[joint] = positions[above] + turns[above] @ offsets[joint]
    evened = _evening(positions, limbs)
    for joint in range(1, len(parents)):
        above = int(parents[joint])
        if joint not in evened and above in evened:
            evened[joint] = evened[above]
        positions[joint] = positions[above] + evened.get(above, np.eye(3)) @ turns[above] @ offsets[joint]
    turns = np.stack([evened.get(joint, np.eye(3)) @ turn for joint, turn in enumerate(turns)])
    return Stance(turns, positions)


def _evening(positions: np.ndarray, limbs: Limbs) -> dict[int, np.ndarray]:
    """The rotations of the bones of the legs of an animal that faces +Z to where they and their mirror images meet."""
    out: dict[int, np.ndarray] = {}
    for left, right in (limbs.hind, limbs.front):
        if len(left) != len(right):
            continue
        for (joint, below), (other, under) in zip(pairwise(left), pairwise(right), strict=True):
            bones = positions[below] - positions[joint], (positions[under] - positions[other]) * MIRROR
            middle = sum(bone / max(float(np.linalg.norm(bone)), 1e-12) for bone in bones)
            out[joint] = rotation_between(bones[0], middle)
            out[other] = rotation_between(bones[1] * MIRROR, middle * MIRROR)
    return out


def _tops(positions: np.ndarray, lines: tuple[list[int], list[int]]) -> np.ndarray:
    return np.asarray(0.5 * (positions[:, lines[0][0]] + positions[:, lines[1][0]]))


def _heading(positions: np.ndarray, limbs: Limbs) -> np.ndarray:
    """Where the trunk points, about +Y from +Z [rad], shape (N,)."""
    ahead = _tops(positions, limbs.front) - _tops(positions, limbs.hind)
    return np.asarray(np.arctan2(ahead[:, 0], ahead[:, 2]))


def _heights(positions: np.ndarray, limbs: Limbs) -> np.ndarray:
    """How high the hips and the shoulders are over the lower foot of their pair, in the mean [m], shape (N,)."""
    pairs = [
        _tops(positions, lines)[:, 1] - np.min([positions[:, line[-1], 1] for line in lines], axis=0)
        for lines in (limbs.hind, limbs.front)
    ]
    return np.asarray(np.mean(pairs, axis=0))


def _stands(positions: np.ndarray, limbs: Limbs) -> np.ndarray:
    """In which poses (N, J, 3) an animal stands on its four feet, shape (N,), bool."""
    trunk = _tops(positions, limbs.front) - _tops(positions, limbs.hind)
    out = np.abs(trunk[:, 1]) < np.sin(np.radians(LEVEL)) * np.linalg.norm(trunk, axis=1)
    feet, knees = [], []
    for lines in (limbs.hind, limbs.front):
        down, length = np.zeros(len(positions)), np.zeros(len(positions))
        for line in lines:
            down += positions[:, line[0], 1] - positions[:, line[-1], 1]
            length += np.linalg.norm(np.diff(positions[:, line], axis=1), axis=-1).sum(axis=1)
        out &= down > DOWN * np.maximum(length, 1e-12)
        feet.append(np.min([positions[:, line[-1], 1] for line in lines], axis=0))
        knees.append(np.min([positions[:, line[1], 1] for line in lines], axis=0))
    hips = _tops(positions, limbs.hind)[:, 1] - feet[0]
    out &= np.abs(feet[0] - feet[1]) < NEAR * hips
    return np.asarray(out & (knees[0] - feet[0] > CLEAR * hips))


def _person(rest: np.ndarray, limbs: Limbs, parts: np.ndarray) -> bool:
    """Whether a rest pose is that of an upright body on two legs."""
    ends = [0.5 * (rest[lines[0][-1]] + rest[lines[1][-1]]) for lines in (limbs.hind, limbs.front)]
    hips, shoulders = (0.5 * (rest[lines[0][0]] + rest[lines[1][0]]) for lines in (limbs.hind, limbs.front))
    trunk, legs = shoulders - hips, ends[0] - hips
    size = max(float(np.linalg.norm(trunk)), 1e-12)
    steep = trunk[1] > np.sin(np.radians(UPRIGHT)) * size
    tail = np.isin(parts, [HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")]).any()
    return bool(steep and legs[1] < -0.5 * np.linalg.norm(legs) and not tail)


@dataclass(frozen=True, eq=False)
class CreatureMotion:
    """Motion of a body that is not a person."""

    # Of 30 handles with the reference body's meaning. Rotations are relative to the pose in which the body stands, and
    # not to the T-pose; what the body lacks moves with its parents; joints hold. The root's path is in the scale of the
    # reference body, whose pelvis is as high above the ground as the body's root is.
    motion: HandleMotion
    plan: BodyPlan
    heights: np.ndarray  # of its lowest point over the ground, in the same scale [m], shape (N,)
    flies: bool = False
    # Of a body that lies along its spine and walks on two legs: the same by way of the reference body, for characters
    # of other kinds.
    person: HandleMotion | None = None
    goals: tuple[tuple[str, float, float], ...] = ()  # what is reached, and from when to when [s] (`reached`)

    def at(self, fps: float) -> CreatureMotion:
        """The same at another rate [1/s]."""
        heights = Resampling.of(len(self.heights), self.motion.fps, fps).linear(self.heights)
        person = None if self.person is None else resample(self.person, fps)
        return replace(self, motion=resample(self.motion, fps), heights=heights, person=person)

    def suits(self, plan: BodyPlan) -> bool:
        """Whether it goes from how the one body stands to how the other does, and not by way of the reference body."""
        return self.person is None or (plan.kind == "two legs" and not plan.upright)


def motion_of_skeleton(
    motion: SkeletalMotion, fps: float, names: Mapping[str, str] | None = None
) -> CreatureMotion | None:
    """The motion of an animal's skeleton at a rate [1/s]; None where no four legs are seen to carry a level trunk, as
    of people.

    Args:
        motion: Of any skeleton, +Y up [m].
        names: The skeleton's joint by SMPL's name, for joints that are not found or found wrongly; "" for none.
    """
    skeleton = motion.skeleton
    parts = _parts(motion, names)
    limbs = find_limbs(parts, skeleton.parents)
    stance = None if limbs is None else find_stance(motion, limbs, parts)
    if stance is None:
        return None
    character = stick_character("source", skeleton.names, skeleton.parents, stance.positions, parts != NO_HANDLE)
    rig = RigParts.of(character, parts)
    motion = resample_motion(motion, fps)
    world, positions = motion.world()
    turns = world.astype(np.float64) @ np.swapaxes(stance.turns, -1, -2)
    return motion_of_handles(bones_to_handles(rig, turns, positions.astype(np.float64), fps), rig.anatomy)


def _parts(motion: SkeletalMotion, names: Mapping[str, str] | None) -> np.ndarray:
    """Handle of each joint, -1 for none, shape (J,): by its name, by people's conventions, or as given."""
    from bunraku.anatomy.names.skeleton_map import map_skeleton

    skeleton = motion.skeleton
    parts = handle_of_joints(skeleton.names, skeleton.parents)
    try:
        mapped = map_skeleton(skeleton, names)
    except MotionError:
        if names:
            raise
        return parts
    for part, (joint, how) in enumerate(zip(mapped.joints, mapped.how, strict=True)):
        if joint >= 0 and (parts[joint] == NO_HANDLE or how == "given") and (how == "given" or part not in parts):
            parts[parts == part] = NO_HANDLE
            parts[joint] = part
    left_out = [JOINT_NAMES.index(name) for name, bone in (names or {}).items() if not bone and name in JOINT_NAMES]
    parts[np.isin(parts, left_out)] = NO_HANDLE
    return parts


def motion_of_handles(motion: HandleMotion, anatomy: Anatomy) -> CreatureMotion | None:
    """A motion of a character's handles, relative to the pose of its anatomy; None of a person and of any other body
    that walks upright, with wings or without.
    """
    character, handles, plan = anatomy.character, anatomy.handles, anatomy.plan
    flies = plan.wings and wing_swing(motion) > BEATS
    if (plan.kind == "person" or (plan.kind == "two legs" and plan.upright)) and not flies:
        return None  # it goes by way of the reference body
    rotations = motion.rotations.astype(np.float64).copy()
    for handle in downwards(HANDLE_PARENTS)[1:]:
        if not anatomy.own[handle]:
            rotations[:, handle] = rotations[:, HANDLE_PARENTS[handle]]
    body = reference_anatomy()
    rotations, translations = body.attached(rotations)
    seen = character.vertices[character.surface]
    reach = Reach.of(seen, handles.weights[character.surface])
    ground = reach.lowest(motion.transforms(handles.positions))
    floor = float(seen[:, 1].min())
    path = motion.root_translation.astype(np.float64)
    rise = float(np.quantile(ground, STANDS))
    path[:, 1] -= rise - floor
    scale = float(body.handles.positions[0, 1]) / max(float(handles.positions[0, 1]) - floor, 0.02 * character.height)
    moved = replace(motion, rotations=rotations, translations=translations, root_translation=path * scale).of_own_body()
    return CreatureMotion(in_air(moved) if flies else moved, plan, (ground - rise) * scale, flies)


def fit_body(
    source: HandleMotion | CreatureMotion, body: Anatomy | RigParts, stages: Stages
) -> Animation | RigAnimation:
    """A motion of the reference body or of a creature on a character that stands in its rest pose: on its handles, or
    on the bones of its rig. CharacterError where it lacks what carries the source (see `check_plans`).
    """
    anatomy = body.anatomy if isinstance(body, RigParts) else body
    if isinstance(source, CreatureMotion) and not source.suits(anatomy.plan):
        assert source.person is not None
        source = source.person
    if isinstance(source, HandleMotion):
        if isinstance(body, RigParts):
            return fit_rig(source, body, stages)
        return Animation(body.character, body.handles, fit_motion(source, body, stages), source)
    check_plans(source.plan, anatomy.plan, anatomy.character.name, source.flies)
    own = isinstance(body, RigParts)
    # two of which compare with a person
    stages = replace(stages, rest_pose=False, hands=False, shape=stages.shape and not own)
    # what flies, swims or slides keeps the height of its path
    heights = source.heights if source.plan.legs and not source.flies else None
    motion = stiff(source.motion) if own else source.motion
    fitted = fit_motion(motion, anatomy, stages, heights)
    for goal in source.goals:
        fitted = reached(fitted, anatomy.unturned, *goal)
    if isinstance(body, RigParts):
        return on_bones(body, fitted)
    return Animation(body.character, body.handles, fitted, motion_to_reference(fitted, body, own=True))
