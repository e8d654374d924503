"""Processes and threads: the pool, work in parallel, and the number of threads."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from bunraku.cli.options import parse_jobs
from bunraku.core.nn.layers import one_thread, parallel, usable_threads
from bunraku.core.parallel import Pool
from bunraku.errors import OptionError

SLEEPING = """
import sys, time
from bunraku.core.parallel import Pool
if __name__ == "__main__":
    try:
        with Pool(2) as pool:
            waiting = [pool.submit(time.sleep, 60) for _ in range(20)]
            print("begun", flush=True)
            for one in waiting:
                one.result()
    except KeyboardInterrupt:
        sys.exit(130)
"""


def below(process):
    """All processes that a process has started, and those that these have."""
    parents = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            rest = status.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        parents[int(status.parent.name)] = int(rest[1])
    found = {process}
    while True:
        more = {child for child, parent in parents.items() if parent in found} - found
        if not more:
            return found - {process}
        found |= more


def alive(process):
    """Whether a process runs; one that only waits to be taken notice of does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def wait_for(condition, seconds):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.02)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs the /proc of Linux")
@pytest.mark.parametrize("how", ["interrupt", "interrupt all", "kill"])
@pytest.mark.parametrize("after", [0.0, 1.5])
def test_nothing_is_left(tmp_path, how, after):
    script = tmp_path / "sleeping.py"
    script.write_text(SLEEPING)
    process = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout.readline() == "begun\n"
    wait_for(lambda: len(below(process.pid)) >= 2, 20)
    time.sleep(after)  # while they start, and while they work
    started = below(process.pid)
    sender = os.killpg if how == "interrupt all" else os.kill
    sender(process.pid, signal.SIGKILL if how == "kill" else signal.SIGINT)
    process.wait(60)
    wait_for(lambda: not any(map(alive, started)), 60)  # they would sleep for longer
    if how != "kill":
        assert process.returncode == 130 and process.stderr.read() == ""


def test_work_is_done_in_other_processes_with_one_thread():
    before = os.environ.get("OMP_NUM_THREADS")
    with Pool(2, os.chdir, ("/",)) as pool:
        assert pool.submit(os.getcwd).result() == "/"
        assert pool.submit(os.getpid).result() != os.getpid()
        assert pool.submit(os.getenv, "OMP_NUM_THREADS").result() == "1"
        assert [one.result() for one in [pool.submit(abs, -n) for n in range(5)]] == list(range(5))
    assert os.environ.get("OMP_NUM_THREADS") == before


def test_an_error_ends_the_workers():
    before = time.monotonic()
    with pytest.raises(ValueError, match="wrong"), Pool(1) as pool:
        pool.submit(time.sleep, 60)
        raise ValueError("wrong")
    assert time.monotonic() - before < 50  # and not the worker's 60 s


PROGRAM = '''
"""Each thing writes a letter into a file of its own; those named die, always or once."""
import os, signal, sys
from functools import partial
from pathlib import Path
from bunraku.core.parallel import run_parallel

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
    for name, reason in run_parallel(partial(work, folder, always, once), batches, 2, str):
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


@pytest.mark.parametrize("text", ["0", "1025", "-1", "two", "", "1.5", "٣" * 5])
def test_jobs_are_a_number_or_ray(text):
    with pytest.raises(OptionError, match="--jobs"):
        parse_jobs(text)
    assert parse_jobs("ray") == "ray" and parse_jobs("12") == 12


@pytest.fixture
def two_threads(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)


def here():
    return threading.get_ident()


def blas():
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


def test_second_call_has_a_thread_of_its_own_where_there_is_a_processor_to_spare(two_threads):
    assert len({*parallel(here, here), here()}) == 1
    before = blas()
    with one_thread():
        first, second = parallel(here, here)
        assert first == here() != second and blas() == {1}
    assert blas() == before


def test_as_many_threads_as_processors_where_nobody_says(monkeypatch):
    for said in ("", "many", "0"):
        monkeypatch.setenv("OMP_NUM_THREADS", said)
        assert usable_threads() >= 1
    monkeypatch.setenv("OMP_NUM_THREADS", "3,2")
    assert usable_threads() == 3


def test_same_numbers_and_errors(two_threads):
    def fails():
        raise ValueError("the other")

    value = np.random.default_rng(3).standard_normal((64, 64)).astype(np.float32)
    with one_thread():
        alone = value @ value, value @ value.T
        first, second = parallel(lambda: value @ value, lambda: value @ value.T)
        with pytest.raises(ValueError, match="the other"):
            parallel(lambda: 1, fails)
        with pytest.raises(ValueError, match="the other"):
            parallel(fails, lambda: 1)
    assert np.array_equal(first, alone[0]) and np.array_equal(second, alone[1])
