"""Labelled characters of every source: the wardrobe, people in MakeHuman's clothes, families made by code, the
archive's figures.

Labels are -1 where nothing says them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from bunraku.apparel.part_network import CARRIERS, PARTS
from bunraku.core.body.layout import JOINT_NAMES
from bunraku_lab.synthetic.dressed import extras
from bunraku_lab.synthetic.dressed.garments import BodyShape, Piece, Wardrobe, joined
from bunraku_lab.synthetic.dressed.people import covered_by, melted, random_outfit, simplified
from bunraku_lab.synthetic.families import beasts, bipeds, crawlers, sea, toons
from bunraku_lab.synthetic.families.appendages import critter, stubby_beast
from bunraku_lab.synthetic.families.model import Model
from bunraku_lab.synthetic.families.people import humanoid
from bunraku_lab.synthetic.fields import Lump
from bunraku_lab.synthetic.makehuman import pose_points, random_body, random_rest
from bunraku_lab.synthetic.wardrobe.character import is_draped, open_closet, wardrobe_costume
from bunraku_lab.synthetic.wardrobe.model import Costume

PART = {name: number for number, name in enumerate(PARTS)}
CARRIER = {name: number for number, name in enumerate(CARRIERS)}
UNKNOWN = -1
HANGS = 0.5
"""Weight on joints that physics move from which on a vertex hangs, as in `apparel.mask`. The data set defines its masks
so.
"""


@dataclass(frozen=True, eq=False)
class Labelled:
    """A mesh, +Y up and facing +Z.

    Args:
        vertices: [m], shape (V, 3).
        faces: Shape (F, 3).
        part: Number in `PARTS` of each vertex, shape (V,), int8, or -1.
        hangs: 1 where it hangs and physics would move it, 0 where not, -1 unknown, shape (V,), int8.
        carrier: Number in `CARRIERS`, shape (V,), int8, or -1.
        colors: sRGB from 0 to 1, shape (V, 3), or None.
        hands: Where the hands are [m], left and right, shape (2, 3), or None.
    """

    vertices: np.ndarray
    faces: np.ndarray
    part: np.ndarray
    hangs: np.ndarray
    carrier: np.ndarray
    colors: np.ndarray | None = None
    hands: np.ndarray | None = None

    def carried(self, other: Labelled) -> Labelled:
        """With another beside it."""
        names = ("vertices", "part", "hangs", "carrier")
        own = {name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in names}
        both = self.colors is not None and other.colors is not None
        colors = np.concatenate([self.colors, other.colors]) if both else None  # type: ignore[list-item]
        faces = np.concatenate([self.faces, other.faces + len(self.vertices)])
        return replace(self, faces=faces, colors=colors, **own)

    def on(self, vertices: np.ndarray, faces: np.ndarray) -> Labelled:
        """Its labels on another mesh of the same shape, from the nearest vertices."""
        corner = self.vertices[self.faces]
        middle = np.concatenate([self.vertices, corner.mean(axis=1)])
        owner = np.concatenate([np.arange(len(self.vertices)), self.faces[:, 0]])
        near = owner[cKDTree(middle).query(vertices)[1]]
        colors = None if self.colors is None else self.colors[near]
        return Labelled(vertices, faces, self.part[near], self.hangs[near], self.carrier[near], colors, self.hands)


_SIDES = {"left": ("left", "Left", "左"), "right": ("right", "Right", "右")}
_CARRIED = {
    "head": "head neck Head Neck 頭 首 Jaw Eye Ear 両目 目",
    "chest": "spine1 spine2 spine3 collar Spine Spine1 Spine2 Shoulder 上半身 上半身2 肩",
    "pelvis": "pelvis Hips 下半身 センター グルーブ 全ての親",
}
_LIMBS = {
    "arm": ("shoulder elbow wrist 腕 ひじ 手首", ("Arm", "ForeArm", "Hand")),
    "leg": ("hip knee ankle foot 足 ひざ 足首 つま先", ("UpLeg", "Leg", "Foot", "Toe")),
}
"""Names of joints with what they carry, and beginnings of others."""


def carrier_of(name: str) -> int:
    """Number in `CARRIERS` of a joint by its name in the body's layout, the wardrobe (Japanese) or a family."""
    side = next((side for side, marks in _SIDES.items() if name.startswith(marks)), "")
    word = name
    for mark in ("left_", "right_", "Left", "Right", "左", "右"):
        word = word.removeprefix(mark)
    for carrier, words in _CARRIED.items():
        if word in words.split():
            return CARRIER[carrier]
    for limb, (joints, begins) in _LIMBS.items() if side else ():
        if word in joints.split() or word.startswith(begins):
            return CARRIER[f"{side} {limb}"]
    return UNKNOWN


