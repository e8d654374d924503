import numpy as np
import torch

from bunraku.core.animation import Animation
from bunraku.core.motion import HandleMotion
from bunraku_lab.evaluation.motion.arap import animation_arap
from bunraku_lab.training.adaptation.arap_labels import EdgeSystem, arap_labels, edge_system
from bunraku_lab.training.losses.batched_fit import fit_locals


def one_edge():
    """An edge of rest length 1 that is 1.2 long along x, one end on handle 1."""
    spread = torch.zeros(1, 1, 3)
    spread[0, 0, 1] = 1
    return EdgeSystem(torch.tensor([[[[1.2, 0, 0]]]]), spread, torch.ones(1, 1), torch.ones(1), torch.zeros(1, 1, 3, 3))


def test_one_step_by_hand():
    """Eq. 10 for one edge: nu (0.2 + d)^2 + d^2 is least at d = -0.2 nu / (1 + nu)."""
    label = arap_labels(one_edge(), torch.zeros(1, 1, 3, 3), strength=0.2, steps=1)
    torch.testing.assert_close(label[0, 0, 1], torch.tensor([-0.2 * 0.2 / 1.2, 0, 0]))
    assert float(label[0, 0, [0, 2]].abs().max()) == 0
    torch.testing.assert_close(one_edge().loss(label), torch.tensor([[(0.2 - 0.2 * 0.2 / 1.2) ** 2]]))


def test_calm_keeps_it_short():
    """nu (0.2 + d)^2 + (1 + calm) d^2 from d = 0."""
    label = arap_labels(one_edge(), torch.zeros(1, 1, 3, 3), 0.2, 1, calm=0.5)
    torch.testing.assert_close(label[0, 0, 1, 0], torch.tensor(-0.2 * 0.2 / 1.7))


def test_each_step_is_near_the_one_before():
    """A second step starts where the first ended; all together are cut to 5 cm."""
    first, d = arap_labels(one_edge(), torch.zeros(1, 1, 3, 3), 0.1, 1), -0.2 * 0.1 / 1.1
    second = arap_labels(one_edge(), first, 0.1, 1)
    torch.testing.assert_close(second[0, 0, 1, 0], torch.tensor(d - (0.2 + d) * 0.1 / 1.1))
    far = arap_labels(one_edge(), torch.zeros(1, 1, 3, 3), 100.0, 5)
    torch.testing.assert_close(far[0, 0, 1].norm(), torch.tensor(0.05))


def test_labels_lower_the_loss_of_a_character(bank, gesture):
    row = torch.tensor([1])
    system = edge_system(fit_locals(*gesture("left_elbow", 5, 1.5), bank, row), bank)
    label = arap_labels(system, torch.zeros(1, 5, 30, 3))
    before, after = system.loss()[0], system.loss(label)[0]
    assert float(before[0]) < float(before[-2]) and float(after.mean()) < 0.9 * float(before.mean())
    assert float(label.norm(dim=-1).max()) < 0.051


def test_the_sampled_loss_is_that_of_the_whole_mesh(bank, gesture):
    """Of the dancer: what the bank's edges say is what `animation_arap` says of all edges, up to sampling."""
    from bunraku.handles.from_rig import rig_handles
    from bunraku_lab.synthetic.samples import make_sample
    from bunraku_lab.training.losses.batched_fit import posed_positions

    character = make_sample("dancer", 0.5, rigged=True)
    handles = rig_handles(character).top(4)
    fitted = fit_locals(*gesture("left_elbow", 4, 1.5), bank, torch.tensor([1]))
    still = np.zeros((4, 3))
    motion = HandleMotion(
        posed_positions(fitted, bank)[0][0], fitted.rotations[0], still, np.tile(np.eye(3), (4, 1, 1))
    )
    whole = animation_arap(Animation(character, handles, motion))
    assert abs(float(edge_system(fitted, bank).loss().mean()) / whole - 1) < 0.2
