"""Two runs of real processes to one place: the second is refused, and what a dead one left counts for nothing."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from bunraku.cli import main
from bunraku.cli import manifest as module
from bunraku.cli.manifest import exclusive_output
from bunraku.errors import FormatError

ROOT = Path(__file__).resolve().parents[2]
HOLDER = """
import sys, time
from pathlib import Path
from bunraku.cli.manifest import exclusive_output
kind, *paths = sys.argv[1:]
with exclusive_output(**{kind: [Path(path) for path in paths]}):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def holder():
    """Start processes that hold places; give each once it does."""
    running = []

    def start(kind, *paths):
        process = subprocess.Popen(
            [sys.executable, "-c", HOLDER, kind, *map(str, paths)], stdout=subprocess.PIPE, text=True,
            env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        )  # fmt: skip
        running.append(process)
        assert process.stdout.readline() == "held\n"
        return process

    yield start
    for process in running:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.mark.parametrize(
    ("theirs", "ours"),
    [
        (("files", "out.glb"), {"files": ["out.glb"]}),
        (("files", "other.glb", "out.glb"), {"files": ["sub/../out.glb"]}),
        (("folders", "."), {"files": ["out.glb"]}),
        (("folders", "."), {"folders": ["sub"]}),
        (("files", "sub/out.glb"), {"folders": ["."]}),
    ],
)
def test_places_that_meet_are_refused(holder, tmp_path, theirs, ours):
    kind, *paths = theirs
    process = holder(kind, *(tmp_path / path for path in paths))
    ours = {kind: [tmp_path / path for path in paths] for kind, paths in ours.items()}
    with pytest.raises(FormatError, match=rf"\(process {process.pid}\) is writing here"), exclusive_output(**ours):
        pass
    process.send_signal(signal.SIGKILL)
    process.wait()
    with exclusive_output(**ours):  # what it left behind counts for nothing
        pass


def test_a_process_meets_itself_not_and_leaves_no_locks(holder, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    beside = holder("files", tmp_path / "beside.glb")
    with exclusive_output([tmp_path / "out.glb"]), exclusive_output([tmp_path / "out.glb", tmp_path / "more.glb"]):
        assert len(list(module._lock_folder().iterdir())) > 3
    with exclusive_output([tmp_path / "many" / f"{number}.glb" for number in range(1000)]):  # than files can be open
        pass
    beside.terminate()
    beside.wait()
    with exclusive_output([tmp_path / "beside.glb"]):
        pass
    assert list(module._lock_folder().iterdir()) == []


def test_a_run_of_the_command_line_is_refused_and_leaves_what_is_there(holder, good, fails, tmp_path):
    holder("files", tmp_path / "out.glb")
    for words in (["animate", good, "walks"], ["rig", good]):
        assert "another run of Bunraku" in fails(*words, "-o", tmp_path / "out.glb")
    for suffix in ("png", "mp4"):
        holder("files", tmp_path / f"picture.{suffix}")
        assert "another run of Bunraku" in fails("render", good, "-o", tmp_path / f"picture.{suffix}")
    holder("files", tmp_path / "mushroom.glb")
    assert "another run of Bunraku" in fails("samples", "person", "mushroom", "-o", tmp_path)
    holder("folders", tmp_path / "clips")
    (tmp_path / "prompts.txt").write_text("walks\n")
    assert "another run of Bunraku" in fails(
        "animate", good, "--prompts", tmp_path / "prompts.txt", "-o", tmp_path / "clips"
    )


def test_two_runs_at_once_into_one_folder_make_it_whole(good, tmp_path):
    """One of them is refused or finds the clips there; the folder is whole, and a third run has nothing to do."""
    (tmp_path / "prompts.txt").write_text("walks\nwaves\n")
    words = ["animate", good, "--prompts", tmp_path / "prompts.txt", "-o", tmp_path / "clips", "--seconds", 1,
             "--steps", 1, "--candidates", 1]  # fmt: skip
    command = [sys.executable, "-m", "bunraku", *map(str, words)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    runs = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment) for _ in range(2)]
    said = [run.communicate()[1] for run in runs]
    codes = sorted(run.returncode for run in runs)
    assert codes in ([0, 0], [0, 2]), said
    assert codes == [0, 0] or any("another run of Bunraku" in text for text in said)
    assert len(list((tmp_path / "clips").glob("*.glb"))) == 2
    assert main([str(word) for word in words]) == 0


def test_rig_writes_every_file_that_it_is_told(good, tmp_path):
    assert main(["rig", str(good), "-o", str(tmp_path / "a.glb"), "-o", str(tmp_path / "b.glb")]) == 0
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()
