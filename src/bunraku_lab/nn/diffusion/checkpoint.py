"""Denoisers in files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import torch

from bunraku.diffusion.denoiser_config import denoiser_config
from bunraku.diffusion.inference.denoiser import KIND
from bunraku.errors import WeightsError
from bunraku_lab.nn.checkpoints import load_checkpoint, save_checkpoint
from bunraku_lab.nn.diffusion.denoiser import Denoiser

__all__ = ["load_denoiser", "save_denoiser"]


def save_denoiser(
    path: str | Path, model: Denoiser, notes: Mapping[str, object] | None = None, half: bool = True
) -> Path:
    """Write a denoiser with its config; `notes` (data, steps, time) go into the config's "notes"."""
    return save_checkpoint(path, model.state_dict(), asdict(model.config) | {"notes": notes or {}}, KIND, half=half)


def load_denoiser(path: str | Path, device: str | torch.device = "cpu") -> Denoiser:
    """Read a denoiser, ready for sampling.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its config and weights disagree.
    """
    state, config = load_checkpoint(path, KIND)
    notes = config.pop("notes", None)
    try:
        built = denoiser_config(config)
        with torch.device("meta"):
            model = Denoiser(built)
        model.load_state_dict(state, assign=True)
        model.notes = dict(notes or {})
    except Exception as error:
        raise WeightsError(
            f"{path}: the config and the weights of this denoiser disagree ({str(error).splitlines()[0]}); train it "
            "again"
        ) from error
    return model.to(device).eval().requires_grad_(False)
