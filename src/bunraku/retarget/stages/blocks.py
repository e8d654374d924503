"""Limbs of rigid blocks: the stage `blocks` of fitting."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.blocks import WHOLE_LIMBS, pieces
from bunraku.anatomy.joints import reference_joints
from bunraku.geometry.rotations import rotation_between
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Blocks"]


@dataclass(frozen=True)
class Blocks(Stage):
    """Arms and legs of one rigid block point to where a person's hand or foot is.

    A block takes the turn of the upper arm or the thigh, and is swung from there by the least turn that makes it point
    along the whole limb.

    Args:
        folded: How much the upper part counts beside the whole limb, so that a hand at the shoulder gives a direction.
    """

    name: ClassVar[str] = "blocks"

    folded: float = 0.05

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return anatomy.handles.rigid

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        known, rotations = reference_joints().positions, fitting.rotations.copy()
        for limb in WHOLE_LIMBS:
            for handle, end in pieces(limb, anatomy.joints):
                chain = limb[limb.index(handle) : limb.index(end) + 1]
                posed = sum(
                    np.einsum("nij,j->ni", fitting.rotations[:, one], known[two] - known[one])
                    for one, two in zip(chain, chain[1:], strict=False)
                )
                own = fitting.rotations[:, handle]
                straight = np.einsum("nij,j->ni", own, known[end] - known[handle])
                rotations[:, handle] = rotation_between(straight, posed + self.folded * straight) @ own
        return replace(fitting, rotations=rotations)
