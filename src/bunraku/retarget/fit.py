"""From the reference body to any character: the analytic adaptation of a handle motion.

The diffusion model speaks of the reference body: its proportions and its T-pose. Named stages, each of which can be
switched off, clean its motion and turn it into one of another character. They run in this order:

- `smooth`: the generator's noise is taken out and fast moves stay (`retarget/stages/smooth.py`).
- `rest_pose`: a limb that rests in another direction than the reference body's (arms down, A-pose, sitting, the front
  legs of a dog) is first turned into the reference's direction, so the motion means the same. Bodies that lie along
  their spine take a third of the pelvis' tilt. Fins and claws stay near their rest (`retarget/creatures/fins.py`).
  Tails of creatures that are held up higher than they rest are lowered (`retarget/creatures/tail.py`), whether this
  stage runs or not.
- `attach`: local translations are set so that each handle stays joined to its parent at the place where their weights
  meet. It takes the place of the learned adaptation delta (section 3.2 of TapMo) where bones are longer or shorter than
  the reference's.
- `shape`: handles move a little where that keeps the mesh's edges at their lengths (`retarget/stages/shape.py`); off
  unless asked for, as everything that makes a motion for a character does, and nothing that takes one back from it and
  on.
- `ground`: the lowest point of what the character stands on is as high above the ground, in its own scale, as that of
  the reference body, and a reference body that drifts off the ground for longer than a jump lasts is set back on it.
  A `native` motion keeps its own height where the body has wings or no legs or is upright, but what hovers by less
  than a fifth of the body is set down. Heads of bodies that lie along their spine are kept out of the ground before
  that (`retarget/creatures/front.py`).
- `support`: who stands on four legs keeps two of them under each end of the trunk
  (`retarget/stages/support.py`).
- `feet`: feet that stand do not slide: the root's path and then the legs make up for it (`retarget/stages/feet.py`).
- `hands`: hands that touch the body stay near it (`retarget/stages/hands.py`); off unless asked for, as motion transfer
  does.
- `floor`: nothing sinks into the ground, and feet that stand are on it (`retarget/stages/floor.py`); a tail that would
  sink is turned up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.joints import attach_joints, reference_joints
from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.body.residuals import capped
from bunraku.core.motion import HandleMotion
from bunraku.geometry.heading import heading
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, matrix_y
from bunraku.retarget.stages.feet import lock_feet
from bunraku.retarget.stages.fins import drawn_arms, held_fins
from bunraku.retarget.stages.floor import settle_on_floor
from bunraku.retarget.stages.front import raised_front
from bunraku.retarget.stages.gait import stepping
from bunraku.retarget.stages.ground import set_on_ground, settle_hovering
from bunraku.retarget.stages.hands import keep_hands
from bunraku.retarget.stages.shape import keep_edges
from bunraku.retarget.stages.smooth import smooth
from bunraku.retarget.stages.support import keep_support
from bunraku.retarget.stages.tail import lowered_tail, raised_tail

__all__ = ["Stages", "fit_motion"]

_WINGS = [HANDLE_NAMES.index(f"{side}_wing") for side in ("left", "right")]


@dataclass(frozen=True)
class Stages:
    """Which stages run after sampling.

    Args:
        rest_pose: Turn limbs from the character's rest direction into the reference body's.
        attach: Keep handles joined to their parents.
        ground: Keep the character as high above the ground as the reference body.
        feet: Hold feet in place while they stand.
        smooth: Take the generator's noise out.
        floor: Let nothing sink into the ground.
        hands: Keep hands near the body where the reference body's are.
        shape: Keep the mesh's edges at their lengths where handles can.
        support: Keep legs under the trunk of who stands on four.
    """

    rest_pose: bool = True
    attach: bool = True
    ground: bool = True
    feet: bool = True
    smooth: bool = True
    floor: bool = True
    hands: bool = False
    shape: bool = False
    support: bool = True


def fit_motion(
    motion: HandleMotion, anatomy: Anatomy, stages: Stages | None = None, heights: np.ndarray | None = None
) -> HandleMotion:
    """A handle motion of the reference body, fitted to a character.

    Args:
        motion: Motion of the reference body's handles, feet on y = 0. One that is `native` keeps its
            own height, but for hovering: a bird stays in the air.
        anatomy: Of the character.
        stages: Which stages run; all but `hands` and `shape` when None.
        heights: Of the lowest point of the body that moves, where that is not the reference body, in its scale [m],
            shape (N,).

    Returns:
        The motion for the character, its root path scaled by the height of the root handle above the floor.
    """
    stages = stages or Stages()
    body = reference_body()
    if stages.smooth:
        motion = smooth(motion)
    if not stages.rest_pose:
        anatomy = anatomy.unturned
    character, handles, joints = anatomy.mesh, anatomy.mesh_handles, anatomy.joints
    rotations = stepping(motion, handles)
    if stages.rest_pose:
        rotations = rotations @ anatomy.rotations
    legs, level = anatomy.legs, not anatomy.upright
    if motion.native:
        drawn = not level or drawn_arms(motion.rotations)
        if stages.rest_pose and level and (not drawn or not legs or handles.roles is not None):
            rotations = held_fins(rotations, handles, joints, drawn, motion.fps)
        rotations = lowered_tail(rotations, handles, joints, motion.fps)
        if stages.ground and legs and level:
            motion, rotations = raised_front(motion, rotations, character, handles, joints)
    scale, stands, floor = anatomy.scale, anatomy.stands, anatomy.floor
    if stages.attach:
        rotations, translations = attach_joints(rotations, handles, joints)
        stiff = attach_joints(motion.rotations.astype(np.float64), body.handles, reference_joints())[1]
        residual = capped(motion.translations - stiff, motion.native)  # soft bending and shrugs
        translations += residual[:, handles.played] * scale * joints.present[:, None]
    else:
        translations = motion.translations[:, handles.played] * scale
    if stages.shape:
        translations = translations + keep_edges(rotations, translations, anatomy.character, anatomy.handles, scale)
    fitted = replace(motion, rotations=rotations, translations=translations, root_translation=anatomy.path(motion))
    if stages.rest_pose and not motion.native and level:
        fitted = replace(fitted, root_rotation=_levelled(motion.root_rotation, motion.fps))
    if stages.ground and motion.native and heights is None:  # it brings its own height: a bird stays in the air
        flies = not legs or not level or bool(joints.present[_WINGS].all())  # who is upright may climb or hang
        fitted = settle_hovering(fitted, character, handles, stands, flies)
    elif stages.ground:
        fitted = set_on_ground(motion, fitted, character, handles, scale, stands, heights)
    if stages.feet or stages.floor or stages.hands or stages.support:
        contacts = None
        if stages.support:
            fitted = keep_support(fitted, character, handles, joints, legs, floor)
        if stages.feet:
            fitted, contacts = lock_feet(fitted, character, handles, joints, legs, floor)
        if stages.hands:
            fitted = keep_hands(motion, fitted, character, handles, joints, anatomy.rotations, anatomy.arms, scale)
        if stages.floor:
            if legs:
                fitted = raised_tail(fitted, character, handles, joints, floor)
            fitted = settle_on_floor(fitted, character, handles, joints, legs, anatomy.arms, contacts, stands, floor)
    return fitted


def _levelled(root_rotation: np.ndarray, fps: float) -> np.ndarray:
    """Root rotations whose turn about +Y is kept and whose tilt is a third.

    A person bends over by tilting the pelvis; on a body that lies along its spine the same tilt would stand it on its
    head.
    """
    facing = matrix_y(heading(root_rotation, fps))
    tilt = axis_angle_from_matrix(facing.transpose(0, 2, 1) @ root_rotation)
    return np.asarray(facing @ matrix_from_axis_angle(tilt / 3))
