"""Evidence of how a character stands beside the network's: the ground, mirror planes, what it would rest on, where its
top leans, and where its colours vary most.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from bunraku.core.geometry.axes import AXES, BARE, ORIENTATIONS, axis_vector
from bunraku.core.geometry.surface import face_normals

__all__ = [
    "CALIBRATION",
    "COLOR_WEIGHT",
    "LEAN_WEIGHT",
    "REST_WEIGHTS",
    "asymmetries",
    "combined",
    "evidence",
    "evidence_of_file",
    "evidence_of_surface",
    "front_scores",
    "ground_fit",
    "has_rule",
    "kind_weights",
    "lean",
    "rest",
    "variety",
    "with_prior",
]


COLOR_WEIGHT = 8.0
"""Of the log of `variety`. On every second character of the archive, of the 60 that have colours, the most varied of
four sides is the front for 70 % and the front is more varied than the back for 80 %; of the 19 files for priors that
have colours, for 68 and 79 %. The cross-entropy of the four, where equal chances have 1.39, is 1.00 and 0.88."""
_PLAIN = 3e-3
"""A variance of colours that is as good as none."""
_FACING = 0.3
"""Cosine from which on a face counts as seen, and more the straighter it looks."""


def variety(vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """Variance of the colours that are seen from each of `AXES`, by area, shape (6,).

    Args:
        vertices: Positions, any unit, shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        colors: Of each vertex, sRGB, shape (V, 3), uint8.
    """
    normals = face_normals(vertices, faces).astype(np.float64)
    areas = np.linalg.norm(normals, axis=1)
    middles = vertices[faces].mean(axis=1) - vertices.mean(axis=0)
    outward = -1 if (middles * normals).sum() < 0 else 1  # some files have their faces inside out
    seen = colors[faces].mean(axis=1) / 255
    found = []
    for axis in AXES:
        share = areas * np.clip(outward * (normals @ axis_vector(axis)) / np.maximum(areas, 1e-300) - _FACING, 0, None)
        share = share / max(float(share.sum()), 1e-300)
        found.append(float(share @ np.square(seen - share @ seen).sum(axis=1)))
    return np.array(found)


def front_scores(varied: np.ndarray) -> np.ndarray:
    """How much rather each of `AXES` is the front than others at a right angle to the same up axis, by `variety`,
    shape (6,); the largest is 1.
    """
    logs = COLOR_WEIGHT * np.log(varied + _PLAIN)
    return np.asarray(np.exp(logs - logs.max()))


REST_WEIGHTS = np.array([0.20, 1.49, 5.87])
"""Of the numbers of `rest`: log of what lies flat, whether it stands by itself, how wide its base is."""
LEAN_WEIGHT = 3.95
_FLAT, _LOW_POINTS, _DOWN = 0.012, 0.025, -0.9
"""How high over the lowest point, of the largest extent, what lies flat and what carries may be; and the cosine from
which on a normal points down."""
_EDGE, _LEAST = 0.02, 2e-3
_TOP = 0.85
_ANGLES = np.linspace(0, 2 * np.pi, 16, endpoint=False)
_AROUND = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
"""Directions in which corners of a hull in the plane are looked for first."""
_UP_VECTORS = np.array([axis_vector(up) for up, _ in ORIENTATIONS])
_FRONT_VECTORS = np.array([axis_vector(front) for _, front in ORIENTATIONS])


def rest(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """How a shape would rest on the ground with each of `AXES` up, shape (6, 3).

    Args:
        points: Spread evenly over its surface, any unit, shape (N, 3).
        normals: Their unit normals, shape (N, 3).

    Returns:
        Log of the share of the surface that lies flat on the ground; whether its middle is above what carries it, from
        0 to 1 over a few hundredths of its extent; and the area within what carries it, of its footprint.
    """
    extent = max(float(np.ptp(points, axis=0).max()), 1e-100)
    middle = points.mean(axis=0)
    rows = []
    for axis in AXES:
        up = axis_vector(axis)
        height = points @ up
        height = (height - height.min()) / extent
        flat = float(((height < _FLAT) & (normals @ up < _DOWN)).mean())
        across = np.delete(np.arange(3), "xyz".index(axis[1]))
        inside, base = _carried(points[height < _LOW_POINTS][:, across] / extent, middle[across] / extent)
        footprint = max(float(np.prod(np.ptp(points[:, across], axis=0))) / extent**2, 1e-12)
        rows.append((np.log(flat + _LEAST), 1 / (1 + np.exp(-np.clip(inside / _EDGE, -50, 50))), base / footprint))
    return np.array(rows)


def _carried(low: np.ndarray, middle: np.ndarray) -> tuple[float, float]:
    """How far a point is inside the hull of others in the plane, shape (N, 2), and the area of that hull; -1 and 0
    where they have none.
    """
    if len(low) < 3 or np.ptp(low, axis=0).min() < 1e-6:
        return -1.0, 0.0
    corners = _hull(low)
    edges = np.roll(corners, -1, axis=0) - corners
    outward = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1, keepdims=True)
    area = 0.5 * float((corners[:, 0] * edges[:, 1] - corners[:, 1] * edges[:, 0]).sum())
    return (float((outward * (corners - middle)).sum(axis=1).min()), area) if area > 1e-12 else (-1.0, 0.0)


def _hull(points: np.ndarray) -> np.ndarray:
    """Corners of the convex hull of points in the plane, counter-clockwise, shape (C, 2), by Andrew's monotone chain.

    Qhull would load a tenth of a second and ten megabytes of scipy.
    """
    rough = points[(points @ _AROUND.T).argmax(axis=0)]  # what lies within these corners is none
    edges = np.roll(rough, -1, axis=0) - rough
    beyond = edges[:, 0] * (points[:, 1:] - rough[:, 1]) - edges[:, 1] * (points[:, :1] - rough[:, 0])
    rows = np.unique(points[(beyond <= 1e-12).any(axis=1)], axis=0).tolist()
    corners: list[list[float]] = []
    for line in (rows, rows[::-1]):
        side: list[list[float]] = []
        for x, y in line:
            while len(side) > 1:
                (u, v), (w, z) = side[-2:]
                if (w - u) * (y - v) - (z - v) * (x - u) > 0:
                    break
                side.pop()
            side.append([x, y])
        corners += side[:-1]
    return np.array(corners)


def lean(points: np.ndarray) -> np.ndarray:
    """How far the top of a shape is before its middle in each of `ORIENTATIONS`, of its largest extent, shape (24,).

    Heads are in front of trunks.

    Args:
        points: Spread evenly over its surface, any unit, shape (N, 3).
    """
    heights = points @ _UP_VECTORS.T
    low, high = heights.min(axis=0), heights.max(axis=0)
    top = heights >= low + _TOP * (high - low)
    before = (points - points.mean(axis=0)) @ _FRONT_VECTORS.T
    return np.asarray((before * top).sum(axis=0) / top.sum(axis=0) / max(float(np.ptp(points, axis=0).max()), 1e-100))


CALIBRATION = 1.1
"""What the log-odds of all witnesses are divided by, since they are not quite independent: fitted to the least
cross-entropy on the 37 files of `benchmarks/foreign_files.json` that are for it.
"""
NETWORK_DOUBT = 0.05
"""Where the network says 97 % or more it is right for 93 % of 180 meshes that training did not see."""
GROUND_DOUBT, GROUND_WEIGHT = 0.03, 10.0
"""Of 151 characters of the training archive half stand on the plane through 0, and none has such a plane on a wrong
side; on its own it gives odds of at most 195 to 1 for one axis against another."""
REST_DOUBT, LEAN_DOUBT = 0.05, 0.3
"""What lies on its back rests well too. With a lean that is doubted by 10 % two of 30 held-out characters turn their
backs as a GLB, with 30 % none. At most 115 to 1 between two axes and 10 to 1 between two fronts."""
COLOR_DOUBT = 0.3
"""What is painted on a back may be richer than a face: at most 10 to 1 between two fronts."""
BONES_DOUBT = 0.03
"""Of 114 rigs of the archive whose bones tell, two name left and right the other way."""
MIRROR_DOUBT, MIRROR_POWER, MIRROR_FLOOR = 0.01, 10.0, 1e-4
"""The chance that a plane is the one between left and right goes with its asymmetry to the power of -10: what is nearly
symmetric across one plane alone has it for sure, and a lion in mid-step, whose planes differ by a fifth, tells little.
Fitted on those 37 files, where it errs in 3; at most 298 to 1."""
FEW = 12
"""A shape of so many vertices has told half of what it could: of 60 characters of the archive, simplified, the network
is right for 82 % at 1,000 vertices, 77 % at 106, 50 % at 31 and 25 % at 15, and its log-odds have the least
cross-entropy times 1, 1, 0.8 and 0.35; those of the mirror plane likewise, times 1, 1, 0.45 and 0.35.
"""
_LOW, _MIDDLE = 0.05, 0.25
"""How far from the lowest point the ground may be, and from the middle the origin, as shares of the extent."""
_ASKED = 2000
"""Vertices whose mirror images are looked for."""
_HELD = 60_000
"""Vertices, evenly drawn from more, among which the nearest to a mirror image is looked for."""
_FAR = 0.05
"""An asymmetry that is as good as none, of the largest extent."""
_UPS = np.array([AXES.index(up) for up, _ in ORIENTATIONS])
_FOUR = _UPS[:, None] == _UPS
_FRONTS = np.array([AXES.index(front) for _, front in ORIENTATIONS])
_SIDES = np.array([3 - "xyz".index(up[1]) - "xyz".index(front[1]) for up, front in ORIENTATIONS])


def _weights(table: dict[tuple[str, str], float], up: str, of_up: float, rest: float) -> np.ndarray:
    """A prior: the weights of a table, `of_up` for others with that axis up, `rest` for all others; they sum to 1,
    shape (24,).
    """
    weights = np.array([table.get(axes, of_up if axes[0] == up else rest) for axes in ORIENTATIONS])
    return weights / weights.sum()


_MOVED = _weights({("+y", "+z"): 97, ("+z", "-y"): 0.3}, "+y", 0.7, 0.05)
_BARE = _weights({("+y", "+z"): 8, ("+z", "-y"): 1.5}, "+y", 2, 0.3)
_PRINTED = _weights(
    {("+z", "-y"): 8, ("+y", "+z"): 3, **{("+y", front): 0.7 for front in ("-z", "+x", "-x")}}, "+z", 2, 0.3
)


def has_rule(suffix: str) -> bool:
    """Whether a format says which axis is up; all do but OBJ, PLY, STL, and "" for a mesh that is of no file."""
    return bool(suffix) and suffix not in BARE


def kind_weights(suffix: str, moved: bool = False) -> np.ndarray:
    """How likely each of `ORIENTATIONS` is in files of a kind before anyone looks at the mesh, shape (24,).

    Counted in the 37 files of `benchmarks/foreign_files.json` that are for it, with a little for what none of them
    does. With a skin or a clip 9 of 9 stand along +Y and face +Z: 97 %, at least 0.7 % for the other fronts. Without,
    of 21 GLB and OBJ files 9 do, 8 face another way and 4 lie: 8, 2 for each other front, 1.5 for +Z up facing -Y, 0.3
    for each of the rest. STL and PLY: all 7, of one maker, have +Z up and face -Y: 8, 3 for +Y up facing +Z, 2 for the
    other fronts with +Z up, 0.7 for those with +Y up, 0.3.

    Args:
        suffix: The format, such as ".stl"; "" where there is no file.
        moved: Whether the file has a skin or a clip, so that somebody has animated it.
    """
    if suffix in (".stl", ".ply"):
        return _PRINTED
    return _MOVED if moved and has_rule(suffix) else _BARE


def combined(
    network: np.ndarray,
    vertices: np.ndarray | None = None,
    prior: np.ndarray | None = None,
    surface: tuple[np.ndarray, np.ndarray] | None = None,
    bones: tuple[str, str] | None = None,
    paint: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """How likely each of `ORIENTATIONS` is by all witnesses, calibrated, shape (24,), sums to 1.

    Args:
        network: What the network gives each orientation, shape (24,), sums to 1.
        vertices: Rest positions as the file has them, any unit, shape (V, 3); without them ground and mirror are not
            asked.
        prior: Weights of `kind_weights`, shape (24,); equal where not given. A weight of 0 rules an orientation out.
        surface: Points and unit normals spread evenly over the surface, shape (N, 3) each; without them what it rests
            on and where its top leans are not asked.
        bones: Up and front as the bones have them, where they tell.
        paint: Faces (F, 3) and the colours of the vertices, sRGB, shape (V, 3), uint8, where there are any.
    """
    return with_prior(network, *evidence(vertices, surface, paint), prior, bones)


def evidence(
    vertices: np.ndarray | None = None,
    surface: tuple[np.ndarray, np.ndarray] | None = None,
    paint: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, float]:
    """What the witnesses beside network and bones say, and what share of its word such a shape deserves; arguments as
    those of `combined`, shape (24,).
    """
    logs = np.zeros(len(ORIENTATIONS))
    if surface is not None:
        logs = logs + evidence_of_surface(*surface)
    if vertices is None:
        return logs, 1.0
    if paint is not None:
        logs = logs + _fronts(front_scores(variety(vertices, *paint))[_FRONTS], COLOR_DOUBT)
    distinct = len(np.unique(vertices[:: max(len(vertices) // _ASKED, 1)], axis=0))
    return logs + evidence_of_file(vertices), distinct / (distinct + FEW)


def with_prior(
    network: np.ndarray,
    logs: np.ndarray,
    worth: float,
    prior: np.ndarray | None = None,
    bones: tuple[str, str] | None = None,
) -> np.ndarray:
    """As `combined`, of what `told` has."""
    logs = (np.log(_tempered(network, NETWORK_DOUBT)) + logs) * worth
    chances: np.ndarray = np.exp((logs - logs.max()) / CALIBRATION) * (1 if prior is None else prior)
    if bones is not None:
        chances = chances * _tempered(np.eye(len(ORIENTATIONS))[ORIENTATIONS.index(bones)], BONES_DOUBT)
    return chances / chances.sum()


def evidence_of_file(vertices: np.ndarray) -> np.ndarray:
    """Log-odds of `ORIENTATIONS` by the ground and by the mirror plane, up to a constant, shape (V, 3) -> (24,)."""
    ground = _tempered(_softmax(GROUND_WEIGHT * ground_fit(vertices)), GROUND_DOUBT)
    mirror = _tempered(_softmax(-MIRROR_POWER * np.log(asymmetries(vertices) + MIRROR_FLOOR)), MIRROR_DOUBT)
    return np.asarray(np.log(ground)[_UPS] + np.log(mirror)[_SIDES])


def evidence_of_surface(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Log-odds of `ORIENTATIONS` by what a shape would rest on and by where its top leans, which tells nothing of what
    is up; up to a constant, shapes (N, 3), (N, 3) -> (24,).
    """
    rests = _tempered(_softmax(rest(points, normals) @ REST_WEIGHTS), REST_DOUBT)
    return np.asarray(np.log(rests)[_UPS] + _fronts(np.exp(LEAN_WEIGHT * lean(points)), LEAN_DOUBT))


