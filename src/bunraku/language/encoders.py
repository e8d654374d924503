"""Text encoders: a sentence as at most 30 tokens of the last layer but one, and one vector for the whole.

TapMo takes the tokens of CLIP's penultimate layer (section 3.2). No package ships CLIP's text weights, so the default
is all-MiniLM-L6-v2; `CLIPEncoder` reads the user's own CLIP folder. A checkpoint names the encoder it was trained with.
"""

from __future__ import annotations

import functools
import importlib.util
import json
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from bunraku.core.nn.checkpoints import dated, halves_of
from bunraku.core.nn.layers import Linear, Norm, PostNorm, through, unit
from bunraku.errors import MissingExtraError, WeightsError
from bunraku.language.lexicon import lexicon, said_cues
from bunraku.language.tokenizer import WordPieces, encoder_file, read_header

TEXT_LENGTH = 30


@dataclass(frozen=True)
class TextBatch:
    """Encoded sentences.

    Args:
        tokens: Penultimate-layer tokens, shape (B, L, C) with L <= 30, zero where padded.
        mask: True where a token is real, shape (B, L).
        pooled: One vector a sentence, shape (B, P): of unit length as an encoder has it, with `cues` behind it where
            they are read.
    """

    tokens: np.ndarray
    mask: np.ndarray
    pooled: np.ndarray

    def some(self, rows: Sequence[int]) -> TextBatch:
        """Some of the sentences, in the order that is given, with no more tokens than the longest of them has."""
        mask = self.mask[list(rows)]
        longest = int(mask.sum(1).max())
        return TextBatch(self.tokens[list(rows), :longest], mask[:, :longest], self.pooled[list(rows)])


class TextEncoder(Protocol):
    """What the denoiser and its training ask of a text encoder."""

    name: str
    token_size: int
    pooled_size: int

    def encode(self, sentences: Sequence[str]) -> TextBatch:
        """Encode sentences, float32."""
        ...


_Encoded = tuple[np.ndarray, np.ndarray]
"""Tokens (L, C) and pooled vector (P,) of a sentence."""


class _Cache:
    """The last sentences, so that one prompt is encoded once."""

    def __init__(self, size: int = 512):
        self.size = size
        self.rows: OrderedDict[str, _Encoded] = OrderedDict()

    def encode(self, sentences: Sequence[str], compute: Callable[[str], _Encoded]) -> TextBatch:
        new = [sentence for sentence in dict.fromkeys(sentences) if sentence not in self.rows]
        rows = dict(self.rows) if new else self.rows
        for sentence in new:  # alone, since beside others its sums are rounded otherwise
            rows[sentence] = compute(sentence)
        found = [rows[sentence] for sentence in sentences]
        for sentence in sentences:
            self.rows[sentence] = rows[sentence]
            self.rows.move_to_end(sentence)
        while len(self.rows) > self.size:
            self.rows.popitem(last=False)
        longest = max(len(tokens) for tokens, _ in found)
        tokens = np.zeros((len(found), longest, found[0][0].shape[1]), np.float32)
        mask = np.zeros((len(found), longest), bool)
        for row, (values, _) in enumerate(found):
            tokens[row, : len(values)] = values
            mask[row, : len(values)] = True
        return TextBatch(tokens, mask, np.stack([pooled for _, pooled in found]))


_WORDS = "embeddings.word_embeddings.weight"
RARE, SCALES = "embeddings.word_embeddings.rare", "embeddings.word_embeddings.scale"
"""Word pieces behind those of `_WORDS`, in steps, shape (R, 384), int8, and how large the steps are, shape (R,)."""


