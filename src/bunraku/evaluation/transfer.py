"""What motion transfer is worth: the table of `bunraku evaluate transfer`.

Rigged characters are their own truth: where a limb of the source points, the limb between the same two bones of the result must point,
whether the rig was moved or handles that know nothing of it.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.animation import Animation
from bunraku.bodies.layout import JOINT_COUNT
from bunraku.bodies.smpl_rest import LIMB_CHILD
from bunraku.character import Character
from bunraku.errors import BunrakuError, FormatError
from bunraku.evaluation.transfer_speed import MANY, bvh_again, times
from bunraku.motion import HandleMotion
from bunraku.retarget.fit import Stages
from bunraku.retarget.rig_parts import RigParts
from bunraku.rig_animation import RigAnimation

__all__ = ["BARS", "KINDS", "Bar", "evaluate_transfer", "limb_angles", "pick_motions"]

KINDS = ("walk", "dance", "kick", "sit", "roll")
Progress = Callable[[str, float], None]
SECONDS = 8.0  # of each motion
STRIDE = 4  # frames from one that is measured to the next
CARRIED = Stages(ground=False, feet=False, smooth=False, floor=False)
"""What carries a motion over, without what corrects it."""


@dataclass(frozen=True)
class Bar:
    """A row of the table.

    Args:
        title: What it measures.
        bar: What must be reached.
        high: Whether more is better.
        unit: After the number.
    """

    title: str
    bar: float | None
    high: bool = False
    unit: str = ""


BARS: dict[str, Bar] = {
    "finished": Bar("pairs of character and motion that finished", 1.0, True),
    "angle_rig": Bar("limb directions on rigs, mean", 5.0, unit=" deg"),
    "angle_handles": Bar("limb directions on handles, mean", 8.0, unit=" deg"),
    "back": Bar("a character's clip to the reference body and back, over the height, median", 0.005),
    "back_copied": Bar("a character's clip copied to the same skeleton, over the height", 0.005),
    "bvh_degrees": Bar("BVH written and read again", 0.01, unit=" deg"),
    "seconds_bvh": Bar("reading a BVH of 2 minutes at 120 Hz", 0.5, unit=" s"),
    "seconds_rig": Bar("10 s of motion onto the rig of 20k vertices", 1.5, unit=" s"),
    "seconds_handles": Bar("10 s of motion onto the handles of 20k vertices, handles known", 1.5, unit=" s"),
}


def pick_motions(folder: str | Path) -> dict[str, Path]:
    """A motion of each kind of `KINDS` in a folder: by the captions of its `captions.csv`, or by the names of the files.

    Of several that fit, one that says just this word is taken, then the one with the fewest words, then the first by name.

    Raises:
        FormatError: There is none of some kind.
    """
    folder = Path(folder)
    found: list[tuple[str, Path]] = []
    table = folder / "captions.csv"
    if table.is_file():
        with table.open(newline="", encoding="utf-8") as file:
            found = [
                (row["caption"], folder / row["file"]) for row in csv.DictReader(file) if row.get("caption") and (folder / row["file"]).is_file()
            ]
    found += [(path.stem.replace("_", " "), path) for path in sorted(folder.glob("*")) if path.suffix.lower() in (".bvh", ".npz", ".npy", ".fbx")]
    out = {}
    for kind in KINDS:
        words = [(text.lower().split(), path) for text, path in found]
        fits = [(kind not in some, len(some), path.name, path) for some, path in words if any(word.startswith(kind) for word in some)]
        if not fits:
            raise FormatError(folder, f"it holds no motion whose caption or name says '{kind}'; the table needs {', '.join(KINDS)}")
        out[kind] = min(fits)[3]
    return out


def limb_angles(parts: RigParts, heads: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Angles between limbs of a result and of its source [degrees], shape (N, limbs): upper arms, forearms, thighs and shins.

    Args:
        parts: The rig that names the limbs.
        heads: Where the joints of its handles are in the result [m], shape (N, 30, 3).
        source: Where SMPL's 22 joints are in the source [m], shape (N, 22, 3).
    """
    out = []
    for joint, child in LIMB_CHILD.items():
        if min(parts.leads[joint], parts.leads[child]) >= 0:
            own, want = heads[:, child] - heads[:, joint], source[:, child] - source[:, joint]
            scale = np.linalg.norm(own, axis=1) * np.linalg.norm(want, axis=1)
            out.append(np.degrees(np.arccos(np.clip((own * want).sum(axis=1) / np.maximum(scale, 1e-12), -1, 1))))
    return np.stack(out, axis=1)


