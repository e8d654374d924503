"""Human motions as handle motions (`bunraku data motions`), without sloping feet, heights and rolled limbs."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d, percentile_filter

from bunraku.core.body.joint_rotations import motion_from_positions
from bunraku.core.body.layout import HANDLE_NAMES, JOINT_NAMES
from bunraku.core.body.reference import handle_positions, reference_body
from bunraku.core.files import remove_leftovers
from bunraku.core.geometry.rotations import (
    axis_angle_from_matrix,
    heading,
    matrix_from_axis_angle,
    matrix_from_quaternion,
)
from bunraku.core.geometry.surface import vertex_areas
from bunraku.core.motion import HandleMotion, SkeletalMotion, Skeleton
from bunraku.core.parallel import Pool
from bunraku.errors import FormatError
from bunraku.retarget.to_reference import handle_motion_of_mesh
from bunraku_lab.datasets.motions.clips import (
    FEWEST,
    Stretch,
    load_clip,
    load_index,
    load_lowest,
    load_watched,
    source_of,
    subject_of,
    write_clip,
    write_index,
)

ANKLES = (JOINT_NAMES.index("left_ankle"), JOINT_NAMES.index("right_ankle"))
LEAST_SLOPE, MOST_SLOPE = np.radians(2.0), np.radians(35.0)


def standing_foot_pitch(motion: SkeletalMotion) -> float:
    """Median slope [rad] of the feet while they stand (low, slower than 0.3 m/s); NaN where they never stand."""
    rotations, positions = motion.world()
    slopes = []
    for joint in ANKLES:
        height = positions[:, joint, 1]
        speed = np.linalg.norm(np.diff(positions[:, joint], axis=0, prepend=positions[:1, joint]), axis=-1) * motion.fps
        stands = (height < np.quantile(height, 0.3) + 0.03) & (speed < 0.3)
        if stands.sum() >= 8:
            slopes.append(float(np.median(np.arcsin(np.clip(rotations[stands, joint, 1, 2], -1, 1)))))
    return float(np.mean(slopes)) if slopes else float("nan")


def subject_pitches(pitches: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Slope of each subject [rad]: the median of its clips, 0 where that is small, scattered or of few clips."""
    groups = defaultdict(list)
    for name, pitch in pitches:
        if np.isfinite(pitch):
            groups[subject_of(name)].append(pitch)
    medians = {subject: float(np.median(values)) for subject, values in groups.items() if len(values) >= 3}
    return {subject: value if LEAST_SLOPE < abs(value) < MOST_SLOPE else 0.0 for subject, value in medians.items()}


def level_feet(motion: SkeletalMotion, name: str, slopes: Mapping[str, float]) -> SkeletalMotion:
    """The motion with its subject's constant slope taken out of both ankles."""
    slope = slopes.get(subject_of(name), 0.0)
    if slope == 0.0:
        return motion
    rotations = motion.rotations.copy()
    turn = matrix_from_axis_angle(np.array([slope, 0.0, 0.0])).astype(np.float32)
    for joint in ANKLES:
        rotations[:, joint] = rotations[:, joint] @ turn
    return replace(motion, rotations=rotations)


# The shipped denoiser was trained on data made with these.
HAND = 0.15
"""Height [m] up to which a body that is off the ground means to stand on it."""
CLIMB = 0.2
"""Height [m] from which on a clip climbs."""
WINDOW = 2.4
"""Time [s] in which a body touches the ground at least once, however it jumps."""
_SITS = re.compile(r"\b(sits?|sitting|seated|seat|chair)\b", re.IGNORECASE)
_HIGH = re.compile(
    r"\b(stool|high|horse|ride|riding|motorcycle|swing|hop|table|ledge|climb\w*|cycl\w*)\b", re.IGNORECASE
)
_LIES = re.compile(r"\b(lies|lying|lie|crawl\w*|push-?ups?|sit-?ups?)\b", re.IGNORECASE)


def floor_height(lowest: np.ndarray, fps: float) -> np.ndarray:
    """Height of the ground under a clip, by what touches it.

    Args:
        lowest: Lowest point of what can carry the body, all but the arms, in each frame [m], shape (N,).
        fps: Frames a second [1/s].

    Returns:
        Height [m] to take off each frame, shape (N,): smooth where the clip hovers or sinks by less than `CLIMB` all
        along, else one number, 0 where even that is more than `HAND`.
    """
    whole = float(np.quantile(lowest, 0.05))
    whole = whole if abs(whole) < HAND else 0.0
    rest = np.asarray(lowest, float) - whole
    size = max(3, round(WINDOW * fps))
    local = gaussian_filter1d(percentile_filter(rest, 10, size=size, mode="nearest"), 0.4 * fps, mode="nearest")
    if np.abs(local).max(initial=0) > CLIMB:
        return np.full(len(rest), whole)
    return whole + local


