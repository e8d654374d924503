"""Stages for limbs at rest: the rest pose is met, limbs stay joined, those of rigid blocks stay rigid, and limbs that a
body lacks or that the motion does not move are held.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.anatomy.handles.limbs import ARMS, LEGS
from bunraku.anatomy.joints import Joints, downwards, reference_joints
from bunraku.anatomy.rest_pose import WHOLE_LIMBS, pieces
from bunraku.core.body.layout import CHEST
from bunraku.core.body.reference import capped
from bunraku.core.character import Handles
from bunraku.core.geometry.curves import gaussian
from bunraku.core.geometry.rotations import (
    axis_angle_from_matrix,
    facing_and_tilt,
    matrix_from_axis_angle,
    rotation_between,
)
from bunraku.retarget.stages.stage import Fitting, Stage


@dataclass(frozen=True)
class RestPose(Stage, name="rest_pose"):
    """Limbs are rotated from the character's rest direction into the reference body's.

    A limb that rests in another direction (arms down, A-pose, sitting, the front legs of a dog) is first turned into
    the reference's, so the motion means the same (`Anatomy.rotations`).
    """

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        return replace(fitting, rotations=fitting.rotations @ anatomy.rotations)


@dataclass(frozen=True)
class Level(Stage, name="level", needs=("rest_pose",)):
    """Bodies that lie along their spine take a third of a person's tilt of the pelvis.

    A person bends over by tilting the pelvis; on a body that lies along its spine the same tilt would stand it on its
    head. The turn about +Y stays whole.
    """

    parts: float = 3  # of so many parts of the tilt one is kept

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return not fitting.source.own_kind and not anatomy.upright

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        facing, tilt = facing_and_tilt(fitting.source.root_rotation, fitting.source.fps)
        less = matrix_from_axis_angle(axis_angle_from_matrix(tilt) / self.parts)
        return replace(fitting, root_rotation=np.asarray(facing @ less))


@dataclass(frozen=True)
class Attach(Stage, name="attach"):
    """Handles stay joined to their parents.

    Each is joined at the place where its weights and its parent's meet. This takes the place of the learned adaptation
    delta (section 3.2 of TapMo) where bones are longer or shorter than the reference's. Soft bending and shrugs, which
    the motion has beyond stiff joints, are added in the character's scale; rigid blocks have none.
    """

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        source, handles = fitting.source, anatomy.handles
        rotations, translations = anatomy.attached(fitting.rotations)
        if handles.rigid:
            return replace(fitting, rotations=rotations, translations=translations)
        stiff = reference_anatomy().attached(source.rotations.astype(np.float64))[1]
        residual = capped(source.translations - stiff, source.soft)
        translations += residual[:, handles.played] * anatomy.scale * anatomy.joints.present[:, None]
        return replace(fitting, rotations=rotations, translations=translations)


@dataclass(frozen=True)
class Blocks(Stage, name="blocks"):
    """Arms and legs of one rigid block point to where a person's hand or foot is.

    A block takes the turn of the upper arm or the thigh, and is swung from there by the least turn that makes it point
    along the whole limb.
    """

    # How much the upper part counts beside the whole limb, so that a hand at the shoulder gives a direction.
    folded: float = 0.05

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return anatomy.handles.rigid

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        rest, rotations = reference_joints().positions, fitting.rotations.copy()
        for limb in WHOLE_LIMBS:
            for handle, end in pieces(limb, anatomy.joints):
                chain = pairwise(limb[limb.index(handle) : limb.index(end) + 1])
                rotated = fitting.rotations
                posed = sum(np.einsum("nij,j->ni", rotated[:, joint], rest[two] - rest[joint]) for joint, two in chain)
                turns = fitting.rotations[:, handle]
                straight = np.einsum("nij,j->ni", turns, rest[end] - rest[handle])
                rotations[:, handle] = rotation_between(straight, posed + self.folded * straight) @ turns
        return replace(fitting, rotations=rotations)


_ARM_HANDLES, _LEGS = ([*left, *right] for left, right in (ARMS, LEGS))


@dataclass(frozen=True)
class Legless(Stage, name="legless", needs=("rest_pose",)):
    """The foot of a snail takes no steps, and the branches of a tree do not swing as arms.

    A body has no legs where nothing of it reaches the ground on either side as a leg does, and it is no person's where
    it has no arms either (`Anatomy.plan`). The predictor still shares its lower end between two legs, and a person's
    steps would tear that apart. Arms of what lies are left to `fins` where the motion was drawn for such a body. Limbs
    that the bones of a rig name are there, whatever hangs on them.
    """

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return not anatomy.named and anatomy.plan.kind == "no legs"

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        played, rotations = anatomy.handles.played, fitting.rotations.copy()
        rotations[:, np.isin(played, _LEGS)] = np.eye(3)
        if anatomy.upright or not fitting.source.own_kind:
            rotations[:, np.isin(played, _ARM_HANDLES)] = rotations[:, [CHEST]]
        return replace(fitting, rotations=rotations)


_PARTS = [part for arm in ARMS for part in arm]


@dataclass(frozen=True)
class Fins(Stage, name="fins", needs=("rest_pose",)):
    """Fins, claws and forelegs that nothing was drawn for stay near their rest."""

    # Arms that are off the trunk's turn by no more on average were not drawn [rad].
    undrawn: float = float(np.radians(6))
    # Each part of a fin is held so far from its rest at the most, but for its swings [rad].
    aside: float = float(np.radians(10))
    slow: float = 0.5  # what changes more slowly than this is how a fin is held, and no swing [s]

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        if not fitting.source.own_kind or anatomy.upright:
            return False
        return not anatomy.legs or anatomy.has_extra_legs or not self.drawn(fitting.source.rotations)

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        drawn = self.drawn(fitting.source.rotations)
        held = self.held(fitting.rotations, anatomy.handles, anatomy.joints, drawn, fitting.source.fps)
        return replace(fitting, rotations=held)

    def drawn(self, rotations: np.ndarray) -> bool:
        """Whether arms move of their own in a motion of the reference body, whose rotations (N, 30, 3, 3) are given."""
        chest = rotations[:, CHEST].astype(np.float64).transpose(0, 2, 1)
        upper = [handle for arm in ARMS for handle in arm[:2]]
        turns = axis_angle_from_matrix(chest[:, None] @ rotations[:, upper].astype(np.float64))
        return bool(np.linalg.norm(turns, axis=-1).mean() > self.undrawn)

    def held(self, rotations: np.ndarray, handles: Handles, joints: Joints, drawn: bool, fps: float) -> np.ndarray:
        """Rotations (N, K, 3, 3) of a character's handles from its rest pose, in the root's frame, in which arms rest
        where they were not `drawn`, and are held near their rest where they were.
        """
        before = rotations.astype(np.float64)
        out = before.copy()
        for handle in downwards(joints.parents):
            if int(handles.played[handle]) in _PARTS and joints.present[handle]:
                parent = int(joints.parents[handle])
                turned = before[:, parent].transpose(0, 2, 1) @ before[:, handle]
                out[:, handle] = out[:, parent] @ self._nearer(turned, fps) if drawn else out[:, parent]
        return out

    def _nearer(self, turned: np.ndarray, fps: float) -> np.ndarray:
        """Turns from rest (N, 3, 3) of which no more than `aside` is left of what lasts."""
        lasts = gaussian(np.asarray(axis_angle_from_matrix(turned)), self.slow * fps)
        angle = np.linalg.norm(lasts, axis=-1, keepdims=True)
        kept = matrix_from_axis_angle(lasts * np.minimum(1, self.aside / np.maximum(angle, 1e-9)))
        return np.asarray(kept @ matrix_from_axis_angle(lasts).transpose(0, 2, 1) @ turned)
