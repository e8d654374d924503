"""Time a frame of learned apparel, stage by stage: a pose in, the places of all apparel vertices out.

    python benchmarks/apparel_frame.py [--seed 10012] [--frames 60] [--rounds 3] [--against OTHER/src]

A wardrobe character with about 2,000 apparel vertices dances. `--against` times the sources of another checkout in turn
with these, so that whatever else the machine does falls on both. For each stage the median of the frames and the tenth
percentile, which is nearly free of others' work, in milliseconds of the process' own time and of the clock.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

STAGES = ("features", "network", "safety", "carry", "safety of vertices", "frame")


def timed(call: Callable[..., Any], times: list[tuple[float, float]]) -> Callable[..., Any]:
    """The same function, which writes down how long it takes."""

    def run(*args: Any, **more: Any) -> Any:
        begin = time.process_time(), time.perf_counter()
        out = call(*args, **more)
        times.append((time.process_time() - begin[0], time.perf_counter() - begin[1]))
        return out

    return run


def measure(seed: int, frames: int) -> dict[str, Any]:
    """Times of all stages of all frames [s], and how large the character is."""
    import numpy as np

    from bunraku.apparel.body import UnifiedBody
    from bunraku.apparel.learned.player import ApparelPlayer
    from bunraku.apparel.physics.clothed_from_file import clothed_from_file
    from bunraku.pipelines.apparel import shipped_displacement
    from bunraku_lab.datasets.apparel.build import body_animation
    from bunraku_lab.synthetic.stock_motions import stock_motion
    from bunraku_lab.synthetic.wardrobe import wardrobe_character

    character = wardrobe_character(seed)
    body = UnifiedBody.of(character)
    poses = body.transforms(body_animation(body, stock_motion("dance", 4.0, 30.0))).astype(np.float32)
    player: Any = ApparelPlayer(clothed_from_file(character, body), shipped_displacement())
    player.start(poses[0])
    player.advance(poses[0])
    out: dict[str, list[tuple[float, float]]] = {stage: [] for stage in STAGES}
    player.features.advance = timed(player.features.advance, out["features"])
    player._moved = timed(player._moved, out["network"])
    player._carried = timed(player._carried, out["carry"])
    safety, vertices = player.safety, player.safety.vertices

    class Stage:
        share = safety.share
        vertices: Callable[..., Any]

        def __call__(self, *args: Any) -> Any:
            return first(*args)

    first = timed(safety.__call__, out["safety"])
    player.safety = Stage()
    player.safety.vertices = timed(vertices, out["safety of vertices"])
    advance = timed(player.advance, out["frame"])
    for pose in poses[1 : frames + 1]:
        advance(pose)
    return {"vertices": len(player.carrier.vertices), "nodes": len(player.nodes), "times": out}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=10012, help="of the character: 10012 has 1,967 apparel vertices")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--against", type=Path, help="the folder src of another checkout")
    parser.add_argument("--once", action="store_true", help="print times as JSON, for the others")
    args = parser.parse_args()
    if args.once:
        print(json.dumps(measure(args.seed, args.frames)))
        return
    import numpy as np

    here = Path(__file__).resolve().parents[1] / "src"
    trees = {"these": here} | ({"against": args.against.resolve()} if args.against else {})
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in trees}
    command = [sys.executable, __file__, "--once", "--seed", str(args.seed), "--frames", str(args.frames)]
    for _ in range(args.rounds):
        for name, tree in trees.items():
            done = subprocess.run(
                command, env=os.environ | {"PYTHONPATH": str(tree)}, capture_output=True, text=True, check=True
            )
            found[name].append(json.loads(done.stdout))
    first = found["these"][0]
    print(f"{first['vertices']:,} apparel vertices, {first['nodes']} nodes")
    print(f"{'ms':20}" + "".join(f"{name + ' ' + kind:>26}" for name in trees for kind in ("own time", "clock")))
    for stage in STAGES:
        line = f"{stage:20}"
        for name in trees:
            times = 1000 * np.array([pair for one in found[name] for pair in one["times"][stage]])
            for low, middle in np.percentile(times, [10, 50], axis=0).T:
                line += f"{middle:14.2f} (10 %: {low:5.2f})"
        print(line)


if __name__ == "__main__":
    main()
