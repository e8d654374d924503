"""How keyframed animals walk, run, attack, eat and die: creatures with such legs do it after them.

A clip is kept as the motion of the 30 handles of a body in its own stance (`retarget.creatures`), packed as the
examples of people are.
"""

from __future__ import annotations

import functools
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.anatomy.legs import BodyPlan
from bunraku.core.arrays import lzma_filters, pack_steps, unpack_steps
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.geometry.rotations import Resampling, axis_angle_from_matrix, matrix_from_axis_angle, nearest_rotation
from bunraku.core.motion import HandleMotion, resample
from bunraku.core.travel import placed_at, repeated
from bunraku.errors import BunrakuError, WeightsError
from bunraku.files import Source, bones_of, clip_names, own_animation
from bunraku.language.captions import caption_table, conjugate
from bunraku.language.sentence import Sentence
from bunraku.retarget.creatures import CreatureMotion, motion_of_handles
from bunraku.retarget.fit import posed
from bunraku.retarget.locomotion import turning, widened
from bunraku.retarget.rig_parts import RigParts
from bunraku.retarget.stages.feet import Feet, foot_motion
from bunraku.retarget.stages.stage import sole_points
from bunraku.retarget.to_reference import bones_to_handles

KIND = "creatures"
FPS = 20.0
_METRES, _RADIANS, _ORDER = 1e-3, 2e-3, 2  # steps of a packed clip; chosen by eye, as those of the examples
_FILTERS = lzma_filters(9, 1 << 16)
_NUMBERS = 4 + 3 * HANDLE_COUNT
MOST_FRAMES = 400  # of one clip; more in a file is damage
GAITS = ("walk", "run", "trot", "gallop")
"""Actions whose clips are one round of steps on the spot."""
STANDS = 0.25  # a foot stands while it is lower than this share of how far it is lifted; chosen by eye on horses
HURRY = {"slow": 0.75, "fast": 1.25}  # how much faster than their clip steps are by what is said; chosen by eye
LIFTED = {"walk": 0.05}
"""How far a walk is off the ground at the most [m of the reference body]; chosen by eye on dogs that leap in theirs."""
LEAPS = 0.4  # what rises by more is no round of steps [m]; chosen by eye on a deer that bucks
LEAST = 0.35
"""A clip in which the head turns by less shows nothing [rad]; chosen by eye, those of 20° stood still."""
EACH = 2  # clips of a file that are read of one action
OWN = "own"  # stands for the animal of a clip of the character's own file
FINE = 60.0  # rate at which clips of files are read [1/s]
FEWEST, MOST = 6, 130  # frames of such a clip; longer ones wait before they begin
CLOSES, SWING = 0.35, 0.1
"""How far a part may be from where it began at the end of a round of steps, and through how much each thigh swings at
the least [rad]; chosen by eye."""
FADE = 6  # frames in which what follows begins as what was before ended; chosen by eye
NAMED, ALIKE = 2.0, 1.0
"""What it counts that a clip is of the animal that is named, or of one like it, against a body e times as long for its
height; chosen by eye on sheets."""
LESS = 0.3  # what each place counts by which an action stands behind the one that is asked for; chosen by eye
TURNS = "turn", "turn left", "turn right"
"""Actions that bodies do by a walk on a bow."""
REACHES = 1.3  # how far the mouth is from the shoulder at the most, over the arm's length; chosen by eye on goblins
_MOVES = (("stay", "lie", ""), ("step", "run"))  # how a body moves for which clips are looked up; steps last
GOALS = "eat", "attack", "death"  # what a body does as a whole, with or without a clip (`locomotion.reached`)
SPREAD = 0.2  # scale of the Gumbel numbers that make seeds differ; chosen by eye
PACES = 0.85, 1.15  # how fast a clip is done, for seeds that take the same one to differ; chosen by eye on a dragon
_PELVIS, _HEAD = HANDLE_NAMES.index("pelvis"), HANDLE_NAMES.index("head")
_THIGHS = [HANDLE_NAMES.index(f"{side}_hip") for side in ("left", "right")]


