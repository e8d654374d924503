"""How deep points are in a body, in any pose, at a few operations a point.

The signed distance from the body in the rest pose is kept on a grid. A point of a pose is taken back to the rest pose
by the transform of the body that is nearest to it, which is exact where the body is rigid and good to a millimetre or
two where it bends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b

import numpy as np
from scipy.ndimage import distance_transform_edt, label, maximum_filter, minimum_filter

from bunraku.apparel.body_volume import BodyVolume
from bunraku.geometry.closest import surface_distances
from bunraku.geometry.rotations import adjugates
from bunraku.geometry.subdivision import split_long_edges
from bunraku.geometry.winding import winding_numbers

__all__ = ["BodyDepth", "Unposed", "body_depth"]

CELL = 0.015
"""Of the grid, over the character's size [m]."""
BAND = 0.09
"""Distances beyond this are as good as this, over the character's size [m]."""
_MOST_CELLS = 2_000_000
_FACES = 6_000
OUTSIDE = 2.5
"""Cells from the body beyond which distances outside of it are good to a cell or two: nothing asks for more there."""
_ROUGH = 1.5  # how far a surface may be from the cells of its triangles' middles [cells]
CLOSE = 1.0  # cells from the surface within which every point is asked whether it is inside
_KEPT = 3
"""Grids of the last bodies; one takes up to 8 MB."""


