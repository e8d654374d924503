"""Clips of animals, monsters and machines as handle motions: `bunraku data motions --creatures`.

Each character gets the handles that the shipped predictor gives its bare mesh, as those of whoever has an unrigged
copy. Its clips are registered to them and taken to the reference body (`bunraku.retarget.reference`), from where
`fit_motion` of a motion of their own body takes them back. `creature_clips.json` holds the species of every file, the
action and the words of every label, and, in place of those words, sentences of whoever watched the clip. Of people with
equal clips one is taken, without the walking that motion capture has more of; they join as clips of any humanoid.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.errors import BunrakuError, CharacterError
from bunraku.retarget.from_mesh import handle_motion_of_mesh
from bunraku.retarget.reference import motion_to_reference
from bunraku_lab.datasets.archive import present_files
from bunraku_lab.datasets.characters.build import HELD_OUT
from bunraku_lab.datasets.characters.known_rigs import facing_turn
from bunraku_lab.datasets.motions.clips import load_clip, load_index, write_clip, write_index
from bunraku_lab.datasets.motions.strides import forward_speed, played_on, with_travel

__all__ = [
    "HELD_OUT_SPECIES", "CreatureBody", "CreatureClip", "add_creatures", "clip_vertices", "creature_body",
    "creature_clips", "creature_split", "known_plan",
    "reference_motion",
]  # fmt: skip

HELD_OUT_SPECIES: tuple[str, ...] = (
    "bull", "shiba inu", "rat", "velociraptor", "spider", "crab", "dragon", "bee", "tuna", "betta", "puffer",
    "manta ray", "goblin",
)  # fmt: skip
"""Species that no training sees: hoofed and clawed animals, a biped with a tail, eight legs, claws, wings, fish. No
predictor saw them.
"""

VALIDATION_SPECIES: tuple[str, ...] = ("llama", "tetra", "turbot", "parasaurolophus")

FPS = 20.0
LEAST_FRAMES = 8
_TRAVELS = ("walk", "run", "trot", "gallop", "sneak", "crawl", "carry", "run carry")
_CYCLES = (
    *_TRAVELS,
    "swim",
    "swim fast",
    "swim impulse",
    "fly",
    "glide",
    "hover",
    "idle",
    "idle head low",
    "alert",
    "eat",
    "sleep",
    "sit",
    "dance",
)
LEAST_LOOP = 40  # frames to which shorter loops are played on
_SEEN_ON_PEOPLE = ("walk", "run", "idle", "crawl")  # motion capture has these, and game clips of them are poorer
_FLOATS = ("fish", "flyer", "snake", "blob")


@dataclass(frozen=True)
class CreatureClip:
    """One labelled clip of the archive.

    Args:
        file: The character, as a path in the archive without suffix.
        label: Name of the clip in the file.
        name: Name of the clip in the index.
        action: Canonical action, such as "walk" or "attack".
        plan: Body plan, such as "quadruped" or "fish".
        species: The best word first.
        person: A person, whose clip fits any humanoid.
        texts: Captions.
        weight: How much it counts beside its like.
    """

    file: str
    label: str
    name: str
    action: str
    plan: str
    species: tuple[str, ...]
    person: bool
    texts: tuple[str, ...]
    weight: float = 1.0


class _Character(TypedDict, total=False):
    """What the table says of a character about its clips being watched."""

    watched: dict[str, list[str]]
    watched_like: str


@lru_cache(maxsize=1)
def _table() -> dict[str, Any]:
    table: dict[str, Any] = json.loads(
        resources.files("bunraku_lab.datasets.motions").joinpath("creature_clips.json").read_text(encoding="utf-8")
    )
    return table


def _taken_elsewhere() -> dict[str, dict[str, str]]:
    taken: dict[str, dict[str, str]] = json.loads(
        resources.files("bunraku_lab.datasets.motions").joinpath("game_clips.json").read_text(encoding="utf-8")
    )
    return taken


def _sentences(species: tuple[str, ...], generic: str, phrases: list[str]) -> tuple[str, ...]:
    """Each phrase said of each word, then of "the animal": "a horse gallops"."""
    out = [f"{'an' if word[0].lower() in 'aeio' else 'a'} {word} {phrase}" for phrase in phrases for word in species]
    if species[0] != "person":
        out.append(f"the {generic} {phrases[0]}")
    return tuple(dict.fromkeys(out))


def _seen(characters: Mapping[str, _Character], file: str, word: str) -> list[str] | None:
    """Phrases written from watching this clip; they stand with the character named in `watched_like` where the same was
    seen on it.
    """
    known = characters[file]
    like = characters.get(known.get("watched_like", ""))
    return known.get("watched", {}).get(word) or (like or known).get("watched", {}).get(word)


def creature_clips(file: str, labels: list[str]) -> list[CreatureClip]:
    """What the table says of the clips of a character; those that it does not name are left out.

    Args:
        file: Path in the archive without suffix.
        labels: Names of the clips in the file; of equal ones the first counts.
    """
    table = _table()
    known = table["characters"].get(file)
    if known is None:
        return []
    species, plan = tuple(known["species"]), known["plan"]
    person = species[0] == "person"
    taken = _taken_elsewhere().get(file, {}) if person else {}
    out: dict[str, CreatureClip] = {}
    for label in labels:
        short = label.rsplit("|", 1)[-1]
        if short in known.get("leave_out", {}) or short in taken:
            continue
        word = known.get("clips", {}).get(short, short)
        if word.partition("_")[0] in table["prefixes"]:
            word = word.partition("_")[2]
        entry = table["labels"].get(f"{plan}:{word}") or table["labels"].get(word)
        if entry is None or (person and entry["action"] in _SEEN_ON_PEOPLE):
            continue
        phrases = _seen(table["characters"], file, word) or entry["phrases"]
        texts = _sentences(species, table["generic"][plan], phrases)
        name = "creature_" + re.sub(r"[^A-Za-z0-9_-]", "-", f"{file.replace('/', '-')}_{short}")
        out.setdefault(
            name,
            CreatureClip(file, label, name, entry["action"], plan, species, person, texts, known.get("weight", 1.0)),
        )
    return list(out.values())


def known_plan(file: str) -> str | None:
    """The body plan of a character of the archive, such as "quadruped" or "fish"; None of one that is not in the table.

    Args:
        file: Path in the archive without suffix.
    """
    known = _table()["characters"].get(file)
    return None if known is None else str(known["plan"])


def creature_split(clip: CreatureClip) -> str:
    """The split of a clip: whole species and whole characters are kept from training; what people are tested on stays
    as it is.
    """
    if clip.file in HELD_OUT or clip.species[0] in HELD_OUT_SPECIES:
        return "test"
    if clip.species[0] in VALIDATION_SPECIES:
        return "val"
    return "train"


@dataclass(frozen=True, eq=False)
class CreatureBody:
    """A character as whoever has an unrigged copy of it sees it.

    Args:
        path: Its file.
        character: Facing +Z, without rig.
        handles: Predicted, with four influences a vertex as `bunraku.rig` gives them.
        turn: What made it face +Z, shape (3, 3).
        areas: Surface of each vertex, shape (V,).
        anatomy: What is known of the body.
    """

    path: Path
    character: Character
    handles: Handles
    turn: np.ndarray
    areas: np.ndarray
    anatomy: Anatomy


def creature_body(path: Path, name: str) -> CreatureBody:
    """Load a rigged character and predict its handles.

    Args:
        path: A GLB.
        name: Its path in the archive without suffix; the facing of some is known by it.

    Raises:
        BunrakuError: It cannot be read, or has no rig.
    """
    from bunraku.handles.predict import predict_handles
    from bunraku.io import load_character

    character = load_character(path)
    if character.rig is None:
        raise CharacterError(f"{path}: there is no rig in this file, so its clips move nothing")
    turn = facing_turn(name, character.rig.names, character.rig.positions)
    character = replace(character, vertices=character.vertices @ turn.T.astype(np.float32), rig=None, source=None)
    handles = predict_handles(character).top(4)
    return CreatureBody(
        path,
        character,
        handles,
        turn,
        character.areas,
        Anatomy.of(character, handles),
    )


def clip_vertices(body: CreatureBody, label: str) -> np.ndarray:
    """The character's vertices in each frame of a clip at 20 frames a second [m], shape (N, V, 3).

    Raises:
        BunrakuError: The clip cannot be played.
    """
    from bunraku.io.play import load_animation

    return np.asarray(load_animation(body.path, label, FPS).vertices() @ body.turn.T.astype(np.float32))


def reference_motion(
    body: CreatureBody, vertices: np.ndarray, travels: bool = False, loops: bool = False, person: bool = False
) -> HandleMotion:
    """What a character does, as handle motion of the reference body.

    Args:
        body: The character.
        vertices: Its vertices in each frame [m], shape (N, V, 3).
        travels: It goes over the ground, so a way that keeps its feet from sliding is added where the clip stays in
            place.
        loops: It repeats itself, so it is played on to two seconds.
        person: It becomes a motion of any humanoid, otherwise it stays one of this very body.

    Raises:
        CharacterError: The clip is shorter than 0.4 s, or moves the mesh as no body moves.
    """
    name, height = body.path.stem, body.character.height
    if len(vertices) < LEAST_FRAMES:
        raise CharacterError(f"{name}: the clip has {len(vertices)} frames, but motions have at least {LEAST_FRAMES}")
    extent = np.ptp(body.character.vertices[body.character.surface], axis=0).max()
    ratio = np.ptp(vertices[:, body.character.surface], axis=1).max(axis=1) / extent
    if not np.isfinite(ratio).all() or ratio.max() > 3 or ratio.min() < 0.2:
        raise CharacterError(
            f"{name}: the clip makes the mesh {ratio.max():.1f} times its size, which no handles do; it may move "
            "something else"
        )
    motion = handle_motion_of_mesh(
        body.character.vertices, vertices, body.handles.weights, body.handles.positions, body.areas, FPS
    )
    if loops:
        motion = played_on(motion, LEAST_LOOP)
    if travels:
        motion = with_travel(motion, forward_speed(vertices, body.character.surface, height, FPS))
    return motion_to_reference(motion, body.anatomy, own=not person)


def _entry(clip: CreatureClip, frames: int) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "texts": list(clip.texts), "source": f"character archive, {clip.file}", "licence": "CC0-1.0", "frames": frames,
        "split": creature_split(clip), "weight": clip.weight, "action": clip.action,
    }  # fmt: skip
    return entry if clip.person else entry | {"species": clip.species[0], "plan": clip.plan, "character": clip.file}


def add_creatures(
    characters: str | Path, out: str | Path, progress: Callable[[str, float], None] | None = None
) -> tuple[list[str], dict[str, str]]:
    """Convert the clips that `creature_clips.json` names and add them to the index that `build_motions` wrote.

    One file a clip, so a second run goes on where the first one stopped. What cannot be converted does not stop the
    others.

    Args:
        characters: Folder of the unpacked character archive.
        out: Folder of the motions, with its `index.json`.
        progress: Called with a stage's name and the share done.

    Returns:
        Names of the clips in the index, and what failed with its reason.

    Raises:
        FormatError: There is no index, or none of the characters is there.
    """
    from bunraku.formats.gltf.container.open import open_document
    from bunraku.io.play import clip_names

    characters, out = Path(characters), Path(out)
    load_index(out)  # there must be one, before minutes are spent
    files = present_files(characters, _table()["characters"])
    added: dict[str, dict[str, Any]] = {}
    failed: dict[str, str] = {}
    for number, file in enumerate(files):
        body: CreatureBody | None = None
        path = characters / f"{file}.glb"
        try:
            clips = creature_clips(file, clip_names(open_document(path, path.read_bytes())))
        except BunrakuError as error:
            failed[file] = str(error)
            continue
        for clip in clips:
            target = out / f"{clip.name}.npz"
            try:
                if target.is_file():
                    motion = load_clip(target)
                else:
                    body = body or creature_body(path, file)
                    travels = clip.action in _TRAVELS and clip.plan not in _FLOATS
                    motion = reference_motion(
                        body, clip_vertices(body, clip.label), travels, clip.action in _CYCLES, clip.person
                    )
                    write_clip(target, motion)
            except BunrakuError as error:
                failed[clip.name] = str(error)
                continue
            added[clip.name] = _entry(clip, len(motion))
        if progress:
            progress("converting clips of creatures", (number + 1) / len(files))
    write_index(out, load_index(out) | added)
    return list(added), failed
