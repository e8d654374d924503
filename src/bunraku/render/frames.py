"""The software renderer, four samples a pixel, and frames of animations and characters, one after another: memory grows
neither with the length nor with the mesh.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from queue import SimpleQueue
from typing import Literal

import numpy as np

from bunraku.core.animation import Animation, PointAnimation
from bunraku.core.character import Character, Handles
from bunraku.core.skinning import skin_basis
from bunraku.errors import OptionError
from bunraku.files import srgb_from_linear, with_still
from bunraku.render.stage import (
    YAW,
    Backdrop,
    Background,
    Camera,
    Framing,
    Shadows,
    Stage,
    Surface,
    build_backdrop,
    build_surface,
    cast_shadows,
    compress_highlights,
    set_stage,
    view_axes,
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
        """One picture, shape (H, W, 3), uint8, of posed vertices [m] (V, 3), float32, contiguous; `offset` [m], shape
        (3,), is the displacement of the lit part of the floor.
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
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    threads = min(processors, MOST_THREADS)
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


# Spread over the colours that can be told apart on a grey stage: any two are at least 30 apart in CIELAB, and parents
# and children, left and right, and handles with one parent at least 60.
_HEX = """
fa142c 14eeca 1444e2 696914 75b1fa 8de214 14ee5d b11499 2ca599 14d6fa
5d9914 fa99a5 fa6914 146938 e25dfa fa1499 7544a5 a52c2c fa3869 14bd69
faa514 e2b1fa 1481fa bd7538 145d99 bde299 8d385d d6d614 ee75bd faca75
"""

HANDLE_PALETTE: np.ndarray = np.frombuffer(bytes.fromhex(_HEX), np.uint8).reshape(30, 3)
"""sRGB colour of each handle, shape (30, 3), uint8, read-only."""


def handle_colors(handles: Handles) -> np.ndarray:
    """sRGB colour of each vertex, the handles' colours blended by weight, shape (V, 3), uint8."""
    palette = HANDLE_PALETTE[np.arange(len(handles.positions)) % len(HANDLE_PALETTE)].astype(np.float32)
    return np.clip(handles.weights @ palette + 0.5, 0, 255).astype(np.uint8)


SIZE = (640, 480)
MOST_FACES = 120_000
KEPT_FACES = 60_000
CHUNK_BYTES = 32 << 20
KEPT_BYTES = 96 << 20
"""Posed frames that are kept between measuring and drawing [bytes]; further ones are posed twice."""


@dataclass(frozen=True)
class _Take:
    """Frames to draw; posed vertices can be iterated again and again."""

    rest: np.ndarray
    faces: np.ndarray
    colors: np.ndarray | None
    frames: Callable[[], Iterator[np.ndarray]]
    count: int
    floor: float | None = None


def render_frames(
    vertices: np.ndarray,
    faces: np.ndarray,
    colors: np.ndarray | None = None,
    camera: Camera | None = None,
    *,
    size: tuple[int, int] = SIZE,
    fps: float = 20.0,
    background: Background = "studio",
) -> np.ndarray:
    """Draw posed vertices. OptionError if a size, a colour or a background is invalid, or there is no frame.

    Args:
        vertices: Posed positions [m], +Y up, +Z forward, shape (N, V, 3).
        faces: Vertex indices, shape (F, 3).
        colors: sRGB colours, uint8, of the vertices (V, 3) or one for all (3,).
        camera: The camera of all frames; None fits one, which follows long paths.
        size: Width and height in pixels.
        fps: Frames a second, for how softly the camera follows [1/s].
        background: "studio", "white", "dark", a colour such as "#dfe4e9", or three numbers 0 to 255.

    Returns:
        Pictures, shape (N, H, W, 3), uint8.
    """
    vertices = np.asarray(vertices, np.float32)
    if vertices.ndim != 3 or not len(vertices) or vertices.shape[2] != 3 or not np.isfinite(vertices).all():
        raise OptionError(f"frames to draw must be finite numbers of shape (N, V, 3) with N > 0, not {vertices.shape}")
    take = _Take(
        vertices[0],
        np.asarray(faces),
        colors,
        lambda: (np.ascontiguousarray(frame) for frame in vertices),
        len(vertices),
    )
    return np.stack(list(_draw(take, size, fps, background, camera=camera)))


