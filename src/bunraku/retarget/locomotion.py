"""How bodies fly, swim, slither and stay on the ground, whatever a generator made of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.curves import gaussian, smooth_step
from bunraku.core.geometry.rotations import (
    axis_angle_from_matrix,
    facing_and_tilt,
    matrix_from_axis_angle,
    matrix_slerp,
    matrix_y,
)
from bunraku.core.motion import HandleMotion
from bunraku.retarget.fit import posed
from bunraku.retarget.stages.ground import Ground
from bunraku.retarget.stages.trailing import Tail

_LYING_LINE = [HANDLE_NAMES.index(name) for name in ("spine1", "spine2", "spine3", "tail", "tail_tip")]
_FRONT = [HANDLE_NAMES.index(name) for name in ("neck", "head", "head_top", "face")]
"""Parts that may rise."""


def laid(motion: HandleMotion, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Local rotations (N, 30, 3, 3) and those of the root (N, 3, 3) of the reference body's motion in which a long body
    without legs keeps to the ground: its root does not tilt, its parts turn aside only, and its neck and head no
    farther down than they rest. `share` (N,) says how much of that is done in each frame, 0 to 1.
    """
    root = motion.root_rotation.astype(np.float64)
    facing, _ = facing_and_tilt(root, motion.fps)
    flat = matrix_slerp(root, facing, share)
    seen = flat.transpose(0, 2, 1) @ root  # what is left of the tilt is for the parts to keep
    rotations = motion.rotations.astype(np.float64).copy()
    for part in (*_LYING_LINE, *_FRONT):
        turned = seen @ rotations[:, part]
        ahead = turned[:, :, 2]
        level = np.asarray(matrix_y(np.arctan2(ahead[:, 0], ahead[:, 2])), np.float64)
        if part in _FRONT:
            up = np.maximum(np.arctan2(ahead[:, 1], np.hypot(ahead[:, 0], ahead[:, 2])), 0)
            level = level @ matrix_from_axis_angle(-up[:, None] * np.array([1.0, 0, 0]))
        rotations[:, part] = matrix_slerp(turned, level, share)
    return rotations, flat


# Chosen by eye on the sheets of tools/make_creature_sheets.py.
HOVER = 0.8
"""How high a body flies over where it stands, over the height of its root."""
RISE = 0.7  # how long what flies takes up and down where something else follows [s]
BEAT, SPREAD = 2.2, 0.6  # wing beats in a second, and how far a wing swings up and down [rad]
BEATS = 0.5  # wings that swing through less than this do not beat [rad]
LIFTS = 2.5  # nor do wings whose swings are slower than this carry a body [rad/s]; captured ones are at 3.9 to 17
HELD = 0.4  # what changes more slowly than this is how a wing is held, and no beat [s]
TILT = np.radians(30)  # a body that flies tilts so far at the most, and no part of its trunk bends farther
BOB = 0.05  # how far a body sinks and rises with the beats, over the height of its root
WAVE = {"swim": 1.2, "slither": 0.9}  # waves in a second
BENT = {"swim": 0.45, "slither": 0.7}  # how far the tip of a tail turns aside [rad]
BENDS = 0.3  # a tail that swings through less than this does not bend [rad]
SPEED = {"swim": 0.5, "slither": 0.3, "step": 0.3, "run": 0.6}
"""Lengths of the body, along its longest axis, in a second; without legs it glides where others step or run."""
LASTS = 1.0
"""What changes more slowly than this is how a body is held in the water, and no swing [s]. Chosen by eye."""
ROLLS = np.radians(12)  # how far a body that swims tilts at the most; chosen by eye on a tuna
STAYS = 0.25  # a motion that gets ahead by less than this share of that is given the speed
AIR = {"stay": 0.75, "run": 0.2, "step": 0.15, "lie": 0.05, "slither": 0.05}
"""How long before and after a frame the ground is touched at the latest [s]; a step always has a foot on it."""
LEAST = 0.01  # what hovers by less, over the height, is left to the stages of fitting
_WINGS = [HANDLE_NAMES.index(f"{side}_wing") for side in ("left", "right")]
_LINE = {"head": -1.2, "neck": -0.9, "spine3": -0.6, "spine2": -0.4, "spine1": -0.2, "tail": 0.9, "tail_tip": 1.7}
"""Parts along a body, and how far they are behind its middle in the wave [rad]; the size of their turn grows so too."""
_TAIL = HANDLE_NAMES.index("tail_tip")
_TRUNK = [HANDLE_NAMES.index(name) for name in ("spine1", "spine2", "spine3", "neck")]
_HEAD = [HANDLE_NAMES.index(name) for name in ("head", "face", "head_top")]


