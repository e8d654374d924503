"""Captured examples that show what a sentence says, and those that the denoiser attends to.

An example to start from must do the requested actions, on the requested side and in the requested direction; of those,
the nearest are taken by the ranker's vectors of sentences and motions. For the denoiser only the vectors decide, as in
ReMoDiffuse (Zhang et al. 2023): training learns what is of use in an example.
"""

from __future__ import annotations

import functools
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bunraku.errors import WeightsError
from bunraku.generation.denoiser import DenoiserConfig, RetrievedExamples
from bunraku.generation.extractor import RADIUS, Extractor, load_ranker, sentence_vectors
from bunraku.generation.features import FeatureStatistics, mirror
from bunraku.generation.pack import ExamplePack, Said, load_examples, said_by
from bunraku.generation.verifier import asks_to_turn
from bunraku.gestures.catalogue import part_in
from bunraku.language.captions import mirror_words
from bunraku.language.clauses import limbs_described
from bunraku.language.encoders import TextBatch, TextEncoder, text_encoder
from bunraku.language.interactions import Interaction, says_more
from bunraku.language.lexicon import LIMB_CUES, cues_of, done_once, goes_ahead, is_cyclic, lexicon
from bunraku.language.phrasing import body_stems, saying, tells_all, told
from bunraku.language.posing import Posing, Stance
from bunraku.language.sentence import Clause
from bunraku.language.vocabulary import stems

# Chosen by eye on sheets of generated motion.
MOST = 8  # examples that are offered for a sentence
SHARED = 4  # seeds in a row among which they are dealt, so that no two of them have the same
NEAR = 0.12
"""Mean cosine by which an example may be farther than the nearest one. Chosen by eye, as are the next ones."""
MOTION = 0.15  # share of the cosine with the motion in a score, beside that with the nearest sentence
EXTRA = 0.04  # by which an example counts for less for each thing that it shows and that was not requested
STANDS = 4  # things for which standing counts in an example of what goes on: others of the same action come first
NEAR_MADE = 0.05
"""The same where the nearest is made by code, since captured ones show its action less plainly; and of one that does
the very actions, if it comes before others.
"""
LEAST = 0.65  # least mean cosine of an example that does not do the very actions
WALKING = 0.8  # the same for plain walks and runs, which the network does well by itself
SAME = 0.9
"""Cosine of two sentences that mean the same, if they share an action, or the one has none or names a limb: the ranker
takes sit-ups for sitting down, and a stab with a spear for standing with one. Not for a gesture made by code, which it
has never seen.
"""
LIKE = 0.78
"""The same where the lexicon finds the same actions in both, or none in the clause. Measured on 144 sentences that ask
for clips held out: with a cosine of .8 to .9, the nearest stretch has the very actions in 35 %, with more in 60 %.
"""
PARTLY = 0.6
"""Least mean cosine of an example that shows a part of what no example shows whole, or of what is not known by name: of
48 sentences from outside, the nearest caption would have satisfied a viewer in .46, the network in .17 to .39.
"""
_NOTHING = said_by(()).actions
_SIDED = frozenset(lexicon().reading["shown"])
_WAYS = frozenset(cue for cue in _SIDED if cue.endswith(" go"))
# captured examples must say how often, too; a gesture is done as often as requested
_SPEEDS, _TURNS, _ANGLES, _COUNTS = map(cues_of, ("speed", "turn side", "degrees", "count"))
MOST_TIMES = 4  # most repetitions of a captured example in a row
_ADDED_WAYS = cues_of("direction") | {"sideways"}
_ADDED = _ADDED_WAYS.union(lexicon().reading["added"])
"""Cues and traits of a clause that a gesture does not do where its own words do not say them."""


class Found(NamedTuple):
    """An example that fits a sentence."""

    number: int  # its index in the pack
    mirrored: bool  # its mirror image is meant
    # mean of the cosine of the sentence with its nearest sentence, and of that with its motion; and words that it says,
    # and 1 for the very actions
    score: float
    part: str = ""  # the part of the body at which a gesture is done in place of its own; "" for its own
    times: int = 1  # repetitions of a captured one that shows a counted action once
    # what is done with a thing, follows from one, or is done by limbs, as a gesture of its own
    detail: Interaction | Posing | None = None
    straight: bool = False  # it is not to turn
    close: bool = False  # it does the very actions, or says the same in much the same words: it is followed closely
    stance: Stance | None = None  # in which it is done, where its own sentences say nothing of that


