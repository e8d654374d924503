"""`bunraku data apparel`: characters in motions, simulated and recorded as shards."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.apparel.body import UnifiedBody
from bunraku.core.animation import RigAnimation
from bunraku.core.character import Character
from bunraku.core.files import atomic_write, remove_leftovers
from bunraku.core.parallel import run_parallel
from bunraku.core.skinning import skin
from bunraku.errors import BunrakuError, CharacterError, FormatError
from bunraku_lab.datasets.apparel.checks import pushed_out_clips, unclothed
from bunraku_lab.datasets.apparel.plan import FPS, CharacterSource, ClipPlan, ShardPlan
from bunraku_lab.datasets.apparel.shards import INDEX, LATER_ARRAYS, SHARD_ARRAYS, Shard, shard_fingerprint, write_shard

RIGID = 2e-5
"""A bone that leaves its joint by less than this at all its vertices [m] counts as rigid with it:
half precision, in which offsets are kept, was measured to move it by .03 to .07 mm.
"""
_CHUNK = 256


@dataclass(frozen=True, eq=False)
class Recording:
    """N frames of all clips, one after the other.

    Args:
        transforms: `[R | t]` of the joints, shape (N, 22, 3, 4), float32.
        loose: Vertices that have offsets, shape (M,), int32.
        offsets: How far they are from what the joints alone give [m], shape (N, M, 3), float16.
        rounding: Largest error of half precision in them [m].
    """

    transforms: np.ndarray
    loose: np.ndarray
    offsets: np.ndarray
    rounding: float


def record(body: UnifiedBody, clips: Sequence[RigAnimation]) -> Recording:
    """Write down what a character does.

    Raises:
        ValueError: An offset is not finite or too long for half precision.
    """
    rig = body.parts.character.rig
    assert rig is not None
    vertices = body.parts.character.vertices
    bones = _loose_bones(body, clips)
    dense = np.zeros((len(vertices), len(rig.names)), np.float32)
    np.add.at(dense, (np.arange(len(dense))[:, None], rig.indices), rig.weights)
    loose = np.flatnonzero(dense[:, bones].sum(axis=1) > 1e-4).astype(np.int32)
    weights = dense[np.ix_(loose, bones)]
    transforms = np.concatenate([body.transforms(clip) for clip in clips])
    offsets = np.empty((len(transforms), len(loose), 3), np.float16)
    start, rounding = 0, 0.0
    for clip in clips:
        deviations = _deviations(body, clip)[:, bones]
        for first in range(0, len(clip), _CHUNK):
            exact = skin(vertices[loose], weights, deviations[first : first + _CHUNK])
            if not np.abs(exact).max(initial=0) < 1000:
                raise ValueError("vertices leave their joints by more than a kilometre")
            here = slice(start + first, start + first + len(exact))
            offsets[here] = exact
            rounding = max(
                rounding, float(np.linalg.norm(offsets[here].astype(np.float32) - exact, axis=-1).max(initial=0))
            )
        start += len(clip)
    return Recording(transforms, loose, offsets, rounding)


def _deviations(body: UnifiedBody, animation: RigAnimation) -> np.ndarray:
    """What each bone does beside its joint, as affine transforms, shape (N, J, 3, 4), float32."""
    affine = animation.transforms()
    return affine - affine[:, body.bones[body.joint_of]]


def _loose_bones(body: UnifiedBody, clips: Sequence[RigAnimation]) -> np.ndarray:
    """Bones that hold vertices and leave their joints in some frame, shape (B,)."""
    rig = body.parts.character.rig
    assert rig is not None
    held = np.unique(rig.indices[rig.weights > 1e-4])
    centres, radii = _extents(body)
    far = np.zeros(len(held))
    for clip in clips:
        deviation = _deviations(body, clip)[:, held].astype(np.float64)
        at = np.einsum("njab,jb->nja", deviation[..., :3], centres[held]) + deviation[..., 3]
        reach = np.linalg.norm(deviation[..., :3], axis=(-2, -1)) * radii[held]
        far = np.maximum(far, (np.linalg.norm(at, axis=-1) + reach).max(axis=0))
    return np.asarray(held[far > RIGID])


def _extents(body: UnifiedBody) -> tuple[np.ndarray, np.ndarray]:
    """Centre (J, 3) and radius (J,) [m] of a ball about the vertices that each bone holds."""
    rig, vertices = body.parts.character.rig, body.parts.character.vertices.astype(np.float64)
    assert rig is not None
    count = len(rig.names)
    rows, columns = np.nonzero(rig.weights > 1e-4)
    bones = rig.indices[rows, columns]
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, bones, vertices[rows])
    np.maximum.at(high, bones, vertices[rows])
    some = np.isfinite(low[:, 0])
    centres, radii = rig.positions.astype(np.float64).copy(), np.zeros(count)
    centres[some] = (low[some] + high[some]) / 2
    radii[some] = np.linalg.norm(high[some] - low[some], axis=1) / 2
    return centres, radii


@dataclass
class BuildState:
    """How far a build is; `build_apparel` reports it after every shard.

    Args:
        shards: Shards of the plan.
        minutes: Their length [min].
        done: Shards that are built, now or before.
        built_minutes: Their length [min].
        failed: What was left out and why, by the names of characters, shards, or clips.
        fly_aways: Clips in which a body flew away and was put back, and which body.
        rounding: Largest error of half precision in any vertex [m].
    """

    shards: int = 0
    minutes: float = 0.0
    done: int = 0
    built_minutes: float = 0.0
    failed: dict[str, str] = field(default_factory=dict)
    fly_aways: dict[str, str] = field(default_factory=dict)
    rounding: float = 0.0


def build_apparel(
    folder: str | Path, plan: Sequence[ShardPlan], *, jobs: int | str = 1,
    progress: Callable[[BuildState], None] | None = None,
) -> BuildState:  # fmt: skip
    """Build the shards of a plan that are not there yet, and the index.

    Args:
        folder: Folder for `shards/` and `index.json`, made when it is not there.
        plan: From `plan_shards`.
        jobs: How many processes, or "ray" for a cluster of the package ray, whose machines must see the same files.
        progress: Called after every shard.

    Raises:
        FormatError: The folder cannot be written.
        MissingExtraError: ray is not installed.
    """
    folder = Path(folder).resolve()
    try:
        (folder / "shards").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FormatError(folder, f"the folder cannot be made ({error.strerror}); choose another") from error
    for home in (folder, folder / "shards"):
        remove_leftovers(home)
    progress = progress or (lambda state: None)
    state = BuildState(len(plan), sum(shard.seconds for shard in plan) / 60)
    todo = [shard for shard in plan if not _known(_path(folder, shard), shard, *LATER_ARRAYS)]
    waiting = {shard.name for shard in todo}
    for shard in plan:
        if shard.name not in waiting:
            _note(state, shard, _path(folder, shard))
    _write_index(folder, plan)
    progress(state)
    for shard, problem in run_parallel(partial(_build_batch, folder), [[shard] for shard in todo], jobs, str):
        if problem:
            state.failed[shard.name] = problem
        else:
            _note(state, shard, _path(folder, shard))
        _write_index(folder, plan)
        progress(state)
    return state


def _known(path: Path, shard: ShardPlan, *arrays: str) -> bool:
    """Whether a shard of this plan is there, with some arrays that older versions did not write."""
    return shard_fingerprint(path) == shard.fingerprint() and set(arrays) <= Shard(path).names


def _build_batch(folder: Path, shards: list[ShardPlan]) -> list[str]:
    return [build_shard(folder, shard) for shard in shards]


def _path(folder: Path, shard: ShardPlan) -> Path:
    return folder / "shards" / f"{shard.name}.safetensors"


def _note(state: BuildState, shard: ShardPlan, path: Path) -> None:
    facts = Shard(path).facts
    state.done += 1
    state.built_minutes += sum(clip["frames"] for clip in facts["clips"]) / FPS / 60
    state.rounding = max(state.rounding, float(facts["rounding"]))
    state.failed |= {f"{shard.name} {motion}": reason for motion, reason in facts["failed"].items()}
    for clip in facts["clips"]:
        bodies = sorted({str(body) for body, frame in clip["fly_aways"] if frame >= 0})
        if bodies:
            state.fly_aways[f"{shard.name} {clip['motion']}"] = ", ".join(bodies)


def _write_index(folder: Path, plan: Sequence[ShardPlan]) -> None:
    """The clips of all shards of the plan that are there, in the plan's order."""
    shards = {}
    for shard in plan:
        path = _path(folder, shard)
        try:
            facts = _facts(str(path), path.stat().st_mtime_ns, path.stat().st_size)
        except (OSError, FormatError):
            continue
        if facts["fingerprint"] == shard.fingerprint():
            shards[shard.name] = {key: facts[key] for key in ("name", "split", "clips", "vertices", "apparel", "kind")}
    with atomic_write(folder / INDEX) as file:
        file.write(json.dumps({"fps": FPS, "shards": shards}, indent=1).encode())


