"""Files in and out: the readers and writers of every format. Everything outside this room imports from here alone.

Each name is fetched from its module when it is first used (PEP 562), so that no command loads formats that it does not
need.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bunraku.files.clips import bones_of, clip_names, load_animation, load_clip, load_clip_animation, merge
    from bunraku.files.fbx.clips import load_fbx_motion
    from bunraku.files.fbx.read import fbx_facts
    from bunraku.files.gltf.carry import free_name
    from bunraku.files.gltf.clips import write_stretches
    from bunraku.files.gltf.colors import linear_from_srgb
    from bunraku.files.gltf.document import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, Document, GltfBuilder
    from bunraku.files.gltf.mesh import borrow_weights, strongest
    from bunraku.files.gltf.open import open_document
    from bunraku.files.gltf.read import Source, read_gltf, turned
    from bunraku.files.gltf.vrma import write_vrma
    from bunraku.files.gltf.write import clip_handles, document_of, joint_tracks
    from bunraku.files.gltf.write_points import before_skin, shapes_of_meshes
    from bunraku.files.meshes.obj import check_sequence, read_obj
    from bunraku.files.meshes.ply import read_ply
    from bunraku.files.mmd.document import LIGHT
    from bunraku.files.mmd.model import MmdFile, MmdMaterial, mmd_character
    from bunraku.files.mmd.read import read_pmx_file
    from bunraku.files.mmd.vmd import VMD_FPS, MmdClip, VmdMotion, load_vmd, write_vmd
    from bunraku.files.mmd.write import pmx_bytes
    from bunraku.files.motions.arrays import (
        HUMANML3D_FPS,
        REFERENCE,
        TimedCaption,
        motion_arrays,
        pack_animation,
        pack_motion,
        read_npz_motion,
        read_positions,
        read_reference,
        read_texts,
    )
    from bunraku.files.motions.bvh import write_bvh
    from bunraku.files.presets import Preset, preset_named, preset_rows, save_clips, save_for
    from bunraku.files.registry import (
        FORMATS,
        UNIT_CHOICES,
        UNIT_NAMES,
        check_points_writer,
        check_writer,
        check_writes,
        detect,
        in_metres,
        load_character,
        load_with_clips,
        read_motion,
        resolve_unit,
        save_animation,
        save_character,
        save_motion,
    )
    from bunraku.files.samples import sample_character, sample_file, sample_names

__all__ = [
    "ARRAY_BUFFER",
    "Document",
    "ELEMENT_ARRAY_BUFFER",
    "FORMATS",
    "GltfBuilder",
    "HUMANML3D_FPS",
    "LIGHT",
    "MmdClip",
    "MmdFile",
    "MmdMaterial",
    "Preset",
    "REFERENCE",
    "Source",
    "TimedCaption",
    "UNIT_CHOICES",
    "UNIT_NAMES",
    "VMD_FPS",
    "VmdMotion",
    "before_skin",
    "bones_of",
    "borrow_weights",
    "check_points_writer",
    "check_sequence",
    "check_writer",
    "check_writes",
    "clip_handles",
    "clip_names",
    "detect",
    "document_of",
    "fbx_facts",
    "free_name",
    "in_metres",
    "joint_tracks",
    "linear_from_srgb",
    "load_animation",
    "load_character",
    "load_clip",
    "load_clip_animation",
    "load_fbx_motion",
    "load_vmd",
    "load_with_clips",
    "merge",
    "mmd_character",
    "motion_arrays",
    "open_document",
    "pack_animation",
    "pack_motion",
    "pmx_bytes",
    "preset_named",
    "preset_rows",
    "read_gltf",
    "read_motion",
    "read_npz_motion",
    "read_obj",
    "read_ply",
    "read_pmx_file",
    "read_positions",
    "read_reference",
    "read_texts",
    "resolve_unit",
    "sample_character",
    "sample_file",
    "sample_names",
    "save_animation",
    "save_character",
    "save_clips",
    "save_for",
    "save_motion",
    "shapes_of_meshes",
    "strongest",
    "turned",
    "write_bvh",
    "write_stretches",
    "write_vmd",
    "write_vrma",
]

_MODULES = {
    "bunraku.files.clips": (
        "bones_of",
        "clip_names",
        "load_animation",
        "load_clip",
        "load_clip_animation",
        "merge",
    ),
    "bunraku.files.fbx.clips": ("load_fbx_motion",),
    "bunraku.files.fbx.read": ("fbx_facts",),
    "bunraku.files.gltf.carry": ("free_name",),
    "bunraku.files.gltf.clips": ("write_stretches",),
    "bunraku.files.gltf.colors": ("linear_from_srgb",),
    "bunraku.files.gltf.document": (
        "ARRAY_BUFFER",
        "Document",
        "ELEMENT_ARRAY_BUFFER",
        "GltfBuilder",
    ),
    "bunraku.files.gltf.mesh": (
        "borrow_weights",
        "strongest",
    ),
    "bunraku.files.gltf.open": ("open_document",),
    "bunraku.files.gltf.read": (
        "Source",
        "read_gltf",
        "turned",
    ),
    "bunraku.files.gltf.vrma": ("write_vrma",),
    "bunraku.files.gltf.write": (
        "clip_handles",
        "document_of",
        "joint_tracks",
    ),
    "bunraku.files.gltf.write_points": (
        "before_skin",
        "shapes_of_meshes",
    ),
    "bunraku.files.meshes.obj": (
        "check_sequence",
        "read_obj",
    ),
    "bunraku.files.meshes.ply": ("read_ply",),
    "bunraku.files.mmd.document": ("LIGHT",),
    "bunraku.files.mmd.model": (
        "MmdFile",
        "MmdMaterial",
        "mmd_character",
    ),
    "bunraku.files.mmd.read": ("read_pmx_file",),
    "bunraku.files.mmd.vmd": (
        "MmdClip",
        "VMD_FPS",
        "VmdMotion",
        "load_vmd",
        "write_vmd",
    ),
    "bunraku.files.mmd.write": ("pmx_bytes",),
    "bunraku.files.motions.arrays": (
        "HUMANML3D_FPS",
        "REFERENCE",
        "TimedCaption",
        "motion_arrays",
        "pack_animation",
        "pack_motion",
        "read_npz_motion",
        "read_positions",
        "read_reference",
        "read_texts",
    ),
    "bunraku.files.motions.bvh": ("write_bvh",),
    "bunraku.files.presets": (
        "Preset",
        "preset_named",
        "preset_rows",
        "save_clips",
        "save_for",
    ),
    "bunraku.files.registry": (
        "FORMATS",
        "UNIT_CHOICES",
        "UNIT_NAMES",
        "check_points_writer",
        "check_writer",
        "check_writes",
        "detect",
        "in_metres",
        "load_character",
        "load_with_clips",
        "read_motion",
        "resolve_unit",
        "save_animation",
        "save_character",
        "save_motion",
    ),
    "bunraku.files.samples": (
        "sample_character",
        "sample_file",
        "sample_names",
    ),
}
"""Names by the modules that have them."""
_HOME = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'bunraku.files' has no attribute '{name}'")
    value = globals()[name] = getattr(import_module(_HOME[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
