"""What a process that has worked before takes, in turns with another checkout:

    python benchmarks/warm.py [--tree ../other] [--runs 3] [-o outputs/warm.json]

Each turn is a process of its own that does each row twice and measures the second time. Printed are medians of the
turns in seconds of the processor, all threads together, and by the clock.

| row | meaning |
| --- | --- |
| animate, 20k | `bunraku.animate` of a sentence for 6 s on the sample person with 20,000 vertices |
| animate, 196 frames | the same for 9.8 s on the reference body with its own handles, three candidates |
| handles, 5k; 200k | `bunraku.rig` of the sample person with so many vertices |
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from stages import PROMPT, sized

HERE = Path(__file__).resolve()
SIZES = (5_000, 20_000, 200_000)


def turn(folder: Path) -> dict[str, tuple[float, float]]:
    """Seconds of the processor and of the clock of each row, in this process."""
    import bunraku
    from bunraku.core.body.reference import reference_body
    from bunraku.pipelines.animate import animate, rig

    small, middle, large = (bunraku.load_character(folder / f"{size}.glb") for size in SIZES)
    body = reference_body()
    rows: dict[str, Callable[[], object]] = {
        "animate, 20k": lambda: animate(middle, PROMPT, seconds=6.0, seed=1),
        "animate, 196 frames": lambda: animate(
            body.character(), PROMPT, seconds=9.8, seed=1, handles=body.handles, candidates=3
        ),
        "handles, 5k": lambda: rig(small),
        "handles, 200k": lambda: rig(large),
    }
    found = {}
    for name, row in rows.items():
        row()
        used, clock = time.process_time(), time.perf_counter()
        row()
        found[name] = time.process_time() - used, time.perf_counter() - clock
    return found


def main() -> None:
    """Take turns and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tree", type=Path, help="another checkout, which takes turns with this one")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--turn", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.turn:
        print(json.dumps(turn(args.turn)))
        return
    trees = [HERE.parents[1]] + ([args.tree.resolve()] if args.tree else [])
    found: dict[str, list[dict[str, list[float]]]] = {str(tree): [] for tree in trees}
    with tempfile.TemporaryDirectory() as name:
        for size in SIZES:
            sized(size, Path(name) / f"{size}.glb")
        for _ in range(args.runs):
            for tree in trees:
                threads = os.environ.get("OMP_NUM_THREADS", "1")
                environment = {**os.environ, "PYTHONPATH": str(tree / "src"), "OMP_NUM_THREADS": threads}
                words = [sys.executable, str(HERE), "--turn", name]
                done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
                if done.returncode:
                    raise SystemExit(done.stderr[-2000:])
                found[str(tree)].append(json.loads(done.stdout.splitlines()[-1]))
    print("| " + " | ".join(["row", *(f"{tree.name}: processor | clock" for tree in trees)]) + " |")
    print("| --- |" + " ---: | ---: |" * len(trees))
    for row in found[str(trees[0])][0]:
        cells = [
            f"{statistics.median(one[row][which] for one in found[str(tree)]):.2f}"
            for tree in trees
            for which in (0, 1)
        ]
        print(f"| {row} | " + " | ".join(cells) + " |")
    if args.output:
        args.output.parent.mkdir(parents=True, exist_ok=True)
        args.output.write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
