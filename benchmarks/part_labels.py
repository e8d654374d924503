"""How well the part network's labels agree with what the physics of files move, beside what ships.

    python benchmarks/part_labels.py files FILES           intersection over union by area, on MMD and VRM files
    python benchmarks/part_labels.py nothing ARCHIVE       area marked on the files of apparel_nothing.txt

The first number of each file is the network alone, without joints or handles: what hangs. Then what ships: its network
vertex by vertex, and with the rules on whole parts (`apparel/hanging.py`), by handles that are predicted for the bare
mesh, and by the joints of the file's rig. The list of files is `part_files.md`.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from bunraku.apparel.mask import apparel_mask
from bunraku.core.character import Character
from bunraku.files import load_character
from bunraku_lab.nn.part_inference import PARTS, FoundParts, find_parts

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
    from bunraku.apparel.body import UnifiedBody
    from bunraku.apparel.learned.segmentation import find_apparel
    from bunraku.pipelines.animate import rig
    from bunraku.pipelines.clothes import body_of_handles, separate_apparel

    rows = []
    for path in paths:
        character = load_character(path)
        true = apparel_mask(character)
        if true is None or not true.any():
            print(f"{path.name}: no physics")
            continue
        bare, file_body = replace(character, rig=None, avatar=None), UnifiedBody.of(character)
        found = parts_of(character, checkpoint)
        masks = [found.mask]
        for weights, joints in (body_of_handles(bare, rig(bare)), (file_body.weights, file_body.joints)):
            masks.append(find_apparel(bare.vertices, bare.faces, joints).mask)
            masks.append(separate_apparel(bare, joints, weights, None).apparel)
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
        "(part network; by predicted handles: shipped alone, with rules; by the file's joints: alone, with rules)",
    )


def parts_of(character: Character, checkpoint: Path | None) -> FoundParts:
    """What the part network says of a character with the colours that it has."""
    colors = None if character.colors is None else character.colors / 255
    return find_parts(character.vertices, character.faces, colors, checkpoint)


def nothing(archive: Path, checkpoint: Path | None) -> None:
    """Print a row for each file on which nothing is apparel."""
    marked = []
    for line in LIST.read_text().split():
        character = load_character(archive / line)
        found, areas = parts_of(character, checkpoint), character.areas
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