def posture_fault(texts: list[str], height: np.ndarray, lowest: np.ndarray) -> str | None:
    """Why a stretch cannot be what its sentences say: it sits, lies or stands in the air; None where it can.

    Args:
        texts: Its sentences.
        height: Root over its standing height in each frame [m], shape (N,).
        lowest: Lowest point of the body over the ground in each frame [m], shape (N,).
    """
    words = " ".join(texts)
    if _SITS.search(words) and not _HIGH.search(words) and float(height.min()) > -0.18:
        return f"sits with the pelvis {-100 * float(height.min()):.0f} cm below standing, which is no seat"
    if _LIES.search(words) and not re.search(r"\bswim", words, re.IGNORECASE) and float(height.min()) > -0.3:
        return f"lies or creeps with the pelvis {-100 * float(height.min()):.0f} cm below standing"
    if not re.search(
        r"\b(climb\w*|hang\w*|swing\w*|swim\w*|ladder|fl(y|ies|ying)|levitat\w*|jump\w*|leap\w*|flip\w*|mid-?air)\b",
        words,
        re.IGNORECASE,
    ):
        share = float((lowest > 0.08).mean())
        if share > 0.6:
            return f"nothing is near the ground in {100 * share:.0f} % of the frames"
    return None


HINGES = {"left_knee": (1, 0, 0), "right_knee": (1, 0, 0), "left_elbow": (0, -1, 0), "right_elbow": (0, 1, 0)}
"""Axis about which each bends in the T-pose, roughly."""
BENT = np.deg2rad(20)
FEWEST_BENT = 8  # frames


def rolled_limbs(motion: SkeletalMotion) -> list[str]:
    """Hinges that bend the wrong way in most of the frames in which they are bent by 20 degrees or more.

    Args:
        motion: Of SMPL's 22 joints, rest in the T-pose.
    """
    found = []
    for name, axis in HINGES.items():
        turn = axis_angle_from_matrix(motion.rotations[:, JOINT_NAMES.index(name)].astype(np.float64))
        angle = np.linalg.norm(turn, axis=1)
        bent = angle > BENT
        if bent.sum() >= FEWEST_BENT and float(np.median(turn[bent] @ np.array(axis) / angle[bent])) < -0.5:
            found.append(name)
    return found


def unrolled(motion: SkeletalMotion) -> SkeletalMotion:
    """The motion with its rotations found again from its joint positions, where a limb is rolled; else as it is."""
    if not rolled_limbs(motion):
        return motion
    return motion_from_positions(motion.world()[1], motion.fps)


# The shipped denoiser was trained on data made with these.
HELD_TURN, HELD_WAY, HELD_MARGIN = np.radians(10), 0.05, 5
"""A pose is held while no handle rotates and the root moves no farther than this [m]; this many frames are kept."""
QUATERNION_STEP = 8192.0  # the archive stores first differences of round(8192 q)


@dataclass(frozen=True)
class MotionArchive:
    """The packed motions, opened.

    Args:
        path: The `motions.npz`.
        names: Clip names.
        bounds: First frame of each clip and the end of the last, shape (clips + 1,).
        clips: What `motions.json` says of each clip.
    """

    path: Path
    names: tuple[str, ...]
    bounds: np.ndarray
    clips: dict[str, dict[str, Any]]
    _planes: np.ndarray
    _root: np.ndarray
    _offsets: np.ndarray
    _parents: np.ndarray

    @classmethod
    def open(cls, folder: str | Path) -> MotionArchive:
        """Open the archive in a folder that holds `motions.npz` and `motions.json`.

        Raises:
            FormatError: A file is missing, broken, or not this archive.
        """
        path = Path(folder) / "motions.npz"
        labels = path.with_suffix(".json")
        for file in (path, labels):
            if not file.is_file():
                raise FormatError(
                    file, "there is no such file; give the folder that holds motions.npz and motions.json"
                )
        try:
            with np.load(path, allow_pickle=False) as packed:
                names = tuple(str(name) for name in packed["names"])
                if tuple(str(joint) for joint in packed["joints"]) != JOINT_NAMES:
                    raise FormatError(path, "its joints are not SMPL's 22; this is another archive")
                return cls(
                    path, names, packed["off"], json.loads(labels.read_text(encoding="utf-8"))["clips"],
                    packed["dq"], packed["root"], packed["offsets"], packed["parents"],
                )  # fmt: skip
        except FormatError:
            raise
        except Exception as error:
            raise FormatError(
                path, f"cannot be read as a motion archive ({type(error).__name__}); copy it again"
            ) from error

    def motion(self, index: int) -> SkeletalMotion:
        """One clip as skeletal motion at 20 frames a second."""
        start, end = int(self.bounds[index]), int(self.bounds[index + 1])
        planes = self._planes[:, :, start:end]
        deltas = np.ascontiguousarray(planes.transpose(1, 2, 0)).view(np.int16)[..., 0]
        quaternions = np.cumsum(deltas.astype(np.int32), axis=1).T.reshape(-1, len(JOINT_NAMES), 4) / QUATERNION_STEP
        skeleton = Skeleton(JOINT_NAMES, self._parents, self._offsets[index])
        return SkeletalMotion(
            skeleton, matrix_from_quaternion(quaternions[..., [1, 2, 3, 0]]), self._root[start:end], 20.0
        )


