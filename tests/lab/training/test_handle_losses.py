import math

import numpy as np
import pytest
import torch

from bunraku.body.layout import HANDLE_MIRROR
from bunraku_lab.training.losses import handle_losses as losses


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


def test_pairs_are_sure_and_rightly_signed():
    true = torch.tensor([[1.0, 0, 0], [0.95, 0.05, 0], [0, 1.0, 0], [0.5, 0.5, 0], [0, 0, 1.0]])
    i, j, gamma = losses.skinning_pairs(true, 400, torch.Generator().manual_seed(0))
    assert 3 not in i and 3 not in j and (i != j).all()
    joint = torch.tensor([0, 0, 1, -1, 2])
    assert torch.equal(gamma > 0, joint[i] == joint[j]) and (gamma > 0).any() and (gamma < 0).any()
    i, j, gamma = losses.skinning_pairs(true, 400, torch.Generator().manual_seed(0), groups=torch.tensor([4, 4, 7]))
    assert not ((gamma < 0) & (joint[i] < 2) & (joint[j] < 2)).any()


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


def test_pose_loss_has_a_finite_gradient():
    logits = torch.zeros(20, 4, requires_grad=True)
    rest = torch.randn(20, 3, generator=torch.Generator().manual_seed(1))
    losses.pose_loss(rest, (rest * 1.1)[None], logits.softmax(-1)).backward()
    assert torch.isfinite(logits.grad).all()


def test_drive_local_is_eq_3_without_its_global_items():
    rng = np.random.default_rng(0)
    v, h, t = rng.normal(size=(5, 3)), rng.normal(size=(3, 3)), rng.normal(size=(1, 3, 3))
    s = rng.dirichlet(np.ones(3), 5)
    r = np.linalg.qr(rng.normal(size=(1, 3, 3, 3)))[0]
    expected = np.zeros((5, 3))
    for i in range(5):
        expected[i] = s[i, 0] * v[i] + sum(s[i, k] * (r[0, k] @ (v[i] - h[k]) + h[k] + t[0, k]) for k in (1, 2))
    out = losses.drive_local(*(torch.from_numpy(x) for x in (v, s, r, t, h)))
    np.testing.assert_allclose(out[0].numpy(), expected, atol=1e-12)


def test_semantic_loss_by_hand_and_without_labels():
    logits = torch.tensor([[0.5, 0.5], [0.25, 0.75]]).log()
    target = torch.tensor([[1.0, 0.0], [0.0, 1.0]])
    areas = torch.tensor([0.5, 0.5])
    assert losses.semantic_loss(logits, target, areas).item() == pytest.approx(-(math.log(0.5) + math.log(0.75)) / 2)
    assert losses.semantic_loss(logits, target * 0, areas).item() == 0


def test_sparsity_and_mirror():
    weights = torch.full((3, 8), 0.125)
    assert losses.sparsity_loss(weights).item() == pytest.approx(0.5)
    logits = torch.randn(6, 30, generator=torch.Generator().manual_seed(0))
    swap = torch.tensor(HANDLE_MIRROR)
    assert losses.mirror_loss(logits, logits[:, swap], swap).item() == pytest.approx(0, abs=1e-6)
    assert losses.mirror_loss(logits, logits, swap).item() > 0.01


def test_feature_loss_by_hand():
    before = torch.tensor([3.0, 4.0])
    assert losses.feature_loss(before, before).item() == 0
    assert losses.feature_loss(torch.tensor([3.0, 5.0]), before).item() == pytest.approx(1 / 25)
