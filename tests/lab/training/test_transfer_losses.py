"""Losses of Skeleton-free Pose Transfer against values computed by hand."""

import math

import pytest
import torch

from bunraku_lab.training.losses.transfer_losses import chamfer_loss, far_points, transform_loss, weight_divergence


def test_transforms_by_hand():
    own = torch.tensor([[1.0, 0, 0, 1, 0, 0, 0], [0, 0, 0, 0, 1, 0, 0]])
    true = torch.tensor([[0.0, 2, 0, -1, 0, 0, 0], [0, 0, 0, 1, 0, 0, 0]])
    # 3 for the way, 0 for a quaternion that is the same with the other sign; then half of 1 + 1
    assert float(transform_loss(own, true)) == pytest.approx((3 + 0.5 * 2) / 2)


def test_far_points_are_the_corners():
    points = torch.tensor([[0.0, 0, 0], [4, 0, 0], [4.1, 3, 0], [2, 1, 0], [0, 3, 0]])
    assert far_points(points, 3).tolist() == [2, 0, 1]  # farthest from the mean, then from it, then from both
    assert sorted(far_points(points, 9).tolist()) == [0, 1, 2, 3, 4]


def test_chamfer_by_hand():
    centres, points = torch.tensor([[0.0, 0, 0]]), torch.tensor([[1.0, 0, 0], [0, 3, 0]])
    assert float(chamfer_loss(centres, points)) == 1 + (1 + 9) / 2


def test_divergence_by_hand():
    even, sure = torch.zeros(1, 2), torch.tensor([[math.log(3.0), 0.0]])  # 1/2 1/2 and 3/4 1/4
    assert float(weight_divergence(even, even)) == 0
    wanted = 0.75 * math.log(0.75 / 0.5) + 0.25 * math.log(0.25 / 0.5)
    assert float(weight_divergence(even, sure)) == pytest.approx(wanted)
    held = torch.zeros(1, 2, requires_grad=True)
    weight_divergence(torch.zeros(1, 2, requires_grad=True), held).backward()
    assert held.grad is None
