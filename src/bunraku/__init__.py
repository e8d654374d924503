"""Bunraku animates character meshes: a sentence in, an engine-ready animation out.

    import bunraku

    character = bunraku.load_character("dragon.glb")
    animation = bunraku.animate(character, "walks forward, then waves", seconds=6, seed=1)
    animation.save("dragon-wave.glb")

Importing the package loads nothing heavy: each public name is fetched from its module when it is first used (PEP 562).
"""

from __future__ import annotations

from bunraku.interrupt import is_command_line, watch

if is_command_line():  # what follows takes a while
    watch()

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
    from bunraku import clips
    from bunraku.core.animated import AnimatedCharacter
    from bunraku.core.animation import Animation
    from bunraku.core.character import Character, Handles, Rig
    from bunraku.core.motion import HandleMotion, SkeletalMotion, Skeleton
    from bunraku.core.rig_animation import RigAnimation
    from bunraku.handles.orientation import Orientation, guess_orientation, upright
    from bunraku.io import load_character, save_character
    from bunraku.io.motions import load_motion
    from bunraku.io.presets import save_for
    from bunraku.io.save_clips import save_clips
    from bunraku.pipelines.animate import animate, generate, rig, with_skeleton
    from bunraku.pipelines.animator import Animator
    from bunraku.pipelines.edit import edit
    from bunraku.pipelines.requests.request import Request
    from bunraku.pipelines.transfer import transfer
    from bunraku.retarget.stages.switches import Stages
    from bunraku.samples import sample_character

__version__ = "0.1.0"

__all__ = [
    "AnimatedCharacter",
    "Animation",
    "Animator",
    "BunrakuError",
    "Character",
    "CharacterError",
    "FormatError",
    "HandleMotion",
    "Handles",
    "MissingExtraError",
    "MotionError",
    "OptionError",
    "Orientation",
    "Request",
    "Rig",
    "RigAnimation",
    "SkeletalMotion",
    "Skeleton",
    "Stages",
    "WeightsError",
    "__version__",
    "animate",
    "clips",
    "edit",
    "generate",
    "guess_orientation",
    "load_character",
    "load_motion",
    "rig",
    "sample_character",
    "save_character",
    "save_clips",
    "save_for",
    "transfer",
    "upright",
    "with_skeleton",
]

_HOME = {
    "AnimatedCharacter": "bunraku.core.animated",
    "Animation": "bunraku.core.animation",
    "Animator": "bunraku.pipelines.animator",
    "Character": "bunraku.core.character",
    "HandleMotion": "bunraku.core.motion",
    "Handles": "bunraku.core.character",
    "Orientation": "bunraku.handles.orientation",
    "Request": "bunraku.pipelines.requests.request",
    "Rig": "bunraku.core.character",
    "RigAnimation": "bunraku.core.rig_animation",
    "SkeletalMotion": "bunraku.core.motion",
    "Skeleton": "bunraku.core.motion",
    "Stages": "bunraku.retarget.stages.switches",
    "animate": "bunraku.pipelines.animate",
    "edit": "bunraku.pipelines.edit",
    "generate": "bunraku.pipelines.animate",
    "guess_orientation": "bunraku.handles.orientation",
    "load_character": "bunraku.io",
    "load_motion": "bunraku.io.motions",
    "rig": "bunraku.pipelines.animate",
    "sample_character": "bunraku.samples",
    "save_character": "bunraku.io",
    "save_clips": "bunraku.io.save_clips",
    "save_for": "bunraku.io.presets",
    "transfer": "bunraku.pipelines.transfer",
    "upright": "bunraku.handles.orientation",
    "with_skeleton": "bunraku.pipelines.animate",
}


_ROOMS = {"clips": "bunraku.clips"}
"""Rooms that are public as they are."""

provide(
    save="bunraku.io.registry:save",
    resolve_axes="bunraku.handles.orientation:resolve_axes",
    handle_animation="bunraku.retarget.rig_motion:handle_animation",
    write_humanoid_bvh="bunraku.io.humanoid:write_humanoid_bvh",
    write_humanoid_vrma="bunraku.io.humanoid:write_humanoid_vrma",
    write_motion_bvh="bunraku.io.skeletal:write_motion_bvh",
    write_motion_npz="bunraku.io.skeletal:write_motion_npz",
    write_motion_vrma="bunraku.io.skeletal:write_motion_vrma",
    write_character_vmd="bunraku.io.mmd_motion:write_character_vmd",
    check_mmd_character="bunraku.io.mmd_motion:check_character",
    write_html="bunraku.render.html:write_html",
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
