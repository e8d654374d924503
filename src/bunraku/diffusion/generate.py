"""From sentences to handle motions: what `bunraku.generate` and `bunraku.animate` call."""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.core.ground_path import GroundPath
from bunraku.core.motion import HandleMotion
from bunraku.core.travel import moved
from bunraku.diffusion.features import FEATURE_SIZE, FeatureStatistics, decode, root_velocities
from bunraku.errors import OptionError
from bunraku.language.encoders import TextEncoder, encoder_of, text_encoder
from bunraku.language.prompts import check_prompt

if TYPE_CHECKING:
    from torch import Tensor

    from bunraku.diffusion.denoiser import Denoiser
    from bunraku.diffusion.ranking import Drawn

__all__ = ["GUIDANCE", "STEPS", "Sampling", "adapt", "generate_motion", "generate_motions", "load_generator"]

STEPS = 20
GUIDANCE = 3.0
_APART = 1_000_003
"""Between the noise of a motion's candidates, so that none is that of another motion of the batch."""


@dataclass(frozen=True)
class Sampling:
    """How a motion is drawn.

    Args:
        steps: Sampling steps, 1 to 1,000; None takes 20.
        guidance: Classifier-free guidance scale, 0 to 20; None takes 3.
        mesh_feature: f_phi of the character, shape (448,); None, or weights that were trained without characters,
            generate for no mesh in particular.
        progress: Called with a stage's name and the share done.
        checkpoint: Weights in place of the shipped ones.
        candidates: How many motions are drawn for each that is given back: the one that the ranker likes best
            (`diffusion.ranking`), 1 to 16. The first has the noise that it has alone. Where none has the side, the turn
            or the direction that the sentence says, as many are drawn again, twice at the most.

    Raises:
        OptionError: A setting is outside what can be done.
    """

    steps: int | None = None
    guidance: float | None = None
    mesh_feature: object | None = None
    progress: Callable[[str, float], None] | None = None
    checkpoint: str | Path | None = None
    candidates: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.candidates <= 16:
            raise OptionError(f"a motion is the best of 1 to 16 candidates, not of {self.candidates}")
        if self.steps is not None and not 1 <= self.steps <= 1000:
            raise OptionError(f"sampling takes 1 to 1,000 steps, not {self.steps}")
        if self.guidance is not None and not (math.isfinite(self.guidance) and 0 <= self.guidance <= 20):
            raise OptionError(f"the guidance scale must be from 0 to 20, not {self.guidance:g}")

    def native(self, model: Denoiser) -> bool:
        """Whether what is drawn is a body's own motion: see `HandleMotion`."""
        return self.mesh_feature is not None and bool(model.notes.get("creatures"))

    def options(self, model: Denoiser, rows: int) -> dict[str, Any]:
        """Options of `sample_windows` for this many sentences."""
        import torch

        mesh, progress = None, self.progress
        if self.mesh_feature is not None and model.knows_meshes:
            mesh = torch.as_tensor(np.asarray(self.mesh_feature, np.float32))
            if mesh.shape != (model.config.mesh_features,) or not bool(torch.isfinite(mesh).all()):
                raise OptionError(f"the mesh feature must be {model.config.mesh_features} finite numbers")
            mesh = mesh.expand(rows, -1)
        return {
            "steps": STEPS if self.steps is None else self.steps,
            "guidance": GUIDANCE if self.guidance is None else self.guidance,
            "mesh_features": mesh,
            "progress": (lambda done, total: progress("generate", done / total)) if progress else None,
        }


def generate_motion(prompt: str, seconds: float, *, seed: int = 0, **sampling: Any) -> HandleMotion:
    """A handle motion of the reference body from a sentence (Eq. 2 of TapMo), at the model's 20 frames a second.

    Args:
        prompt: What the character does, in English, at most 1,000 characters, of which some 30 words are read.
        seconds: Length [s].
        seed: The same seed and version give the same motion.
        sampling: See `Sampling`.

    Raises:
        OptionError: The prompt or a setting is outside what can be done.
        WeightsError: The weights are missing or broken.
    """
    return generate_motions([[(prompt, seconds)]], seeds=seed, **sampling)[0]


