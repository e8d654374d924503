"""Do takes turn, begin late or idle where nobody asked for it? One line a sentence, then the shares.

python benchmarks/no_turn.py [--sentences benchmarks/no_turn.txt] [--seed 0]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from bunraku.generation.generate import generate_motions
from bunraku.generation.verifier import Track
from bunraku.language.parse import parse

LATE, REST, TURN, LIVELY = 1.0, 1.5, 60.0, 0.4
"""Seconds within which a take begins, those that it may rest at an end, the degrees that it may turn, and the speed of
the body's points with which it has begun at the latest [m/s].
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sentences", type=Path, default=Path(__file__).with_name("no_turn.txt"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--candidates", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=6.0, help="of each take")
    args = parser.parse_args()
    lines = [line for line in args.sentences.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    turned, begun, filled = [], [], []
    for line in lines:
        text = line.lstrip("=_")
        clauses = parse(text, args.seconds, force=True).clauses
        (motion,) = generate_motions([clauses], seeds=[args.seed], candidates=args.candidates)
        track = Track.of(motion)
        angle = np.degrees(track.angle - track.angle[0])
        points = np.stack(list(track.points.values()), 1)
        speed = np.linalg.norm(np.gradient(points, axis=0), axis=-1).mean(1) * track.fps
        speed = np.convolve(speed, np.ones(5) / 5, "same")
        moving = np.flatnonzero(speed >= min(speed.max() / 2, LIVELY)) / track.fps
        lively = np.flatnonzero(speed >= speed.max() / 5) / track.fps
        rest = max(lively[0], len(track) / track.fps - lively[-1])
        turned.append(abs(angle[-1]) > TURN)
        if not line.startswith("="):
            begun.append(moving[0] <= LATE)
            if not line.startswith("_"):
                filled.append(rest < REST)
        print(f"{angle[-1]:6.0f} {np.ptp(angle):5.0f} {moving[0]:5.2f} {rest:5.2f} {line}", flush=True)
    for name, marks in (("turned", turned), ("begun within 1 s", begun), ("filled", filled)):
        print(f"{name}: {np.mean(marks):.1%} of {len(marks)}")


if __name__ == "__main__":
    main()
