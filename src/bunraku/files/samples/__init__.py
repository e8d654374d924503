"""Sample characters that come with the package, so that demos and tests need no downloads.

Each sample is a GLB file beside this module with smooth normals and one material per colour. It stands on y = 0, faces
+Z and has its left side at +X; people are in T-pose.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bunraku.core.arguments import checked
from bunraku.errors import OptionError

if TYPE_CHECKING:
    from bunraku.core.character import Character

__all__ = ["sample_bytes", "sample_character", "sample_file", "sample_files", "sample_names"]

_MESH = "knight.obj"
_OTHERS = (_MESH, "hero.glb", "avatar.vrm", "walk.bvh", "ten.txt")
"""What else the docs use: the person as a bare mesh, on the skeletons of Mixamo and of VRM, a walk, ten prompts."""
_NAMES = ("person", "dancer", "dog", "mushroom", "robot", "dragon")


def sample_names() -> tuple[str, ...]:
    """The names that `sample_character` knows."""
    return _NAMES


def sample_file(name: str) -> Path:
    """The GLB file of a sample character.

    Raises:
        OptionError: The name is unknown.
    """
    if name not in _NAMES:
        raise OptionError(f"there is no sample character named {name[:40]!r}; choose one of {', '.join(_NAMES)}")
    return Path(__file__).with_name(f"{name}.glb")


def sample_files() -> dict[str, str]:
    """Names of all files that `bunraku samples` writes, by those of the samples: the characters, and what else the docs
    use.
    """
    return {name.partition(".")[0]: name for name in (*(f"{name}.glb" for name in _NAMES), *_OTHERS)}


def sample_bytes(file: str) -> bytes:
    """What is in one of `sample_files`. Errors are those of `sample_character`."""
    from bunraku.core.files import read_bounded

    if file == _MESH:
        from bunraku.files.meshes.obj import obj_frame

        person = sample_character("person")
        return obj_frame(person)(person.vertices)
    return read_bounded(Path(__file__).with_name(file))


@checked
def sample_character(name: str) -> Character:
    """A sample character without a rig, one of `sample_names`: closed parts of 6,000 to 9,000 vertices together, wound
    outward, with one colour a face.

    Raises:
        OptionError: The name is unknown.
        FormatError: The installation is damaged: the file cannot be read.
    """
    path = sample_file(name)
    from bunraku.core.files import read_bounded
    from bunraku.files.gltf.read import read_gltf

    return read_gltf(path, read_bounded(path))
