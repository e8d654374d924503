"""A moving mesh is taken as it stands, and not as its first frame has it."""

import numpy as np

from bunraku.core.mesh_motion import MeshMotion
from bunraku.pipelines.to_reference import _standing
from bunraku_lab.synthetic.samples import make_sample


def test_a_mesh_that_crouches_first_stands_as_it_does_later():
    person = make_sample("person", 0.3)
    low = person.vertices * [1, 0.5, 1]
    moving = np.stack([low] * 20 + [person.vertices] * 20).astype(np.float32)
    np.testing.assert_array_equal(_standing(MeshMotion(moving, person.faces)).vertices, person.vertices)
    moving = moving[::-1] + np.linspace(0, 0.01, 40)[:, None, None].astype(np.float32)
    np.testing.assert_array_equal(_standing(MeshMotion(moving, person.faces)).vertices, moving[0])
