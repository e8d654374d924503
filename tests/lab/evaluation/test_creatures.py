"""The classifier of actions, on made motions whose action is plain."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.motion import HandleMotion
from bunraku.errors import FormatError
from bunraku_lab.datasets.motions.clips import write_clip
from bunraku_lab.evaluation.motion.classifier import action_features
from bunraku_lab.evaluation.motion.creatures import (
    CLASSES,
    creature_accuracy,
    load_cases,
    main_action,
    real_accuracy,
    train_classifier,
)

KINDS = {
    "walk": (0.4, 1.0, 1.0),
    "run": (0.8, 2.5, 4.0),
    "idle": (0.03, 0.5, 0.0),
    "swim": (0.5, 1.0, 0.0),
    "death": (0.0, 1.0, 0.0),
    "attack": (0.9, 1.0, 0.0),
}


def motion_of(action, seed, frames=30):
    """Legs swing, the tail swings, the body falls over, the head darts forward: each in its own way, with some
    chance.
    """
    random = np.random.default_rng([seed, CLASSES.index(action)])
    size, rate, speed = (value * random.uniform(0.8, 1.2) for value in KINDS[action])
    moments = np.arange(frames) / 20
    part = {"swim": "tail", "attack": "neck"}.get(action)
    rotations = np.tile(np.eye(3), (frames, 30, 1, 1))
    swing = (
        size * np.sin(2 * np.pi * rate * moments)
        if action != "attack"
        else size * np.exp(-(((moments - 0.7) / 0.1) ** 2))
    )
    for handle, name in enumerate(HANDLE_NAMES):
        if (part and name.startswith(part)) or (not part and name.endswith(("hip", "knee"))):
            sign = -1 if name.startswith("right") else 1
            rotations[:, handle] = Rotation.from_rotvec(sign * swing[:, None] * [1, 0, 0]).as_matrix()
    fall = np.clip(moments, 0, 1) if action == "death" else 0 * moments
    root = Rotation.from_rotvec(1.5 * fall[:, None] * [0, 0, 1]).as_matrix()
    path = np.stack([0 * moments, -0.6 * fall, speed * moments], axis=1)
    return HandleMotion(np.zeros((frames, 30, 3)), rotations, path, root)


@pytest.fixture
def data(tmp_path):
    clips = {}
    for action in CLASSES:
        for seed in range(8):
            name = f"creature_{action}_{seed}"
            write_clip(tmp_path / f"{name}.npz", motion_of(action, seed))
            held = seed >= 6
            clips[name] = {
                "texts": [f"a {'dragon' if held else 'horse'} does {action}"], "species": "dragon" if held else "horse",
                "character": "pack/dragon" if held else "pack/horse",
                "action": "gallop" if action == "run" else action, "split": "test" if held else "train",
            }  # fmt: skip
    clips["person"] = {"texts": ["a person walks"], "split": "train"}
    (tmp_path / "index.json").write_text(json.dumps({"clips": clips}))
    return tmp_path


def test_plain_actions_are_told_apart(data):
    cases = load_cases(data, held_out=False)
    assert len(cases) == 36 and main_action("gallop") == "run" and main_action("dance") == "dance"
    classifier = train_classifier(cases)
    result = real_accuracy(classifier, load_cases(data, held_out=True))
    assert result["accuracy"] > 0.9 and set(result["by_class"]) == set(CLASSES)
    again = train_classifier(cases)
    assert np.array_equal(classifier.weights, again.weights)


def test_generated_clips_are_asked_for_with_the_characters_feature(data):
    asked = []

    def generate(text, feature, seconds, seed):
        asked.append((text, feature, seconds, seed))
        return motion_of(text.rsplit(" ", 1)[1], 100 + seed, frames=round(20 * seconds))

    feature = np.ones(448)
    result = creature_accuracy(generate, data, {"pack/dragon": feature}, seconds=2.0, seeds=(3, 4))
    assert result["clips"] == len(asked) == 12 and result["accuracy"] > 0.9 and result["real"]["accuracy"] > 0.9
    assert all(given is feature and seconds == 2.0 for _, given, seconds, _ in asked) and {
        seed for *_, seed in asked
    } == {3, 4}
    wrong = creature_accuracy(lambda *some: motion_of("idle", 0), data, {})
    assert wrong["accuracy"] == pytest.approx(1 / 6) and len(wrong["wrong"]) == 5


def test_where_a_creature_stands_and_faces_does_not_matter():
    motion = motion_of("walk", 0)
    turn = Rotation.from_euler("y", 80, degrees=True).as_matrix()
    moved = HandleMotion(
        motion.translations, motion.rotations, motion.root_translation @ turn.T + [3, 0, 1], turn @ motion.root_rotation
    )
    np.testing.assert_allclose(action_features(moved), action_features(motion), atol=1e-3)


def test_data_without_creatures_are_refused(tmp_path):
    (tmp_path / "index.json").write_text(
        json.dumps({"clips": {"person": {"texts": ["a person walks"], "split": "train"}}})
    )
    with pytest.raises(FormatError, match="creatures"):
        load_cases(tmp_path, held_out=True)
