"""Hair: a cap over the skull, fringes, and what hangs: ponytails, twin tails, side locks, long loose hair."""

from __future__ import annotations

import numpy as np

from bunraku_lab.synthetic.figures import Figure
from bunraku_lab.synthetic.surfaces import curve_through, sheet_faces, strand, unit
from bunraku_lab.synthetic.wardrobe.chains import Hang, add_chains, band_start
from bunraku_lab.synthetic.wardrobe.model import SOLID, Costume

HAIR = 4
_MEETS = SOLID["trunk"] | SOLID["head"]


class Scalp:
    """A dome over the skull that hair lies on.

    Args:
        figure: The body.
        thick: How thick hair is at the crown [m].
    """

    def __init__(self, figure: Figure, thick: float):
        self.center, self.half = figure.skull
        self.thick = thick
        low = self.center[1] - 0.75 * self.half[1]
        cloud = figure.head[figure.head[:, 1] > low] - self.center
        length = np.linalg.norm(cloud, axis=1)
        self._ways, self._cloud, self._length = cloud / length[:, None], cloud, length

    def radius(self, ways: np.ndarray) -> np.ndarray:
        """How far the head reaches in directions, rounded, shape (V,)."""
        flat = ways.reshape(-1, 3)
        near = flat @ self._ways.T
        reach = np.where(near > 0.86, near * self._length, 0).max(axis=1)
        box = 1 / np.linalg.norm(flat / self.half, axis=1)
        return np.asarray(np.maximum(reach, 0.9 * box).reshape(ways.shape[:-1]))

    def at(self, turn: np.ndarray | float, fall: np.ndarray | float, lift: np.ndarray | float = 0.0) -> np.ndarray:
        """Points on the dome, shape (..., 3).

        Args:
            turn: About the vertical: 0 in front, a quarter turn to +X [rad].
            fall: From the crown down: 0 at the top, a quarter turn at the height of the middle [rad].
            lift: Farther out by this [m].
        """
        turn, fall, lift = np.broadcast_arrays(turn, fall, lift)
        ways = np.stack([np.sin(fall) * np.sin(turn), np.cos(fall), np.sin(fall) * np.cos(turn)], axis=-1)
        return np.asarray(self.center + ways * (self.radius(ways) + self.thick + lift)[..., None])


def add_hair(
    costume: Costume, figure: Figure, rng: np.random.Generator, *, kind: str, colors: tuple[str, str]
) -> Scalp:
    """Hair of a kind ("short", "bob", "ponytail", "twin tails", "long") with a fringe; returns its dome."""
    scalp = Scalp(figure, float(rng.uniform(0.08, 0.14)) * float(figure.skull[1][0]))
    bone = costume.bone_index("頭")
    _cap(costume, scalp, bone, rng, kind, colors[0])
    _fringe(costume, figure, scalp, bone, rng, colors[0])
    if kind == "ponytail":
        _tail(costume, figure, scalp, rng, "ポニテ", np.pi, float(rng.uniform(0.9, 1.5)), colors)
    elif kind == "twin tails":
        turn, fall = float(rng.uniform(1.75, 2.2)), float(rng.uniform(0.85, 1.45))
        state = rng.bit_generator.state
        for mark, side in (("左", 1), ("右", -1)):
            rng.bit_generator.state = state  # both alike
            _tail(costume, figure, scalp, rng, f"{mark}ツインテ", side * turn, fall, colors)
    elif kind == "long":
        _long(costume, figure, scalp, rng, colors[0])
    if kind in ("long", "bob", "ponytail", "twin tails") and rng.random() < (0.25 if costume.quiet else 0.65):
        _side_locks(costume, figure, scalp, rng, colors[0])
    costume.words.append(f"{kind} hair" if kind in ("short", "long") else kind)
    return scalp


def _fall_of(rng: np.random.Generator) -> float:
    """How far hair falls below its root, over the height: to the hips mostly, to the ground now and then."""
    return float(rng.uniform(0.25, 0.62) if rng.random() < 0.7 else rng.uniform(0.62, 1.0))


