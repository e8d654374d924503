"""Reading a BVH of two minutes at 120 frames a second with 31 joints, against the packages `bvh` and `bvhio` on the
same file.

    pip install bvh bvhio
    python benchmarks/bvh.py [--seconds 120] [--fps 120] [--joints 31] [--packages DIR]

| reader | what is timed |
| --- | --- |
| bunraku | `load_motion`: rotation matrices, offsets and the path in metres, checked |
| numpy | the numbers alone, `numpy.loadtxt` after the header |
| bvh | `Bvh(text)` and its frames as floats: no rotations yet |
| bvhio | `readAsBvh`: positions and quaternions of every joint |

Best of three runs for the first two, one run for the others, in seconds.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.files import write_bvh
from bunraku.pipelines.to_reference import load_motion


def made_up(frames: int, joints: int, fps: float) -> SkeletalMotion:
    """A tree of bones that swing."""
    rng = np.random.default_rng(0)
    parents = [-1, *(max(joint - 1 - 4 * (joint % 5 == 0), 0) for joint in range(1, joints))]
    skeleton = Skeleton(tuple(f"joint{joint}" for joint in range(joints)), parents, rng.normal(0, 0.15, (joints, 3)))
    phase, speed = rng.uniform(0, 6, (1, joints, 3)), rng.uniform(0.3, 3, (1, joints, 1))
    swing = 1.2 * np.sin(np.arange(frames)[:, None, None] / fps * speed + phase)
    rotations = Rotation.from_rotvec(swing.reshape(-1, 3)).as_matrix().reshape(frames, joints, 3, 3)
    return SkeletalMotion(skeleton, rotations, np.cumsum(rng.normal(0, 0.01, (frames, 3)), axis=0), fps)


def best(work: Callable[[], object], runs: int) -> tuple[float, float]:
    """Least wall-clock and processor time of some runs [s]."""
    times = []
    for _ in range(runs):
        wall, processor = time.perf_counter(), time.process_time()
        work()
        times.append((time.perf_counter() - wall, time.process_time() - processor))
    return min(wall for wall, _ in times), min(processor for _, processor in times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--fps", type=float, default=120.0)
    parser.add_argument("--joints", type=int, default=31)
    parser.add_argument(
        "--packages", type=Path, help="folder that bvh and bvhio are installed in, when it is not the environment's"
    )
    args = parser.parse_args()
    sys.path = [
        folder for folder in sys.path if Path(folder).resolve() != Path(__file__).resolve().parent
    ]  # this file is no package bvh
    sys.path += [str(args.packages)] if args.packages else []
    with tempfile.TemporaryDirectory() as folder:
        path = write_bvh(made_up(int(args.seconds * args.fps), args.joints, args.fps), Path(folder) / "take.bvh")
        print(f"{int(args.seconds * args.fps)} frames x {args.joints} joints, {path.stat().st_size / 1e6:.1f} MB")
        rows: dict[str, tuple[float, float]] = {"bunraku": best(lambda: load_motion(path), 3)}
        lines = path.read_text().splitlines()
        header = next(number for number, line in enumerate(lines) if line.startswith("Frame Time")) + 1
        rows["numpy"] = best(lambda: np.loadtxt(path, skiprows=header), 3)
        for name in ("bvh", "bvhio"):
            try:
                package = importlib.import_module(name)
            except ImportError:
                print(f"{name} is not installed: pip install {name}")
                continue
            if name == "bvh":
                rows[name] = best(lambda package=package: np.array(package.Bvh(path.read_text()).frames, float), 1)
            else:
                rows[name] = best(lambda package=package: package.readAsBvh(str(path)), 1)
    for name, (wall, processor) in rows.items():
        print(
            f"{name:8s} {wall:8.3f} s wall  {processor:8.3f} s processor  {wall / rows['bunraku'][0]:8.1f} times "
            "bunraku's"
        )


if __name__ == "__main__":
    main()
