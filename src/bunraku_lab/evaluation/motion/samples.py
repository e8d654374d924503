"""Motions made for a table, kept in a folder as they are made, so that a killed evaluation goes on where it stopped.

The folder's name is a digest of all that decides the motions: the weights, the sampler's settings, and the sentences
with their lengths. Motions of one length are made in one batch, each batch from a seed of its own.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bunraku.diffusion.features import FEATURE_SIZE, FeatureStatistics, encode
from bunraku.errors import OptionError
from bunraku.formats.files import atomic_write, weights_file

if TYPE_CHECKING:
    from bunraku.diffusion.inference.denoiser import Denoiser
    from bunraku.language.encoders import TextEncoder

__all__ = ["Request", "SamplerSettings", "checkpoint_digest", "choose_motions", "make_motions"]

BATCH = 32
CHOOSING = ("ranker", "critic", "examples")
"""Weights that choosing takes beside the denoiser's."""


@dataclass(frozen=True)
class Request:
    """A motion to be made.

    Args:
        sentence: What it shows.
        frames: Its length N.
    """

    sentence: str
    frames: int


@dataclass(frozen=True)
class SamplerSettings:
    """Settings of the sampler.

    Args:
        steps: Predictions of x0; None takes those that `animate` makes, by `choose_motions` alone.
        guidance: Scale of classifier-free guidance; None likewise.
        seed: Of the noise.
        candidates: Of how many each motion is chosen, as `animate` does; 1 for none.
        examples: Candidates start from captured examples; where there is but one, it does.
        classifier_guidance: What is predicted is guided towards its sentence; by `choose_motions` alone.
    """

    steps: int | None
    guidance: float | None
    seed: int = 0
    candidates: int = 1
    examples: bool = False
    classifier_guidance: bool = False


