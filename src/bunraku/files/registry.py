"""The registry of formats: how a file is recognised, what reads and writes it, and in which unit its lengths are."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.animation import Animation, PointAnimation, RigAnimation
from bunraku.core.avatars import MmdModel, VrmModel
from bunraku.core.body.corrections import read_corrections
from bunraku.core.character import Character, Handles
from bunraku.core.files import MAX_BYTES, MAX_TEXT_BYTES, check_input, check_output_folder, open_input
from bunraku.core.geometry.axes import BARE, UNITS, axis_name, default_orientation, likely_unit
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.core.request import checked
from bunraku.core.saving import provided
from bunraku.errors import BunrakuError, CharacterError, FormatError, MotionError, OptionError, WeightsError
from bunraku.files.gltf.read import rotated, scaled

_USD = (".usd", ".usda", ".usdc", ".usdz")

READERS: dict[str, dict[str, str]] = {
    "character": {
        ".glb": "bunraku.files.gltf.read:read_gltf",
        ".vrm": "bunraku.files.gltf.read:read_gltf",
        ".gltf": "bunraku.files.gltf.read:read_gltf",
        ".ply": "bunraku.files.meshes.ply:read_ply",
        ".obj": "bunraku.files.meshes.obj:read_obj",
        ".stl": "bunraku.files.meshes.ply:read_stl",
        ".fbx": "bunraku.files.fbx.read:read_fbx",
        ".pmx": "bunraku.files.mmd.read:read_model",
        ".pmd": "bunraku.files.mmd.read:read_model",
    },
    "motion": {
        ".glb": "bunraku.files.gltf.vrma:read_glb_motion",
        ".npz": "bunraku.files.motions.arrays:read_any_motion",
        ".npy": "bunraku.files.motions.arrays:read_humanml3d",
        ".bvh": "bunraku.files.motions.bvh:read_bvh",
        ".vrma": "bunraku.files.gltf.vrma:read_vrma",
        ".fbx": "bunraku.files.fbx.clips:read_motion",
    },
}
"""What makes a character or a motion of a path and its bytes, by the suffix.

Functions are named as "module:function" and imported when a file is read or written. A name without a module is a
function of a room above, such as a renderer, which `core.saving.provide` makes known.
"""

WRITERS: dict[str, dict[str, str]] = {
    "animation": {
        ".glb": "bunraku.files.gltf.write:write_animation",
        ".ply": "bunraku.files.meshes.obj:write_ply_sequence",
        ".obj": "bunraku.files.meshes.obj:write_obj_sequence",
        **dict.fromkeys(_USD, "bunraku.files.usd:write_usd"),
        ".npz": "bunraku.files.motions.arrays:write_animation",
        ".bvh": "write_humanoid_bvh",
        ".vrma": "write_humanoid_vrma",
        ".fbx": "bunraku.files.fbx.export:write_fbx",
        ".vmd": "write_character_vmd",
        ".html": "write_html",
        **dict.fromkeys((".mp4", ".webp", ".gif", ".png"), "save_preview"),
    },
    "rig animation": {
        ".glb": "bunraku.files.gltf.write_rig:save_rig_animation",
        **dict.fromkeys(_USD, "bunraku.files.usd:write_usd"),
        ".fbx": "bunraku.files.fbx.export:write_fbx",
        ".vmd": "write_character_vmd",
        ".html": "write_html",
    },
    "points": {
        ".glb": "bunraku.files.gltf.write_points:write_point_animation",
        ".ply": "bunraku.files.meshes.obj:write_ply_sequence",
        ".obj": "bunraku.files.meshes.obj:write_obj_sequence",
        **dict.fromkeys(_USD, "bunraku.files.usd:write_points"),
        ".fbx": "bunraku.files.fbx.export:write_points",
        ".html": "write_html",
        **dict.fromkeys((".mp4", ".webp", ".gif", ".png"), "save_preview"),
    },
    "motion": {".npz": "write_motion_npz", ".bvh": "write_motion_bvh", ".vrma": "write_motion_vrma"},
    "character": {
        ".glb": "bunraku.files.gltf.write_rig:write_character",
        ".vrm": "bunraku.files.gltf.vrma:write_avatar",
        ".fbx": "bunraku.files.fbx.export:write_character",
        ".pmx": "bunraku.files.mmd.write:write_character",
    },
}
"""What writes an animation of handles, one of a character's own rig, one whose vertices also move on their own, a
motion without a character, and a character without motion to a path, by the suffix.

