"""A motion from any file or folder that holds one."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.arguments import checked
from bunraku.core.motion import HandleMotion, MeshMotion, SkeletalMotion
from bunraku.errors import FormatError, MotionError
from bunraku.files import load_animation, load_character, load_skeleton_clip, read_motion

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
            motion = load_fbx_motion(path, clip or None, fps)
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
