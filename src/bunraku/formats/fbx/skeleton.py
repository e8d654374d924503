"""The joints of an FBX file, and where they stood when its meshes were bound to them."""

from __future__ import annotations

import numpy as np

from bunraku.formats.fbx.mesh import Cluster
from bunraku.formats.fbx.scene import FbxScene

__all__ = ["BONES", "bind_matrices", "inverses"]

BONES = ("LimbNode", "Limb", "Root")
"""Kinds of model that are joints."""


def bind_matrices(scene: FbxScene, world: np.ndarray, clusters: list[Cluster]) -> dict[int, np.ndarray]:
    """World transforms of all joints in the bind pose, in the file's frame and unit.

    Clusters say it of the joints that they move; the others are where the default pose has them relative to a joint
    that is known.

    Args:
        scene: The file.
        world: The default pose, shape (M, 4, 4).
        clusters: Of all meshes.
    """
    known: dict[int, np.ndarray] = {}
    for cluster in clusters:
        known.setdefault(scene.indices[cluster.joint.id], cluster.bind)
    bones = [index for index, model in enumerate(scene.models) if model.subtype in BONES]
    if not known:
        return {index: world[index] for index in bones}
    for index in reversed(bones):  # up the tree first, so that roots that move nothing stand where their children say
        parent = int(scene.parents[index])
        if index in known and parent >= 0 and parent not in known and scene.models[parent].subtype in BONES:
            known[parent] = known[index] @ inverses(world[index][None])[0] @ world[parent]
    for index in bones:
        parent = int(scene.parents[index])
        if index not in known:
            known[index] = (
                known[parent] @ inverses(world[parent][None])[0] @ world[index] if parent in known else world[index]
            )
    return dict(sorted(known.items()))


def inverses(matrices: np.ndarray) -> np.ndarray:
    """Inverses, of flat matrices the pseudo-inverse, shape (N, 4, 4)."""
    flat = np.abs(np.linalg.det(matrices[:, :3, :3])) < 1e-30
    if not flat.any():
        return np.linalg.inv(matrices)
    return np.linalg.pinv(matrices)
