"""Predicted handles against rigs that others made: `python benchmarks/foreign_rigs.py FOLDER [--no-resolutions]`.

FOLDER holds rigged characters: GLB, FBX, or OBJ beside the rig texts of RigNet. For each: part purity, the pose error
over the height, and how much weights differ between 1,000, 5,000 and 50,000 vertices (`docs/evaluation.md`); then their
means. Nothing of the rigs is shown to the predictor.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from bunraku.anatomy.handles.predict import predict_handles
from bunraku.errors import BunrakuError
from bunraku_lab.evaluation.handles.measures import main_handles, part_purity
from bunraku_lab.evaluation.handles.subjects import Subject, find_files, load_subject, subject_name
from bunraku_lab.evaluation.handles.table import pose_errors, resolution_differences


def measured(one: Subject, resolutions: bool) -> list[float]:
    """Part purity, pose error and the difference across resolutions of one character; NaN for what does not apply."""
    weights = predict_handles(one.character).weights[one.surface]
    purity = part_purity(main_handles(weights), one.truth.weights[one.surface])
    error = pose_errors(one, weights, baselines=False, seed=0)["pose_error"]
    across = resolution_differences(one, predict_handles).values() if resolutions else [np.nan]
    return [np.nan if purity is None else purity, error, float(np.mean(list(across)))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--no-resolutions", action="store_true")
    asked = parser.parse_args()
    rows = []
    print("| file | vertices | part purity | pose error | weights across resolutions |")
    print("| --- | --- | --- | --- | --- |")
    for path in find_files(asked.folder, everything=True):
        name = subject_name(asked.folder, path)
        try:
            one = load_subject(path, name)
            row = measured(one, not asked.no_resolutions)
        except BunrakuError as failure:
            print(f"| {name} | failed: {failure} | | | |", flush=True)
            continue
        rows.append(row)
        print(f"| {name} | {int(one.surface.sum())} | {row[0]:.1%} | {row[1]:.2%} | {row[2]:.3f} |", flush=True)
    if not rows:
        raise SystemExit(f"{asked.folder}: no rigged character in it could be measured")
    purity, error, across = np.nanmean(np.array(rows), axis=0)
    print(f"\n{len(rows)} files: part purity {purity:.1%}, pose error {error:.2%}, across resolutions {across:.3f}")


if __name__ == "__main__":
    main()
