"""Avatars as games and drawings have them, with their labels: large heads, hair in thick loose locks, short skirts in
tiers and panels, open jackets, wide hats. They are bodies of the wardrobe or of MakeHuman in other proportions.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from bunraku.core.geometry.curves import smooth_step
from bunraku_lab.datasets.labelled.figures import CARRIER, PART, UNKNOWN, Labelled, of_costume
from bunraku_lab.datasets.labelled.locks import Hair
from bunraku_lab.synthetic.figures import Figure, random_figure
from bunraku_lab.synthetic.surfaces import ring_mesh, sheet_faces, unit
from bunraku_lab.synthetic.wardrobe.character import makehuman_figure, open_closet
from bunraku_lab.synthetic.wardrobe.clothes import Field, Outfit, add_clothed_body, add_face, random_colors
from bunraku_lab.synthetic.wardrobe.hair import Scalp, add_hair
from bunraku_lab.synthetic.wardrobe.model import Costume, add_skeleton
from bunraku_lab.synthetic.wardrobe.skirts import Drape, Outline, hanging_rings

_HATS = (  # radius over the head's and height over the head's half, from the brim up: witch, sun, cap, beret, top hat
    [(2.3, -0.1), (1.06, 0.1), (0.9, 0.6), (0.5, 1.3), (0.2, 2.0), (0.02, 2.5)],
    [(2.0, -0.25), (1.08, 0.1), (1.02, 0.6), (0.6, 1.0), (0.02, 1.1)],
    [(1.12, 0.0), (1.12, 0.4), (0.8, 0.9), (0.02, 1.1)],
    [(1.05, 0.2), (1.5, 0.5), (1.3, 0.85), (0.02, 0.95)],
    [(1.6, 0.1), (1.06, 0.15), (1.0, 1.3), (1.05, 1.7), (0.02, 1.72)],
)


def avatar(seed: int, clothes: Path | None = None, body: Path | None = None) -> Labelled:
    """One avatar.

    Args:
        seed: The same gives the same one.
        clothes, body: Folders of MakeHuman's clothes and body, of which half are then made.
    """
    rng = np.random.default_rng((seed, 77))
    figure = random_figure(rng, str(rng.choice(["coarse", "plain"])))
    if rng.random() < 0.5 and clothes is not None:
        figure = makehuman_figure(open_closet(str(clothes), str(body)), rng)[0]
    costume = Costume(f"avatar-{seed}")
    costume.colors, costume.seed = random_colors(rng), seed
    add_skeleton(costume, figure)
    u, chance = rng.uniform, rng.random
    outfit = Outfit(
        float(rng.choice([u(2.4, 2.9), u(1.5, 2.3), u(3.2, 3.8)])) if chance() < 0.9 else None,
        u(4.6, 5.1), bool(chance() < 0.2), float(rng.choice([0.3, u(0.8, 1.6), u(2.3, 2.95)])),
        float(rng.choice([u(0.05, 1.0), u(1.3, 1.8)])) if chance() < 0.4 else None,
        float(rng.choice([u(0.3, 0.9), u(1.2, 1.7), 2.8])) if chance() < 0.6 else None,
        float(rng.choice([0.12, u(0.2, 1.2)])) if chance() < 0.85 else None, u(1.2, 2.9) if chance() < 0.2 else None,
    )  # fmt: skip
    add_clothed_body(costume, figure, outfit, u(0.003, 0.012) * figure.height, form=str(
        rng.choice(["over", "cut", "painted"], p=[0.25, 0.5, 0.25])
    ))  # fmt: skip
    if chance() < 0.8:
        add_face(costume, figure, rng)
    dresser = _Dresser(costume, Scalp(figure, u(0.06, 0.3) * float(figure.skull[1][0])), figure, rng)
    made = dresser.dress()
    if chance() < 0.3:
        made = _with_larger_head(made, figure.at("neck"), dresser.chin, u(1.1, 1.8))
    return _coarse(made, int(np.exp(u(6.3, 8.7)))) if chance() < 0.2 else made


def _with_larger_head(made: Labelled, neck: np.ndarray, chin: float, factor: float) -> Labelled:
    """The head, with its hair and what is worn on it, made larger about the chin."""
    points = made.vertices.copy()
    share = smooth_step(points[:, 1], float(neck[1]), chin)
    share = np.where(made.part == PART["body"], share, 1.0) * (made.carrier == CARRIER["head"])
    centre = np.array([0.0, chin, neck[2]])
    points += (share * (factor - 1))[:, None] * (points - centre)
    points[:, 1] = np.maximum(points[:, 1], 0.0)  # tails that reach the ground lie on it
    return replace(made, vertices=points)


def _coarse(made: Labelled, faces: int) -> Labelled:
    """The figure with next to so few triangles."""
    import fast_simplification

    points, corners = np.unique(np.round(made.vertices, 5), axis=0, return_inverse=True)
    triangles = corners.reshape(-1)[made.faces]
    triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
    if len(triangles) <= faces:
        return made
    few, mesh = fast_simplification.simplify(points.astype(np.float32), triangles.astype(np.int32), target_count=faces)
    return made.on(few.astype(np.float64), mesh.astype(np.int64)) if len(mesh) > 0.2 * faces else made


class _Dresser:
    """Puts apparel on a figure; each piece is labelled where it is made."""

    def __init__(self, costume: Costume, scalp: Scalp, figure: Figure, rng: np.random.Generator):
        self.rng, self.u, self.figure, self.h, self.scalp = rng, rng.uniform, figure, figure.height, scalp
        self.half, self.middle = scalp.half, scalp.center
        self.cap = rng.random() < 0.35  # the wardrobe's own cap and fringe
        if self.cap:
            costume.kind = "hair"
            add_hair(costume, figure, rng, kind=str(rng.choice(["short", "bob"])), colors=("hair", "hair tie"))
        self.made = of_costume(costume)
        self.hair, self.cloth = costume.colors["hair"], costume.colors["cloth"]
        self.chin = float(figure.at("head")[1])

    def chance(self, rate: float) -> bool:
        """Whether something is so."""
        return bool(self.rng.random() < rate)

    def add(
        self, points: np.ndarray, faces: np.ndarray, part: str, carrier: str, hangs: np.ndarray | int,
        paint: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        """Add a piece."""
        count = len(points)
        colour = self.rng.uniform(0.05, 0.95, 3) if paint is None else paint
        state = np.broadcast_to(np.asarray(hangs, np.int8), count)
        kind, holder = (np.full(count, number, np.int8) for number in (PART[part], CARRIER[carrier]))
        self.made = self.made.carried(Labelled(points, faces, kind, state, holder, np.tile(colour, (count, 1))))

    def dress(self) -> Labelled:
        """The figure with what it wears, at random."""
        rng, chance, kinds = self.rng, self.chance, self.rng.choice
        if chance(0.35):
            self.shell()
        if chance(0.15):
            self.robe()
        elif chance(0.75):
            self.skirt(str(kinds(["plain", "pleats", "tiers", "panels"], p=[0.24, 0.24, 0.34, 0.18])))
        if chance(0.25):
            self.skirt(str(kinds(["open", "tails", "apron"])))
        if chance(0.1):
            self.helmet()
        elif chance(0.95):
            grown = partial(self.add, part="hair", carrier="head", paint=self.hair)
            Hair(self.scalp, self.chin, self.h, rng, grown).grow(self.cap)
        if chance(0.2):
            self.hat()
        if chance(0.2):
            self.collar()
        if chance(0.2):  # what hair hides is cut away
            head = (self.made.part == PART["body"]) & (self.made.carrier == CARRIER["head"])
            middle = self.made.vertices[self.made.faces].mean(axis=1)
            behind = (middle[:, 2] < self.middle[2] - 0.1 * self.half[2]) & (middle[:, 1] > self.middle[1])
            self.made = replace(self.made, faces=self.made.faces[~(behind & head[self.made.faces[:, 0]])])
        return self.made

    # Cloth

    def sheet(
        self, drape: Drape, rows: tuple[float, float], turns: tuple[float, float] | None, fold: float, waves: int,
        *, part: str = "skirt", carrier: str = "pelvis", lift: float = 0.0, point: float = 0.0,
        paint: np.ndarray | None = None, flare: float = 0.0, held: bool = True,
    ) -> None:  # fmt: skip
        """A sheet that hangs in rings: places on the drape from 0 to 1, the way round [rad] or all, folds as a share of
        the radius, and how pointed it is.
        """
        u, rng = self.u, self.rng
        width = 2 * np.pi if turns is None else turns[1] - turns[0]
        columns = max(int(rng.integers(16, 40) * width / (2 * np.pi)), 5)
        if waves:
            columns = max(columns, int(waves * rng.integers(2, 5)))
        count = int(rng.integers(4, 13))
        across = np.linspace(0, 1, columns, endpoint=turns is not None)
        angles = (turns[0] if turns else 0.0) + across * width
        fine = drape.points(np.linspace(0, 1, 33), angles)
        axis = np.array([drape.center[0], 0, drape.center[1]])
        t = np.linspace(0, 1, count)
        end = rows[1] - (rows[1] - rows[0]) * point * np.abs(2 * across - 1) ** u(0.6, 2.0)
        place = (rows[0] + t[:, None] * (end - rows[0])) * 32
        low = np.minimum(place.astype(int), 31)
        share, column = (place - low)[..., None], np.arange(columns)
        grid = (1 - share) * fine[low, column] + share * fine[low + 1, column]
        phase = waves * across * (2 * np.pi if turns is None else width)
        wave = np.sign(np.sin(phase)) * u(0.6, 1.0) if self.chance(0.3) else np.sin(phase)
        away = (grid - axis) * [1, 0, 1]
        size = np.linalg.norm(away, axis=-1, keepdims=True)
        ramp = t[:, None, None] ** u(0.3, 1.5)
        out = (fold * wave[None, :, None] + flare) * ramp * np.maximum(size, 0.03 * self.h) + lift
        grid = grid + unit(away) * out
        faces = sheet_faces(count, columns, wrap=turns is None)
        state = np.repeat(np.where(t < 0.12, 0 if held else UNKNOWN, np.where(t < 0.35, UNKNOWN, 1)), columns)
        points = grid.reshape(-1, 3)
        sides = [(points, faces)]
        if self.chance(0.35):
            inner = points - (unit(away) * self.h * float(rng.choice([0.0, 0.002, 0.006]))).reshape(-1, 3)
            sides.append((inner, faces[:, ::-1]))
        for mesh in sides:
            self.add(*mesh, part, carrier, state, paint)

    def skirt(self, kind: str) -> None:
        """A skirt, the tails of a coat or an apron."""
        u, rng, at = self.u, self.rng, self.figure.at
        hip, waist, knee = at("left_hip")[1], at("spine2")[1], at("left_knee")[1]
        top = float(hip + u(-0.1, 1.0) * (waist - hip))
        down = float(rng.choice([u(0.2, 0.7), u(0.7, 1.2), u(1.2, 1.95)], p=[0.62, 0.2, 0.18]))
        hem = min(float(np.interp(down, [0, 1, 2], [hip, knee, at("left_ankle")[1]])), top - 0.05 * self.h)
        outline = Outline(u(0.2, 1.3) if down < 0.8 else u(0.02, 0.6), u(0.4, 1.5), u(0.003, 0.02) * self.h)
        drape = hanging_rings(self.figure, top, hem, outline, convex=self.chance(0.8))
        paint, trim = (self.cloth if self.chance(0.5) else rng.uniform(0.05, 0.95, 3)), rng.uniform(0.05, 0.95, 3)
        if kind == "plain":
            self.sheet(drape, (0, 1), None, u(0, 0.08), int(rng.integers(0, 12)), paint=paint)
        elif kind == "pleats":
            self.sheet(drape, (0, 1), None, u(0.03, 0.15), int(rng.integers(10, 30)), paint=paint)
        elif kind == "tiers":
            count = int(rng.integers(2, 6))
            for tier in range(count):
                begin = max(tier / count - u(0, 0.15), 0.0)
                self.sheet(
                    drape, (begin, (tier + 1) / count), None, u(0.03, 0.2), int(rng.integers(8, 28)),
                    lift=u(0, 0.006) * self.h * (count - tier), flare=u(0, 0.35), held=tier == 0,
                    paint=paint if tier % 2 == 0 else trim,
                )  # fmt: skip
        elif kind == "panels":
            count, gap = int(rng.integers(3, 9)), u(-0.2, 0.25)
            if self.chance(0.5):
                self.sheet(drape, (0, u(0.5, 0.9)), None, u(0, 0.06), 8, lift=-0.003 * self.h, paint=trim)
            for number in range(count):
                begin = 2 * np.pi * (number + 0.5 * gap) / count
                self.sheet(
                    drape, (0, u(0.75, 1.0)), (begin, begin + 2 * np.pi * (1 - gap) / count), 0.0, 0,
                    point=u(0, 0.6), paint=paint, lift=0.004 * self.h * (number % 2),
                )  # fmt: skip
        else:
            wide = {"open": u(0.15, 0.9), "tails": u(1.6, 2.6), "apron": 0.0}[kind]
            turns = (-u(0.4, 1.1), u(0.4, 1.1)) if kind == "apron" else (wide, 2 * np.pi - wide)
            cut = [turns]
            if kind == "tails" and self.chance(0.5):
                cut = [(wide, np.pi - u(0.02, 0.3)), (np.pi + u(0.02, 0.3), 2 * np.pi - wide)]
            for round_it in cut:
                self.sheet(drape, (0, 1), round_it, u(0, 0.06), int(rng.integers(0, 8)), lift=0.008 * self.h,
                           point=u(0, 0.5) * self.chance(0.4), paint=paint)  # fmt: skip
        if self.chance(0.35):  # a belt
            size = (u(0.003, 0.01) * self.h, u(0.005, 0.03) * self.h)
            radii = (float(drape.radii[0].max()), float(drape.radii[0][0]) + 0.005 * self.h)
            self.add(*ring_mesh([drape.center[0], top, drape.center[1]], radii, size), "accessory", "pelvis", 0)

    def robe(self) -> None:
        """A dress or a coat from the shoulders down as one sheet; above the hips it is body."""
        u, at, rng = self.u, self.figure.at, self.rng
        top, hip = float(at("left_shoulder")[1] + u(-0.06, 0.03) * self.h), float(at("left_hip")[1])
        hem = float(np.interp(u(0.5, 2.05), [0, 1, 2], [hip, at("left_knee")[1], at("left_ankle")[1]]))
        outline = Outline(u(0.02, 0.5), u(0.6, 2.2), u(0.004, 0.02) * self.h)
        drape = hanging_rings(self.figure, top, hem, outline, rings=24)
        wide = u(0.05, 0.4)
        turns = (wide, 2 * np.pi - wide) if self.chance(0.5) else None
        rows = slice(len(self.made.vertices), None)
        self.sheet(drape, (0, 1), turns, u(0, 0.08), int(rng.integers(0, 14)), paint=self.cloth)
        high = self.made.vertices[rows, 1] > hip + u(0.0, 0.05) * self.h
        self.made.part[rows][high], self.made.hangs[rows][high] = PART["body"], 0
        self.made.carrier[rows][high] = CARRIER["chest"]
        near = ~high & (self.made.vertices[rows, 1] > hip - 0.04 * self.h)
        self.made.hangs[rows][near] = UNKNOWN

    def shell(self) -> None:
        """Clothes that stand off the body and go with it: an open jacket, wide sleeves, puffed shorts, thick boots."""
        u, skin = self.u, self.figure.skin
        kind = str(self.rng.choice(["jacket", "sleeves", "shorts", "boots"], p=[0.5, 0.2, 0.15, 0.15]))
        start, end, gap = u(0.9, 2.0), u(1.4, 2.95), u(0.0, 0.06) * self.h if kind == "jacket" else -1.0
        low, high, inner, outer = {  # of `Skin.rise` and `Skin.reach`
            "jacket": (u(2.4, 3.6), 4.8, -9, end), "sleeves": (-9, 9, start, max(end, start + 0.5)),
            "shorts": (u(0.9, 1.7), 3.0, -9, 0.55), "boots": (-9, u(0.3, 1.3), -9, 9),
        }[kind]  # fmt: skip
        fields: tuple[Field, ...] = (
            lambda s: s.rise - low, lambda s: high - s.rise, lambda s: s.reach - inner, lambda s: outer - s.reach,
            lambda s: np.where(s.depth > 0, np.abs(s.points[:, 0]) - gap, 1.0),
        )  # fmt: skip
        for field in fields:
            skin = skin.above(field(skin)) if len(skin.faces) else skin
        if not len(skin.faces):
            return
        wide = np.clip(skin.reach - start, 0, 1) if kind in ("jacket", "sleeves") else np.sin(np.pi * skin.rise % np.pi)
        skin = skin.puffed((u(0.008, 0.03) + u(0, 0.05) * np.abs(wide)) * self.h)
        zero = np.zeros(len(skin.points), np.int8)
        colour = np.tile(self.rng.uniform(0.05, 0.95, 3), (len(zero), 1))
        near = self.made.on(skin.points, skin.faces)
        carrier = np.where(near.part == PART["body"], near.carrier, UNKNOWN).astype(np.int8)
        self.made = self.made.carried(Labelled(skin.points, skin.faces, zero, zero, carrier, colour))

    # What is worn

    def hat(self) -> None:
        """A hat turned on a lathe, its tip bent."""
        u, half = self.u, self.half
        profile = np.array(_HATS[int(self.rng.integers(len(_HATS)))]) * [u(0.9, 1.3), u(0.7, 1.3)]
        sides = int(self.rng.integers(10, 25))
        angle = np.arange(sides) * 2 * np.pi / sides
        r, y = profile[:, :1], np.broadcast_to(profile[:, 1:], (len(profile), sides))
        r = r * (half[0] + 1.3 * self.scalp.thick)
        ring = np.stack([r * np.sin(angle), half[1] * y, r * np.cos(angle)], axis=-1)
        ring += (np.maximum(y - 1, 0) ** 2)[..., None] * np.array([u(-0.3, 0.3), -0.2, u(-0.5, 0.1)]) * half[0]
        points = ring.reshape(-1, 3) + self.middle + [0, u(0.1, 0.6) * half[1], u(-0.3, 0.1) * half[2]]
        self.add(points, sheet_faces(len(profile), sides, wrap=True)[:, ::-1], "accessory", "head", 0)

    def helmet(self) -> None:
        """A helmet, or a mask that is drawn over the head and so is body."""
        u, rng = self.u, self.rng
        columns, rows, tight = int(rng.integers(8, 25)), int(rng.integers(6, 13)), self.chance(0.4)
        turn, share = np.arange(columns) * 2 * np.pi / columns, np.linspace(0.02, 1, rows)[:, None]
        edge = u(1.9, 2.8) - u(0, 1.5) * np.exp(-np.square((turn + np.pi) % (2 * np.pi) - np.pi) / u(0.1, 0.6))
        lift = self.scalp.thick * (u(-0.8, 0.0) if tight else u(0.5, 2.0))
        points = self.scalp.at(turn[None], share * np.maximum(edge, 0.8), lift).reshape(-1, 3)
        self.add(points, sheet_faces(rows, columns, wrap=True), "body" if tight else "accessory", "head", 0)

    def collar(self) -> None:
        """A collar, or a short cape about the shoulders."""
        u, figure, short = self.u, self.figure, self.chance(0.5)
        neck, shoulders = figure.at("neck"), figure.skin.points[figure.skin.weights[:, 15] < 0.3]
        y, wide = float(neck[1] - u(0.0, 0.05) * self.h), u(0.0, 0.6)
        low = y - (u(0.03, 0.09) if short else u(0.1, 0.3)) * self.h
        outline = Outline(u(0.05, 0.6), u(0.4, 1.0), 0.01 * self.h)
        rings = hanging_rings(figure, y, low, outline, center=neck[[0, 2]], points=shoulders)
        self.sheet(rings, (0, 1), (wide, 2 * np.pi - wide), u(0, 0.05), int(self.rng.integers(0, 9)),
                   part="accessory" if short else "cape", carrier="chest")  # fmt: skip
