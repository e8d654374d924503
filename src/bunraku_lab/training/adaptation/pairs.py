"""What the adaptation's linear layer sees, for many motions on many characters, kept on disk.

All else is frozen while that layer is fine-tuned (Eq. 11 of TapMo), so its inputs are computed once: training clips are
noised as little as a sampler's last step leaves them, the step at which the adaptation is read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from bunraku.diffusion.sampling.solvers import sampling_steps
from bunraku.formats.files import sweep
from bunraku.language.encoders import TextEncoder
from bunraku_lab.datasets.characters.bank_file import CharacterBank
from bunraku_lab.nn.checkpoints import load_checkpoint, save_checkpoint
from bunraku_lab.nn.diffusion.denoiser import Denoiser
from bunraku_lab.nn.diffusion.noise import add_noise, alphas_cumprod
from bunraku_lab.nn.text import tensors_of
from bunraku_lab.training.rows.clip_rows import ClipSet

__all__ = ["AdaptationPairs", "PairPlan", "collect_pairs"]

CHUNK = 32
KIND = "adaptation-pairs"


@dataclass(frozen=True, eq=False)
class AdaptationPairs:
    """P motions on characters, N frames each, in T tokens.

    Args:
        seen: What the linear layer sees: hidden state and mesh token, shape (P, T, 2 d), float16.
        motion: The denoised motion in network units, shape (P, N, 271), float16.
        row: The character of each in the bank, shape (P,).
    """

    seen: Tensor
    motion: Tensor
    row: Tensor


@dataclass(frozen=True)
class PairPlan:
    """What is drawn.

    Args:
        count: How many pairs.
        frames: Frames of each, a multiple of the model's frames a token.
        digest: What they depend on; chunks of another are made again.
        seed: Of the draws.
    """

    count: int
    frames: int
    digest: str
    seed: int = 0


@torch.no_grad()
def collect_pairs(
    model: Denoiser,
    encoder: TextEncoder,
    clips: ClipSet,
    bank: CharacterBank,
    rows: np.ndarray,
    folder: Path,
    plan: PairPlan,
    progress: Callable[[int, int], None] | None = None,
) -> AdaptationPairs:
    """Draw pairs of a training clip and a character; chunks that an earlier call wrote are read, not made again.

    Args:
        model: The denoiser.
        encoder: Its text encoder.
        clips: Clips in the model's units.
        bank: Characters.
        rows: Those that may be drawn; people's clips go to all of them, a creature's own to itself.
        folder: Where the chunks are kept.
        plan: How many are drawn.
        progress: Called with (done, total).
    """
    count, frames = plan.count, plan.frames
    folder.mkdir(parents=True, exist_ok=True)
    sweep(folder)
    curve, names = alphas_cumprod(), {name: row for row, name in enumerate(bank.names)}
    device = model.mean.device
    parts: list[dict[str, Tensor]] = []
    for chunk, start in enumerate(range(0, count, CHUNK)):
        size, path = min(CHUNK, count - start), folder / f"pairs_{chunk:04d}.safetensors"
        if path.is_file():
            state, config = load_checkpoint(path, KIND)
            if config == {"digest": plan.digest, "size": size}:
                parts.append({"seen": state["seen"].half(), "motion": state["motion"].half(), "row": state["row"]})
                continue
        random = np.random.default_rng([plan.seed, chunk, 3])
        values, sentences, chosen = np.zeros((size, frames, model.config.features), np.float32), [], []
        index = 0
        while index < size:
            drawn = clips.draw(random)
            if len(drawn.values) < frames:
                continue
            begin = int(random.integers(len(drawn.values) - frames + 1))
            values[index] = drawn.values[begin : begin + frames]
            own = names.get(drawn.mesh) if drawn.mesh is not None else None
            chosen.append(own if own is not None and own in rows else int(rows[int(random.integers(len(rows)))]))
            sentences.append(drawn.sentence)
            index += 1
        step = torch.tensor([sampling_steps(int(random.integers(10, 31)))[-1] for _ in range(size)], device=device)
        clean = torch.from_numpy(values).to(device)
        noise = torch.from_numpy(random.standard_normal(values.shape, np.float32)).to(device)
        text, yes = tensors_of(encoder.encode(sentences)).to(device), torch.ones(size, dtype=torch.bool, device=device)
        row = torch.tensor(chosen)
        condition = model.condition(text.tokens, text.mask, text.pooled, bank.features[row].to(device), yes, yes)
        hidden = model.hidden(
            add_noise(clean, noise, step, curve), step, torch.full((size,), frames, device=device), condition
        )
        motion = model.motion_out(hidden).reshape(size, -1, model.config.features)[:, :frames]
        seen = torch.cat([hidden, condition[0][:, :1].expand(-1, hidden.shape[1], -1)], dim=-1)
        part = {"seen": seen.half().cpu(), "motion": motion.half().cpu(), "row": row}
        save_checkpoint(path, part, {"digest": plan.digest, "size": size}, KIND)
        parts.append(part)
        if progress is not None:
            progress(start + size, count)
    return AdaptationPairs(*(torch.cat([part[name] for part in parts]) for name in ("seen", "motion", "row")))
