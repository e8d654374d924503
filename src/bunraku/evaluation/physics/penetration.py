"""How much of a character's apparel is inside its body, frame by frame.

Bodies of avatars are layers of open sheets (faces, shirts, sleeves), so inside is where the generalized winding number
(Jacobson et al. 2013, by the fast sums of Barill et al. 2018) of all of them together exceeds a half, and depth is the
distance to the nearest sheet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.apparel.unified import UnifiedBody
from bunraku.core.skinning import posed_points, skin
from bunraku.errors import CharacterError

__all__ = ["DEEP", "BodyVolume", "deep_share", "nearest_joint_vertices", "sample_apparel"]

DEEP = 0.01
"""Vertices deeper than this are counted [m]."""
_MOST_FACES = 12_000
_MOST_POINTS = 1_500


@dataclass(frozen=True, eq=False)
class BodyVolume:
    """The part of a character that physics do not move, with fewer faces.

    Args:
        rest: Vertices in the rest pose [m], shape (B, 3).
        faces: Shape (F, 3), int64.
        weights: For the 22 joints, shape (B, 22).
    """

    rest: np.ndarray
    faces: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, body: UnifiedBody, apparel: np.ndarray, most_faces: int = _MOST_FACES) -> BodyVolume:
        """Take a character's body.

        Args:
            body: The character's joints.
            apparel: Its mask, shape (V,), bool.
            most_faces: A body with more is simplified to about so many, which moves its surface by a millimetre or two.

        Raises:
            CharacterError: All of the character is apparel.
        """
        character = body.parts.character
        return cls.of_mesh(character.vertices, character.faces, body.weights, apparel, character.name, most_faces)

    @classmethod
    def of_mesh(
        cls, vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray, apparel: np.ndarray, name: str,
        most_faces: int = _MOST_FACES,
    ) -> BodyVolume:  # fmt: skip
        """Take the body of a mesh.

        Args:
            vertices: Rest mesh [m], shape (V, 3).
            faces: Shape (F, 3).
            weights: For the 22 joints, shape (V, 22).
            apparel: Its mask, shape (V,), bool.
            name: Of the character.
            most_faces: As above.

        Raises:
            CharacterError: All of the character is apparel.
        """
        faces = faces[~apparel[faces].any(axis=1)]
        if not len(faces):
            raise CharacterError(f"{name}: all of it is apparel, so there is no body to be inside of")
        points, index = np.unique(
            np.round(vertices[np.unique(faces)].astype(np.float64), 6), axis=0, return_inverse=True
        )
        place = np.full(len(vertices), -1)
        place[np.unique(faces)] = index.ravel()
        shares = _means(weights[np.unique(faces)], index.ravel(), len(points))
        faces = place[faces]
        faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
        if len(faces) <= most_faces:
            return cls(points, np.ascontiguousarray(faces, np.int64), shares)
        import fast_simplification

        few, few_faces, collapses = fast_simplification.simplify(
            points.astype(np.float32), faces.astype(np.int32), target_count=most_faces, return_collapses=True
        )
        few, few_faces, kept = fast_simplification.replay_simplification(
            points.astype(np.float32), faces.astype(np.int32), collapses
        )
        return cls(few.astype(np.float64), np.ascontiguousarray(few_faces, np.int64), _means(shares, kept, len(few)))

    def posed(self, transforms: np.ndarray) -> np.ndarray:
        """Vertices of frames [m], shape (N, B, 3).

        Args:
            transforms: Affine transforms of the joints, as `skin` takes them, shape (N, 22, 3, 4).
        """
        return skin(self.rest.astype(np.float32), self.weights, transforms)

    def deep(self, vertices: np.ndarray, points: np.ndarray, depth: float = DEEP) -> np.ndarray:
        """Which points are deeper than this inside the body, shape (P,), bool.

        Args:
            vertices: Of the body in this frame [m], shape (B, 3).
            points: Shape (P, 3).
            depth: [m].
        """
        import igl

        vertices, points = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(points, np.float64)
        out = np.abs(igl.fast_winding_number(vertices, self.faces, points)) > 0.5
        inside = np.flatnonzero(out)
        if len(inside):
            out[inside] = igl.point_mesh_squared_distance(points[inside], vertices, self.faces)[0] > depth * depth
        return np.asarray(out)


def deep_share(volume: BodyVolume, transforms: np.ndarray, clouds: list[np.ndarray], depth: float = DEEP) -> np.ndarray:
    """Share of the points that are deeper inside the body than this, in each frame and for each cloud, shape (N, C).

    Args:
        volume: The body.
        transforms: Affine transforms of its joints, shape (N, 22, 3, 4).
        clouds: Points of the frames [m], each (N, P, 3).
        depth: [m].
    """
    posed = volume.posed(transforms)
    sizes = [cloud.shape[1] for cloud in clouds]
    out = np.zeros((len(posed), len(clouds)))
    for frame, vertices in enumerate(posed):
        deep = volume.deep(vertices, np.concatenate([cloud[frame] for cloud in clouds]), depth)
        out[frame] = [part.mean() if len(part) else 0.0 for part in np.split(deep, np.cumsum(sizes)[:-1])]
    return out


def nearest_joint_vertices(body: UnifiedBody, chosen: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """Vertices moved rigidly with the body joint that is nearest in the rest pose [m], shape (N, P, 3).

    Args:
        body: The character's joints.
        chosen: Which vertices, shape (P,).
        transforms: Affine transforms of the joints, shape (N, 22, 3, 4).
    """
    points = body.parts.character.vertices[chosen]
    nearest = np.linalg.norm(points[:, None] - body.joints[None], axis=-1).argmin(axis=1)
    own = transforms[:, nearest]
    return np.asarray(posed_points(own, points))


def sample_apparel(apparel: np.ndarray, most: int = _MOST_POINTS) -> np.ndarray:
    """Vertices of apparel, evenly taken where they are many, shape (P,)."""
    found = np.flatnonzero(apparel)
    return found if len(found) <= most else found[np.linspace(0, len(found) - 1, most).astype(np.int64)]


def _means(values: np.ndarray, groups: np.ndarray, count: int) -> np.ndarray:
    out = np.zeros((count, values.shape[1]))
    np.add.at(out, groups, values)
    return np.asarray(out / np.maximum(out.sum(axis=1, keepdims=True), 1e-12), np.float32)
