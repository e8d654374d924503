"""What a stage of fitting is, and what goes from one stage to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.legs import LEAST_SHIFT, Leg, move_feet
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin


def with_feet_moved(
    motion: HandleMotion, anatomy: Anatomy, legs: list[Leg], shifts: np.ndarray, slopes: np.ndarray | None = None
) -> HandleMotion:
    """The motion of a character with its feet, or its hands, moved by bending their limbs (`anatomy.legs.move_feet`).

    Args:
        motion: Of the character, N frames.
        legs: The limbs whose ends are moved, L.
        shifts: How far each ankle or wrist moves [m], shape (N, L, 3).
        slopes: How each foot is rotated about its ankle, in the world, shape (N, L, 3, 3); None for not at all.
    """
    if not (np.abs(shifts) > LEAST_SHIFT).any():
        return motion
    world = motion.transforms(anatomy.handles.positions).astype(np.float64)
    move_feet(world, motion.root_rotation, anatomy.joints, legs, shifts, slopes)
    return motion.with_transforms(world, anatomy.handles.positions)


def sole_points(leg: Leg, anatomy: Anatomy, transforms: np.ndarray) -> np.ndarray:
    """Where the sole of a leg is in each frame [m], shape (N, m, 3), by the transforms of the handles (N, K, 3, 4)."""
    sole = leg.sole
    return skin(anatomy.mesh.vertices[sole], anatomy.mesh_handles.weights[sole], transforms).astype(np.float64)


def near_wrist(arm: Leg, anatomy: Anatomy, share: float) -> np.ndarray:
    """Vertices of a hand nearer to its wrist than a share of the arm's length: farther out is what it holds."""
    away = np.linalg.norm(anatomy.mesh.vertices[arm.foot_area] - arm.joints[2], axis=1)
    return np.asarray(arm.foot_area[away < share * arm.length])


@dataclass(frozen=True, eq=False)
class Contacts:
    """How feet move along the ground, from each frame to the next."""

    steps: np.ndarray  # how far the lowest part of each sole moves along x and z [m], shape (N - 1, L, 2)
    stands: np.ndarray  # how much the foot stands, 0 to 1, shape (N - 1, L)


@dataclass(frozen=True, eq=False)
class Fitting:
    """A motion on its way from the reference body to a character."""

    source: HandleMotion  # the motion of the reference body, as far as stages have changed it
    rotations: np.ndarray  # local rotations of the character's handles, in the root's frame, shape (N, K, 3, 3)
    translations: np.ndarray  # their local translations [m], shape (N, K, 3)
    root_rotation: np.ndarray  # of the character, shape (N, 3, 3)
    root_translation: np.ndarray  # of the character [m], shape (N, 3)
    # Of the lowest point of the body that moves in the source, where that is not the reference body, in its scale [m],
    # shape (N,).
    heights: np.ndarray | None = None
    contacts: Contacts | None = None  # of the character's feet; None where nothing has looked for them

    @classmethod
    def of(cls, source: HandleMotion, anatomy: Anatomy, heights: np.ndarray | None = None) -> Fitting:
        """A motion of the reference body whose parts the character's handles play, in the character's scale."""
        played = anatomy.handles.played
        return cls(
            source,
            source.rotations[:, played].astype(np.float64),
            source.translations[:, played] * anatomy.scale,
            source.root_rotation,
            anatomy.path(source.root_translation, source.root_rotation),
            heights,
        )

    @property
    def motion(self) -> HandleMotion:
        """The motion of the character."""
        return self.source.with_arrays({name: getattr(self, name) for name in HandleMotion.arrays})

    def moved(self, motion: HandleMotion) -> Fitting:
        """The same with another motion of the character."""
        return replace(self, **{name: getattr(motion, name) for name in HandleMotion.arrays})


@dataclass(frozen=True)
class Stage:
    """A step on the way of a motion from the reference body to a character; its thresholds are its fields. Motions and
    the anatomy that its methods take are the character's, unless they say otherwise.

    The first line of a stage's docstring says what holds after it; the help of `--without` and the docs print it.
    """

    name: ClassVar[str]
    """By which it is switched on and off (`Stages`)."""
    needs: ClassVar[tuple[str, ...]]
    """Stages without which it does not run."""

    def __init_subclass__(cls, name: str, needs: tuple[str, ...] = ()) -> None:
        cls.name, cls.needs = name, needs

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        """Whether there is something for it to do."""
        return True

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        """The motion after it; of most stages, that of the character as they have `changed` it."""
        return fitting.moved(self.changed(fitting.motion, anatomy))

    def changed(self, motion: HandleMotion, anatomy: Anatomy) -> HandleMotion:
        """The motion of the character after it."""
        raise NotImplementedError
