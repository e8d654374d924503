"""Chains of a mesh without bones for its apparel, and parts that swing as a file beside the character's says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import diags
from scipy.spatial import cKDTree

from bunraku.apparel.chains.chain import Chain, LaidShape, parameters_from_file, parameters_of_laid
from bunraku.apparel.chains.chain_rig import LaidChains, neighbours_of
from bunraku.apparel.chains.sheets import Piece, pieces_of
from bunraku.apparel.clothed import FREE, LOADS, NARROW, SOFTEST, STIFFEST, ClothedCharacter, Swing
from bunraku.core.body.layout import JOINT_COUNT
from bunraku.core.geometry.curves import smooth_step

# Lengths over the size [m]. All were chosen by eye.
LINK = 0.115  # length of a link
WIDE = {"skirt": 0.17, "cape": 0.17, "sleeve": 0.2}  # width of a column
LOCK = 0.13  # width of a column of other kinds
MOST_LINKS, MOST_COLUMNS = 6, 14
LEAST = {"skirt": 8, "cape": 3}  # columns that a sheet has at least
SHORTEST = 0.05  # what reaches less far from where it is held stays there
SHORT = 0.45  # of the farthest end: a shorter end gets a chain of its own only where none is near
CANDIDATES = 700  # points among which ends are looked for
SLOPE = 0.03  # points are ends where none near reaches so much farther
EVENED = 4  # how often ends are moved to the middle of what is nearest to them
HOLDS = 0.9  # of a link: so far from its beginning its skin blends into what it hangs on
BROAD = 0.45  # of a column's width: standard deviation of what it holds
EASED = 6  # how often shares are averaged along the surface
HOLDERS = 6  # links that hold a vertex
SHARED = 0.04  # of what two columns hold: as much as this in common makes them neighbours
LIGHT = 1e-3  # least gravity by which springs are measured, as a factor: a file may say none; chosen by eye


@dataclass(frozen=True, eq=False)
class _Column:
    """A chain of a piece: its points, shape (R + 1, 3), and the distance of its end along the surface [m]."""

    points: np.ndarray
    end: float

    @property
    def links(self) -> int:
        return len(self.points) - 1

    def at(self, along: np.ndarray) -> np.ndarray:
        """Distances along the surface in links."""
        return np.asarray(np.clip(along / self.end, 0, 1) * self.links)

    def beside(self, points: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Distance of points from the position of the column as far along [m]."""
        at = self.at(along)
        row = np.minimum(at.astype(np.int64), self.links - 1)
        position = self.points[row] + (at - row)[:, None] * (self.points[row + 1] - self.points[row])
        return np.asarray(np.linalg.norm(points - position, axis=1))


def shape_chains(clothed: ClothedCharacter) -> LaidChains:
    """Chains over the apparel of a character whose parts hang on one joint each, and what of it they hold.
    CharacterError if the mesh is broken.
    """
    pieces, index = pieces_of(clothed)
    size = clothed.scale
    chains: list[Chain] = []
    near: list[tuple[int, int, float]] = []
    count = int(index.max()) + 1
    links, shares = np.zeros((count, HOLDERS), np.int64), np.zeros((count, HOLDERS))
    total = 0
    for number, piece in enumerate(pieces):
        columns = _columns(piece, size)
        if not columns:
            continue
        wide = WIDE.get(piece.kind, LOCK) * size
        held, common = _hold(piece, columns, wide)
        links[piece.rows], shares[piece.rows] = held[0] + total, held[1]
        base = len(chains)
        for order, column in enumerate(columns):
            bones = JOINT_COUNT + total + np.arange(column.links)
            total += column.links
            width = _half_width(piece, column, wide, size)
            thick = float(np.clip(0.25 * width, 0.004 * size, 0.015 * size))
            chains.append(Chain(
                f"{piece.kind}_{number}_{order}", piece.kind, bones, column.points, piece.joint,
                np.full(column.links, width), thick, parameters_of_laid(piece.kind, _shape(piece, column, width, size)),
            ))  # fmt: skip
        for one, other in zip(*np.nonzero(np.triu(common > SHARED, 1)), strict=True):
            near.append((base + int(one), base + int(other), float(common[one, other])))
    vertices = np.flatnonzero((clothed.part >= 0) & (shares[index].sum(axis=1) > 0))
    return LaidChains(
        tuple(chains),
        tuple(neighbours_of(chains)),
        vertices,
        links[index[vertices]],
        shares[index[vertices]],
        tuple(near),
    )


def _columns(piece: Piece, size: float) -> list[_Column]:
    """The chains of a piece; none where it is too short."""
    wide = WIDE.get(piece.kind, LOCK) * size
    longest = float(piece.along.max())
    if longest < SHORTEST * size:
        return []
    out = []
    for end in _ends(piece, wide, size):
        length = float(piece.along[end])
        rows = int(np.clip(round(length / (LINK * size)), 1, MOST_LINKS))
        rows = max(rows, 2) if length > 0.08 * size else rows
        out.append(_Column(_spine(piece, end, rows, wide), length))
    return out


