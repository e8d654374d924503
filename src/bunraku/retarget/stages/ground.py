"""Feet on the floor: how high a character stands and how its lowest point follows the reference body's."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d, minimum_filter1d, uniform_filter1d

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.ground import lowest, standing
from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.motion import HandleMotion
from bunraku.geometry.easing import smooth_step
from bunraku.retarget.stages.stage import Fitting, Stage

__all__ = ["Ground"]

_WINGS = [HANDLE_NAMES.index(f"{side}_wing") for side in ("left", "right")]


@dataclass(frozen=True)
class Ground(Stage):
    """The lowest point is as high above the ground as the reference body's.


    That of what the character stands on, in its own scale. A reference body that drifts off the ground for longer than
    a jump lasts is set back on it. A motion that brings its own height keeps it where the body has wings or no legs or
    is upright, but what hovers by less than `flies` of the body's height is set down.

    Args:
        flies: Heights over the ground, as shares of the body's, between which what hovers becomes what flies.
        jump: Nobody stays in the air for twice as long [s].
        soft: How softly the ground of a hovering body is found [s].
    """

    name: ClassVar[str] = "ground"

    flies: tuple[float, float] = (0.12, 0.2)
    jump: float = 0.75
    soft: float = 0.25

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        motion = fitting.motion
        if not fitting.source.own_height or fitting.heights is not None:
            return fitting.moved(self.followed(fitting.source, motion, anatomy, fitting.heights))
        wings = bool(anatomy.joints.present[_WINGS].all())
        flies = not anatomy.legs or anatomy.upright or wings  # who is upright may climb or hang
        return fitting.moved(self.settled(motion, anatomy, flies))

    def followed(
        self,
        motion: HandleMotion,
        fitted: HandleMotion,
        anatomy: Anatomy,
        heights: np.ndarray | None = None,
    ) -> HandleMotion:
        """The fitted motion with its lowest point as high over the floor, that of its rest pose, as the reference
        body's is over y = 0.

        The reference body's own drift off the ground is taken out first. Nobody stays in the air for a second, so the
        lowest height within 0.75 s of a frame is where the ground is for that frame.

        Args:
            motion: Of the reference body.
            fitted: Of the character.
            anatomy: Of the character.
            heights: Of the lowest point of another body than the reference body, in the reference body's scale [m],
                shape (N,).
        """
        character, handles, stands = anatomy.mesh, anatomy.mesh_handles, anatomy.stands
        body = reference_body()
        want = (
            lowest(body.vertices, body.handle_weights, motion, body.handles.positions) if heights is None else heights
        )
        window = 2 * round(self.jump * motion.fps) + 1
        drift = gaussian_filter1d(
            minimum_filter1d(want, window, mode="nearest"), self.soft * motion.fps, mode="nearest"
        )
        have = lowest(character.vertices[stands], handles.weights[stands], fitted, handles.positions)
        seen = character.surface
        if heights is None and stands.sum() < seen.sum():
            feet = standing(body.character(), body.handles)
            hands_down = (
                lowest(body.vertices[feet], body.handle_weights[feet], motion, body.handles.positions) > want + 0.01
            )
            if hands_down.any():
                have = np.where(
                    hands_down, lowest(character.vertices[seen], handles.weights[seen], fitted, handles.positions), have
                )
        lift = uniform_filter1d(anatomy.floor + (want - drift) * anatomy.scale - have, 5, mode="nearest")
        moved = fitted.root_translation.copy()
        moved[:, 1] += lift
        return replace(fitted, root_translation=moved)

    def settled(self, fitted: HandleMotion, anatomy: Anatomy, flies: bool = True) -> HandleMotion:
        """A motion that was generated for this very body, set down where it hovers: it brings its own height over the
        floor, and generators are a few centimetres off.

        Jumps keep their height (`hovering`), and what can fly and is farther up than `flies` means to be there.

        Args:
            fitted: Motion of the character.
            anatomy: Of the character.
            flies: Whether the body can be off the ground for long: with wings, without legs, or where it climbs.
        """
        hovers = self.hovering(fitted, anatomy)
        if flies:
            hovers = hovers * (1 - smooth_step(hovers / anatomy.mesh.height, *self.flies))
        moved = fitted.root_translation.copy()
        moved[:, 1] -= hovers
        return replace(fitted, root_translation=moved)

    def hovering(self, fitted: HandleMotion, anatomy: Anatomy, air: float | None = None) -> np.ndarray:
        """How far a body is off the ground in each frame but for its jumps [m], shape (N,).

        Nobody stays in the air for a second, so the lowest height within 0.75 s of a frame is where the body thinks the
        ground is; it goes up and down softly. Who walks or runs is in the air for a shorter time, if at all, and is on
        the ground otherwise.

        Args:
            fitted: Motion of the character.
            anatomy: Of the character.
            air: Half of the time that the body is in the air at the most [s]; None for the 0.75 s.
        """
        character, handles, stands = anatomy.mesh, anatomy.mesh_handles, anatomy.stands
        have = lowest(character.vertices[stands], handles.weights[stands], fitted, handles.positions) - anatomy.floor
        window = 2 * round((self.jump if air is None else air) * fitted.fps) + 1
        low = minimum_filter1d(have, window, mode="nearest")
        if air is None:
            hovers = gaussian_filter1d(low, self.soft * fitted.fps, mode="nearest")
        else:
            hovers = maximum_filter1d(low, window, mode="nearest")
        return np.asarray(np.maximum(hovers, 0))
