"""Figures that wardrobe characters are dressed on: a shape, its proportions, its rest pose and what clothes measure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.interpolate import PchipInterpolator

from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.surface import vertex_normals
from bunraku_lab.synthetic.makehuman import limb_rotations, pose_points, random_kind, random_proportions, rest_linear
from bunraku_lab.synthetic.surfaces import nearest_shares

J = {name: joint for joint, name in enumerate(JOINT_NAMES)}
_ARMS = [J[f"{side}_{part}"] for side in ("left", "right") for part in ("shoulder", "elbow", "wrist")]
_HANDS = [J["left_wrist"], J["right_wrist"]]
DRAWN = ("drawn", "chibi", "toon")
"""Kinds of figures whose faces are drawn with few features."""


@dataclass(frozen=True, eq=False)
class Skin:
    """A surface that follows the 22 joints.

    Args:
        points: Positions in the rest pose [m], shape (V, 3).
        normals: Unit normals, shape (V, 3).
        faces: Shape (F, 3).
        weights: Of the 22 joints, shape (V, 22).
        reach: Steps along the arms in the T-pose, shape (V,): 1 at the shoulder joint, 2 at the elbow, 3 at the wrist.
        rise: Steps up the body in the T-pose, shape (V,): 0 at the ankle, 1 knee, 2 hip joint, 3 lower spine, 4 upper
            spine, 5 neck, 6 head joint.
        depth: Z in the T-pose over the body's height, shape (V,).
    """

    points: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    weights: np.ndarray
    reach: np.ndarray
    rise: np.ndarray
    depth: np.ndarray

    def below(self, field: np.ndarray) -> Skin:
        """The rest of `above`, cut at the same places."""
        return self.above(np.where(field == 0, -1e-12, -field))

    def kept(self, faces: np.ndarray) -> Skin:
        """Only some faces, shape (F,) bool, and the vertices that they use."""
        used, corners = np.unique(self.faces[faces], return_inverse=True)
        values = (getattr(self, name)[used] for name in ("points", "normals", "weights", "reach", "rise", "depth"))
        points, normals, weights, reach, rise, depth = values
        return Skin(points, normals, corners.reshape(-1, 3), weights, reach, rise, depth)

    def above(self, field: np.ndarray) -> Skin:
        """The part where a field on the vertices, shape (V,), is at least 0; faces on its border are cut along it."""
        high = field >= 0
        counts = high[self.faces].sum(axis=1)
        if (counts == 3).all():
            return self
        crossed = self.faces[(counts == 1) | (counts == 2)]
        if not len(crossed):
            return self.kept(counts == 3)
        ends = np.sort(np.concatenate([crossed[:, [0, 1]], crossed[:, [1, 2]], crossed[:, [2, 0]]]), axis=1)
        ends = np.unique(ends[high[ends[:, 0]] != high[ends[:, 1]]], axis=0)
        share = (field[ends[:, 0]] / (field[ends[:, 0]] - field[ends[:, 1]]))[:, None]
        count = len(self.points)
        index = {(int(a), int(b)): count + number for number, (a, b) in enumerate(ends)}

        def middle(a: int, b: int) -> int:
            return index[(a, b) if a < b else (b, a)]

        new = []
        for face in crossed.tolist():
            up = [bool(high[corner]) for corner in face]
            odd = next(at for at in range(3) if up[at] != up[at - 1] and up[at] != up[(at + 1) % 3])
            a, b, c = face[odd], face[(odd + 1) % 3], face[(odd + 2) % 3]
            ab, ca = middle(a, b), middle(c, a)
            new += [[a, ab, ca]] if up[odd] else [[ab, b, c], [ab, c, ca]]

        def grown(values: np.ndarray) -> np.ndarray:
            s = share if values.ndim == 2 else share[:, 0]
            return np.concatenate([values, values[ends[:, 0]] * (1 - s) + values[ends[:, 1]] * s])

        faces = np.concatenate([self.faces[counts == 3], np.array(new, np.int64)])
        whole = Skin(
            *(
                grown(self.points),
                grown(self.normals),
                faces,
                grown(self.weights),
                grown(self.reach),
                grown(self.rise),
                grown(self.depth),
            )
        )
        return whole.kept(np.ones(len(faces), bool))

    def puffed(self, thickness: np.ndarray | float) -> Skin:
        """Moved outwards along the normals [m]."""
        return replace(self, points=self.points + self.normals * np.reshape(thickness, (-1, 1)))


@dataclass(frozen=True, eq=False)
class Figure:
    """A body in its rest pose, feet on the ground, facing +Z.

    Args:
        skin: Its surface.
        joints: Joint positions [m], shape (22, 3).
        kind: What it is, for people to read.
        eyes: Middles of the eyes, left and right, where the body knows them [m], shape (2, 3), or None.
        worn: Points of what it wears already, that further apparel keeps clear of [m], shape (W, 3), or None.
    """

    skin: Skin
    joints: np.ndarray
    kind: str
    eyes: np.ndarray | None = None
    worn: np.ndarray | None = None

    def wearing(self, points: np.ndarray) -> Figure:
        """The same with more on."""
        return replace(self, worn=points if self.worn is None else np.concatenate([self.worn, points]))

    def at(self, name: str) -> np.ndarray:
        """Position of a joint [m], shape (3,)."""
        return self.joints[J[name]]

    @cached_property
    def height(self) -> float:
        """Height [m]."""
        return float(self.skin.points[:, 1].max())

    @cached_property
    def _samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Points all over the surface, and how far each belongs to the arms."""
        corners = self.skin.points[self.skin.faces]
        middles = [0.5 * (corners[:, a] + corners[:, b]) for a, b in ((0, 1), (1, 2), (2, 0))]
        arms = self.skin.weights[:, _ARMS].sum(axis=1)
        share = arms[self.skin.faces].mean(axis=1)
        return np.concatenate([self.skin.points, corners.mean(axis=1), *middles]), np.concatenate([arms, *[share] * 4])

    @cached_property
    def trunk(self) -> np.ndarray:
        """Points all over head, trunk and legs, the arms left out, and of what is worn [m], shape (S, 3)."""
        points, arms = self._samples
        own = points[arms < 0.35]
        return own if self.worn is None else np.concatenate([own, self.worn])

    @cached_property
    def torso(self) -> np.ndarray:
        """As `trunk`, without the head [m], shape (S, 3)."""
        skin = self.skin
        heads = skin.weights[:, [J["head"], *_ARMS]].sum(axis=1)[skin.faces].mean(axis=1)
        own = skin.points[skin.faces].mean(axis=1)[heads < 0.3]
        return own if self.worn is None else np.concatenate([own, self.worn])

    @cached_property
    def head(self) -> np.ndarray:
        """Points of the head [m], shape (S, 3)."""
        skin = self.skin
        return skin.points[skin.weights[:, J["head"]] > 0.6]

    @cached_property
    def skull(self) -> tuple[np.ndarray, np.ndarray]:
        """Middle of the cranium and its half extents [m], each shape (3,)."""
        points = self.head
        top, back = float(points[:, 1].max()), float(points[:, 2].min())
        low = float(points[:, 1].min())
        upper = points[points[:, 1] > low + 0.5 * (top - low)]
        half = np.array(
            [np.percentile(np.abs(upper[:, 0]), 88), 0.36 * (top - low), 0.5 * (np.percentile(upper[:, 2], 97) - back)]
        )
        return np.array([0.0, top - half[1], back + half[2]]), half

    def rim(
        self, height: float, angles: np.ndarray, *, center: np.ndarray, band: float, points: np.ndarray | None = None
    ) -> np.ndarray:
        """How far the body's convex outline at a height reaches, in directions about a vertical axis [m], shape (A,).

        Args:
            height: Y [m].
            angles: 0 is +Z, a quarter turn +X [rad], shape (A,).
            center: X and Z of the axis, shape (2,).
            band: Points within this of the height count [m].
            points: Instead of those of head, trunk and legs.
        """
        cloud = self.trunk if points is None else points
        near = cloud[np.abs(cloud[:, 1] - height) < band][:, [0, 2]] - center
        if not len(near):
            return np.zeros(len(angles))
        ways = np.stack([np.sin(angles), np.cos(angles)])
        return np.asarray((near @ ways).max(axis=0))

    def profile(
        self, height: float, angles: np.ndarray, *, center: np.ndarray, band: float, spread: float = 0.3,
        points: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """How far the surface reaches in each direction, as `rim` but not convex."""
        cloud = self.trunk if points is None else points
        near = cloud[np.abs(cloud[:, 1] - height) < band][:, [0, 2]] - center
        if not len(near):
            return np.zeros(len(angles))
        turn = np.arctan2(near[:, 0], near[:, 1])
        apart = np.abs((turn[:, None] - angles[None] + np.pi) % (2 * np.pi) - np.pi)
        return np.asarray(np.where(apart < spread, np.linalg.norm(near, axis=1)[:, None], 0).max(axis=0))


_GROWN = ("average", "woman", "man", "heavy", "heavy_woman", "thin", "strong", "tall", "short", "old")
# Modelled by eye: half width, depth of the front and depth of the back of a drawn head from the chin (-1) to the crown
# (1), over half
# its extents.
_HEAD = np.array(
    [
        [-1.0, 0.10, 0.62, 0.0], [-0.9, 0.32, 0.77, 0.2], [-0.7, 0.60, 0.85, 0.45], [-0.45, 0.80, 0.88, 0.72], [-0.15,
        0.93, 0.90, 0.9],
        [0.2, 1.0, 0.94, 1.0], [0.5, 0.96, 0.90, 0.97], [0.75, 0.78, 0.72, 0.78], [0.92, 0.45, 0.42, 0.45], [1.0, 0.08,
        0.08, 0.08],
    ]
)  # fmt: skip


def _with_drawn_head(skin: Skin) -> Skin:
    """The body with the plain head of a drawing: round above, a small chin, next to no nose, no ears."""
    share = skin.weights[:, J["head"]]
    own = skin.points[share > 0.6]
    low, high = float(own[:, 1].min()), float(own[:, 1].max())
    low += 0.05 * (high - low)
    # Ears and nose do not count for its width and depth.
    wide = float(np.percentile(np.abs(own[:, 0]), 85)) * 1.15
    front, back = float(np.percentile(own[:, 2], 93)), float(own[:, 2].min())
    middle, deep = 0.5 * (front + back), 0.5 * (front - back) * 1.03
    columns = 28 if len(skin.points) > 1500 else 18
    rows = 22 if len(skin.points) > 1500 else 14
    s = -np.cos(np.linspace(0.02, np.pi, rows))[::-1]
    width, ahead, behind = (PchipInterpolator(_HEAD[:, 0], _HEAD[:, column])(s)[:, None] for column in (1, 2, 3))
    turn = np.arange(columns) * 2 * np.pi / columns
    x, z = np.sin(turn)[None], np.cos(turn)[None]
    # Front and back run into each other at the sides.
    face = 0.5 + 0.5 * np.clip(z / 0.7, -1, 1)
    depth = np.maximum(face * ahead + (1 - face) * behind, 0.06)
    length = (np.abs(x / width) ** 2.2 + np.abs(z / depth) ** 2.2) ** (-1 / 2.2)
    nose = 0.07 * np.exp(-np.square((s[:, None] + 0.4) / 0.1) - np.square(np.arctan2(x, z) / 0.13))
    height = (
        low + 0.5 * (s[:, None] + 1) * (high - low) + 0.1 * (high - low) * np.clip(-s[:, None] - 0.3, 0, 1) * (1 - face)
    )
    points = np.stack(
        [wide * x * length, np.broadcast_to(height, length.shape), middle + deep * z * (length + nose)], axis=-1
    )
    index = np.arange(rows * columns).reshape(rows, columns)
    after = np.roll(index, -1, axis=1)
    quads = np.stack([index[:-1], index[1:], after[1:], after[:-1]], axis=-1).reshape(-1, 4)
    ends = [np.full(columns, rows * columns), np.full(columns, rows * columns + 1)]
    caps = [np.stack([ends[0], index[0], after[0]], axis=1), np.stack([ends[1], after[-1], index[-1]], axis=1)]
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]], *caps])
    points = np.concatenate(
        [points.reshape(-1, 3), points[0].mean(axis=0, keepdims=True), points[-1].mean(axis=0, keepdims=True)]
    )
    body = skin.kept(~(share[skin.faces] > 0.6).all(axis=1))
    count = len(points)
    weights = np.zeros((count, len(J)))
    weights[:, J["head"]] = 1
    return Skin(
        np.concatenate([body.points, points]), np.concatenate([body.normals, vertex_normals(points, faces)]),
        np.concatenate([body.faces, faces + len(body.points)]),
        np.concatenate([body.weights, weights]), np.concatenate([body.reach, np.zeros(count)]),
        np.concatenate([body.rise, np.full(count, 6.5)]),
        np.concatenate([body.depth, np.zeros(count)]),
    )  # fmt: skip


