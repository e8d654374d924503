"""What physics move of a character, whatever its file: rigid bodies and joints as MMD has them.

An MMD model's own are taken as they are; the spring chains of a VRM become bodies and joints (`vrm_chains`). Sizes are
in metres; springs and damping stay in the numbers of MMD files, see `world` for what they mean.

Angle limits and springs of a joint are those of Bullet, which MMD uses: they count the rotation of body A as seen from
body B, about x, then y, then z. So a skirt panel B at the front, whose joint has the world's axes, swings forwards by
*positive* angles about x.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.core.mmd_model import MmdBody, MmdJoint

__all__ = ["ApparelRig"]


@dataclass(frozen=True, eq=False)
class ApparelRig:
    """Rigid bodies and the joints between them.

    Args:
        bodies: The bodies; `MmdBody.bone` is the index of a rig joint, -1 for none.
        joints: The joints, by indices of bodies.
        notes: What of the file was left out or repaired, a sentence each.
        gravity: Acceleration that each body has of its own, in place of the world's gravity [m/s^2], shape (B, 3); None
            where it is the world's.
    """

    bodies: tuple[MmdBody, ...]
    joints: tuple[MmdJoint, ...]
    notes: tuple[str, ...] = ()
    gravity: np.ndarray | None = None

    @property
    def dynamic(self) -> tuple[int, ...]:
        """Indices of the bodies that physics move."""
        return tuple(index for index, body in enumerate(self.bodies) if body.dynamic)

    @property
    def unguarded(self) -> tuple[int, ...]:
        """Dynamic bodies that may collide but that no body which follows its bone collides with: nothing of the file
        keeps them out of the person.
        """
        still = {(body.group, body.mask) for body in self.bodies if not body.dynamic}
        return tuple(
            index
            for index in self.dynamic
            if (body := self.bodies[index]).mask
            and not any(body.mask >> group & 1 and mask >> body.group & 1 for group, mask in still)
        )
