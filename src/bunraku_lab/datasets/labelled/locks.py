"""Hair of any size on labelled figures: tails as thick as the head and as long as the figure, locks, braids, buns,
and curtains of flat strips.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bunraku_lab.datasets.labelled.figures import CARRIER, PART, UNKNOWN, Labelled
from bunraku_lab.synthetic.families.model import block_mesh
from bunraku_lab.synthetic.fields import ball
from bunraku_lab.synthetic.surfaces import curve_through, strand, unit


class _Tail(NamedTuple):
    """Half width and length [m], angle of its root over the middle of the head [rad], how far out it goes [m], bow as a
    share of its drop, thickness over width, curl of its end along x and z [m], and beads of a braid, 0 for none.
    """

    fat: float
    length: float
    rise: float
    out: float
    bow: float
    flat: float
    curl: np.ndarray
    beads: float


class _Head:
    """Where the head of a figure is, and the hair that is put on it."""

    def __init__(self, figure: Labelled, head: np.ndarray, rng: np.random.Generator):
        self.figure, self.rng = figure, rng
        low, high = head.min(axis=0), head.max(axis=0)
        self.centre, self.half = 0.5 * (low + high), 0.5 * (high - low)
        self.ground = float(figure.vertices[:, 1].min())
        self.tall = float(figure.vertices[:, 1].max()) - self.ground
        own = figure.part == PART["hair"]
        self.paint = rng.uniform(0.05, 0.95, 3)
        if figure.colors is not None and own.any() and rng.random() < 0.8:
            self.paint = figure.colors[own].mean(axis=0)

    def add(self, points: np.ndarray, faces: np.ndarray, hangs: np.ndarray | int) -> None:
        """Hang a lock on it."""
        count = len(points)
        colors = None if self.figure.colors is None else np.tile(self.paint, (count, 1))
        part, carrier = (np.full(count, number, np.int8) for number in (PART["hair"], CARRIER["head"]))
        state = np.broadcast_to(np.asarray(hangs, np.int8), count)
        self.figure = self.figure.carried(Labelled(points, faces, part, state, carrier, colors))

    def buns(self) -> None:
        """A round bun on each side."""
        u = self.rng.uniform
        rise, around, size = u(-0.3, 1.2), u(0.8, 2.4), u(0.3, 1.0)
        for side in (1, -1):
            way = np.array([side * np.sin(around) * np.cos(rise), np.sin(rise), np.cos(around) * np.cos(rise)])
            at, extent = self.centre + self.half * way * u(1.1, 1.4), self.half[0] * size * u(0.8, 1.2, 3)
            self.add(*block_mesh(ball(at, extent), 2.0, 5), UNKNOWN)

    def curtain(self) -> None:
        """Flat strips that lie on the skull and fall from it all round the back, in one to three layers."""
        u, half = self.rng.uniform, self.half
        length, wide = self.tall * u(0.1, 0.85), u(1.2, 2.6)
        spread, sway = u(0.0, 0.35), u(0.0, 0.12) * self.tall
        count = int(self.rng.integers(9, 26))
        for layer in range(int(self.rng.integers(1, 4))):
            for turn in np.linspace(np.pi - wide, np.pi + wide, count) + self.rng.normal(0, 0.05, count):
                way = np.array([np.sin(turn), 0, np.cos(turn)])
                drop = length * u(0.7, 1.05) * (1 - 0.25 * layer)
                out = half * (1.02 + 0.06 * layer)
                ear = self.centre + out * way * [1, 0, 1] + [0, -0.1 * half[1], 0]
                end = ear + way * spread * drop + [u(-1, 1) * sway, -drop, u(-1, 1) * sway]
                end[1] = max(end[1], self.ground + 0.01 * self.tall)
                middle = 0.5 * (ear + end) + way * (0.5 * spread * drop + u(-0.02, 0.06) * self.tall)
                top = self.centre + out * (0.5 * way + [0, 0.85, 0])
                rows = int(self.rng.integers(8, 15))
                curve = curve_through(np.array([top, ear, middle, end]), rows)
                width = (
                    half[0] * u(0.12, 0.35) * np.interp(np.linspace(0, 1, rows), [0, 0.3, 0.7, 1], [0.5, 1, 0.9, 0.05])
                )
                points, faces, _ = strand(curve, unit(way + 1e-3), width, 0.3 * width, int(self.rng.integers(4, 8)))
                self.add(points, faces, np.where(points[:, 1] < ear[1] - 0.15 * half[1], 1, 0))

    def tails(self, kind: str) -> None:
        """Twin tails, a tail, a braid or two, or a bundle of locks."""
        u, half, rng = self.rng.uniform, self.half, self.rng
        most = {"bundle": 0.5, "braids": 0.35, "tail": 1.6, "twins": 1.7}[kind]
        fat = half[0] * float(np.exp(u(np.log(0.12), np.log(most))))
        length = self.tall * float(u(0.15, 1.0))
        rise, out, bow = u(-0.2, 1.0), u(0.2, 2.2) * half[0], u(-0.3, 0.8)
        flat, curl = u(0.3, 1.0), u(-0.15, 0.15, 2) * self.tall
        if kind == "twins" or (kind == "braids" and rng.random() < 0.7):
            turns = [u(1.0, 2.5)] * 2
            turns[1] *= -1
        elif kind == "bundle":
            count = int(rng.integers(4, 12))
            turns = list(np.pi + np.linspace(-1.7, 1.7, count) + rng.normal(0, 0.08, count))
        else:
            turns = [np.pi + rng.normal(0, 0.25)]
        if kind in ("bundle", "braids"):
            rise, out = u(-0.4, 0.3), u(0.0, 0.6) * half[0]
        beads = u(5, 14) if kind == "braids" else 0.0
        tail = _Tail(fat, length, rise, out, bow, flat, curl, beads)
        for turn in turns:
            self._tail(turn, tail)

    def _tail(self, turn: float, tail: _Tail) -> None:
        u, rng = self.rng.uniform, self.rng
        fat, length, rise, out, bow, flat, curl, beads = tail
        sign = np.sign(np.sin(turn)) or 1.0
        way = np.array([np.sin(turn), 0, np.cos(turn)])
        root = self.centre + self.half * 0.95 * (way * np.cos(rise) + [0, np.sin(rise), 0])
        knee = root + out * way + [0, u(-0.2, 0.5) * fat, 0]
        drop = root[1] - max(root[1] - length * u(0.9, 1.1), self.ground + 0.02 * self.tall)
        middle = root + way * (out + bow * 0.3 * drop) + np.array([sign * curl[0], -0.55 * drop, curl[1]])
        end = root + way * (out + 0.5 * bow * 0.3 * drop) + np.array([sign * curl[0] * u(0, 1.5), -drop, curl[1]])
        rows = 48 if beads else int(rng.integers(8, 22))
        curve = curve_through(np.array([root, knee, middle, end]), rows)
        t = np.linspace(0, 1, rows)
        widths = fat * np.interp(t, [0, 0.06, 0.3, 0.65, 0.92, 1], [0.3, 0.55, 1.0, u(0.6, 1.1), u(0.2, 0.6), 0.03])
        widths *= 1 + 0.3 * np.sin(2 * np.pi * beads * t)
        points, faces, place = strand(curve, unit(way + 1e-3), widths, flat * widths, int(rng.integers(6, 14)))
        self.add(points, faces, np.where(place / (rows - 1) > 0.07, 1, 0))
        thick = fat > 0.4 * self.half[0]
        for _ in range(int(rng.integers(0, 9)) if thick and not beads else 0):  # strands that leave its surface
            start = int(rng.integers(1, max(2, rows // 2)))
            off = rng.normal(size=3) * fat * 0.7
            thin = curve[start:] + off * np.linspace(0.5, 1.5, rows - start)[:, None]
            taper = np.interp(np.linspace(0, 1, rows - start), [0, 0.4, 1], [0.3, u(0.3, 0.7), 0.02]) * fat
            points, faces, _ = strand(thin, unit(way + 1e-3), taper, flat * taper, 6)
            self.add(points, faces, 1)


def with_locks(figure: Labelled, rng: np.random.Generator) -> Labelled:
    """The figure with more hair, where it is known what the head is."""
    face = figure.vertices[(figure.part == PART["body"]) & (figure.carrier == CARRIER["head"])]
    if len(face) < 20:
        return figure
    head = _Head(figure, face, rng)
    kind = str(
        rng.choice(["twins", "tail", "bundle", "buns", "curtain", "braids"], p=[0.4, 0.12, 0.1, 0.06, 0.2, 0.12])
    )
    if kind == "buns":
        head.buns()
    elif kind == "curtain":
        head.curtain()
    else:
        head.tails(kind)
    return head.figure