def _ends(piece: Piece, wide: float, size: float) -> list[int]:
    """Points to which the columns run: the ends of the piece, as far apart as columns are wide."""
    far = np.flatnonzero(piece.along > SHORTEST * size)
    if len(far) > CANDIDATES:
        far = np.sort(np.random.default_rng(0).choice(far, CANDIDATES, replace=False))
        far = np.union1d(far, [piece.along.argmax()])
    points, along = piece.points[far], piece.along[far]
    tree = cKDTree(points)
    highest = np.array([along[near].max() for near in tree.query_ball_point(points, 0.6 * wide)])
    beside = piece.graph.tocoo()
    reached = np.array(piece.along)  # of what an edge away reaches farthest: meshes may be coarse
    np.maximum.at(reached, beside.row, piece.along[beside.col])
    good = np.flatnonzero(along >= np.maximum(highest, reached[far]) - SLOPE * size)
    # a short end counts only where no long one is near
    chosen = [int(good[along[good].argmax()])]
    gap = np.linalg.norm(points[good] - points[chosen[0]], axis=1)
    least = LEAST.get(piece.kind, 1)
    short = 1 + 1.5 * np.clip(SHORT - along[good] / along.max(), 0, 1)
    while len(chosen) < MOST_COLUMNS:
        best = int((gap / short).argmax())
        if gap[best] / short[best] < (wide if len(chosen) >= least else 0.3 * wide):
            break
        chosen.append(int(good[best]))
        gap = np.minimum(gap, np.linalg.norm(points[good] - points[chosen[-1]], axis=1))
    for _ in range(EVENED):  # farthest points lie once and twice as far apart
        nearest = cKDTree(points[chosen]).query(points[good])[1]
        means = [points[good[nearest == index]].mean(axis=0) for index in range(len(chosen))]
        chosen = [
            int(good[nearest == index][np.linalg.norm(points[good[nearest == index]] - mean, axis=1).argmin()])
            for index, mean in enumerate(means)
        ]
    return [int(far[index]) for index in chosen]


def _spine(piece: Piece, end: int, rows: int, wide: float) -> np.ndarray:
    """Means of the points about distances along the way to an end, shape (R + 1, 3)."""
    way = [end]
    while piece.before[way[-1]] >= 0:
        way.append(int(piece.before[way[-1]]))
    way = way[::-1]
    stops = np.linspace(0, piece.along[end], rows + 1)
    guide = np.stack([np.interp(stops, piece.along[way], piece.points[way][:, axis]) for axis in range(3)], axis=1)
    half = 0.35 * stops[1]
    out = []
    for stop, position in zip(stops, guide, strict=True):
        level = np.square(np.clip((piece.along - stop) / half, -8, 8))
        across = np.square(np.linalg.norm(piece.points - position, axis=1) / (0.35 * wide))
        share = np.exp(-0.5 * np.minimum(level + across, 1000)) + 1e-300
        out.append(share @ piece.points / share.sum())
    return np.array(out)


def _shape(piece: Piece, column: _Column, width: float, size: float) -> LaidShape:
    """What is seen at rest of a column, half the width of which is `width` [m]."""
    mine = np.exp(-0.5 * np.square(column.beside(piece.points, piece.along) / max(width, 1e-6)).clip(max=1000))
    mine *= piece.along  # its end is what swings
    way = column.points[-1] - column.points[0]
    return LaidShape(
        column.end / size, np.inf if piece.kind in WIDE else column.end / (2 * width),
        float(mine @ piece.gap / max(float(mine.sum()), 1e-9)) / size, float(-way[1] / max(np.linalg.norm(way), 1e-9)),
    )  # fmt: skip


def _half_width(piece: Piece, column: _Column, wide: float, size: float) -> float:
    """Half the width of what a column holds [m]."""
    away = column.beside(piece.points, piece.along)
    mine = (away < 0.6 * wide) & (piece.along > 0.3 * column.end)
    spread = float(np.percentile(away[mine], 80)) if mine.sum() > 3 else 0.25 * wide
    return float(np.clip(min(spread, 0.5 * wide), 0.006 * size, 0.08 * size))