def render_animation(
    animation: Animation | PointAnimation,
    *,
    size: tuple[int, int] = SIZE,
    fps: float | None = None,
    times: np.ndarray | None = None,
    background: Background = "studio",
    color: Literal["texture", "handles"] = "texture",
) -> Iterator[np.ndarray]:
    """Draw an animation one frame after the other: pictures (H, W, 3), uint8. OptionError if an option is outside what
    can be drawn.

    Args:
        fps: Pictures a second [1/s]; None is the motion's own. Between the motion's frames vertices are interpolated.
        times: Moments to draw [s], shape (M,), instead of `fps`.
        color: The character's own colours, or those of its handles.
    """
    at = moments(animation, fps) if times is None else np.asarray(times, float)
    pace = (len(at) - 1) / max(float(at[-1] - at[0]), 1e-6) if len(at) > 1 else animation.motion.fps
    return _draw(_take(animation, at, color), size, pace, background)


def render_still(
    character: Character,
    handles: Handles | None = None,
    *,
    size: tuple[int, int] = (400, 480),
    yaw: float = float(YAW),
    background: Background = "studio",
) -> np.ndarray:
    """A picture of a character in its rest pose, shape (H, W, 3), uint8, in its own colours or, when `handles` are
    given, in theirs. The viewer is rotated about +Y from the character's front (+Z) towards +X by `yaw` [rad].
    """
    colors = character.colors if handles is None else handle_colors(handles)
    vertices = np.ascontiguousarray(character.vertices, np.float32)
    rest, faces, colors, _ = _simplified(vertices, character.faces, colors)
    take = _Take(rest, faces, colors, lambda: iter([rest]), 1)
    return next(_draw(take, size, 20.0, background, axes=view_axes(yaw)))


def moments(animation: Animation | PointAnimation, fps: float | None) -> np.ndarray:
    """Times of the pictures of a video at `fps`, or at the motion's own rate [s], shape (M,)."""
    motion = animation.motion
    if fps is None or fps == motion.fps:
        return np.arange(len(motion)) / motion.fps
    return np.arange(max(round(len(motion) / motion.fps * fps), 1)) / fps


