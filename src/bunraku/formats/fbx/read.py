"""Read FBX (Mixamo, Blender, Maya, 3ds Max): the meshes, materials and skin of a character."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bunraku.core.character import Character
from bunraku.formats.fbx.clips import read_clips
from bunraku.formats.fbx.document import scene_document
from bunraku.formats.fbx.scene import read_scene
from bunraku.formats.fbx.tree import read_tree
from bunraku.formats.gltf.read import character_from_document

__all__ = ["fbx_facts", "read_fbx"]


def read_fbx(path: Path, data: bytes, *, rest: str = "bind", clip_fps: float | None = None) -> Character:
    """Read an FBX file of version 7.1 to 7.7, binary or text.

    The vertices are the control points of all meshes in the order of the file, turned from the frame and unit that it
    states into ours. Hidden meshes are left out where others are not; blend shapes are not read.

    Args:
        path: The file.
        data: Its bytes.
        rest: "bind" rests in the pose that the skins were bound in, "default" in that of the file's objects.
        clip_fps: Also read the clips, at so many frames a second [1/s].

    Raises:
        FormatError: The file is broken, of a version that is not read, or holds no mesh.
        CharacterError: What it holds is no character.
    """
    document, index = scene_document(read_scene(read_tree(path, data)), clip_fps)
    return character_from_document(document, path.stem, index, ".fbx", rest=rest)


def fbx_facts(path: Path, data: bytes) -> dict[str, Any]:
    """What an FBX file says of itself, for people: version, program, clips, and the unit and axes that reading turns
    into ours.

    Raises:
        FormatError: The file is broken, or of a version that is not read.
    """
    tree = read_tree(path, data)
    scene = read_scene(tree)
    frame = scene.frame
    clips = [
        {"name": clip.name, "seconds": round(clip.seconds, 3), "channels": len(clip.curves)}
        for clip in read_clips(scene)
    ]
    return {
        "generator": tree.root.text("Creator") or tree.section("FBXHeaderExtension").text("Creator"),
        "fbx_version": f"{tree.version / 1000:.1f}",
        "file_unit": f"{frame.metres:.6g} m",
        "meshes": len([thing for thing in scene.of_kind("Geometry") if thing.subtype == "Mesh"]),
        "file_axes": f"up {frame.up}, front {frame.front}",
        "animations": clips,
    }
