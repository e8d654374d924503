"""Losses of handles and motion, against values by hand."""

import math

import numpy as np
import pytest
import torch
from oracles import registration_case

from bunraku.core.skinning import part_means, register
from bunraku.generation.features import FEATURE_SIZE, ROOT_SIZE, decode
from bunraku.generation.verifier import Track
from bunraku_lab.training.losses import handles as losses
from bunraku_lab.training.losses.handles import register_torch
from bunraku_lab.training.losses.motion import UNIT, contact_loss, foot_points, motion_losses


def test_root_loss_by_hand():
    positions = torch.tensor([[0.0, 0, 0], [2.0, 0, 0]])
    weights = torch.tensor([[0.75, 0.25], [0.25, 0.75]])
    # handle 0 at (0.75 * 0 + 0.25 * 2) / 1 = 0.5, so 0.5^2 + 1
    assert losses.root_loss(positions, weights, torch.tensor([0.0, 1.0, 0.0])).item() == pytest.approx(1.25)
    # twice the area on the second vertex: (0.25 * 2 * 2) / (0.75 + 0.5) = 0.8
    assert losses.root_loss(
        positions, weights, torch.tensor([0.0, 0, 0]), torch.tensor([1.0, 2.0])
    ).item() == pytest.approx(0.64)


def test_skinning_loss_by_hand():
    p, q = torch.tensor([0.5, 0.5]), torch.tensor([0.9, 0.1])
    kl = 0.5 * math.log(0.5 / 0.9) + 0.5 * math.log(0.5 / 0.1)
    logits = torch.stack([p, q]).log()
    i, j = torch.tensor([0]), torch.tensor([1])
    assert losses.skinning_loss(logits, i, j, torch.tensor([1.0])).item() == pytest.approx(kl)
    assert losses.skinning_loss(logits, i, j, torch.tensor([-1.0])).item() == pytest.approx(-kl)
    assert losses.skinning_loss(logits * 100, i, j, torch.tensor([-1.0]), apart=3.0).item() == pytest.approx(-3.0)
    assert (
        losses.skinning_loss(logits * 100, i, j, torch.tensor([-1.0]), apart=math.inf).item() < -3
    )  # Eq. 13 as it is written


def test_smoothness_by_hand():
    weights = torch.tensor([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])
    # |(0.5, -0.5)|^2 = 0.5 and |(1, -1)|^2 = 2
    assert losses.smoothness_loss(weights, torch.tensor([[0, 1], [0, 2]])).item() == pytest.approx(1.25)
    assert losses.smoothness_loss(weights, torch.zeros(0, 2, dtype=torch.long)).item() == 0


def test_pose_loss_is_zero_for_true_parts_and_by_hand_for_one():
    rng = torch.Generator().manual_seed(0)
    rest = torch.randn(40, 3, generator=rng)
    weights = torch.zeros(40, 3)
    weights[:15, 0], weights[15:, 1] = 1, 1
    turn = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    posed = rest.clone()
    posed[15:] = rest[15:] @ turn.T + torch.tensor([0.1, 0.2, 0.3])
    assert losses.pose_loss(rest, posed[None], weights).item() == pytest.approx(0, abs=1e-9)
    # all weight on the root, which rests: what is left is the whole displacement
    alone = torch.zeros(40, 3)
    alone[:, 0] = 1
    expected = (posed - rest).square().sum(-1).mean().item()
    assert losses.pose_loss(rest, posed[None], alone).item() == pytest.approx(expected, rel=1e-5)


def test_semantic_loss_by_hand_and_without_labels():
    logits = torch.tensor([[0.5, 0.5], [0.25, 0.75]]).log()
    target = torch.tensor([[1.0, 0.0], [0.0, 1.0]])
    areas = torch.tensor([0.5, 0.5])
    assert losses.semantic_loss(logits, target, areas).item() == pytest.approx(-(math.log(0.5) + math.log(0.75)) / 2)
    assert losses.semantic_loss(logits, target * 0, areas).item() == 0


def test_torch_equals_numpy():
    source, targets, weights = case = registration_case()
    rotations, translations = register(source, targets, weights)
    theirs = register_torch(*(torch.tensor(array) for array in case))
    np.testing.assert_allclose(theirs[0], rotations, atol=1e-9)
    np.testing.assert_allclose(theirs[1], translations, atol=1e-9)
    np.testing.assert_allclose(theirs[2], part_means(source, weights), atol=1e-12)


def test_torch_gradients_equal_differences():
    cut = (array[:12] if array.ndim == 2 else array[:2, :12] for array in registration_case())
    source, targets, weights = map(torch.tensor, cut)
    weights = weights[:, :2].clone().requires_grad_()

    def moved(w):
        rotations, translations, handles = register_torch(source, targets, w)
        return torch.einsum("nkij,kj->nki", rotations, handles), translations

    assert torch.autograd.gradcheck(moved, (weights,), atol=1e-6)


def test_torch_gradients_are_finite_where_singular_values_coincide():
    """A cube (three equal singular values), a line, a point and an empty part."""
    cube = torch.tensor([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
    weights = torch.zeros(8, 4)
    weights[:, 0], weights[:2, 1], weights[0, 2] = 1, 1, 1
    weights.requires_grad_()
    rotations, translations, handles = register_torch(cube, cube[None] + 0.5, weights)
    (rotations.square() @ torch.rand(3, 3)).sum().add(translations.sum() + handles.sum()).backward()
    assert torch.isfinite(weights.grad).all()
    torch.testing.assert_close(rotations.detach()[0], torch.eye(3).expand(4, 3, 3))


def test_losses_are_the_masked_means_written_out():
    generator = torch.Generator().manual_seed(0)
    predicted, clean = torch.randn(2, 9, 4, generator=generator), torch.randn(2, 9, 4, generator=generator)
    weights = torch.tensor([2.0, 1.0, 0.5, 0.5])
    position, change = motion_losses(predicted, clean, torch.tensor([9, 5]), weights)
    for row, length in enumerate((9, 5)):
        error = (predicted - clean)[row, :length]
        torch.testing.assert_close(position[row], (error**2 * weights).mean())
        torch.testing.assert_close(change[row], (error.diff(dim=0) ** 2 * weights).mean())


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
