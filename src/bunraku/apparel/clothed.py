"""A character as the apparel networks see it: mesh, joints, what is apparel, how stiff it is, and how each vertex
swings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from bunraku.core.avatars import MMD_METRE
from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES
from bunraku.errors import CharacterError

LEGS = tuple(
    JOINT_NAMES.index(f"{side}_{part}") for part in ("hip", "knee", "ankle", "foot") for side in ("left", "right")
)
"""Joints of the legs."""
ARMS = tuple(
    JOINT_NAMES.index(f"{side}_{part}") for part in ("shoulder", "elbow", "wrist") for side in ("left", "right")
)
"""Joints of the arms."""
SIZE = 1.6
"""Height that the networks know characters at [m]; others are measured in units of theirs over this."""
GRAVITY = 98 * MMD_METRE
"""98 units of MMD files [m/s^2]; the displacement network was trained with it, and springs are measured by it."""
RATE = 30.0
"""Frames a second that the networks were trained at, and that motions are made at to which springs are fitted [1/s]."""
LAYER = 0.02
"""Over the size [m]: layers of cloth and cards of hair that are nearer lie on one another, and one point of a surface
stands for what is as near. Chosen by eye on the wardrobe and on twelve bare meshes.
"""
BESIDE = 0.04
"""Over the size [m]: what is farther from a surface is not beside it. A chain that keeps so far from the body is free,
and within as much apparel goes over to the body where both are one sheet. Chosen by eye on the same meshes.
"""
NORMAL_STIFFNESS = -0.4
"""Of cloth that hangs, the median of the wardrobe: the stiffness of a part without springs and limits."""
NORMAL_DAMPING = 0.93
"""Share of the velocity that a part loses in a second, where nothing says it: the median of twelve MMD and VRM files
and of the wardrobe.
"""
SOFTEST, STIFFEST = -2.2, 2.0  # range of stiffness that the networks were trained on
FREE = np.pi  # limit of a joint without limits [rad]
NARROW = 0.01  # the narrowest limit that differs from a locked joint, as the networks were trained [rad]
LOADS = 0.3
"""log10 of the load on a moving part over its weight: springs that rotate as far under it as the limits allow hold as
the limits do. Chosen by eye.
"""


def part_stiffness(
    spring: np.ndarray, mass: np.ndarray, length: np.ndarray, dial: float = 1.0, limit: np.ndarray | None = None
) -> np.ndarray:
    """Stiffness of parts as the networks take it: log10 of a joint's spring over the moment of a body at the part's
    end, from -2.2, where it hangs freely, to 2, where it stands; shape (P,), float32. A part held by limits is as stiff
    as one whose springs let it rotate no farther.

    Args:
        spring: Of a joint [N m / rad], shape (P,).
        mass: Of a body [kg], shape (P,).
        length: Of the part [m], shape (P,).
        dial: The user's factor.
        limit: How far a joint may rotate [rad], shape (P,); None for freely.
    """
    moment = np.maximum(np.asarray(mass, np.float64), 1e-4) * GRAVITY * np.maximum(length, 1e-3)
    spring = np.asarray(spring, np.float64)
    ratio = np.where(spring > 0, np.log10(np.maximum(spring, 1e-8) / moment), NORMAL_STIFFNESS)
    if limit is not None:
        turn = np.clip(np.asarray(limit, np.float64), NARROW, FREE)
        ratio = np.where(turn < FREE, np.maximum(ratio, LOADS - np.log10(turn)), ratio)
    return np.asarray(np.clip(ratio + np.log10(dial), SOFTEST, STIFFEST), np.float32)


@dataclass(frozen=True, eq=False)
class ClothedCharacter:
    """A character with apparel. CharacterError if the shapes do not fit."""

    # rest, faces: rest mesh V [m], float32, shapes (V, 3) and (F, 3)
    rest: np.ndarray
    faces: np.ndarray
    joints: np.ndarray  # J, SMPL's 22 joints in the rest pose [m], shape (22, 3)
    weights: np.ndarray  # skinning weights W for the joints, shape (V, 22); an apparel vertex has those of its carrier
    apparel: np.ndarray  # the mask, shape (V,), bool
    part: np.ndarray  # number of the apparel part of each vertex, -1 on the body, shape (V,)
    stiffness: np.ndarray  # of each part (`part_stiffness`), shape (P,)
    damping: np.ndarray  # of each part: share of the velocity that it loses in a second, shape (P,)
    # of each part: how far a joint of it may rotate [rad], shape (P,); freely when None
    limit: np.ndarray = None  # type: ignore[assignment]
    # How each vertex swings by the joints above it, rows of `Swing`, shape (V, SWING_NUMBERS); None where only the
    # parts' stiffness is known.
    swing: np.ndarray | None = None
    kinds: tuple[str, ...] = ()  # kind of each part (`chains.chain.KINDS`), length P; empty where it is not known

    def __post_init__(self) -> None:
        count, parts = len(self.rest), int(self.part.max(initial=-1)) + 1
        if self.limit is None:
            object.__setattr__(self, "limit", np.full(parts, FREE, np.float32))
        good = self.weights.shape == (count, JOINT_COUNT) and self.joints.shape == (JOINT_COUNT, 3)
        good &= self.apparel.shape == self.part.shape == (count,)
        good &= self.swing is None or len(self.swing) == count
        if not good or len(self.stiffness) != parts or len(self.damping) != parts or len(self.limit) != parts:
            raise CharacterError("the mesh, its weights and its apparel are not of one character")

    @property
    def scale(self) -> float:
        """Its size over `SIZE`."""
        return max(float(np.ptp(self.rest[:, 1])), 1e-6) / SIZE


_SIZES = {"lever": 3, "away": 3, "arm": 3, "axes": 9, "lower": 3, "upper": 3, "spring": 3, "friction": 1, "drag": 1,
          "weight": 1, "share": 1}  # fmt: skip
"""Numbers of each field of `Swing` in a row of its table, by definition."""
SWING_NUMBERS = sum(_SIZES.values())
AIR = 1.5  # largest rate at which the air takes speed, as in the simulation and the trained networks [1/s]
SOLID = 2 / 3  # of a rod: by definition as long is the pendulum that swings like it


@dataclass(frozen=True, eq=False)
class Swing:
    """How N vertices or nodes swing, in the rest pose."""

    lever: np.ndarray  # A small rotation w of its chain takes it by w x lever [m], shape (N, 3)
    away: np.ndarray  # from the pivot of its chain to it [m], shape (N, 3)
    arm: np.ndarray  # from there to the mass of a pendulum that swings as its chain does [m], shape (N, 3)
    axes: np.ndarray  # axes of rotation, columns, shape (N, 3, 3)
    # lower, upper: limits about each [rad], shape (N, 3)
    lower: np.ndarray
    upper: np.ndarray
    spring: np.ndarray  # about each, over the inertia [1/s^2], shape (N, 3)
    # friction, drag: rates at which it loses speed against its carrier, and against the air [1/s], shape (N,)
    friction: np.ndarray
    drag: np.ndarray
    weight: np.ndarray  # its gravity over that of MMD's files, shape (N,)
    share: np.ndarray  # how much of it swings; the rest stays where it is carried, shape (N,)

    @classmethod
    def of_rows(cls, rows: np.ndarray) -> Swing:
        """From rows of plain numbers, shape (N, SWING_NUMBERS)."""
        parts = np.split(rows, np.cumsum(list(_SIZES.values()))[:-1], axis=1)
        return cls(*(part.reshape(len(rows), *_shape(size)) for part, size in zip(parts, _SIZES.values(), strict=True)))

    def rows(self) -> np.ndarray:
        """As rows of plain numbers, shape (N, SWING_NUMBERS), float32."""
        count = len(self.share)
        columns = [getattr(self, field.name).reshape(count, -1) for field in fields(self)]
        return np.concatenate(columns, axis=1, dtype=np.float32)

    def take(self, chosen: np.ndarray) -> Swing:
        """Some of them."""
        return Swing(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def dialled(self, dial: float) -> Swing:
        """With a factor on the springs, and limits narrower by its root."""
        narrow = float(np.sqrt(dial))
        return replace(self, lower=self.lower / narrow, upper=self.upper / narrow, spring=self.spring * dial)

    def with_parameters(self, numbers: Mapping[str, float], links: int) -> Swing:
        """With the parameters of a chain of `links` links from a file; what the file does not say stays."""
        out = self
        length = np.maximum(np.linalg.norm(self.arm, axis=1), 1e-3)
        if "limit" in numbers:
            turn = np.full_like(self.upper, min(np.radians(numbers["limit"]) * links, FREE))
            out = replace(out, lower=-turn, upper=turn)
        if "stiffness" in numbers:
            out = replace(out, spring=(numbers["stiffness"] * GRAVITY / length)[:, None] * np.ones(3, np.float32))
        if "damping" in numbers:
            loss = np.full_like(self.friction, -np.log1p(-min(numbers["damping"], 0.999)))
            out = replace(out, friction=np.maximum(loss - AIR, 0), drag=np.minimum(loss, AIR))
        if "gravity" in numbers:
            out = replace(out, weight=np.full_like(self.weight, numbers["gravity"]))
        return out

    def turns(self) -> np.ndarray:
        """Rotation across its lever by limits, and by springs that give way to its weight, level [rad], (N, 2)."""
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
        stiffness, damping: As of `ClothedCharacter`, of each node, shape (N,).
    """
    count = len(held)
    turn = np.clip(10.0 ** (LOADS - stiffness.astype(np.float64)), NARROW, FREE)[:, None] * np.ones(3)
    length = np.maximum(SOLID * np.linalg.norm(held, axis=1), 1e-3)
    spring = (10.0 ** stiffness.astype(np.float64) * GRAVITY / length)[:, None] * np.ones(3)
    loss = -np.log1p(-np.minimum(damping.astype(np.float64), 0.999))
    ones = np.ones(count)
    axes = np.broadcast_to(np.eye(3), (count, 3, 3))
    return Swing(
        held, held, SOLID * held, axes, -turn, turn, spring, np.maximum(loss - AIR, 0), np.minimum(loss, AIR), ones,
        ones,
    )  # fmt: skip
