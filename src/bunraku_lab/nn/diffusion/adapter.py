"""The adaptation's last layer alone, in a file of its own: what `bunraku train adaptation` changes of a denoiser."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import torch

from bunraku.errors import WeightsError
from bunraku_lab.nn.checkpoints import load_checkpoint, save_checkpoint
from bunraku_lab.nn.diffusion.checkpoint import load_denoiser, save_denoiser
from bunraku_lab.nn.diffusion.denoiser import Denoiser

__all__ = ["adapted_denoiser", "frozen_digest", "save_adapter"]

KIND = "adaptation"
LAYER = "adaptation_out."


def frozen_digest(model: Denoiser) -> str:
    """What tells the weights of a denoiser but for its adaptation's last layer from others."""
    found = hashlib.sha256()
    for name, value in sorted(model.state_dict().items()):
        if not name.startswith(LAYER):
            found.update(name.encode() + value.detach().cpu().half().contiguous().numpy().tobytes())
    return found.hexdigest()


def save_adapter(path: str | Path, model: Denoiser, notes: Mapping[str, object]) -> Path:
    """Write the last layer of a denoiser's adaptation, and which denoiser it is of.

    Args:
        path: The file.
        model: The denoiser.
        notes: How it was trained.
    """
    layer = {name: value for name, value in model.state_dict().items() if name.startswith(LAYER)}
    shape = {"adaptation_mesh": model.config.adaptation_mesh, "adaptation_frame": model.config.adaptation_frame}
    return save_checkpoint(path, layer, {**shape, "of": frozen_digest(model), "notes": dict(notes)}, KIND, half=True)


def adapted_denoiser(adapter: str | Path, denoiser: str | Path, out: str | Path) -> Path:
    """Write a denoiser with the adaptation of a file.

    Args:
        adapter: What `save_adapter` wrote.
        denoiser: The weights that it was trained on.
        out: Where to write.

    Raises:
        WeightsError: A file is missing or damaged, or the adaptation belongs to other weights.
    """
    layer, said = load_checkpoint(adapter, KIND)
    model = load_denoiser(denoiser)
    if said.get("of") != frozen_digest(model):
        raise WeightsError(
            f"{adapter}: this adaptation was trained on other weights than {denoiser}; train it on them with `bunraku "
            "train adaptation`"
        )
    shape = {name: said[name] for name in ("adaptation_mesh", "adaptation_frame")}
    built = Denoiser(replace(model.config, **shape))
    try:
        built.load_state_dict({**model.state_dict(), **{name: torch.as_tensor(value) for name, value in layer.items()}})
    except RuntimeError as error:
        raise WeightsError(f"{adapter}: its layer does not fit {denoiser}; train it again") from error
    return save_denoiser(out, built, {**model.notes, "adaptation": said.get("notes", {})})
