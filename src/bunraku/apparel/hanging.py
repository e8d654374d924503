"""What hangs on a person by its shape, as whole parts: skirts, which go round both legs together; hair that comes down
from the skull; and what does not hang: trousers, which go round one leg each, shirts, ends of belts, gloves and shoes.

The segmentation network says how likely points are apparel, as far as it has seen the like, and its border may run
through a part. Shape says where a part begins and ends.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from bunraku.apparel.nodes import LARGE
from bunraku.core.body.layout import JOINT_NAMES, sided
from bunraku.core.geometry.axes import ROUND, covered, direction_bins, directions_about, goes_round
from bunraku.core.geometry.graph import clean_mesh, mesh_parts, unique_edges

# Lengths over the height. All were chosen by eye.
LIKELY, UNLIKELY = 0.5, 0.15  # mean likelihood of a loose piece that is apparel as a whole, or not at all
HAIR = 0.04  # mean likelihood from which on a piece that comes down from the skull is hair
AROUND = 0.9  # of the directions about the middle: a skirt covers so many below the crotch
LEAST = 0.004  # of the surface: smaller pieces below the hips are not looked at
CROTCH = 0.02  # how far below the hips' joints a skirt must reach
FUSED = 0.35  # mean likelihood from which on a surface round both legs is a skirt: thighs touch
DEEP = 0.05  # how far below the hips a skirt of one surface with the body reaches
BULGES, BINS = 0.8, 24  # of its convex hull, that the line of a skirt reaches in so many directions
LEVELS = 0.012  # from one level at which such a surface is cut to the next
STIFF = 0.13  # what is shorter between the knees and the waist is a knot, a pocket or the end of a belt
LONG = 0.12  # what reaches so far below the base of the skull is hair, though some of it lies before the face
BELOW = 0.05  # how far below the base of the skull hair must reach
HELD = 0.03  # hair begins so near to what the head holds; a tail may reach as high
SHIRT, HEM = 0.65, 0.04  # directions about the trunk that a shirt covers; how far below the hips it ends at most
THICK = 0.06  # radius of an upper arm at most
EARS = 0.1  # of the way from the middle of the head to its front: the face begins there
SIDE = 0.9  # share of a leg of trousers that lies on one side
_PELVIS, _WAIST, _NECK, _HEAD = (JOINT_NAMES.index(name) for name in ("pelvis", "spine1", "neck", "head"))
_HIPS, _KNEES, _ANKLES, _SHOULDERS, _ELBOWS = (
    list(sided(part)) for part in ("hip", "knee", "ankle", "shoulder", "elbow")
)
_ARMS = sided("shoulder", "elbow", "wrist")
"""A loose piece that they carry is a sleeve: on one joint of them it would stay behind."""
_ENDS = sided("wrist", "knee", "ankle", "foot")  # what they carry is a glove, a sock or a shoe


def hanging_mask(
    vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, weights: np.ndarray, areas: np.ndarray,
    likely: np.ndarray, mask: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """A mask of what hangs, by whole parts, and its hair, which the head carries whatever lies beside it; each shape
    (V,), bool.

    Args:
        vertices, faces: Rest mesh [m], +Y up and facing +Z, shapes (V, 3) and (F, 3).
        joints, weights: J [m], shape (22, 3), and the weights of the vertices for them, shape (V, 22).
        areas, likely: Areas of the vertices, and their probability to be apparel, shape (V,).
        mask: The apparel of a network, shape (V,), bool.

    Raises:
        CharacterError: The mesh is broken.
    """
    clean = clean_mesh(vertices, faces)
    count = len(clean.vertices)
    first = np.unique(clean.index, return_index=True)[1]
    points, edges = vertices[first], unique_edges(clean.faces, count)
    area = np.bincount(clean.index, areas, count)
    piece = mesh_parts(edges, count)
    size = np.bincount(piece, area)
    mean = np.bincount(piece, area * likely[first]) / np.maximum(size, 1e-12)
    height = float(np.ptp(vertices[:, 1]))
    out = np.array(mask[first])
    small = size < LARGE * size.sum()
    out[(small & (mean > LIKELY))[piece]] = True
    out[(small & (mean < UNLIKELY))[piece]] = False
    shares = weights[first]
    skull = points[shares[:, _HEAD] > 0.5]
    top, front = (float(skull[:, axis].max()) if len(skull) else np.inf for axis in (1, 2))
    hair = np.zeros(count, bool)
    near_skull = np.zeros(len(points), bool)
    if len(skull):
        near_skull = cKDTree(skull).query(points, distance_upper_bound=HELD * height)[0] < np.inf
    skirt, trousers = _below_the_hips(points, edges, piece, area, joints, height)
    legs = np.isin(np.arange(len(size)), piece[trousers])
    for number in np.flatnonzero(small & (mean > HAIR) & ~legs):
        rows = piece == number
        part = points[rows]
        short = part[:, 1].min() > joints[_HEAD, 1] - LONG * height
        comes_down = near_skull[rows].any() and not _skin(part, joints, top, height)
        if comes_down and _hair(part, joints, top, height) and not (short and _face(part, joints, top, front)):
            hair |= rows
    ahead = points[:, 2] > joints[_HEAD, 2] + EARS * (front - joints[_HEAD, 2])
    out &= ~(~small[piece] & (shares[:, _HEAD] > 0.5) & ahead)  # a face that is one surface with the body
    skirt |= _fused_skirt(points, clean.faces, ~small[piece], likely[first], joints, height)
    for number in np.unique(piece[skirt]):
        skirt |= (piece == number) & _to_the_waist(points, piece == number, joints, height)
    out = (out & ~trousers) | skirt
    carried = shares[:, _ENDS].sum(axis=1) > 0.5
    sleeve = small & (np.bincount(piece, area * shares[:, _ARMS].sum(axis=1)) > 0.5 * size)
    carried |= sleeve[piece]
    out = (out & (~carried | (points[:, 1] > joints[_HEAD, 1]))) | skirt | hair
    out &= ~_stays(points, edges, out, skirt | hair, joints, height)
    return out[clean.index], hair[clean.index]


def _hair(points: np.ndarray, joints: np.ndarray, top: float, height: float) -> bool:
    """Whether a piece comes down from the skull beside or behind the neck, or farther out."""
    head = joints[_HEAD]
    if not (points[:, 1] < head[1] - BELOW * height).any() or points[:, 1].max() < head[1] + 0.3 * (top - head[1]):
        return False
    ends = points[:, 1] <= np.percentile(points[:, 1], 10)
    return float(np.hypot(*(points[ends] - head)[:, [0, 2]].T).mean()) > 0.03 * height


def _skin(points: np.ndarray, joints: np.ndarray, top: float, height: float) -> bool:
    """Whether a piece goes round an upper arm or the neck, as skin does and hair does not."""
    thin, high = THICK * height, top - float(joints[_HEAD, 1])
    lines = [(*arm, thin, ROUND) for arm in zip(_SHOULDERS, _ELBOWS, strict=True)]
    for first, last, reach, least in (*lines, (_NECK, _HEAD, 0.5 * high, AROUND)):
        start, line = joints[first], joints[last] - joints[first]
        along = (points - start) @ line / max(float(line @ line), 1e-12)
        away = np.linalg.norm(points - start - along[:, None] * line, axis=1)
        near = (along > 0.2) & (along < 1) & (away < reach)
        if near.any() and covered(directions_about(points[near], start, joints[last])) >= least:
            return True
    return False


def _face(points: np.ndarray, joints: np.ndarray, top: float, front: float) -> bool:
    """Whether a piece has a chin or a mouth."""
    head = joints[_HEAD]
    high = top - head[1]
    low = (points[:, 1] > head[1] - 0.1 * high) & (points[:, 1] < head[1] + 0.3 * high)
    ahead = (np.abs(points[:, 0] - head[0]) < 0.12 * high) & (points[:, 2] > head[2] + 0.6 * (front - head[2]))
    return bool((low & ahead).any())


def _below_the_hips(
    points: np.ndarray, edges: np.ndarray, piece: np.ndarray, area: np.ndarray, joints: np.ndarray, height: float
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Points of skirts and of legs of trousers, (P,) each: what goes round both legs together, or round one."""
    crotch = _crotch(joints, height)
    skirt, trousers = np.zeros(len(points), bool), np.zeros(len(points), bool)
    middle = joints[_HIPS].mean(axis=0)
    below = points[:, 1] < crotch
    part = mesh_parts(edges[below[edges].all(axis=1)], len(points))
    sizes = np.bincount(part[below], area[below], len(points))
    for number in np.flatnonzero(sizes > LEAST * area.sum()):
        rows = below & (part == number)
        members = points[rows]
        if _legs(points, edges, area, rows, crotch, joints):
            trousers |= rows
        elif covered(np.arctan2(members[:, 0] - middle[0], members[:, 2] - middle[2])) >= AROUND:
            skirt |= rows
    return skirt, trousers


