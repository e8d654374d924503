"""Sampling: from noise and sentences to motions, with classifier-free guidance and values that are known beforehand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from bunraku.diffusion.denoiser import Denoiser
from bunraku.diffusion.denoiser_layers import RetrievedExamples
from bunraku.diffusion.sampling.solvers import ancestral, dpm_solver, sampling_steps
from bunraku.language.encoders import TextBatch
from bunraku.nn.threads import side_by_side

__all__ = [
    "Known",
    "Sample",
    "Solver",
    "Steering",
    "Window",
    "guided",
    "row_noise",
    "sample",
    "sample_windows",
    "starting_noise",
    "token_share",
]

# Guidance acts while the diffusion step, 0 to 999, is at least this; below it the sentence's own prediction is taken,
# which costs half. The early, noisy steps decide what is done. In the late ones the scale only enlarges details: waves
# trembled above 5 Hz. (Guidance on an interval of noise: Kynkaanniemi et al. 2024.)
GUIDED_FROM = 500
# Down to this step a guide stands for what the network would predict; the next one visited has a log signal-to-noise
# ratio of about -0.4. The root's way, height and tilt are the guide's to the end: the network halves the height of a
# jump even where there is no noise left.
LED_UNTIL = 600
ROOT = slice(0, 10)  # its features (`diffusion.features`)
GROUP = 16  # windows that go through the denoiser at once; more gain nothing on a CPU and take memory

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Known:
    """What the motion must keep.

    Args:
        values: Clean frames in network units, shape (B, N, D); anything where `share` is 0.
        share: How far each frame, or each feature of each frame, is held, 1 for fully, shape (N,), (N, D) or (B, N, D).
    """

    values: Tensor
    share: Tensor

    def spread(self) -> tuple[Tensor, Tensor]:
        """Values and share on one time line, shapes (B N, D) and (B N, D or 1)."""
        share = self.share[:, None] if self.share.ndim == 1 else self.share
        return self.values.flatten(0, 1), share.expand(len(self.values), -1, -1).flatten(0, 1)


@dataclass(frozen=True)
class Window:
    """A stretch of the time line that the denoiser sees at once.

    Args:
        frames: Which frames of the time line, shape (L,); a loop's run on from its end to its start, and may come
            twice.
        share: What the window's prediction of each frame counts among those of all windows, shape (L,).
        row: The sentence, and mesh feature, that it is given.
    """

    frames: Tensor
    share: Tensor
    row: int


@dataclass(frozen=True)
class Sample:
    """What a sampler gives.

    Args:
        values: Motions in network units, shape (B, N, D).
        adaptation: Offsets on the local translations [m], shape (B, N, K, 3).
    """

    values: Tensor
    adaptation: Tensor


def guided(
    conditional: Tensor, unconditional: Tensor, guidance: float, rescale: float = 0.0, real: Tensor | None = None
) -> Tensor:
    """Classifier-free guidance on x0 (Ho & Salimans 2022), brought back towards the conditional's deviation by the
    share `rescale` (Lin et al. 2023), shape (B, N, D); `real` (B, N) is False in padding, which does not count in the
    deviation.
    """
    x0 = unconditional + guidance * (conditional - unconditional)
    if rescale > 0:
        factor = _deviation(conditional, real) / _deviation(x0, real).clamp(min=1e-8)
        x0 = x0 * (rescale * factor + 1 - rescale)
    return x0


def _deviation(x: Tensor, real: Tensor | None) -> Tensor:
    if real is None:
        return x.std((1, 2), keepdim=True)
    return torch.stack([row[keep].std() for row, keep in zip(x, real, strict=True)]).view(-1, 1, 1)


def starting_noise(rows: int, frames: int, features: int, seed: int) -> Tensor:
    """x_T, shape (rows, frames, features): one `row_noise` for each row."""
    return torch.stack([row_noise(frames, features, seed, row) for row in range(rows)])


def row_noise(frames: int, features: int, seed: int, row: int = 0) -> Tensor:
    """x_T of one row of a batch, shape (frames, features). It is drawn from a generator of (seed, row) of its own, on
    the CPU on every machine, so a row is the same in any batch.
    """
    return torch.randn(frames, features, generator=_generator(seed, row))


def _generator(seed: int, row: int) -> torch.Generator:
    # A copy of torch's own, the same as a new one once it is seeded: making one loads what compiles graphs (0.2 s).
    return torch.default_generator.clone_state().manual_seed((seed + row * 0x9E3779B97F4A7C15) % 2**63)


def token_share(frames: int, patch: int) -> Tensor:
    """How far each frame trusts its token, shape (frames,): most in the middle, least at the edges."""
    return 1 - ((torch.arange(frames) % patch + 0.5) * 2 / patch - 1).abs()


@dataclass(frozen=True)
class Solver:
    """How motions are denoised.

    Args:
        steps: Predictions of x0 that are made, one after the other.
        guidance: Scale of classifier-free guidance; 1 is the conditional model alone and takes half the time.
        rescale: Share of guidance rescaling, 0 to 1.
        method: "dpm", or "ddpm" for the ancestral reference.
        bf16: Let matrix products run in bfloat16.
        progress: Called with (done, total) steps.
    """

    steps: int = 20
    guidance: float = 3.0
    rescale: float = 0.0
    method: str = "dpm"
    bf16: bool = False
    progress: Progress | None = None


@dataclass(frozen=True)
class Steering:
    """What acts on the predicted x0 of a time line at each step, in this order.

    Args:
        classifier_guidance: Changes what the network predicts (F, D) at the step that it is told.
        guide: What is predicted while the noise is strong, how far, and down to which step, at most `LED_UNTIL`, shapes
            (F, D), (F, 1) and (F, 1): where the motion starts from.
        refine: Changes the predicted x0 (F, D).
        known: Values to keep and how far, shapes (F, D) and (F, D) or (F, 1).
    """

    classifier_guidance: Callable[[Tensor, int], Tensor] | None = None
    guide: tuple[Tensor, Tensor, Tensor] | None = None
    refine: Callable[[Tensor], Tensor] | None = None
    known: tuple[Tensor, Tensor] | None = None


@torch.inference_mode()
def sample(
    model: Denoiser,
    text: TextBatch,
    frames: int | Sequence[int],
    solver: Solver = Solver(),
    *,
    mesh_features: Tensor | None = None,
    seed: int = 0,
    known: Known | None = None,
) -> Sample:
    """Draw one motion for each sentence, all in one batch.

    Args:
        model: The denoiser.
        text: B encoded sentences.
        frames: Length N of the motions, at most the model's `frames`; or that of each, and all are padded with zeros to
            the longest.
        solver: How they are denoised.
        mesh_features: f_phi of each row's character, shape (B, 448); None for no mesh in particular.
        seed: Of the starting noise.
        known: What to keep: it overwrites the predicted x0 at each step (section A.3).
    """
    rows = len(text.mask)
    lengths = [frames] * rows if isinstance(frames, int) else list(frames)
    longest = max(lengths)
    windows = [
        Window(torch.arange(row * longest, row * longest + length), torch.ones(length), row)
        for row, length in enumerate(lengths)
    ]
    noise = starting_noise(rows, longest, model.config.features, seed).flatten(0, 1)
    steering = Steering(known=None if known is None else known.spread())
    found = sample_windows(model, text, windows, noise, solver, steering, mesh_features=mesh_features, seed=seed)
    return Sample(found.values.unflatten(0, (rows, longest)), found.adaptation.unflatten(0, (rows, longest)))


@torch.inference_mode()
def sample_windows(
    model: Denoiser,
    text: TextBatch,
    windows: Sequence[Window],
    noise: Tensor,
    solver: Solver = Solver(),
    steering: Steering = Steering(),
    *,
    mesh_features: Tensor | None = None,
    seed: int = 0,
) -> Sample:
    """Denoise a time line through windows, all of them at each step: where they overlap, x0 is the mean of what they
    predict.

    Neighbours thus agree while the motion takes shape, and not only afterwards (as in DiffCollage, Zhang et al. 2023,
    and the first take of DoubleTake, Shafir et al. 2023). Motions of a batch lie one after the other on the time line,
    no window reaching from one into another.

    Args:
        model: The denoiser.
        text: Encoded sentences, which the windows name by their rows.
        windows: What the denoiser sees at once.
        noise: x_T on the time line, shape (F, D).
        solver: How it is denoised.
        steering: What acts on the predictions.
        mesh_features: f_phi of each sentence's character, shape (B, 448).
        seed: Of the noise that the ancestral sampler adds.

    Returns:
        Values (F, D) and adaptation (F, K, 3); zero in frames that no window counts in.
    """
    device, config, bf16, guide = model.mean.device, model.config, solver.bf16, steering.guide
    text, noise = text.to(device), noise.to(device)
    order = sorted(windows, key=lambda window: len(window.frames))  # a group pads to its longest
    led_whole = [guide is not None and bool((guide[1][window.frames.cpu()] >= 1).all()) for window in order]
    examples = None
    if config.examples:
        from bunraku.diffusion.examples.attended import example_bank

        examples = example_bank(model)(text).to(device)
    with torch.autocast(device.type, torch.bfloat16, enabled=bf16):
        groups = [
            _Group(model, text, some[start : start + GROUP], mesh_features, examples, solver, led)
            for led in (False, True)
            for some in [[window for window, own in zip(order, led_whole, strict=True) if own == led]]
            for start in range(0, len(some), GROUP)
        ]
    total = torch.zeros(len(noise), 1, device=device)
    for group in groups:
        total.index_add_(0, group.frames[group.real], group.share[group.real][:, None])
    total = total.clamp(min=1e-8)
    held = None if steering.known is None else tuple(part.to(device) for part in steering.known)
    led = None if guide is None else tuple(part.to(device) for part in guide)
    visited = sampling_steps(solver.steps)
    last = torch.zeros(len(noise), config.handles, 3, device=device)

    def predict(x: Tensor, step: int) -> Tensor:
        x0, adaptation = torch.zeros_like(x), torch.zeros_like(last)
        for group in groups:
            if group.led and step >= LED_UNTIL and step != visited[-1]:
                continue  # whatever the network says, the guide overwrites it
            with torch.autocast(device.type, torch.bfloat16, enabled=bf16):
                values, offsets = group.predict(model, x, step, final=step == visited[-1])
            weight = group.share[group.real][:, None]
            x0.index_add_(0, group.frames[group.real], values[group.real] * weight)
            if step == visited[-1]:
                adaptation.index_add_(0, group.frames[group.real], offsets[group.real] * weight[..., None])
        x0 /= total
        if step == visited[-1]:
            last.copy_(adaptation / total[..., None])
        if steering.classifier_guidance is not None:
            x0 = steering.classifier_guidance(x0, step)
        if led is not None:
            pose = slice(ROOT.stop, None)
            x0[:, ROOT] = torch.lerp(x0[:, ROOT], led[0][:, ROOT], led[1])
            x0[:, pose] = torch.lerp(x0[:, pose], led[0][:, pose], led[1] * (step >= led[2]))
        if steering.refine is not None:
            x0 = steering.refine(x0)
        return x0 if held is None else torch.lerp(x0, *held)

    if solver.method == "dpm":
        values = dpm_solver(predict, noise, visited, solver.progress)
    elif solver.method == "ddpm":
        values = ancestral(predict, noise, visited, _generator(seed, -1), solver.progress)
    else:
        raise ValueError(f"there is no sampler '{solver.method}'; take 'dpm' or 'ddpm'")
    return Sample(values, last)


class _Group:
    """Windows that go through the denoiser together, with what does not depend on the step. All of a group are led by
    a guide in all of their frames, or none is.
    """

    def __init__(
        self,
        model: Denoiser,
        text: TextBatch,
        windows: Sequence[Window],
        mesh_features: Tensor | None,
        examples: RetrievedExamples | None,
        solver: Solver,
        led: bool,
    ):
        self.led = led
        device = model.mean.device
        count, longest = len(windows), max(len(window.frames) for window in windows)
        self.guidance, self.rescale = solver.guidance, solver.rescale
        self.twice = 1 if solver.guidance == 1 else 2
        self.lengths = torch.tensor([len(window.frames) for window in windows], device=device)
        self.real = torch.arange(longest, device=device) < self.lengths[:, None]
        self.frames = torch.zeros(count, longest, dtype=torch.long, device=device)
        self.share = torch.zeros(count, longest, device=device)
        for row, window in enumerate(windows):
            self.frames[row, : len(window.frames)], self.share[row, : len(window.frames)] = (
                window.frames.to(device),
                window.share.to(device),
            )
        rows = torch.tensor([window.row for window in windows], device=device)
        tokens, mask, pooled = (
            part[rows].repeat(self.twice, *[1] * (part.ndim - 1)) for part in (text.tokens, text.mask, text.pooled)
        )
        mesh = None if mesh_features is None else mesh_features.to(device).float()[rows].repeat(self.twice, 1)
        keep_text = torch.arange(self.twice * count, device=device) < count
        self.condition = model.condition(
            tokens, mask, pooled, mesh, keep_text, torch.full_like(keep_text, mesh is not None),
            None if examples is None else examples.rows(rows.repeat(self.twice)),
        )  # fmt: skip

    def predict(self, model: Denoiser, x: Tensor, step: int, final: bool) -> tuple[Tensor, Tensor]:
        """x0 (G, L, D) and adaptation (G, L, K, 3) of each window, from x_t on the time line (F, D)."""
        seen, patch = x[self.frames], model.config.frames_per_token
        x0, adaptation = self._run(model, seen, step, self.lengths)
        if final and patch > 1:
            # Frames of one token agree better than neighbours across two: a second grid, moved by half a token, heals
            # the seams.
            ahead = patch // 2
            moved = torch.cat([seen[:, :ahead].flip(1), seen], 1)
            other, other_adaptation = (part[:, ahead:] for part in self._run(model, moved, step, self.lengths + ahead))
            share = token_share(seen.shape[1], patch).to(x.device)[:, None]
            x0, adaptation = torch.lerp(other, x0, share), torch.lerp(other_adaptation, adaptation, share[..., None])
        return x0, adaptation

    def _run(self, model: Denoiser, x: Tensor, step: int, lengths: Tensor) -> tuple[Tensor, Tensor]:
        count, twice = len(x), self.twice if step >= GUIDED_FROM else 1
        lengths = lengths.repeat(twice)
        condition = tuple([part[: twice * count] for part in self.condition])
        seen, steps = x.repeat(twice, 1, 1), torch.full_like(lengths, step)

        def run(rows: slice) -> tuple[Tensor, Tensor]:
            return model(seen[rows], steps[rows], lengths[rows], tuple([part[rows] for part in condition]))

        if len(seen) == 1 or x.device.type != "cpu" or torch.is_autocast_enabled("cpu"):
            motion, adaptation = run(slice(None))
        else:  # in halves on every processor, whether or not they run at once, so that all give the same
            half = (len(seen) + 1) // 2
            parts = side_by_side(lambda: run(slice(half)), lambda: run(slice(half, None)))
            motion, adaptation = map(torch.cat, zip(*parts, strict=True))
        motion = motion.float()
        if twice == 2:
            real = torch.arange(x.shape[1], device=x.device) < lengths[:count, None]
            motion = guided(motion[:count], motion[count:], self.guidance, self.rescale, real)
        return motion, adaptation[:count].float()