@dataclass(frozen=True)
class CreatureClip:
    """One clip of an animal: what it does by the table of creatures' captions, the kind of its body
    (`_kind`), its `body_shape`, and the packed motion.
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
            piece, shape = data[start : start + int(size)], (float(length), float(slope))
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
    """The actions whose clips show an action, the best first."""
    table: dict[str, list[str]] = caption_table("creature_captions.json")["shown by"]
    return table


def _likeness(clip: CreatureClip, words: set[str]) -> float:
    """How near the animal of a clip is to those that some words name."""
    if clip.animal in words or clip.animal == OWN:
        return NAMED * (1 + (clip.animal == OWN))
    kinds = caption_table("creature_captions.json")["kinds"]
    return ALIKE * any(clip.animal in kind["species"] and words & {*kind["species"]} for kind in kinds)


def file_clips(
    parts: RigParts, animal: str, wanted: Callable[[str], bool]
) -> Iterator[tuple[CreatureClip, CreatureMotion]]:
    """The clips of a character's file that show an action which is wanted, by their names, and that its rig is known to
    make: no person's, no flight of what has legs, and of steps only whole rounds of four legs at the most.
    """
    character, source = parts.character, parts.character.source
    if not isinstance(source, Source):
        return
    shown = {action for actions in shown_by().values() for action in actions}
    for number, label in enumerate(clip_names(source.document)):
        action = creature_action(re.sub(r"[_\d]+", " ", label.split("|")[-1]))
        if action not in shown or not wanted(action) or (action in GAITS and parts.anatomy.has_extra_legs):
            continue
        try:
            fine = own_animation(character, number, FINE)
        except BunrakuError:  # which is said where the clip itself is asked for
            continue
        seconds = (len(fine.motion) - 1) / FINE
        frames = round(seconds * FPS)
        if not FEWEST <= frames < MOST:
            continue
        creature = motion_of_handles(bones_to_handles(parts, *bones_of(fine), FINE), parts.anatomy)
        if creature is None or (creature.flies and parts.anatomy.plan.legs):
            continue
        creature = creature.at(frames / seconds)  # as many whole frames as there is time, so that rounds close
        motion, heights = creature.motion, creature.heights
        if action in GAITS:
            if not _is_round(motion) or np.ptp(heights) > LIFTED.get(action, LEAPS):
                continue
            path = motion.root_translation.astype(np.float64)
            way = np.linspace(0, 1, len(path))[:, None] * (path[-1] - path[0]) + path[0] * [1, 0, 1]
            motion, heights = replace(motion, root_translation=path - way), heights - heights.min()
        elif _head_moves(motion):
            heights = np.maximum(heights - heights[0], 0)  # they begin standing, and sink nowhere
        else:
            continue
        shape, body = body_shape(parts.anatomy), _kind(parts.anatomy.plan)
        yield CreatureClip(animal, action, body, shape, len(motion), packed_clip(motion, heights)), creature


def _head_moves(motion: HandleMotion) -> bool:
    head = motion.root_rotation.astype(float) @ motion.rotations[:, _HEAD].astype(float)
    return bool(np.linalg.norm(axis_angle_from_matrix(head[0].T @ head), axis=-1).max() > LEAST)


def _is_round(motion: HandleMotion) -> bool:
    """Whether steps end as they begin, look ahead, and swing both thighs."""
    turns = motion.rotations.astype(float)
    away = np.linalg.norm(axis_angle_from_matrix(np.swapaxes(turns[0], -1, -2) @ turns[-1]), axis=-1)
    swings = [np.ptp(axis_angle_from_matrix(turns[:, thigh])[:, 0]) for thigh in _THIGHS]
    return bool(away.max() < CLOSES and min(swings) > SWING and motion.root_rotation[:, 2, 2].min() > 0)


@functools.lru_cache(maxsize=8)
def own_clips(parts: RigParts, wanted: tuple[str, ...]) -> tuple[CreatureClip, ...]:
    """The clips of a character's own file that show some actions (`file_clips`), the first few of each."""
    counts: Counter[str] = Counter(dict.fromkeys(wanted, EACH))
    clips = []
    for clip, _ in file_clips(parts, OWN, lambda action: counts[action] > 0):
        counts[clip.action] -= 1
        clips.append(clip)
    return tuple(clips)


def creature_motion(
    sentence: Sentence, anatomy: Anatomy, seed: int, own: RigParts | None = None
) -> CreatureMotion | None:
    """What a sentence, as the body does it, asks of a creature, after clips of its file, where its `own` bones move it,
    or of animals with a body like its own, which the seed draws; None where they do not show all of it.
    """
    words = {*re.findall(r"[a-z]+", f"{Path(anatomy.character.name).stem} {sentence.english}".lower())}
    random = np.random.default_rng(seed % 2**63)
    taken: tuple[HandleMotion, np.ndarray] | None = None
    goals: list[tuple[str, float, float]] = []
    plan = anatomy.plan
    for clause in sentence.clauses:
        action = creature_action(clause.text)
        said = frozenset() if action in TURNS else clause.cues - {"forward", *HURRY}
        if clause.moves not in _MOVES[action in GAITS] or said or (clause.turn is None) == (action in TURNS):
            return None
        shown = shown_by().get(action, [])
        goals_of = GOALS if plan.kind != "person" or plan.wings else () if _feeds_itself(anatomy) else GOALS[:2]
        goal = next((name for name in goals_of if name in shown), "")
        if not goal and plan.upright:  # it steps as people do
            return None
        frames, stiff = max(round(clause.seconds * FPS), 1), not plan.legs and (plan.upright or plan.wings)
        clip = None if stiff else _chosen(shown, anatomy, words, random, own)
        if clip is None and not goal:
            return None
        if goal:
            start = 0.0 if taken is None else len(taken[1]) / FPS
            goals.append((goal, start, start + frames / FPS))
        if clip is None:
            still = np.tile(np.eye(3), (frames, 1, 1))
            turns = np.tile(np.eye(3), (frames, HANDLE_COUNT, 1, 1))
            at_rest = HandleMotion(np.zeros((frames, HANDLE_COUNT, 3)), turns, np.zeros((frames, 3)), still, FPS)
            part = at_rest.of_own_body(), np.zeros(frames)
        elif clip.action in GAITS:
            hurry = [factor for cue, factor in HURRY.items() if cue in clause.cues]
            part = _stepping(clip, frames, random.uniform(*PACES) * float(np.prod(hurry)), random, anatomy)
            if clause.turn is not None:
                side = clause.turn.side or random.choice([-1, 1])
                part = turning(part[0], side * (clause.turn.least + clause.turn.most) / 2), part[1]
        else:
            part = _lasting(clip, frames, random)
        taken = part if taken is None else _followed(*taken, *part)
    return None if taken is None else CreatureMotion(taken[0], plan, taken[1], goals=tuple(goals))