def draped(seed: int) -> Labelled:
    """A character of the wardrobe with a coat, a cape or wide sleeves."""
    while not is_draped(seed):
        seed += 1_000_000
    return of_costume(wardrobe_costume(seed))


def wardrobe(seed: int, closet: Path | None = None, body: Path | None = None) -> Labelled:
    """A character of the wardrobe."""
    return of_costume(wardrobe_costume(seed, clothes=closet, body_data=body))


def of_costume(costume: Costume) -> Labelled:
    """A character of the wardrobe, or what is made of it so far, with labels."""
    moved = np.zeros(len(costume.bones), bool)
    moved[[one.bone for one in costume.bodies if one.dynamic and one.bone >= 0]] = True
    group = np.full(len(costume.bones), UNKNOWN)
    for number, bone in enumerate(costume.bones):  # parents come first
        moved[number] |= bone.parent >= 0 and moved[bone.parent]
        group[number] = group[bone.parent] if moved[number] else carrier_of(bone.name)
    hips = np.mean([costume.bones[costume.bone_index(f"{mark}足")].position[1] for mark in "左右"])
    pieces: list[Labelled] = []
    for part in costume.parts:
        count = len(part.points)
        swings = (part.shares * moved[part.bones]).sum(axis=1) > HANGS
        first = part.bones[np.arange(count), part.shares.argmax(axis=1)]
        material = np.broadcast_to(part.material, len(part.faces))
        paint = np.stack([costume.colors.get(name, np.full(3, 0.6)) for name in material])
        label = np.full(count, PART.get(part.kind, 0))
        carrier = group[first]
        if part.kind == "coat":  # its upper half is a jacket
            low = swings | (part.points[:, 1] < hips)
            label = np.where(low, PART["skirt"], PART["body"])
            carrier = np.where(low, CARRIER["pelvis"], carrier)
        elif part.kind in ("hair", "accessory"):
            label[:] = PART["hair"] if (material == "hair").mean() > 0.5 else PART["accessory"]
        elif part.kind == "skirt":
            carrier = np.full(count, CARRIER["pelvis"])
        # One vertex a corner keeps the borders of colours sharp.
        corners = part.faces.reshape(-1)
        kinds, states, holders = (values[corners].astype(np.int8) for values in (label, swings, carrier))
        triangles, tint = np.arange(len(corners)).reshape(-1, 3), np.repeat(paint, 3, axis=0)
        pieces.append(Labelled(part.points[corners], triangles, kinds, states, holders, tint))
    names = ("vertices", "part", "hangs", "carrier", "colors")
    all_of = {name: np.concatenate([getattr(piece, name) for piece in pieces]) for name in names}
    out = Labelled(faces=np.arange(len(all_of["part"])).reshape(-1, 3), **all_of)
    hands = np.array([costume.bones[costume.bone_index(f"{mark}手首")].position for mark in "左右"])
    elbows = np.array([costume.bones[costume.bone_index(f"{mark}ひじ")].position for mark in "左右"])
    return replace(out, hands=hands + 0.35 * (hands - elbows))


_OUTFIT = {
    "spikes": "hair", "hat": "accessory", "helmet": "accessory", "glasses": "accessory", "bag": "accessory",
    "shoulder_pads": "accessory", "cape": "cape", "tail": "tail", "ears": "tail", "long skirt": "skirt",
}  # fmt: skip


