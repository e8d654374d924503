"""Work on processes: all of it once, and a worker that dies takes nothing along."""

import importlib.util
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from bunraku.errors import MissingExtraError, OptionError
from bunraku.nn.spread import parse_jobs, spread

PROGRAM = '''
"""Each thing writes a letter into a file of its own; those named die, always or once."""
import os, signal, sys
from functools import partial
from pathlib import Path
from bunraku.nn.spread import spread

def work(folder, always, once, batch):
    for name in batch:
        with open(folder / name, "a") as file:
            file.write("x")
        if name == always or name == once and (folder / name).read_text() == "x":
            os.kill(os.getpid(), signal.SIGKILL)
    return ["" for name in batch]

if __name__ == "__main__":
    folder, always, once = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
    batches = [["a", "b"], ["c", "d"], ["e"]]
    for name, reason in spread(partial(work, folder, always, once), batches, 2, str):
        print(name, reason)
'''


def said(tmp_path, always, once):
    (tmp_path / "program.py").write_text(PROGRAM)
    (tmp_path / "out").mkdir()
    words = [sys.executable, str(tmp_path / "program.py"), str(tmp_path / "out"), always, once]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=True)
    return dict(line.split(" ", 1) for line in done.stdout.splitlines()), done.stdout.count("\n")


def test_a_worker_that_dies_takes_nothing_along(tmp_path):
    found, lines = said(tmp_path, "b", "d")
    assert lines == 5 and set(found) == set("abcde")
    assert "ended twice" in found.pop("b") and set(found.values()) == {""}
    letters = {path.name: path.read_text() for path in (tmp_path / "out").iterdir()}
    assert letters == {"a": "xx", "b": "xx", "c": "xx", "d": "xx", "e": "x"}


def test_nothing_to_do_starts_nothing():
    assert list(spread(partial(print), [], 4, str)) == []


@pytest.mark.parametrize("text", ["0", "1025", "-1", "two", "", "1.5", "٣" * 5])
def test_jobs_are_a_number_or_ray(text):
    with pytest.raises(OptionError, match="--jobs"):
        parse_jobs(text)
    assert parse_jobs("ray") == "ray" and parse_jobs("12") == 12


@pytest.mark.skipif(importlib.util.find_spec("ray") is not None, reason="ray is installed")
def test_ray_is_asked_for_by_name():
    with pytest.raises(MissingExtraError, match="ray"):
        list(spread(os.fspath, [[Path()]], "ray", str))
