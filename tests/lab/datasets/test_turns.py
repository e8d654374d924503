"""Turns found in motions whose heading is known."""

import json

import numpy as np
import pytest

from bunraku.core.motion import HandleMotion
from bunraku.errors import FormatError
from bunraku.geometry.rotations import heading, matrix_y
from bunraku_lab.datasets.motions.clips import load_clip, write_clip
from bunraku_lab.datasets.motions.turns import add_turns, find_turn


def walker(degrees, frames=160, radius=0.0):
    """Stands for 40 frames, turns within 40, stands again; or walks a circle while turning."""
    angle = np.radians(degrees) * np.clip((np.arange(frames) - 40) / 40, 0, 1)
    path = radius * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    still = np.broadcast_to(np.eye(3), (frames, 30, 3, 3))
    return HandleMotion(np.zeros((frames, 30, 3)), still, path, matrix_y(angle), 20.0)


@pytest.mark.parametrize("degrees", [170, -170])
def test_a_turn_is_found_with_its_direction(degrees):
    start, stop, change = find_turn(walker(degrees))
    assert start <= 45 and stop >= 75 and change == pytest.approx(np.radians(degrees), abs=0.4)


def test_what_is_no_turn_on_the_spot():
    assert find_turn(walker(60)) is None
    assert find_turn(walker(170, radius=2.0)) is None
    assert find_turn(walker(170, frames=45)) is None


def test_turns_join_the_index_with_their_direction(tmp_path):
    clips = {}
    for name, degrees, text in (
        ("a", 170, "walk"),
        ("b", -170, "a person walks"),
        ("c", 170, "salsa dance"),
        ("d", 40, "walk"),
    ):
        write_clip(tmp_path / f"{name}.npz", walker(degrees))
        clips[name] = {"texts": [text], "split": "train", "frames": 160, "weight": 1.0}
    (tmp_path / "index.json").write_text(json.dumps({"clips": clips}))
    assert add_turns(tmp_path) == ["turn_a", "turn_b"]
    index = json.loads((tmp_path / "index.json").read_text())["clips"]
    assert index["turn_a"]["texts"] == ["a person turns around to the left"]
    assert index["turn_b"]["texts"] == ["a person turns around to the right"]
    turn = load_clip(tmp_path / "turn_a.npz")
    assert len(turn) == index["turn_a"]["frames"] < 90
    assert np.ptp(heading(turn.root_rotation)) > 2.5


def test_an_index_cannot_name_a_file_outside_its_folder(tmp_path):
    (tmp_path / "index.json").write_text(json.dumps({"clips": {"../outside": {"texts": ["walk"], "split": "train"}}}))
    with pytest.raises(FormatError, match="not a plain name"):
        add_turns(tmp_path)
