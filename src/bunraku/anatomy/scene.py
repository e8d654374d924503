"""What a file holds beside its character: the ground below it, stray pieces, and other characters.

Pieces are told apart by what touches what, by where they lie and by their size, never by names.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from bunraku.anatomy.corrected import beside_as_said
from bunraku.core.character import Character
from bunraku.core.geometry.graph import clean_mesh, mesh_parts, unique_edges
from bunraku.core.geometry.surface import surface_points, vertex_areas
from bunraku.errors import OptionError

# Lengths are shares of the height of what stands above the ground. All were chosen by eye on the sample person, whole
# and in pieces, on plates, plinths and columns.
TOUCH = 0.008  # pieces nearer than this touch, those at twice the distance may
SINKS = 0.03  # how deep what stands on the ground may sink into it
FEET = 0.05  # what is so near to the ground stands on it
THIN = 0.05  # a plate is thinner; what is thicker is ground only under two feet
WIDER = 1.25  # how much larger the ground is than what stands on it
TALLEST = 0.6  # the ground is no more than this share of the whole height
PEER, ALIKE = 0.25, 0.5  # another character's surface and height, over the largest one's, at the least
STRAY, FAR = 0.02, 0.1  # the surface of a stray piece, over the character's, at the most, and how far away it is
BELOW, APART = 0.25, 0.5  # how far below a body feet without legs hover, and how far apart they are, over its width
MOST_PARTS = 3000  # loose parts that are looked at; more are leaves or crumbs of one thing


@dataclass(frozen=True, eq=False)
class Scene:
    """The pieces of a character's file, as masks over its vertices, shape (V,), bool."""

    characters: tuple[np.ndarray, ...]  # the characters, the largest first; at least one
    ground: np.ndarray  # what they stand on
    strays: np.ndarray  # pieces that lie apart from all, small ones or below

    @property
    def lines(self) -> list[str]:
        """What there is beside one character, in words, a line each."""
        out = []
        if len(self.characters) > 1:
            sizes = ", ".join(f"{int(one.sum()):,} vertices" for one in self.characters)
            out.append(f"{len(self.characters)} characters: {sizes}")
        for name, piece in (("ground that it stands on", self.ground), ("stray pieces", self.strays)):
            if piece.any():
                out.append(f"{name}: {int(piece.sum()):,} vertices")
        return out


def find_scene(character: Character) -> Scene:
    """What a file holds beside its character, which stands along +Y."""
    none = np.zeros(len(character.vertices), bool)
    clean = clean_mesh(character.vertices, character.faces)
    points, faces = clean.vertices, clean.faces
    label = mesh_parts(unique_edges(faces, len(points)), len(points))
    count = int(label.max()) + 1
    if not 1 < count <= MOST_PARTS:
        return Scene((~none,), none, none)
    pieces = _Pieces.of(points, faces, label)
    ground = pieces.ground()
    body = np.flatnonzero(~ground)
    height = pieces.height(body)
    group = pieces.touching(body, TOUCH * height)
    areas = np.bincount(group, pieces.areas[body])
    order = np.argsort(-areas, kind="stable")
    main = body[group == order[0]]
    figures: list[np.ndarray] = [main]
    rest: list[np.ndarray] = []
    for number in order[1:]:
        own = body[group == number]
        (figures if pieces.peers(own, main, areas[number] / areas[order[0]]) else rest).append(own)
    strays = np.zeros(count, bool)
    feet = pieces.feet(rest, main)
    for own in rest:
        gaps = [pieces.gap(own, figure) for figure in figures]
        nearest = int(np.argmin(gaps))
        small = pieces.areas[own].sum() < STRAY * areas[order[0]]
        if (
            not feet[own].any()
            and gaps[nearest] > FAR * height
            and (small or pieces.high[own, 1].max() < pieces.low[main, 1].min())
        ):
            strays[own] = True
        else:
            figures[nearest] = np.append(figures[nearest], own)

    def mask(chosen: np.ndarray) -> np.ndarray:
        return np.asarray(chosen[label[clean.index]] & clean.used)

    return Scene(tuple(mask(np.isin(np.arange(count), figure)) for figure in figures), mask(ground), mask(strays))


