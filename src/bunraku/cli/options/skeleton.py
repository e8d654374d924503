"""The option of whose skeleton a character gets."""

from __future__ import annotations

from typing import Annotated, Literal

import tyro

__all__ = ["SkeletonOption"]

SkeletonOption = Annotated[Literal["mixamo", "vrm", "unreal"] | None, tyro.conf.arg(help_behavior_hint="")]