class MiniLMEncoder:
    """all-MiniLM-L6-v2 (Reimers & Gurevych 2019; Wang et al. 2020): six BERT layers of width 384.

    The forward pass is written out here because importing `transformers` for it takes 2.5 s, half of a whole `animate`;
    a test holds the two together.

    Its weights come with Bunraku in float16, word pieces that no caption has in steps (`weights/text.md`,
    `tools/pack_text_encoder.py`).

    Args:
        folder: Folder with the `tokenizer.json`, `config.json` and `model.safetensors` of the published model, to use
            instead.

    Raises:
        WeightsError: The files are missing or damaged.
    """

    name = "all-MiniLM-L6-v2"
    token_size = 384
    pooled_size = 384

    def __init__(self, folder: str | Path | None = None):
        from safetensors import safe_open

        path = encoder_file() if folder is None else Path(folder) / "model.safetensors"
        try:
            if folder is None:
                header = read_header(path)
                config, words = json.loads(header["config"]), header["tokenizer"]
            else:
                config = json.loads((Path(folder) / "config.json").read_text(encoding="utf-8"))
                words = (Path(folder) / "tokenizer.json").read_text(encoding="utf-8")
            self._tokenizer = WordPieces(words)
            with safe_open(path, framework="np") as file:
                read = {name: file.get_tensor(name) for name in {*file.keys()} - {_WORDS, RARE}}
            halves_of(read, [name for name, value in read.items() if value.dtype == np.uint8])
            self._weights = {
                name: value.astype(np.float32, copy=False) for name, value in read.items() if value.dtype.kind == "f"
            }
            # A third of the file, of which each sentence needs a few rows: only these become memory.
            words = safe_open(path, framework="np")
            self._words, self._rare = words.get_slice(_WORDS), words.get_slice(RARE) if folder is None else None
            self._known = self._words.get_shape()[-2]
            pieces = self._known + (len(self._weights[SCALES]) if self._rare else 0)
            self._epsilon = config["layer_norm_eps"]
            self._layers = [
                self._layer(f"encoder.layer.{index}", config["num_attention_heads"])
                for index in range(config["num_hidden_layers"])
            ]
            if config["hidden_size"] != self.token_size or pieces != len(self._tokenizer):
                raise ValueError("it is another model")
        except WeightsError:
            raise
        except Exception as error:
            raise WeightsError(f"{path}: the text encoder cannot be read ({error}); install Bunraku again") from error
        self._cache = _Cache()

    def encode(self, sentences: Sequence[str]) -> TextBatch:
        """Encode sentences; those longer than 30 tokens keep their beginning."""
        return self._cache.encode(sentences, self._compute)

    def _linear(self, name: str) -> Linear:
        return Linear(self._weights[f"{name}.weight"].T, self._weights[f"{name}.bias"])

    def _norm(self, name: str) -> Norm:
        return Norm(self._weights[f"{name}.weight"], self._weights[f"{name}.bias"], self._epsilon)

    def _layer(self, name: str, heads: int) -> PostNorm:
        query, key, value = (self._linear(f"{name}.attention.self.{part}") for part in ("query", "key", "value"))
        return PostNorm(
            query, key, value, self._linear(f"{name}.attention.output.dense"), heads,
            self._norm(f"{name}.attention.output.LayerNorm"), self._linear(f"{name}.intermediate.dense"),
            self._linear(f"{name}.output.dense"), self._norm(f"{name}.output.LayerNorm"),
        )  # fmt: skip

    def _vectors(self, numbers: Sequence[int]) -> np.ndarray:
        """The vectors of word pieces, shape (L, 384), float32."""
        if self._rare is None:
            return np.stack([np.asarray(self._words[number], np.float32) for number in numbers])
        found = np.empty((len(numbers), self.token_size), np.float32)
        known = [at for at, number in enumerate(numbers) if number < self._known]
        rows = {_WORDS: np.stack([self._words[:, numbers[at]] for at in known], 1)}
        halves_of(rows, rows)
        found[known] = rows[_WORDS]
        for at, number in enumerate(numbers):
            if number >= self._known:
                row = number - self._known
                found[at] = self._rare[row] * self._weights[SCALES][row]
        return found

    def numbers(self, sentence: str) -> list[int]:
        """The numbers of a sentence's word pieces, at most 30."""
        return self._tokenizer.numbers(sentence, TEXT_LENGTH)

    def embedded(self, numbers: Sequence[int]) -> np.ndarray:
        """What the first layer reads of word pieces, shape (L, 384), float32."""
        weights = self._weights
        x = self._vectors(numbers)
        x += weights["embeddings.position_embeddings.weight"][: len(numbers)]
        return self._norm("embeddings.LayerNorm")(x + weights["embeddings.token_type_embeddings.weight"][0])

    @property
    def layers(self) -> Sequence[PostNorm]:
        """Its six layers."""
        return self._layers

    def hidden(self, sentence: str, depth: int) -> np.ndarray:
        """Tokens of a sentence behind the first `depth` layers, shape (L, 384), float32."""
        return np.asarray(through(self._layers[:depth], self.embedded(self.numbers(sentence))[None])[0])

    def _compute(self, sentence: str) -> _Encoded:
        penultimate = self.hidden(sentence, len(self._layers) - 1)
        return penultimate, unit(self._layers[-1](penultimate[None])[0].mean(0))


