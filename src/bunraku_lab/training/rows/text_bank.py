"""All sentences of a training run encoded once and kept in a file of the run folder."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import torch

from bunraku.errors import WeightsError
from bunraku.language import encoders
from bunraku.language.encoders import TextEncoder
from bunraku_lab.nn.checkpoints import load_checkpoint, save_checkpoint
from bunraku_lab.nn.text import TextBatch, tensors_of
from bunraku_lab.training.runs.ahead import forking

__all__ = ["TextBank"]


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
        self,
        encoder: TextEncoder,
        sentences: Sequence[str],
        cache: str | Path | None = None,
        progress: Callable[[int, int], None] | None = None,
        workers: int = 0,
    ):
        self._encoder = encoder
        sentences = sorted(set(sentences))
        self._rows = {sentence: row for row, sentence in enumerate(sentences)}
        digest = hashlib.sha256("\n".join([encoder.name, *sentences]).encode()).hexdigest()
        if cache is not None and Path(cache).is_file():
            try:
                state, config = load_checkpoint(cache, "text-bank")
                if config.get("digest") == digest:
                    self._tokens, self._offsets, self._pooled = (
                        state["tokens"].half(),
                        state["offsets"],
                        state["pooled"],
                    )
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
        self._offsets = torch.cat(
            [
                torch.zeros(1, dtype=torch.long),
                torch.cat(lengths).cumsum(0) if lengths else torch.zeros(0, dtype=torch.long),
            ]
        )
        # As the file gives it back: a run that goes on must learn from the same numbers.
        self._pooled = torch.cat(pooled).half().float() if pooled else torch.zeros(0, encoder.pooled_size)
        if cache is not None:
            state = {"tokens": self._tokens, "offsets": self._offsets, "pooled": self._pooled}
            save_checkpoint(cache, state, {"digest": digest}, "text-bank", half=True)

    def __len__(self) -> int:
        return len(self._rows)

    def __call__(self, sentences: Sequence[str]) -> TextBatch:
        """The sentences, encoded, padded to the longest of them."""
        # One by one: beside others, which a run that goes on may have encoded before, sums are rounded otherwise.
        fresh = {
            own: tensors_of(self._encoder.encode([own])) for own in dict.fromkeys(sentences) if own not in self._rows
        }
        rows = []
        for sentence in sentences:
            row = self._rows.get(sentence)
            if row is not None:
                rows.append((self._tokens[self._offsets[row] : self._offsets[row + 1]].float(), self._pooled[row]))
            else:
                own = fresh[sentence]
                rows.append((own.tokens[0][own.mask[0]], own.pooled[0]))
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