class Retrieved(NamedTuple):
    """What fits a sentence.

    Args:
        found: Examples, the nearest first.
        lacking: What the sentence adds to its action that no gesture of that action has, where one would fit but for
            that.
        instead: The actions that they show where none shows what is said, but what is like it; none otherwise.
    """

    found: list[Found]
    lacking: tuple[str, ...] = ()
    instead: tuple[str, ...] = ()


def retrieve(pack: ExamplePack, clause: Clause, vector: np.ndarray) -> Retrieved:
    """Examples that show what a clause says (`_offered`), or where none does, a gait without its turn, or what is
    nearest to it by the lexicon; without turns where it speaks of none.
    """
    offered, straight, rows = _offered(pack, clause, vector), not asks_to_turn(clause), lexicon().actions
    onward = tuple(action for action in clause.actions if not rows[action].turns)
    shown = [pack.said[example.number].actions for example in offered.found]
    # of a gait with a turn, the course is bent afterwards
    if clause.turn and clause.locomotion and onward and frozenset(clause.actions) not in shown:
        bent = _offered(pack, replace(clause, actions=onward, cues=clause.cues - _TURNS - _ANGLES), vector)
        offered = bent if bent.found else offered
    nearest = tuple(dict.fromkeys(rows[action].like or action for action in clause.actions))
    if not offered.found and nearest != clause.actions:
        like = replace(clause, actions=nearest)  # which may be done another way: a hit from the left, a stagger
        offered = _offered(pack, like, vector)
        offered = offered if offered.found else _offered(pack, replace(like, cues=like.cues - _WAYS), vector)
        plain = [one for one in offered.found if pack.made[one.number]]  # words tell nothing of what is captured here
        offered = offered._replace(found=plain or offered.found, instead=nearest)
    return offered._replace(found=[example._replace(straight=straight) for example in offered.found])


def _offered(pack: ExamplePack, clause: Clause, vector: np.ndarray) -> Retrieved:
    """Examples that show what a clause says. Described limbs are a gesture of their own, and what is done with a thing
    one through the positions that it names, or as captured where it names none, or where the action, like driving a
    car, is one that only the reader names and that an example shows. Where no example shows everything,
    those count that show it once, to be repeated, those with the right limb, whichever way its movement goes, and those
    of people who stand, for what is done sitting.

    Args:
        pack: To choose from.
        clause: Of one action.
        vector: The ranker's unit vector of it, shape (V,).
    """
    described = (
        []
        if clause.detail is None or clause.voices
        else [Found(one, False, 1.0, "", 1, clause.detail) for one in pack.handled]
    )
    if described and isinstance(clause.detail, Posing):
        return Retrieved(_described(pack, clause, clause.detail) or described)
    if clause.limbs_meanwhile is not None:
        return Retrieved([])  # what else is done is shown apart
    rows = lexicon().actions
    named = bool(clause.actions) and not any(rows[action].said for action in clause.actions)  # the reader did: to drive
    if described and not named and not isinstance(clause.detail, Posing) and says_more(clause.detail):
        return Retrieved(described)
    found = _retrieved(pack, clause, vector, frozenset())
    if described and not found.found:
        return Retrieved(described)
    let_go = _WAYS if LIMB_CUES & clause.cues and "goes" not in clause.traits else frozenset[str]()
    let_go |= frozenset(("sits",)) if "sits" not in clause.traits else frozenset[str]()
    let_go |= _COUNTS if clause.count and 1 < clause.count <= MOST_TIMES else frozenset[str]()
    if found.found or found.lacking:
        return found
    if let_go & clause.cues:
        found = _retrieved(pack, clause, vector, let_go)
    if not found.found and LIMB_CUES & clause.cues:  # whose side the verifier then sees
        found = _retrieved(pack, clause, vector, let_go | LIMB_CUES)
    if "sits" in let_go & clause.cues:
        stance = clause.stance or Stance("seat")
        found = found._replace(found=[example._replace(stance=stance) for example in found.found])
    if found.found or found.lacking or clause.parts or clause.voices:
        return found
    return _retrieved(pack, clause, vector, LIMB_CUES, PARTLY)


def _described(pack: ExamplePack, clause: Clause, posing: Posing) -> list[Found]:
    """The gestures with a sentence that says the very same of limbs as a clause does."""
    matches = []
    for index in np.flatnonzero(pack.made).tolist():
        if pack.said[index].actions != frozenset(clause.actions):
            continue
        described = [limbs_described(text) for text in pack.examples[index].texts]
        same = [other.bare for other in described if other is not None and not other.rest]
        for mirrored, wanted in ((False, posing.bare), (True, posing.mirrored.bare)):
            if wanted in same:
                matches.append(Found(index, mirrored, 1.0))
                break
    return matches


