"""What lies over what: a skirt over legs, and long hair over a skirt, as they do at rest.

Apparel that hangs from the pelvis knows little of the legs under it. The skin of the bare mesh takes it along with the
legs: that looks stiff but lets no leg through. So where a leg has come through, apparel goes back to the skin as far as
it must to lie over the leg again, and takes its surroundings along. Then what was outside of it at rest, hair on its
back, is laid over it in turn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from bunraku.apparel.clothed import LEGS, ClothedCharacter
from bunraku.apparel.nodes import apparel_parts
from bunraku.core.geometry.curves import gaussian, smooth_step
from bunraku.core.geometry.surface import vertex_normals

# Chosen by eye on clips of the wardrobe; benchmarks/apparel_layers.py measures what they do.
LEG = 0.6  # weight of the legs in what counts as a leg
ROUNDS = 2  # of what lies over what, since there may be three layers
BENEATH = 0.002  # how far under a vertex a point must lie at rest, over the character's size [m]
SPREAD = 0.08  # how far what is moved takes its surroundings along, over the same [m]
FEW = 0.25  # share of what is around a vertex that must be moved for it to move by as much
CELL = 0.02  # edge of a cube in which one vertex stands for all others of its part, over the same [m]
SOFT = 0.004  # lack of height from which on it counts in full, over the same [m]
LEAST = 1e-3  # least rise of a way back to the skin, over the same [m]
RISE = 0.2  # how far below the hips all that hangs goes back as far as it must, over the same [m]
SMOOTH = 1.5  # standard deviation in time [frames]
MOST = 0.2  # farthest that anything is laid over something else, over the same [m]


class _How(NamedTuple):
    """How something lies over something else. Lengths are over the character's size [m]; all were chosen by eye."""

    near: int  # points at rest under a vertex that it must stay over
    clear: float  # how far over them it stays where it was farther off at rest
    # distances from the way out of a point at which it begins not to count, and counts no more
    beside: tuple[float, float]
    reach: float  # how near they must be at rest


# Chosen by eye on clips of the wardrobe; benchmarks/apparel_layers.py measures what they do.
OVER_LEGS = _How(32, 0.015, (0.06, 0.14), np.inf)
OVER_PARTS = _How(12, 0.006, (0.06, 0.14), 0.08)