def wing_swing(motion: HandleMotion) -> float:
    """Through which angle the wings of the reference body swing [rad]: 5 of 100 frames are beyond it at either end."""
    return _range(_wing_turns(motion))


def wings_carry(motion: HandleMotion) -> bool:
    """Whether the wings of the reference body beat, through an angle (`BEATS`) and at a speed (`LIFTS`) that carry it;
    how they are held (`HELD`) is no beat.
    """
    turns = _wing_turns(motion)
    swings = turns - gaussian(turns, HELD * motion.fps)
    speed = np.linalg.norm(np.diff(swings, axis=0), axis=-1).mean(axis=0).max() * motion.fps
    return bool(_range(swings) >= BEATS and speed >= LIFTS)


def _wing_turns(motion: HandleMotion) -> np.ndarray:
    return np.asarray(axis_angle_from_matrix(motion.rotations[:, _WINGS].astype(np.float64)))


def _range(turns: np.ndarray) -> float:
    low, high = np.quantile(turns, [0.05, 0.95], axis=0)
    return float(np.linalg.norm(high - low, axis=-1).max())


def moved_so(motion: HandleMotion, locomotion: str, where: slice, anatomy: Anatomy, loop: bool = False) -> HandleMotion:
    """The motion of the reference body, generated for a character, with what a locomotion needs in some of its frames;
    as it is for other kinds than "fly", "swim" and those of `AIR`. "Stay" is to be in the air for no longer than a
    jump, and "lie" to be on the ground with all but the front. In a `loop` the last frame is the first again.
    """
    frames = np.arange(len(motion))[where]
    if locomotion not in ("fly", *WAVE, *AIR) or len(frames) < 2:
        return motion
    if locomotion in ("lie", "slither"):
        turned, root = laid(motion, _amount(len(motion), frames, motion.fps))
        motion = _attached(motion, turned, root_rotation=root)
    if locomotion == "fly":
        return _flown(motion, frames, anatomy, loop)
    if locomotion in WAVE:
        motion = _waved(motion, locomotion, frames, anatomy, loop)
    elif not anatomy.plan.legs:
        motion = _upon_base(motion) if anatomy.upright else motion
        if locomotion in SPEED:
            motion = replace(motion, root_translation=_travelled(motion, locomotion, frames, anatomy))
    return _grounded(motion, locomotion, frames, anatomy) if locomotion in AIR else motion


def in_air(motion: HandleMotion, frames: np.ndarray | None = None) -> HandleMotion:
    """The motion at the height of flight in some frames, or in all; up and down between them and the others."""
    share = np.ones(len(motion)) if frames is None else _amount(len(motion), frames, motion.fps)
    path = motion.root_translation.astype(np.float64)
    path[:, 1] += HOVER * _root() * share
    return replace(motion, root_translation=path, own_height=True)


def _grounded(motion: HandleMotion, locomotion: str, frames: np.ndarray, anatomy: Anatomy) -> HandleMotion:
    """The motion lower by as much as the character would hover in some frames, with a tail that a tilted trunk does not
    hold up.
    """
    if not motion.own_height:
        return motion
    share = _amount(len(motion), frames, motion.fps)
    motion = _tail_lowered(motion, share, anatomy)
    hovers = Ground().hovering(posed(motion, anatomy), anatomy, AIR[locomotion])
    hovers = share * gaussian(hovers, AIR[locomotion] / 3 * motion.fps)
    least = Ground().flies[0] if locomotion == "stay" else LEAST  # what `fit_motion` sets down
    if hovers.max() < least * anatomy.mesh.height:
        return motion
    path = motion.root_translation.astype(np.float64)
    path[:, 1] -= hovers / anatomy.scale
    return replace(motion, root_translation=path)


def _tail_lowered(motion: HandleMotion, share: np.ndarray, anatomy: Anatomy) -> HandleMotion:
    handles, joints = anatomy.handles, anatomy.joints
    before = motion.rotations.astype(np.float64)
    after = Tail().lowered(before, handles, replace(joints, present=anatomy.own), motion.fps, motion.root_rotation)
    if after is before:
        return motion
    turn = axis_angle_from_matrix(after @ before.transpose(0, 1, 3, 2))
    return _attached(motion, matrix_from_axis_angle(share[:, None, None] * np.asarray(turn)) @ before)