@lru_cache(maxsize=4096)
def _facts(path: str, changed: int, size: int) -> dict[str, Any]:
    return Shard(path).facts


def build_shard(folder: Path, shard: ShardPlan) -> str:
    """Make one shard; one that an older version made is not simulated again, and gets the arrays that it lacks.

    Returns:
        "" when it is written, otherwise what went wrong.
    """
    try:
        path = _path(folder, shard)
        if _known(path, shard):
            _complete(path, shard)
        else:
            _build(folder, shard)
    except BunrakuError as error:
        return str(error)
    except MemoryError:
        return "the memory is not enough for this; use fewer processes"
    except Exception as error:  # one bad character must not stop the others
        return f"this is a fault of Bunraku, not yours: {type(error).__name__}: {error}"
    return ""


def _complete(path: Path, shard: ShardPlan) -> None:
    """Write how its vertices swing into a shard of an older version."""
    from bunraku.apparel.physics.clothed_from_file import vertex_swing
    from bunraku.apparel.physics.rig import apparel_rig

    old, character = Shard(path), source_character(shard.character)
    arrays = {name: old.array(name) for name in SHARD_ARRAYS}
    rig = apparel_rig(character)
    if rig is None or not np.array_equal(arrays["rest"], character.vertices):
        raise FormatError(path, "its character is not what its plan makes; remove the file to build it again")
    swing = vertex_swing(character, rig)
    write_shard(path, arrays | {"swing": swing.rows()}, old.facts)


