"""Files in and out: characters, motions and animations, recognised by their first bytes and their suffix."""

from __future__ import annotations

from bunraku.io.registry import load_character, save_animation, save_character, save_motion

__all__ = ["load_character", "save_animation", "save_character", "save_motion"]