def _rig_heads(parts: RigParts, animation: RigAnimation, frames: np.ndarray) -> np.ndarray:
    return np.asarray(animation.world()[1][frames][:, np.maximum(parts.leads, 0)])


def _carried_heads(parts: RigParts, animation: Animation | RigAnimation, frames: np.ndarray) -> np.ndarray:
    """Where the skinning of an animation takes a rig's joints: as it takes the vertices that both parts of the joint hold, in the mean."""
    own = parts.handles.weights.astype(np.float64)
    world = animation.motion.transforms(animation.handles.positions)[frames].astype(np.float64)
    heads = np.tile(parts.joints.positions, (len(world), 1, 1))
    for handle in range(1, JOINT_COUNT):
        head = parts.joints.positions[handle]
        mass = own[:, handle] * own[:, max(int(parts.joints.parents[handle]), 0)]
        if mass.sum() < 0.05:  # parts that do not overlap: what is nearest to the joint
            mass = np.zeros(len(own))
            mass[np.argsort(((parts.character.vertices - head) ** 2).sum(axis=1))[:12]] = 1.0
        blend = np.einsum("k,nkij->nij", (mass / mass.sum()) @ animation.handles.weights, world)
        heads[:, handle] = blend[..., :3] @ head + blend[..., 3]
    return heads


def evaluate_transfer(
    characters: str | Path, motions: str | Path, *, limit: int | None = None, speed: bool = True, progress: Progress | None = None
) -> dict[str, Any]:
    """Measure all rows.

    Args:
        characters: Folder of characters, searched through.
        motions: Folder with a motion of each kind, BVH with a `captions.csv` beside them or named by kind.
        limit: How many characters to take, spread over all; all when None.
        speed: Whether to measure times too.
        progress: Called with a stage's name and the share done.

    Returns:
        Values by the keys of `BARS`, None where nothing could be measured; `reached`, `failed`, `rows` and `counts`.

    Raises:
        FormatError: There is no character, or a motion of some kind is missing.
    """
    from bunraku.any_motion import load_any_motion, reference_motion

    folder = Path(characters)
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in (".glb", ".gltf", ".vrm", ".fbx"))
    if not files:
        raise FormatError(folder, "it holds no .glb, .gltf, .vrm or .fbx character")
    if limit is not None and limit < len(files):
        files = [files[index] for index in np.linspace(0, len(files) - 1, limit).round().astype(int)]
    picked = pick_motions(motions)
    references = {kind: _cut(reference_motion(load_any_motion(path))) for kind, path in picked.items()}
    sources = {kind: _joints(motion) for kind, motion in references.items()}
    rows: list[dict[str, Any]] = []
    failed: dict[str, str] = {}
    nearest: tuple[int, Character | None] = (0, None)
    for number, path in enumerate(files):
        name = path.relative_to(folder).with_suffix("").as_posix()
        row: dict[str, Any] = {"name": name, "finished": 0}
        try:
            character = _facing(path, name)
            _measure(character, path, references, sources, row, failed)
            gap = abs(len(character.vertices) - MANY)
            if row.get("humanoid") and (nearest[1] is None or gap < nearest[0]):
                nearest = (gap, character)
        except BunrakuError as error:
            failed[name] = str(error)
        rows.append(row)
        if progress:
            progress("characters", (number + 1) / len(files))
    result: dict[str, Any] = {"finished": sum(row["finished"] for row in rows) / (len(rows) * len(KINDS))}
    for key in ("angle_rig", "angle_handles", "back", "back_copied"):
        values = [row[key] for row in rows if key in row]
        result[key] = float((np.median if key == "back" else np.mean)(values)) if values else None  # of some, half the vertices are weapons
    result["bvh_degrees"] = bvh_again(picked["walk"])
    result |= times(nearest[1], references["walk"]) if speed else dict.fromkeys(("seconds_bvh", "seconds_rig", "seconds_handles"))
    known = {key: bar for key, bar in BARS.items() if bar.bar is not None and result[key] is not None}
    result["reached"] = {key: bool(result[key] >= bar.bar if bar.high else result[key] <= bar.bar) for key, bar in known.items()}
    humanoids = sum(bool(row.get("humanoid")) for row in rows)
    counts = {"characters": len(rows), "humanoids": humanoids, "clips": sum("back" in row for row in rows)}
    return result | {"counts": counts, "motions": {kind: path.name for kind, path in picked.items()}, "failed": failed, "rows": rows}


