"""Repairs of predicted skinning weights, in the order of `REPAIRS`, and small loose parts that move as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from bunraku.anatomy.handles.limbs import LEGS
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES, HANDLE_PARENTS
from bunraku.core.body.reference import handle_positions
from bunraku.core.geometry.graph import mean_operator, mesh_parts
from bunraku.core.geometry.simplify import NetworkMesh
from bunraku.core.motion import lines_up

_LIMBS = [
    i for i, name in enumerate(HANDLE_NAMES) if name.startswith(("left_", "right_")) or name in ("tail", "tail_tip")
]
_LEGS = [*LEGS[0], *LEGS[1]]
_SKULL = [HANDLE_NAMES.index(name) for name in ("head", "head_top", "face")]
_TAIL, _TIP = HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")
_LINES = lines_up(HANDLE_PARENTS)
_SUBTREES = [[other for other, line in enumerate(_LINES) if handle in line] for handle in range(HANDLE_COUNT)]
"""Each handle with those below it."""


@dataclass(frozen=True, eq=False)
class Patient:
    """What repairs see of a body beside its weights."""

    mesh: NetworkMesh  # the network mesh, M vertices
    touch: float = 1.5  # loose parts nearer than this touch, in cells; chosen by eye

    @cached_property
    def areas(self) -> np.ndarray:
        """Surface that each vertex stands for, shape (M,), float64."""
        return self.mesh.areas.astype(np.float64)

    @cached_property
    def edges(self) -> np.ndarray:
        """Edges without the bridges, and pairs of vertices on different loose parts that touch, shape (E, 2)."""
        mesh = self.mesh
        inner = mesh.edges[mesh.components[mesh.edges[:, 0]] == mesh.components[mesh.edges[:, 1]]]
        near = cKDTree(mesh.vertices).query_pairs(self.touch * mesh.cell, output_type="ndarray")
        return np.concatenate([inner, near[mesh.components[near[:, 0]] != mesh.components[near[:, 1]]]])

    def pieces(self, held: np.ndarray) -> np.ndarray:
        """Number of the connected piece of each vertex that is held, -1 for others, shape (M,)."""
        return np.where(held, mesh_parts(self.edges[held[self.edges].all(axis=1)], len(held)), -1)


class Repair:
    """A repair of skinning weights. Its fields are its thresholds, its first line is what holds after it."""

    def __call__(self, body: Patient, weights: np.ndarray) -> np.ndarray:
        """The weights after it, from those before: shape (M, 30), rows sum to 1, float32."""
        raise NotImplementedError


@dataclass(frozen=True)
class JoinRegions(Repair):
    """No limb's handle holds two regions that do not touch: the handles around them take the lesser ones.

    What lies apart from a leg and hangs behind the hips in the middle of the body is a tail, and gets the tail's
    handles where they hold nothing yet. All thresholds were chosen by eye.
    """

    held: float = 0.35  # a vertex belongs to the region of a handle that holds more of it
    # least distance of a stray region from the main one, as a share of the extent; fingers are nearer
    apart: float = 0.06
    lesser: float = 0.5  # a region apart is stray if it is smaller than this share of the main one
    least_tail: float = 0.004  # share of the surface from which what hangs behind the hips is a tail, and not a flap

    def __call__(self, body: Patient, weights: np.ndarray) -> np.ndarray:
        out, mesh, areas = np.array(weights, np.float64), body.mesh, body.areas
        spare_tail = areas @ weights[:, [_TAIL, _TIP]].sum(axis=1) < self.least_tail * areas.sum()
        for handle in _LIMBS:
            held = out[:, handle] > self.held
            if not held.any():
                continue
            label = body.pieces(held)
            mass = np.bincount(label[held], areas[held] * out[held, handle])
            pieces = np.flatnonzero(mass > 0)
            may_be_tail = spare_tail and handle in _LEGS
            tails = [piece for piece in pieces if may_be_tail and self._is_tail(mesh, out, label == piece)]
            main = max((piece for piece in pieces if piece not in tails), key=lambda piece: mass[piece], default=-1)
            for piece in pieces:
                stray = label == piece
                if piece == main or main < 0 or _gap(mesh, stray, label == main) < self.apart:
                    continue
                if piece in tails:
                    out[stray, _TAIL] += out[stray, handle]
                    out[stray, handle] = 0
                elif mass[piece] < self.lesser * mass[main]:
                    _give_back(mesh, out, stray, handle)
        return (out / out.sum(axis=1, keepdims=True)).astype(np.float32)

    def _is_tail(self, mesh: NetworkMesh, weights: np.ndarray, piece: np.ndarray) -> bool:
        """Whether a piece hangs behind the hips, in the middle of the body."""
        hips = handle_positions(mesh.vertices, weights.astype(np.float32), mesh.areas)[0]
        points, areas = mesh.vertices[piece], mesh.areas[piece]
        position = np.average(points, axis=0, weights=areas)
        behind = position[2] < hips[2] - 2 * mesh.cell
        middle = abs(position[0] - hips[0]) < 0.15 * np.ptp(mesh.vertices[:, 0])
        return bool(behind and middle and areas.sum() > self.least_tail * mesh.areas.sum())


def _gap(mesh: NetworkMesh, piece: np.ndarray, other: np.ndarray) -> float:
    """Least distance of two sets of vertices, as a share of the extent."""
    return float(cKDTree(mesh.vertices[other]).query(mesh.vertices[piece])[0].min())


def _rim(edges: np.ndarray, piece: np.ndarray) -> np.ndarray:
    """Vertices beside a piece, as often as edges lead to them."""
    first, second = edges.T
    return np.concatenate([second[piece[first] & ~piece[second]], first[piece[second] & ~piece[first]]])


def _give_back(mesh: NetworkMesh, weights: np.ndarray, piece: np.ndarray, handle: int) -> None:
    """Give what a handle holds of a piece to the handles that hold the piece's surroundings, in place."""
    rim = _rim(mesh.edges, piece)
    around = weights[rim].sum(axis=0) if len(rim) else weights[piece].sum(axis=0)
    around[handle] = 0
    if around.sum() <= 1e-9:
        return
    weights[piece] += weights[piece, handle][:, None] * (around / around.sum())
    weights[piece, handle] = 0


