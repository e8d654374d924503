"""Things beside a figure: what it holds in its hands and wears on its back, what it stands on, and what lies about."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_closing, gaussian_filter, label

from bunraku_lab.datasets.labelled.figures import CARRIER, PART, UNKNOWN, Labelled
from bunraku_lab.synthetic.dressed.extras import box, tube
from bunraku_lab.synthetic.families.model import block_mesh
from bunraku_lab.synthetic.fields import ball, grid_surface
from bunraku_lab.synthetic.surfaces import sheet_faces, unit

Mesh = tuple[np.ndarray, np.ndarray]
_MARGIN = 3
"""Empty voxels about what is fused."""


def _lathe(profile: list[tuple[float, float]], sides: int = 14) -> Mesh:
    """Turned about +Y from pairs of radius and height."""
    angle = np.arange(sides) * 2 * np.pi / sides
    rings = [np.stack([r * np.cos(angle), np.full(sides, y), -r * np.sin(angle)], axis=1) for r, y in profile]
    return np.concatenate(rings), sheet_faces(len(profile), sides, wrap=True)[:, ::-1]


def _round(r: float, y: float) -> Mesh:
    """A ball."""
    return _lathe([(1e-4, y - r), (0.7 * r, y - 0.7 * r), (r, y), (0.7 * r, y + 0.7 * r), (1e-4, y + r)])


def _bar(a: np.ndarray, b: np.ndarray, radius: float, end: float | None = None, sides: int = 8) -> Mesh:
    t = np.linspace(0, 1, 6)[:, None]
    radii = np.linspace(radius, radius if end is None else end, 6)
    curve = np.concatenate([[a], a + t * (b - a), [b]])
    return tube(curve, np.concatenate([[1e-4], radii, [1e-4]]), sides)


def _join(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(mesh[0]) for mesh in meshes)])
    return np.concatenate([mesh[0] for mesh in meshes]), np.concatenate(
        [mesh[1] + start for mesh, start in zip(meshes, starts, strict=False)]
    )


def _held(rng: np.random.Generator) -> Mesh:
    """Something to hold, its grip at 0, along +Y, in units of the figure's height."""
    u = rng.uniform
    kinds = "sword staff shield gun hammer bag umbrella book bow lantern broom bottle ball flag instrument"
    kind = str(rng.choice(kinds.split()))
    y, o = np.array([0, 1.0, 0]), np.zeros(3)
    thin = u(0.006, 0.02)
    if kind == "sword":
        long, wide = u(0.2, 0.8), u(0.012, 0.05)
        return _join(
            box(y * (0.04 + long / 2), (wide, long, u(0.004, 0.015))),
            box(y * 0.03, (wide * u(2, 5), 0.015, 0.02)),
            _bar(y * -u(0.04, 0.12), y * 0.03, thin),
        )
    if kind in ("staff", "broom", "flag"):
        low, high = -u(0.1, 0.6), u(0.2, 0.9)
        meshes = [_bar(y * low, y * high, thin, thin * u(0.6, 1.3))]
        if kind == "broom":
            meshes.append(_bar(y * low, y * (low - u(0.08, 0.2)), thin * 1.5, u(0.03, 0.09), 12))
        elif kind == "flag":
            size = u(0.1, 0.4)
            meshes.append(box(y * (high - size / 2) + [size * 0.7, 0, 0], (size * 1.4, size, 0.004)))
        elif rng.random() < 0.7:
            meshes.append(_round(u(0.02, 0.09), high))
        if rng.random() < 0.3 and kind == "staff":
            meshes.append(box(y * high, (u(0.05, 0.25), u(0.04, 0.16), u(0.01, 0.05))))
        return _join(*meshes)
    if kind == "shield":
        r, deep = u(0.08, 0.26), u(0.005, 0.05)
        if rng.random() < 0.5:
            points, faces = _lathe([(1e-4, deep), (0.6 * r, 0.8 * deep), (r, 0), (r, -0.01), (1e-4, -0.01)], 20)
            return points[:, [0, 2, 1]] * [1, u(0.8, 1.6), 1], faces[:, ::-1]
        return box(o, (2 * r, 2 * r * u(0.9, 1.7), 0.02))
    if kind == "gun":
        long = u(0.12, 0.6)
        return _join(
            box(y * long * 0.35, (u(0.02, 0.05), long, u(0.03, 0.08))),
            _bar(y * long * 0.8, y * long * u(1.1, 1.6), thin),
            box(np.array([0, 0, -0.05]), (0.02, 0.04, u(0.06, 0.12))),
        )
    if kind == "hammer":
        high = u(0.15, 0.7)
        return _join(
            _bar(y * -u(0.05, 0.3), y * high, thin), box(y * high, (u(0.08, 0.35), u(0.05, 0.16), u(0.03, 0.16)))
        )
    if kind in ("bag", "lantern"):
        drop, size = u(0.05, 0.25), u(0.05, 0.16)
        body = _round(0.5 * size, -drop - 0.5 * size)
        if kind == "bag":
            body = box(-y * (drop + size / 2), (size * u(0.8, 1.6), size, size * u(0.3, 1.0)))
        return _join(
            body, _bar(o, np.array([size * 0.3, -drop, 0]), 0.006), _bar(o, np.array([-size * 0.3, -drop, 0]), 0.006)
        )
    if kind == "umbrella":
        high, r = u(0.25, 0.55), u(0.15, 0.4)
        deep = u(0.1, 0.6) * r
        if rng.random() < 0.3:
            return _join(
                _bar(y * -0.1, y * high, 0.008),
                _lathe([(0.01, 0), (0.035, 0.3 * high), (0.02, 0.9 * high), (1e-4, high)]),
            )
        return _join(
            _bar(y * -0.1, y * high, 0.008), _lathe([(r, high - deep), (0.7 * r, high - 0.4 * deep), (1e-4, high)], 12)
        )
    if kind == "book":
        return box(o, (u(0.08, 0.2), u(0.1, 0.22), u(0.02, 0.06)))
    if kind == "bow":
        t = np.linspace(-1, 1, 13)
        long, bend = u(0.2, 0.5), u(0.05, 0.2)
        curve = np.stack([np.zeros(13), long * t, -bend * t * t], axis=1)
        return _join(tube(curve, np.full(13, u(0.006, 0.015)), 6), _bar(curve[0], curve[-1], 0.003))
    if kind == "instrument":
        size = u(0.08, 0.16)
        points, faces = _lathe([(1e-4, -0.03), (size, -0.03), (size, 0.03), (1e-4, 0.03)], 16)
        return _join(
            (points[:, [0, 2, 1]] * [1, 1.3, 1], faces[:, ::-1]), box(y * size * 2.2, (0.03, size * 2.4, 0.02))
        )
    r = u(0.03, 0.12)
    if kind == "bottle":
        return _lathe([(1e-4, -2 * r), (r, -2 * r), (r, r), (0.3 * r, 1.6 * r), (0.3 * r, 2.4 * r), (1e-4, 2.4 * r)])
    return _round(r, 0.0)


