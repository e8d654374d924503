"""How long the studio takes from a sentence to a take, over the library's own time; and its memory over many takes.

    python benchmarks/studio.py [--rounds 5] [--takes 50]

The two are timed in turns, so that what else the machine does falls on both, by the clock and in processor time.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.character import Character, Handles
from bunraku.diffusion.generation.drawing import GUIDANCE, STEPS
from bunraku.io import load_character
from bunraku.pipelines.animate import animate, generate, rig
from bunraku.pipelines.apply import apply_motion
from bunraku.studio.tasks.making import DRAFT_STAGES, DRAFT_STEPS

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "studio"))

from conftest import Studio

PROMPT, SECONDS = "walks forward and waves", 4.0
PAUSE = 0.02
"""Seconds between two questions."""


def resident(process: int) -> float:
    """Memory of a process [MB]."""
    text = Path(f"/proc/{process}/status").read_text()
    return int(text.partition("VmRSS:")[2].split()[0]) / 1e3


def processor(process: int) -> float:
    """Processor time of a process [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Times:
    """Seconds of a draft and of a full take, by the clock and of the processor."""

    draft: float
    full: float
    draft_work: float
    full_work: float


def studio_times(studio: Studio, character: str, seed: int) -> Times:
    """From the request to the clips of the draft and of the full take, by asking what has changed, as a page does."""
    worker = studio.get("/api/about")["worker"]["process"]
    event = studio.get("/api/about")["event"]
    start, work = time.perf_counter(), processor(worker) + processor(studio.process.pid)
    made = studio.post(
        f"/api/characters/{character}/takes",
        {"script": [{"text": PROMPT, "seconds": SECONDS}], "seeds": [seed], "steps": STEPS, "guidance": GUIDANCE},
    )
    found: dict[str, tuple[float, float]] = {}
    while "done" not in found:
        answer = studio.get(f"/api/changes?after={event}")
        event = answer["event"]
        for what, said in answer["changes"]:
            if what == "take" and said["id"] == made["takes"][0] and said["state"] in ("draft", "done"):
                studio.ask("GET", f"/api/takes/{said['id']}/clip")
                spent = processor(worker) + processor(studio.process.pid) - work
                found.setdefault(said["state"], (time.perf_counter() - start, spent))
        time.sleep(PAUSE)
    return Times(found["draft"][0], found["done"][0], found["draft"][1], found["done"][1])


def library_times(character: Character, handles: Handles, seed: int) -> Times:
    """What a draft and a full take cost without the studio."""
    start, work = time.perf_counter(), time.process_time()
    motion = generate(
        PROMPT, seconds=SECONDS, seed=seed, steps=DRAFT_STEPS, candidates=1, mesh_feature=handles.features
    )
    apply_motion(motion, Anatomy.of(character, handles), stages=DRAFT_STAGES)
    draft = time.perf_counter() - start, time.process_time() - work
    start, work = time.perf_counter(), time.process_time()
    animate(character, PROMPT, seconds=SECONDS, seed=seed, handles=handles)
    return Times(draft[0], time.perf_counter() - start, draft[1], time.process_time() - work)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--takes", type=int, default=0, help="so many takes are queued, and memory is told")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        studio = Studio(Path(folder) / "studio")
        try:
            studio.until(lambda: studio.get("/api/about")["worker"]["warm"], "a warm worker")
            record = studio.get("/api/characters")["characters"][0]
            source = next((studio.folder / "characters" / record["id"] / "source").iterdir())
            character = load_character(source)
            handles = rig(character)
            rounds = []
            for seed in range(options.rounds + 1):
                library, ours = library_times(character, handles, seed), studio_times(studio, record["id"], seed)
                if seed:  # the first round warms both up
                    rounds.append((ours, library))
            print(f"{len(character.vertices):,} vertices, {SECONDS:g} s; medians of {options.rounds} rounds")
            for name in ("draft", "full", "draft_work", "full_work"):
                pairs = [(getattr(ours, name), getattr(library, name)) for ours, library in rounds]
                mine, theirs = (statistics.median(column) for column in zip(*pairs, strict=True))
                ratio = statistics.median(one / other for one, other in pairs)
                print(f"{name}: studio {mine:.2f} s, library {theirs:.2f} s, ratio {ratio:.2f}")
            if options.takes:
                queued(studio, record["id"], options.takes)
        finally:
            studio.stop()


def queued(studio: Studio, character: str, count: int) -> None:
    """Queue takes and tell the memory of server and worker after every ten."""
    jobs = [studio.animate(character, "waves", seconds=2, seeds=[seed])["job"] for seed in range(count)]
    for number, job in enumerate(jobs, 1):
        studio.done(job)
        if number % 10 == 0:
            worker = studio.get("/api/about")["worker"]["process"]
            print(f"{number} takes: server {resident(studio.process.pid):.0f} MB, worker {resident(worker):.0f} MB")


if __name__ == "__main__":
    main()