def checkpoint_digest(path: Path) -> str:
    """What tells one file of weights from another: the SHA-256 of its bytes, hexadecimal.

    Raises:
        OptionError: The file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise OptionError(f"{path}: these weights cannot be read ({error.strerror}); give another file") from error


def make_motions(
    model: Denoiser,
    encoder: TextEncoder,
    requests: Sequence[Request],
    sampling: SamplerSettings,
    *,
    folder: Path | None = None,
    digest: str = "",
    mesh_feature: np.ndarray | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[np.ndarray]:
    """Motions in the order of the requests, features in the data's units, each of shape (N, 271), float32.

    Args:
        model: The denoiser, of either kind.
        encoder: Its text encoder.
        requests: What to make; no longer than the model's longest motion.
        sampling: How.
        folder: Where batches are kept; None keeps nothing.
        digest: Of the weights (`checkpoint_digest`).
        mesh_feature: f_phi of the character, shape (448,), whose motions have the adaptation of the local translations
            added; None makes motions for no mesh in particular.
        progress: Called with (motions done, total).

    Raises:
        OptionError: A motion is longer than the model makes at once.
    """
    from bunraku.diffusion.sampling.sampler import Solver, sample
    from bunraku.nn.threads import one_thread

    if sampling.steps is None or sampling.guidance is None:
        raise ValueError("what the network says alone needs a number of steps and a guidance")
    solver = Solver(sampling.steps, sampling.guidance)
    longest = max((request.frames for request in requests), default=0)
    if longest > model.config.frames:
        raise OptionError(
            f"a motion of {longest} frames is longer than the {model.config.frames} that these weights make at once"
        )
    adapt = mesh_feature is not None
    home = None if folder is None else folder / _key(digest, requests, sampling, mesh_feature, adapt)
    statistics = FeatureStatistics(model.mean, model.std)
    mesh = None if mesh_feature is None or not model.knows_meshes else np.asarray(mesh_feature, np.float32)[None]

    def drawn(rows: list[int], number: int) -> np.ndarray:
        with one_thread():
            found = sample(
                model, encoder.encode([requests[row].sentence for row in rows]), requests[rows[0]].frames,
                solver,
                mesh_features=None if mesh is None else mesh.repeat(len(rows), axis=0),
                seed=sampling.seed + 104_729 * (number + 1),
            )  # fmt: skip
        values = statistics.restore(found.values).astype(np.float32)
        if adapt:
            local = found.adaptation[:, :, 1:]
            values[..., 10:].reshape(*values.shape[:2], -1, 9)[..., :3] += local
        return np.asarray(values)

    return _kept(requests, home, drawn, progress)


def choose_motions(
    requests: Sequence[Request],
    sampling: SamplerSettings,
    checkpoint: Path,
    *,
    folder: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[np.ndarray]:
    """Motions as `bunraku animate` makes and chooses them, before they are fitted to a character; otherwise as
    `make_motions`.

    Args:
        requests: What to make.
        sampling: How, and of how many candidates.
        checkpoint: Weights of the denoiser.
        folder: Where batches are kept; None keeps nothing.
        progress: Called with (motions done, total).
    """
    from bunraku.diffusion.generation.generate import generate_motions
    from bunraku.diffusion.generation.networks import Networks
    from bunraku.language.parse import clauses_of

    few = [Networks(checkpoint).few_steps_file] if sampling.steps is None and sampling.guidance is None else []
    digest = " ".join(checkpoint_digest(path) for path in (checkpoint, *few) if path.is_file())
    home = None if folder is None else folder / _key(digest, requests, sampling, None, True)

    def drawn(rows: list[int], number: int) -> np.ndarray:
        motions = generate_motions(
            [clauses_of([(requests[row].sentence, requests[row].frames / 20)]) for row in rows],
            seeds=[sampling.seed + 104_729 * (number + 1) + index for index in range(len(rows))],
            steps=sampling.steps, guidance=sampling.guidance, checkpoint=checkpoint,
            candidates=sampling.candidates, examples=sampling.examples,
            classifier_guidance=sampling.classifier_guidance,
            all_led=sampling.examples and sampling.candidates == 1,
        )  # fmt: skip
        return np.stack([encode(motion) for motion in motions])

    return _kept(requests, home, drawn, progress)


def _kept(
    requests: Sequence[Request],
    home: Path | None,
    make: Callable[[list[int], int], np.ndarray],
    progress: Callable[[int, int], None] | None,
) -> list[np.ndarray]:
    """Motions in the order of the requests, made in batches, each read from its folder where it is there already.

    Args:
        requests: What to make.
        home: Folder of these very requests, weights and settings; None keeps nothing.
        make: Makes the rows of batch `number`, shape (B, N, 271).
        progress: Called with (motions done, total).
    """
    if home is not None:
        home.mkdir(parents=True, exist_ok=True)
    out: list[np.ndarray] = [np.zeros((0, FEATURE_SIZE), np.float32)] * len(requests)
    done = 0
    for number, rows in enumerate(_batches(requests)):
        path = None if home is None else home / f"{number:04d}.npz"
        values = None if path is None else _stored(path, (len(rows), requests[rows[0]].frames, FEATURE_SIZE))
        if values is None:
            values = make(rows, number)
            if path is not None:
                with atomic_write(path) as file:
                    np.savez(file, features=values.astype(np.float16))
                values = values.astype(np.float16)  # a run that goes on must see the same numbers
        for row, motion in zip(rows, values, strict=True):
            out[row] = motion.astype(np.float32)
        done += len(rows)
        if progress is not None:
            progress(done, len(requests))
    return out


def _batches(requests: Sequence[Request]) -> list[list[int]]:
    """Rows of each batch: of one length, in the order of the requests."""
    by_length: dict[int, list[int]] = {}
    for row, request in enumerate(requests):
        by_length.setdefault(request.frames, []).append(row)
    return [
        rows[start : start + BATCH] for _, rows in sorted(by_length.items()) for start in range(0, len(rows), BATCH)
    ]


def _key(
    digest: str,
    requests: Sequence[Request],
    sampling: SamplerSettings,
    mesh: np.ndarray | None,
    adapt: bool,
) -> str:
    wanted = [[request.sentence, request.frames] for request in requests]
    how = [sampling.steps, sampling.guidance, sampling.seed, adapt, BATCH]
    if sampling.candidates > 1 or sampling.examples or sampling.classifier_guidance:
        files = [path for name in CHOOSING if (path := weights_file(f"{name}.safetensors")).is_file()]
        how += [sampling.candidates, sampling.examples, sampling.classifier_guidance, *map(checkpoint_digest, files)]
    say = [digest, wanted, how, None if mesh is None else np.asarray(mesh, float).round(4).tolist()]
    return hashlib.sha256(json.dumps(say).encode()).hexdigest()[:20]


def _stored(path: Path, shape: tuple[int, int, int]) -> np.ndarray | None:
    """A batch from an earlier run; None where there is none, or a broken one."""
    try:
        with np.load(path, allow_pickle=False) as file:
            values = np.asarray(file["features"])
    except Exception:  # a cache is made again, whatever is wrong with it
        return None
    return values if values.shape == shape and bool(np.isfinite(values).all()) else None
