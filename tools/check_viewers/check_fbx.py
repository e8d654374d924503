"""Are FBX files in Blender, ufbx and three.js what Bunraku says they are? Joints, weights and poses of characters with
four clips each.

python tools/check_viewers/check_fbx.py --lot tools/check_viewers/fbx_lot.txt --folder data/raw

Each character is written twice: on its own rig where it has one, and on its 30 handles, with four clips of 2 seconds
that turn every joint by other angles. The table has the largest distances over the height, and of weights the largest
difference. `--sentences` makes the clips by `bunraku.animate` instead.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from fbx_viewers import READERS, Shown

import bunraku
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import HandleMotion
from bunraku.errors import BunrakuError
from bunraku.files import save_clips
from bunraku.files.fbx.write_meshes import meshes_of
from bunraku.files.fbx.write_motion import Bones

CLIPS, FPS, FRAMES = ("idle", "walk", "Run fast", "Attack"), 30.0, 60
TIMES = np.array([0, 7, 23, 42, 59]) / FPS
BAR = 1e-4  # of the height
SENTENCES = ("idle", "walks forward", "runs", "waves")


def turning(count: int, seed: int) -> np.ndarray:
    """Rotations of joints that sweep through up to 2.5 rad about axes of their own, shape (N, J, 3, 3)."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    phase, reach = rng.uniform(0, 6, count), rng.uniform(0.2, 2.5, count)
    swing = reach * np.sin(np.linspace(0, 6, FRAMES)[:, None] + phase)
    return np.asarray(matrix_from_axis_angle(swing[..., None] * axes))


def clips_on_rig(character: Character) -> dict[str, Any]:
    """Four clips of the character's own rig."""
    assert character.rig is not None
    joints, out = len(character.rig.names), {}
    for seed, name in enumerate(CLIPS):
        moved = np.zeros((FRAMES, joints, 3))
        roots = character.rig.parents < 0
        moved[:, roots] = np.linspace(0, seed, FRAMES)[:, None, None] * [0.1, 0.02, 0.4] * character.height
        out[name] = RigAnimation(character, turning(joints, seed), moved, FPS)
    return out


def clips_on_handles(character: Character, handles: Handles) -> dict[str, Any]:
    """Four clips of its handles."""
    count, out = len(handles.positions), {}
    for seed, name in enumerate(CLIPS):
        turns = turning(count, seed)
        moved = (
            0.03
            * character.height
            * np.sin(np.linspace(0, 5, FRAMES)[:, None, None] + np.arange(3 * count).reshape(-1, 3))
        )
        moved[:, 0], turns[:, 0] = 0, np.eye(3)
        root = np.linspace(0, seed, FRAMES)[:, None] * [0.1, 0.02, 0.4] * character.height
        motion = HandleMotion(moved, turns, root, turning(1, seed + 50)[:, 0], FPS)
        out[name] = Animation(character, handles, motion)
    return out


def gaps(shown: Shown, clips: dict[str, Any], corners: bool) -> dict[str, float]:
    """How far what a reader shows is from what Bunraku says: over the height, but for weights."""
    first = next(iter(clips.values()))
    character = first.character
    bones = Bones.of_rig(character.rig) if isinstance(first, RigAnimation) else Bones.of_handles(first.handles)
    _, meshes = meshes_of(character)
    meshes = sorted(meshes, key=lambda mesh: mesh.name)
    index = np.concatenate([mesh.index[mesh.faces].reshape(-1) if corners else mesh.index for mesh in meshes])
    place = {name: number for number, name in enumerate(bones.names)}
    plain = {"".join(sign for sign in name.replace(" ", "_") if sign not in "[].:/"): name for name in bones.names}
    names = [name if name in place else plain[name] for name in shown.names]
    own = np.array([place[name] for name in names])
    if len(own) != len(bones.names):
        raise RuntimeError(f"{len(own)} joints of {len(bones.names)}")
    tree = [bones.names[parent] if parent >= 0 else "" for parent in bones.parents[own]]
    for name, said, known in zip(names, shown.parents, tree, strict=True):
        if said and plain.get(said, said) != known:
            raise RuntimeError(f"{name} hangs on {said} and not on {known}")
    dense = np.zeros((len(character.vertices), len(bones.names)))
    np.add.at(dense, (np.arange(len(dense))[:, None], bones.indices), bones.weights)
    height = character.height
    distance = lambda one, other: float(np.linalg.norm(one - other, axis=-1).max()) / height  # noqa: E731
    out = {
        "rest": distance(shown.rest, character.vertices[index]),
        "joints": distance(shown.heads, bones.positions[own]),
        "weights": float(np.abs(shown.weights - dense[index][:, own]).max()),
        "posed": 0.0, "moved": 0.0, "turned": 0.0,
    }  # fmt: skip
    if sorted(clip.name for clip in shown.clips) != sorted(clips):
        raise RuntimeError(f"clips {[clip.name for clip in shown.clips]}")
    for clip in shown.clips:
        known = clips[clip.name]
        at = np.round(TIMES * known.fps).astype(int)
        track = bones.rig_track(known) if isinstance(known, RigAnimation) else bones.handle_track(known)
        turns, heads = world(bones, track.rotations[at], track.translations[at])
        four = (
            known if isinstance(known, RigAnimation) else Animation(known.character, known.handles.top(4), known.motion)
        )
        posed = four.vertices(at)[:, index]
        out["posed"] = max(out["posed"], distance(clip.posed, posed))
        out["moved"] = max(out["moved"], distance(clip.heads, heads[:, own]))
        out["turned"] = max(out["turned"], float(np.abs(clip.turns - turns[:, own]).max()))
    return out


