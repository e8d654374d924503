"""The motions that the table compares: windows of captioned clips, and motions made and kept in a folder."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bunraku.core.files import atomic_write, weights_file
from bunraku.errors import OptionError
from bunraku.generation import sampler
from bunraku.generation.features import FEATURE_SIZE, FeatureStatistics, encode, mirror
from bunraku.language.captions import mirror_words
from bunraku_lab.description.captions import caption_group, caption_variants, normalise_label
from bunraku_lab.training.rows.clips import ClipEntry

if TYPE_CHECKING:
    from bunraku.generation.denoiser import Denoiser
    from bunraku.language.encoders import TextBatch, TextEncoder

SHORTEST = 40
"""Frames: HumanML3D leaves out clips of less than 2 s, and so do we."""
LENGTHS = (40, 50, 60, 70, 80, 100, 120, 140, 160, 180, 196)
"""Frames a window may have: few lengths, so that motions of one length can be made in one batch."""
_ENOUGH = 400  # frames after which a clip is not drawn more often for being longer


@dataclass(frozen=True)
class Window:
    """A cut of a clip with its sentence.

    Args:
        clip: Name of the clip.
        start: First frame.
        frames: Length N.
        mirrored: Whether left and right are exchanged.
        label: The clip's caption as the archive has it.
        sentence: A rewording of it, mirrored where the window is.
        meaning: The caption's group, mirrored where the window is.
    """

    clip: str
    start: int
    frames: int
    mirrored: bool
    label: str
    sentence: str
    meaning: str


def window_meaning(label: str, mirrored: bool = False) -> str:
    """The name of a caption's group; for a mirror image, that of the caption with left and right exchanged."""
    return caption_group(mirror_words(normalise_label(label)) if mirrored else label).name


def _shares(clips: Mapping[str, ClipEntry], names: list[str]) -> np.ndarray:
    """How often each clip is drawn: by the root of its length, and less where many clips mean the same."""
    meanings = [window_meaning(clips[name]["texts"][0]) for name in names]
    count = Counter(meanings)
    frames = np.array([min(len(clips[name]["features"]), _ENOUGH) for name in names], float)
    share = np.sqrt(frames) / np.sqrt([count[meaning] for meaning in meanings])
    return share / share.sum()


def draw_windows(
    clips: Mapping[str, ClipEntry], count: int, random: np.random.Generator, shortest: int = SHORTEST,
    longest: int = 196,
) -> list[Window]:  # fmt: skip
    """Windows at random places, half of them mirrored.

    A clip of at most `longest` frames gives windows of three fifths of its length or more; a longer one of three fifths
    of `longest` or more. Lengths are rounded down to one of `LENGTHS` where that is not under `shortest`.

    Args:
        clips: What `load_clips` returned.
        count: How many.
        random: Draws them.
        shortest: Clips with fewer frames are left out.
        longest: Frames of the longest window.

    Raises:
        OptionError: No clip is long enough.
    """
    names = sorted(name for name, entry in clips.items() if len(entry["features"]) >= shortest)
    if not names:
        raise OptionError(f"no clip has the {shortest} frames that a window needs")
    found = []
    for index in random.choice(len(names), size=count, p=_shares(clips, names)):
        entry = clips[names[index]]
        whole = len(entry["features"])
        most = min(whole, longest)
        frames = int(random.integers(max(shortest, int(0.6 * most)), most + 1))
        frames = max((length for length in LENGTHS if shortest <= length <= frames), default=frames)
        mirrored = bool(random.random() < 0.5)
        label = entry["texts"][int(random.integers(len(entry["texts"])))]
        variants = caption_variants(label, mirrored)
        sentence = variants[int(random.integers(len(variants)))]
        start = int(random.integers(0, whole - frames + 1))
        found.append(Window(names[index], start, frames, mirrored, label, sentence, window_meaning(label, mirrored)))
    return found


def window_features(clips: Mapping[str, ClipEntry], window: Window) -> np.ndarray:
    """The window's motion features, shape (N, 271), in the data's units."""
    features = clips[window.clip]["features"][window.start : window.start + window.frames]
    return mirror(features) if window.mirrored else features