def generate_motions(
    scripts: Sequence[Sequence[tuple[str, float]]],
    *,
    seeds: int | Sequence[int] = 0,
    loop: bool = False,
    path: GroundPath | None = None,
    **sampling: Any,
) -> list[HandleMotion]:
    """Handle motions of the reference body, all in one batch, each from one sentence or several in a row.

    Args:
        scripts: For each motion its sentences with the seconds that each lasts.
        seeds: One for each motion; a single number gives each motion noise of its own, the first as when it is alone.
        loop: Make loops: each motion's last frame is its first again, at another place where it travels.
        path: What the root follows, in metres of the reference body; each motion then starts where the path does. Who
            goes backwards in the first sentence looks back along it.
        sampling: See `Sampling`.

    Raises:
        OptionError: A prompt or a setting is outside what can be done.
        WeightsError: The weights are missing or broken.
    """
    scripts = [[(check_prompt(prompt), seconds) for prompt, seconds in script] for script in scripts]
    how = Sampling(**sampling)
    for _, seconds in (part for script in scripts for part in script):
        if not (math.isfinite(seconds) and seconds > 0):
            raise OptionError(f"a motion needs a length of more than 0 seconds, not {seconds:g}")
    if not isinstance(seeds, int) and len(seeds) != len(scripts):
        raise OptionError(f"{len(scripts)} motions need as many seeds, not {len(seeds)}")
    if not scripts:
        return []

    from bunraku.diffusion.windows import drawn_noise

    if how.progress:
        how.progress("generate", 0.0)
    model, encoder = load_generator(how.checkpoint)
    noise = drawn_noise(seeds, len(scripts))

    def draw(rows: list[int], places: list[int]) -> list[Drawn]:
        pairs = [(noise[row][0], noise[row][1] + _APART * place) for row, place in zip(rows, places, strict=True)]
        again = how if not any(place >= how.candidates for place in places) else replace(how, progress=None)
        return _draw(model, encoder, [scripts[row] for row in rows], pairs, again, loop, path)

    rows = list(range(len(scripts)))
    if how.candidates > 1:
        from bunraku.diffusion.ranking import choose

        found = choose(draw, len(scripts), how.candidates, _ranked(model, encoder))
    else:
        found = draw(rows, [0] * len(rows))
    native = how.native(model)
    motions = []
    for one, script in zip(found, scripts, strict=True):
        made = replace(decode(one.motion, model.config.fps), native=native)
        if path is not None:
            x, z, heading = _way(path, len(made), model.config.fps, script)[0]
            made = moved(made, heading, np.array([x, 0, z]))
        motions.append(adapt(made, one.adaptation))
    return motions


def _ranked(model: Denoiser, encoder: TextEncoder) -> Callable[[Sequence[Drawn]], np.ndarray]:
    """What the ranker says of candidates, with the encoder that it was trained with."""
    from bunraku.diffusion.ranking import load_ranker, script_scores
    from bunraku.nn.threads import fitting_threads

    ranker = load_ranker()
    own = encoder_of(ranker.config.text_encoder, encoder)

    def score(drawn: Sequence[Drawn]) -> np.ndarray:
        with fitting_threads(model):
            return script_scores(ranker, own, [one.motion for one in drawn], [one.script for one in drawn])

    return score


