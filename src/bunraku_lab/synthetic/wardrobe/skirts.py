"""Cloth that hangs from chains: skirts from the waist down, and coats, capes and wide sleeves over the clothes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bunraku_lab.synthetic.figures import Figure
from bunraku_lab.synthetic.surfaces import sheet_faces, unit
from bunraku_lab.synthetic.wardrobe.chains import Hang, add_chains, band_start
from bunraku_lab.synthetic.wardrobe.clothes import collar_field
from bunraku_lab.synthetic.wardrobe.model import SOLID, Costume, body_weights

SKIRT = 5
AROUND = 48  # directions of a ring


@dataclass(frozen=True, eq=False)
class Drape:
    """Rings that cloth hangs in, about a vertical axis.

    Args:
        heights: Of the rings, from the top [m], shape (H,).
        radii: In each direction [m], shape (H, A).
        angles: The directions: 0 is +Z, a quarter turn +X [rad], shape (A,).
        center: X and Z of the axis, shape (2,).
    """

    heights: np.ndarray
    radii: np.ndarray
    angles: np.ndarray
    center: np.ndarray

    def points(
        self, rows: np.ndarray, angles: np.ndarray, swell: np.ndarray | float = 1.0, lift: float = 0.0
    ) -> np.ndarray:
        """Points of the drape, shape (len(rows), len(angles), 3).

        Args:
            rows: Places from 0, the top, to 1, the hem.
            angles: Directions [rad].
            swell: Factor on the radii, such as that of pleats.
            lift: Added to the radii [m].
        """
        at = np.asarray(rows) * (len(self.heights) - 1)
        low = np.minimum(at.astype(np.int64), len(self.heights) - 2)
        share = (at - low)[:, None]
        radii = (1 - share) * self.radii[low] + share * self.radii[low + 1]
        turn = np.asarray(angles) % (2 * np.pi)
        own = self.angles % (2 * np.pi)
        order = np.argsort(own)
        around = np.stack([np.interp(turn, own[order], row[order], period=2 * np.pi) for row in radii]) * swell + lift
        heights = np.interp(at, np.arange(len(self.heights)), self.heights)[:, None]
        return np.stack(
            [
                self.center[0] + around * np.sin(angles),
                np.broadcast_to(heights, around.shape),
                self.center[1] + around * np.cos(angles),
            ],
            axis=-1,
        )


@dataclass(frozen=True)
class Outline:
    """How rings of cloth widen towards the hem.

    Args:
        flare: How much farther out the hem is than the body, over the length.
        bow: 1 widens evenly, less widens at once below the top, more towards the hem.
        clear: Distance from the body [m].
    """

    flare: float
    bow: float
    clear: float


def hanging_rings(
    figure: Figure, top: float, hem: float, outline: Outline, *,
    rings: int = 14, center: np.ndarray | None = None, convex: bool = True, points: np.ndarray | None = None,
) -> Drape:  # fmt: skip
    """Rings about the body from one height down to another that never narrow, and widen by the flare.

    Args:
        figure: The body.
        top, hem: Heights [m].
        outline: How they widen.
        rings: How many.
        center: X and Z of the axis; None is the middle of the hips.
        convex: Whether the cloth is drawn straight over hollows, as where it goes all around.
        points: What it keeps clear of, instead of head, trunk and legs.
    """
    axis = figure.at("pelvis")[[0, 2]] if center is None else center
    angles = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    heights = np.linspace(top, hem, rings)
    band = max(0.7 * (top - hem) / rings, 0.02 * figure.height)
    if convex:
        body = np.stack(
            [figure.rim(float(height), angles, center=axis, band=band, points=points) for height in heights]
        )
        first = figure.profile(top, angles, center=axis, band=0.02 * figure.height, spread=0.2, points=points)
        body[0] = np.minimum(np.where(first > 0, first, body[0]) + 0.004 * figure.height, body[0])
    else:
        body = np.stack(
            [figure.profile(float(height), angles, center=axis, band=band, points=points) for height in heights]
        )
    held = np.maximum.accumulate(np.maximum(body, 0.02), axis=0)
    share = np.linspace(0, 1, rings)[:, None]
    spread = held[:1] + outline.flare * (top - hem) * share**outline.bow
    return Drape(heights, np.maximum(held, spread) + outline.clear * np.minimum(0.3 + 4 * share, 1), angles, axis)


def add_skirt(
    costume: Costume, figure: Figure, rng: np.random.Generator, *, kind: str, top: float, colors: tuple[str, str],
    what: str = "skirt",
) -> np.ndarray:  # fmt: skip
    """A skirt of a kind: "short", "long", "pleated" or "layered".

    Args:
        costume: What it is added to.
        figure: The body.
        rng: Random numbers.
        kind: Its kind.
        top: Height of its waist [m].
        colors: Materials of cloth and trimming.
        what: What it is called: a dress has no band at its waist.

    Returns:
        The points of its cloth [m], shape (V, 3).
    """
    u, h = rng.uniform, figure.height
    hip, knee, ankle = (float(figure.at(f"left_{part}")[1]) for part in ("hip", "knee", "ankle"))
    down = {"short": u(0.45, 0.8), "pleated": u(0.45, 0.95), "layered": u(0.7, 1.6), "long": u(1.25, 1.85)}[kind]
    hem = float(np.interp(down, [0, 1, 2], [hip, knee, ankle]))
    flare = {"short": u(0.1, 0.5), "pleated": u(0.15, 0.5), "layered": u(0.2, 0.55), "long": u(0.05, 0.32)}[kind]
    drape = hanging_rings(figure, top, hem, Outline(flare, float(u(0.6, 1.2)), 0.016 * h))
    length = top - hem
    count = 12 if length > 0.3 * h or kind == "layered" else 10
    begin = band_start(costume, "スカート")
    links = int(np.clip(round((1 - begin) * length / (0.075 * h)), 1 if begin else 2, 7))
    turns = np.arange(count) * 2 * np.pi / count
    nodes = drape.points(np.linspace(begin, 1, links + 1), turns).transpose(1, 0, 2)
    outward = np.stack([np.sin(turns), np.zeros(count), np.cos(turns)], axis=1)
    hang = Hang(
        mass=1.0, damping=(0.85, 0.95), out=70, inward=25, side=25, twist=0, spring=float(u(0.1, 0.4)), thick=0.007 * h,
        box=True,
        group=SKIRT, meets=SOLID["legs"], give=0.2,
    )  # fmt: skip
    waist = costume.bone_index("下半身")
    chains = add_chains(
        costume, [f"スカート{number}" for number in range(count)], nodes, outward, waist, hang, closed=True
    )
    folds = int(rng.integers(2, 4)) * count if kind == "pleated" else int(rng.integers(1, 3)) * count
    deep = float(u(0.045, 0.08)) if kind == "pleated" else float(rng.choice([0.0, u(0.01, 0.05)]))
    layers = int(rng.integers(2, 4)) if kind == "layered" else 1
    columns = max(round(costume.fine * 4) * count, 3 * count, 2 * folds if kind == "pleated" else 0)
    rows = max(round(costume.fine * 4 * links), 2 * links) + 1
    for layer in range(layers):
        end = 1 - layer * 0.72 / layers
        share = np.linspace(0, end, rows)
        angles = np.arange(columns) * 2 * np.pi / columns
        wave = _zigzag(angles * folds / (2 * np.pi)) if kind == "pleated" else np.cos(angles * folds)
        # Layers above stand off; folds grow towards the hem, outwards, so that the body stays inside.
        swell = 1 + deep * np.minimum(2.2 * share, 1)[:, None] * (1 + wave)[None]
        points = drape.points(share, angles, swell, layer * 0.012 * h)
        along, across = (
            np.repeat((share - begin) / (1 - begin) * links, columns),
            np.tile(angles / (2 * np.pi) * count, rows),
        )
        material = colors[0] if layer % 2 == 0 else colors[1]
        faces = sheet_faces(rows, columns, wrap=True)
        bones, shares = chains.weights(along, across)
        border = layer == 0 and rng.random() < 0.5 and faces.max(axis=1) >= (rows - max(2, rows // 8)) * columns
        costume.add(
            points.reshape(-1, 3), faces, bones, shares,
            np.where(border, colors[1], material) if layer == 0 else material,
        )  # fmt: skip
        if layer == 0:
            outer = points.reshape(-1, 3)
    if what == "skirt":
        _waistband(costume, drape, columns, waist, colors[1], h)
    costume.words.append(f"{kind} {what}")
    return outer


def _waistband(costume: Costume, drape: Drape, columns: int, bone: int, material: str, height: float) -> None:
    angles = np.arange(columns) * 2 * np.pi / columns
    rings = drape.points(np.zeros(4), angles, 1.0, 0.004 * height)
    rings[[0, 3]] -= 0.003 * height * np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
    rings[:, :, 1] += np.array([0.018, 0.015, -0.012, -0.015])[:, None] * height
    costume.add(rings.reshape(-1, 3), sheet_faces(4, columns, wrap=True), bone, 1, material)


def _zigzag(turns: np.ndarray) -> np.ndarray:
    """A wave of knife pleats between -1 and 1, one a turn."""
    phase = turns % 1
    return np.asarray(np.where(phase < 0.7, phase / 0.7, (1 - phase) / 0.3) * 2 - 1)


COAT, CAPE, SLEEVE = 6, 7, 8


@dataclass(frozen=True)
class _Cloth:
    """A sheet of cloth."""

    span: np.ndarray
    colors: tuple[str, str]
    wave: float
    lining: float


def _sheet(
    costume: Costume, drape: Drape, cloth: _Cloth, names: str, bone: int, hang: Hang, links: int, count: int
) -> np.ndarray:
    """An open sheet on chains, with a lining inside; returns its points."""
    span, colors, wave, lining = cloth.span, cloth.colors, cloth.wave, cloth.lining
    begin = band_start(costume, names)
    links = max(round((1 - begin) * links), 1)
    columns, rows = (
        max(round(4 * (count - 1) * costume.fine), 2 * count) + 1,
        max(round(4 * links * costume.fine), 2 * links) + 1,
    )

    def grid(share: np.ndarray, across: np.ndarray, lift: float = 0.0, fold: float = 0.0) -> np.ndarray:
        out = []
        for row in share:
            ends = span[0] + (span[1] - span[0]) * min(3.0 * row, 1)
            angles = ends[0] + (ends[1] - ends[0]) * across
            swell = 1 + fold * min(2 * row, 1) * (1 + np.cos(across * (count - 1) * 2 * np.pi))
            out.append(drape.points(np.array([row]), angles, swell[None], lift)[0])
        return np.stack(out)

    nodes = grid(np.linspace(begin, 1, links + 1), np.linspace(0, 1, count)).transpose(1, 0, 2)
    middle = 0.5 * (nodes[:, 0] + nodes[:, -1]) - [drape.center[0], 0, drape.center[1]]
    chains = add_chains(
        costume, [f"{names}{number}" for number in range(count)], nodes, unit(middle * [1, 0, 1]), bone, hang
    )
    share, across = np.linspace(0, 1, rows), np.linspace(0, 1, columns)
    bones, shares = chains.weights(
        np.repeat((share - begin) / (1 - begin) * links, columns), np.tile(across * (count - 1), rows)
    )
    outer, inner = grid(share, across, 0.0, wave), grid(share, across, -lining, wave)
    inner[:, [0, -1]], inner[-1] = outer[:, [0, -1]], outer[-1]
    faces = sheet_faces(rows, columns)
    costume.add(outer.reshape(-1, 3), faces, bones, shares, colors[0])
    costume.add(inner.reshape(-1, 3), faces[:, ::-1], bones, shares, colors[1])
    return outer.reshape(-1, 3)


def add_coat(
    costume: Costume, figure: Figure, rng: np.random.Generator, *, waist: float, colors: tuple[str, str], thick: float
) -> np.ndarray:
    """A long coat whose skirts are open in front; returns its points but those of the sleeves."""
    u, h = rng.uniform, figure.height
    skin = figure.skin
    rise = (
        float(np.interp(waist, [figure.at("left_hip")[1], figure.at("spine1")[1], figure.at("spine3")[1]], [2, 3, 4]))
        - 0.12
    )
    jacket = skin.above(skin.rise - rise)
    jacket = jacket.above(u(2.5, 2.95) - jacket.reach)
    jacket = jacket.above(collar_field(jacket, 5.15))
    swell = thick * (1.0 + 0.6 * np.clip(jacket.reach - 1.8, 0, 1))
    bones, shares = body_weights(costume, jacket.weights)
    costume.add(jacket.puffed(swell).points, jacket.faces, bones, shares, colors[0])
    knee, ankle = figure.at("left_knee")[1], figure.at("left_ankle")[1]
    hem = float(np.interp(u(0.2, 1.6), [0, 1, 2], [0.5 * (figure.at("left_hip")[1] + knee), knee, ankle]))
    drape = hanging_rings(figure, waist, hem, Outline(float(u(0.1, 0.35)), float(u(0.8, 1.2)), 0.018 * h))
    gap = float(u(0.12, 0.4))
    wider = gap + float(u(0.05, 0.35))
    span = np.array([[gap, 2 * np.pi - gap], [wider, 2 * np.pi - wider]])
    links = int(np.clip(round((waist - hem) / (0.08 * h)), 3, 5))
    hang = Hang(
        mass=1.2, damping=(0.88, 0.96), out=60, inward=20, side=20, twist=0, spring=float(u(0.3, 0.9)), thick=0.008 * h,
        box=True, group=COAT,
        meets=SOLID["legs"], give=0.15,
    )  # fmt: skip
    count = int(rng.integers(8, 11))
    cloth = _Cloth(span, colors, float(u(0, 0.03)), 0.004 * h)
    points = _sheet(costume, drape, cloth, "コート", costume.bone_index("下半身"), hang, links, count)
    costume.words.append("long coat")
    return np.concatenate([points, jacket.puffed(swell).points[jacket.reach < 0.8]])


def add_cape(costume: Costume, figure: Figure, rng: np.random.Generator, *, colors: tuple[str, str]) -> np.ndarray:
    """A cape from the neck down the back; returns its points."""
    u, h = rng.uniform, figure.height
    neck, hip, ankle = figure.at("neck")[1], figure.at("left_hip")[1], figure.at("left_ankle")[1]
    top = float(neck + 0.004 * h)
    hem = float(np.interp(u(0.1, 0.9), [0, 1], [hip, ankle + 0.05 * h]))
    center = figure.at("neck")[[0, 2]] + [0, 0.01 * h]
    drape = hanging_rings(
        figure, top, hem, Outline(float(u(0.02, 0.2)), 1.0, 0.022 * h), rings=24, center=center, convex=False,
        points=figure.torso,
    )  # fmt: skip
    span = np.array([np.pi + np.array([-1, 1]) * u(1.7, 2.2), np.pi + np.array([-1, 1]) * u(0.95, 1.15)])
    links = int(np.clip(round((top - hem) / (0.085 * h)), 4, 7))
    hang = Hang(
        mass=1.0, damping=(0.88, 0.96), out=60, inward=15, side=20, twist=0, spring=float(u(0.15, 0.5)),
        thick=0.008 * h, box=True, group=CAPE,
        meets=SOLID["legs"] | SOLID["trunk"], give=0.15,
    )  # fmt: skip
    chest = costume.bone_index("上半身2")
    count = int(rng.integers(5, 8))
    cloth = _Cloth(span, colors, float(u(0.0, 0.05)), 0.004 * h)
    points = _sheet(costume, drape, cloth, "マント", chest, hang, links, count)
    angles = np.linspace(0, 2 * np.pi, 28, endpoint=False)
    drape = replace(drape, radii=np.minimum(drape.radii, 1.25 * np.median(drape.radii[0])))
    chin = float(figure.head[:, 1].min()) - top
    collar = drape.points(np.zeros(4), angles, 1.0, 0.0)
    flare = np.array([0.014, 0.018, 0.006, -0.006])[:, None, None] * h
    collar += flare * np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)[None]
    collar[:, :, 1] += (
        np.array([0.05, 0.048, 0.0, -0.022])[:, None] * h * float(min(u(0.5, 1.0), max(0.8 * chin / (0.05 * h), 0.2)))
    )
    bones, shares = np.full(len(collar.reshape(-1, 3)), chest), np.ones(4 * 28)
    costume.add(collar.reshape(-1, 3), sheet_faces(4, 28, wrap=True), bones[:, None], shares[:, None], colors[0])
    costume.words.append("cape")
    return points


def add_sleeves(costume: Costume, figure: Figure, rng: np.random.Generator, *, colors: tuple[str, str]) -> None:
    """Wide sleeves: pouches of cloth that hang from the forearms."""
    u, h = rng.uniform, figure.height
    drop, begin, wide = float(u(0.09, 0.26)) * h, float(u(-0.25, 0.2)), float(u(1.35, 1.8))
    spring = float(u(0.04, 0.15))
    for side, mark in (("left", "左"), ("right", "右")):
        elbow, wrist = figure.at(f"{side}_elbow"), figure.at(f"{side}_wrist")
        upper = figure.at(f"{side}_shoulder")
        direction = unit(wrist - elbow)
        skin = figure.skin
        own = skin.points[skin.weights[:, 18 if side == "left" else 19] > 0.7]
        radius = wide * float(np.percentile(np.linalg.norm(np.cross(own - elbow, direction), axis=1), 80))
        down = unit(np.array([0, -1.0, 0]) + 0.35 * direction * direction[1])
        normal = unit(np.cross(direction, down))
        count, links = 3, 2
        length = float(np.linalg.norm(wrist - elbow))

        def axis(
            share: np.ndarray, elbow: np.ndarray = elbow, wrist: np.ndarray = wrist, upper: np.ndarray = upper
        ) -> np.ndarray:
            """Places along the arm: 0 at the elbow, 1 at the wrist, below 0 on the upper arm."""
            share = np.asarray(share)[..., None]
            return np.asarray(np.where(share < 0, elbow + share * (elbow - upper), elbow + share * (wrist - elbow)))

        at = np.linspace(max(begin, 0.05) + 0.05, 0.95, count)
        deep = drop * np.array([0.55, 0.9, 1.0])
        steps = np.linspace(0, 1, links + 1)
        nodes = axis(at)[:, None] + down * (radius * 0.6 + deep[:, None] * steps[None])[..., None]
        hang = Hang(
            mass=0.4, damping=(0.92, 0.99), out=55, inward=55, side=20, twist=0, spring=spring, thick=0.01 * h,
            box=False, group=SLEEVE,
            meets=0,
        )  # fmt: skip
        chains = add_chains(
            costume, [f"{mark}袖{number}" for number in range(count)], nodes, np.tile(normal, (count, 1)),
            costume.bone_index(f"{mark}ひじ"), hang,
        )  # fmt: skip
        columns = max(round(12 * costume.fine), 7)
        share = np.linspace(begin, 1.0 + 0.03 / max(length, 0.1), columns)
        half, over = max(round(9 * costume.fine), 6), max(round(6 * costume.fine), 4)
        # Around a section: over the arm, down one side, up the other.
        turn = np.linspace(0, np.pi, 2 * over + 1)
        ring = [(np.cos(t), -np.sin(t), 0.0) for t in turn]
        ring += [(-1 + s, 0.0, s) for s in np.linspace(0, 1, half + 1)[1:]] + [
            (1 - s, 0.0, s) for s in np.linspace(1, 0, half + 1)[1:-1]
        ]
        table = np.array(ring)  # along the normal, along down, and how far down the pouch
        fall = drop * np.interp(share, [begin, at[0], 1.0], [0.12, 0.55, 1.0])
        girth = radius * np.interp(share, [begin, 0.3, 1.0], [0.85, 1.0, 1.15])
        narrow = np.where(table[:, 2] > 0, np.sign(table[:, 0]) * (1 - 0.85 * table[:, 2]), table[:, 0])
        points = (
            axis(share)[None] + narrow[:, None, None] * girth[None, :, None] * normal
            + (table[:, 1][:, None] * girth[None] + table[:, 2][:, None] * fall[None])[..., None] * down
        )  # fmt: skip
        along = np.where(table[:, 2] > 0, table[:, 2] * links, -0.5)
        across = np.interp(share, at, np.arange(count))
        bones, shares = chains.weights(np.repeat(along, columns), np.tile(across, len(table)))
        arm = (share < 0)[None] & (np.ones(len(table), bool))[:, None]
        blend = np.clip(-np.tile(share, len(table)) / max(-begin, 0.05), 0, 1) * arm.reshape(-1)
        elbow_share = 1 - blend
        bones = np.column_stack([bones, np.full(len(bones), costume.bone_index(f"{mark}腕"))])
        shares = np.column_stack([shares * elbow_share[:, None], blend])
        faces = sheet_faces(len(table), columns)
        last = (len(table) - 1) * columns + np.arange(columns)
        seam = np.stack([last[:-1], np.arange(columns)[:-1], np.arange(columns)[1:], last[1:]], axis=1)
        faces = np.concatenate([faces, seam[:, [0, 1, 2]], seam[:, [0, 2, 3]]])
        flat = points.reshape(-1, 3)
        border = (faces % columns >= columns - max(2, round(2 * costume.fine))).all(axis=1)
        costume.add(flat, faces, bones, shares, np.where(border, colors[1], colors[0]))
    costume.words.append("wide sleeves")
