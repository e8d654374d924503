"""What is behind the routes: the store, the queue, and how what the worker made becomes part of a record."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

from bunraku.errors import BunrakuError
from bunraku.studio.jobs import About, Job, Jobs
from bunraku.studio.projects import unpack_project
from bunraku.studio.store import NotThere, Store

SAMPLE = Path(__file__).parent / "sample.bunraku"
"""A character in motion, for the first start of the studio; `tools/make_studio_sample.py` writes it."""
KEPT_EXPORTS = 3
"""Copies that were written and stay until others are."""


class State:
    """The studio's state: its store, which it keeps, its queue, and what is told to pages."""

    def __init__(self, store: Store):
        self.store = store
        self.jobs = Jobs(store, self._finish)
        self.writing = threading.Lock()
        """Held by requests that change what there is."""
        self.windows: dict[str, Mapping[str, object]] = {}
        """What jobs of live characters gave, until it is fetched."""
        store.troubled = lambda trouble: self.jobs.changes.tell("trouble", {"text": trouble})
        for take in store.all("takes"):
            if take["state"] in ("waiting", "draft"):
                store.note("takes", take["id"], state="interrupted", error="interrupted; make it again?")
        for character in store.all("characters"):
            if character["state"] == "opening":
                store.note("characters", character["id"], state="interrupted", error="interrupted; open it again?")

    def start(self) -> None:
        """Start the worker; put the sample there where there is no character yet."""
        if not self.store.all("characters") and SAMPLE.is_file():
            try:
                unpack_project(self.store, SAMPLE)
            except BunrakuError as error:  # a full disk is no reason not to open what is there
                logging.getLogger(__name__).warning("%s", error)
        for character in self.store.all("characters"):
            if character["state"] == "unclear":  # what was kept of it could not be read
                try:
                    self.open(character["id"], character["file"])
                except BunrakuError as error:
                    logging.getLogger(__name__).warning("%s", error)
            elif character["state"] == "ready" and not {"ends", "laid"} <= set(character):
                with suppress(BunrakuError):
                    self.find_out(character["id"])
        self.jobs.start()

    def stop(self) -> None:
        """End the worker."""
        self.jobs.stop()

    def new_takes(self, character: str, count: int, **about: object) -> list[dict[str, Any]]:
        """Records of takes to be made; OptionError for too many, FormatError where they cannot be written down."""
        self.store.check_takes(count)
        takes: list[dict[str, Any]] = []
        seeds = about.get("seeds")
        try:
            for number in range(count):
                seed = seeds[number] if isinstance(seeds, list) else 0
                fresh = {"character": character, "state": "waiting", "star": False, "error": ""}
                takes.append(self.store.new("takes", {**fresh, **about, "seed": seed}))
        except Exception:
            for take in takes:
                self.store.drop("takes", take["id"])
            raise
        for take in takes:
            self.jobs.changes.tell("take", take)
        return takes

    def make_takes(
        self, kind: str, title: str, character: str, params: Mapping[str, object], seeds: list[int], **about: object
    ) -> Any:
        """Add takes of these seeds and queue the job that makes them; errors are those of `new_takes` and `make`."""
        takes = self.new_takes(character, len(seeds), seeds=seeds, **about)
        return self.make(kind, title, character, [take["id"] for take in takes], params)

    def make(self, kind: str, title: str, character: str, takes: list[str], params: Mapping[str, object]) -> Any:
        """Queue the job that makes takes; they vanish where it cannot be queued."""
        try:
            about: About = {"character": character, "takes": takes}
            job = self.jobs.submit(kind, title, {**params, **about}, about)
        except Exception:
            for name in takes:
                self.drop("takes", name)
            raise
        return {"job": job["id"], "takes": takes}

    def open(self, name: str, file: str, again: bool = False) -> dict[str, Any]:
        """Queue the opening of a character by its id and its file, relative to its folder, `again` where what was
        guessed still holds. One that was open before is opened at once, and takes of it that are in work are made
        afterwards. Errors are those of `Jobs.submit`.
        """
        record = self.change("characters", name, file=file, state="opening", error="")
        params = {"character": name, "file": file, "settings": record["settings"], "again": again}
        about: About = {"character": name, "opens": name}
        job = self.jobs.submit("open", f"open {record['name']}", params, about, first=record["version"] > 0)
        return {"character": record, "job": job["id"]}

    def find_out(self, name: str) -> None:
        """Queue, for quiet times, what takes longer to find of a character."""
        about: About = {"found": name}
        self.jobs.submit("find-out", "look at the character", {"character": name}, about, passing=True)

    def lay_chains(self, name: str) -> None:
        """Queue, for quiet times, the chains of a character's hair and clothes, unless they are queued already."""
        about: About = {"laid": name}
        if not any(job["state"] == "waiting" and job["about"].get("laid") == name for job in self.jobs.all()):
            self.jobs.submit("lay-chains", "lay chains of bones", {"character": name}, about, passing=True)

    def drop(self, kind: str, name: str) -> None:
        """Remove a thing and tell so."""
        self.store.drop(kind, name)
        self.jobs.changes.tell("gone", {"kind": kind, "id": name})

    def change(self, kind: str, name: str, /, **values: object) -> dict[str, Any]:
        """Change a record and tell so."""
        record = self.store.change(kind, name, **values)
        self.jobs.changes.tell(kind[:-1], record)
        return record

    def note(self, kind: str, name: str, /, **values: object) -> dict[str, Any]:
        """Change a record, in memory alone where the disk is full, and tell so."""
        record = self.store.note(kind, name, **values)
        self.jobs.changes.tell(kind[:-1], record)
        return record

    def new_export(self, file: str, title: str) -> dict[str, Any]:
        """The record of a copy that is to be written, FormatError where it cannot be; of those that were written
        before, the latest stay.
        """
        written = [record for record in self.store.all("exports") if record.get("state") == "done"]
        for old in written[: max(0, len(written) - KEPT_EXPORTS)]:
            self.store.drop("exports", old["id"])
        return self.store.new("exports", {"file": file, "title": title, "state": "waiting"})

    def export(self, kind: str, file: str, title: str, params: Mapping[str, object], **about: object) -> dict[str, Any]:
        """Queue the job of a kind that writes a copy, a file with a title that a user sees. `params` is what the task
        takes besides the file, and `about` which things the job is about. Errors are those of `Jobs.submit`.
        """
        export = self.new_export(file, title)
        try:
            job = self.jobs.submit(
                kind, f"write {title}", {**params, "export": export["id"], "file": file},
                cast(About, {**about, "export": export["id"]}),
            )  # fmt: skip
        except BaseException:
            self.store.drop("exports", export["id"])
            raise
        return {"job": job["id"], "export": export["id"], "title": title}

    def revive(self, about: About) -> None:
        """Mark what a job is about as waiting again."""
        for name in about.get("takes", ()):
            with suppress(NotThere):
                if self.store.get("takes", name)["state"] != "done":
                    self.change("takes", name, state="waiting", error="")
        if "opens" in about:
            self.change("characters", about["opens"], state="opening", error="")

    def _finish(self, job: Job, state: str, said: Mapping[str, object]) -> None:
        about = job["about"]
        if job["kind"] == "live":
            self.windows[job["id"]] = said
        if said.get("full"):
            self.store.make_room()
        if state == "partly":
            values = {**said}
            name = str(values.pop("take"))
            with suppress(NotThere):
                self.note("takes", name, **{"state": "draft", **values})
                if values.get("state") == "done":
                    with suppress(OSError):
                        (self.store.folder_of("takes", name) / "draft.bin").unlink(missing_ok=True)
            return
        if "opens" in about:
            facts = {**said, "state": "ready", "error": ""}
            values = facts if state == "done" else {"state": state, "error": said.get("error", "")}
            version = int(self.store.get("characters", about["opens"]).get("version", 0)) + 1
            self.note("characters", about["opens"], version=version, **values)
            if state == "done":
                with suppress(BunrakuError):  # a full queue or disk: the character is open without it
                    self.find_out(about["opens"])
        if "found" in about and state == "done":
            self.note("characters", about["found"], **said)
            with suppress(BunrakuError):
                self.lay_chains(about["found"])
        if "laid" in about and state == "done":
            with suppress(NotThere):
                times = int(self.store.get("characters", about["laid"]).get("laid", 0)) + 1
                self.note("characters", about["laid"], laid=times, **said)
        for name in about.get("takes", ()):
            with suppress(NotThere):
                if self.store.get("takes", name)["state"] == "done":
                    continue
                if state == "cancelled":
                    self.drop("takes", name)
                else:
                    self.note("takes", name, state=state, error=said.get("error", ""))
        if "export" in about:
            if state == "done":
                self.store.note("exports", about["export"], state="done")
            else:
                self.store.drop("exports", about["export"])
