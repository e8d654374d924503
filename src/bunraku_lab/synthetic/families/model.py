"""A character in the making: bones, parts with their shares, and how the parts become one mesh or many."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TypeVar

import numpy as np

from bunraku.core.character import Character, Rig, top_influences
from bunraku.core.geometry.surface import vertex_normals
from bunraku_lab.synthetic.fields import Lump, ball, bar, marched, neighbour_average
from bunraku_lab.synthetic.surfaces import sheet_faces, unit

Mesh = tuple[np.ndarray, np.ndarray]


@lru_cache(maxsize=64)
def _cube(around: int, rows: int) -> Mesh:
    """The surface of the cube [-1, 1]^3 as a grid with `rows` cells along Y and `around` along X and Z."""
    vertices, faces, start = [], [], 0
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        steps = [np.linspace(-1, 1, (rows if i == 1 else around) + 1) for i in (b, c)]
        for sign in (-1, 1):
            grid = np.zeros((len(steps[0]), len(steps[1]), 3))
            grid[..., axis], grid[..., b], grid[..., c] = sign, steps[0][:, None], steps[1][None]
            index = start + np.arange(grid[..., 0].size).reshape(grid.shape[:2])
            quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], -1).reshape(-1, 4)[
                :, ::sign
            ]
            vertices.append(grid.reshape(-1, 3))
            faces += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
            start += index.size
    points, where = np.unique(np.round(np.concatenate(vertices), 6), axis=0, return_inverse=True)
    return points, where.reshape(-1)[np.concatenate(faces)]


def block_mesh(lump: Lump, exponent: float = 2.0, cells: int = 4, cap: float = 1.0) -> Mesh:
    """One lump as a closed mesh of its own.

    Args:
        lump: The lump.
        exponent: Roundness of its section: 2 is an ellipse, 20 a box with sharp edges.
        cells: Cells of the grid across each side.
        cap: How far the ends reach past the axis, over the radius.
    """
    axis = lump.end - lump.start
    length = float(np.linalg.norm(axis))
    turn = np.eye(3) if lump.turn is None else lump.turn
    stretch = np.ones(3) if lump.stretch is None else lump.stretch
    if length < 1e-9:
        points, faces = _cube(cells, cells)
        unit = points / (np.abs(points) ** exponent).sum(axis=1, keepdims=True) ** (1 / exponent)
        size = lump.radii[0] * stretch * (0.9 if exponent > 4 else 1.0)
        return lump.start + (unit * size) @ turn.T, faces
    along = axis / length
    side = np.eye(3)[0] if abs(along[0]) < 0.8 else np.eye(3)[2]
    side = side - (side @ along) * along
    side /= np.linalg.norm(side)
    frame = np.stack([side, along, np.cross(side, along)], axis=1)
    bent = (turn * stretch) @ turn.T
    across = np.array([np.linalg.norm(bent @ frame[:, 0]), 1.0, np.linalg.norm(bent @ frame[:, 2])])
    first, last = (radius * cap * float(np.linalg.norm(bent @ along)) for radius in lump.radii)
    points, faces = _cube(
        cells,
        max(cells, min(3 * cells, round(cells * (length + first + last) / (2.5 * max(lump.radii) * across.max())))),
    )
    position = -first + 0.5 * (points[:, 1] + 1) * (length + first + last)
    share = np.clip(position / length, 0, 1)
    radius = lump.radii[0] + share * (lump.radii[1] - lump.radii[0])
    past = np.where(
        position < 0,
        position / max(first, 1e-9),
        np.where(position > length, (position - length) / max(last, 1e-9), 0.0),
    )
    unit = np.stack([points[:, 0], past, points[:, 2]], axis=1)
    unit /= np.maximum((np.abs(unit) ** exponent).sum(axis=1, keepdims=True) ** (1 / exponent), 1e-9)
    end = np.where(past < 0, first, last)
    local = np.stack(
        [unit[:, 0] * radius * across[0], share * length + unit[:, 1] * end, unit[:, 2] * radius * across[2]], axis=1
    )
    return lump.start + local @ frame.T, faces


def melted_mesh(lumps: Sequence[Lump], count: int) -> Mesh:
    """The skin around lumps melted into each other, by marching cubes, with about `count` vertices."""
    solid = [lump for lump in lumps if not lump.carve]
    area = 0.0
    for lump in solid:
        mean, length = float(np.mean(lump.radii)), float(np.linalg.norm(lump.end - lump.start))
        size = mean * (np.ones(3) if lump.stretch is None else lump.stretch)
        area += (
            4.2 * float(np.prod(size) ** (1 / 3) * size.max()) * 3 + 6.3 * mean * float(np.median(size) / mean) * length
        )
    thinnest = min(max(lump.radii) * (1.0 if lump.stretch is None else float(np.min(lump.stretch))) for lump in solid)
    spacing = float(np.sqrt(0.9 * area / count))
    spacing = min(spacing, max(0.8 * thinnest, 0.45 * spacing))
    return marched(lumps, spacing)


def thinned(mesh: Mesh, faces: int) -> Mesh:
    """The mesh with at most this many faces, for the look of low-polygon models."""
    import fast_simplification

    if len(mesh[1]) <= faces:
        return mesh
    points, triangles = fast_simplification.simplify(
        mesh[0].astype(np.float32), mesh[1].astype(np.int32), 1 - faces / len(mesh[1])
    )
    return np.asarray(points, float), np.asarray(triangles, np.int64)


def sheet_mesh(grid: np.ndarray, thickness: float = 0.0, wrap: bool = False) -> Mesh:
    """A sheet through a grid of points, such as a skirt, a cape, a wing or a fin.

    Args:
        grid: Points, shape (R, S, 3).
        thickness: Distance of its two sides [m]; 0 gives one open layer.
        wrap: The last column joins the first.
    """
    rows, columns = grid.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    if wrap:
        index = np.concatenate([index, index[:, :1]], axis=1)
    faces = sheet_faces(rows, columns, wrap)
    points = grid.reshape(-1, 3)
    if thickness <= 0:
        return points, faces
    normal = unit(vertex_normals(points, faces, unit=False))  # where the sheet ends in a point it has no thickness
    count = len(points)
    rim = [index[0], index[-1][::-1]] + ([] if wrap else [index[::-1, 0], index[:, -1]])
    walls = [faces, faces[:, ::-1] + count]
    for line in rim:
        a, b = line[:-1], line[1:]
        walls += [np.stack([a, b, b + count], 1), np.stack([a, b + count, a + count], 1)]
    return np.concatenate([points + 0.5 * thickness * normal, points - 0.5 * thickness * normal]), np.concatenate(walls)


SIDES = (("Left", 1.0), ("Right", -1.0))
T = TypeVar("T")
Vector = Sequence[float] | np.ndarray


@dataclass(frozen=True)
class Chain:
    """Joints along a line: each moves what lies between its position and that of the next.

    Args:
        joints: Joint names, length N.
        points: Their positions [m], length N; the first also takes what lies before it.
        blur: Factor on the width of the passage from one joint to the next.
    """

    joints: Sequence[str]
    points: Sequence[Vector]
    blur: float = 1.0

    def weights(self, points: np.ndarray, soft: float) -> dict[str, np.ndarray]:
        """Share of each joint at points (M, 3); `soft` is the half width of a passage [m]."""
        knots = np.asarray(self.points, float)
        if len(knots) == 1:
            return {self.joints[0]: np.ones(len(points))}
        steps = np.diff(knots, axis=0)
        lengths = np.linalg.norm(steps, axis=1) + 1e-9
        starts = np.concatenate([[0], np.cumsum(lengths)])
        best, position = np.full(len(points), np.inf), np.zeros(len(points))
        for i, step in enumerate(steps):
            along = (points - knots[i]) @ step / lengths[i] ** 2
            along = np.clip(along, -9 if i == 0 else 0, 9 if i == len(steps) - 1 else 1)
            far = np.linalg.norm(points - knots[i] - along[:, None] * step, axis=1)
            better = far < best
            best[better], position[better] = far[better], (starts[i] + along * lengths[i])[better]
        width = np.maximum(soft * self.blur, 1e-6)
        passed = [np.ones(len(points))] + [
            1 / (1 + np.exp(-np.clip(2.5 * (position - s) / width, -40, 40))) for s in starts[1:]
        ]
        passed.append(np.zeros(len(points)))
        out: dict[str, np.ndarray] = {}
        for name, now, after in zip(self.joints, passed[:-1], passed[1:], strict=True):
            out[name] = out.get(name, 0) + now - after
        return out


Share = str | Chain | Callable[[np.ndarray], Mapping[str, np.ndarray]]


@dataclass(frozen=True)
class Style:
    """How the parts of one character become a mesh.

    Args:
        mode: "clay" melts the body into one skin, "regions" does so limb by limb, "pieces" closes every part.
        exponent: Roundness of pieces (`block_mesh`).
        cells: Cells across a piece.
        cap: How far pieces reach past their joints, over their radius.
        soft: Half the width over which weights pass from joint to joint, over the size; 0 for rigid parts.
        melt: Factor on the widths over which lumps melt into each other.
        faces: Faces of the body after thinning; None for all.
        detail: Vertices of the body.
        thick: Whether sheets have two sides.
        gap: How much shorter each piece is than its bone, as a share; parts of robots and toys float.
        fuse: Whether loose parts melt into the body too, as in scanned and generated meshes.
        smoothing: Rounds of averaging the weights over neighbours.
    """

    mode: str = "clay"
    exponent: float = 2.0
    cells: int = 4
    cap: float = 1.0
    soft: float = 0.02
    melt: float = 1.0
    faces: int | None = None
    detail: int = 3000
    thick: bool = True
    gap: float = 0.0
    fuse: bool = False
    smoothing: int = 2


@dataclass(frozen=True)
class _Part:
    shape: Lump | Mesh
    share: Share
    region: str
    loose: bool


class Model:
    """Collects the bones and parts of one character.

    Args:
        rng: Source of all choices.
        style: How its parts become a mesh; drawn at random where it is None.
    """

    def __init__(self, rng: np.random.Generator, style: Style | None = None):
        self.rng = rng
        self.style = style or self._style()
        self.bones: dict[str, tuple[str, np.ndarray]] = {}
        self.parts: list[_Part] = []

    def u(self, low: float, high: float) -> float:
        """A number between two."""
        return float(self.rng.uniform(low, high))

    def chance(self, share: float) -> bool:
        """True in this share of the cases."""
        return bool(self.rng.random() < share)

    def pick(self, *choices: T, weights: Sequence[float] | None = None) -> T:
        """One of the choices."""
        p = None if weights is None else np.asarray(weights, float) / np.sum(weights)
        return choices[int(self.rng.choice(len(choices), p=p))]

    def _style(self) -> Style:
        mode = self.pick("clay", "regions", "pieces", weights=(0.42, 0.28, 0.30))
        rigid = self.chance(0.2 if mode == "clay" else 0.35)
        return Style(
            mode=mode,
            exponent=float(np.exp(self.u(np.log(2), np.log(5)))) if self.chance(0.35) else 2.0,
            cells=int(self.rng.integers(2, 6)),
            cap=self.u(0.6, 1.0),
            soft=0.0 if rigid else float(np.exp(self.u(np.log(0.004), np.log(0.04)))),
            melt=self.u(0.3, 1.6),
            faces=int(np.exp(self.u(np.log(600), np.log(3000)))) if self.chance(0.45) else None,
            detail=int(self.u(1800, 4000)),
            thick=self.chance(0.65),
            gap=self.u(0.05, 0.3) if self.chance(0.15) else 0.0,
            fuse=self.chance(0.3),
            smoothing=0 if rigid else int(self.rng.integers(0, 5)),
        )

    def restyle(self, **changes: object) -> None:
        """Change the style."""
        self.style = replace(self.style, **changes)  # type: ignore[arg-type]

    def bone(self, name: str, parent: str, at: Vector) -> np.ndarray:
        """Add a bone and return its position."""
        self.bones[name] = (parent, np.asarray(at, float))
        return self.bones[name][1]

    def bones_along(self, names: Sequence[str], positions: Iterable[Vector], parent: str = "") -> None:
        """Add a chain of bones, each the parent of the next one."""
        for name, above, at in zip(names, [parent, *names], positions, strict=False):
            self.bone(name, above, at)

    def at(self, name: str) -> np.ndarray:
        """Position of a bone [m], shape (3,)."""
        return self.bones[name][1]

    def limb(self, points: Sequence[Vector], radii: Sequence[float], share: Share | Sequence[str], region: str, *,
    loose: bool = False,
             stretch: Vector | None = None, turn: np.ndarray | None = None, blend: float = 0.35) -> None:  # fmt: skip
        """Bars from point to point; the shares are one for all or one for each bar."""
        shares: list[Share] = (
            [share] * (len(points) - 1) if isinstance(share, (str, Chain)) or callable(share) else list(share)
        )
        for i, one in enumerate(shares):
            width = blend * self.style.melt * min(radii[i], radii[i + 1])
            lump = bar(points[i], points[i + 1], (radii[i], radii[i + 1]), stretch=stretch, turn=turn, blend=width)
            self.parts.append(_Part(lump, one, region, loose))

    def lump(self, centre: Vector, radii: float | Vector, share: Share, region: str, *, loose: bool = False,
    turn: np.ndarray | None = None,
             blend: float = 0.35) -> None:  # fmt: skip
        """An ellipsoid."""
        width = blend * self.style.melt * float(np.min(radii))
        self.parts.append(_Part(ball(centre, radii, turn=turn, blend=width), share, region, loose))

    def block(
        self, centre: Vector, half: Vector, share: Share, region: str, turn: np.ndarray | None = None,
        exponent: float = 8.0,
    ) -> None:  # fmt: skip
        """A loose box with rounded edges; `half` are half its edge lengths [m]."""
        self.mesh(block_mesh(ball(centre, half, turn=turn), exponent, max(self.style.cells, 3)), share, region)

    def mesh(self, mesh: Mesh, share: Share, region: str) -> None:
        """A loose mesh."""
        self.parts.append(_Part(mesh, share, region, True))

    def sheet(self, grid: np.ndarray, share: Share, region: str, thickness: float = 0.008, wrap: bool = False) -> None:
        """A sheet through a grid of points (R, S, 3)."""
        self.mesh(sheet_mesh(grid, thickness if self.style.thick else 0.0, wrap), share, region)

    def _shares(self, share: Share, points: np.ndarray, soft: float) -> np.ndarray:
        names = list(self.bones)
        out = np.zeros((len(points), len(names)))
        if isinstance(share, str):
            out[:, names.index(share)] = 1
            return out
        found = share.weights(points, soft) if isinstance(share, Chain) else share(points)
        for name, values in found.items():
            out[:, names.index(name)] += values
        return out / np.maximum(out.sum(axis=1, keepdims=True), 1e-9)

    def _weigh(self, mesh: Mesh, parts: Sequence[_Part], soft: float, own: int | None) -> np.ndarray:
        """Weights of a mesh made of lumps: each vertex goes with the lumps that it is nearest to."""
        points, faces = mesh
        x, y, z = np.ascontiguousarray(points.T)
        distance = np.stack([part.shape.distance(x, y, z) for part in parts if isinstance(part.shape, Lump)], axis=1)
        if own is not None:
            distance[:, own] -= 2 * soft
        distance -= distance.min(axis=1, keepdims=True)
        near = np.exp(-distance / max(0.6 * soft, 1e-5))
        near /= near.sum(axis=1, keepdims=True)
        weights = np.zeros((len(points), len(self.bones)))
        for i, part in enumerate(parts):
            used = near[:, i] > 1e-3
            weights[used] += near[used, i, None] * self._shares(part.share, points[used], soft)
        if self.style.smoothing and soft > 0:
            average = neighbour_average(len(points), faces)
            for _ in range(self.style.smoothing):
                weights = 0.5 * weights + 0.5 * (average @ weights)
        return weights

    def _meshes(self, size: float) -> list[tuple[Mesh, np.ndarray]]:
        style, soft = self.style, self.style.soft * size
        groups: dict[str, list[_Part]] = {}
        out: list[tuple[Mesh, np.ndarray]] = []
        for part in self.parts:
            if isinstance(part.shape, Lump):
                apart = part.loose and not (style.fuse and style.mode != "pieces")
                key = f"loose {part.region}" if apart else "body" if style.mode == "clay" else part.region
                groups.setdefault(key, []).append(part)
            else:
                out.append((part.shape, self._shares(part.share, part.shape[0], soft)))
        whole = sum(len(parts) for parts in groups.values())
        for parts in groups.values():
            lumps = [part.shape for part in parts if isinstance(part.shape, Lump)]
            if style.mode == "pieces":
                for own, lump in enumerate(lumps):
                    if lump.carve:
                        continue
                    short = 0.5 * style.gap * (lump.end - lump.start)
                    mesh = block_mesh(
                        replace(lump, start=lump.start + short, end=lump.end - short), style.exponent, style.cells,
                        style.cap,
                    )  # fmt: skip
                    near = parts if soft > 0 else [parts[own]]
                    out.append((mesh, self._weigh(mesh, near, soft, own if soft > 0 else None)))
                continue
            share = max(len(parts) / whole, 0.06)
            mesh = melted_mesh(lumps, int(style.detail * share))
            if style.faces is not None:
                mesh = thinned(mesh, max(int(style.faces * share), 24))
            out.append((mesh, self._weigh(mesh, parts, soft, None)))
        return out

    def _bend(self, size: float, middle: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """A smooth random warp of space, so that no two parts, and no two sides, are the same."""
        count, most = 4, float(self.rng.choice([0.0, 0.006, 0.012]))
        wave = self.rng.normal(size=(count, 3)) * 4 / size
        phase, shift = self.rng.uniform(0, 6.28, count), self.rng.normal(size=(count, 3)) * most * size
        even = self.chance(0.6)

        def warp(points: np.ndarray) -> np.ndarray:
            position = points - middle
            if even:
                position = position * [0, 1, 1]
            move = np.sin(position @ wave.T + phase) @ shift
            return points + (move * [0, 1, 1] if even else move)

        return warp

    def character(self, name: str) -> Character:
        """The finished character, set on y = 0."""
        low = np.min([part.shape.start for part in self.parts if isinstance(part.shape, Lump)], axis=0)
        high = np.max([part.shape.end for part in self.parts if isinstance(part.shape, Lump)], axis=0)
        size = float((high - low).max())
        made = self._meshes(size)
        warp = self._bend(size, (low + high) / 2)
        vertices = warp(np.concatenate([mesh[0] for mesh, _ in made]))
        starts = np.cumsum([0] + [len(mesh[0]) for mesh, _ in made[:-1]])
        faces = np.concatenate([mesh[1] + start for (mesh, _), start in zip(made, starts, strict=True)])
        weights = np.concatenate([weights for _, weights in made])
        weights = np.where(weights < 0.01 * weights.max(axis=1, keepdims=True), 0, weights)
        tints = np.clip(self.rng.normal(165, 45, (len(made), 3)), 40, 245).astype(np.uint8)
        colors = np.repeat(tints, [len(mesh[0]) for mesh, _ in made], axis=0)
        drop = np.array([0, vertices[:, 1].min(), 0])
        names = tuple(self.bones)
        transforms = np.tile(np.eye(4), (len(names), 1, 1))
        transforms[:, :3, 3] = warp(np.stack([self.bones[n][1] for n in names])) - drop
        parents = np.array([names.index(self.bones[n][0]) if self.bones[n][0] else -1 for n in names])
        rig = Rig(names, parents, transforms, *top_influences(weights, 4))
        return Character(name, vertices - drop, faces, rig, colors)
