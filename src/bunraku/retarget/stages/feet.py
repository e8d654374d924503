"""The stage `feet`: feet that stand do not slide; and whether a clip walks on the spot, as clips of games do."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.core.geometry.curves import gaussian, smooth_step, softly_bounded, solve_banded
from bunraku.core.geometry.rotations import heading, matrix_y
from bunraku.core.motion import HandleMotion
from bunraku.retarget.stages.stage import Contacts, Fitting, Stage, sole_points, with_feet_moved


def foot_motion(points: np.ndarray, floor: float, soft: float) -> tuple[np.ndarray, np.ndarray]:
    """Steps (N - 1, 2) and heights over the floor (N - 1,) of a sole whose points are known (N, m, 3): of its lowest
    part, so rolling is no step [m]. Points that are `soft` higher than the lowest count little.
    """
    height = 0.5 * (points[1:, :, 1] + points[:-1, :, 1])
    lowest = height.min(axis=1)
    share = np.exp(-((height - lowest[:, None]) / soft))
    share /= share.sum(axis=1, keepdims=True)
    steps = np.einsum("nm,nmi->ni", share, np.diff(points[..., [0, 2]], axis=0))
    return steps, lowest - floor


FIXED = 1e6
"""Weight of the offset of a frame that stays as it is, far over every other weight."""


@dataclass(frozen=True)
class Feet(Stage, name="feet"):
    """Standing feet do not slide.

    The root's path and then the legs make up for what they would slide.
    """

    low: float = 0.05  # height of a foot that comes to stand, over the leg's length
    high: float = 0.08  # height of one that no longer does
    slow: float = 0.5  # speed along the ground of a foot that comes to stand, in leg lengths a second
    fast: float = 1.0  # speed of one that no longer does
    # Points of a sole so much higher than its lowest, over the leg's length, count half for where it is.
    roll: float = 0.012
    # Two feet near the ground whose distance changes so slowly may both stand, and where it changes so fast they do
    # not, in leg lengths a second. Where one of them makes nearly all of the change, the other stands.
    parts: tuple[float, float] = (0.15, 0.5)
    # Shares of the change that the slower one makes, between which it no longer stands; in a jump that spreads the legs
    # each foot makes half of it.
    makes: tuple[float, float] = (0.25, 0.4)
    short: int = 3  # shorter contacts are none, and shorter gaps between them are closed [pairs of frames]
    apart: float = 0.25  # a foot that is so much faster than the slowest that stands counts half for the path
    hurry: float = 2.0  # likewise one that is so fast itself, in leg lengths a second
    # The path's correction and the contacts, which need one another, are found in turns; contacts from the middle on.
    rounds: int = 6
    sits: float = 0.25  # a body with a hip lower than this share of the leg from there on does not stand on it
    kneels: float = 0.35  # likewise with a knee
    most: float = 0.15  # how far a foot is moved at the most, over the leg's length; what slides farther means to
    free: float = 0.05  # weight of the size of the path's correction, over a foot's slide
    root_smooth: float = 2.0  # weight of its change from step to step
    hold: float = 100.0  # weight of a standing foot's slide, over the acceleration of its offset
    pull: float = 0.05  # weight of the offset's size while the foot does not stand
    stride: float = 0.5  # how long what the path is off must last to be a drift, about a step [s]

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return bool(anatomy.legs) and len(fitting.source) > 2

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        free = fitting.source.own_height and fitting.heights is None and not anatomy.has_extra_legs
        motion, contacts = self.locked(fitting.motion, anatomy, None if free else fitting.source)
        return replace(fitting.moved(motion), contacts=contacts)

    def contacts(self, motion: HandleMotion, anatomy: Anatomy, held: int = 0) -> tuple[Contacts, np.ndarray]:
        """The contacts of a motion of a character with L legs, whose steps are still without the correction, and the
        root's steps that are missing for standing feet to stay where they are in the mean, along x and z [m], shape (N
        - 1, 2).

        A foot whose knee or hip is near the ground, as in crawling, kneeling and sitting, has no contacts. `held`
        frames at the beginning stay as they are.
        """
        legs, floor = anatomy.legs, anatomy.floor
        world = motion.transforms(anatomy.handles.positions)
        steps, heights, raised = [], [], []
        for leg in legs:
            step, height = foot_motion(sole_points(leg, anatomy, world), floor, self.roll * leg.length)
            steps.append(step)
            heights.append(height)
            up = np.ones(len(step), bool)
            for handle, joint, least in zip(
                (leg.upper, leg.lower), leg.joints[:2], (self.sits, self.kneels), strict=True
            ):
                height = world[:, handle, 1, :3] @ joint + world[:, handle, 1, 3] - floor
                up &= 0.5 * (height[1:] + height[:-1]) > least * leg.reach(joint)
            raised.append(up)
        step, height, standing = np.stack(steps, axis=1), np.stack(heights, axis=1), np.stack(raised, axis=1)
        lengths = np.array([leg.length for leg in legs])
        unit = motion.fps / lengths
        share = height / lengths
        trust = np.exp(-((np.maximum(share, 0) / self.low) ** 2)) * standing
        near = (share < self.high) & standing
        missing = np.zeros((len(step), 2))
        for number in range(self.rounds):
            speed = np.linalg.norm(step + missing[:, None], axis=-1) * unit
            if number >= self.rounds // 2:
                enters = (share < self.low) & (speed < self.slow) & standing
                stays = (share < self.high) & (speed < self.fast) & standing
                trust = (
                    np.stack([self._held(enters[:, leg], stays[:, leg]) for leg in range(len(legs))], axis=1)
                    * smooth_step(speed, self.fast, self.slow)
                    * smooth_step(share, self.high, self.low)
                    * (1 - self._parting(step, speed, near, unit))
                )
            slowest = np.take_along_axis(step, (speed + self.hurry * (1 - trust)).argmin(axis=1)[:, None, None], axis=1)
            beside = np.linalg.norm(step - slowest, axis=-1) * unit
            count_for_path = trust / (1 + (beside / self.apart) ** 4) / (1 + (speed / self.hurry) ** 2)
            missing = self._root_steps(step, count_for_path, held)
        return Contacts(step, trust), missing

    def _parting(self, step: np.ndarray, speed: np.ndarray, near: np.ndarray, unit: np.ndarray) -> np.ndarray:
        """How far each foot is known not to stand because its distance from another one near the ground changes, shape
        (N - 1, L): two feet that stand stay as far from one another as they are.
        """
        out = np.zeros(speed.shape)
        for foot in range(speed.shape[1]):
            for other in range(speed.shape[1]):
                if other != foot:
                    change = np.linalg.norm(step[:, foot] - step[:, other], axis=-1) * unit[foot]
                    share = np.minimum(speed[:, foot], speed[:, other]) / np.maximum(change, 1e-9)
                    doubt = smooth_step(change, *self.parts) * smooth_step(share, *self.makes) * near[:, other]
                    out[:, foot] = np.maximum(out[:, foot], doubt * near[:, foot])
        return out

    def _held(self, enters: np.ndarray, stays: np.ndarray) -> np.ndarray:
        """Where a foot stands, shape (n,), bool: from where it enters until it no longer stays, forwards and backwards
        in time.
        """
        label = np.cumsum(np.diff(stays.astype(int), prepend=0) == 1) * stays
        held = np.isin(label, np.unique(label[enters & stays])) & stays
        for value in (False, True):
            self._drop_short(held, value)
        return held

    def _drop_short(self, held: np.ndarray, value: bool) -> None:
        """Flip runs of a value that are short, in place; not those at the clip's ends."""
        edges = np.flatnonzero(np.diff(held.astype(int))) + 1
        for start, end in zip(edges[:-1], edges[1:], strict=True):
            if held[start] == value and end - start < self.short:
                held[start:end] = not value

    def _root_steps(self, steps: np.ndarray, trust: np.ndarray, held: int) -> np.ndarray:
        """Steps of the root that cancel those of standing feet, smooth in time, shape (N - 1, 2); none between the
        first frames, which are held.
        """
        total = trust.sum(axis=1)
        count = len(steps)
        band = np.zeros((2, count))
        band[1] = total + self.free
        band[1, : max(held - 1, 0)] += FIXED
        band[1, :-1] += self.root_smooth
        band[1, 1:] += self.root_smooth
        band[0, 1:] = -self.root_smooth
        return solve_banded(band, -np.einsum("nl,nli->ni", trust, steps))

    def _offsets(self, steps: np.ndarray, trust: np.ndarray, held: int) -> np.ndarray:
        """Offsets of one foot that cancel its steps (N - 1, 2) where it stands (N - 1,), smooth and small elsewhere,
        shape (N, 2); none in the first frames, which are held.
        """
        count = len(steps) + 1
        band = np.zeros((3, count))
        free = np.ones(count)
        free[:-1] -= 0.5 * trust
        free[1:] -= 0.5 * trust
        band[2] = self.pull * free + 1e-4
        band[2, :held] += FIXED
        holds = self.hold * trust
        band[2, :-1] += holds
        band[2, 1:] += holds
        band[1, 1:] -= holds
        add_bending(band)
        right = np.zeros((count, 2))
        right[:-1] += holds[:, None] * steps
        right[1:] -= holds[:, None] * steps
        return solve_banded(band, right)

    def continued(self, motion: HandleMotion, before: HandleMotion, anatomy: Anatomy) -> HandleMotion:
        """A motion, fitted without what was before, that begins in the last frame of another one, with the feet that
        stand there where they stood.
        """
        last, whole = before.take(slice(-1, None)), HandleMotion.joined([before, motion.take(slice(1, None))])
        locked, _ = self.locked(whole, anatomy, held=len(before))
        return HandleMotion.joined([last, locked.take(slice(len(before), None))])

    def locked(
        self, motion: HandleMotion, anatomy: Anatomy, source: HandleMotion | None = None, held: int = 0
    ) -> tuple[HandleMotion, Contacts | None]:
        """The motion with standing feet held in place, and its contacts; None where it has no legs.

        Args:
            motion: Of the character, on the ground.
            anatomy: Of the character, with L legs.
            source: The motion of the reference body whose path counts, or one made for the character, which counts
                where feet would take most of it; None where the path may change. What steps are shorter or longer than
                there the legs make up alone, step by step; what slides there on purpose (`SLIDES`) is held here.
            held: So many frames at the beginning stay as they are.
        """
        legs = anatomy.legs
        if not legs or len(motion) < 3:
            return motion, None
        contacts, missing = self.contacts(motion, anatomy, held)
        path = motion.root_translation.astype(np.float64)
        if anatomy.has_extra_legs:  # legs that stand out sideways would push the body aside
            aside = matrix_y(heading(motion.root_rotation, motion.fps))[1:, [0, 2], 0]
            missing = missing - aside * (missing * aside).sum(axis=1, keepdims=True)
        away = np.concatenate([np.zeros((1, 2)), np.cumsum(missing, axis=0)])
        # what takes most of an animal's way has mistaken its feet, as of a body that rests in the middle of a step
        way = (path[-1] - path[0])[[0, 2]]
        lost = np.hypot(*away[-1]) > TRAVELS * np.hypot(*way)
        if source is not None and (lost or not source.own_height):
            slid = self.contacts(source, reference_anatomy())[1] * (not source.own_height)
            slid *= float(np.linalg.norm(slid, axis=1).mean() * motion.fps) > SLIDES  # less is a capture's noise
            drift = away[1:] - np.cumsum(anatomy.scale * slid, axis=0)
            away -= _lasting(np.concatenate([away[:1], drift]), self.stride * motion.fps)
        if not held and way @ (way + away[-1]) < 0:  # feet that would turn the way round do not tell where it leads
            away -= _lasting(away, self.stride * motion.fps)
        missing = np.diff(away, axis=0)
        path[:, [0, 2]] += away
        motion = replace(motion, root_translation=path)
        shifts = np.zeros((len(motion), len(legs), 3))
        for number, leg in enumerate(legs):
            offsets = self._offsets(contacts.steps[:, number] + missing, contacts.stands[:, number], held)
            shifts[:, number][:, [0, 2]] = softly_bounded(offsets, self.most * leg.length)
        return with_feet_moved(motion, anatomy, legs, shifts), contacts


