"""A new run from the weights of another one, on other data with other statistics."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import torch

from bunraku.diffusion.denoiser_config import DenoiserConfig
from bunraku.diffusion.inference.examples import EXAMPLE_TOKENS
from bunraku.errors import OptionError
from bunraku_lab.nn.diffusion.checkpoint import load_denoiser
from bunraku_lab.nn.diffusion.denoiser import Denoiser

__all__ = ["rescaled", "start_from"]

_HEAD = "adaptation_out."
_FREE = {"adaptation_mesh", "adaptation_frame", "examples"}
"""What may differ: the adaptation's layer is small and trained anew, and examples begin without effect."""


@torch.no_grad()
def rescaled(model: Denoiser, mean: torch.Tensor, std: torch.Tensor) -> dict[str, torch.Tensor]:
    """Weights that say of motions in other units what a denoiser says of them in its own.

    Network units are `(value - mean) / std`. The first and the last layer are linear in them, so the change of units
    goes into these two layers without loss: the same clean motion gives the same prediction. Noise, which has the same
    size in any units, does not.

    Args:
        model: The denoiser.
        mean: The new statistics, shape (D,).
        std: The same, shape (D,).

    Returns:
        A state for a denoiser of the same config.
    """
    state = {name: value.clone() for name, value in model.state_dict().items()}
    patch = model.config.frames_per_token
    scale, shift = ((std / model.std).float().repeat(patch), ((mean - model.mean) / model.std).float().repeat(patch))
    weight = state["motion_in.weight"].float()
    state["motion_in.bias"] = state["motion_in.bias"].float() + weight @ shift
    state["motion_in.weight"] = weight * scale
    state["motion_out.weight"] = state["motion_out.weight"].float() / scale[:, None]
    state["motion_out.bias"] = (state["motion_out.bias"].float() - shift) / scale
    state["mean"], state["std"] = mean.clone(), std.clone()
    return state


def start_from(path: str | Path, model: Denoiser) -> None:
    """Give a new denoiser the weights of a checkpoint, in the units of its own statistics; its adaptation's layer stays
    as it is.

    Args:
        path: A checkpoint of kind "diffusion".
        model: The new denoiser, its `mean` and `std` set.

    Raises:
        OptionError: The checkpoint is of another network.
        WeightsError: It is missing or broken.
    """
    old = load_denoiser(path)
    names = [field.name for field in fields(DenoiserConfig) if field.name not in _FREE]
    other = [name for name in names if getattr(old.config, name) != getattr(model.config, name)]
    if other:
        raise OptionError(
            f"{path}: a run cannot start from this network, whose {', '.join(other)} differ; give the preset that it "
            "was trained with"
        )
    state = rescaled(old, model.mean.cpu(), model.std.cpu())
    if model.config.examples and not old.config.examples:  # examples are read as motions are
        state["example_in.weight"] = state["motion_in.weight"].repeat(1, EXAMPLE_TOKENS) / EXAMPLE_TOKENS
        state["example_in.bias"] = state["motion_in.bias"].clone()
    kept = {name: value for name, value in state.items() if not name.startswith(_HEAD)}
    model.load_state_dict(kept, strict=False)
