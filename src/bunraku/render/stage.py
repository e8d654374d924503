"""What a picture shows besides the motion: camera, faces and colours, lights, shadows, floor, background."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from bunraku.errors import OptionError
from bunraku.files import linear_from_srgb
from bunraku.render.reference import rays

FIELD_OF_VIEW = np.deg2rad(26.0)
YAW = np.deg2rad(32.0)
ELEVATION = np.deg2rad(13.0)
FOLLOW = 0.8
"""A path longer than this many times the character is followed. Chosen by eye."""


def view_axes(yaw: float = YAW, elevation: float = ELEVATION) -> np.ndarray:
    """Camera axes that look at the origin: rows right, up and back (towards the viewer) in the world, shape (3, 3),
    float64. The viewer is rotated about +Y from +Z (the character's front) towards +X, and above the horizon by
    `elevation` [rad].
    """
    back = np.array([np.sin(yaw) * np.cos(elevation), np.sin(elevation), np.cos(yaw) * np.cos(elevation)])
    right = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
    return np.stack([right, np.cross(back, right), back])


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with square pixels and its principal point in the middle of the picture."""

    position: np.ndarray  # position of the eye [m], shape (3,)
    axes: np.ndarray  # rows right, up and back in world coordinates, shape (3, 3)
    field_of_view: float = float(FIELD_OF_VIEW)  # angle from the picture's lower to its upper border [rad]

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", np.asarray(self.position, np.float64).reshape(3))
        object.__setattr__(self, "axes", np.asarray(self.axes, np.float64).reshape(3, 3))
        if not 0 < self.field_of_view < np.pi:
            raise OptionError("a camera's field of view must be between 0 and pi radians")

    def moved(self, offset: np.ndarray) -> Camera:
        """The same camera, displaced [m]."""
        return replace(self, position=self.position + offset)

    def focal(self, height: int) -> float:
        """Focal length in pixels for a picture that is `height` pixels high."""
        return 0.5 * height / float(np.tan(0.5 * self.field_of_view))

    def project(self, points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Column, row ((0, 0) is the upper left corner of the upper left pixel) and distance along the line of sight
        [m] of points (..., 3) in a picture of a width and height, shape (..., 3), float64.
        """
        width, height = size
        local = (np.asarray(points, np.float64) - self.position) @ self.axes.T
        depth = -local[..., 2]
        scale = self.focal(height) / np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        return np.stack([0.5 * width + local[..., 0] * scale, 0.5 * height - local[..., 1] * scale, depth], axis=-1)


class Framing:
    """Measures a motion frame by frame, then gives the closest camera that keeps all of it in the picture.

    For a fixed direction the four sides of the view are planes of known slope, so the closest camera follows from four
    support values per frame; no vertex has to be kept. A path about as long as the character is followed: the camera
    moves with the smoothed path, and the ground shows the movement.

    Args:
        frames: Number of frames N.
        size: Width and height of the picture in pixels.
        fps: Frames a second [1/s].
        axes: Rows right, up and back, shape (3, 3).
        margin: Share of the picture's half width and height left empty at each border; a pair gives the lower border
            another.
        floor: Height on which the character stands at rest [m]; it is the ground where the motion stays near it.
    """

    def __init__(
        self,
        frames: int,
        size: tuple[int, int],
        fps: float = 20.0,
        axes: np.ndarray | None = None,
        margin: float | tuple[float, float] = 0.1,
        floor: float | None = None,
    ):
        self.axes = view_axes() if axes is None else np.asarray(axes, np.float64)
        self.bounds = np.zeros((frames, 2, 3), np.float32)
        self._support = np.zeros((frames, 4))
        self._fps = fps
        self._floor = floor
        above, below = (margin, margin) if isinstance(margin, float) else margin
        slope = float(np.tan(0.5 * FIELD_OF_VIEW))
        self._slopes = np.array([slope * size[0] / size[1] * (1 - above), slope * (1 - above), slope * (1 - below)])

    def add(self, frame: int, vertices: np.ndarray) -> None:
        """Measure one frame: vertices [m], shape (V, 3), float32, contiguous."""
        from bunraku.render.kernels import measure

        self.bounds[frame], self._support[frame] = measure(vertices, self.axes, self._slopes)

    @property
    def extent(self) -> float:
        """Largest extent of the character in any frame [m]."""
        return max(float((self.bounds[:, 1] - self.bounds[:, 0]).max()), 1e-9)

    @property
    def ground(self) -> float:
        """Height of the ground [m]: the floor of the rest pose, through which a weapon or a tail may pass for a while;
        of a motion elsewhere, or without a floor, the height below the lowest vertices of nearly all frames.
        """
        lowest = float(np.quantile(self.bounds[:, 0, 1], 0.05, method="lower"))
        if self._floor is not None and abs(lowest - self._floor) < 0.4 * self.extent:
            return self._floor
        return lowest

    def offsets(self) -> np.ndarray:
        """Displacement of camera and lit floor in each frame [m], shape (N, 3); zeros for a short path."""
        centre = self.bounds.mean(axis=1).astype(np.float64)
        out = np.zeros_like(centre)
        path = centre[:, [0, 2]]
        if float(np.ptp(path, axis=0).max(initial=0)) <= FOLLOW * self.extent:
            return out
        from bunraku.core.geometry.curves import gaussian

        # Mirrored about its ends the path goes on as it came, so that a straight walk is followed without lag.
        sigma = 0.6 * self._fps
        spare = min(int(4 * sigma) + 1, len(path) - 1)
        longer = np.pad(path, ((spare, spare), (0, 0)), mode="reflect", reflect_type="odd")
        smooth = gaussian(longer, sigma)[spare : spare + len(path)]
        out[:, [0, 2]] = smooth - path.mean(axis=0)
        return out

    def camera(self) -> Camera:
        """The closest camera, to be moved by `offsets` in each frame."""
        local = self.offsets() @ self.axes.T
        across, above, below = self._slopes
        right = (self._support[:, 0] - local[:, 0] - across * local[:, 2]).max()
        left = (self._support[:, 1] - local[:, 0] + across * local[:, 2]).min()
        top = (self._support[:, 2] - local[:, 1] - above * local[:, 2]).max()
        bottom = (self._support[:, 3] - local[:, 1] + below * local[:, 2]).min()
        back = max((right - left) / (2 * across), (top - bottom) / (above + below))
        # What the tighter side leaves free is shared by both borders of the other one.
        x, y = 0.5 * (right + left), 0.5 * (top - above * back + bottom + below * back)
        return Camera(np.array([x, y, back]) @ self.axes, self.axes)


CREASE = np.deg2rad(42.0)
CLAY = (206, 170, 142)


def compress_highlights(values: np.ndarray) -> np.ndarray:
    """Linear light with all above a half bent to stay below 1, so that white characters keep their shape."""
    values = np.asarray(values, np.float32)
    return np.where(values <= 0.5, values, 1 - 0.5 * np.exp(1 - 2 * np.maximum(values, 0.5))).astype(np.float32)


@dataclass(frozen=True)
class Surface:
    """A mesh as the renderer draws it: points are vertices, split where a crease divides their normals."""

    # faces, triangles: vertices and points of each triangle, shape (F, 3), int32
    faces: np.ndarray
    triangles: np.ndarray
    clusters: np.ndarray  # normal of each corner, shape (F, 3), int32, below `normal_count`
    # point_vertex, point_cluster: vertex and normal of each point, shape (P,), int32
    point_vertex: np.ndarray
    point_cluster: np.ndarray
    colors: np.ndarray  # linear light of each point, shape (P, 3), float32
    normal_count: int  # number of normals

    def pose(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions [m] and unit normals of the points, both (P, 3), for vertices [m] (V, 3), float32."""
        from bunraku.render.kernels import accumulate_normals

        normals = accumulate_normals(vertices, self.faces, self.clusters, self.normal_count)
        return vertices.take(self.point_vertex, axis=0), normals.take(self.point_cluster, axis=0)


def build_surface(vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray | None = None) -> Surface:
    """Find the creases of a rest pose of vertices [m] (V, 3) and faces (F, 3) and split the vertices there. Colours are
    sRGB, uint8, of the vertices (V, 3) or one for all (3,); None, and white all over, which is what files without
    materials come as, is drawn in the colour of clay. OptionError if the colours are of another number than the
    vertices, or a face names a vertex that is not there.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    vertices = np.asarray(vertices, np.float32)
    faces = np.ascontiguousarray(faces, np.int32)
    if len(faces) and not 0 <= int(faces.min()) <= int(faces.max()) < len(vertices):
        raise OptionError(f"faces must name vertices 0 to {len(vertices) - 1}")
    tint = np.asarray(CLAY if colors is None else colors, np.uint8)
    if tint.shape not in ((3,), vertices.shape):
        raise OptionError(f"colours must have shape (3,) or {vertices.shape}, not {tint.shape}")

    if int(tint.min(initial=255)) == 255:
        tint = np.asarray(CLAY, np.uint8)

    # Seams of texture coordinates hold copies of a vertex; normals run across them.
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-30)
    grid = np.round((vertices - vertices.min(axis=0)) / size * 2e5).astype(np.int64)
    _, welded = np.unique(grid @ np.array([1, 1 << 20, 1 << 40]), return_inverse=True)
    corners = welded[faces]
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)

    start, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    corner = np.arange(start.size)
    following = np.roll(corner.reshape(-1, 3), -1, axis=1).ravel()
    swap = start > end
    low, high = np.where(swap, end, start), np.where(swap, start, end)
    at_low, at_high = np.where(swap, following, corner), np.where(swap, corner, following)
    order = np.lexsort((high, low))
    first, second = order[:-1], order[1:]
    smooth = (low[first] == low[second]) & (high[first] == high[second])
    smooth &= np.einsum("fi,fi->f", normals[first // 3], normals[second // 3]) > np.cos(CREASE)
    first, second = first[smooth], second[smooth]
    rows, columns = np.concatenate([at_low[first], at_high[first]]), np.concatenate([at_low[second], at_high[second]])
    graph = coo_matrix((np.ones(len(rows), np.int8), (rows, columns)), shape=(start.size, start.size))
    count, clusters = connected_components(graph, directed=False)

    pairs = faces.ravel().astype(np.int64) * count + clusters
    unique, triangles = np.unique(pairs, return_inverse=True)
    point_vertex = (unique // count).astype(np.int32)
    point_tint = np.broadcast_to(tint, (len(unique), 3)) if tint.ndim == 1 else tint[point_vertex]
    return Surface(
        faces=faces,
        triangles=triangles.reshape(-1, 3).astype(np.int32),
        clusters=clusters.reshape(-1, 3).astype(np.int32),
        point_vertex=point_vertex,
        point_cluster=(unique % count).astype(np.int32),
        colors=np.ascontiguousarray(linear_from_srgb(point_tint / np.float32(255))),
        normal_count=int(count),
    )


Background = str | tuple[int, int, int]
BACKGROUNDS: dict[str, tuple[str, str]] = {
    "studio": ("#eef1f4", "#dfe4e9"),
    "white": ("#ffffff", "#ffffff"),
    "dark": ("#2b3038", "#1b1f25"),
}
# Linear colours of the key light, the sky, the floor's bounce and the rim; chosen by eye.
LIGHTS = np.array([[0.92, 0.88, 0.80], [0.36, 0.39, 0.45], [0.17, 0.155, 0.15], [0.09, 0.10, 0.12]])
TEXELS = 320


@dataclass(frozen=True)
class Stage:
    """Everything of a picture but the character and the camera."""

    ground: float  # height of the floor [m]
    centre: np.ndarray  # middle of the lit part of the floor [m], shape (3,)
    radius: float  # where the floor has faded out [m]
    cell: float  # spacing of the grid [m]
    light: np.ndarray  # direction towards the key light, shape (3,), unit length
    reach: float  # half the side of the square of floor that can hold a shadow [m]
    extent: float  # size of the character [m]
    top: np.ndarray  # sRGB of the background's upper border, 0..1, shape (3,). Likewise `bottom`, `floor` and `line`.
    bottom: np.ndarray
    floor: np.ndarray
    line: np.ndarray
    lights: np.ndarray = field(default_factory=LIGHTS.copy)


@dataclass(frozen=True)
class Shadows:
    """Two maps of the floor, both (R, R), float32, whose texel (row z, column x) starts at `near`, `left` [m]."""

    heights: np.ndarray  # how high above the floor the highest surface stands in the way of the key light [m]
    floor: np.ndarray  # how much darker the floor is, 0..1
    left: float
    near: float
    texel: float


def parse_background(background: Background) -> tuple[np.ndarray, np.ndarray]:
    """Upper and lower sRGB colour, 0..1, of a named background, a colour such as "#dfe4e9" or (223, 228, 233).
    OptionError if it is none of these.
    """
    try:
        if isinstance(background, str):
            pair = BACKGROUNDS.get(background, (background, background))
            if any(name[0] != "#" or len(name) != 7 for name in pair):
                raise ValueError
            values = [[int(name[at : at + 2], 16) for at in (1, 3, 5)] for name in pair]
        else:
            values = [[int(channel) for channel in background]] * 2
        upper, lower = np.array(values, float)
        if upper.shape != (3,) or upper.min() < 0 or upper.max() > 255:
            raise ValueError
        return upper / 255, lower / 255
    except (ValueError, TypeError, IndexError):
        names = ", ".join(BACKGROUNDS)
        raise OptionError(
            f"background {background!r} is not one of {names}, a colour such as '#dfe4e9', or three numbers 0 to 255"
        ) from None


def set_stage(framing: Framing, background: Background = "studio") -> Stage:
    """The stage for a motion that `framing` has measured."""
    top, bottom = parse_background(background)
    axes = framing.axes
    light = -0.55 * axes[0] + np.array([0.0, 1.15, 0.0]) + 0.75 * np.array([axes[2, 0], 0.0, axes[2, 2]])
    light /= np.linalg.norm(light)
    local = framing.bounds - framing.offsets()[:, None]
    low, high = local[:, 0].min(axis=0), local[:, 1].max(axis=0)
    centre = 0.5 * (low + high).astype(np.float64)
    ground, extent = framing.ground, framing.extent
    # A frame's shadow reaches from its bounds to its bounds along the light.
    sizes = (framing.bounds[:, 1] - framing.bounds[:, 0])[:, [0, 2]].max(axis=1)
    rise = np.maximum(framing.bounds[:, 1, 1] - ground, 0)
    slope = float(np.abs(light[[0, 2]]).max() / light[1])
    step = 10.0 ** np.floor(np.log10(0.4 * extent))
    cell = float(step * max(m for m in (1, 2, 5) if m * step <= 0.4 * extent * 1.0001))
    dark = float(top.mean()) < 0.4
    shift = 0.06 if dark else -0.035
    return Stage(
        ground=ground,
        centre=np.array([centre[0], ground, centre[2]]),
        radius=float(1.1 * max(np.hypot(*(high - low)[[0, 2]]), 0.0) + 2.2 * extent),
        cell=cell,
        light=light,
        reach=float((0.5 * sizes + slope * rise).max() * 1.08 + 0.02 * extent),
        extent=extent,
        top=top,
        bottom=bottom,
        floor=np.clip(bottom + shift, 0, 1),
        line=np.clip(bottom + (0.14 if dark else -0.13), 0, 1),
    )


def cast_shadows(stage: Stage, surface: Surface, vertices: np.ndarray) -> Shadows:
    """The shadows of one frame: vertices [m], shape (V, 3), float32, contiguous."""
    from bunraku.render.kernels import drop_shadow, measure, soften

    texel = 2 * stage.reach / TEXELS
    low, high = measure(vertices, np.eye(3), np.zeros(3))[0]
    slope_x, slope_z = stage.light[0] / stage.light[1], stage.light[2] / stage.light[1]
    # Half a shadow's length towards where it falls; whole texels, so that edges do not swim.
    rise = max(float(high[1]) - stage.ground, 0.0)
    middle = np.array(
        [0.5 * (low[0] + high[0]) - 0.5 * slope_x * rise, 0.5 * (low[2] + high[2]) - 0.5 * slope_z * rise]
    )
    left, near = (np.floor(middle / texel) * texel - stage.reach).tolist()
    corner = (left, near)
    heights = np.full((TEXELS, TEXELS), -np.inf, np.float32)
    drop_shadow(vertices, surface.faces, (slope_x, slope_z), stage.ground, corner, texel, False, heights)
    lowest = np.full((TEXELS // 2, TEXELS // 2), np.inf, np.float32)
    drop_shadow(vertices, surface.faces, (0.0, 0.0), stage.ground, corner, 2 * texel, True, lowest)

    def blurred(image: np.ndarray, radius: float) -> np.ndarray:
        width = 2 * max(round(radius), 1) + 1
        return soften(soften(image, width), width)

    key = blurred((heights > -np.inf).astype(np.float32), 0.012 * stage.extent / texel)
    contact = blurred(np.exp(lowest / np.float32(-0.12 * stage.extent)), 0.015 * stage.extent / texel)
    contact = soften(np.repeat(np.repeat(contact, 2, axis=0), 2, axis=1), 3)
    floor = (1 - (1 - 0.24 * key) * (1 - 0.42 * contact)).astype(np.float32)
    return Shadows(heights, floor, left, near, texel)


@dataclass(frozen=True)
class Backdrop:
    """A picture without lines and character. It is the same wherever the camera moves to above its floor, whose lit
    part moves along.
    """

    base: np.ndarray  # sRGB 0..1, shape (H, W, 3), float32
    plain: np.ndarray  # the same as it is shown, uint8
    # Of each pixel: x and z of its floor point, seen from the point below the eye [m]; how far that moves along x and z
    # from one pixel to the next [m]; how much of the floor is seen, 0..1. Shape (H, W, 5), float32.
    floor: np.ndarray


def build_backdrop(size: tuple[int, int], camera: Camera, stage: Stage, offset: np.ndarray) -> Backdrop:
    """The backdrop of pictures of `size` pixels; `offset` [m], shape (3,), is the displacement of the lit floor."""
    focal, axes = camera.focal(size[1]), camera.axes
    columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    ray = rays(columns, rows, size, axes, focal)
    down = ray[..., 1] < -1e-4
    slope = ray / np.where(down, ray[..., 1], -1)[..., None]
    t = np.where(down, (stage.ground - camera.position[1]) * slope[..., 1] / ray[..., 1], 0)
    at = t[..., None] * ray
    centre = stage.centre + offset - camera.position
    r = ((at[..., 0] - centre[0]) ** 2 + (at[..., 2] - centre[2]) ** 2) / stage.radius**2
    fade = np.where((t > 0) & (r < 1), (1 - r) ** 2, 0)
    # Movement of the floor point for one pixel to the right and one up.
    moved = [np.abs(t / focal * (axes[:2, i, None, None] - axes[:2, 1, None, None] * slope[..., i])) for i in (0, 2)]
    base = stage.top + (stage.bottom - stage.top) * ((rows + 0.5) / size[1])[..., None]
    base = (base + (stage.floor - base) * fade[..., None]).astype(np.float32)
    floor = np.stack([at[..., 0], at[..., 2], moved[0].sum(axis=0), moved[1].sum(axis=0), fade], axis=-1)
    return Backdrop(base, (255 * base + 0.5).astype(np.uint8), floor.astype(np.float32))