def figure_of(
    points: np.ndarray, faces: np.ndarray, joints: np.ndarray, weights: np.ndarray, linear: np.ndarray, kind: str,
    eyes: np.ndarray | None = None,
) -> Figure:  # fmt: skip
    """A body brought to its rest pose.

    Args:
        points: In the body's own pose [m], shape (V, 3).
        faces: Shape (F, 3).
        joints: Of the same pose, shape (22, 3).
        weights: Of the 22 joints, shape (V, 22).
        linear: Linear maps of the parts to the rest pose, shape (22, 3, 3), as of `rest_linear`.
        kind: What it is.
        eyes: Middles of the eyes in the body's own pose, or None.
    """
    flat, straight = pose_points(points, joints, weights, limb_rotations(joints))
    posed, rest = pose_points(points, joints, weights, linear)
    ground = np.array([0, posed[:, 1].min(), 0])
    x, y = np.abs(flat[:, 0]), flat[:, 1]
    arm = straight[[J["left_collar"], J["left_shoulder"], J["left_elbow"], J["left_wrist"]], 0]
    hand = float(x.max())
    reach = np.interp(x, [0, arm[0], *arm[1:], max(hand, arm[3] + 0.02)], [0, 0.2, 1, 2, 3, 4])
    marks = [
        straight[J[name], 1] for name in ("left_ankle", "left_knee", "left_hip", "spine1", "spine3", "neck", "head")
    ]
    low, high = float(y.min()), float(y.max())
    rise = np.interp(y, [low, *marks, max(high, marks[-1] + 0.02)], [-1, 0, 1, 2, 3, 4, 5, 6, 7])
    reach = np.minimum(reach, 0.6 + 8 * np.maximum(rise - 4.1, 0))  # wide hips are no arms
    normals = vertex_normals(posed, faces)
    seen = None
    if eyes is not None:
        rows = np.zeros((2, len(JOINT_NAMES)))
        rows[:, J["head"]] = 1
        seen = pose_points(eyes, joints, rows, linear)[0] - ground
    skin = Skin(
        posed - ground, normals, np.asarray(faces, np.int64), weights, reach, rise, flat[:, 2] / max(high - low, 1e-6)
    )
    return Figure(_with_drawn_head(skin) if kind in DRAWN else skin, rest - ground, kind, seen)


