"""The settings of the training of the adaptation's last layer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bunraku_lab.training.runs.settings import RunSettings

__all__ = ["FRAMES", "AdaptationConfig"]

FRAMES = ("root", "joints")
"""What the layer may say."""


@dataclass(frozen=True, kw_only=True)
class AdaptationConfig(RunSettings):
    """Settings of the fine-tuning.

    Args:
        diffusion: The denoiser, as `bunraku train diffusion` wrote it.
        cache: The bank of characters that `bunraku data character-bank` wrote.
        data: Folder that `bunraku data motions` wrote.
        pairs: Motions on characters to learn from.
        frames: Frames of each.
        steps: Optimiser steps.
        edges: Edges of each character a step.
        strength: nu_v of Eq. 10, over a mean of the character's own ARAP-Loss and half the usual one [m^2].
        calm: Weight of delta's own squared length in Eq. 10, so that it stays short where edges do not ask for it.
        label_steps: Steps of Eq. 10, each held near the one before, for one label.
        label_weight: Weight of the distance to the labels (Eq. 11) [1 / cm^2]; 0 trains without labels.
        spring_weight: nu_h of Eq. 9.
        adversarial_weight: nu_a of Eq. 9.
        mesh_frames: Frames of each motion that those two look at.
        frame: What the layer says: "joints", how far joints should be moved, or "root", offsets as in the paper.
        mesh: Let the layer see the mesh token beside the hidden state.
        mesh_size: Main directions of the mesh token that are used.
        learning_rate: Peak.
        decay: Weight decay, in whitened coordinates.
        text_folder: Folder with CLIP, for a denoiser that was trained with it.
        device: "cuda", "cpu" or another of torch; None takes CUDA when it is there.
        save_every: Minutes between saved states.
    """

    diffusion: Path = Path("runs/diffusion/diffusion.safetensors")
    cache: Path = Path("runs/data/character_bank.npz")
    data: Path = Path("runs/data/motions")
    out: Path = Path("runs/adaptation")
    pairs: int = 2000
    frames: int = 64
    steps: int = 2000
    batch: int = 12
    edges: int = 500
    strength: float = 0.02
    calm: float = 0.03
    label_steps: int = 1
    label_weight: float = 1.0
    spring_weight: float = 0.0
    adversarial_weight: float = 0.0
    mesh_frames: int = 32
    frame: str = "joints"
    mesh: bool = True
    mesh_size: int = 64
    learning_rate: float = 6e-4
    decay: float = 1e-3
    text_folder: Path | None = None
    device: str | None = None
    save_every: float = 5.0
    validate_every: int = 100
    seed: int = 0
