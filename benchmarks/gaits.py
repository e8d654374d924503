"""Do bodies on four legs swing left and right legs alike, and in turn? As a Markdown table.

    python benchmarks/gaits.py CHARACTERS [--seeds 3] [--candidates 3] [--prompt "walks forward"]

The twelve four-legged characters of the archive walk. A leg's swing is the angle between where it meets the body and
its foot, forward and back along the heading, between the 5th and the 95th percentile of the frames. Columns: the left
leg's swing over the right one's, fore and hind, and how far the right leg is behind the left one, in cycles (a half
where they take turns). The bar is 0.8 to 1.25.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

ANIMALS = (
    "Alpaca", "Bull", "Cow", "Deer", "Donkey", "Fox", "Horse", "Horse_White", "Husky", "ShibaInu", "Stag", "Wolf",
)  # fmt: skip
FOLDER = "quaternius/animals_pack"
BAR = (0.8, 1.25)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("characters", type=Path, help="folder of the archive's characters")
    parser.add_argument("--animals", nargs="*", default=ANIMALS)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--candidates", type=int, default=3)
    parser.add_argument("--prompt", default="walks forward")
    parser.add_argument("--without", nargs="*", default=[], help="stages that are left out")
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = str(args.threads)  # read when the libraries load, so before any import of them

    import numpy as np

    from bunraku.files import load_character
    from bunraku.language.parse import parse
    from bunraku.pipelines.animator import Animator
    from bunraku.pipelines.requests import Request, Sampling
    from bunraku.retarget.fit import Stages
    from bunraku_lab.evaluation.motion.viewer import gait_of

    animator = Animator.shipped()
    sentence = parse(args.prompt, args.seconds)
    stages = Stages(**{name.replace("-", "_"): False for name in args.without})
    print("| animal | seed | fore | hind | phase fore | phase hind | swing fore, hind [degrees] |")
    print("| --- | --- | --- | --- | --- | --- | --- |", flush=True)
    found: list[Any] = []
    for animal in args.animals:
        character = load_character(args.characters / FOLDER / f"{animal}.glb")
        requests = [
            Request(sentence, Sampling(seed=seed, candidates=args.candidates), stages=stages)
            for seed in range(args.seeds)
        ]
        body = animator.body(character, requests[0])
        for seed, made in enumerate(animator.each(body, requests)):
            pairs = gait_of(made, body.anatomy)
            found += pairs
            fore, hind = pairs[0], pairs[-1]
            print(
                f"| {animal} | {seed} | {fore.ratio:.2f} | {hind.ratio:.2f} | {fore.phase:.2f} | {hind.phase:.2f} "
                f"| {fore.left:.0f}/{fore.right:.0f}, {hind.left:.0f}/{hind.right:.0f} |",
                flush=True,
            )
    ratios = np.array([pair.ratio for pair in found])
    inside = (ratios >= BAR[0]) & (ratios <= BAR[1])
    print(f"\nfrom {ratios.min():.2f} to {ratios.max():.2f}")
    print(f"within {BAR[0]} to {BAR[1]}: {inside.sum()} of {len(ratios)}")


if __name__ == "__main__":
    main()
