"""What is worn and does not swing: bows, headphones, flowers, bands with ruffles, bells of stiff cuffs."""

from __future__ import annotations

import numpy as np

from bunraku_lab.datasets.labelled.figures import CARRIER, PART, UNKNOWN, Labelled
from bunraku_lab.synthetic.families.model import block_mesh
from bunraku_lab.synthetic.fields import ball
from bunraku_lab.synthetic.surfaces import sheet_faces, strand, unit

Mesh = tuple[np.ndarray, np.ndarray]


def _bow(at: np.ndarray, way: np.ndarray, size: float, rng: np.random.Generator) -> list[tuple[Mesh, int]]:
    """Two loops and a knot, which are stiff, and two ends, which physics move in some files and not in others."""
    side = unit(np.cross([0.0, 1.0, 0.0], way))
    up, u = np.cross(way, side), rng.uniform
    out: list[tuple[Mesh, int]] = [(block_mesh(ball(at, size * u(0.15, 0.3, 3)), 3.0, 4), 0)]
    t = np.linspace(0, 1, 6)[:, None]
    for sign in (1.0, -1.0):
        curve = at + t * size * (sign * side + u(-0.2, 0.4) * up) + 0.1 * size * way
        wide = size * np.interp(t[:, 0], [0, 0.7, 1], [0.15, u(0.4, 0.7), 0.3])
        out.append((strand(curve, way, wide, u(0.2, 0.6) * wide, 8)[:2], 0))
        if rng.random() < 0.6:
            curve = at + t * size * u(0.6, 2.0) * (0.4 * sign * side - up) + 0.08 * size * way
            out.append((strand(curve, way, np.full(6, size * 0.18), 0.02 * size, 4)[:2], UNKNOWN))
    return out


def _headphones(centre: np.ndarray, half: np.ndarray, rng: np.random.Generator) -> list[Mesh]:
    u = rng.uniform
    size, thick = half[1] * u(0.25, 0.6), half[0] * u(0.1, 0.35)
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 13)
    arc = centre + np.stack([half[0] * 1.12 * np.sin(angle), half[1] * 1.15 * np.cos(angle), 0 * angle], axis=1)
    out: list[Mesh] = [strand(arc, np.array([0, 0, 1.0]), half[0] * u(0.05, 0.15), half[0] * 0.06, 6)[:2]]
    for sign in (1, -1):
        at = centre + [sign * (half[0] * 1.05 + thick), u(-0.2, 0.2) * half[1], 0]
        out.append(block_mesh(ball(at, np.array([thick, size, size])), float(rng.choice([2.0, 5.0])), 5))
    return out


def _frill(at: np.ndarray, radius: float, wide: float, rng: np.random.Generator) -> Mesh:
    """A ring in folds, from lying flat to hanging straight down."""
    waves, tilt = int(rng.integers(6, 20)), rng.uniform(0.1, 1.4)
    return _ring(at, radius, wide, tilt, waves, rng.uniform(0.03, 0.25) * wide)


def _ring(at: np.ndarray, radius: float, wide: float, tilt: float, waves: int = 8, deep: float = 0.0) -> Mesh:
    """A band about +Y with two walls, which goes out and down by its tilt [rad], in folds so deep [m]."""
    angle = np.arange(4 * waves) * np.pi / (2 * waves)
    rows = []
    for inset, down in [*((0.0, share) for share in (0, 0.33, 0.66, 1)), *((0.04, share) for share in (1, 0.5, 0))]:
        r = radius + wide * (np.cos(tilt) * down - inset) + deep * down * np.sin(waves * angle)
        y = deep * down * np.cos(waves * angle) - wide * (np.sin(tilt) * down + inset)
        rows.append(at + np.stack([r * np.sin(angle), y, r * np.cos(angle)], axis=1))
    return np.concatenate(rows), sheet_faces(len(rows), len(angle), wrap=True)


def with_accessories(figure: Labelled, rng: np.random.Generator) -> Labelled:
    """The figure with one to three such things on its head, trunk and wrists, where it is known what those are."""
    head = figure.vertices[(figure.part == PART["body"]) & (figure.carrier == CARRIER["head"])]
    trunk = figure.vertices[(figure.part == PART["body"]) & (figure.carrier == CARRIER["chest"])]
    if len(head) < 20 or len(trunk) < 20:
        return figure
    u = rng.uniform
    low, high = head.min(axis=0), head.max(axis=0)
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    for kind in rng.choice(
        ["bow", "headphones", "frill", "cuffs", "collar bow", "sash"], int(rng.integers(1, 4)), False
    ):
        made: list[tuple[Mesh, int]] = []
        carrier = "head"
        if kind == "bow":
            turn, rise = u(-np.pi, np.pi), u(0.1, 1.4)
            way = np.array([np.sin(turn) * np.cos(rise), np.sin(rise), np.cos(turn) * np.cos(rise)])
            made = _bow(centre + half * way * 1.1, way, half[0] * u(0.3, 1.3), rng)
        elif kind == "headphones":
            made = [(mesh, 0) for mesh in _headphones(centre, half, rng)]
        elif kind == "cuffs" and figure.hands is not None:
            for hand, name in zip(figure.hands, ("left arm", "right arm"), strict=True):
                inward = unit(centre + [0, -1.6 * half[1], 0] - hand)
                t = np.linspace(0.2, u(1.0, 1.8), 6)[:, None]
                widths = half[0] * np.interp(t[:, 0], [0.2, 1.8], sorted(u(0.25, 0.8, 2))[::-1])
                points, faces, _ = strand(hand + t * half[1] * inward, np.array([0, 0, 1.0]), widths, widths, 12)
                figure = figure.carried(_worn((points, faces), "body", name, 0, figure, rng))
            continue
        else:
            carrier = "chest"
            share = {"frill": u(0.0, 1.0), "collar bow": u(0.75, 1.0), "sash": u(0.0, 0.3)}.get(str(kind), 0.5)
            y = trunk[:, 1].min() + share * float(np.ptp(trunk[:, 1]))
            band = trunk[np.abs(trunk[:, 1] - y) < 0.06 * np.ptp(trunk[:, 1]) + 1e-6]
            band = band[np.abs(band[:, 0] - centre[0]) < 1.2 * half[0]]
            if len(band) < 4:
                continue
            z = band[:, 2].max() if kind == "collar bow" else band[:, 2].min()
            if kind == "frill":
                middle = np.array([centre[0], y, band[:, 2].mean()])
                radius = 0.5 * float(max(np.ptp(band[:, 0]), np.ptp(band[:, 2])))
                if rng.random() < 0.5:
                    made = [(_frill(middle, radius, half[0] * u(0.2, 1.0), rng), 0)]
                else:
                    size = half[0] * u(0.05, 0.3)
                    made = [(_ring(middle, radius, size, 1.4), 0)]
            else:
                way = np.array([0, 0, 1.0 if kind == "collar bow" else -1.0])
                made = _bow(np.array([centre[0], y, z]), way, half[0] * u(0.2, 1.6), rng)
        for mesh, hangs in made:
            figure = figure.carried(_worn(mesh, "accessory", carrier, hangs, figure, rng))
    return figure


def _worn(mesh: Mesh, part: str, carrier: str, hangs: int, figure: Labelled, rng: np.random.Generator) -> Labelled:
    count = len(mesh[0])
    colors = None if figure.colors is None else np.tile(rng.uniform(0.05, 0.95, 3), (count, 1))
    labels = [np.full(count, number, np.int8) for number in (PART[part], hangs, CARRIER[carrier])]
    return Labelled(mesh[0], mesh[1], labels[0], labels[1], labels[2], colors)
