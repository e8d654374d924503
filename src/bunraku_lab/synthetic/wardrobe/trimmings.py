"""Trimmings of wardrobe characters: ribbons, scarves, ears, tails, and the little things that swing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bunraku_lab.synthetic.figures import Figure
from bunraku_lab.synthetic.surfaces import curve_through, strand, unit
from bunraku_lab.synthetic.wardrobe.chains import Hang, add_chains
from bunraku_lab.synthetic.wardrobe.hair import HAIR, Scalp
from bunraku_lab.synthetic.wardrobe.model import SOLID, Costume

TRIM, TAIL = 9, 10


@dataclass(frozen=True)
class Bow:
    """A bow of two loops, with two ends that hang on chains.

    Args:
        name: Of its chains.
        bone: What it is tied to.
        center: Its knot [m], shape (3,).
        outward: Away from the body, shape (3,).
        size: Length of a loop [m].
        ends: Length of the ends [m].
        meets: Groups that the ends collide with.
    """

    name: str
    bone: str
    center: np.ndarray
    outward: np.ndarray
    size: float
    ends: float
    meets: int


def add_bow(costume: Costume, figure: Figure, bow: Bow) -> None:
    """Add a bow to what a body wears."""
    up = np.array([0, 1.0, 0])
    outward, center, size, ends = unit(bow.outward), bow.center, bow.size, bow.ends
    side = unit(np.cross(up, outward))
    holder, position = costume.bone_index(bow.bone), np.linspace(0, 1, max(round(8 * costume.fine), 6))
    sides = max(round(9 * costume.fine), 6)
    for sign in (1, -1):
        curve = (
            center
            + position[:, None] * size * (sign * side + 0.28 * up + 0.1 * outward)
            + 0.1 * size * np.sin(np.pi * position)[:, None] * outward
        )
        width = size * np.interp(position, [0, 0.35, 0.8, 1], [0.1, 0.36, 0.42, 0.2])
        points, faces, _ = strand(curve, outward, width, 0.35 * width + 0.004, sides)
        costume.add(points, faces, holder, 1, "trim")
        if ends <= 0:
            continue
        links = 1 if ends < 0.09 * figure.height else 2  # short ends of several links are as stiff as light to simulate
        low = center + np.array([0, -ends, 0]) + 0.42 * ends * sign * side + 0.12 * ends * outward
        path = np.array([
            center + 0.02 * size * outward,
            0.6 * center + 0.4 * low + 0.05 * ends * sign * side + 0.06 * ends * outward, low,
        ])  # fmt: skip
        hang = Hang(
            mass=0.3, damping=(0.95, 0.99), out=60, inward=20, side=45, twist=0, spring=0.03, thick=0.014, box=False,
            group=TRIM, meets=bow.meets,
        )  # fmt: skip
        label = f"{bow.name}{'左' if sign > 0 else '右'}"
        chains = add_chains(
            costume, [label], curve_through(path, links + 1)[None], outward[None], holder, hang, cross=False
        )
        t = np.linspace(0, 1, max(round(9 * costume.fine), 7))
        points, faces, at = strand(
            curve_through(path, len(t)), outward, size * np.interp(t, [0, 0.3, 1], [0.08, 0.2, 0.3]), 0.004, sides
        )
        costume.add(points, faces, *chains.weights(at / (len(t) - 1) * links), "trim")
    t = np.linspace(-1, 1, 5)
    points, faces, _ = strand(
        center + t[:, None] * 0.16 * size * up + 0.08 * size * outward, outward, 0.14 * size, 0.12 * size, sides
    )
    costume.add(points, faces, holder, 1, "trim")


def add_scarf(costume: Costume, figure: Figure, rng: np.random.Generator, *, colors: tuple[str, str]) -> np.ndarray:
    """A scarf around the neck whose ends hang down the back or the front; returns the points of its ring."""
    u, h = rng.uniform, figure.height
    neck = figure.at("neck")
    height = float(neck[1] + 0.012 * h)
    around = max(round(22 * costume.fine), 14)
    angles = np.arange(around) * 2 * np.pi / around
    center = np.array([0.0, 0.5 * (neck[2] + figure.at("head")[2])])
    fat = float(u(0.014, 0.022)) * h
    inner = figure.rim(height + 0.01 * h, angles, center=center, band=0.012 * h)
    inner = np.minimum(inner, 1.4 * np.median(inner)) + 0.55 * fat
    loop = np.stack(
        [center[0] + inner * np.sin(angles), height + 0.012 * h * -np.cos(angles), center[1] + inner * np.cos(angles)],
        axis=1,
    )
    sides = max(round(10 * costume.fine), 6)
    turn = np.arange(sides) * 2 * np.pi / sides
    out = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
    rings = loop[:, None] + fat * (
        np.cos(turn)[None, :, None] * out[:, None] + 1.25 * np.sin(turn)[None, :, None] * np.array([0, 1.0, 0])
    )
    index = np.arange(around * sides).reshape(around, sides)
    index = np.concatenate([index, index[:1]])
    index = np.concatenate([index, index[:, :1]], axis=1)
    quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1).reshape(-1, 4)
    chest = costume.bone_index("上半身2")
    faces = np.concatenate([quads[:, [0, 2, 1]], quads[:, [0, 3, 2]]])
    costume.add(rings.reshape(-1, 3), faces, chest, 1, colors[0])
    behind = rng.random() < 0.6
    base = np.pi if behind else 0.0
    for number, lean in enumerate((0.35, -0.3)[: int(rng.integers(1, 3))]):
        angle = base + lean
        direction = np.array([np.sin(angle), 0, np.cos(angle)])
        start = loop[round(angle / (2 * np.pi) * around) % around] + direction * fat * 0.6
        length = float(u(0.16, 0.34)) * h
        heights = np.linspace(start[1] - 0.1 * length, start[1] - length, 5)
        far, positions = float((start - [center[0], 0, center[1]]) @ direction), [start]
        for y in heights:
            body = float(figure.profile(float(y), np.array([angle]), center=center, band=0.02 * h)[0])
            far = max(far, min(body, far + 0.05 * h) + 0.014 * h)
            positions.append(np.array([center[0] + far * direction[0], y, center[1] + far * direction[2]]))
        links = int(np.clip(round(length / (0.065 * h)), 3, 5))
        path = np.array(positions)
        hang = Hang(
            mass=0.5, damping=(0.85, 0.95), out=70, inward=25, side=45, twist=0, spring=float(u(0.03, 0.1)),
            thick=0.008 * h, box=False, group=TRIM,
            meets=SOLID["trunk"],
        )  # fmt: skip
        chains = add_chains(
            costume, [f"マフラー{number}"], curve_through(path, links + 1)[None], direction[None], chest, hang,
            cross=False,
        )  # fmt: skip
        t = np.linspace(0, 1, max(round(14 * costume.fine), 9))
        points, faces, at = strand(
            curve_through(path, len(t)), direction, fat * np.interp(t, [0, 0.2, 1], [1.0, 1.5, 1.7]), 0.32 * fat, sides
        )
        bones, shares = chains.weights(at / (len(t) - 1) * links)
        low = at[faces].max(axis=1) / (len(t) - 1)
        striped = (low > 0.72) & (low < 0.9)
        costume.add(points, faces, bones, shares, np.where(striped, colors[1], colors[0]))
    costume.words.append("scarf")
    return np.asarray(rings.reshape(-1, 3))


def add_ears(costume: Costume, scalp: Scalp, rng: np.random.Generator, *, kind: str, colors: tuple[str, str]) -> None:
    """Ears on top of the head: "cat", "fox" or "rabbit"; they spring back when they are swung."""
    u, size = rng.uniform, float(scalp.half[0])
    turn, fall = {"cat": (1.45, 0.62), "fox": (1.45, 0.6), "rabbit": (1.5, 0.36)}[kind]
    tall = size * {"cat": u(0.95, 1.2), "fox": u(1.15, 1.5), "rabbit": u(1.5, 2.4)}[kind]
    wide = size * {"cat": u(0.42, 0.52), "fox": u(0.38, 0.48), "rabbit": u(0.2, 0.26)}[kind]
    shape = {"cat": [1.0, 0.85, 0.45, 0.05], "fox": [1.0, 0.92, 0.5, 0.05], "rabbit": [0.65, 1.0, 0.9, 0.2]}[kind]
    bend, links = float(u(-0.1, 0.3)), 3 if kind == "rabbit" else 2
    for mark, side in (("左", 1), ("右", -1)):
        root = scalp.at(side * turn, fall, -0.12 * size)
        away = unit(root - scalp.center)
        tip = root + tall * unit(np.array([side * 0.3, 1.0, -0.1])) + bend * tall * np.array([side * 0.3, -0.2, 0.1])
        path = np.array([root, 0.5 * (root + tip) + 0.06 * tall * away, tip])
        ahead = unit(np.array([side * 0.25, 0.0, 1.0]))
        hang = Hang(
            mass=0.15, damping=(0.95, 0.99), out=25, inward=25, side=25, twist=0, spring=float(u(0.5, 0.9)),
            thick=0.3 * wide,
            box=False, group=TRIM, meets=0,
        )  # fmt: skip
        nodes = curve_through(path, links + 1)
        chains = add_chains(
            costume, [f"{mark}耳"], nodes[None], -ahead[None], costume.bone_index("頭"), hang, cross=False
        )
        t = np.linspace(0, 1, max(round(9 * costume.fine), 6))
        width = wide * np.interp(t, [0, 0.3, 0.7, 1], shape)
        curve, sides = curve_through(path, len(t)), max(round(10 * costume.fine), 6)
        points, faces, at = strand(curve, ahead, width, 0.35 * width + 0.002, sides)
        costume.add(points, faces, *chains.weights(at / (len(t) - 1) * links), colors[0])
        points, faces, at = strand(
            curve + ahead * (0.2 * width + 0.002)[:, None], ahead, 0.62 * width, 0.2 * width + 0.001, sides
        )
        costume.add(points, faces, *chains.weights(at / (len(t) - 1) * links), colors[1])
    costume.words.append(f"{kind} ears")


def add_tail(
    costume: Costume, figure: Figure, rng: np.random.Generator, *, kind: str, colors: tuple[str, str], lift: float
) -> None:
    """A tail from the end of the spine: "cat", "fox" or "wolf".

    Args:
        costume: What it is added to.
        figure: The body.
        rng: Random numbers.
        kind: Its kind.
        colors: Materials of the fur and of its tip.
        lift: Height of its root over the hip joints [m], such as above a skirt.
    """
    u, h = rng.uniform, figure.height
    hips = figure.at("pelvis")
    height = float(figure.at("left_hip")[1] + max(lift, 0.015 * h))
    back = float(figure.rim(height, np.array([np.pi]), center=hips[[0, 2]], band=0.02 * h)[0])
    root = np.array([0, height, hips[2] - back + 0.012 * h])
    long = float(u(0.3, 0.48)) * h
    fat = h * {"cat": u(0.011, 0.016), "fox": u(0.04, 0.06), "wolf": u(0.028, 0.04)}[kind]
    low = max(height - 0.62 * long, 0.1 * h)
    clear = float(
        figure.rim(0.5 * (height + low), np.array([np.pi]), center=hips[[0, 2]], band=0.5 * (height - low))[0]
    )
    z = hips[2] - max(clear, back) - 1.3 * fat
    out = min(z, root[2] - 0.3 * long)
    path = np.array([
        root, [0, height + 0.02 * h, 0.5 * (root[2] + out)], [0, height - 0.18 * long, out], [0, low, out - 0.1 * long],
        [0, low + 0.16 * long, out - 0.38 * long],
    ])  # fmt: skip
    links = 6
    hang = Hang(
        mass=0.6, damping=(0.85, 0.95), out=28, inward=28, side=28, twist=0, spring=float(u(0.8, 2.0)), thick=0.8 * fat,
        box=False, group=TAIL,
        meets=SOLID["legs"],
    )  # fmt: skip
    chains = add_chains(
        costume, ["尻尾"], curve_through(path, links + 1)[None], np.array([[0, 0, -1.0]]), costume.bone_index("下半身"),
        hang, cross=False,
    )  # fmt: skip
    t = np.linspace(0, 1, max(round(24 * costume.fine), 14))
    shape = {"cat": [0.9, 1, 1, 1, 0.15], "fox": [0.3, 0.65, 1.0, 0.95, 0.08], "wolf": [0.4, 0.85, 1.05, 0.8, 0.08]}[
        kind
    ]
    width = fat * np.interp(t, [0, 0.2, 0.55, 0.8, 1], shape)
    points, faces, at = strand(
        curve_through(path, len(t)), np.array([0, 0.4, -1.0]), width, width, max(round(11 * costume.fine), 7)
    )
    bones, shares = chains.weights(at / (len(t) - 1) * links)
    tip = at[faces].max(axis=1) / (len(t) - 1) > float(u(0.72, 0.85))
    costume.add(points, faces, bones, shares, np.where(tip, colors[1], colors[0]))
    costume.words.append(f"{kind} tail")


CHARM = 11
_DOWN = np.array([0, -1.0, 0])


def add_little_pieces(costume: Costume, figure: Figure, scalp: Scalp, rng: np.random.Generator, hair: str) -> None:
    """Add some of them, more where little else of the character is apparel."""
    likely = 0.3 if costume.quiet else 0.22
    before = len(costume.bodies)
    makers: list[Callable[[], None]] = [
        lambda: _tie(costume, figure, rng), lambda: _tassels(costume, figure, rng), lambda: _bell(costume, figure, rng),
        lambda: _on_the_head(costume, scalp, rng),
    ]  # fmt: skip
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
        costume, "ネクタイ", "上半身2",
        _Strip(positions, np.array([0, 0, 1.0]), size * np.array([0.5, 0.7, 1.0, 1.2, 0.1]), 0.003 * h),
        int(rng.integers(1, 4)), _small(0.05, 0.008, meets=SOLID["trunk"]), "trim", float(rng.uniform(0.1, 0.5)),
    )  # fmt: skip
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
            costume, f"飾り{number}", "下半身", _Strip(nodes, out, 0.007 * h, 0.005 * h), 1, _small(0.04, 0.006 * h),
            "trim",
        )  # fmt: skip
    costume.words.append("tassels")


def _bell(costume: Costume, figure: Figure, rng: np.random.Generator) -> None:
    """A bell at the collar."""
    h = figure.height
    root = _front(figure, float(figure.at("neck")[1] - 0.02 * h)) + [0, 0, 0.01 * h]
    length = float(rng.uniform(0.03, 0.05)) * h
    nodes = root + np.linspace(0, 1, 3)[:, None] * length * _DOWN
    _hung(
        costume, "鈴", "上半身2",
        _Strip(nodes, np.array([0, 0, 1.0]), 0.014 * h * np.array([0.2, 1.0, 1.0, 0.3]), 0.012 * h), 1,
        _small(0.12, 0.01 * h), "hair tie",
    )  # fmt: skip
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
            costume, f"{mark}髪飾り", "頭", _Strip(positions, out, 0.1 * size * np.array([0.4, 1.0, 0.6]), 0.04 * size),
            1, _small(0.02 if rings else 0.3, 0.06 * size), "trim",
        )  # fmt: skip
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
            costume, f"襟髪{number}", "頭", _Strip(np.concatenate([top, drops]), out, wide, 0.35 * scalp.thick), links,
            _small(0.05, 0.01, HAIR, SOLID["head"] | SOLID["trunk"] if links > 1 else 0), "hair", begin,
        )  # fmt: skip
    costume.words.append("locks")
