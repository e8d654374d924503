"""What crawls and hums: insects, spiders, crabs, bees, snakes and worms."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np

from bunraku_lab.synthetic.families.human_head import eyes
from bunraku_lab.synthetic.families.model import SIDES, Chain, Model
from bunraku_lab.synthetic.surfaces import unit


@dataclass(frozen=True)
class _LegShape:
    """How far out a leg goes, how high its knee is over its root, where the ground is, and how thick it is [m]."""

    reach: float
    rise: float
    ground: float
    radius: float


def _leg(m: Model, side: str, word: str, root: np.ndarray, yaw: float, shape: _LegShape, parent: str = "Hips") -> None:
    """A leg of three segments: out and up, out and down, and to the ground; the word names its bones."""
    reach, rise, ground, radius = astuple(shape)
    direction = np.array([dict(SIDES)[side] * np.cos(yaw), 0, np.sin(yaw)])
    knee = root + direction * reach * 0.38 + [0, rise, 0]
    mid = root + direction * reach * 0.75 + [0, (ground - root[1]) * 0.45 + 0.3 * rise, 0]
    tip = np.array([*(root + direction * reach)]) * [1, 0, 1] + [0, ground, 0]
    names = [f"{side}{word}{i}" for i in (1, 2, 3)]
    m.bones_along(names, (root, knee, mid), parent)
    m.limb(
        [root, knee, mid, tip], [radius * 1.1, radius, radius * 0.8, radius * m.u(0.2, 0.7)], names, f"{word} {side}",
        blend=0.4,
    )  # fmt: skip


def _legs(
    m: Model, words: tuple[str, ...], y: float, z: tuple[float, float], wide: float, ground: float, parent: str = "Hips"
) -> None:
    u = m.u
    reach, rise, radius, fan = u(0.6, 1.2) * (0.6 + wide), u(-0.02, 0.4), u(0.015, 0.06), u(0.3, 1.0)
    positions, shape = np.linspace(z[0], z[1], len(words)), _LegShape(reach, rise, ground, radius)
    for side, s in SIDES:
        for i, word in enumerate(words):
            yaw = fan * (1 - 2 * i / max(len(words) - 1, 1))
            _leg(m, side, word, np.array([s * wide * 0.8, y, positions[i]]), yaw, shape, parent)


def _antennae(m: Model, at: np.ndarray, size: float) -> None:
    for _, s in SIDES:
        direction = unit(np.array([s * 0.4, m.u(0.4, 1.0), 0.6]))
        m.limb(
            [
                at + size * np.array([s * 0.3, 0.6, 0.4]), at + size * 1.2 * direction,
                at + size * (1.2 * direction + m.u(0.4, 1.2) * unit(direction * [1, 0.3, 1])),
            ],
            [0.08 * size, 0.06 * size, 0.05 * size], "Head", f"antenna {s}", loose=True,
        )  # fmt: skip


def _abdomen(m: Model, root: np.ndarray, length: float, radius: float, dip: float, curl: float, sting: bool) -> None:
    """The rear of an insect moves as a tail does."""
    points, angle = [root], dip
    for _ in range(3):
        points.append(points[-1] + length / 3 * np.array([0, -np.sin(angle), -np.cos(angle)]))
        angle += curl / 3
    names = ["Abdomen1", "Abdomen2", "Abdomen3"]
    for name, parent, at in zip(names, ["Hips", *names], points, strict=False):
        m.bone(name.replace("Abdomen", "Tail"), parent.replace("Abdomen", "Tail"), at)
    chain = Chain(["Tail1", "Tail2", "Tail3"], points[:3])
    m.limb(
        points, [radius * m.u(0.3, 0.8), radius, radius * m.u(0.75, 1.0), radius * m.u(0.2, 0.6)], chain, "abdomen",
        blend=1.0,
    )  # fmt: skip
    if sting:
        direction = unit(points[3] - points[2])
        m.limb([points[3], points[3] + direction * radius * 1.2], [radius * 0.25, 0.008], "Tail3", "abdomen")


def _body(m: Model, y: float, radius: float, head: float, gap: float) -> np.ndarray:
    """Thorax and head; returns the head's centre. The thorax is the pelvis."""
    m.bone("Hips", "", (0, y, 0))
    m.lump((0, y, 0), radius * np.array([1, m.u(0.75, 1.1), m.u(0.9, 1.5)]), "Hips", "thorax")
    neck = m.bone("Neck", "Hips", (0, y + 0.1 * radius, radius * 0.9))
    centre = np.array([0, y + m.u(-0.1, 0.5) * radius, radius + gap + 0.8 * head])
    m.bone("Head", "Neck", centre - [0, 0, 0.7 * head])
    m.limb([neck, centre], [min(head, radius) * 0.6] * 2, "Neck", "thorax")
    m.lump(centre, head * np.array([m.u(0.8, 1.2), m.u(0.7, 1.0), m.u(0.7, 1.1)]), "Head", "head")
    eyes(m, centre, np.full(3, head), "Head")
    return centre


