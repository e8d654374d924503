"""Previews without a display, drawn on the processor: videos, moving pictures, contact sheets and stills."""

from __future__ import annotations

from bunraku.render.camera import Camera
from bunraku.render.frames import render_animation, render_frames, render_still
from bunraku.render.palette import HANDLE_PALETTE, handle_colors
from bunraku.render.preview import save_preview, save_still
from bunraku.render.sheets import contact_sheet

__all__ = [
    "HANDLE_PALETTE",
    "Camera",
    "contact_sheet",
    "handle_colors",
    "render_animation",
    "render_frames",
    "render_still",
    "save_preview",
    "save_still",
]
