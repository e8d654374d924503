"""From a sentence to a handle motion: what `bunraku.generate` and `bunraku.animate` call."""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bunraku.diffusion.features import FeatureStatistics, decode
from bunraku.diffusion.text import TextEncoder, check_prompt, text_encoder
from bunraku.errors import OptionError
from bunraku.motion import HandleMotion

if TYPE_CHECKING:
    from bunraku.diffusion.denoiser import Denoiser

__all__ = ["GUIDANCE", "STEPS", "generate_motion", "load_generator"]

STEPS = 20
GUIDANCE = 2.5


def generate_motion(
    prompt: str,
    seconds: float,
    *,
    seed: int = 0,
    steps: int | None = None,
    guidance: float | None = None,
    mesh_feature: object | None = None,
    progress: Callable[[str, float], None] | None = None,
    checkpoint: str | Path | None = None,
) -> HandleMotion:
    """A handle motion of the reference body from a sentence (Eq. 2 of TapMo), at the model's 20 frames a second.

    Args:
        prompt: What the character does, in English, at most 1,000 characters, of which some 30 words are read.
        seconds: Length [s].
        seed: The same seed and version give the same motion.
        steps: Sampling steps, 1 to 1,000; None takes 20.
        guidance: Classifier-free guidance scale, 0 to 20; None takes 2.5.
        mesh_feature: f_phi of the character, shape (448,); None, or weights that were trained without characters, generate for
            no mesh in particular.
        progress: Called with a stage's name and the share done.
        checkpoint: Weights in place of the shipped ones.

    Raises:
        OptionError: The prompt or a setting is outside what can be done.
        WeightsError: The weights are missing or broken.
    """
    prompt = check_prompt(prompt)
    steps, guidance = STEPS if steps is None else steps, GUIDANCE if guidance is None else guidance
    if not 1 <= steps <= 1000:
        raise OptionError(f"sampling takes 1 to 1,000 steps, not {steps}")
    if not (math.isfinite(guidance) and 0 <= guidance <= 20):
        raise OptionError(f"the guidance scale must be from 0 to 20, not {guidance:g}")
    if not (math.isfinite(seconds) and seconds > 0):
        raise OptionError(f"a motion needs a length of more than 0 seconds, not {seconds:g}")

    import torch

    from bunraku.diffusion.windows import sample_long
    from bunraku.nn.threads import fitting_threads

    if progress:
        progress("generate", 0.0)
    model, encoder = load_generator(checkpoint)
    mesh = None
    if mesh_feature is not None and model.knows_meshes:
        mesh = torch.as_tensor(np.asarray(mesh_feature, np.float32))[None]
        if mesh.shape != (1, model.config.mesh_features) or not bool(torch.isfinite(mesh).all()):
            raise OptionError(f"the mesh feature must be {model.config.mesh_features} finite numbers")
    with fitting_threads(model):
        result = sample_long(
            model,
            encoder.encode([prompt]),
            max(1, round(seconds * model.config.fps)),
            mesh_features=mesh,
            steps=steps,
            guidance=guidance,
            seed=seed,
            progress=(lambda done, total: progress("generate", done / total)) if progress else None,
        )
    statistics = FeatureStatistics(model.mean.cpu().numpy(), model.std.cpu().numpy())
    motion = decode(statistics.restore(result.values[0].cpu().numpy()), model.config.fps)
    return adapt(motion, result.adaptation[0].cpu().numpy())


def adapt(motion: HandleMotion, adaptation: np.ndarray) -> HandleMotion:
    """The motion with the adaptation added to its local translations (section 3.2 of TapMo).

    Args:
        motion: N frames of K handles.
        adaptation: Offsets [m], shape (N, K, 3); the root's is left out.
    """
    if not adaptation.any():
        return motion
    translations = motion.translations + adaptation
    translations[:, 0] = 0
    return HandleMotion(translations, motion.rotations, motion.root_translation, motion.root_rotation, motion.fps)


def load_generator(checkpoint: str | Path | None = None) -> tuple[Denoiser, TextEncoder]:
    """The denoiser and its text encoder, kept between calls as long as the file does not change.

    Weights trained with CLIP look for its folder in the environment variable BUNRAKU_CLIP.

    Args:
        checkpoint: Weights in place of the shipped ones.

    Raises:
        WeightsError: The weights are missing or broken.
    """
    from bunraku.nn.checkpoints import shipped_checkpoint

    path = shipped_checkpoint("diffusion") if checkpoint is None else Path(checkpoint)
    changed = path.stat().st_mtime_ns if path.is_file() else 0
    return _load(path, changed)


@functools.lru_cache(maxsize=2)
def _load(path: Path, changed: int) -> tuple[Denoiser, TextEncoder]:
    from bunraku.diffusion.denoiser import load_denoiser

    model = load_denoiser(path)
    name = model.config.text_encoder
    return model, text_encoder(name, os.environ.get("BUNRAKU_CLIP") if name.startswith("clip") else None)
