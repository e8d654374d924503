"""Writing pictures: MP4, animated WebP, GIF and PNG, each whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import numpy as np

from bunraku.errors import FormatError, MissingExtraError
from bunraku.formats.files import check_output_folder, open_to_others

__all__ = ["check_target", "write_moving", "write_png"]

MOVING = (".mp4", ".webp", ".gif")
SUFFIXES = (*MOVING, ".png")


def check_target(path: str | Path, suffixes: tuple[str, ...] = SUFFIXES) -> Path:
    """The target's path, when its suffix is one of `suffixes` and its folder can be written.

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
    """A temporary path beside the target, renamed to it at the end; removed when anything goes wrong."""
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
    except OSError as error:
        raise FormatError(path, f"cannot be written ({error.strerror or error}); choose another folder") from error
    temporary = Path(name)
    try:
        yield temporary
        open_to_others(temporary)
        os.replace(temporary, path)
    except OSError as error:
        raise FormatError(
            path, f"cannot be written ({error.strerror or error}); free some space or choose another folder"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_moving(images: Iterable[np.ndarray], path: str | Path, fps: float) -> Path:
    """Write pictures (H, W, 3), uint8, one at a time, as the video or animation that the suffix names.

    Args:
        images: The pictures, all of one size; an MP4 needs even sizes.
        path: A name that ends with .mp4 (H.264 in yuv420p, which browsers play), .webp or .gif.
        fps: Pictures a second [1/s].

    Raises:
        FormatError: The suffix is another, or the file cannot be written.
        MissingExtraError: PyAV or Pillow is not installed.
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
    """Write one picture (H, W, 3), uint8, as PNG.

    Args:
        image: The picture.
        path: A name that ends with .png.
        limit: Most bytes of the file; colours, then size, are reduced until it fits. None keeps every pixel.

    Raises:
        FormatError: The suffix is another, or the file cannot be written.
        MissingExtraError: Pillow is not installed.
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
            small.quantize(colors, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(
                temporary, optimize=True
            )
            if colors > 96:
                colors //= 2
            elif min(small.size) > 64:
                small = small.resize((small.width * 4 // 5, small.height * 4 // 5), Image.Resampling.LANCZOS)
            else:
                break
    return target
