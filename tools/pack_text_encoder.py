"""Write `src/bunraku/weights/text.safetensors`: what Bunraku needs of all-MiniLM-L6-v2, with its tokenizer in the
header.

    python tools/pack_text_encoder.py FOLDER

FOLDER is a copy of sentence-transformers/all-MiniLM-L6-v2 with `config.json`, `tokenizer.json` and `model.safetensors`.
Matrices become float16; word pieces that no English sentence has (other scripts, places left free) and positions beyond
30 are left out, and so is the pooler, which sentence embeddings do not use.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file

from bunraku.language.encoders import TEXT_LENGTH

OUT = Path(__file__).resolve().parents[1] / "src" / "bunraku" / "weights" / "text.safetensors"
WORDS = "embeddings.word_embeddings.weight"
POSITIONS = "embeddings.position_embeddings.weight"
LEFT_OUT = ("pooler.", "embeddings.position_ids")


def kept_pieces(vocabulary: dict[str, int]) -> list[str]:
    """The word pieces that sentences in English may have, in their order."""
    order = sorted(vocabulary, key=vocabulary.__getitem__)
    return [piece for piece in order if piece.isascii() and not piece.startswith("[unused")]


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
    folder = parser.parse_args().folder
    tokenizer = json.loads((folder / "tokenizer.json").read_text(encoding="utf-8"))
    config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
    weights = load_file(folder / "model.safetensors")
    vocabulary = tokenizer["model"]["vocab"]
    pieces = kept_pieces(vocabulary)
    weights[WORDS] = weights[WORDS][torch.tensor([vocabulary[piece] for piece in pieces])]
    weights[POSITIONS] = weights[POSITIONS][:TEXT_LENGTH]
    tensors = {
        name: (value.half() if value.ndim > 1 else value.float()).contiguous()
        for name, value in weights.items()
        if not name.startswith(LEFT_OUT)
    }
    needed = ("num_hidden_layers", "num_attention_heads", "layer_norm_eps", "hidden_size")
    metadata = {
        "format": "bunraku-1",
        "kind": "text",
        "config": json.dumps({name: config[name] for name in needed}),
        "tokenizer": json.dumps(fewer_pieces(tokenizer, pieces), ensure_ascii=False, separators=(",", ":")),
    }
    save_file(tensors, OUT, metadata)
    print(f"{OUT}: {OUT.stat().st_size / 1e6:.1f} MB, {len(pieces):,} of {len(vocabulary):,} word pieces")


if __name__ == "__main__":
    main()