def _cap(costume: Costume, scalp: Scalp, bone: int, rng: np.random.Generator, kind: str, material: str) -> None:
    """The dome itself, from the hairline in front over the ears to the nape."""
    columns, rows = max(round(28 * costume.fine), 14), max(round(10 * costume.fine), 6)
    turn = np.arange(columns) * 2 * np.pi / columns
    back = 0.5 - 0.5 * np.cos(turn)
    nape = {"short": 2.2, "bob": 2.4, "long": 2.25}.get(kind, 2.15)
    edge = np.interp(back, [0, 0.12, 0.3, 0.42, 0.6, 1.0], [0.95, 1.05, 1.55, 1.85, 2.05, nape])
    if kind == "bob":
        edge = np.interp(back, [0, 0.12, 0.3, 0.5, 1.0], [0.95, 1.0, 1.9, 2.3, nape])
    share = np.linspace(0.02, 1, rows)[:, None]
    tips = 0.05 * np.cos(turn * 11) * share**4  # a ragged border
    fall = share * (edge + tips)
    lift = scalp.thick * (0.2 - 0.9 * np.clip((share - 0.75) / 0.25, 0, 1) ** 2) * np.ones_like(fall)
    if kind == "bob":
        lift = lift + 0.25 * scalp.half[0] * np.clip(fall - 1.3, 0, 1) * (back > 0.2)
    points = scalp.at(turn[None] + 0 * fall, fall, lift)
    if kind == "bob":
        points[..., 1] -= 0.15 * scalp.half[1] * np.clip(fall - 1.6, 0, 1)
    crown = scalp.at(0.0, 0.0, 0.2 * scalp.thick)
    faces = sheet_faces(rows, columns, wrap=True)
    top = np.stack([np.full(columns, rows * columns), np.arange(columns), (np.arange(columns) + 1) % columns], axis=1)
    costume.add(np.concatenate([points.reshape(-1, 3), crown[None]]), np.concatenate([faces, top]), bone, 1, material)


def _fringe(costume: Costume, figure: Figure, scalp: Scalp, bone: int, rng: np.random.Generator, material: str) -> None:
    """Locks over the forehead, parted somewhere; their lower halves may swing."""
    count = int(rng.integers(5, 9))
    part = float(rng.uniform(-0.5, 0.5))
    turns = np.linspace(-1.05, 1.05, count)
    end = float(rng.uniform(1.3, 1.5))
    swings = rng.random() < (0.45 if costume.quiet else 0.35)
    for number, turn in enumerate(turns):
        lean = 0.22 * np.sign(turn - part + 1e-6) * float(rng.uniform(0.3, 1))
        low = end + 0.22 * abs(turn) + float(rng.uniform(-0.08, 0.08))
        t = np.linspace(0, 1, max(round(7 * costume.fine), 5))
        fall = 0.35 + (low - 0.35) * t
        path = scalp.at(
            turn + lean * t**2, fall, scalp.thick * (0.15 + 0.5 * np.sin(np.pi * t)) - 0.3 * scalp.thick * (t > 0.99)
        )
        wide = 1.5 * scalp.half[0] / count * np.array([1.0, 1.25, 1.2, 0.75, 0.08])
        width = np.interp(t, [0, 0.35, 0.6, 0.85, 1], wide)
        points, faces, position = strand(path, path - scalp.center, width, 0.28 * width + 0.002, 6)
        if not swings:
            costume.add(points, faces, bone, 1, material)
            continue
        low = len(path) // 2
        hang = Hang(
            mass=0.1, damping=(0.93, 0.98), out=40, inward=8, side=25, twist=0, spring=0.02, thick=0.3 * wide[0],
            box=False, group=HAIR, meets=0,
        )  # fmt: skip
        ends = path[[low, -1]][None]
        chains = add_chains(
            costume, [f"前髪{number}"], ends, unit(path[low] - scalp.center)[None], bone, hang, cross=False
        )
        costume.add(points, faces, *chains.weights((position - low) / (len(path) - 1 - low)), material)