def _fronts(scores: np.ndarray, doubt: float) -> np.ndarray:
    """Log-odds by a witness that scores fronts and tells nothing of what is up, shape (24,) -> (24,)."""
    return np.asarray(np.log((1 - doubt) * scores / np.maximum(_FOUR @ scores, 1e-300) + doubt / 4))


def ground_fit(vertices: np.ndarray) -> np.ndarray:
    """How well a mesh stands on the plane through 0 with each of `AXES` up, 0 to 1, shape (V, 3) -> (6,).

    It does where its lowest point is at 0 and 0 is in the middle of the other two axes. What lies in one corner of the
    axes, as printing programs have it, stands nowhere: all fits are near 0.
    """
    low, high = vertices.min(axis=0).astype(np.float64), vertices.max(axis=0).astype(np.float64)
    depth = -low / np.maximum(high - low, 1e-12 * max(float((high - low).max()), 1e-30))
    middle = np.exp(-(((depth - 0.5) / _MIDDLE) ** 2))
    fits = []
    for axis in AXES:
        along = "xyz".index(axis[1])
        above = depth[along] if axis[0] == "+" else 1 - depth[along]
        fits.append(np.exp(-((above / _LOW) ** 2)) * np.prod(np.delete(middle, along)))
    return np.array(fits)


