"""Stages for the ground: how high a character stands, that nothing sinks into the ground, and long feet held flat."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.anatomy.legs import Leg, carry
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.geometry.curves import (
    correlated,
    gaussian,
    running_least,
    running_mean,
    running_most,
    smooth_step,
    solve_banded,
)
from bunraku.core.geometry.rotations import axis_angle_from_matrix, facing_and_tilt, matrix_from_axis_angle
from bunraku.core.motion import HandleMotion
from bunraku.retarget.stages.feet import add_bending
from bunraku.retarget.stages.stage import Contacts, Fitting, Stage, near_wrist, sole_points, with_feet_moved

_WINGS = [HANDLE_NAMES.index(f"{side}_wing") for side in ("left", "right")]


@dataclass(frozen=True)
class Ground(Stage, name="ground"):
    """The lowest point is as high above the ground as the reference body's.

    That of what the character stands on, in its own scale. A reference body that drifts off the ground for longer than
    a jump lasts is set back on it. A motion that brings its own height keeps it where the body has wings or no legs or
    is upright, but what hovers by less than `flies` of the body's height is set down.
    """

    # Heights over the ground, as shares of the body's, between which what hovers becomes what flies.
    flies: tuple[float, float] = (0.12, 0.2)
    jump: float = 0.75  # half of the longest time that a body stays in the air [s]
    soft: float = 0.25  # how softly the ground of a hovering body is found [s]
    held: float = 0.25  # how far below feet, seat and back the hands of a body are that stands on them [m]

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        motion = fitting.motion
        if not fitting.source.own_height or fitting.heights is not None:
            return fitting.moved(self.followed(fitting.source, motion, anatomy, fitting.heights))
        wings = bool(anatomy.own[_WINGS].all())
        flies = not anatomy.legs or anatomy.upright or wings  # an upright body may climb or hang
        return fitting.moved(self.grounded(motion, anatomy, flies))

    def _stood(self, motion: HandleMotion) -> tuple[np.ndarray, np.ndarray]:
        """How high all but the arms of the reference body is, and what it stands on, in each frame [m], (N,) each."""
        body, source = reference_anatomy(), motion.transforms(reference_anatomy().handles.positions)
        below = body.reach.lowest(source)
        return below, self._ground_of(below, body.surface_reach.lowest(source), motion.fps)

    def followed(
        self, motion: HandleMotion, fitted: HandleMotion, anatomy: Anatomy, heights: np.ndarray | None = None
    ) -> HandleMotion:
        """The fitted motion with its lowest point as high over the floor, that of its rest pose, as that of the
        reference body's motion is over y = 0. The reference body's own drift off the ground is taken out first.
        `heights` (N,) are those of the lowest point of another body than the reference body, in its scale [m].
        """
        world = fitted.transforms(anatomy.handles.positions)
        have = anatomy.reach.lowest(world)
        if heights is None:
            below, want = self._stood(motion)
            hands_down = below > want + 0.01
            if hands_down.any() and anatomy.stands.sum() < anatomy.mesh.surface.sum():
                have = np.where(hands_down, anatomy.surface_reach.lowest(world), have)
        else:
            want = np.asarray(heights)
        drift = self._local_ground(want, motion.fps)
        lift = running_mean(anatomy.floor + (want - drift) * anatomy.scale - have, 5)
        moved = fitted.root_translation.copy()
        moved[:, 1] += lift
        return replace(fitted, root_translation=moved)

    def _ground_of(self, stands: np.ndarray, whole: np.ndarray, fps: float) -> np.ndarray:
        """Height of the lowest point of the reference body [m], shape (N,), but for hands that have sunk in.

        The ground is where feet, seat or back are, which come down to it again and again: `stands` (N,) is the height
        of the lowest point of all but the arms, `whole` (N,) that of all. Hands below it have sunk in, and must not
        lift the feet. Hands carry the body where they are far below all else for longer than a jump lasts.
        """
        carried = running_least(stands - whole, self._window(fps)) > self.held
        ground = np.where(carried, whole, self._local_ground(stands, fps))
        return np.asarray(np.minimum(stands, np.maximum(whole, ground)))

    def _local_ground(self, heights: np.ndarray, fps: float) -> np.ndarray:
        """Where the ground is in each frame [m], shape (N,): the lowest height within `jump` seconds."""
        low = running_least(heights, self._window(fps))
        return np.asarray(gaussian(low, self.soft * fps))

    def _window(self, fps: float, air: float | None = None) -> int:
        """Frames in which a body touches the ground once at least, from half of the time in the air [s]."""
        return 2 * round((self.jump if air is None else air) * fps) + 1

    def grounded(self, fitted: HandleMotion, anatomy: Anatomy, flies: bool = True) -> HandleMotion:
        """A motion that was generated for this very body, set down where it hovers: generators are a few centimetres
        off. Jumps keep their height (`hovering`). A body `flies` that can be off the ground for long: with wings,
        without legs, or where it climbs.
        """
        hovers = self.hovering(fitted, anatomy)
        if flies:
            hovers = hovers * (1 - smooth_step(hovers / anatomy.mesh.height, *self.flies))
        moved = fitted.root_translation.copy()
        moved[:, 1] -= hovers
        return replace(fitted, root_translation=moved)

    def hovering(self, fitted: HandleMotion, anatomy: Anatomy, air: float | None = None) -> np.ndarray:
        """How far a body is off the ground in each frame but for its jumps [m], shape (N,).

        No jump lasts two seconds, so the lowest height within `jump` of a frame is where the ground is; it goes up and
        down softly. A body that walks or runs is in the air for a shorter time, half of which is at most `air` [s], and
        on the ground otherwise.
        """
        have = anatomy.reach.lowest(fitted.transforms(anatomy.handles.positions)) - anatomy.floor
        if air is None:
            hovers = self._local_ground(have, fitted.fps)
        else:
            window = self._window(fitted.fps, air)
            hovers = running_most(running_least(have, window), window)
        return np.asarray(np.maximum(hovers, 0))


def enough(need: np.ndarray, reach: int) -> np.ndarray:
    """A smooth curve that is nowhere below another one and nowhere larger than that is within twice `reach` frames,
    shape (N,).
    """
    if not need.any():
        return np.zeros(len(need))
    window = np.hanning(2 * reach + 3)[1:-1]
    return np.asarray(correlated(running_most(need, 2 * reach + 1), window / window.sum()))


def _lifted(motion: HandleMotion, lift: np.ndarray) -> HandleMotion:
    if not lift.any():
        return motion
    path = motion.root_translation.astype(np.float64)
    path[:, 1] += lift
    return replace(motion, root_translation=path)


@dataclass(frozen=True)
class Floor(Stage, name="floor"):
    """Nothing sinks into the ground, and feet that stand, and legs of a body that lies, are on it."""

    hand: float = 0.45  # how far from the wrist a hand reaches, over the arm's length; farther out is what it holds
    depth: float = 0.002  # what sinks less than this share of the height is left as it is
    spread: float = 0.15  # how long before and after it is needed a lift begins and ends [s]
    lowered: float = 0.08  # how far a standing foot that floats is put down at the most, over the leg's length
    hold: float = 10.0  # weight of the heights of standing feet, over the acceleration of their correction
    pull: float = 0.05  # weight of the heights of other feet
    air: float = 0.75  # half of the longest time that a body on legs that do not bend stays in the air [s]
    # A body on such legs that is farther up than between these shares of the height climbs or flies.
    flies: tuple[float, float] = (0.12, 0.2)
    lies: float = 0.6  # how far the pelvis of the reference body is under its standing height where it lies [m]
    raised: float = 0.3  # legs whose soles are higher over the ground in the reference body are meant to be up [m]

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        motion = fitting.motion
        if anatomy.is_person and fitting.heights is None:
            motion = self.rested(motion, fitting.source, anatomy)
        stiff = bool(anatomy.legs) and all(leg.upper == leg.lower for leg in anatomy.legs)
        if stiff and fitting.heights is None:
            motion = self.vaulted(motion, fitting.source, anatomy)
        return fitting.moved(self.grounded(motion, anatomy, fitting.contacts))

    def vaulted(self, motion: HandleMotion, source: HandleMotion, anatomy: Anatomy) -> HandleMotion:
        """A motion on legs that do not bend, as high in each frame as the reference body over the ground: no knee makes
        up for a body that goes up and down otherwise than its legs do.
        """
        have = anatomy.reach.lowest(motion.transforms(anatomy.handles.positions)) - anatomy.floor
        body = reference_anatomy()
        want = body.surface_reach.lowest(source.transforms(body.handles.positions))
        air = want - running_least(want, 2 * round(self.air * source.fps) + 1)
        up, down = np.maximum(air * anatomy.scale - have, 0), np.maximum(have - air * anatomy.leap, 0)
        return _lifted(motion, up - down * (1 - smooth_step(down / anatomy.mesh.height, *self.flies)))

    def rested(self, motion: HandleMotion, source: HandleMotion, anatomy: Anatomy) -> HandleMotion:
        """A motion whose legs are on the ground while the body lies: a belly that is thicker than the reference body's
        holds them up.
        """
        lies = (source.root_translation[:, 1] < -self.lies) & (np.abs(source.root_rotation[:, 1, 1]) < np.sqrt(0.5))
        if not lies.any() or len(anatomy.legs) != 2:
            return motion
        body = reference_anatomy()
        soles = [sole_points(leg, body, source.transforms(body.handles.positions))[..., 1] for leg in body.legs]
        own = [sole_points(leg, anatomy, motion.transforms(anatomy.handles.positions))[..., 1] for leg in anatomy.legs]
        shifts = np.zeros((len(motion), 2, 3))
        for number, (heights, have) in enumerate(zip(soles, own, strict=True)):
            share = gaussian((lies & (heights.min(axis=1) < self.raised)).astype(float), self.spread * motion.fps)
            shifts[:, number, 1] = -share * np.maximum(have.min(axis=1) - anatomy.floor, 0)
        return with_feet_moved(motion, anatomy, anatomy.legs, shifts)

    def _foot_lifts(self, heights: np.ndarray, trust: np.ndarray, most: float, depth: float, reach: int) -> np.ndarray:
        """How far a foot is moved up in each frame [m], shape (N,): to the ground where it stands (`trust`), down by
        `most` [m] at the most, and out of it where it does not.
        """
        goal = np.maximum(-heights, -most)
        band = np.zeros((3, len(heights)))
        band[2] = self.hold * trust + self.pull * (1 - trust) + 1e-4
        add_bending(band)
        lifts = solve_banded(band, (self.hold * trust * goal)[:, None])[:, 0]
        return np.asarray(lifts + enough(np.maximum(-(heights + lifts) - depth, 0), reach))

    def _solid(self, anatomy: Anatomy) -> np.ndarray:
        """Vertices that must not sink, shape (V,), bool: what the character stands on, its arms and its hands, but not
        what they hold.
        """
        character, handles, out = anatomy.mesh, anatomy.mesh_handles, anatomy.stands.copy()
        for arm in anatomy.arms:
            out |= character.surface & (handles.weights[:, [arm.upper, arm.lower]].sum(axis=1) > 0.5)
            out[near_wrist(arm, anatomy, self.hand)] = True
        for stump in anatomy.stumps:
            out |= character.surface & (handles.weights[:, [stump.upper, stump.lower]].max(axis=1) > 0.5)
        return out

    def grounded(self, motion: HandleMotion, anatomy: Anatomy, contacts: Contacts | None) -> HandleMotion:
        """The motion with nothing below the ground, and standing feet on it. What may stand on the ground, arms and
        hands must not sink, but what hands hold may.
        """
        character, handles, legs, arms = anatomy.mesh, anatomy.handles, anatomy.legs, anatomy.arms
        floor = anatomy.floor
        depth, reach = self.depth * character.height, max(1, round(self.spread * motion.fps))
        solid = self._solid(anatomy)
        hands = (replace(arm, sole=np.intersect1d(arm.sole, near_wrist(arm, anatomy, self.hand))) for arm in arms)
        limbs = [limb for limb in (*legs, *hands, *anatomy.stumps) if len(limb.sole)]

        def need(some: np.ndarray) -> np.ndarray:
            if not some.any():
                return np.zeros(len(motion))
            heights = anatomy.reach_of(some).lowest(motion.transforms(handles.positions))
            return np.maximum(floor - depth - heights, 0)

        ends = np.zeros(len(character.vertices), bool)
        for limb in limbs:
            ends[limb.foot_area] = True
        motion = _lifted(motion, enough(need(solid & ~ends), reach))
        if limbs and len(motion) > 2:
            shifts, transforms = np.zeros((len(motion), len(limbs), 3)), motion.transforms(handles.positions)
            for number, limb in enumerate(limbs):
                heights = sole_points(limb, anatomy, transforms)[..., 1].min(axis=1) - floor
                trust = np.zeros(len(motion))
                if contacts is not None and number < len(legs):
                    held = contacts.stands[:, number]
                    trust[0], trust[-1], trust[1:-1] = held[0], held[-1], np.maximum(held[1:], held[:-1])
                shifts[:, number, 1] = self._foot_lifts(heights, trust, self.lowered * limb.length, depth, reach)
            motion = with_feet_moved(motion, anatomy, limbs, shifts)
        return _lifted(motion, enough(need(solid), reach))


class Leap(Ground, name="leap", needs=("ground",)):
    """Bodies on short legs leap as high as is fit for their whole height."""

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return anatomy.leap > anatomy.scale

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        motion, source, high = fitting.motion, fitting.source, fitting.heights
        if high is None and (anatomy.upright or not source.own_height):
            high = self._stood(source)[1]
        elif high is None:
            high = anatomy.reach.lowest(motion.transforms(anatomy.handles.positions)) / anatomy.scale
        air = np.maximum(high - self._local_ground(high, motion.fps), 0)
        return fitting.moved(_lifted(motion, (anatomy.leap - anatomy.scale) * running_mean(air, 5)))


@dataclass(frozen=True)
class Soles(Stage, name="soles", needs=("ground",)):
    """Feet that are long for their legs are held flatter where they would sink into the ground."""

    sinks: float = 0.04  # a sole may sink so far, over the leg's length: the leg makes up for that by bending
    steps: tuple[float, ...] = (0.75, 0.5, 0.25)  # shares of the slope that are tried, before none
    soft: float = 0.1  # how long before and after it is needed a foot is flatter [s]

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return any(leg.foot for leg in anatomy.legs)

    def changed(self, motion: HandleMotion, anatomy: Anatomy) -> HandleMotion:
        """The motion with feet turned about their ankles towards the level, as far as their soles would sink."""
        world, changed = motion.transforms(anatomy.handles.positions).astype(np.float64), False
        for leg in anatomy.legs:
            if not leg.foot:
                continue
            end_rotations, shift = world[:, leg.end, :, :3], world[:, leg.end, :, 3]
            ankle = np.einsum("nij,j->ni", end_rotations, leg.joints[2]) + shift
            below = ankle[:, 1] - self._under(leg, anatomy, world, ankle) - anatomy.floor
            if (below >= -self.sinks * leg.length).all():
                continue
            turned = end_rotations @ anatomy.rotations[leg.end].T
            facing, tilt = facing_and_tilt(turned, motion.fps)
            slope = np.asarray(axis_angle_from_matrix(tilt))
            less = np.where(below < -self.sinks * leg.length, 1.0, 0.0)
            for step in self.steps[::-1]:
                back = self._back(np.full(len(motion), 1 - step), slope, facing, turned)
                clear = ankle[:, 1] - self._under(leg, anatomy, world, ankle, back) - anatomy.floor
                less = np.where((less > 0) & (clear >= -self.sinks * leg.length), np.minimum(less, 1 - step), less)
            back = self._back(enough(less, max(1, round(self.soft * motion.fps))), slope, facing, turned)
            for handle in leg.foot:
                carry(world, handle, anatomy.joints, ankle, ankle, back)
            changed = True
        return motion.with_transforms(world, anatomy.handles.positions) if changed else motion

    def _back(self, less: np.ndarray, slope: np.ndarray, facing: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """What takes a foot from its slope to one that is less by a share, shape (N, 3, 3)."""
        kept = facing @ matrix_from_axis_angle((1 - np.minimum(less, 1))[:, None] * slope)
        return np.asarray(kept @ turned.transpose(0, 2, 1))

    def _under(
        self, leg: Leg, anatomy: Anatomy, world: np.ndarray, ankle: np.ndarray, back: np.ndarray | None = None
    ) -> np.ndarray:
        """How far the lowest point of a sole is under its ankle, shape (N,) [m], turned by `back` (N, 3, 3)."""
        away = sole_points(leg, anatomy, world) - ankle[:, None]
        heights = away[..., 1] if back is None else np.einsum("nj,nmj->nm", back[:, 1], away)
        return np.asarray(-heights.min(axis=1))
