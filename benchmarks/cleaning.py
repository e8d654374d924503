"""What each cleaning stage of fitting does: `python benchmarks/cleaning.py [--characters DIR] [--seconds 6] [-o
outputs/cleaning.json]`.

Every prompt is generated once with the shipped weights and fitted to the reference body and, where the folder of the
character archive is given, to seven of its characters: with all stages, with each of `smooth`, `feet` and `floor` left
out, and with none of them. Then the seconds that fitting takes for 10 s of motion, with and without the three stages.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import bunraku
from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.pipelines.animate import generate, rig
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.evaluation.motion.characters import CLEANING, stage_effects

PROMPTS = (
    "a person walks forward", "a person runs forward", "a person walks in a circle", "a person dances",
    "a person jumps forward",
    "a person kicks with the left leg", "a person sits down on the floor", "a person waves with the right hand",
    "a person does a squat",
    "a person sneaks forward",
)  # fmt: skip
CHARACTERS = (
    "kaykit/Knight", "quaternius2019/Female_Dress", "quaternius/modular_women/Witch", "valid/White_M_1_Busi",
    "quaternius2019/Goblin",
    "quaternius/animals_pack/ShibaInu", "quaternius/easy_enemies_pack/Spider",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--characters", type=Path)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    body = reference_body()
    characters: dict[str, tuple[Character, Handles]] = {"reference": (body.character(), body.handles)}
    for name in CHARACTERS if args.characters else ():
        character = bunraku.load_character(args.characters / f"{name}.glb")
        characters[Path(name).name] = character, rig(character)
    motions = [generate(prompt, seconds=args.seconds, seed=seed) for seed, prompt in enumerate(PROMPTS)]
    rows = stage_effects(motions, characters)
    print(
        f"{'character':14} {'without':20} slide  and swings  down   sunk %  deepest %  jitter   moved   [cm a frame "
        "at 1.7 m]"
    )
    for row in rows:
        print(
            f"{row['character']:14} {row['without']:20} {row['sliding']:5.2f} {row['sliding_all']:11.2f} "
            f"{row['contact_share']:5.2f}"
            f" {row['sunk']:8.3f} {row['deepest']:10.2f} {row['jitter']:7.2f} {row['moved']:7.2f}"
        )
    timed = {name: times(motions[0], *pair) for name, pair in characters.items()}
    for name, (vertices, all_stages, without) in timed.items():
        print(
            f"{name:14} {vertices:7d} vertices: 10 s of motion in {all_stages:.3f} s, without the three stages "
            f"{without:.3f} s"
        )
    if args.output:
        args.output.parent.mkdir(parents=True, exist_ok=True)
        args.output.write_text(json.dumps({"effects": rows, "seconds": timed}, indent=1))


def times(motion: HandleMotion, character: Character, handles: Handles) -> tuple[int, float, float]:
    """Vertices, and the seconds of the fastest of three fittings of 200 frames with and without the cleaning stages."""
    index = np.arange(200) % len(motion)
    parts = ("translations", "rotations", "root_translation", "root_rotation")
    motion = replace(motion, **{name: getattr(motion, name)[index] for name in parts})
    found = []
    for stages in (Stages(), Stages(**dict.fromkeys(CLEANING, False))):
        runs = []
        for _ in range(3):
            start = time.perf_counter()
            fit_motion(motion, Anatomy.of(character, handles), stages)
            runs.append(time.perf_counter() - start)
        found.append(min(runs))
    return len(character.vertices), *found


if __name__ == "__main__":
    main()
