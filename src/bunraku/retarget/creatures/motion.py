"""Motion of a body that is no person, relative to the pose in which that body stands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.ground import lowest
from bunraku.anatomy.joints import attach_joints, downwards, reference_joints
from bunraku.anatomy.plan import BodyPlan
from bunraku.body.layout import HANDLE_PARENTS, JOINT_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.core.resample import resample, resample_motion
from bunraku.errors import MotionError
from bunraku.geometry.resampling import Resampling
from bunraku.retarget.creatures.stance import find_limbs, find_stance
from bunraku.retarget.creatures.sticks import stick_character
from bunraku.retarget.creatures.ways import BEATS, in_air, wing_swing
from bunraku.retarget.rig_motion import bones_to_handles
from bunraku.retarget.rig_parts import RigParts
from bunraku.skeletons.bone_names import NO_HANDLE, handle_of_joints

__all__ = ["CreatureMotion", "motion_of_handles", "motion_of_rig", "motion_of_skeleton"]

STANDS = 0.05  # share of frames whose lowest point may be under the ground


@dataclass(frozen=True, eq=False)
class CreatureMotion:
    """Motion of a body that is no person.

    Args:
        motion: Of 30 handles with the reference body's meaning. Rotations are relative to the pose in which the body
            stands, and not to the T-pose; what the body lacks moves with its parents; joints hold. The root's path is
            in the scale of the reference body, whose pelvis is as high above the ground as the body's root is.
        plan: What the body stands and moves with.
        heights: Of its lowest point over the ground, in the same scale [m], shape (N,).
        flies: Whether wings that beat carry it.
        person: Of a body that lies along its spine and walks on two legs: the same by way of the reference body, for
            characters of other kinds.
    """

    motion: HandleMotion
    plan: BodyPlan
    heights: np.ndarray
    flies: bool = False
    person: HandleMotion | None = None

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
    """The motion of an animal's skeleton; None where no four legs are seen to carry a level trunk, as of people.

    Args:
        motion: Of any skeleton, +Y up [m].
        fps: Frames a second of the result [1/s].
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
    return motion_of_rig(rig, turns, positions.astype(np.float64), fps)


def _parts(motion: SkeletalMotion, names: Mapping[str, str] | None) -> np.ndarray:
    """Handle of each joint, -1 for none, shape (J,): by its name, by people's conventions, or as given."""
    from bunraku.skeletons.skeleton_map import map_skeleton

    skeleton = motion.skeleton
    parts = handle_of_joints(skeleton.names, skeleton.parents)
    try:
        found = map_skeleton(skeleton, names)
    except MotionError:
        if names:
            raise
        return parts
    for part, (joint, how) in enumerate(zip(found.joints, found.how, strict=True)):
        if joint >= 0 and (parts[joint] == NO_HANDLE or how == "given") and (how == "given" or part not in parts):
            parts[parts == part] = NO_HANDLE
            parts[joint] = part
    for name, own in (names or {}).items():
        if not own and name in JOINT_NAMES:
            parts[parts == JOINT_NAMES.index(name)] = NO_HANDLE
    return parts


def motion_of_rig(rig: RigParts, turns: np.ndarray, positions: np.ndarray, fps: float) -> CreatureMotion | None:
    """The motion of a rig that stands in its rest pose; None of a person and of whoever else goes upright on two legs.

    Args:
        rig: Facing +Z.
        turns: World rotation of each bone from the rest pose, shape (N, J, 3, 3).
        positions: Where its head is [m], shape (N, J, 3).
        fps: Frames a second [1/s].
    """
    plan = rig.anatomy.plan
    if _as_people(plan) and not plan.wings:
        return None
    return _creature(bones_to_handles(rig, turns, positions, fps), rig.anatomy)


def motion_of_handles(motion: HandleMotion, anatomy: Anatomy) -> CreatureMotion | None:
    """A motion of a character's handles; None of a person and of whoever else goes upright on two legs.

    Args:
        motion: Of its handles.
        anatomy: Of the character, in the pose that the motion is relative to.
    """
    return None if _as_people(anatomy.plan) and not anatomy.plan.wings else _creature(motion, anatomy)


def _as_people(plan: BodyPlan) -> bool:
    """Whether a body that walks goes by way of the reference body."""
    return plan.kind == "person" or (plan.kind == "two legs" and plan.upright)


def _creature(motion: HandleMotion, anatomy: Anatomy) -> CreatureMotion | None:
    """A motion of a character's handles in the words of `CreatureMotion`; None of one with wings that goes on its legs
    as people do.
    """
    character, handles, joints, plan = anatomy.character, anatomy.handles, anatomy.joints, anatomy.plan
    flies = plan.wings and wing_swing(motion) > BEATS
    if _as_people(plan) and not flies:
        return None
    own = joints.present & (handles.played == np.arange(len(handles.positions)))
    rotations = motion.rotations.astype(np.float64).copy()
    for handle in downwards(HANDLE_PARENTS)[1:]:
        if not own[handle]:
            rotations[:, handle] = rotations[:, HANDLE_PARENTS[handle]]
    body = reference_body()
    rotations, translations = attach_joints(rotations, body.handles, reference_joints())
    seen = character.vertices[character.surface]
    ground = lowest(seen, handles.weights[character.surface], motion, handles.positions)
    floor = float(seen[:, 1].min())
    path = motion.root_translation.astype(np.float64)
    rise = float(np.quantile(ground, STANDS))
    path[:, 1] -= rise - floor
    scale = float(body.handles.positions[0, 1]) / max(float(handles.positions[0, 1]) - floor, 0.02 * character.height)
    moved = replace(motion, rotations=rotations, translations=translations, root_translation=path * scale).of_own_body()
    return CreatureMotion(in_air(moved) if flies else moved, plan, (ground - rise) * scale, flies)
