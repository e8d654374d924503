"""Labels of the archive's figures, from the names of their nodes, materials and bones."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bunraku.core.character import Character
from bunraku.files import load_character
from bunraku_lab.datasets.characters.training_character import facing_rotation
from bunraku_lab.datasets.labelled.figures import PART, UNKNOWN, Labelled

_PROPS = ("axe", "shield", "mug", "sword", "spellbook", "wand", "staff", "knife", "crossbow", "throwable", "pistol")
_WORN = ("hat", "helmet", "backpack")
_HEAD = {
    "hair": "hair", "hair_white": "hair", "hair_blond": "hair", "hair_brown": "hair", "hair_black": "hair",
    "hairbase": "hair", "moustache": "hair", "earrings": "accessory", "gold": "accessory",
    "worker_yellow": "accessory", "skin": "body", "skin_darker": "body", "eye": "body", "eyes": "body",
    "eyebrows": "body", "pants": "body", "shirt": "body", "shoes": "body",
}  # fmt: skip
_ROBES = ("dress", "robe")


def archive_figure(path: Path, name: str, rng: np.random.Generator) -> Labelled | None:
    """A figure of the archive, facing +Z; of several things for the same hand it holds one. None without a rig.

    Args:
        path: Its file.
        name: Path in the archive without the suffix.
        rng: Chooses what it holds.
    """
    character = load_character(path)
    rig = character.rig
    if rig is None:
        return None
    node, material = _names(character)
    bone = np.array([one.lower() for one in rig.names])
    first = rig.indices[np.arange(len(node)), np.nan_to_num(rig.weights).argmax(axis=1)]
    part = np.zeros(len(node), np.int64)
    hangs = np.zeros(len(node), np.int64)
    person = "0ad/people" in name or name.startswith(("kaykit", "quaternius/modular", "quaternius2019/Smooth", "valid"))
    for number, word in enumerate(bone):
        rows = first == number
        if word.startswith("tail") or (word.startswith("ear") and not word.startswith("earth")):
            part[rows] = PART["tail"]
        elif word.startswith("cape"):
            part[rows], hangs[rows] = PART["cape"], 1
        elif word.startswith(("loincloth", "robe")):
            part[rows], hangs[rows] = PART["skirt"], 1
        elif word.startswith(("hair", "beard")):
            part[rows] = PART["hair"]
    keep = np.ones(len(character.faces), bool)
    held: dict[str, list[str]] = {}
    for label in dict.fromkeys(node.tolist()):
        rows, word = node == label, label.lower()
        if any(prop in word for prop in _PROPS):
            part[rows], hangs[rows] = PART["prop"], 0
            held.setdefault(str(bone[first[rows][0]]), []).append(label)
        elif "cape" in word:
            part[rows], hangs[rows] = PART["cape"], 1
        elif any(one in word for one in _WORN):
            part[rows] = PART["accessory"]
        elif "wig" in word:
            part[rows], hangs[rows] = PART["hair"], UNKNOWN
        elif word.endswith("_head") or name.startswith("quaternius2019"):
            for paint in dict.fromkeys(material[rows].tolist()):
                own = rows & (material == paint)
                kind = _HEAD.get(paint.lower(), "" if word.endswith("_head") else "body")
                part[own] = PART[kind] if kind else UNKNOWN
                if kind == "hair":
                    hangs[own] = UNKNOWN if "female" in name.lower() or "women" in name else 0
                elif not kind:
                    hangs[own] = UNKNOWN
        elif "women" in name and word.endswith(("formal_legs", "witch_legs", "medieval_legs")):
            own = rows & ~np.char.startswith(np.char.lower(material.astype(str)), "skin")
            part[own], hangs[own] = UNKNOWN, UNKNOWN
    for labels in held.values():
        kept = str(rng.choice([*labels, ""]))
        for label in labels:
            if label != kept:
                keep &= (node != label)[character.faces[:, 0]]
    turn = facing_rotation(name, rig.names, rig.positions)
    vertices = np.asarray(character.vertices, np.float64) @ turn.T
    joints = rig.positions @ turn.T
    if "0ad/people" in name:  # one surface: what goes round both legs is not known, but in long robes
        low = np.isin(first, [i for i, word in enumerate(bone) if "thigh" in word or "calf" in word or "leg" in word])
        robe = any(word in name for word in _ROBES)
        part[low] = PART["skirt"] if robe else UNKNOWN
        hangs[low] = 1 if robe else UNKNOWN
    if person or "skeleton" in name.lower():
        part[(part == PART["tail"]) & np.char.startswith(bone[first].astype(str), "ear")] = PART["body"]
    hands = [
        next((joints[i] for i, word in enumerate(bone) if "hand" in word and word.endswith(end)), None)
        for end in ("l", "r")
    ]
    both = None if not person or any(hand is None for hand in hands) else np.stack(hands)  # type: ignore[arg-type]
    used = character.faces[keep]
    colors = None if character.colors is None else character.colors / 255
    carrier = np.full(len(node), UNKNOWN, np.int8)
    return Labelled(vertices, used, part.astype(np.int8), hangs.astype(np.int8), carrier, colors, both)


def _names(character: Character) -> tuple[np.ndarray, np.ndarray]:
    """Names of the node and of the material of each vertex, shape (V,) each."""
    source = character.source
    tree = source.document.tree
    nodes, materials = [], []
    for part in source.parts:
        named = str(tree["nodes"][part.node].get("name", ""))
        for group in part.groups:
            paint = np.full(len(group.vertices), "", dtype=object)
            for number, triangles in zip(group.primitives, group.triangles, strict=True):
                index = tree["meshes"][part.mesh]["primitives"][number].get("material")
                if index is not None:
                    paint[np.unique(triangles)] = str(tree["materials"][index].get("name", ""))
            nodes.append(np.full(len(paint), named, dtype=object))
            materials.append(paint)
    return np.concatenate(nodes)[source.index], np.concatenate(materials)[source.index]
