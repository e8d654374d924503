"""How well the part network's labels agree with what the physics of files move, beside what ships.

    python benchmarks/part_labels.py files FILES           intersection over union by area, on MMD and VRM files
    python benchmarks/part_labels.py nothing ARCHIVE       area marked on the files of apparel_nothing.txt

The first line of each file is the network alone, without joints or handles: what hangs. Then what ships: its network
vertex by vertex, and the rules on whole parts (`apparel/hanging.py`), both of which know the joints of the file's rig.
The list of files is `part_files.md`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from bunraku.apparel.mask import apparel_mask
from bunraku.files import load_character
from bunraku_lab.nn.part_inference import PARTS, find_parts

LIST = Path(__file__).with_name("apparel_nothing.txt")


def agreement(mask: np.ndarray, true: np.ndarray, areas: np.ndarray) -> float:
    """Intersection over union by area."""
    return float(areas[mask & true].sum() / max(float(areas[mask | true].sum()), 1e-12))


def shares(label: np.ndarray, areas: np.ndarray) -> str:
    """Area of each kind, in percent."""
    area = np.bincount(label, areas, len(PARTS)) / areas.sum()
    return ", ".join(f"{name} {100 * part:.0f}" for name, part in zip(PARTS, area, strict=True) if part > 0.005)


def files(paths: list[Path], checkpoint: Path | None, shipped: bool) -> None:
    """Print a row for each file."""
    from bunraku.apparel.body import UnifiedBody
    from bunraku.apparel.learned.segmentation import find_apparel
    from bunraku.pipelines.clothes import separate_apparel

    rows = []
    for path in paths:
        character = load_character(path)
        true = apparel_mask(character)
        if true is None or not true.any():
            print(f"{path.name}: no physics")
            continue
        colors = None if character.colors is None else character.colors / 255
        row = []
        for tint in (None, colors):
            found = find_parts(character.vertices, character.faces, tint, checkpoint)
            row.append(agreement(found.mask, true, character.areas))
        cloth = np.isin(found.label, [PARTS.index(name) for name in ("hair", "skirt", "cape", "sleeve", "tail")])
        row.append(agreement(cloth, true, character.areas))
        if shipped:
            body = UnifiedBody.of(character)
            alone = find_apparel(character.vertices, character.faces, body.joints).mask
            row += [
                agreement(alone, true, character.areas),
                agreement(separate_apparel(character, body.joints, body.weights, None).apparel, true, character.areas),
            ]
        rows.append(row)
        print(
            f"{path.name:28s}",
            " ".join(f"{value:.3f}" for value in row),
            f"true {100 * character.areas[true].sum() / character.areas.sum():.0f} %;",
            shares(found.label, character.areas),
            flush=True,
        )
    print(
        f"{'mean':28s}",
        " ".join(f"{value:.3f}" for value in np.mean(rows, axis=0)),
        "(hangs without colours, with colours, cloth and hair by label"
        + (", shipped alone, shipped with rules)" if shipped else ")"),
    )


def nothing(archive: Path, checkpoint: Path | None) -> None:
    """Print a row for each file on which nothing is apparel."""
    marked = []
    for line in LIST.read_text().split():
        character = load_character(archive / line)
        colors = None if character.colors is None else character.colors / 255
        found = find_parts(character.vertices, character.faces, colors, checkpoint)
        areas = character.areas
        marked.append(float(areas[found.mask].sum() / areas.sum()))
        print(f"{line:40s} hangs {100 * marked[-1]:.1f} %;", shares(found.label, areas), flush=True)
    print(f"mean {100 * np.mean(marked):.2f} %, worst {100 * max(marked):.1f} %")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("what", choices=("files", "nothing"))
    parser.add_argument("paths", type=Path, nargs="+")
    parser.add_argument("--checkpoint", type=Path)
    parser.add_argument("--no-shipped", action="store_true")
    asked = parser.parse_args()
    if asked.what == "files":
        files(asked.paths, asked.checkpoint, not asked.no_shipped)
    else:
        nothing(asked.paths[0], asked.checkpoint)


if __name__ == "__main__":
    main()
