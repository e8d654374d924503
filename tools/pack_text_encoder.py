"""Write `src/bunraku/weights/text.safetensors`: what Bunraku needs of all-MiniLM-L6-v2, with its tokenizer in the
header.

    python tools/pack_text_encoder.py FOLDER [data/motions]

Without motions the word pieces are those of the shipped file, in its order. FOLDER is a copy of
sentence-transformers/all-MiniLM-L6-v2 with `config.json`, `tokenizer.json` and `model.safetensors`. Matrices become
float16, whose high bytes stand together, since a wheel packs them better so. Word pieces that no English sentence has
(other scripts, places left free) and positions beyond 30 are left out, and so is the pooler, which sentence embeddings
do not use. The pieces of words that the captions of the training data or the lexicon have come first; all others become
int8 with a scale a piece, in `LEVELS` steps to each side.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from bunraku.core.nn.checkpoints import planes_of
from bunraku.generation.pack import load_examples
from bunraku.language.encoders import RARE, SCALES, TEXT_LENGTH
from bunraku.language.tokenizer import WordPieces

SOURCES = Path(__file__).resolve().parents[1] / "src" / "bunraku"
OUT = SOURCES / "weights" / "text.safetensors"
WORDS = "embeddings.word_embeddings.weight"
POSITIONS = "embeddings.position_embeddings.weight"
LEFT_OUT = ("pooler.", "embeddings.position_ids")
SAID = ("vocabulary", "captions", "creature_captions", "lexicon")
"""Whose words are kept exactly, beside those of the captions and of the examples."""
LEVELS = 50
"""Steps of a rare piece from zero to its largest number. 50 take 1.5 MB less of a wheel than 127;
`weights/text.md` says what that costs."""


def strings(said: object) -> Iterator[str]:
    """All texts in what a JSON file holds."""
    if isinstance(said, str):
        yield said
    elif isinstance(said, dict):
        yield from said
        yield from strings(list(said.values()))
    elif isinstance(said, list):
        for one in said:
            yield from strings(one)


def kept_pieces(tokenizer: dict, captions: list[str]) -> tuple[list[str], int]:
    """The word pieces that sentences in English may have, those first that are known to be said, and how many these
    are.
    """
    pieces, special = WordPieces(json.dumps(tokenizer)), {token["content"] for token in tokenizer["added_tokens"]}
    texts = list(captions)
    examples = load_examples()
    texts += [text for example in (examples.examples if examples else ()) for text in example.texts]
    for name in SAID:
        texts += strings(json.loads((SOURCES / "language" / f"{name}.json").read_text(encoding="utf-8")))
    said = {number for text in texts for number in pieces.numbers(text, 10**6)}
    order = sorted(tokenizer["model"]["vocab"].items(), key=lambda piece: piece[1])
    kept = [(piece, number) for piece, number in order if piece.isascii() and not piece.startswith("[unused")]
    known = [piece for piece, number in kept if number in said or piece in special]
    return known + [piece for piece, _ in kept if piece not in set(known)], len(known)


def fewer_pieces(tokenizer: dict, pieces: list[str]) -> dict:
    """The tokenizer with these pieces alone, numbered anew."""
    number = {piece: index for index, piece in enumerate(pieces)}
    special = {
        name: {**of, "ids": [number[name]]} for name, of in tokenizer["post_processor"]["special_tokens"].items()
    }
    return {
        **tokenizer,
        "truncation": None,
        "padding": None,
        "added_tokens": [{**token, "id": number[token["content"]]} for token in tokenizer["added_tokens"]],
        "post_processor": {**tokenizer["post_processor"], "special_tokens": special},
        "model": {**tokenizer["model"], "vocab": number},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("motions", type=Path, nargs="?")
    asked = parser.parse_args()
    folder = asked.folder
    tokenizer = json.loads((folder / "tokenizer.json").read_text(encoding="utf-8"))
    config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
    weights = load_file(folder / "model.safetensors")
    vocabulary = tokenizer["model"]["vocab"]
    if asked.motions is None:
        with safe_open(OUT, framework="np") as file:
            shipped = json.loads(file.metadata()["tokenizer"])["model"]["vocab"]
            pieces, known = sorted(shipped, key=shipped.__getitem__), file.get_slice(WORDS).get_shape()[1]
    else:
        clips = json.loads((asked.motions / "index.json").read_text(encoding="utf-8"))["clips"].values()
        captions = [text for clip in clips for one in (clip, *clip.get("stretches", ())) for text in one["texts"]]
        pieces, known = kept_pieces(tokenizer, captions)
    words = weights.pop(WORDS)[[vocabulary[piece] for piece in pieces]].astype(np.float32)
    weights[POSITIONS] = weights[POSITIONS][:TEXT_LENGTH]
    scales = np.abs(words[known:]).max(axis=1) / LEVELS
    tensors = {RARE: np.rint(words[known:] / scales[:, None]).astype(np.int8), SCALES: scales}
    for name, value in {WORDS: words[:known], **weights}.items():
        if not name.startswith(LEFT_OUT):
            tensors[name] = planes_of(value) if value.ndim > 1 else np.asarray(value, np.float32)
    needed = ("num_hidden_layers", "num_attention_heads", "layer_norm_eps", "hidden_size")
    metadata = {
        "format": "bunraku-1",
        "kind": "text",
        "config": json.dumps({name: config[name] for name in needed}),
        "tokenizer": json.dumps(fewer_pieces(tokenizer, pieces), ensure_ascii=False, separators=(",", ":")),
    }
    save_file(tensors, OUT, metadata)
    print(
        f"{OUT}: {OUT.stat().st_size / 1e6:.1f} MB, {len(pieces):,} of {len(vocabulary):,} word pieces, {known:,} exact"
    )


if __name__ == "__main__":
    main()
