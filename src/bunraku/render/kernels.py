"""The loops of the software renderer, compiled by numba: measuring, normals, shadows and rasterising."""

# mypy: disable-error-code="no-untyped-def"
# numba infers the types of the compiled loops.
from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np

__all__ = ["accumulate_normals", "compiled", "drop_shadow", "measure", "project", "rasterise"]


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function compiled at its first call, and kept in the cache beside its module for the next process."""
    # Infinities mark empty texels, so of the fast-math rules only those that respect them.
    options: dict[str, Any] = {"error_model": "numpy", "nogil": True, "fastmath": {"contract", "arcp", "nsz"}}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no folder for the cache can be written: compile in each process
        return numba.njit(**options)(function)


# Four samples a pixel on a rotated grid, as graphics cards place them.
SAMPLES_X = (0.375, 0.875, 0.125, 0.625)
SAMPLES_Y = (0.125, 0.375, 0.625, 0.875)


@compiled
def measure(vertices, axes, slopes, bounds, support):
    """Bounds (2, 3) of vertices (V, 3), and the four support values that `Framing` needs."""
    for axis in range(3):
        bounds[0, axis] = np.inf
        bounds[1, axis] = -np.inf
    support[0] = support[2] = -np.inf
    support[1] = support[3] = np.inf
    for v in range(len(vertices)):
        px, py, pz = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        bounds[0, 0], bounds[1, 0] = min(bounds[0, 0], px), max(bounds[1, 0], px)
        bounds[0, 1], bounds[1, 1] = min(bounds[0, 1], py), max(bounds[1, 1], py)
        bounds[0, 2], bounds[1, 2] = min(bounds[0, 2], pz), max(bounds[1, 2], pz)
        x = axes[0, 0] * px + axes[0, 1] * py + axes[0, 2] * pz
        y = axes[1, 0] * px + axes[1, 1] * py + axes[1, 2] * pz
        z = axes[2, 0] * px + axes[2, 1] * py + axes[2, 2] * pz
        support[0] = max(support[0], x + slopes[0] * z)
        support[1] = min(support[1], x - slopes[0] * z)
        support[2] = max(support[2], y + slopes[1] * z)
        support[3] = min(support[3], y - slopes[2] * z)


@compiled
def accumulate_normals(vertices, faces, clusters, count):
    """Unit normals (count, 3) of the smooth clusters: area-weighted sums over the faces whose corners belong to
    them.
    """
    out = np.zeros((count, 3), np.float32)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for corner in range(3):
            k = clusters[f, corner]
            out[k, 0] += nx
            out[k, 1] += ny
            out[k, 2] += nz
    for k in range(count):
        length = np.sqrt(out[k, 0] ** 2 + out[k, 1] ** 2 + out[k, 2] ** 2)
        if length > 0:
            out[k, 0] /= length
            out[k, 1] /= length
            out[k, 2] /= length
        else:
            out[k, 1] = 1.0
    return out


@compiled
def project(vertices, axes, eye, focal, width, height):
    """Column, row and inverse distance of each vertex, shape (V, 3), float32; inverse distance 0 is behind the eye."""
    out = np.empty((len(vertices), 3), np.float32)
    for v in range(len(vertices)):
        px, py, pz = vertices[v, 0] - eye[0], vertices[v, 1] - eye[1], vertices[v, 2] - eye[2]
        x = axes[0, 0] * px + axes[0, 1] * py + axes[0, 2] * pz
        y = axes[1, 0] * px + axes[1, 1] * py + axes[1, 2] * pz
        z = -(axes[2, 0] * px + axes[2, 1] * py + axes[2, 2] * pz)
        if z > 1e-6:
            out[v, 0] = 0.5 * width + focal * x / z
            out[v, 1] = 0.5 * height - focal * y / z
            out[v, 2] = 1.0 / z
        else:
            out[v] = 0.0
    return out


@compiled
def rasterise(screen, faces, depth, ids):
    """Write the nearest face of each sample to `ids` and its inverse distance to `depth`, both (H, W, 4)."""
    height, width = depth.shape[0], depth.shape[1]
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        za, zb, zc = float(screen[a, 2]), float(screen[b, 2]), float(screen[c, 2])
        if za <= 0 or zb <= 0 or zc <= 0:
            continue
        ax, ay = float(screen[a, 0]), float(screen[a, 1])
        bx, by = screen[b, 0] - ax, screen[b, 1] - ay
        cx, cy = screen[c, 0] - ax, screen[c, 1] - ay
        area = bx * cy - by * cx
        if area == 0:
            continue
        left, right = ax + min(0.0, bx, cx), ax + max(0.0, bx, cx)
        top, bottom = ay + min(0.0, by, cy), ay + max(0.0, by, cy)
        if right < 0 or bottom < 0 or left >= width or top >= height:
            continue
        # Samples lie between 1/8 and 7/8 of a pixel.
        x0, x1 = int(max(left + 0.125, 0.0)), int(min(right - 0.125, width - 1.0))
        y0, y1 = int(max(top + 0.125, 0.0)), int(min(bottom - 0.125, height - 1.0))
        ux, uy = cy / area, -cx / area
        vx, vy = -by / area, bx / area
        # How far a pixel's samples reach inside each edge, seen from its corner: a whole pixel outside is skipped at
        # once.
        reach_u = 0.875 * (max(ux, 0.0) + max(uy, 0.0))
        reach_v = 0.875 * (max(vx, 0.0) + max(vy, 0.0))
        reach_w = 1 + 0.875 * (max(-ux - vx, 0.0) + max(-uy - vy, 0.0))
        zb -= za
        zc -= za
        for y in range(y0, y1 + 1):
            row_u = ux * (x0 - ax) + uy * (y - ay)
            row_v = vx * (x0 - ax) + vy * (y - ay)
            for x in range(x0, x1 + 1):
                if row_u + reach_u >= 0 and row_v + reach_v >= 0 and row_u + row_v <= reach_w:
                    for s in range(4):
                        u = row_u + ux * SAMPLES_X[s] + uy * SAMPLES_Y[s]
                        v = row_v + vx * SAMPLES_X[s] + vy * SAMPLES_Y[s]
                        if u >= 0 and v >= 0 and u + v <= 1:
                            z = za + u * zb + v * zc
                            if z > depth[y, x, s]:
                                depth[y, x, s] = z
                                ids[y, x, s] = f
                row_u += ux
                row_v += vx


@compiled
def drop_shadow(vertices, faces, slope_x, slope_z, ground, left, near, texel, lowest, heights):
    """Project faces to the floor along (-slope_x, -1, -slope_z); keep the highest (or lowest) height of each texel (R,
    R).

    Heights are above the floor [m]; texels that nothing covers keep what they held.
    """
    size = len(heights)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ha, hb, hc = vertices[a, 1] - ground, vertices[b, 1] - ground, vertices[c, 1] - ground
        ax, ay = (vertices[a, 0] - slope_x * ha - left) / texel, (vertices[a, 2] - slope_z * ha - near) / texel
        bx, by = (
            (vertices[b, 0] - slope_x * hb - left) / texel - ax,
            (vertices[b, 2] - slope_z * hb - near) / texel - ay,
        )
        cx, cy = (
            (vertices[c, 0] - slope_x * hc - left) / texel - ax,
            (vertices[c, 2] - slope_z * hc - near) / texel - ay,
        )
        area = bx * cy - by * cx
        if area == 0:
            continue
        x0, x1 = (
            int(max(np.ceil(ax + min(0.0, bx, cx) - 0.5), 0.0)),
            int(min(np.floor(ax + max(0.0, bx, cx) - 0.5), size - 1.0)),
        )
        y0, y1 = (
            int(max(np.ceil(ay + min(0.0, by, cy) - 0.5), 0.0)),
            int(min(np.floor(ay + max(0.0, by, cy) - 0.5), size - 1.0)),
        )
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                px, py = x + 0.5 - ax, y + 0.5 - ay
                u = (cy * px - cx * py) / area
                v = (bx * py - by * px) / area
                if u >= 0 and v >= 0 and u + v <= 1:
                    h = ha + u * (hb - ha) + v * (hc - ha)
                    if lowest:
                        heights[y, x] = min(heights[y, x], max(h, 0.0))
                    else:
                        heights[y, x] = max(heights[y, x], h)
