"""The options of whose skeleton a character gets, and of the program that a file is for."""

from __future__ import annotations

from typing import Annotated, Literal

import tyro

__all__ = ["ProgramOption", "SkeletonOption"]

SkeletonOption = Annotated[Literal["mixamo", "vrm", "unreal"] | None, tyro.conf.arg(help_behavior_hint="")]
ProgramOption = Annotated[
    Literal["unity", "unreal", "godot", "blender", "three", "vrchat"] | None,
    tyro.conf.arg(name="for", help_behavior_hint=""),
]
