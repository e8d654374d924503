"""How bodies fly, swim, slither, stay on the ground, and reach it to eat and to die, whatever was drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial import ConvexHull

from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.anatomy.handles.limbs import LEGS, SIDES
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.curves import gaussian, smooth_step
from bunraku.core.geometry.rotations import (
    axis_angle_from_matrix,
    facing_and_tilt,
    matrix_from_axis_angle,
    matrix_slerp,
    matrix_y,
    rotation_between,
)
from bunraku.core.motion import HandleMotion, line_up
from bunraku.core.skinning import skin
from bunraku.retarget.fit import posed
from bunraku.retarget.stages.ground import Ground
from bunraku.retarget.stages.stage import with_feet_moved
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
SPEED = {"swim": 0.5, "slither": 0.3, "step": 0.3, "run": 0.6, "fly on": 0.5, "fly fast": 1.0}
"""Lengths of the body, along its longest axis, in a second; without legs it hops where others step or run."""
HOPS = {"step": 1.5, "run": 2.5}  # hops in a second of a body without legs; chosen by eye on a figurine
HOP = 0.08  # how high they are, over its height; chosen by eye on the same
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
    as it is for other kinds than "fly" and those of `SPEED` and `AIR`. "Stay" is to be in the air for no longer than a
    jump, and "lie" to be on the ground with all but the front. In a `loop` the last frame is the first again.
    """
    frames = np.arange(len(motion))[where]
    if locomotion not in ("fly", *SPEED, *AIR) or len(frames) < 2:
        return motion
    if locomotion in ("lie", "slither"):
        turned, root = laid(motion, _amount(len(motion), frames, motion.fps))
        motion = _attached(motion, turned, root_rotation=root)
    if locomotion.startswith("fly"):
        motion = _flown(motion, frames, anatomy, loop)
        ahead = locomotion in SPEED
        return replace(motion, root_translation=_travelled(motion, locomotion, frames, anatomy)) if ahead else motion
    if locomotion in WAVE:
        motion = _waved(motion, locomotion, frames, anatomy, loop)
    elif not anatomy.plan.legs:
        motion = _upon_base(motion) if anatomy.upright else motion
        if locomotion in SPEED:
            motion = replace(motion, root_translation=_travelled(motion, locomotion, frames, anatomy))
    motion = _grounded(motion, locomotion, frames, anatomy) if locomotion in AIR else motion
    return motion if anatomy.plan.legs or locomotion not in HOPS else _hopping(motion, locomotion, frames, anatomy)


def _hopping(motion: HandleMotion, locomotion: str, frames: np.ndarray, anatomy: Anatomy) -> HandleMotion:
    """The motion of a body without legs that gets ahead in hops, and stands still between them."""
    path, seconds = motion.root_translation.astype(np.float64), (frames - frames[0]) / motion.fps
    number, phase = np.divmod(seconds * HOPS[locomotion], 1)
    gone = smooth_step(phase, 0.3, 1.0)
    at = frames[0] + (number + gone) / HOPS[locomotion] * motion.fps
    way = np.stack([np.interp(at, np.arange(len(path)), axis) for axis in path.T], axis=1)
    way[:, 1] = path[frames, 1] + 4 * HOP * anatomy.mesh.height / anatomy.scale * gone * (1 - gone)
    path[frames] = way
    return replace(motion, root_translation=path)


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


BOW = {"neck": 70.0, "head": 30.0, "spine3": 12.0, "spine2": 8.0, "spine1": 8.0}
"""How far parts of a body turn where its head goes to the ground [degrees]; chosen by eye on a horse, a hen and a
box-shaped tiger."""
KNEELS = 45.0  # how far the whole of it does; chosen by eye on the same
FRACTIONS = np.linspace(-0.4, 1.0, 15)  # of a bow that are tried; below 0 a body rears
FALLS = 0.3, 1.5  # when a body that dies begins and ends to fall [s]; chosen by eye on a cow and a hen
SAGS = 50.0  # how far limbs, neck and tail of a dead body sink at the most [degrees]; chosen by eye on the same
STRIKE = 1.4  # how long a strike takes [s]; chosen by eye on a fish and a stork
LEAP = 0.35, 0.08  # how far ahead and up a body leaps with it, over its length; chosen by eye on the same
TOUCHES = 0.02  # a part that is nearer to the ground is on it, over the size; chosen by eye on a horse
_HANGS = ("neck", "head", "tail", *(f"{side}_{part}" for part in ("hip", "shoulder", "wing") for side in SIDES))
_HIND = [*LEGS[0], *LEGS[1]]
_DOWN = np.array([0.0, -1.0, 0.0])


