"""Make the pictures of the sample characters in the studio: studio/public/sample-NAME.webp.

python tools/make_sample_cards.py
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

from bunraku.files import sample_character, sample_names
from bunraku.render.frames import render_still

SIZE = 192, 144
TARGET = Path(__file__).resolve().parents[1] / "studio" / "public"


def main() -> int:
    """Draw all samples."""
    TARGET.mkdir(exist_ok=True)
    for name in sample_names():
        picture = render_still(sample_character(name), size=(SIZE[0] * 2, SIZE[1] * 2))
        Image.fromarray(picture).resize(SIZE, Image.Resampling.LANCZOS).save(TARGET / f"sample-{name}.webp", quality=80)
    return 0


if __name__ == "__main__":
    sys.exit(main())
