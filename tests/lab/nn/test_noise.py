import torch

from bunraku.diffusion.sampling.noise import generator
from bunraku_lab.nn.diffusion.noise import add_noise, alphas_cumprod


def test_noise_keeps_unit_variance():
    drawn = torch.Generator().manual_seed(0)
    clean, noise = torch.randn(3, 100, 50, generator=drawn), torch.randn(3, 100, 50, generator=drawn)
    noisy = add_noise(clean, noise, torch.tensor([0, 500, 999]), alphas_cumprod())
    torch.testing.assert_close(noisy.var((1, 2)), torch.ones(3), atol=0.05, rtol=0)
    torch.testing.assert_close(noisy[0], clean[0], atol=0.05, rtol=0)
    torch.testing.assert_close(noisy[2], noise[2], atol=1e-3, rtol=0)


def test_noise_by_seed_is_what_torch_draws():
    for shape in ((3, 271), (120, 271), (7, 5), (4, 4)):
        for seed, row in ((0, 0), (7, 3), (2**40 + 5, 1), (-3, 2)):
            ours = generator(seed, row)
            theirs = torch.Generator().manual_seed((seed + row * 0x9E3779B97F4A7C15) % 2**63)
            for _ in range(2):
                torch.testing.assert_close(
                    torch.from_numpy(ours.draw(*shape)), torch.randn(*shape, generator=theirs), atol=2e-6, rtol=0
                )
