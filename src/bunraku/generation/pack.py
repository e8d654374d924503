"""Captured examples in one file: short stretches of motion with sentences, and the ranker's vectors of both.

A stretch is kept as the motion of a skeleton of 22 joints: the root's position and the joints' rotations at 20 frames a
second, in steps of half a millimetre and of two milliradians, their second differences packed by LZMA: 41 bytes a
frame. What its sentences say is kept beside them, so that they are not read again wherever a motion is made.
"""

from __future__ import annotations

import functools
import hashlib
import lzma
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bunraku.core.arrays import lzma_filters, unpack_steps
from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.errors import WeightsError
from bunraku.language.lexicon import actions_of, main_actions, said_cues, said_traits

if TYPE_CHECKING:
    from bunraku.core.motion import SkeletalMotion
    from bunraku.gestures.pose import Gesture

KIND = "examples"
FPS = 20.0
MADE = "gesture_"  # beginning of the names of examples made by code
OWN = "own_"  # beginning of the names of examples that a user has added
IDLE = "#idle"
"""End of the names of stretches of people who stand; gestures are made by these."""
BUSY = "#busy"
"""The same of people who use their hands; gestures take all but these from them."""
MOST_FRAMES = 2_000  # of one stretch; more in a file is damage
METRES, RADIANS, ORDER = 5e-4, 2e-3, 2
"""Steps of a packed stretch, and how often differences are taken: as measured, with one milliradian and first
differences, 60 stretches took 23 % more bytes.
"""
STEPS = 127.0  # into which 1 is parted in a file's unit vectors; a cosine is then off by .003 at the most
HANGS = float(np.radians(15))
"""How far a head hangs from the chest for good at the most. Nine of ten stretches of other sources stay below it; the
markers of some people of CMU's make it 30 to 70 degrees while they stand, walk or sit down.
"""
NECK, HEAD = JOINT_NAMES.index("neck"), JOINT_NAMES.index("head")
_NUMBERS = 3 + 3 * JOINT_COUNT
FILTERS = lzma_filters(9 | lzma.PRESET_EXTREME, 1 << 16)


@dataclass(frozen=True)
class Example:
    """One stretch of a captured or keyframed clip.

    Args:
        name: Its clip, and its first frame there.
        texts: Sentences for it, the fullest first; none where a person only stands, for others to be joined to.
        frames: How many it has.
        loop: Frames (i, j) such that frame j after frame i is smooth and the sentences stay true; None where it is done
            once.
    """

    name: str
    texts: tuple[str, ...]
    frames: int
    loop: tuple[int, int] | None = None

    @property
    def unranked(self) -> bool:
        """Whether the ranker has never seen its like: it is made by code, or a user's own clip."""
        return self.name.startswith((MADE, OWN))

    @property
    def made(self) -> bool:
        """Whether it is a gesture made by code (`bunraku.gestures`)."""
        return self.name.startswith(MADE)

    @property
    def gesture(self) -> str:
        """The action of a gesture, which its name says; "" where it says none, and for captured examples."""
        return self.name.removeprefix(MADE).rpartition("_")[0].replace("_", " ") if self.name.startswith(MADE) else ""

    @property
    def stands(self) -> bool:
        """Whether gestures are made by the person in it."""
        return self.name.endswith((IDLE, BUSY))


class Said(NamedTuple):
    """What an example shows: of a shipped one actions that were labelled by hand, else what the lexicon reads."""

    actions: frozenset[str]  # what they agree on (`main_actions`)
    # cues, traits: of all of them
    cues: frozenset[str]
    traits: frozenset[str]
    besides: frozenset[str] = frozenset()  # actions of the fullest beyond those


@functools.lru_cache(maxsize=4096)
def said_by(texts: tuple[str, ...], gesture: str = "") -> Said:
    """What the sentences of an example say; the action of a `gesture` is its name."""
    cues, traits = (frozenset[str]().union(*map(read, texts)) for read in (said_cues, said_traits))
    if gesture:
        return Said(frozenset((gesture,)), cues, traits)
    actions = frozenset(main_actions(texts))
    besides = frozenset(actions_of(texts[0])) if texts else frozenset[str]()
    return Said(actions, cues, traits, besides - actions)


