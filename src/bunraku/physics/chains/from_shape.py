"""Chains of a mesh without bones for its apparel: a spine a lock for hair, tails, ears and ribbons, columns of links
with ties all round for skirts, sheets of them for capes and sleeves, and a smooth skin on them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.body.layout import JOINT_COUNT
from bunraku.physics.chains.chain import Chain, laid_manner
from bunraku.physics.chains.laid import LaidChains
from bunraku.physics.chains.sheets import Piece, pieces_of

__all__ = ["shape_chains"]

LINK = 0.115
"""Length of a link over the size [m]."""
WIDE = {"skirt": 0.19, "cape": 0.17, "sleeve": 0.2}
"""Width of a column over the size [m]."""
LOCK = 0.16  # of other kinds
MOST_LINKS, MOST_COLUMNS = 6, 14
SHORTEST = 0.025
"""Over the size [m]: a piece that reaches less far stays with what it hangs on."""
HOLDS = 0.5  # of a link: as far from where it begins its skin goes over to what it hangs on
TIED = ("skirt", "cape", "sleeve")


@dataclass(frozen=True, eq=False)
class _Column:
    """A chain of a piece: its points, and how far along the surface the first and the last are."""

    angle: float
    points: np.ndarray
    start: float
    end: float
    width: float


def shape_chains(clothed: ClothedCharacter) -> LaidChains:
    """Chains over the apparel of a mesh, and what of it they hold.

    Args:
        clothed: The character; its parts hang whole on one joint each.

    Raises:
        CharacterError: The mesh is broken.
    """
    pieces, index = pieces_of(clothed)
    size = clothed.scale
    chains: list[Chain] = []
    ties: list[tuple[int, int]] = []
    first: dict[int, tuple[list[_Column], list[int]]] = {}  # of a piece: its columns, and number of their first links
    ends: dict[int, list[int]] = {}
    count = int(index.max()) + 1
    links, shares = np.zeros((count, 4), np.int64), np.zeros((count, 4))
    total = 0
    for number, piece in enumerate(pieces):
        columns = _columns(piece, size)
        holders = _holders(piece, pieces, first, ends, columns)
        if not columns:  # too short for links of its own: it goes with what it hangs on
            above = ends.get(piece.above)
            if above:
                links[piece.rows, 0], shares[piece.rows, 0] = above[0], 1.0
                ends[number], first[number] = above, first[piece.above]
            continue
        starts, lasts, base = [], [], len(chains)
        for place, column in enumerate(columns):
            rows = len(column.points) - 1
            starts.append(total)
            bones = JOINT_COUNT + total + np.arange(rows)
            total += rows
            lasts.append(total - 1)
            width = np.full(rows, column.width)
            chains.append(
                Chain(
                    f"{piece.kind}_{number}_{place}",
                    piece.kind,
                    bones,
                    column.points,
                    holders[place],
                    width,
                    float(np.clip(0.25 * column.width, 0.004 * size, 0.015 * size)),
                    laid_manner(piece.kind, (column.end - column.start) / size),
                )
            )
        if piece.kind in TIED and len(columns) > 1:
            ties += [(base + place, base + place + 1) for place in range(len(columns) - 1)]
            if piece.closed and len(columns) > 2:
                ties.append((base + len(columns) - 1, base))
        first[number], ends[number] = (columns, starts), lasts
        above_link = np.array([holder - JOINT_COUNT for holder in holders])
        _hold(piece, columns, np.array(starts), above_link, links, shares)
    vertices = np.flatnonzero((clothed.part >= 0) & (shares[index].sum(axis=1) > 0))
    return LaidChains(tuple(chains), tuple(ties), vertices, links[index[vertices]], shares[index[vertices]])


def _columns(piece: Piece, size: float) -> list[_Column]:
    """Where the chains of a piece run; none where it is too short."""
    length = float(piece.along.max()) - piece.start
    if length < SHORTEST * size or len(piece.rows) < 4:
        return []
    wide = WIDE.get(piece.kind, LOCK) * size
    count = int(np.clip(round(_breadth(piece) / wide), 1, MOST_COLUMNS))
    if piece.kind == "skirt" and piece.closed:
        count = max(count, 6)
    if piece.kind == "cape":
        count = max(count, 3)
    step = piece.span / count
    out = []
    for place in range(count):
        angle = (place + (0.0 if piece.closed else 0.5)) * step
        away = np.abs(_apart(piece, piece.angle, angle))
        near = away <= 0.5 * step + 1e-9
        if near.sum() < 4:
            continue
        start, end = piece.start, float(np.percentile(piece.along[near], 97))
        if end - start < SHORTEST * size:
            continue
        rows = int(np.clip(round((end - start) / (LINK * size)), 1, MOST_LINKS))
        rows = max(rows, 2) if end - start > 0.08 * size else rows
        points = _spine(piece, away, max(step, 1e-6) * 0.35, np.linspace(start, end, rows + 1))
        gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if gaps.min() < 0.2 * (end - start) / rows:  # folded on itself: a straight line is as good
            points = np.linspace(points[0], points[-1], rows + 1)
            if np.linalg.norm(points[-1] - points[0]) < 0.3 * SHORTEST * size:
                continue
        middle = points[len(points) // 2]
        off = np.linalg.norm(piece.points[near] - middle, axis=1)
        width = float(np.clip(min(_breadth(piece) / count / 2, np.median(off)), 0.006 * size, 0.08 * size))
        out.append(_Column(angle, points, start, end, width))
    return out


def _breadth(piece: Piece) -> float:
    """How wide a piece is, all the way across or round, where it hangs [m]."""
    low, high = piece.start, float(piece.along.max())
    some = (piece.along > low + 0.4 * (high - low)) & (piece.along < low + 0.9 * (high - low))
    points = piece.points[some] if some.sum() >= 4 else piece.points
    if piece.kind in TIED:
        bins = (
            (piece.angle[some] / max(piece.span, 1e-9) * 12).astype(np.int64).clip(0, 11) if some.sum() >= 4 else None
        )
        if bins is not None:
            line = np.array([points[bins == one].mean(axis=0) for one in range(12) if (bins == one).any()])
            if piece.closed:
                line = np.concatenate([line, line[:1]])
            if len(line) > 1:
                return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    # across: the second axis of what lies at one distance, the first being along
    gaps = points - points.mean(axis=0)
    values = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(gaps.T)), 0))
    return float(values[1] * np.sqrt(12))


def _apart(piece: Piece, angle: np.ndarray, other: float) -> np.ndarray:
    """Difference of angles; the short way round where the sheet is closed."""
    gap = angle - other
    return (gap + np.pi) % (2 * np.pi) - np.pi if piece.closed else gap


def _spine(piece: Piece, away: np.ndarray, wide: float, stops: np.ndarray) -> np.ndarray:
    """Means of the points about some distances along, near one column, shape (R + 1, 3)."""
    half = 0.35 * (stops[1] - stops[0])
    column = np.exp(-0.5 * np.square(np.minimum(away / wide, 6.0)))
    out = []
    for stop in stops:
        level = np.exp(-0.5 * np.square(np.clip((piece.along - stop) / half, -8, 8)))
        share = column * level + 1e-30
        out.append(share @ piece.points / share.sum())
    return np.array(out)


def _holders(
    piece: Piece, pieces: list[Piece], first: dict[int, tuple[list[_Column], list[int]]], ends: dict[int, list[int]],
    columns: list[_Column],
) -> list[int]:  # fmt: skip
    """What each column hangs on: the joint of the body, or the nearest link of the piece that it branches off from."""
    if piece.above < 0 or piece.above not in first:
        return [piece.joint] * len(columns)
    above, starts = first[piece.above]
    out = []
    for column in columns:
        best, where = np.inf, 0
        for parent, start in zip(above, starts, strict=True):
            gaps = np.linalg.norm(parent.points[1:] - column.points[0], axis=1)
            if gaps.min() < best:
                best, where = float(gaps.min()), start + int(gaps.argmin())
        out.append(JOINT_COUNT + where)
    return out


def _hold(
    piece: Piece, columns: list[_Column], starts: np.ndarray, above: np.ndarray, links: np.ndarray, shares: np.ndarray
) -> None:
    """Which links hold the points of a piece: the two columns on both sides, the two links above and below."""
    angles = np.array([column.angle for column in columns])
    gaps = np.stack([_apart(piece, piece.angle, angle) for angle in angles], axis=1)
    count = len(columns)
    if count == 1:
        sides = [(np.zeros(len(piece.rows), np.int64), np.ones(len(piece.rows)))]
    else:
        left = np.where(gaps >= 0, gaps, np.inf)
        right = np.where(gaps < 0, -gaps, np.inf)
        one, other = left.argmin(axis=1), right.argmin(axis=1)
        near = np.arange(len(gaps))
        a, b = left[near, one], right[near, other]
        one, other = np.where(np.isfinite(a), one, other), np.where(np.isfinite(b), other, one)
        a, b = np.where(np.isfinite(a), a, 0.0), np.where(np.isfinite(b), b, 0.0)
        share = np.where(a + b > 1e-12, b / np.maximum(a + b, 1e-12), 0.5)
        share = np.where(one == other, 0.5, share)
        sides = [(one, share), (other, 1 - share)]
    out_links, out_shares = np.zeros((len(piece.rows), 4), np.int64), np.zeros((len(piece.rows), 4))
    for place, (column, share) in enumerate(sides):
        begin = np.array([one.start for one in columns])[column]
        end = np.array([one.end for one in columns])[column]
        rows = np.array([len(one.points) - 1 for one in columns])[column]
        at = np.clip((piece.along - begin) / np.maximum(end - begin, 1e-9), 0, 1) * rows
        body = np.clip(1 - at / HOLDS, 0, 1)
        lower = np.clip(np.floor(at - 0.5), 0, rows - 1).astype(np.int64)
        upper = np.minimum(lower + 1, rows - 1)
        share_up = np.clip(at - 0.5 - lower, 0, 1)
        hung = above[column] >= 0
        out_links[:, 2 * place] = np.where((body > 0) & hung, above[column], starts[column] + upper)
        out_shares[:, 2 * place] = np.where(body > 0, np.where(hung, body, 0.0), share_up) * share
        out_links[:, 2 * place + 1] = starts[column] + lower
        out_shares[:, 2 * place + 1] = np.where(body > 0, 1 - body, 1 - share_up) * share
    links[piece.rows], shares[piece.rows] = out_links, out_shares
