"""`build_wardrobe` writes wardrobe characters as PMX files."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from bunraku.formats.files import atomic_write
from bunraku.formats.mmd.pmx_write import pmx_bytes
from bunraku_lab.synthetic.wardrobe.character import wardrobe_costume

__all__ = ["INDEX", "build_wardrobe"]

INDEX = "wardrobe.json"


def build_wardrobe(
    folder: str | Path,
    count: int,
    seed: int = 0,
    *,
    clothes: str | Path | None = None,
    body_data: str | Path | None = None,
    progress: Callable[[int, int, str], None] | None = None,
) -> list[Path]:
    """Write wardrobe characters as `wardrobe-<seed>.pmx`, and `wardrobe.json`, which says what each wears.

    Args:
        folder: Folder to write to, made when it is not there.
        count: How many.
        seed: Of the first; the others follow.
        clothes, body_data: As for `wardrobe_character`.
        progress: Called with the number done, the number of all, and the name.

    Returns:
        The PMX files.

    Raises:
        FormatError: A file cannot be written, or the clothes or the body are missing or damaged.
    """
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    files, index = [], {}
    for number in range(count):
        costume = wardrobe_costume(seed + number, clothes=clothes, body_data=body_data)
        target = out / f"{costume.name}.pmx"
        with atomic_write(target) as stream:
            stream.write(pmx_bytes(costume.file()))
        files.append(target)
        dynamic = sum(body.dynamic for body in costume.bodies)
        index[target.name] = {
            "seed": seed + number,
            "wears": costume.words,
            "bodies": len(costume.bodies),
            "dynamic": dynamic,
            "joints": len(costume.joints),
        }
        if progress:
            progress(number + 1, count, costume.name)
    with atomic_write(out / INDEX) as stream:
        stream.write((json.dumps(index, indent=1, ensure_ascii=False) + "\n").encode())
    return files
