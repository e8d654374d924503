"""Hair of any size on labelled figures: tails as thick as the head and as long as the figure, locks, buns."""

from __future__ import annotations

import numpy as np

from bunraku_lab.datasets.labelled.figures import CARRIER, PART, UNKNOWN, Labelled
from bunraku_lab.synthetic.families.model import block_mesh
from bunraku_lab.synthetic.fields import ball
from bunraku_lab.synthetic.surfaces import curve_through, strand, unit

__all__ = ["with_locks"]


def with_locks(figure: Labelled, rng: np.random.Generator) -> Labelled:
    """The figure with more hair, where it is known what the head is."""
    head = figure.vertices[(figure.part == PART["body"]) & (figure.carrier == CARRIER["head"])]
    if len(head) < 20:
        return figure
    low, high = head.min(axis=0), head.max(axis=0)
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    ground = float(figure.vertices[:, 1].min())
    tall = float(figure.vertices[:, 1].max()) - ground
    own = figure.part == PART["hair"]
    paint = rng.uniform(0.05, 0.95, 3)
    if figure.colors is not None and own.any() and rng.random() < 0.8:
        paint = figure.colors[own].mean(axis=0)
    kind = str(rng.choice(["twins", "tail", "bundle", "buns"], p=[0.4, 0.2, 0.25, 0.15]))
    u = rng.uniform
    if kind == "buns":
        rise, around, size = u(-0.3, 1.2), u(0.8, 2.4), u(0.3, 1.0)
        for side in (1, -1):
            way = np.array([side * np.sin(around) * np.cos(rise), np.sin(rise), np.cos(around) * np.cos(rise)])
            points, faces = block_mesh(ball(centre + half * way * u(1.1, 1.4), half[0] * size * u(0.8, 1.2, 3)), 2.0, 5)
            figure = figure.carried(_lock(points, faces, np.full(len(points), UNKNOWN), paint, figure))
        return figure
    fat = half[0] * float(np.exp(u(np.log(0.15), np.log(1.6 if kind != "bundle" else 0.5))))
    length = tall * float(u(0.15, 1.0))
    rise, out, bow = u(-0.2, 1.0), u(0.2, 2.2) * half[0], u(-0.3, 0.8)
    flat, curl = u(0.4, 1.0), u(-0.15, 0.15, 2) * tall
    if kind == "twins":
        turns = [u(1.0, 2.5)] * 2
        turns[1] *= -1
    elif kind == "tail":
        turns = [np.pi + rng.normal(0, 0.25)]
    else:
        count = int(rng.integers(4, 12))
        turns = list(np.pi + np.linspace(-1.7, 1.7, count) + rng.normal(0, 0.08, count))
        rise, out = u(-0.4, 0.3), u(0.0, 0.6) * half[0]
    for turn in turns:
        sign = np.sign(np.sin(turn)) or 1.0
        way = np.array([np.sin(turn), 0, np.cos(turn)])
        root = centre + half * 0.95 * (way * np.cos(rise) + [0, np.sin(rise), 0])
        knee = root + out * way + [0, u(-0.2, 0.5) * fat, 0]
        end_y = max(root[1] - length * u(0.9, 1.1), ground + 0.02 * tall)
        drop = root[1] - end_y
        away = way * (out + bow * 0.3 * drop)
        middle = root + away + np.array([sign * curl[0], -0.55 * drop, curl[1]])
        end = root + way * (out + 0.5 * bow * 0.3 * drop) + np.array([sign * curl[0] * u(0, 1.5), -drop, curl[1]])
        rows = int(rng.integers(8, 22))
        curve = curve_through(np.array([root, knee, middle, end]), rows)
        t = np.linspace(0, 1, rows)
        widths = fat * np.interp(t, [0, 0.06, 0.3, 0.65, 0.92, 1], [0.3, 0.55, 1.0, u(0.6, 1.1), u(0.2, 0.6), 0.03])
        points, faces, place = strand(curve, unit(way + 1e-3), widths, flat * widths, int(rng.integers(6, 14)))
        hangs = np.where(place / (rows - 1) > 0.07, 1, 0)
        figure = figure.carried(_lock(points, faces, hangs, paint, figure))
        for _ in range(int(rng.integers(0, 5)) if fat > 0.4 * half[0] else 0):  # strands that leave its surface
            start = int(rng.integers(1, max(2, rows // 2)))
            off = rng.normal(size=3) * fat * 0.6
            thin = curve[start:] + off * np.linspace(0.6, 1.4, rows - start)[:, None]
            taper = np.interp(np.linspace(0, 1, rows - start), [0, 0.4, 1], [0.3, 0.4, 0.02]) * fat
            points, faces, _ = strand(thin, unit(way + 1e-3), taper, flat * taper, 6)
            figure = figure.carried(_lock(points, faces, np.ones(len(points)), paint, figure))
    return figure


def _lock(points: np.ndarray, faces: np.ndarray, hangs: np.ndarray, paint: np.ndarray, figure: Labelled) -> Labelled:
    count = len(points)
    colors = None if figure.colors is None else np.tile(paint, (count, 1))
    part, carrier = (np.full(count, number, np.int8) for number in (PART["hair"], CARRIER["head"]))
    return Labelled(points, faces, part, hangs.astype(np.int8), carrier, colors)