def _build(folder: Path, shard: ShardPlan) -> None:
    from bunraku.apparel.mask import apparel_mask
    from bunraku.apparel.nodes import apparel_parts
    from bunraku.apparel.physics.clothed_from_file import part_springs, vertex_swing
    from bunraku.apparel.physics.rig import apparel_rig
    from bunraku.apparel.physics.simulate import simulate

    character = source_character(shard.character)
    rig = apparel_rig(character)
    mask = apparel_mask(character)
    if rig is None or mask is None or not mask.any():
        raise CharacterError(f"{character.name}: its file has no apparel that physics move; leave it out")
    body = UnifiedBody.of(character)
    animations: list[RigAnimation] = []
    clips: list[dict[str, Any]] = []
    failed: dict[str, str] = {}
    first = 0
    for clip in shard.clips:
        try:
            simulation = simulate(_clip_animation(body, clip), rig)
            animation = simulation.animation
        except BunrakuError as error:
            failed[clip.motion.name] = str(error)
            continue
        away = [[lost.body, int(lost.frame)] for lost in simulation.report.recoveries]
        clips.append({
            "motion": clip.motion.name, "start": clip.start, "first": first, "frames": len(animation),
            "fly_aways": away,
        })  # fmt: skip
        animations.append(animation)
        first += len(animation)
    if not animations:
        raise CharacterError(f"{character.name}: none of its motions can be used: {next(iter(failed.values()))}")
    recording = record(body, animations)
    own = character.rig
    assert own is not None
    part = apparel_parts(character.vertices, character.faces, mask)
    springs, swing = part_springs(character, rig, part), vertex_swing(character, rig)
    clothed = unclothed(character.vertices, character.faces, body.joints, body.weights, mask, part)
    offsets = pushed_out_clips(clothed, recording.transforms, recording.loose, recording.offsets, clips)
    arrays = {
        "rest": character.vertices, "faces": character.faces, "joints": body.joints, "weights": body.weights,
        "apparel": mask, "part": part, "spring": springs.spring, "mass": springs.mass, "damping": springs.damping,
        "limit": springs.limit, "swing": swing.rows(),
        "loose": recording.loose, "transforms": recording.transforms, "offsets": offsets,
        "bone_parents": own.parents,
        "bone_positions": own.positions, "bone_moved": body.moved, "bone_indices": own.indices,
        "bone_weights": own.weights,
    }  # fmt: skip
    facts = {
        "name": shard.character.name, "split": shard.character.split,
        "kind": "file" if shard.character.path else "wardrobe", "fps": FPS,
        "fingerprint": shard.fingerprint(), "clips": clips, "failed": failed, "rounding": recording.rounding,
        "pushed_out": True,
        "vertices": len(character.vertices), "apparel": int(mask.sum()), "bones": list(own.names),
    }  # fmt: skip
    write_shard(_path(folder, shard), arrays, facts)