def _retrieved(
    pack: ExamplePack, clause: Clause, vector: np.ndarray, let_go: frozenset[str], least: float = 0.0
) -> Retrieved:
    """Examples that show what a clause says but for these cues; with a `least` cosine also those that show a part."""
    partly = least > 0
    query = Said(frozenset(clause.actions) or _NOTHING, clause.cues, clause.traits)
    wanted = _shown(query) - let_go
    counts = query.cues & _COUNTS - let_go
    times = clause.count or 1 if query.cues & _COUNTS & let_go else 1
    lacking: dict[str, None] = {}
    sided, unsided = any(cue.startswith(("left", "right")) for cue in query.cues), query.cues & LIMB_CUES & let_go
    gait = bool(clause.actions) and query.actions <= {"walk", "run"}
    least = WALKING if gait else least or LEAST
    read = pack.readings is not None and bool(clause.actions) and not gait  # labelled by hand
    same_actions = np.array([read and said.actions == query.actions for said in pack.said], bool)
    found = []
    for mirrored in (False, True):
        near, moves = pack.nearness(vector, mirrored)
        score = near + MOTION * (moves - near)
        for index in np.flatnonzero(pack.made | same_actions | (score >= least)).tolist():
            made = bool(pack.made[index])
            if made and (not clause.actions or (mirrored and not sided)):  # it takes the hand that most people take
                continue
            if made and unsided and mirrored != any(cue.startswith("left") for cue in unsided):  # the right one
                continue
            if pack.actions[index] and query.actions != {pack.actions[index]}:  # as `_does` would find by its sentences
                continue
            said = pack.said[index]
            both = (said.actions | said.besides) & query.actions
            shared = not clause.actions or bool(both or LIMB_CUES & query.cues)
            same = shared and bool(
                near[index] >= (LIKE if not clause.actions or said.actions == query.actions else SAME)
            )
            shown = wanted - _ADDED if made else wanted | counts
            part_of_it = partly and not made and (not clause.actions or (said.actions | said.besides) & query.actions)
            if not ((part_of_it or _does(said, query, same, made)) and _agrees(said, mirrored, query, shown)):
                continue
            if times > 1 and (made or said.cues & _COUNTS or pack.examples[index].loop is not None):
                continue
            lacks, part = _lacks(pack, index, mirrored, clause) if made else ((), "")
            lacking.update(dict.fromkeys(lacks))
            if not body_stems().isdisjoint(stems(lacks)) or not lexicon().lemmas.keys() >= set(lacks):
                continue  # a verb, as in "golf drive", is no other gesture
            # in a gait no arm leads
            other_hand = mirrored and not (sided or gait) and any(cue.endswith(" arm") for cue in said.cues)
            total = float(score[index]) - EXTRA * (_apart(said, mirrored, query, made) + other_hand)
            close = not made and (same or (bool(clause.actions) and said.actions == query.actions and not said.besides))
            found.append(Found(index, mirrored, total, part, times, close=close))
    found.sort(key=lambda example: -example.score)
    exact = [example for example in found if example.close or pack.made[example.number]]
    first = bool(exact) and exact[0].score >= found[0].score - NEAR_MADE  # before what does more or less
    best_made = bool(found) and bool(pack.made[found[0].number])
    best_made = best_made and query.actions != {"stand up"}  # that depends on how the person sits, kneels or lies
    away = NEAR_MADE if best_made else NEAR
    kept = [example for example in found if example.score >= found[0].score - away]
    complete = [
        example for example in kept if example.part or tells_all(clause.added, pack.examples[example.number].texts)
    ]
    words = saying(clause.person, clause.actions) if done_once(clause.actions) else ()  # a hook is no other punch
    shares = [
        told(words, pack.examples[example.number].texts) + (first and example in exact) for example in complete or kept
    ]
    ranked = sorted(zip(shares, complete or kept, strict=True), key=lambda pair: -pair[0])
    most = max(shares.count(max(shares, default=0)), SHARED)
    kept = [example._replace(score=example.score + share) for share, example in ranked[: min(most, MOST)]]
    return Retrieved(kept, () if complete else tuple(lacking))