@dataclass(frozen=True)
class SoftenTornEdges(Repair):
    """No limb's rotation stretches an edge far: weights are softened where it would.

    Only vertices of such edges change, and, where that is not enough, those around them; bridges between loose parts
    are no edges.
    """

    angle: float = float(np.radians(60))  # how far a limb is rotated in walks [rad]
    most: float = 2.0  # share of its length by which an edge may grow in such a rotation; chosen by eye
    rounds: int = 16  # of softening, at the most
    sharp: float = 1e-4  # share of the surface under which two parts do not blend where they meet; chosen by eye

    def __call__(self, body: Patient, weights: np.ndarray) -> np.ndarray:
        mesh = body.mesh
        inner = mesh.components[mesh.edges[:, 0]] == mesh.components[mesh.edges[:, 1]]
        mean = mean_operator(mesh.edges[inner], len(weights))
        out = np.array(weights, np.float64)
        active = np.zeros(len(out), bool)
        for _ in range(self.rounds):
            torn = inner & (self.strain(mesh, out) > self.most)
            if not torn.any():
                break
            active[mesh.edges[torn]] = True
            around = active | (np.asarray(mean @ active) > 0)
            out[around] = 0.5 * out[around] + 0.5 * np.asarray(mean @ out)[around]
        return (out / out.sum(axis=1, keepdims=True)).astype(np.float32)

    def strain(self, mesh: NetworkMesh, weights: np.ndarray) -> np.ndarray:
        """By how much of its length each edge grows at the most when a limb is rotated by `angle`, shape (E,).

        A vertex v of which the limb holds the share W goes to `v + W (R - I) (v - j)`, so an edge grows by the
        difference of W over its ends times `2 sin(angle / 2)` times the distance from the joint j.
        """
        first, second = mesh.edges.T
        points = mesh.vertices.astype(np.float64)
        length = np.maximum(np.linalg.norm(points[first] - points[second], axis=1), 0.25 * mesh.cell)
        middle = 0.5 * (points[first] + points[second])
        out = np.zeros(len(mesh.edges))
        for handle in _LIMBS:
            share = weights[:, _SUBTREES[handle]].sum(axis=1)
            step = np.abs(share[first] - share[second])
            if float(mesh.areas @ weights[:, handle]) <= 0 or step.sum() <= 0:
                continue
            overlap = mesh.areas * share * (1 - share)
            if overlap.sum() > self.sharp * mesh.areas.sum():
                joint = overlap @ points / overlap.sum()
            else:  # parts that meet without a blend
                joint = step @ middle / step.sum()
            away = np.linalg.norm(middle - joint, axis=1)
            out = np.maximum(out, 2 * np.sin(self.angle / 2) * step * away / length)
        return out


