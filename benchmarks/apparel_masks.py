"""How well the mask that is found agrees with what the physics of files move.

    python benchmarks/apparel_masks.py FILES

For each file of MMD or VRM, on its own rig: the intersection over the union of what its physics move with what the
network finds vertex by vertex; with what is made of that by whole parts (`apparel/parts.py`); and with what chains
move of that, which are held where the body holds them: more than half of a vertex goes with links.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from bunraku.apparel.body import UnifiedBody
from bunraku.apparel.chains.from_shape import shape_chains
from bunraku.apparel.mask import apparel_mask
from bunraku.apparel.parts import find_parts
from bunraku.files import load_character
from bunraku.pipelines.clothes import separate_apparel


def agreement(mask: np.ndarray, true: np.ndarray) -> float:
    """Intersection over union."""
    return float((mask & true).sum() / max((mask | true).sum(), 1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("files", type=Path, nargs="+")
    rows = []
    for path in parser.parse_args().files:
        character = load_character(path)
        true = apparel_mask(character)
        if true is None:
            print(f"{path.name}: no physics")
            continue
        body = UnifiedBody.of(character)
        alone = find_parts(character.vertices, character.faces).mask
        clothed = separate_apparel(character, body.joints, body.weights, None)
        laid = shape_chains(clothed)
        moved = np.zeros(len(true), bool)
        moved[laid.vertices[laid.shares.sum(axis=1) > 0.5]] = True
        rows.append([agreement(mask, true) for mask in (alone, clothed.apparel, moved)])
        print(path.name, " ".join(f"{value:.3f}" for value in rows[-1]), flush=True)
    print("mean", " ".join(f"{value:.3f}" for value in np.mean(rows, axis=0)))


if __name__ == "__main__":
    main()
