"""What is behind the routes: the store, the queue, and how what the worker made becomes part of a record."""

from __future__ import annotations

import logging
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

from bunraku.errors import BunrakuError, OptionError
from bunraku.studio.jobs import OPEN_STATES, Jobs
from bunraku.studio.projects import unpack_project
from bunraku.studio.store import NotThere, Store
from bunraku.studio.study.show import Session

__all__ = ["SAMPLE", "State"]

SAMPLE = Path(__file__).parent / "sample.bunraku"
"""A character in motion, for who opens the studio for the first time; `tools/make_studio_sample.py` writes it."""
MOST_TAKES = 2000


class State:
    """The studio's state.

    Args:
        store: What it keeps.
        study: The folder of a blind study that is shown, None for none.
    """

    def __init__(self, store: Store, study: Path | None = None):
        self.store = store
        self.session = None if study is None else Session(study)
        self.jobs = Jobs(store, self._finish)
        for take in store.all("takes"):
            if take["state"] in ("waiting", "draft"):
                store.change("takes", take["id"], state="interrupted", error="interrupted; make it again?")
        for character in store.all("characters"):
            if character["state"] == "opening":
                store.change("characters", character["id"], state="interrupted", error="interrupted; open it again?")

    def start(self) -> None:
        """Start the worker; put the sample there where there is no character yet."""
        if not self.store.all("characters") and SAMPLE.is_file():
            try:
                unpack_project(self.store, SAMPLE)
            except BunrakuError as error:  # a full disk is no reason not to open what is there
                logging.getLogger(__name__).warning("%s", error)
        self.jobs.start()

    def stop(self) -> None:
        """End the worker."""
        self.jobs.stop()

    def new_takes(self, character: str, count: int, **about: Any) -> list[dict[str, Any]]:
        """Records of takes that are to be made.

        Raises:
            OptionError: There are too many.
            FormatError: They cannot be written down.
        """
        if len(self.store.all("takes")) + count > MOST_TAKES:
            raise OptionError(f"there are {MOST_TAKES:,} takes; delete some that are not needed")
        made = []
        try:
            for number in range(count):
                made.append(
                    self.store.new(
                        "takes",
                        {
                            "character": character, "state": "waiting", "star": False, "error": "", **about,
                            "seed": about.get("seeds", [0] * count)[number],
                        },
                    )
                )  # fmt: skip
        except Exception:
            for take in made:
                self.store.drop("takes", take["id"])
            raise
        for take in made:
            self.jobs.tell("take", take)
        return made

    def make(self, kind: str, title: str, character: str, takes: list[dict[str, Any]], params: dict[str, Any]) -> Any:
        """Queue the job that makes takes; they vanish where it cannot be queued."""
        names = [take["id"] for take in takes]
        try:
            job = self.jobs.submit(
                kind,
                title,
                {**params, "character": character, "takes": names},
                {"character": character, "takes": names},
            )
        except Exception:
            for name in names:
                self.drop("takes", name)
            raise
        return {"job": job["id"], "takes": names}

    def drop(self, kind: str, name: str) -> None:
        """Remove a thing and tell so."""
        self.store.drop(kind, name)
        self.jobs.tell("gone", {"kind": kind, "id": name})

    def change(self, kind: str, name: str, /, **values: Any) -> dict[str, Any]:
        """Change a record and tell so."""
        record = self.store.change(kind, name, **values)
        self.jobs.tell(kind[:-1], record)
        return record

    def revive(self, about: dict[str, Any]) -> None:
        """Mark what a job is about as waiting again."""
        for name in about.get("takes", ()):
            with suppress(NotThere):
                if self.store.get("takes", name)["state"] != "done":
                    self.change("takes", name, state="waiting", error="")
        if "opens" in about:
            self.change("characters", about["opens"], state="opening", error="")

    def _finish(self, job: dict[str, Any], state: str, said: dict[str, Any]) -> None:
        about = job["about"]
        if state == "partly":
            values = {**said}
            name = values.pop("take")
            with suppress(NotThere):
                self.change("takes", name, **{"state": "draft", **values})
                if values.get("state") == "done":
                    (self.store.place("takes", name) / "draft.bin").unlink(missing_ok=True)
            return
        if "opens" in about:
            values = (
                {**said, "state": "ready", "error": ""}
                if state == "done"
                else {"state": state, "error": said.get("error", "")}
            )
            version = int(self.store.get("characters", about["opens"]).get("version", 0)) + 1
            self.change("characters", about["opens"], version=version, **values)
        for name in about.get("takes", ()):
            with suppress(NotThere):
                take = self.store.get("takes", name)
                if take["state"] == "done":
                    continue
                if state == "cancelled" and take["state"] != "draft":
                    self.drop("takes", name)
                else:
                    self.change("takes", name, state=state, error=said.get("error", ""))
        if "export" in about and state != "done":
            self.store.drop("exports", about["export"])

    def busy(self, kind: str, name: str) -> bool:
        """Whether a job is waiting or running that is about a thing."""
        return any(
            job["state"] in OPEN_STATES and name in (job["about"].get("character"), *job["about"].get("takes", ()))
            for job in self.jobs.all()
        )

    def forget(self) -> None:
        """Remove exports, which are copies."""
        for record in self.store.all("exports"):
            shutil.rmtree(self.store.folder / "exports" / record["id"], ignore_errors=True)