def _draw(
    model: Denoiser,
    encoder: TextEncoder,
    scripts: Sequence[Sequence[tuple[str, float]]],
    noise: list[tuple[int, int]],
    how: Sampling,
    loop: bool,
    path: GroundPath | None,
) -> list[Drawn]:
    """One candidate for each script from its own noise, all in one batch."""
    import torch

    from bunraku.diffusion.composition import PartTrack
    from bunraku.diffusion.ranking import Drawn, script_agreement
    from bunraku.diffusion.windows import plan_windows, sample_plans
    from bunraku.language.concurrent import body_part_prompts
    from bunraku.nn.threads import fitting_threads

    lengths = [frames_of([seconds for _, seconds in script], model.config.fps) for script in scripts]
    plans = [plan_windows(parts, model.config.frames, loop=loop) for parts in lengths]
    prompts = [[body_part_prompts(prompt) for prompt, _ in script] for script in scripts]
    tracks = [track for index, some in enumerate(prompts) if (track := PartTrack.of(index, some))]
    sentences = [parts[0].sentence for some in prompts for parts in some]
    text = encoder.encode(sentences + [sentence for track in tracks for sentence in track.sentences])
    statistics = FeatureStatistics(model.mean.cpu().numpy(), model.std.cpu().numpy())
    plans += [plans[track.motion] for track in tracks]
    noise = noise + [noise[track.motion] for track in tracks]
    sizes = [plan.frames for plan in plans]

    ways = (
        [_way(path, sum(lengths[row]), model.config.fps, script) for row, script in enumerate(scripts)] if path else []
    )
    held = (
        _held_roots(ways + [ways[track.motion] for track in tracks], sizes, statistics, model.config.fps)
        if path
        else None
    )

    def refine(values: Tensor) -> Tensor:
        parts = list(values.split(sizes))
        for place, track in enumerate(tracks, len(scripts)):
            parts[place] = track.follow(parts[track.motion], parts[place])
        return torch.cat([closed(part, model) for part in parts] if loop else parts)

    with fitting_threads(model):
        found = sample_plans(
            model,
            text,
            plans,
            seeds=noise,
            refine=refine if loop or tracks else None,
            known=held,
            **how.options(model, len(text.mask)),
        )
    for track, own in zip(tracks, found[len(scripts) :], strict=True):
        found[track.motion] = replace(own, adaptation=track.adapt(found[track.motion].adaptation, own.adaptation))
    drawn = []
    for part, script, own_lengths in zip(found, scripts, lengths, strict=False):
        frames = np.arange(sum(own_lengths) + loop) % len(part.values)
        features = statistics.restore(part.values.cpu().numpy()[frames])
        timed = [(prompt, length) for (prompt, _), length in zip(script, own_lengths, strict=True)]
        said = script_agreement(features, timed) if how.candidates > 1 and path is None else None
        drawn.append(Drawn(features, part.adaptation.cpu().numpy()[frames], timed, said))
    return drawn


def _way(path: GroundPath, frames: int, fps: float, script: Sequence[tuple[str, float]]) -> np.ndarray:
    """Place (x, z) [m] and heading [rad] of a root that follows a path in each frame, shape (N, 3)."""
    back = "backward" in script[0][0].lower()
    return np.column_stack([path.places(frames, fps), path.headings(frames, fps, back)])


def _held_roots(
    ways: Sequence[np.ndarray], sizes: Sequence[int], statistics: FeatureStatistics, fps: float
) -> tuple[Tensor, Tensor]:
    """Root velocities that are known beforehand, in network units, and which features these are: both (F, D)."""
    import torch

    values, share = (np.zeros((sum(sizes), FEATURE_SIZE), np.float32) for _ in range(2))
    start = 0
    for way, size in zip(ways, sizes, strict=True):
        values[start : start + len(way), :3] = root_velocities(way, fps)
        share[start : start + len(way), :3] = 1
        start += size
    return torch.from_numpy(np.where(share > 0, statistics.normalise(values), 0).astype(np.float32)), torch.from_numpy(
        share
    )


def frames_of(seconds: Sequence[float], fps: float) -> list[int]:
    """Frames of each part, at least one, so that the parts end where the sum of their seconds says, whatever the
    rounding.
    """
    ends = [round(float(end) * fps) for end in np.cumsum(seconds)]
    out = [max(1, after - before) for before, after in zip([0, *ends], ends, strict=False)]
    return out


def closed(values: Tensor, model: Denoiser) -> Tensor:
    """Values of a loop, shape (N, D) in network units, whose root ends facing as it starts, and where it starts if it
    hardly travels.
    """
    import torch

    from bunraku.diffusion.root_path import arrive

    mean, std = model.mean[:3], model.std[:3]
    root = arrive(values[:, :3] * std + mean, model.config.fps, None, None)
    return torch.cat([(root - mean) / std, values[:, 3:]], -1)


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
    return replace(motion, translations=translations)


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
    from bunraku.diffusion.checkpoint import load_denoiser

    model = load_denoiser(path)
    name = model.config.text_encoder
    return model, text_encoder(name, os.environ.get("BUNRAKU_CLIP") if name.startswith("clip") else None)
