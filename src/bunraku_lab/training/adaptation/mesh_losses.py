"""Spring and adversarial loss of the adaptation (Eq. 7 and 8 of TapMo) while all but its last layer is frozen."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from bunraku_lab.datasets.characters.bank_file import CharacterBank
from bunraku_lab.training.diffusion.mesh_learning import MeshDraw, MeshLearning
from bunraku_lab.training.losses.adversarial_loss import ARM_VERTICES

__all__ = ["MeshLosses"]


class MeshLosses:
    """nu_h L_h + nu_a L_a (Eq. 9 of TapMo) of an adaptation, and the discriminator that L_a learns against.

    Args:
        bank: The characters.
        frames: Frames of each motion that are looked at.
        spring: nu_h.
        adversarial: nu_a; 0 leaves the discriminator as it is.
    """

    def __init__(self, bank: CharacterBank, frames: int, spring: float, adversarial: float):
        self.learning = MeshLearning(bank, bank.handles.device, 0, frames, sigma=0.0)
        self.spring, self.adversarial = spring, adversarial

    def able(self, row: Tensor) -> np.ndarray:
        """Which pairs have a character with arms, by the row of each in the bank."""
        return np.flatnonzero(self.learning.bank.arms.cpu()[row.cpu()].numpy())

    def __call__(self, features: Tensor, delta: Tensor, row: Tensor, random: np.random.Generator) -> Tensor:
        """The loss, a scalar; the discriminator learns where it has its turn (A.2).

        Args:
            features: Motions (B, N, 271), not in network units.
            delta: Their adaptation [m], shape (B, N, K, 3).
            row: The character of each, shape (B,).
            random: Draws the frames and the vertices of the arms.
        """
        learning, device, count = self.learning, delta.device, len(row)
        frames = min(learning.frames, delta.shape[1])
        starts = torch.from_numpy(random.integers(delta.shape[1] - frames + 1, size=count)).to(device)
        picked = random.integers(learning.bank.arm_points.shape[1], size=(count, ARM_VERTICES))
        draw = MeshDraw(torch.arange(count, device=device), row, starts, frames, torch.from_numpy(picked).to(device))
        learns = self.adversarial > 0 and learning.learns
        spring, adversarial, real, fake = learning.losses(draw, features, delta, learns)
        if self.adversarial > 0:
            _, learning.score = learning.learn(real, fake, learns)
            if learns:
                learning.step()
        return self.spring * spring + self.adversarial * adversarial