def world(bones: Bones, turns: np.ndarray, heads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forward kinematics."""
    turns, heads = turns.copy(), heads.copy()
    done: set[int] = set()

    def place(bone: int) -> None:
        parent = int(bones.parents[bone])
        if bone in done:
            return
        done.add(bone)
        if parent >= 0:
            place(parent)
            heads[:, bone] = heads[:, parent] + np.einsum("nij,nj->ni", turns[:, parent], heads[:, bone])
            turns[:, bone] = turns[:, parent] @ turns[:, bone]

    for bone in range(len(bones.names)):
        place(bone)
    return turns, heads


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("characters", nargs="*", type=Path)
    parser.add_argument("--lot", type=Path, help="a list of characters, one a line")
    parser.add_argument("--folder", type=Path, default=Path(), help="where those of the list are")
    parser.add_argument("--sentences", action="store_true")
    arguments = parser.parse_args()
    paths = list(arguments.characters)
    if arguments.lot:
        lines = arguments.lot.read_text().splitlines()
        paths += [arguments.folder / line for line in lines if line and not line.startswith("#")]
    readers = {}
    for name, (shows, missing) in READERS.items():
        if missing():
            print(f"{name} is left out: {missing()}")
        else:
            readers[name] = shows
    columns = ("rest", "joints", "weights", "posed", "moved", "turned")
    print(
        f"{'character':<26} {'moved by':<8} {'vertices':>8} {'joints':>6} {'reader':<8}"
        + "".join(f" {one:>8}" for one in columns)
    )
    worst = dict.fromkeys(readers, 0.0)
    with tempfile.TemporaryDirectory() as folder:
        for path in paths:
            character = bunraku.load_character(path)
            made = {"handles": clips_on_handles(character, bunraku.rig(character))}
            if character.rig is not None:
                made["rig"] = clips_on_rig(character)
            if arguments.sentences:
                made = {
                    "animate": {
                        name: bunraku.animate(character, said, seconds=2).at(FPS)
                        for name, said in zip(CLIPS, SENTENCES, strict=True)
                    }
                }
            for kind, clips in made.items():
                for options in ({}, {"up": "+z", "unit": "m"}):
                    file = save_clips(clips, Path(folder, "clips.fbx"), **options)
                    for name, shows in readers.items():
                        try:
                            found = gaps(shows(file, TIMES), clips, name == "three.js")
                        except (BunrakuError, RuntimeError, KeyError, ValueError) as error:
                            print(f"{path.stem[:26]:<26} {kind:<8} {name}: {type(error).__name__} {str(error)[:300]}")
                            worst[name] = np.inf
                            continue
                        worst[name] = max(worst[name], *found.values())
                        some = next(iter(clips.values()))
                        joints = (
                            len(character.rig.names) if isinstance(some, RigAnimation) else len(some.handles.positions)
                        )
                        print(
                            f"{path.stem[:26]:<26} {kind:<8} {len(character.vertices):>8} {joints:>6} {name:<8}"
                            + "".join(f" {found[one]:>8.1e}" for one in columns)
                            + (" +z, m" if options else ""), flush=True,
                        )  # fmt: skip
    for name, value in worst.items():
        print(f"{name}: {value:.1e} at most, {'within' if value <= BAR else 'NOT within'} {BAR:g}")


if __name__ == "__main__":
    main()
