"""Bunraku animates character meshes: a sentence in, an engine-ready animation out.

    import bunraku

    character = bunraku.load_character("dragon.glb")
    animation = bunraku.animate(character, "walks forward, then waves", seconds=6, seed=1)
    animation.save("dragon-wave.glb")

Importing the package loads nothing heavy: each public name is fetched from its module when it is first used (PEP 562).
"""

from __future__ import annotations

from bunraku.core.interrupt import is_command_line, watch_interrupts

if is_command_line():  # what follows takes a while
    watch_interrupts()

from importlib import import_module
from typing import TYPE_CHECKING, Any

from bunraku.core.saving import provide
from bunraku.errors import (
    BunrakuError,
    CharacterError,
    FormatError,
    MissingExtraError,
    MotionError,
    OptionError,
    WeightsError,
)

if TYPE_CHECKING:
    from bunraku.anatomy.handles.orientation import Orientation, guess_orientation, upright
    from bunraku.core.animation import AnimatedCharacter, Animation, RigAnimation
    from bunraku.core.character import Character, Handles, Rig
    from bunraku.core.motion import HandleMotion, SkeletalMotion, Skeleton
    from bunraku.files import load_character, sample_character, save_character, save_clips, save_for
    from bunraku.generation import library as clips
    from bunraku.pipelines.animate import animate, edit, generate, rig, with_skeleton
    from bunraku.pipelines.animator import Animator
    from bunraku.pipelines.live import Live, live
    from bunraku.pipelines.requests import Request
    from bunraku.pipelines.to_reference import load_motion
    from bunraku.pipelines.transfer import transfer
    from bunraku.retarget.stages import Stages

__version__ = "0.1.0"

__all__ = [
    "AnimatedCharacter", "Animation", "Animator", "BunrakuError", "Character", "CharacterError", "FormatError",
    "HandleMotion", "Handles", "Live", "MissingExtraError", "MotionError", "OptionError", "Orientation", "Request",
    "Rig", "RigAnimation", "SkeletalMotion", "Skeleton", "Stages", "WeightsError", "__version__", "animate",
    "clips", "edit", "generate", "guess_orientation", "live", "load_character", "load_motion", "rig",
    "sample_character", "save_character", "save_clips", "save_for", "transfer", "upright", "with_skeleton",
]  # fmt: skip

_HOME = {
    "AnimatedCharacter": "bunraku.core.animation",
    "Animation": "bunraku.core.animation",
    "Animator": "bunraku.pipelines.animator",
    "Character": "bunraku.core.character",
    "HandleMotion": "bunraku.core.motion",
    "Handles": "bunraku.core.character",
    "Live": "bunraku.pipelines.live",
    "Orientation": "bunraku.anatomy.handles.orientation",
    "Request": "bunraku.pipelines.requests",
    "Rig": "bunraku.core.character",
    "RigAnimation": "bunraku.core.animation",
    "SkeletalMotion": "bunraku.core.motion",
    "Skeleton": "bunraku.core.motion",
    "Stages": "bunraku.retarget.stages",
    "animate": "bunraku.pipelines.animate",
    "edit": "bunraku.pipelines.animate",
    "generate": "bunraku.pipelines.animate",
    "guess_orientation": "bunraku.anatomy.handles.orientation",
    "live": "bunraku.pipelines.live",
    "load_character": "bunraku.files",
    "load_motion": "bunraku.pipelines.to_reference",
    "rig": "bunraku.pipelines.animate",
    "sample_character": "bunraku.files",
    "save_character": "bunraku.files",
    "save_clips": "bunraku.files",
    "save_for": "bunraku.files",
    "transfer": "bunraku.pipelines.transfer",
    "upright": "bunraku.anatomy.handles.orientation",
    "with_skeleton": "bunraku.pipelines.animate",
}


_ROOMS = {"clips": "bunraku.generation.library"}
"""Rooms that are public as they are."""

provide(
    save="bunraku.files:save",
    resolve_axes="bunraku.anatomy.handles.orientation:resolve_axes",
    handle_animation="bunraku.retarget.to_reference:handle_animation",
    write_humanoid_bvh="bunraku.pipelines.humanoid:write_humanoid_bvh",
    write_humanoid_vrma="bunraku.pipelines.humanoid:write_humanoid_vrma",
    write_motion_bvh="bunraku.pipelines.humanoid:write_humanoid_bvh",
    write_motion_npz="bunraku.pipelines.humanoid:write_motion_npz",
    write_motion_vrma="bunraku.pipelines.humanoid:write_humanoid_vrma",
    write_character_vmd="bunraku.pipelines.humanoid:write_character_vmd",
    write_html="bunraku.render.preview:write_html",
    save_preview="bunraku.render.preview:save_preview",
)


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return import_module(_ROOMS[name])
    if name not in _HOME:
        raise AttributeError(f"module 'bunraku' has no attribute '{name}'")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
