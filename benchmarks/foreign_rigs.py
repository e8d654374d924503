"""Predicted handles against rigs that others made: `python benchmarks/foreign_rigs.py FOLDER [--no-resolutions]`.

FOLDER holds rigged characters: GLB, FBX, or OBJ beside the rig texts of RigNet. For each: part purity, the pose error
over the height, and how much weights differ between 1,000, 5,000 and 50,000 vertices (`docs/evaluation.md`); then their
means. Nothing of the rigs is shown to the predictor.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import numpy as np

from bunraku.anatomy.handles.predict import predict_handles
from bunraku.core.character import Character, Rig, top_influences
from bunraku.errors import BunrakuError
from bunraku.files import load_character
from bunraku_lab.evaluation.handles.measures import main_handles, part_purity
from bunraku_lab.evaluation.handles.subjects import Subject, subject, subject_name
from bunraku_lab.evaluation.handles.table import pose_errors, resolution_differences


def rig_text(mesh: Path) -> Path | None:
    """The rig text of RigNet that belongs to an OBJ, None where there is none."""
    beside = mesh.with_name(re.sub("_(remesh|ori)$", "", mesh.stem) + "_rig.txt")
    apart = mesh.parent.parent / f"rig_info{mesh.parent.name.removeprefix('obj')}" / f"{mesh.stem}.txt"
    return next((path for path in (beside, apart) if path.is_file()), None)


def rigged_by_text(mesh: Path, text: Path) -> Character:
    """An OBJ with the rig of lines "joints NAME X Y Z", "hier PARENT CHILD" and "skin VERTEX NAME SHARE ..."."""
    character = load_character(mesh, unit="m")
    places: dict[str, list[float]] = {}
    above: dict[str, str] = {}
    skin: dict[int, list[str]] = {}
    for kind, *words in (line.split() for line in text.read_text().splitlines() if line.strip()):
        if kind == "joints":
            places[words[0]] = [float(word) for word in words[1:4]]
        elif kind == "hier":
            above[words[1]] = words[0]
        elif kind == "skin":
            skin[int(words[0])] = words[1:]
    names = tuple(places)
    weights = np.zeros((len(character.vertices), len(names)))
    for vertex, words in skin.items():
        for name, share in zip(words[::2], words[1::2], strict=True):
            weights[vertex, names.index(name)] = float(share)
    transforms = np.tile(np.eye(4), (len(names), 1, 1))
    transforms[:, :3, 3] = list(places.values())
    parents = np.array([names.index(above[name]) if name in above else -1 for name in names])
    rig = Rig(names, parents, transforms, *top_influences(weights, 4))
    return Character(character.name, character.vertices, character.faces, rig, character.colors)


def found_files(folder: Path) -> list[Path]:
    """Files that may hold rigged characters."""
    files = (path for path in folder.rglob("*") if path.suffix.lower() in (".glb", ".fbx", ".obj"))
    return sorted(path for path in files if path.suffix.lower() != ".obj" or rig_text(path) is not None)


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
    for path in found_files(asked.folder):
        name = subject_name(asked.folder, path)
        try:
            text = rig_text(path) if path.suffix.lower() == ".obj" else None
            one = subject(load_character(path) if text is None else rigged_by_text(path, text), name, path)
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
