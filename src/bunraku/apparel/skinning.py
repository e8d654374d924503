"""Linear blend skinning by the joints of a body (Eq. 4 of MMDMC), as affine transforms that `core.skinning` takes."""

from __future__ import annotations

import numpy as np

__all__ = ["eq4_transforms"]


def eq4_transforms(transforms: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Affine transforms that `skin` takes, from `[R | t]` of [MMDMC 4], shape (N, J, 3, 4), float32.

    Args:
        transforms: Rotation and position of each joint [m], shape (N, J, 3, 4).
        joints: Positions in the rest pose [m], shape (J, 3).
    """
    out = np.array(transforms, np.float32)
    out[..., 3] -= np.einsum("njab,jb->nja", out[..., :3], np.asarray(joints, np.float32))
    return out
