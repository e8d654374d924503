"""What a file tells about how its character stands, beside the shape that the network sees: where the ground is, what
mirrors it, and what its format is used for.

Each is a witness with a doubt: with that chance it knows nothing, so none can outvote the others alone, and the odds
that it can give are bounded. Witnesses are combined by adding their log-odds (naive Bayes).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from bunraku.formats.frames import BARE
from bunraku.geometry.axes import AXES, ORIENTATIONS

__all__ = ["asymmetries", "combined", "format_weights", "ground_fit", "has_rule", "witnesses"]

NETWORK_DOUBT = 0.05
"""Where the network says 97 % or more it is right for 93 % of 180 meshes that training did not see."""
GROUND_DOUBT, GROUND_WEIGHT = 0.03, 10.0
"""Of 151 characters of the training archive half stand on the plane through 0, and none has such a plane on a wrong
side; on its own it gives odds of at most 195 to 1 for one axis against another."""
MIRROR_DOUBT, MIRROR_WEIGHT = 0.01, 800.0
"""The plane with the least asymmetry is the one between left and right for 150 of the 151; at most 298 to 1."""
_LOW, _MIDDLE = 0.05, 0.25
"""How far from the lowest point the ground may be, and from the middle the origin, as shares of the extent."""
_ASKED = 2000
"""Vertices whose mirror images are looked for."""
_FAR = 0.05
"""An asymmetry that is as good as none, of the largest extent."""
_UPS = np.array([AXES.index(up) for up, _ in ORIENTATIONS])
_SIDES = np.array([3 - "xyz".index(up[1]) - "xyz".index(front[1]) for up, front in ORIENTATIONS])


def _weights(table: dict[tuple[str, str], float], up: str, of_up: float = 2.0) -> np.ndarray:
    """A prior: the weights of a table, `of_up` for others with that axis up, 1 for all others; they sum to 1, shape
    (24,).
    """
    weights = np.array([table.get(axes, of_up if axes[0] == up else 1.0) for axes in ORIENTATIONS])
    return weights / weights.sum()


_Y_UP = _weights({("+y", "+z"): 6, ("+z", "-y"): 2}, "+y")
_Z_UP = _weights({("+z", "-y"): 6, ("+y", "+z"): 3}, "+z")
_RULE = _weights({("+y", "+z"): 1500, ("+y", "-z"): 30, ("+z", "-y"): 20}, "+y", 15)


def has_rule(suffix: str) -> bool:
    """Whether a format says which axis is up; all do but OBJ, PLY, STL, and "" for a mesh that is of no file."""
    return bool(suffix) and suffix not in BARE


def format_weights(suffix: str) -> np.ndarray:
    """How likely each of `ORIENTATIONS` is in files of a format before anyone looks at the mesh, shape (24,).

    OBJ, and meshes of no file: 6 for +Y up and +Z ahead, 2 for the other fronts with +Y up and for +Z up facing -Y, 1
    for each of the rest. STL and PLY: 6 for +Z up facing -Y, 3 for +Y up facing +Z, 2 for the other fronts with +Z up.
    Formats with a rule: 1500 for the rule, 30 for facing backwards, 20 for +Z up facing -Y, 15 for facing sideways,
    which is too much for any one witness.
    """
    if has_rule(suffix):
        return _RULE
    return _Z_UP if suffix in (".stl", ".ply") else _Y_UP


def combined(network: np.ndarray, vertices: np.ndarray | None = None, prior: np.ndarray | None = None) -> np.ndarray:
    """How likely each of `ORIENTATIONS` is by all witnesses, shape (24,), sums to 1.

    Args:
        network: What the network gives each orientation, shape (24,), sums to 1.
        vertices: Rest positions as the file has them, any unit, shape (V, 3); without them ground and mirror are not
            asked.
        prior: Weights of `format_weights`, shape (24,); equal where not given. A weight of 0 rules an orientation out.
    """
    logs = np.log(_doubted(network, NETWORK_DOUBT))
    if vertices is not None:
        logs = logs + witnesses(vertices)
    chances: np.ndarray = np.exp(logs - logs.max()) * (1 if prior is None else prior)
    return chances / chances.sum()


def witnesses(vertices: np.ndarray) -> np.ndarray:
    """Log-odds of `ORIENTATIONS` by the ground and by the mirror plane, up to a constant, shape (V, 3) -> (24,)."""
    ground = _doubted(_softmax(GROUND_WEIGHT * ground_fit(vertices)), GROUND_DOUBT)
    mirror = _doubted(_softmax(-MIRROR_WEIGHT * asymmetries(vertices)), MIRROR_DOUBT)
    return np.asarray(np.log(ground)[_UPS] + np.log(mirror)[_SIDES])


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
    tree = cKDTree(vertices, balanced_tree=False)
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


def _doubted(chances: np.ndarray, doubt: float) -> np.ndarray:
    """Probabilities of a witness who with some chance knows nothing."""
    return np.asarray((1 - doubt) * chances + doubt / len(chances))
