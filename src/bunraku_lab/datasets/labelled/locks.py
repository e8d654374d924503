"""Hair of avatars on the dome of a head: caps, fringes, thick locks that spread, curtains, and tails of many locks."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bunraku_lab.datasets.labelled.figures import UNKNOWN
from bunraku_lab.synthetic.surfaces import curve_through, sheet_faces, strand, unit
from bunraku_lab.synthetic.wardrobe.hair import Scalp


class Hair:
    """Grows hair on a head.

    Args:
        scalp: Its dome.
        chin: Height of the chin [m]; hair below it hangs.
        height: Of the figure [m].
        rng: Random numbers.
        add: Takes each piece: points (P, 3), faces (F, 3), and by its name `hangs`, as of `Labelled`.
    """

    def __init__(self, scalp: Scalp, chin: float, height: float, rng: np.random.Generator, add: Callable[..., None]):
        self.scalp, self.chin, self.h, self.rng, self.u, self.add = scalp, chin, height, rng, rng.uniform, add
        self.half, self.middle, self.chance = scalp.half, scalp.center, lambda rate: bool(rng.random() < rate)

    def low(self, points: np.ndarray) -> np.ndarray:
        """Which points (P, 3) hang: those below the chin do, those beside the face may, shape (P,)."""
        y = points[:, 1]
        return np.where(y < self.chin, 1, np.where(y < self.middle[1], UNKNOWN, 0))

    def lock(
        self, curve: Sequence[np.ndarray] | np.ndarray, wide: float, free: float | None = None,
        flat: float | None = None, root: float = 0.5,
    ) -> None:  # fmt: skip
        """A thick lock along points, pointed at its end; what hangs is what is `low`, or past a share of its length."""
        u, rng = self.u, self.rng
        rows = int(rng.integers(5, 16))
        path = curve_through(np.array(curve), rows)
        path[:, 1] = np.maximum(path[:, 1], 0.01 * self.h)
        t = np.linspace(0, 1, rows)
        taper = np.interp(t, [0, 0.2, u(0.4, 0.7), 0.9, 1], [root, 1, u(0.8, 1.1), u(0.2, 0.5), 0.02])
        deep = u(0.25, 0.9) if flat is None else flat
        points, faces, place = strand(path, unit(path.mean(axis=0) - self.middle + 1e-4), wide * taper,
                                      deep * wide * taper, int(rng.integers(3, 9)))  # fmt: skip
        self.add(points, faces, hangs=self.low(points) if free is None else np.where(place / (rows - 1) > free, 1, 0))

    def grow(self, cap: bool) -> None:
        """A cap, unless there is one, what falls over the forehead, and what is behind or beside."""
        u, rng, scalp, chance = self.u, self.rng, self.scalp, self.chance
        if not cap:
            columns, rows = int(rng.integers(14, 30)), int(rng.integers(6, 11))
            around = np.arange(columns) * 2 * np.pi / columns
            back = 0.5 - 0.5 * np.cos(around)
            edge = np.interp(back, [0, 0.12, 0.35, 0.6, 1.0], [u(0.7, 1.0), 1.05, u(1.3, 1.9), 2.0, u(1.9, 2.4)])
            share = np.linspace(0.02, 1, rows)[:, None]
            lift = u(0, 1.2) + u(0, 0.8) * np.sin(np.pi * share) + 0.15 * rng.normal(size=(rows, columns))
            points = scalp.at(around[None], share * edge, scalp.thick * lift).reshape(-1, 3)
            self.add(points, sheet_faces(rows, columns, wrap=True), hangs=0)
        size = float(self.half[0])
        fringe = str(rng.choice(["spikes", "blunt", "parted", "none"], p=[0.45, 0.2, 0.25, 0.1]))
        count = int(rng.integers(3, 11))
        if fringe == "blunt":
            angles, falls = np.linspace(-u(0.7, 1.2), u(0.7, 1.2), 13), np.linspace(0.3, u(1.25, 1.55), 6)
            grid = scalp.at(angles[None], falls[:, None], scalp.thick * u(0.3, 1.2)).reshape(-1, 3)
            self.add(grid, sheet_faces(6, 13), hangs=0)
        for middle in np.linspace(-u(0.7, 1.2), u(0.7, 1.2), count) if fringe in ("spikes", "parted") else ():
            lean = u(-0.4, 0.4) if fringe == "spikes" else 0.6 * np.sign(middle + 1e-3)
            falls = np.array([0.2, 0.7, 1.1, u(1.25, 1.7)])
            lifts = scalp.thick * np.array([0.1, u(0.5, 1.5), u(0.5, 2.0), u(0, 1.5)])
            self.lock(
                scalp.at(middle + lean * np.linspace(0, 1, 4) ** 2, falls, lifts), 1.6 * size / count * u(0.7, 1.3)
            )
        kinds = ["spiky", "locks", "curtain", "twins", "pony", "short"]
        kind = str(rng.choice(kinds, p=[0.12, 0.24, 0.14, 0.3, 0.1, 0.1]))
        fall = float(u(0.1, 0.45) if chance(0.5) else u(0.45, 1.0)) * self.h
        if kind == "spiky":
            for _ in range(int(rng.integers(12, 45))):
                turn, down = np.pi + u(-2.0, 2.0), u(0.2, 2.1)
                root = scalp.at(turn, down, -0.3 * scalp.thick)
                way = unit(root - self.middle) + np.array([0, u(-1.0, 0.3), u(-0.4, 0.2)])
                long = self.half[1] * u(0.4, 1.3)
                tip = root + long * way - [0, u(0, 0.4) * long, 0]
                self.lock([root, root + 0.5 * long * way, tip], size * u(0.15, 0.4))
        elif kind == "locks":
            self._locks(fall)
        elif kind == "curtain":
            self._curtain(fall)
        elif kind in ("twins", "pony"):
            turn, down = (np.pi, u(0.5, 1.8)) if kind == "pony" else (u(1.2, 2.5), u(0.4, 2.0))
            state = rng.bit_generator.state
            for side in (1,) if kind == "pony" else (1, -1):
                rng.bit_generator.state = state
                self._bundle(side * turn, down, fall)
            if chance(0.25):
                self._locks(u(0.05, 0.3) * self.h)
        if chance(0.4):  # beside the face
            turn, long, wide = u(0.9, 1.5), self.half[1] * u(0.8, 3.5), size * u(0.08, 0.3)
            for side in (1, -1):
                top = scalp.at(side * turn, np.array([0.6, 1.2, 1.6]), 0.6 * scalp.thick)
                low = top[-1] - [0, long, 0] + np.array([side * u(-0.1, 0.3), 0, u(-0.1, 0.3)]) * size
                self.lock([*top, 0.5 * (top[-1] + low), low], wide)

    def _locks(self, fall: float) -> None:
        """Thick locks that leave the dome all round the back and spread to their ends, in layers."""
        u, rng, scalp = self.u, self.rng, self.scalp
        wide, spread, curl = u(1.2, 2.4), u(0, 0.5), u(-0.3, 0.6)
        count = int(rng.integers(4, 15))
        for layer in range(int(rng.integers(1, 4))):
            for turn in np.linspace(np.pi - wide, np.pi + wide, count) + rng.normal(0, 0.06, count):
                way = np.array([np.sin(turn), 0, np.cos(turn)])
                drop = fall * u(0.65, 1.1) * (1 - 0.2 * layer)
                falls = np.array([0.4, 1.0, 1.5])
                top = scalp.at(turn, falls, scalp.thick * (0.6 + 0.5 * layer))
                middle = top[-1] - [0, 0.5 * drop, 0] + way * 0.5 * spread * drop
                end = top[-1] - [0, drop, 0] + way * drop * (spread + curl * u(0, 0.6))
                broad = 2.2 * wide * float(self.half[0]) / count * u(0.35, 0.75)
                self.lock([*top, middle, end + rng.normal(0, 0.02, 3) * self.h], broad, flat=u(0.15, 0.5))

    def _curtain(self, fall: float) -> None:
        """One sheet from the dome down, blunt or in points, closed or not."""
        u, rng, scalp = self.u, self.rng, self.scalp
        wide, columns = u(1.2, 2.3), int(rng.integers(15, 41))
        turns = np.linspace(np.pi - wide, np.pi + wide, columns)
        ways = np.stack([np.sin(turns), 0 * turns, np.cos(turns)], axis=1)
        above = scalp.at(turns[None], np.array([0.5, 0.9, 1.3, 1.55])[:, None], scalp.thick * u(0.4, 1.5))
        t = np.linspace(0, 1, int(rng.integers(6, 14)))[1:, None, None]
        spread, narrow = u(-0.05, 0.35), u(0, 0.4)
        hem = fall * (1 - u(0, 0.25) * (np.arange(columns) % int(rng.integers(2, 5)) == 0))
        side = (above[-1] - self.middle) * [1, 0, 0]
        below = above[-1] - t * hem[:, None] * [0, 1, 0] + t * (ways * spread * fall - narrow * side)
        fold = u(0, 0.12) * self.half[0] * np.sin(np.arange(columns) * u(0.5, 2.0))[:, None] * ways
        grid = np.concatenate([above, below + fold * t])
        points, faces = grid.reshape(-1, 3), sheet_faces(len(grid), columns)
        points[:, 1] = np.maximum(points[:, 1], 0.01 * self.h)
        state = self.low(points)
        self.add(points, faces, hangs=state)
        if self.chance(0.5):
            inner = points - np.tile(ways, (len(grid), 1)) * self.half[0] * u(0.03, 0.2)
            self.add(inner, faces[:, ::-1], hangs=state)

    def _bundle(self, turn: float, down: float, fall: float) -> None:
        """A tail of many locks that part towards their ends."""
        u, rng, size = self.u, self.rng, float(self.half[0])
        root = self.scalp.at(turn, down, 0.0)
        way = unit(np.array([np.sin(turn), u(-0.1, 0.6), np.cos(turn)]))
        out = size * u(0.2, 1.6)
        fan, lean, bow = u(0.02, 0.6), u(0, 0.7), u(-0.1, 0.5)
        for number in range(int(rng.integers(1, 10))):
            drop = fall * (1 if not number else u(0.5, 1.05))
            apart = rng.normal(0, 1, 3) * [1, 0.3, 1] * fan * 0.35 * drop
            flat = way * [1, 0, 1]
            knee = root + way * out + rng.normal(0, 0.1, 3) * size
            middle = knee - [0, 0.5 * drop, 0] + flat * (lean * 0.5 + bow) * 0.4 * drop + 0.5 * apart
            end = knee - [0, drop, 0] + flat * lean * 0.5 * drop + apart
            curl = end + rng.normal(0, 0.06, 3) * drop + [0, u(-0.05, 0.12) * drop, 0]
            fat = size * u(0.15, 0.7) * (0.8 if number else 1.4)
            self.lock([root, knee, middle, end, curl], fat, 0.12, root=u(0.15, 0.6))