def separated(character: Character, number: int | None = None) -> tuple[Character, list[str]]:
    """One of the characters of a file, with all else standing still beside it, and what there is to say about it.
    OptionError if there are not so many.

    Args:
        character: Standing along +Y; one with a rig is left as it is, for its bones move what they hold, and so is one
            that is separated already.
        number: Which of the characters, from 1, the largest; None for that one.
    """
    said = character.corrections
    if number is None and said is not None and character.beside is None:
        number = said.character
    if number is None and (character.rig is not None or character.beside is not None):
        return character, []
    answers = character.__dict__.setdefault("_separated", {})  # clips of one character have one object for it
    if number not in answers:
        answers[number] = _separated(character, number)
    other, lines = answers[number]
    return other or character, lines


def _separated(character: Character, number: int | None) -> tuple[Character | None, list[str]]:
    """What `separated` gives; None for the character itself."""
    scene = find_scene(character)
    count = len(scene.characters)
    if number is not None and not 1 <= number <= count:
        raise OptionError(f"{character.name}: there is no character {number} in this file; it has {count}")
    beside = beside_as_said(character, character.surface & ~scene.characters[(number or 1) - 1])
    lines = scene.lines
    if not beside.any():
        return None, []
    if count > 1:
        lines[0] += f"; number {number or 1} moves, choose another with --character"
    return replace(character, beside=beside), lines