def _tail(
    costume: Costume, figure: Figure, scalp: Scalp, rng: np.random.Generator, name: str, turn: float, fall: float,
    colors: tuple[str, str],
) -> None:  # fmt: skip
    """A tail of hair bound on the dome that falls behind or beside the head, clear of the body."""
    u, size = rng.uniform, float(scalp.half[0])
    root = scalp.at(turn, fall, -0.2 * scalp.thick)
    direction = unit(np.array([np.sin(turn), 0.35, np.cos(turn)]))
    fat, out = float(size * u(0.26, 0.42)), float(size * u(0.45, 0.8))
    end = max(root[1] - _fall_of(rng) * figure.height, 0.06 * figure.height)
    knee = root + direction * out
    drop = np.array([np.sin(turn), 0, np.cos(turn)])
    heights = np.linspace(knee[1] - 0.6 * out, end, 6)
    positions = [root, knee]
    start = knee + 0.35 * out * drop
    far = float((start - [scalp.center[0], 0, scalp.center[2]]) @ drop)
    axis = scalp.center[[0, 2]]
    behind = abs(turn) > 2.6
    for height in heights:  # never nearer to the body than its outline
        band = 0.04 * figure.height
        body = (figure.rim if behind else figure.profile)(float(height), np.array([turn]), center=axis, band=band)[0]
        far = max(far, min(float(body), far + 0.1 * figure.height) + 1.15 * fat)
        positions.append(
            np.array([axis[0] + drop[0] * far, height, axis[1] + drop[2] * far - (0.0 if behind else 0.35 * size)])
        )
    begin = band_start(costume, name)
    links = int(np.clip(round((1 - begin) * (root[1] - end) / (0.085 * figure.height)), 1 if begin else 3, 9))
    whole = curve_through(np.array(positions), 65)
    curve = curve_through(whole[round(64 * begin) :], links + 1)
    hang = Hang(
        mass=0.8, damping=(0.9, 0.99), out=55, inward=40, side=45, twist=0, spring=float(u(0.1, 0.35)),
        thick=0.55 * fat, box=False, group=HAIR, meets=_MEETS,
    )  # fmt: skip
    chains = add_chains(costume, [name], curve[None], drop[None], costume.bone_index("頭"), hang, cross=False)
    rows = max(round(3.2 * links / (1 - begin) * costume.fine), links + 3)
    fine_curve = curve_through(np.array(positions), rows)
    t = np.linspace(0, 1, rows)
    widths = fat * np.interp(
        t, [0, 0.06, 0.25, 0.6, 0.9, 1], [0.35, 0.6, 1.0, float(u(0.7, 1.05)), float(u(0.25, 0.6)), 0.03]
    )
    points, faces, position = strand(fine_curve, drop, 1.15 * widths, 0.85 * widths, max(round(10 * costume.fine), 6))
    costume.add(points, faces, *chains.weights((position / (rows - 1) - begin) / (1 - begin) * links), colors[0])
    tie = curve_through(np.array(positions), 40)[1:5]
    points, faces, _ = strand(tie, drop, 0.6 * fat, 0.52 * fat, 8)
    costume.add(points, faces, costume.bone_index("頭"), 1, colors[1])


def _side_locks(costume: Costume, figure: Figure, scalp: Scalp, rng: np.random.Generator, material: str) -> None:
    """A lock before each ear that hangs beside the face."""
    length = float(rng.uniform(1.3, 2.6)) * float(scalp.half[1])
    fat = float(rng.uniform(0.16, 0.24)) * float(scalp.half[0])
    for mark, side in (("左", 1), ("右", -1)):
        turn = side * 1.2
        falls = np.array([0.75, 1.15, 1.5])
        top = scalp.at(turn, falls, 0.35 * scalp.thick)
        last = top[-1] + np.array([side * 0.12 * scalp.half[0], 0, 0.06 * scalp.half[2]])
        drops = [
            last - [0, length * share, 0] + np.array([side * 0.05, 0, 0.12]) * share * scalp.half[0]
            for share in (0.4, 0.75, 1.0)
        ]
        positions = np.concatenate([top, np.array(drops)])
        links = 2
        hung = np.concatenate([top[-1:], np.array(drops)])
        out = np.array([np.sin(turn), 0, np.cos(turn)])
        hang = Hang(
            mass=0.4, damping=(0.88, 0.975), out=40, inward=25, side=40, twist=0, spring=0.06, thick=0.7 * fat,
            box=False, group=HAIR, meets=_MEETS,
        )  # fmt: skip
        chain = curve_through(hung, links + 1)
        chains = add_chains(
            costume, [f"{mark}横髪"], chain[None], out[None], costume.bone_index("頭"), hang, cross=False
        )
        rows = max(round(14 * costume.fine), 8)
        curve = curve_through(positions, rows)
        t = np.linspace(0, 1, rows)
        width = fat * np.interp(t, [0, 0.2, 0.6, 0.9, 1], [0.3, 0.9, 1.0, 0.55, 0.04])
        points, faces, position = strand(curve, out, width, 0.5 * width, max(round(7 * costume.fine), 5))
        begin = float(
            np.linalg.norm(np.diff(positions[:3], axis=0), axis=1).sum()
            / max(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum(), 1e-9)
        )
        along = (position / (rows - 1) - begin) / (1 - begin) * links
        bones, shares = chains.weights(np.maximum(along, -0.5))
        costume.add(points, faces, bones, shares, material)