def grounded_motion(motion: SkeletalMotion) -> tuple[HandleMotion, np.ndarray]:
    """A captured motion as handle motion of the reference body, set on the ground by what touches it.

    Hands do not count: what reaches for the floor reaches through it, as people's arms are not this body's.

    Returns:
        The motion, and the body's lowest point over the ground in each frame [m], shape (N,).
    """
    whole, lowest, carrying = registered_body(motion)
    floor = floor_height(carrying, motion.fps)
    drop = np.outer(floor, [0, 1, 0]).astype(np.float32)
    return replace(whole, root_translation=whole.root_translation - drop), (lowest - floor).astype(np.float32)


CHUNK = 400  # frames posed at once: bounds memory at about 30 MB a worker


def handle_motion_of_body(motion: SkeletalMotion) -> HandleMotion:
    """Skeletal motion of SMPL's joints as handle motion of the reference body.

    The body is set on the ground: the clip is moved along Y so that the lowest point of its standing frames (5 %
    quantile) is at 0, unless that is more than 15 cm away, where the clip means to be off the ground.
    """
    registered, lowest, _ = registered_body(motion)
    floor = float(np.quantile(lowest, 0.05))
    drop = np.array([0, floor if abs(floor) < 0.15 else 0, 0], np.float32)
    return replace(registered, root_translation=registered.root_translation - drop)


def registered_body(motion: SkeletalMotion) -> tuple[HandleMotion, np.ndarray, np.ndarray]:
    """Handle motion of the reference body as the skeleton moves it, wherever the ground is, the lowest point of the
    body in each frame [m], shape (N,), and that of all but its arms.
    """
    body = reference_body()
    areas = vertex_areas(body.vertices, body.faces)
    positions = handle_positions(body.vertices, body.handle_weights, areas)
    outer = ("elbow", "wrist", "fingers")
    arms = [HANDLE_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in outer]
    carries = body.handle_weights[:, arms].sum(axis=1) < 0.5
    parts, lowest, carrying = [], [], []
    for start in range(0, len(motion), CHUNK):
        cut = slice(start, start + CHUNK)
        part = SkeletalMotion(motion.skeleton, motion.rotations[cut], motion.root_translation[cut], motion.fps)
        posed = body.pose(part)
        lowest.append(posed[..., 1].min(axis=1))
        carrying.append(posed[:, carries, 1].min(axis=1))
        parts.append(handle_motion_of_mesh(body.vertices, posed, body.handle_weights, positions, areas, motion.fps))
    return HandleMotion.joined(parts), np.concatenate(lowest), np.concatenate(carrying)


def split_of(name: str) -> str:
    """The split of a clip, fixed for ever by its name: 6 % "test", 3 % "val", the rest "train"."""
    number = int(hashlib.sha256(name.encode()).hexdigest()[:8], 16) % 100
    return "test" if number < 6 else "val" if number < 9 else "train"


def _convert(archive: MotionArchive, indices: list[int], out: Path, slopes: dict[str, float]) -> int:
    for index in indices:
        name = archive.names[index]
        write_clip(out / f"{name}.npz", *grounded_motion(level_feet(unrolled(archive.motion(index)), name, slopes)))
    return sum(int(archive.bounds[index + 1] - archive.bounds[index]) for index in indices)


_ARCHIVE: MotionArchive | None = None


def _start_worker(source: str) -> None:
    global _ARCHIVE
    _ARCHIVE = MotionArchive.open(source)


def _work(indices: list[int], out: Path, slopes: dict[str, float]) -> int:
    assert _ARCHIVE is not None
    return _convert(_ARCHIVE, indices, out, slopes)


