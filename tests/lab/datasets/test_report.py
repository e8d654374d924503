import numpy as np
import pytest

from bunraku.body.layout import HANDLE_COUNT
from bunraku.core.motion import HandleMotion
from bunraku.geometry.rotations import matrix_y
from bunraku_lab.datasets.motions.clips import write_clip, write_index
from bunraku_lab.datasets.motions.report import motion_report, report_text


def body(frames, speed=0.0, turn=0.0, height=0.0):
    """A reference body that stands, slides ahead at a speed [m/s] and turns by so many radians."""
    path = np.zeros((frames, 3))
    path[:, 2], path[:, 1] = np.arange(frames) / 20 * speed, height
    still = np.tile(np.eye(3), (frames, HANDLE_COUNT, 1, 1))
    return HandleMotion(np.zeros((frames, HANDLE_COUNT, 3)), still, path, matrix_y(np.linspace(0, turn, frames)), 20.0)


def test_each_action_is_measured_and_what_is_dropped_is_named(tmp_path):
    write_clip(tmp_path / "walk.npz", body(100, speed=1.5), np.zeros(100))
    write_clip(tmp_path / "turn.npz", body(60, turn=np.pi / 2), np.full(60, 0.2))
    entry = {"source": "", "licence": "", "split": "train", "weight": 1.0, "texts": []}
    parts = [
        {"start": 0, "stop": 60, "texts": ["a person walks forward"]},
        {"start": 60, "stop": 100, "texts": ["a person walks on"], "fault": "frozen"},
    ]
    clips = {
        "walk": entry | {"frames": 100, "stretches": parts},
        "turn": entry | {"frames": 60, "texts": ["turn left"]},
        "dog": entry | {"frames": 9, "species": "dog", "texts": ["a dog walks"]},
    }
    write_index(tmp_path, clips)
    rows = motion_report(tmp_path)
    assert set(rows) == {"walk", "turn"}
    assert rows["walk"].seconds == [3.0] and rows["walk"].speed[0] == pytest.approx(1.5, abs=0.02)
    assert rows["walk"].contact == [0.0] and rows["walk"].dropped == {"frozen": 1}  # its feet slide, so none stands
    assert rows["turn"].turn[0] == pytest.approx(90, abs=3) and rows["turn"].contact[0] > 0.9
    assert rows["turn"].floating == [1.0]
    text = report_text(rows)
    assert "walk" in text and "frozen" in text and text.index("walk") < text.index("dropped")