@dataclass(frozen=True, eq=False)
class Unposed:
    """The way back to the rest pose for M points of a frame: `back @ (x - shift)`.

    Args:
        back: Shape (M, 3, 3).
        shift: [m], shape (M, 3).
        joint: The joint that holds the body there, shape (M,).
    """

    back: np.ndarray
    shift: np.ndarray
    joint: np.ndarray

    @classmethod
    def of(cls, blend: np.ndarray, joint: np.ndarray) -> Unposed:
        """From the affine transforms of the body nearest to each point, shape (M, 3, 4), and the joints of it (M,)."""
        turn = blend[..., :3]
        other = adjugates(turn)
        volume = (turn[:, 0] * other[:, :, 0]).sum(axis=-1)
        return cls(other / np.where(np.abs(volume) > 0.05, volume, 1.0)[:, None, None], blend[..., 3], joint)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Points of the pose in the rest pose [m], shape (M, 3)."""
        return self.columns(points).T

    def columns(self, points: np.ndarray) -> np.ndarray:
        """The same, one row for each axis, shape (3, M)."""
        return np.asarray(np.einsum("mab,mb->am", self.back, points - self.shift))

    def take(self, rows: np.ndarray) -> Unposed:
        """The same for some of the points, or for others that go with them."""
        return Unposed(self.back.take(rows, axis=0), self.shift.take(rows, axis=0), self.joint.take(rows))


@dataclass(frozen=True, eq=False)
class BodyDepth:
    """The signed distance from a body in its rest pose, above 0 outside.

    Args:
        low: Where the grid begins [m], shape (3,).
        cell: Width of a cell [m].
        values: Distances at its corners [m], shape (X, Y, Z), float32.
    """

    low: np.ndarray
    cell: float
    values: np.ndarray

    @cached_property
    def _least(self) -> np.ndarray:
        """The least value at the corners of the cell that begins at each corner, flat: nothing in it is below that."""
        out = self.values
        for axis in range(3):
            turned = np.moveaxis(out, axis, 0)
            out = np.moveaxis(np.concatenate([np.minimum(turned[:-1], turned[1:]), turned[-1:]]), 0, axis)
        return np.asarray(out.reshape(-1))

    @cached_property
    def _steps(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """How far apart in the flat grid neighbours along each axis are, and the eight corners of a cell; and the last
        position in the grid [cells].
        """
        shape = np.array(self.values.shape)
        steps = np.array([shape[1] * shape[2], shape[2], 1])
        return steps, _CORNERS @ steps, (shape - 1.001).astype(np.float32)[:, None]

    def at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance of points of the rest pose [m], shape (M,), and its gradient, shape (M, 3): linear within a cell."""
        return self._linear(*self._cells(points.T))

    def _cells(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The first corner of the cells that points (3, M) lie in, shape (M,), and where in them along each axis, from
        0 to 1, shape (3, M).
        """
        position = (points - self.low[:, None]).astype(np.float32, copy=False)
        position /= np.float32(self.cell)
        np.maximum(position, 0, out=position)
        np.minimum(position, self._steps[2], out=position)
        first = position.astype(np.int64)
        position -= first
        x, y, z = first
        steps = self._steps[0]
        return x * steps[0] + y * steps[1] + z, position

    def _linear(self, corner: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance and gradient at positions in cells, as `_cells` gives them."""
        v = self.values.reshape(-1)[self._steps[1][:, None] + corner]
        x, y, z = share
        # along z, then y, then x
        dz = v[1::2] - v[::2]
        vz = v[::2] + z * dz
        dy, dzy = vz[1::2] - vz[::2], dz[::2] + y * (dz[1::2] - dz[::2])
        vy = vz[::2] + y * dy
        dx = vy[1] - vy[0]
        slope = np.stack([dx, dy[0] + x * (dy[1] - dy[0]), dzy[0] + x * (dzy[1] - dzy[0])], axis=1)
        return vy[0] + x * dx, slope / np.float32(self.cell)

    def push(self, points: np.ndarray, unposed: Unposed, gap: np.ndarray, most: float) -> tuple[np.ndarray, np.ndarray]:
        """What moves points of a pose out of the body until they are as far from it as `gap`: which points are moved,
        shape (P,), and by how much [m], shape (P, 3).

        Args:
            points: [m], shape (M, 3).
            unposed: Their way back.
            gap: [m], below 0 where a point may be inside, shape (M,).
            most: Points that would move by more stay: they are on the wrong side of something thin [m].
        """
        corner, share = self._cells(unposed.columns(points))
        # mostly few are near, and only of them all corners are looked at
        rows = np.flatnonzero(self._least[corner] < gap)
        if not len(rows):
            return rows, np.zeros((0, 3), np.float32)
        distance, slope = self._linear(corner[rows], share[:, rows])
        step = gap[rows] - distance
        moved = np.flatnonzero((step > 0) & (step < most))
        rows = rows[moved]
        shift = np.einsum("mba,mb->ma", unposed.back[rows], slope[moved])
        length = np.maximum(np.einsum("ma,ma->m", shift, shift), 0.1)
        return rows, (step[moved] / length)[:, None] * shift

    def pushed(self, points: np.ndarray, unposed: Unposed, gap: np.ndarray, most: float) -> np.ndarray:
        """Points moved out of the body, shape (M, 3); what is given as in `push`."""
        rows, step = self.push(points, unposed, gap, most)
        out = np.array(points)
        out[rows] += step
        return out


_grids: dict[bytes, BodyDepth] = {}
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])


def body_depth(
    vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray, apparel: np.ndarray, scale: float = 1.0
) -> BodyDepth | None:
    """The grid of a character's body; None where all of it is apparel. Those of the last bodies are kept: apparel that
    is made anew is of the same body.

    Args:
        vertices: Rest mesh [m], shape (V, 3).
        faces: Shape (F, 3).
        weights: For the 22 joints, shape (V, 22).
        apparel: Its mask, shape (V,), bool.
        scale: The clothed's size.
    """
    if not len(faces[~apparel[faces].any(axis=1)]):
        return None
    arrays = (vertices, faces, weights, apparel, np.array(scale))
    key = b"".join(blake2b(part.tobytes(), digest_size=16).digest() for part in arrays)
    grid = _grids.get(key)
    if grid is None:
        grid = _grid(vertices, faces, weights, apparel, scale)
        while len(_grids) >= _KEPT:
            _grids.pop(next(iter(_grids)), None)
        _grids[key] = grid
    return grid


