"""The loops that colour pixels, compiled by numba: the backdrop with its floor, and the character under its lights."""

# mypy: disable-error-code="no-untyped-def"
# numba infers the types of the compiled loops.
from __future__ import annotations

import numpy as np

from bunraku.render.kernels import compiled

__all__ = ["LINE_WIDTH", "backdrop", "shade"]

LINE_WIDTH = 0.016
"""Thickness of a grid line as a share of the grid's spacing."""


@compiled
def _line(position, cell, width, footprint):
    """Share of a pixel of this footprint that grid lines at multiples of `cell` cover."""
    distance = abs(position / cell - np.floor(position / cell + 0.5)) * cell
    footprint = max(footprint, 1e-9)
    near = (0.5 * (width + footprint) - distance) / min(width, footprint)
    share = min(max(near, 0.0), 1.0) * min(1.0, width / footprint)
    blur = min(max(2.5 * footprint / cell - 0.5, 0.0), 1.0)
    return share + (width / cell - share) * blur


@compiled
def backdrop(axes, eye, focal, centre, ground, radius, cell, top, bottom, floor, line, out):
    """The background's gradient and the floor with its faded grid, sRGB 0..1, into `out` (H, W, 3)."""
    height, width = out.shape[0], out.shape[1]
    thickness = LINE_WIDTH * cell
    for y in range(height):
        sy = (0.5 * height - y - 0.5) / focal
        blend = (y + 0.5) / height
        for x in range(width):
            sx = (x + 0.5 - 0.5 * width) / focal
            dx = axes[0, 0] * sx + axes[1, 0] * sy - axes[2, 0]
            dy = axes[0, 1] * sx + axes[1, 1] * sy - axes[2, 1]
            dz = axes[0, 2] * sx + axes[1, 2] * sy - axes[2, 2]
            fade = 0.0
            cover = 0.0
            if dy < -1e-4:
                t = (ground - eye[1]) / dy
                px, pz = eye[0] + t * dx, eye[2] + t * dz
                r = np.sqrt((px - centre[0]) ** 2 + (pz - centre[2]) ** 2) / radius
                if t > 0 and r < 1:
                    fade = (1 - r * r) ** 2
                    # Movement of the floor point for one pixel to the right and one up.
                    k = t / focal
                    rx, rz = k * (axes[0, 0] - axes[0, 1] / dy * dx), k * (axes[0, 2] - axes[0, 1] / dy * dz)
                    ux, uz = k * (axes[1, 0] - axes[1, 1] / dy * dx), k * (axes[1, 2] - axes[1, 1] / dy * dz)
                    cover = max(
                        _line(px, cell, thickness, abs(rx) + abs(ux)),
                        _line(pz, cell, thickness, abs(rz) + abs(uz)),
                    )
            for i in range(3):
                value = top[i] + (bottom[i] - top[i]) * blend
                value += (floor[i] - value) * fade
                out[y, x, i] = value + (line[i] - value) * (cover * fade)


@compiled
def _bilinear(image, x, y):
    size = len(image)
    x, y = x - 0.5, y - 0.5
    if x < 0 or y < 0 or x >= size - 1 or y >= size - 1:
        return 0.0
    i, j = int(x), int(y)
    fx, fy = x - i, y - j
    upper = image[j, i] + (image[j, i + 1] - image[j, i]) * fx
    lower = image[j + 1, i] + (image[j + 1, i + 1] - image[j + 1, i]) * fx
    return upper + (lower - upper) * fy


@compiled
def _occlusion(heights, x, y, height):
    """Share of 3 x 3 texels around (x, y) where something stands higher than `height` in the way of the light."""
    size = len(heights)
    x, y = x - 0.5, y - 0.5
    i, j = int(np.floor(x)), int(np.floor(y))
    if i < 1 or j < 1 or i >= size - 2 or j >= size - 2:
        return 0.0
    fx, fy = x - i, y - j
    total = 0.0
    for dj in range(-1, 3):
        wy = 1 - fy if dj == -1 else (fy if dj == 2 else 1.0)
        for di in range(-1, 3):
            if heights[j + dj, i + di] > height:
                wx = 1 - fx if di == -1 else (fx if di == 2 else 1.0)
                total += wx * wy
    return total / 9


@compiled
def _touch(faces, f, g):
    """Whether two faces share a point: no crease parts them there, and one shading serves both within a pixel."""
    for i in range(3):
        p = faces[f, i]
        if p == faces[g, 0] or p == faces[g, 1] or p == faces[g, 2]:
            return True
    return False


