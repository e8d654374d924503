"""Contact sheets: many pictures in a grid, with labels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bunraku.errors import MissingExtraError, OptionError
from bunraku.render.video import write_png

__all__ = ["assemble", "contact_sheet"]

LIMIT = 300_000
INK, PAPER = (58, 64, 72), (255, 255, 255)


def assemble(
    images: Sequence[np.ndarray],
    labels: Sequence[str] | None = None,
    *,
    columns: int | None = None,
    title: str | None = None,
    gap: int = 4,
    paper: tuple[int, int, int] = PAPER,
) -> np.ndarray:
    """Pictures of one size in a grid, row by row, each with its label below.

    Args:
        images: Pictures, each (H, W, 3), uint8.
        labels: One short text a picture.
        columns: Pictures in a row; None makes the sheet about 16:10.
        title: A line above all.
        gap: Pixels between the pictures.
        paper: sRGB of what lies between and below the pictures.

    Returns:
        The sheet, uint8, three channels.

    Raises:
        OptionError: No pictures, of several sizes, or another number of labels.
        MissingExtraError: Pillow is not installed.
    """
    try:
        from PIL import Image, ImageDraw, ImageFont
    except ImportError as error:
        raise MissingExtraError("pillow", "video", "a contact sheet") from error
    if not len(images) or any(image.shape != images[0].shape for image in images):
        raise OptionError("a contact sheet needs at least one picture, and all of one size")
    if labels is not None and len(labels) != len(images):
        raise OptionError(f"{len(images)} pictures need as many labels, not {len(labels)}")
    height, width = images[0].shape[:2]
    if columns is None:
        columns = round(float(np.sqrt(1.6 * len(images) * height / width)))
    columns = min(max(columns, 1), len(images))
    rows = -(-len(images) // columns)
    text = int(np.clip(width // 14, 11, 20))
    strip = text + 10 if labels is not None else 0
    head = round(2.2 * text) if title else 0
    sheet = Image.new("RGB", (columns * (width + gap) + gap, head + rows * (height + strip + gap) + gap), paper)
    draw = ImageDraw.Draw(sheet)
    ink = INK if sum(paper) > 384 else (222, 226, 230)
    font = ImageFont.load_default(text)
    if title:
        large = ImageFont.load_default(text + 3)
        draw.text(
            (sheet.width // 2, head // 2 + 2),
            _fitted(title, draw, large, sheet.width - 4 * gap),
            ink,
            large,
            anchor="mm",
        )
    for i, image in enumerate(images):
        x, y = gap + i % columns * (width + gap), head + gap + i // columns * (height + strip + gap)
        sheet.paste(Image.fromarray(np.ascontiguousarray(image)), (x, y))
        if labels is not None:
            draw.text(
                (x + width // 2, y + height + strip // 2), _fitted(labels[i], draw, font, width), ink, font, anchor="mm"
            )
    return np.asarray(sheet)


def _fitted(text: str, draw, font, width: int) -> str:  # type: ignore[no-untyped-def]
    """The text in one line, cut with an ellipsis where it is wider than `width` pixels."""
    text = " ".join(text.split())[:400]
    if draw.textlength(text, font) <= width:
        return text
    while text and draw.textlength(text + "...", font) > width:
        text = text[:-1]
    return text.rstrip() + "..."


def contact_sheet(
    images: Sequence[np.ndarray],
    labels: Sequence[str] | None,
    path: str | Path,
    *,
    columns: int | None = None,
    title: str | None = None,
    limit: int | None = LIMIT,
) -> Path:
    """Write pictures in a grid as one PNG of at most `limit` bytes (300 kB), reducing colours, then size, to fit.

    Arguments and errors are those of `assemble`; also:

    Raises:
        FormatError: The file cannot be written, or its name does not end with .png.
    """
    return write_png(assemble(images, labels, columns=columns, title=title), path, limit)
