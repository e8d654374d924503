"""An animation as one page that shows it: a view to turn, without a server or a network."""

from __future__ import annotations

import base64
import html
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bunraku.core.saving import save
from bunraku.errors import FormatError
from bunraku.formats.files import atomic_write

if TYPE_CHECKING:
    from bunraku.core.animated import AnimatedCharacter

__all__ = ["MOST_BYTES", "write_html"]

MOST_BYTES = 64 << 20
"""Bytes of a model that a page holds."""


def write_html(
    animation: AnimatedCharacter,
    path: Path,
    *,
    fps: float | None = None,
    name: str | None = None,
    most: int = MOST_BYTES,
) -> Path:
    """Write an animation as a page that shows it, by three.js.

    Args:
        animation: Of any kind that a GLB can hold.
        path: The file.
        fps: Frames a second of the clip [1/s]; those of the motion by default.
        name: The title; the file's name by default.
        most: Bytes that the model may have.

    Returns:
        The file that was written.

    Raises:
        FormatError: The file cannot be written, or the model is larger.
    """
    title = str(name) if name else path.stem
    rate: dict[str, Any] = {} if fps is None else {"fps": fps}
    with tempfile.TemporaryDirectory() as folder:
        model = save(animation, Path(folder, "model.glb"), name=title, **rate).read_bytes()
    if len(model) > most:
        raise FormatError(
            path,
            f"the model is larger than the {most >> 20} MiB that a page holds; simplify the mesh, or write a GLB",
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
