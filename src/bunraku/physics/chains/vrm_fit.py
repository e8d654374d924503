"""Springs of VRM that swing as chains do.

A spring of VRM has no limits, no ties and no mass. So its numbers are not converted but fitted: the chains are
simulated here in motions that sway, turn and go forward, and each link in turn, from the first one on, gets the
stiffness, drag and gravity with which VRM's own steps come nearest to that. What hangs on a link of VRM does not pull
at it, so what is found for it holds whatever those below get.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from bunraku.core.rig_animation import RigAnimation
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.physics.chains.laid import Chained
from bunraku.physics.chains.moving import steady_simulation
from bunraku.physics.vrm_steps import VrmValues, between_frames, link_turns, vrm_steps

__all__ = ["fitted_springs"]

FPS = 30.0
# Gravity over stiffness is how far a link hangs down. Softer links with less drag swing on in motions that they were
# not fitted to.
_GRID = np.array([(stiffness, drag, stiffness * sag) for stiffness, drag, sag in product(
    (0.5, 1.0, 2.0, 4.0, 8.0, 16.0), (0.15, 0.3, 0.5, 0.75), (0.0, 0.05, 0.1, 0.2, 0.35, 0.6))])  # fmt: skip


@dataclass(frozen=True)
class _Sway:
    """A motion made of sines.

    Args:
        seconds: Its length [s].
        turns: How far the body bends, turns and leans [rad].
        aside, up: How far it goes aside and up and down, over its height.
        pace: How fast it goes forward, heights a second; of the first, to and fro by a quarter of its height.
        legs: How far legs swing from the hip [rad]; knees bend by twice as much.
    """

    seconds: float
    turns: tuple[float, float, float]
    aside: float
    up: float
    pace: float
    legs: float


_STANDING = _Sway(5.0, (0.25, 0.6, 0.2), 0.1, 0.02, 0.0, 0.4)
_GOING = tuple(_Sway(6.0, (0.12 * much, 0.3 * much, 0.08 * much), 0.04, 0.015, pace, legs)
               for pace, much, legs in ((0.7, 1.0, 0.4), (0.8, 0.3, 0.5), (0.4, 0.6, 0.3)))  # fmt: skip
STEP = 0.9  # steps of each leg a second [1/s]


def fitted_springs(made: Chained) -> list[np.ndarray]:
    """Stiffness, drag and gravity power of each link of each chain, each of shape (R, 3)."""
    values = VrmValues(*_GRID.T)
    paths = [_Path.of(made, sway) for sway in (_STANDING, *_GOING)]
    out: list[np.ndarray] = [np.zeros((len(chain), 3)) for chain in made.chains]
    for link in range(max(map(len, made.chains), default=0)):
        rows = [number for number, chain in enumerate(made.chains) if len(chain) > link]
        bones = np.stack([made.chains[number].points[link + 1] - made.chains[number].points[link] for number in rows])
        best = sum(path.errors(link, rows, bones, values) for path in paths).argmin(axis=1)  # type: ignore[union-attr]
        for number, chosen in zip(rows, _GRID[best], strict=True):
            out[number][link] = chosen
        for path in paths:
            path.go_on(rows, bones, VrmValues(*_GRID[best].T[:, :, None]))
    return out


class _Path:
    """A motion, where the links of C chains go in our simulation, and where VRM's steps have brought the link above.

    Args:
        turns, heads: Of what the first link of each chain hangs on at each step, shapes (T, C, 3, 3) and (T, C, 3).
        tails: Of each chain in our simulation, shape (N, R, 3).
        rigid: How far these are in the mean from where they would be without one [m], shape (C,).
    """

    def __init__(self, turns: np.ndarray, heads: np.ndarray, tails: Sequence[np.ndarray], rigid: np.ndarray):
        self.turns, self.heads, self.tails, self.rigid = turns, heads, tails, rigid

    @classmethod
    def of(cls, made: Chained, sway: _Sway) -> _Path:
        moved = _swaying(made, sway)
        rotations, places = steady_simulation(moved, made.rig()).animation.world()
        still = moved.world()[1]
        bones = [[*chain.bones[1:], end] for chain, end in zip(made.chains, made.ends, strict=True)]
        holders, firsts = ([int(bone) for bone in row] for row in zip(
            *((chain.holder, chain.bones[0]) for chain in made.chains), strict=True))  # fmt: skip
        turns, heads = between_frames(rotations[:, holders], places[:, firsts], FPS)
        rigid = [np.linalg.norm(places[:, own] - still[:, own], axis=-1).mean() for own in bones]
        return cls(turns, heads, [places[:, own] for own in bones], np.maximum(rigid, 1e-6))

    def errors(self, link: int, rows: list[int], bones: np.ndarray, values: VrmValues) -> np.ndarray:
        """How far VRM's tails of some chains' links are from ours with each setting, over rigid, shape (C, S)."""
        true = np.stack([self.tails[number][:, link] for number in rows], axis=1)
        every = (len(self.heads) - 1) // (len(true) - 1)
        out = np.zeros((len(rows), values.stiffness.shape[-1]))
        own = VrmValues(*(np.broadcast_to(one, out.shape) for one in (values.stiffness, values.drag, values.gravity)))
        for step, tails in enumerate(vrm_steps(self.turns[:, rows], self.heads[:, rows], bones, own)):
            if step % every == 0:
                away = tails - true[step // every][:, None]
                out += np.sqrt(np.einsum("csa,csa->cs", away, away))
        return np.asarray(out / len(true) / self.rigid[rows][:, None])

    def go_on(self, rows: list[int], bones: np.ndarray, values: VrmValues) -> None:
        """Take the links with the settings that were chosen as what the next ones hang on."""
        turns, heads = self.turns[:, rows], self.heads[:, rows]
        tails = np.stack(list(vrm_steps(turns, heads, bones, values)))[:, :, 0]
        self.turns[:, rows], self.heads[:, rows] = link_turns(turns, heads, bones, tails), tails


def _swaying(made: Chained, sway: _Sway) -> RigAnimation:
    """A body that bends, turns and goes."""
    rig = made.character.rig
    assert rig is not None
    time = np.arange(round(sway.seconds * FPS)) / FPS
    count = len(rig.names)
    rotations = np.tile(np.eye(3), (len(time), count, 1, 1))
    translations = np.zeros((len(time), count, 3))
    top = int(np.flatnonzero(rig.parents < 0)[0])
    holders = {int(chain.holder) for chain in made.chains}
    links = {int(bone) for chain in made.chains for bone in chain.bones}
    angles = np.stack(
        [much * np.sin(2 * np.pi * rate * time) for much, rate in zip(sway.turns, (STEP, 0.4, 0.6), strict=True)],
        axis=1,
    )
    for bone in sorted(({top} | holders) - links):
        rotations[:, bone] = matrix_from_axis_angle((1.0 if bone == top else 0.7) * angles)
    limbs = {body.bone for body in made.colliders}
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
    translations[:, top] = made.character.height * np.stack([aside, up, forward], axis=1)
    return RigAnimation(made.character, rotations, translations, FPS)