An animation of a rig whose suffix is not among its own goes to the writer of animations: as that of the 30 handles to
`_OF_PARTS`, and to all others as the rig's bones move the mesh.
"""

_OF_PARTS = (".npz", ".bvh", ".vrma")
"""Formats that hold the motion of a person's parts."""
_MAGIC = {
    b"glTF": ".glb", b"ply\n": ".ply", b"ply\r": ".ply", b"PK\x03\x04": ".npz", b"\x93NUMPY": ".npy",
    b"HIERARCHY": ".bvh", b"Kaydara FBX Binary": ".fbx", b"; FBX": ".fbx", b"Vocaloid Motion Data": ".vmd",
    b"PMX ": ".pmx", b"Pmd": ".pmd",
}  # fmt: skip
"""First bytes that name a format whatever the suffix says."""
_MARKED = READERS["character"].keys() & {*_MAGIC.values(), ".vrm"}
"""Suffixes of characters whose files are read only where they begin as they should."""
_LARGEST = {".bvh": MAX_TEXT_BYTES}
"""Largest file that is opened at all, where that is less than `MAX_BYTES` [bytes]."""

UNIT_CHOICES = ("auto", "m", "cm", "mm", "in")
UNIT_NAMES = {"m": "metres", "cm": "centimetres", "mm": "millimetres", "in": "inches", "": "unknown"}


@dataclass(frozen=True)
class SettledUnit:
    """The unit that a file's lengths are taken to have."""

    unit: str  # one of `core.geometry.axes.UNITS`
    likely: str  # what the height makes likely; "" where it is too small to tell
    note: str = ""  # what to say about it; "" for nothing


def check_unit(unit: str, option: str = "unit") -> None:
    """Raise OptionError unless this is a unit of characters or "auto"."""
    if unit not in UNIT_CHOICES:
        raise OptionError(f"{option}: '{unit}' is not a unit of characters; there are {', '.join(UNIT_CHOICES)}")


def resolve_unit(height: float, suffix: str, unit: str = "auto") -> SettledUnit:
    """The unit of a character's file, from what the user says (one of `UNIT_CHOICES`: all but "auto" is the unit of
    lengths as they were read), the rule of its format ("" for no file, in metres), and its height as it was read, in
    metres where its format has a unit.
    """
    likely, bare = likely_unit(height), suffix in BARE
    if unit != "auto":
        return SettledUnit(unit, likely)
    if likely == "m":
        return SettledUnit("m", likely)
    if not likely:
        note = f"{height:.2g} m tall: probably shrunk 100 or 1,000 times on its way; left as it is"
        return SettledUnit("m", likely, note)
    size = f"{height:,.4g} {'' if bare else 'm '}tall: probably {UNIT_NAMES[likely]}"
    if bare:
        return SettledUnit(likely, likely, f"{size}; taken as {height * UNITS[likely]:.3g} m")
    return SettledUnit("m", likely, f"{size}, against the unit of its format; left as it is")


