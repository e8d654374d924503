"""The parts of a character, found before it has handles or joints: body, hair, clothes that hang, what is held, worn or
lies about, and what carries each.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.spatial import cKDTree

from bunraku.apparel.part_network import CARRIERS, PARTS, PartNetwork, PartPoints, load_parts, loose_parts, part_points
from bunraku.core.body.corrections import Piece
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.curves import smooth_step
from bunraku.core.geometry.graph import clean_mesh, mesh_parts, unique_edges
from bunraku.core.nn.checkpoints import dated_checkpoint
from bunraku.core.nn.layers import one_thread, sigmoid, softmax

BODY = PARTS.index("body")
HANGING = tuple(PARTS.index(name) for name in ("hair", "skirt", "cape", "sleeve", "tail"))
"""Kinds that hang; what is held or worn is stiff."""
STIFF = tuple(PARTS.index(name) for name in ("prop", "accessory"))
LIKELY = 0.15
"""Probability from which on a vertex hangs: long hair that physics move and stiff hair look alike. On the files that
settings are chosen on (`benchmarks/part_files.md`) 0.1 was best by little, with the weights before these, and marked
1.28 % of machines, animals and the bare; 0.15 marked 0.88 %, and 0.52 % with these.
"""
EVENED = 4  # how often probabilities are averaged with those beside them; chosen by eye
ISLAND = 0.002  # of the surface: smaller patches inside another part are of that part; chosen by eye
TOUCH = 0.02  # over the size: loose pieces of one kind that are nearer are one part; chosen by eye
LEAST = 5e-4  # of the surface: smaller parts belong to the body; chosen by eye
BORDER = 0.03  # over the size: so far from the body's surface a stiff part of one skin with it is not stiff yet; by eye
BARE = 0.25  # of the surface: where less would be left of a body, its handles are those of the whole; chosen by eye
LOW, WIDE = 0.3, 0.15
"""Nine tenths of a base are lower, of the height, and it has more of the surface. Measured: of 57 files six have one,
with at least 22 % of the surface below 31 % of the height; soles and hems of gowns that the network takes for one have
less than 10 %.
"""
HOLDING = 10  # percentile of distances: so much of a part, nearest to the body, says what holds it; chosen by eye
MOSTLY = 0.6  # of the surface about what is worn: where one limb has less of it, it bends; chosen by eye
LEAST_SHARE = 0.1  # of the weights about a part: a carrier that has less of them is not what holds it; chosen by eye
KNOWN = 4  # characters whose parts stay in memory, by definition 0.7 MB each at 10,000 vertices
_HEAD, _CHEST = HANDLE_NAMES.index("head"), HANDLE_NAMES.index("spine3")


@dataclass(frozen=True, eq=False)
class FoundParts:
    """What the network says of each vertex of a mesh."""

    parts: np.ndarray  # probability of each of `PARTS`, shape (V, 9)
    hangs: np.ndarray  # probability that physics would move it, shape (V,)
    carriers: np.ndarray  # probability of each of `CARRIERS`, shape (V, 7)

    @property
    def label(self) -> np.ndarray:
        """Number in `PARTS` of each vertex, shape (V,)."""
        return np.asarray(self.parts.argmax(axis=1))

    @property
    def mask(self) -> np.ndarray:
        """Vertices that hang, shape (V,), bool."""
        return np.asarray(self.hangs > LIKELY)


@dataclass(frozen=True, eq=False)
class Parts:
    """The parts of a character besides its body."""

    label: np.ndarray  # number in `PARTS` of each vertex, shape (V,), int8
    number: np.ndarray  # the part of each vertex, -1 on the body, shape (V,), int32
    hangs: np.ndarray  # vertices that swing where their part is moved, shape (V,), bool
    kinds: tuple[str, ...]  # kind of each part, one of `PARTS`
    carriers: tuple[str, ...]  # what carries each, one of `CARRIERS`

    def __len__(self) -> int:
        return len(self.kinds)

    @property
    def carrier(self) -> np.ndarray:
        """Number in `CARRIERS` of what carries each vertex, -1 on the body, shape (V,)."""
        table = np.array([*(CARRIERS.index(name) for name in self.carriers), -1])
        return np.asarray(table[self.number])

    @property
    def left_out(self) -> np.ndarray:
        """What no handle is made of, shape (V,), bool: hair that hangs, and what is held."""
        hair = self.hangs & (self.label == PARTS.index("hair"))
        return np.asarray(hair | (self.label == PARTS.index("prop")))

    def base(self, character: Character) -> np.ndarray:
        """What a character of which these are the parts stands on and is one with, shape (V,), bool."""
        heights, areas = character.vertices[:, 1], character.areas
        top = float(heights.min()) + LOW * float(np.ptp(heights))
        low = np.array(
            [np.quantile(heights[self.number == number], 0.9) < top for number in range(len(self))] + [False]
        )
        out = (self.label == PARTS.index("ground")) & low[self.number]
        return np.asarray(out & (areas[out].sum() > WIDE * areas.sum()) & ~_beside(character))


def _beside(character: Character) -> np.ndarray:
    """What stands still beside a character, shape (V,), bool."""
    return np.zeros(len(character.vertices), bool) if character.beside is None else character.beside


_known: OrderedDict[bytes, FoundParts] = OrderedDict()


def parts_of(character: Character) -> Parts:
    """The parts of a character: those that the network finds, as a person corrected them. CharacterError if the mesh is
    broken; WeightsError if the shipped weights are missing or broken.
    """
    colors = None if character.colors is None else character.colors / np.float32(255)
    arrays = (character.vertices, character.faces, *(() if colors is None else (colors,)))
    key = hashlib.blake2b(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).digest()
    found = _known.pop(key, None) or find_parts(character.vertices, character.faces, colors)
    _known[key] = found
    while len(_known) > KNOWN:
        _known.popitem(last=False)
    said = () if character.corrections is None else character.corrections.part
    return _whole(character, found, said)


def part_facts(character: Character) -> list[dict[str, Any]]:
    """The parts of a character in values that JSON can say, the largest first: kind, what carries it, a point on it
    [m], by which corrections name it, and its share of the surface.
    """
    parts, areas = parts_of(character), character.areas
    share = np.bincount(parts.number + 1, areas, len(parts) + 1)[1:] / max(float(areas.sum()), 1e-30)
    return [
        {
            "kind": kind, "carrier": parts.carriers[number], "area": round(min(float(share[number]), 1.0), 4),
            "at": [round(value, 4) for value in part_point(character, parts, number)],
        }
        for number, kind in enumerate(parts.kinds)
    ]  # fmt: skip


def part_point(character: Character, parts: Parts, number: int) -> tuple[float, float, float]:
    """The vertex of a part that is nearest to its middle [m], by which corrections name it."""
    points = character.vertices[parts.number == number].astype(np.float64)
    x, y, z = points[int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmin())].tolist()
    return x, y, z


def find_parts(
    vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray | None = None, checkpoint: str | Path | None = None
) -> FoundParts:
    """What part each vertex is of, what carries it, and whether it hangs. CharacterError if the mesh is broken;
    WeightsError if the checkpoint is missing or does not fit.

    Args:
        vertices: Rest mesh [m], +Y up and facing +Z, shape (V, 3).
        faces: Shape (F, 3).
        colors: sRGB from 0 to 1 of each vertex, shape (V, 3), or None.
        checkpoint: Weights of kind "parts" in place of the shipped ones.
    """
    model = _model(*dated_checkpoint("parts", checkpoint))
    vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
    own = loose_parts(vertices, faces)
    part = np.zeros(len(vertices), np.int64)  # strays are of any
    part[faces] = own[:, None]
    used = vertices[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    placed = (vertices - 0.5 * (low + high)) / max(float((high - low).max()), 1e-12)
    count = len(PARTS)
    with one_thread():
        seen = part_points(vertices, faces, own, colors, how=model.config)
        # Painted or not, a part is the same: where there are colours, both answers count.
        plain = replace(seen, surface=replace(seen.surface, colors=None))
        scores = [model.scores(view) for view in ((plain,) if colors is None else (plain, seen))]
        likely = np.mean(
            [
                np.concatenate(
                    [softmax(row[:, :count]), sigmoid(row[:, count : count + 1]), softmax(row[:, count + 1 :])], axis=1
                )
                for row in scores
            ],
            axis=0,
        )
    total = _spread(placed, part, seen, likely)
    return FoundParts(total[:, :count], total[:, count], total[:, count + 1 :])


@lru_cache(maxsize=2)
def _model(path: Path, changed: int) -> PartNetwork:
    return load_parts(path)


def _spread(placed: np.ndarray, part: np.ndarray, seen: PartPoints, values: np.ndarray) -> np.ndarray:
    """Values of points at the vertices, from the three nearest of the same loose part, or of any where it has none."""
    # Parts that lie on one another stay apart: each has a layer of its own along a fourth axis.
    layer = np.concatenate([placed, 4.0 * part[:, None]], axis=1)
    known = np.concatenate([seen.surface.points, 4.0 * seen.surface.part[:, None]], axis=1)
    gap, near = cKDTree(known).query(layer, 3)
    lost = gap[:, 0] >= 4
    if lost.any():
        gap[lost], near[lost] = cKDTree(seen.surface.points).query(placed[lost], 3)
    weight = 1 / (gap.clip(max=4) + 1e-4) * (gap < 4)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
    return np.asarray((values[near] * weight[..., None]).sum(axis=1), np.float32)


def _whole(character: Character, found: FoundParts, said: Sequence[Piece]) -> Parts:
    """Parts as connected pieces of the surface, without holes and islands; those at the points of corrections have the
    kinds that these say.
    """
    clean = clean_mesh(character.vertices, character.faces)
    count = len(clean.vertices)
    first = np.unique(clean.index, return_index=True)[1]
    edges = unique_edges(clean.faces, count)
    area = np.bincount(clean.index, character.areas, count)
    values = _evened(np.column_stack([found.parts, found.hangs])[first], edges)
    label, hangs = values[:, :-1].argmax(axis=1), values[:, -1] > LIKELY
    label = _filled(label, edges, area)
    piece = _pieces(clean.vertices, edges, label)
    chosen = np.zeros(count, bool)
    for correction in said:
        at = (np.asarray(correction.at) - clean.center) / clean.scale
        rows = np.isin(piece, piece[cKDTree(clean.vertices).query(at)[1]])
        kind = PARTS.index(correction.kind) if correction.kind in PARTS else BODY  # an arm is of the body
        body = label == BODY
        if kind != BODY and (body & rows).any() and area[body & ~rows].sum() < BARE * area.sum():
            continue  # of one skin with the body: all of it would become a prop
        label[rows], chosen[rows] = kind, True
    hangs = np.isin(label, HANGING) & (hangs | chosen)
    hangs = (_filled(np.where(hangs, label, -1), edges, area) >= 0) & np.isin(label, HANGING)
    number = np.full(count, -1)
    piece = _pieces(clean.vertices, edges, label)
    kinds: list[str] = []
    carriers: list[str] = []
    rank = np.bincount(piece, np.where(label == BODY, 0, area))
    votes = np.stack([np.bincount(piece, area * column) for column in found.carriers[first].T], axis=1)
    for part in np.argsort(-rank, kind="stable"):
        if rank[part] < LEAST * area.sum():
            break
        rows = piece == part
        number[rows] = len(kinds)
        kinds.append(PARTS[int(label[rows][0])])
        carriers.append(CARRIERS[int(votes[part].argmax())])
    label = np.where(number >= 0, label, BODY)
    hangs &= number >= 0
    back = clean.index
    return Parts(label[back].astype(np.int8), number[back].astype(np.int32), hangs[back], tuple(kinds), tuple(carriers))


def _evened(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Values of points averaged with those an edge away, shape (P, C)."""
    count = len(values)
    both = np.concatenate([edges, edges[:, ::-1]])
    matrix = csr_matrix((np.ones(len(both), np.float32), (both[:, 0], both[:, 1])), shape=(count, count))
    degree = np.asarray(matrix.sum(axis=1)).reshape(-1)
    mean = diags((1 / np.maximum(degree, 1)).astype(np.float32)) @ matrix
    for _ in range(EVENED):
        values = np.where((degree > 0)[:, None], 0.5 * values + 0.5 * (mean @ values), values)
    return values


