"""The table of formats: by which suffixes and first bytes each is known, and who reads and writes it."""

from __future__ import annotations

from dataclasses import dataclass

from bunraku.formats.files import MAX_BYTES, MAX_TEXT_BYTES

__all__ = ["FORMATS", "Format"]


@dataclass(frozen=True)
class Format:
    """A file format.

    Modules are those of `bunraku.io`, or have their whole name, for what needs more than files: pictures, or the
    humanoid in a character. They are loaded when a file is read or written, so nothing here imports what is built on
    it.

    Args:
        title: Its name in messages.
        suffixes: Suffixes that name it, lower case.
        magic: First bytes that name it whatever the suffix says.
        character: "module:function" that makes a character of a path and its bytes.
        motion: "module:function" that makes a motion of a path and its bytes.
        animation: "module:function" that writes an animation to a path.
        moved: "module:function" that writes a motion without a character to a path.
        bones: "module:function" that writes an animation of a character's own rig to a path, where that is another.
        parts: It speaks of a person's parts: an animation of a rig is written as that of its 30 handles.
        points: "module:function" that writes an animation whose vertices also move on their own to a path.
        rigged: "module:function" that writes a character with or without handles to a path.
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
    largest: int = MAX_BYTES


_PREVIEW = "bunraku.render.preview:save_preview"
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
    ),
    Format("STL", (".stl",), character="bunraku.formats.mesh.stl:read_stl"),
    Format(
        "handle motion",
        (".npz",),
        (b"PK\x03\x04",),
        motion="bunraku.formats.arrays.npz:read_any_motion",
        animation="bunraku.formats.arrays.npz:write_animation",
        parts=True,
        moved="bunraku.io.skeletal:write_motion_npz",
    ),
    Format("HumanML3D", (".npy",), (b"\x93NUMPY",), motion="bunraku.formats.arrays.humanml3d:read_humanml3d"),
    Format(
        "BVH",
        (".bvh",),
        (b"HIERARCHY",),
        motion="bunraku.formats.bvh.read:read_bvh",
        animation="bunraku.io.humanoid:write_humanoid_bvh",
        parts=True,
        moved="bunraku.io.skeletal:write_motion_bvh",
        largest=MAX_TEXT_BYTES,
    ),
    Format(
        "VRMA",
        (".vrma",),
        (b"glTF",),
        motion="bunraku.formats.vrm.vrma:read_vrma",
        animation="bunraku.io.humanoid:write_humanoid_vrma",
        parts=True,
        moved="bunraku.io.skeletal:write_motion_vrma",
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
        animation="bunraku.io.mmd_motion:write_character_vmd",
        bones="bunraku.io.mmd_motion:write_character_vmd",
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
        animation="bunraku.render.html:write_html",
        bones="bunraku.render.html:write_html",
        points="bunraku.render.html:write_html",
    ),
    Format("MP4", (".mp4",), animation=_PREVIEW, points=_PREVIEW),
    Format("WEBP", (".webp",), animation=_PREVIEW, points=_PREVIEW),
    Format("GIF", (".gif",), animation=_PREVIEW, points=_PREVIEW),
    Format("PNG", (".png",), animation=_PREVIEW, points=_PREVIEW),
)
