"""What becomes of files as users have them: `python benchmarks/foreign_files.py FOLDER [--use measure|fresh|fresh2]
[--walks] [--pictures FOLDER]`, or `... FOLDER --unlisted` for the walks of any meshes, stood up as they are taken to
stand.

FOLDER holds the files of `foreign_files.json`, each under its name there: `git cat-file blob BLOB > NAME` in a clone of
its repository. For each: how it is taken to stand, how sure that is, and whether it is right. Then the shares: right as
the file comes; wrong and nothing said of it; right and doubted. With `--walks`, of the file stood up as the list has
it: how far edges change their length in "walks forward", mean over edges and frames, of their length at rest. With
`--pictures`, a strip of frames of each such walk.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.anatomy.handles.orientation import SURE, resolve_axes, upright
from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.graph import unique_edges
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.errors import BunrakuError
from bunraku.files import load_character, rotated
from bunraku.pipelines.animator import Animator
from bunraku.pipelines.requests import Request, Sampling
from bunraku_lab.evaluation.handles.measures import CHUNK, SHORT, STRIDE

LIST = Path(__file__).with_suffix(".json")
FRAMES = 6
MOST = 20_000  # edges that an error is the mean of


def stood(character: Character, row: dict[str, Any]) -> tuple[str, bool, bool]:
    """How a file is taken to stand in words, whether that is right, and whether something is said of it."""
    found = resolve_axes(character)
    taken = found.up, found.front
    right = taken[0] == row["up"] and taken[1] in row["front"]
    assert found.guess is not None
    sure = found.guess.probability(*taken)
    return f"{taken[0]} {taken[1]} {100 * sure:.0f} %", right, sure < SURE


def edge_error(character: Character, handles: Handles, motion: HandleMotion) -> float:
    """How far edges are from their length at rest, of that length: the mean of |l / l_rest - 1| over edges and frames.

    Edges shorter than 0.1 % of the height are not looked at, and of more than 20,000 as many, evenly chosen.
    """
    edges = unique_edges(character.faces, len(character.vertices))
    rest = character.vertices.astype(np.float64)
    lengths = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    edges = edges[lengths > SHORT * character.height]
    if not len(edges):
        return 0.0
    edges = edges[np.unique(np.linspace(0, len(edges) - 1, min(len(edges), MOST)).astype(int))]
    used, index = np.unique(edges, return_inverse=True)
    first, second = index.reshape(-1, 2).T
    length = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    transforms = motion.transforms(handles.positions)[::STRIDE]
    vertices, weights, total = character.vertices[used], handles.weights[used], 0.0
    for start in range(0, len(transforms), CHUNK):
        posed = skin(vertices, weights, transforms[start : start + CHUNK])
        changed = np.linalg.norm(posed[:, first] - posed[:, second], axis=-1) / length - 1
        total += float(np.abs(changed).mean(axis=1).sum())
    return total / len(transforms)


def walk(character: Character, row: dict[str, Any], animator: Animator, pictures: Path | None) -> float:
    """The edge error of a walk on 30 handles; a strip of its frames is drawn where a folder for it is given."""
    character = rotated(character, row["up"], row["front"][0]) if row["front"] else upright(character)
    request = Request("walks forward", Sampling(3.0, 1, candidates=1), rig="handles")
    animation = animator(character, request)
    assert isinstance(animation, Animation)
    if pictures is not None:
        from PIL import Image

        from bunraku.render.frames import render_animation

        times = np.linspace(0.3, 2.8, FRAMES)
        strip = np.concatenate(list(render_animation(animation, size=(200, 220), times=times)), axis=1)
        Image.fromarray(strip).save(pictures / f"{row['name']}.png")
    return edge_error(animation.character, animation.handles, animation.motion)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--use", choices=("measure", "fresh", "fresh2", "prior"), default="measure")
    parser.add_argument("--walks", action="store_true")
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--unlisted", action="store_true")
    asked = parser.parse_args()
    animator = Animator.shipped()
    if asked.unlisted:
        meshes = sorted(some for some in asked.folder.iterdir() if some.is_file())
        rows = [{"name": some.stem, "front": []} for some in meshes]
        found = []
        for some, row in zip(meshes, rows, strict=True):
            found.append(walk(load_character(some, unit="m"), row, animator, asked.pictures))
            print(f"| {some.name} | {100 * found[-1]:.1f} % |", flush=True)
        print(f"edge error: mean {100 * np.mean(found):.2f} %, median {100 * np.median(found):.2f} %")
        return
    results, errors = [], []
    print("| file | kind | taken | | edge error |")
    print("| --- | --- | --- | --- | --- |")
    for row in json.loads(LIST.read_text()):
        if row["use"] != asked.use:
            continue
        try:
            character = load_character(asked.folder / row["name"], unit="m")
            taken, right, told = stood(character, row)
            error = walk(character, row, animator, asked.pictures) if asked.walks else None
        except BunrakuError as failure:
            print(f"| {row['name']} | {row['kind']} | failed: {failure} | | |", flush=True)
            continue
        results.append((right, told))
        errors += [] if error is None else [error]
        said = ("right" if right else "wrong") + (", said" if told else "")
        print(
            f"| {row['name']} | {row['kind']} | {taken} | {said} | {'' if error is None else f'{100 * error:.1f} %'} |",
            flush=True,
        )
    if not results:
        raise SystemExit(f"{asked.folder}: none of the files of {LIST.name} is here")
    rights, tolds = np.array(results).T
    print(
        f"\n{len(results)} files: right {100 * rights.mean():.1f} %; wrong and not said {(~rights & ~tolds).sum()}; ",
        end="",
    )
    print(f"right and doubted {100 * (rights & tolds).sum() / max(rights.sum(), 1):.1f} % of the right ones")
    if errors:
        print(f"edge error: mean {100 * np.mean(errors):.2f} %, median {100 * np.median(errors):.2f} %")


if __name__ == "__main__":
    main()
