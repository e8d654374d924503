import numpy as np
import pytest

from bunraku.core.body.joint_rotations import skeleton_from_handles
from bunraku.generation.features import decode
from bunraku.generation.pack import Example, ExamplePack
from bunraku_lab.datasets.motions.clips import packed_stretch


@pytest.fixture
def pack(features):
    """A wave with the left hand that goes on, and a kick with the right leg that is done once, from rest to rest.

    Each has a unit vector of its own for its sentence and its motion, and others for their mirror images.
    """
    kick = features("right_knee", frames=20)
    kick = np.concatenate([np.repeat(kick[:1], 5, axis=0), kick, np.repeat(kick[:1], 5, axis=0)])
    motions = [features("left_elbow", frames=40), kick]
    data = []
    for values in motions:
        skeleton = skeleton_from_handles(decode(values))
        data.append(packed_stretch(skeleton.root_translation, skeleton.rotations))
    examples = (
        Example("wave", ("a person waves with the left hand", "waves"), 40, (30, 10)),
        Example("kick", ("a person kicks with the right leg",), 30),
    )
    axes = np.eye(4)
    owners = np.array([0, 0, 1])
    return ExamplePack(
        examples, tuple(data), owners, np.stack([axes[[0, 0, 1]], axes[[2, 2, 3]]]),
        np.stack([axes[[0, 1]], axes[[2, 3]]]), "none",
    )  # fmt: skip