class Layers:
    """The stage for one clothed character and its apparel vertices, in order, shape (A,).

    Attributes:
        seen: Vertices of the mesh that `clip` needs as their skin moves them, shape (S,).
    """

    def __init__(self, clothed: ClothedCharacter, vertices: np.ndarray):
        self.scale, self.seen = clothed.scale, np.zeros(0, np.int64)
        # what moves as one part may be several sheets
        part = apparel_parts(clothed.rest, clothed.faces, clothed.part >= 0)
        hips = clothed.joints[list(LEGS[:2]), 1].mean()
        low = clothed.rest[vertices, 1] < hips
        carrier = clothed.weights[vertices].argmax(axis=1)
        hung = low & ~np.isin(carrier, LEGS)
        legs = ~clothed.apparel & (clothed.weights[:, LEGS].sum(axis=1) > LEG)
        # hair that begins far above is lifted over a leg without a ledge at the hips
        below = smooth_step(hips - clothed.rest[vertices, 1], 0, RISE * self.scale)
        self.below = np.where(carrier == 0, 1, below)[hung].astype(np.float32)
        self.skirt = _Over(clothed, part, vertices, np.flatnonzero(hung), [(None, np.flatnonzero(legs))], OVER_LEGS)
        if not len(self.skirt):
            return  # nothing is laid over anything
        few = _thinned(clothed, part, np.arange(len(part)))
        others = [(number, few[part[few] != number]) for number in range(int(part.max(initial=-1)) + 1)]
        self.rest = _Over(clothed, part, vertices, np.arange(len(vertices)), others, OVER_PARTS)
        used = [self.skirt.vertices, self.skirt.used, *([self.rest.used] if len(self.rest) else [])]
        self.seen = np.unique(np.concatenate(used))
        self.hung, self.legs = (np.searchsorted(self.seen, row) for row in used[:2])
        if len(self.rest):
            # what of it is apparel is where the stage has brought it
            self.beneath = np.searchsorted(self.seen, self.rest.used)
            self.moved = np.flatnonzero(np.isin(self.rest.used, vertices))
            self.mover = np.searchsorted(vertices, self.rest.used[self.moved])

    def clip(
        self, positions: np.ndarray, skinned: np.ndarray, progress: Callable[[float], None] | None = None
    ) -> np.ndarray:
        """Apparel of all frames of a clip laid over what it lies on at rest [m], shapes (N, A, 3) and, of the vertices
        that are `seen`, (N, S, 3); changes are smooth in time. `progress` is called with the share done.
        """
        if not len(self.skirt):
            return positions
        change = np.zeros(positions.shape, np.float32)
        for frame, (moved, skin) in enumerate(zip(positions, skinned, strict=True)):
            change[frame] = self(moved, skin) - moved
            if progress and frame % 16 == 0:
                progress(frame / len(positions))
        rows = np.flatnonzero(change.any(axis=(0, 2)))
        out = np.array(positions)
        out[:, rows] += gaussian(change[:, rows], SMOOTH)
        return out

    def __call__(self, positions: np.ndarray, skinned: np.ndarray) -> np.ndarray:
        """The same for one frame, shapes (A, 3) and (S, 3)."""
        if not len(self.skirt):
            return positions
        out, skinned = np.array(positions, np.float32), np.asarray(skinned, np.float32)
        over = self.skirt
        back = skinned[self.hung] - out[over.rows]
        step = back[over.chosen]
        row, lack, beside, ways = over.lacking(out, skinned[self.legs], np.inf)
        rise = np.einsum("ap,pa->p", ways, step[row])
        share = np.where(rise > LEAST * self.scale, lack * beside / np.maximum(rise, LEAST * self.scale), 0)
        share = over.largest(row, np.minimum(share, 1))
        if share.any():
            share = np.maximum(share, over.spread(share[:, None], share)[over.chosen, 0])
            out[over.rows] += (self.below * (over.back @ share))[:, None] * back
        over = self.rest
        if len(over):
            points = skinned[self.beneath]
            for _ in range(ROUNDS):
                points[self.moved] = out[self.mover]
                row, lack, beside, ways = over.lacking(out, points, MOST * self.scale)
                lack *= beside
                most = over.largest(row, lack)
                if not most.any():
                    break
                # the deepest points say where to, all of them, so that nothing jumps between frames
                sums = np.stack([np.bincount(row, lack**3 * way, len(over)) for way in ways], axis=1)
                push = sums / np.maximum(np.bincount(row, lack**2, len(over)), 1e-12)[:, None]
                out[over.rows] += over.spread(push, np.minimum(most / (SOFT * self.scale), 1))
        return out


