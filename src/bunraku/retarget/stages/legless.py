"""Limbs that a body does not have: what the predictor takes for them goes along with the trunk."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.layout import HANDLE_NAMES
from bunraku.handles.limbs import FAMILIES, SIDES, limb_handles
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Legless"]

_ARMS, _LEGS = (
    [handle for side in SIDES for handle in limb_handles(side, family)] for family in (FAMILIES[1], FAMILIES[0])
)
_CHEST = HANDLE_NAMES.index("spine3")


@dataclass(frozen=True)
class Legless(Stage):
    """The foot of a snail takes no steps, and the branches of a tree do not swing as arms.

    A body has no legs where nothing of it reaches the ground on either side as a leg does, and it is no person's where
    it has no arms either (`Anatomy.plan`). The predictor still shares its lower end between two legs, and a person's
    steps would tear that apart. Arms of what lies are left to `fins` where the motion was drawn for such a body. Limbs
    that the bones of a rig name are there, whatever hangs on them.
    """

    name: ClassVar[str] = "legless"
    needs: ClassVar[tuple[str, ...]] = ("rest_pose",)

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        named = anatomy.known is not None and not anatomy.handles.rigid
        return not named and anatomy.plan.kind == "no legs"

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        played, rotations = anatomy.handles.played, fitting.rotations.copy()
        rotations[:, np.isin(played, _LEGS)] = np.eye(3)
        if anatomy.upright or not fitting.source.own_kind:
            rotations[:, np.isin(played, _ARMS)] = rotations[:, [_CHEST]]
        return replace(fitting, rotations=rotations)
