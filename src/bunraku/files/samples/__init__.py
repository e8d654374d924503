"""Sample characters that come with the package, so that demos and tests need no downloads.

Each sample is a GLB file beside this module with smooth normals and one material per colour. It stands on y = 0, faces
+Z and has its left side at +X; people are in T-pose.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import TYPE_CHECKING

from bunraku.core.request import checked
from bunraku.errors import OptionError

if TYPE_CHECKING:
    from bunraku.core.character import Character

__all__ = ["sample_bytes", "sample_character", "sample_file", "sample_files", "sample_names"]

_MESH, _HERO, _AVATAR = "knight.obj", "hero.glb", "avatar.vrm"
_OTHERS = (_MESH, _HERO, _AVATAR, "walk.bvh", "ten.txt")
"""What else the docs use: the person as a bare mesh, on the skeletons of Mixamo and of VRM, a walk, ten prompts."""
_NAMES = ("person", "dancer", "dog", "mushroom", "robot", "dragon")


def sample_names() -> tuple[str, ...]:
    """The names that `sample_character` knows."""
    return _NAMES


def sample_file(name: str) -> Path:
    """The GLB file of a sample character. OptionError if the name is unknown."""
    if name not in _NAMES:
        raise OptionError(f"there is no sample character named {name[:40]!r}; choose one of {', '.join(_NAMES)}")
    return Path(__file__).with_name(f"{name}.glb")


def sample_files() -> dict[str, str]:
    """Names of all files that `bunraku samples` writes, by those of the samples: characters, and what the docs use."""
    return {name.partition(".")[0]: name for name in (*(f"{name}.glb" for name in _NAMES), *_OTHERS)}


def sample_bytes(file: str) -> bytes:
    """What is in one of `sample_files`. Errors are those of `sample_character`."""
    from bunraku.core.files import read_bounded

    if file == _MESH:
        from bunraku.files.meshes.obj import obj_frame

        person = sample_character("person")
        return obj_frame(person)(person.vertices)
    if file == _HERO:
        return _with_mixamo_names(read_bounded(Path(__file__).with_name(_AVATAR)))
    return read_bounded(Path(__file__).with_name(file))


def _with_mixamo_names(avatar: bytes) -> bytes:
    """The GLB of a VRM file whose bones have Mixamo's names."""
    from bunraku.core.body.layout import engine_names

    end = 20 + int.from_bytes(avatar[12:16], "little")
    tree = json.loads(avatar[20:end])
    names = dict(zip(engine_names("vrm"), engine_names("mixamo"), strict=True))
    for node in tree["nodes"]:
        node["name"] = names.get(node["name"], node["name"])
    del tree["extensions"]
    tree["extensionsUsed"].remove("VRMC_vrm")
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4s4I", b"glTF", 2, 20 + len(text) + len(avatar) - end, len(text), 0x4E4F534A)
    return head + text + avatar[end:]


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
