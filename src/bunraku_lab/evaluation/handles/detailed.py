"""Detailed people that no training of handles saw: long hair, hats, hoods, armour, coats, skirts and what hangs.

Seven people of the archive that are held out, three avatars that were made elsewhere, and ten of the wardrobe, which no
handles were trained on: twenty in all. The list was written before anything was measured on it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from bunraku_lab.evaluation.handles.subjects import Subject, load_subject, subject

__all__ = ["ARCHIVE", "AVATARS", "WARDROBE", "detailed_subjects"]

ARCHIVE: tuple[str, ...] = (
    "kaykit/Rogue_Hooded", "quaternius/modular_men/King", "quaternius/modular_women/Formal",
    "quaternius/modular_women/Witch", "quaternius/single_knight_pack/KnightCharacter",
    "quaternius2019/Smooth_Female_Dress", "valid/Black_F_1_Busi",
)  # fmt: skip
"""Held-out characters of the archive, by their paths in it."""
AVATARS: tuple[str, ...] = ("MS_Uka.pmx", "Gene.pmx", "Godette_vrm_v4.vrm")
"""Files of avatars, wherever they lie in a folder of them."""
WARDROBE: tuple[int, ...] = tuple(range(900_000, 900_010))
"""Seeds of wardrobe characters."""


def detailed_subjects(characters: Path | None = None, avatars: Path | None = None) -> dict[str, Callable[[], Subject]]:
    """How to load each detailed person, by name; files that are not there are left out.

    Args:
        characters: Folder of the archive.
        avatars: Folder of avatars, searched through.
    """
    out: dict[str, Callable[[], Subject]] = {}
    for name in ARCHIVE if characters is not None else ():
        assert characters is not None
        path = characters / f"{name}.glb"
        if path.is_file():
            out[name] = partial(load_subject, path, name)
    found = sorted(avatars.rglob("*")) if avatars is not None else []
    for path in found:
        if path.name in AVATARS:
            out[path.stem] = partial(load_subject, path, path.stem)
    for seed in WARDROBE:
        out[f"wardrobe/{seed}"] = partial(_wardrobe, seed)
    return out


def _wardrobe(seed: int) -> Subject:
    from bunraku_lab.synthetic.wardrobe import wardrobe_character

    return subject(wardrobe_character(seed), f"wardrobe/{seed}")