def insect(m: Model) -> None:
    """A beetle or an ant: six legs, thorax, abdomen."""
    u = m.u
    radius, head, ground = u(0.1, 0.25), u(0.09, 0.24), 0.0
    y = u(0.15, 0.5)
    centre = _body(m, y, radius, head, u(0, 0.05))
    _abdomen(m, np.array([0, y, -0.7 * radius]), u(0.3, 0.8), u(0.12, 0.32), u(-0.3, 0.3), u(-0.2, 0.4), m.chance(0.2))
    _legs(m, ("TopLeg", "MidLeg", "BottomLeg"), y - 0.3 * radius, (0.7 * radius, -0.7 * radius), radius, ground)
    if m.chance(0.7):
        _antennae(m, centre, head)
    if m.chance(0.3):
        for _, s in SIDES:
            m.limb(
                [
                    centre + [s * 0.5 * head, -0.3 * head, 0.7 * head],
                    centre + [s * 0.7 * head, -0.3 * head, 1.5 * head],
                    centre + [s * 0.1 * head, -0.3 * head, 1.9 * head],
                ],
                [0.2 * head, 0.15 * head, 0.03], "Head", f"jaw {s}",
            )  # fmt: skip


def spider(m: Model) -> None:
    """A spider or scorpion: eight legs, of which the front two pairs count as arms."""
    u = m.u
    radius, head, y = u(0.12, 0.26), u(0.08, 0.2), u(0.15, 0.45)
    centre = _body(m, y, radius, head, u(-0.05, 0.02))
    scorpion = m.chance(0.25)
    _abdomen(
        m, np.array([0, y, -0.6 * radius]), u(0.3, 0.7) * (2.0 if scorpion else 1),
        u(0.2, 0.42) * (0.3 if scorpion else 1), -0.3 if scorpion else u(-0.4, 0.2), -2.6 if scorpion else u(-0.2, 0.4),
        scorpion,
    )  # fmt: skip
    _legs(
        m, ("FrontLeg", "MidFrontLeg", "MidBackLeg", "BackLeg"), y - 0.2 * radius, (0.7 * radius, -0.7 * radius),
        radius, 0.0,
    )  # fmt: skip
    if m.chance(0.6):
        for _, s in SIDES:
            m.limb(
                [
                    centre + [s * 0.35 * head, -0.4 * head, 0.6 * head],
                    centre + [s * 0.35 * head, -1.0 * head, 1.0 * head],
                ],
                [0.25 * head, 0.05 * head], "Head", f"fang {s}",
            )  # fmt: skip


def bee(m: Model) -> None:
    """A bee, wasp, fly or butterfly: wings, six or four short legs or none, a sting or none."""
    u = m.u
    radius, head = u(0.12, 0.3), u(0.1, 0.3)
    y = 1.0
    centre = _body(m, y, radius, head, u(-0.1, 0.05))
    sting = m.chance(0.5)
    _abdomen(m, np.array([0, y, -0.6 * radius]), u(0.25, 0.8), radius * u(0.6, 1.4), u(-0.2, 1.0), u(-0.3, 0.9), sting)
    if m.chance(0.75):
        words = ("TopLeg", "MidLeg", "BottomLeg")[: m.pick(3, 3, 2)]
        low, r, long = u(0.15, 0.5), u(0.012, 0.04), u(0.1, 0.3)
        for side, s in SIDES:
            for i, word in enumerate(words):
                root = np.array([s * 0.5 * radius, y - 0.6 * radius, (0.5 - 0.5 * i) * radius])
                _leg(m, side, word, root, 0.5 - 0.5 * i, _LegShape(long, -0.03, y - 0.6 * radius - low, r))
    span, chord, lift, sweep = u(0.3, 1.0), u(0.12, 0.5), u(-0.1, 1.1), u(-0.1, 0.6)
    pairs = 2 if m.chance(0.4) else 1
    for side, s in SIDES:
        root = np.array([s * 0.4 * radius, y + 0.75 * radius, 0.1 * radius])
        m.bone(f"{side}Wing", "Hips", root)
        for pair in range(pairs):
            t, v = np.linspace(0, 1, 11)[:, None, None], np.linspace(-0.5, 0.5, 5)[None, :, None]
            direction = np.array([s * np.cos(lift), np.sin(lift), -sweep - 0.7 * pair]) * (1 - 0.3 * pair)
            grid = (
                root
                + t * span * direction
                + v * chord * np.sin(np.pi * (0.06 + 0.9 * t**0.7)) * np.array([0, -0.3, 1.0])
            )
            m.sheet(grid, f"{side}Wing", f"wing {side}", u(0.005, 0.02))
    if m.chance(0.7):
        _antennae(m, centre, head)


