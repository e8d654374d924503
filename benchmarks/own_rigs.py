"""What `animate --rig own` keeps of rigged files, and how near its motion is to that of 30 handles.

    python benchmarks/own_rigs.py FOLDER [--sentence "walks forward"] [--seed 1] [--handles predict|rig]

For each file of the folder: whether bones, names, parents, bind pose, weights and the file's other clips are the same
in what is written; and of upper and lower arms and legs, mean over frames and limbs [degrees], the angle between the
file's bones and 30 handles that the same motion moves, and of each to that motion itself. The handles are predicted
from the mesh, or have the weights of the file's rig, which tells what of an angle is the prediction's.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from bunraku.anatomy.joints import reference_joints
from bunraku.cli.options import stand_up
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.character import Character
from bunraku.errors import BunrakuError
from bunraku.files import Source, load_character
from bunraku.pipelines.animator import Animator, Body
from bunraku.pipelines.requests import Request, Sampling
from bunraku.retarget.rig_parts import RigParts

ENDS = {"shoulder": "elbow", "elbow": "wrist", "hip": "knee", "knee": "ankle"}
LIMBS = [f"{side}_{part}" for side in ("left", "right") for part in ("shoulder", "elbow", "hip", "knee")]


def kept(given: Character, written: Character) -> list[str]:
    """What of a file is not the same in what was written."""
    old, new = given.source, written.source
    assert isinstance(old, Source) and isinstance(new, Source) and given.rig is not None and written.rig is not None
    nodes = [[node.get("name") for node in one.document.items("nodes")] for one in (old, new)]
    found = {
        "names": given.rig.names == written.rig.names and nodes[0] == nodes[1][: len(nodes[0])],
        "parents": np.array_equal(given.rig.parents, written.rig.parents),
        "bind pose": all(
            np.array_equal(a.astype(np.float32), b.astype(np.float32))
            for a, b in zip(old.skins.inverse, new.skins.inverse, strict=True)
        ),
        "weights": np.abs(given.rig.dense_weights()[old.index] - written.rig.dense_weights()).max() < 1e-6,
        "vertices": np.abs(given.vertices[old.index] - written.vertices).max() < 1e-5 * given.height,
        "clips": same_clips(old, new),
    }
    return [name for name, same in found.items() if not same]


def same_clips(old: Source, new: Source) -> bool:
    """Whether all clips of a file follow the first of another, key by key."""
    before, after = old.document.items("animations"), new.document.items("animations")[1:]
    if len(before) != len(after):
        return False
    for clip, copy in zip(before, after, strict=True):
        pairs = list(zip(clip["channels"], copy["channels"], strict=False))
        if len(pairs) != len(clip["channels"]) or clip.get("name") != copy.get("name"):
            return False
        for one, other in pairs:
            samplers = clip["samplers"][one["sampler"]], copy["samplers"][other["sampler"]]
            if one["target"]["node"] != other["target"]["node"] or one["target"]["path"] != other["target"]["path"]:
                return False
            for key in ("input", "output"):
                arrays = [
                    source.document.accessor(sampler[key], ("SCALAR", "VEC3", "VEC4"), raw=True)
                    for source, sampler in zip((old, new), samplers, strict=True)
                ]
                if not np.array_equal(*arrays):
                    return False
    return True


def limb_angles(own: RigAnimation, other: Animation, parts: RigParts) -> dict[str, tuple[float, float, float]]:
    """Of each limb the mean angles [degrees] of bones to handles, of bones to the motion of the reference body that
    both were fitted from, and of handles to that.
    """
    turns, known = own.world()[0], reference_joints().positions
    motion, moved = own.reference, other.motion
    assert motion is not None
    out = {}
    for name in LIMBS:
        side, part = name.split("_")
        handle, child = HANDLE_NAMES.index(name), HANDLE_NAMES.index(f"{side}_{ENDS[part]}")
        bone = parts.leads[handle]
        if bone < 0 or not parts.joints.present[[handle, child]].all() or other.handles.played[handle] != handle:
            continue
        rest = parts.joints.positions[child] - parts.joints.positions[handle]
        bones = turns[:, bone] @ rest
        handles = np.einsum("nij,njk,k->ni", moved.root_rotation, moved.rotations[:, handle], rest)
        limb = known[child] - known[handle]
        want = np.einsum("nij,njk,k->ni", motion.root_rotation, motion.rotations[:, handle], limb)
        out[name] = angle(bones, handles), angle(bones, want), angle(handles, want)
    return out


def angle(one: np.ndarray, other: np.ndarray) -> float:
    """Mean angle between directions, shape (N, 3) each [degrees]."""
    cosine = (one * other).sum(axis=1) / (np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1))
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())


def row(path: Path, request: Request, folder: Path, handles: str) -> str:
    """One line of the table."""
    given = load_character(path, unit="m", clips=30.0)
    character = stand_up(given, path, "auto", "auto", "auto")
    animator = Animator.shipped()
    own: Body = animator.body(character, request)
    if own.parts is None:
        return f"| {path.name} | not understood | | | |"
    moved = animator(own, request)
    assert isinstance(moved, RigAnimation)
    written = load_character(moved.save(folder / f"{path.stem}.glb"))
    lost = kept(character, written)
    other = animator(character, Request(request.sentence, request.sampling, handles=handles, rig="handles"))
    assert isinstance(other, Animation)
    angles = limb_angles(moved, other, own.parts)
    worst = max(angles, key=lambda name: angles[name][0])
    means = np.mean(list(angles.values()), axis=0)
    source = written.source
    assert isinstance(source, Source)
    clips = len(source.document.items("animations")) - 1
    return (
        f"| {path.name} | {len(own.parts.parts)} | {clips} | {', '.join(lost) or 'all the same'} | "
        f"{means[0]:.1f} ({worst} {angles[worst][0]:.1f}) | {means[1]:.1f} | {means[2]:.1f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sentence", default="walks forward")
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--handles", choices=("predict", "rig"), default="predict")
    parser.add_argument("--keep", type=Path, help="write the GLBs here")
    asked = parser.parse_args()
    request = Request(asked.sentence, Sampling(asked.seconds, asked.seed, candidates=1))
    print("| file | bones | other clips | not the same | bones off handles | bones off the motion | handles off it |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        for path in sorted(some for some in asked.folder.iterdir() if some.is_file()):
            try:
                print(row(path, request, asked.keep or Path(folder), asked.handles), flush=True)
            except BunrakuError as error:
                print(f"| {path.name} | failed: {error} | | | |", flush=True)


if __name__ == "__main__":
    main()
