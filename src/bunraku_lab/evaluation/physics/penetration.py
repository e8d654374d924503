"""How much of a character's apparel is inside its body, frame by frame.

What is inside, and how deep, `apparel.body_volume` says.
"""

from __future__ import annotations

import numpy as np

from bunraku.apparel.body_volume import BodyVolume
from bunraku.apparel.unified import UnifiedBody
from bunraku.core.skinning import posed_points
from bunraku_lab.datasets.apparel.body_inside import DEEP, deep_inside

__all__ = ["deep_share", "nearest_joint_vertices", "sample_apparel"]

_MOST_POINTS = 1_500


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
        deep = deep_inside(volume, vertices, np.concatenate([cloud[frame] for cloud in clouds]), depth)
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
