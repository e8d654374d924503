"""Motion-to-text retrieval with the denoiser as judge: does a held-out motion find back the sentence it was captioned
with?

For a clip and each of 32 candidate sentences, the clip is noised and the error of the predicted x0 under that sentence
is taken, as in diffusion classifiers (Li et al. 2023). The candidates share the noise. The sentence with the least
error is the answer; a model that ignores its text is right one time in 32.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bunraku.diffusion.features import FeatureStatistics, feature_weights
from bunraku.errors import OptionError
from bunraku.language.captions.phrases import caption_group, caption_variants
from bunraku.language.encoders import TextEncoder
from bunraku_lab.nn.diffusion.checkpoint import load_denoiser
from bunraku_lab.nn.diffusion.denoiser import Denoiser
from bunraku_lab.nn.diffusion.noise import add_noise, alphas_cumprod
from bunraku_lab.nn.text import tensors_of
from bunraku_lab.training.losses.motion_loss import motion_losses
from bunraku_lab.training.rows.clip_data import load_clips
from bunraku_lab.training.runs.half_precision import bf16_is_fast

__all__ = ["candidate_errors", "draw_candidates", "retrieval", "wilson_interval"]

LEVELS = (500, 600, 700, 760, 820, 880, 940, 980)  # steps at which the sentence says more than the noisy motion does
FRAMES = 120


def wilson_interval(right: int, total: int) -> tuple[float, float]:
    """95 % interval of a share, after Wilson (1927)."""
    if total == 0:
        return 0.0, 1.0
    z, share = 1.959964, right / total
    middle = (share + z * z / (2 * total)) / (1 + z * z / total)
    half = z / (1 + z * z / total) * math.sqrt(share * (1 - share) / total + z * z / (4 * total * total))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def draw_candidates(texts: Sequence[str], labels: Sequence[str], count: int, random: np.random.Generator) -> list[str]:
    """The first of a clip's captions and `count` - 1 others, each of another meaning than the clip's and than one
    another.

    Args:
        texts: All captions of the clip.
        labels: Captions to draw from.
        count: Candidates in all.
        random: Draws them.

    Raises:
        OptionError: The labels have too few meanings.
    """
    own = {caption_group(text).name for text in texts}
    others = {caption_group(label).name: label for label in sorted(labels, reverse=True)}
    names = sorted(name for name in others if name not in own)
    if len(names) < count - 1:
        raise OptionError(
            f"the held-out clips have captions of {len(names) + 1} meanings, fewer than the {count} candidates asked "
            "for"
        )
    return [texts[0], *(others[names[index]] for index in random.permutation(len(names))[: count - 1])]


@torch.inference_mode()
def candidate_errors(
    model: Denoiser,
    encoder: TextEncoder,
    clean: torch.Tensor,
    sentences: Sequence[str],
    levels: Sequence[int],
    seed: int,
    bf16: bool | None = None,
) -> torch.Tensor:
    """Weighted squared error of x0 under each sentence.

    Args:
        model: The denoiser.
        encoder: Its text encoder.
        clean: The motion in network units, shape (N, D).
        sentences: C candidates.
        levels: Diffusion steps.
        seed: Of the noise, which the candidates share.
        bf16: Let matrix products run in bfloat16; None where the device has them in hardware.

    Returns:
        Shape (levels, C).
    """
    device, count, curve = model.mean.device, len(sentences), alphas_cumprod()
    text = tensors_of(encoder.encode(list(sentences))).to(device)
    generator = torch.Generator().manual_seed(seed)
    clean = clean[None].to(device)
    lengths = torch.full((count,), clean.shape[1], device=device)
    weights = torch.from_numpy(feature_weights()).to(device)
    yes, no = torch.ones(count, dtype=torch.bool, device=device), torch.zeros(count, dtype=torch.bool, device=device)
    errors = []
    with torch.autocast(device.type, torch.bfloat16, enabled=bf16_is_fast(device) if bf16 is None else bf16):
        condition = model.condition(text.tokens, text.mask, text.pooled, None, yes, no)
        for level in levels:
            noise = torch.randn(clean.shape, generator=generator).to(device)
            step = torch.full((count,), level, device=device)
            noisy = add_noise(clean, noise, step[:1], curve).expand(count, -1, -1)
            predicted, _ = model(noisy, step, lengths, condition)
            errors.append(motion_losses(predicted.float(), clean.expand(count, -1, -1), lengths, weights)[0])
    return torch.stack(errors).cpu()


def retrieval(
    data: str | Path = "runs/data/motions",
    *,
    checkpoint: str | Path | None = None,
    split: str = "test",
    candidates: int = 32,
    levels: Sequence[int] = LEVELS,
    frames: int = FRAMES,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Top-1, top-2 and top-3 accuracy of finding a clip's caption among candidates.

    Args:
        data: What `bunraku data motions` wrote.
        checkpoint: Weights of the denoiser; None takes the shipped ones.
        split: Clips to test on; captions are drawn from the same split.
        candidates: Captions a clip, its own included.
        levels: Diffusion steps that count, each the same.
        frames: Longest cut of a clip, from its middle.
        seed: Of candidates and noise.
        progress: Called with (clips done, total).

    Returns:
        Numbers and lists that JSON can say: "clips", "candidates", "chance", "top1" to "top3", "top1_interval" (95 %,
        Wilson), "times_chance", "mean_rank", and "rows" with each clip's caption, rank and first answer.

    Raises:
        FormatError: The data are missing or damaged.
        OptionError: There are fewer captions than candidates, or a setting is out of range.
        WeightsError: The weights are missing or broken.
    """
    from bunraku.diffusion.generation.networks import load_generator
    from bunraku.nn.checkpoints import shipped_checkpoint

    if candidates < 2 or frames < 1 or not levels or any(not 0 <= level < 1000 for level in levels):
        raise OptionError("retrieval needs at least 2 candidates, 1 frame, and diffusion steps from 0 to 999")
    model = load_denoiser(checkpoint or shipped_checkpoint("diffusion"))
    _, encoder = load_generator(checkpoint)
    clips = load_clips(data, splits={split})
    statistics = FeatureStatistics(model.mean.cpu().numpy(), model.std.cpu().numpy())
    labels = [text for entry in clips.values() for text in entry["texts"]]
    rows = []
    for number, (name, entry) in enumerate(clips.items()):
        features = entry["features"]
        start = max(len(features) - min(frames, model.config.frames), 0) // 2
        clean = torch.from_numpy(statistics.normalise(features[start : start + frames]).astype(np.float32)).clamp(-8, 8)
        captions = draw_candidates(entry["texts"], labels, candidates, np.random.default_rng([seed, number]))
        errors = candidate_errors(
            model,
            encoder,
            clean,
            [caption_variants(text)[0] for text in captions],
            levels,
            seed * 1_000_003 + number,
        )
        score = (errors / errors.mean(1, keepdim=True)).mean(0)  # each noise level counts the same
        rank = int((score <= score[0]).sum())  # a draw is lost, so that a model without an opinion is last
        answer = captions[0] if rank == 1 else captions[1 + int(score[1:].argmin())]
        rows.append({"clip": name, "caption": captions[0], "rank": rank, "answer": answer})
        if progress is not None:
            progress(number + 1, len(clips))
    ranks = np.array([row["rank"] for row in rows])
    tops = {f"top{index}": float((ranks <= index).mean()) for index in (1, 2, 3)}
    return {
        "clips": len(rows),
        "candidates": candidates,
        "chance": 1 / candidates,
        **tops,
        "top1_interval": list(wilson_interval(int((ranks == 1).sum()), len(rows))),
        "times_chance": tops["top1"] * candidates,
        "mean_rank": float(ranks.mean()),
        "rows": rows,
    }
