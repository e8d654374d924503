"""The action test: a classifier that was fitted to captured clips alone names what generated ones do.

Forty actions, each asked for in two sentences that no caption has. Captured clips are so few of each action (7 of
waving) that the same test on them is by turns: the clips of one fifth are named by a classifier of the other four.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.errors import FormatError
from bunraku.language.description.track import SIDES, Track
from bunraku.language.lexicon.reading import actions_of, main_actions
from bunraku_lab.datasets.motions.clips import load_clip, load_index
from bunraku_lab.evaluation.motion.classifier import ActionClassifier, action_features, fit_classifier

__all__ = ["SENTENCES", "ActionClip", "action_clips", "by_turns", "captured_classifier", "named", "person_features"]

SENTENCES: dict[str, tuple[str, str]] = {
    "walk": ("the person is out for a walk", "let them walk across the room"),
    "idle": ("somebody just stands there idle", "the figure waits standing"),
    "squat": ("let him do squats", "the woman squats low"),
    "run": ("somebody is running to the goal", "the person runs as if late"),
    "tennis": ("she plays tennis against a wall", "the man hits a ball with a racket"),
    "jump": ("the man jumps for joy", "let her jump up and down"),
    "kick": ("he kicks an enemy", "the fighter kicks hard"),
    "turn": ("the person turns to one side", "she turns where she stands"),
    "sneak": ("a thief sneaks through the house", "the man is sneaking past a guard"),
    "talk": ("she talks with lively hands", "the speaker is explaining something"),
    "zombie": ("he shambles like a zombie", "the undead zombie walks"),
    "reach": ("she reaches for a shelf", "the child reaches out for something"),
    "stand up": ("the old man stands up from where he is", "she gets up to her feet"),
    "pick up": ("somebody picks up a coin", "the man picks something up from below"),
    "backward": ("the person goes backwards", "he walks backward away from danger"),
    "shoot a ball": ("the player shoots a ball at the hoop", "he takes a jump shot"),
    "wash": ("she washes a window", "the man is washing the car"),
    "climb": ("he climbs a ladder", "somebody is climbing up a wall"),
    "dance": ("the girl dances at a party", "let him dance to the music"),
    "twist": ("the person twists the trunk from side to side", "she twists her upper body"),
    "sword": ("the knight swings a sword", "she slashes with a sword"),
    "lunge": ("he does lunges", "the athlete lunges deep"),
    "raise arm": ("the pupil raises an arm", "she raises her arms to the sky"),
    "dribble": ("the player is dribbling a ball", "he dribbles past somebody"),
    "knee lift": ("she lifts her knees one after the other", "let him do knee lifts"),
    "salsa": ("the couple's man dances salsa", "she is dancing the salsa"),
    "circle": ("the guard walks in circles", "he walks around in a circle again and again"),
    "hang": ("he hangs from a branch", "the climber is hanging by the hands"),
    "sit": ("the guest sits on a bench", "she is sitting and resting"),
    "hop": ("the child hops along", "he hops on one foot"),
    "punch": ("the boxer throws punches", "he punches an opponent"),
    "stagger": ("the drunk staggers home", "she staggers and nearly falls"),
    "drink": ("the man drinks a glass of water", "she takes a drink"),
    "wave": ("the child waves goodbye", "she waves at a friend"),
    "arm circle": ("the swimmer circles the arms to warm up", "he does arm circles"),
    "march": ("the soldier marches", "they march on parade"),
    "catch": ("the keeper catches a ball", "she catches something thrown at her"),
    "swim": ("he swims a length", "the swimmer is swimming breaststroke"),
    "spin": ("the ballerina spins", "he spins like a top"),
    "jumping jack": ("the class does jumping jacks", "he is doing jumping jacks"),
}
"""What is requested, by the words of the lexicon."""
SHORTEST = 20  # frames of a captured clip
FOLDS = 5
_LIMBS = ("wrist", "elbow", "ankle")
_SPECTRUM = 128  # frames
_BANDS = (1, 4, 9, 17, 33, 65)


def _spread(values: np.ndarray) -> list[float]:
    return [*np.quantile(values, [0.1, 0.5, 0.9]), float(values.std()), float(np.abs(np.diff(values)).mean())]


def _tempo(position: np.ndarray) -> list[float]:
    """Shares of five bands in the power of a way to and fro, shape (N, 3)."""
    long = np.zeros((_SPECTRUM, 3))
    part = (position - position.mean(axis=0))[:_SPECTRUM]
    long[: len(part)] = part
    power = (np.abs(np.fft.rfft(long, axis=0)) ** 2).sum(axis=1)
    return [float(power[low:high].sum() / (power.sum() + 1e-9)) for low, high in zip(_BANDS, _BANDS[1:], strict=False)]


def person_features(motion: HandleMotion) -> np.ndarray:
    """What the classifier sees of a person with at least two frames, the same for the mirrored motion, shape (235,):
    `action_features`, and where hands, elbows and feet are, the higher value of the two sides and the lower.
    """
    track = Track.of(motion)
    found: list[float] = []
    root = motion.root_translation[:, 1]
    positions = {f"{side}_{part}": track.relative(f"{side}_{part}") for side in SIDES for part in _LIMBS}
    for part in _LIMBS:
        sides = []
        for sign, side in zip((1, -1), SIDES, strict=True):
            position = positions[f"{side}_{part}"]
            own = (sign * position[:, 0], position[:, 1] - root, position[:, 2])
            sides.append(np.concatenate([_spread(values) for values in own]))
        found += [*np.maximum(*sides), *np.minimum(*sides)]
    found += _spread(np.linalg.norm(positions["left_wrist"] - positions["right_wrist"], axis=1))
    body = (track.feet.min(axis=1), track.feet.max(axis=1), track.height, track.up, track.speed, track.velocity[:, 0])
    for values in (*body, track.points["head"][:, 1] - root):
        found += _spread(values)
    rate = np.gradient(track.angle) * track.fps
    found += [float(abs(track.angle[-1] - track.angle[0])), float(np.abs(rate).mean()), float(np.abs(rate).max())]
    found.append(float(np.abs(track.velocity[:, 1]).mean()))
    for part in ("wrist", "ankle"):
        both = np.array([_tempo(positions[f"{side}_{part}"]) for side in SIDES])
        found += [*both.max(axis=0), *both.min(axis=0)]
    return np.concatenate([action_features(motion), found])


@dataclass(frozen=True)
class ActionClip:
    """A captured stretch in which one thing is done.

    Args:
        clip: Name of the file that it is of; stretches of one stay together.
        action: What is done.
        motion: Of the reference body.
    """

    clip: str
    action: str
    motion: HandleMotion


def action_clips(folder: str | Path) -> list[ActionClip]:
    """All captured stretches of people that say just one of the forty actions.

    Raises:
        FormatError: The index or a clip is missing or damaged, or there are none.
    """
    folder = Path(folder)
    found = []
    for clip, entry in sorted(load_index(folder).items()):
        if entry.get("species"):
            continue
        for part in entry.get("stretches", []):
            if "fault" in part or part["stop"] - part["start"] < SHORTEST:
                continue
            actions = main_actions(part["texts"])
            sure = all((actions_of(text) or actions) == actions for text in part["texts"][-2:])
            if len(actions) == 1 and sure and actions[0] in SENTENCES:
                motion = load_clip(folder / f"{clip}.npz").take(slice(part["start"], part["stop"]))
                found.append(ActionClip(clip, actions[0], motion))
    if not found:
        raise FormatError(
            folder, "there are no captured clips of single actions; build them with 'bunraku data motions'"
        )
    return found


def captured_classifier(clips: Sequence[ActionClip]) -> ActionClassifier:
    """The classifier of captured clips."""
    return fit_classifier([clip.motion for clip in clips], [clip.action for clip in clips], describe=person_features)


def by_turns(clips: Sequence[ActionClip]) -> list[str]:
    """What each captured clip is named by a classifier of the clips of other files."""
    files = sorted({clip.clip for clip in clips})
    order = np.random.default_rng(0).permutation(len(files))
    fold = {files[index]: number % FOLDS for number, index in enumerate(order)}
    answers = [""] * len(clips)
    for number in range(FOLDS):
        own = [index for index, clip in enumerate(clips) if fold[clip.clip] == number]
        others = [clip for clip in clips if fold[clip.clip] != number]
        if own and others:
            for index, answer in zip(
                own, captured_classifier(others).predict([clips[i].motion for i in own]), strict=True
            ):
                answers[index] = answer
    return answers


def named(actions: Sequence[str], answers: Sequence[str]) -> dict[str, Any]:
    """How often the answers are right: "accuracy" as the mean over actions, and "by_action"."""
    right: dict[str, list[bool]] = {}
    for action, answer in zip(actions, answers, strict=True):
        right.setdefault(action, []).append(action == answer)
    table = {action: float(np.mean(found)) for action, found in sorted(right.items())}
    return {"accuracy": float(np.mean(list(table.values()))), "by_action": table}
