"""What each file is, by its first bytes and its suffix, and who reads and writes it."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.mmd_model import MmdModel
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.core.point_animation import PointAnimation
from bunraku.core.rig_animation import RigAnimation
from bunraku.core.saving import provided
from bunraku.core.vrm_model import VrmModel
from bunraku.errors import BunrakuError, CharacterError, FormatError, MotionError, OptionError
from bunraku.formats.files import check_input, check_output_folder, open_input
from bunraku.geometry.axes import axis_name, default_orientation
from bunraku.io.table import FORMATS, Format
from bunraku.io.units import check_unit, in_metres

__all__ = [
    "check_points_writer",
    "check_writer",
    "check_writes",
    "detect",
    "load_character",
    "read_motion",
    "load_with_clips",
    "save",
    "save_animation",
    "save_character",
    "save_motion",
    "save_points",
]


_log = logging.getLogger(__name__)
_ABILITIES = {
    "character": "characters are read from",
    "motion": "motions are read from",
    "animation": "animations are written to",
    "bones": "animations of rigs are written to",
    "moved": "motions are written to",
    "points": "vertices that move on their own are written to",
    "rigged": "characters are written to",
}


def detect(path: Path, start: bytes, ability: str) -> Format:
    """The format of a file, by its magic bytes first and its suffix second.

    Args:
        path: The file.
        start: Its first bytes, empty for a file that is to be written.
        ability: What the format must be able to do: a field of `Format`.

    Raises:
        FormatError: No format that can do this is recognised; the message lists those that can.
    """
    suffix = path.suffix.lower()
    found = next((f for f in FORMATS if any(start.startswith(magic) for magic in f.magic)), None)
    if found is None and start.lstrip()[:1] == b"{" and suffix in (".glb", ".vrm"):
        suffix = ".gltf"
    found = found or next(
        (f for f in FORMATS if suffix in f.suffixes and (not start or not f.magic or not f.character)), None
    )
    if found is not None and getattr(found, ability):
        return found
    if found is None and start and any(suffix in f.suffixes for f in FORMATS):
        raise FormatError(
            path,
            f"its contents are not those of a {suffix} file; it is broken or has the wrong suffix, export it again",
        )
    known = ", ".join(known_suffix for f in FORMATS if getattr(f, ability) for known_suffix in f.suffixes)
    what = f"'{suffix}'" if suffix else "a file without a suffix"
    hint = "; export it as GLB, for example with Blender" if ability == "character" else ""
    raise FormatError(path, f"{what} is not a format for this; {_ABILITIES[ability]} {known}{hint}")


def _resolve(target: str) -> Callable[..., Any]:
    if ":" not in target:
        return provided(target)
    module, name = target.split(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    return function


def _read(path: str | Path, ability: str, **options: object) -> Any:
    path = Path(path)
    size = check_input(path)
    try:
        with open_input(path) as file:  # once, so that what is told apart is what is read
            found = detect(path, file.read(64), ability)
            if size > found.largest:
                raise FormatError(
                    path,
                    f"{size >> 20} MiB are too many for a {found.title} file, at most {found.largest >> 20} are read; "
                    "cut it into parts",
                )
            file.seek(0)
            data = file.read(size)  # a larger number would be set aside in memory first
    except OSError as error:
        raise FormatError(
            path, f"the file cannot be read ({(error.strerror or str(error)).lower()}); check its permissions"
        ) from None
    except MemoryError:
        raise FormatError(path, "it does not fit into memory; simplify the mesh first") from None
    function = _resolve(getattr(found, ability))
    try:
        with np.errstate(all="ignore"):  # broken numbers are found by what they lead to
            known = _parameters(function)
            return function(path, data, **{name: value for name, value in options.items() if name in known})
    except CharacterError as error:
        raise CharacterError(f"{path}: {str(error).removeprefix(f'{path.stem}: ')}") from None
    except MotionError as error:
        raise MotionError(f"{path}: {error}") from None
    except BunrakuError:
        raise
    except MemoryError:
        raise FormatError(path, "it does not fit into memory; simplify the mesh first") from None
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        # The readers check what they use; this is the net below them for broken files that nobody thought of.
        raise FormatError(
            path, f"the file is broken ({type(error).__name__}: {str(error)[:80]}); export it again"
        ) from error


def load_character(
    path: str | Path,
    *,
    rest: str = "bind",
    up: str | None = None,
    front: str | None = None,
    unit: str = "auto",
    clips: float | None = None,
) -> Character:
    """Read a character from GLB, glTF, VRM, FBX, OBJ, PLY or STL.

    The vertices of GLB, glTF, VRM and FBX are in world space, those of FBX turned from the frame and unit that the file
    states.
    OBJ, PLY and STL name neither: they are taken as they are, +Y up and +Z forward, and in the unit that makes their
    height a character's, which a warning of the log tells where it is not the metre.

    Args:
        path: The file; its first bytes decide the format where they can, its suffix otherwise.
        rest: The rest pose of a file with a skin: "bind", the pose that its meshes were skinned in (T or A for most),
            or "default", that of its nodes, which may be the middle of a clip. Files whose bind pose makes no sense
            take the default.
        up: The axis that is up in the character as it would be read without this, such as "+z"; it is turned to stand
            along +Y. `bunraku.upright` finds out by itself.
        front: The axis that it faces; "-y" with "+z" up, "+z" otherwise, when only `up` is given.
        unit: The unit of lengths as they would be read without this: "m", "cm", "mm" or "in". "auto" is the metre for
            formats that have a unit, and for the others what the height makes likely (`formats.frames.likely_unit`).
        clips: Frames a second at which the clips of an FBX file are read [1/s], so that what is written on its own
            skeleton has them too; None leaves them out. Those of glTF are there in any case.

    Raises:
        FormatError: The file is missing, empty, too large, broken, or of no known format.
        CharacterError: It holds no usable mesh: points only, coordinates that are not numbers, no extent.
        OptionError: `rest` is neither, `unit` is none of these, or `up` and `front` are not two axes at a right angle.
    """
    if rest not in ("bind", "default"):
        raise OptionError(f"the rest pose of a file is 'bind' or 'default', not {rest!r}")
    axes = [None if axis is None else axis_name(axis) for axis in (up, front)]
    check_unit(unit)
    character: Character = _read(path, "character", rest=rest, clip_fps=clips)
    standing = None if axes == [None, None] else default_orientation(*axes)
    if unit != "m":
        character, note = in_metres(character, unit, None if standing is None else standing[0])
        if note:
            _log.warning('%s: %s; say unit="m" to keep its numbers', path, note)
    if standing is None:
        return character
    from bunraku.formats.gltf.turning import turned

    return turned(character, *standing)


def load_with_clips(path: str | Path, fps: float) -> Character:
    """Read a character as `load_character` does, its document with all clips of the file.

    Args:
        path: The file.
        fps: Frames a second of clips that the document cannot hold as the file has them, those of FBX [1/s].

    Raises:
        FormatError: As `load_character`.
        CharacterError: As `load_character`.
    """
    character: Character = _read(path, "character", clip_fps=fps)
    return character


def read_motion(path: str | Path) -> HandleMotion | SkeletalMotion:
    """Read a motion: a handle motion that `Animation.save` wrote to NPZ, or a skeletal one of BVH, VRMA, AMASS (.npz),
    HumanML3D (.npy), or the first clip of FBX.

    Skeletal motions keep their own joints; `bunraku.skeletons.to_smpl` turns them into ones of SMPL's 22.

    Args:
        path: The file.

    Raises:
        FormatError: The file is missing, empty, too large, broken, or of no known format.
        MotionError: What it holds breaks the rules of a motion.
    """
    motion: HandleMotion | SkeletalMotion = _read(path, "motion")
    return motion


def save(
    thing: Animation | RigAnimation | PointAnimation | HandleMotion | SkeletalMotion,
    path: str | Path,
    **options: object,
) -> Path:
    """Write a motion or an animation of any kind in the format that the suffix names; `.save()` of all types ends here.

    An animation of a character's own rig goes to .glb with the file's own nodes, skins and materials, to .usd and .fbx
    as its bones in their tree under their names, to .vmd as the bones of an MMD model, to the formats that speak of a
    person's parts as that of its 30 handles, and to all others as its bones move the mesh.

    Raises:
        FormatError: The suffix is unknown, or the file cannot be written.
        OptionError: The format has no such option, or its value makes no sense.
    """
    if isinstance(thing, RigAnimation):
        return _save_rig_animation(thing, path, options)
    if isinstance(thing, PointAnimation):
        return save_points(thing, path, **options)
    return (
        save_motion(thing, path, **options)
        if isinstance(thing, HandleMotion | SkeletalMotion)
        else save_animation(thing, path, **options)
    )


def _save_rig_animation(animation: RigAnimation, path: str | Path, options: dict[str, object]) -> Path:
    found = detect(Path(path), b"", "animation")
    if found.bones:
        return _write("bones", path, options, animation)
    if found.parts:
        return _write("animation", path, options, provided("handle_animation")(animation))
    return _write("animation", path, options, animation.animation())


def save_animation(animation: Animation, path: str | Path, **options: object) -> Path:
    """Write an animation in the format that the suffix names.

    .glb, .fbx, .usd, .usda, .usdc and .usdz hold the character with its skin and motion, .obj and .ply a sequence of
    meshes, .bvh and .vrma what the humanoid skeleton does, .vmd the bones of an MMD model, .npz the handle motion,
    .mp4, .webp and .gif a video, .png a contact sheet, .html a page that shows it.

    Args:
        animation: The animation.
        path: The file. `walk.obj` becomes a folder `walk` with `walk_0000.obj`, `walk_0001.obj` and so on.
        **options: `fps`, frames a second of the output [1/s], for all but .npz and .vmd; `up` ("+y" or "+z") and `unit`
            ("m", "cm", ...) for USD, .obj, .ply and .bvh; and what the writers of single formats have besides
            (docs/files.md).

    Returns:
        The file or folder that was written.

    Raises:
        FormatError: The suffix is unknown, or the file cannot be written.
        OptionError: The format has no such option, or its value makes no sense.
    """
    return _write("animation", path, options, animation)


def save_motion(motion: HandleMotion | SkeletalMotion, path: str | Path, **options: object) -> Path:
    """Write a motion without a character: .bvh, .vrma, or .npz for a handle motion.

    Args:
        motion: A skeletal motion, or a handle motion of the reference body, which is written as that of its 22 joints.
        path: The file.
        **options: `fps`, frames a second of the output [1/s], for all but .npz; `unit`, `up` and `order` for .bvh, see
            `bunraku.formats.bvh.write.write_bvh`; `name`, the clip's name, for .vrma.

    Returns:
        The file that was written.

    Raises:
        FormatError: The suffix is unknown, or the file cannot be written.
        MotionError: A handle motion of fewer handles than the reference body has, or a skeleton that is no humanoid,
            for .vrma.
        OptionError: The format has no such option, its value makes no sense, or the motion has no frame.
    """
    return _write("moved", path, options, motion)


def check_writer(path: str | Path) -> None:
    """Make sure that what writes animations to files of this suffix is installed, before anything is made that is to be
    written.

    Raises:
        BunrakuError: An optional library or program is missing; the message says which.
        FormatError: The suffix is unknown.
    """
    path = Path(path)
    if check := detect(path, b"", "animation").available:
        _resolve(check)()


def check_writes(path: str | Path, character: Character) -> None:
    """Make sure that files of this suffix can hold what a character does, before anything is made to be written.

    Raises:
        FormatError: They cannot: a VMD is of MMD models alone; or the suffix is unknown.
    """
    path = Path(path)
    if check := detect(path, b"", "animation").suits:
        _resolve(check)(character, path)


def check_points_writer(path: str | Path) -> None:
    """Make sure that files of this suffix hold vertices that move on their own, as learned apparel does, before
    anything is made that is to be written.

    Raises:
        FormatError: They do not; the message lists those that do.
    """
    detect(Path(path), b"", "points")


def save_character(
    character: Character,
    path: str | Path,
    handles: Handles | None = None,
    *,
    rig: bool = False,
    avatar: MmdModel | VrmModel | None = None,
) -> Path:
    """Write a character to GLB, FBX, VRM or PMX, its handles as a skin, without motion.

    Args:
        character: The character.
        path: The file.
        handles: Its handles; without them the mesh alone is written.
        rig: Write the character's own rig as its skin, as `bunraku.with_skeleton` makes one, in place of handles.
        avatar: What else is to be written, by the bones of that rig: springs for GLB and VRM, rigid bodies for PMX.

    Returns:
        The file that was written.

    Raises:
        FormatError: The suffix is unknown, or the file cannot be written.
        CharacterError: The handles weigh another number of vertices.
    """
    options: dict[str, object] = {"rig": True} if rig else {}
    if avatar is not None:
        options["avatar"] = avatar
    return _write("rigged", path, options, character, handles)


def save_points(animation: PointAnimation, path: str | Path, **options: object) -> Path:
    """Write an animation whose vertices also move on their own: .glb, USD, or a sequence of .obj or .ply files.

    Args:
        animation: The animation.
        path: The file.
        **options: `fps`, frames a second of the output [1/s]; and those of the format.

    Returns:
        The file or folder that was written.

    Raises:
        FormatError: The suffix is unknown, or the file cannot be written.
        OptionError: The format has no such option, or its value makes no sense.
    """
    return _write("points", path, options, animation)


def _write(ability: str, path: str | Path, options: dict[str, object], *things: Any) -> Path:
    path = Path(path)
    if os.path.isdir(path):
        raise FormatError(path, "this is a folder; name a file inside it")
    function = _resolve(getattr(detect(path, b"", ability), ability))
    known = {name for name, parameter in _parameters(function).items() if parameter.kind is parameter.KEYWORD_ONLY}
    for option in options:
        if option not in known:
            raise OptionError(
                f"{path.suffix} files have no option '{option}'; they have: {', '.join(sorted(known)) or 'none'}"
            )
    check_output_folder(path)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        out: Path = function(*things, path, **options)
    return out


def _parameters(function: Callable[..., Any]) -> dict[str, Any]:
    import inspect

    return dict(inspect.signature(function).parameters)
