"""The action test on motions whose action is plain, and its forty actions."""

import json

import numpy as np
import pytest

from bunraku.diffusion.features import decode, encode, mirror
from bunraku.errors import FormatError
from bunraku.language.lexicon.reading import main_actions
from bunraku_lab.datasets.motions.clips import write_clip
from bunraku_lab.evaluation.motion.viewer.action_test import (
    SENTENCES,
    ActionClip,
    action_clips,
    by_turns,
    named,
    person_features,
)


def index(folder, name, stretches):
    path = folder / "index.json"
    clips = json.loads(path.read_text())["clips"] if path.is_file() else {}
    path.write_text(json.dumps({"clips": clips | {name: {"texts": ["a"], "split": "train", "stretches": stretches}}}))


@pytest.fixture
def clips(features):
    """Ten waves of an arm and ten of a leg, each from a file of its own."""
    return [
        ActionClip(f"{handle}{number}", action, decode(features(handle, frames=40 + number)))
        for handle, action in (("left_elbow", "wave"), ("right_knee", "kick"))
        for number in range(10)
    ]


def test_clips_are_named_by_a_classifier_of_the_others(clips):
    answers = by_turns(clips)
    assert named([clip.action for clip in clips], answers)["accuracy"] > 0.9
    lone = [ActionClip("only", clip.action, clip.motion) for clip in clips]
    assert set(by_turns(lone)) == {""}  # all of one file: there are no others to learn from


def test_accuracy_is_the_mean_over_actions():
    found = named(["walk", "walk", "walk", "kick"], ["walk", "walk", "run", "kick"])
    assert found["by_action"] == {"kick": 1.0, "walk": pytest.approx(2 / 3)} and found["accuracy"] == pytest.approx(
        5 / 6
    )


def test_left_and_right_are_the_same_action(features):
    motion = decode(features("left_elbow", frames=50))
    mirrored = decode(mirror(encode(motion)))
    seen, other = person_features(motion), person_features(mirrored)
    np.testing.assert_allclose(seen[96:], other[96:], atol=2e-3)


def test_stretches_of_one_action_are_taken(tmp_path, features):
    motion = decode(features("left_elbow", frames=60))
    part = {"start": 0, "stop": 40, "texts": ["someone waves a hand", "wave"]}
    two = {"start": 0, "stop": 60, "texts": ["someone walks and waves", "walk and wave"]}
    faulty = {**part, "fault": "floats"}
    short = {**part, "stop": 10}
    for name, stretches in (("a", [part, short]), ("b", [two]), ("c", [faulty])):
        write_clip(tmp_path / f"{name}.npz", motion)
        index(tmp_path, name, stretches)
    found = action_clips(tmp_path)
    assert [(clip.clip, clip.action, len(clip.motion)) for clip in found] == [("a", "wave", 40)]
    index(tmp_path, "a", [two])  # in place of the first
    with pytest.raises(FormatError, match="no captured clips of single actions"):
        action_clips(tmp_path)


def test_forty_actions_are_asked_for_in_sentences_that_name_them():
    assert len(SENTENCES) == 40
    for action, sentences in SENTENCES.items():
        assert len(set(sentences)) == 2
        assert any(action in main_actions([sentence]) for sentence in sentences), action
