"""How long the studio takes from a sentence to a take, over the library's own time; and its memory over many takes.

    python benchmarks/studio.py [--rounds 5] [--takes 50]

The two are timed in turns, so that what else the machine does falls on both.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from pathlib import Path

from bunraku.io import load_character
from bunraku.pipelines.animate import animate, generate, rig
from bunraku.pipelines.apply import apply_motion
from bunraku.studio.tasks import DRAFT_STAGES, DRAFT_STEPS

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "studio"))

from conftest import Studio

PROMPT, SECONDS = "walks forward and waves", 4.0


def resident(process: int) -> float:
    """Memory of a process [MB]."""
    text = Path(f"/proc/{process}/status").read_text()
    return int(text.partition("VmRSS:")[2].split()[0]) / 1e3


def studio_times(studio: Studio, character: str, seed: int) -> tuple[float, float]:
    """Seconds from the request to the clip of the draft, and of the full take."""
    start = time.perf_counter()
    made = studio.post(
        f"/api/characters/{character}/takes",
        {"script": [{"text": PROMPT, "seconds": SECONDS}], "seeds": [seed], "steps": 20, "guidance": 3},
    )
    draft = 0.0
    while True:
        take = studio.get(f"/api/takes/{made['takes'][0]}")
        if take["state"] == "draft" and not draft:
            studio.ask("GET", f"/api/takes/{take['id']}/clip")
            draft = time.perf_counter() - start
        if take["state"] == "done":
            studio.ask("GET", f"/api/takes/{take['id']}/clip")
            return draft, time.perf_counter() - start
        time.sleep(0.03)


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
            drafts, takes = [], []
            for seed in range(options.rounds + 1):
                start = time.perf_counter()
                motion = generate(
                    PROMPT, seconds=SECONDS, seed=seed, steps=DRAFT_STEPS, candidates=1, mesh_feature=handles.features
                )
                apply_motion(motion, character, handles, stages=DRAFT_STAGES)
                draft = time.perf_counter() - start
                start = time.perf_counter()
                animate(character, PROMPT, seconds=SECONDS, seed=seed, handles=handles)
                full = time.perf_counter() - start
                ours = studio_times(studio, record["id"], seed)
                if seed:  # the first round warms both up
                    drafts.append((ours[0], draft))
                    takes.append((ours[1], full))
            print(f"{len(character.vertices):,} vertices, {SECONDS:g} s; medians of {options.rounds} rounds")
            for name, pairs in (("draft", drafts), ("full take", takes)):
                mine, library = (statistics.median(column) for column in zip(*pairs, strict=True))
                ratio = statistics.median(one / other for one, other in pairs)
                print(f"{name}: studio {mine:.2f} s, library {library:.2f} s, ratio {ratio:.2f}")
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