def _root() -> float:
    return float(reference_body().handles.positions[0, 1])


def _amount(count: int, frames: np.ndarray, fps: float) -> np.ndarray:
    """1 in some frames, 0 in others, and a soft way between, shape (N,)."""
    soft, at = RISE * fps, np.arange(count)
    up = np.ones(count) if frames[0] == 0 else smooth_step(at, frames[0] - 0.5 * soft, frames[0] + 0.5 * soft)
    last = frames[-1]
    down = np.ones(count) if last == count - 1 else smooth_step(at, last + 0.5 * soft, last - 0.5 * soft)
    return np.asarray(up * down)


def _phase(count: int, frames: np.ndarray, rate: float, fps: float, loop: bool) -> np.ndarray:
    """Angle of a swing in each frame [rad], shape (N,); whole swings in a loop."""
    span = (len(frames) - 1) / fps
    turns = max(round(rate * span), 1) if loop else rate * span
    return np.asarray(2 * np.pi * turns * (np.arange(count) - frames[0]) / max(len(frames) - 1, 1))


def _flown(motion: HandleMotion, frames: np.ndarray, anatomy: Anatomy, loop: bool) -> HandleMotion:
    motion = in_air(motion, frames)
    share = _amount(len(motion), frames, motion.fps)
    motion = _righted(motion, share)
    if wings_carry(HandleMotion.take(motion, frames)):
        return motion
    phase = _phase(len(motion), frames, BEAT, motion.fps, loop)
    rotations = motion.rotations.astype(np.float64).copy()
    for wing in _WINGS:
        axis = _lifting_axis(anatomy, wing)
        held = axis_angle_from_matrix(rotations[:, wing]) * (1 - share[:, None])  # what was drawn is no flight
        beat = SPREAD * np.sin(phase) * share
        rotations[:, wing] = matrix_from_axis_angle(beat[:, None] * axis) @ matrix_from_axis_angle(held)
    path = motion.root_translation.astype(np.float64)
    level = HOVER * _root() - BOB * _root() * np.sin(phase - 0.5)
    path[:, 1] += share * (level - path[:, 1])
    return _attached(motion, rotations, root_translation=path)


def _righted(motion: HandleMotion, share: np.ndarray) -> HandleMotion:
    """The motion of a body that neither falls over nor rolls up in the air, whatever else was drawn."""

    def within(turn: np.ndarray) -> np.ndarray:
        size = np.linalg.norm(turn, axis=-1, keepdims=True)
        least = np.minimum(1, TILT / np.maximum(size, 1e-9))
        return np.asarray(turn * (1 + (least - 1) * share.reshape(-1, *[1] * (turn.ndim - 1))))

    return _bent(motion, _TRUNK, within)


def _bent(motion: HandleMotion, parts: list[int], change: Callable[[np.ndarray], np.ndarray]) -> HandleMotion:
    """The motion with the tilt of its root and the turns of some parts, axes times angles [rad], changed."""
    facing, tilt = facing_and_tilt(motion.root_rotation, motion.fps)
    root = facing @ matrix_from_axis_angle(change(np.asarray(axis_angle_from_matrix(tilt))))
    rotations = motion.rotations.astype(np.float64)
    turns = change(np.asarray(axis_angle_from_matrix(rotations[:, parts])))
    rotations[:, parts] = matrix_from_axis_angle(turns)
    return _attached(motion, rotations, root_rotation=root)


def _lifting_axis(anatomy: Anatomy, wing: int) -> np.ndarray:
    """The axis about which a wing turns upwards, from where it is joined to its middle, shape (3,)."""
    handles = anatomy.handles
    out = handles.positions[wing] - anatomy.joints.positions[wing]
    axis = np.cross(out, [0.0, 1.0, 0.0])
    if np.linalg.norm(axis) < 0.3 * max(float(np.linalg.norm(out)), 1e-9):  # it points up: it beats sideways
        axis = np.array([0, 0, 1.0 if handles.positions[wing][0] > 0 else -1.0])
    return np.asarray(axis / np.linalg.norm(axis))


