"""Written GLBs as three.js, Blender and Godot show them: vertices at some times, to compare with Bunraku's own.

All are optional. three.js needs node and `npm install` in this folder (or BUNRAKU_THREE, a folder with
node_modules/three). Blender is the program that BUNRAKU_BLENDER names, or `blender` on the path, or the Python with the
package `bpy` that BUNRAKU_BLENDER_PYTHON names. Godot is the program that BUNRAKU_GODOT names, 4.4 or newer.
"""

from __future__ import annotations

import json
import os
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

__all__ = [
    "blender_command",
    "blender_missing",
    "blender_vertices",
    "godot_missing",
    "godot_vertices",
    "three_missing",
    "three_vertices",
]

HERE = Path(__file__).parent
THREE = Path(os.environ.get("BUNRAKU_THREE", HERE)) / "node_modules" / "three"
SECONDS = 600
_INTEGERS = {5121: "u1", 5123: "<u2", 5125: "<u4"}

Shots = Sequence[tuple[Path, Sequence[float]]]


def three_missing() -> str:
    """Why three.js cannot be asked, "" where it can."""
    if shutil.which("node") is None:
        return "needs node"
    return "" if THREE.is_dir() else "needs three.js: `npm install` in tools/check_viewers (or BUNRAKU_THREE)"


def blender_command() -> list[str]:
    """How Blender runs a Python file, up to the file's name; empty where there is none."""
    named, python = (os.environ.get(f"BUNRAKU_{name}") for name in ("BLENDER", "BLENDER_PYTHON"))
    blender = shutil.which(named or "blender")
    if blender is not None and (named or not python):
        return [blender, "--background", "--factory-startup", "--python-exit-code", "1", "--python"]
    found = shutil.which(python) if python else None
    return [found] if found else []


def blender_missing() -> str:
    """Why Blender cannot be asked, "" where it can."""
    return "" if blender_command() else "needs Blender on the path, or BUNRAKU_BLENDER or BUNRAKU_BLENDER_PYTHON"


def godot_missing() -> str:
    """Why Godot cannot be asked, "" where it can."""
    named = os.environ.get("BUNRAKU_GODOT")
    return "" if named and shutil.which(named) else "needs Godot 4.4, which BUNRAKU_GODOT names"


def three_vertices(shots: Shots, clip: int = 0) -> list[np.ndarray]:
    """Vertices of GLBs at times [s], one array for each file of shape (T, V, 3), in the order of the file's nodes.

    Args:
        shots: Files and times [s].
        clip: Which clip of the files is played.
    """
    with tempfile.TemporaryDirectory() as folder:
        jobs = [
            {"glb": str(Path(glb).resolve()), "times": list(map(float, times)), "out": f"{folder}/{k}", "clip": clip}
            for k, (glb, times) in enumerate(shots)
        ]
        _run(["node", str(HERE / "three_play.mjs"), str(THREE)], json.dumps(jobs))
        return [_three_order(Path(job["glb"]), Path(job["out"]), len(job["times"])) for job in jobs]


def blender_vertices(shots: Shots, fps: float, clip: int = 0) -> list[np.ndarray]:
    """The same of Blender, which drops vertices that no triangle uses: those are not numbers here.

    Args:
        shots: Files and times [s].
        fps: Frames a second of the scene; between frames Blender's turns are a little off the shortest way.
        clip: Which clip of the files is played.
    """
    return _played([*blender_command(), str(HERE / "blender_play.py")], _blender_order, shots, fps, clip)


def godot_vertices(shots: Shots, fps: float, clip: int = 0) -> list[np.ndarray]:
    """The same of Godot, whose reader leaves out vertices that no triangle uses: those are not numbers here.

    Args:
        shots: Files and times [s].
        fps: Frames a second at which Godot samples the clips as it reads them; the import's own is 30.
        clip: Which clip of the files is played.
    """
    command = [os.environ["BUNRAKU_GODOT"], "--headless", "--script", str(HERE / "godot_play.gd")]
    return _played(command, _godot_order, shots, fps, clip)


def _played(
    command: Sequence[str], order: Callable[[Path, Path, int], np.ndarray], shots: Shots, fps: float, clip: int
) -> list[np.ndarray]:
    """What a program's script writes of each file, with its vertices in the order of the file.

    Args:
        command: The program and its script, which takes a file of jobs.
        order: Puts what was written into the file's order, from the GLB, what was written, and the number of times.
        shots: Files and times [s].
        fps: Frames a second.
        clip: Which clip of the files is played.
    """
    with tempfile.TemporaryDirectory() as folder:
        jobs = [
            {
                "glb": str(Path(glb).resolve()),
                "times": list(map(float, times)),
                "fps": fps,
                "out": f"{folder}/{k}",
                "clip": clip,
            }
            for k, (glb, times) in enumerate(shots)
        ]
        Path(folder, "jobs.json").write_text(json.dumps(jobs))
        _run([*command, "--", f"{folder}/jobs.json"])
        return [order(Path(job["glb"]), Path(job["out"]), len(job["times"])) for job in jobs]