def reached(motion: HandleMotion, anatomy: Anatomy, goal: str, start: float, end: float) -> HandleMotion:
    """A motion that is fitted to a character, in which it reaches a goal from `start` to `end` [s]: "eat", its head
    comes down to the ground again and again; "attack", it rears, leaps ahead and strikes; "death", it falls over and
    lies on the ground from then on.
    """
    seconds, length = np.arange(len(motion)) / motion.fps - start, end - start
    if goal == "death":
        return _lain(motion, anatomy, seconds, min(round(end * motion.fps), len(motion) - 1))
    inside = smooth_step(seconds, 0, 0.3) * smooth_step(seconds, length, length - 0.3)
    if goal == "eat":
        down = smooth_step(seconds, 0.3, 1.1) * (0.85 + 0.15 * np.cos(2 * np.pi * seconds))
        return _bowed(motion, anatomy, inside, down, False)
    phase = np.mod(seconds, STRIKE)
    out, back = smooth_step(phase, 0.45, 0.65), smooth_step(phase, 0.9, 1.15)
    size = float(np.ptp(anatomy.mesh.vertices[anatomy.mesh.surface, 2]))
    ahead = facing_and_tilt(motion.root_rotation, motion.fps)[0][:, :, 2]
    path = motion.root_translation + (inside * (out - back) * LEAP[0] * size)[:, None] * ahead
    path[:, 1] += inside * LEAP[1] * size * 4 * (out * (1 - out) + back * (1 - back))
    rears = smooth_step(phase, 0, 0.35) * (1 - back)
    return _bowed(replace(motion, root_translation=path), anatomy, inside * rears, 0.6 * out, True)


def _bowed(motion: HandleMotion, anatomy: Anatomy, share: np.ndarray, down: np.ndarray, rears: bool) -> HandleMotion:
    """The motion with the muzzle a share `down` (N,) of its way to the ground, from where it is held, or from higher up
    where that is on the ground or the body `rears`; `share` (N,) says how much of that is done.
    """
    mesh, near = anatomy.mesh, TOUCHES * float(np.ptp(anatomy.mesh.vertices, axis=0).max())
    front = anatomy.front if len(anatomy.front) else np.flatnonzero(mesh.surface)  # a body that is all head
    muzzle = int(front[mesh.vertices[front, 2].argmax()])
    front = np.append(anatomy.front, muzzle)
    heights = []
    for some in FRACTIONS:
        world = _bow(motion, anatomy, np.full(len(motion), some)).transforms(anatomy.handles.positions)
        points = skin(mesh.vertices[front], anatomy.mesh_handles.weights[front], world)[..., 1]
        heights.append(points[:, -1] - np.minimum(points[:, :-1].min(axis=1, initial=anatomy.floor), anatomy.floor))
    low = np.array(heights) <= 3 * near
    first = np.where(low.any(axis=0), low.argmax(axis=0), np.argmin(heights, axis=0))
    held = FRACTIONS[0] if rears or heights[np.searchsorted(FRACTIONS, 0)][0] < 10 * near else 0.0
    least = gaussian(np.maximum(FRACTIONS[first], held), 0.15 * motion.fps)
    return _planted(_bow(motion, anatomy, share * (held + down * (least - held))), motion, anatomy)


