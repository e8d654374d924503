"""What of covered legs shows in motion, with and without the stage that lays apparel over them.

`python benchmarks/apparel_layers.py --first 895 --count 30`: characters of the wardrobe as bare meshes, apparel found
and moved by the networks, three seconds of a sentence each. Those in skirts are drawn from two sides with the legs
above the hem in red: the share of red in the body, at rest and in motion, beside how edges keep their lengths (ELS) and
the jitter.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

import bunraku
from bunraku.apparel.clothed import LEGS
from bunraku.apparel.fitting import eased_border
from bunraku.apparel.layers import LEG, Layers
from bunraku.apparel.learned.player import ApparelPlayer
from bunraku.pipelines.apparel import animated_clothed, shipped_displacement
from bunraku.render import render_frames
from bunraku_lab.synthetic.wardrobe import wardrobe_character

PROMPTS = (
    "a person dances and turns around", "a person kicks with the right leg", "a person runs forward",
    "a person walks forward",
)  # fmt: skip
FEW = 300  # vertices that hang, from which on a character wears a skirt
MOMENTS = slice(5, None, 12)


def shown(frames: np.ndarray, faces: np.ndarray, legs: np.ndarray) -> float:
    """Share of the legs in what is seen of a character from the front and from behind."""
    colors = np.where(legs[:, None], [255, 0, 0], [0, 0, 255]).astype(np.uint8)
    both = np.concatenate([frames, frames * np.array([-1, 1, -1], frames.dtype)])
    pictures = np.stack(list(render_frames(both, faces, colors, size=(160, 220)))).astype(int)
    red = (pictures[..., 0] > pictures[..., 2] + 40).sum()
    return float(red / max(red + (pictures[..., 2] > pictures[..., 0] + 40).sum(), 1))


def measured(seed: int) -> dict[str, dict[str, float]] | None:
    """The figures of one character; None for one without a skirt."""
    character = replace(wardrobe_character(seed), name="a bare mesh", rig=None, source=None)
    animation = bunraku.animate(character, PROMPTS[seed % len(PROMPTS)], seconds=3.0, seed=1)
    clothed, transforms, moved = animated_clothed(animation)
    if not clothed.apparel.any():
        return None
    player = ApparelPlayer(clothed, shipped_displacement(clothed))
    chosen = player.carrier.vertices
    layers = Layers(clothed, chosen)
    if len(layers.skirt.rows) < FEW:
        return None
    skinned = moved.vertices()
    player.start(transforms[0])
    learned = np.stack([player.advance(pose) for pose in transforms])
    hem = np.quantile(clothed.rest[chosen[layers.skirt.rows], 1], 0.05) + 0.02
    height = clothed.rest[:, 1]
    legs = ~clothed.apparel & (clothed.weights[:, LEGS].sum(axis=1) > LEG) & (height > hem)
    legs &= height < clothed.joints[list(LEGS[:2]), 1].mean()
    inside = clothed.faces[np.isin(clothed.faces, chosen).all(axis=1)]
    number = np.zeros(len(clothed.rest), np.int64)
    number[chosen] = np.arange(len(chosen))
    edges = number[np.concatenate([inside[:, :2], inside[:, 1:]])]
    length = np.linalg.norm(np.diff(clothed.rest[chosen][edges], axis=1)[:, 0], axis=1) + 1e-6
    ease = eased_border(clothed)[chosen, None]
    out = {"rest": {"legs": shown(clothed.rest[None].astype(np.float32), clothed.faces, legs)}}
    rows = {"skinned": skinned[:, chosen], "learned": learned, "laid": layers.clip(learned, skinned)}
    for name, positions in rows.items():
        positions = skinned[:, chosen] + ease * (positions - skinned[:, chosen])
        whole = np.array(skinned[MOMENTS], np.float32)
        whole[:, chosen] = positions[MOMENTS]
        now = np.linalg.norm(np.diff(positions[MOMENTS][:, edges], axis=2)[:, :, 0], axis=-1)
        out[name] = {
            "legs": shown(whole, clothed.faces, legs),
            "els": float(np.clip(1 - np.abs(now / length - 1), 0, None).mean()),
            "jitter": float(np.linalg.norm(np.diff(positions, 3, axis=0), axis=-1).mean()),
        }
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=895, help="seed of the first character")
    parser.add_argument("--count", type=int, default=30, help="how many are tried")
    arguments = parser.parse_args()
    found = []
    for seed in range(arguments.first, arguments.first + arguments.count):
        figures = measured(seed)
        if figures is not None:
            found.append(figures)
            print(seed, {name: {key: round(value, 4) for key, value in row.items()} for name, row in figures.items()})
    for name in ("rest", "skinned", "learned", "laid"):
        means = {key: np.mean([one[name][key] for one in found]) for key in found[0][name]}
        print(f"{name:8}", *(f"{key} {value:.4f}" for key, value in means.items()))


if __name__ == "__main__":
    main()
