"""The queue: jobs run one after another in a process that may be killed and restarts, and reports about them."""

from __future__ import annotations

import logging
import multiprocessing
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import takewhile
from multiprocessing.connection import Connection
from typing import Any, NotRequired, TypedDict, cast

from bunraku.errors import BunrakuError, FormatError, OptionError
from bunraku.studio.store import NotThere, Store
from bunraku.studio.worker import page_sentence, work

MOST = 10_000
"""Things of which the latest change is kept."""


class Changes:
    """The changes of one run of the studio."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._latest: dict[tuple[str, str], tuple[int, str, Mapping[str, object]]] = {}
        self._count = 0
        self._forgotten = 0

    @property
    def last(self) -> int:
        """The number of the latest change."""
        return self._count

    def tell(self, what: str, record: Mapping[str, object]) -> None:
        """Note that a thing is now as its record says."""
        key = what, f"{record.get('kind')}/{record.get('id')}" if what == "gone" else str(record.get("id", ""))
        with self._lock:
            self._count += 1
            self._latest.pop(key, None)
            self._latest[key] = self._count, what, record
            if len(self._latest) > MOST:
                oldest = next(iter(self._latest))
                self._forgotten = self._latest.pop(oldest)[0]

    def since(self, after: int) -> dict[str, Any]:
        """The latest change of each thing after a number, in order.

        Returns:
            `event`, the number to ask with next time; `changes`, pairs of a kind and a record; and `missed`: all is to
            be asked for anew, since this run never gave that number or has forgotten what came after.
        """
        with self._lock:
            if not self._forgotten <= after <= self._count:
                return {"event": self._count, "missed": True, "changes": []}
            newest = takewhile(lambda change: change[0] > after, reversed(self._latest.values()))
            changes = [[kind, dict(record)] for _, kind, record in newest]
            return {"event": self._count, "missed": False, "changes": changes[::-1]}


_log = logging.getLogger(__name__)
MOST_WAITING = 64
"""Jobs in the queue; more are refused."""
REMEMBERED = 500
"""Finished jobs that are kept for pages that were away."""
LATER = ("find-out", "lay-chains")
"""Jobs that are begun when nothing was done for `QUIET`, and stopped, to be done again later, where another comes."""
QUIET = 1.0
"""Seconds without work before a background job is begun; chosen by eye."""
PATIENCE = 4.0
"""Seconds that a cancelled job has to stop before its process is killed; chosen by eye."""
KILLED = (
    "the process that does the work was stopped in the middle of this, by you or for lack of memory; everything else is"
    " safe, so try again, with a smaller mesh or fewer seconds if it happens twice"
)
OPEN_STATES = ("waiting", "running")


class About(TypedDict, total=False):
    """Which things a job is about: takes that it makes of a character; a character that it opens, finds out more of or
    lays chains over; a take that it exports.
    """

    character: str
    takes: list[str]
    opens: str
    found: str
    laid: str
    export: str
    take: str


class Job(TypedDict):
    """A job: its task, the task's parameters, what it is about, and how far it is."""

    id: str
    created: float
    kind: str
    title: str
    params: Mapping[str, object]
    about: About
    state: str
    stage: str
    done: float
    error: str
    started: NotRequired[float]


class QueueFull(BunrakuError):
    """Too many jobs wait."""


Finish = Callable[[Job, str, Mapping[str, object]], None]
"""Called with a job, "partly", "done", "failed" or "cancelled", and what the worker said."""