def _levelled(motion: HandleMotion, share: np.ndarray) -> HandleMotion:
    """The motion of a body that is level in the water, as it rests, where a swimming person lies on the front: what
    lasts of the tilt of the root and of the bend of the trunk and head is taken off, and what is beyond `ROLLS`.
    """

    def without(turn: np.ndarray) -> np.ndarray:
        part = share.reshape(-1, *[1] * (turn.ndim - 1))
        turn = turn - part * gaussian(turn, LASTS * motion.fps)
        least = np.minimum(1, ROLLS / np.maximum(np.linalg.norm(turn, axis=-1, keepdims=True), 1e-9))
        return np.asarray(turn * (1 + (least - 1) * part))

    return _bent(motion, [*_TRUNK, *_HEAD], without)


def _waved(motion: HandleMotion, locomotion: str, frames: np.ndarray, anatomy: Anatomy, loop: bool) -> HandleMotion:
    share = _amount(len(motion), frames, motion.fps)
    if locomotion == "swim":
        motion = _levelled(motion, share)
    some = HandleMotion.take(motion, frames)
    path = _travelled(motion, locomotion, frames, anatomy)
    rotations = motion.rotations.astype(np.float64).copy()
    turns = np.asarray(axis_angle_from_matrix(some.rotations[:, _TAIL].astype(np.float64)))
    if float(np.ptp(turns, axis=0).max()) < BENDS:
        phase = _phase(len(motion), frames, WAVE[locomotion], motion.fps, loop)
        axis = np.array([1.0, 0, 0]) if locomotion == "swim" and _flat_tail(anatomy) else np.array([0, 1.0, 0])
        for name, behind in _LINE.items():
            angle = BENT[locomotion] * abs(behind) / 1.7 * np.sin(phase - behind) * share
            turn = matrix_from_axis_angle(angle[:, None] * axis)
            for part in _HEAD if name == "head" else [HANDLE_NAMES.index(name)]:
                rotations[:, part] = turn @ rotations[:, part]
    return _attached(motion, rotations, root_translation=path)


def _upon_base(motion: HandleMotion) -> HandleMotion:
    """The motion with its root upright, whatever it rests on: all that is above tilts in its place."""
    facing, tilt = facing_and_tilt(motion.root_rotation, motion.fps)
    rotations = tilt[:, None] @ motion.rotations.astype(np.float64)
    rotations[:, 0] = np.eye(3)
    return _attached(motion, rotations, root_rotation=facing)


def _travelled(motion: HandleMotion, locomotion: str, frames: np.ndarray, anatomy: Anatomy) -> np.ndarray:
    """The root's path, at a speed fit for the body's size where it hardly gets ahead, shape (N, 3)."""
    path = motion.root_translation.astype(np.float64)
    ahead = facing_and_tilt(motion.root_rotation, motion.fps)[0][:, :, 2]
    own = float(((path[frames[-1]] - path[frames[0]]) * ahead[frames].mean(axis=0)).sum())
    length = float(np.ptp(anatomy.mesh.vertices[anatomy.mesh.surface], axis=0).max()) / anatomy.scale
    wanted = SPEED[locomotion] * length * len(frames) / motion.fps
    share = _amount(len(motion), frames, motion.fps)
    more = np.cumsum(ahead * share[:, None] * wanted / len(frames), axis=0)
    return path + more if own < STAYS * wanted else path


def _flat_tail(anatomy: Anatomy) -> bool:
    """Whether the end of a tail is wider than high, as a whale's: it beats up and down."""
    held = anatomy.mesh.surface & (anatomy.mesh_handles.weights[:, _TAIL] > 0.5)
    if held.sum() < 3:
        return False
    size = np.ptp(anatomy.mesh.vertices[held], axis=0)
    return bool(size[0] > 1.5 * size[1])


def _attached(motion: HandleMotion, rotations: np.ndarray, **root: np.ndarray) -> HandleMotion:
    """The motion with other rotations, and perhaps another `root_rotation` and `root_translation`; parts stay as far
    from their joints as they were.
    """
    body = reference_anatomy()
    before = body.attached(motion.rotations.astype(np.float64))[1]
    after = body.attached(rotations)[1]  # its rotations let a tail, which people lack, go with the hips
    moved = motion.translations.astype(np.float64) - before + after
    moved[:, 0] = 0
    return motion.with_arrays({"rotations": rotations, "translations": moved, **root})