@lru_cache(maxsize=1)
def source_character(source: CharacterSource) -> Character:
    """The character of a source; the last one is kept."""
    if source.path:
        from bunraku.files import load_character

        return load_character(source.path)
    from bunraku_lab.synthetic.wardrobe import wardrobe_character

    return wardrobe_character(source.seed, clothes=source.clothes or None, body_data=source.body_data or None)


def _clip_animation(body: UnifiedBody, clip: ClipPlan) -> RigAnimation:
    """A clip on the character's rig, apparel going along with the body."""
    from bunraku.core.motion import HandleMotion, resample
    from bunraku.pipelines.transfer import played_by_mmd

    path, cut = clip.motion.path, slice(round(clip.start * FPS), round((clip.start + clip.seconds) * FPS))
    if clip.motion.clip:
        from bunraku_lab.datasets.motions.clips import load_clip

        motion: Any = load_clip(path)
        # Only the part that is used, in its own frames; the rest of the cut is made after resampling.
        early = int(clip.start * motion.fps)
        motion = motion.take(slice(early, int((clip.start + clip.seconds) * motion.fps) + 2))
        whole = resample(motion, FPS)
        skip = round((clip.start - early / motion.fps) * FPS)
        whole = whole.take(slice(skip, skip + cut.stop - cut.start))
    else:
        played = played_by_mmd(body.parts.character, path, FPS)
        if played is not None:
            return RigAnimation(played.character, played.rotations[cut], played.translations[cut], FPS)
        whole = _reference(path).take(cut)
    assert isinstance(whole, HandleMotion)
    return body_animation(body, whole)


@lru_cache(maxsize=8)
def _reference(path: str) -> Any:
    from bunraku.pipelines.to_reference import load_motion, reference_motion

    return reference_motion(load_motion(path, fps=FPS), fps=FPS)


def body_animation(body: UnifiedBody, motion: Any) -> RigAnimation:
    """A handle motion on a character's rig, moved by SMPL's 22 joints alone; fingers, hair and tails go along.

    Args:
        body: The character.
        motion: `HandleMotion` of the reference body.
    """
    from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_PARENTS, JOINT_COUNT
    from bunraku.pipelines.transfer import TRANSFER_STAGES
    from bunraku.retarget.stages.feet import is_treadmill
    from bunraku.retarget.to_rig import fit_rig

    rotations = np.array(motion.rotations)
    for handle in range(JOINT_COUNT, HANDLE_COUNT):
        rotations[:, handle] = rotations[:, HANDLE_PARENTS[handle]]
    motion = replace(motion, rotations=rotations)
    # Bones keep their lengths in any case; feet that are held would carry away a person who slides on the spot.
    stages = replace(TRANSFER_STAGES, shape=False, feet=not is_treadmill(motion))
    return fit_rig(motion, body.parts, stages)
