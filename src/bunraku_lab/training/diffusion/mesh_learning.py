"""Mesh-specific motion learning (section 3.2 of TapMo): spring and adversarial loss of the adaptation on random
characters.

At each step some rows of the batch are given to random characters of a bank. Their motions are fitted to these
characters with the predicted adaptation, and only the adaptation is judged: rotations and everything else are those of
the data (Eq. 9).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from bunraku.body.layout import HANDLE_COUNT
from bunraku.diffusion.features import ROOT_SIZE
from bunraku.geometry.rotations import matrix_from_6d
from bunraku_lab.datasets.characters.bank_file import CharacterBank
from bunraku_lab.nn.checkpoints import TrainingState
from bunraku_lab.training.losses.adversarial_loss import (
    ARM_VERTICES,
    MARGIN,
    MeshMotionDiscriminator,
    adversarial_loss,
    discriminator_loss,
    discriminator_turn,
    handle_driven,
    skeleton_driven,
)
from bunraku_lab.training.losses.batched_fit import Fitted, fit_locals, posed_positions
from bunraku_lab.training.losses.spring_loss import spring_loss, springs_present

__all__ = ["MeshDraw", "MeshLearning", "local_motion"]


@dataclass(frozen=True, eq=False)
class MeshDraw:
    """Rows of a batch that are on characters of the bank.

    Args:
        rows: Rows of the batch, shape (R,).
        characters: Their characters, shape (R,).
        starts: First frame of the stretch that is looked at, shape (R,).
        frames: Its length F.
        picked: Arm vertices, shape (R, 100).
    """

    rows: Tensor
    characters: Tensor
    starts: Tensor
    frames: int
    picked: Tensor

    def stretch(self, values: Tensor) -> Tensor:
        """The stretch of each row, shape (B, N, ...) -> (R, F, ...)."""
        frames = self.starts[:, None] + torch.arange(self.frames, device=self.starts.device)
        return values[self.rows[:, None], frames]


def local_motion(features: Tensor) -> tuple[Tensor, Tensor]:
    """Local rotations (B, N, K, 3, 3) and translations (B, N, K, 3) [m] of motion features (B, N, 271)."""
    local = features[..., ROOT_SIZE:].unflatten(-1, (HANDLE_COUNT - 1, 9)).float()
    rotations = matrix_from_6d(local[..., 3:])
    still = torch.eye(3, device=features.device).expand(*rotations.shape[:2], 1, 3, 3)
    return torch.cat([still, rotations], dim=2), torch.cat(
        [torch.zeros_like(local[:, :, :1, :3]), local[..., :3]], dim=2
    )


class MeshLearning:
    """The characters, the discriminator and its optimiser.

    Args:
        bank: The characters; those of the split "train" are drawn.
        device: Where to compute.
        characters: Rows a step.
        frames: Frames of each that are looked at.
        sigma: Of the spring loss.
        learning_rate: Of the discriminator.
    """

    def __init__(
        self,
        bank: CharacterBank,
        device: torch.device,
        characters: int,
        frames: int,
        sigma: float,
        learning_rate: float = 1e-4,
    ):
        self.bank = bank.to(device)
        self.characters, self.frames, self.sigma = characters, frames, sigma
        self.discriminator = MeshMotionDiscriminator().to(device)
        self.optimizer = torch.optim.Adam(self.discriminator.parameters(), lr=learning_rate)
        self.score = 0.0  # the mean score of fakes, from the last step
        armed = bank.arms.cpu().numpy()
        self._rows = {None: bank.rows("train"), True: bank.rows("train", True)}
        self._rows = {kind: rows[armed[rows]] for kind, rows in self._rows.items()}

    def draw(
        self, random: np.random.Generator, lengths: np.ndarray, meshes: list[str | None] | None, cross: float
    ) -> MeshDraw | None:
        """Rows of a batch, among those that no character of their own belongs to, and their characters; None where
        there are none.

        Args:
            random: Draws them.
            lengths: Frames of each row, shape (B,).
            meshes: The character that each row's motion belongs to, None for any humanoid.
            cross: Share of the rows that take any body at all.
        """
        able = [row for row, length in enumerate(lengths) if length >= 8 and (meshes is None or meshes[row] is None)]
        people, all_bodies = self._rows[True], self._rows[None]
        if not able or not len(all_bodies) or self.characters < 1:
            return None
        rows = np.sort(random.choice(able, min(self.characters, len(able)), replace=False))
        bodies = [all_bodies if random.random() < cross or not len(people) else people for _ in rows]
        chosen = np.array([int(some[int(random.random() * len(some))]) for some in bodies])
        frames = min(self.frames, int(lengths[rows].min()))
        starts = np.array([int(random.integers(int(lengths[row]) - frames + 1)) for row in rows])
        picked = random.integers(0, self.bank.arm_points.shape[1], (len(rows), ARM_VERTICES))
        device = self.bank.handles.device
        tensors = [torch.from_numpy(value).to(device) for value in (rows, chosen, starts, picked)]
        return MeshDraw(tensors[0], tensors[1], tensors[2], frames, tensors[3])

    def losses(
        self, draw: MeshDraw, clean: Tensor, delta: Tensor, learns: bool
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Spring and adversarial loss of the adaptation, and what the discriminator is to learn from.

        Args:
            draw: The rows.
            clean: Features of the batch, shape (B, N, 271).
            delta: Predicted adaptation [m], shape (B, N, K, 3).
            learns: Whether the discriminator has its turn; then the adversarial loss is 0.

        Returns:
            L_h and L_a, scalars, and real and fake samples for the discriminator, without gradients.
        """
        fitted: Fitted = fit_locals(*local_motion(draw.stretch(clean)), self.bank, draw.characters)
        offset = draw.stretch(delta).float()
        bank, row = self.bank, draw.characters
        # in the reference body's metres, so that the spring of a giant is that of a child
        scale = bank.scale[row][:, None, None]
        positions = posed_positions(fitted, bank, offset)[1] / scale[:, None]
        springs = springs_present(bank.present[row], bank.roles[row])
        spring = spring_loss(positions, bank.handles[row] / scale, springs, self.sigma).mean()
        fake = handle_driven(fitted, bank, draw.picked, offset)
        if learns:
            adversarial = torch.zeros((), device=delta.device)
        else:
            self.discriminator.requires_grad_(False)
            adversarial = adversarial_loss(self.discriminator(fake))
            self.discriminator.requires_grad_(True)
        return spring, adversarial, skeleton_driven(fitted, bank, draw.picked), fake.detach()

    def learn(self, real: Tensor, fake: Tensor, learns: bool) -> tuple[Tensor, float]:
        """Gradients of the discriminator on real and fake arms, where it has its turn; its loss and the mean score of
        the fakes.

        The caller steps the optimiser (`step`), so that several processes can average the gradients first.
        """
        with torch.set_grad_enabled(learns):
            fakes = self.discriminator(fake)
            loss = discriminator_loss(self.discriminator(real), fakes)
        if learns:
            loss.backward()
        return loss.detach(), float(torch.sigmoid(fakes.detach()).mean())

    def step(self) -> None:
        """One step of the discriminator's optimiser."""
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)

    def add_to(self, state: TrainingState) -> None:
        """Add the discriminator to what a run goes on from."""
        state.models["discriminator"] = self.discriminator.state_dict()
        state.optimizers["discriminator"] = self.optimizer.state_dict()
        state.values["score"] = self.score

    def restore(self, state: TrainingState) -> None:
        """Go on from a saved state; one of before there was a discriminator leaves a fresh one."""
        if "discriminator" in state.models:
            self.discriminator.load_state_dict(state.models["discriminator"])
            self.optimizer.load_state_dict(state.optimizers["discriminator"])
            self.score = float(state.values.get("score", 0.0))

    @property
    def learns(self) -> bool:
        """Whether the discriminator has its turn (A.2)."""
        return discriminator_turn(self.score, MARGIN)