def _hold(piece: Piece, columns: list[_Column], wide: float) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Links that hold the points of a piece and how much, each shape (P, HOLDERS), numbered from its first; and how
    much of what one column holds each other one holds too, shape (C, C).
    """
    away = np.stack([column.beside(piece.points, piece.along) for column in columns], axis=1)
    near = away.min(axis=1, keepdims=True)
    share = np.exp(-0.5 * (np.square(away) - np.square(near)) / (BROAD * wide) ** 2)
    share = _smooth(piece, share / share.sum(axis=1, keepdims=True))
    size = np.sqrt(np.square(share).sum(axis=0))
    common = (share.T @ share) / np.maximum(np.outer(size, size), 1e-12)
    held = np.zeros((len(piece.rows), sum(column.links for column in columns)))
    first = 0
    for number, column in enumerate(columns):
        at = column.at(piece.along)
        free = smooth_step(at / HOLDS, 0.0, 1.0) * share[:, number]
        lower = np.clip(np.floor(at - 0.5), 0, column.links - 1).astype(np.int64)
        upper = np.minimum(lower + 1, column.links - 1)
        more = np.clip(at - 0.5 - lower, 0, 1)
        rows = np.arange(len(at))
        held[rows, first + lower] += (1 - more) * free
        held[rows, first + upper] += more * free
        first += column.links
    free = held.sum(axis=1, keepdims=True)
    held = _smooth(piece, held)
    held *= free / np.maximum(held.sum(axis=1, keepdims=True), 1e-12)
    return _most(held), common


def _smooth(piece: Piece, values: np.ndarray) -> np.ndarray:
    """Values averaged along the surface."""
    joined = piece.graph.copy()
    joined.data = np.ones_like(joined.data)
    degree = np.asarray(joined.sum(axis=1)).reshape(-1)
    mean = diags(1 / np.maximum(degree, 1)) @ joined
    alone = (degree == 0)[:, None]
    for _ in range(EASED):
        values = np.where(alone, values, 0.5 * values + 0.5 * (mean @ values))
    return values


def _most(held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The links that hold most of each point, and how much, faded so that the next one falls away to 0."""
    count = min(HOLDERS, held.shape[1])
    order = np.argsort(-held, axis=1, kind="stable")[:, :count]
    held_most = np.take_along_axis(held, order, axis=1)
    total = held.sum(axis=1, keepdims=True)
    if held.shape[1] > count:
        next_one = -np.partition(-held, count, axis=1)[:, count : count + 1]
        held_most = held_most - next_one
    held_most = held_most * total / np.maximum(held_most.sum(axis=1, keepdims=True), 1e-12)
    links, shares = np.zeros((len(held), HOLDERS), np.int64), np.zeros((len(held), HOLDERS))
    links[:, :count], shares[:, :count] = order, np.where(total > 1e-4, held_most, 0.0)
    return links, shares


def with_parts_from_file(clothed: ClothedCharacter, tables: Mapping[str, Mapping[str, float]]) -> ClothedCharacter:
    """A clothed character whose apparel swings as the tables of a file say (`parameters_beside`); the rest stays.

    A part gets the mean of the parameters of the chains over it, by how much they hold. Where each vertex has a
    `swing`, those that a chain holds swing as far in all as its links together. Masses do not count here.
    CharacterError if the mesh is broken.
    """
    if not tables:
        return clothed
    laid = shape_chains(clothed)
    changes = [parameters_from_file(chain.kind, chain.name, tables) for chain in laid.chains]
    if not any(changes):
        return clothed
    held = _held(laid)
    counts = np.zeros((len(clothed.stiffness), len(laid.chains)))
    np.add.at(counts, clothed.part[laid.vertices], held)
    total = np.maximum(counts.sum(axis=1), 1e-9)
    stiffness, damping = np.array(clothed.stiffness, np.float64), np.array(clothed.damping, np.float64)
    limit = np.array(clothed.limit, np.float64)
    new = [_numbers(change) for change in changes]
    for number, (ratio, lost, turn) in enumerate(new):
        share = counts[:, number] / total
        if ratio is not None:
            stiffness += share * (ratio - clothed.stiffness)
        if lost is not None:
            damping += share * (lost - clothed.damping)
        if turn is not None:
            limit += share * (turn - clothed.limit)
    swing = clothed.swing
    if swing is not None:
        swing = np.array(swing)
        for number, chain in enumerate(laid.chains):
            rows = laid.vertices[(held[:, number] > 0.5 * held.sum(axis=1)) & (held[:, number] > 0)]
            if changes[number] and len(rows):
                swing[rows] = Swing.of_rows(swing[rows]).with_parameters(changes[number], len(chain)).rows()
    return replace(
        clothed, stiffness=np.clip(stiffness, SOFTEST, STIFFEST).astype(np.float32),
        damping=damping.astype(np.float32), limit=limit.astype(np.float32), swing=swing,
    )  # fmt: skip


def _held(laid: LaidChains) -> np.ndarray:
    """Share of each vertex that each chain holds, shape (A, C)."""
    owner = np.zeros(sum(map(len, laid.chains)), np.int64)
    for number, chain in enumerate(laid.chains):
        owner[chain.bones - JOINT_COUNT] = number
    out = np.zeros((len(laid.vertices), len(laid.chains)))
    for links, shares in zip(laid.links.T, laid.shares.T, strict=True):
        np.add.at(out, (np.arange(len(out)), owner[links]), shares)
    return out


def _numbers(table: Mapping[str, float]) -> tuple[float | None, float | None, float | None]:
    """Stiffness, damping and limit [rad] as parts have them; None for what the file does not say."""
    limit = float(np.clip(np.radians(table["limit"]), NARROW, FREE)) if "limit" in table else None
    ratio = None if limit is None else LOADS - float(np.log10(limit))
    if table.get("stiffness", 0.0) > 0:
        spring = float(np.log10(table["stiffness"] / max(table.get("gravity", 1.0), LIGHT)))
        ratio = spring if ratio is None else max(ratio, spring)
    return ratio, table.get("damping"), limit
