"""Labelled clips of the character archive as handle motions: animals, monsters and machines (`bunraku data motions
--creatures`) and people of games (`--characters`), played on and moved as engines do.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.names.bone_names import rig_handles
from bunraku.core.animation import Animation
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.errors import BunrakuError, CharacterError, FormatError
from bunraku.retarget.to_reference import handle_motion_of_mesh, motion_to_reference
from bunraku_lab.datasets.characters.build import HELD_OUT
from bunraku_lab.datasets.characters.training_character import facing_rotation
from bunraku_lab.datasets.motions.build import split_of
from bunraku_lab.datasets.motions.clips import load_clip, load_index, write_clip, write_index


def present_files(folder: Path, files: Iterable[str]) -> list[str]:
    """Those of the archive's files, named without their `.glb`, that a folder holds.

    Raises:
        FormatError: It holds none.
    """
    present = [file for file in files if (folder / f"{file}.glb").is_file()]
    if not present:
        raise FormatError(
            folder, "none of the known characters is here; give the folder of the unpacked character archive"
        )
    return present


# The shipped denoiser was trained on data made with these. What is nearer than NEAR to the lowest point, over the
# height, stands; the second value counts where the first takes in swinging feet.
NEAR = (0.04, 0.015)
IN_PLACE = 0.25  # clips that come farther than this share of the way that their feet make do move already
SLOWEST, FASTEST = 0.03, 6.0  # in body heights a second


def forward_speed(vertices: np.ndarray, surface: np.ndarray, height: float, fps: float) -> float:
    """Speed along +Z at which the feet would not slide [m/s], not negative; 0 where none can be told.

    Args:
        vertices: Of each frame [m], shape (N, V, 3), of a body that faces +Z.
        surface: Which vertices count, shape (V,), bool.
        height: Of the body [m].
        fps: Frames a second [1/s].
    """
    points = vertices[:, surface].astype(np.float64)
    if len(points) < 3:
        return 0.0
    for near in NEAR:
        down = points[..., 1] < points[..., 1].min(axis=1, keepdims=True) + near * height
        down &= points[..., 1] < points[..., 1].min() + 2 * near * height  # feet do not stand in the air
        both = down[:-1] & down[1:]
        if both.any():
            speed = float(np.median(-np.diff(points[..., 2], axis=0)[both]) * fps)
            if SLOWEST * height < speed < FASTEST * height:
                return speed
    return 0.0


def with_travel(motion: HandleMotion, speed: float) -> HandleMotion:
    """The motion with a steady way along +Z added, unless it comes forward by itself.

    Args:
        motion: Of a body on the spot that faces +Z.
        speed: What `forward_speed` found [m/s].
    """
    moments = np.arange(len(motion)) / motion.fps
    own = float(motion.root_translation[-1, 2] - motion.root_translation[0, 2])
    if speed == 0 or abs(own) > IN_PLACE * speed * moments[-1]:
        return motion
    return replace(
        motion, root_translation=motion.root_translation + np.outer(moments, [0, 0, speed]).astype(np.float32)
    )


def played_on(motion: HandleMotion, least: int) -> HandleMotion:
    """A loop repeated until it has at least `least` frames; a motion that does not end as it began stays as it is.

    Loops of a few frames, such as one bound of a gallop, are too short to be cut, joined or told from a single step.
    """
    frames = len(motion)
    if frames < 3 or frames >= least:
        return motion
    flat = np.concatenate([motion.rotations.reshape(frames, -1), motion.root_rotation.reshape(frames, -1)], axis=1)
    step, gap = np.linalg.norm(np.diff(flat, axis=0), axis=1).max(), float(np.linalg.norm(flat[-1] - flat[0]))
    if gap > 1.2 * step:
        return motion
    period = frames - 1 if gap < 0.5 * step else frames  # the last frame is the first again, or the one before it
    rounds = -(-least // period)
    order = np.arange(rounds * period) % period
    path = motion.root_translation.astype(np.float64)
    course = (path[-1] - path[0]) * period / (frames - 1)
    path = path[order] + np.outer(np.arange(rounds * period) // period, [course[0], 0, course[2]])
    return replace(motion.take(order), root_translation=path)


HELD_OUT_SPECIES: tuple[str, ...] = (
    "bull", "shiba inu", "rat", "velociraptor", "spider", "crab", "dragon", "bee", "tuna", "betta", "puffer",
    "manta ray", "goblin",
)  # fmt: skip
"""Species that no training sees: hoofed and clawed, a biped with a tail, eight legs, claws, wings, fish."""

VALIDATION_SPECIES: tuple[str, ...] = ("llama", "tetra", "turbot", "parasaurolophus")

FPS = 20.0
LEAST_FRAMES = 8
_TRAVELS = ("walk", "run", "trot", "gallop", "sneak", "crawl", "carry", "run carry")
_CYCLES = (
    *_TRAVELS, "swim", "swim fast", "swim impulse", "fly", "glide", "hover", "idle", "idle head low", "alert", "eat",
    "sleep", "sit", "dance",
)  # fmt: skip
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
    """Phrases written from watching this clip, or the clip of the character named in `watched_like`."""
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
    """The body plan of a character of the archive, such as "quadruped" or "fish"; None where it is unknown."""
    known = _table()["characters"].get(file)
    return None if known is None else str(known["plan"])


def creature_split(clip: CreatureClip) -> str:
    """The split of a clip: whole species and characters are kept from training."""
    if clip.file in HELD_OUT or clip.species[0] in HELD_OUT_SPECIES:
        return "test"
    if clip.species[0] in VALIDATION_SPECIES:
        return "val"
    return "train"


@dataclass(frozen=True, eq=False)
class CreatureBody:
    """A character as it looks without its rig.

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
    from bunraku.anatomy.handles.predict import predict_handles
    from bunraku.files import load_character

    character = load_character(path)
    if character.rig is None:
        raise CharacterError(f"{path}: there is no rig in this file, so its clips move nothing")
    turn = facing_rotation(name, character.rig.names, character.rig.positions)
    character = replace(character, vertices=character.vertices @ turn.T.astype(np.float32), rig=None, source=None)
    handles = predict_handles(character).top(4)
    return CreatureBody(path, character, handles, turn, character.areas, Anatomy.of(character, handles))


