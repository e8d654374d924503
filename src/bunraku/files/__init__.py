"""Files in and out: the readers and writers of every format. Everybody outside imports from here alone."""

from __future__ import annotations

from bunraku.files.registry import load_character, save_animation, save_character, save_motion

__all__ = ["load_character", "save_animation", "save_character", "save_motion"]