def _take(animation: Animation | PointAnimation, times: np.ndarray, color: str) -> _Take:
    if color not in ("texture", "handles"):
        raise OptionError(f"color must be 'texture' or 'handles', not {color!r}")
    moved = with_still(animation) if isinstance(animation, Animation) else animation
    character, motion, handles = moved.character, moved.motion, moved.handles
    colors = character.colors if color == "texture" else handle_colors(handles)
    rest, faces, colors, origin = _simplified(character.vertices, character.faces, colors, handles.weights)
    weights = handles.weights if origin is None else handles.weights[origin]
    transforms = motion.transforms(handles.positions)
    at = np.clip(times * motion.fps, 0, len(motion) - 1)
    before = np.floor(at + 1e-6).astype(int)
    after = np.minimum(before + 1, len(motion) - 1)
    share = np.clip(at - before, 0, 1).astype(np.float32)[:, None, None, None]
    basis = skin_basis(rest, weights)
    chunk = max(int(CHUNK_BYTES // (12 * len(rest))), 1)
    offsets = animation.offsets if isinstance(animation, PointAnimation) else None
    rows = slice(None) if origin is None else origin

    def frames() -> Iterator[np.ndarray]:
        for start in range(0, len(times), chunk):
            part = slice(start, start + chunk)
            blend = transforms[before[part]] * (1 - share[part]) + transforms[after[part]] * share[part]
            left = np.ascontiguousarray(blend.transpose(0, 2, 1, 3)).reshape(3 * len(blend), -1)
            for number, posed in enumerate((left @ basis).reshape(len(blend), 3, -1), start):
                vertices = np.ascontiguousarray(posed.T)
                if offsets is not None:
                    later = float(share[number, 0, 0, 0])
                    vertices += (1 - later) * offsets[before[number]][rows] + later * offsets[after[number]][rows]
                yield vertices

    return _Take(rest, faces, colors, frames, len(times), floor=float(rest[:, 1].min()))


def _simplified(
    vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray | None, weights: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
    """The mesh as it is drawn, with fewer faces if it is large, and the original vertex of each new one; None where all
    are as they were.

    Vertices without faces are left out, since they would draw the camera away unseen. Copies of a vertex that look and
    move alike, as files keep them at seams and STL for every face, are drawn as one.
    """
    kept, faces = _welded(vertices, faces, colors, weights)
    if len(kept) < len(vertices):
        tints = colors if colors is None or colors.ndim == 1 else colors[kept]
        rest, small, tints, origin = _fewer(np.ascontiguousarray(vertices[kept]), faces, tints)
        return rest, small, tints, kept if origin is None else kept[origin]
    return _fewer(vertices, faces, colors)


def _welded(
    vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray | None, weights: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """One vertex of each group of equal ones that has faces, ascending, and the faces that name those."""
    parts = [vertices, weights, colors if colors is not None and colors.ndim == 2 else None]
    columns = [np.ascontiguousarray(part, np.float32).view(np.uint32) for part in parts if part is not None]
    # A hash of 64 bits a vertex: equal vertices have equal ones, and others do not by all odds.
    odd = np.random.default_rng(0).integers(0, 1 << 63, sum(part.shape[1] for part in columns), np.uint64) * 2 + 1
    mixed, start = np.zeros(len(vertices), np.uint64), 0
    for part in columns:
        for column in part.T:
            mixed = (mixed ^ column) * odd[start]
            mixed ^= mixed >> np.uint64(29)
            start += 1
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    at = np.flatnonzero(used)
    _, first, group = np.unique(mixed[at], return_index=True, return_inverse=True)
    order = np.argsort(first)  # as they came
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    new = np.zeros(len(vertices), np.int64)
    new[at] = rank[group]
    return at[first[order]], new[faces]


def _fewer(
    vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
    """`_simplified` for a mesh without loose vertices."""
    if len(faces) <= MOST_FACES and len(vertices) <= MOST_FACES:
        return vertices, faces, colors, None
    import fast_simplification
    from scipy.spatial import cKDTree

    # Copies of a vertex at texture seams would tear apart: simplify the welded surface.
    points, first, welded = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    corners = welded.reshape(-1)[faces]
    solid = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2]) & (corners[:, 2] != corners[:, 0])
    corners = np.ascontiguousarray(corners[solid], np.int32)
    if len(corners) > KEPT_FACES:
        simpler, small = fast_simplification.simplify(points, corners, target_count=KEPT_FACES, agg=7)
        rest = np.ascontiguousarray(simpler, np.float32)
        origin = first[cKDTree(points).query(rest)[1]]
    else:
        rest, small, origin = points, corners, first
    if not len(small):
        return vertices, faces, colors, None
    return rest, np.asarray(small), None if colors is None else colors if colors.ndim == 1 else colors[origin], origin


def _draw(
    take: _Take,
    size: tuple[int, int],
    fps: float,
    background: Background,
    *,
    camera: Camera | None = None,
    axes: np.ndarray | None = None,
) -> Iterator[np.ndarray]:
    width, height = int(size[0]), int(size[1])
    if not (16 <= width <= 4096 and 16 <= height <= 4096):
        raise OptionError(f"a picture has 16 to 4096 pixels a side, not {width} x {height}")
    framing = Framing(take.count, (width, height), fps, axes if camera is None else camera.axes, floor=take.floor)
    kept: list[np.ndarray] | None = [] if 12 * len(take.rest) * take.count <= KEPT_BYTES else None
    for index, posed in enumerate(take.frames()):
        framing.add(index, posed)
        if kept is not None:
            kept.append(posed)
    stage = set_stage(framing, background)
    offsets = framing.offsets() if camera is None else np.zeros((take.count, 3))
    view = framing.camera() if camera is None else camera
    surface = build_surface(take.rest, take.faces, take.colors)

    def opened() -> SoftwareRenderer:
        return SoftwareRenderer((width, height), surface, stage)

    frames = take.frames() if kept is None else iter(kept)
    return draw_parallel(opened, ((posed, view.moved(o), o) for posed, o in zip(frames, offsets, strict=True)))