def _filled(label: np.ndarray, edges: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Labels of points in which small patches have the label of most that is around them, shape (P,)."""
    out, count = np.array(label), len(label)
    for _ in range(2):
        piece = mesh_parts(edges[out[edges[:, 0]] == out[edges[:, 1]]], count)
        small = np.bincount(piece, area) < ISLAND * area.sum()
        across = edges[piece[edges[:, 0]] != piece[edges[:, 1]]]
        across = np.concatenate([across, across[:, ::-1]])
        across = across[small[piece[across[:, 0]]] & ~small[piece[across[:, 1]]]]
        if not len(across):
            break
        pairs, votes = np.unique(np.stack([piece[across[:, 0]], out[across[:, 1]]], axis=1), axis=0, return_counts=True)
        order = np.argsort(votes, kind="stable")
        most = np.full(len(small), label.min() - 1)
        most[pairs[order, 0]] = pairs[order, 1]  # the last one stays
        found = most[piece] >= label.min()
        out[found] = most[piece[found]]
    return out


def _pieces(points: np.ndarray, edges: np.ndarray, label: np.ndarray) -> np.ndarray:
    """Number of the connected piece of one label of each point, shape (P,); loose ones that nearly touch are one."""
    same = edges[label[edges[:, 0]] == label[edges[:, 1]]]
    return mesh_parts(np.concatenate([same, _touching(points, label)]), len(points))


def _touching(points: np.ndarray, label: np.ndarray) -> np.ndarray:
    """Pairs of points of one kind, not the body's, that nearly touch, shape (E, 2)."""
    rows = np.flatnonzero(label != BODY)
    if len(rows) < 2:
        return np.zeros((0, 2), np.int64)
    placed = np.column_stack([points[rows], label[rows].astype(float)])  # kinds are an extent apart
    near = min(6, len(rows))
    gap, other = cKDTree(placed).query(placed, near, distance_upper_bound=TOUCH)
    row, column = np.nonzero(np.isfinite(gap))
    return np.stack([rows[row], rows[other[row, column]]], axis=1)


_LIMBS = (
    ("neck", "head", "head_top", "face"),
    ("spine1", "spine2", "spine3", "left_collar", "right_collar"),
    ("pelvis", "spine1"),
    *(tuple(f"{side}_{name}" for name in ("shoulder", "elbow", "wrist", "fingers")) for side in ("left", "right")),
    *(tuple(f"{side}_{name}" for name in ("hip", "knee", "ankle", "foot")) for side in ("left", "right")),
)
_HANDLES = np.array([[name in limb for name in HANDLE_NAMES] for limb in _LIMBS])
"""Handles of each of `CARRIERS`, shape (7, 30)."""


def carried_by(carrier: str, weights: np.ndarray) -> int:
    """The handle or joint of a carrier that has most of some weights (K,) of the layout's first K; of any where the
    carrier has next to none of them.
    """
    own = weights * _HANDLES[CARRIERS.index(carrier), : len(weights)]
    return int((own if own.sum() > LEAST_SHARE * weights.sum() else weights).argmax())


def handles_of_body(character: Character, predict: Callable[[Character], Handles]) -> Handles:
    """The handles of a character, predicted on its body alone; hair, and what is held or worn, goes with its carrier,
    and what it stands on with the root, as do its legs then.

    Args:
        character: Any mesh, +Y up and facing +Z.
        predict: Gives the handles of a character; vertices that are `beside` are none of its body.
    """
    parts = parts_of(character)
    base, areas = parts.base(character), character.areas
    left = parts.left_out | base
    if areas[~left].sum() < BARE * areas.sum():
        left = base = np.zeros_like(left)
    handles = predict(replace(character, beside=left | _beside(character)) if left.any() else character)
    if handles.rigid or not len(parts):
        return handles
    weights = np.array(stiff_weights(character, parts, handles.weights, left))
    off_limbs(parts, weights)
    if base.any():
        glide_with(base, character, weights, handles.played)
    return replace(handles, weights=weights)


def glide_with(base: np.ndarray, character: Character, weights: np.ndarray, played: np.ndarray) -> None:
    """Let a figure for print, or a statue, glide with its base, in place: no limb of it bends, since what its hands
    hold is of one skin with them.

    Args:
        base: Vertices of the base, shape (V,), bool.
        character: The figure.
        weights: Of its handles, shape (V, 30).
        played: The part that each handle plays, shape (30,).
    """
    vertices = character.vertices.astype(np.float64)
    reach = BORDER * float(np.ptp(vertices, axis=0).max())
    away = cKDTree(vertices[base]).query(vertices)[0]
    border = ~base & (away < reach)
    for carrier, limb in zip(CARRIERS, _HANDLES[:, played], strict=True):
        if carrier.endswith(("arm", "leg")):
            rests = weights[border][:, limb].sum() > LEAST_SHARE * max(int(border.sum()), 1)
            holder = 0 if carrier.endswith("leg") or rests else _CHEST
            weights[:, holder] += weights[:, limb].sum(axis=1)
            weights[:, limb] = 0
    free = smooth_step(away, 0.0, reach)[:, None]
    weights[:] = free * weights + (1 - free) * np.eye(1, weights.shape[1])


def off_limbs(parts: Parts, weights: np.ndarray) -> None:
    """Let clothes and hair follow no arm that they merely lie on, in place, and hair no leg either: a cape goes with
    the chest that carries it.

    Args:
        parts: Of a character of V vertices.
        weights: Of its handles, shape (V, 30).
    """
    arms, legs = (_HANDLES[[name.endswith(limb) for name in CARRIERS]].any(axis=0) for limb in ("arm", "leg"))
    for number, (kind, carrier) in enumerate(zip(parts.kinds, parts.carriers, strict=True)):
        rows, limbs = np.flatnonzero(parts.number == number), arms | legs if kind == "hair" else arms
        if len(rows) and PARTS.index(kind) in HANGING and (kind == "hair" or not carrier.endswith("arm")):
            away = weights[rows][:, limbs].sum(axis=1)
            weights[np.ix_(rows, limbs)] = 0
            holder = _HEAD if kind == "hair" else carried_by(carrier, weights[rows].sum(axis=0))
            weights[rows, holder] += away


def stiff_weights(character: Character, parts: Parts, weights: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Weights (V, K) of handles in which each part that is stiff, or was left out (V,), goes as a whole with the handle
    that holds it: the one that has most of the surface nearest to it, among those of its carrier. Hair goes with the
    head, and so does what is nearest to hair. What is worn across limbs bends with them. Where a part is one skin with
    the body, it becomes stiff away from the border.
    """
    out = np.array(weights, np.float64)
    moved = left | np.isin(parts.label, STIFF)
    vertices = np.asarray(character.vertices, np.float64)
    holds = character.surface & ~moved
    if not holds.any():
        return weights
    reach = BORDER * float(np.ptp(vertices, axis=0).max())
    clean = clean_mesh(vertices, character.faces)
    points, of = np.zeros_like(clean.vertices), np.full(len(clean.vertices), -1)
    points[clean.index], of[clean.index[moved]] = vertices, parts.number[moved]
    edges = unique_edges(clean.faces, len(of))
    edges = np.concatenate([edges, edges[:, ::-1]])
    edges = edges[(of[edges[:, 0]] >= 0) & (of[edges[:, 1]] < 0)]
    for number in sorted(range(len(parts)), key=lambda number: parts.kinds[number] != "hair"):  # hair first
        kind, carrier = parts.kinds[number], parts.carriers[number]
        rows = np.flatnonzero((parts.number == number) & moved)
        if not len(rows) or kind == "ground":
            continue
        body = np.flatnonzero(holds)
        gap, near = cKDTree(vertices[body]).query(vertices[rows])
        around = out[body[near]]
        if kind == "accessory" and (_HANDLES @ around.sum(axis=0)).max() < MOSTLY * len(rows):
            continue
        close = gap <= np.percentile(gap, HOLDING)
        holder = _HEAD if kind == "hair" else carried_by(carrier, around[close].sum(axis=0))
        ends, share = points[edges[of[edges[:, 0]] == number, 1]], np.ones(len(rows))
        if len(ends):
            share = smooth_step(cKDTree(ends).query(vertices[rows])[0] / reach, 0.0, 1.0)
        out[rows] = around * (1 - share[:, None])
        out[rows, holder] += share
        holds[rows] = kind == "hair"
    return out.astype(np.float32)
