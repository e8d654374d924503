import torch

from bunraku_lab.training.losses.motion_loss import motion_losses


def test_losses_are_the_masked_means_written_out():
    generator = torch.Generator().manual_seed(0)
    predicted, clean = torch.randn(2, 9, 4, generator=generator), torch.randn(2, 9, 4, generator=generator)
    weights = torch.tensor([2.0, 1.0, 0.5, 0.5])
    position, change = motion_losses(predicted, clean, torch.tensor([9, 5]), weights)
    for row, length in enumerate((9, 5)):
        error = (predicted - clean)[row, :length]
        torch.testing.assert_close(position[row], (error**2 * weights).mean())
        torch.testing.assert_close(change[row], (error.diff(dim=0) ** 2 * weights).mean())


def test_padding_does_not_count():
    clean = torch.zeros(1, 8, 3)
    predicted = clean.clone()
    predicted[:, 5:] = 9
    assert [float(part) for part in motion_losses(predicted, clean, torch.tensor([5]), torch.ones(3))] == [0, 0]