def _chosen(
    wanted: list[str], anatomy: Anatomy, words: set[str], random: np.random.Generator, own: RigParts | None
) -> CreatureClip | None:
    """The clip of one of some actions, the best first, that suits a body the most; None where none does."""
    shape, kind, offered = body_shape(anatomy), _kind(anatomy.plan), []
    for clip in (*shipped_clips(), *(own_clips(own, tuple(wanted)) if own and wanted else ())):
        far = float(np.hypot(*np.subtract(clip.shape, shape)))
        if clip.action in wanted and clip.body == kind:
            score = _likeness(clip, words) - LESS * wanted.index(clip.action) - far + SPREAD * random.gumbel()
            offered.append((score, clip))
    return max(offered, key=lambda pair: pair[0])[1] if offered else None


def _kind(plan: BodyPlan) -> str:
    """The kind of a body whose clips are alike; those without legs by how they move."""
    if plan.legs:
        return plan.kind
    return "snake" if plan.slithers else "fish" if plan.swims else "wings" if plan.wings else plan.kind


def _lasting(clip: CreatureClip, frames: int, random: np.random.Generator) -> tuple[HandleMotion, np.ndarray]:
    """A clip for so many frames, again and again, each time at a pace of its own; a death is held at its end."""
    motion, heights = clip.unpacked

    def once() -> tuple[HandleMotion, np.ndarray]:
        paced = resample(motion, FPS / random.uniform(*PACES))
        at = np.linspace(0, len(motion) - 1, len(paced))
        return replace(paced, fps=FPS), np.interp(at, np.arange(len(motion)), heights)

    whole = once()
    if clip.action == "death":
        indices = np.minimum(np.arange(frames), len(whole[0]) - 1)
        return whole[0].take(indices), whole[1][indices]
    while len(whole[0]) < frames:
        whole = _followed(*whole, *once())
    return whole[0].take(slice(frames)), whole[1][:frames]


def _stepping(
    clip: CreatureClip, frames: int, pace: float, random: np.random.Generator, anatomy: Anatomy
) -> tuple[HandleMotion, np.ndarray]:
    """A clip of steps on the spot for so many frames, round after round from anywhere in it, `pace` times as fast,
    which gets a body ahead by as much as its standing feet go back.
    """
    motion, heights = clip.unpacked
    last = len(motion) - 1
    start = int(random.integers(last))
    more = start + int(frames * pace) + 2
    whole = replace(resample(repeated(motion, 0, more).take(slice(start, None)), FPS / pace), fps=FPS)
    rounds = np.resize(heights[:-1], more + last + 1)[start:]
    high = Resampling.of(len(rounds), FPS, FPS / pace).linear(rounds)
    return _travelled(widened(whole.take(slice(frames)), anatomy, np.ones(frames)), anatomy), high[:frames]


def _feeds_itself(anatomy: Anatomy) -> bool:
    """Whether a hand comes to the mouth, with some nodding."""
    mouth = anatomy.mesh.vertices[anatomy.muzzle]
    return any(np.linalg.norm(mouth - arm.joints[0]) < REACHES * arm.length for arm in anatomy.arms)


def _travelled(motion: HandleMotion, anatomy: Anatomy) -> HandleMotion:
    """The steps of a body on the spot as those with which it gets ahead, at one speed: the middle one of the feet that
    stand, as they go back on this body.
    """
    body = anatomy.unturned
    world = posed(motion, body).transforms(body.handles.positions)
    speeds: list[float] = []
    for leg in body.legs:
        step, height = foot_motion(sole_points(leg, body, world), body.floor, Feet.roll * leg.length)
        # On a body unlike the animal's a foot may drag as it goes forward, which is no stand.
        stands = (height < height.min() + STANDS * np.ptp(height)) & (step[:, 1] < 0)
        speeds.extend(-step[stands, 1])
    path = motion.root_translation.astype(np.float64)
    path[:, 2] += (float(np.median(speeds)) / body.scale if speeds else 0.0) * np.arange(len(motion))
    return replace(motion, root_translation=path)


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
