"""Handles that are read off a moving mesh, for the Handle-FID of the papers' tables."""

import numpy as np
import pytest

from bunraku.body.reference import reference_body
from bunraku.geometry.rotations import matrix_y
from bunraku_lab.evaluation.tables.global_shape import body_samples


def test_samples_do_not_see_where_a_body_stands_and_faces():
    body = reference_body("toddler")
    still = body_samples(body.vertices[None], body)
    turned = body.vertices @ matrix_y(np.array([2.1]))[0].T + [3, 0, -1]
    np.testing.assert_allclose(body_samples(turned[None], body), still, atol=1e-4)
    lifted = (body_samples(turned[None] + [0, 0.1, 0], body) - still).reshape(-1, 3)
    height = float(np.ptp(body.vertices[:, 1]))
    assert lifted[:, 1] == pytest.approx(0.1 / height, abs=1e-4) and np.abs(lifted[:, [0, 2]]).max() < 1e-4


def test_samples_of_a_body_at_rest_are_its_handles():
    body = reference_body("tall")
    found = body_samples(body.vertices[None], body).reshape(-1, 3)
    own = body.handle_weights[:, body.handle_weights.sum(axis=0) > 0]
    wanted = own.T @ body.vertices / own.sum(axis=0)[:, None]
    wanted -= wanted[0] * [1, 0, 1]
    gap = np.linalg.norm(found - wanted / np.ptp(body.vertices[:, 1]), axis=1)
    assert gap.max() < 0.01  # the hips of a body are not quite in one line with the sides
