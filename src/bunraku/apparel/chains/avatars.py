"""Chains for other programs: springs and colliders of VRM that swing as the chains do, and rigid bodies of MMD."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from bunraku.apparel.chains.chain import Chain
from bunraku.apparel.chains.chain_rig import Chained
from bunraku.apparel.chains.moving import steady_simulation
from bunraku.apparel.clothed import RATE
from bunraku.apparel.physics.rig import VRM_RATE
from bunraku.core.animation import RigAnimation
from bunraku.core.avatars import MmdModel, MmdSdef, VrmCollider, VrmModel, VrmSpring, VrmSpringJoint
from bunraku.core.geometry.rotations import matrix_from_axis_angle, rotation_between

VrmValues = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Stiffness, drag and gravity power of links, each of shape (C, S) or one that fits."""


def between_frames(turns: np.ndarray, positions: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotations, of the nearest frames, and positions, linear, of frames (N, ...) at the times of VRM's steps."""
    parts = max(1, round(VRM_RATE / fps))
    time = np.arange((len(positions) - 1) * parts + 1) / parts
    before = np.minimum(time.astype(np.int64), len(positions) - 1)
    after = np.minimum(before + 1, len(positions) - 1)
    share = (time - before).reshape(-1, *[1] * (positions.ndim - 1))
    return turns[np.where(time - before > 0.5, after, before)], (1 - share) * positions[before] + share * positions[
        after
    ]


def vrm_steps(turns: np.ndarray, heads: np.ndarray, bones: np.ndarray, values: VrmValues) -> Iterator[np.ndarray]:
    """Tails of C links, without colliders, step by step as VRM's specification moves them: `x += (1 - drag) dx +
    stiffness dt rest + gravity dt down`, and then back to its length. What hangs on a link does not pull at it.

    Args:
        turns: World rotation of the holder of each link at each step, shape (T, C, 3, 3).
        heads: Beginning of each link [m], shape (T, C, 3).
        bones: From the beginning of each link to its tail at rest [m], shape (C, 3).
        values: S settings of each link.

    Yields:
        T times positions [m], shape (C, S, 3).
    """
    stiffness, drag, gravity = np.broadcast_arrays(*values)
    length = np.linalg.norm(bones, axis=1)[:, None, None]
    aims = np.einsum("tcab,cb->tca", turns, bones / np.maximum(length[:, 0], 1e-9))[:, :, None]
    keep, back = (1 - drag)[..., None], (stiffness / VRM_RATE)[..., None]
    fall = np.stack([np.zeros_like(gravity), -gravity / VRM_RATE, np.zeros_like(gravity)], axis=-1)
    now = before = np.broadcast_to(heads[0][:, None] + length * aims[0], fall.shape)
    yield now
    for head, aim in zip(heads[1:], aims[1:], strict=True):
        away = now + keep * (now - before) + back * aim + fall - head[:, None]
        away /= np.maximum(np.sqrt(np.einsum("csa,csa->cs", away, away)), 1e-9)[..., None]
        before, now = now, head[:, None] + length * away
        yield now


def link_turns(turns: np.ndarray, heads: np.ndarray, bones: np.ndarray, tails: np.ndarray) -> np.ndarray:
    """World rotations of C links with known tails [m], shape (T, C, 3): the least rotation from where the holder takes
    them, shape (T, C, 3, 3); other arguments as of `vrm_steps`.
    """
    aims = np.einsum("tcab,cb->tca", turns, bones)
    return np.asarray(rotation_between(aims, tails - heads) @ turns)


# Gravity over stiffness is how far a link hangs down. Softer links with less drag swing on in motions that they were
# not fitted to.
_GRID = np.array([(stiffness, drag, stiffness * sag) for stiffness, drag, sag in product(
    (0.5, 1.0, 2.0, 4.0, 8.0, 16.0), (0.15, 0.3, 0.5, 0.75), (0.0, 0.05, 0.1, 0.2, 0.35, 0.6))])  # fmt: skip


@dataclass(frozen=True)
class _Sway:
    """A motion made of sines."""

    seconds: float  # its length [s]
    turns: tuple[float, float, float]  # how far the body bends, turns and leans [rad]
    # aside, up: how far it goes aside and up and down, over its height
    aside: float
    up: float
    pace: float  # how fast it goes forward, heights a second; 0 for to and fro by a quarter of its height
    legs: float  # how far legs swing from the hip [rad]; knees bend by twice as much


# Chosen in sight of five characters of the wardrobe (seeds 810003, 810010, 810035, 840003, 840010).
_STANDING = _Sway(5.0, (0.25, 0.6, 0.2), 0.1, 0.02, 0.0, 0.4)
_GOING = tuple(_Sway(6.0, (0.12 * much, 0.3 * much, 0.08 * much), 0.04, 0.015, pace, legs)
               for pace, much, legs in ((0.7, 1.0, 0.4), (0.8, 0.3, 0.5), (0.4, 0.6, 0.3)))  # fmt: skip
STEP = 0.9  # steps of each leg a second [1/s]


def fitted_springs(chained: Chained) -> list[np.ndarray]:
    """Stiffness, drag and gravity power of each link of each chain, each of shape (R, 3)."""
    values = (_GRID[:, 0], _GRID[:, 1], _GRID[:, 2])
    paths = [_Path.of(chained, sway) for sway in (_STANDING, *_GOING)]
    out: list[np.ndarray] = [np.zeros((len(chain), 3)) for chain in chained.chains]
    for link in range(max(map(len, chained.chains), default=0)):
        rows = [number for number, chain in enumerate(chained.chains) if len(chain) > link]
        lines = [chained.chains[number].points for number in rows]
        bones = np.stack([line[link + 1] - line[link] for line in lines])
        best = sum(path.errors(link, rows, bones, values) for path in paths).argmin(axis=1)  # type: ignore[union-attr]
        for number, chosen in zip(rows, _GRID[best], strict=True):
            out[number][link] = chosen
        for path in paths:
            path.go_on(rows, bones, (*_GRID[best].T[:, :, None],))
    return out


class _Path:
    """A motion, where the links of C chains go in our simulation, and where VRM's steps have brought the link above:
    rotations (T, C, 3, 3) and positions (T, C, 3) of the holder of each chain's first link, the tails of each chain (N,
    R, 3), and their mean distance from where they would be without a simulation [m], (C,).
    """

    def __init__(self, turns: np.ndarray, heads: np.ndarray, tails: Sequence[np.ndarray], rigid: np.ndarray):
        self.turns, self.heads, self.tails, self.rigid = turns, heads, tails, rigid

    @classmethod
    def of(cls, chained: Chained, sway: _Sway) -> _Path:
        moved = _swaying(chained, sway)
        rotations, positions = steady_simulation(moved, chained.rig()).animation.world()
        still = moved.world()[1]
        bones = [[*chain.bones[1:], end] for chain, end in zip(chained.chains, chained.ends, strict=True)]
        holders, firsts = ([int(bone) for bone in row] for row in zip(
            *((chain.holder, chain.bones[0]) for chain in chained.chains), strict=True))  # fmt: skip
        turns, heads = between_frames(rotations[:, holders], positions[:, firsts], RATE)
        rigid = [np.linalg.norm(positions[:, tails] - still[:, tails], axis=-1).mean() for tails in bones]
        return cls(turns, heads, [positions[:, tails] for tails in bones], np.maximum(rigid, 1e-6))

    def errors(self, link: int, rows: list[int], bones: np.ndarray, values: VrmValues) -> np.ndarray:
        """Distance of VRM's tails of the chains' links from ours with each setting, over rigid, shape (C, S)."""
        true = np.stack([self.tails[number][:, link] for number in rows], axis=1)
        every = (len(self.heads) - 1) // (len(true) - 1)
        out = np.zeros((len(rows), values[0].shape[-1]))
        stiffness, drag, gravity = (np.broadcast_to(value, out.shape) for value in values)
        settings = (stiffness, drag, gravity)
        for step, tails in enumerate(vrm_steps(self.turns[:, rows], self.heads[:, rows], bones, settings)):
            if step % every == 0:
                away = tails - true[step // every][:, None]
                out += np.sqrt(np.einsum("csa,csa->cs", away, away))
        return np.asarray(out / len(true) / self.rigid[rows][:, None])

    def go_on(self, rows: list[int], bones: np.ndarray, values: VrmValues) -> None:
        """Take the links with the chosen settings as holders of the next ones."""
        turns, heads = self.turns[:, rows], self.heads[:, rows]
        tails = np.stack(list(vrm_steps(turns, heads, bones, values)))[:, :, 0]
        self.turns[:, rows], self.heads[:, rows] = link_turns(turns, heads, bones, tails), tails


def _swaying(chained: Chained, sway: _Sway) -> RigAnimation:
    """The animation of a `_Sway`."""
    rig = chained.character.rig
    assert rig is not None
    time = np.arange(round(sway.seconds * RATE)) / RATE
    count = len(rig.names)
    rotations = np.tile(np.eye(3), (len(time), count, 1, 1))
    translations = np.zeros((len(time), count, 3))
    top = int(np.flatnonzero(rig.parents < 0)[0])
    holders = {int(chain.holder) for chain in chained.chains}
    links = {int(bone) for chain in chained.chains for bone in chain.bones}
    angles = np.stack(
        [much * np.sin(2 * np.pi * rate * time) for much, rate in zip(sway.turns, (STEP, 0.4, 0.6), strict=True)],
        axis=1,
    )
    for bone in sorted(({top} | holders) - links):
        rotations[:, bone] = matrix_from_axis_angle((1.0 if bone == top else 0.7) * angles)
    limbs = chained.legs & {body.bone for body in chained.colliders}
    for bone in sorted(limbs - links):
        phase = 2 * np.pi * STEP * time + (np.pi if rig.positions[bone, 0] > 0 else 0.0)
        swing = -sway.legs * np.sin(phase)
        if int(rig.parents[bone]) in limbs:  # a knee bends while its leg goes forward
            swing = 2 * sway.legs * np.maximum(np.cos(phase), 0)
        rotations[:, bone] = matrix_from_axis_angle(swing[:, None] * np.array([1.0, 0, 0]))
    # to its pace in a second
    forward = sway.pace * np.where(time < 1, time**2 / 2, time - 0.5)
    if not sway.pace:
        forward = 0.25 * np.sin(2 * np.pi * 0.3 * time)
    aside, up = sway.aside * np.sin(2 * np.pi * 0.5 * time), sway.up * np.sin(2 * np.pi * 1.9 * time)
    translations[:, top] = chained.character.height * np.stack([aside, up, forward], axis=1)
    return RigAnimation(chained.character, rotations, translations, RATE)


def mmd_avatar(chained: Chained) -> MmdModel:
    """The rigid bodies and joints of a character's chains, by the bones of its rig; the writer makes the rest."""
    rooms = np.array([_rooms(chain, chained) - chain.width.max(initial=0) for chain in chained.chains])
    # other programs throw out what lies within a collider at rest
    clear = np.flatnonzero((rooms.reshape(-1, len(chained.colliders)) > 0).all(axis=0))
    rig = replace(chained, colliders=tuple(chained.colliders[number] for number in clear)).rig()
    none = np.zeros((0, 3))
    return MmdModel(
        chained.character.name, "", "PMX 2.0", (), (), rig.bodies, rig.joints, np.zeros(0, np.uint8),
        MmdSdef(np.zeros(0, np.int64), none, none, none),
    )  # fmt: skip


def vrm_avatar(chained: Chained) -> VrmModel:
    """The springs and colliders of a character's chains, by the bones of its rig."""
    rig = chained.character.rig
    assert rig is not None
    colliders = []
    for body in chained.colliders:
        half = 0.5 * body.size[1] * body.rotation[:, 1]
        middle = body.position - rig.positions[body.bone]
        colliders.append(VrmCollider(body.bone, "capsule", middle - half, float(body.size[0]), middle + half))
    springs, down = [], np.array([0.0, -1, 0])
    groups: dict[tuple[int, ...], int] = {}
    for chain, end, values in zip(chained.chains, chained.ends, fitted_springs(chained), strict=True):
        rooms = _rooms(chain, chained)
        clear = tuple(np.flatnonzero(rooms > 0).tolist())  # what lies within one at rest would be thrown out of it
        room = float(rooms[list(clear)].min(initial=np.inf))
        joints = []
        for bone, width, setting in zip(chain.bones, chain.width, values, strict=True):
            stiffness, drag, gravity = setting.tolist()
            radius = float(np.clip(min(0.6 * width, room), 0.0, 0.04))
            joints.append(VrmSpringJoint(int(bone), stiffness, gravity, down, drag, radius))
        joints.append(VrmSpringJoint(end, 1.0, 0.0, down, float(values[-1, 1]), 0.0))
        group = (groups.setdefault(clear, len(groups)),) if clear else ()
        springs.append(VrmSpring(chain.name, tuple(joints), group))
    return VrmModel("1.0", chained.character.name, {}, tuple(springs), tuple(colliders), tuple(groups))


def _rooms(chain: Chain, chained: Chained) -> np.ndarray:
    """Distance of a chain's tails from each collider at rest [m], shape (C,)."""
    out = []
    for body in chained.colliders:
        along, half = body.rotation[:, 1], 0.5 * body.size[1]
        away = chain.points[1:] - body.position
        at = np.clip(away @ along, -half, half)
        out.append(np.linalg.norm(away - at[:, None] * along, axis=1).min() - body.size[0])
    return np.array(out)
