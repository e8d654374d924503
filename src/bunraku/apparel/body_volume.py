"""The surface of a character's body without its apparel, with few faces: what others may be inside of.

Bodies of avatars are layers of open sheets (faces, shirts, sleeves), so inside is where the generalized winding number
(Jacobson et al. 2013, by the fast sums of Barill et al. 2018) of all of them together exceeds a half, and depth is the
distance to the nearest sheet.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_matrix

from bunraku.core.skinning import skin
from bunraku.errors import CharacterError

if TYPE_CHECKING:
    from bunraku.apparel.unified import UnifiedBody

__all__ = ["BodyVolume"]

_MOST_FACES = 12_000


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
        numbering = np.full(len(vertices), -1)
        numbering[np.unique(faces)] = index.ravel()
        shares = _means(weights[np.unique(faces)], index.ravel(), len(points))
        faces = numbering[faces]
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


def _means(values: np.ndarray, groups: np.ndarray, count: int) -> np.ndarray:
    each = np.arange(len(groups))
    out = csr_matrix((np.ones(len(groups)), (groups, each)), (count, len(groups))) @ values.astype(np.float64)
    return np.asarray(out / np.maximum(out.sum(axis=1, keepdims=True), 1e-12), np.float32)
