"""What `bunraku evaluate motion` asks for to see what a viewer sees, and the figures that sum it up.

Motions of the reference body are made of plain sentences, several seeds each, and measured by the functions of
`viewer.measures`. Speed and trembling are compared with captured clips that are said to do the same.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.generation.verifier import SIDES
from bunraku.language.lexicon import main_actions
from bunraku_lab.datasets.motions.clips import load_clip, load_index
from bunraku_lab.evaluation.motion import viewer
from bunraku_lab.evaluation.motion.metrics import measure_seams
from bunraku_lab.evaluation.motion.table import MotionEvalConfig, Report
from bunraku_lab.evaluation.report import Bar

BATCH = 32
"""Motions made at once."""
ENOUGH = 8
"""Captured clips of an action that are enough to compare with."""
SHORTEST = 20  # frames of a captured clip that is compared with

Make = Callable[[Sequence[tuple[str, float]]], list[HandleMotion]]

# Goals, set before anything was measured.
VIEWER_BARS = {
    "turn_side_degrees": Bar("turns left or right: degrees to that side, median", 60, 130),
    "turn_side_share": Bar("- share of 45 to 150 degrees to that side", 0.7),
    "turn_around_degrees": Bar("turns around: degrees, median", 150, 210),
    "turn_around_share": Bar("- share of 130 to 230 degrees", 0.7),
    "wave_range_cm": Bar("waves: way of the hand to and fro, median [cm]", 15),
    "wave_above_5hz": Bar("- share of its velocity's energy above 5 Hz, median", most=0.3),
    "side_accuracy": Bar("kicks, punches, raises, waves, steps with the requested side", 0.9),
    "speed_over_captured": Bar("speed of walks and runs over captured, the farthest from 1", 0.8, 1.2),
    "jitter_over_real": Bar("third difference over captured, the largest of 8 actions", most=1.5),
    "float_share": Bar("frames in which nothing carries the body", most=0.05),
    "sitting_ok": Bar("sits: feet down and pelvis 20 cm lower", 1.0),
    "heading_drift_60s": Bar("60 s of walking forward: largest change of heading [degrees]", most=30),
    "seam_jump": Bar("- largest frame-to-frame jump at a seam over median", most=3),
}
SIDE_PROMPTS = {
    "kick": ("a person kicks with the {} leg", "someone kicks with their {} foot"),
    "punch": ("a person punches with the {} hand", "someone throws a punch with the {} hand"),
    "raise": ("a person raises the {} arm", "someone raises their {} hand"),
    "wave": ("a person waves with the {} hand", "someone waves their {} hand"),
    "step": ("a person steps to the {}", "someone takes a step to the {}"),
}
STANDING = (
    "a person stands still", "a person walks forward", "a person kicks with the left leg",
    "a person kicks with the right leg", "a person punches", "a person waves with the right hand",
    "a person turns left", "a person turns around", "a person raises both arms", "a person bows", "a person squats",
    "a person claps",
)  # fmt: skip
SITTING = (
    "a person sits down on a chair", "a person sits", "a person sits down", "a person sits on the floor",
)  # fmt: skip
WALK = "a person walks forward"


@dataclass(frozen=True)
class Captured:
    """Which captured clips do what a sentence says.

    Args:
        sentence: That is generated.
        action: The only action that their captions agree on (`main_actions`).
        said: Pattern of what one of the captions must say; anything where it is empty.
        unsaid: Pattern of what none may say; nothing is barred where it is empty.
    """

    sentence: str
    action: str
    said: str = ""
    unsaid: str = ""


_ASIDE = (
    r"in place|on the spot|\b(stop|paus|halt|start|stand|sets? (out|off)|turn|circl|arc\b|around|spiral|zigzag|"
    r"diagonal|angle|side|left|right|back|across|bend|crouch|low|stiff|climb|jump|stair|seat|over|karate|lay)"
)
"""Words of those who do not simply go straight on."""
_PACE = r"|\b(slow|fast|quick|brisk|hurr|rapid|sprint|sneak|power|strid)"
ACTIONS = {
    "walk": Captured("a person walks forward", "walk", r"\bwalk", _ASIDE + _PACE),
    "run": Captured("a person runs forward", "run", r"\b(run|jog)", _ASIDE + _PACE),
    "slow walk": Captured("a person walks slowly", "walk", r"\bslow", _ASIDE),
    "jump": Captured("a person jumps", "jump"),
    "kick": Captured("a person kicks", "kick"),
    "punch": Captured("a person punches", "punch"),
    "wave": Captured("a person waves with the right hand", "wave"),
    "squat": Captured("a person squats", "squat"),
}
"""What trembling is compared in, and, of the first three, speed."""
GAITS = ("walk", "run", "slow walk")


def captured_clips(data: Path, wanted: Mapping[str, Captured]) -> dict[str, list[HandleMotion]]:
    """Captured motions of people for each name: held-out ones, and training ones where there are fewer than 8.

    Args:
        data: Folder that `bunraku data motions` wrote.
        wanted: What to look for, by name.

    Raises:
        FormatError: The index or a clip is missing or damaged.
    """
    rows: dict[str, dict[str, list[tuple[str, int, int]]]] = {name: {} for name in wanted}
    for clip, entry in load_index(data).items():
        if any(entry.get(key) for key in ("species", "character", "action")):
            continue
        whole = [{"start": 0, "stop": entry.get("frames", 0), "texts": entry.get("texts") or []}]
        for part in entry.get("stretches", whole):
            if "fault" in part or not part["texts"] or part["stop"] - part["start"] < SHORTEST:
                continue
            actions, words = main_actions(part["texts"]), " ".join(part["texts"])
            for name, what in wanted.items():
                barred = what.unsaid and re.search(what.unsaid, words, re.IGNORECASE)
                if actions == (what.action,) and re.search(what.said, words, re.IGNORECASE) and not barred:
                    split = entry.get("split", "train")
                    rows[name].setdefault(split, []).append((clip, int(part["start"]), int(part["stop"])))
    found = {}
    for name, own in rows.items():
        chosen = own.get("test", []) + own.get("val", [])
        if len(chosen) < ENOUGH:
            chosen = chosen + own.get("train", [])
        found[name] = [load_clip(data / f"{clip}.npz").take(slice(start, stop)) for clip, start, stop in chosen]
    return found


def viewer_figures(config: MotionEvalConfig, quick: bool, report: Report) -> dict[str, Any]:
    """All figures of `VIEWER_BARS`, and tables by action.

    Returns:
        By key; a figure that could not be measured is None. Tables: "side_accuracy_by_action",
        "speed_by_action" and "jitter_by_action".

    Raises:
        FormatError: The data are missing or damaged.
        WeightsError: The weights are missing or broken.
    """
    from bunraku.generation.generate import generate_motions
    from bunraku.language.parse import clauses_of

    how: dict[str, Any] = {
        "steps": config.steps, "guidance": config.guidance, "checkpoint": config.checkpoint,
        "candidates": config.best_of, "examples": config.examples, "classifier_guidance": config.classifier_guidance,
    }  # fmt: skip

    def make(wanted: Sequence[tuple[str, float]]) -> list[HandleMotion]:
        found: list[HandleMotion] = []
        for first in range(0, len(wanted), BATCH):
            scripts = [clauses_of([part]) for part in wanted[first : first + BATCH]]
            seeds = [config.seed + first + number for number in range(len(scripts))]
            found += generate_motions(scripts, seeds=seeds, **how)
        return found

    blocks: dict[str, Callable[[], dict[str, Any]]] = {
        "turns": lambda: _turns(make, 6 if quick else 20),
        "waves": lambda: _waves(make, 6 if quick else 20),
        "sides": lambda: _sides(make, 2 if quick else 5),
        "like captured": lambda: _like_captured(make, config.data, 4 if quick else 10),
        "ground": lambda: _ground(make, 2 if quick else 6),
        "a minute": lambda: _minute(make, config, 3),
    }
    result: dict[str, Any] = {}
    for number, (name, block) in enumerate(blocks.items()):
        report(f"viewer: {name}", number / len(blocks))
        result |= block()
    report("viewer", 1.0)
    return result


def _turns(make: Make, seeds: int) -> dict[str, Any]:
    """Turns of 2.5 to 4 s."""
    lengths = np.linspace(2.5, 4, seeds).tolist()
    requests = [(f"a person turns {way}", seconds) for way in (*SIDES, "around") for seconds in lengths]
    left, right, around = np.reshape([viewer.turned(motion) for motion in make(requests)], (3, seeds))
    sided, around = np.concatenate([left, -right]), np.abs(around)
    return {
        "turn_side_degrees": float(np.median(sided)),
        "turn_side_share": float(((sided >= 45) & (sided <= 150)).mean()),
        "turn_around_degrees": float(np.median(around)),
        "turn_around_share": float(((around >= 130) & (around <= 230)).mean()),
    }


def _waves(make: Make, seeds: int) -> dict[str, Any]:
    """Waves of 4 s; a hand that is never raised waves 0 cm, and says nothing of how fast."""
    found = []
    for side in SIDES:
        motions = make([(f"a person waves with the {side} hand", 4.0)] * seeds)
        found += [viewer.wave_of(motion, side) for motion in motions]
    fast = [wave.fast for wave in found if wave is not None]
    return {
        "wave_range_cm": float(np.median([0.0 if wave is None else wave.range for wave in found])),
        "wave_above_5hz": float(np.median(fast)) if fast else None,
    }


def _sides(make: Make, seeds: int) -> dict[str, Any]:
    """Whether the requested side does it, of two phrasings and both sides, 3 s each."""
    table = {}
    for action, phrasings in SIDE_PROMPTS.items():
        requests = [(phrasing, side) for phrasing in phrasings for side in SIDES for _ in range(seeds)]
        motions = make([(phrasing.format(side), 3.0) for phrasing, side in requests])
        did = viewer.DOERS[action]
        table[action] = float(
            np.mean([did(motion) == side for motion, (_, side) in zip(motions, requests, strict=True)])
        )
    return {"side_accuracy": float(np.mean(list(table.values()))), "side_accuracy_by_action": table}


def _like_captured(make: Make, data: Path, seeds: int) -> dict[str, Any]:
    """Speed and trembling of motions of 5 s over those of captured clips of the same words."""
    captured = captured_clips(data, ACTIONS)
    speeds, tremors = {}, {}
    for name, what in ACTIONS.items():
        motions, real = make([(what.sentence, 5.0)] * seeds), captured[name]
        tremors[name] = _compared(viewer.tremor, motions, real)
        if name in GAITS:
            speeds[name] = _compared(viewer.moving_speed, motions, real)
    ratios = [row["ratio"] for row in speeds.values() if row["ratio"] is not None]
    rough = [row["ratio"] for row in tremors.values() if row["ratio"] is not None]
    return {
        "speed_over_captured": max(ratios, key=lambda ratio: abs(np.log(max(ratio, 1e-9))), default=None),
        "jitter_over_real": max(rough, default=None), "speed_by_action": speeds, "jitter_by_action": tremors,
    }  # fmt: skip


def _compared(
    measure: Callable[[HandleMotion], float], motions: Sequence[HandleMotion], real: Sequence[HandleMotion]
) -> dict[str, Any]:
    """Means of generated and captured motions and their ratio, None without captured ones."""
    made = float(np.mean([measure(motion) for motion in motions]))
    shown = float(np.mean([measure(motion) for motion in real])) if real else None
    return {"generated": made, "captured": shown, "ratio": made / shown if shown else None, "clips": len(real)}


def _ground(make: Make, seeds: int) -> dict[str, Any]:
    """What floats while a person stands, and whether sitting down ends seated; 4 s each."""
    standing = make([(sentence, 4.0) for sentence in STANDING for _ in range(seeds)])
    sitting = make([(sentence, 4.0) for sentence in SITTING for _ in range(seeds)])
    return {
        "float_share": float(np.concatenate([viewer.floating(motion) for motion in standing]).mean()),
        "sitting_ok": float(np.mean([viewer.sits(motion) for motion in sitting])),
    }


def _minute(make: Make, config: MotionEvalConfig, seeds: int) -> dict[str, Any]:
    """Walks of a minute: the largest change of heading, and the largest jump at a seam, of all seeds."""
    from bunraku.generation.networks import Networks
    from bunraku.generation.sampler import plan_windows

    model = Networks(config.checkpoint).denoiser
    motions = make([(WALK, 60.0)] * seeds)
    seams = plan_windows([len(motions[0])], model.config.frames).seams
    return {
        "heading_drift_60s": max(viewer.heading_drift(motion) for motion in motions),
        "seam_jump": max(measure_seams(motion, seams).displacement for motion in motions),
    }
