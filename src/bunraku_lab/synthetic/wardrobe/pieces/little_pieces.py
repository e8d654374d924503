"""Little things that swing: locks of hair with tips, ties, tassels, bells, ear-rings, pins. Real avatars have dozens,
most of them stiff.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bunraku_lab.synthetic.people.figure import Figure
from bunraku_lab.synthetic.surfaces import curve_through, strand, unit
from bunraku_lab.synthetic.wardrobe.kit.chains import Hang, add_chains
from bunraku_lab.synthetic.wardrobe.kit.model import Costume
from bunraku_lab.synthetic.wardrobe.kit.skeleton import SOLID
from bunraku_lab.synthetic.wardrobe.pieces.hair import HAIR, Scalp

__all__ = ["add_little_pieces"]

CHARM = 11
_DOWN = np.array([0, -1.0, 0])


def add_little_pieces(costume: Costume, figure: Figure, scalp: Scalp, rng: np.random.Generator, hair: str) -> None:
    """Add some of them, more where little else of the character is apparel.

    Args:
        costume: What they are added to.
        figure: The body and what it wears.
        scalp: The dome that hair lies on.
        rng: Random numbers.
        hair: Kind of the hair.
    """
    likely = 0.3 if costume.quiet else 0.22
    before = len(costume.bodies)
    makers: list[Callable[[], None]] = [
        lambda: _tie(costume, figure, rng),
        lambda: _tassels(costume, figure, rng),
        lambda: _bell(costume, figure, rng),
        lambda: _on_the_head(costume, scalp, rng),
    ]
    if hair in ("short", "bob"):
        makers.append(lambda: _locks(costume, figure, scalp, rng))
    for make in makers:
        if rng.random() < likely:
            make()
    if costume.quiet and len(costume.bodies) == before:
        _bell(costume, figure, rng)


@dataclass(frozen=True)
class _Strip:
    """A strand along places (P, 3), its flat side outward (3,); widths along it, and how thick it is [m]."""

    positions: np.ndarray
    outward: np.ndarray
    wide: np.ndarray | float
    thick: float


def _hung(
    costume: Costume, name: str, bone: str, strip: _Strip, links: int, hang: Hang, material: str, begin: float = 0.0
) -> None:
    """A strand on a chain of so many links, which begins at a share of its length."""
    whole, outward = curve_through(strip.positions, 33), strip.outward
    holder = costume.bone_index(bone)
    nodes = curve_through(whole[round(32 * begin) :], links + 1)
    chains = add_chains(costume, [name], nodes[None], unit(outward)[None], holder, hang, cross=False)
    t = np.linspace(0, 1, max(round(8 * costume.fine), 6))
    width = np.interp(t, np.linspace(0, 1, np.size(strip.wide)), np.atleast_1d(strip.wide))
    points, faces, at = strand(
        curve_through(whole, len(t)), outward, width, strip.thick, max(round(7 * costume.fine), 5)
    )
    costume.add(points, faces, *chains.weights((at / (len(t) - 1) - begin) / (1 - begin) * links), material)


def _small(spring: float, thick: float, group: int = CHARM, meets: int = 0) -> Hang:
    return Hang(
        mass=0.2, damping=(0.9, 0.97), out=50, inward=15, side=35, twist=0, spring=spring, thick=thick, box=False,
        group=group, meets=meets,
    )  # fmt: skip


def _front(figure: Figure, y: float, turn: float = 0.0) -> np.ndarray:
    """The point of the body at a height, in a direction about the vertical."""
    z = float(figure.profile(y, np.array([turn]), center=np.zeros(2), band=0.015 * figure.height)[0])
    return np.array([z * np.sin(turn), y, z * np.cos(turn)])


def _tie(costume: Costume, figure: Figure, rng: np.random.Generator) -> None:
    """A tie on the chest; its knot, or more of it, does not move."""
    h = figure.height
    top = figure.at("neck")[1] - 0.03 * h
    length = float(rng.uniform(0.08, 0.2)) * h
    positions = np.stack([_front(figure, top - share * length) for share in (0.0, 0.35, 0.7, 1.0)])
    positions[:, 2] = np.maximum.accumulate(positions[:, 2]) + 0.012 * h
    size = 0.016 * h * float(rng.uniform(0.7, 1.4))
    _hung(
        costume,
        "ネクタイ",
        "上半身2",
        _Strip(positions, np.array([0, 0, 1.0]), size * np.array([0.5, 0.7, 1.0, 1.2, 0.1]), 0.003 * h),
        int(rng.integers(1, 4)),
        _small(0.05, 0.008, meets=SOLID["trunk"]),
        "trim",
        float(rng.uniform(0.1, 0.5)),
    )
    costume.words.append("tie")


def _tassels(costume: Costume, figure: Figure, rng: np.random.Generator) -> None:
    """Small ends around the waist."""
    h = figure.height
    hips = figure.at("pelvis")
    y = float(hips[1] + rng.uniform(-0.01, 0.03) * h)
    count, length = int(rng.integers(2, 9)), float(rng.uniform(0.04, 0.11)) * h
    for number, turn in enumerate(np.linspace(0, 2 * np.pi, count, endpoint=False) + rng.uniform(0, 1)):
        out = np.array([np.sin(turn), 0, np.cos(turn)])
        far = float(figure.rim(y, np.array([turn]), center=hips[[0, 2]], band=0.02 * h)[0]) + 0.014 * h
        root = np.array([hips[0], y, hips[2]]) + far * out
        nodes = root + np.linspace(0, 1, 4)[:, None] * length * (_DOWN + 0.12 * out)
        _hung(
            costume,
            f"飾り{number}",
            "下半身",
            _Strip(nodes, out, 0.007 * h, 0.005 * h),
            1,
            _small(0.04, 0.006 * h),
            "trim",
        )
    costume.words.append("tassels")


def _bell(costume: Costume, figure: Figure, rng: np.random.Generator) -> None:
    """A bell at the collar."""
    h = figure.height
    root = _front(figure, float(figure.at("neck")[1] - 0.02 * h)) + [0, 0, 0.01 * h]
    length = float(rng.uniform(0.03, 0.05)) * h
    nodes = root + np.linspace(0, 1, 3)[:, None] * length * _DOWN
    _hung(
        costume,
        "鈴",
        "上半身2",
        _Strip(nodes, np.array([0, 0, 1.0]), 0.014 * h * np.array([0.2, 1.0, 1.0, 0.3]), 0.012 * h),
        1,
        _small(0.12, 0.01 * h),
        "hair tie",
    )
    costume.words.append("bell")


def _on_the_head(costume: Costume, scalp: Scalp, rng: np.random.Generator) -> None:
    """A pair of stiff things that stand on the hair, or of ear-rings."""
    size = float(scalp.half[0])
    rings = rng.random() < 0.4
    fall = 1.75 if rings else float(rng.uniform(0.5, 1.1))
    length, turn = size * float(rng.uniform(0.25, 0.5)), float(rng.uniform(1.2, 1.9))
    for mark, side in (("左", 1), ("右", -1)):
        root = scalp.at(side * turn, fall, 0.1 * scalp.thick)
        away = unit(root - scalp.center)
        direction = _DOWN + 0.2 * away if rings else unit(away + 0.4 * _DOWN)
        positions = root + np.linspace(0, 1, 3)[:, None] * length * direction
        out = away if rings else unit(np.cross(direction, [0, 0, 1.0]))
        _hung(
            costume,
            f"{mark}髪飾り",
            "頭",
            _Strip(positions, out, 0.1 * size * np.array([0.4, 1.0, 0.6]), 0.04 * size),
            1,
            _small(0.02 if rings else 0.3, 0.06 * size),
            "trim",
        )
    costume.words.append("ear-rings" if rings else "hair pins")


def _locks(costume: Costume, figure: Figure, scalp: Scalp, rng: np.random.Generator) -> None:
    """Locks from the dome around the back of the head, of which the tips swing."""
    count = int(rng.integers(5, 16))
    length, begin = float(rng.uniform(0.7, 2.6)) * float(scalp.half[1]), float(rng.uniform(0.2, 0.7))
    links = 1 if (1 - begin) * length < 0.08 * figure.height else 2
    for number, turn in enumerate(np.linspace(np.pi - 1.7, np.pi + 1.7, count)):
        top = scalp.at(turn, np.array([0.9, 1.3, 1.7]), 0.5 * scalp.thick)
        out = np.array([np.sin(turn), 0, np.cos(turn)])
        last = top[-1] + 0.1 * scalp.half[0] * out
        drops = np.stack([last + length * share * (_DOWN + 0.15 * out) for share in (0.3, 0.65, 1.0)])
        wide = 2.4 * scalp.half[0] / count * np.array([0.5, 1.0, 1.0, 0.6, 0.05])
        _hung(
            costume,
            f"襟髪{number}",
            "頭",
            _Strip(np.concatenate([top, drops]), out, wide, 0.35 * scalp.thick),
            links,
            _small(0.05, 0.01, HAIR, SOLID["head"] | SOLID["trunk"] if links > 1 else 0),
            "hair",
            begin,
        )
    costume.words.append("locks")