def _bow(motion: HandleMotion, anatomy: Anatomy, amount: np.ndarray) -> HandleMotion:
    """The motion with the whole, the trunk, the neck and the head turned down by an amount (N,) of `BOW`; a head
    without a neck does the part of both.
    """
    positions, present = anatomy.handles.positions, anatomy.joints.present
    aside = facing_and_tilt(motion.root_rotation, motion.fps)[0][:, :, 0]
    if anatomy.legs or anatomy.plan.swims:
        tops = [leg for leg in anatomy.legs if int(anatomy.handles.played[leg.upper]) in _HIND] or anatomy.legs
        middle = np.mean([leg.joints[0] for leg in tops] or positions[:1], axis=0)
        tilt = np.radians(KNEELS) * np.clip(np.maximum(amount - 0.4, np.minimum(amount, 0)) / 0.6, -1, 1)
        motion = _tilted(motion, positions, tilt[:, None] * aside, middle)
    world, left = motion.transforms(positions).astype(np.float64), 0.0
    for name, degrees in BOW.items():
        left += degrees
        if present[part := HANDLE_NAMES.index(name)]:
            most = 1.6 * amount - 0.4 * (amount > 0) * name.startswith("spine")
            turn = np.radians(left) * np.clip(most, np.minimum(amount, 0), 1)
            _turn_part(world, part, anatomy, turn[:, None] * aside)
            left = 0.0
    return motion.with_transforms(world, positions)


def _tilted(motion: HandleMotion, positions: np.ndarray, turns: np.ndarray, about: np.ndarray) -> HandleMotion:
    """The motion turned as a whole by axes times angles [rad] (N, 3), about where a point of the root (3,) [m] is."""
    turned, root = matrix_from_axis_angle(turns), motion.root_rotation.astype(np.float64)
    arm = np.einsum("nij,j->ni", root, positions[0] - about)
    path = motion.root_translation + np.einsum("nij,nj->ni", turned, arm) - arm
    return replace(motion, root_rotation=turned @ root, root_translation=path)


def _members(part: int, anatomy: Anatomy) -> list[int]:
    parents = anatomy.joints.parents
    return [handle for handle in range(len(parents)) if part in line_up(handle, parents)]


def _turn_part(world: np.ndarray, part: int, anatomy: Anatomy, turns: np.ndarray) -> None:
    """Turn a part of a body, where it is there, and all that hangs on it, by axes times angles [rad], in place."""
    turned, members = matrix_from_axis_angle(turns)[:, None], _members(part, anatomy)
    pivot = (world[:, part, :, :3] @ anatomy.joints.positions[part] + world[:, part, :, 3])[:, None]
    shifts, rotations = world[..., 3], world[..., :3]
    shifts[:, members] = (turned @ (shifts[:, members] - pivot)[..., None])[..., 0] + pivot
    rotations[:, members] = turned @ rotations[:, members]


def _planted(motion: HandleMotion, before: HandleMotion, anatomy: Anatomy) -> HandleMotion:
    """The motion with its feet as they were before, and nothing below the ground."""
    legs, positions = anatomy.legs, anatomy.handles.positions
    if legs:
        now, then = (some.transforms(positions).astype(np.float64) for some in (motion, before))
        shifts = [(then - now)[:, leg.end] @ np.append(leg.joints[2], 1) for leg in legs]
        slopes = [then[:, leg.end, :, :3] @ now[:, leg.end, :, :3].transpose(0, 2, 1) for leg in legs]
        motion = with_feet_moved(motion, anatomy, legs, np.stack(shifts, axis=1), np.stack(slopes, axis=1))
    sunk = np.maximum(anatomy.floor - anatomy.surface_reach.lowest(motion.transforms(positions)), 0)
    return replace(motion, root_translation=motion.root_translation - sunk[:, None] * _DOWN)


