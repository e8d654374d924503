"""Human motions as handle motions: `bunraku data motions`.

Reads the packed motion archive (`motions.npz` with `motions.json` beside it), poses the reference body with each clip and
converts the moving mesh to handle motion by weighted rigid registration (Besl & McKay 1992; sections 3.2 and A.2 of TapMo).
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.bodies.layout import JOINT_NAMES
from bunraku.bodies.reference import ReferenceBody, handle_positions, reference_body
from bunraku.datasets.feet import level_feet, standing_foot_pitch, subject_pitches
from bunraku.datasets.hinges import unrolled
from bunraku.diffusion.clips import write_clip, write_index
from bunraku.errors import FormatError
from bunraku.geometry.areas import vertex_areas
from bunraku.geometry.registration import register
from bunraku.geometry.rotations import matrix_from_quaternion
from bunraku.motion import HandleMotion, SkeletalMotion, Skeleton

__all__ = ["MotionArchive", "build_motions", "handle_motion_of_body", "handle_motion_of_mesh", "split_of"]

QUATERNION_STEP = 8192.0  # the archive stores first differences of round(8192 q)
CHUNK = 400  # frames posed at once: bounds memory at about 30 MB a worker


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
                raise FormatError(file, "there is no such file; give the folder that holds motions.npz and motions.json")
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
            raise FormatError(path, f"cannot be read as a motion archive ({type(error).__name__}); copy it again") from error

    def motion(self, index: int) -> SkeletalMotion:
        """One clip as skeletal motion at 20 frames a second."""
        start, end = int(self.bounds[index]), int(self.bounds[index + 1])
        planes = self._planes[:, :, start:end]
        deltas = np.ascontiguousarray(planes.transpose(1, 2, 0)).view(np.int16)[..., 0]
        quaternions = np.cumsum(deltas.astype(np.int32), axis=1).T.reshape(-1, len(JOINT_NAMES), 4) / QUATERNION_STEP
        skeleton = Skeleton(JOINT_NAMES, self._parents, self._offsets[index])
        return SkeletalMotion(skeleton, matrix_from_quaternion(quaternions[..., [1, 2, 3, 0]]), self._root[start:end], 20.0)


def handle_motion_of_mesh(
    rest: np.ndarray, posed: np.ndarray, weights: np.ndarray, positions: np.ndarray, areas: np.ndarray, fps: float
) -> HandleMotion:
    """Handle motion of a mesh that moves, by weighted rigid registration (section A.2).

    The root handle's motion is the global one; it is taken off before the other handles are registered, so theirs are local.

    Args:
        rest: Rest vertices [m], shape (V, 3).
        posed: Moved vertices of each frame [m], shape (N, V, 3).
        weights: Handle weights, shape (V, K).
        positions: Handle positions [m], shape (K, 3).
        areas: Surface area that each vertex stands for, shape (V,).
        fps: Frames a second [1/s].

    Returns:
        The motion; handles without weight stay at the identity.
    """
    mass = weights * areas[:, None]
    rotations, translations = register(rest, posed, mass[:, :1], positions[:1])
    root_rotation, root_translation = rotations[:, 0], translations[:, 0]
    local = np.einsum("nji,nvj->nvi", root_rotation, posed - positions[0] - root_translation[:, None]) + positions[0]
    rotations, translations = register(rest, local, mass, positions)
    still = mass.sum(axis=0) <= 1e-6 * areas.sum()
    still[0] = True
    rotations[:, still], translations[:, still] = np.eye(3), 0
    return HandleMotion(translations, rotations, root_translation, root_rotation, fps)


def handle_motion_of_body(motion: SkeletalMotion, body: ReferenceBody | None = None) -> HandleMotion:
    """Skeletal motion of SMPL's joints as handle motion of the reference body.

    The body is set on the ground: the clip is moved along Y so that the lowest point of its standing frames (5 % quantile) is at 0,
    unless that is more than 15 cm away, where the clip means to be off the ground.
    """
    body = body or reference_body()
    areas = vertex_areas(body.vertices, body.faces)
    positions = handle_positions(body.vertices, body.handle_weights, areas)
    parts, lowest = [], []
    for start in range(0, len(motion), CHUNK):
        cut = slice(start, start + CHUNK)
        posed = body.pose(SkeletalMotion(motion.skeleton, motion.rotations[cut], motion.root_translation[cut], motion.fps))
        lowest.append(posed[..., 1].min(axis=1))
        parts.append(handle_motion_of_mesh(body.vertices, posed, body.handle_weights, positions, areas, motion.fps))
    floor = float(np.quantile(np.concatenate(lowest), 0.05))
    drop = np.array([0, floor if abs(floor) < 0.15 else 0, 0], np.float32)
    whole = HandleMotion.joined(parts)
    return replace(whole, root_translation=whole.root_translation - drop)


def split_of(name: str) -> str:
    """The split of a clip, fixed for ever by its name: 6 % "test", 3 % "val", the rest "train"."""
    number = int(hashlib.sha256(name.encode()).hexdigest()[:8], 16) % 100
    return "test" if number < 6 else "val" if number < 9 else "train"


def _convert(archive: MotionArchive, indices: list[int], out: Path, slopes: dict[str, float]) -> int:
    for index in indices:
        name = archive.names[index]
        write_clip(out / f"{name}.npz", handle_motion_of_body(level_feet(unrolled(archive.motion(index)), name, slopes)))
    return sum(int(archive.bounds[index + 1] - archive.bounds[index]) for index in indices)


_ARCHIVE: MotionArchive | None = None


def _start_worker(source: str) -> None:
    global _ARCHIVE
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
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


def build_motions(source: str | Path, out: str | Path, jobs: int | None = None, progress: Callable[[str, float], None] | None = None) -> Path:
    """Convert every clip of the archive to handle motion of the reference body.

    One file a clip, written whole or not at all, so a second run goes on where the first one stopped.

    Args:
        source: Folder with `motions.npz` and `motions.json`.
        out: Folder for the clips and `index.json` (captions, source, frames, split and weight of each clip).
        jobs: Processes; the number of cores when None.
        progress: Called with a stage's name and the share done.

    Returns:
        Path of `index.json`.

    Raises:
        FormatError: The archive cannot be read or the folder cannot be written.
    """
    archive, out = MotionArchive.open(source), Path(out)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FormatError(out, f"the folder cannot be made ({error.strerror}); choose another") from error
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
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_start_worker, initargs=(str(source),)) as pool:
            for future in as_completed([pool.submit(_work, batch, out, slopes) for batch in _batches(archive, todo)]):
                done += future.result()
                report("converting motions", done / total)
    entries = {
        name: {
            "texts": clip.get("texts") or [],
            "source": clip.get("source", ""),
            "licence": clip.get("licence", ""),
            "frames": int(lengths[i]),
            "split": split_of(name),
            "weight": 0.5 if any("partial" in flag for flag in clip.get("flags") or []) else 1.0,
        }
        for i, (name, clip) in enumerate((name, archive.clips.get(name, {})) for name in archive.names)
    }
    return write_index(out, entries)
