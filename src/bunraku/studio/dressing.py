"""The apparel of takes: which vertices it is, as the page paints it, and how it moves."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.arrays import read_npy
from bunraku.core.character import Character, Handles
from bunraku.core.files import atomic_write, read_bounded
from bunraku.core.request import Progress
from bunraku.errors import CharacterError, FormatError, OptionError
from bunraku.files import document_of
from bunraku.pipelines.requests import Apparel
from bunraku.retarget.fit import Stages
from bunraku.studio.wire import Dressed, Take, body_of

if TYPE_CHECKING:
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.apparel.chains.chain_rig import Chained

WORN = "worn.bin"
"""What is found of a character, beside its mesh."""
_MAGIC = b"BNRM"


def save_worn(character: Character, found: np.ndarray | None, path: Path, numbers: np.ndarray | None = None) -> None:
    """Write what was found of a character, vertices that are apparel (V,), None where that is not known, and which
    vertices the page draws: `BNRM`, the length of a JSON header, the header (`vertices`, `parts`: mesh, primitive,
    rows, and `numbered`), `packed_bits` of the mask, for each primitive the vertex of the character that each of its
    rows is, uint32, and where it is numbered the part of each vertex, uint16: 0 is the body, and others are the entries
    of the record's `dress`, from 1 on, which `numbers` (V,) has from 0 on, -1 on the body.
    """
    source = document_of(character)
    parts: list[dict[str, int]] = []
    rows: list[np.ndarray] = []
    start, mesh = 0, 0
    for part in source.parts:
        members: dict[int, np.ndarray] = {}
        for group in part.groups:
            members |= dict.fromkeys(group.primitives, source.index[start : start + len(group.vertices)])
            start += len(group.vertices)
        if not any(len(index) for index in members.values()):
            continue
        for primitive, (_, index) in enumerate(sorted(members.items())):
            parts.append({"mesh": mesh, "primitive": primitive, "rows": len(index)})
            rows.append(index.astype("<u4"))
        mesh += 1
    count = len(character.vertices)
    words = json.dumps({"vertices": count, "parts": parts, "numbered": numbers is not None}).encode()
    words += b" " * (-len(words) % 4)
    bits = packed_bits(np.zeros(count, bool) if found is None else found)
    with atomic_write(path) as file:
        file.write(b"".join([_MAGIC, struct.pack("<I", len(words)), words, bits, *(row.tobytes() for row in rows)]))
        file.write(b"" if numbers is None else (numbers + 1).astype("<u2").tobytes())


def packed_bits(mask: np.ndarray) -> bytes:
    """A bit for each entry, lowest first, padded to four bytes."""
    bits = np.packbits(mask, bitorder="little").tobytes()
    return bits + b"\0" * (-len(bits) % 4)


def shown_mask(worn: Path, painted: Path) -> bytes:
    """The file of `save_worn` as the page gets it, with the painted mask where there is one; FormatError where a file
    is broken.
    """
    data = read_bounded(worn)
    start, count = _head(worn, data)
    if not painted.is_file():
        return data
    mask = read_npy(painted, read_bounded(painted))
    if mask.shape != (count,):
        raise FormatError(painted.name, f"it is not a mask of {count:,} vertices; paint it again")
    bits = packed_bits(mask > 0.5)
    return data[:start] + bits + data[start + len(bits) :]


def found_mask(worn: Path) -> np.ndarray:
    """What was found, shape (V,), bool; FormatError where the file is broken."""
    data = read_bounded(worn)
    start, count = _head(worn, data)
    return np.unpackbits(np.frombuffer(data[start:], np.uint8), count=count, bitorder="little").astype(bool)


def _head(worn: Path, data: bytes) -> tuple[int, int]:
    """Where the bits begin, and how many there are."""
    try:
        length = struct.unpack("<I", data[4:8])[0]
        header: dict[str, Any] = json.loads(data[8 : 8 + length])
        count = int(header["vertices"])
    except (ValueError, KeyError, TypeError, struct.error):
        raise FormatError(worn.name, "it is broken; open the character again") from None
    if data[:4] != _MAGIC or len(data) < 8 + length + len(packed_bits(np.zeros(count, bool))):
        raise FormatError(worn.name, "it is broken; open the character again")
    return 8 + length, count


def painted_file(source: Path) -> Path:
    """Where the painted mask of a character's file is."""
    return source.with_name(f"{source.stem}.apparel.npy")


def clean_mask(worn: Path, bits: bytes) -> np.ndarray:
    """The mask of `packed_bits` that a page sent for the file of `save_worn`, shape (V,), bool; OptionError where it is
    of another mesh, FormatError where the file is broken.
    """
    _, count = _head(worn, read_bounded(worn))
    if len(bits) != len(packed_bits(np.zeros(count, bool))):
        raise OptionError(f"this is not a mask of {count:,} vertices; reload the page")
    return np.unpackbits(np.frombuffer(bits, np.uint8), count=count, bitorder="little").astype(bool)