def _lasting(offsets: np.ndarray, frames: float) -> np.ndarray:
    """What lasts of offsets (N, 2), ends and all: the curve goes on beyond them as a half turn about them."""
    count = min(len(offsets) - 1, round(4 * frames))
    before, after = 2 * offsets[0] - offsets[count:0:-1], 2 * offsets[-1] - offsets[-2 : -2 - count : -1]
    return np.asarray(gaussian(np.concatenate([before, offsets, after]), frames)[count : count + len(offsets)])


def add_bending(band: np.ndarray) -> None:
    """Add the squared second differences of a curve to a banded matrix (3, N), in place; in upper form, its diagonal in
    row 2.
    """
    count = band.shape[1]
    for offset, weight in zip((0, 1, 2), (1.0, -2.0, 1.0), strict=True):
        band[2, offset : count - 2 + offset] += weight * weight
    band[1, 1 : count - 1] -= 2
    band[1, 2:count] -= 2
    band[0, 2:] += 1


SLIDES = 0.25
"""Mean speed of standing feet from which on they slide on purpose [m/s]; captured clips were measured to drift by less
than a third.
"""
TRAVELS = 0.5
"""A body that moves by this share of what its feet slide does not stay on the spot; chosen by eye."""


def is_treadmill(motion: HandleMotion) -> bool:
    """Whether the reference body's feet slide under it in a motion that goes nowhere."""
    if len(motion) < 8:
        return False
    missing = Feet().contacts(motion, reference_anatomy())[1]
    slide = float(np.linalg.norm(missing, axis=1).mean() * motion.fps)
    path = np.diff(motion.root_translation[:, [0, 2]], axis=0)
    speed = float(np.linalg.norm(path, axis=1).mean() * motion.fps)
    return slide > SLIDES and speed < TRAVELS * slide
