"""Chains of bones that apparel hangs on, with their rigid bodies, their joints and the cross-links between neighbours.

Weights of a surface over the chains follow from where its vertices are along and between them.
"""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass, replace

import numpy as np

from bunraku.core.avatars import MmdBody, MmdBone, MmdJoint
from bunraku_lab.synthetic.surfaces import unit
from bunraku_lab.synthetic.wardrobe.model import Costume, bone_frame

_DEGREE = np.pi / 180
SPRING = 1 / 0.08**2
"""Stiffness in a file for each N m / rad: By definition: MMD's forces are in kg unit / s^2 and its unit is 8 cm."""

# Fitted by eye to the percentiles of limits, springs and damping in twelve MMD files.
HELD = 0.6  # share of the pieces that narrow limits hold in shape
WIDER = 0.35  # log10 of how much wider the limits of the others are at the most
SPRINGLESS_HELD, SPRINGLESS = 0.6, 0.35  # share of those, and of the others, without springs
STIFFER = 2.0  # log10 of the most that a spring is stiffer
LOSSES = (-1.0, 0.85)  # log10 of what damping leaves of the speed in a second, over the usual, from and to
WIDEST = 170.0  # limit [degrees]
LOCKED = 0.25  # share of the pieces so held, of several links, whose first one does not turn


@dataclass(frozen=True)
class Hang:
    """How chains move.

    Args:
        mass: Of a link at the top [kg]; those below are lighter, the last has half.
        damping: Share of the velocity that is lost in a second, linear and angular.
        out, inward, side, twist: Largest angles of a link against the one above [deg]: away from the body, and so on.
        spring: Stiffness against turning at the top [N m / rad]; those below are weaker, as their masses.
        thick: Half thickness of boxes, or radius of capsules [m].
        box: Whether links are boxes as wide as their share of the surface, as cloth is.
        group: Collision group.
        meets: Groups that it collides with, bit g for group g.
        give: How far a tie between neighbours lets them come apart, over their distance; 0 keeps their places together.
        friction: Coefficient.
        locked: Whether the first link of a chain does not turn.
    """

    mass: float
    damping: tuple[float, float]
    out: float
    inward: float
    side: float
    twist: float
    spring: float
    thick: float
    box: bool
    group: int
    meets: int
    give: float = 0.0
    friction: float = 0.2
    locked: bool = False