def dressed(clothes: Wardrobe, seed: int) -> Labelled:
    """A person of MakeHuman in clothes of the archive, or cut from the base mesh, or next to none."""
    rng = np.random.default_rng((seed, 42))
    vertices = clothes.body.shape(random_body(rng))
    figure = BodyShape(vertices, clothes.body.joints(vertices))
    outfit = random_outfit(clothes, figure, rng)
    for kind, extra in (("cape", extras.cape), ("tail", extras.tail), ("ears", extras.ears)):
        if kind not in outfit.names and rng.random() < 0.12:
            outfit.add(kind, extra(clothes, figure, rng), hangs=True)
    skin = clothes.part(figure, "body")
    rest = [skin]
    if rng.random() < 0.6 and outfit.hidden:
        seen = np.ones(len(vertices), bool)
        seen[covered_by(figure, outfit)] = False
        rest = [clothes.part(figure, "body", keep=seen)]
    if rng.random() < 0.6:
        rest.append(clothes.part(figure, "helper-l-eye", "helper-r-eye"))
    whole = joined([*outfit.pieces, *rest])
    part, hangs, tint = [], [], []
    group = np.array([carrier_of(name) for name in JOINT_NAMES])
    carrier = group[whole.joints.argmax(axis=1)]
    start = 0
    skull = figure.joints[JOINT_NAMES.index("head"), 1]
    height = float(np.ptp(vertices[:, 1]))
    for name, piece, swings in zip(outfit.names, outfit.pieces, outfit.hangs, strict=True):
        count = len(piece.points)
        own = np.broadcast_to(swings, count).astype(np.int8)
        kind = _OUTFIT.get(name.split(" ")[0] if name.startswith("skirt") else name, "")
        if name in clothes.hair:
            kind = "hair"
            if own.any():  # the cap stays, what is below the ears hangs, and where it begins is unknown
                y = piece.points[:, 1]
                own = np.where(y < skull + 0.02 * height, 1, np.where(y > skull + 0.08 * height, 0, UNKNOWN)).astype(
                    np.int8
                )
        elif name in clothes.hats:
            kind = "accessory"
        elif name.startswith("skirt") or name == "long skirt":
            kind = "skirt"
        label = np.full(count, PART[kind or "body"])
        if not kind and own.any():
            label[own > 0] = PART["skirt"]
        rows = slice(start, start + count)
        fixed = {"skirt": "pelvis", "cape": "chest", "hair": "head"}
        if kind in fixed:
            carrier[rows] = CARRIER[fixed[kind]]
        elif not kind:
            carrier[rows][label == PART["skirt"]] = CARRIER["pelvis"]
        part.append(label)
        hangs.append(own)
        tint.append(np.tile(rng.uniform(0.05, 0.95, 3), (count, 1)))
        start += count
    left = len(whole.points) - start
    part.append(np.zeros(left, np.int64))
    hangs.append(np.zeros(left, np.int8))
    tint.append(np.tile(rng.uniform([0.4, 0.25, 0.2], [0.95, 0.8, 0.75]), (left, 1)))
    linear = random_rest(rng, figure.joints)
    points, joints = pose_points(whole.points, figure.joints, whole.joints, linear)
    wrists, elbows = (
        joints[[JOINT_NAMES.index(f"{side}_{name}") for side in ("left", "right")]] for name in ("wrist", "elbow")
    )
    marks = np.concatenate(part), np.concatenate(hangs), carrier
    kinds, states, holders = (values.astype(np.int8) for values in marks)
    hands = wrists + 0.35 * (wrists - elbows)
    plain = Labelled(points, whole.faces, kinds, states, holders, np.concatenate(tint), hands)
    form = rng.random()
    posed = Piece(points, whole.faces, whole.joints, whole.handles)
    if form < 0.12:
        solid = Piece(
            pose_points(skin.points, figure.joints, skin.joints, linear)[0], skin.faces, skin.joints, skin.handles
        )
        cell = float(np.ptp(points[:, 1]) / rng.uniform(70, 120))
        mesh = melted(posed, solid, cell, cell * float(rng.uniform(0.6, 1.0)))
        return plain.on(mesh.points, mesh.faces)
    if form < 0.3:
        mesh = simplified(posed, int(rng.integers(1200, 6000)))
        return plain.on(mesh.points, mesh.faces) if mesh is not posed else plain
    return plain


