"""Written FBX files as Blender, ufbx (the reader inside Godot) and three.js read them: joints, weights, poses.

Each is optional. Blender and three.js are found as `viewers.py` finds them; ufbx needs a C compiler and the folder with
`ufbx.c` and `ufbx.h` that BUNRAKU_UFBX names.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from viewers import HERE, SECONDS, THREE, blender_command, blender_missing, three_missing

__all__ = ["READERS", "Clip", "Shown"]

UFBX = os.environ.get("BUNRAKU_UFBX", "")


@dataclass(frozen=True)
class Clip:
    """A clip at some times.

    Args:
        name: As the reader names it.
        heads: Where the joints are [m], shape (T, J, 3).
        turns: Their world rotations, shape (T, J, 3, 3).
        posed: Where the vertices are [m], shape (T, V, 3).
    """

    name: str
    heads: np.ndarray
    turns: np.ndarray
    posed: np.ndarray


@dataclass(frozen=True)
class Shown:
    """A file as a reader has it, in metres and glTF's axes.

    Args:
        names: Of the joints.
        parents: The parent of each, "" for none.
        heads: Where they rest [m], shape (J, 3).
        rest: Vertices [m], shape (V, 3).
        weights: Shape (V, J).
        clips: The clips.
    """

    names: list[str]
    parents: list[str]
    heads: np.ndarray
    rest: np.ndarray
    weights: np.ndarray
    clips: list[Clip]


def ufbx_missing() -> str:
    """Why ufbx cannot be asked, "" where it can."""
    if shutil.which("cc") is None:
        return "needs a C compiler"
    return "" if UFBX and Path(UFBX, "ufbx.c").is_file() else "needs BUNRAKU_UFBX, a folder with ufbx.c and ufbx.h"


def blender_shows(path: Path, times: Sequence[float]) -> Shown:
    """A file in Blender at times [s]."""
    with tempfile.TemporaryDirectory() as folder:
        job = {"fbx": str(path.resolve()), "times": list(map(float, times)), "out": f"{folder}/out.npz"}
        Path(folder, "jobs.json").write_text(json.dumps([job]))
        _run([*blender_command(), str(HERE / "fbx_blender.py"), "--", f"{folder}/jobs.json"])
        with np.load(f"{folder}/out.npz") as found:
            clips = [
                Clip(str(name).split("|")[-2] if "|" in name else str(name), found[f"heads_{k}"], found[f"turns_{k}"],
                     found[f"posed_{k}"])
                for k, name in enumerate(found["clips"])
            ]  # fmt: skip
            names, parents = found["names"].tolist(), found["parents"].tolist()
            return Shown(names, parents, found["heads"], found["rest"], found["weights"], clips)


@cache
def _ufbx_program() -> tuple[str, tempfile.TemporaryDirectory[str]]:
    """The program, made once, and the folder that it goes with."""
    folder = tempfile.TemporaryDirectory()
    program = f"{folder.name}/fbx_ufbx"
    _run(["cc", "-O1", "-I", UFBX, str(HERE / "fbx_ufbx.c"), f"{UFBX}/ufbx.c", "-lm", "-o", program])
    return program, folder


def ufbx_shows(path: Path, times: Sequence[float]) -> Shown:
    """A file in ufbx at times [s]."""
    with tempfile.TemporaryDirectory() as folder:
        program, _ = _ufbx_program()
        said = _run([program, str(path), f"{folder}/out", *(repr(float(time)) for time in times)])
        return _numbers(json.loads(said), np.fromfile(f"{folder}/out", "<f8"), len(times))


def three_shows(path: Path, times: Sequence[float]) -> Shown:
    """A file in three.js at times [s]; its vertices are the corners of the triangles."""
    with tempfile.TemporaryDirectory() as folder:
        job = {"fbx": str(path.resolve()), "times": list(map(float, times)), "out": f"{folder}/out"}
        _run(["node", str(HERE / "three_fbx.mjs"), str(THREE)], json.dumps([job]))
        said = json.loads(Path(folder, "out.json").read_text())
        return _numbers(said, np.fromfile(f"{folder}/out", "<f8"), len(times))


READERS = {
    "Blender": (blender_shows, blender_missing),
    "ufbx": (ufbx_shows, ufbx_missing),
    "three.js": (three_shows, three_missing),
}


def _numbers(said: dict[str, Any], values: np.ndarray, times: int) -> Shown:
    joints, vertices = len(said["joints"]), said["vertices"]
    at = 0

    def take(*shape: int) -> np.ndarray:
        nonlocal at
        count = int(np.prod(shape))
        at += count
        return values[at - count : at].reshape(shape)

    names = [name for name, _ in said["joints"]]
    parents = [names[parent] if parent >= 0 else "" for _, parent in said["joints"]]
    heads, rest, shares = take(joints, 3), take(vertices, 3), take(said["weights"], 3)
    weights = np.zeros((vertices, joints))
    np.add.at(weights, (shares[:, 0].astype(int), shares[:, 1].astype(int)), shares[:, 2])
    clips = []
    for name in said["clips"]:
        every = [(take(joints, 3), take(joints, 3, 3), take(vertices, 3)) for _ in range(times)]
        clips.append(Clip(name, *(np.array(part) for part in zip(*every, strict=True))))
    return Shown(names, parents, heads, rest, weights, clips)


def _run(command: list[str], given: str = "") -> str:
    kept = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(command, input=given, capture_output=True, text=True, timeout=SECONDS, env=kept)
    if done.returncode:
        raise RuntimeError(f"{command[0]} failed: {(done.stderr or done.stdout).strip()[-2000:]}")
    return done.stdout
