"""How the studio bears much: tabs, open streams, a long queue, a full and a shut disk, a killed worker, a huge file.

    python benchmarks/studio_load.py [--takes 100]

Each row tells the slowest answer of `GET /api/about` and of the requests that the row is about while that goes on, what
became of what was there, and the memory of the server before and after.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "studio"))

from studio import resident
from studio_process import Studio, as_somebody, no_space

TABS, STREAMS, HUGE = 12, 300, 300 << 20


@dataclass
class Watch:
    """Asks the studio again and again while something goes on, and keeps how long each answer took [s]."""

    studio: Studio
    every: float = 0.1
    times: list[float] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)

    def __enter__(self) -> Watch:
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.before = resident(self.studio.process.pid)
        self._thread.start()
        return self

    def _run(self) -> None:
        while not self._stop.wait(self.every):
            self.timed(lambda: self.studio.ask("GET", "/api/about"))

    def timed(self, ask: Callable[[], tuple[int, object]]) -> tuple[int, object]:
        """Time a request."""
        start = time.perf_counter()
        status, body = ask()
        self.times.append(time.perf_counter() - start)
        if status >= 500 and status != 507:
            self.wrong.append(f"{status} {body}")
        return status, body

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self.after = resident(self.studio.process.pid)

    def row(self, name: str, note: str) -> None:
        """Print what was seen."""
        print(
            f"| {name} | {max(self.times):.2f} s, median {statistics.median(self.times):.3f} | {note} | "
            f"{self.before:.0f}, {self.after:.0f} MB | {len(self.wrong)} |",
            flush=True,
        )


def things(studio: Studio) -> tuple[set[str], set[str]]:
    """Ids of the characters and of the takes that are done."""
    about = studio.get("/api/about")
    return {one["id"] for one in about["characters"]}, {one["id"] for one in about["takes"] if one["state"] == "done"}


def kept(before: tuple[set[str], set[str]], studio: Studio) -> str:
    """What became of what was there."""
    after = things(studio)
    lost = sum(len(one - other) for one, other in zip(before, after, strict=True))
    return "nothing lost" if not lost else f"{lost} LOST"


def tabs(studio: Studio) -> None:
    """Twelve tabs that each ask for what has changed, as a page does while something is made."""
    stop = threading.Event()

    def tab() -> None:
        last = studio.get("/api/about")["event"]
        while not stop.wait(0.25):
            last = studio.get(f"/api/changes?after={last}")["event"]

    threads = [threading.Thread(target=tab) for _ in range(TABS)]
    owner = studio.get("/api/characters")["characters"][0]["id"]
    with Watch(studio) as watch:
        for one in threads:
            one.start()
        studio.done(studio.animate(owner)["job"])
        stop.set()
        for one in threads:
            one.join()
    watch.row(f"{TABS} tabs, a take meanwhile", "made")


def streams(studio: Studio) -> None:
    """Connections that are held open in the middle of a request."""
    base = urlsplit(studio.base)
    held = []
    try:
        for _ in range(STREAMS):
            line = socket.create_connection((base.hostname, base.port), timeout=10)
            line.sendall(b"GET /api/changes HTTP/1.1\r\nHost: localhost\r\n")
            held.append(line)
        with Watch(studio) as watch:
            time.sleep(3)
        watch.row(f"{STREAMS} lines held open", kept(things(studio), studio))
    finally:
        for line in held:
            line.close()


def queue(studio: Studio, count: int) -> None:
    """Takes that are queued at once; where the queue is full, each is asked for again."""
    owner = studio.get("/api/characters")["characters"][0]["id"]
    body = {"script": [{"text": "waves", "seconds": 1}], "steps": 2, "candidates": 1, "draft": False}
    jobs, refused, workers = [], 0, []
    with Watch(studio) as watch:
        while len(jobs) < count:
            status, made = watch.timed(
                lambda: studio.ask("POST", f"/api/characters/{owner}/takes", {**body, "seeds": [len(jobs)]})
            )
            if status == 202:
                jobs.append(made["job"])  # type: ignore[index]
            else:
                refused += 1
                time.sleep(0.5)
        for number, job in enumerate(jobs):
            studio.done(job)
            if number in (9, count - 1):
                workers.append(resident(studio.get("/api/about")["worker"]["process"]))
    watch.row(
        f"{count} takes queued",
        f"made; {refused} refused by a full queue; worker {workers[0]:.0f} MB after 10, {workers[-1]:.0f} after all",
    )


def full(studio: Studio) -> None:
    """A disk that takes nothing."""
    before = things(studio)
    owner = next(iter(before[0]))
    worker = studio.get("/api/about")["worker"]["process"]
    with Watch(studio) as watch, no_space(studio.process.pid), no_space(worker):
        answers = [
            watch.timed(lambda: studio.ask("POST", f"/api/characters/{owner}/takes",
                                           {"script": [{"text": "waves", "seconds": 1}], "steps": 2}))[0],
            watch.timed(lambda: studio.ask("POST", "/api/characters?sample=robot", {}))[0],
        ]  # fmt: skip
        time.sleep(2)
    watch.row("the disk is full", f"{kept(before, studio)}; making answers {answers}")


def killed(studio: Studio) -> None:
    """The worker is killed in the middle of a take, with another one waiting."""
    before = things(studio)
    owner = next(iter(before[0]))
    with Watch(studio) as watch:
        first = studio.animate(owner, "walks", 20, steps=50)["job"]
        second = studio.animate(owner)["job"]
        studio.until(lambda: studio.get(f"/api/jobs/{first}")["state"] == "running", "a running job")
        os.kill(studio.get("/api/about")["worker"]["process"], signal.SIGKILL)
        states = [studio.ended(job)["state"] for job in (first, second)]
    watch.row("the worker is killed", f"{kept(before, studio)}; that take {states[0]}, the one that waited {states[1]}")


def huge(studio: Studio) -> None:
    """A file of 300 MB is sent."""
    before = things(studio)
    with Watch(studio) as watch:
        status, said = studio.ask("POST", "/api/characters?name=huge.glb", data=bytes(HUGE))
    watch.row("300 MB are sent", f"{kept(before, studio)}; answered {status}")
    assert status == 413, said


def shut(folder: Path) -> None:
    """A folder that can only be read."""
    open_before: dict[Path, int] = {path: path.stat().st_mode for path in (folder, *folder.rglob("*"))}
    try:
        for path, mode in open_before.items():
            path.chmod(mode & ~0o222)
        studio = Studio(folder, limit=as_somebody)
        try:
            path = f"/api/characters/{next(iter(things(studio)[0]))}"
            with Watch(studio) as watch:
                answers = [
                    watch.timed(lambda: studio.ask("PATCH", path, {"name": "other"}))[0],
                    watch.timed(lambda: studio.ask("DELETE", path))[0],
                ]
                time.sleep(1)
            trouble = studio.get("/api/about")["trouble"]
            note = f"changing answers {answers}; it says so: {bool(trouble)}"
            watch.row("a folder that can only be read", note)
        finally:
            studio.stop()
    finally:
        for path, mode in open_before.items():
            if path.exists():
                path.chmod(mode)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--takes", type=int, default=100)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as home:
        folder = Path(home) / "studio"
        studio = Studio(folder)
        print("| what goes on | slowest answer | what became of it | server before, after | failures |")
        print("| --- | --- | --- | --- | --- |")
        try:
            studio.until(lambda: studio.get("/api/about")["worker"]["warm"], "a warm worker")
            tabs(studio)
            streams(studio)
            queue(studio, options.takes)
            killed(studio)
            huge(studio)
            full(studio)
            before = things(studio)
        finally:
            studio.stop()
        studio = Studio(folder)
        print("| started again | | " + kept(before, studio) + " | | |")
        studio.stop()
        shut(folder)


if __name__ == "__main__":
    main()
