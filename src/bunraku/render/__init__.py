"""Previews without a display, drawn on the processor: videos, moving pictures, contact sheets and stills."""

from __future__ import annotations

from bunraku.render.frames import HANDLE_PALETTE, handle_colors, render_animation, render_frames, render_still
from bunraku.render.pictures import contact_sheet
from bunraku.render.preview import save_preview, save_still
from bunraku.render.stage import Camera

__all__ = [
    "HANDLE_PALETTE", "Camera", "contact_sheet", "handle_colors", "render_animation", "render_frames", "render_still",
    "save_preview", "save_still",
]  # fmt: skip