_REGIONS = {
    "hair": "hair", "bun": "hair", "long": "hair", "hat": "accessory", "brim": "accessory", "helmet": "accessory",
    "hood": "accessory", "crown": "accessory", "visor": "accessory", "crest": "accessory", "skirt": "skirt",
    "coat": "skirt", "cape": "cape", "tail": "tail", "ear": "tail", "backpack": "accessory", "belt": "accessory",
    "scarf": "accessory", "pad": "accessory", "pouch": "accessory", "item": "prop", "button": "body",
    "armour": "accessory",
}  # fmt: skip
_BONES = {"Hair": "hair", "Ear": "tail", "Tail": "tail"}
_MAKERS = {
    "humanoid": humanoid, "mascot": toons.mascot, "blob": toons.blob, "flyer": toons.flyer,
    "quadruped": beasts.quadruped, "dragon": beasts.dragon, "frog": beasts.frog, "dinosaur": bipeds.dinosaur,
    "bird": bipeds.bird, "mech": bipeds.mech, "fish": sea.fish, "whale": sea.whale, "ray": sea.ray,
    "insect": crawlers.insect, "spider": crawlers.spider, "crab": crawlers.crab, "snake": crawlers.snake,
    "critter": critter, "stubby_beast": stubby_beast,
}  # fmt: skip


def code_made(family: str, seed: int) -> Labelled:
    """A character of a family. What animals have by nature does not hang; hair, capes and skirts of people do."""
    m = Model(np.random.default_rng([sum(map(ord, family)), seed, 42]))
    _MAKERS[family](m)
    person = family == "humanoid"
    drop_before = m.parts
    character = m.character(family)
    low = np.array([0, 0.0, 0])
    points = np.asarray(character.vertices, np.float64)
    # The finished mesh stands on the ground; the parts do not yet.
    rig = character.rig
    assert rig is not None
    shift = np.median(rig.positions - np.stack([at for _, at in m.bones.values()]), axis=0)
    raw = points - shift + low
    x, y, z = np.ascontiguousarray(raw.T)
    best, label = np.full(len(raw), np.inf), np.zeros(len(raw), np.int64)
    for one in drop_before:
        if isinstance(one.shape, Lump):
            if one.shape.carve:
                continue
            gap = np.abs(one.shape.distance(x, y, z))
        else:
            corner = one.shape[0]
            middle = np.concatenate([corner, corner[one.shape[1]].mean(axis=1)])
            gap = cKDTree(middle).query(raw)[0] * 0.5
        kind = _REGIONS.get(one.region.split(" ")[0], "body")
        if isinstance(one.share, str):
            for word, what in _BONES.items():
                if word in one.share:
                    kind = what
        if one.region.startswith(("Left", "Right", "Hair")):
            for word, what in _BONES.items():
                if word in one.region:
                    kind = what
        near = gap < best
        best[near], label[near] = gap[near], PART[kind]
    names = list(rig.names)
    of_people = family in ("humanoid", "mascot", "critter")
    group = np.array([carrier_of(name) if of_people else UNKNOWN for name in names])
    first = rig.indices[np.arange(len(raw)), rig.weights.argmax(axis=1)]
    carrier = group[first]
    height = float(np.ptp(points[:, 1]))
    hangs = np.zeros(len(raw), np.int8)
    if person or family == "critter":
        hangs[np.isin(label, [PART["cape"], PART["skirt"]])] = 1
        carrier[label == PART["skirt"]], carrier[label == PART["cape"]] = CARRIER["pelvis"], CARRIER["chest"]
        hangs[label == PART["tail"]] = 1 if person else 0
        hair = label == PART["hair"]
        neck = next((rig.positions[names.index(name), 1] for name in ("Neck",) if name in names), None)
        if hair.any() and neck is not None:
            hangs[hair & (points[:, 1] < neck)] = 1
            hangs[hair & (points[:, 1] >= neck) & (points[:, 1] < neck + 0.06 * height)] = UNKNOWN
    hands = None
    if "LeftHand" in names and "RightHand" in names:
        hands = rig.positions[[names.index("LeftHand"), names.index("RightHand")]]
    colors = None if character.colors is None else character.colors / 255
    return Labelled(points, character.faces, label.astype(np.int8), hangs, carrier.astype(np.int8), colors, hands)


@lru_cache(maxsize=1)
def closet_of(clothes: str, body: str) -> Wardrobe:
    """MakeHuman's clothes and body."""
    return open_closet(clothes, body)