def _grid(vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray, apparel: np.ndarray, scale: float) -> BodyDepth:
    volume = BodyVolume.of_mesh(vertices, faces, weights, apparel, "the mesh", _FACES)
    band = BAND * scale
    low = volume.rest.min(axis=0) - band
    extent = volume.rest.max(axis=0) + band - low
    cell = max(CELL * scale, float(np.cbrt(np.prod(extent) / _MOST_CELLS)))
    shape = tuple(int(count) for count in np.ceil(extent / cell).astype(np.int64) + 1)
    corners = np.stack(np.meshgrid(*(np.arange(count) for count in shape), indexing="ij"), axis=-1)
    points = low + cell * corners.reshape(-1, 3)
    rest, triangles, _ = split_long_edges(np.asarray(volume.rest, np.float64), np.asarray(volume.faces, np.int64), cell)
    bare = np.ones(shape, bool)
    middle = np.round((rest[triangles].mean(axis=1) - low) / cell).astype(np.int64)
    bare[tuple(np.clip(middle, 0, np.array(shape) - 1).T)] = False
    # what lies farther than this from the cells of all middles is farther than `OUTSIDE` from all faces
    about = distance_transform_edt(bare).reshape(-1)
    some = about <= OUTSIDE + _ROUGH
    gap = np.where(about * cell <= band, about * cell, np.inf)
    gap[some] = surface_distances(points[some], rest, triangles, cell, np.inf)
    inside = _inside(points, gap, cell, shape, volume)
    # far outside it does not matter how far
    some = inside & ~some & np.isfinite(gap)
    gap[some] = surface_distances(points[some], rest, triangles, cell, np.inf)
    near = np.isfinite(gap)
    out = np.full(len(points), band, np.float32)
    out[near] = np.minimum(gap[near], band) * np.where(inside[near], -1, 1)
    # what is far from all faces is inside or outside as a whole
    regions, count = label(~near.reshape(shape))
    regions = regions.reshape(-1)
    if count:
        first = np.array([np.flatnonzero(regions == number + 1)[0] for number in range(count)])
        deep = np.abs(winding_numbers(points[first], volume.rest, volume.faces)) > 0.5
        out[np.isin(regions, np.flatnonzero(deep) + 1)] = -band
    return BodyDepth(low.astype(np.float32), float(cell), out.reshape(shape))


def _inside(points: np.ndarray, gap: np.ndarray, cell: float, shape: tuple[int, ...], volume: BodyVolume) -> np.ndarray:
    """Whether the points of a grid that are near the body are in it, shape (P,), by winding numbers. These jump at the
    surface and are smooth elsewhere: of what is not close to it every second point is asked first, and the others where
    those about them differ.

    Args:
        points: Shape (P, 3), of a grid of this shape.
        gap: How far they are from the surface; infinite where that does not matter, shape (P,).
        cell: Of the grid.
        volume: The body.
    """
    near, close = np.isfinite(gap).reshape(shape), (gap < CLOSE * cell).reshape(shape)
    every = np.zeros(shape, bool)
    every[::2, ::2, ::2] = True
    known = near & (close | every)
    inside = np.zeros(shape, bool)
    inside[known] = np.abs(winding_numbers(points[known.reshape(-1)], volume.rest, volume.faces)) > 0.5
    asked = known & every
    most, least = (filter(np.where(asked, inside, blank), size=3)
                   for filter, blank in ((maximum_filter, False), (minimum_filter, True)))  # fmt: skip
    alike = (most == least) & maximum_filter(asked, size=3)
    inside = np.where(known, inside, most & alike)
    rest = near & ~known & ~alike
    if rest.any():
        inside[rest] = np.abs(winding_numbers(points[rest.reshape(-1)], volume.rest, volume.faces)) > 0.5
    return np.asarray(inside.reshape(-1))