REPAIRS: tuple[Repair, ...] = (JoinRegions(), SoftenTornEdges())
"""All repairs, in the order in which they run."""


def repaired(mesh: NetworkMesh, weights: np.ndarray) -> np.ndarray:
    """Weights after all `REPAIRS`, shape (M, 30), rows sum to 1."""
    body = Patient(mesh)
    for repair in REPAIRS:
        weights = repair(body, weights)
    return weights


@dataclass(frozen=True, eq=False)
class LooseParts:
    """The loose parts of a mesh."""

    label: np.ndarray  # part of each point of the mesh's surface (`NetworkMesh.surface`), shape (S,)
    extent: np.ndarray  # largest extent of each part, as a share of the character's, shape (P,)
    areas: np.ndarray  # surface of each part, shape (P,)
    # share of its surface with which each small part lies on the larger ones; 0 of those that are not small, shape (P,)
    cover: np.ndarray
    gap: np.ndarray  # distance of each point of a small part to the larger parts, infinite elsewhere, shape (S,)
    host: np.ndarray  # the point of a larger part nearest to each point of a small part, -1 elsewhere, shape (S,)


@dataclass(frozen=True)
class SeatParts:
    """Each small loose part has one row of weights for all of it.

    A part that lies on a larger one takes the mean of that one's weights at the points nearest to it. A part that lies
    on none, as the head of a robot does, takes the mean of its own where one handle clearly holds it, and the head's
    where head, hair and face hold it together; small ones follow what they touch. Rows are sharpened. All thresholds
    were chosen by eye; lengths are shares of the character's extent.
    """

    small: float = 0.13  # largest extent of a part that can sit on another
    # share of the surface from which a part is no longer small, however short: the shoulder plates of a robot
    piece: float = 0.03
    reach: float = 0.025  # a point nearer than this to a larger part lies on it
    cover: float = 0.8  # share of its surface with which a part must lie on the larger one to sit there
    near: float = 0.01  # how sharply the nearest points of the larger part are preferred
    stiff: float = 0.35  # largest extent of a part that sits nowhere and yet moves as a whole
    # share of such a part that one handle must hold, from which on it counts and from which on wholly; others reach
    # over a joint, as a sleeve does
    clear: tuple[float, float] = (0.6, 0.8)
    # of a part's row: blends of handles that move apart would shear the part, and rigs mostly bind it to one bone
    power: int = 3
    touches: float = 0.012  # parts nearer than this touch
    tiny: float = 0.008  # share of the surface under which a piece is not a limb, however sure its handle is

    def loose_parts(self, mesh: NetworkMesh) -> LooseParts:
        """The loose parts of the surface that a network mesh stands for, and how the small ones lie on the large."""
        points, label, areas = mesh.surface.vertices, mesh.surface.parts, mesh.surface.areas
        count = int(label.max()) + 1
        order = np.argsort(label, kind="stable")
        starts = np.searchsorted(label[order], np.arange(count))
        extent = (np.maximum.reduceat(points[order], starts) - np.minimum.reduceat(points[order], starts)).max(axis=1)
        of_part = np.bincount(label, areas, count)
        small = (extent < self.small) & (of_part < self.piece * areas.sum())
        gap, host = np.full(len(points), np.inf), np.full(len(points), -1)
        if small.any() and not small.all():
            inside, outside = np.flatnonzero(small[label]), np.flatnonzero(~small[label])
            gap[inside], near = cKDTree(points[outside]).query(points[inside])
            host[inside] = outside[near]
        cover = np.bincount(label, areas * (gap < self.reach), count) / of_part
        return LooseParts(label, extent, of_part, cover, gap, host)

    def __call__(self, mesh: NetworkMesh, weights: np.ndarray, stiff: bool = True) -> np.ndarray:
        """Weights of the vertices of `mesh.clean`, shape (W, K), float32.

        Args:
            mesh: The network mesh.
            weights: Of its vertices, rows sum to 1, shape (M, K).
            stiff: Whether parts that lie on no other may move as a whole; not where they are legs, as those of insects
                often are.
        """
        full = mesh.push_clean(weights)
        if not mesh.surface.parts.any():
            return full
        parts = self.loose_parts(mesh)
        label, areas, count = parts.label, mesh.surface.areas, len(parts.extent)

        def means(where: np.ndarray, share: np.ndarray, values: np.ndarray) -> np.ndarray:
            """Mean of values (S', K) at some points over each part, shape (P, K); zero of parts without such points."""
            total = np.maximum(np.bincount(label[where], share, count), 1e-30)
            columns = [np.bincount(label[where], share * column, count) / total for column in values.T]
            return np.stack(columns, axis=1).astype(np.float32)

        sits = parts.cover >= self.cover
        on = np.flatnonzero(sits[label])
        nearest = np.full(count, np.inf)
        np.minimum.at(nearest, label[on], parts.gap[on])
        share = areas[on] * np.exp(-0.5 * ((parts.gap[on] - nearest[label[on]]) / self.near) ** 2)
        hosts, inverse = np.unique(parts.host[on], return_inverse=True)
        rows = means(on, share, mesh.push_surface(weights, hosts)[inverse.reshape(-1)])

        single = ~sits & (parts.extent < self.stiff) & stiff
        alone = np.flatnonzero(single[label])
        means_alone = means(alone, areas[alone], mesh.push_surface(weights, alone))
        rows[single] = means_alone[single]
        heads = means_alone[:, _SKULL].sum(axis=1) if means_alone.shape[1] == HANDLE_COUNT else np.zeros(count)
        hair = single & (means_alone.max(axis=1) < self.clear[1]) & (heads > self.clear[0])  # whatever shares it
        rows[hair] = np.eye(means_alone.shape[1])[min(_SKULL[0], means_alone.shape[1] - 1)]
        rows **= self.power
        rows /= np.maximum(rows.sum(axis=1, keepdims=True), 1e-30)
        share_of_row = np.where(sits, 1.0, 0.0)
        clear = np.where(hair, heads, means_alone.max(axis=1))
        share_of_row[single] = np.clip((clear[single] - self.clear[0]) / (self.clear[1] - self.clear[0]), 0, 1)
        if stiff:
            seating = _Seating(mesh, weights, parts, sits, means_alone, rows, share_of_row)
            waiting = ~sits & (means_alone.sum(axis=1) > 0) & (parts.areas < self.piece * parts.areas.sum())
            self._seat_flecks(seating, self._follow_contacts(seating, waiting))
            seating.follow_hosts()
        member = label[mesh.surface.start]
        held = np.flatnonzero(share_of_row[member] > 0)
        member = member[held]
        full[held] += share_of_row[member, None].astype(np.float32) * (rows[member] - full[held])
        return full

    def _follow_contacts(self, seating: _Seating, waiting: np.ndarray) -> np.ndarray:
        """Let small pieces move with what they touch, one after another: arrows with their quiver, a feather with its
        arrow; those that touch nothing are left over, shape (P,), bool.

        A piece whose handle is far from that of what it touches cannot be a limb that is jointed there: it would fly
        off. Unless it is large and clearly of one handle, it takes the row of what it touches.
        """
        parts, points = seating.parts, seating.mesh.surface.vertices
        label, areas = parts.label, parts.areas
        fresh = ~waiting
        while waiting.any():
            # What touched a piece of an earlier round is settled with it, so only the last ones are asked.
            loose, settled = np.flatnonzero(waiting[label]), np.flatnonzero(fresh[label])
            if not len(settled):
                break
            gap, near = cKDTree(points[settled]).query(points[loose], distance_upper_bound=self.touches)
            touching = np.isfinite(gap)
            if not touching.any():
                break
            pieces, there = label[loose[touching]], settled[near[touching]]
            full = seating.mesh.push_surface(seating.weights, there)
            stiffened = seating.share[label[there]][:, None]
            full = (1 - stiffened) * full + stiffened * seating.rows[label[there]]
            fresh = np.isin(np.arange(len(waiting)), pieces)
            for piece in np.flatnonzero(fresh):
                row = full[pieces == piece].mean(axis=0)
                unsure = seating.own[piece].max() < self.clear[1] or areas[piece] < self.tiny * areas.sum()
                if unsure and not _jointed(int(seating.own[piece].argmax()), int(row.argmax())):
                    seating.seat(int(piece), row**self.power)
            waiting = waiting & ~fresh
        return waiting

    def _seat_flecks(self, seating: _Seating, waiting: np.ndarray) -> None:
        """Let flecks that touch nothing, as image-to-3D programs leave them, stay with the nearest larger part."""
        parts = seating.parts
        for piece in np.flatnonzero(waiting & (parts.areas < self.tiny * parts.areas.sum())):
            on = (parts.label == piece) & (parts.host >= 0)
            if on.any():
                nearest = on & (parts.gap <= parts.gap[on].min() + self.near)
                row = seating.mesh.push_surface(seating.weights, parts.host[nearest]).mean(axis=0)
                seating.seat(int(piece), row**self.power)


