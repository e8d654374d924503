"""Denoisers from their configs, and in files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import torch

from bunraku.diffusion.denoiser_config import ARCHITECTURES, DenoiserConfig
from bunraku.diffusion.inference.denoiser import KIND
from bunraku.errors import WeightsError
from bunraku.nn.checkpoints import config_of
from bunraku_lab.nn.checkpoints import load_checkpoint, save_checkpoint
from bunraku_lab.nn.diffusion.denoiser import Denoiser

__all__ = ["build_denoiser", "save_denoiser", "load_denoiser"]


def build_denoiser(config: DenoiserConfig) -> Denoiser:
    """The denoiser that a config describes; both kinds are called alike.

    Raises:
        WeightsError: The architecture is unknown.
    """
    if config.architecture == "decoder":
        return Denoiser(config)
    if config.architecture == "encoder":
        from bunraku_lab.nn.diffusion.mdm_denoiser import EncoderDenoiser

        model: Denoiser = EncoderDenoiser(config)
        return model
    raise WeightsError(f"the architecture '{config.architecture}' is unknown; there are {' and '.join(ARCHITECTURES)}")


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
        built = config_of(DenoiserConfig, config)
        with torch.device("meta"):
            model = build_denoiser(built)
        model.load_state_dict(state, assign=True)
        model.notes = dict(notes or {})
    except Exception as error:
        raise WeightsError(
            f"{path}: the config and the weights of this denoiser disagree ({str(error).splitlines()[0]}); train it "
            "again"
        ) from error
    return model.to(device).eval().requires_grad_(False)
