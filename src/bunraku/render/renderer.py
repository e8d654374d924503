"""The software renderer: four samples per pixel, several frames at once."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from queue import SimpleQueue

import numpy as np

from bunraku.render.stage import (
    Backdrop,
    Camera,
    Shadows,
    Stage,
    Surface,
    build_backdrop,
    cast_shadows,
    compress_highlights,
    srgb_from_linear,
)


class SoftwareRenderer:
    """Draws frames of one surface on one stage; for one thread at a time. Faces that reach behind the eye are left out
    whole; a fitted camera has none.
    """

    def __init__(self, size: tuple[int, int], surface: Surface, stage: Stage):
        width, height = size
        self._surface, self._stage = surface, stage
        self._depth = np.zeros((height, width, 4), np.float32)
        self._ids = np.full((height, width, 4), -1, np.int32)
        self._encode = srgb_from_linear(compress_highlights(np.linspace(0, 2, 8193, dtype=np.float32)))
        self._seen: tuple[float, ...] = ()
        self._base, self._plain = np.empty((height, width, 3), np.float32), np.empty((height, width, 3), np.uint8)
        self._backdrop: Backdrop | None = None
        self._behind: tuple[float, ...] = ()
        self._floor = slice(0, 0)

    def draw(self, vertices: np.ndarray, camera: Camera, offset: np.ndarray) -> np.ndarray:
        """One picture, shape (H, W, 3), uint8.

        Args:
            vertices: Posed positions [m], shape (V, 3), float32, contiguous.
            camera: The camera.
            offset: Displacement of the lit part of the floor [m], shape (3,).
        """
        from bunraku.render import kernels
        from bunraku.render.reference import Drawn, Lighting, ShadowMap, View

        stage, surface = self._stage, self._surface
        height, width = self._ids.shape[:2]
        focal = camera.focal(height)
        self._draw_backdrop(camera, focal, offset)
        points, normals = surface.pose(vertices)
        shadows = cast_shadows(stage, surface, vertices)
        screen = kernels.project(points, camera.axes, camera.position, focal, width, height)
        left, top, right, bottom = kernels.rasterise(screen, surface.triangles, self._depth, self._ids)
        dark = self._darkened(shadows, camera)
        out: np.ndarray = self._plain.copy()
        kernels.shade(
            (min(left, dark[0]), min(top, dark[1]), max(right, dark[2]), max(bottom, dark[3])),
            Drawn(screen, surface.triangles, points, normals, surface.colors),
            View(camera.axes, camera.position, focal),
            Lighting(stage.ground, stage.light, stage.lights, self._encode),
            ShadowMap(shadows.heights, shadows.floor, (shadows.left, shadows.near), shadows.texel),
            self._ids,
            self._base,
            out,
        )
        self._depth[top:bottom, left:right] = 0
        self._ids[top:bottom, left:right] = -1
        return out

    def _draw_backdrop(self, camera: Camera, focal: float, offset: np.ndarray) -> None:
        """Fill `base` and `plain` where the camera has moved."""
        from bunraku.render import kernels

        seen = (*camera.position.tolist(), *camera.axes.ravel().tolist(), focal, *np.asarray(offset).tolist())
        if seen == self._seen:
            return
        stage = self._stage
        height, width = self._ids.shape[:2]
        behind = (*(camera.position - offset).round(9).tolist(), *seen[3:13], camera.position[1])
        if self._backdrop is None or behind != self._behind:
            self._backdrop, self._behind = build_backdrop((width, height), camera, stage, offset), behind
            rows = np.flatnonzero(self._backdrop.floor[..., 4].any(axis=1))
            self._floor = slice(int(rows[0]), int(rows[-1]) + 1) if len(rows) else slice(0, 0)
        backdrop, floor = self._backdrop, self._floor
        np.copyto(self._base, backdrop.base)
        np.copyto(self._plain, backdrop.plain)
        kernels.draw_grid(
            backdrop.floor[floor], camera.position[[0, 2]], stage.cell, stage.line, self._base[floor],
            self._plain[floor],
        )  # fmt: skip
        self._seen = seen

    def _darkened(self, shadows: Shadows, camera: Camera) -> tuple[int, int, int, int]:
        """The rectangle outside which no shadow lies on the floor: first column and row, and those after the last."""
        height, width = self._ids.shape[:2]
        rows, columns = (np.flatnonzero((shadows.floor > 0).any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return width, height, 0, 0
        x = shadows.left + shadows.texel * np.array([columns[0] - 1, columns[-1] + 2])
        z = shadows.near + shadows.texel * np.array([rows[0] - 1, rows[-1] + 2])
        corners = np.array([[across, self._stage.ground, along] for across in x for along in z])
        seen = camera.project(corners, (width, height))
        if (seen[:, 2] <= 0).any():
            return 0, 0, width, height
        first = np.clip(np.floor(seen[:, :2].min(axis=0)) - 1, 0, (width, height)).astype(int)
        last = np.clip(np.ceil(seen[:, :2].max(axis=0)) + 1, 0, (width, height)).astype(int)
        return int(first[0]), int(first[1]), int(last[0]), int(last[1])


MOST_THREADS = 8
Frame = tuple[np.ndarray, Camera, np.ndarray]
"""Posed vertices, the camera, and the displacement of the floor."""


def draw_parallel(opened: Callable[[], SoftwareRenderer], frames: Iterable[Frame]) -> Iterator[np.ndarray]:
    """Pictures of frames in their order, drawn on one thread per processor, a few pictures ahead, so that a video is
    encoded meanwhile. `opened` gives a new renderer; all draw the same.
    """
    first = opened()
    threads = min(
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, MOST_THREADS
    )
    if threads == 1:
        for frame in frames:
            yield first.draw(*frame)
        return
    free: SimpleQueue[SoftwareRenderer] = SimpleQueue()
    free.put(first)
    drawn = 1

    def draw(frame: Frame) -> np.ndarray:
        renderer = free.get()
        try:
            return renderer.draw(*frame)
        finally:
            free.put(renderer)

    source = iter(frames)
    ahead: deque[Future[np.ndarray]] = deque()
    pool = ThreadPoolExecutor(threads, "bunraku-preview")
    try:
        for frame in islice(source, 2 * threads):
            if drawn < threads and len(ahead) >= drawn:
                drawn += 1
                free.put(opened())
            ahead.append(pool.submit(draw, frame))
        while ahead:
            picture = ahead.popleft().result()
            for frame in islice(source, 1):
                ahead.append(pool.submit(draw, frame))
            yield picture
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
