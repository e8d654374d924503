"""Picture files: MP4, animated WebP, GIF and PNG, contact sheets, and pictures with text below them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import numpy as np

from bunraku.core.files import check_output_folder, share_file, writing
from bunraku.errors import FormatError, MissingExtraError, OptionError

MOVING = (".mp4", ".webp", ".gif")
SUFFIXES = (*MOVING, ".png")


def check_target(path: str | Path, suffixes: tuple[str, ...] = SUFFIXES) -> Path:
    """The target's path, if its suffix is one of `suffixes` and its folder can be written.

    Raises:
        FormatError: Neither.
    """
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        raise FormatError(
            path, f"a preview cannot be written as '{path.suffix or 'no suffix'}'; name it {', '.join(suffixes)}"
        )
    check_output_folder(path)
    if not os.access(path.parent, os.W_OK):
        raise FormatError(path, "the folder cannot be written; choose another folder")
    return path


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside the target, renamed to it at the end and removed when anything goes wrong."""
    with writing(path):
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        try:
            yield Path(name)
            share_file(Path(name))
            os.replace(name, path)
        finally:
            Path(name).unlink(missing_ok=True)


def write_moving(images: Iterable[np.ndarray], path: str | Path, fps: float) -> Path:
    """Write pictures (H, W, 3), uint8, all of one size, one at a time, as a video .mp4 (H.264 in yuv420p, which
    browsers play; even sizes), or as a .webp or .gif. FormatError if the suffix is another, or the file cannot be
    written; MissingExtraError if PyAV or Pillow is not installed.
    """
    target = check_target(path, MOVING)
    with _replacing(target) as temporary:
        if target.suffix.lower() == ".mp4":
            _write_mp4(images, temporary, fps)
        else:
            _write_pillow(images, temporary, fps)
    return target


def _write_mp4(images: Iterable[np.ndarray], path: Path, fps: float) -> None:
    try:
        import av
    except ImportError as error:
        raise MissingExtraError("av", "video", "writing an MP4") from error
    rate = Fraction(fps).limit_denominator(1000)
    codec = "libx264" if "libx264" in av.codecs_available else "h264"
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        stream = None
        for image in images:
            if stream is None:
                stream = container.add_stream(codec, rate=rate)
                stream.width, stream.height, stream.pix_fmt = image.shape[1], image.shape[0], "yuv420p"
                # Nearer to the pictures than "veryfast" at 19, in half the time and half as many bytes again.
                stream.options = {"crf": "22", "preset": "superfast", "threads": "1"}
                stream.codec_context.color_range = 1  # limited, BT.601: what players assume for a picture of this size
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        if stream is not None:
            container.mux(stream.encode())


def _write_pillow(images: Iterable[np.ndarray], path: Path, fps: float) -> None:
    try:
        from PIL import Image
    except ImportError as error:
        raise MissingExtraError("pillow", "video", "writing a picture") from error
    gif = path.suffix.lower() == ".gif"
    # A GIF counts hundredths of a second.
    duration = 10 * max(round(100 / fps), 2) if gif else round(1000 / fps)

    def pictures() -> Iterator[Image.Image]:
        for image in images:
            picture = Image.fromarray(image)
            yield picture.quantize(128, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE) if gif else picture

    stream = pictures()
    first = next(stream)
    options = {"optimize": False} if gif else {"quality": 82, "method": 2}
    first.save(
        path, format="GIF" if gif else "WEBP", save_all=True, append_images=stream, duration=duration, loop=0, **options
    )


def write_png(image: np.ndarray, path: str | Path, limit: int | None = None) -> Path:
    """Write one picture (H, W, 3), uint8, as PNG. Where the file has more than `limit` bytes, colours, then size, are
    reduced until it fits. FormatError if the name does not end with .png, or the file cannot be written;
    MissingExtraError if Pillow is not installed.
    """
    try:
        from PIL import Image
    except ImportError as error:
        raise MissingExtraError("pillow", "video", "writing a picture") from error
    target = check_target(path, (".png",))
    picture = Image.fromarray(np.ascontiguousarray(image))
    with _replacing(target) as temporary:
        picture.save(temporary, optimize=True)
        small, colors = picture, 256
        while limit is not None and temporary.stat().st_size > limit:
            few = small.quantize(colors, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
            few.save(temporary, optimize=True)
            if colors > 96:
                colors //= 2
            elif min(small.size) > 64:
                small = small.resize((small.width * 4 // 5, small.height * 4 // 5), Image.Resampling.LANCZOS)
            else:
                break
    return target


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
    """Pictures of one size in a grid, (H, W, 3), uint8, row by row, each with its label below and a title above all, on
    `paper` (sRGB). Without a number of columns the sheet is about 16:10. OptionError if there are none, of several
    sizes, or another number of labels; MissingExtraError if Pillow is not installed.
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
        line = _fitted(title, draw, large, sheet.width - 4 * gap)
        draw.text((sheet.width // 2, head // 2 + 2), line, ink, large, anchor="mm")
    for i, image in enumerate(images):
        x, y = gap + i % columns * (width + gap), head + gap + i // columns * (height + strip + gap)
        sheet.paste(Image.fromarray(np.ascontiguousarray(image)), (x, y))
        if labels is not None:
            line = _fitted(labels[i], draw, font, width)
            draw.text((x + width // 2, y + height + strip // 2), line, ink, font, anchor="mm")
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
    """`assemble` pictures and write them as one PNG of at most `limit` bytes (`write_png`)."""
    return write_png(assemble(images, labels, columns=columns, title=title), path, limit)


MARGIN = 14
TEXT = 14


def page(picture: np.ndarray, title: str, lines: Sequence[str]) -> np.ndarray:
    """A picture (H, W, 3), uint8, with a title and lines below it, as wide as the picture; lines that are too long are
    wrapped. MissingExtraError if Pillow is not installed.
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