@compiled
def shade(
    screen, faces, points, normals, colors, ids, base, axes, eye, focal, ground, light, lights, heights, floor_shadow,
    left, near, texel, encode, out
):  # fmt: skip
    """Shade the samples of each pixel, once for each face that it sees, and average them into `out` (H, W, 3), uint8.

    `lights` holds the linear colours of the key light, the sky, the bounce from the floor and the rim, shape (4, 3),
    and `encode` the sRGB value of linear 0..2 in equal steps, highlights compressed.
    """
    height, width = ids.shape[0], ids.shape[1]
    found = np.empty(4, np.int32)
    tint = np.empty((4, 3), np.float64)
    steps = len(encode) - 1
    slope_x, slope_z = light[0] / light[1], light[2] / light[1]
    for y in range(height):
        sy = (0.5 * height - y - 0.5) / focal
        for x in range(width):
            red, green, blue = 0.0, 0.0, 0.0
            for s in range(4):
                f = ids[y, x, s]
                found[s] = f
                seen = -1
                for e in range(s):
                    if found[e] == f or (f >= 0 and found[e] >= 0 and _touch(faces, f, found[e])):
                        seen = e
                        break
                if seen >= 0:
                    for i in range(3):
                        tint[s, i] = tint[seen, i]
                elif f < 0:
                    dark = 0.0
                    sx = (x + 0.5 - 0.5 * width) / focal
                    dy = axes[0, 1] * sx + axes[1, 1] * sy - axes[2, 1]
                    if dy < -1e-4:
                        t = (ground - eye[1]) / dy
                        if t > 0:
                            px = eye[0] + t * (axes[0, 0] * sx + axes[1, 0] * sy - axes[2, 0])
                            pz = eye[2] + t * (axes[0, 2] * sx + axes[1, 2] * sy - axes[2, 2])
                            dark = _bilinear(floor_shadow, (px - left) / texel, (pz - near) / texel)
                    for i in range(3):
                        tint[s, i] = base[y, x, i] * (1 - dark)
                else:
                    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
                    ax, ay = float(screen[a, 0]), float(screen[a, 1])
                    bx, by = screen[b, 0] - ax, screen[b, 1] - ay
                    cx, cy = screen[c, 0] - ax, screen[c, 1] - ay
                    area = bx * cy - by * cx
                    px, py = x + 0.5 - ax, y + 0.5 - ay
                    v = min(max((cy * px - cx * py) / area, 0.0), 1.0)
                    w = min(max((bx * py - by * px) / area, 0.0), 1.0 - v)
                    u = (1 - v - w) * screen[a, 2]
                    v *= screen[b, 2]
                    w *= screen[c, 2]
                    total = u + v + w
                    u, v, w = u / total, v / total, w / total
                    nx = u * normals[a, 0] + v * normals[b, 0] + w * normals[c, 0]
                    ny = u * normals[a, 1] + v * normals[b, 1] + w * normals[c, 1]
                    nz = u * normals[a, 2] + v * normals[b, 2] + w * normals[c, 2]
                    # Rows grow downwards, so a face turned to the viewer has a negative area here.
                    length = np.sqrt(nx * nx + ny * ny + nz * nz) * (1.0 if area < 0 else -1.0)
                    if length == 0:
                        length = 1.0
                    nx, ny, nz = nx / length, ny / length, nz / length
                    qx = u * points[a, 0] + v * points[b, 0] + w * points[c, 0]
                    qy = u * points[a, 1] + v * points[b, 1] + w * points[c, 1]
                    qz = u * points[a, 2] + v * points[b, 2] + w * points[c, 2]
                    ex, ey, ez = eye[0] - qx, eye[1] - qy, eye[2] - qz
                    length = np.sqrt(ex * ex + ey * ey + ez * ez)
                    ex, ey, ez = ex / length, ey / length, ez / length
                    facing = nx * light[0] + ny * light[1] + nz * light[2]
                    rise = qy - ground
                    # The bias grows where the light grazes the surface; lifting along the normal keeps creases clean.
                    lift = texel * (1.5 + 2.5 * (1 - max(facing, 0.0)))
                    hidden = _occlusion(
                        heights,
                        (qx + nx * lift - slope_x * (rise + ny * lift) - left) / texel,
                        (qz + nz * lift - slope_z * (rise + ny * lift) - near) / texel,
                        rise + ny * lift + 1.5 * texel,
                    )
                    key = max((facing + 0.2) / 1.2, 0.0) * (1 - 0.7 * hidden)
                    sky = 0.5 + 0.5 * ny
                    grazing = 1 - max(nx * ex + ny * ey + nz * ez, 0.0)
                    rim = grazing * grazing * grazing * sky
                    hx, hy, hz = ex + light[0], ey + light[1], ez + light[2]
                    gloss = max((nx * hx + ny * hy + nz * hz) / np.sqrt(hx * hx + hy * hy + hz * hz), 0.0)
                    gloss = gloss * gloss
                    gloss = gloss * gloss
                    gloss = gloss * gloss
                    gloss = 0.05 * gloss * gloss * (1 - hidden)
                    for i in range(3):
                        albedo = u * colors[a, i] + v * colors[b, i] + w * colors[c, i]
                        value = (
                            albedo * (lights[0, i] * key + lights[1, i] * sky + lights[2, i] * (1 - sky))
                            + lights[3, i] * rim
                            + gloss
                        )
                        tint[s, i] = encode[int(min(max(0.5 * value, 0.0), 1.0) * steps + 0.5)]
                red += tint[s, 0]
                green += tint[s, 1]
                blue += tint[s, 2]
            out[y, x, 0] = np.uint8(min(max(red * 63.75, 0.0), 255.0) + 0.5)
            out[y, x, 1] = np.uint8(min(max(green * 63.75, 0.0), 255.0) + 0.5)
            out[y, x, 2] = np.uint8(min(max(blue * 63.75, 0.0), 255.0) + 0.5)