def crab(m: Model) -> None:
    """A crab: a wide body, claws on arms, four to eight legs."""
    u = m.u
    half = np.array([u(0.25, 0.5), u(0.12, 0.32), u(0.18, 0.36)])
    y = u(0.15, 0.4) + half[1] * 0.5
    m.bone("Hips", "", (0, y, 0))
    m.bone("Head", "Hips", (0, y + 0.25 * half[1], 0.45 * half[2]))
    m.lump((0, y, 0), half, Chain(["Hips", "Head"], [m.at("Hips"), m.at("Head")], 1.5), "body")
    stalk = u(0.0, 1.2) * half[1]
    for _, s in SIDES:
        at = np.array([s * 0.4 * half[0], y + 0.7 * half[1], 0.5 * half[2]])
        if stalk > 0.3 * half[1]:
            m.limb([at, at + [0, stalk, 0]], [0.12 * half[1]] * 2, "Head", f"eye {s}")
        m.lump(at + [0, stalk, 0], half[1] * u(0.25, 0.4), "Head", f"eye {s}", loose=True)
    r, long, claw, lift = u(0.04, 0.09), u(0.25, 0.55), u(0.12, 0.3), u(-0.3, 0.7)
    for side, s in SIDES:
        a = m.bone(f"{side}Arm", "Hips", (s * 0.8 * half[0], y, 0.5 * half[2]))
        b = m.bone(f"{side}ForeArm", f"{side}Arm", a + long * 0.5 * unit(np.array([s, lift, 0.5])))
        c = m.bone(f"{side}Hand", f"{side}ForeArm", b + long * 0.5 * unit(np.array([0.1 * s, lift, 1.0])))
        m.limb([a, b, c], [r, r * 0.9, r], [f"{side}Arm", f"{side}ForeArm"], f"arm {side}")
        m.lump(c + [0, 0, 0.5 * claw], claw * np.array([0.6, 0.4, 0.7]), f"{side}Hand", f"arm {side}")
        for i in (-1, 1):
            m.limb(
                [c + [i * 0.3 * claw, 0, 0.9 * claw], c + [i * 0.1 * claw, 0, 1.7 * claw]], [0.25 * claw, 0.08 * claw],
                f"{side}Hand", f"arm {side}",
            )  # fmt: skip
    words = ("ALeg", "BLeg", "CLeg", "DLeg")[: int(m.rng.integers(2, 5))]
    reach, rise, thick = u(0.25, 0.6), u(0.0, 0.25), u(0.02, 0.06)
    for side, s in SIDES:
        for i, word in enumerate(words):
            share = i / (len(words) - 1)
            root = np.array([s * 0.8 * half[0], y - 0.3 * half[1], half[2] * (0.2 - 0.9 * share)])
            _leg(m, side, word, root, 0.2 - 0.8 * share, _LegShape(reach, rise, 0.0, thick))


def snake(m: Model) -> None:
    """A snake or worm: flat on the ground in curves, or with its front raised."""
    u = m.u
    radius, head = u(0.025, 0.09), u(0.8, 2.0)
    if m.chance(0.5):  # raised: pelvis at the bend, tail behind
        high, lean = u(0.35, 0.8), u(-0.15, 0.15)
        points = [
            np.array([0, radius, 0.0]), np.array([0, 0.3 * high, 0.06]), np.array([0, 0.55 * high, 0.02]),
            np.array([0, 0.78 * high, lean]), np.array([0, high, lean + 0.02]),
        ]  # fmt: skip
        names = ["Hips", "Spine", "Spine1", "Neck"]
    else:
        wave, turns = u(0.0, 0.14), u(0.5, 1.5)
        positions = np.linspace(0, 0.6, 6)
        points = [np.array([wave * np.sin(6.28 * turns * z), radius, z]) for z in positions]
        names = ["Hips", "Spine", "Spine1", "Spine2", "Neck"]
    m.bones_along(names, points)
    fat = radius * (u(1.0, 2.5) if len(names) == 4 else 1.2)
    swell = np.interp(np.linspace(0, 1, len(points)), [0, 0.6, 1], [1, fat / radius, 0.9])
    m.limb(points, list(radius * swell), names, "body", blend=0.6)
    top = m.bone("Head", "Neck", points[-1])
    size = radius * head * 1.4
    m.lump(top + [0, 0.2 * size, 0.6 * size], size * np.array([u(0.8, 1.2), u(0.5, 0.9), 1.2]), "Head", "head")
    eyes(m, top + [0, 0.2 * size, 0.5 * size], np.full(3, size * 0.9), "Head")
    if m.chance(0.3):
        m.limb(
            [top + [0, 0, 1.5 * size], top + [0, 0, 2.5 * size]], [0.1 * size, 0.05 * size], "Head", "tongue",
            loose=True,
        )  # fmt: skip
    long, curve, count = u(0.4, 1.2), u(0.0, 0.2), int(m.rng.integers(3, 6))
    back = [points[0]]
    for i in range(count):
        back.append(np.array([curve * np.sin(2.2 * (i + 1)), radius, points[0][2] - long * (i + 1) / count]))
    joints = [f"Tail{i + 1}" for i in range(count)]
    m.bones_along(joints, back, "Hips")
    m.limb(back, list(np.linspace(radius, radius * u(0.15, 0.8), count + 1)), joints, "body", blend=0.6)