def _pack(rng: np.random.Generator) -> Mesh:
    """Something on the back, its middle before it at 0: a backpack with pouches and rolls, a shell, a pair of tanks."""
    u = rng.uniform
    half = u([0.06, 0.08, 0.03], [0.17, 0.2, 0.1])
    power = float(rng.choice([2.0, 3.0, 5.0, 10.0]))
    if rng.random() < 0.2:
        apart, half = half[0] * 0.55, half * [0.45, 1, 1]
        tanks = [block_mesh(ball((side * apart, 0, -0.9 * half[2]), half), power, 5) for side in (1, -1)]
        return _join(*tanks)
    meshes = [block_mesh(ball((0, 0, -0.9 * half[2]), half), power, 5)]
    for _ in range(int(rng.integers(0, 4))):
        size, side = half * u(0.25, 0.7, 3), int(rng.integers(4))
        offset = [(half[0], 0, -half[2]), (-half[0], 0, -half[2]), (0, half[1], -half[2]), (0, 0, -1.9 * half[2])][side]
        meshes.append(block_mesh(ball(np.array(offset) * u(0.8, 1.1), size), power, 4))
    for side in (1, -1) if rng.random() < 0.5 else ():  # straps over the shoulders
        t = np.linspace(0, np.pi, 9)
        curve = np.stack([np.full(9, side * u(0.05, 0.08)), 0.11 + 0.05 * np.sin(t), 0.09 - 0.1 * np.cos(t)], axis=1)
        meshes.append(tube(curve, np.full(9, u(0.006, 0.014)), 6))
    return _join(*meshes)


