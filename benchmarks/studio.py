"""How long the studio takes from a sentence to a take, over the library's own time; from words to a clip of the library
on a character; and its memory over many takes.

    python benchmarks/studio.py [--rounds 5] [--takes 50] [--clips 20] [--detail 0.5 1] [--subdivided]

The two are timed in turns, so that what else the machine does falls on both, by the clock and in processor time.
"""

from __future__ import annotations

import argparse
import os
import random
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
import trimesh

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.character import Character
from bunraku.files import load_character, save_character
from bunraku.generation.candidates import GUIDANCE, STEPS
from bunraku.pipelines.animate import animate, generate, rig
from bunraku.pipelines.apply import apply_motion
from bunraku.studio.takes import DRAFT_STAGES
from bunraku.studio.workspace import Settings, opened_character
from bunraku_lab.synthetic.samples import make_sample

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "studio"))

from studio_process import Studio

PROMPT, SECONDS = "walks forward and waves", 4.0
PAUSE = 0.1
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
    """Seconds of opening, of a draft and of a full take, by the clock and of the processor."""

    open: float
    draft: float
    full: float
    open_work: float
    draft_work: float
    full_work: float


def told(studio: Studio, event: int, wanted: Callable[[str, dict[str, Any]], bool]) -> int:
    """Ask what has changed, as a page does, until something that is wanted has; the number to ask with next."""
    while True:
        answer = studio.get(f"/api/changes?after={event}")
        event = answer["event"]
        if any(wanted(what, said) for what, said in answer["changes"]):
            return event
        time.sleep(PAUSE)


def studio_times(studio: Studio, file: Path, seed: int) -> Times:
    """From the request to the mesh with its skin, and to the clips of the draft and of the full take."""
    worker = studio.get("/api/about")["worker"]["process"]

    def spent() -> float:
        return processor(worker) + processor(studio.process.pid)

    event = studio.get("/api/about")["event"]
    start, work = time.perf_counter(), spent()
    opened = studio.post(f"/api/characters?name={file.name}", data=file.read_bytes())
    character = opened["character"]["id"]
    told(studio, event, lambda what, said: what == "character" and said["id"] == character and said["state"] == "ready")
    studio.ask("GET", f"/api/characters/{character}/mesh.glb")
    opening = time.perf_counter() - start, spent() - work
    studio.until(lambda: "ends" in studio.get(f"/api/characters/{character}"), "the rest of it")
    event = studio.get("/api/about")["event"]
    start, work = time.perf_counter(), processor(worker) + processor(studio.process.pid)
    made = studio.post(
        f"/api/characters/{character}/takes",
        {"script": [{"text": PROMPT, "seconds": SECONDS}], "seeds": [seed], "steps": STEPS, "guidance": GUIDANCE},
    )
    found: dict[str, tuple[float, float]] = {}
    states: list[str] = []

    def there(what: str, said: dict[str, Any]) -> bool:
        if what == "take" and said["id"] == made["takes"][0] and said["state"] in ("draft", "done"):
            states.append(said["state"])
        return bool(states)

    while "done" not in found:
        states.clear()
        event = told(studio, event, there)
        studio.ask("GET", f"/api/takes/{made['takes'][0]}/clip")
        for state in ("draft", *states):
            found.setdefault(state, (time.perf_counter() - start, spent() - work))
    studio.ask("DELETE", f"/api/characters/{character}")
    draft, done = found["draft"], found["done"]
    return Times(opening[0], draft[0], done[0], opening[1], draft[1], done[1])


