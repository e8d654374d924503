"""Characters of MMDMC's data set as targets of a pose transfer whose source is the reference body in the same pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku_lab.baselines.pose_transfer import (
    PartMesh,
    in_root_frame,
    over_height,
    predicted_parts,
    source_body,
    source_turns,
)
from bunraku_lab.training.baselines.clothed_bank import ClothedSample
from bunraku_lab.training.baselines.transfer_pairs import Target

__all__ = ["clothed_target", "clothed_targets"]


def clothed_target(sample: ClothedSample, weights: np.ndarray) -> Target:
    """A character of the data set, and the source's turns in each of its frames.

    Args:
        sample: The character.
        weights: Of the parts, shape (M, K).
    """
    low, height = sample.rest[:, 1].min(), np.float32(np.ptp(sample.rest[:, 1]))
    origin = np.array([sample.joints[0, 0], low, sample.joints[0, 2]], np.float32)
    affine, truth = in_root_frame(sample.affine, sample.truth)
    mesh = PartMesh((sample.rest - origin) / height, sample.faces, sample.edges, weights)
    turns = source_turns(sample.affine[..., :3], sample.joints)
    joints = over_height(affine, origin, float(height))
    source = source_body().resting_as(sample.joints)
    return Target(sample.name, mesh, sample.weights, (truth - origin) / height, joints, turns, source)


def clothed_targets(samples: Sequence[ClothedSample], predicted: bool) -> list[Target]:
    """Characters of the data set as targets.

    Args:
        samples: The characters.
        predicted: Whether networks predict the parts as they learn, and none are needed.
    """
    out = []
    for one in samples:
        none = np.zeros((len(one.rest), 0), np.float32)
        weights = none if predicted else predicted_parts(one.rest, one.normals, one.edges, one.areas)
        out.append(clothed_target(one, weights))
    return out
