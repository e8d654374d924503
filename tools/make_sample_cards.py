"""Make the pictures of the sample characters in the studio: studio/public/sample-NAME.webp, each moments of a walk side
by side, on nothing.

python tools/make_sample_cards.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from bunraku import animate
from bunraku.files import sample_character, sample_names
from bunraku.render.frames import render_animation

SIZE = 144, 108
MOMENTS = 6
"""As many as `FRAMES` of studio/src/thumbs.ts."""
FIRST, CYCLE = 1.0, 1.1
"""When the walk is steady, and about how long two steps take [s]."""
FLOOR = 0.12
"""How much the floor's pattern covers at most, which is left out; chosen by eye."""
TARGET = Path(__file__).resolve().parents[1] / "studio" / "public"


def main() -> int:
    """Draw all samples."""
    TARGET.mkdir(exist_ok=True)
    times = FIRST + CYCLE * np.arange(MOMENTS) / MOMENTS
    for name in sample_names():
        walk = animate(sample_character(name), "walks forward", seconds=3, seed=0, in_place=True)
        light, dark = (
            np.concatenate(
                list(render_animation(walk, size=(SIZE[0] * 2, SIZE[1] * 2), times=times, background=paper)), axis=1
            ).astype(float)
            for paper in ("#ffffff", "#000000")
        )
        there = 1 - (light - dark).mean(axis=2, keepdims=True) / 255  # what a background shows through is not there
        colour = np.clip(dark / np.maximum(there, 1e-3), 0, 255)
        there = np.maximum(there - FLOOR, 0) / (1 - FLOOR)
        picture = np.concatenate([colour, np.clip(255 * there, 0, 255)], axis=2).round().astype(np.uint8)
        small = Image.fromarray(picture).resize((SIZE[0] * MOMENTS, SIZE[1]), Image.Resampling.LANCZOS)
        small.save(TARGET / f"sample-{name}.webp", quality=60, alpha_quality=50, method=6)
    return 0


if __name__ == "__main__":
    sys.exit(main())
