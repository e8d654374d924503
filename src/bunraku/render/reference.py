"""The loops of the renderer in numpy: readable versions of `kernels.c`, which draw where that is not compiled."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

# Four samples a pixel on a rotated grid, as the standard pattern of Direct3D places them.
SAMPLES = ((0.375, 0.125), (0.875, 0.375), (0.125, 0.625), (0.625, 0.875))
LINE_WIDTH = 0.016
"""Thickness of a grid line as a share of the grid's spacing. Chosen by eye."""
EDGE = 1e-6
"""A face covers a sample this far beyond its edge, as a share of the face, so that neighbours leave no gap."""
PAIRS = 1 << 19
"""Pairs of a face and a pixel that are processed together."""


def measure(vertices: np.ndarray, axes: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (2, 3) of vertices (V, 3), and the four support values that `Framing` needs."""
    x, y, z = axes @ vertices.T.astype(np.float64)
    support = [
        (x + slopes[0] * z).max(), (x - slopes[0] * z).min(), (y + slopes[1] * z).max(), (y - slopes[2] * z).min()
    ]  # fmt: skip
    return np.stack([vertices.min(axis=0), vertices.max(axis=0)]), np.array(support)


def accumulate_normals(vertices: np.ndarray, faces: np.ndarray, clusters: np.ndarray, count: int) -> np.ndarray:
    """Unit normals (count, 3) of the smooth clusters: area-weighted sums over the faces with corners in them."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    normals = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    summed = np.stack([np.bincount(clusters.ravel(), normals[:, i], count) for i in range(3)], axis=1)
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    return np.where(length > 0, summed / np.maximum(length, 1e-300), (0, 1, 0)).astype(np.float32)


def project(points: np.ndarray, axes: np.ndarray, eye: np.ndarray, focal: float, width: int, height: int) -> np.ndarray:
    """Column, row and inverse distance of each point, shape (P, 3), float32; inverse distance 0 is behind the eye."""
    local = (points - eye) @ axes.T
    seen = -local[:, 2] > 1e-6
    near = np.where(seen, 1 / np.where(seen, -local[:, 2], 1), 0)
    at = np.stack([0.5 * width + focal * local[:, 0] * near, 0.5 * height - focal * local[:, 1] * near, near], axis=1)
    return np.where(seen[:, None], at, 0).astype(np.float32)


def _pairs(first: np.ndarray, last: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Each face with each pixel of its box, lowest to highest column and row (F, 2), in chunks: face, column, row."""
    sides = np.maximum(last - first + 1, 0)
    counts = sides[:, 0] * sides[:, 1]
    ends = np.cumsum(counts)
    start = 0
    while start < (ends[-1] if len(ends) else 0):
        stop = min(start + PAIRS, int(ends[-1]))
        pair = np.arange(start, stop)
        face = np.searchsorted(ends, pair, side="right")
        inside = pair - (ends[face] - counts[face])
        yield face, first[face, 0] + inside % sides[face, 0], first[face, 1] + inside // sides[face, 0]
        start = stop


def rasterise(screen: np.ndarray, faces: np.ndarray, depth: np.ndarray, ids: np.ndarray) -> tuple[int, int, int, int]:
    """Write the nearest face of each sample to `ids` and its inverse distance to `depth`, both (H, W, 4), and return
    the rectangle that holds all of them: first column and row, and those after the last.
    """
    height, width = depth.shape[:2]
    near, nearest = depth.reshape(-1), ids.reshape(-1)
    corners = screen[faces].astype(np.float64)
    ab, ac = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    low, high = corners[:, :, :2].min(axis=1) + 0.125, corners[:, :, :2].max(axis=1) - 0.125
    seen = (corners[:, :, 2] > 0).all(axis=1) & (area != 0)
    seen &= (high >= 0).all(axis=1) & (low < (width + 0.125, height + 0.125)).all(axis=1)
    kept = np.flatnonzero(seen)
    first = np.maximum(low[kept], 0).astype(np.int64)
    last = np.minimum(high[kept], (width - 1, height - 1)).astype(np.int64)
    visible = (last >= first).all(axis=1)
    kept, first, last = kept[visible], first[visible], last[visible]
    if not len(kept):
        return width, height, 0, 0
    for index, x, y in _pairs(first, last):
        face = kept[index]
        (ax, ay, za), (bx, by), (cx, cy) = corners[face, 0].T, ab[face].T, ac[face].T
        zb, zc = corners[face, 1, 2] - za, corners[face, 2, 2] - za
        for s, (right, down) in enumerate(SAMPLES):
            px, py = x + right - ax, y + down - ay
            u, v = (cy * px - cx * py) / area[face], (bx * py - by * px) / area[face]
            z = (za + u * zb + v * zc).astype(np.float32)
            at = 4 * (y * width + x) + s
            covers = (u >= -EDGE) & (v >= -EDGE) & (u + v <= 1 + EDGE) & (z > near[at])
            at, z = at[covers], z[covers]
            np.maximum.at(near, at, z)
            won = np.flatnonzero(near[at] == z)[::-1]  # of equally near faces the first one is drawn
            nearest[at[won]] = face[covers][won]
    (left, top), (right_, bottom) = first.min(axis=0).tolist(), (last.max(axis=0) + 1).tolist()
    return left, top, right_, bottom


def drop_shadow(
    vertices: np.ndarray, faces: np.ndarray, slopes: tuple[float, float], ground: float, corner: tuple[float, float],
    texel: float, lowest: bool, heights: np.ndarray,
) -> None:  # fmt: skip
    """Project faces to the floor along (-slope x, -1, -slope z); keep the highest (or lowest) height of each texel (R,
    R) above the floor [m]. Texels that nothing covers keep their values.
    """
    size, kept = len(heights), heights.reshape(-1)
    points = vertices.astype(np.float64)
    height = points[:, 1] - ground
    floor = (points[:, [0, 2]] - height[:, None] * np.array(slopes) - np.array(corner)) / texel
    at, h = floor[faces], height[faces]
    ab, ac = at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    first = np.clip(np.ceil(at.min(axis=1) - 0.5), 0, size).astype(np.int64)
    last = np.clip(np.floor(at.max(axis=1) - 0.5), -1, size - 1).astype(np.int64)
    solid = np.flatnonzero((area != 0) & (last >= first).all(axis=1))
    for index, x, y in _pairs(first[solid], last[solid]):
        face = solid[index]
        (ax, ay), (bx, by), (cx, cy) = at[face, 0].T, ab[face].T, ac[face].T
        px, py = x + 0.5 - ax, y + 0.5 - ay
        u, v = (cy * px - cx * py) / area[face], (bx * py - by * px) / area[face]
        covers = (u >= 0) & (v >= 0) & (u + v <= 1)
        ha, hb, hc = h[face].T
        above = (ha + u * (hb - ha) + v * (hc - ha))[covers].astype(np.float32)
        where = (y * size + x)[covers]
        if lowest:
            np.minimum.at(kept, where, np.maximum(above, 0))
        else:
            np.maximum.at(kept, where, above)


def soften(image: np.ndarray, width: int) -> np.ndarray:
    """The mean over a square of odd width, for an image (R, R), float32, that is zero around."""
    from scipy.ndimage import uniform_filter

    out: np.ndarray = uniform_filter(image, width, mode="constant")
    return out


def _line(position: np.ndarray, cell: float, width: float, footprint: np.ndarray) -> np.ndarray:
    """Share of a pixel of this footprint that grid lines at multiples of `cell` cover."""
    distance = np.abs(position / cell - np.floor(position / cell + 0.5)) * cell
    footprint = np.maximum(footprint, 1e-9)
    near = (0.5 * (width + footprint) - distance) / np.minimum(width, footprint)
    share = np.clip(near, 0, 1) * np.minimum(1, width / footprint)
    out: np.ndarray = share + (width / cell - share) * np.clip(2.5 * footprint / cell - 0.5, 0, 1)
    return out


def rays(columns: np.ndarray, rows: np.ndarray, size: tuple[int, int], axes: np.ndarray, focal: float) -> np.ndarray:
    """Directions through the middles of pixels, shape (..., 3), one along the line of sight."""
    across, up = (columns + 0.5 - 0.5 * size[0]) / focal, (0.5 * size[1] - rows - 0.5) / focal
    out: np.ndarray = across[..., None] * axes[0] + up[..., None] * axes[1] - axes[2]
    return out


def draw_grid(
    floor: np.ndarray, offset: np.ndarray, cell: float, color: np.ndarray, base: np.ndarray, plain: np.ndarray
) -> None:
    """Draw the floor's lines, `cell` metres apart and of an sRGB colour 0..1 (3,), over a `Backdrop` without any: into
    its sRGB 0..1 (H, W, 3), float32, and into the uint8 version of it. `offset` is the position of the origin of its
    floor along x and z [m], shape (2,).
    """
    x, z, across, along, fade = np.moveaxis(floor.astype(np.float64), -1, 0)
    width = LINE_WIDTH * cell
    cover = fade * np.maximum(_line(x + offset[0], cell, width, across), _line(z + offset[1], cell, width, along))
    base += ((color - base) * cover[..., None]).astype(np.float32)
    plain[cover > 0] = (255 * base[cover > 0] + 0.5).astype(np.uint8)


def _bilinear(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    size = len(image)
    x, y = x - 0.5, y - 0.5
    inside = (x >= 0) & (y >= 0) & (x < size - 1) & (y < size - 1)
    x, y = np.where(inside, x, 0), np.where(inside, y, 0)
    i, j = x.astype(np.int64), y.astype(np.int64)
    fx, fy = x - i, y - j
    upper = image[j, i] + (image[j, i + 1] - image[j, i]) * fx
    lower = image[j + 1, i] + (image[j + 1, i + 1] - image[j + 1, i]) * fx
    return np.where(inside, upper + (lower - upper) * fy, 0)


def _occlusion(heights: np.ndarray, x: np.ndarray, y: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Share of 3 x 3 texels around (x, y) where something higher than `height` blocks the light."""
    size = len(heights)
    x, y = x - 0.5, y - 0.5
    inside = (x >= 1) & (y >= 1) & (x < size - 2) & (y < size - 2)
    x, y = np.where(inside, x, 1), np.where(inside, y, 1)
    i, j = x.astype(np.int64), y.astype(np.int64)
    total = np.zeros(len(x))
    ones = np.ones(len(x))
    for dj, wy in zip(range(-1, 3), (1 - (y - j), ones, ones, y - j), strict=True):
        for di, wx in zip(range(-1, 3), (1 - (x - i), ones, ones, x - i), strict=True):
            total += np.where(heights[j + dj, i + di] > height, wx * wy, 0)
    return np.where(inside, total / 9, 0)


class Drawn(NamedTuple):
    """A posed mesh: `screen` of `project`, faces (F, 3), and points [m], normals and linear colours (V, 3)."""

    screen: np.ndarray
    faces: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    colors: np.ndarray


class View(NamedTuple):
    """Axes of the camera (rows right, up, back), its position [m], and its focal length [pixels]."""

    axes: np.ndarray
    eye: np.ndarray
    focal: float


class Lighting(NamedTuple):
    """Height of the floor [m]; direction towards the key light; linear colours of the key light, the sky, the bounce
    from the floor and the rim, shape (4, 3); and the sRGB value of linear 0..2 in equal steps, highlights compressed.
    """

    ground: float
    light: np.ndarray
    lights: np.ndarray
    encode: np.ndarray


class ShadowMap(NamedTuple):
    """Maps of `Shadows`, the x and z of their corner, and the side of a texel [m]."""

    heights: np.ndarray
    floor: np.ndarray
    corner: tuple[float, float]
    texel: float


def shade(
    window: tuple[int, int, int, int],
    mesh: Drawn,
    view: View,
    lighting: Lighting,
    shadows: ShadowMap,
    ids: np.ndarray,
    base: np.ndarray,
    out: np.ndarray,
) -> None:
    """Shade the samples of a rectangle's pixels, once for each face, and average them into `out` (H, W, 3), uint8."""
    left, top, right, bottom = window
    if left >= right or top >= bottom:
        return
    screen, faces, points, normals, colors = mesh
    axes, eye, focal = view
    ground, light, lights, encode = lighting
    heights, floor_shadow, corner, texel = shadows
    size = (ids.shape[1], ids.shape[0])
    rows, columns = (side.ravel() for side in np.mgrid[top:bottom, left:right])
    face_ids = ids[rows, columns]
    tints = np.empty((len(rows), 4, 3))
    slopes = light[[0, 2]] / light[1]

    def on_map(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (at[:, 0] - corner[0]) / texel, (at[:, 1] - corner[1]) / texel

    def floor(pixel: np.ndarray) -> np.ndarray:
        ray = rays(columns[pixel], rows[pixel], size, axes, focal)
        down = ray[:, 1] < -1e-4
        t = np.where(down, (ground - eye[1]) / np.where(down, ray[:, 1], -1), 0)
        dark = _bilinear(floor_shadow, *on_map((eye + t[:, None] * ray)[:, [0, 2]]))
        shown: np.ndarray = base[rows[pixel], columns[pixel]] * (1 - np.where(t > 0, dark, 0))[:, None]
        return shown

    def character(pixel: np.ndarray, face: np.ndarray) -> np.ndarray:
        corners = faces[face]
        a, b, c = (screen[corners[:, i]].astype(np.float64) for i in range(3))
        (bx, by), (cx, cy) = (b - a)[:, :2].T, (c - a)[:, :2].T
        px, py = columns[pixel] + 0.5 - a[:, 0], rows[pixel] + 0.5 - a[:, 1]
        area = bx * cy - by * cx
        v = np.clip((cy * px - cx * py) / area, 0, 1)
        w = np.minimum(np.maximum((bx * py - by * px) / area, 0), 1 - v)
        share = np.stack([(1 - v - w) * a[:, 2], v * b[:, 2], w * c[:, 2]], axis=1)
        share /= share.sum(axis=1, keepdims=True)
        n, q, albedo = (np.einsum("pi,pij->pj", share, values[corners]) for values in (normals, points, colors))
        length = np.linalg.norm(n, axis=1)
        # Rows grow downwards, so a face turned to the viewer has a negative area here.
        n = n / np.where(length > 0, np.where(area < 0, length, -length), np.where(area < 0, 1, -1))[:, None]
        towards = (eye - q) / np.linalg.norm(eye - q, axis=1, keepdims=True)
        facing = n @ light
        # The bias grows where the light grazes the surface; lifting along the normal keeps creases clean.
        lifted = q + n * (texel * (1.5 + 2.5 * (1 - np.maximum(facing, 0))))[:, None]
        rise = lifted[:, 1] - ground
        hidden = _occlusion(heights, *on_map(lifted[:, [0, 2]] - rise[:, None] * slopes), rise + 1.5 * texel)
        key, sky = np.maximum((facing + 0.2) / 1.2, 0) * (1 - 0.7 * hidden), 0.5 + 0.5 * n[:, 1]
        rim = (1 - np.maximum(np.einsum("pi,pi->p", n, towards), 0)) ** 3 * sky
        half = (towards + light) / np.linalg.norm(towards + light, axis=1, keepdims=True)
        gloss = 0.05 * np.maximum(np.einsum("pi,pi->p", n, half), 0) ** 16 * (1 - hidden)
        value = albedo * (np.stack([key, sky, 1 - sky], axis=1) @ lights[:3]) + rim[:, None] * lights[3]
        value += gloss[:, None]
        shown: np.ndarray = encode[(np.clip(0.5 * value, 0, 1) * (len(encode) - 1) + 0.5).astype(np.int64)]
        return shown

    for s in range(4):
        face = face_ids[:, s]
        shared = np.full(len(rows), s)
        for e in range(s - 1, -1, -1):  # no crease parts faces that share a point: one shading serves both
            both = (face >= 0) & (face_ids[:, e] >= 0)
            touch = (faces[face][:, :, None] == faces[face_ids[:, e]][:, None, :]).any(axis=(1, 2))
            shared[(face == face_ids[:, e]) | (both & touch)] = e
        same_face = shared == s
        tints[~same_face, s] = tints[~same_face, shared[~same_face]]
        empty, covered = np.flatnonzero(same_face & (face < 0)), np.flatnonzero(same_face & (face >= 0))
        tints[empty, s] = floor(empty)
        tints[covered, s] = character(covered, face[covered])
    out[top:bottom, left:right] = (
        (np.clip(tints.sum(axis=1) * 63.75, 0, 255) + 0.5).astype(np.uint8).reshape(bottom - top, right - left, 3)
    )
