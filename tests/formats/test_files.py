"""What a run that was killed leaves half-written, and who removes it."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bunraku.formats.files import PACKAGE_WEIGHTS, STALE, atomic_write, open_input, open_once, sweep, weights_file

KILLED = """
import os, signal, sys
from pathlib import Path
from bunraku.formats.files import atomic_write
with atomic_write(Path(sys.argv[1])) as file:
    file.write(b"half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_run_left_is_removed(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "out.glb")], check=False)
    assert len(list(tmp_path.iterdir())) == 1
    assert sweep(tmp_path) == 1 and list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs the /proc of Linux")
def test_a_killed_process_that_nobody_has_asked_after_is_gone(tmp_path):
    with subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path / "out.glb")]) as process:
        while Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z":
            time.sleep(0.01)
        assert len(list(tmp_path.iterdir())) == 1
        assert sweep(tmp_path) == 1


def test_what_is_being_written_and_what_is_not_ours_stays(tmp_path):
    others = [".notes.tmp", "scene.tmp", ".x.abc123-1-12345678.tmp.glb", ".x.part"]
    for name in others:
        (tmp_path / name).write_bytes(b"")
        os.utime(tmp_path / name, (0, 0))
    with atomic_write(tmp_path / "out.glb") as file:
        file.write(b"whole")
        assert sweep(tmp_path) == 0
    assert (tmp_path / "out.glb").read_bytes() == b"whole"
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*others, "out.glb"])


def test_what_another_machine_gave_up_is_removed_after_an_hour(tmp_path):
    path = tmp_path / ".out.glb.000000-1-abcdefgh.tmp"
    path.write_bytes(b"half")
    assert sweep(tmp_path) == 0
    old = time.time() - STALE - 1
    os.utime(path, (old, old))
    assert sweep(tmp_path) == 1


def test_a_folder_that_is_not_there_holds_nothing(tmp_path):
    assert sweep(tmp_path / "none") == 0


def test_what_is_told_apart_is_what_is_read_within_one_opening(tmp_path):
    path, other = tmp_path / "a.bin", tmp_path / "b.bin"
    path.write_bytes(b"first")
    with open_once():
        with open_input(path) as file:
            assert file.read(2) == b"fi"
        other.write_bytes(b"second")
        other.replace(path)
        with open_input(path) as again:
            assert again.read() == b"first" and again is file
    assert file.closed
    with open_input(path) as file:
        assert file.read() == b"second"
    assert file.closed


def test_weights_are_found_in_the_first_folder_that_has_them(tmp_path, monkeypatch):
    for folder, name in (("one", "a"), ("two", "a"), ("two", "b")):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / name).write_text("")
    monkeypatch.setenv("BUNRAKU_WEIGHTS", os.pathsep.join([str(tmp_path / "one"), str(tmp_path / "two"), ""]))
    assert [weights_file(name).parent.name for name in "ab"] == ["one", "two"]
    assert weights_file("diffusion.md").parent == PACKAGE_WEIGHTS and weights_file("c").parent.name == "one"
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path / "one"))
    assert weights_file("diffusion.md").parent.name == "one"
    monkeypatch.delenv("BUNRAKU_WEIGHTS")
    assert weights_file("diffusion.md").parent == PACKAGE_WEIGHTS
