"""Make the pictures of the docs small: each PNG below docs/ becomes a WebP of the same name, at half its bytes.

    python tools/docs_pictures.py

The other tools here write PNG; run this after them.
"""

from __future__ import annotations

from pathlib import Path

from PIL import Image

DOCS = Path(__file__).resolve().parents[1] / "docs"
QUALITY = 85
"""Of WebP; chosen by eye on sheets of characters and on the studio's page, whose small text stays sharp."""

if __name__ == "__main__":
    for path in sorted(DOCS.rglob("*.png")):
        with Image.open(path) as picture:
            picture.convert("RGB").save(path.with_suffix(".webp"), quality=QUALITY, method=6)
        print(f"{path.with_suffix('.webp')}: {path.with_suffix('.webp').stat().st_size / 1e3:.0f} kB")
        path.unlink()
