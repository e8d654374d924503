"""How chains swing by their files, beside those of the wardrobe: limits, springs, damping and mass by kind.

    python benchmarks/apparel_manners.py FILES ... [--first SEED] [--count N]

FILES are PMX, PMD and VRM files with physics (apparel_files.md). All characters count alike, however many chains they
have. Then: how far guesses are off on a file that they were not fitted to, in factors of two.
"""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

import numpy as np

from bunraku.files import load_character
from bunraku_lab.evaluation.apparel.chains import chains_from_file, file_chain_table, kind_priors, prior_errors
from bunraku_lab.synthetic.wardrobe import wardrobe_character


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=60)
    asked = parser.parse_args()
    logging.disable(logging.WARNING)
    real = [chain for path in asked.files for chain in chains_from_file(load_character(path))]
    made = [chain for seed in range(asked.first, asked.first + asked.count)
            for chain in chains_from_file(wardrobe_character(seed))]  # fmt: skip
    print("10th, 50th and 90th percentile of files, and of the wardrobe")
    print(file_chain_table({"files": real, "wardrobe": made}))
    print("\nmedians of the files: limit [degrees], stiffness, damping")
    for kind, (limit, stiffness, damping) in kind_priors(real).items():
        print(f"  {kind or 'all':<8}{np.degrees(limit):8.1f}{stiffness:8.2f}{damping:8.3f}")
    print("\noff by, in factors of two, on a file left out: limit, stiffness, 1 - damping")
    for name, errors in prior_errors(real).items():
        print(f"  {name:<18}" + "".join(f"{error:7.2f}" for error in errors))


if __name__ == "__main__":
    main()
