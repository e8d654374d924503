"""Which denoiser is worth a long training? Variants trained alike from scratch and measured on the same windows, as a
Markdown table.

    python benchmarks/equal.py --data MOTIONS [--steps 1000] [--out runs/equal] [--only plain examples]

Each is trained by what `bunraku train diffusion` does, on people alone, from one seed, and goes on where it was
stopped. Then it makes one motion of each of 128 test windows, alone: without a critic, without starting from examples,
without a choice. R-Precision is over that of real motion; FID also over that of TapMo (MDM) after as many steps.

- plain: attention to the sentence
- examples: attention to two captured examples that are retrieved for the sentence, too
- convolution: a convolution over five tokens beside attention
- drawn: a tenth of the text tokens dropped, actions drawn nearly alike
- mdm: TapMo (MDM), the encoder-only denoiser

All of them keep averaged weights, which are what is measured.
"""

from __future__ import annotations

import argparse
import os
import shutil
from pathlib import Path
from typing import Any

VARIANTS: dict[str, dict[str, Any]] = {
    "plain": {},
    "examples": {"examples": 2},
    "convolution": {"convolution": 5},
    "drawn": {"drop_tokens": 0.1, "balance": 0.25, "most_drawn": 20.0},
    "mdm": {"preset": "mdm"},
}
PEOPLE = {"creatures": 0.0, "borrowed": 0.0, "cross": 0.0}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="what `bunraku data motions` wrote")
    parser.add_argument("--out", type=Path, default=Path("runs/equal"))
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--rate", type=float, default=6e-4)
    parser.add_argument("--warmup", type=int, default=60)
    parser.add_argument("--workers", type=int, default=0, help="processes that draw rows ahead")
    parser.add_argument("--device", help="'cuda', 'cpu'; CUDA where it is there")
    parser.add_argument("--pool", type=int, default=128, help="windows")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--sampled", type=int, default=8, help="steps of the sampler")
    parser.add_argument("--only", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    args = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # read when the libraries load, so before any import of them

    from bunraku_lab.evaluation.motion.table import MotionEvalConfig, evaluate_motion
    from bunraku_lab.training.diffusion.train import TrainingConfig, train_diffusion

    def trained(name: str) -> Path:
        out = args.out / name
        known = next(args.out.glob("*/captions.safetensors"), None)  # the sentences are the same, encoded once
        if known is not None and not (out / known.name).is_file():
            out.mkdir(parents=True, exist_ok=True)
            shutil.copy(known, out)
        settings = {**PEOPLE, **VARIANTS[name], "learning_rate": args.rate, "warmup": args.warmup, "seed": 0}
        return train_diffusion(
            TrainingConfig(
                data=args.data,
                out=out,
                minutes=None,
                steps=args.steps,
                batch=args.batch,
                workers=args.workers,
                device=args.device,
                **settings,
            )
        )

    rows = {}
    for name in args.only:
        result = evaluate_motion(
            MotionEvalConfig(
                data=args.data, checkpoint=trained(name), work=args.out / "motions", pool=args.pool,
                clips=min(100, args.pool), runs=args.runs, references=1000, repeats=0, steps=args.sampled,
            )
        )  # fmt: skip
        rows |= {"real": result["rows"]["real"], name: result["rows"]["tapmo"]}

    print(f"{args.steps:,} steps of {args.batch}\n")
    print("| | R-Precision top-1 | over real | FID | over MDM's |\n| --- | --- | --- | --- | --- |")
    for name, row in rows.items():
        top, fid = row["r_precision_1"], row["fid"]
        real, mdm = rows["real"]["r_precision_1"]["mean"], rows.get("mdm", {}).get("fid")
        ratios = ("", "") if name == "real" else (f"{top['mean'] / real:.2f}", _over(fid, mdm))
        print(f"| {name} | {_cell(top, 3)} | {ratios[0]} | {_cell(fid, 1)} | {ratios[1]} |")


def _cell(value: dict[str, float], digits: int) -> str:
    return f"{value['mean']:.{digits}f} ± {value['half']:.{digits}f}"


def _over(value: dict[str, float], base: dict[str, float] | None) -> str:
    return "" if base is None else f"{value['mean'] / base['mean']:.2f}"


if __name__ == "__main__":
    main()
