"""How much scale, place, order and seams of a mesh change its animation: the largest move of a vertex over the height.

    python benchmarks/invariance.py CHARACTERS [--every 9]

Each character is animated as it is, 100 times smaller and larger, moved by a few heights, with its vertices and faces
in another order, and with every seam open (a triangle soup).
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np

import bunraku
from bunraku.core.character import Character

PROMPT = "a person walks forward"


def variants(character: Character) -> dict[str, tuple[Character, float, np.ndarray, np.ndarray]]:
    """Changed characters with the scale, the shift and the vertex order that take the result back."""
    rng = np.random.default_rng(0)
    count, height = len(character.vertices), np.float32(character.height)
    plain = {"rig": None, "colors": None, "source": None}
    same, none = np.arange(count), np.zeros(3, np.float32)
    found = {}
    for scale in (0.01, 100.0):
        found[f"scale {scale:g}"] = (
            dataclasses.replace(character, vertices=character.vertices * np.float32(scale), **plain),
            scale,
            none,
            same,
        )
    shift = height * np.array([3, 2, -4], np.float32)
    found["moved"] = (dataclasses.replace(character, vertices=character.vertices + shift, **plain), 1.0, shift, same)
    order, faces = rng.permutation(count), rng.permutation(len(character.faces))
    index = np.argsort(order)
    mixed = dataclasses.replace(
        character, vertices=character.vertices[order], faces=index[character.faces[faces]], **plain
    )
    found["re-ordered"] = (mixed, 1.0, none, index)
    soup = dataclasses.replace(
        character,
        vertices=character.vertices[character.faces].reshape(-1, 3),
        faces=np.arange(3 * len(character.faces)).reshape(-1, 3),
        **plain,
    )
    found["seams open"] = (soup, 1.0, none, np.arange(3 * len(character.faces)))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("characters", type=Path)
    parser.add_argument("--every", type=int, default=9, help="take every n-th file")
    args = parser.parse_args()
    worst: dict[str, list[float]] = {}
    for file in sorted(args.characters.rglob("*.glb"))[:: args.every]:
        character = bunraku.load_character(file)
        used = np.unique(character.faces)  # vertices without a surface have no place in a soup
        want = bunraku.animate(character, PROMPT, seconds=2.0).vertices()
        row = []
        for name, (changed, scale, shift, position) in variants(character).items():
            got = (bunraku.animate(changed, PROMPT, seconds=2.0).vertices() - shift) / scale
            if name == "seams open":
                difference = got - want[:, character.faces.ravel()]
            else:
                difference = (got[:, position] - want)[:, used]
            value = float(np.linalg.norm(difference, axis=-1).max()) / character.height
            worst.setdefault(name, []).append(value)
            row.append(f"{name} {value:.1e}")
        print(f"{file.stem}: " + ", ".join(row), flush=True)
    for name, values in worst.items():
        print(
            f"{name}: worst {max(values):.2%}, median {np.median(values):.1e} of the height over {len(values)} "
            "characters"
        )


if __name__ == "__main__":
    main()
