"""Colours of wardrobe characters: skin, hair, eyes, and clothes that go together."""

from __future__ import annotations

import colorsys

import numpy as np

__all__ = ["random_colors"]

_SKINS = (
    (255, 226, 205),
    (250, 214, 188),
    (240, 196, 164),
    (224, 172, 136),
    (198, 140, 104),
    (150, 100, 70),
    (104, 68, 48),
)
_HAIRS = (
    (38, 32, 34), (66, 44, 34), (112, 72, 44), (158, 104, 58), (226, 190, 120), (242, 224, 176), (196, 84, 48), (150,
    40, 44), (222, 224, 232),
    (128, 134, 150), (240, 150, 176), (92, 160, 210), (60, 84, 150), (110, 180, 150), (150, 110, 190), (96, 50, 90),
)  # fmt: skip


def _hsv(hue: float, saturation: float, value: float) -> np.ndarray:
    return np.array(colorsys.hsv_to_rgb(hue % 1, saturation, value))


def random_colors(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """sRGB of each material from 0 to 1, shape (3,): one main colour, a second one near or opposite to it, and quiet
    ones beside them.
    """
    u = rng.uniform
    skin = np.array(_SKINS[rng.choice(len(_SKINS), p=[0.26, 0.24, 0.16, 0.12, 0.1, 0.07, 0.05])]) / 255
    hair = np.clip(np.array(_HAIRS[rng.integers(len(_HAIRS))]) / 255 * u(0.88, 1.08), 0, 1)
    hue = float(u(0, 1))
    other = hue + float(rng.choice([0.5, 0.08, -0.08, 0.33, 0.17]))
    dark, pale = _hsv(hue, u(0.15, 0.6), u(0.16, 0.34)), _hsv(hue, u(0.0, 0.14), u(0.88, 0.97))
    main = {0: _hsv(hue, u(0.4, 0.75), u(0.5, 0.9)), 1: _hsv(hue, u(0.15, 0.4), u(0.75, 0.95)), 2: dark}[
        int(rng.choice(3, p=[0.55, 0.25, 0.2]))
    ]
    accent = _hsv(other, u(0.3, 0.7), u(0.6, 0.95))
    quiet = pale if rng.random() < 0.55 else dark
    return {
        "skin": skin, "hair": hair, "hair tie": accent, "brow": hair * 0.7, "lashes": np.array([0.14, 0.1, 0.12]),
        "eye white": np.array([0.97, 0.97, 0.98]),
        "iris": _hsv(float(u(0, 1)), u(0.5, 0.85), u(0.45, 0.8)), "pupil": np.array([0.07, 0.06, 0.1]),
        "eye light": np.array([1.0, 1, 1]),
        "mouth": skin * [0.72, 0.42, 0.42], "cloth": main, "trim": accent, "top": quiet if rng.random() < 0.5 else main,
        "legs": dark if rng.random() < 0.6 else _hsv(other, u(0.1, 0.5), u(0.25, 0.7)), "socks": (pale, dark,
        accent)[rng.integers(3)],
        "shoes": (dark * 0.8, _hsv(0.07, u(0.4, 0.7), u(0.2, 0.5)), accent * 0.7)[rng.integers(3)],
        "gloves": quiet, "mantle": (main * 0.8, accent, dark)[rng.integers(3)],
        "lining": accent * 0.65 if rng.random() < 0.5 else pale, "fur": np.clip(hair * u(0.9, 1.1), 0, 1),
        "fur tip": pale,
    }  # fmt: skip
