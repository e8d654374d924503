"""Chains of the wardrobe that are found by its bones alone.

    python benchmarks/apparel_bones.py [--first SEED] [--count N]

Each character keeps its rig and loses its physics. Names are taken from the bones of its apparel, and then from all. A
chain is found when all its bones that hold something are; what is found of other bones is printed as the share of the
skin that they hold.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from bunraku.apparel.chains.from_bones import apparel_bones
from bunraku.apparel.mask import moved_joints
from bunraku.core.character import Character
from bunraku_lab.synthetic.wardrobe import wardrobe_character


def true_chains(character: Character, moved: np.ndarray, mass: np.ndarray) -> list[set[int]]:
    """The bones of each chain that physics move, those that hold something."""
    rig = character.rig
    assert rig is not None
    out: dict[int, set[int]] = {}
    for bone in np.flatnonzero(moved & (mass > 1)):
        top = int(bone)
        while rig.parents[top] >= 0 and moved[rig.parents[top]]:
            top = int(rig.parents[top])
        out.setdefault(top, set()).add(int(bone))
    return list(out.values())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--first", type=int, default=9000)
    parser.add_argument("--count", type=int, default=40)
    asked = parser.parse_args()
    totals = {"apparel": [0, 0, 0.0], "all bones": [0, 0, 0.0]}
    for seed in range(asked.first, asked.first + asked.count):
        character = wardrobe_character(seed)
        rig, moved = character.rig, moved_joints(character)
        assert rig is not None
        mass = np.bincount(rig.indices.ravel(), rig.weights.ravel(), minlength=len(rig.names))
        chains = true_chains(character, moved, mass)
        order = np.random.default_rng(seed).permutation(len(rig.names))
        for which, total in totals.items():
            names = [f"Bone.{order[bone]:03d}" if moved[bone] or which == "all bones" else name
                     for bone, name in enumerate(rig.names)]  # fmt: skip
            found = set(apparel_bones(replace(character, avatar=None, rig=replace(rig, names=tuple(names)))))
            total[0] += len(chains)
            total[1] += sum(chain <= found for chain in chains)
            total[2] += sum(mass[bone] for bone in found if not moved[bone]) / mass.sum() / asked.count
    for which, (count, found, wrong) in totals.items():
        print(f"names of {which} scrambled: {found} of {count} chains ({found / count:.1%}), other skin {wrong:.2%}")


if __name__ == "__main__":
    main()