def _batches(archive: MotionArchive, todo: list[int]) -> Iterator[list[int]]:
    batch: list[int] = []
    frames = 0
    for index in todo:
        batch.append(index)
        frames += int(archive.bounds[index + 1] - archive.bounds[index])
        if frames >= 4000:
            yield batch
            batch, frames = [], 0
    if batch:
        yield batch


def build_motions(
    source: str | Path, out: str | Path, jobs: int | None = None, progress: Callable[[str, float], None] | None = None
) -> Path:
    """Convert every clip of the archive in a folder, with `motions.npz` and `motions.json`, to handle motion of the
    reference body, on as many processes as there are cores by default. The path of `index.json` is given back, which
    has captions, source, frames, split and weight of each clip.

    One file a clip, written whole or not at all, so a second run goes on where the first one stopped.

    Raises:
        FormatError: The archive cannot be read or the folder cannot be written.
    """
    archive, out = MotionArchive.open(source), Path(out)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FormatError(out, f"the folder cannot be made ({error.strerror}); choose another") from error
    remove_leftovers(out)
    todo = [index for index, name in enumerate(archive.names) if not (out / f"{name}.npz").is_file()]
    lengths = np.diff(archive.bounds)
    total, done = int(lengths.sum()), int(lengths.sum() - lengths[todo].sum())
    report = progress or (lambda stage, share: None)
    slopes: dict[str, float] = {}
    if todo:
        pitches = []
        for index, name in enumerate(archive.names):
            pitches.append((name, standing_foot_pitch(unrolled(archive.motion(index)))))
            report("measuring feet", (index + 1) / len(archive.names))
        slopes = subject_pitches(pitches)
    report("converting motions", done / total)
    jobs = jobs or os.cpu_count() or 1
    if jobs == 1 or len(todo) < 8:
        for batch in _batches(archive, todo):
            done += _convert(archive, batch, out, slopes)
            report("converting motions", done / total)
    else:
        with Pool(jobs, _start_worker, (str(source),)) as pool:
            for future in as_completed([pool.submit(_work, batch, out, slopes) for batch in _batches(archive, todo)]):
                done += future.result()
                report("converting motions", done / total)
    watched = load_watched(source, {name: int(length) for name, length in zip(archive.names, lengths, strict=True)})
    entries = {}
    for i, name in enumerate(archive.names):
        clip = archive.clips.get(name, {})
        entries[name] = {
            "texts": clip.get("texts") or [], "source": clip.get("source", ""), "licence": clip.get("licence", ""),
            "frames": int(lengths[i]), "split": split_of(name), "weight": clip_weight(name, clip.get("flags") or []),
        }  # fmt: skip
        if name in watched:
            motion, bottom = load_clip(out / f"{name}.npz"), load_lowest(out / f"{name}.npz")
            origin = source_of(name)
            moves = between_held_poses(motion) if origin is not None and origin.holds_ends else None
            entries[name]["stretches"] = [checked(stretch, motion, bottom, moves) for stretch in watched[name]]
            report("checking captions", (i + 1) / len(archive.names))
    return write_index(out, entries)


def clip_weight(name: str, flags: Sequence[str]) -> float:
    """How often to draw a clip: as its source says, and less where its caption tells more than it shows, or the body
    rides what is not there.
    """
    source = source_of(name)
    doubted = any("partial" in flag or flag.startswith("rides") for flag in flags)
    return (source.weight if source is not None else 1.0) * (0.5 if doubted else 1.0)


def checked(
    stretch: Stretch, motion: HandleMotion, lowest: np.ndarray, moves: tuple[int, int] | None = None
) -> dict[str, Any]:
    """A stretch for the index: without the T-pose, or the pose held at the ends of its take, that it may start or end
    in, and with the fault that keeps it from training, if it has one.

    Args:
        stretch: As it was watched.
        motion: The take.
        lowest: The body's lowest point over the ground in each frame [m], shape (N,).
        moves: First frame and frame after the last of what lies between the poses held at the ends of the take; None
            where its source holds none.
    """
    start, stop = stretch.start, stretch.stop
    if moves is not None:
        start, stop = max(start, moves[0]), min(stop, moves[1])
    posed = t_pose(motion) if "T-pose" in stretch.note else np.zeros(len(motion), bool)
    while start < stop and posed[start]:
        start += 1
    while stop > start and posed[stop - 1]:
        stop -= 1
    part = slice(start, stop)
    fault = stretch.fault
    if stop - start < FEWEST:
        fault = fault or ("nothing but a pose that is held" if moves is not None else "nothing but a T-pose")
        return {"start": stretch.start, "stop": stretch.stop, "texts": list(stretch.texts), "fault": fault}
    fault = fault or ("a T-pose in the middle" if posed[part].any() else None)
    fault = fault or posture_fault(list(stretch.texts), motion.root_translation[part, 1], lowest[part])
    said = {"start": start, "stop": stop, "texts": list(stretch.texts), "asked": list(stretch.asked)}
    return said | ({"fault": fault} if fault else {})