def _to_the_waist(points: np.ndarray, rows: np.ndarray, joints: np.ndarray, height: float) -> np.ndarray:
    """Points of a surface with a skirt between the crotch and the waist, shape (P,)."""
    crotch, waist = _crotch(joints, height), 0.5 * float(joints[_PELVIS, 1] + joints[_WAIST, 1])
    return np.asarray((points[:, 1] >= crotch) & (points[:, 1] < waist) & _outer(points, rows, joints))


def _crotch(joints: np.ndarray, height: float) -> float:
    return float(joints[_HIPS, 1].mean()) - CROTCH * height


def _fused_skirt(
    points: np.ndarray, faces: np.ndarray, large: np.ndarray, likely: np.ndarray, joints: np.ndarray, height: float
) -> np.ndarray:  # fmt: skip
    """Points of a skirt that is one surface with the body, shape (P,), bool: cut at any height from the hips down to
    its hem, one line of the surface goes round both legs. `large` are points of a piece that may be the body.
    """
    out = np.zeros(len(points), bool)
    faces = faces[large[faces].all(axis=1)]
    crotch = _crotch(joints, height)
    middle = joints[_HIPS].mean(axis=0)
    first, levels = crotch + 0.5 * LEVELS * height, 0
    while len(faces):
        level = first - levels * LEVELS * height
        lines, ends = _cut(points, faces, level)
        if not len(lines):
            break
        part = mesh_parts(ends, len(lines))
        share = ((points[lines[:, 0], 1] - level) / (points[lines[:, 0], 1] - points[lines[:, 1], 1]))[:, None]
        crossings = points[lines[:, 0]] * (1 - share) + points[lines[:, 1]] * share
        chosen = np.zeros(len(lines), bool)
        for number in np.flatnonzero(np.bincount(part) >= 8):
            ring = crossings[part == number]
            legs = [_leg_at(joints, side, level) for side in (0, 1)]
            around = all(covered(np.arctan2(*(ring - centre)[:, [0, 2]].T)) >= AROUND for centre in (middle, *legs))
            if around and _bulges(ring[:, [0, 2]]):
                chosen |= part == number
        if not chosen.any():
            break
        band = np.flatnonzero(large & (np.abs(points[:, 1] - level) <= 0.5 * LEVELS * height))
        out[lines[chosen].reshape(-1)] = True
        if len(band):
            out[band] = chosen[cKDTree(crossings).query(points[band])[1]]
        levels += 1
    if levels * LEVELS < DEEP or likely[out].mean() < FUSED:
        return np.zeros(len(points), bool)
    return out


