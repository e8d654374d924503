"""The table of formats: by which suffixes and first bytes each is known, and who reads and writes it."""

from __future__ import annotations

from dataclasses import dataclass

from bunraku.formats.files import MAX_BYTES, MAX_TEXT_BYTES

__all__ = ["FORMATS", "Format"]


@dataclass(frozen=True)
class Format:
    """A file format.

    Functions are named as "module:function" and imported when a file is read or written. A name without a module is a
    function of a room above, such as a renderer, which `core.saving.provide` makes known.

    Args:
        title: Its name in messages.
        suffixes: Suffixes that name it, lower case.
        magic: First bytes that name it whatever the suffix says.
        character: Function that makes a character of a path and its bytes.
        motion: Function that makes a motion of a path and its bytes.
        animation: Function that writes an animation to a path.
        moved: Function that writes a motion without a character to a path.
        bones: Function that writes an animation of a character's own rig to a path, where that is another.
        parts: It speaks of a person's parts: an animation of a rig is written as that of its 30 handles.
        points: Function that writes an animation whose vertices also move on their own to a path.
        rigged: Function that writes a character with or without handles to a path.
        available: Function that raises MissingExtraError where what writes the format is not installed.
        suits: Function that takes a character and a path, and raises FormatError where files of the format cannot hold
            what the character does.
        largest: Largest file that is opened at all [bytes].
    """

    title: str
    suffixes: tuple[str, ...]
    magic: tuple[bytes, ...] = ()
    character: str = ""
    motion: str = ""
    animation: str = ""
    moved: str = ""
    bones: str = ""
    parts: bool = False
    points: str = ""
    rigged: str = ""
    available: str = ""
    suits: str = ""
    largest: int = MAX_BYTES


FORMATS: tuple[Format, ...] = (
    Format(
        "GLB",
        (".glb",),
        (b"glTF",),
        character="bunraku.formats.gltf.read:read_gltf",
        motion="bunraku.formats.vrm.vrma:read_glb_motion",
        animation="bunraku.formats.gltf.write:write_animation",
        bones="bunraku.formats.gltf.write_rig:save_rig_animation",
        points="bunraku.formats.gltf.write_points:write_point_animation",
        rigged="bunraku.formats.gltf.write_rig:write_character",
    ),
    Format(
        "VRM",
        (".vrm",),
        (b"glTF",),
        character="bunraku.formats.gltf.read:read_gltf",
        rigged="bunraku.formats.vrm.write:write_avatar",
    ),
    Format("glTF", (".gltf",), character="bunraku.formats.gltf.read:read_gltf"),
    Format(
        "PLY",
        (".ply",),
        (b"ply\n", b"ply\r"),
        character="bunraku.formats.mesh.ply:read_ply",
        animation="bunraku.formats.mesh.sequences:write_ply_sequence",
        points="bunraku.formats.mesh.sequences:write_ply_sequence",
    ),
    Format(
        "OBJ",
        (".obj",),
        character="bunraku.formats.mesh.obj:read_obj",
        animation="bunraku.formats.mesh.sequences:write_obj_sequence",
        points="bunraku.formats.mesh.sequences:write_obj_sequence",
    ),
    Format(
        "USD",
        (".usd", ".usda", ".usdc", ".usdz"),
        animation="bunraku.formats.usd.write:write_usd",
        bones="bunraku.formats.usd.write:write_rig",
        points="bunraku.formats.usd.write:write_points",
        available="bunraku.formats.usd.write:check_available",
    ),
    Format("STL", (".stl",), character="bunraku.formats.mesh.stl:read_stl"),
    Format(
        "handle motion",
        (".npz",),
        (b"PK\x03\x04",),
        motion="bunraku.formats.arrays.npz:read_any_motion",
        animation="bunraku.formats.arrays.npz:write_animation",
        parts=True,
        moved="write_motion_npz",
    ),
    Format("HumanML3D", (".npy",), (b"\x93NUMPY",), motion="bunraku.formats.arrays.humanml3d:read_humanml3d"),
    Format(
        "BVH",
        (".bvh",),
        (b"HIERARCHY",),
        motion="bunraku.formats.bvh.read:read_bvh",
        animation="write_humanoid_bvh",
        parts=True,
        moved="write_motion_bvh",
        largest=MAX_TEXT_BYTES,
    ),
    Format(
        "VRMA",
        (".vrma",),
        (b"glTF",),
        motion="bunraku.formats.vrm.vrma:read_vrma",
        animation="write_humanoid_vrma",
        parts=True,
        moved="write_motion_vrma",
    ),
    Format(
        "FBX",
        (".fbx",),
        (b"Kaydara FBX Binary", b"; FBX"),
        character="bunraku.formats.fbx.read:read_fbx",
        motion="bunraku.formats.fbx.motion:read_motion",
        animation="bunraku.formats.fbx.export:write_fbx",
        bones="bunraku.formats.fbx.export:write_fbx",
        points="bunraku.formats.fbx.export:write_points",
        rigged="bunraku.formats.fbx.export:write_character",
    ),
    Format(
        "VMD",
        (".vmd",),
        (b"Vocaloid Motion Data",),
        animation="write_character_vmd",
        bones="write_character_vmd",
        suits="check_mmd_character",
    ),
    Format(
        "PMX",
        (".pmx",),
        (b"PMX ",),
        character="bunraku.formats.mmd.pmx:read_pmx",
        rigged="bunraku.formats.mmd.export:write_character",
    ),
    Format("PMD", (".pmd",), (b"Pmd",), character="bunraku.formats.mmd.pmd:read_pmd"),
    Format(
        "HTML",
        (".html",),
        animation="write_html",
        bones="write_html",
        points="write_html",
    ),
    Format("MP4", (".mp4",), animation="save_preview", points="save_preview"),
    Format("WEBP", (".webp",), animation="save_preview", points="save_preview"),
    Format("GIF", (".gif",), animation="save_preview", points="save_preview"),
    Format("PNG", (".png",), animation="save_preview", points="save_preview"),
)
