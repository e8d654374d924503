"""Write FBX through Blender, which is optional: our GLB goes to a Blender without a window, and its FBX comes back.

FBX has no open specification for writing, and programs differ in what they accept; what Blender writes they all read.
Blender is run as a process of its own, so none of its libraries are loaded here.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING

from bunraku.core.resample import checked_fps, resample
from bunraku.errors import BunrakuError, OptionError
from bunraku.formats.files import check_output_folder, writing
from bunraku.formats.gltf.write import write_animation

if TYPE_CHECKING:
    from bunraku.core.animation import Animation

__all__ = ["BLENDER", "BLENDER_PYTHON", "blender_command", "check_available", "write_fbx"]

BLENDER, BLENDER_PYTHON = "BUNRAKU_BLENDER", "BUNRAKU_BLENDER_PYTHON"
"""Environment variables: the Blender to run, and a Python that has Blender as its module `bpy`."""

SECONDS = 600.0
SCALES = {"cm": "FBX_SCALE_NONE", "m": "FBX_SCALE_ALL"}


def blender_command() -> list[str]:
    """How Blender runs a Python file, up to the file's name.

    The Blender that BUNRAKU_BLENDER names, or `blender` on the path, or the Python with `bpy` that
    BUNRAKU_BLENDER_PYTHON names.

    Raises:
        BunrakuError: There is none, or a variable names no program.
    """
    for variable in (BLENDER, BLENDER_PYTHON):
        if os.environ.get(variable) and shutil.which(os.environ[variable]) is None:
            raise BunrakuError(
                f"{variable} names {os.environ[variable]}, which is no program that can be run; correct or remove it"
            )
    blender = shutil.which(os.environ.get(BLENDER) or "blender")
    if blender is not None and (os.environ.get(BLENDER) or not os.environ.get(BLENDER_PYTHON)):
        return [blender, "--background", "--factory-startup", "--python-exit-code", "1", "--python"]
    if os.environ.get(BLENDER_PYTHON):
        return [str(shutil.which(os.environ[BLENDER_PYTHON]))]
    raise BunrakuError(
        "writing FBX needs Blender; install it from blender.org so that `blender` is on the path, or name it with the "
        "variable"
        f" {BLENDER}, or name a Python that has the package bpy with {BLENDER_PYTHON}"
    )


def check_available() -> None:
    """Raise BunrakuError unless there is a Blender."""
    blender_command()


def write_fbx(
    animation: Animation,
    path: Path,
    *,
    fps: float | None = None,
    name: str | None = None,
    up: str = "+y",
    unit: str = "cm",
    timeout: float = SECONDS,
) -> Path:
    """Write an animation as FBX.

    Args:
        animation: The animation.
        path: The file.
        fps: Frames a second [1/s]; those of the motion by default.
        name: The clip's name; the file's by default.
        up: The axis that is up in the file, "+y" or "+z".
        unit: "cm", as most FBX files have it, or "m".
        timeout: Seconds that Blender may take.

    Returns:
        The file that was written.

    Raises:
        BunrakuError: There is no Blender, or it fails or takes too long.
        FormatError: The file cannot be written.
        OptionError: An option makes no sense.
    """
    if up not in ("+y", "+z"):
        raise OptionError(f"up in an FBX file is +y or +z, not {up}")
    if unit not in SCALES:
        raise OptionError(f"the unit of an FBX file is {' or '.join(SCALES)}, not {unit}")
    command = blender_command()
    rate = checked_fps(fps, animation.motion.fps)
    check_output_folder(path)
    options = {
        "fps": rate, "frames": len(resample(animation.motion, rate)), "up": up, "scale": SCALES[unit],
        "name": str(name) if name else path.stem,
    }  # fmt: skip
    with (
        writing(path),
        tempfile.TemporaryDirectory(prefix=f".{path.stem[:100]}.", suffix=".tmp", dir=path.parent) as folder,
    ):
        source, target = Path(folder, "in.glb"), Path(folder, "out.fbx")
        write_animation(animation, source, fps=rate)
        with as_file(files("bunraku.formats.fbx").joinpath("blender_script.py")) as script:
            _run(
                [*command, str(script), "--", str(source.resolve()), str(target.resolve()), json.dumps(options)],
                target,
                path,
                timeout,
            )
        os.replace(target, path)
    return path


def _run(command: list[str], target: Path, path: Path, timeout: float) -> None:
    kept = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}  # ours is another Python
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout,
            env=kept,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        raise BunrakuError(
            f"{path}: Blender took more than {timeout:g} s and was stopped; simplify the mesh or shorten the clip"
        ) from None
    except OSError as error:
        raise BunrakuError(
            f"{path}: {command[0]} cannot be run ({(error.strerror or str(error)).lower()}); correct {BLENDER}"
        ) from None
    if done.returncode or not target.is_file() or not target.stat().st_size:
        lines = [line.strip() for line in (done.stderr + "\n" + done.stdout).splitlines() if line.strip()]
        said = next((line for line in reversed(lines) if "Error" in line), lines[-1] if lines else "nothing")
        raise BunrakuError(f"{path}: Blender failed, saying {said[:200]!r}; try Blender 3.6 or later, or write a GLB")
