"""Coats, capes and wide sleeves: cloth over the clothes, open in front, behind, or around the arms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bunraku_lab.synthetic.people.figure import Figure
from bunraku_lab.synthetic.surfaces import sheet_faces, unit
from bunraku_lab.synthetic.wardrobe.kit.chains import Hang, add_chains, band_start
from bunraku_lab.synthetic.wardrobe.kit.clothes import collar_field
from bunraku_lab.synthetic.wardrobe.kit.model import Costume
from bunraku_lab.synthetic.wardrobe.kit.skeleton import SOLID, body_weights
from bunraku_lab.synthetic.wardrobe.pieces.skirts import Drape, Outline, hanging_rings

__all__ = ["add_cape", "add_coat", "add_sleeves"]

COAT, CAPE, SLEEVE = 6, 7, 8


@dataclass(frozen=True)
class _Cloth:
    """A sheet of cloth.

    Args:
        span: Directions of its first and last column at the top and at the hem, shape (2, 2) [rad].
        colors: Materials outside and inside.
        wave: Depth of folds over the radius.
        lining: Distance of the inside [m].
    """

    span: np.ndarray
    colors: tuple[str, str]
    wave: float
    lining: float


def _sheet(
    costume: Costume, drape: Drape, cloth: _Cloth, names: str, bone: int, hang: Hang, links: int, count: int
) -> np.ndarray:
    """An open sheet on chains, with a lining inside; returns its points.

    Args:
        costume: What it is added to.
        drape: The rings it hangs in.
        cloth: The sheet.
        names: What the chains are called.
        bone: What they hang on.
        hang: How they move.
        links, count: Of the chains.
    """
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
    costume: Costume,
    figure: Figure,
    rng: np.random.Generator,
    *,
    waist: float,
    colors: tuple[str, str],
    thick: float,
) -> np.ndarray:
    """A long coat: a jacket with sleeves, its skirts open in front below the waist; returns its points but those of the
    sleeves.
    """
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
        figure,
        top,
        hem,
        Outline(float(u(0.02, 0.2)), 1.0, 0.022 * h),
        rings=24,
        center=center,
        convex=False,
        points=figure.torso,
    )
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
            costume,
            [f"{mark}袖{number}" for number in range(count)],
            nodes,
            np.tile(normal, (count, 1)),
            costume.bone_index(f"{mark}ひじ"),
            hang,
        )
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
