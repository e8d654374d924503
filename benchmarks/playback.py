"""Is an answer something that lives, or an example played back? As a Markdown table.

    python benchmarks/playback.py [--seeds 4] [--candidates 3] [--sentences benchmarks/playback.txt]

Windows of a second are compared with all windows of the examples and gestures of the pack and with their mirror images:
the mean distance of the 22 joints, once both stand at one place and face one way. A window is played back where that is
under 3 cm, and an answer where that holds of half of its windows in which anything moves. Gestures are those of the
pack, as their keys say, without tempo and size of their own.

Then pairs of seeds of three sentences: the mean distance of the joints in all frames, placed by the first one.

The sentences are 36 of the action test and 12 of those that tell gestures, drawn by lot before anything was measured.
"""

from __future__ import annotations

import argparse
import os
from itertools import combinations
from pathlib import Path
from typing import Any

FRAMES, EVERY, HOP = 20, 5, 4
AT_ONCE = 8
NEAR = 0.03
"""Mean distance of joints with which a window is played back [m]."""
MOVES = 0.06
"""Mean speed of the joints, seen from the root, from which on a window moves [m/s]."""
PAIRS = ("sit down", "waves", "claps")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sentences", type=Path, default=Path(__file__).with_name("playback.txt"))
    parser.add_argument("--seeds", type=int, default=4, help="of each of the three sentences")
    parser.add_argument("--most", type=int, default=48, help="sentences at the most, evenly from the list")
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--candidates", type=int, default=3)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = str(args.threads)  # read when the libraries load, so before any import of them

    import numpy as np

    from bunraku.core.body.layout import JOINT_NAMES
    from bunraku.generation.features import decode
    from bunraku.generation.generate import generate_motions
    from bunraku.generation.pack import load_examples
    from bunraku.language.parse import parse
    from bunraku_lab.evaluation.motion.metrics import posed_positions

    def joints(motion: Any) -> Any:
        return posed_positions(motion)[:, :22].astype(np.float32)

    def placed(positions: Any, frame: int = 0) -> Any:
        """Positions (..., N, 22, 3) with the pelvis of one frame over the origin and its hips along x."""
        across = positions[..., frame, 1, :] - positions[..., frame, 2, :]
        angle = np.arctan2(-across[..., 2], across[..., 0])
        cosine, sine, zero, one = np.cos(angle), np.sin(angle), 0 * angle, 0 * angle + 1
        turn = np.stack([cosine, zero, -sine, zero, one, zero, sine, zero, cosine], axis=-1)
        turn = turn.reshape(*angle.shape, 1, 3, 3).astype(np.float32)
        moved = positions - positions[..., frame, :1, :][..., None, :, :] * np.array([1, 0, 1], np.float32)
        return moved @ np.swapaxes(turn, -1, -2)

    def windows(positions: Any, hop: int) -> Any:
        """Windows (W, 20, 22, 3) of a motion, placed by their middle frame."""
        if len(positions) < FRAMES:
            return np.zeros((0, FRAMES, 22, 3), np.float32)
        rows = np.arange(0, len(positions) - FRAMES + 1, hop)[:, None] + np.arange(FRAMES)
        return placed(positions[rows], FRAMES // 2).astype(np.float32)

    other = [name.replace("left", "?").replace("right", "left").replace("?", "right") for name in JOINT_NAMES]
    swapped = [JOINT_NAMES.index(name) for name in other]

    pack = load_examples()
    assert pack is not None
    bank, names = [], []
    for index, example in enumerate(pack.examples):
        if example.texts:
            own = joints(decode(pack.features(index)))
            for way in (own, own[:, swapped] * np.array([-1, 1, 1], np.float32)):
                found = windows(way, HOP // 2)[:, ::EVERY]
                bank.append(found)
                names += [index] * len(found)
    known, owners = np.concatenate(bank), np.array(names)
    flat = known.reshape(len(known), -1)
    size = (flat**2).sum(axis=1)

    def nearest(window: Any) -> tuple[float, int]:
        part = window[::EVERY]
        # the mean distance is at most the root of the mean square, so the nearest by that are enough to look at
        square = size - 2 * flat @ part.reshape(-1)
        some = np.argpartition(square, 64)[:64]
        away = np.linalg.norm(known[some] - part, axis=-1).mean(axis=(1, 2))
        best = int(away.argmin())
        return float(away[best]), int(owners[some[best]])

    def generated(prompts: list[str], seeds: list[int]) -> list[Any]:
        scripts = [parse(prompt, args.seconds, force=True).clauses for prompt in prompts]
        return [joints(one) for one in generate_motions(scripts, seeds=seeds, candidates=args.candidates)]

    lines = args.sentences.read_text(encoding="utf-8").split("\n")[:-1]
    sentences = lines[:: max(1, len(lines) // args.most)][: args.most]
    played, shares = 0, []
    print(
        "| sentence | windows played back | median distance [cm] | mostly of |\n| --- | --- | --- | --- |", flush=True
    )
    for start in range(0, len(sentences), AT_ONCE):
        some = sentences[start : start + AT_ONCE]
        for prompt, motion in zip(some, generated(some, list(range(start, start + len(some)))), strict=True):
            near = []
            for window in windows(motion, HOP):
                relative = window - window[:, :1]
                if np.linalg.norm(np.diff(relative, axis=0), axis=-1).mean() * 20 > MOVES:
                    near.append(nearest(window))
            away = np.array([distance for distance, _ in near])
            share = float((away < NEAR).mean()) if len(away) else 0.0
            played += share >= 0.5
            shares.append(np.median(away) if len(away) else np.nan)
            of = pack.examples[near[int(away.argmin())][1]].name if len(away) else ""
            print(f"| {prompt} | {100 * share:.0f} % | {100 * shares[-1]:.1f} | {of} |", flush=True)
    print(f"\nplayed back: {played} of {len(sentences)}, {100 * played / len(sentences):.0f} %")
    print(f"median distance: {100 * np.nanmedian(shares):.1f} cm\n")
    print("| sentence | pairs of seeds differ by, median [cm] | least |\n| --- | --- | --- |", flush=True)
    for prompt in PAIRS if args.seeds > 1 else ():
        motions = [placed(one) for one in generated([prompt] * args.seeds, list(range(args.seeds)))]
        apart = [np.linalg.norm(one - two, axis=-1).mean() for one, two in combinations(motions, 2)]
        print(f"| {prompt} | {100 * np.median(apart):.1f} | {100 * min(apart):.1f} |", flush=True)


if __name__ == "__main__":
    main()
