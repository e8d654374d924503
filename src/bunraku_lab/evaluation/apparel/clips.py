"""Truth to measure learned apparel by: clips of a data set, and of files that are simulated for it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count as counting
from itertools import islice
from pathlib import Path

import numpy as np

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.skinning import eq4_transforms
from bunraku.apparel.unified import UnifiedBody
from bunraku.core.character import Character
from bunraku.core.rig_animation import RigAnimation
from bunraku.core.skinning import skin
from bunraku.geometry.graph import unique_edges
from bunraku.physics.from_file import apparel_rig
from bunraku.physics.simulate import simulate
from bunraku.physics.told.clothed import clothed_from_file
from bunraku_lab.datasets.apparel import ApparelData
from bunraku_lab.datasets.apparel.build import body_animation
from bunraku_lab.datasets.apparel.plan import character_split
from bunraku_lab.datasets.apparel.push_out import PushOut
from bunraku_lab.datasets.apparel.recording import record

__all__ = ["TrueClip", "data_clips", "file_clips", "long_clip", "made_clips"]

RATE = 30.0
MADE = 900_000  # seed from which characters are made that no data set has
MOST = 600  # apparel vertices that distances are taken of


@dataclass(frozen=True, eq=False)
class TrueClip:
    """A clip at 30 frames a second whose apparel is known.

    Args:
        name: Of the character.
        motion: Of the motion.
        clothed: The character, with its file's mask and stiffness.
        transforms: `[R | t]` of the joints, shape (N, 22, 3, 4).
        loose: Vertices that leave their joints, shape (M,).
        offsets: By how much [m], shape (N, M, 3).
    """

    name: str
    motion: str
    clothed: ClothedCharacter
    transforms: np.ndarray
    loose: np.ndarray
    offsets: np.ndarray

    @property
    def affine(self) -> np.ndarray:
        """Affine transforms of the joints, shape (N, 22, 3, 4)."""
        return eq4_transforms(self.transforms, self.clothed.joints)

    def sample(self) -> np.ndarray:
        """Apparel vertices, evenly taken where they are many, shape (S,)."""
        found = np.flatnonzero(self.clothed.apparel)
        return found if len(found) <= MOST else found[np.linspace(0, len(found) - 1, MOST).astype(np.int64)]

    def carried(self, vertices: np.ndarray) -> np.ndarray:
        """Vertices as the joints alone take them [m], shape (N, S, 3)."""
        return np.asarray(skin(self.clothed.rest[vertices], self.clothed.weights[vertices], self.affine))

    def truth(self, vertices: np.ndarray) -> np.ndarray:
        """Where vertices are [m], shape (N, S, 3)."""
        index = np.full(len(self.clothed.rest), -1)
        index[self.loose] = np.arange(len(self.loose))
        rows = index[vertices]
        moved = np.array(self.carried(vertices))
        moved[:, rows >= 0] += self.offsets[:, rows[rows >= 0]].astype(np.float32)
        return moved

    def edges(self) -> np.ndarray:
        """Edges between apparel vertices, shape (E, 2)."""
        found = unique_edges(np.asarray(self.clothed.faces, np.int64), len(self.clothed.rest))
        return found[self.clothed.apparel[found].all(axis=1)]


def data_clips(data: ApparelData, most: int | None = None, seconds: float = 6.0) -> Iterator[TrueClip]:
    """Clips of a data set, characters in turn; those under `seconds` are passed over, longer ones are cut.

    Args:
        data: Of one split.
        most: How many at the most.
        seconds: Length [s].
    """
    from bunraku_lab.training.apparel.node_bank import truly_clothed

    rows: dict[str, list[int]] = {}
    for number, clip in enumerate(data.clips):
        if clip.frames >= seconds * RATE:
            rows.setdefault(clip.character, []).append(number)
    order = [number for turn in range(max(map(len, rows.values()), default=0)) for number in
             (own[turn] for own in rows.values() if turn < len(own))]  # fmt: skip
    for number in order[:most]:
        clip = data.clips[number]
        character, shard = data.character(clip), data.shard(clip.shard)
        span = clip.first, clip.first + round(seconds * RATE)
        yield TrueClip(
            clip.character, clip.motion, truly_clothed(character), shard.frames("transforms", *span), character.loose,
            shard.frames("offsets", *span),
        )  # fmt: skip


def file_clips(character: Character, motions: Sequence[str], seconds: float = 6.0) -> list[TrueClip]:
    """A character's file simulated in motions made by code.

    Args:
        character: An MMD model or a VRM avatar.
        motions: Kinds of `stock_motion`.
        seconds: Length of each [s].
    """
    from bunraku_lab.evaluation.transfer.stock_motions import stock_motion

    body = UnifiedBody.of(character)
    return [_simulated(character, body, kind, body_animation(body, stock_motion(kind, seconds, RATE)))
            for kind in motions]  # fmt: skip


def made_clips(count: int, seconds: float = 6.0) -> Iterator[TrueClip]:
    """Clips that need no data: characters of the wardrobe that are no data of training by their names, simulated in
    motions made by code.

    Args:
        count: How many, each of another character.
        seconds: Length of each [s].
    """
    from bunraku_lab.synthetic.wardrobe import wardrobe_character

    seeds = (seed for seed in counting(MADE) if character_split(f"wardrobe_{seed:06d}") == "test")
    for number, seed in enumerate(islice(seeds, count)):
        kind = ("walk", "dance")[number % 2]
        yield from file_clips(wardrobe_character(seed), (kind,), seconds)


def long_clip(seed: int, motion: Path, seconds: float = 60.0) -> TrueClip:
    """A wardrobe character in a motion that is played forth and back for so long.

    Args:
        seed: Of the character.
        motion: A clip that `bunraku data motions` wrote.
        seconds: Length [s].
    """
    from bunraku.core.resample import resample
    from bunraku_lab.datasets.motions.clips import load_clip
    from bunraku_lab.synthetic.wardrobe import wardrobe_character

    character = wardrobe_character(seed)
    body = UnifiedBody.of(character)
    reference = resample(load_clip(motion), RATE)
    moved = body_animation(body, reference.take(slice(0, round(10 * RATE))))
    count, frames = len(moved), round(seconds * RATE)
    course = np.concatenate([np.arange(count), np.arange(count - 2, 0, -1)])
    rows = np.tile(course, frames // len(course) + 1)[:frames]
    whole = RigAnimation(character, moved.rotations[rows], moved.translations[rows], RATE)
    return _simulated(character, body, Path(motion).stem, whole)


def _simulated(character: Character, body: UnifiedBody, name: str, animation: RigAnimation) -> TrueClip:
    recording = record(body, [simulate(animation, apparel_rig(character)).animation])
    clothed = clothed_from_file(character, body)
    offsets = PushOut(clothed)(recording.transforms, recording.loose, recording.offsets)
    return TrueClip(character.name, name, clothed, recording.transforms, recording.loose, offsets)
