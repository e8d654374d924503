"""How chains swing by their files, beside those of the wardrobe: limits, springs, damping and mass by kind.

    python benchmarks/apparel_manners.py FILES ... [--first SEED] [--count N]

FILES are PMX, PMD and VRM files with physics (apparel_files.md). All characters count alike, however many chains they
have.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from bunraku.apparel.clothed import FREE
from bunraku.files import load_character
from bunraku_lab.evaluation.apparel.chains import FileChain, chains_from_file
from bunraku_lab.synthetic.wardrobe import wardrobe_character

FACTS = (
    "links",
    "length [% of the height]",
    "limit [degrees]",
    "all links [degrees]",
    "stiffness",
    "damping",
    "mass [kg]",
)


def _facts(chain: FileChain) -> tuple[float, ...]:
    whole = np.degrees(min(sum(chain.limits), FREE))
    return (chain.links, 100 * chain.length, float(np.degrees(chain.limit)), float(whole), chain.stiffness,
            chain.damping, chain.mass)  # fmt: skip


def _weights(chains: Sequence[FileChain]) -> np.ndarray:
    """All characters count alike, however many chains they have, shape (C,)."""
    counts: dict[str, int] = {}
    for chain in chains:
        counts[chain.file] = counts.get(chain.file, 0) + 1
    return np.array([1 / counts[chain.file] for chain in chains])


def _quantiles(values: np.ndarray, weights: np.ndarray, shares: Sequence[float]) -> np.ndarray:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order]) / weights.sum()
    return np.asarray(values[order][np.minimum(np.searchsorted(total, shares), len(values) - 1)])


def file_chain_table(groups: Mapping[str, Sequence[FileChain]]) -> str:
    """Lines for each kind of the 10th, 50th and 90th percentile of each fact in each group, all characters alike."""
    kinds = sorted({chain.kind for chains in groups.values() for chain in chains})
    lines = []
    for kind in (None, *kinds):
        some = {name: [chain for chain in chains if kind in (None, chain.kind)] for name, chains in groups.items()}
        if not all(some.values()):
            continue
        heads = (f"{name}: {len(own)} chains of {len({one.file for one in own})}" for name, own in some.items())
        lines.append(f"{kind or 'all'} ({'; '.join(heads)})")
        for column, fact in enumerate(FACTS):
            cells = []
            for own in some.values():
                values = np.array([_facts(chain)[column] for chain in own], float)
                cells.append("".join(f"{value:9.3g}" for value in _quantiles(values, _weights(own), (0.1, 0.5, 0.9))))
            lines.append(f"  {fact:<26}" + "  |".join(cells))
        tests = {
            "first link locked [%]": lambda chain: chain.locked,
            "without springs [%]": lambda chain: chain.stiffness <= 0,
        }
        for label, test in tests.items():
            shares = [100 * float(_weights(own) @ [test(one) for one in own] / _weights(own).sum())
                      for own in some.values()]  # fmt: skip
            lines.append(f"  {label:<26}" + "  |".join(f"{'':9}{share:9.3g}{'':9}" for share in shares))
    return "\n".join(lines)


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


if __name__ == "__main__":
    main()
