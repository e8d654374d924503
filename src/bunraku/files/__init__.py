"""Files in and out: the readers and writers of every format. Everything outside this room imports from here alone.

Each name is fetched from its module when it is first used (PEP 562), so that no command loads formats that it does not
need.
"""

# ruff: noqa: F401, I001 - what is imported here is for type checkers

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bunraku.files.clips import (
        bones_of, clips_rise, load_animation, load_clip, load_clip_animation, merge, own_animation,
    )  # fmt: skip
    from bunraku.files.fbx.clips import load_fbx_motion
    from bunraku.files.fbx.read import fbx_facts
    from bunraku.files.gltf.carry import clip_names, free_name
    from bunraku.files.gltf.clips import write_stretches
    from bunraku.files.gltf.colors import linear_from_srgb, srgb_from_linear
    from bunraku.files.gltf.document import Document
    from bunraku.files.gltf.open import open_document
    from bunraku.files.gltf.read import Source, read_gltf, rotated
    from bunraku.files.gltf.vrma import load_skeleton_clip, write_vrma
    from bunraku.files.gltf.write_rig import with_still
    from bunraku.files.gltf.write import clip_handles, document_of, joint_tracks
    from bunraku.files.gltf.write_points import before_skin, shapes_of_meshes
    from bunraku.files.meshes.obj import check_sequence, read_obj
    from bunraku.files.meshes.ply import read_ply
    from bunraku.files.mmd.document import LIGHT
    from bunraku.files.mmd.model import MmdFile, MmdMaterial, mmd_character
    from bunraku.files.mmd.read import read_pmx_file
    from bunraku.files.mmd.vmd import MmdClip, VMD_FPS, VmdMotion, load_vmd, write_vmd
    from bunraku.files.mmd.write import pmx_bytes
    from bunraku.files.motions.arrays import (
        HUMANML3D_FPS, REFERENCE, motion_arrays, pack_animation, pack_motion, read_npz_motion,
        read_positions, read_reference,
    )  # fmt: skip
    from bunraku.files.motions.bvh import write_bvh
    from bunraku.files.presets import Preset, preset_named, preset_rows, save_clips, save_for
    from bunraku.files.registry import (
        READERS, UNIT_CHOICES, UNIT_NAMES, WRITERS, check_writer, holds_character, in_metres, load_character,
        load_with_clips, read_motion, resolve_unit, save, save_character,
    )  # fmt: skip
    from bunraku.files.samples import sample_bytes, sample_character, sample_file, sample_files, sample_names

_NAMES = {
    "clips": "bones_of clips_rise load_animation load_clip load_clip_animation merge own_animation",
    "fbx.clips": "load_fbx_motion",
    "fbx.read": "fbx_facts",
    "gltf.carry": "clip_names free_name",
    "gltf.clips": "write_stretches",
    "gltf.colors": "linear_from_srgb srgb_from_linear",
    "gltf.document": "Document",
    "gltf.open": "open_document",
    "gltf.read": "Source read_gltf rotated",
    "gltf.vrma": "load_skeleton_clip write_vrma",
    "gltf.write_rig": "with_still",
    "gltf.write": "clip_handles document_of joint_tracks",
    "gltf.write_points": "before_skin shapes_of_meshes",
    "meshes.obj": "check_sequence read_obj",
    "meshes.ply": "read_ply",
    "mmd.document": "LIGHT",
    "mmd.model": "MmdFile MmdMaterial mmd_character",
    "mmd.read": "read_pmx_file",
    "mmd.vmd": "MmdClip VMD_FPS VmdMotion load_vmd write_vmd",
    "mmd.write": "pmx_bytes",
    "motions.arrays":
        "HUMANML3D_FPS REFERENCE motion_arrays pack_animation pack_motion read_npz_motion "
        "read_positions read_reference",
    "motions.bvh": "write_bvh",
    "presets": "Preset preset_named preset_rows save_clips save_for",
    "registry":
        "READERS UNIT_CHOICES UNIT_NAMES WRITERS check_writer holds_character in_metres load_character load_with_clips "
        "read_motion resolve_unit save save_character",
    "samples": "sample_bytes sample_character sample_file sample_files sample_names",
}  # fmt: skip
"""Public names by the module below this one that has them."""
_HOME = {name: f"bunraku.files.{module}" for module, names in _NAMES.items() for name in names.split()}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'bunraku.files' has no attribute '{name}'")
    value = globals()[name] = getattr(import_module(_HOME[name]), name)
    return value


def __dir__() -> list[str]:
    return __all__
