"""Folders that other programs take: an add-on, a pack of nodes."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from bunraku.cli.output.checks import check_folder
from bunraku.cli.output.ledger import check_free
from bunraku.cli.output.outputs import wrote
from bunraku.formats.files import atomic_write, writing

__all__ = ["write_pack"]


def write_pack(name: str, folder: Path, overwrite: bool) -> None:
    """Write the files of a pack; one that is there already and is the same is no reason to stop.

    Args:
        name: Its folder beside the studio's add-ons.
        folder: Where it goes.
        overwrite: Whether other files of these names are replaced.

    Raises:
        FormatError: A file is there and is another one, or cannot be written.
    """
    source = files("bunraku.studio").joinpath("addon", name)
    contents = {
        folder / one.name: one.read_bytes()
        for one in sorted(source.iterdir(), key=lambda one: one.name)
        if one.is_file() and not one.name.endswith(".pyc")
    }
    check_folder(folder if folder.parent.exists() else folder.parent)
    other = [path for path, data in contents.items() if not (path.is_file() and path.read_bytes() == data)]
    check_free(other, overwrite, ours=False)
    with writing(folder, "folder"):
        folder.mkdir(parents=True, exist_ok=True)
    for path, data in contents.items():
        with atomic_write(path) as file:
            file.write(data)
        wrote(path)
