"""Hair and capes of bare meshes that go with an arm or a leg which they lie on.

    python benchmarks/apparel_hair.py [--first SEED] [--count N] [FILES]

The first N characters of the wardrobe from a seed on with long hair or a cape, as bare meshes, and files of MMD. For
each: the share of its hair and capes, by its own bones, that predicted handles give to an arm by a fifth and more, and
to any limb; and the same as it is moved by `--apparel auto` and `chains`, where what is found to be apparel goes with
what carries it. A mesh fails from 2 % on.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from bunraku.apparel.fitting import carried
from bunraku.apparel.mask import moved_joints
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.character import Character
from bunraku.files import load_character
from bunraku.pipelines.animate import rig
from bunraku.pipelines.clothes import body_of_handles, separate_apparel
from bunraku.retarget.rig_parts import understood_rig
from bunraku_lab.synthetic.wardrobe import wardrobe_character

ARMS = [place for place, name in enumerate(HANDLE_NAMES) if name.endswith(("shoulder", "elbow", "wrist", "fingers"))]
LEGS = [place for place, name in enumerate(HANDLE_NAMES) if name.endswith(("hip", "knee", "ankle", "foot"))]
HOLDERS = [HANDLE_NAMES.index(name) for name in ("neck", "head", "head_top", "face", "spine2", "spine3")]
LONG = 0.25  # of the height: how far down hair or a cape goes
SHARE, FAILS = 0.2, 0.02


def hanging(character: Character) -> np.ndarray:
    """Vertices of hair and capes: what physics move below the head and the chest, shape (V,), bool."""
    parts = understood_rig(character)
    rig_ = character.rig
    if parts is None or rig_ is None:
        return np.zeros(len(character.vertices), bool)
    moved = moved_joints(character)
    hung = np.zeros(len(moved), bool)
    for bone in np.flatnonzero(moved):
        above = int(bone)
        while above >= 0 and moved[above]:
            above = int(rig_.parents[above])
        hung[bone] = above >= 0 and int(parts.parts[above]) in HOLDERS
    return (rig_.weights * hung[rig_.indices]).sum(axis=1) > 0.5


def subjects(asked: argparse.Namespace) -> Iterator[tuple[str, Character, np.ndarray]]:
    for path in asked.files:
        character = load_character(path)
        yield path.name, character, hanging(character)
    seed, count = asked.first, 0
    while count < asked.count:
        character = wardrobe_character(seed)
        hair = hanging(character)
        if hair.any() and np.ptp(character.vertices[hair, 1]) > LONG * character.height:
            yield f"wardrobe {seed}", character, hair
            count += 1
        seed += 1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("files", type=Path, nargs="*")
    parser.add_argument("--first", type=int, default=820_000)
    parser.add_argument("--count", type=int, default=12)
    shares = []
    for name, character, hair in subjects(parser.parse_args()):
        if not hair.any():
            print(f"{name}: no hair that physics move")
            continue
        handles = rig(replace(character, rig=None, avatar=None, source=None))
        weights = np.array(handles.weights, np.float64)
        share, joint = carried(separate_apparel(character, *body_of_handles(character, handles)[::-1], None))
        moved = weights * (1 - share[:, None]) + np.eye(weights.shape[1])[joint] * share[:, None]
        shares.append([
            float((row[hair][:, limb].sum(axis=1) > SHARE).mean()) for row in (weights, moved)
            for limb in (ARMS, ARMS + LEGS)
        ])  # fmt: skip
        arm, limb, own_arm, own_limb = shares[-1]
        print(f"{name}: arms {arm:.1%}, limbs {limb:.1%} of {hair.sum()} vertices; with apparel {own_arm:.1%}, "
              f"{own_limb:.1%}", flush=True)  # fmt: skip
    names = ("an arm", "a limb", "an arm with apparel", "a limb with apparel")
    for limbs, column in zip(names, np.array(shares).T, strict=True):
        print(f"{(column > FAILS).sum()} of {len(column)} meshes whose hair follows {limbs}, mean {column.mean():.1%}")


if __name__ == "__main__":
    main()