def _lain(motion: HandleMotion, anatomy: Anatomy, seconds: np.ndarray, last: int) -> HandleMotion:
    """The motion of a body that falls over and lies on the ground as it would come to rest, from a frame on that is
    `seconds` (N,) ago; `last` is the one in which it lies.
    """
    positions, part = anatomy.handles.positions, anatomy.surface_reach
    share = smooth_step(seconds, *FALLS) ** 1.5
    down = _rest(HandleMotion.take(motion, slice(last, last + 1)), anatomy)
    motion = _tilted(
        motion, positions, share[:, None] * axis_angle_from_matrix(rotation_between(down, _DOWN)), positions[0]
    )
    if anatomy.plan.legs or not anatomy.upright:
        motion = _sagged(motion, anatomy, smooth_step(seconds, FALLS[1] - 0.5, FALLS[1] + 0.6), last)
    points = skin(part.vertices, part.weights, motion.transforms(positions)).astype(np.float64)
    low = points[..., 1].argmin(axis=1)
    frames, path = np.arange(len(motion)), motion.root_translation.astype(np.float64)
    sunk = anatomy.floor - points[frames, low, 1]
    path[:, 1] += smooth_step(seconds, 0, FALLS[1]) * sunk
    slip = points[frames[:-1], low[:-1]] - points[frames[1:], low[:-1]]  # it rolls over what it lies on
    path[1:, [0, 2]] += np.cumsum(slip * (np.diff(share) > 0)[:, None], axis=0)[:, [0, 2]]
    return replace(motion, root_translation=path)


def _rest(pose: HandleMotion, anatomy: Anatomy) -> np.ndarray:
    """The direction in a single pose that is down where the body lies, shape (3,): of the faces of its hull the one
    over which its middle is low, but not that on which it stood; rather a side than an end.
    """
    world, mesh = pose.transforms(anatomy.handles.positions), anatomy.mesh
    points = skin(mesh.vertices, anatomy.mesh_handles.weights, world)[0].astype(np.float64)
    middle = mesh.areas @ points / mesh.areas.sum()
    faces = np.unique(ConvexHull(points[mesh.surface], qhull_options="QJ").equations, axis=0)
    normals, heights = faces[:, :3], -faces[:, :3] @ middle - faces[:, 3]
    seen = normals @ pose.root_rotation[0].astype(np.float64)  # as the body has them at rest
    score = heights / heights.mean() + 0.5 * np.abs(seen[:, 2]) + 0.15 * np.maximum(seen[:, 1], 0)
    score += 0.1 * normals[:, 1] + 2.0 * (seen[:, 1] < -0.5)
    return np.asarray(normals[score.argmin()])


def _sagged(motion: HandleMotion, anatomy: Anatomy, share: np.ndarray, last: int) -> HandleMotion:
    """The motion with limbs, neck and tail that sink to the ground by a share (N,), as far as they do in one frame."""
    positions, root = anatomy.handles.positions, motion.root_rotation.astype(np.float64)
    world = motion.transforms(positions).astype(np.float64)
    near = float(anatomy.surface_reach.lowest(world[[last]])[0]) + TOUCHES * anatomy.mesh.height
    for part in (HANDLE_NAMES.index(name) for name in _HANGS):
        held = np.flatnonzero(anatomy.mesh_handles.weights[:, _members(part, anatomy)].sum(axis=1) > 0.5)
        if not anatomy.own[part] or len(held) < 4:
            continue
        reach, pose = anatomy.reach_of(held), world[[last]]
        pivot = pose[0, part, :, :3] @ anatomy.joints.positions[part] + pose[0, part, :, 3]
        axis = np.cross(skin(reach.vertices, reach.weights, pose)[0].mean(axis=0) - pivot, _DOWN)
        axis /= max(float(np.linalg.norm(axis)), 1e-9)
        heights = []
        for angle in (angles := np.radians(np.linspace(0, SAGS, 11))):
            _turn_part(turned := pose.copy(), part, anatomy, angle * axis[None])
            heights.append(float(reach.lowest(turned)[0]))
        low = np.asarray(heights) <= near
        most = angles[low.argmax() if low.any() else int(np.argmin(heights))]
        _turn_part(world, part, anatomy, (share * most)[:, None] * (root @ root[last].T @ axis))
    return motion.with_transforms(world, positions)
