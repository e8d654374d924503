"""Workers end with what started them, however that ends."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bunraku.nn.pool import Pool

SLEEPING = """
import sys, time
from bunraku.nn.pool import Pool
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
    before = time.monotonic()
    process.wait(20)
    wait_for(lambda: not any(map(alive, started)), 2 - (time.monotonic() - before))
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
    assert time.monotonic() - before < 5