def in_metres(character: Character, unit: str = "auto", up: str | None = None) -> tuple[Character, str]:
    """The character, lying or standing as its file has it, in metres, and a note about it. Where its unit depends on
    the up axis and that is not given, it is guessed from the shape. OptionError if there is no such unit, or that of
    the file cannot be changed.
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
_PLURALS = {
    "character": "characters",
    "motion": "motions",
    "animation": "animations",
    "points": "vertices that move on their own",
}


def _suffix_of(path: Path, kind: str, start: bytes = b"") -> str:
    """The suffix of a file's format, by its first bytes if it is read, and by its own suffix otherwise; `kind` is a key
    of `READERS`, or of `WRITERS` for a file that is written. FormatError if no format of this kind is recognised; the
    message lists those that are.
    """
    functions = READERS[kind] if start else WRITERS[kind]
    suffix = path.suffix.lower()
    by_magic = next((magic_suffix for magic, magic_suffix in _MAGIC.items() if start.startswith(magic)), "")
    if not by_magic and start.lstrip()[:1] == b"{" and suffix in (".glb", ".vrm"):
        suffix = ".gltf"
    if not by_magic and start and suffix in _MARKED:
        problem = f"its contents are not those of a {suffix} file; it is broken or has the wrong suffix"
        raise FormatError(path, f"{problem}, export it again")
    by_magic = by_magic or suffix
    if by_magic in functions:
        return by_magic
    subject = f"'{suffix}'" if suffix else "a file without a suffix"
    hint = "; export it as GLB, for example with Blender" if start and kind == "character" else ""
    done = f"{_PLURALS[kind]} are {'read from' if start else 'written to'}"
    raise FormatError(path, f"{subject} is not a format for this; {done} {', '.join(functions)}{hint}")


def _resolve(target: str) -> Callable[..., Any]:
    if ":" not in target:
        return provided(target)
    module, name = target.split(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    return function


def holds_character(path: Path) -> bool:
    """Whether a file holds a character, with or without clips, and not only a motion. Folders hold frames of a moving
    mesh. FormatError if the file is missing, or its kind is unknown.
    """
    if os.path.isdir(path):  # unlike Path.is_dir, no name makes it raise
        return False
    size = check_input(path)
    with open_input(path) as file:
        start = file.read(64)
        try:
            suffix = _suffix_of(path, "character", start)
        except FormatError:
            if path.suffix.lower() != ".vmd":
                _suffix_of(path, "motion", start)
            return False
        if suffix not in (".glb", ".gltf", ".vrm", ".fbx"):
            return True
        file.seek(0)
        data = file.read(size)
    if suffix == ".fbx":
        from bunraku.files.fbx.read import fbx_facts

        return bool(fbx_facts(path, data)["meshes"])
    from bunraku.files.gltf.open import open_document

    return bool(open_document(path, data).items("meshes"))


def _read(path: str | Path, kind: str, **options: object) -> Any:
    path = Path(path)
    size = check_input(path)
    try:
        with open_input(path) as file:  # once, so that the bytes that name the format are those that are read
            suffix = _suffix_of(path, kind, file.read(64))
            most = _LARGEST.get(suffix, MAX_BYTES)
            if size > most:
                problem = f"{size >> 20} MiB are too many for {suffix}, at most {most >> 20} are read"
                raise FormatError(path, f"{problem}; cut it into parts")
            file.seek(0)
            data = file.read(size)  # a larger number would be set aside in memory first
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise FormatError(path, f"the file cannot be read ({reason}); check its permissions") from None
    except MemoryError:
        raise FormatError(path, "it does not fit into memory; simplify the mesh first") from None
    function = _resolve(READERS[kind][suffix])
    try:
        with np.errstate(all="ignore"):  # broken numbers are found by what they lead to
            parameters = _parameters(function)
            return function(path, data, **{name: value for name, value in options.items() if name in parameters})
    except CharacterError as error:
        raise CharacterError(f"{path}: {str(error).removeprefix(f'{path.stem}: ')}") from None
    except MotionError as error:
        raise MotionError(f"{path}: {error}") from None
    except BunrakuError:
        raise
    except MemoryError:
        raise FormatError(path, "it does not fit into memory; simplify the mesh first") from None
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        # The readers check what they use; this is the net below them for damage that no check expects.
        reason = f"{type(error).__name__}: {str(error)[:80]}"
        raise FormatError(path, f"the file is broken ({reason}); export it again") from error


@checked
def load_character(
    path: str | Path,
    *,
    rest: str = "bind",
    up: str | None = None,
    front: str | None = None,
    unit: str = "auto",
    clips: float | None = None,
) -> Character:
    """Read a character from GLB, glTF, VRM, FBX, PMX, PMD, OBJ, PLY or STL.

    A file of corrections beside it, such as hero.body.toml beside hero.glb (docs/files.md), comes along.

    Vertices are in world space, those of FBX in metres and +Y up by the frame and unit that the file states. OBJ, PLY
    and STL state neither: they are taken as +Y up and +Z forward, in the unit that makes their height a character's;
    the log warns where that is not the metre.

    Args:
        path: The file; its first bytes decide the format where they can, its suffix otherwise.
        rest: The pose in which a file with a skin rests: "bind", in which its meshes were skinned (T or A for most), or
            "default", that of its nodes, which may be the middle of a clip. A bind pose that makes no sense is replaced
            by the default.
        up: The axis that is up in the character as it would be read without this, such as "+z". `bunraku.upright` finds
            out by itself.
        front: The axis that it faces; when only `up` is given, "-y" with "+z" up, else "+z".
        unit: The unit of lengths as they would be read without this: "m", "cm", "mm" or "in"; "auto" is the metre for
            formats that have a unit, and for the others what the height makes likely.
        clips: Frames a second at which the clips of an FBX file are read [1/s], so that they are kept when its own
            skeleton is written; None leaves them out. Those of glTF are always there.

    Raises:
        FormatError: The file is missing, empty, too large, broken, or of no known format.
        CharacterError: It holds no usable mesh: points only, coordinates that are not numbers, no extent.
        OptionError: An option is none of these, or `up` and `front` are not at a right angle.
    """
    if rest not in ("bind", "default"):
        raise OptionError(f"the rest pose of a file is 'bind' or 'default', not {rest!r}")
    axes = [None if axis is None else axis_name(axis) for axis in (up, front)]
    check_unit(unit)
    character = _read_character(path, rest=rest, clip_fps=clips)
    standing = None if axes == [None, None] else default_orientation(*axes)
    if unit != "m":
        character, note = in_metres(character, unit, None if standing is None else standing[0])
        if note:
            _log.warning('%s: %s; say unit="m" to keep its numbers', path, note)
    return character if standing is None else rotated(character, *standing)


def load_with_clips(path: str | Path, fps: float) -> Character:
    """Read a character with its file's clips; those of FBX at a rate [1/s]. Errors are those of `load_character`."""
    return _read_character(path, clip_fps=fps)


