"""Are GLBs in three.js, Blender and Godot what Bunraku says they are? Vertices at three times, for characters with a
motion.

python tools/check_viewers/check.py CHARACTER.glb ... --motion walk.bvh

Each character is written three times: its rig moved, its 30 handles moved, and vertices that also move on their own (a
wave that grows with the height, as morph targets). The table has the largest and the mean distance from `vertices()`,
in per cent of the height.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from viewers import blender_missing, blender_vertices, godot_missing, godot_vertices, three_missing, three_vertices

import bunraku
from bunraku.core.animation import PointAnimation
from bunraku.errors import BunrakuError
from bunraku.pipelines.animator import Animator
from bunraku.pipelines.requests import TransferRequest
from bunraku.pipelines.to_reference import load_motion, reference_motion
from bunraku.pipelines.transfer import fitted_transfer
from bunraku.retarget.rig_parts import is_humanoid_rig

SECONDS = 3.0
BAR = 0.1  # per cent of the height


def waving(animation: Any) -> PointAnimation:
    """The animation and a wave of all vertices across, from nothing at the feet to 3 % of the height at the top."""
    posed, character = animation.vertices(), animation.character
    share = ((character.vertices - character.vertices.min(0)) / character.height)[:, 1]
    phase = np.arange(len(posed))[:, None] * 0.4 + 6 * share[None]
    offsets = (
        0.03 * character.height * share[None, :, None] * np.stack([np.sin(phase), 0 * phase, np.cos(phase)], axis=-1)
    )
    return PointAnimation.of_vertices(animation, posed + offsets)


def written(path: Path, motion: Any, folder: Path) -> Iterator[tuple[str, Path, np.ndarray, list[int], float, float]]:
    """The GLBs of a character: what is moved, the file, its vertices (3, V, 3), their frames, frames a second, and the
    height.
    """
    character = bunraku.load_character(path)
    handles = bunraku.rig(character)
    made: dict[str, Any] = {}
    if is_humanoid_rig(character):
        made["rig"] = fitted_transfer(Animator.shipped(), character, motion, TransferRequest("rig"))
    made["handles"] = fitted_transfer(
        Animator.shipped(), character, motion, TransferRequest("handles", handles=handles)
    )
    made["points"] = waving(made["handles"])
    for kind, animation in made.items():
        frames = [len(motion) // 4, len(motion) // 2, len(motion) - 1]
        file = animation.save(folder / f"{path.stem}-{kind}-{len(list(folder.iterdir()))}.glb")
        known = animation.vertices(frames)
        if kind == "rig" and path.suffix.lower() == ".vrm" and b'"VRM"' in file.read_bytes():
            known = known * [-1, 1, -1]  # avatars of VRM 0.x face -Z in their files, and a file that stays one does too
        yield kind, file, known, frames, motion.fps, character.height


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("characters", nargs="+", type=Path)
    parser.add_argument("--motion", type=Path, required=True)
    arguments = parser.parse_args()
    asked = {"three.js": three_missing(), "Blender": blender_missing(), "Godot": godot_missing()}
    for name, reason in asked.items():
        if reason:
            print(f"{name} is left out: {reason}")
    motion = reference_motion(load_motion(arguments.motion))
    motion = motion.take(slice(0, round(SECONDS * motion.fps)))
    with tempfile.TemporaryDirectory() as folder:
        made = []
        for path in arguments.characters:
            try:
                made += [(path, *entry) for entry in written(path, motion, Path(folder))]
            except BunrakuError as error:
                print(f"{path}: {error}")
        shots = [(file, np.array(frames) / fps) for _, _, file, _, frames, fps, _ in made]
        found = {}
        if not asked["three.js"]:
            found["three.js"] = three_vertices(shots)
        if not asked["Blender"]:
            found["Blender"] = blender_vertices(shots, motion.fps)
        if not asked["Godot"]:
            found["Godot"] = godot_vertices(shots, motion.fps)
    print(
        f"{'character':<28} {'moved':<8} {'vertices':>8}"
        + "".join(f"  {name + ' largest':>16} {'mean':>8}" for name in found)
    )
    worst = dict.fromkeys(found, 0.0)
    for number, (path, kind, _, known, _, _, height) in enumerate(made):
        line = f"{path.stem[:28]:<28} {kind:<8} {known.shape[1]:>8}"
        for name, shown in found.items():
            gap = 100 * np.linalg.norm(shown[number] - known, axis=-1) / height
            worst[name] = max(worst[name], float(np.nanmax(gap)))
            line += f"  {np.nanmax(gap):>15.5f}% {np.nanmean(gap):>7.5f}%"
        print(line)
    for name, value in worst.items():
        print(f"{name}: {value:.5f} % of the height at most, {'within' if value <= BAR else 'NOT within'} {BAR} %")


if __name__ == "__main__":
    main()