def clip_vertices(body: CreatureBody, label: str) -> np.ndarray:
    """The character's vertices in each frame of a clip at 20 frames a second [m], shape (N, V, 3).

    Raises:
        BunrakuError: The clip cannot be played.
    """
    from bunraku.files import load_animation

    return np.asarray(load_animation(body.path, label, FPS).vertices() @ body.turn.T.astype(np.float32))


def reference_motion(
    body: CreatureBody, vertices: np.ndarray, travels: bool = False, loops: bool = False, person: bool = False
) -> HandleMotion:
    """What a character does, as handle motion of the reference body.

    Args:
        body: The character.
        vertices: Its vertices in each frame [m], shape (N, V, 3).
        travels: It goes over the ground, so a path that keeps its feet from sliding is added to a clip in place.
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
    """Convert the clips that `creature_clips.json` names, of the unpacked character archive, and add them to the index
    that `build_motions` wrote. The names of its clips are given back, and what failed with its reason.

    One file a clip, so a second run goes on where the first one stopped; what fails does not stop the others.

    Raises:
        FormatError: There is no index, or none of the characters is there.
    """
    from bunraku.files import clip_names, open_document

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


def reference_clip(animation: Animation) -> HandleMotion:
    """What a rigged character does, by whatever handles it is driven, as handle motion of the reference body.

    Raises:
        CharacterError: The character has no rig with telling names.
    """
    character = animation.character
    handles = rig_handles(character, least=8)
    areas = character.areas
    motion = handle_motion_of_mesh(
        character.vertices, animation.vertices(), handles.weights, handles.positions, areas, animation.motion.fps
    )
    return motion_to_reference(motion, Anatomy.of(character, handles))


def _side(motion: HandleMotion, part: str) -> str:
    """The side on which a handle travels farther in the root's frame."""
    travel = {}
    for side in ("left", "right"):
        handle = HANDLE_NAMES.index(f"{side}_{part}")
        travel[side] = float(np.linalg.norm(np.diff(motion.translations[:, handle], axis=0), axis=1).sum())
    return max(travel, key=lambda side: travel[side])


def add_game_clips(
    characters: str | Path, out: str | Path, progress: Callable[[str, float], None] | None = None
) -> tuple[list[str], dict[str, str]]:
    """As `add_creatures`, the clips that `game_clips.json` names."""
    from bunraku.files import load_animation

    characters, out = Path(characters), Path(out)
    clips = load_index(out)
    table = json.loads(
        resources.files("bunraku_lab.datasets.motions").joinpath("game_clips.json").read_text(encoding="utf-8")
    )
    wanted = [
        (file, clip, caption) for file in present_files(characters, table) for clip, caption in table[file].items()
    ]
    added, failed = [], {}
    for number, (file, clip, caption) in enumerate(wanted):
        name = "game_" + file.replace("/", "-") + f"_{clip}"
        try:
            motion = reference_clip(load_animation(characters / f"{file}.glb", clip, 20.0))
        except BunrakuError as error:
            failed[name] = str(error)
            continue
        write_clip(out / f"{name}.npz", motion)
        text = caption.format(hand=_side(motion, "wrist"), leg=_side(motion, "ankle"))
        entry = {"texts": [text], "source": f"character archive, {file}", "licence": "CC0-1.0", "frames": len(motion)}
        clips[name] = entry | {"split": split_of(name), "weight": 1.0}
        added.append(name)
        if progress:
            progress("converting clips of characters", (number + 1) / len(wanted))
    write_index(out, clips)
    return added, failed
