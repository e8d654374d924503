"""The zero surface of values at the corners of cubes (Lorensen & Cline 1987), closed wherever the values are whole."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np

__all__ = ["grid_surface", "marching_cubes"]

CUBE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]])
"""The corners of a cube, in the order in which `marching_cubes` takes them: bit a of a number is along axis a."""
_EDGES = [(corner, corner | 1 << axis) for axis in range(3) for corner in range(8) if not corner >> axis & 1]


def marching_cubes(values: np.ndarray, points: np.ndarray, cubes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of the surface where values that are linear along the edges of cubes are 0.

    Where two corners that lie across a side of a cube are inside and the two others are not, the inside ones are taken
    apart; both cubes of that side do so, hence no crack.

    Args:
        values: Below 0 inside, never 0, shape (P,).
        points: Where they are taken, shape (P, 3).
        cubes: Eight points each, in the order of `CUBE`, shape (C, 8).

    Returns:
        Vertices, shape (V, 3), and faces, shape (F, 3), int64, that look to where values are above 0.
    """
    count, triangles = _cases()
    case = ((values[cubes] < 0) << np.arange(8)).sum(axis=1)
    number = count[case]
    owner = np.repeat(np.arange(len(cubes)), number)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(number) - number, number)
    ends = cubes[owner[:, None, None], np.array(_EDGES)[triangles[case[owner], place]]]
    key = ends.min(axis=-1) * len(points) + ends.max(axis=-1)
    unique, faces = np.unique(key, return_inverse=True)
    a, b = unique // len(points), unique % len(points)
    share = (values[a] / (values[a] - values[b]))[:, None]
    return points[a] + share * (points[b] - points[a]), faces.reshape(-1, 3).astype(np.int64)


def grid_surface(values: np.ndarray, spacing: float, low: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The surface where values on a grid are zero: vertices (V, 3) in the unit of the spacing, and faces (F, 3).

    Args:
        values: Negative inside, none of them zero, shape (X, Y, Z).
        spacing: Size of a cell.
        low: Where the first value is, shape (3,).
    """
    inside = values < 0
    number = np.zeros(np.array(values.shape) - 1, np.int8)
    for dx, dy, dz in CUBE:
        number += inside[dx : dx + number.shape[0], dy : dy + number.shape[1], dz : dz + number.shape[2]]
    cells = np.argwhere((number > 0) & (number < 8))
    corners = np.ravel_multi_index((cells[:, None] + CUBE).reshape(-1, 3).T, values.shape)
    used, cubes = np.unique(corners, return_inverse=True)
    positions = np.stack(np.unravel_index(used, values.shape), axis=1) * spacing + low
    return marching_cubes(values.reshape(-1)[used].astype(float), positions, cubes.reshape(-1, 8))


@cache
def _cases() -> tuple[np.ndarray, np.ndarray]:
    """For each set of inside corners how many triangles it has, shape (256,), and on which edges their corners lie,
    shape (256, T, 3).
    """
    fans = [[triangle for loop in _loops(case) for triangle in _fan(loop)] for case in range(256)]
    count = np.array([len(fan) for fan in fans])
    out = np.zeros((256, count.max(), 3), np.int64)
    for case, fan in enumerate(fans):
        out[case, : len(fan)] = np.array(fan).reshape(-1, 3)
    return count, out


def _fan(loop: list[int]) -> list[tuple[int, int, int]]:
    """Triangles of a closed line, around the first corner from which no other side lies in a side of the cube: the cube
    beyond it might have the same.
    """
    for start in range(len(loop)):
        turned = loop[start:] + loop[:start]
        if not any(_beside(turned[0], other) for other in turned[2:-1]):
            break
    return [(turned[0], turned[i + 1], turned[i]) for i in range(1, len(turned) - 1)]


def _beside(edge: int, other: int) -> bool:
    """Whether two edges belong to a common side of the cube."""
    corners = CUBE[list(_EDGES[edge] + _EDGES[other])]
    return bool((corners == corners[0]).all(axis=0).any())


def _loops(case: int) -> list[list[int]]:
    """The closed lines in which the surface crosses the sides of a cube, as numbers of edges.

    Each crossed edge belongs to two sides, and going around both as seen from outside, one leaves the inside there on
    one side and enters it on the other. So a line from where the inside is left to where it was entered goes on at its
    end, on the next side.
    """
    number = {edge: i for i, edge in enumerate(_EDGES)} | {edge[::-1]: i for i, edge in enumerate(_EDGES)}
    follows: dict[int, int] = {}
    for axis, side in product(range(3), range(2)):
        u, v = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
        round_ = [base | side << axis for base in ((0, u, u | v, v) if side else (0, v, u | v, u))]
        steps = [(a, b) for a, b in zip(round_, round_[1:] + round_[:1], strict=True) if (case >> a ^ case >> b) & 1]
        entered = [not case >> a & 1 for a, _ in steps]
        for i, step in enumerate(steps):
            if not entered[i]:
                follows[number[step]] = number[steps[i - 1]]
    loops = []
    while follows:
        loop = [next(iter(follows))]
        while (after := follows.pop(loop[-1])) != loop[0]:
            loop.append(after)
        loops.append(loop)
    return loops
