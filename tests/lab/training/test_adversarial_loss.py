import math

import pytest
import torch

from bunraku_lab.training.losses.adversarial_loss import (
    MeshMotionDiscriminator,
    adversarial_loss,
    discriminator_loss,
    discriminator_turn,
    handle_driven,
    skeleton_driven,
)
from bunraku_lab.training.losses.batched_fit import fit_locals


def test_adversarial_loss_by_hand():
    """Eq. 8 with Disc(real) = 0.8 and Disc(fake) = 0.25."""
    real, fake = (torch.tensor([math.log(p / (1 - p))]) for p in (0.8, 0.25))
    assert math.isclose(float(adversarial_loss(fake)), math.log(0.75), rel_tol=1e-5)
    assert math.isclose(float(discriminator_loss(real, fake)), -(math.log(0.8) + math.log(0.75)), rel_tol=1e-5)


def test_the_margin_says_whose_turn_it_is():
    assert discriminator_turn(0.31) and not discriminator_turn(0.3) and not discriminator_turn(0.1)


def test_the_order_of_vertices_does_not_matter():
    torch.manual_seed(0)
    model, points = MeshMotionDiscriminator(8), torch.randn(2, 5, 20, 6)
    assert torch.allclose(model(points), model(points[:, :, torch.randperm(20)]), atol=1e-6)
    assert not torch.allclose(model(points), model(points.flip(1)))  # time does


def test_the_discriminator_learns_to_tell_apart():
    torch.manual_seed(0)
    model = MeshMotionDiscriminator(16)
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-3)
    for _ in range(60):
        real, fake = torch.randn(8, 6, 20, 6) * 0.2, torch.randn(8, 6, 20, 6) * 0.2
        fake[..., 3:] += torch.randn(8, 6, 1, 3) * 0.5  # jitters
        loss = discriminator_loss(model(real), model(fake))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert float(loss.detach()) < 0.3


def test_arms_of_handles_and_of_bones_are_told_alike(bank, gesture):
    """A resting body looks the same either way; the chest's own motion does not show; the adaptation does."""
    rotations, translations = gesture("right_elbow", 4)
    row, picked = torch.tensor([1]), torch.arange(50)[None]
    fitted = fit_locals(torch.eye(3).expand_as(rotations), torch.zeros_like(translations), bank, row)
    still = handle_driven(fitted, bank, picked)
    assert still.shape == (1, 4, 50, 6)
    assert still[..., 3:].abs().max() < 0.015 and skeleton_driven(fitted, bank, picked)[..., 3:].abs().max() < 0.015
    fitted = fit_locals(rotations, translations, bank, row)
    moved = handle_driven(fitted, bank, picked)
    real = skeleton_driven(fitted, bank, picked)
    assert moved[:, 1:, :, 3:].abs().max() > 0.02
    assert (moved - real).abs().mean() < 0.3 * moved[..., 3:].abs().mean()  # the same motion
    shift = torch.zeros(1, 4, 30, 3)
    shift[:, :, 16:] = 0.02
    shift.requires_grad_(True)
    changed = handle_driven(fitted, bank, picked, shift)
    assert (changed - moved).abs().max() > 1e-3
    changed.square().sum().backward()
    assert shift.grad.abs().sum() > 0 and float(shift.grad[:, :, 0].abs().max()) == pytest.approx(0)