@dataclass(frozen=True, eq=False)
class ExamplePack:
    """Examples with their vectors, each as it is and in the mirror."""

    examples: tuple[Example, ...]  # E of them
    data: tuple[bytes, ...]  # packed stretches
    owners: np.ndarray  # the example of each sentence, shape (T,)
    # unit vectors of the sentences, of those in which people ask for the same, and of all in the mirror, (2, T, V)
    texts: np.ndarray
    motions: np.ndarray  # unit vectors of the stretches and of their mirror images, shape (2, E, V)
    ranker: str  # fingerprint of the ranker's weights that made the vectors
    stand: Sequence[int] | None = None  # result of `stand_well`; None where it is not stored
    readings: Sequence[Said] | None = None  # what the sentences of each say; None where it is not stored

    @functools.cached_property
    def made(self) -> np.ndarray:
        """Which ones are gestures made by code, shape (E,), bool."""
        return np.array([example.name.startswith(MADE) for example in self.examples], bool)

    @functools.cached_property
    def actions(self) -> tuple[str, ...]:
        """The actions of gestures by their names, so that their sentences need not be read; "" where a name says none,
        and for captured examples.
        """
        return tuple([example.gesture if example.name.startswith(MADE) else "" for example in self.examples])

    @functools.cached_property
    def handled(self) -> tuple[int, ...]:
        """The gesture that stands for all that is done with things; none in a pack without it."""
        return tuple([index for index, action in enumerate(self.actions) if action == "handle"])

    @property
    def standing(self) -> tuple[int, ...]:
        """Indices of stretches for others to be joined to, of people who stand on both legs."""
        return tuple([index for index in self._standing_well if not self.examples[index].stands])

    @functools.cached_property
    def idles(self) -> tuple[SkeletalMotion, ...]:
        """People who stand; gestures are made by them."""
        return self._people(IDLE)

    @functools.cached_property
    def busy(self) -> tuple[SkeletalMotion, ...]:
        """People who stand and use their hands; gestures take their legs, trunk and head."""
        return self._people(BUSY)

    def _people(self, ending: str) -> tuple[SkeletalMotion, ...]:
        return tuple(_skeletal(self, [one for one in self._standing_well if self.examples[one].name.endswith(ending)]))

    @functools.cached_property
    def _standing_well(self) -> Sequence[int]:
        return stand_well(self) if self.stand is None else self.stand

    @functools.cached_property
    def said(self) -> Sequence[Said]:
        """What the sentences of each example say."""
        if self.readings is not None:
            return self.readings
        return [said_by(example.texts, example.gesture) for example in self.examples]

    def nearness(self, vector: np.ndarray, mirrored: bool) -> tuple[np.ndarray, np.ndarray]:
        """The cosines (E,) of the ranker's unit vector (V,) of a sentence with the nearest sentence of each example,
        and with its motion; those of the mirror images where `mirrored`.
        """
        nearest = np.full(len(self.examples), -1.0)
        np.maximum.at(nearest, self.owners, self.texts[int(mirrored)].astype(float) @ vector)
        return nearest, self.motions[int(mirrored)].astype(float) @ vector

    def gesture(self, index: int) -> Gesture | None:
        """The gesture that an example is; None where it is captured, or no gesture of this version."""
        from bunraku.gestures.catalogue import gesture_of

        example = self.examples[index]
        return gesture_of(example.texts) if example.made and example.texts else None

    def features(self, index: int) -> np.ndarray:
        """Features of an example, shape (N, 271)."""
        return _features(self.data[index], self.examples[index].frames, not self.examples[index].made)


def stand_well(pack: ExamplePack) -> list[int]:
    """Usable ones of those without a sentence: others are joined to one of a person who stands on both legs, and
    gestures are made by a person who stands well.
    """
    from bunraku.generation.composition import on_one_leg
    from bunraku.gestures.play import stands_well

    wordless = [index for index, example in enumerate(pack.examples) if not example.texts]
    others = [index for index in wordless if not pack.examples[index].stands]
    lifted = {
        index for index, features in zip(others, _encoded_at_once(pack, others), strict=True) if on_one_leg(features)
    }
    standing = [index for index in wordless if pack.examples[index].stands]
    lifted |= {i for i, motion in zip(standing, _skeletal(pack, standing), strict=True) if not stands_well(motion)}
    return [index for index in wordless if index not in lifted]


def _encoded_at_once(pack: ExamplePack, indices: Sequence[int]) -> list[np.ndarray]:
    """Features of some examples but for their first frames' velocities, shape (N, 271) each."""
    root, rotations, ends = _unpacked(pack, indices)
    return np.split(_encoded(root, rotations), ends) if indices else []


def _skeletal(pack: ExamplePack, indices: Sequence[int]) -> list[SkeletalMotion]:
    """The motions of some examples."""
    root, rotations, ends = _unpacked(pack, indices)
    return [_motion(*part) for part in zip(np.split(root, ends), np.split(rotations, ends), strict=True) if indices]


