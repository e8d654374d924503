"""How bodies fly, swim, slither, stay on the ground, and reach it to eat and to die, whatever was drawn."""

from __future__ import annotations

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

_TRUNK = [HANDLE_NAMES.index(name) for name in ("spine1", "spine2", "spine3", "neck")]
_HEAD = [HANDLE_NAMES.index(name) for name in ("head", "face", "head_top")]
_TAILS = [HANDLE_NAMES.index(name) for name in ("tail", "tail_tip")]
_DOWN = np.array([0.0, -1.0, 0.0])
_LINE = [*_TRUNK, *_HEAD, *_TAILS]


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
    for part in _LINE:
        turned = seen @ rotations[:, part]
        ahead = turned[:, :, 2]
        level = np.asarray(matrix_y(np.arctan2(ahead[:, 0], ahead[:, 2])), np.float64)
        if part in (_TRUNK[3], *_HEAD):  # they may rise
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
BOB = 0.05  # how far a body sinks and rises with the beats, over the height of its root
WAVE = {"swim": 1.2, "swim fast": 2.0, "slither": 0.9, "slither fast": 1.5}  # waves in a second
BENT = {"swim": (0.15, 0.45, 0.8), "slither": (0.6, 0.6, 1.2)}
"""How far the nose and the end of the tail turn aside [rad], and how many waves a body is long."""
SPEED = {"swim": 0.6, "swim fast": 1.2, "slither": 0.5, "slither fast": 0.9, "fly on": 0.5, "fly fast": 1.0}
SPEED |= {"step": 0.3, "run": 0.6}
"""Lengths of the body, along its longest axis, in a second; without legs it hops where others step or run."""
HOPS = {"step": 1.5, "run": 2.5}  # hops in a second of a body without legs; chosen by eye on a figurine
HOP = 0.08  # how high they are, over its height; chosen by eye on the same
LASTS = 1.0
"""What changes more slowly than this is how a body is held in water and air, and no swing [s]. Chosen by eye."""
ROLLS = np.radians(12)  # how far a body that swims or flies tilts at the most; chosen by eye on a tuna
WIDEST = 1.6  # how much wider the strides of short legs are than a person's at the most; chosen by eye on cubs
AIR = {"stay": 0.75, "run": 0.2, "step": 0.15, "lie": 0.05, "slither": 0.05, "slither fast": 0.05}
"""How long before and after a frame the ground is touched at the latest [s]; a step always has a foot on it."""
LEAST = 0.01  # what hovers by less, over the height, is left to the stages of fitting
_WINGS = [HANDLE_NAMES.index(f"{side}_wing") for side in ("left", "right")]


def wing_swing(motion: HandleMotion) -> float:
    """Through which angle the wings of the reference body swing [rad]: 5 of 100 frames are beyond it at either end."""
    turns = axis_angle_from_matrix(motion.rotations[:, _WINGS].astype(np.float64))
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
    if locomotion.startswith(("lie", "slither")):
        turned, root = laid(motion, _amount(len(motion), frames, motion.fps))
        motion = _attached(motion, turned, root_rotation=root)
    if locomotion.startswith("fly"):
        motion = _flown(motion, frames, anatomy, loop)
        return _travelled(motion, locomotion, frames, anatomy) if locomotion in SPEED else motion
    if locomotion in HOPS and anatomy.plan.hind == anatomy.plan.legs:
        motion = widened(motion, anatomy, _amount(len(motion), frames, motion.fps))
    hen = anatomy.plan.kind == "two legs" and locomotion in HOPS  # which does not lean as a person
    if locomotion in HOPS and anatomy.plan.kind == "many legs":
        motion = _travelled(motion, locomotion, frames, anatomy)
    if hen or (locomotion == "stay" and anatomy.plan.swims):
        motion = _levelled(motion, _amount(len(motion), frames, motion.fps))
    if locomotion in WAVE:
        motion = _waved(motion, locomotion, frames, anatomy, loop)
    elif not anatomy.plan.legs:
        motion = _upon_base(motion) if anatomy.upright else motion
        if locomotion in SPEED:
            motion = _travelled(motion, locomotion, frames, anatomy)
    motion = _grounded(motion, locomotion, frames, anatomy) if locomotion in AIR else motion
    return motion if anatomy.plan.legs or locomotion not in HOPS else _hopping(motion, locomotion, frames, anatomy)


def widened(motion: HandleMotion, anatomy: Anatomy, share: np.ndarray) -> HandleMotion:
    """The motion with wider strides, by a share (N,) of that, where legs are short for a body, which would hardly be
    seen and get it nowhere.
    """
    wide = min(anatomy.leap / anatomy.scale, WIDEST) - 1
    if wide <= 0:
        return motion
    share = wide * share
    rotations, path = motion.rotations.astype(np.float64), motion.root_translation.astype(np.float64)
    for hip, knee, *_ in LEGS:
        turns = np.asarray(axis_angle_from_matrix(rotations[:, hip]))
        swing = turns + share[:, None] * (turns - gaussian(turns, LASTS * motion.fps))
        wider = matrix_from_axis_angle(swing) @ rotations[:, hip].transpose(0, 2, 1)
        rotations[:, [hip, knee]] = wider[:, None] @ rotations[:, [hip, knee]]
    path[1:, [0, 2]] += np.cumsum(share[1:, None] * np.diff(path[:, [0, 2]], axis=0), axis=0)
    strides, body = _attached(motion, rotations, root_translation=path), reference_anatomy()
    lows = [body.surface_reach.lowest(some.transforms(body.handles.positions)) for some in (motion, strides)]
    return replace(strides, root_translation=path + (lows[1] - lows[0])[:, None] * _DOWN)


