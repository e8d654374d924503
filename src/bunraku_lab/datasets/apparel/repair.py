"""`bunraku data push-out`: data that were simulated before the simulation ended with a push out of the body, repaired
into a new folder without being simulated again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.errors import BunrakuError, FormatError
from bunraku.formats.files import atomic_write, sweep
from bunraku.nn.spread import spread
from bunraku_lab.datasets.apparel.reader import INDEX, read_index
from bunraku_lab.datasets.apparel.shards import LATER_ARRAYS, SHARD_ARRAYS, Shard, write_shard

__all__ = ["RepairState", "repair_apparel", "repair_shard", "pushed_out_clips"]

LOOKED_AT = 6  # frames of a shard whose insides are measured


@dataclass
class RepairState:
    """How far it is.

    Args:
        shards: How many there are.
        done: How many are repaired, now or before.
        inside: Share of the apparel deeper than 1 cm in the body: rigid, before and after, of each shard.
        failed: What went wrong, by the names of shards.
    """

    shards: int
    done: int = 0
    inside: list[list[float]] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)


def pushed_out_clips(
    clothed: ClothedCharacter,
    transforms: np.ndarray,
    loose: np.ndarray,
    offsets: np.ndarray,
    clips: Sequence[Mapping[str, Any]],
) -> np.ndarray:
    """The offsets of a character's clips with its apparel out of its body, shape (N, M, 3).

    Args:
        clothed: The character.
        transforms, loose, offsets: As of `Recording`.
        clips: Where each begins ("first") and how long it is ("frames").
    """
    from bunraku_lab.datasets.apparel.push_out import PushOut

    push = PushOut(clothed)
    spans = [slice(clip["first"], clip["first"] + clip["frames"]) for clip in clips]
    return np.concatenate([push(transforms[span], loose, offsets[span]) for span in spans])


def unclothed(
    rest: np.ndarray, faces: np.ndarray, joints: np.ndarray, weights: np.ndarray, apparel: np.ndarray, part: np.ndarray
) -> ClothedCharacter:
    """A clothed character of whose springs nothing is said."""
    none = np.zeros(int(part.max(initial=-1)) + 1, np.float32)
    return ClothedCharacter(rest, faces, joints, weights, apparel.astype(bool), part, none, none)


def repair_apparel(
    source: str | Path,
    folder: str | Path,
    *,
    jobs: int | str = 1,
    progress: Callable[[RepairState], None] | None = None,
) -> RepairState:
    """Push the apparel of a data set out of the bodies, into another folder; what is there already stays.

    Args:
        source: Folder of the data set.
        folder: Folder to write to, made when it is not there.
        jobs: How many processes, or "ray".
        progress: Called after every shard.

    Raises:
        FormatError: There is no data set, or the folder cannot be written.
        MissingExtraError: ray is not installed.
    """
    source, folder = Path(source).resolve(), Path(folder).resolve()
    index = read_index(source)
    try:
        (folder / "shards").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FormatError(folder, f"the folder cannot be made ({error.strerror}); choose another") from error
    sweep(folder / "shards")
    names = list(index["shards"])
    state = RepairState(len(names))
    todo = [name for name in names if not _inside(folder, name)]
    for shard, problem in spread(partial(_repair_batch, source, folder), [[name] for name in todo], jobs, str):
        if problem:
            state.failed[shard] = problem
        state.done = sum(bool(_inside(folder, name)) for name in names)
        if progress:
            progress(state)
    found = {name: _inside(folder, name) for name in names}
    state.inside = [inside for inside in found.values() if inside]
    state.done = len(state.inside)
    kept = {name: entry for name, entry in index["shards"].items() if found[name]}
    with atomic_write(folder / INDEX) as file:
        file.write(json.dumps(index | {"shards": kept}, indent=1).encode())
    return state


def _repair_batch(source: Path, folder: Path, names: list[str]) -> list[str]:
    return [repair_shard(source, folder, name) for name in names]


def _inside(folder: Path, name: str) -> list[float]:
    """What a repaired shard says of its insides, [] where there is none."""
    try:
        found = Shard(_path(folder, name)).facts.get("inside")
    except FormatError:
        return []
    return [float(share) for share in found] if isinstance(found, list) and len(found) == 3 else []


def _path(folder: Path, name: str) -> Path:
    return folder / "shards" / f"{Path(name).name}.safetensors"


def repair_shard(source: Path, folder: Path, name: str) -> str:
    """Repair one shard.

    Returns:
        "" when it is written, otherwise what went wrong.
    """
    from bunraku_lab.datasets.apparel.push_out import inside_shares

    try:
        shard = Shard(_path(source, name))
        arrays = {key: shard.array(key) for key in (*SHARD_ARRAYS, *LATER_ARRAYS) if key in shard.names}
        if not all(np.isfinite(array).all() for array in arrays.values()):
            raise FormatError(shard.path, "it holds values that are not numbers; build it again")
        clothed = unclothed(
            arrays["rest"], arrays["faces"], arrays["joints"], arrays["weights"], arrays["apparel"], arrays["part"]
        )
        transforms, loose, before = arrays["transforms"], arrays["loose"], arrays["offsets"]
        after = before
        if shard.facts.get("pushed_out") is not True:
            after = pushed_out_clips(clothed, transforms, loose, before, shard.facts["clips"])
        some = np.linspace(0, len(before) - 1, min(LOOKED_AT, len(before))).astype(np.int64)
        inside = inside_shares(clothed, transforms[some], loose, before[some], after[some])
        write_shard(
            _path(folder, name), arrays | {"offsets": after}, shard.facts | {"pushed_out": True, "inside": list(inside)}
        )
    except (BunrakuError, IndexError) as error:
        return str(error)
    return ""
