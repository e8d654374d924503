"""One training clip in network units: what it says, whether it may be played again, and how it is made longer."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from bunraku.diffusion.features import FeatureStatistics, feature_weights, is_rotation
from bunraku.diffusion.splicing import END, held, join_point, played, rests
from bunraku.language.captions.phrases import caption_group
from bunraku.language.lexicon.reading import is_cyclic, main_actions
from bunraku_lab.description.wording import all_variants, clauses
from bunraku_lab.training.rows.clip_data import ClipEntry
from bunraku_lab.training.rows.stretches import agreeing, stretch_phrases, stretch_variants

__all__ = ["TrainingClip"]

FARTHEST = 8.0
"""Standard deviations beyond which a velocity or a translation is a fault of capture, which would outweigh all else in
a squared error. Rotations have no such faults: whoever lies is twelve deviations from standing.
"""
_FARTHEST = np.where(is_rotation(), np.inf, FARTHEST).astype(np.float32)
_ONCE = re.compile(
    r"\b(then|once|twice|two|three|four|five|six|times|after|before|finally|first|ends?|ending|starts?|stops?|stopping|"
    r"begins?|halts?|until|again|turns?|turning|half ?way|back up|back to|straightens|stands? up|gets? up|rises?|"
    r"sits? down|lies? down|single|double|triple|slows?|pauses?|finish\w*|away)\b"
)
"""Words of a sentence that is no longer true when its motion is played twice."""
_FINAL = {"death", "die", "dead", "hit", "hit reaction", "attack", "jump", "land", "spawn", "fall"}
_TURNS = frozenset({"spin", "circle"})
MOST_TURN = np.radians(25)
"""Change of heading [rad] in one round of a loop; more adds up to turns that nobody spoke of."""


@dataclass(frozen=True)
class TrainingClip:
    """One clip, or a stretch of one, in network units.

    Args:
        name: Its name in the index.
        values: Normalised features, shape (N, D), float32.
        texts: Its captions: labels as the archive has them, or sentences of what was watched.
        watched: The captions were written from watching just this; the fullest is first, the tersest last.
        labels: Labels of the archive for a watched clip, used where they say the same.
        weight: The index's own weight.
        loop: Frames (i, j) such that playing on from j after i is smooth and what the captions say stays true; None
            where there are none.
        rests: The clip ends at rest, so its last pose can be held.
        follows: Name of the stretch that goes on where this one ends.
        species: What creature it is of; None for people.
        action: What is done, in a canonical word, where the index says so.
        character: The creature's name in the mesh bank; None for any humanoid.
        rehearsed: It is not of the data, but something that the network knew before.
    """

    name: str
    values: np.ndarray
    texts: tuple[str, ...]
    watched: bool = False
    labels: tuple[str, ...] = ()
    weight: float = 1.0
    loop: tuple[int, int] | None = None
    rests: bool = False
    follows: str | None = None
    species: str | None = None
    action: str | None = None
    character: str | None = None
    rehearsed: bool = False

    @property
    def label(self) -> str:
        """What groups it with clips of the same meaning."""
        if self.watched:
            return " and ".join(self.actions)
        group = caption_group(self.texts[0])
        return (
            f"{self.species or 'person'}: {self.action}"
            if self.action and not (self.species is None and group.phrases)
            else group.name
        )

    @property
    def actions(self) -> tuple[str, ...]:
        """What a person does in it, in the words that the draws are balanced by."""
        return main_actions(self.texts)

    @property
    def phrases(self) -> tuple[str, ...]:
        """What it shows without a subject, verbs in braces, to be joined with others; none where no caption has that
        form.
        """
        return stretch_phrases(self.texts) if self.watched else clauses(self.texts[0], self.species, self.action)

    def sentences(self, mirrored: bool = False) -> tuple[str, ...]:
        """All sentences that the captions give."""
        if self.watched:
            return stretch_variants(self.texts, agreeing(self.texts, self.labels), mirrored)
        labels = ("",) if self.species else self.texts
        return tuple(
            dict.fromkeys(
                sentence for text in labels for sentence in all_variants(text, self.species, self.action, mirrored)
            )
        )

    @classmethod
    def prepare(cls, name: str, entry: ClipEntry, statistics: FeatureStatistics, frames: int) -> TrainingClip:
        """Bring a clip to network units and see whether it loops or ends at rest.

        Args:
            name: Its name in the index.
            entry: Its index entry with its "features", shape (N, D).
            statistics: Units of the network.
            frames: Only clips shorter than this are ever lengthened.
        """
        values = np.clip(statistics.normalise(entry["features"]).astype(np.float32), -_FARTHEST, _FARTHEST)
        species, action = entry.get("species"), entry.get("action")
        creature = (species, action, entry.get("character")) if species and action else (None, action, None)
        texts = tuple(entry.get("texts") or [f"a {species}: {action}"])
        watched, loop, ends_at_rest = bool(entry.get("watched")), None, False
        if len(values) < frames:
            if may_loop(texts, species, action):
                i, j, distance = join_point(values, values, feature_weights())
                turn = abs(float(entry["features"][j:i, 0].sum())) / 20
                if (
                    distance < (0.8 if len(values) < 60 else 0.3)
                    and i - j >= 6
                    and (turn < MOST_TURN or _TURNS & set(main_actions(texts)))
                ):
                    loop = (i, j)
            ends_at_rest = rests(values[-END:], statistics)
        labels = tuple(entry.get("labels") or ())
        return cls(
            name,
            values,
            texts,
            watched,
            labels,
            float(entry.get("weight", 1.0)),
            loop,
            ends_at_rest,
            entry.get("next"),
            creature[0],
            creature[1],
            creature[2],
            bool(entry.get("rehearsed")),
        )

    def lengthened(self, target: int, still: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """The clip played again from its loop point, or with its last pose held, until it has `target` frames or can
        have no more.

        Args:
            target: Frames wanted.
            still: The root's velocities at rest in network units, shape (3,).
            random: Draws how long the last pose is held.

        Returns:
            The very array of the clip where nothing can be added, else a longer one, shape (N, D).
        """
        if self.loop is not None:
            return played(self.values, self.loop, target)
        if self.rests and len(self.values) < target:
            return held(self.values, min(target - len(self.values), int(random.integers(5, 40))), still)
        return self.values


def may_loop(texts: tuple[str, ...], species: str | None, action: str | None) -> bool:
    """Whether what the captions say is still true when the motion is played again."""
    if species is not None:
        return action not in _FINAL
    return all(map(is_cyclic, main_actions(texts))) and not any(_ONCE.search(text) for text in texts)
