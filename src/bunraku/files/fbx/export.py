"""Write FBX: meshes, materials with their textures, joints, skin, shapes and clips.

The file is binary FBX 7.4, which Blender, Unity, Unreal, Maya, 3ds Max, Godot and three.js read.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.character import written_rig
from bunraku.core.files import atomic_write
from bunraku.core.geometry.axes import FileFrame
from bunraku.core.motion import checked_fps
from bunraku.errors import FormatError, OptionError
from bunraku.files.fbx.write_meshes import Look, Shape, add_mesh, file_matrices, meshes_of
from bunraku.files.fbx.write_motion import Bones, ShapeTrack, Track, add_bones, add_clips
from bunraku.files.fbx.write_objects import Objects, element, write_elements
from bunraku.files.gltf.write import writable

if TYPE_CHECKING:
    from bunraku.core.animation import PointAnimation
    from bunraku.core.character import Character, Handles


def write_fbx(
    animation: Animation | RigAnimation,
    path: Path,
    *,
    fps: float | None = None,
    name: str | None = None,
    up: str = "+y",
    unit: str = "cm",
) -> Path:
    """Write an animation of handles or of the bones of the character's own rig as FBX, with a clip of the file's or
    another name. Options are those of `save`; most FBX files are in "cm". FormatError if the file cannot be written;
    OptionError if an option makes no sense.
    """
    return write_clips({str(name) if name else path.stem: animation}, path, fps=fps, up=up, unit=unit)


def write_clips(
    clips: Mapping[str, Animation] | Mapping[str, RigAnimation] | Mapping[str, Animation | RigAnimation],
    path: Path,
    *,
    fps: float | None = None,
    up: str = "+y",
    unit: str = "cm",
) -> Path:
    """Write several animations of one character, by the same handles or the same bones, each as a clip of its name.
    Options and errors are those of `write_fbx`.
    """
    first = next(iter(clips.values()))
    moved = {name: clip.at(checked_fps(fps, clip.fps)) for name, clip in clips.items()}
    bones = Bones.of_rig(first.rig) if isinstance(first, RigAnimation) else Bones.of_handles(first.handles)
    tracks = {name: _track(bones, clip) for name, clip in moved.items()}
    return _write(first.character, bones, tracks, path, up, unit)


def write_points(
    animation: PointAnimation,
    path: Path,
    *,
    fps: float | None = None,
    name: str | None = None,
    up: str = "+y",
    unit: str = "cm",
    tolerance: float | None = None,
    shapes: str = "auto",
) -> Path:
    """Write an animation whose vertices also move on their own, by bones of their own or by shapes; `tolerance` and
    `shapes` are those of `files.gltf.write_points.fitted_points`, other options and errors those of `write_fbx`.
    OptionError if bones do not come as near as the tolerance.
    """
    from bunraku.files.gltf.write_points import fitted_points

    moved = animation.at(checked_fps(fps, animation.motion.fps))
    fitted = fitted_points(moved, tolerance, shapes)
    bones = Bones.of_handles(fitted.animation.handles, fitted.names)
    title, found = str(name) if name else path.stem, fitted.shapes
    extra: np.ndarray | None = None
    if found is not None:
        extra = np.zeros((len(found.shapes), len(moved.character.vertices), 3))
        extra[:, fitted.moving] = found.shapes
    tracks = {title: _track(bones, fitted.animation)}
    keys = None if found is None else (found.frames, found.weights)
    return _write(moved.character, bones, tracks, path, up, unit, extra, keys)


def write_character(
    character: Character, handles: Handles | None, path: Path, *, rig: bool = False, up: str = "+y", unit: str = "cm"
) -> Path:
    """Write a character without motion, with its handles or its rig as a skin where there are some. CharacterError if
    the handles weigh another number of vertices, or there is no rig to write; FormatError if the file cannot be
    written; OptionError if an option makes no sense.
    """
    bones = None
    if handles is not None:
        handles.check_vertices(len(character.vertices), character.name)
        bones = Bones.of_handles(handles)
    if rig:
        bones = Bones.of_rig(written_rig(character))
    return _write(character, bones, {}, path, up, unit)


def _track(bones: Bones, clip: Animation | RigAnimation) -> Track:
    return bones.rig_track(clip) if isinstance(clip, RigAnimation) else bones.handle_track(clip)


def _write(
    character: Character,
    bones: Bones | None,
    tracks: Mapping[str, Track],
    path: Path,
    up: str,
    unit: str,
    shapes: np.ndarray | None = None,
    keys: tuple[np.ndarray, np.ndarray] | None = None,
) -> Path:
    """Write a character with what moves it and what the bones do in each clip; `shapes` are displacements of all
    vertices [m], shape (T, V, 3), and `keys` their frames and amounts in the one clip.
    """
    if path.suffix.lower() != ".fbx":
        raise OptionError(f"FBX is written to a file that ends in .fbx, not in {path.suffix or 'nothing'}")
    objects = Objects(FileFrame.of(up, unit), up, unit)
    with writable(path, character.name):
        document, meshes = meshes_of(character)
        look = Look(objects, document)
        joints = add_bones(objects, bones) if bones is not None else []
        models, played = [], []
        for mesh in meshes:
            moving = [] if shapes is None else [
                Shape(f"move_{number}", deltas[mesh.index]) for number, deltas in enumerate(shapes)
            ]  # fmt: skip
            moving = moving if any(deltas.offsets.any() for deltas in moving) else []
            model, channels = add_mesh(objects, mesh, moving, character, look, bones, joints)
            models.append(model)
            if moving and keys is not None:
                played.append(ShapeTrack(channels[len(channels) - len(moving) :], *keys))
        if bones is not None:
            _add_bind_pose(objects, bones, joints, models)
            if tracks:
                add_clips(objects, tracks, bones, joints, dict.fromkeys(tracks, played))
    with atomic_write(path) as file:
        try:
            write_elements(file, objects.elements())
        except ValueError as error:
            raise FormatError(path, f"the FBX cannot be written ({error}); simplify the mesh first") from None
    return path


def _add_bind_pose(objects: Objects, bones: Bones, joints: list[int], models: list[int]) -> None:
    matrices = [*file_matrices(bones.bind, objects.frame), *(np.eye(4) for _ in models)]
    nodes = [
        element("PoseNode", children=[element("Node", np.int64(number)), element("Matrix", matrix.T.reshape(-1))])
        for number, matrix in zip([*joints, *models], matrices, strict=True)
    ]
    objects.add(
        "Pose", "BindPose", "BindPose", element("Type", "BindPose"), element("Version", 100),
        element("NbPoseNodes", len(nodes)), *nodes,
    )  # fmt: skip
