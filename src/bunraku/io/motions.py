"""A motion from any file that holds one."""

from __future__ import annotations

from pathlib import Path

from bunraku.core.animation import Animation
from bunraku.core.mesh_motion import MeshMotion
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import FormatError, MotionError
from bunraku.io.mesh_folder import load_mesh_motion
from bunraku.io.play import load_animation
from bunraku.io.registry import read_motion

__all__ = ["Motion", "load_motion"]

Motion = SkeletalMotion | HandleMotion | Animation | RigAnimation | MeshMotion


CLIPS = (".glb", ".gltf", ".vrm", ".fbx")


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
    if path.is_dir():
        return load_mesh_motion(path, fps)
    suffix = path.suffix.lower()
    if suffix == ".npz":
        motion = read_motion(path)
        if isinstance(motion, SkeletalMotion):
            return motion
        from bunraku.io.clips import load_clip

        return load_clip(path).of_the_reference_body()
    if suffix == ".vmd":
        from bunraku.retarget.mmd.standard import vmd_motion

        return vmd_motion(path, fps=fps)
    if suffix not in CLIPS:
        return read_motion(path)
    if suffix == ".glb":
        own = _own_clip(path)
        if own is not None:
            return own
    if suffix == ".fbx":
        from bunraku.formats.fbx.motion import load_fbx_motion
        from bunraku.skeletons.skeleton_map import map_skeleton

        try:  # of a person a skeleton is enough
            motion = load_fbx_motion(path, clip or None, fps)
            map_skeleton(motion.skeleton)
            return motion
        except (MotionError, FormatError):
            pass

    return load_animation(path, clip, fps)


def _own_clip(path: Path) -> Animation | HandleMotion | None:
    """The clip of a GLB that Bunraku wrote, None for other files: the motion of the reference body, or, of one that was
    made for a body of its own kind, with that body.
    """
    from bunraku.io.clips import load_clip, load_clip_animation

    try:
        found = load_clip(path)
    except (FormatError, MotionError):
        return None
    known = found.reference
    return known if known is not None and not known.own_kind else load_clip_animation(path)
