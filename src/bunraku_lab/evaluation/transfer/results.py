"""Another method's results in the table of motion transfer: the pairs of character and motion go out as a CSV, animated
files come back, `CHARACTER/walk.glb` and so on.

Measured is what is measured of ours on rigs: how far limbs point from where the source's limbs point, between the same
two bones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.errors import BunrakuError, FormatError
from bunraku.geometry.axes import upright_rotation
from bunraku.retarget.rig_parts import RigParts
from bunraku_lab.evaluation.asked import write_asked
from bunraku_lab.evaluation.transfer.character import STRIDE, CharacterRow, Source, limb_angles, named_front

__all__ = ["SUFFIXES", "Pair", "measure_results", "pairs_of", "result_angle", "write_pairs"]

SUFFIXES = (".glb", ".gltf", ".vrm", ".fbx")


@dataclass(frozen=True)
class Pair:
    """A character that plays a motion.

    Args:
        name: Of the character: its path in the folder, without suffix.
        kind: Of the motion.
        character: Its file.
        motion: The motion's file.
    """

    name: str
    kind: str
    character: Path
    motion: Path

    @property
    def file(self) -> str:
        """Where its result is looked for in a folder of results, without suffix."""
        return f"{self.name}/{self.kind}"


def pairs_of(characters: Mapping[Path, str], motions: Mapping[str, Path]) -> list[Pair]:
    """All pairs.

    Args:
        characters: Names of the characters by their files.
        motions: Files of the motions by their kinds.
    """
    return [
        Pair(name, kind, path, motion) for path, name in characters.items() for kind, motion in motions.items()
    ]  # fmt: skip


def write_pairs(path: str | Path, pairs: Iterable[Pair]) -> Path:
    """Write what another method is to make: columns file, character and motion.

    Raises:
        FormatError: The file cannot be written.
    """
    rows = ([pair.file, pair.character, pair.motion] for pair in pairs)
    return write_asked(path, ("file", "character", "motion"), rows)


def measure_results(
    folder: str | Path, pairs: Sequence[Pair], sources: Mapping[str, Source], rows: Sequence[CharacterRow],
    failed: dict[str, str], progress: Callable[[str, float], None] | None = None,
) -> dict[str, float | None]:  # fmt: skip
    """What another method's results are worth; all None where there is none.

    Args:
        folder: Animated files, named as `write_pairs` says.
        pairs: The pairs.
        sources: Motions by their kinds.
        rows: What was measured of ours, for the same characters.
        failed: Gets the reasons why single files cannot be measured.
        progress: Called with a stage's name and the share done.

    Returns:
        `results`, the share of the pairs that came back and can be played; `angle_results` [degrees], the mean over
        people's rigs; `angle_rig_there`, ours on rigs of the same characters.

    Raises:
        FormatError: No file of the folder is named as one of the pairs.
    """
    folder = Path(folder)
    files = {pair: file for pair in pairs if (file := _file(folder, pair)) is not None}
    if not files:
        raise FormatError(
            folder, f"it holds no result, such as {pairs[0].file}.glb; --pairs-to writes how each is to be named"
        )
    played, angles = 0, dict[str, list[float]]()
    for number, (pair, file) in enumerate(files.items()):
        if progress:
            progress("results", number / len(files))
        try:
            angle = result_angle(file, pair.name, sources[pair.kind])
        except BunrakuError as error:
            failed[f"result {pair.file}"] = str(error)
            continue
        played += 1
        if angle is not None:
            angles.setdefault(pair.name, []).append(angle)
    ours = [row["angle_rig"] for row in rows if row["name"] in angles and "angle_rig" in row]
    means = [float(np.mean(found)) for found in angles.values()]
    return {
        "results": played / len(pairs),
        "angle_results": float(np.mean(means)) if means else None,
        "angle_rig_there": float(np.mean(ours)) if ours else None,
    }


def result_angle(path: Path, name: str, source: Source) -> float | None:
    """Mean angle between the limbs of a result and of its source [degrees], as long as both last; None where the rig is
    nobody's that goes on two legs.

    Args:
        path: A character with a clip.
        name: Of the character, by which known rigs are told.
        source: The motion that it plays.

    Raises:
        FormatError: The file cannot be read, or holds no clip.
    """
    from bunraku.io.play import bones_of, load_animation

    animation = load_animation(path, 0, source.motion.fps)
    try:
        parts = RigParts.of(animation.character)
    except BunrakuError:
        return None
    if not parts.humanoid:
        return None
    frames = np.arange(0, min(len(animation.motion), len(source.motion)), STRIDE)
    _, heads = bones_of(animation)
    turn = upright_rotation("+y", named_front(animation.character, name))
    own = heads[frames][:, np.maximum(parts.leads, 0)] @ turn.T
    return float(limb_angles(parts, own, source.joints[frames]).mean())


def _file(folder: Path, pair: Pair) -> Path | None:
    return next((file for suffix in SUFFIXES if (file := folder / f"{pair.file}{suffix}").is_file()), None)
