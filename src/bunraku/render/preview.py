"""Previews of animations and characters in files: pictures, videos, an interactive page, and views of orientations."""

from __future__ import annotations

import base64
import html
import math
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from bunraku.core.animation import Animation, PointAnimation
from bunraku.core.character import Character, Handles
from bunraku.core.files import atomic_write
from bunraku.core.geometry.axes import ORIENTATIONS
from bunraku.errors import FormatError, OptionError
from bunraku.render.frames import SIZE, moments, render_animation, render_still
from bunraku.render.pictures import assemble, check_target, page, write_moving, write_png
from bunraku.render.stage import YAW, Background, parse_background

if TYPE_CHECKING:
    from bunraku.core.animation import AnimatedCharacter

CELL = (240, 280)
Progress = Callable[[int, int], None]


def save_preview(
    animation: Animation | PointAnimation,
    path: str | Path,
    *,
    size: tuple[int, int] | None = None,
    fps: float | None = None,
    background: Background = "studio",
    color: Literal["texture", "handles"] = "texture",
    columns: int | None = None,
    frames: int = 8,
    title: str | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write a preview of an animation: a video (.mp4), a moving picture (.webp, .gif) or a contact sheet (.png).
    FormatError if the suffix is unknown, or the file cannot be written; OptionError if an option is outside what can be
    drawn; MissingExtraError if PyAV or Pillow is not installed.

    Args:
        animation: What to show.
        path: The file to write.
        size: Width and height of a picture in pixels; None is 640 x 480, and 240 x 280 for each picture of a sheet. MP4
            needs even numbers and gets the next lower ones.
        fps: Pictures a second [1/s]; None is the motion's own.
        background: "studio", "white", "dark", a colour such as "#dfe4e9", or three numbers 0 to 255.
        color: The character's own colours, or those of its handles.
        columns: Pictures in a row of a sheet.
        frames: Pictures of a sheet, evenly spaced from the first frame to the last.
        title: A line above the sheet.
        progress: Called with the number of pictures done and of all.
    """
    target = check_target(path)
    parse_background(background)
    progress = progress or (lambda done, total: None)
    if target.suffix.lower() == ".png":
        if not 1 <= frames <= 400 or (columns is not None and columns < 1):
            raise OptionError(f"a sheet has 1 to 400 pictures in at least one column, not {frames} in {columns}")
        last = (len(animation.motion) - 1) / animation.motion.fps
        times = np.unique(np.round(np.linspace(0, last, frames) * animation.motion.fps) / animation.motion.fps)
        pictures = render_animation(animation, size=size or CELL, times=times, background=background, color=color)
        images = list(_counted(pictures, len(times), progress))
        red, green, blue = np.round(255 * parse_background(background)[0]).astype(int).tolist()
        labels = [f"{time:.2f} s" for time in times]
        sheet = assemble(images, labels, columns=columns, title=title, gap=3, paper=(red, green, blue))
        return write_png(sheet, target)
    rate = animation.motion.fps if fps is None else fps
    if not 1 <= rate <= 240:
        raise OptionError(f"a preview has 1 to 240 pictures a second, not {rate:g}")
    width, height = size or SIZE
    if target.suffix.lower() == ".mp4":
        width, height = width // 2 * 2, height // 2 * 2
    pictures = render_animation(animation, size=(width, height), fps=rate, background=background, color=color)
    return write_moving(_counted(pictures, len(moments(animation, rate)), progress), target, rate)


def save_beside(
    animations: Sequence[Animation | PointAnimation],
    path: str | Path,
    *,
    size: tuple[int, int],
    fps: float,
    progress: Progress | None = None,
) -> Path:
    """Write a video or a moving picture (.mp4, .webp or .gif) of at least one animation side by side, in as many rows
    as columns or one less, within a width and height in pixels; those that end first stay in their last pose. Errors
    are those of `save_preview`.
    """
    columns = math.ceil(math.sqrt(len(animations)))
    rows = math.ceil(len(animations) / columns)
    cell = size[0] // columns // 2 * 2, size[1] // rows // 2 * 2
    empty = np.broadcast_to(np.round(255 * parse_background("studio")[0]).astype(np.uint8), (cell[1], cell[0], 3))
    counts = [len(moments(animation, fps)) for animation in animations]

    def pictures() -> Iterator[np.ndarray]:
        drawn = [render_animation(animation, size=cell, fps=fps) for animation in animations]
        seen = [empty] * (rows * columns)
        for _ in range(max(counts)):
            for number, each in enumerate(drawn):
                seen[number] = next(each, seen[number])
            lines = [np.concatenate(seen[row * columns : (row + 1) * columns], axis=1) for row in range(rows)]
            yield np.concatenate(lines, axis=0)

    progress = progress or (lambda done, total: None)
    return write_moving(_counted(pictures(), max(counts), progress), path, fps)


def save_still(
    character: Character,
    path: str | Path,
    handles: Handles | None = None,
    *,
    size: tuple[int, int] = (400, 480),
    views: int = 1,
    background: Background = "studio",
    lines: Sequence[str] = (),
) -> Path:
    """Write a PNG of a character in its rest pose, seen from the front, or, with `views=2`, also from the back.

    With handles each vertex has its handles' colours, blended by weight. Lines are written below the picture, under the
    character's name. Other arguments are those of `render_still`. FormatError if the file cannot be written, or its
    name does not end with .png; OptionError if an option is outside what can be drawn.
    """
    target = check_target(path, (".png",))
    if views not in (1, 2):
        raise OptionError(f"a still has one view or two, not {views}")
    turns = (YAW, YAW + np.pi)[:views]
    images = [render_still(character, handles, size=size, yaw=float(turn), background=background) for turn in turns]
    picture = np.concatenate(images, axis=1)
    return write_png(page(picture, character.name, lines) if lines else picture, target)


def _counted(pictures: Iterable[np.ndarray], total: int, progress: Progress) -> Iterator[np.ndarray]:
    for done, picture in enumerate(pictures, 1):
        yield picture
        progress(done, total)


MOST_BYTES = 64 << 20
"""Largest size of a page's model [bytes]."""


def write_html(
    animation: AnimatedCharacter,
    path: Path,
    *,
    fps: float | None = None,
    name: str | None = None,
    most: int = MOST_BYTES,
) -> Path:
    """Write an animation of any kind that a GLB can hold as a page that shows it with three.js, titled as the file or
    otherwise, at the motion's or another rate [1/s]. FormatError if the file cannot be written, or the model has more
    than `most` bytes.
    """
    title = str(name) if name else path.stem
    rate: dict[str, Any] = {} if fps is None else {"fps": fps}
    with tempfile.TemporaryDirectory() as folder:
        model = animation.save(Path(folder, "model.glb"), name=title, **rate).read_bytes()
    if len(model) > most:
        raise FormatError(
            path, f"the model is larger than the {most >> 20} MiB that a page holds; simplify the mesh, or write a GLB"
        )
    view = Path(__file__).with_name("view")
    page = view.joinpath("page.html").read_text(encoding="utf-8").replace("TITLE", html.escape(title))
    script = view.joinpath("view.js").read_text(encoding="utf-8").replace("</script", "<\\/script")
    before, _, rest = page.partition("MODEL")
    middle, _, after = rest.partition("SCRIPT")
    # the script in ASCII, for frames that take the encoding of what is around them
    parts = before.encode(), base64.b64encode(model), middle.encode(), script.encode("ascii", "backslashreplace")
    with atomic_write(path) as file:
        for part in (*parts, after.encode()):
            file.write(part)
    return path


VIEW_SIZE = (320, 360)


def orientation_views(character: Character, count: int = 4) -> np.ndarray:
    """The `count` (1 to 24) likeliest orientations of a character side by side, shape (H, W, 3), uint8: the right one
    stands upright and faces the viewer. Each is labelled with its options and its probability. WeightsError if the
    weights of the orientation network are missing or broken; MissingExtraError if Pillow is not installed.
    """
    from bunraku.anatomy.handles.orientation import guess_orientation
    from bunraku.files import rotated

    guess = guess_orientation(character)
    likely = np.argsort(-guess.probabilities)[:count]
    pictures = [render_still(rotated(character, *ORIENTATIONS[n]), size=VIEW_SIZE, yaw=0.2) for n in likely]
    labels = [
        f"--up {ORIENTATIONS[n][0]} --front {ORIENTATIONS[n][1]} ({100 * min(guess.probabilities[n], 0.99):.0f} %)"
        for n in likely
    ]
    return assemble(pictures, labels, columns=count)
