"""What has changed, by number, for pages that ask now and then.

Only the latest of each thing is kept, so a page that was away for long misses nothing and memory is bounded by what
there is.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

__all__ = ["Changes"]

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
        """What has changed after a number: the latest of each thing, in the order in which it happened.

        Args:
            after: The number that an earlier answer gave as `event`.

        Returns:
            `event`, the number to ask with next time; `changes`, pairs of what it is and its record; and `missed`,
            whether all is to be asked for anew, since this run never gave that number or has forgotten what came after.
        """
        with self._lock:
            if not self._forgotten <= after <= self._count:
                return {"event": self._count, "missed": True, "changes": []}
            found = []
            for number, what, record in reversed(self._latest.values()):
                if number <= after:
                    break
                found.append([what, dict(record)])
            return {"event": self._count, "missed": False, "changes": found[::-1]}
