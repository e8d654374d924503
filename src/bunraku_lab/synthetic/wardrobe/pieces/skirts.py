"""Skirts: short and long, plain, pleated and layered, on chains from the waist down."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku_lab.synthetic.people.figure import Figure
from bunraku_lab.synthetic.surfaces import sheet_faces
from bunraku_lab.synthetic.wardrobe.kit.chains import Hang, add_chains, band_start
from bunraku_lab.synthetic.wardrobe.kit.model import Costume
from bunraku_lab.synthetic.wardrobe.kit.skeleton import SOLID

__all__ = ["Drape", "Outline", "add_skirt", "hanging_rings"]

SKIRT = 5
AROUND = 48  # directions of a ring


@dataclass(frozen=True, eq=False)
class Drape:
    """Rings that cloth hangs in, about a vertical axis.

    Args:
        heights: Of the rings, from the top [m], shape (H,).
        radii: In each direction [m], shape (H, A).
        angles: The directions: 0 is +Z, a quarter turn +X [rad], shape (A,).
        center: X and Z of the axis, shape (2,).
    """

    heights: np.ndarray
    radii: np.ndarray
    angles: np.ndarray
    center: np.ndarray

    def points(
        self, rows: np.ndarray, angles: np.ndarray, swell: np.ndarray | float = 1.0, lift: float = 0.0
    ) -> np.ndarray:
        """Points of the drape, shape (len(rows), len(angles), 3).

        Args:
            rows: Places from 0, the top, to 1, the hem.
            angles: Directions [rad].
            swell: Factor on the radii, such as that of pleats.
            lift: Added to the radii [m].
        """
        at = np.asarray(rows) * (len(self.heights) - 1)
        low = np.minimum(at.astype(np.int64), len(self.heights) - 2)
        share = (at - low)[:, None]
        radii = (1 - share) * self.radii[low] + share * self.radii[low + 1]
        turn = np.asarray(angles) % (2 * np.pi)
        own = self.angles % (2 * np.pi)
        order = np.argsort(own)
        around = np.stack([np.interp(turn, own[order], row[order], period=2 * np.pi) for row in radii]) * swell + lift
        heights = np.interp(at, np.arange(len(self.heights)), self.heights)[:, None]
        return np.stack(
            [
                self.center[0] + around * np.sin(angles),
                np.broadcast_to(heights, around.shape),
                self.center[1] + around * np.cos(angles),
            ],
            axis=-1,
        )


@dataclass(frozen=True)
class Outline:
    """How rings of cloth widen towards the hem.

    Args:
        flare: How much farther out the hem is than the body, over the length.
        bow: 1 widens evenly, less widens at once below the top, more towards the hem.
        clear: Distance from the body [m].
    """

    flare: float
    bow: float
    clear: float


def hanging_rings(
    figure: Figure, top: float, hem: float, outline: Outline, *,
    rings: int = 14, center: np.ndarray | None = None, convex: bool = True, points: np.ndarray | None = None,
) -> Drape:  # fmt: skip
    """Rings about the body from one height down to another that never narrow, and widen by the flare.

    Args:
        figure: The body.
        top, hem: Heights [m].
        outline: How they widen.
        rings: How many.
        center: X and Z of the axis; None is the middle of the hips.
        convex: Whether the cloth is drawn straight over hollows, as it is where it goes all around; at its top it lies
            on the body.
        points: What it keeps clear of, instead of head, trunk and legs.
    """
    axis = figure.at("pelvis")[[0, 2]] if center is None else center
    angles = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    heights = np.linspace(top, hem, rings)
    band = max(0.7 * (top - hem) / rings, 0.02 * figure.height)
    if convex:
        body = np.stack(
            [figure.rim(float(height), angles, center=axis, band=band, points=points) for height in heights]
        )
        first = figure.profile(top, angles, center=axis, band=0.02 * figure.height, spread=0.2, points=points)
        body[0] = np.minimum(np.where(first > 0, first, body[0]) + 0.004 * figure.height, body[0])
    else:
        body = np.stack(
            [figure.profile(float(height), angles, center=axis, band=band, points=points) for height in heights]
        )
    held = np.maximum.accumulate(np.maximum(body, 0.02), axis=0)
    share = np.linspace(0, 1, rings)[:, None]
    spread = held[:1] + outline.flare * (top - hem) * share**outline.bow
    return Drape(heights, np.maximum(held, spread) + outline.clear * np.minimum(0.3 + 4 * share, 1), angles, axis)


def add_skirt(
    costume: Costume, figure: Figure, rng: np.random.Generator, *, kind: str, top: float, colors: tuple[str, str],
    what: str = "skirt",
) -> np.ndarray:  # fmt: skip
    """A skirt of a kind: "short", "long", "pleated" or "layered".

    Args:
        costume: What it is added to.
        figure: The body.
        rng: Random numbers.
        kind: Its kind.
        top: Height of its waist [m].
        colors: Materials of cloth and trimming.
        what: What it is called: a dress has no band at its waist.

    Returns:
        The points of its cloth [m], shape (V, 3).
    """
    u, h = rng.uniform, figure.height
    hip, knee, ankle = (float(figure.at(f"left_{part}")[1]) for part in ("hip", "knee", "ankle"))
    down = {"short": u(0.45, 0.8), "pleated": u(0.45, 0.95), "layered": u(0.7, 1.6), "long": u(1.25, 1.85)}[kind]
    hem = float(np.interp(down, [0, 1, 2], [hip, knee, ankle]))
    flare = {"short": u(0.1, 0.5), "pleated": u(0.15, 0.5), "layered": u(0.2, 0.55), "long": u(0.05, 0.32)}[kind]
    drape = hanging_rings(figure, top, hem, Outline(flare, float(u(0.6, 1.2)), 0.016 * h))
    length = top - hem
    count = 12 if length > 0.3 * h or kind == "layered" else 10
    begin = band_start(costume, "スカート")
    links = int(np.clip(round((1 - begin) * length / (0.075 * h)), 1 if begin else 2, 7))
    turns = np.arange(count) * 2 * np.pi / count
    nodes = drape.points(np.linspace(begin, 1, links + 1), turns).transpose(1, 0, 2)
    outward = np.stack([np.sin(turns), np.zeros(count), np.cos(turns)], axis=1)
    hang = Hang(
        mass=1.0, damping=(0.85, 0.95), out=70, inward=25, side=25, twist=0, spring=float(u(0.1, 0.4)), thick=0.007 * h,
        box=True,
        group=SKIRT, meets=SOLID["legs"], give=0.2,
    )  # fmt: skip
    waist = costume.bone_index("下半身")
    chains = add_chains(
        costume, [f"スカート{number}" for number in range(count)], nodes, outward, waist, hang, closed=True
    )
    folds = int(rng.integers(2, 4)) * count if kind == "pleated" else int(rng.integers(1, 3)) * count
    deep = float(u(0.045, 0.08)) if kind == "pleated" else float(rng.choice([0.0, u(0.01, 0.05)]))
    layers = int(rng.integers(2, 4)) if kind == "layered" else 1
    columns = max(round(costume.fine * 4) * count, 3 * count, 2 * folds if kind == "pleated" else 0)
    rows = max(round(costume.fine * 4 * links), 2 * links) + 1
    for layer in range(layers):
        end = 1 - layer * 0.72 / layers
        share = np.linspace(0, end, rows)
        angles = np.arange(columns) * 2 * np.pi / columns
        wave = _zigzag(angles * folds / (2 * np.pi)) if kind == "pleated" else np.cos(angles * folds)
        # Layers above stand off; folds grow towards the hem, outwards, so that the body stays inside.
        swell = 1 + deep * np.minimum(2.2 * share, 1)[:, None] * (1 + wave)[None]
        points = drape.points(share, angles, swell, layer * 0.012 * h)
        along, across = (
            np.repeat((share - begin) / (1 - begin) * links, columns),
            np.tile(angles / (2 * np.pi) * count, rows),
        )
        material = colors[0] if layer % 2 == 0 else colors[1]
        faces = sheet_faces(rows, columns, wrap=True)
        bones, shares = chains.weights(along, across)
        border = layer == 0 and rng.random() < 0.5 and faces.max(axis=1) >= (rows - max(2, rows // 8)) * columns
        costume.add(
            points.reshape(-1, 3),
            faces,
            bones,
            shares,
            np.where(border, colors[1], material) if layer == 0 else material,
        )
        if layer == 0:
            outer = points.reshape(-1, 3)
    if what == "skirt":
        _waistband(costume, drape, columns, waist, colors[1], h)
    costume.words.append(f"{kind} {what}")
    return outer


def _waistband(costume: Costume, drape: Drape, columns: int, bone: int, material: str, height: float) -> None:
    angles = np.arange(columns) * 2 * np.pi / columns
    rings = drape.points(np.zeros(4), angles, 1.0, 0.004 * height)
    rings[[0, 3]] -= 0.003 * height * np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
    rings[:, :, 1] += np.array([0.018, 0.015, -0.012, -0.015])[:, None] * height
    costume.add(rings.reshape(-1, 3), sheet_faces(4, columns, wrap=True), bone, 1, material)


def _zigzag(turns: np.ndarray) -> np.ndarray:
    """A wave of knife pleats between -1 and 1, one a turn."""
    phase = turns % 1
    return np.asarray(np.where(phase < 0.7, phase / 0.7, (1 - phase) / 0.3) * 2 - 1)