def _cut(points: np.ndarray, faces: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Edges of a surface that a level crosses, shape (E, 2), and which of them a face joins, shape (G, 2)."""
    above = points[:, 1] > level
    crossed = faces[(above[faces].any(axis=1)) & ~above[faces].all(axis=1)]
    sides = np.sort(np.stack([crossed, np.roll(crossed, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    over = above[sides[:, 0]] != above[sides[:, 1]]  # two of the three of each face
    lines, index = np.unique(sides[over], axis=0, return_inverse=True)
    return lines, index.reshape(-1, 2)


def _bulges(line: np.ndarray) -> bool:
    """Whether a closed line (P, 2) is nowhere far inside its convex hull; a line about two legs is."""
    centre = line.mean(axis=0)
    hull = ConvexHull(line, qhull_options="QJ").equations  # inside where normal x + offset < 0
    away = line - centre
    bins = direction_bins(np.arctan2(away[:, 0], away[:, 1]), BINS)
    reach = np.zeros(BINS)
    gap = -(hull[:, :2] @ centre + hull[:, 2])
    slope = np.maximum(away @ hull[:, :2].T, 1e-12)
    np.maximum.at(reach, bins, 1 / np.maximum((gap / slope).min(axis=1), 1e-9))  # 1 on the convex line
    return bool((reach[np.unique(bins)] >= BULGES).mean() >= AROUND)


def _leg_at(joints: np.ndarray, side: int, level: float) -> np.ndarray:
    """The middle of a leg at a height [m], shape (3,)."""
    line = joints[[_HIPS[side], _KNEES[side], _ANKLES[side]]]
    return np.array([np.interp(-level, -line[:, 1], line[:, axis]) for axis in range(3)])


def _stays(
    points: np.ndarray, edges: np.ndarray, mask: np.ndarray, hangs: np.ndarray, joints: np.ndarray, height: float
) -> np.ndarray:  # fmt: skip
    """Points of parts that stay with the body, shape (P,), bool: a shirt, which goes round the trunk and ends at the
    hips, and short stiff pieces between the knees and the waist, unless they are behind, as tails are. `hangs` are
    points known to hang.
    """
    out = np.zeros(len(points), bool)
    part = mesh_parts(edges[mask[edges].all(axis=1)], len(points))
    pelvis, knees, waist = joints[_PELVIS], float(joints[_KNEES, 1].max()), float(joints[_WAIST, 1])
    crotch = _crotch(joints, height)
    for number in np.unique(part[mask & ~hangs]):
        rows = mask & (part == number)
        members = points[rows]
        if hangs[rows].any():
            continue
        low, high = members.min(axis=0), members.max(axis=0)
        centre = 0.5 * (low + high)
        round_it = covered(np.arctan2(members[:, 0] - pelvis[0], members[:, 2] - pelvis[2])) >= SHIRT
        if round_it and crotch - HEM * height < low[1] < waist and high[1] < joints[_HEAD, 1]:
            out |= rows
        short = float(np.linalg.norm(high - low)) < STIFF * height
        behind = members[:, 2].max() < pelvis[2] and abs(centre[0] - pelvis[0]) < 0.05 * height
        if short and knees < centre[1] < waist and not behind:
            out |= rows
    return out


def _legs(
    points: np.ndarray, edges: np.ndarray, area: np.ndarray, rows: np.ndarray, crotch: float, joints: np.ndarray
) -> bool:
    """Whether at any height most of what is below the hips goes round one leg."""
    middle, low = joints[_HIPS].mean(axis=0), float(points[rows, 1].min())
    for level in np.linspace(crotch, low, 7)[:-1]:
        below = rows & (points[:, 1] <= level)
        inner = edges[below[edges].all(axis=1)]
        part = mesh_parts(inner, len(points))
        sizes = np.bincount(part[below], area[below], len(points))
        round_one = 0.0
        for number in np.flatnonzero(sizes > 0.1 * sizes.sum()):
            members = points[below & (part == number)]
            left = float((members[:, 0] > middle[0]).mean())
            if max(left, 1 - left) < SIDE:
                continue
            side = int(np.abs(joints[_KNEES, 0] - members[:, 0].mean()).argmin())
            lines = inner[part[inner[:, 0]] == number]  # rings of few points are drawn out along their edges
            between = [points[lines[:, 0]] * (1 - share) + points[lines[:, 1]] * share for share in (0.25, 0.5, 0.75)]
            ring = np.concatenate([members, *between])
            if goes_round(directions_about(ring, joints[_HIPS[side]], joints[_KNEES[side]])):
                round_one += float(sizes[number])
        if round_one > 0.5 * sizes.sum():
            return True
    return False


def _outer(points: np.ndarray, rows: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Points that arms do not carry, shape (P,): hands may hang between the hips and the waist."""
    away = np.abs(points[:, 0] - joints[_PELVIS, 0])
    below = rows & (points[:, 1] < joints[_PELVIS, 1])
    wide = np.percentile(away[below], 98) if below.any() else np.inf
    return np.asarray(away <= 1.1 * wide)
