"""Each command of docs/tasks.md does what its row says, as it stands there."""

import re
import shlex
import struct
from pathlib import Path

import pytest

from bunraku.cli import main
from bunraku.files import load_character
from bunraku.files.clips import clip_names, load_animation
from bunraku.files.registry import load_with_clips

ROOT = Path(__file__).resolve().parents[1]
QUICK = ["--seconds", "1", "--steps", "4", "--candidates", "1"]
"""What is added, so that a test of the words does not wait for the motion."""
ROWS = re.findall(
    r"^\| ([^|]+) \| `bunraku ([^`]+)` \|", (ROOT / "docs" / "tasks.md").read_text(encoding="utf-8"), re.MULTILINE
)
MADE = {  # what is there afterwards, and the clips that it holds
    "a mesh that moves": {"knight-walks.glb": 1},
    "a loop on the spot for a game, at 60 frames a second": {"knight-runs.glb": 1},
    "ten sentences at once, one file each": {f"knight-clips/{number:03}": 1 for number in range(1, 11)},
    "four clips in one file": {"knight-moves.glb": ["idle", "walks-forward", "runs", "Attack"]},
    "a file moved by its own skeleton": {"hero-waves.glb": 1},
    "a captured motion on an avatar": {"avatar-walks.glb": 1},
    "that motion as a file for VRM programs": {"avatar-walks.vrma": None},
    "a clip from the library": {"knight-charleston.glb": 1},
    "an FBX file": {"knight-waves.fbx": 1},
    "clips for Unity": {"knight-unity.fbx": ["idle", "runs"]},
    "clips for Unreal": {"knight-unreal-idle.fbx": ["idle"], "knight-unreal-runs.fbx": ["runs"]},
    "clips for Godot": {"knight-godot.glb": ["idle", "runs"]},
    "clips for Blender": {"knight-blender.glb": ["idle", "runs"]},
    "a video of a clip": {"knight-walks.mp4": None},
}


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """The files that the page speaks of."""
    folder = tmp_path_factory.mktemp("tasks")
    assert main(["samples", "-o", str(folder)]) == 0
    return folder


def test_every_row_is_tried():
    assert [row for row, command in ROWS if command != "studio"] == list(MADE)


@pytest.mark.parametrize(("row", "command"), [one for one in ROWS if one[1] != "studio"], ids=lambda text: text[:24])
def test_a_command_does_what_its_row_says(row, command, home, monkeypatch):
    monkeypatch.chdir(home)
    if row == "a video of a clip" and not Path("knight-walks.glb").is_file():
        pytest.skip("it shows what the first row made")
    words = shlex.split(command)
    assert main([*words, *(QUICK if words[0] == "animate" else [])]) == 0
    for name, clips in MADE[row].items():
        (path,) = home.glob(f"{name}*")
        assert path.stat().st_size > 1000
        if clips is None:
            continue
        source = load_with_clips(path, 30.0).source.document
        assert clip_names(source) == clips if isinstance(clips, list) else len(clip_names(source)) == clips
        assert load_animation(path, 0, 30.0).vertices().std(axis=0).max() > 1e-3


def test_the_loop_for_a_game_closes_on_the_spot_at_its_rate(home, monkeypatch):
    monkeypatch.chdir(home)
    (command,) = [command for _, command in ROWS if "--loop --in-place" in command]
    if not Path("knight-runs.glb").is_file():
        assert main([*shlex.split(command), *QUICK]) == 0
    data = Path("knight-runs.glb").read_bytes()
    assert data[20 : 20 + struct.unpack("<I", data[12:16])[0]].count(b'"animations"') == 1
    posed = load_animation("knight-runs.glb", 0, 60.0).vertices()
    size = load_character("knight-runs.glb").height
    assert len(posed) == 61 and abs(posed[-1] - posed[0]).max() < 0.02 * size
    assert abs(posed.mean(axis=1)[:, [0, 2]] - posed.mean(axis=(0, 1))[[0, 2]]).max() < 0.15 * size
