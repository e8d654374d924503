"""The table of formats: by which suffixes and first bytes each is known, and who reads and writes it."""

from __future__ import annotations

from dataclasses import dataclass

from bunraku.formats.files import MAX_BYTES, MAX_TEXT_BYTES

__all__ = ["FORMATS", "Format"]


@dataclass(frozen=True)
class Format:
    """A file format.

    Modules are those of `bunraku.formats`, or have their whole name, for what needs more than files: pictures, or the humanoid in a
    character. They are loaded when a file is read or written, so nothing here imports what is built on it.

    Args:
        title: Its name in messages.
        suffixes: Suffixes that name it, lower case.
        magic: First bytes that name it whatever the suffix says.
        character: "module:function" that makes a character of a path and its bytes.
        motion: "module:function" that makes a motion of a path and its bytes.
        animation: "module:function" that writes an animation to a path.
        moved: "module:function" that writes a motion without a character to a path.
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
    points: str = ""
    rigged: str = ""
    largest: int = MAX_BYTES


FORMATS: tuple[Format, ...] = (
    Format(
        "GLB",
        (".glb",),
        (b"glTF",),
        character="gltf_read:read_gltf",
        motion="vrma:read_glb_motion",
        animation="gltf_write:write_animation",
        points="gltf_points:write_point_animation",
        rigged="gltf_write:write_character",
    ),
    Format("VRM", (".vrm",), (b"glTF",), character="gltf_read:read_gltf"),
    Format("glTF", (".gltf",), character="gltf_read:read_gltf"),
    Format(
        "PLY",
        (".ply",),
        (b"ply\n", b"ply\r"),
        character="ply:read_ply",
        animation="sequences:write_ply_sequence",
        points="sequences:write_ply_sequence",
    ),
    Format(
        "OBJ",
        (".obj",),
        character="rignet:read_obj_with_rig",
        animation="sequences:write_obj_sequence",
        points="sequences:write_obj_sequence",
    ),
    Format("USD", (".usd", ".usda", ".usdc", ".usdz"), animation="usd:write_usd", points="usd:write_points"),
    Format("STL", (".stl",), character="stl:read_stl"),
    Format(
        "handle motion",
        (".npz",),
        (b"PK\x03\x04",),
        motion="npz:read_any_motion",
        animation="npz:write_animation",
        moved="skeletal_out:write_motion_npz",
    ),
    Format("HumanML3D", (".npy",), (b"\x93NUMPY",), motion="humanml3d:read_humanml3d"),
    Format(
        "BVH",
        (".bvh",),
        (b"HIERARCHY",),
        motion="bvh:read_bvh",
        animation="bunraku.retarget.humanoid:write_humanoid_bvh",
        moved="skeletal_out:write_motion_bvh",
        largest=MAX_TEXT_BYTES,
    ),
    Format(
        "VRMA",
        (".vrma",),
        (b"glTF",),
        motion="vrma:read_vrma",
        animation="bunraku.retarget.humanoid:write_humanoid_vrma",
        moved="skeletal_out:write_motion_vrma",
    ),
    Format(
        "FBX",
        (".fbx",),
        (b"Kaydara FBX Binary", b"; FBX"),
        character="fbx:read_fbx",
        motion="fbx_motion:read_motion",
        animation="fbx_export:write_fbx",
    ),
    Format("VMD", (".vmd",), (b"Vocaloid Motion Data",), animation="bunraku.retarget.vmd_out:write_character_vmd"),
    Format("PMX", (".pmx",), (b"PMX ",), character="pmx:read_pmx"),
    Format("PMD", (".pmd",), (b"Pmd",), character="pmd:read_pmd"),
    Format("RigNet", (".txt",), character="rignet:read_rignet"),
    *(Format(suffix[1:].upper(), (suffix,), animation="bunraku.render.preview:save_preview") for suffix in (".mp4", ".webp", ".gif", ".png")),
)