@dataclass(frozen=True, eq=False)
class _Seating:
    """Loose parts on their way to a row of weights each."""

    mesh: NetworkMesh  # the network mesh
    weights: np.ndarray  # of its vertices, shape (M, K)
    parts: LooseParts  # its loose parts
    sits: np.ndarray  # which of them sit on another, shape (P,), bool
    own: np.ndarray  # mean weights of the parts that may move as a whole, shape (P, K); zero of others
    rows: np.ndarray  # the row of each part, shape (P, K), changed in place
    share: np.ndarray  # how much of it each part takes, shape (P,), changed in place

    def seat(self, piece: int, row: np.ndarray) -> None:
        """Give a piece a row, wholly."""
        self.rows[piece], self.share[piece] = row / row.sum(), 1.0

    def follow_hosts(self) -> None:
        """Let what sits on a piece that follows another follow too."""
        label = self.parts.label
        for part in np.flatnonzero(self.sits):
            on = self.parts.host[label == part]
            host = np.bincount(label[on[on >= 0]], minlength=len(self.sits)).argmax()
            self.rows[part] = (1 - self.share[host]) * self.rows[part] + self.share[host] * self.rows[host]


def _jointed(handle: int, other: int) -> bool:
    """Whether two handles are one, or at most two joints apart."""
    lines = _LINES[handle], _LINES[other]
    return sum(len(set(line) - set(both)) for line, both in (lines, lines[::-1])) <= 2
