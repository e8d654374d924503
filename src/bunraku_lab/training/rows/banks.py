"""What trainings look up: kept arrays of samples, mesh features f_phi, and encoded sentences."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bunraku.core.files import atomic_write, remove_leftovers
from bunraku.core.nn.layers import through, unit
from bunraku.errors import BunrakuError, FormatError, WeightsError
from bunraku.language import encoders
from bunraku.language.encoders import CuedEncoder, MiniLMEncoder, TextEncoder
from bunraku_lab.datasets.motions.clips import read_bundle
from bunraku_lab.nn.checkpoints import load_checkpoint, save_checkpoint
from bunraku_lab.nn.text import TextBatch, tensors_of
from bunraku_lab.training.runs.run import forking

Arrays = dict[str, Any]


class BatchedEncoder:
    """MiniLM that runs sentences of one length side by side, four times as fast as alone. Beside others sums are
    rounded a little otherwise, so a bank keeps what it has encoded.

    Args:
        inner: The encoder of single sentences.
        size: Sentences side by side.
    """

    def __init__(self, inner: MiniLMEncoder, size: int = 64):
        self.inner, self.size = inner, size
        self.name, self.token_size, self.pooled_size = inner.name, inner.token_size, inner.pooled_size

    def encode(self, sentences: Sequence[str]) -> encoders.TextBatch:
        """Encode sentences; those longer than 30 tokens keep their beginning."""
        numbers = [self.inner.numbers(sentence) for sentence in sentences]
        lengths = np.array([len(row) for row in numbers])
        tokens = np.zeros((len(numbers), int(lengths.max()), self.token_size), np.float32)
        pooled = np.zeros((len(numbers), self.pooled_size), np.float32)
        for length in np.unique(lengths):
            rows = np.flatnonzero(lengths == length)
            for part in np.array_split(rows, -(-len(rows) // self.size)):
                x = through(self.inner.layers[:-1], np.stack([self.inner.embedded(numbers[row]) for row in part]))
                tokens[part, :length] = x
                pooled[part] = unit(through(self.inner.layers[-1:], x).mean(1))
        return encoders.TextBatch(tokens, np.arange(tokens.shape[1]) < lengths[:, None], pooled)


def batched(encoder: TextEncoder) -> TextEncoder:
    """An encoder that runs sentences side by side where it can."""
    if isinstance(encoder, CuedEncoder):
        return CuedEncoder(batched(encoder.inner))
    return BatchedEncoder(encoder) if isinstance(encoder, MiniLMEncoder) else encoder


def kept_arrays(
    folder: Path, makers: Mapping[str, Callable[[], Arrays]], progress: Callable[[float], None] | None = None,
) -> Iterator[tuple[str, Arrays]]:  # fmt: skip
    """The arrays of each sample by its name, from an NPZ of the folder; those that are not there yet are made, and
    samples that cannot be made are left out.

    Args:
        folder: Where they are kept.
        makers: What makes them, by name.

    Raises:
        FormatError: A file is damaged.
    """
    folder.mkdir(parents=True, exist_ok=True)
    remove_leftovers(folder)
    for done, (name, make) in enumerate(makers.items(), 1):
        path = folder / f"{name.replace('/', '__')}.npz"
        if not path.is_file():
            try:
                arrays = make()
            except BunrakuError:
                continue
            with atomic_write(path) as file:
                np.savez(file, **arrays)
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {key: file[key] for key in file.files}
        except (OSError, ValueError) as error:
            raise FormatError(path, f"these arrays cannot be read ({error}); remove the file and train again") from None
        yield name, arrays
        if progress is not None:
            progress(done / len(makers))


@dataclass(frozen=True, eq=False)
class MeshBank:
    """Mesh features to train with.

    Args:
        features: f_phi, shape (C, 448).
        rows: Rows of each character by its name; what follows a "~" in a name says which variant it is and is left out.
        humanoid: Rows of upright bodies with arms; all rows where the bank does not say.
    """

    features: Tensor
    rows: dict[str, np.ndarray]
    humanoid: np.ndarray

    def __len__(self) -> int:
        return len(self.features)

    def draw(
        self, meshes: Sequence[str | None] | None, size: int, random: np.random.Generator, cross: float = 0.0
    ) -> tuple[Tensor, np.ndarray]:
        """A feature for each row of a batch.

        Args:
            meshes: Character of each row's motion, None for any humanoid; None in place of all without creatures.
            size: Rows B.
            random: Draws them.
            cross: Share of the humanoids' rows that take any character at all.

        Returns:
            Features (B, 448), and whether they are known, shape (B,): a creature that the bank lacks has the null mesh.
        """
        chosen = self.choose(meshes, size, random, cross)
        return self.features[torch.from_numpy(np.maximum(chosen, 0))], chosen >= 0

    def choose(
        self, meshes: Sequence[str | None] | None, size: int, random: np.random.Generator, cross: float = 0.0
    ) -> np.ndarray:
        """Row of the feature that `draw` gives each row of a batch, -1 where it is not known, shape (B,)."""
        chosen = np.zeros(size, np.int64)
        for index, name in enumerate(meshes or [None] * size):
            pick, any_body = random.random(), random.random() < cross
            if name is None:
                chosen[index] = (
                    int(pick * len(self.features)) if any_body else self.humanoid[int(pick * len(self.humanoid))]
                )
                continue
            rows = self.rows.get(name.partition("~")[0])
            if rows is None:
                chosen[index] = -1
            else:
                chosen[index] = rows[int(pick * len(rows))]
        return chosen


def load_mesh_bank(path: Path, size: int) -> MeshBank:
    """The training rows of what `bunraku train handles` wrote.

    Args:
        path: NPZ with `features` (C, `size`) and perhaps `names` (C,), `split` (C,) and `humanoid` (C,); or a bundle
            that has them (see `datasets.motions.bundle`).
        size: Length of f_phi.

    Raises:
        FormatError: The file is damaged, or its features have another shape.
    """
    try:
        found = _arrays(path)
        bank = np.asarray(found["features"], np.float32)
    except FormatError:
        raise
    except Exception as error:
        raise FormatError(
            path, f"the mesh features cannot be read ({error}); write them with 'bunraku train handles'"
        ) from error
    if bank.ndim != 2 or bank.shape[1] != size or not len(bank) or not np.isfinite(bank).all():
        raise FormatError(
            path, f"the mesh features must be finite numbers of shape (characters, {size}), not {bank.shape}"
        )
    if any(value.shape[:1] != bank.shape[:1] for value in found.values()):
        raise FormatError(
            path,
            "the names, splits and features are not as many; write the features again with 'bunraku train handles'",
        )
    kept = np.flatnonzero(found["split"] == "train") if "split" in found else np.arange(len(bank))
    if not len(kept):
        raise FormatError(
            path, "no row of the mesh features is of the split 'train'; write them again with 'bunraku train handles'"
        )
    rows: dict[str, list[int]] = {}
    for row, name in enumerate(found["names"][kept] if "names" in found else []):
        rows.setdefault(str(name).partition("~")[0], []).append(row)
    upright = np.flatnonzero(found["humanoid"][kept].astype(bool)) if "humanoid" in found else np.arange(len(kept))
    return MeshBank(
        torch.from_numpy(bank[kept]),
        {name: np.array(own) for name, own in rows.items()},
        upright if len(upright) else np.arange(len(kept)),
    )


def _arrays(path: Path) -> dict[str, np.ndarray]:
    if path.suffix == ".safetensors":
        return read_bundle(path).meshes or {}
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in ("features", "names", "split", "humanoid") if name in file.files}


class TextBank:
    """Encoded sentences by text; those it does not know are encoded when asked for.

    Args:
        encoder: Encodes them.
        sentences: What to keep.
        cache: File to keep them in between runs; written again when the sentences or the encoder change.
        progress: Called with (done, total) while encoding.
        workers: Processes that encode; 0 for none beside this one.
    """

    def __init__(
        self, encoder: TextEncoder, sentences: Sequence[str], cache: str | Path | None = None,
        progress: Callable[[int, int], None] | None = None, workers: int = 0,
    ):  # fmt: skip
        self._encoder = encoder = batched(encoder)
        sentences = sorted(set(sentences))
        self._rows = {sentence: row for row, sentence in enumerate(sentences)}
        digest = hashlib.sha256("\n".join([encoder.name, *sentences]).encode()).hexdigest()
        if cache is not None and Path(cache).is_file():
            try:
                state, config = load_checkpoint(cache, "text-bank")
                if config.get("digest") == digest:
                    self._tokens, self._offsets, self._pooled = (
                        state["tokens"].half(), state["offsets"], state["pooled"],
                    )  # fmt: skip
                    return
            except WeightsError:
                pass  # a broken cache is made again
        parts = [sentences[start : start + 256] for start in range(0, len(sentences), 256)]
        tokens, lengths, pooled = [], [], []
        for done, part in enumerate(_encoded(encoder, parts, workers)):
            tokens.append(part.tokens[part.mask].half())
            lengths.append(part.mask.sum(1))
            pooled.append(part.pooled)
            if progress is not None:
                progress(min(256 * (done + 1), len(sentences)), len(sentences))
        self._tokens = torch.cat(tokens) if tokens else torch.zeros(0, encoder.token_size, dtype=torch.float16)
        self._offsets = torch.cat([
            torch.zeros(1, dtype=torch.long),
            torch.cat(lengths).cumsum(0) if lengths else torch.zeros(0, dtype=torch.long),
        ])  # fmt: skip
        # As the file gives it back: a run that goes on must learn from the same numbers.
        self._pooled = torch.cat(pooled).half().float() if pooled else torch.zeros(0, encoder.pooled_size)
        if cache is not None:
            state = {"tokens": self._tokens, "offsets": self._offsets, "pooled": self._pooled}
            save_checkpoint(cache, state, {"digest": digest}, "text-bank", half=True)

    def __len__(self) -> int:
        return len(self._rows)

    def __call__(self, sentences: Sequence[str]) -> TextBatch:
        """The sentences, encoded, padded to the longest of them."""
        fresh = [own for own in dict.fromkeys(sentences) if own not in self._rows]
        new = tensors_of(self._encoder.encode(fresh)) if fresh else None
        at = {own: number for number, own in enumerate(fresh)}
        rows = []
        for sentence in sentences:
            row = self._rows.get(sentence)
            if row is not None:
                rows.append((self._tokens[self._offsets[row] : self._offsets[row + 1]].float(), self._pooled[row]))
            else:
                assert new is not None
                rows.append((new.tokens[at[sentence]][new.mask[at[sentence]]], new.pooled[at[sentence]]))
        longest = max(len(values) for values, _ in rows)
        tokens = torch.zeros(len(rows), longest, self._encoder.token_size)
        mask = torch.zeros(len(rows), longest, dtype=torch.bool)
        for index, (values, _) in enumerate(rows):
            tokens[index, : len(values)] = values
            mask[index, : len(values)] = True
        return TextBatch(tokens, mask, torch.stack([vector for _, vector in rows]))


def _encoded(encoder: TextEncoder, parts: Sequence[Sequence[str]], workers: int) -> Iterator[TextBatch]:
    """Each part in its turn."""
    if workers < 2:
        yield from (tensors_of(encoder.encode(part)) for part in parts)
        return
    with ProcessPoolExecutor(workers, forking(), _know, (encoder,)) as pool:
        yield from map(tensors_of, pool.map(_encode, parts))


_known: list[TextEncoder] = []  # of a process that encodes


def _know(encoder: TextEncoder) -> None:
    _known[:] = [encoder]


def _encode(sentences: Sequence[str]) -> encoders.TextBatch:
    return _known[0].encode(sentences)
