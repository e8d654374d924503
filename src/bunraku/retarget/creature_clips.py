"""How keyframed animals attack, eat and die: creatures with such legs do it after them.

A clip is kept as the motion of the 30 handles of a body in its own stance (`retarget.creatures`), packed as the
examples of people are.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.core.arrays import lzma_filters, pack_steps, unpack_steps
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, nearest_rotation
from bunraku.core.motion import HandleMotion, resample
from bunraku.core.travel import placed_at
from bunraku.errors import WeightsError
from bunraku.language.captions import caption_table, conjugate
from bunraku.language.sentence import Sentence
from bunraku.retarget.creatures import CreatureMotion

KIND = "creatures"
FPS = 20.0
_METRES, _RADIANS, _ORDER = 1e-3, 2e-3, 2  # steps of a packed clip; chosen by eye, as those of the examples
_FILTERS = lzma_filters(9, 1 << 16)
_NUMBERS = 4 + 3 * HANDLE_COUNT
MOST_FRAMES = 400  # of one clip; more in a file is damage
FADE = 6  # frames in which what follows begins as what was before ended; chosen by eye
NAMED, ALIKE = 2.0, 1.0
"""What it counts that a clip is of the animal that is named, or of one like it, against a body e times as long for its
height; chosen by eye on sheets."""
FAR = 0.7  # an animal whose shape is farther from a body shows nothing to it; chosen by eye on a crocodile (0.86)
LESS = 0.3  # what each place counts by which an action stands behind the one that is asked for; chosen by eye
SPREAD = 0.2  # scale of the Gumbel numbers that make seeds differ; chosen by eye
PACES = 0.85, 1.15  # how fast a clip is done, for seeds that take the same one to differ; chosen by eye on a dragon
_PELVIS, _HEAD = HANDLE_NAMES.index("pelvis"), HANDLE_NAMES.index("head")


@dataclass(frozen=True)
class CreatureClip:
    """One clip of an animal: what it does by the table of creatures' captions, the kind of its body
    (`anatomy.legs.BodyPlan.kind`), its `body_shape`, and the packed motion.
    """

    animal: str
    action: str
    body: str
    shape: tuple[float, float]
    frames: int
    data: bytes

    @property
    def unpacked(self) -> tuple[HandleMotion, np.ndarray]:
        """Its motion, with joints that hold, and the heights of its lowest point [m], shape (N,); WeightsError where
        the bytes are damaged.
        """
        try:
            if not 2 <= self.frames <= MOST_FRAMES:
                raise ValueError
            values = unpack_steps([self.data], [self.frames], _NUMBERS, _ORDER, _FILTERS)
        except ValueError as error:
            raise WeightsError("the clips of creatures are damaged; install Bunraku again") from error
        turns = matrix_from_axis_angle((values[:, 4:] * _RADIANS).reshape(self.frames, HANDLE_COUNT, 3))
        root = turns[:, 0].copy()
        turns[:, 0] = np.eye(3)
        rotations, translations = reference_anatomy().attached(turns)
        motion = HandleMotion(translations, rotations, values[:, :3] * _METRES, root, FPS).of_own_body()
        return motion, values[:, 3] * _METRES


def packed_clip(motion: HandleMotion, heights: np.ndarray) -> bytes:
    """A motion of the reference body's handles, and the heights of its lowest point [m], in few bytes."""
    turns = motion.rotations.astype(float)
    turns[:, 0] = motion.root_rotation
    angles = axis_angle_from_matrix(turns).reshape(len(motion), -1)
    path = np.column_stack([motion.root_translation, heights])
    return pack_steps(np.concatenate([path / _METRES, angles / _RADIANS], axis=1), _ORDER, _FILTERS)


def body_shape(anatomy: Anatomy) -> tuple[float, float]:
    """How far the head of a body is from its hips, over their height, as a logarithm, and at which slope [rad]."""
    hips, head = anatomy.handles.positions[[_PELVIS, _HEAD]].astype(float)
    low, least = float(anatomy.character.vertices[:, 1].min()), 0.02 * anatomy.character.height
    away = head - hips
    length = max(float(np.linalg.norm(away)), least) / max(float(hips[1]) - low, least)
    return float(np.log(length)), float(np.arctan2(away[1], np.hypot(away[0], away[2])))


def write_clips(path: str | Path, clips: Sequence[CreatureClip], notes: dict[str, object]) -> Path:
    """Write clips with notes on their sources."""
    from bunraku.core.nn.checkpoints import save_checkpoint

    table = [[clip.animal, clip.action, clip.body, *clip.shape, clip.frames, len(clip.data)] for clip in clips]
    data = np.frombuffer(b"".join(clip.data for clip in clips), np.uint8)
    return save_checkpoint(path, {"data": data}, {"clips": table, "notes": notes}, KIND)


@functools.lru_cache(maxsize=2)
def read_clips(path: Path) -> tuple[CreatureClip, ...]:
    """The clips of a file; WeightsError where it is damaged or of another kind."""
    from bunraku.core.nn.checkpoints import fitting_config, load_checkpoint

    state, config = load_checkpoint(path, KIND)
    with fitting_config(path):
        data, start, clips = state["data"].tobytes(), 0, []
        for animal, action, body, length, slope, frames, size in config["clips"]:
            piece = data[start : start + int(size)]
            shape = float(length), float(slope)
            clips.append(CreatureClip(str(animal), str(action), str(body), shape, int(frames), piece))
            start += int(size)
        if start != len(data):
            raise ValueError("the sizes of the clips do not add up")
    return tuple(clips)


