"""Motion of any kind: read from any file that holds one, and taken to the reference body.

A skeleton goes there by the meaning of its joints, a clip of a character by its rig or its handles, a moving mesh by
registration of its handles.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.body.layout import HANDLE_COUNT
from bunraku.core.character import Character
from bunraku.core.geometry.curves import tallest_steady
from bunraku.core.motion import HandleMotion, MeshMotion, SkeletalMotion
from bunraku.core.request import checked
from bunraku.errors import CharacterError, FormatError, MotionError
from bunraku.files import bones_of, load_animation, load_character, load_skeleton_clip, read_motion
from bunraku.retarget.creatures import CreatureMotion, motion_of_handles, motion_of_skeleton
from bunraku.retarget.rig_parts import RigParts
from bunraku.retarget.to_reference import bones_to_handles, handle_motion_of_mesh, motion_to_reference

MAX_VALUES = 400_000_000
"""Coordinates of all frames of a moving mesh: 1.6 GB."""


def load_mesh_motion(folder: str | Path, fps: float = 20.0) -> MeshMotion:
    """Read a folder of OBJ or PLY files, one a frame in the order of their names, all with the same triangles;
    FormatError where there are no such files, one cannot be read, or their meshes differ.
    """
    folder = Path(folder)
    inside = sorted(file for file in folder.iterdir() if file.is_file())
    files = max(([file for file in inside if file.suffix.lower() == suffix] for suffix in (".ply", ".obj")), key=len)
    if not files:
        raise FormatError(folder, "it holds no .obj or .ply files; name a folder with one mesh a frame")
    first = load_character(files[0], unit="m")
    count = len(first.vertices)
    if count * 3 * len(files) > MAX_VALUES:
        raise FormatError(
            folder, f"{len(files)} frames of {count:,} vertices are too many; simplify the meshes or leave frames out"
        )
    vertices = np.empty((len(files), count, 3), np.float32)
    for number, file in enumerate(files):
        mesh = first if not number else load_character(file, unit="m")
        if mesh.vertices.shape != first.vertices.shape or not np.array_equal(mesh.faces, first.faces):
            raise FormatError(
                file,
                f"its mesh has other triangles than {files[0].name}; export all frames with the same vertices in the "
                "same order",
            )
        vertices[number] = mesh.vertices
    return MeshMotion(vertices, first.faces, fps, folder.name)


Motion = SkeletalMotion | HandleMotion | Animation | RigAnimation | MeshMotion


CLIPS = (".glb", ".gltf", ".vrm", ".fbx")


@checked
def load_motion(path: str | Path, *, fps: float = 30.0, clip: int | str = 0) -> Motion:
    """Read a motion from any file that holds one, or a moving mesh from a folder.

    Args:
        path: The file; or a folder of .obj or .ply files, one a frame.
        fps: Frames a second of clips that are sampled, and of folders [1/s].
        clip: Number or name of the clip of a file with several.

    Raises:
        FormatError: It cannot be read, or holds no motion.
        OptionError: There is no such clip.
    """
    path = Path(path)
    if os.path.isdir(path):  # unlike Path.is_dir, no name makes it raise
        return load_mesh_motion(path, fps)
    suffix = path.suffix.lower()
    if suffix == ".npz":
        motion = read_motion(path)
        if isinstance(motion, SkeletalMotion):
            return motion
        from bunraku.files import load_clip

        return load_clip(path).of_the_reference_body()
    if suffix == ".vmd":
        from bunraku.retarget.mmd_motion import vmd_motion

        return vmd_motion(path, fps=fps)
    if suffix not in CLIPS:
        return read_motion(path)
    if suffix == ".glb":
        own = _own_clip(path)
        if own is not None:
            return own
    if suffix in (".glb", ".gltf"):
        bare = load_skeleton_clip(path, clip, fps)
        if bare is not None:
            return bare
    if suffix == ".fbx":
        from bunraku.anatomy.names.skeleton_map import map_skeleton
        from bunraku.files import load_fbx_motion

        try:  # of a person a skeleton is enough
            motion = load_fbx_motion(path, clip, fps)
            map_skeleton(motion.skeleton)
            return motion
        except (MotionError, FormatError):
            pass

    return load_animation(path, clip, fps)


def _own_clip(path: Path) -> Animation | HandleMotion | None:
    """The clip of a GLB that Bunraku wrote, None for other files: the motion of the reference body, or an animation of
    the clip's body where that is of another kind.
    """
    from bunraku.files import load_clip, load_clip_animation

    try:
        clip = load_clip(path)
    except (FormatError, MotionError):
        return None
    reference = clip.reference
    return reference if reference is not None and not reference.own_kind else load_clip_animation(path)


_CHUNK = 200  # frames registered at once, which bounds the memory
TALL = 0.85
"""A moving mesh stands where its mean height over its lowest point reaches this share of what it lastingly is. Raised
arms add less; chosen by eye.
"""


def reference_motion(motion: Motion, *, fps: float = 20.0, names: Mapping[str, str] | None = None) -> HandleMotion:
    """Any motion as handle motion of the reference body, at a rate [1/s]. `names` gives the skeleton's joint by SMPL's
    name, for joints that are missed or mistaken; "" for none.

    Raises:
        MotionError: No pelvis and legs are found in the skeleton, or a handle motion is of something else.
        CharacterError: The character of a clip has no usable mesh.
    """
    from bunraku.core.motion import resample

    if isinstance(motion, SkeletalMotion):
        return _of_skeleton(motion, fps, names)
    if isinstance(motion, HandleMotion):
        reference = motion
        if reference.translations.shape[1] != HANDLE_COUNT:
            raise MotionError(
                f"a motion of the reference body has {HANDLE_COUNT} handles, not {reference.translations.shape[1]}"
            )
    elif isinstance(motion, MeshMotion) or motion.reference is None:
        reference = motion_to_reference(*_handles_moved(motion))
    else:
        reference = motion.reference
    return resample(reference, fps)


def creature_motion(
    motion: Motion, *, fps: float = 20.0, names: Mapping[str, str] | None = None
) -> CreatureMotion | None:
    """The motion of a body on four legs or more, on none or on wings, or on two legs along a level spine; None for
    people and other upright bodies. Arguments and errors are those of `reference_motion`.
    """
    creature = _creature_motion(motion, fps, names)
    if creature is not None and creature.plan.kind == "two legs" and not creature.flies:
        person = reference_motion(motion, fps=fps, names=names).of_own_body(False)
        creature = replace(creature, person=person)
    return creature


def _creature_motion(motion: Motion, fps: float, names: Mapping[str, str] | None) -> CreatureMotion | None:
    if isinstance(motion, SkeletalMotion):
        return motion_of_skeleton(motion, fps, names)
    if isinstance(motion, HandleMotion):
        return None
    moved, anatomy, _ = _handles_moved(motion)
    creature = motion_of_handles(moved, anatomy)
    return None if creature is None else creature.at(fps)


def _of_skeleton(motion: SkeletalMotion, fps: float, names: Mapping[str, str] | None) -> HandleMotion:
    from bunraku.anatomy.names.skeleton_map import map_skeleton
    from bunraku.anatomy.names.to_smpl import to_smpl
    from bunraku.core.motion import resample_motion
    from bunraku.generation.features import body_handle_motion

    mapped = map_skeleton(motion.skeleton, names)
    return body_handle_motion(to_smpl(resample_motion(motion, fps), mapped))


def _handles_moved(motion: Animation | RigAnimation | MeshMotion) -> tuple[HandleMotion, Anatomy, bool]:
    """How the 30 handles of a character move, its anatomy by them, and whether its bones say so: in a clip of bones
    whose names are known, in one of these handles, or by registration of its mesh.
    """
    if isinstance(motion, MeshMotion):
        return *_registered(_standing(motion), motion.vertices, motion.fps), False
    character, count = motion.character, len(motion.handles.positions)
    of_bones = character.rig is not None and count == len(character.rig.names) + 1  # as clips of files are
    if isinstance(motion, RigAnimation) or of_bones:
        world = motion.world() if isinstance(motion, RigAnimation) else bones_of(motion)
        try:
            standing, rotations, positions = facing(character, *world)
            parts = RigParts.of(standing)
            return bones_to_handles(parts, rotations, positions, motion.motion.fps), parts.anatomy, True
        except CharacterError:
            pass  # the names of its bones say nothing
    elif count == HANDLE_COUNT:
        return motion.motion, Anatomy.of(character, motion.handles), False
    return *_registered(replace(character, rig=None), motion.vertices(), motion.motion.fps), False


def facing(
    character: Character, rotations: np.ndarray, positions: np.ndarray
) -> tuple[Character, np.ndarray, np.ndarray]:
    """A character and the motion of its bones, rotated to face +Z by its rig."""
    from bunraku.anatomy.names.bone_names import rig_axes
    from bunraku.core.geometry.axes import upright_rotation
    from bunraku.files import rotated

    rig = character.rig
    assert rig is not None
    axes = rig_axes(rig.names, rig.parents, rig.positions)
    if axes is not None and axes != ("+y", "+z"):
        upright = upright_rotation(*axes)
        character = rotated(replace(character, source=None, avatar=None), *axes)
        rotations, positions = upright @ rotations @ upright.T, positions @ upright.T
    return character, rotations, positions


def _standing(motion: MeshMotion) -> Character:
    """A moving mesh in the first frame in which it stands."""
    starts = range(0, len(motion.vertices), _CHUNK)
    chunks = (np.asarray(motion.vertices[start : start + _CHUNK])[..., 1] for start in starts)
    heights = np.concatenate([chunk.mean(axis=1) - chunk.min(axis=1) for chunk in chunks])
    frame = int(tallest_steady(heights, motion.fps, TALL).argmax())
    return Character(motion.name, motion.vertices[frame], motion.faces)


def _registered(rest: Character, vertices: np.ndarray, fps: float) -> tuple[HandleMotion, Anatomy]:
    """How the predicted handles of a moving mesh move, by registration (section A.2 of TapMo), and its anatomy."""
    from bunraku.pipelines.animate import rig

    handles = rig(rest)
    areas = rest.areas
    parts = [
        handle_motion_of_mesh(
            rest.vertices, np.asarray(vertices[start : start + _CHUNK]), handles.weights, handles.positions, areas, fps
        )
        for start in range(0, len(vertices), _CHUNK)
    ]
    return HandleMotion.joined(parts), Anatomy.of(rest, handles)