def _does(said: Said, query: Said, same: bool, made: bool) -> bool:
    """Whether an example does what is requested: the very actions or, captured, at least half of all that either says,
    or what is said in much the `same` words.
    """
    if said.actions == query.actions or (same and not made):
        return True
    both = said.actions | said.besides
    return not made and 2 * len(both & query.actions) >= len(both | query.actions)


def _agrees(said: Said, mirrored: bool, query: Said, wanted: frozenset[str]) -> bool:
    """Whether an example says the wanted sides, directions, postures and counts, and none that is not requested."""
    cues = mirrored_cues(said.cues) if mirrored else said.cues
    wished, shown = query.cues | query.traits, cues | said.traits
    for pair in lexicon().contrary:
        if pair & wished and pair & shown and not pair & wished & shown:
            return False
    # what is done once, like a blow, has a speed of its own
    unasked = frozenset[str]() if done_once(query.actions) else _SPEEDS
    unasked |= {"in place"} if goes_ahead(query.actions) else frozenset[str]()
    return wanted <= cues and not cues & unasked - query.cues


@functools.lru_cache(maxsize=4096)
def mirrored_cues(cues: frozenset[str]) -> frozenset[str]:
    """Cues with left and right exchanged."""
    return frozenset(map(mirror_words, cues))


def _apart(said: Said, mirrored: bool, query: Said, made: bool) -> float:
    """How many things an example shows that were not requested, other actions and, of a gesture, another way, and half
    of how many traits only one of the two has. A person who points does not point to the left, a person who falls does
    not get up and fall again, and a person who runs does not set off and halt.
    """
    ways = (mirrored_cues(said.cues) if mirrored else said.cues) & _ADDED_WAYS - query.cues
    rows = lexicon().actions
    shown = (said.actions | said.besides) - query.actions
    others = [one for one in shown if one not in rows or not rows[one].passing]
    # in what goes on, standing before it or after it disturbs
    stands = STANDS if "idle" in shown and all(map(is_cyclic, query.actions)) and "halts" not in query.traits else 0
    return stands + len(others) + made * len(ways) + len(said.traits ^ query.traits) / 2


def _lacks(pack: ExamplePack, index: int, mirrored: bool, clause: Clause) -> tuple[tuple[str, ...], str]:
    """What a clause adds to its action that a gesture does not do, and the part of the body that replaces its own."""
    texts, said = pack.examples[index].texts, pack.said[index]
    words = [word for word in clause.added if not tells_all((word,), texts)]
    cues = mirrored_cues(said.cues) if mirrored else said.cues
    added = sorted((clause.cues | clause.traits) & _ADDED - cues - said.traits)
    added = [cue for cue in added if not tells_all((cue,), texts)]
    words += [f"to the {cue.removesuffix(' go')}" if cue in _WAYS else cue for cue in added]
    if not words and not clause.count:
        return (), ""
    gesture, part = pack.gesture(index), part_in(clause.person)  # only then is the gesture read
    if gesture is None or not gesture.at:
        part = None
    if part is not None:
        words = [word for word in words if word not in part.words]
    if clause.count and gesture is not None and not gesture.counted:
        words.append(f"{clause.count} times")
    return tuple(words), "" if part is None else part.name


def _shown(query: Said) -> frozenset[str]:
    """Cues that an example must say, too: "forward" where a person goes, "around" where a person turns."""
    idle = frozenset[str]() if goes_ahead(query.actions) else {"forward"}
    rows = lexicon().actions
    turns = any("turn" in (action, *rows[action].covers) for action in query.actions if action in rows)
    return (query.cues & _SIDED) - idle - (frozenset[str]() if turns else _ANGLES)


def take_of(name: str) -> str:
    """The take of a clip, of a stretch of one or of a turn cut out of one: `cmu_13_29_jacks@40` -> `cmu_13_29`,
    `snu_WalkSad05@0` -> `snu_WalkSad`.
    """
    clip = name.partition("@")[0].removeprefix("turn_")
    return "_".join(clip.split("_")[:3]) if clip.startswith("cmu_") else clip.rstrip("0123456789")