def asymmetries(vertices: np.ndarray) -> np.ndarray:
    """How far vertices are from their mirror images across each axis, shape (V, 3) -> (3,).

    The mean distance from a mirrored vertex to the next vertex, of the largest extent, at most 0.05; the plane goes
    through the middle, the median or 0, whichever is best. Left and right mirror each other, so the plane of up and
    front has the least asymmetry; round bodies have several such planes, which then say nothing.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = max(float((high - low).max()), 1e-300)
    some = vertices[np.unique(np.linspace(0, len(vertices) - 1, min(len(vertices), _ASKED)).astype(int))]
    tree = cKDTree(vertices[:: max(len(vertices) // _HELD, 1)], balanced_tree=False)
    found = []
    for axis in range(3):
        planes = {float(low[axis] + high[axis]) / 2, float(np.median(vertices[:, axis])), 0.0}
        means = []
        for plane in planes:
            image = some.copy()
            image[:, axis] = 2 * plane - image[:, axis]
            distances = tree.query(image, distance_upper_bound=_FAR * size)[0] / size
            means.append(float(np.minimum(distances, _FAR).mean()))
        found.append(min(means))
    return np.array(found)


def _softmax(scores: np.ndarray) -> np.ndarray:
    out: np.ndarray = np.exp(scores - scores.max())
    return out / out.sum()


def _tempered(chances: np.ndarray, doubt: float) -> np.ndarray:
    """Probabilities of a witness who with some chance knows nothing."""
    return np.asarray((1 - doubt) * chances + doubt / len(chances))
