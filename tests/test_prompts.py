"""The words matter: with the shipped weights, different sentences give motions that differ in what the words say."""

from functools import cache

import numpy as np
import pytest

from bunraku.core.animation import Animation
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import heading
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.pipelines.animate import animate

pytestmark = pytest.mark.skipif(
    not shipped_checkpoint("diffusion").is_file(), reason="the shipped weights are not there"
)
SEEDS = 3


@cache
def performances(prompt):
    """The reference body's animations of a sentence, 3 s, one a seed."""
    body = reference_body()
    return tuple(
        animate(body.character(), prompt, seconds=3.0, seed=seed, handles=body.handles) for seed in range(SEEDS)
    )


def part(animation: Animation, name: str) -> np.ndarray:
    """Path of the middle of a part [m], shape (N, 3)."""
    weights = animation.handles.weights[:, HANDLE_NAMES.index(name)]
    return animation.vertices().transpose(0, 2, 1) @ (weights / weights.sum())


def median(measure, prompt):
    return float(np.median([measure(animation) for animation in performances(prompt)]))


def speed(animation):
    path = animation.motion.root_translation[:, [0, 2]]
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) / animation.motion.duration


def forward(animation):
    return float(animation.motion.root_translation[-1, 2] - animation.motion.root_translation[0, 2])


def turned(animation):
    return float(np.degrees(np.ptp(heading(animation.motion.root_rotation))))


def highest(name):
    return lambda animation: float(part(animation, name)[:, 1].max())


def test_walking_goes_forward_and_running_is_faster():
    assert median(forward, "a person walks forward") > 1.5
    assert median(speed, "a person runs forward") > 1.5 * median(speed, "a person walks forward")
    assert median(speed, "a person waves with the right hand") < 0.4 * median(speed, "a person walks forward")


def test_walking_backwards_goes_back():
    assert median(forward, "a person walks backwards") < -0.5


@pytest.mark.parametrize(("side", "other"), [("left", "right"), ("right", "left")])
def test_waving_raises_the_hand_that_is_named(side, other):
    prompt = f"a person waves with the {side} hand"
    assert median(highest(f"{side}_wrist"), prompt) > median(highest(f"{other}_wrist"), prompt) + 0.2
    assert median(highest(f"{side}_wrist"), prompt) > 1.2


def test_kicking_raises_a_foot():
    def foot(animation):
        return max(highest("left_ankle")(animation), highest("right_ankle")(animation))

    assert median(foot, "a person kicks") > 0.5
    assert median(foot, "a person kicks") > median(foot, "a person walks forward") + 0.1


def test_squatting_lowers_the_hips():
    def lowest_hips(animation):
        return float(part(animation, "pelvis")[:, 1].min())

    assert median(lowest_hips, "a person does a squat") < 0.75 * median(lowest_hips, "a person walks forward")


def test_turning_turns():
    assert median(turned, "a person turns around") > 90
    assert median(turned, "a person walks forward") < 60


def test_jumping_leaves_the_ground():
    def rise(animation):
        feet = np.minimum(part(animation, "left_ankle")[:, 1], part(animation, "right_ankle")[:, 1])
        return float(feet.max() - np.quantile(feet, 0.1))

    assert median(rise, "a person jumps") > median(rise, "a person walks forward") + 0.03


def test_dancing_moves_the_arms_and_the_body():
    def busy(animation):
        return sum(
            float(np.linalg.norm(np.diff(part(animation, f"{side}_wrist"), axis=0), axis=1).sum())
            for side in ("left", "right")
        )

    assert median(busy, "a person dances") > 1.3 * median(busy, "a person stands still")
