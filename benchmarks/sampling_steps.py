"""Quality against sampling steps: what fewer steps cost, as a Markdown table.

    python benchmarks/sampling_steps.py [--steps 5 10 15 20 30 50 100] [--frames 196] [--prompts FILE] [--reference
    1000]

Each row draws the same motions, from the same noise, with that many steps of the default solver. The reference is the
solver with 1,000 steps. Columns:

- distance: root of the mean squared distance to the reference, in network units, in which the features' deviation is
  about one
- handles: mean distance of the 29 handles' places in the root's frame from the reference's [mm]
- jerk: mean third difference of the handles' world positions [m/s^3], over the reference's
- spread: standard deviation of the features over frames, over the reference's; below 1, motion is lost
- FID: of the motions against the reference's, and against those of the ancestral sampler where `--ancestral` is given,
  by the extractor of `bunraku evaluate motion`, where its weights are there and there are at least 64 motions
- seconds: CPU seconds for a clip in a batch, and of a clip alone
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

PROMPTS = (
    "a person walks forward", "a person runs", "a person jumps", "a person waves with the right hand",
    "a person dances", "a person kicks",
    "a person walks backward", "a person sits down", "a person bows", "a person throws a ball", "a person turns around",
    "a person punches",
    "a person climbs stairs", "a person picks something up", "a person walks in a circle", "a person hops on one leg",
)  # fmt: skip
BATCH = 8


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, nargs="+", default=[5, 8, 10, 15, 20, 30, 50, 100])
    parser.add_argument("--frames", type=int, default=196)
    parser.add_argument("--prompts", type=Path, help="a text file with one prompt a line")
    parser.add_argument("--reference", type=int, default=1000, help="steps of the reference")
    parser.add_argument(
        "--ancestral", action="store_true", help="also a row for the ancestral sampler with 1,000 steps"
    )
    parser.add_argument("--guidance", type=float, default=2.5)
    parser.add_argument("--checkpoint", type=Path)
    parser.add_argument("--extractor", type=Path, help="weights of the feature extractor for FID")
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = str(args.threads)  # read when the libraries load, so before any import of them

    import numpy as np

    from bunraku.diffusion.features import FeatureStatistics, decode
    from bunraku.diffusion.generation.networks import load_generator
    from bunraku.diffusion.sampling.sampler import Solver, sample
    from bunraku.nn.threads import one_thread
    from bunraku_lab.evaluation.motion.seams import posed_positions

    model, encoder = load_generator(args.checkpoint)
    prompts = (
        [line.strip() for line in args.prompts.read_text().splitlines() if line.strip()]
        if args.prompts
        else list(PROMPTS)
    )
    statistics = FeatureStatistics(model.mean, model.std)
    frames = min(args.frames, model.config.frames)

    def draw(steps: int, method: str = "dpm") -> tuple[np.ndarray, float]:
        """Values (B, N, D) in network units, and CPU seconds a clip."""
        out, start = [], time.process_time()
        with one_thread():
            for first in range(0, len(prompts), BATCH):
                text = encoder.encode(prompts[first : first + BATCH])
                found = sample(model, text, frames, Solver(steps, guidance=args.guidance, method=method), seed=first)
                out.append(found.values)
        return np.concatenate(out), (time.process_time() - start) / len(prompts)

    def alone(steps: int) -> float:
        text, start = encoder.encode(prompts[:1]), time.process_time()
        with one_thread():
            sample(model, text, frames, Solver(steps, guidance=args.guidance))
        return time.process_time() - start

    def jerk(values: np.ndarray) -> float:
        parts = [posed_positions(decode(statistics.restore(row), model.config.fps)) for row in values]
        return (
            float(np.mean([np.linalg.norm(np.diff(part, n=3, axis=0), axis=-1).mean() for part in parts]))
            * model.config.fps**3
        )

    def apart(values: np.ndarray, others: np.ndarray) -> float:
        """Mean distance of the handles' local places [mm]."""
        pairs = [(statistics.restore(a), statistics.restore(b)) for a, b in zip(values, others, strict=True)]
        local = [[part[:, 10:].reshape(len(part), -1, 9)[..., :3] for part in pair] for pair in pairs]
        return 1000 * float(np.mean([np.linalg.norm(a - b, axis=-1).mean() for a, b in local]))

    def embedded(values: np.ndarray) -> np.ndarray | None:
        if len(values) < 64 or args.extractor is None:
            return None
        from bunraku.diffusion.inference.extractor import embed_motions, load_extractor

        return np.asarray(embed_motions(load_extractor(args.extractor), [statistics.restore(row) for row in values]))

    sample(model, encoder.encode(prompts[:1]), frames, Solver(1))  # warm
    wanted, slow = draw(args.reference)
    vectors, reference_jerk = embedded(wanted), jerk(wanted)
    ancestral = draw(1000, "ddpm") if args.ancestral else None
    ancestral_vectors = embedded(ancestral[0]) if ancestral else None

    def distance(ours: np.ndarray | None, theirs: np.ndarray | None) -> str:
        if ours is None or theirs is None:
            return "-"
        from bunraku_lab.evaluation.motion.metrics import fid

        return f"{fid(ours, theirs):.3f}"

    print(
        f"{len(prompts)} prompts, {frames} frames, guidance {args.guidance:g}, {args.threads} threads, load "
        f"{os.getloadavg()[0]:.1f}\n"
    )
    print(
        "| steps | distance | handles [mm] | jerk | spread | FID to reference | FID to ancestral | seconds in a batch "
        "| seconds alone |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")

    def row(name: str, values: np.ndarray, batch: float, single: float | None) -> None:
        found = embedded(values)
        print(
            f"| {name} | {float(np.sqrt(np.mean((values - wanted) ** 2))):.3f} | {apart(values, wanted):.1f} | "
            f"{jerk(values) / reference_jerk:.2f} "
            f"| {float(values.std(axis=1).mean() / wanted.std(axis=1).mean()):.3f} | {distance(found, vectors)} "
            f"| {distance(found, ancestral_vectors)} | {batch:.2f} | {'-' if single is None else f'{single:.2f}'} |",
            flush=True,
        )

    for steps in args.steps:
        row(str(steps), *draw(steps), alone(steps))
    row(f"{args.reference} (reference)", wanted, slow, None)
    if ancestral:
        row("1000, ancestral", *ancestral, None)


if __name__ == "__main__":
    main()
