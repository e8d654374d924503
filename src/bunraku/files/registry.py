"""The registry of formats: how a file is recognised, what reads and writes it, and in which unit its lengths are."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.animation import Animation, PointAnimation, RigAnimation
from bunraku.core.avatars import MmdModel, VrmModel
from bunraku.core.character import Character, Handles
from bunraku.core.files import MAX_BYTES, MAX_TEXT_BYTES, check_input, check_output_folder, open_input
from bunraku.core.geometry.axes import BARE, UNITS, axis_name, default_orientation, likely_unit
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.core.saving import provided
from bunraku.errors import BunrakuError, CharacterError, FormatError, MotionError, OptionError, WeightsError
from bunraku.files.gltf.read import scaled

__all__ = [
    "UNIT_CHOICES",
    "FORMATS",
    "Format",
    "UNIT_NAMES",
    "SettledUnit",
    "check_points_writer",
    "check_unit",
    "check_writer",
    "check_writes",
    "detect",
    "in_metres",
    "load_character",
    "load_with_clips",
    "read_motion",
    "resolve_unit",
    "save",
    "save_animation",
    "save_character",
    "save_motion",
    "save_points",
]


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
        character="bunraku.files.gltf.read:read_gltf",
        motion="bunraku.files.gltf.vrma:read_glb_motion",
        animation="bunraku.files.gltf.write:write_animation",
        bones="bunraku.files.gltf.write_rig:save_rig_animation",
        points="bunraku.files.gltf.write_points:write_point_animation",
        rigged="bunraku.files.gltf.write_rig:write_character",
    ),
    Format(
        "VRM",
        (".vrm",),
        (b"glTF",),
        character="bunraku.files.gltf.read:read_gltf",
        rigged="bunraku.files.gltf.vrma:write_avatar",
    ),
    Format("glTF", (".gltf",), character="bunraku.files.gltf.read:read_gltf"),
    Format(
        "PLY",
        (".ply",),
        (b"ply\n", b"ply\r"),
        character="bunraku.files.meshes.ply:read_ply",
        animation="bunraku.files.meshes.obj:write_ply_sequence",
        points="bunraku.files.meshes.obj:write_ply_sequence",
    ),
    Format(
        "OBJ",
        (".obj",),
        character="bunraku.files.meshes.obj:read_obj",
        animation="bunraku.files.meshes.obj:write_obj_sequence",
        points="bunraku.files.meshes.obj:write_obj_sequence",
    ),
    Format(
        "USD",
        (".usd", ".usda", ".usdc", ".usdz"),
        animation="bunraku.files.usd:write_usd",
        bones="bunraku.files.usd:write_rig",
        points="bunraku.files.usd:write_points",
        available="bunraku.files.usd:check_available",
    ),
    Format("STL", (".stl",), character="bunraku.files.meshes.ply:read_stl"),
    Format(
        "handle motion",
        (".npz",),
        (b"PK\x03\x04",),
        motion="bunraku.files.motions.arrays:read_any_motion",
        animation="bunraku.files.motions.arrays:write_animation",
        parts=True,
        moved="write_motion_npz",
    ),
    Format("HumanML3D", (".npy",), (b"\x93NUMPY",), motion="bunraku.files.motions.arrays:read_humanml3d"),
    Format(
        "BVH",
        (".bvh",),
        (b"HIERARCHY",),
        motion="bunraku.files.motions.bvh:read_bvh",
        animation="write_humanoid_bvh",
        parts=True,
        moved="write_motion_bvh",
        largest=MAX_TEXT_BYTES,
    ),
    Format(
        "VRMA",
        (".vrma",),
        (b"glTF",),
        motion="bunraku.files.gltf.vrma:read_vrma",
        animation="write_humanoid_vrma",
        parts=True,
        moved="write_motion_vrma",
    ),
    Format(
        "FBX",
        (".fbx",),
        (b"Kaydara FBX Binary", b"; FBX"),
        character="bunraku.files.fbx.read:read_fbx",
        motion="bunraku.files.fbx.clips:read_motion",
        animation="bunraku.files.fbx.export:write_fbx",
        bones="bunraku.files.fbx.export:write_fbx",
        points="bunraku.files.fbx.export:write_points",
        rigged="bunraku.files.fbx.export:write_character",
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
        character="bunraku.files.mmd.read:read_pmx",
        rigged="bunraku.files.mmd.write:write_character",
    ),
    Format("PMD", (".pmd",), (b"Pmd",), character="bunraku.files.mmd.read:read_pmd"),
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


UNIT_CHOICES = ("auto", "m", "cm", "mm", "in")
UNIT_NAMES = {"m": "metres", "cm": "centimetres", "mm": "millimetres", "in": "inches", "": "unknown"}


@dataclass(frozen=True)
class SettledUnit:
    """How long the unit of a file is taken to be.

    Args:
        unit: One of `formats.frames.UNITS`.
        likely: What the height makes likely; "" where it is so small that nothing is.
        note: What to tell about it, without what to do; "" where there is nothing to tell.
    """

    unit: str
    likely: str
    note: str = ""


def check_unit(unit: str, option: str = "unit") -> None:
    """Raise OptionError unless this is a unit of characters or "auto"."""
    if unit not in UNIT_CHOICES:
        raise OptionError(f"{option}: '{unit}' is no unit of characters; there are {', '.join(UNIT_CHOICES)}")


def resolve_unit(height: float, suffix: str, unit: str = "auto") -> SettledUnit:
    """The unit of a character's file, from what is said about it, the rule of its format, and its height.

    Args:
        height: Its height as it was read, in metres where its format has a unit.
        suffix: The format; "" for a character of no file, which is in metres.
        unit: One of `CHOICES`. All but "auto" is taken for the unit of lengths as they were read.
    """
    likely, bare = likely_unit(height), suffix in BARE
    if unit != "auto":
        return SettledUnit(unit, likely)
    if likely == "m":
        return SettledUnit("m", likely)
    if not likely:
        return SettledUnit(
            "m", likely, f"{height:.2g} m tall: probably shrunk 100 or 1,000 times on its way; left as it is"
        )
    size = f"{height:,.4g} {'' if bare else 'm '}tall: probably {UNIT_NAMES[likely]}"
    if bare:
        return SettledUnit(likely, likely, f"{size}; taken as {height * UNITS[likely]:.3g} m")
    return SettledUnit("m", likely, f"{size}, against the unit of its format; left as it is")


def in_metres(character: Character, unit: str = "auto", up: str | None = None) -> tuple[Character, str]:
    """The character in metres, and what there is to tell about it.

    Args:
        character: As its file has it, lying or standing.
        unit: One of `CHOICES`.
        up: Its up axis where that is known. Where it is not, and the unit hangs on it, it is guessed from the shape.

    Raises:
        OptionError: It is none of them, or the unit of the file cannot be changed.
    """
    check_unit(unit)
    suffix = str(getattr(character.source, "suffix", ""))
    resolved = resolve_unit(_height(character, up, suffix if unit == "auto" else ""), suffix, unit)
    factor = UNITS[resolved.unit]
    return character if factor == 1 else scaled(character, factor), resolved.note if suffix in BARE else ""


def _height(character: Character, up: str | None, suffix: str) -> float:
    extents = np.ptp(character.vertices[character.surface], axis=0)
    if up is None and suffix in BARE and len({likely_unit(float(extent)) for extent in extents}) > 1:
        try:
            up = provided("resolve_axes")(character).up
        except WeightsError:
            up = None  # as it is read then, with +Y up
    return float(extents["xyz".index((up or "+y")[1])]) or character.height


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
    from bunraku.files.gltf.read import turned

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

    Skeletal motions keep their own joints; `bunraku.anatomy.names.to_smpl` turns them into ones of SMPL's 22.

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
            `bunraku.files.motions.bvh.write_bvh`; `name`, the clip's name, for .vrma.

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