def _read_character(path: str | Path, **options: object) -> Character:
    """The character of a file, with what the file of corrections beside it says."""
    character: Character = _read(path, "character", **options)
    return replace(character, corrections=read_corrections(Path(path)))


def read_motion(path: str | Path) -> HandleMotion | SkeletalMotion:
    """Read a motion: a handle motion from NPZ, or a skeletal one with its own joints from BVH, VRMA, AMASS (.npz),
    HumanML3D (.npy), or the first clip of FBX. FormatError if the file is missing, empty, too large, broken, or of no
    known format; MotionError if what it holds breaks the rules of a motion.
    """
    motion: HandleMotion | SkeletalMotion = _read(path, "motion")
    return motion


_KINDS: tuple[tuple[type | tuple[type, ...], str], ...] = (
    (RigAnimation, "rig animation"),
    (PointAnimation, "points"),
    (Animation, "animation"),
    ((HandleMotion, SkeletalMotion), "motion"),
)


def save(
    thing: Animation | RigAnimation | PointAnimation | HandleMotion | SkeletalMotion,
    path: str | Path,
    **options: object,
) -> Path:
    """Write a motion or an animation of any kind in the format that the suffix names; `.save()` of all types ends here.

    .glb, .fbx and USD hold the character with its skin and motion, .obj and .ply a folder with one mesh a frame
    (`walk.obj` becomes `walk/walk_0000.obj` and so on), .bvh and .vrma what the humanoid skeleton does, .vmd the bones
    of an MMD model, .npz the handle motion, .mp4, .webp and .gif a video, .png a contact sheet, .html a page that shows
    the animation. An animation of a character's own rig keeps the file's nodes, skins and materials in a .glb, and its
    bones in their tree under their names in .fbx and USD. A motion goes to .bvh, .vrma or .npz; one of handles must be
    that of the reference body.

    Args:
        thing: What to write.
        path: The file.
        **options: `fps`, frames a second of the output [1/s], for all but .npz and .vmd; `up` ("+y" or "+z") and `unit`
            ("m", "cm", ...) for FBX, USD, .obj, .ply and .bvh; and those of single formats (docs/files.md).

    Returns:
        The file or folder that was written.

    Raises:
        FormatError: The suffix is unknown, or the file cannot be written.
        MotionError: The motion has fewer handles than the reference body, or its skeleton is no humanoid.
        OptionError: The format has no such option, its value makes no sense, or the motion has no frame.
    """
    if isinstance(thing, Animation) and Path(path).suffix.lower() not in _OF_PARTS:
        from bunraku.files.gltf.write_rig import with_still

        thing = with_still(thing)
    kind = next(name for types, name in _KINDS if isinstance(thing, types))
    if isinstance(thing, RigAnimation):
        suffix = _suffix_of(Path(path), "animation")
        if suffix not in WRITERS[kind]:
            kind = "animation"
            thing = provided("handle_animation")(thing) if suffix in _OF_PARTS else thing.animation()
    return _write(kind, path, options, thing)