def library_times(file: Path, seed: int) -> Times:
    """What opening (read, stood up, with handles, written), a draft and a full take cost without the studio."""
    start, work = time.perf_counter(), time.process_time()
    character, _ = opened_character(file, Settings())
    handles = rig(character)
    with tempfile.TemporaryDirectory() as folder:
        save_character(character, Path(folder) / "mesh.glb", handles)
    opening = time.perf_counter() - start, time.process_time() - work
    start, work = time.perf_counter(), time.process_time()
    motion = generate(PROMPT, seconds=SECONDS, seed=seed, candidates=1, mesh_feature=handles.features)
    apply_motion(motion, Anatomy.of(character, handles), stages=DRAFT_STAGES)
    draft = time.perf_counter() - start, time.process_time() - work
    start, work = time.perf_counter(), time.process_time()
    animate(character, PROMPT, seconds=SECONDS, seed=seed, handles=handles)
    full = time.perf_counter() - start, time.process_time() - work
    return Times(opening[0], draft[0], full[0], opening[1], draft[1], full[1])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--takes", type=int, default=0, help="so many takes are queued, and memory is told")
    parser.add_argument("--clips", type=int, default=0, help="so many clips are searched and shown, drawn by lot")
    parser.add_argument("--detail", type=float, nargs="*", default=[1.0], help="of the sample person: 0.3, 0.5, 1")
    parser.add_argument("--subdivided", action="store_true", help="each triangle of the last becomes four")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as home:
        studio = Studio(Path(home) / "studio")
        try:
            studio.until(lambda: studio.get("/api/about")["worker"]["warm"], "a warm worker")
            for number, detail in enumerate(options.detail):
                dense = options.subdivided and number == len(options.detail) - 1
                file = Path(home) / f"person-{number}.glb"
                written(file, detail, dense)
                if options.rounds:
                    compare(studio, file, options.rounds)
                if options.clips:
                    searched(studio, file, options.clips)
            if options.takes:
                queued(studio, studio.get("/api/characters")["characters"][0]["id"], options.takes)
        finally:
            studio.stop()


def written(file: Path, detail: float, dense: bool) -> Path:
    """A file with the sample person, without a rig."""
    person = make_sample("person", detail)
    vertices, faces = person.vertices, person.faces
    if dense:
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    return save_character(Character("person", np.asarray(vertices, np.float32), np.asarray(faces)), file)


def compare(studio: Studio, file: Path, rounds: int) -> None:
    """Time both in turns, and print medians."""
    found = []
    for seed in range(rounds + 1):
        pair = library_times(file, seed), studio_times(studio, file, seed)
        if seed:  # the first round warms both up
            found.append(pair)
    print(f"{len(load_character(file).vertices):,} vertices, {SECONDS:g} s; medians of {rounds} rounds")
    for name in ("open", "draft", "full", "open_work", "draft_work", "full_work"):
        pairs = [(getattr(ours, name), getattr(library, name)) for library, ours in found]
        mine, theirs = (statistics.median(column) for column in zip(*pairs, strict=True))
        ratio = statistics.median(one / other for one, other in pairs if other)
        print(f"{name}: studio {mine:.2f} s, library {theirs:.2f} s, ratio {ratio:.2f}", flush=True)


def searched(studio: Studio, file: Path, count: int) -> None:
    """Search clips by their sentences and get the first that is found on a character, as a card of the page does."""
    opened = studio.post(f"/api/characters?name={file.name}", data=file.read_bytes())
    studio.done(opened["job"])
    character = opened["character"]["id"]
    sentences = sorted(one["sentence"] for one in studio.get("/api/clips")["clips"])
    times = []
    for sentence in random.Random(1).sample(sentences, count):
        start = time.perf_counter()
        name = studio.get(f"/api/clips?{urlencode({'q': sentence})}")["clips"][0]["name"]
        made = studio.post(f"/api/characters/{character}/clips", {"clips": [name]})
        if made["job"]:
            studio.done(made["job"])
        studio.ask("GET", f"/api/characters/{character}/clips/{name}")
        times.append(time.perf_counter() - start)
    vertices = len(load_character(file).vertices)
    print(
        f"{count} clips searched and shown on {vertices:,} vertices: the first {times[0]:.2f} s, "
        f"median {statistics.median(times):.2f}, slowest {max(times):.2f}", flush=True
    )  # fmt: skip
    studio.ask("DELETE", f"/api/characters/{character}")


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
