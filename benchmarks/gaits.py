"""Do bodies on four legs swing left and right legs alike, and in turn? As a Markdown table.

    python benchmarks/gaits.py CHARACTERS [--seeds 3] [--candidates 3] [--prompt "walks forward"]

The twelve four-legged characters of the archive walk. A leg's swing is the angle between where it meets the body and
its foot, forward and back along the heading, between the 5th and the 95th percentile of the frames. Columns: the left
leg's swing over the right one's, fore and hind, and how far the right leg is behind the left one, in cycles (a half
where they take turns). The bar is 0.8 to 1.25.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.legs import Leg
from bunraku.core.animation import Animation, RigAnimation
from bunraku.files import load_character
from bunraku.language.parse import parse
from bunraku.pipelines.animator import Animator
from bunraku.pipelines.requests import Request, Sampling
from bunraku.retarget.fit import Stages

ANIMALS = (
    "Alpaca", "Bull", "Cow", "Deer", "Donkey", "Fox", "Horse", "Horse_White", "Husky", "ShibaInu", "Stag", "Wolf",
)  # fmt: skip
FOLDER = "quaternius/animals_pack"
BAR = (0.8, 1.25)

LOW_PERCENTILE, HIGH_PERCENTILE = 5, 95
"""Percentiles between which a leg swings."""
NEAR = 24
"""Vertices around a joint that tell where it is."""


@dataclass(frozen=True)
class Pair:
    """A left and a right leg.

    Args:
        left: Through which angle the left one swings [degrees].
        right: The same of the right one.
        phase: How far the right one is behind the left one, in cycles, 0 to 1.
    """

    left: float
    right: float
    phase: float

    @property
    def ratio(self) -> float:
        """The left one's swing over the right one's."""
        return self.left / max(self.right, 1e-9)


def pairs_of(legs: list[Leg]) -> list[tuple[Leg, Leg]]:
    """Legs of the left and of the right side of a body that faces +Z that meet it side by side, the foremost first."""
    left, found = sorted((leg for leg in legs if leg.joints[0][0] > 0), key=lambda leg: -leg.joints[0][2]), []
    right = [leg for leg in legs if leg.joints[0][0] <= 0]
    for one in left:
        if right:
            other = min(right, key=lambda leg: abs(leg.joints[0][2] - one.joints[0][2]))
            right = [leg for leg in right if leg is not other]
            found.append((one, other))
    return found


def gait_of(animation: Animation | RigAnimation, anatomy: Anatomy) -> list[Pair]:
    """The pairs of legs of a body, the foremost first."""
    character = animation.character
    whole = Anatomy(character, anatomy.handles, character, anatomy.handles)
    vertices = animation.vertices().astype(np.float64)
    middle = vertices.mean(axis=1)
    way = (middle[-1] - middle[0]) * [1, 0, 1]
    ahead = way / max(float(np.linalg.norm(way)), 1e-9) if np.linalg.norm(way) > 0.1 * character.height else [0, 0, 1.0]
    pairs = []
    for pair in pairs_of(whole.legs):
        angles = []
        for leg in pair:
            near = np.argsort(np.linalg.norm(character.vertices - leg.joints[0], axis=1))[:NEAR]
            down = vertices[:, leg.sole].mean(axis=1) - vertices[:, near].mean(axis=1)
            angles.append(np.degrees(np.arctan2(down @ ahead, -down[:, 1])))
        swings = [float(np.ptp(np.percentile(angle, [LOW_PERCENTILE, HIGH_PERCENTILE]))) for angle in angles]
        pairs.append(Pair(swings[0], swings[1], _behind(*angles)))
    return pairs


def _behind(left: np.ndarray, right: np.ndarray) -> float:
    """How far one signal is behind another in cycles of the strongest frequency they share."""
    window = np.hanning(len(left))
    spectra = [np.fft.rfft((one - one.mean()) * window, 4 * len(one)) for one in (left, right)]
    shared = np.abs(spectra[0]) * np.abs(spectra[1])
    peak = int(shared[4:].argmax()) + 4
    return float((np.angle(spectra[0][peak]) - np.angle(spectra[1][peak])) / (2 * np.pi) % 1.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("characters", type=Path, help="folder of the archive's characters")
    parser.add_argument("--animals", nargs="*", default=ANIMALS)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--candidates", type=int, default=3)
    parser.add_argument("--prompt", default="walks forward")
    parser.add_argument("--without", nargs="*", default=[], help="stages that are left out")
    args = parser.parse_args()
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
