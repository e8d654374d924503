"""The stage that a character stands on: background, floor, lights, and the shadows of a frame."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bunraku.errors import OptionError
from bunraku.render.camera import Framing
from bunraku.render.surface import Surface

__all__ = ["Shadows", "Stage", "cast_shadows", "parse_background", "set_stage"]

Background = str | tuple[int, int, int]
BACKGROUNDS: dict[str, tuple[str, str]] = {
    "studio": ("#eef1f4", "#dfe4e9"),
    "white": ("#ffffff", "#ffffff"),
    "dark": ("#2b3038", "#1b1f25"),
}
# Linear colours of the key light, the sky, the floor's bounce and the rim.
LIGHTS = np.array([[0.92, 0.88, 0.80], [0.36, 0.39, 0.45], [0.17, 0.155, 0.15], [0.09, 0.10, 0.12]])
TEXELS = 320


@dataclass(frozen=True)
class Stage:
    """Everything of a picture but the character and the camera.

    Args:
        ground: Height of the floor [m].
        centre: Middle of the lit part of the floor [m], shape (3,).
        radius: Where the floor has faded out [m].
        cell: Spacing of the grid [m].
        light: Direction towards the key light, shape (3,), unit length.
        reach: Half the side of the square of floor that can hold a shadow [m].
        extent: Size of the character [m].
        top: sRGB of the background's upper border, 0..1, shape (3,). Likewise `bottom`, `floor` and `line`.
    """

    ground: float
    centre: np.ndarray
    radius: float
    cell: float
    light: np.ndarray
    reach: float
    extent: float
    top: np.ndarray
    bottom: np.ndarray
    floor: np.ndarray
    line: np.ndarray
    lights: np.ndarray = field(default_factory=LIGHTS.copy)


@dataclass(frozen=True)
class Shadows:
    """Two maps of the floor, both (R, R), float32, whose texel (row z, column x) starts at `near`, `left` [m].

    Args:
        heights: How high above the floor the highest surface stands in the way of the key light [m].
        floor: How much darker the floor is, 0..1.
    """

    heights: np.ndarray
    floor: np.ndarray
    left: float
    near: float
    texel: float


def parse_background(background: Background) -> tuple[np.ndarray, np.ndarray]:
    """Upper and lower sRGB colour, 0..1, of a named background, a colour such as "#dfe4e9" or (223, 228, 233).

    Raises:
        OptionError: It is none of these.
    """
    pair = BACKGROUNDS.get(background) if isinstance(background, str) else None
    try:
        if pair is None:
            pair = (background, background) if isinstance(background, str) else None
        if pair is None:
            value = np.array([int(channel) for channel in background], float)
            if value.shape != (3,) or value.min() < 0 or value.max() > 255:
                raise ValueError
            return value / 255, value / 255
        upper, lower = (
            np.array([int(name[at : at + 2], 16) for at in (1, 3, 5)], float) / 255
            for name in pair
            if name[0] == "#" and len(name) == 7
        )
        return upper, lower
    except (ValueError, TypeError, IndexError):
        known = ", ".join(BACKGROUNDS)
        raise OptionError(
            f"background {background!r} is not one of {known}, a colour such as '#dfe4e9', or three numbers 0 to 255"
        ) from None


def set_stage(framing: Framing, background: Background = "studio") -> Stage:
    """The stage for a motion that `framing` has measured."""
    top, bottom = parse_background(background)
    axes = framing.axes
    light = -0.55 * axes[0] + np.array([0.0, 1.15, 0.0]) + 0.75 * np.array([axes[2, 0], 0.0, axes[2, 2]])
    light /= np.linalg.norm(light)
    local = framing.bounds - framing.offsets()[:, None]
    low, high = local[:, 0].min(axis=0), local[:, 1].max(axis=0)
    centre = 0.5 * (low + high).astype(np.float64)
    ground, extent = framing.ground, framing.extent
    # A frame's shadow reaches from its bounds to its bounds along the light.
    sizes = (framing.bounds[:, 1] - framing.bounds[:, 0])[:, [0, 2]].max(axis=1)
    rise = np.maximum(framing.bounds[:, 1, 1] - ground, 0)
    slope = float(np.abs(light[[0, 2]]).max() / light[1])
    step = 10.0 ** np.floor(np.log10(0.4 * extent))
    cell = float(step * max(m for m in (1, 2, 5) if m * step <= 0.4 * extent * 1.0001))
    dark = float(top.mean()) < 0.4
    shift = 0.06 if dark else -0.035
    return Stage(
        ground=ground,
        centre=np.array([centre[0], ground, centre[2]]),
        radius=float(1.1 * max(np.hypot(*(high - low)[[0, 2]]), 0.0) + 2.2 * extent),
        cell=cell,
        light=light,
        reach=float((0.5 * sizes + slope * rise).max() * 1.08 + 0.02 * extent),
        extent=extent,
        top=top,
        bottom=bottom,
        floor=np.clip(bottom + shift, 0, 1),
        line=np.clip(bottom + (0.14 if dark else -0.13), 0, 1),
    )


def cast_shadows(stage: Stage, surface: Surface, vertices: np.ndarray) -> Shadows:
    """The shadows of one frame: vertices [m], shape (V, 3), float32, contiguous."""
    from bunraku.render.loops.kernels import drop_shadow, measure, soften

    texel = 2 * stage.reach / TEXELS
    low, high = measure(vertices, np.eye(3), np.zeros(3))[0]
    slope_x, slope_z = stage.light[0] / stage.light[1], stage.light[2] / stage.light[1]
    # Half a shadow's length towards where it falls; whole texels, so that edges do not swim.
    rise = max(float(high[1]) - stage.ground, 0.0)
    middle = np.array(
        [0.5 * (low[0] + high[0]) - 0.5 * slope_x * rise, 0.5 * (low[2] + high[2]) - 0.5 * slope_z * rise]
    )
    left, near = (np.floor(middle / texel) * texel - stage.reach).tolist()
    corner = (left, near)
    heights = np.full((TEXELS, TEXELS), -np.inf, np.float32)
    drop_shadow(vertices, surface.faces, (slope_x, slope_z), stage.ground, corner, texel, False, heights)
    lowest = np.full((TEXELS // 2, TEXELS // 2), np.inf, np.float32)
    drop_shadow(vertices, surface.faces, (0.0, 0.0), stage.ground, corner, 2 * texel, True, lowest)

    def blurred(image: np.ndarray, radius: float) -> np.ndarray:
        width = 2 * max(round(radius), 1) + 1
        return soften(soften(image, width), width)

    key = blurred((heights > -np.inf).astype(np.float32), 0.012 * stage.extent / texel)
    contact = blurred(np.exp(lowest / np.float32(-0.12 * stage.extent)), 0.015 * stage.extent / texel)
    contact = soften(np.repeat(np.repeat(contact, 2, axis=0), 2, axis=1), 3)
    floor = (1 - (1 - 0.24 * key) * (1 - 0.42 * contact)).astype(np.float32)
    return Shadows(heights, floor, left, near, texel)