def paint(mask: np.ndarray, path: Path) -> None:
    """Write a painted mask; FormatError where it cannot be written."""
    packed = io.BytesIO()
    np.save(packed, mask, allow_pickle=False)
    with atomic_write(path) as file:
        file.write(packed.getvalue())


MOST_POSITIONS = 30_000_000
"""Vertices times frames of apparel that moves on its own, which takes 24 bytes for each."""
LEAST = 0.01
"""Share of a mesh that is apparel where there is some."""


def check_fits(apparel: Apparel, character: Character, seconds: float) -> None:
    """Whether apparel of a clip of some seconds can move so, before the work.

    Raises:
        CharacterError: It is to be simulated, and the file says nothing of physics.
        OptionError: It moves on its own, and the mesh is too large for so long a clip.
    """
    from bunraku.apparel.chains.moving import check_apparel
    from bunraku.pipelines.apparel import RATE

    if apparel.motion == "simulate":
        check_apparel(character)
    most = MOST_POSITIONS / (RATE * len(character.vertices))
    if apparel.motion in ("learn", "chains") and seconds > most:
        raise OptionError(
            f"moving apparel of {len(character.vertices):,} vertices does not fit into the studio for {seconds:g} "
            f"seconds; take at most {most:.1f}, or use the command line"
        )


def dress_take(body: Animation | RigAnimation, apparel: Apparel, report: Progress) -> Take:
    """A take of an animation with its apparel moved; errors are those of `check_fits` and `dressed`."""
    from bunraku.core.animation import PointAnimation
    from bunraku.pipelines.apparel import dressed

    if not apparel.moves:
        return body
    check_fits(apparel, body.character, len(body.motion) / body.fps)
    moved = dressed(body, apparel, report)
    if apparel.motion == "chains" and isinstance(moved, RigAnimation):
        return Dressed.of_chains(body, moved, apparel.stiffness, apparel.gravity)
    return Dressed(body, moved, apparel.stiffness) if isinstance(moved, PointAnimation) else moved


def redress_take(
    take: Take, apparel: Apparel, handles: Handles, *, in_place: bool = False, stages: Stages | None = None,
    report: Progress,
) -> Take:  # fmt: skip
    """A take of the same motion whose apparel moves otherwise. The stages fit the motion to the character, with its
    handles, where that is done again; `in_place` says that the travel was removed from it.

    Raises:
        CharacterError: There is no such apparel.
        OptionError: What moves its bones is not known as a motion of the body.
    """
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.core.motion import resample
    from bunraku.pipelines.apply import apply_motion, apply_rigged, reference_of
    from bunraku.pipelines.requests import RATE, Constraints
    from bunraku.retarget.rig_parts import RigParts

    body = body_of(take)
    check_fits(apparel, body.character, len(body.motion) / body.fps)
    if apparel.motion in ("learn", "chains") or (not apparel.moves and isinstance(body, Animation)):
        return dress_take(body, apparel, report)
    if isinstance(body, RigAnimation) and body.reference is None:
        raise OptionError(
            "the bones of this take were moved by its file; drop that file again with other hair and clothes"
        )
    motion, constraints = reference_of(body), Constraints.of(in_place=in_place)
    if apparel.motion == "simulate":
        motion = resample(motion, RATE)  # apparel swings faster than 20 frames a second can show
        moved = apply_rigged(motion, RigParts.of(body.character), constraints, stages, report)
        return dress_take(moved, apparel, report)
    return apply_motion(motion, Anatomy.of(body.character, handles), constraints, stages, report)


def apparel_mask_of(character: Character) -> np.ndarray:
    """Which vertices of a character are apparel, by its file or else by a network, shape (V,), bool."""
    from bunraku.apparel.mask import apparel_mask, artist_mask
    from bunraku.apparel.parts import parts_of

    mask = artist_mask(character)
    if mask is None:
        mask = apparel_mask(character)
    return parts_of(character).hangs if mask is None else mask


def has_apparel(mask: np.ndarray | None) -> bool:
    """Whether so much of a mesh is apparel that there is some."""
    return mask is not None and bool(mask.mean() >= LEAST)


def chains_of(anatomy: Anatomy) -> tuple[Chained | None, str]:
    """A character with chains of bones over its apparel; None with a sentence where there are none."""
    from bunraku.pipelines.clothes import rig_with_chains

    try:
        return rig_with_chains(anatomy), ""
    except CharacterError as error:
        return None, str(error)


def chain_facts(made: Chained) -> list[dict[str, Any]]:
    """What a page shows of chains: name, kind, points at rest [m], and the handle that carries each."""
    carriers: dict[int, int] = {}
    facts = []
    for chain in made.chains:
        carrier = carriers.get(chain.holder, int(chain.holder))
        carriers |= dict.fromkeys(chain.bones.tolist(), carrier)
        points = chain.points.astype(float).round(5).tolist()
        facts.append({"name": chain.name, "kind": chain.kind, "joint": carrier, "points": points})
    return facts
