"""Make the pictures of the wardrobe: `python tools/make_wardrobe_pictures.py [--seed S]`, in docs/pictures, at most 300
kB each.

`wardrobe-1.png` to `wardrobe-3.png` show sixty characters; `wardrobe-skirt.png` skirts that swing out, follow and
settle while their wearers turn round. Nothing but this package is needed.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from bunraku.apparel.physics.simulate import simulate
from bunraku.core.animation import RigAnimation
from bunraku.core.character import Character
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.render import contact_sheet, render_animation, render_still
from bunraku_lab.synthetic.wardrobe import wardrobe_character, wardrobe_costume

OUT = Path(__file__).parents[1] / "docs/pictures"
COUNT, SHEETS, COLUMNS, CELL = 60, 3, 10, (124, 168)
FPS = 30.0
TIMES = (0.0, 0.4, 0.7, 1.0, 1.3, 1.45, 1.6, 1.8, 2.1, 4.0)


def sheet(seed: int) -> None:
    """Sixty characters, every third one seen from behind."""
    pictures = []
    for number in range(COUNT):
        yaw = 2.6 if number % 3 == 2 else 0.4
        pictures.append(render_still(wardrobe_character(seed + number), size=CELL, yaw=yaw, background="white"))
    each = COUNT // SHEETS
    for part in range(SHEETS):
        contact_sheet(
            pictures[part * each : (part + 1) * each], None, OUT / f"wardrobe-{part + 1}.png", columns=COLUMNS
        )


def turning(character: Character, seconds: float = 4.1) -> RigAnimation:
    """A turn of 540 degrees in a second and a half, stopped at once, then standing still."""
    assert character.rig is not None
    time = np.arange(round(seconds * FPS)) / FPS
    share = np.clip(time / 1.5, 0, 1)
    angle = 3 * np.pi * np.where(share < 1, share**2 * (1.6 - 0.6 * share), 1)
    joints = len(character.rig.names)
    rotations = np.tile(np.eye(3), (len(time), joints, 1, 1))
    rotations[:, character.rig.names.index("センター")] = matrix_from_axis_angle(angle[:, None] * np.array([0, 1.0, 0]))
    return RigAnimation(character, rotations, np.zeros((len(time), joints, 3)), FPS)


def skirts(seed: int, count: int = 2) -> None:
    """Frames of skirts in the turn."""
    pictures, labels = [], []
    chosen = [
        number
        for number in range(seed, seed + 60)
        if wardrobe_costume(number).words[1] in ("pleated skirt", "layered skirt", "long skirt")
    ]
    for number in chosen[:count]:
        character = wardrobe_character(number)
        moved = simulate(turning(character)).animation
        pictures += list(
            render_animation(moved.animation(), size=(130, 180), times=np.array(TIMES), background="white")
        )
        labels += [f"{time:.2f} s" for time in TIMES]
    contact_sheet(
        pictures,
        labels,
        OUT / "wardrobe-skirt.png",
        columns=len(TIMES),
        title="One and a half turns in 1.5 s, then a stop",
    )


def main() -> None:
    """Make both pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0, help="seed of the first character")
    parser.add_argument("--only", choices=("sheet", "skirts"), help="make one of the two")
    options = parser.parse_args()
    if options.only != "skirts":
        sheet(options.seed)
    if options.only != "sheet":
        skirts(options.seed)


if __name__ == "__main__":
    main()
