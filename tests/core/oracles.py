"""Skinning and rigid registration as their definitions read, for tests."""

import numpy as np
from scipy.spatial.transform import Rotation

from bunraku.core.body.layout import JOINT_COUNT, JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.motion import posed_points


def skin_reference(vertices: np.ndarray, weights: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """`skin` as its definition reads, one frame and one handle at a time, in double precision."""
    out = np.zeros((len(transforms), len(vertices), 3))
    for frame, handles in enumerate(np.asarray(transforms, float)):
        for handle, transform in enumerate(handles):
            moved = vertices @ transform[:, :3].T + transform[:, 3]
            out[frame] += weights[:, handle, None] * moved
    return out


def register_reference(
    source: np.ndarray, target: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`register` of one part in one frame as the paper has it.

    Args:
        source: Rest vertices [m], shape (V, 3).
        target: Moved vertices [m], shape (V, 3).
        weight: The part's weights, shape (V,), not all zero; the points must not lie on one line.

    Returns:
        Handle h (3,), rotation R (3, 3) and translation t (3,).
    """
    handle = np.average(source, axis=0, weights=weight)
    middle = np.average(target, axis=0, weights=weight)
    covariance = np.zeros((3, 3))
    for x, y, w in zip(source, target, weight, strict=True):
        covariance += w * np.outer(y - middle, x - handle)
    u, _, vt = np.linalg.svd(covariance)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return handle, rotation, middle - handle


def joint_errors(motion, found):
    """Mean distance over all frames of each joint of `found`, which `skeleton_from_handles` made of `motion`, from
    where the handles above and below it take it [m], shape (22,).
    """
    body = reference_body()
    transforms = motion.transforms(body.handles.positions)[:, :JOINT_COUNT].astype(float)
    own = posed_points(transforms, body.joints)
    above = np.maximum(np.array(JOINT_PARENTS), 0)
    upper = transforms[:, above]
    other = posed_points(upper, body.joints)
    return np.asarray(np.linalg.norm((own + other) / 2 - found.world()[1], axis=-1).mean(axis=0))


def registration_case():
    """Points (120, 3), where five frames have them, and weights of six parts."""
    rng = np.random.default_rng(0)
    source = rng.normal(size=(120, 3))
    weights = rng.random((120, 6)) ** 6
    weights /= weights.sum(axis=1, keepdims=True)
    turns = Rotation.random(5, random_state=2).as_matrix()
    targets = source @ turns.transpose(0, 2, 1) + 0.3 * rng.normal(size=(5, 120, 3)) + rng.normal(size=(5, 1, 3))
    return source, targets, weights