def _cut(motion: HandleMotion) -> HandleMotion:
    return motion.take(slice(0, round(SECONDS * motion.fps)))


def _joints(motion: HandleMotion) -> np.ndarray:
    """Where the reference body's joints are [m], shape (N, 22, 3)."""
    from bunraku.bodies.reference import reference_body

    body = reference_body()
    world = motion.transforms(body.handles.positions).astype(np.float64)[:, :JOINT_COUNT]
    return np.asarray(np.einsum("njab,jb->nja", world[..., :3], body.joints) + world[..., 3])


def _facing(path: Path, name: str) -> Character:
    """A character facing +Z, by what is known of the archive's rigs."""
    from bunraku.datasets.known_rigs import facing_turn
    from bunraku.formats import load_character
    from bunraku.formats.turning import turned
    from bunraku.geometry.axes import AXES, axis_vector

    character = load_character(path)
    if character.rig is None:
        return character
    ahead = facing_turn(name, character.rig.names, character.rig.positions).T @ np.array([0.0, 0, 1])
    return turned(character, "+y", max(AXES, key=lambda axis: float(axis_vector(axis) @ ahead)))


def _measure(
    character: Character, path: Path, references: dict[str, HandleMotion], sources: dict[str, np.ndarray], row: dict[str, Any], failed: dict[str, str]
) -> None:
    from bunraku.motion_transfer import perform_transfer
    from bunraku.pipeline import rig

    try:
        parts = RigParts.of(character)
    except BunrakuError:
        parts = None
    row["humanoid"] = humanoid = parts is not None and parts.humanoid
    handles = rig(character)
    on_rig: list[float] = []
    on_handles: list[float] = []
    for kind, motion in references.items():
        try:
            frames = np.arange(0, len(motion), STRIDE)
            result = perform_transfer(character, motion, onto="handles", handles=handles)
            posed = result.vertices(frames)
            if not np.isfinite(posed).all():
                raise FormatError(path, "the result holds values that are not numbers")
            row["finished"] += 1
            if humanoid:
                assert parts is not None
                on_handles.append(float(limb_angles(parts, _carried_heads(parts, result, frames), sources[kind][frames]).mean()))
                moved = perform_transfer(character, motion, onto="rig")
                assert isinstance(moved, RigAnimation)
                on_rig.append(float(limb_angles(parts, _rig_heads(parts, moved, frames), sources[kind][frames]).mean()))
        except BunrakuError as error:
            failed[f"{row['name']} {kind}"] = str(error)
    if humanoid and on_rig:
        row |= {"angle_rig": float(np.mean(on_rig)), "angle_handles": float(np.mean(on_handles))}
        row |= _there_and_back(path)


def _there_and_back(path: Path) -> dict[str, float]:
    """Mean error of the vertices of a character's own clip, over its height, after the way to the reference body and back; none without clips."""
    from bunraku.any_motion import reference_motion
    from bunraku.formats.gltf_play import clip_names, load_animation
    from bunraku.motion_transfer import perform_transfer, same_skeleton

    try:
        clip = load_animation(path, 0, 20.0)
        names = clip_names(clip.character.source.document)
        clip = load_animation(path, next((number for number, name in enumerate(names) if "walk" in name.lower()), 0), 20.0)
        truth, height = clip.vertices(), clip.character.height
        back = perform_transfer(clip.character, reference_motion(clip), onto="rig", stages=CARRIED)
        copied = same_skeleton(clip.character, clip)
    except BunrakuError:
        return {}
    out = {"back": float(np.linalg.norm(back.vertices() - truth, axis=-1).mean() / height)}
    if copied is not None:
        out["back_copied"] = float(np.linalg.norm(copied.vertices() - truth, axis=-1).mean() / height)
    return out
