"""Mixed work in one process for as long as is asked, and what memory it holds.

python tests/soak/soak.py --minutes 60    the last line tells; the exit status is 1 where memory grew by more than 5 %
"""

from __future__ import annotations

import argparse
import gc
import itertools
import random
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import bunraku
from bunraku.core.character import Character
from bunraku.errors import BunrakuError
from bunraku.files import save_character
from bunraku.files.samples import sample_character, sample_names
from bunraku.render import save_preview, save_still

PROMPTS = (
    "a person walks forward", "jumps, then waves with the left hand", "dances", "kicks:1; turns around:1",
    "a man runs while clapping", "sits down", "crawls", "bows slowly",
)  # fmt: skip
GROWTH = 0.05


def resident() -> float:
    """Memory that this process holds [MB]."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096 / 1e6


def work(folder: Path, chance: random.Random) -> Iterator[tuple[str, Callable[[], object]]]:
    """One thing after the other, for ever."""
    characters: dict[str, Character] = {}
    for turn in itertools.count():
        name = chance.choice(sample_names())
        if name not in characters:
            characters[name] = sample_character(name)
        character, prompt = characters[name], chance.choice(PROMPTS)
        seconds = chance.uniform(0.5, 3)
        made: list[bunraku.AnimatedCharacter] = []

        def animate(character=character, prompt=prompt, seconds=seconds, seed=turn, made=made) -> None:
            made.append(bunraku.animate(character, prompt, seconds=seconds, seed=seed, candidates=1 + seed % 3))
            made[0].save(folder / "a.glb")

        def preview(made=made, suffix=(".mp4", ".webp", ".png")[turn % 3]) -> None:
            save_preview(made[0], folder / f"p{suffix}", size=(160, 120))

        yield "animate", animate
        yield "preview", preview
        yield "edit", lambda made=made, prompt=prompt: bunraku.edit(made[0], prompt, keep="legs")
        yield "transfer", lambda made=made, character=character: bunraku.transfer(character, made[0].motion)
        yield "still", lambda character=character: save_still(character, folder / "s.png", size=(120, 120))
        path = folder / "c.glb"

        def there_and_back(character=character, path=path) -> None:
            save_character(character, path)
            bunraku.load_character(path)

        yield "files", there_and_back

        at, byte = chance.random(), chance.randrange(256)

        def broken(path=path, at=at, byte=byte) -> None:
            data = bytearray(path.read_bytes())
            data[int(at * len(data))] = byte
            path.write_bytes(data[: int(len(data) * (0.5 + at / 2))])
            with suppress(BunrakuError):
                bunraku.load_character(path)

        yield "broken file", broken


def soak(seconds: float, seed: int = 0, tell: Callable[[str], None] = print) -> tuple[int, float, float]:
    """Work for so long.

    Returns:
        How many things were done, and the most memory [MB] held in the first sixth of the time, when every kind of work
        has been done, and in the last.
    """
    done, start, samples = 0, time.monotonic(), []
    next_line = 60.0
    with tempfile.TemporaryDirectory(prefix="bunraku-soak-") as name:
        for what, call in work(Path(name), random.Random(seed)):
            try:
                call()
            except BunrakuError as error:
                tell(f"{what}: {error}")
            done += 1
            gc.collect()
            passed = time.monotonic() - start
            samples.append((passed, resident()))
            if passed > next_line:
                tell(f"{passed / 60:.0f} min: {done} done, {samples[-1][1]:.0f} MB")
                next_line += 60
            if passed > seconds:
                break
    first = max(memory for at, memory in samples if at <= max(passed / 6, samples[0][0]))
    last = max(memory for at, memory in samples if at >= passed * 5 / 6)
    return done, first, last


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    done, first, last = soak(60 * options.minutes, options.seed, lambda line: print(line, flush=True))
    grown = last / first - 1
    print(
        f"{done} things in {options.minutes:g} minutes; most memory in the first sixth {first:.0f} MB, in the last "
        f"{last:.0f} MB ({100 * grown:+.1f} %)"
    )
    return int(grown > GROWTH)


if __name__ == "__main__":
    sys.exit(main())
