"""What the apparel data set is made of, before anything is computed: characters, motions, splits and shards.

The split of a character or a motion is fixed by its name. Characters of a split meet motions of the same split only, so
that a test clip has a character and a motion that no training clip has.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.files import check_input
from bunraku.errors import FormatError, OptionError

FPS = 30.0
SPLITS = ("train", "val", "test")
SHARD_FRAMES = 3600
"""A shard is closed before it has more frames: two minutes, some 100 MB, which is what a kill can cost."""
SHORTEST = 2.0  # clip [s]
LONG_ENOUGH = 4.0  # motion [s]
_MOTIONS = (".bvh", ".vmd", ".npz", ".npy", ".glb", ".gltf", ".fbx", ".vrma")
_CHARACTERS = (".pmx", ".pmd", ".vrm", ".glb")


@dataclass(frozen=True)
class CharacterSource:
    """A character: of the wardrobe by its seed, or a file.

    Args:
        name: Its name in the data set.
        split: "train", "val" or "test".
        seed: Of the wardrobe, -1 for a file.
        path: The file, "" for the wardrobe.
        digest: Of the file's content.
        clothes: Folder of MakeHuman clothes for the wardrobe, "" for none.
        body_data: Folder of MakeHuman's body for them, "" for the installed one.
    """

    name: str
    split: str
    seed: int = -1
    path: str = ""
    digest: str = ""
    clothes: str = ""
    body_data: str = ""


@dataclass(frozen=True)
class MotionSource:
    """A motion file.

    Args:
        name: Its name in the data set.
        split: As above.
        path: The file.
        seconds: Its length [s].
        digest: Of its content.
        clip: Whether it is a clip that `bunraku data motions` wrote.
    """

    name: str
    split: str
    path: str
    seconds: float
    digest: str
    clip: bool


@dataclass(frozen=True)
class ClipPlan:
    """A part of a motion.

    Args:
        motion: Which.
        start: Where it begins [s].
        seconds: Its length [s].
    """

    motion: MotionSource
    start: float
    seconds: float


@dataclass(frozen=True)
class ShardPlan:
    """A file of the data set: some clips of one character."""

    character: CharacterSource
    part: int
    clips: tuple[ClipPlan, ...] = field(default_factory=tuple)

    @property
    def name(self) -> str:
        """Of its file, without a suffix."""
        return f"{self.character.name}-{self.part:02d}"

    @property
    def seconds(self) -> float:
        """Length of all clips [s]."""
        return sum(clip.seconds for clip in self.clips)

    def fingerprint(self) -> str:
        """A digest of what the shard is made of; a file with another one is built again. Folders do not count."""
        from bunraku import __version__

        facts = asdict(self)
        facts["character"].pop("path")
        facts["character"].pop("body_data")
        facts["character"]["clothes"] = bool(self.character.clothes)
        for clip in facts["clips"]:
            clip["motion"].pop("path")
        return hashlib.sha256(json.dumps([__version__, FPS, facts], sort_keys=True).encode()).hexdigest()[:32]


def _number(name: str) -> int:
    return int(hashlib.sha256(name.encode()).hexdigest()[:8], 16)


def character_split(name: str) -> str:
    """The split of a character, fixed for ever by its name: 12 % "test", 6 % "val", the rest "train"."""
    number = _number(f"apparel character {name}") % 100
    return "test" if number < 12 else "val" if number < 18 else "train"


def _motion_split(name: str) -> str:
    number = _number(f"apparel motion {name}") % 100
    return "test" if number < 10 else "val" if number < 15 else "train"


def wardrobe_sources(
    count: int, first: int = 0, clothes: str | Path | None = None, body_data: str | Path | None = None
) -> list[CharacterSource]:
    """Characters of the wardrobe by their seeds, which name them.

    Args:
        count: How many.
        first: Seed of the first.
        clothes, body_data: As `wardrobe_character` takes them.
    """
    names = [(seed, f"wardrobe_{seed:06d}") for seed in range(first, first + count)]
    return [
        CharacterSource(name, character_split(name), seed, clothes=str(clothes or ""), body_data=str(body_data or ""))
        for seed, name in names
    ]


def character_sources(paths: Iterable[str | Path]) -> list[CharacterSource]:
    """Character files, or all in folders that are named.

    Raises:
        FormatError: A file is missing, of a kind without physics, or a folder holds none.
        OptionError: Two have the same name.
    """
    out: list[CharacterSource] = []
    for given in map(Path, paths):
        files = [given]
        if given.is_dir():
            files = sorted(path for path in given.rglob("*") if path.suffix.lower() in _CHARACTERS)
            if not files:
                raise FormatError(given, "it holds no PMX, PMD or VRM file")
        for path in files:
            check_input(path)
            if path.suffix.lower() not in _CHARACTERS:
                raise FormatError(path, "characters with physics are PMX, PMD or VRM files")
            name = _plain(path.stem)
            if any(name.lower() == other.name.lower() for other in out):
                raise OptionError(
                    f"two characters are named '{name}'; names decide the split, so rename one of the files"
                )
            out.append(CharacterSource(name, character_split(name), path=str(path.resolve()), digest=_digest(path)))
    return out


def motion_sources(folder: str | Path, shortest: float = LONG_ENOUGH) -> list[MotionSource]:
    """The people's motions of a folder of `bunraku data motions`, whose index names the splits, or of motion files.

    Args:
        folder: Which.
        shortest: Motions under this length are passed over [s].

    Raises:
        FormatError: There is none, or the index is broken.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FormatError(
            folder, "there is no such folder; make it with `bunraku data motions`, or name one of BVH files"
        )
    if (folder / "index.json").is_file():
        out = _indexed(folder, shortest)
    else:
        out = []
        for path in sorted(folder.rglob("*")):
            if path.suffix.lower() in _MOTIONS and path.is_file():
                name = _plain(path.relative_to(folder).with_suffix("").as_posix())
                seconds = _length(path)
                if seconds >= shortest:
                    out.append(
                        MotionSource(name, _motion_split(name), str(path.resolve()), seconds, _digest(path), False)
                    )
    if not out:
        raise FormatError(
            folder,
            f"it holds no motion of a person of {shortest:g} s or more; name a folder of `bunraku data motions` or of "
            "BVH files",
        )
    return out


