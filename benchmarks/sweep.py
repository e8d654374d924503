"""Animate every character of a folder and check what was written.

    python benchmarks/sweep.py CHARACTERS -o outputs/sweep [--prompt "a person walks forward"] [--limit 20] [--sheet]

For each file: the whole of `bunraku.animate` and `save`; the GLB played by an independent reading of the glTF rules
(`tests/files/gltf_player.py`) against the library's own vertices; vertex count and order, UVs, materials and images
against the source; and the Khronos validator where node and `npm install` in tests/files/validator are there. Ends
with status 1 when anything failed.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "files"))

from gltf_player import Player  # noqa: E402

import bunraku  # noqa: E402
from bunraku.core.animation import Animation  # noqa: E402

SUFFIXES = {".glb", ".gltf", ".vrm", ".obj", ".ply", ".stl"}
VALIDATOR = Path(os.environ.get("BUNRAKU_GLTF_VALIDATOR", ROOT / "tests/files/validator"))


def kept(path: Path, source: Path) -> str:
    """What of the source's content differs in the output, in words; empty where all is the same."""
    if source.suffix.lower() not in {".glb", ".vrm"}:
        return ""
    before, after = Player(source), Player(path)
    problems = []

    def contents(player: Player) -> tuple[list[bytes], list[int], int, int]:
        uvs, counts = [], []
        for number in range(len(player.nodes)):
            node = player.nodes[number]
            if "mesh" in node and (player is after or number in reachable):
                for primitive in player.tree["meshes"][node["mesh"]]["primitives"]:
                    attributes = primitive["attributes"]
                    counts.append(player.tree["accessors"][attributes["POSITION"]]["count"])
                    if "TEXCOORD_0" in attributes:
                        uvs.append(player.accessor(attributes["TEXCOORD_0"]).tobytes())
        return sorted(uvs), sorted(counts), len(player.tree.get("materials", [])), len(player.tree.get("images", []))

    reachable: set[int] = set()
    todo = list(before.tree["scenes"][before.tree.get("scene", 0)]["nodes"])
    while todo:
        number = todo.pop()
        reachable.add(number)
        todo.extend(before.nodes[number].get("children", []))
    for what, one, two in zip(
        ("UVs", "vertex counts", "materials", "images"), contents(before), contents(after), strict=True
    ):
        if one != two and not (what in ("materials", "images") and two <= one):  # materials that no mesh uses may go
            problems.append(f"{what} differ")
    return ", ".join(problems)


def playback_error(path: Path, animation: Animation) -> float:
    """Mean distance between played and own vertices over the height, the worst of three times."""
    worst = 0.0
    player = Player(path)
    for frame in np.linspace(0, len(animation.motion) - 1, 3).astype(int):
        own = animation.vertices([int(frame)])[0]
        played = player.vertices(frame / animation.motion.fps)
        if len(played) == len(own):
            worst = max(worst, float(np.linalg.norm(played - own, axis=1).mean()) / animation.character.height)
        else:
            worst = float("nan")
    return worst


def validate(paths: list[Path]) -> dict[str, int] | None:
    """Errors that the Khronos validator finds, by file; None where it is not installed."""
    if not (VALIDATOR / "node_modules" / "gltf-validator").is_dir():
        return None
    command = ["node", str(ROOT / "tests/files/validator/validate.js"), *map(str, paths)]
    output = subprocess.run(
        command, capture_output=True, check=True, env={**os.environ, "NODE_PATH": str(VALIDATOR / "node_modules")}
    ).stdout
    return {Path(name).name: report["errors"] for name, report in json.loads(output).items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("characters", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("outputs/sweep"))
    parser.add_argument("--prompt", default="a person walks forward")
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--limit", type=int)
    parser.add_argument("--sheet", action="store_true", help="also draw a picture of each, half way through")
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    files = sorted(path for path in args.characters.rglob("*") if path.suffix.lower() in SUFFIXES)[: args.limit]
    rows, pictures, labels = [], [], []
    for number, file in enumerate(files):
        name = "-".join(file.relative_to(args.characters).with_suffix("").parts)
        out = args.output / f"{name}.glb"
        row = {"file": name, "vertices": 0, "seconds": 0.0, "playback": float("nan"), "problem": "", "errors": ""}
        try:
            start = time.perf_counter()
            character = bunraku.load_character(file)
            animation = bunraku.animate(character, args.prompt, seconds=args.seconds)
            animation.save(out)
            row |= {"vertices": len(character.vertices), "seconds": round(time.perf_counter() - start, 2)}
            row |= {"playback": playback_error(out, animation), "problem": kept(out, file)}
            if args.sheet:
                from bunraku.render import render_animation

                pictures.append(
                    next(iter(render_animation(animation, size=(240, 280), times=np.array([0.55 * args.seconds]))))
                )
                labels.append(file.stem)
        except Exception as error:
            row["problem"] = f"{type(error).__name__}: {error}"
        rows.append(row)
        print(
            f"{number + 1}/{len(files)} {name}: {row['vertices']} vertices, {row['seconds']} s, playback "
            f"{row['playback']:.2e} {row['problem']}",
            flush=True,
        )
    found = validate(
        [args.output / f"{row['file']}.glb" for row in rows if not row["problem"].startswith(("Format", "Character"))]
    )
    for row in rows:
        row["errors"] = "" if found is None else found.get(f"{row['file']}.glb", "not written")
    with open(args.output / "sweep.csv", "w", newline="") as handle:
        writer = csv.DictWriter(handle, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    if pictures:
        from bunraku.render import contact_sheet

        for page in range(0, len(pictures), 40):
            contact_sheet(
                pictures[page : page + 40],
                labels[page : page + 40],
                args.output / f"sheet-{page // 40 + 1}.png",
                columns=8,
                limit=None,
            )
    bad = [row for row in rows if row["problem"] or row["errors"] not in ("", 0) or not row["playback"] < 1e-3]
    print(
        f"{len(rows)} characters, {len(rows) - len(bad)} without a fault, worst playback "
        f"{max(r['playback'] for r in rows):.2e} of the height"
    )
    print("validator: " + ("not installed" if found is None else f"{sum(found.values())} errors in {len(found)} files"))
    for row in bad:
        print(f"FAULT {row['file']}: {row['problem']} {row['errors']} {row['playback']}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