def _long(costume: Costume, figure: Figure, scalp: Scalp, rng: np.random.Generator, material: str) -> None:
    """Loose hair that falls from the back of the dome over nape and back in one curtain."""
    u = rng.uniform
    wide = float(u(1.75, 2.05))  # how far round to the front it begins
    count = int(rng.integers(5, 8))
    end = max(float(scalp.center[1] - _fall_of(rng) * figure.height), 0.05 * figure.height)
    fine_turns = np.linspace(np.pi - wide, np.pi + wide, max(round(6 * count * costume.fine), 3 * count))
    top = 1.35
    base = scalp.at(fine_turns, top, 0.45 * scalp.thick)
    axis = scalp.center[[0, 2]]
    heights = np.linspace(float(base[:, 1].mean()), end, 12)
    share = np.linspace(0, 1, 12)
    narrow = float(u(0.5, 0.7))
    rings = [base]
    far = np.linalg.norm(base[:, [0, 2]] - axis, axis=1)
    for number, height in enumerate(heights[1:], 1):
        turns = np.pi + (fine_turns - np.pi) * (1 - (1 - narrow) * min(2.0 * share[number], 1))
        body = figure.profile(float(height), turns, center=axis, band=0.035 * figure.height)
        far = np.maximum(far, np.minimum(body, far + 0.06 * figure.height) + 0.016 * figure.height)
        far = np.convolve(np.pad(far, 2, mode="edge"), np.ones(5) / 5, mode="valid") * 0.5 + 0.5 * far
        rings.append(np.stack(
            [axis[0] + far * np.sin(turns), np.full(len(turns), height), axis[1] + far * np.cos(turns)], axis=1,
        ))  # fmt: skip
    grid = np.stack(rings)  # rows, columns
    begin = band_start(costume, "後髪")
    links = int(np.clip(round((1 - begin) * (heights[0] - end) / (0.075 * figure.height)), 1 if begin else 3, 10))
    pick = np.round(np.linspace(0, len(fine_turns) - 1, count)).astype(int)
    nodes = np.stack(
        [curve_through(curve_through(grid[:, column], 65)[round(64 * begin) :], links + 1) for column in pick]
    )
    middle = nodes.mean(axis=1)
    outward = unit((middle - [axis[0], 0, axis[1]]) * [1, 0, 1])
    hang = Hang(
        mass=0.8, damping=(0.88, 0.975), out=45, inward=25, side=20, twist=0, spring=float(u(0.1, 0.3)),
        thick=0.012 * figure.height, box=False,
        group=HAIR, meets=_MEETS, give=0.15,
    )  # fmt: skip
    chains = add_chains(
        costume, [f"後髪{number}" for number in range(count)], nodes, outward, costume.bone_index("頭"), hang
    )
    rows = max(round(3.5 * links / (1 - begin) * costume.fine), 2 * links) + 1
    columns = len(fine_turns)
    smooth = np.stack([curve_through(grid[:, column], rows) for column in range(columns)], axis=1)
    t = np.linspace(0, 1, rows)[:, None]
    waves = np.cos(np.linspace(0, 2 * np.pi * count * 2, columns))[None]
    radial = unit((smooth - [axis[0], 0, axis[1]]) * [1, 0, 1])
    smooth = smooth + radial * (0.05 * scalp.half[0] * waves * np.minimum(2 * t, 1))[..., None]
    smooth[..., 1] -= (
        0.35 * scalp.half[1] * (np.cos(np.linspace(0, 2 * np.pi * count, columns))[None] * 0.4 + 0.3) * t**3
    )
    inner = smooth - radial * 0.09 * scalp.half[0] * (1 - 0.8 * t[..., None])
    above = scalp.at(fine_turns[None] + np.zeros((3, 1)), np.array([0.75, 0.95, 1.15])[:, None], 0.35 * scalp.thick)
    outer = np.concatenate([above, smooth])
    hung = (t[:, 0] - begin) / (1 - begin) * links
    along = np.concatenate([np.full(3, -0.5), hung])
    across = np.linspace(0, count - 1, columns)
    for points, positions, faces in (
        (outer, along, sheet_faces(rows + 3, columns)),
        (inner, hung, sheet_faces(rows, columns)[:, ::-1]),
    ):
        bones, shares = chains.weights(np.repeat(positions, columns), np.tile(across, len(positions)))
        costume.add(points.reshape(-1, 3), faces, bones, shares, material)