class _Over:
    """Apparel vertices (A,), those in `rows` of which may lie over something, and what each lies over at rest: `under`
    for each part of the sheets (V,), or for all (None).
    """

    def __init__(
        self, clothed: ClothedCharacter, part: np.ndarray, vertices: np.ndarray, rows: np.ndarray,
        under: Sequence[tuple[int | None, np.ndarray]], how: _How,
    ):  # fmt: skip
        scale, rest = clothed.scale, np.asarray(clothed.rest, np.float64)
        self.rows, self.vertices = rows, vertices[rows]
        self.chosen = rows[:0]
        if not len(rows):
            return
        chosen = np.searchsorted(self.vertices, _thinned(clothed, part, self.vertices))
        positions, sheet = rest[self.vertices[chosen]], part[self.vertices[chosen]]
        points, gap = np.zeros((len(chosen), how.near), np.int64), np.full((len(chosen), how.near), np.inf)
        for number, beneath in under:
            members = np.flatnonzero(sheet == number) if number is not None else np.arange(len(sheet))
            near = min(how.near, len(beneath))
            if near and len(members):
                nearest = cKDTree(rest[beneath]).query(positions[members], near)
                gap[members, :near] = nearest[0].reshape(len(members), near)
                points[members, :near] = beneath[nearest[1].reshape(len(members), near)]
        row, column = np.nonzero((gap <= how.reach * scale) & np.isfinite(gap))
        points = points[row, column]
        self._beneath(clothed.faces, points)
        ways = vertex_normals(rest[self.used], self.corners)[self.under]
        height = ((positions[row] - rest[points]) * ways).sum(axis=-1)
        counts = height > BENEATH * scale
        if not counts.any():
            return
        self._beneath(clothed.faces, points[counts])
        self.chosen, self.row, self.mine = chosen, row[counts], rows[chosen]
        self.clear = np.minimum(height[counts], how.clear * scale).astype(np.float32)
        self.together = under[0][0] is None  # two layers of a skirt go together
        self.beside = tuple(scale * bound for bound in how.beside)
        self._shares(positions, rest[self.vertices], part[self.vertices], SPREAD * scale)

    def _beneath(self, faces: np.ndarray, points: np.ndarray) -> None:
        """The points that something lies over, and the faces that tell the way out of them."""
        used = np.zeros(int(faces.max()) + 1, bool)
        used[points] = True
        corners = faces[used[faces].any(axis=1)]
        self.used, local = np.unique(np.concatenate([points, corners.reshape(-1)]), return_inverse=True)
        self.under, self.corners = local[: len(points)], local[len(points) :].reshape(-1, 3)

    def _shares(self, positions: np.ndarray, rest: np.ndarray, part: np.ndarray, spread: float) -> None:
        """How much each chosen vertex counts near each other one of its part, and for each vertex."""
        tree, own_part = cKDTree(positions), part[self.chosen]
        pairs = tree.sparse_distance_matrix(tree, 2 * spread, output_type="coo_matrix")
        same = (own_part[pairs.row] == own_part[pairs.col]) | self.together
        share = np.exp(-0.5 * np.square(pairs.data[same] / spread))
        around = csr_matrix((share, (pairs.row[same], pairs.col[same])), shape=(len(positions),) * 2)
        self.around = around.multiply(1 / around.sum(axis=1)).tocsr().astype(np.float32)
        count = min(4, len(positions))
        gap, near = (values.reshape(len(rest), count) for values in tree.query(rest, count))
        weight = np.where((own_part[near] == part[:, None]) | self.together, 1 / (gap**2 + 1e-8), 1e-12)
        weight /= weight.sum(axis=1, keepdims=True)
        begins = np.arange(0, near.size + 1, count)
        self.back = csr_matrix(
            (weight.reshape(-1).astype(np.float32), near.reshape(-1), begins), (len(rest), len(positions))
        )

    def __len__(self) -> int:
        return len(self.chosen)

    def lacking(
        self, positions: np.ndarray, points: np.ndarray, most: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Where a chosen vertex is not as far over one of its points as it must be: the row of the vertex, shape (L,),
        by how much [m], its weight, from 0, far beside the way out of the point, to 1, and these ways, shape (3, L).
        Positions are those of all apparel vertices (A, 3), points those that are `used` (U, 3); vertices that lack
        `most` are passed over.
        """
        ways = vertex_normals(points, self.corners).astype(np.float32).T.take(self.under, axis=1)
        away = positions[self.mine].T.take(self.row, axis=1)
        away -= points.T.take(self.under, axis=1)
        height = np.einsum("ap,ap->p", away, ways)
        lack = self.clear - height
        short = np.flatnonzero((lack > 0) & (lack < most))
        away = away[:, short]
        aside = np.sqrt(np.maximum(np.einsum("ap,ap->p", away, away) - height[short] ** 2, 0))
        beside = smooth_step(aside, *self.beside[::-1]).astype(np.float32)
        return self.row[short], lack[short], beside, ways[:, short]

    def largest(self, row: np.ndarray, values: np.ndarray) -> np.ndarray:
        """The largest of values (L,) of each chosen vertex, by their rows in order (L,); 0 for none, shape (C,)."""
        out = np.zeros(len(self), np.float32)
        if len(row):
            begins = np.flatnonzero(np.diff(row, prepend=-1))
            out[row[begins]] = np.maximum(np.maximum.reduceat(values, begins), 0)
        return out

    def spread(self, values: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """Values of the chosen vertices, weighted by how much they are `moved` (C,), smooth and for all vertices: shape
        (R, D). A vertex between moved ones moves as they do.
        """
        near = self.around @ np.column_stack([values * moved[:, None], moved]).astype(np.float32)
        return np.asarray(self.back @ (near[:, :-1] / np.maximum(near[:, -1:], FEW)))


def _thinned(clothed: ClothedCharacter, part: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """One vertex for each small cube and part."""
    cells = np.column_stack([part[rows], np.floor(clothed.rest[rows] / (CELL * clothed.scale)).astype(np.int64)])
    cells = cells - cells.min(axis=0, initial=0)
    sizes = cells.max(axis=0, initial=0) + 1  # a mesh is a few hundred cubes wide
    return np.asarray(rows[np.unique(np.ravel_multi_index(tuple(cells.T), tuple(sizes)), return_index=True)[1]])