def shipped_clips() -> tuple[CreatureClip, ...]:
    """The clips beside the shipped weights; none where there is no such file."""
    from bunraku.core.files import weights_file

    path = weights_file("creatures.safetensors")
    return read_clips(path) if path.is_file() else ()


@functools.cache
def _phrases() -> dict[str, str]:
    """The actions of creatures by the phrases that say them, the longest first."""
    table = caption_table("creature_captions.json")
    rows = [table["actions"], *[kind["phrases"] for kind in table["kinds"]]]
    said = {action: action for action in table["actions"]}
    for action, phrases in (item for row in rows for item in row.items()):
        for phrase in phrases:
            for form in ("third", "gerund", "plain"):
                said.setdefault(conjugate(phrase, form), action)
    said |= {name: action for name, action in table["aliases"].items() if action in table["actions"]}
    return dict(sorted(said.items(), key=lambda item: -len(item[0])))


def creature_action(text: str) -> str:
    """The single action of creatures that some words say; "" where they say none, or several."""
    words, actions = f" {' '.join(re.findall(r'[a-z]+', text.lower()))} ", set()
    for phrase, action in _phrases().items():
        if f" {phrase} " in words:
            words = words.replace(f" {phrase} ", " , ")
            actions.add(action)
    return actions.pop() if len(actions) == 1 else ""


def shown_by() -> dict[str, list[str]]:
    """The actions whose clips show an action, the best first; those of travel are the generator's."""
    table: dict[str, list[str]] = caption_table("creature_captions.json")["shown by"]
    return table


def _likeness(clip: CreatureClip, words: set[str]) -> float:
    """How near the animal of a clip is to those that some words name."""
    if clip.animal in words:
        return NAMED
    kinds = caption_table("creature_captions.json")["kinds"]
    return ALIKE * any(clip.animal in kind["species"] and words & {*kind["species"]} for kind in kinds)


def creature_motion(sentence: Sentence, anatomy: Anatomy, seed: int) -> CreatureMotion | None:
    """What a sentence, as the body does it, asks of a creature, after clips of animals with a body like its own, which
    the seed draws; None where they do not show all of it.
    """
    name = {*re.findall(r"[a-z]+", Path(anatomy.character.name).stem.lower())}
    random = np.random.default_rng(seed % 2**63)
    taken: tuple[HandleMotion, np.ndarray] | None = None
    for clause in sentence.clauses:
        wanted = shown_by().get(creature_action(clause.text), []) if clause.moves == "stay" else []
        words = name | {*re.findall(r"[a-z]+", clause.text.lower())}
        shape = body_shape(anatomy) if wanted else (0.0, 0.0)
        offered = [
            (
                _likeness(clip, words) - LESS * wanted.index(clip.action) - far + SPREAD * random.gumbel(),
                clip,
            )
            for clip in shipped_clips()
            if clip.action in wanted and clip.body == anatomy.plan.kind
            and (far := float(np.hypot(*np.subtract(clip.shape, shape)))) < FAR
            and not (clip.action == "death" and anatomy.plan.wings)  # it would lie on a wing that is spread
        ]  # fmt: skip
        if not offered:
            return None
        clip = max(offered, key=lambda pair: pair[0])[1]
        part = _lasting(clip, max(round(clause.seconds * FPS), 1), random)
        taken = part if taken is None else _followed(*taken, *part)
    return None if taken is None else CreatureMotion(taken[0], anatomy.plan, taken[1])


def _lasting(clip: CreatureClip, frames: int, random: np.random.Generator) -> tuple[HandleMotion, np.ndarray]:
    """A clip for so many frames, again and again, each time at a pace of its own; a death is held at its end."""
    motion, heights = clip.unpacked

    def once() -> tuple[HandleMotion, np.ndarray]:
        paced = resample(motion, FPS / random.uniform(*PACES))
        return replace(paced, fps=FPS), np.interp(
            np.linspace(0, 1, len(paced)), np.linspace(0, 1, len(motion)), heights
        )

    whole = once()
    if clip.action == "death":
        indices = np.minimum(np.arange(frames), len(whole[0]) - 1)
        return whole[0].take(indices), whole[1][indices]
    while len(whole[0]) < frames:
        whole = _followed(*whole, *once())
    return whole[0].take(slice(frames)), whole[1][:frames]


def _followed(
    first: HandleMotion, before: np.ndarray, second: HandleMotion, after: np.ndarray
) -> tuple[HandleMotion, np.ndarray]:
    """A motion and the next one, which begins where and as the first ends, and their heights."""
    second = placed_at(second, 0, first, len(first) - 1)
    share = np.ones(len(second))
    share[:FADE] = (np.arange(min(FADE, len(second))) + 1) / (FADE + 1)
    faded = {}
    for name in HandleMotion.arrays:
        values = getattr(second, name)
        part = share.reshape(-1, *[1] * (values.ndim - 1))
        mixed = getattr(first, name)[-1] * (1 - part) + values * part
        faded[name] = nearest_rotation(mixed) if "rotation" in name else mixed
    heights = np.concatenate([before, before[-1] * (1 - share) + after * share])
    return HandleMotion.joined([first, second.with_arrays(faded)]), heights