@dataclass(frozen=True, eq=False)
class _Pieces:
    """The loose parts of a mesh."""

    points: list[np.ndarray]  # points spread over each part, and its vertices, a list of arrays (S, 3)
    areas: np.ndarray  # of each part, shape (P,)
    # low, high: corners of the box of each part, shape (P, 3)
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, vertices: np.ndarray, faces: np.ndarray, label: np.ndarray) -> _Pieces:
        count = int(label.max()) + 1
        areas = np.bincount(label, vertex_areas(vertices, faces), count)
        by_face, by_vertex = np.argsort(label[faces[:, 0]], kind="stable"), np.argsort(label, kind="stable")
        own_faces = np.split(faces[by_face], np.cumsum(np.bincount(label[faces[:, 0]], minlength=count))[:-1])
        own = np.split(vertices[by_vertex], np.cumsum(np.bincount(label, minlength=count))[:-1])
        height = float(np.ptp(vertices[:, 1]))
        wanted = np.clip(areas / max((0.4 * TOUCH * height) ** 2, 1e-9), 4, 20_000).astype(int)
        points = [
            np.concatenate([some, surface_points(vertices, mine, int(want))[0]])
            for some, mine, want in zip(own, own_faces, wanted, strict=True)
        ]
        low, high = (np.array([side(some, axis=0) for some in own]) for side in (np.min, np.max))
        return cls(points, areas, low, high)

    def height(self, parts: np.ndarray) -> float:
        """Of some parts together."""
        return max(float(self.high[parts, 1].max() - self.low[parts, 1].min()), 1e-9)

    def ground(self) -> np.ndarray:
        """The parts that all others stand on, shape (P,), bool: below a level, one of them wider than all that
        stands there, and thin or under two feet.
        """
        out, everything = np.zeros(len(self.areas), bool), np.arange(len(self.areas))
        whole, floor = self.height(everything), float(self.low[:, 1].min())
        for level in np.unique(self.high[:, 1]):
            below = self.high[:, 1] <= level + 1e-6
            if below.all() or level - floor > TALLEST * whole:
                break
            fresh = below & ~out
            above = np.flatnonzero(~below)
            height = self.height(above)
            start = float(self.low[above, 1].min())
            if start < level - SINKS * height or self.low[above, 1].min() > level + SINKS * height:
                continue
            stands = np.concatenate([self.points[part] for part in above])
            stands = stands[stands[:, 1] < max(level, start) + FEET * height][:, [0, 2]]
            low, high = (side(stands, axis=0) for side in (np.min, np.max))
            margin, ends = TOUCH * height, (self.low[fresh][:, [0, 2]], self.high[fresh][:, [0, 2]])
            under = (ends[0] < low + margin).all(axis=1) & (ends[1] > high - margin).all(
                axis=1
            )  # all of it, not a foot
            if not (
                under & (np.prod(ends[1] - ends[0], axis=1) > WIDER * np.prod(np.maximum(high - low, margin)))
            ).any():
                continue
            flat = np.concatenate([stands, np.zeros((len(stands), 1))], axis=1)
            if level - floor < THIN * height or _clusters(flat, margin).max() > 0:
                out = below
        return out

    def touching(self, parts: np.ndarray, reach: float) -> np.ndarray:
        """Number of the group of parts that touch one another, for each of some parts, shape (n,)."""
        own = np.repeat(np.arange(len(parts)), [len(self.points[part]) for part in parts])
        cluster = len(parts) + _clusters(np.concatenate([self.points[part] for part in parts]), reach)
        group = _connected(np.stack([own, cluster]), int(cluster.max()) + 1)[: len(parts)]
        return np.unique(group, return_inverse=True)[1]

    def peers(self, own: np.ndarray, main: np.ndarray, share: float) -> bool:
        """Whether a group of parts is a character beside the main one: as large, on the same ground, and apart."""
        low, high = self.low[own].min(axis=0), self.high[own].max(axis=0)
        floor, top = self.low[main].min(axis=0), self.high[main].max(axis=0)
        apart = bool(((low > top) | (high < floor))[[0, 2]].any())
        stands = abs(low[1] - floor[1]) < FAR * self.height(main)
        return share > PEER and self.height(own) > ALIKE * self.height(main) and apart and bool(stands)

    def feet(self, rest: list[np.ndarray], main: np.ndarray) -> np.ndarray:
        """The parts of the groups on which a body without legs stands, shape (P,), bool: all that is a little below it,
        if that is as far apart as feet are.
        """
        low, high = self.low[main].min(axis=0), self.high[main].max(axis=0)
        tops = [float(self.high[own, 1].max()) for own in rest]
        floor = low[1] - BELOW * self.height(main)
        below = [own for own, top in zip(rest, tops, strict=True) if floor < top < low[1]]
        out = np.zeros(len(self.areas), bool)
        if below:
            parts = np.concatenate(below)
            wide = (self.high[parts].max(axis=0) - self.low[parts].min(axis=0)) / np.maximum(high - low, 1e-9)
            out[parts] = len(parts) > 1 and wide[[0, 2]].max() > APART
        return out

    def gap(self, own: np.ndarray, other: np.ndarray) -> float:
        """Distance between the boxes of two groups of parts, at the least."""
        apart = np.maximum(self.low[own][:, None] - self.high[other], self.low[other] - self.high[own][:, None])
        return float(np.linalg.norm(np.maximum(apart, 0), axis=-1).min())


def _clusters(points: np.ndarray, reach: float) -> np.ndarray:
    """Number of the cluster of each point, shape (S,): points are near in one cell of a grid of this size, and in cells
    beside each other.
    """
    cells = np.floor(points / reach).astype(np.int64)
    cells -= cells.min(axis=0) - 1
    wide = cells.max(axis=0) + 2
    keys, cell = np.unique((cells[:, 0] * wide[1] + cells[:, 1]) * wide[2] + cells[:, 2], return_inverse=True)
    pairs = []
    for step in list(product((-1, 0, 1), repeat=3))[13:]:  # the cell itself, and of two that are beside each other one
        wanted = keys + (step[0] * wide[1] + step[1]) * wide[2] + step[2]
        there = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        beside = np.flatnonzero(keys[there] == wanted)
        pairs.append(np.stack([beside, there[beside]]))
    return _connected(np.concatenate(pairs, axis=1), len(keys))[cell]


def _connected(pairs: np.ndarray, count: int) -> np.ndarray:
    """Number of the component of each of `count` nodes, by the pairs that are connected, shape (2, E)."""
    graph = coo_matrix((np.ones(pairs.shape[1], bool), pairs), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])