def _rotation(rng: np.random.Generator, up: np.ndarray) -> np.ndarray:
    """A frame whose +Y is a direction, turned about it at random."""
    y = unit(up)
    x = unit(np.cross(y, rng.normal(size=3)))
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _thing(mesh: Mesh, part: str, carrier: int, rng: np.random.Generator, colored: bool) -> Labelled:
    points, faces = mesh
    count = len(points)
    colors = np.tile(rng.uniform(0.05, 0.95, 3), (count, 1)) if colored else None
    kinds, states, holders = (np.full(count, number, np.int8) for number in (PART[part], 0, carrier))
    return Labelled(points, faces, kinds, states, holders, colors)


def with_things(figure: Labelled, rng: np.random.Generator, rate: float = 0.35) -> Labelled:
    """The figure with things in its hands, on its back, under its feet and about it, each in a share of the cases."""
    out, used = figure, figure.vertices[np.unique(figure.faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    height, colored = float(high[1] - low[1]), figure.colors is not None
    if figure.hands is not None:
        for side, name in enumerate(("left arm", "right arm")):
            if rng.random() > rate:
                continue
            points, faces = _held(rng)
            up = rng.choice(3, p=[0.5, 0.3, 0.2])
            way = [
                np.array([0, 1.0, 0]) + rng.normal(0, 0.25, 3),
                np.array([0, 0.2, 1.0]) + rng.normal(0, 0.3, 3),
                rng.normal(size=3),
            ][up]
            points = points * rng.uniform(0.6, 1.3) * height @ _rotation(rng, way).T + figure.hands[side]
            out = out.carried(_thing((points, faces), "prop", CARRIER[name], rng, colored))
        if rng.random() < 0.4 * rate:  # across the back
            points, faces = _held(rng)
            back = used[np.abs(used[:, 1] - low[1] - 0.68 * height) < 0.08 * height]
            back = back[np.abs(back[:, 0] - 0.5 * (low[0] + high[0])) < 0.12 * height]
            if len(back):
                at = np.array([0.5 * (low[0] + high[0]), low[1] + 0.62 * height, back[:, 2].min() - 0.015 * height])
                way = np.array([rng.normal(0, 0.8), 1.0, 0.1])
                points = (points - 0.5 * (points.min(axis=0) + points.max(axis=0))) * height * rng.uniform(0.6, 1.1)
                out = out.carried(
                    _thing((points @ _rotation(rng, way).T + at, faces), "prop", CARRIER["chest"], rng, colored)
                )
    if figure.hands is not None and rng.random() < 0.45 * rate:
        back = used[np.abs(used[:, 1] - low[1] - 0.68 * height) < 0.1 * height]
        back = back[np.abs(back[:, 0] - 0.5 * (low[0] + high[0])) < 0.1 * height]
        if len(back):
            at = np.array([0.5 * (low[0] + high[0]), low[1] + rng.uniform(0.55, 0.72) * height, back[:, 2].min()])
            points, faces = _pack(rng)
            thing = _thing((points * height + at, faces), "accessory", CARRIER["chest"], rng, colored)
            out = out.carried(thing)
    if rng.random() < 0.35 * rate:  # a plinth or a plate
        wide = 0.5 * max(high[0] - low[0], high[2] - low[2]) * rng.uniform(0.4, 1.5)
        tall = height * float(np.exp(rng.uniform(np.log(0.008), np.log(0.25))))
        at = np.array([0.5 * (low[0] + high[0]), low[1] + 0.003 * height, 0.5 * (low[2] + high[2])])
        mesh = _lathe(
            [(1e-4, 0), (wide, 0), (wide * rng.uniform(1, 1.2), -tall), (1e-4, -tall)], int(rng.choice([4, 6, 8, 24]))
        )
        out = out.carried(_thing((mesh[0] + at, mesh[1]), "ground", UNKNOWN, rng, colored))
        for _ in range(int(rng.integers(0, 4))):  # stones and grass on it
            r = height * rng.uniform(0.02, 0.12)
            angle = rng.uniform(0, 2 * np.pi)
            stone = _lathe([(1e-4, -0.7 * r), (0.8 * r, -0.4 * r), (r, 0.1 * r), (0.5 * r, 0.8 * r), (1e-4, r)], 7)
            spot = at + [0.8 * wide * np.sin(angle), 0, 0.8 * wide * np.cos(angle)]
            out = out.carried(
                _thing((stone[0] * rng.uniform(0.5, 1.3, 3) + spot, stone[1]), "ground", UNKNOWN, rng, colored)
            )
    if rng.random() < 0.15 * rate:  # a tub, a boat, a nest about its lower part
        wide, deep = (
            0.5 * max(high[0] - low[0], high[2] - low[2]) * rng.uniform(0.6, 1.2),
            height * rng.uniform(0.1, 0.4),
        )
        rim = np.array([(1e-4, 0), (0.7, 0), (1, 1), (0.9, 1), (0.62, 0.06), (1e-4, 0.06)]) * [wide, deep]
        tub = _lathe(rim.tolist(), int(rng.choice([6, 12, 24])))
        at = np.array([0.5 * (low[0] + high[0]), low[1] - 0.1 * deep, 0.5 * (low[2] + high[2])])
        out = out.carried(
            _thing((tub[0] * [1, 1, rng.uniform(0.8, 1.8)] + at, tub[1]), "ground", UNKNOWN, rng, colored)
        )
    if rng.random() < 0.2 * rate:  # stray things
        for _ in range(int(rng.integers(1, 4))):
            points, faces = _held(rng)
            spot = low + rng.uniform(-0.3, 1.3, 3) * (high - low)
            spot[2 * int(rng.integers(2))] = high[0] + 0.2 * height if rng.random() < 0.5 else low[0] - 0.2 * height
            points = points * height * rng.uniform(0.2, 0.7) @ _rotation(rng, rng.normal(size=3)).T + spot
            out = out.carried(_thing((points, faces), "ground", UNKNOWN, rng, colored))
    return out


def fused(figure: Labelled, rng: np.random.Generator) -> Labelled:
    """One skin over all that touches, as image-to-3D programs make it."""
    a, b, c = (figure.vertices[figure.faces[:, corner]] for corner in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    count = 60_000
    chosen = np.searchsorted(np.cumsum(area), rng.random(count) * area.sum()).clip(0, len(area) - 1)
    r, s = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    points = (1 - r) * a[chosen] + r * (1 - s) * b[chosen] + r * s * c[chosen]
    extent = float(np.ptp(points, axis=0).max())
    most = int(np.sqrt(count / (8 * max(area.sum() / extent**2, 1e-9))))
    vertices, faces = _fused_mesh(points, min(int(rng.integers(48, 110)), most))
    return figure.on(np.asarray(vertices, np.float64), np.asarray(faces, np.int64))


def _fused_mesh(points: np.ndarray, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """The skin of what points enclose: vertices, in the unit of the points, shape (V, 3), and faces (F, 3).

    Args:
        points: Points all over the surfaces of a figure, shape (N, 3); far more than it has voxels.
        cells: Voxels along the largest extent. What touches itself closer than one is one piece from then on.
    """
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    size = max(float(extent.max()), 1e-12) / cells
    low = low - _MARGIN * size
    grid = np.zeros(np.ceil(extent / size).astype(int) + 1 + 2 * _MARGIN, bool)
    grid[tuple(((points - low) / size).astype(int).T)] = True
    outside = label(~binary_closing(grid))[0]  # the margin is outside
    field = 0.5 - gaussian_filter((outside != outside[0, 0, 0]).astype(np.float64), 0.8)
    field = np.where(np.abs(field) < 1e-3, 1e-3, field)
    return grid_surface(field, size, low + 0.5 * size)