def check_writer(path: str | Path, *, points: bool = False, mmd: bool = True) -> None:
    """Make sure, before anything is computed, that an animation can be written to a file: one of `points` that also
    move on their own, as learned apparel does, or of an MMD model, as a VMD must be. MissingExtraError if an optional
    library is missing; FormatError if the suffix is unknown, or such files cannot hold the character.
    """
    suffix = _suffix_of(Path(path), "points" if points else "animation")
    if suffix in _USD:
        _resolve("bunraku.files.usd:check_available")()
    if suffix == ".vmd" and not mmd:
        problem = "a VMD moves the bones of an MMD model, which this character is not"
        raise FormatError(path, f"{problem}; transfer onto a .pmx or .pmd, or write a .bvh or .vrma")


@checked
def save_character(
    character: Character,
    path: str | Path,
    handles: Handles | None = None,
    *,
    rig: bool = False,
    avatar: MmdModel | VrmModel | None = None,
) -> Path:
    """Write a character to GLB, FBX, VRM or PMX, without motion, and return the path.

    Args:
        character: The character.
        path: The file.
        handles: The handles for its skin; without them the mesh alone is written.
        rig: Write the character's own rig as its skin, as `bunraku.with_skeleton` makes one, in place of handles.
        avatar: Springs of that rig's bones for GLB and VRM, their rigid bodies for PMX.

    Raises:
        FormatError: The suffix is unknown, or the file cannot be written.
        CharacterError: The handles weigh another number of vertices.
    """
    options: dict[str, object] = {"rig": True} if rig else {}
    if avatar is not None:
        options["avatar"] = avatar
    return _write("character", path, options, character, handles)


def _write(kind: str, path: str | Path, options: dict[str, object], *things: Any) -> Path:
    path = Path(path)
    if os.path.isdir(path):
        raise FormatError(path, "this is a folder; name a file inside it")
    function = _resolve(WRITERS[kind][_suffix_of(path, kind)])
    parameters = {name for name, parameter in _parameters(function).items() if parameter.kind is parameter.KEYWORD_ONLY}
    for option in options:
        if option not in parameters:
            have = ", ".join(sorted(parameters)) or "none"
            raise OptionError(f"{path.suffix} files have no option '{option}'; they have: {have}")
    check_output_folder(path)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        out: Path = function(*things, path, **options)
    return out


def _parameters(function: Callable[..., Any]) -> dict[str, Any]:
    import inspect

    return dict(inspect.signature(function).parameters)