def turning(motion: HandleMotion, angle: float) -> HandleMotion:
    """Steps straight ahead as those in which a body turns by an angle [rad], to its left where that is positive."""
    turns = np.asarray(matrix_y(angle * smooth_step(np.arange(len(motion)), 0, len(motion) - 1)))
    steps = np.diff(motion.root_translation.astype(np.float64), axis=0, prepend=0)
    path = np.cumsum((turns @ steps[..., None])[..., 0], axis=0)
    return replace(motion, root_rotation=turns @ motion.root_rotation, root_translation=path)


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
    """The motion lower by as much as the character would hover in some frames."""
    if not motion.own_height:
        return motion
    share = _amount(len(motion), frames, motion.fps)
    hovers = Ground().hovering(posed(motion, anatomy), anatomy, AIR[locomotion])
    hovers = share * gaussian(hovers, AIR[locomotion] / 3 * motion.fps)
    least = Ground().flies[0] if locomotion == "stay" else LEAST  # what `fit_motion` sets down
    if hovers.max() < least * anatomy.mesh.height:
        return motion
    path = motion.root_translation.astype(np.float64)
    path[:, 1] -= hovers / anatomy.scale
    return replace(motion, root_translation=path)


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
    share = _amount(len(motion), frames, motion.fps)
    motion = _levelled(in_air(motion, frames), share)
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


def _lifting_axis(anatomy: Anatomy, wing: int) -> np.ndarray:
    """The axis about which a wing turns upwards, from where it is joined to its middle, shape (3,)."""
    out = anatomy.handles.positions[wing] - anatomy.joints.positions[wing]
    ahead = np.array([0, 0, 0.2 if anatomy.handles.positions[wing][0] > 0 else -0.2])  # what points up beats sideways
    axis = np.cross(out, -_DOWN) + ahead * np.linalg.norm(out)
    return np.asarray(axis / max(float(np.linalg.norm(axis)), 1e-9))


def _levelled(motion: HandleMotion, share: np.ndarray) -> HandleMotion:
    """The motion of a body that is level in water or air, as it rests, where a swimming person lies on the front: what
    lasts of the tilt of the root and of the bend of the trunk and head is taken off, and what is beyond `ROLLS`.
    """

    def level(turns: np.ndarray) -> np.ndarray:
        turn = np.asarray(axis_angle_from_matrix(turns))
        part = share.reshape(-1, *[1] * (turn.ndim - 1))
        turn = turn - part * gaussian(turn, LASTS * motion.fps)
        least = np.minimum(1, ROLLS / np.maximum(np.linalg.norm(turn, axis=-1, keepdims=True), 1e-9))
        return np.asarray(matrix_from_axis_angle(turn * (1 + (least - 1) * part)))

    facing, tilt = facing_and_tilt(motion.root_rotation, motion.fps)
    rotations = motion.rotations.astype(np.float64)
    rotations[:, [*_TRUNK, *_HEAD]] = level(rotations[:, [*_TRUNK, *_HEAD]])
    return _attached(motion, rotations, root_rotation=facing @ level(tilt))


def _waved(motion: HandleMotion, locomotion: str, frames: np.ndarray, anatomy: Anatomy, loop: bool) -> HandleMotion:
    """The motion with a wave that runs along the body from the nose to the end of the tail, and its root, which is a
    part of that, goes from side to side with it.
    """
    manner, share = locomotion.split()[0], _amount(len(motion), frames, motion.fps)
    if manner == "swim":
        motion = _levelled(motion, share)
    path = _travelled(motion, locomotion, frames, anatomy).root_translation
    phase = _phase(len(motion), frames, WAVE[locomotion], motion.fps, loop)
    flat = manner == "swim" and _flat_tail(anatomy)
    axis, aside = np.eye(3)[[0, 1]] * [[1], [-1]] if flat else np.eye(3)[[1, 0]]
    ends = np.quantile(anatomy.mesh.vertices[anatomy.mesh.surface, 2], [1, 0])
    nose, tail, waves = BENT[manner]
    behind = (anatomy.handles.positions[:, 2] - ends[0]) / min(ends[1] - ends[0], -1e-9)
    size = nose + (tail - nose) * np.clip(behind, 0, 1)
    along = phase[:, None] - 2 * np.pi * waves * behind
    turns = matrix_from_axis_angle((share[:, None] * size * np.sin(along))[..., None] * axis)
    rotations, root = motion.rotations.astype(np.float64), turns[:, 0]
    rotations[:, _LINE] = root.transpose(0, 2, 1)[:, None] @ turns[:, _LINE] @ rotations[:, _LINE]
    away = share * size[0] * (ends[0] - ends[1]) / (2 * np.pi * waves * anatomy.scale) * np.cos(along[:, 0])
    path = path - away[:, None] * (motion.root_rotation @ aside)
    return _attached(motion, rotations, root_rotation=motion.root_rotation @ root, root_translation=path)