def between_held_poses(motion: HandleMotion) -> tuple[int, int]:
    """First frame and frame after the last of a take without the poses held at its ends, but for 0.25 s of each."""
    first, last = (_still(motion, end) for end in (0, len(motion) - 1))
    start = int(np.argmin(first)) if not first.all() else len(motion)
    stop = len(motion) - int(np.argmin(last[::-1])) if not last.all() else 0
    return max(start - HELD_MARGIN, 0), min(stop + HELD_MARGIN, len(motion))


def _still(motion: HandleMotion, frame: int) -> np.ndarray:
    """Frames whose pose is that of one frame, but for breath and noise, shape (N,), bool."""
    angle = np.einsum("nkij,kij->nk", motion.rotations, motion.rotations[frame])  # 3 where alike
    moved = np.linalg.norm(motion.root_translation - motion.root_translation[frame], axis=1)
    turned = np.einsum("nij,ij->n", motion.root_rotation, motion.root_rotation[frame])
    near = 1 + 2 * np.cos(HELD_TURN)
    return np.asarray((angle > near).all(axis=1) & (turned > near) & (moved < HELD_WAY))


def t_pose(motion: HandleMotion) -> np.ndarray:
    """Frames in which both arms are stretched out to the sides as in the rest pose, shape (N,), bool."""
    parts = [HANDLE_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("shoulder", "elbow")]
    turned = np.einsum("nkii->nk", motion.rotations[:, parts])  # 3 at rest
    return np.asarray((turned > 1 + 2 * np.cos(np.radians(22))).all(axis=1))


# The shipped denoiser was trained on data made with these.
WINDOWS = (50, 70)  # frames
LEAST, MOST, FARTHEST = 2.5, 3.9, 0.9  # rad, rad, m
MARGIN = 6  # frames kept before and after
_WALKS = ("walk", "turn", "stand", "push", "stop")
_OTHERS = (
    "dance", "jete", "pirouette", "wheel", "ball", "tennis", "jump", "hop", "climb", "sit", "pick", "uneven", "spiral",
    "playground",
)  # fmt: skip


def find_turn(motion: HandleMotion) -> tuple[int, int, float] | None:
    """The stretch with the largest change of heading and the smallest move, if there is one.

    Returns:
        First frame, frame after the last, and the change of heading [rad], positive to the left; None without a turn.
    """
    angle = heading(motion.root_rotation, motion.fps)
    path = motion.root_translation[:, [0, 2]]
    best: tuple[float, int, int, float] | None = None
    for window in WINDOWS:
        for start in range(0, len(angle) - window, 5):
            change = float(angle[start + window - 1] - angle[start])
            if LEAST < abs(change) < MOST:
                moved = float(np.ptp(path[start : start + window], axis=0).max())
                cost = moved - 0.3 * abs(change)
                if moved < FARTHEST and (best is None or cost < best[0]):
                    best = (cost, start, start + window, change)
    return best and best[1:]


def add_turns(out: str | Path) -> list[str]:
    """Cut the turns out of the training clips that `build_motions` wrote, add them to the index, and give their names.

    Raises:
        FormatError: The index or a clip is missing or broken.
    """
    out = Path(out)
    clips = load_index(out)
    added = {}
    for name, entry in list(clips.items()):
        if name.startswith("turn_"):
            del clips[name]  # of an earlier run; made again below
            continue
        text = " ".join(entry["texts"]).lower()
        if (
            entry["split"] != "train"
            or not any(word in text for word in _WALKS)
            or any(word in text for word in _OTHERS)
        ):
            continue
        motion = load_clip(out / f"{name}.npz")
        found = find_turn(motion)
        if found is None:
            continue
        start, stop, change = found
        clip = motion.take(slice(max(start - MARGIN, 0), stop + MARGIN))
        write_clip(out / f"turn_{name}.npz", clip)
        caption = f"a person turns around to the {'left' if change > 0 else 'right'}"
        kept = {key: value for key, value in entry.items() if key != "stretches"}
        added[f"turn_{name}"] = kept | {"texts": [caption], "frames": len(clip)}
    write_index(out, clips | added)
    return list(added)