class ExampleBank:
    """`count` examples of each sentence in a network's units (`statistics`), with the vectors of their sentences,
    computed when needed. The captured ones of the pack are used, not gestures made by code; those longer than `frames`
    are cut.
    """

    def __init__(
        self, pack: ExamplePack, ranker: Extractor, encoder: TextEncoder, statistics: FeatureStatistics, count: int,
        frames: int = 196,
    ):  # fmt: skip
        self.pack, self.ranker, self.encoder, self.statistics = pack, ranker, encoder, statistics
        self.count, self.frames = count, frames
        self._usable = ~pack.made & np.array([bool(example.texts) for example in pack.examples], bool)
        self._known: dict[tuple[int, bool], tuple[np.ndarray, np.ndarray]] = {}

    @cached_property
    def _takes(self) -> list[str]:
        return [take_of(example.name) for example in self.pack.examples]

    def nearest(self, vector: np.ndarray, without: Collection[str] = ()) -> list[tuple[int, bool]]:
        """The nearest examples and whether the mirror image is meant; of an example and its mirror image the nearer.

        Args:
            vector: The ranker's unit vector of the sentence, shape (V,).
            without: Takes that are passed over (`take_of`).
        """
        scores = np.stack([np.mean(self.pack.nearness(vector, mirrored), axis=0) for mirrored in (False, True)])
        usable = self._usable & ~np.isin(self._takes, list(without)) if without else self._usable
        best = np.where(usable, scores.max(0), -np.inf)
        order = np.argsort(-best, kind="stable")[: self.count]
        return [(int(index), bool(scores[1, index] > scores[0, index])) for index in order if usable[index]]

    def __call__(self, text: TextBatch, without: Sequence[Collection[str]] | None = None) -> RetrievedExamples:
        """Examples of each encoded sentence; `without` are the takes that are passed over for each."""
        vectors = self.vectors(text)
        excluded = [()] * len(vectors) if without is None else without
        rows = [self.nearest(*pair) for pair in zip(vectors, excluded, strict=True)]
        found = [[self.example(*one) for one in row] for row in rows]
        lengths = np.zeros((len(rows), self.count), np.int64)
        longest = max((len(values) for row in found for values, _ in row), default=1)
        values = np.zeros((len(rows), self.count, longest, len(self.statistics.mean)), np.float32)
        pooled = np.zeros((len(rows), self.count, self.encoder.pooled_size), np.float32)
        for row, own in enumerate(found):
            for index, (features, vector) in enumerate(own):
                lengths[row, index] = len(features)
                values[row, index, : len(features)] = features
                pooled[row, index] = vector
        return RetrievedExamples(values, lengths, pooled)

    def vectors(self, text: TextBatch) -> np.ndarray:
        """The ranker's unit vectors of encoded sentences, (B, V); it reads as much of their own vectors as it knows."""
        size = self.ranker.config.pooled_size
        return sentence_vectors(self.ranker, TextBatch(text.tokens, text.mask, text.pooled[:, :size])) / RADIUS

    def example(self, index: int, mirrored: bool) -> tuple[np.ndarray, np.ndarray]:
        """Features of an example in the network's units (N, D), float16, and the vector of its sentence (P,)."""
        key = (index, mirrored)
        if key not in self._known:
            features, text = self.pack.features(index)[: self.frames], self.pack.examples[index].texts[0]
            if mirrored:
                features, text = mirror(features), mirror_words(text)
            vector = self.encoder.encode([text]).pooled[0]
            self._known[key] = (self.statistics.normalise(features).astype(np.float16), vector)
        return self._known[key]


def example_bank(
    config: DenoiserConfig, statistics: FeatureStatistics, pack: ExamplePack | None = None,
    encoder: TextEncoder | None = None,
) -> ExampleBank:  # fmt: skip
    """The bank of a denoiser that attends to examples; with the shipped pack it is kept between calls.

    Args:
        config, statistics: Of the denoiser.
        pack: In place of the shipped examples.
        encoder: In place of the denoiser's own text encoder.

    Raises:
        WeightsError: There are no examples beside the shipped weights.
    """
    pack = pack or load_examples()
    if pack is None:
        raise WeightsError(
            "these weights attend to captured examples, but examples.safetensors is missing beside the shipped "
            "weights; install Bunraku again"
        )
    if encoder is not None:
        return ExampleBank(pack, load_ranker(), encoder, statistics, config.examples)
    key = (statistics.mean.tobytes(), statistics.std.tobytes())
    return _bank(pack, config.text_encoder, key, config.examples)


@functools.lru_cache(maxsize=1)
def _bank(pack: ExamplePack, encoder: str, units: tuple[bytes, bytes], count: int) -> ExampleBank:
    statistics = FeatureStatistics(*(np.frombuffer(part, np.float32) for part in units))
    return ExampleBank(pack, load_ranker(), text_encoder(encoder), statistics, count)