def _indexed(folder: Path, shortest: float) -> list[MotionSource]:
    from bunraku_lab.datasets.motions.clips import load_index

    out = []
    for name, entry in sorted(load_index(folder).items()):
        path, frames = folder / f"{name}.npz", entry.get("frames") if isinstance(entry, dict) else None
        if (
            not isinstance(frames, int)
            or frames / 20 < shortest
            or entry.get("species")
            or entry.get("character")
            or not path.is_file()
        ):
            continue
        split = entry.get("split")
        out.append(MotionSource(
            name, split if split in SPLITS else _motion_split(name), str(path.resolve()), frames / 20, "", True,
        ))  # fmt: skip
    return out


def _length(path: Path) -> float:
    """Length of a motion [s], 0 where it cannot be read."""
    from bunraku.errors import BunrakuError
    from bunraku.pipelines.to_reference import load_motion

    try:
        motion: Any = load_motion(path)
    except BunrakuError:
        return 0.0
    own = getattr(motion, "motion", motion)
    return float(len(own) / own.fps)


def choose_motions(motions: Sequence[MotionSource], count: int) -> list[MotionSource]:
    """So many motions, mixed: 10 % of "test", 5 % of "val" and the rest of "train", as far as there are any."""
    rows = {
        split: sorted((motion for motion in motions if motion.split == split), key=lambda motion: _number(motion.name))
        for split in SPLITS
    }
    wanted = {"test": max(1, round(count * 0.1)), "val": max(1, round(count * 0.05))}
    wanted["train"] = max(1, count - sum(min(wanted[split], len(rows[split])) for split in wanted))
    chosen = [motion for split in SPLITS for motion in rows[split][: wanted[split]]]
    rest = [motion for motion in sorted(motions, key=lambda motion: _number(motion.name)) if motion not in chosen]
    chosen += rest[: max(0, count - len(chosen))]
    return [motion if motion.digest else replace(motion, digest=_digest(Path(motion.path))) for motion in chosen]


def plan_shards(
    characters: Sequence[CharacterSource], motions: Sequence[MotionSource], *, minutes: float, longest: float = 12.0,
    seed: int = 0,
) -> tuple[list[ShardPlan], dict[str, str]]:  # fmt: skip
    """Which clips are made.

    Every character gets the same time. It meets the motions of its split in an order of its own, from a motion of its
    own on, so that all motions are used; a motion that is longer than a clip is cut at a place of its own.

    Args:
        characters: All.
        motions: All.
        minutes: Length of all clips together [min].
        longest: Longest clip [s].
        seed: Of the cuts.

    Returns:
        The shards, and why characters are left out, by their names.
    """
    rows = {split: [motion for motion in motions if motion.split == split] for split in SPLITS}
    usable = [character for character in characters if rows[character.split]]
    left = {
        character.name: f"no motion is of the split '{character.split}', which its name decides; give more motions"
        for character in characters
        if not rows[character.split]
    }
    out: list[ShardPlan] = []
    index = dict.fromkeys(SPLITS, 0)
    for character in usable:
        row, wanted, total = rows[character.split], minutes * 60 / len(usable), 0.0
        random = np.random.default_rng([seed, _number(character.name)])
        clips: list[ClipPlan] = []
        while total < wanted - SHORTEST / 2:
            motion = row[index[character.split] % len(row)]
            index[character.split] += 1
            frames = int(min(motion.seconds, longest, max(wanted - total, SHORTEST)) * FPS)
            start = int(random.integers(0, max(1, int(motion.seconds * FPS) - frames + 1)))
            clips.append(ClipPlan(motion, start / FPS, frames / FPS))
            total += frames / FPS
        parts: list[list[ClipPlan]] = [[]]
        for clip in clips:
            if parts[-1] and (sum(one.seconds for one in parts[-1]) + clip.seconds) * FPS > SHARD_FRAMES:
                parts.append([])
            parts[-1].append(clip)
        out += [ShardPlan(character, number, tuple(part)) for number, part in enumerate(parts)]
    return out, left


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:32]


def _plain(name: str) -> str:
    """A name that is a plain file name everywhere; letters of all scripts stay."""
    return re.sub(r"[^\w.-]+", "_", name).strip(".") or "unnamed"