class Jobs:
    """The queue and its process. Jobs that wait are written down in the store; `finish` takes in what the
    worker made.
    """

    def __init__(self, store: Store, finish: Finish):
        self.store = store
        self._finish = finish
        self._context = multiprocessing.get_context("spawn")
        self._lock = threading.RLock()
        self._wake = threading.Condition(self._lock)
        self._waiting: deque[str] = deque()
        self._later: deque[str] = deque()
        self._worked = 0.0  # when the last job ended
        self._coming = 0  # jobs that are being written down
        self._jobs: dict[str, Job] = {}
        self.changes = Changes()
        self._process: Any = None
        self._pipe: Connection | None = None
        self._bell: Connection | None = None
        self.warm = False
        self._cancelled_at = 0.0
        self._running: Job | None = None
        self._overtaken = ""  # the job that is stopped so that another one is done, and then done again
        self._stopping = False
        self._thread: threading.Thread | None = None
        for record in store.all("jobs"):  # of a run that ended before they did
            self._jobs[record["id"]] = cast(
                Job, {**record, "state": "interrupted", "done": 0.0, "error": "interrupted; again?"}
            )

    def start(self) -> None:
        """Start the process and the thread that feeds it."""
        self._spawn()
        self._thread = threading.Thread(target=self._serve, name="studio jobs", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the process; jobs that wait are on disk, and the next run offers them again."""
        with self._wake:
            self._stopping = True
            self._wake.notify_all()
        self._kill()
        if self._thread is not None:
            self._thread.join(5)

    @property
    def process_id(self) -> int | None:
        """The id of the process that does the work."""
        return None if self._process is None else self._process.pid

    def all(self) -> list[Job]:
        """All jobs that are known, oldest first."""
        with self._lock:
            return sorted(self._jobs.values(), key=lambda job: float(job["created"]))

    def get(self, name: str) -> Job:
        """A job; NotThere where there is none."""
        with self._lock:
            if name not in self._jobs:
                raise NotThere("there is no such job any more; reload the page")
            return self._jobs[name]

    def submit(
        self, kind: str, title: str, params: Mapping[str, object], about: About | None = None, *,
        passing: bool = False, first: bool = False,
    ) -> Job:  # fmt: skip
        """Put a job into the queue; QueueFull where too many wait, FormatError where it cannot be written down. A job
        that is `passing` is not kept on disk and not offered again by the next run; one that goes `first` is done
        before all that wait. One that opens a character stops the takes that are being made of it, which are made anew
        afterwards; so does any one with what is done `LATER`.
        """
        with self._lock:
            if len(self._waiting) + len(self._later) + self._coming >= MOST_WAITING:
                raise QueueFull(f"{MOST_WAITING} jobs are waiting already; let some finish or cancel them")
            self._coming += 1
        record = {"kind": kind, "title": title, "params": params, "about": about or {}}
        passed = {"id": secrets.token_hex(8), "created": time.time()}
        try:  # outside the lock, so that no request waits for the disk
            new = {**record, **passed} if passing else self.store.new("jobs", record)
        finally:
            with self._lock:
                self._coming -= 1
        with self._wake:
            job = cast(Job, {**new, "state": "waiting", "stage": "", "done": 0.0, "error": ""})
            self._jobs[job["id"]] = job
            queue = self._later if kind in LATER else self._waiting
            (queue.appendleft if first else queue.append)(job["id"])
            if self._running is not None and kind not in LATER:
                name, what = self._running["id"], self._running["about"]
                reopened = "takes" in what and what.get("character") == job["about"].get("opens")
                if self._running["kind"] in LATER or reopened:
                    self._overtaken = name
                    self._ring(name)
            self.changes.tell("job", public(job))
            self._wake.notify_all()
            return job

    def again(self, name: str) -> Job:
        """Put a job that failed or was interrupted into the queue again."""
        job = self.get(name)
        if job["state"] in (*OPEN_STATES, "done"):
            raise OptionError("this job needs no second try; it runs or is done")
        with self._lock:
            self._jobs.pop(name, None)
        self.store.drop("jobs", name)
        return self.submit(job["kind"], job["title"], job["params"], job["about"])

    def cancel(self, name: str) -> Job:
        """Take a job out of the queue, or stop it."""
        with self._wake:
            job = self.get(name)
            queue = next((queue for queue in (self._waiting, self._later) if name in queue), None)
            if queue is not None:
                queue.remove(name)
            elif job["state"] == "running":
                self._overtaken = ""
                self._ring(name)
        if queue is not None or job["state"] == "interrupted":
            self._end(job, "cancelled", {})
        return job

    def _ring(self, name: str) -> None:
        """Have the job stop that runs."""
        self._cancelled_at = time.monotonic()
        with suppress(OSError, AttributeError):  # a process that is gone needs no bell
            self._bell.send(name)  # type: ignore[union-attr]

    def _spawn(self) -> None:
        ours, theirs = self._context.Pipe()
        heard, bell = self._context.Pipe(duplex=False)
        process = self._context.Process(
            target=work, args=(str(self.store.folder), theirs, heard), name="bunraku studio worker", daemon=True
        )
        process.start()
        theirs.close()
        heard.close()
        self._process, self._pipe, self._bell = process, ours, bell
        self.warm = False
        self.changes.tell("worker", {"warm": False, "process": process.pid})

    def _kill(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.join(5)
        for end in (self._pipe, self._bell):
            if end is not None:
                end.close()
        self._pipe = self._bell = None

    def _serve(self) -> None:
        while True:
            with self._wake:
                while not self._waiting and not self._stopping and not self._quiet():
                    self._wake.wait(QUIET)
                    self._look_after()
                if self._stopping:
                    return
                job = self._jobs[(self._waiting or self._later).popleft()]
                self._cancelled_at = 0.0
                job.update({"state": "running", "started": time.time()})
                self._running = job
                self.changes.tell("job", public(job))
            self._run(job)
            self._worked = time.monotonic()

    def _quiet(self) -> bool:
        """Whether it is time for a background job, and there is one."""
        return bool(self._later) and time.monotonic() - self._worked >= QUIET

    def _look_after(self) -> None:
        """While nothing waits: hear that the process is warm, and start it again where it was killed."""
        if self._process is None or self._pipe is None or self._stopping:
            return
        with suppress(EOFError, OSError):
            if not self.warm and self._pipe.poll() and self._pipe.recv()[1] == "warm":
                self._warmed()
        if not self._process.is_alive():
            self._kill()
            self._spawn()  # so that the next job finds it warm

    def _run(self, job: Job) -> None:
        try:
            if self._process is None or not self._process.is_alive():
                self._kill()
                self._spawn()
            assert self._pipe is not None
            self._pipe.send((job["id"], job["kind"], job["params"]))
            while True:
                if self._pipe.poll(0.2):
                    if self._heard(job, *self._pipe.recv()):
                        return
                elif self._cancelled_at and time.monotonic() - self._cancelled_at > PATIENCE:
                    self._kill()
                    self._end(job, "cancelled", {})
                    self._spawn()
                    return
                elif not self._process.is_alive():
                    raise EOFError
        except (EOFError, OSError, AttributeError, AssertionError):  # gone, or taken away by `stop`
            if self._stopping:
                return
            self._kill()
            self._end(job, "failed", {"error": KILLED, "kind": "WorkerKilled"})
            self._spawn()
        except Exception as error:  # one job must not end the queue
            _log.exception("what the worker said could not be taken in")
            self._end(job, "failed", {"error": page_sentence(error), "kind": type(error).__name__})

    def _warmed(self) -> None:
        with self._lock:
            self.warm = True
            self.changes.tell("worker", {"warm": True, "process": self.process_id})

    def _heard(self, job: Job, name: str, what: str, said: Mapping[str, object]) -> bool:
        """Take in one message; whether it was the last one of the job."""
        if what == "warm":
            self._warmed()
        if name != job["id"]:
            return False
        if what == "progress":
            with self._lock:
                cast(dict[str, object], job).update(said)
                self.changes.tell("job", public(job))
            return False
        if what == "partly":
            self._finish(job, what, said)
            return False
        self._end(job, what, said)
        return True

    def _end(self, job: Job, state: str, said: Mapping[str, object]) -> None:
        """Take in how a job ended. Its results come first, so that they are there when it is seen to be done; writing
        them goes on outside the lock.
        """
        error = str(said.get("error", ""))
        with self._lock:
            self._running = None
            overtaken, self._overtaken = self._overtaken == job["id"], ""
            if overtaken and state == "cancelled":
                if job["kind"] in LATER:
                    self._later.appendleft(job["id"])
                else:
                    self._waiting.insert(1, job["id"])  # behind the one that overtook it
                job.update({"state": "waiting", "stage": "", "done": 0.0})
                self.changes.tell("job", public(job))
                return
        try:
            self._finish(job, state, said)
        except NotThere:
            pass  # deleted meanwhile
        except Exception as wrong:
            if not isinstance(wrong, BunrakuError):
                _log.exception("a result could not be taken in")
            state, error = "failed", page_sentence(wrong)
        if state in ("done", "cancelled"):
            self.store.drop("jobs", job["id"])
        elif job["id"] in {record["id"] for record in self.store.all("jobs")}:
            with suppress(FormatError):  # the disk is full; it is in memory
                self.store.change("jobs", job["id"], failed=True)
        with self._lock:
            job.update({"state": state, "done": 1.0 if state == "done" else job["done"], "error": error})
            finished = [known for known in self._jobs.values() if known["state"] not in OPEN_STATES]
            for old in sorted(finished, key=lambda known: float(known["created"]))[:-REMEMBERED]:
                self._jobs.pop(old["id"], None)
            self.changes.tell("job", public(job))


def public(job: Job) -> dict[str, Any]:
    """What pages get of a job: all but what its task is given."""
    return {name: value for name, value in job.items() if name != "params"}
