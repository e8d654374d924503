"""Which joint of a skeleton is which of SMPL's 22: the result of asking."""

from __future__ import annotations

from dataclasses import dataclass

from bunraku.body.layout import JOINT_NAMES

__all__ = ["SkeletonMap"]

_J = {name: index for index, name in enumerate(JOINT_NAMES)}


@dataclass(frozen=True)
class SkeletonMap:
    """Joints of a skeleton by SMPL's names.

    Args:
        joints: Index of the joint of each of SMPL's 22, -1 where there is none.
        how: What each was found by: "given", "name", "rig", "hierarchy" or "structure"; "" where there is none.
        convention: Who names joints like this, as far as that is plain; "" otherwise.
    """

    joints: tuple[int, ...]
    how: tuple[str, ...]
    convention: str = ""

    def of(self, name: str) -> int:
        """Index of the joint for one of SMPL's names, -1 for none."""
        return self.joints[_J[name]]

    @property
    def missing(self) -> tuple[str, ...]:
        """SMPL's names that no joint has."""
        return tuple(name for name, joint in zip(JOINT_NAMES, self.joints, strict=True) if joint < 0)
