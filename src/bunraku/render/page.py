"""A picture with lines of text below it, as one page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku.errors import MissingExtraError
from bunraku.render.sheets import INK, PAPER

__all__ = ["page"]

MARGIN = 14
TEXT = 14


def page(picture: np.ndarray, title: str, lines: Sequence[str]) -> np.ndarray:
    """A picture with a title and lines below it; lines that are too long go on in the next one.

    Args:
        picture: Shape (H, W, 3), uint8.
        title: Set larger.
        lines: One after the other.

    Returns:
        The page, as wide as the picture, uint8, three channels.

    Raises:
        MissingExtraError: Pillow is not installed.
    """
    try:
        from PIL import Image, ImageDraw, ImageFont
    except ImportError as error:
        raise MissingExtraError("pillow", "video", "a page with text") from error
    font, large = ImageFont.load_default(TEXT), ImageFont.load_default(TEXT + 5)
    height, width = picture.shape[:2]
    probe = ImageDraw.Draw(Image.new("RGB", (1, 1)))
    folded: list[str] = []
    for line in lines:
        row = ""
        for word in str(line).split():
            if row and probe.textlength(f"{row} {word}", font) > width - 2 * MARGIN:
                folded.append(row)
                row = "  "
            row = f"{row} {word}".strip() if row.strip() else row + word
        folded.append(row)
    step = TEXT + 6
    sheet = Image.new("RGB", (width, height + 2 * MARGIN + 2 * step + step * len(folded)), PAPER)
    sheet.paste(Image.fromarray(np.ascontiguousarray(picture)), (0, 0))
    draw = ImageDraw.Draw(sheet)
    draw.text((MARGIN, height + MARGIN), title, INK, large)
    for number, row in enumerate(folded):
        draw.text((MARGIN, height + MARGIN + 2 * step + number * step - step // 2), row, INK, font)
    return np.asarray(sheet)
