import numpy as np
import pytest
import torch

from bunraku.body.reference import reference_body
from bunraku.diffusion.features import FEATURE_SIZE, ROOT_SIZE, decode
from bunraku.language.description.track import Track
from bunraku_lab.training.losses.contact_loss import UNIT, contact_loss, foot_points


def standing(frames=20):
    values = torch.zeros(1, frames, FEATURE_SIZE)
    values[..., 4], values[..., 8] = 1, 1
    values[..., ROOT_SIZE + 3 :: 9], values[..., ROOT_SIZE + 7 :: 9] = 1, 1
    return values


def test_feet_are_where_the_decoded_motion_has_them():
    values = standing(40)
    random = np.random.default_rng(0)
    values[0, :, 0] = torch.from_numpy(random.normal(0, 1, 40))  # turns
    values[0, :, 1:4] = torch.from_numpy(random.normal(0, 0.2, (40, 3)))
    points, velocity = foot_points(values)
    track = Track.of(decode(values[0].numpy()))
    ankle = track.points["left_ankle"]
    np.testing.assert_allclose(points[0, :, 0, 1].numpy(), ankle[:, 1], atol=1e-5)
    speed = np.linalg.norm(np.diff(ankle, axis=0), axis=1) * 20
    np.testing.assert_allclose(velocity[0, :, 0].norm(dim=-1).numpy(), speed, atol=0.01)


def test_a_standing_foot_that_slides_costs_the_square_of_its_speed():
    clean, lengths, body = standing(), torch.tensor([20]), torch.tensor([True])
    assert contact_loss(clean, clean, lengths, body).item() == 0
    slid = clean.clone()
    slid[..., 2] = 2 * UNIT  # all four handles slide at twice the unit
    assert contact_loss(slid, clean, lengths, body).item() == pytest.approx(4.0, rel=1e-5)
    assert contact_loss(slid, clean, lengths, ~body).item() == 0  # another body's feet are not known
    raised = clean.clone()
    raised[..., 3] = 0.05  # a height of one unit, without speed
    assert contact_loss(raised, clean, lengths, body).item() == pytest.approx(1.0, rel=1e-5)


def test_a_foot_in_the_air_costs_nothing():
    clean = standing()
    clean[..., 3] = 0.5
    moved = clean.clone()
    moved[..., 2] = 1.0
    assert contact_loss(moved, clean, torch.tensor([20]), torch.tensor([True])).item() == 0
    assert reference_body().handles.positions[7, 1] < 0.2  # an ankle