def candidate_sentences(
    windows: list[Window], clips: Mapping[str, ClipEntry], count: int, random: np.random.Generator
) -> list[list[str]]:
    """For each window its own sentence, then `count` - 1 sentences of other windows, each of another meaning.

    No candidate means the same as any caption of the window's clip, or as another candidate.

    Args:
        windows: The pool that sentences are drawn from.
        clips: What `load_clips` returned.
        count: Candidates in all.
        random: Draws them.

    Raises:
        OptionError: The windows have too few meanings.
    """
    by_meaning: dict[str, list[str]] = {}
    for window in windows:
        by_meaning.setdefault(window.meaning, []).append(window.sentence)
    meanings = sorted(by_meaning)
    rows = []
    for window in windows:
        own = {window_meaning(text, window.mirrored) for text in clips[window.clip]["texts"]} | {window.meaning}
        others = [meaning for meaning in meanings if meaning not in own]
        if len(others) < count - 1:
            raise OptionError(
                f"the held-out clips have captions of {len(others) + 1} meanings, fewer than the {count} candidates "
                "asked for"
            )
        drawn = [others[index] for index in random.permutation(len(others))[: count - 1]]
        rows.append([
            window.sentence,
            *(by_meaning[meaning][int(random.integers(len(by_meaning[meaning])))] for meaning in drawn),
        ])  # fmt: skip
    return rows


BATCH = 32
CHOOSING = ("ranker", "critic", "examples")
"""Weights that choosing takes beside the denoiser's."""


@dataclass(frozen=True)
class Request:
    """A motion to be made."""

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


def sample(
    model: Denoiser, text: TextBatch, frames: int | Sequence[int], solver: sampler.Solver | None = None, *,
    mesh_features: np.ndarray | None = None, seed: int = 0, known: tuple[np.ndarray, np.ndarray] | None = None,
) -> sampler.Sample:  # fmt: skip
    """One motion for each sentence, of one window each, all in one batch.

    Args:
        model: The denoiser.
        text: B encoded sentences.
        frames: Length N of the motions, or of each; all are padded with zeros to the longest.
        solver: How they are denoised.
        mesh_features: f_phi of each row's character, shape (B, 448); None for no mesh in particular.
        seed: Of the starting noise.
        known: Values to keep in network units, shape (B, N, D), and how far, shape (N,) or (N, D).
    """
    rows, size = len(text.mask), model.config.features
    lengths = [frames] * rows if isinstance(frames, int) else list(frames)
    longest = max(lengths)
    windows = [
        sampler.Window(np.arange(row * longest, row * longest + length), np.ones(length, np.float32), row)
        for row, length in enumerate(lengths)
    ]
    steering = sampler.Steering()
    if known is not None:
        share = np.tile(known[1].reshape(longest, -1), (rows, 1))
        steering = sampler.Steering(known=(known[0].reshape(-1, size), share))
    noise = np.concatenate([sampler.row_noise(longest, size, seed, row) for row in range(rows)])
    found = sampler.sample_windows(
        model, text, windows, noise, solver or sampler.Solver(), steering, mesh_features=mesh_features
    )
    return sampler.Sample(*(part.reshape(rows, longest, *part.shape[1:]) for part in (found.values, found.adaptation)))


def make_motions(
    model: Denoiser, encoder: TextEncoder, requests: Sequence[Request], sampling: SamplerSettings, *,
    folder: Path | None = None, digest: str = "", mesh_feature: np.ndarray | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[np.ndarray]:  # fmt: skip
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
    from bunraku.core.nn.layers import one_thread

    if sampling.steps is None or sampling.guidance is None:
        raise ValueError("what the network says alone needs a number of steps and a guidance")
    solver = sampler.Solver(sampling.steps, sampling.guidance)
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
    requests: Sequence[Request], sampling: SamplerSettings, checkpoint: Path, *, folder: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[np.ndarray]:  # fmt: skip
    """Motions as `bunraku animate` makes and chooses them, not fitted to a character; otherwise as `make_motions`.

    Args:
        requests: What to make.
        sampling: How, and of how many candidates.
        checkpoint: Weights of the denoiser.
        folder: Where batches are kept; None keeps nothing.
        progress: Called with (motions done, total).
    """
    from bunraku.generation.generate import generate_motions
    from bunraku.generation.networks import Networks
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
    requests: Sequence[Request], home: Path | None, make: Callable[[list[int], int], np.ndarray],
    progress: Callable[[int, int], None] | None,
) -> list[np.ndarray]:  # fmt: skip
    """Motions in the order of the requests, made in batches, each read from its folder where it is there already."""
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
    digest: str, requests: Sequence[Request], sampling: SamplerSettings, mesh: np.ndarray | None, adapt: bool
) -> str:
    wanted = [[request.sentence, request.frames] for request in requests]
    how: list[object] = [sampling.steps, sampling.guidance, sampling.seed, adapt, BATCH]
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