def _unpacked(pack: ExamplePack, indices: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Root (N, 3) and rotations (N, 22, 3, 3) of some examples in a row, and where each but the last ends."""
    lengths = [pack.examples[index].frames for index in indices]
    values = _stretch_values([pack.data[index] for index in indices], lengths)
    return *_as_motion(values), np.cumsum(lengths)[:-1]


@functools.lru_cache(maxsize=128)
def _features(data: bytes, frames: int, captured: bool) -> np.ndarray:
    root, rotations = unpacked_stretch(data, frames)
    return _encoded(root, head_up(rotations) if captured else rotations)


def head_up(rotations: np.ndarray) -> np.ndarray:
    """Rotations (N, 22, 3, 3) with a head that does not hang from the chest by more than `HANGS` for good; what it does
    meanwhile stays.
    """
    neck, held = rotations[:, NECK], rotations[:, NECK] @ rotations[:, HEAD]
    hangs = float(np.median(np.arctan2(-held[:, 1, 2], held[:, 2, 2])))
    raised, out = matrix_from_axis_angle(np.array([min(HANGS - hangs, 0.0), 0, 0])), rotations.copy()
    out[:, HEAD] = neck.transpose(0, 2, 1) @ raised @ held
    return out


def _encoded(root: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Features of a stretch (see `diffusion.features`), shape (N, 271)."""
    from bunraku.generation.features import body_handle_motion, encode

    return encode(body_handle_motion(_motion(root, rotations)))


def _motion(root: np.ndarray, rotations: np.ndarray) -> SkeletalMotion:
    from bunraku.core.body.reference import reference_body
    from bunraku.core.motion import SkeletalMotion

    return SkeletalMotion(reference_body().skeleton, rotations, root, FPS)


def unpacked_stretch(data: bytes, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Root (N, 3) and rotations (N, 22, 3, 3) of packed bytes.

    Raises:
        WeightsError: The bytes are damaged.
    """
    return _as_motion(_stretch_values([data], [frames]))


def _as_motion(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Root (N, 3) and rotations (N, 22, 3, 3) of the numbers that are packed, shape (N, 69)."""
    turns = (values[:, 3:] * RADIANS).reshape(len(values), JOINT_COUNT, 3)
    return values[:, :3] * METRES, matrix_from_axis_angle(turns)


def _stretch_values(data: Sequence[bytes], frames: Sequence[int]) -> np.ndarray:
    try:
        if min(frames, default=1) < 1 or max(frames, default=1) > MOST_FRAMES:
            raise ValueError
        return unpack_steps(data, frames, _NUMBERS, ORDER, FILTERS)
    except ValueError as error:
        raise WeightsError("the examples are damaged; install Bunraku again or build them again") from error


def read_pack(path: str | Path) -> ExamplePack:
    """Read examples.

    Raises:
        WeightsError: The file is missing, damaged or of another kind.
    """
    from bunraku.core.nn.checkpoints import fitting_config, load_checkpoint

    state, config = load_checkpoint(path, KIND)
    if config.get("radians") != RADIANS:
        raise WeightsError(
            f"{path}: these examples are of an older version; build them again with 'bunraku data examples --add-to "
            "shipped', or take them away"
        )
    with fitting_config(path):
        sizes = state["sizes"].tolist()
        ends = np.cumsum([0, *sizes])
        data = state["data"].tobytes()
        if min(sizes, default=0) < 0 or ends[-1] != len(data):
            raise ValueError("the sizes of the stretches do not add up")
        examples = [
            Example(str(name), tuple(map(str, texts)), int(frames), (int(loop[0]), int(loop[1])) if loop else None)
            for name, texts, frames, loop in config["examples"]
        ]
        owners = state["owners"]
        said = [Said(*map(frozenset, parts)) for parts in config["readings"]]
        pack = ExamplePack(
            tuple(examples), tuple([data[start:stop] for start, stop in zip(ends, ends[1:], strict=False)]), owners,
            _both_sides(state), _units(state["motions"]), str(config["ranker"]),
            [int(index) for index in config["stand"]], [said[number] for number in state["readings"].tolist()],
        )  # fmt: skip
        count = len(examples)
        fits = pack.texts.shape[:2] == (2, len(owners)) and pack.motions.shape[:2] == (2, count)
        if not (fits and len(sizes) == len(pack.readings or ()) == count and ((owners >= 0) & (owners < count)).all()):
            raise ValueError("its tables have different lengths")
        if not all(0 <= index < count for index in pack.stand or ()):
            raise ValueError("people stand in stretches that it does not have")
    return pack


def _units(vectors: np.ndarray) -> np.ndarray:
    """Unit vectors of a file."""
    return vectors.astype(np.float32) / STEPS


def _both_sides(state: Mapping[str, np.ndarray]) -> np.ndarray:
    """Unit vectors of the sentences and of the mirrored ones, shape (2, T, V)."""
    texts = np.stack([_units(state["texts"])] * 2)
    texts[1, state["sided"]] = _units(state["mirrored"])
    return texts


def load_examples() -> ExamplePack | None:
    """The examples beside the shipped weights, kept between calls as long as the file does not change; None where there
    are none.

    Raises:
        WeightsError: The file is damaged, or was made with another ranker than the one beside it.
    """
    from bunraku.core.files import weights_file
    from bunraku.core.nn.checkpoints import dated_checkpoint

    path = weights_file("examples.safetensors")
    return _load(*dated_checkpoint("examples", path), *dated_checkpoint("ranker")) if path.is_file() else None


@functools.lru_cache(maxsize=2)
def _load(path: Path, changed: int, ranker: Path, ranker_changed: int) -> ExamplePack:
    pack = read_pack(path)
    if pack.ranker != fingerprint(ranker):
        raise WeightsError(
            f"{path}: the examples were made with another ranker than {ranker.name} beside them; build them again with "
            "'bunraku data examples', or take them away"
        )
    return pack


def fingerprint(path: Path) -> str:
    """Identifies a ranker's weights."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
