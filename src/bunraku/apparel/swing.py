"""How each vertex of apparel swings: as a pendulum of its own with limits and springs about three axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from bunraku.apparel.clothed import FREE, GRAVITY, LOADS, NARROW

__all__ = ["SWING_NUMBERS", "Swing", "guessed_swing"]

_SIZES = {"lever": 3, "away": 3, "arm": 3, "axes": 9, "lower": 3, "upper": 3, "spring": 3, "friction": 1, "drag": 1,
          "weight": 1, "share": 1}  # fmt: skip
SWING_NUMBERS = sum(_SIZES.values())
AIR = 1.5
"""Of the rate at which speed is lost what the air takes at the most, as in the simulation [1/s]."""
SOLID = 2 / 3  # of a rod: as long is the pendulum that swings like it


@dataclass(frozen=True, eq=False)
class Swing:
    """Of N vertices or nodes, in the rest pose.

    Args:
        lever: A small turn w of its chain takes it by w x lever [m], shape (N, 3).
        away: From where its chain turns to it [m], shape (N, 3).
        arm: From there to the mass of a pendulum that swings as its chain does [m], shape (N, 3).
        axes: That it turns about, columns, shape (N, 3, 3).
        lower, upper: How far about each [rad], shape (N, 3).
        spring: About each, over the inertia [1/s^2], shape (N, 3).
        friction, drag: Rates at which it loses speed against what carries it, and against the air [1/s], shape (N,).
        weight: Its gravity over that of MMD's files, shape (N,).
        share: How much of it swings; the rest stays where it is carried, shape (N,).
    """

    lever: np.ndarray
    away: np.ndarray
    arm: np.ndarray
    axes: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    spring: np.ndarray
    friction: np.ndarray
    drag: np.ndarray
    weight: np.ndarray
    share: np.ndarray

    @classmethod
    def of_rows(cls, rows: np.ndarray) -> Swing:
        """From rows of plain numbers, shape (N, SWING_NUMBERS)."""
        parts = np.split(rows, np.cumsum(list(_SIZES.values()))[:-1], axis=1)
        return cls(*(part.reshape(len(rows), *_shape(size)) for part, size in zip(parts, _SIZES.values(), strict=True)))

    def rows(self) -> np.ndarray:
        """As rows of plain numbers, shape (N, SWING_NUMBERS), float32."""
        count = len(self.share)
        return np.concatenate(
            [getattr(self, one.name).reshape(count, -1) for one in fields(self)], axis=1, dtype=np.float32
        )

    def take(self, chosen: np.ndarray) -> Swing:
        """Some of them."""
        return Swing(*(getattr(self, one.name)[chosen] for one in fields(self)))

    def dialled(self, dial: float) -> Swing:
        """With springs so many times as stiff, and limits narrower by the root of that."""
        narrow = float(np.sqrt(dial))
        return replace(self, lower=self.lower / narrow, upper=self.upper / narrow, spring=self.spring * dial)

    def told(self, numbers: Mapping[str, float], links: int) -> Swing:
        """As somebody says that their chain swings, in the numbers of `physics.chains.manners_file`: how far each of
        its links turns, how stiff its springs are, how damped it is, and what pulls at it; what is not said stays.

        Args:
            numbers: By their names.
            links: Of the chain.
        """
        out = self
        length = np.maximum(np.linalg.norm(self.arm, axis=1), 1e-3)
        if "limit" in numbers:
            turn = np.full_like(self.upper, min(np.radians(numbers["limit"]) * links, FREE))
            out = replace(out, lower=-turn, upper=turn)
        if "stiffness" in numbers:
            spring = (numbers["stiffness"] * GRAVITY / length)[:, None] * np.ones(3, np.float32)
            out = replace(out, spring=spring)
        if "damping" in numbers:
            loss = np.full_like(self.friction, -np.log1p(-min(numbers["damping"], 0.999)))
            out = replace(out, friction=np.maximum(loss - AIR, 0), drag=np.minimum(loss, AIR))
        if "gravity" in numbers:
            out = replace(out, weight=np.full_like(self.weight, numbers["gravity"]))
        return out

    def turns(self) -> np.ndarray:
        """How far it turns across its lever by limits, and by what springs give way to its weight, lying level [rad],
        shape (N, 2).
        """
        length = np.maximum(np.linalg.norm(self.lever, axis=1), 1e-6)
        across = np.linalg.norm(np.cross(self.axes.transpose(0, 2, 1), self.lever[:, None]), axis=-1) / length[:, None]
        fall = GRAVITY / np.maximum(np.linalg.norm(self.arm, axis=1), 1e-3)[:, None]
        sag = np.minimum(fall / np.maximum(self.spring, 1e-6), FREE)
        half = np.stack([(self.upper - self.lower) / 2, sag], axis=1)
        return np.asarray(self.share[:, None] * np.minimum(np.linalg.norm(half * across[:, None], axis=-1), FREE))


def _shape(size: int) -> tuple[int, ...]:
    return (3, 3) if size == 9 else (size,) if size > 1 else ()


def guessed_swing(held: np.ndarray, stiffness: np.ndarray, damping: np.ndarray) -> Swing:
    """What the stiffness of a part would mean for a single joint where it is held.

    Args:
        held: From there to each node [m], shape (N, 3).
        stiffness: As of `ClothedCharacter`, of each node, shape (N,).
        damping: Share of the velocity that is lost in a second, shape (N,).
    """
    count = len(held)
    turn = np.clip(10.0 ** (LOADS - stiffness.astype(np.float64)), NARROW, FREE)[:, None] * np.ones(3)
    length = np.maximum(SOLID * np.linalg.norm(held, axis=1), 1e-3)
    spring = (10.0 ** stiffness.astype(np.float64) * GRAVITY / length)[:, None] * np.ones(3)
    loss = -np.log1p(-np.minimum(damping.astype(np.float64), 0.999))
    one = np.ones(count)
    axes = np.broadcast_to(np.eye(3), (count, 3, 3))
    return Swing(
        held, held, SOLID * held, axes, -turn, turn, spring, np.maximum(loss - AIR, 0), np.minimum(loss, AIR), one, one
    )