def _upon_base(motion: HandleMotion) -> HandleMotion:
    """The motion with its root upright, whatever it rests on: all that is above tilts in its place."""
    facing, tilt = facing_and_tilt(motion.root_rotation, motion.fps)
    rotations = tilt[:, None] @ motion.rotations.astype(np.float64)
    rotations[:, 0] = np.eye(3)
    return _attached(motion, rotations, root_rotation=facing)


def _travelled(motion: HandleMotion, locomotion: str, frames: np.ndarray, anatomy: Anatomy) -> HandleMotion:
    """The motion at a speed fit for the body's size, where it is slower than that."""
    path = motion.root_translation.astype(np.float64)
    ahead = facing_and_tilt(motion.root_rotation, motion.fps)[0][:, :, 2]
    own = float(((path[frames[-1]] - path[frames[0]]) * ahead[frames].mean(axis=0)).sum())
    length = float(np.ptp(anatomy.mesh.vertices[anatomy.mesh.surface], axis=0).max()) / anatomy.scale
    wanted = SPEED[locomotion] * length * len(frames) / motion.fps
    share = _amount(len(motion), frames, motion.fps)
    more = np.cumsum(ahead * share[:, None] * wanted / len(frames), axis=0)
    return replace(motion, root_translation=path + more * max(1 - own / wanted, 0))


def _flat_tail(anatomy: Anatomy) -> bool:
    """Whether the end of a tail is wider than high, as a whale's: it beats up and down."""
    held = anatomy.mesh.surface & (anatomy.mesh_handles.weights[:, _TAILS[1]] > 0.5)
    size = np.ptp(anatomy.mesh.vertices[held], axis=0) if held.sum() > 2 else np.zeros(3)
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
STOOPS, NODS = 80.0, 0.3  # that of an upright body, and the share of neck and head in it; chosen by eye on a meerkat
FRACTIONS = np.linspace(-0.4, 1.0, 15)  # of a bow that are tried; below 0 a body rears
TURNS = 75.0  # how far a head without a neck turns [degrees]; chosen by eye on a box-shaped dog
REARS = -0.15  # share of a bow by which a body rears that has its mouth at the ground; chosen by eye on an elephant
FALLS = 0.3, 1.5  # when a body that dies begins and ends to fall [s]; chosen by eye on a cow and a hen
SAGS = 50.0  # how far limbs, neck and tail of a dead body sink at the most [degrees]; chosen by eye on the same
STRIKE = 1.4  # how long a strike takes [s]; chosen by eye on a fish and a stork
LEAP = 0.45, 0.12  # how far ahead and up a body leaps with it, over its length; chosen by eye on the same
TOUCHES = 0.02  # a part that is nearer to the ground is on it, over the size; chosen by eye on a horse
_HANGS = ("neck", "head", "tail", *(f"{side}_{part}" for part in ("hip", "shoulder", "wing") for side in SIDES))
_HIND = [*LEGS[0], *LEGS[1]]


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
    front = np.append(anatomy.front, anatomy.muzzle)
    heights = []
    for some in FRACTIONS:
        world = _bow(motion, anatomy, np.full(len(motion), some)).transforms(anatomy.handles.positions)
        points = skin(mesh.vertices[front], anatomy.mesh_handles.weights[front], world)[..., 1]
        heights.append(points[:, -1] - np.minimum(points[:, :-1].min(axis=1, initial=anatomy.floor), anatomy.floor))
    low = np.array(heights) <= 3 * near
    first = np.where(low.any(axis=0), low.argmax(axis=0), np.argmin(heights, axis=0))
    held = FRACTIONS[0] if rears else REARS if heights[np.searchsorted(FRACTIONS, 0)][0] < 10 * near else 0.0
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
        tilt = np.radians(np.where((amount > 0) & anatomy.upright, STOOPS, KNEELS)) * np.clip(
            np.maximum(amount - 0.4, np.minimum(amount, 0)) / 0.6, -1, 1
        )
        motion = _tilted(motion, positions, tilt[:, None] * aside, middle)
    world, left = motion.transforms(positions).astype(np.float64), 0.0
    for name, degrees in BOW.items():
        left += degrees
        if present[part := HANDLE_NAMES.index(name)]:
            most = 1.6 * amount - 0.4 * (amount > 0) * name.startswith("spine")
            some = NODS if anatomy.upright and not name.startswith("spine") else 1.0
            turn = np.radians(min(left, TURNS)) * np.clip(most, np.minimum(amount, 0), some)
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
    score = heights / heights.mean() + 0.5 * np.abs(seen[:, 2]) + 0.35 * np.maximum(seen[:, 1], 0)
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
