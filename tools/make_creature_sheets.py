"""Make the sheets of forty creatures of docs/creatures.md: `python tools/make_creature_sheets.py --characters DIR`.

The creatures are those of the archive that no training of handles saw, and others made by code of seeds that none saw.
Each is told to walk, to run, to attack and to stand still. What comes of it is drawn in
docs/pictures/creatures-sheet-1.png and on, at most 300 kB each, and how far the lowest point is off the ground is
printed as JSON, with how many clips are within 2 % of the height: of all, and of those whose bodies do not swim or hang
in the air. With `--work DIR` what is done already is kept there.
"""

from __future__ import annotations

import argparse
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import minimum_filter1d

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.pipelines.animate import rig
from bunraku.pipelines.animator import Animator
from bunraku.pipelines.requests import Request, Sampling
from bunraku.render import contact_sheet, render_animation
from bunraku_lab.evaluation.transfer.character import facing_character
from bunraku_lab.synthetic.families import EVALUATION_SEED, code_made_character

OUT = Path(__file__).parents[1] / "docs/pictures"
SENTENCES = ("walks forward", "runs", "attacks", "stands still")
SECONDS, SEED, SHOWN, SIZE = 2.5, 1, 3, (110, 96)
ON_A_SHEET = 5
LIMIT = 0.02
ARCHIVE = (
    "quaternius/animals_pack/Bull", "quaternius/animals_pack/ShibaInu", "quaternius2019/Horse",
    "quaternius/easy_enemies_pack/Rat", "quaternius2019/Dragon", "quaternius/dinosaurs_pack/Velociraptor",
    "quaternius/cyberpunk_pack/Enemy_2Legs", "quaternius/mech_pack/Stan", "quaternius/easy_enemies_pack/Spider",
    "quaternius/platformer_game_pack/Crab", "quaternius/platformer_game_pack/Bee", "quaternius/cute_fish_pack/Betta",
    "quaternius/cute_fish_pack/Puffer", "quaternius/cute_fish_pack/Tuna", "quaternius/fish_pack/Manta_ray",
    "quaternius/platformer_game_pack/Enemy", "quaternius/platformer_game_pack/Skull",
)  # fmt: skip
MADE = (
    "quadruped", "quadruped", "quadruped", "quadruped", "dragon", "dragon", "frog", "frog", "dinosaur", "dinosaur",
    "bird", "bird", "flyer", "fish", "whale", "seahorse", "insect", "insect", "spider", "bee", "crab", "snake", "blob",
)  # fmt: skip

LEAP = 0.6
"""Longest time in the air that counts as a leap [s]; animals that run leap at every stride."""
CHUNK = 64  # frames posed at once: bounds memory


def ground_heights(animation: Animation) -> np.ndarray:
    """Height of the lowest vertex over the ground in each frame, over the character's height, shape (N,).

    The ground is where the lowest point of the rest pose is. Vertices without faces do not count.
    """
    character = animation.character
    seen = character.surface
    floor = float(character.vertices[seen, 1].min())
    frames = np.arange(len(animation.motion))
    lows = [
        animation.vertices(frames[start : start + CHUNK])[:, seen, 1].min(axis=1)
        for start in range(0, len(frames), CHUNK)
    ]
    return np.asarray((np.concatenate(lows) - floor) / character.height)


def off_ground(heights: np.ndarray, fps: float) -> float:
    """How deep a body sinks at the most, or how high it hovers for longer than a leap lasts, over its height.

    Args:
        heights: Of the lowest point, as of `ground_heights`, shape (N,).
        fps: Frames a second [1/s].
    """
    window = 2 * round(0.5 * LEAP * fps) + 1
    hovers = minimum_filter1d(heights, window, mode="nearest")
    return float(max(-heights.min(), hovers.max(), 0.0))


def creature(name: str, folder: Path) -> Character:
    """A creature without its rig, facing +Z."""
    if name in ARCHIVE:
        found = facing_character(folder / f"{name}.glb", name)
    else:
        family, number = name.split()
        found = code_made_character(family, EVALUATION_SEED + int(number))
    return replace(found, rig=None, source=None, avatar=None)


def told(name: str, folder: Path, work: Path | None) -> tuple[list[np.ndarray], dict[str, float], str, bool]:
    """Pictures of all that a creature is told, how far it is off the ground in each, what it is, and whether it swims
    or hangs in the air.
    """
    kept = None if work is None else work / f"{re.sub(r'[^A-Za-z0-9]', '-', name)}.npz"
    if kept is not None and kept.is_file():
        with np.load(kept) as data:
            off = dict(zip(SENTENCES, data["off"].tolist(), strict=True))
            return list(data["pictures"]), off, str(data["words"]), bool(data["floats"])
    character = creature(name, folder)
    handles = rig(character)
    plan = Anatomy.of(character, handles).plan
    floats = plan.swims or (plan.wings and not plan.legs)
    pictures: list[np.ndarray] = []
    off = {}
    requests = [Request(one, Sampling(SECONDS, SEED), handles=handles) for one in SENTENCES]
    moved = Animator.shipped().each(character, requests)
    for sentence, animation in zip(SENTENCES, moved, strict=True):
        assert isinstance(animation, Animation)
        off[sentence] = off_ground(ground_heights(animation), animation.fps)
        times = np.linspace(0.2, 0.8, SHOWN) * animation.motion.duration
        pictures += render_animation(animation, size=SIZE, times=times)
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        np.savez(kept, pictures=np.stack(pictures), off=np.array(list(off.values())), words=plan.words, floats=floats)
    return pictures, off, plan.words, floats


def main() -> None:
    """Make all sheets, or look at the creatures that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="only creatures whose names contain one of these; no sheets are made")
    parser.add_argument("--characters", type=Path, required=True)
    parser.add_argument("--work", type=Path)
    given = parser.parse_args()
    names = [*ARCHIVE, *(f"{family} {number}" for number, family in enumerate(MADE))]
    chosen = [name for name in names if not given.names or any(part in name for part in given.names)]
    rows: dict[str, dict[str, object]] = {}
    images: list[np.ndarray] = []
    labels: list[str] = []
    for name in chosen:
        pictures, off, words, floats = told(name, given.characters, given.work)
        images += pictures
        short = name.rpartition("/")[2]
        for sentence, value in off.items():
            labels += [short, sentence, f"off ground {value:.1%}"]
        rows[name] = {"body": words, "floats": floats, **off}
        print(json.dumps({name: rows[name]}), flush=True)
    row = SHOWN * len(SENTENCES)
    if not given.names:
        for number, start in enumerate(range(0, len(images), ON_A_SHEET * row)):
            some = slice(start, start + ON_A_SHEET * row)
            contact_sheet(images[some], labels[some], OUT / f"creatures-sheet-{number + 1}.png", columns=row)
    values = np.array([[rows[name][sentence] for sentence in SENTENCES] for name in chosen], float)
    stand = values[[not rows[name]["floats"] for name in chosen]]
    for title, some in (("all", values), ("standing", stand)):
        print(json.dumps({title: some.size, "within_2_percent": int((some <= LIMIT).sum()), "most": some.max()}))


if __name__ == "__main__":
    main()
