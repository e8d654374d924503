"""Evidence of how a character stands beside the network's, as a list of small objects, and its combination."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from bunraku.anatomy.names.bone_words import part_of_name
from bunraku.core.geometry.axes import AXES, BARE, ORIENTATIONS, axis_vector
from bunraku.core.geometry.surface import face_normals

_UPS = np.array([AXES.index(up) for up, _ in ORIENTATIONS])
_SAME_UP = _UPS[:, None] == _UPS
_FRONTS = np.array([AXES.index(front) for _, front in ORIENTATIONS])
_SIDES = np.array([3 - "xyz".index(up[1]) - "xyz".index(front[1]) for up, front in ORIENTATIONS])
_AXIS_VECTORS = np.array([axis_vector(axis) for axis in AXES])


@dataclass(frozen=True, eq=False)
class ShapeView:
    """What evidence is taken from, as the file has it."""

    vertices: np.ndarray | None = None  # rest positions, any unit, shape (V, 3)
    # points and unit normals spread evenly over the surface, shape (N, 3) each
    surface: tuple[np.ndarray, np.ndarray] | None = None
    # faces (F, 3) and the colours of the vertices, sRGB, shape (V, 3), uint8
    paint: tuple[np.ndarray, np.ndarray] | None = None
    # names of n bones or meshes, and where they are, shape (n, 3)
    named: tuple[Sequence[str], np.ndarray] | None = None


@dataclass(frozen=True)
class Evidence:
    """Something that tells how a shape stands."""

    doubt: float  # the chance that it knows nothing
    # What its log-odds count by, since the sources are not quite independent. Those of all sources were fitted together
    # by logistic regression on 354 characters, 199 of them files of 5 lots from public repositories; without the last
    # lot they differ by less than 0.1, and 56 of its 57 fronts are right, none is wrong unannounced, 4 are doubted.
    counts: float = 1.0

    def log_odds(self, view: ShapeView) -> np.ndarray:
        """Log-odds of `ORIENTATIONS`, up to a constant, shape (24,); zeros where the view lacks what it needs."""
        raise NotImplementedError

    def of_axes(self, scores: np.ndarray) -> np.ndarray:
        """Log-odds of axes by the logs of their chances, shape (n,)."""
        chances: np.ndarray = np.exp(scores - scores.max())
        return np.log(tempered(chances / chances.sum(), self.doubt))

    def of_fronts(self, scores: np.ndarray) -> np.ndarray:
        """Log-odds by scores of fronts, which tell nothing of what is up, shape (24,) -> (24,)."""
        share = scores / np.maximum(_SAME_UP @ scores, 1e-300)
        return np.asarray(np.log((1 - self.doubt) * share + self.doubt / 4))


def tempered(chances: np.ndarray, doubt: float) -> np.ndarray:
    """Probabilities by evidence that with some chance knows nothing."""
    return np.asarray((1 - doubt) * chances + doubt / len(chances))


@dataclass(frozen=True)
class RestEvidence(Evidence):
    """What a shape would rest on: bodies stand on flat and wide bases."""

    doubt: float = 0.05  # what lies on its back rests well too; at most 115 to 1 between two axes
    counts: float = 0.94
    # of the three numbers of `rest`: those of the least cross-entropy on 151 characters of the training archive
    weights: tuple[float, float, float] = (0.20, 1.49, 5.87)
    flat: float = 0.012  # how high over the lowest point what lies flat may be, as a share of the largest extent
    low: float = 0.025  # how high what carries may be, likewise
    down: float = -0.9  # cosine from which on a normal points down
    edge: float = 0.02  # how softly the middle is inside what carries it, as a share of the largest extent
    least: float = 2e-3  # share of the surface that counts as nothing flat

    def log_odds(self, view: ShapeView) -> np.ndarray:
        if view.surface is None:
            return np.zeros(len(ORIENTATIONS))
        return self.of_axes(self.rest(*view.surface) @ np.array(self.weights))[_UPS]

    def rest(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """How a shape would rest on the ground with each of `AXES` up, shape (6, 3).

        Args:
            points: Spread evenly over its surface, any unit, shape (N, 3).
            normals: Their unit normals, shape (N, 3).

        Returns:
            Log of the share of the surface that lies flat on the ground; whether its middle is above what carries it,
            from 0 to 1; and the area within what carries it, as a share of its footprint.
        """
        extent = max(float(np.ptp(points, axis=0).max()), 1e-100)
        middle = points.mean(axis=0)
        rows = []
        for axis, up in zip(AXES, _AXIS_VECTORS, strict=True):
            height = points @ up
            height = (height - height.min()) / extent
            flat = float(((height < self.flat) & (normals @ up < self.down)).mean())
            across = np.delete(np.arange(3), "xyz".index(axis[1]))
            inside, base = _carried(points[height < self.low][:, across] / extent, middle[across] / extent)
            footprint = max(float(np.prod(np.ptp(points[:, across], axis=0))) / extent**2, 1e-12)
            above = 1 / (1 + np.exp(-np.clip(inside / self.edge, -50, 50)))
            rows.append((np.log(flat + self.least), above, base / footprint))
        return np.array(rows)


@dataclass(frozen=True)
class ColorEvidence(Evidence):
    """A front has more colours than a back."""

    doubt: float = 0.3  # what is painted on a back may be richer than a face: at most 10 to 1 between two fronts
    # Of the log of `variety`. On every second character of the archive, of the 60 that have colours, the most varied of
    # four sides is the front for 70 % and the front is more varied than the back for 80 %; of the 19 files for priors
    # that have colours, for 68 and 79 %. The cross-entropy of the four, where equal chances have 1.39, is 1.00 and
    # 0.88.
    weight: float = 8.0
    plain: float = 3e-3  # a variance of colours that is as good as none
    facing: float = 0.3  # cosine from which on a face counts as seen, and more the straighter it looks

    def log_odds(self, view: ShapeView) -> np.ndarray:
        if view.vertices is None or view.paint is None:
            return np.zeros(len(ORIENTATIONS))
        return self.of_fronts(self.front_scores(self.variety(view.vertices, *view.paint))[_FRONTS])

    def variety(self, vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray) -> np.ndarray:
        """Variance of the colours seen from each of `AXES`, by area, shape (6,); arguments as in `ShapeView`."""
        normals = face_normals(vertices, faces).astype(np.float64)
        areas = np.linalg.norm(normals, axis=1)
        middles = vertices[faces].mean(axis=1) - vertices.mean(axis=0)
        outward = -1 if (middles * normals).sum() < 0 else 1  # some files have their faces inside out
        seen = colors[faces].mean(axis=1) / 255
        variances = []
        for axis in _AXIS_VECTORS:
            share = areas * np.clip(outward * (normals @ axis) / np.maximum(areas, 1e-300) - self.facing, 0, None)
            share = share / max(float(share.sum()), 1e-300)
            variances.append(float(share @ np.square(seen - share @ seen).sum(axis=1)))
        return np.array(variances)

    def front_scores(self, varied: np.ndarray) -> np.ndarray:
        """How much rather each of `AXES` is the front than others at a right angle to the same up axis, by `variety`,
        shape (6,); the largest is 1.
        """
        logs = self.weight * np.log(varied + self.plain)
        return np.asarray(np.exp(logs - logs.max()))


@dataclass(frozen=True)
class GroundEvidence(Evidence):
    """Many files have the ground at 0, below the middle of the body."""

    # of 151 characters of the training archive half stand on the plane through 0, and none has such a plane on a wrong
    # side; at most 195 to 1 for one axis against another
    doubt: float = 0.03
    counts: float = 1.19
    weight: float = 10.0  # of the fit
    low: float = 0.05  # how far from the lowest point the ground may be, as a share of the extent
    middle: float = 0.25  # how far from the middle the origin may be, likewise

    def log_odds(self, view: ShapeView) -> np.ndarray:
        if view.vertices is None:
            return np.zeros(len(ORIENTATIONS))
        return self.of_axes(self.weight * self.fit(view.vertices))[_UPS]

    def fit(self, vertices: np.ndarray) -> np.ndarray:
        """How well a mesh stands on the plane through 0 with each of `AXES` up, 0 to 1, shape (V, 3) -> (6,).

        It does where its lowest point is at 0 and 0 is in the middle of the other two axes. What lies in one corner of
        the axes, as printing programs have it, stands nowhere: all fits are near 0.
        """
        low, high = vertices.min(axis=0).astype(np.float64), vertices.max(axis=0).astype(np.float64)
        depth = -low / np.maximum(high - low, 1e-12 * max(float((high - low).max()), 1e-30))
        middle = np.exp(-(((depth - 0.5) / self.middle) ** 2))
        fits = []
        for axis in AXES:
            along = "xyz".index(axis[1])
            above = depth[along] if axis[0] == "+" else 1 - depth[along]
            fits.append(np.exp(-((above / self.low) ** 2)) * np.prod(np.delete(middle, along)))
        return np.array(fits)


@dataclass(frozen=True)
class MirrorEvidence(Evidence):
    """Left and right mirror each other."""

    doubt: float = 0.01  # at most 298 to 1 between two planes
    counts: float = 0.68
    # The chance that a plane is the one between left and right goes with its asymmetry to the power of -10: what is
    # nearly symmetric across one plane alone has it for sure, and a lion in mid-step, whose planes differ by a fifth,
    # tells little. Fitted on the 37 files of `benchmarks/foreign_files.json` that are for it, where it errs in 3.
    power: float = 10.0
    floor: float = 1e-4  # an asymmetry that is as good as 0
    asked: int = 2000  # vertices whose mirror images are looked for
    held: int = 60_000  # vertices, evenly drawn from more, among which the nearest to a mirror image is looked for
    far: float = 0.05  # an asymmetry that is as large as any, as a share of the largest extent

    def log_odds(self, view: ShapeView) -> np.ndarray:
        if view.vertices is None:
            return np.zeros(len(ORIENTATIONS))
        return self.of_axes(-self.power * np.log(self.asymmetries(view.vertices) + self.floor))[_SIDES]

    def asymmetries(self, vertices: np.ndarray) -> np.ndarray:
        """How far vertices are from their mirror images across each axis, shape (V, 3) -> (3,).

        The mean distance from a mirrored vertex to the next vertex, as a share of the largest extent, at most `far`;
        the plane goes through the middle, the median or 0, whichever is best. The plane of up and front has the least
        asymmetry; round bodies have several such planes, which then say nothing.
        """
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        size = max(float((high - low).max()), 1e-300)
        sample = vertices[np.unique(np.linspace(0, len(vertices) - 1, min(len(vertices), self.asked)).astype(int))]
        tree = cKDTree(vertices[:: max(len(vertices) // self.held, 1)], balanced_tree=False)
        found = []
        for axis in range(3):
            means = []
            for plane in {float(low[axis] + high[axis]) / 2, float(np.median(vertices[:, axis])), 0.0}:
                image = sample.copy()
                image[:, axis] = 2 * plane - image[:, axis]
                distances = tree.query(image, distance_upper_bound=self.far * size)[0] / size
                means.append(float(np.minimum(distances, self.far).mean()))
            found.append(min(means))
        return np.array(found)


@dataclass(frozen=True)
class NameEvidence(Evidence):
    """A face is in front of its head and toes of their feet, and a tail is behind, where bones or meshes say so."""

    doubt: float = 0.013
    # of faces, tails and toes. Like the doubt, those of the least cross-entropy on 229 rigs and files of named meshes:
    # of 137 named tails in rigs all are behind, of 91 faces 96 % and of 105 toes 92 % ahead rather than aside or behind
    weights: tuple[float, float, float] = (8.8, 6.3, 6.0)
    near: float = 0.03  # what is ahead by less tells little, as a share of the largest extent; chosen

    def log_odds(self, view: ShapeView) -> np.ndarray:
        if view.vertices is None or view.named is None:
            return np.zeros(len(ORIENTATIONS))
        return self.of_fronts(np.exp(self.ahead(view.vertices, *view.named) @ np.array(self.weights)))

    def ahead(self, vertices: np.ndarray, names: Sequence[str], places: np.ndarray) -> np.ndarray:
        """How far ahead of its head, of the tail, and of the feet the face, the body and the toes are with each of
        `ORIENTATIONS`, from -1 to 1, 0 where there is no such name, shape (24, 3); arguments as in `ShapeView`.
        """
        low, high = vertices.min(axis=0).astype(np.float64), vertices.max(axis=0).astype(np.float64)
        kinds = np.array(["" if target else kind for kind, _, _, target in map(part_of_name, names)])
        at: dict[str, np.ndarray] = {kind: places[kinds == kind].mean(axis=0) for kind in np.unique(kinds)} | {
            "": (low + high) / 2
        }
        head, foot = at.get("head", at.get("neck", at[""])), at.get("foot", at.get("hind_paw"))
        toe = at.get("toe", foot)
        ways = np.stack([
            at.get("face", at.get("face_bone", head)) - head,
            at[""] - at.get("tail", at[""]),
            np.zeros(3) if foot is None or toe is None else toe - foot,
        ])  # fmt: skip
        along = ways @ _AXIS_VECTORS.T
        level = np.maximum(np.square(ways).sum(axis=1)[:, None] - np.square(along[:, _UPS]), 0)
        least = self.near * max(float((high - low).max()), 1e-30)
        return np.asarray(along[:, _FRONTS] / np.sqrt(level + least**2)).T


EVIDENCE: tuple[Evidence, ...] = (RestEvidence(), ColorEvidence(), GroundEvidence(), MirrorEvidence(), NameEvidence())
"""All evidence beside that of the network and the bones."""


def gathered(view: ShapeView) -> np.ndarray:
    """Log-odds of `ORIENTATIONS` by all `EVIDENCE`, up to a constant, shape (24,)."""
    return np.asarray(sum(evidence.counts * evidence.log_odds(view) for evidence in EVIDENCE))


@dataclass(frozen=True)
class Combination:
    """The network, the other evidence, what files of a kind are like, and the bones, put together."""

    # where the network says 97 % or more it is right for 93 % of 180 meshes that training did not see
    network_doubt: float = 0.05
    bones_doubt: float = 0.03  # the chance that bones tell nothing; chosen
    # the chance that left and right are named the other way, so that what seems the front is the back: of 114 rigs of
    # the archive and 77 of the lots whose bones tell, five
    mirrored: float = 0.026
    network_counts: float = 0.85  # as the `counts` of other evidence
    # a shape of so many vertices has told half of what it could: of 60 characters of the archive, simplified, the
    # network is right for 82 % at 1,000 vertices, 77 % at 106, 50 % at 31 and 25 % at 15, and its log-odds have the
    # least cross-entropy times 1, 1, 0.8 and 0.35; those of the mirror plane likewise, times 1, 1, 0.45 and 0.35
    few: int = 12
    looked_at: int = 2000  # vertices among which those at one position count once

    def worth(self, vertices: np.ndarray) -> float:
        """What share of its word the evidence of a shape with these vertices (V, 3) deserves."""
        distinct = len(np.unique(vertices[:: max(len(vertices) // self.looked_at, 1)], axis=0))
        return distinct / (distinct + self.few)

    def __call__(
        self,
        network: np.ndarray,
        logs: np.ndarray,
        worth: float = 1.0,
        prior: np.ndarray | None = None,
        bones: tuple[str, str] | None = None,
    ) -> np.ndarray:
        """How likely each of `ORIENTATIONS` is, calibrated, shape (24,), sums to 1.

        Args:
            network: What the network gives each orientation, shape (24,), sums to 1.
            logs: What other evidence says (`gathered`), shape (24,).
            worth: What share of its word all of that deserves.
            prior: Weights of `kind_weights`, shape (24,); equal where not given. A weight of 0 rules an orientation
                out.
            bones: Up and front as the bones have them, where they tell.
        """
        logs = (self.network_counts * np.log(tempered(network, self.network_doubt)) + logs) * worth
        chances: np.ndarray = np.exp(logs - logs.max()) * (1 if prior is None else prior)
        if bones is not None:
            back = bones[0], bones[1].translate(str.maketrans("+-", "-+"))
            names = np.zeros(len(ORIENTATIONS))
            names[[ORIENTATIONS.index(bones), ORIENTATIONS.index(back)]] = 1 - self.mirrored, self.mirrored
            chances = chances * tempered(names, self.bones_doubt)
        return chances / chances.sum()


def _carried(low: np.ndarray, middle: np.ndarray) -> tuple[float, float]:
    """How far a point is inside the hull of others (N, 2), and the area of that hull; -1 and 0 where they have none."""
    if len(low) < 3 or np.ptp(low, axis=0).min() < 1e-6:
        return -1.0, 0.0
    try:
        hull = ConvexHull(low)
    except QhullError:  # all on a line
        return -1.0, 0.0
    return -float((hull.equations[:, :2] @ middle + hull.equations[:, 2]).max()), float(hull.volume)


def _weights(table: dict[tuple[str, str], float], up: str, of_up: float, rest: float) -> np.ndarray:
    """A prior (24,) that sums to 1: weights of a table, `of_up` for others with that axis up, `rest` for all else."""
    weights = np.array([table.get(axes, of_up if axes[0] == up else rest) for axes in ORIENTATIONS])
    return weights / weights.sum()


# Measured: counts of the 37 files for priors in benchmarks/foreign_files.json and of 199 of five lots from public
# repositories, with a little for what none of them does; +X and -X alike, since mirrors of characters are characters.
_TOLD = _weights({("+y", "+z"): 67, ("+y", "-z"): 6, ("+z", "-y"): 1}, "+y", 0.5, 0.05)
_MOVED = _weights({("+y", "+z"): 52, ("+y", "-z"): 0.3, ("+z", "-y"): 0.1}, "+y", 1, 0.02)
_BARE = _weights({("+y", "+z"): 66, ("+y", "-z"): 8, ("+z", "-y"): 1.5}, "+y", 7.5, 0.3)
_PRINTED = _weights(
    {("+z", "-y"): 8, ("+y", "+z"): 6.4, ("+y", "-z"): 4.1, **{("+y", front): 0.7 for front in ("+x", "-x")}},
    "+z", 2, 0.3,
)  # fmt: skip


def has_rule(suffix: str) -> bool:
    """Whether a format says which axis is up; all do but OBJ, PLY, STL, and "" for a mesh that is of no file."""
    return bool(suffix) and suffix not in BARE


def kind_weights(suffix: str, moved: bool = False, told: bool = False) -> np.ndarray:
    """How likely each of `ORIENTATIONS` is in files of a kind before anyone looks at the mesh, shape (24,).

    With a skin or a clip 52 of 54 stand along +Y and face +Z; 67 of 75 whose bones tell left from right, which then
    say what the others do. Of 97 others 66 do. STL and PLY, 7 of them of one maker, have +Z up and face -Y.

    Args:
        suffix: The format, such as ".stl"; "" where there is no file.
        moved: Whether the file has a skin or a clip, so that it stood well for an animator.
        told: Whether its bones tell how it stands.
    """
    if suffix in (".stl", ".ply"):
        return _PRINTED
    return (_TOLD if told else _MOVED) if moved and has_rule(suffix) else _BARE
