"""The body that wardrobe characters are dressed on: a shape, its proportions, its rest pose, and what clothes measure
on it.

Every vertex knows where it stood in a T-pose, in steps along the limbs (`reach`, `rise`), so that sleeves, hems and
necklines of any body are cut at the same position whatever its shape and pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bunraku.body.layout import JOINT_NAMES

__all__ = ["DRAWN", "Figure", "J", "Skin"]

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
        self,
        height: float,
        angles: np.ndarray,
        *,
        center: np.ndarray,
        band: float,
        spread: float = 0.3,
        points: np.ndarray | None = None,
    ) -> np.ndarray:
        """How far the surface itself reaches in each direction, as `rim` but not convex: the farthest point in a
        sector.
        """
        cloud = self.trunk if points is None else points
        near = cloud[np.abs(cloud[:, 1] - height) < band][:, [0, 2]] - center
        if not len(near):
            return np.zeros(len(angles))
        turn = np.arctan2(near[:, 0], near[:, 1])
        apart = np.abs((turn[:, None] - angles[None] + np.pi) % (2 * np.pi) - np.pi)
        return np.asarray(np.where(apart < spread, np.linalg.norm(near, axis=1)[:, None], 0).max(axis=0))