class CLIPEncoder:
    """The text half of CLIP from the user's own folder, as in the paper.

    Args:
        folder: A transformers folder of CLIP, for example a download of openai/clip-vit-base-patch32. Nothing is
            fetched.

    Raises:
        WeightsError: The folder does not hold a CLIP text model.
        MissingExtraError: transformers, or the torch that it needs, is not installed.
    """

    def __init__(self, folder: str | Path):
        if importlib.util.find_spec("torch") is None:
            raise MissingExtraError("torch", "clip", "the CLIP text encoder")
        try:
            from transformers import CLIPTextModel, CLIPTokenizerFast
            from transformers.utils import logging
        except ImportError as error:
            raise MissingExtraError("transformers", "clip", "the CLIP text encoder") from error
        verbosity = logging.get_verbosity()
        logging.set_verbosity_error()
        logging.disable_progress_bar()
        try:
            self._tokenizer = CLIPTokenizerFast.from_pretrained(str(folder), local_files_only=True)
            self._model = CLIPTextModel.from_pretrained(str(folder), local_files_only=True, use_safetensors=True).eval()
        except Exception as error:
            raise WeightsError(
                f"{folder}: this folder does not hold a CLIP text model ({str(error).splitlines()[0]}); give one in "
                "safetensors"
            ) from error
        finally:
            logging.set_verbosity(verbosity)
        self.token_size = self.pooled_size = int(self._model.config.hidden_size)
        self.name = f"clip-{self.token_size}"
        self._cache = _Cache()

    def encode(self, sentences: Sequence[str]) -> TextBatch:
        """Encode sentences; those longer than 30 tokens keep their beginning."""
        return self._cache.encode(sentences, self._compute)

    def _compute(self, sentence: str) -> _Encoded:
        batch = self._tokenizer([sentence], truncation=True, max_length=TEXT_LENGTH, return_tensors="pt")
        output = self._model(**batch, output_hidden_states=True)
        tokens, pooled = (value[0].detach().numpy() for value in (output.hidden_states[-2], output.pooler_output))
        return tokens, unit(pooled)


CUES = tuple(f"{side} {place}" for place in lexicon().places["verbs"] for side in ("left", "right")) + lexicon().cues
"""What the numbers of `sentence_cues` stand for."""


def sentence_cues(sentence: str) -> np.ndarray:
    """What a sentence in English says of sides, directions, turns, counts, speeds and postures.

    The cues of a sentence with left and right exchanged are the cues with their sides exchanged.

    Returns:
        One for each of `CUES` that is said, else zero, shape (30,), float32.
    """
    said = said_cues(sentence)
    return np.array([cue in said for cue in CUES], np.float32)


class CuedEncoder:
    """Another encoder with the cues of each sentence behind its pooled vector, at the size of that vector's numbers.

    Args:
        inner: Encodes the tokens and the vector.
    """

    SUFFIX = "+cues"

    def __init__(self, inner: TextEncoder):
        self.inner = inner
        self.name = inner.name + self.SUFFIX
        self.token_size = inner.token_size
        self.pooled_size = inner.pooled_size + len(CUES)

    def encode(self, sentences: Sequence[str]) -> TextBatch:
        """Encode sentences; those longer than 30 tokens keep their beginning, and all their cues."""
        plain = self.inner.encode(sentences)
        said = np.stack([sentence_cues(sentence) for sentence in sentences])
        pooled = np.concatenate([plain.pooled, said / np.float32(self.inner.pooled_size**0.5)], axis=-1)
        return TextBatch(plain.tokens, plain.mask, pooled)


def text_encoder(name: str = MiniLMEncoder.name, folder: str | Path | None = None) -> TextEncoder:
    """The encoder of this name, as checkpoints name it; the shipped one is kept between calls as long as its file does
    not change.

    Args:
        name: "all-MiniLM-L6-v2", or "clip-SIZE" with a folder; with "+cues" behind it for `CuedEncoder`.
        folder: The encoder's files; needed for CLIP.

    Raises:
        WeightsError: The name is unknown, CLIP has no folder, or the folder holds another model.
    """
    encoder: TextEncoder
    if name.endswith(CuedEncoder.SUFFIX):
        return CuedEncoder(text_encoder(name.removesuffix(CuedEncoder.SUFFIX), folder))
    if name == MiniLMEncoder.name:
        encoder = MiniLMEncoder(folder) if folder is not None else _shipped(*dated(encoder_file()))
    elif name.startswith("clip"):
        if folder is None:
            raise WeightsError(
                f"these weights were trained with the text encoder '{name}'; name a folder with its files"
            )
        encoder = CLIPEncoder(folder)
    else:
        raise WeightsError(f"the text encoder '{name}' is unknown; use '{MiniLMEncoder.name}' or a folder with CLIP")
    if encoder.name != name and name != "clip":
        raise WeightsError(
            f"these weights were trained with the text encoder '{name}' but {folder} holds '{encoder.name}'"
        )
    return encoder


@functools.lru_cache(maxsize=1)
def _shipped(path: Path, changed: int) -> MiniLMEncoder:
    """The encoder that comes with Bunraku: shared by all readers of sentences."""
    return MiniLMEncoder()


def encoder_of(name: str, known: TextEncoder) -> TextEncoder:
    """The encoder of this name: the one that is loaded, or the one inside it, where they are that.

    Raises:
        WeightsError: As `text_encoder`.
    """
    inside = getattr(known, "inner", None)
    if known.name == name:
        return known
    return inside if inside is not None and inside.name == name else text_encoder(name)
