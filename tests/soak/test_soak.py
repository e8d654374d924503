"""The soak's own parts; how long it is let run is up to `make soak`."""

from __future__ import annotations

import random
from itertools import islice
from mmap import mmap
from pathlib import Path

import pytest
from soak import resident, work

pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs the /proc of Linux")


def test_every_kind_of_work_can_be_done(tmp_path):
    seen = []
    for what, call in islice(work(tmp_path, random.Random(1)), 7):
        call()
        seen.append(what)
    assert seen == ["animate", "preview", "edit", "transfer", "still", "files", "broken file"]
    assert {"a.glb", "p.mp4", "s.png"} <= {path.name for path in tmp_path.iterdir()}


def test_memory_that_is_held_is_seen():
    before = resident()
    # A map of its own: an allocator may hand out pages again that the process holds since other tests.
    with mmap(-1, 64_000_000) as held:
        held.write(b"x" * 64_000_000)
        assert resident() - before > 50