def _run(command: list[str], given: str = "") -> None:
    kept = {
        key: value for key, value in os.environ.items() if not key.startswith("PYTHON")
    }  # Blender's Python is another one
    done = subprocess.run(command, input=given, capture_output=True, text=True, timeout=SECONDS, env=kept)
    if done.returncode:
        raise RuntimeError(f"{command[0]} failed: {(done.stderr or done.stdout).strip()[-2000:]}")


def _meshes(glb: Path) -> tuple[dict, bytes, list[tuple[int, list[list[int]], int]]]:
    """The tree, the binary part, and for each node with a mesh: its primitives by the positions they share, with the
    number of these.
    """
    data = glb.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    tree = json.loads(data[20 : 20 + length])
    out = []
    for number, node in enumerate(tree["nodes"]):
        if "mesh" in node:
            groups: dict[int, list[int]] = {}
            for index, primitive in enumerate(tree["meshes"][node["mesh"]]["primitives"]):
                groups.setdefault(primitive["attributes"]["POSITION"], []).append(index)
            out += [(number, members, tree["accessors"][accessor]["count"]) for accessor, members in groups.items()]
    return tree, data[20 + length + 8 :], out


def _three_order(glb: Path, out: Path, times: int) -> np.ndarray:
    listed = json.loads(Path(f"{out}.json").read_text())
    starts = np.cumsum([0] + [entry["count"] for entry in listed])
    found = np.fromfile(out, "<f4").reshape(times, -1, 3)
    place = {
        (entry["node"], entry["primitive"]): found[:, start : start + entry["count"]]
        for entry, start in zip(listed, starts, strict=False)
    }
    return np.concatenate([place[node, members[0]] for node, members, _ in _meshes(glb)[2]], axis=1)


def _blender_order(glb: Path, out: Path, times: int) -> np.ndarray:
    listed = json.loads(Path(f"{out}.json").read_text())
    starts = np.cumsum([0] + [entry["count"] for entry in listed])
    found = np.fromfile(out, "<f4").reshape(times, -1, 3)
    place = {
        entry["node"]: found[:, start : start + entry["count"]] for entry, start in zip(listed, starts, strict=False)
    }
    tree, binary, meshes = _meshes(glb)
    parts = {(node, members[0]): np.full((times, count, 3), np.nan) for node, members, count in meshes}
    first = {(node, member): members[0] for node, members, _ in meshes for member in members}
    for node in dict.fromkeys(node for node, _, _ in meshes):
        start = 0
        for index, primitive in enumerate(tree["meshes"][tree["nodes"][node]["mesh"]]["primitives"]):
            used = _used(tree, binary, primitive)
            parts[node, first[node, index]][:, used] = place[node][:, start : start + len(used)]
            start += len(used)
        if start != place[node].shape[1]:
            raise RuntimeError(f"{glb}: Blender has {place[node].shape[1]} vertices of node {node}, the file {start}")
    return np.concatenate(list(parts.values()), axis=1)


def _used(tree: dict, binary: bytes, primitive: dict) -> np.ndarray:
    """Vertices of a primitive that its triangles use, in order: those that Blender has."""
    if "indices" not in primitive:
        return np.arange(tree["accessors"][primitive["attributes"]["POSITION"]]["count"])
    entry = tree["accessors"][primitive["indices"]]
    view = tree["bufferViews"][entry["bufferView"]]
    start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
    return np.unique(np.frombuffer(binary, _INTEGERS[entry["componentType"]], entry["count"], start))


def _godot_order(glb: Path, out: Path, times: int) -> np.ndarray:
    tree, binary, meshes = _meshes(glb)
    counts = [entry["count"] for entry in json.loads(Path(f"{out}.json").read_text())]
    found = np.fromfile(out, "<f4").reshape(times, -1, 3)
    starts = iter(np.cumsum([0, *counts]))
    parts = []
    for node, members, count in meshes:
        part = np.full((times, count, 3), np.nan)
        for member in members:
            primitive = tree["meshes"][tree["nodes"][node]["mesh"]]["primitives"][member]
            start, own = next(starts), counts.pop(0)
            used = np.arange(count) if own == count else _used(tree, binary, primitive)
            part[:, used] = found[:, start : start + own]
        parts.append(part)
    return np.concatenate(parts, axis=1)