@dataclass(frozen=True, eq=False)
class Chains:
    """Chains side by side.

    Args:
        bones: Bone of each link, shape (C, R).
        parent: Bones that the first links hang on, shape (C,).
        closed: Whether the last is a neighbour of the first.
    """

    bones: np.ndarray
    parent: np.ndarray
    closed: bool

    def weights(self, along: np.ndarray, across: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Bones and shares of vertices, shape (V, 4) each.

        Args:
            along: Place along the chains from 0 at the top to R at the end, shape (V,).
            across: Place between the chains from 0 to C (closed) or C - 1, shape (V,); None for a single chain.
        """
        count, links = self.bones.shape
        table = np.concatenate([self.parent[:, None], self.bones], axis=1)
        rows = np.clip(along + 0.5, 0, links)
        low = np.minimum(rows.astype(np.int64), links - 1)
        down = np.clip(rows - low, 0, 1)
        if across is None:
            across = np.zeros(len(along))
        left = np.floor(across).astype(np.int64)
        aside = across - left
        left, right = (
            (left % count, (left + 1) % count)
            if self.closed
            else (np.clip(left, 0, count - 1), np.clip(left + 1, 0, count - 1))
        )
        bones = np.stack([table[left, low], table[left, low + 1], table[right, low], table[right, low + 1]], axis=1)
        shares = np.stack([(1 - aside) * (1 - down), (1 - aside) * down, aside * (1 - down), aside * down], axis=1)
        return bones, shares


def add_chains(
    costume: Costume, names: list[str], nodes: np.ndarray,
    outward: np.ndarray, parent: int | list[int], hang: Hang, *, closed: bool = False, cross: bool = True,
) -> Chains:  # fmt: skip
    """Add chains of bones along rows of points, with bodies and joints.

    Args:
        costume: What they are added to.
        names: Name of each chain; links are numbered.
        nodes: Positions where links begin, and the end of the last, shape (C, R + 1, 3).
        outward: Directions away from the body, shape (C, 3).
        parent: Bone that they hang on, with a kinematic body; one for all or one each.
        hang: How they move.
        closed: Whether the last chain is a neighbour of the first.
        cross: Whether neighbours are tied to each other.
    """
    count, links = nodes.shape[0], nodes.shape[1] - 1
    hang = _varied(hang, _piece_random(costume, names[0]))
    hang = replace(hang, locked=hang.locked and links > 1)
    above = np.broadcast_to(parent, count).astype(np.int64)
    bones, bodies = np.zeros((count, links), np.int64), np.zeros((count, links), np.int64)
    gaps = _gaps(nodes, closed)
    for chain in range(count):
        holder, body = int(above[chain]), costume.collider(int(above[chain]))
        for link in range(links):
            start, end = nodes[chain, link], nodes[chain, link + 1]
            frame = bone_frame(end - start, outward[chain])
            name = f"{names[chain]}_{link + 1}" if links > 1 else names[chain]
            holder = costume.bone(MmdBone(name, f"{name}", start, holder, tail=end - start))
            if link:
                costume.tails[holder - 1] = holder
            share = 1 - 0.5 * link / max(links - 1, 1)
            own = costume.body(_link_body(name, holder, start, end, frame, gaps[chain, link], hang, share))
            costume.joints.append(_joint(name, (body, own), start, frame, hang, share))
            bones[chain, link], bodies[chain, link], body = holder, own, own
    if cross:
        _cross(costume, names, nodes, outward, bodies, hang, closed)
    return Chains(bones, above, closed)


def band_start(costume: Costume, name: str) -> float:
    """Where a piece begins to move, over its length from its top: at 0 for most, at the hem or tips for others."""
    random = _piece_random(costume, f"{name} band")
    if costume.quiet:
        return float(random.uniform(0.78, 0.94))
    return 0.0 if random.random() < 0.65 else float(random.uniform(0.25, 0.75))


def _piece_random(costume: Costume, name: str) -> np.random.Generator:
    """Random numbers of a piece of apparel; left and right ones, and the chains of one piece, have the same."""
    stem = re.sub(r"[左右\d]", "", name)
    return np.random.default_rng([costume.seed, zlib.crc32(stem.encode())])


def _varied(hang: Hang, random: np.random.Generator) -> Hang:
    """The same with a spring somewhere in nearly three decades, or none, another mass and damping, and limits that hold
    it in shape or do not: what holds most hair of real files are limits of 10 to 35 degrees without springs, and some
    of it hangs on a first joint that is locked. Damping of files is from 0.4 to 0.99.
    """
    stiff, heavy, loss = 10 ** random.uniform([-0.7, -0.15, LOSSES[0]], [STIFFER, 0.15, LOSSES[1]])
    held = random.random() < HELD
    hold = float(10 ** random.uniform(*((-0.8, -0.1) if held else (0.0, WIDER))))
    stiff *= random.random() >= (SPRINGLESS_HELD if held else SPRINGLESS)
    locked = held and random.random() < LOCKED
    angles = {name: min(getattr(hang, name) * hold, WIDEST) for name in ("out", "inward", "side")}
    damping = tuple(float(np.clip(1 - (1 - value) * loss, 0.05, 0.997)) for value in hang.damping)
    return replace(
        hang, spring=hang.spring * float(stiff), mass=hang.mass * float(heavy), damping=(damping[0], damping[1]),
        locked=bool(locked), **angles,
    )  # fmt: skip


def _gaps(nodes: np.ndarray, closed: bool) -> np.ndarray:
    """How wide each link's share of the surface is [m], shape (C, R)."""
    middle = 0.5 * (nodes[:, :-1] + nodes[:, 1:])
    if len(nodes) == 1:
        return np.full(middle.shape[:2], 0.05)
    apart = np.linalg.norm(np.roll(middle, -1, axis=0) - middle, axis=2)
    if not closed:
        apart[-1] = apart[-2]
    return np.asarray(
        np.minimum(apart, np.roll(apart, 1, axis=0) if closed else np.concatenate([apart[:1], apart[:-1]]))
    )


def _link_body(
    name: str, bone: int, start: np.ndarray, end: np.ndarray, frame: np.ndarray, gap: float, hang: Hang, share: float
) -> MmdBody:
    length = float(np.linalg.norm(end - start))
    # The first row of cloth lies on the hips: between them and a lifted thigh it would be crushed.
    meets = 0 if hang.box and share == 1 else hang.meets
    if hang.box:
        shape, size = "box", np.array([max(0.42 * gap, 0.008), max(0.46 * length, 0.008), hang.thick])
    else:
        radius = min(hang.thick, 0.45 * length)
        shape, size = "capsule", np.array([radius, max(length - 2 * radius, 0.002), 0.0])
    return MmdBody(
        name, bone, shape, size, 0.5 * (start + end), frame, hang.mass * share, *hang.damping, 0.0, hang.friction, 1,
        hang.group, meets,
    )  # fmt: skip


def _joint(
    name: str, bodies: tuple[int, int], position: np.ndarray, frame: np.ndarray, hang: Hang, share: float
) -> MmdJoint:
    # MMD counts an angle from the second body to the first, so outwards is positive here.
    free = 0.0 if hang.locked and share == 1 else _DEGREE
    low = np.array([-hang.inward, -hang.twist, -hang.side]) * free
    high = np.array([hang.out, hang.twist, hang.side]) * free
    stiff = hang.spring * share * SPRING * np.array([1.0, 1.5, 1.0])
    return MmdJoint(name, bodies, position, frame, np.zeros(3), np.zeros(3), low, high, np.zeros(3), stiff)


def _cross(
    costume: Costume, names: list[str], nodes: np.ndarray, outward: np.ndarray, bodies: np.ndarray, hang: Hang,
    closed: bool,
) -> None:  # fmt: skip
    """Ties between links of the same row, in every second row: enough to keep cloth in order."""
    count, links = bodies.shape
    rows = range(links - 1, 0, -2) if links > 1 else range(1)
    for chain in range(count if closed else count - 1):
        after = (chain + 1) % count
        for link in rows:
            position = 0.25 * (
                nodes[chain, link] + nodes[chain, link + 1] + nodes[after, link] + nodes[after, link + 1]
            )
            down = nodes[chain, link + 1] + nodes[after, link + 1] - nodes[chain, link] - nodes[after, link]
            frame = bone_frame(down, unit(outward[chain] + outward[after]))
            apart = float(np.linalg.norm(nodes[after, link + 1] - nodes[chain, link + 1]))
            give = np.full(3, hang.give * apart)
            turn = np.array([30.0, 30.0, 30.0]) * _DEGREE
            label = f"{names[chain]}_{link + 1}横"
            costume.joints.append(MmdJoint(
                label, (int(bodies[chain, link]), int(bodies[after, link])), position, frame, -give, give, -turn, turn,
                np.zeros(3), np.zeros(3),
            ))  # fmt: skip
