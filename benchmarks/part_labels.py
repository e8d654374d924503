"""How well the part network's labels agree with what the physics of files move, beside what ships.

    python benchmarks/part_labels.py files FILES           intersection over union by area, on MMD and VRM files
    python benchmarks/part_labels.py nothing ARCHIVE       area marked on the files of apparel_nothing.txt

The first number of each file is the network alone, vertex by vertex: what hangs. The second is what swings: whole parts
of kinds that hang (`apparel.parts`). The list of files is `part_files.md`.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from bunraku.apparel.mask import apparel_mask
from bunraku.apparel.part_network import PARTS
from bunraku.apparel.parts import FoundParts, find_parts, parts_of
from bunraku.core.character import Character
from bunraku.files import load_character

LIST = Path(__file__).with_name("apparel_nothing.txt")


def agreement(mask: np.ndarray, true: np.ndarray, areas: np.ndarray) -> float:
    """Intersection over union by area."""
    return float(areas[mask & true].sum() / max(float(areas[mask | true].sum()), 1e-12))


def shares(label: np.ndarray, areas: np.ndarray) -> str:
    """Area of each kind, in percent."""
    area = np.bincount(label, areas, len(PARTS)) / areas.sum()
    return ", ".join(f"{name} {100 * part:.0f}" for name, part in zip(PARTS, area, strict=True) if part > 0.005)


def files(paths: list[Path], checkpoint: Path | None) -> None:
    """Print a row for each file."""
    rows = []
    for path in paths:
        character = load_character(path)
        true = apparel_mask(character)
        if true is None or not true.any():
            print(f"{path.name}: no physics")
            continue
        found = parts_of_network(character, checkpoint)
        masks = [found.mask, parts_of(replace(character, rig=None, avatar=None, source=None)).hangs]
        rows.append([agreement(mask, true, character.areas) for mask in masks])
        print(
            f"{path.name:28s}",
            " ".join(f"{value:.3f}" for value in rows[-1]),
            f"true {100 * character.areas[true].sum() / character.areas.sum():.0f} %;",
            shares(found.label, character.areas),
            flush=True,
        )
    print(
        f"{'mean':28s}",
        " ".join(f"{value:.3f}" for value in np.mean(rows, axis=0)),
        "(part network; what swings)",
    )


def parts_of_network(character: Character, checkpoint: Path | None) -> FoundParts:
    """What the part network says of a character with the colours that it has."""
    colors = None if character.colors is None else character.colors / 255
    return find_parts(character.vertices, character.faces, colors, checkpoint)


def nothing(archive: Path, checkpoint: Path | None) -> None:
    """Print a row for each file on which nothing is apparel."""
    marked = []
    for line in LIST.read_text().split():
        character = load_character(archive / line)
        found, areas = parts_of_network(character, checkpoint), character.areas
        marked.append(float(areas[found.mask].sum() / areas.sum()))
        print(f"{line:40s} hangs {100 * marked[-1]:.1f} %;", shares(found.label, areas), flush=True)
    print(f"mean {100 * np.mean(marked):.2f} %, worst {100 * max(marked):.1f} %")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("what", choices=("files", "nothing"))
    parser.add_argument("paths", type=Path, nargs="+")
    parser.add_argument("--checkpoint", type=Path)
    asked = parser.parse_args()
    if asked.what == "files":
        files(asked.paths, asked.checkpoint)
    else:
        nothing(asked.paths[0], asked.checkpoint)


if __name__ == "__main__":
    main()