def random_figure(rng: np.random.Generator, detail: str = "plain") -> Figure:
    """A reference body of a mixed shape, in drawn or in natural proportions, in an A-pose.

    Args:
        rng: Random numbers.
        detail: "coarse", "plain" or "fine" tessellation.
    """
    kind = random_kind(rng)
    names = ["woman", "thin", "average", "child"] if kind in ("drawn", "chibi", "tall") else list(_GROWN)
    shares = rng.dirichlet(np.full(3, 0.7))
    bodies = [reference_body(str(rng.choice(names))) for _ in range(3)]
    points = np.sum(
        [share * body.vertices.astype(np.float64) for share, body in zip(shares, bodies, strict=True)], axis=0
    )
    joints = np.sum(
        [share * body.joints.astype(np.float64) for share, body in zip(shares, bodies, strict=True)], axis=0
    )
    weights = bodies[0].joint_weights.astype(np.float64)
    arm = float(np.clip(rng.normal(0.62, 0.1), 0.3, 0.85))
    linear = rest_linear(joints, random_proportions(rng, kind), arm, 0.0, float(rng.uniform(0.0, 0.06)))
    faces, corners, positions = _tessellation(detail)
    points = np.einsum("vc,vck->vk", positions, points[corners])
    weights = np.einsum("vc,vck->vk", positions, weights[corners])
    return figure_of(points, faces, joints, weights, linear, kind)


@lru_cache(maxsize=8)
def _tessellation(detail: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Another mesh of the reference body."""
    body = reference_body()
    points, faces = body.vertices.astype(np.float64), body.faces
    if detail == "coarse":
        import fast_simplification

        near = fast_simplification.simplify(points.astype(np.float32), faces.astype(np.int32), target_count=2200)
        surface, faces = near[0].astype(np.float64), near[1].astype(np.int64)
        corners, shares = nearest_shares(surface, points, body.faces)
        return faces, corners, shares / shares.sum(axis=1, keepdims=True)
    corners, shares = np.repeat(np.arange(len(points))[:, None], 3, axis=1), np.tile([1.0, 0, 0], (len(points), 1))
    if detail == "fine":
        ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        edges, which = np.unique(ends, axis=0, return_inverse=True)
        ab, bc, ca = (which.reshape(-1) + len(points)).reshape(3, -1)
        a, b, c = faces.T
        faces = np.concatenate(
            [np.stack(corner, axis=1) for corner in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
        )
        corners = np.concatenate([corners, np.column_stack([edges, edges[:, 0]])])
        shares = np.concatenate([shares, np.tile([0.5, 0.5, 0], (len(edges), 1))])
    return faces, corners, shares
