"""Clips of animals that creatures move after."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from bunraku.anatomy.anatomy import reference_anatomy
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES, HANDLE_PARENTS
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.core.motion import HandleMotion, line_up
from bunraku.errors import WeightsError
from bunraku.files import load_character, own_animation
from bunraku.files.samples import sample_character
from bunraku.language.parse import parse
from bunraku.pipelines.animator import Animator
from bunraku.pipelines.apply import adapt_sentence
from bunraku.pipelines.requests import Request
from bunraku.retarget import creature_clips
from bunraku.retarget.creature_clips import (
    CreatureClip,
    creature_action,
    creature_motion,
    own_clips,
    packed_clip,
)
from bunraku.retarget.creatures import CreatureMotion, fit_body
from bunraku.retarget.fit import Stages
from bunraku.retarget.rig_parts import understood_rig
from bunraku_lab.synthetic.samples import make_sample


def bowing(frames):
    """A body whose parts turn down and up again."""
    turns = np.zeros((frames, HANDLE_COUNT, 3))
    turns[:, 1:, 0] = 0.4 * np.sin(np.linspace(0, np.pi, frames))[:, None]
    still = np.tile(np.eye(3), (frames, 1, 1))
    rotations, translations = reference_anatomy().attached(matrix_from_axis_angle(turns))
    return HandleMotion(translations, rotations, np.zeros((frames, 3)), still)


def a_clip(action, frames=21):
    data = packed_clip(bowing(frames), np.linspace(0, 0.1, frames))
    return CreatureClip("wolf", action, "four legs", (0.0, 0.0), frames, data)


@pytest.fixture(scope="module")
def dog():
    return Animator.shipped().body(sample_character("dog"), Request(parse("it eats", 2.0)))


def test_a_packed_clip_is_the_same_to_a_millimetre_and_two_milliradians():
    motion, (found, heights) = bowing(21), a_clip("eat").unpacked
    away = axis_angle_from_matrix(found.rotations.swapaxes(-1, -2) @ motion.rotations)
    assert np.linalg.norm(away, axis=-1).max() < 0.003
    np.testing.assert_allclose(heights, np.linspace(0, 0.1, 21), atol=0.001)
    with pytest.raises(WeightsError, match="damaged"):
        _ = replace(a_clip("eat"), data=b"nonsense").unpacked


@pytest.mark.parametrize(
    ("said", "action"),
    [
        ("a wolf dies", "death"), ("a deer grazes", "eat"), ("death", "death"), ("Attack Headbutt", "headbutt"),
        ("a wolf thinks", ""), ("a wolf walks and eats", ""),
    ],
)  # fmt: skip
def test_a_single_action_of_a_creature_is_known_by_its_phrases(said, action):
    assert creature_action(said) == action


def test_a_meal_goes_on_and_a_death_is_held_at_its_end(monkeypatch, dog):
    monkeypatch.setattr(creature_clips, "shipped_clips", lambda: (a_clip("eat"), a_clip("death")))
    dies, dances = [
        adapt_sentence(parse(said), dog.anatomy.plan) for said in ("a dog eats:4; a dog dies:2", "a dog dances")
    ]
    motion = creature_motion(dies, dog.anatomy, seed=0).motion
    bent = np.linalg.norm(axis_angle_from_matrix(motion.rotations[:, 1]), axis=-1)
    assert len(motion) == 120
    assert min(bent[start : start + 28].max() for start in range(80 - 28)) > 0.3
    np.testing.assert_array_equal(motion.rotations[105:], motion.rotations[[-1] * 15])
    other = creature_motion(dies, dog.anatomy, seed=1).motion  # the same clips at another pace
    assert np.abs(other.rotations - motion.rotations).max() > 0.05
    assert creature_motion(dances, dog.anatomy, seed=0) is None


@pytest.mark.parametrize("name", ["dog", "dragon"])
def test_any_creature_bows_to_eat_leaps_to_attack_and_lies_at_rest_when_it_is_dead(name):
    body = Animator.shipped().body(sample_character(name), Request(parse("it eats", 4.0)))
    requests = [Request(parse(sentence, 4.0)) for sentence in ("it eats", "it attacks", "it dies")]
    meal, strike, death = (moved.vertices() for moved in Animator.shipped().each(body, requests))
    size, floor = np.ptp(body.character.vertices, axis=0), body.character.vertices[:, 1].min()
    head = body.anatomy.handles.weights[:, HANDLE_NAMES.index("head")] > 0.5
    low = meal[:, head, 1].min(axis=1) - floor
    assert low.min() < (0.1 * size[1] if name == "dog" else low[0] - 0.1 * size[1])
    assert np.ptp(strike.mean(axis=1)[:, 2]) > 0.2 * size[2]
    dead = death[-1].astype(float)
    assert abs(dead[:, 1].min() - floor) < 0.01 * size[1]
    up, _ = Rotation.align_vectors(
        dead - dead.mean(axis=0), body.character.vertices - body.character.vertices.mean(axis=0)
    )
    assert up.as_matrix()[1, 1] < 0.5  # it does not lie as it stood
    support = Delaunay(dead[dead[:, 1] < floor + 0.05 * size[1]][:, [0, 2]])
    assert support.find_simplex(body.character.areas @ dead[:, [0, 2]] / body.character.areas.sum()) >= 0


def stepping(frames=21):
    """One round of steps on the spot, which swings fore and hind legs of a body in turn."""
    turns = np.zeros((frames, HANDLE_COUNT, 3))
    phase = np.linspace(0, 2 * np.pi, frames)
    for name, below, ahead in (("hip", "knee", 0.0), ("shoulder", "elbow", np.pi)):
        for side, later in (("left", 0.0), ("right", np.pi)):
            at = phase + ahead + later
            turns[:, limb_below(f"{side}_{name}"), 0] += 0.35 * np.sin(at)[:, None]
            turns[:, limb_below(f"{side}_{below}"), 0] += 0.8 * np.maximum(-np.cos(at), 0)[:, None]  # lifted ahead
    still = np.tile(np.eye(3), (frames, 1, 1))
    rotations, translations = reference_anatomy().attached(matrix_from_axis_angle(turns))
    return HandleMotion(translations, rotations, np.zeros((frames, 3)), still)


def limb_below(name):
    """The handle of a limb's first part and those of all parts below it."""
    first = HANDLE_NAMES.index(name)
    return [handle for handle in range(HANDLE_COUNT) if first in line_up(handle, HANDLE_PARENTS)]


def test_steps_on_the_spot_get_a_body_ahead_by_what_its_feet_go_back(monkeypatch, dog):
    clip = CreatureClip("wolf", "walk", "four legs", (0.0, 0.0), 21, packed_clip(stepping(), np.zeros(21)))
    monkeypatch.setattr(creature_clips, "shipped_clips", lambda: (clip,))
    request = Request(parse("a dog walks forward", 4.0))
    moved = next(Animator.shipped().each(dog, [request])).vertices()
    ahead = (moved[-1] - moved[0])[:, 2].mean()
    assert ahead > 0.5 * dog.character.height
    low = moved[:, :, 1].min(axis=1, keepdims=True) + 0.02 * dog.character.height
    both = (moved[:-1, :, 1] < low[:-1]) & (moved[1:, :, 1] < low[1:])
    slides = [np.linalg.norm(np.diff(moved[[n, n + 1]][:, on][..., [0, 2]], axis=0), axis=-1).min()
              for n, on in enumerate(both) if on.any()]  # fmt: skip
    assert np.median(slides) < 0.01 * dog.character.height
    turned = adapt_sentence(parse("a dog walks in a circle"), dog.anatomy.plan)
    assert creature_motion(turned, dog.anatomy, seed=0) is None


def test_feet_that_drag_forward_carry_no_body_backward(monkeypatch, dog):
    """On a body unlike the animal's the feet may be low where the animal lifts them."""
    dragging = stepping().take(slice(None, None, -1))
    clip = CreatureClip("wolf", "walk", "four legs", (0.0, 0.0), 21, packed_clip(dragging, np.zeros(21)))
    monkeypatch.setattr(creature_clips, "shipped_clips", lambda: (clip,))
    moved = next(Animator.shipped().each(dog, [Request(parse("a dog walks forward", 4.0))])).vertices()
    assert (moved[-1] - moved[0])[:, 2].mean() > -0.05 * dog.character.height


def test_the_clips_of_a_file_show_what_its_creature_does(tmp_path):
    dog = make_sample("dog", rigged=True)
    meal = next(Animator.shipped().each(dog, [Request(parse("a dog eats", 3.0))]))
    meal.save(tmp_path / "dog.glb", name="Eating")
    parts = understood_rig(load_character(tmp_path / "dog.glb"))
    (clip,) = own_clips(parts, ("eat",))
    motion, _ = clip.unpacked
    played = own_animation(parts.character, 0, 20.0).vertices()
    again = fit_body(CreatureMotion(motion, parts.anatomy.plan, np.zeros(len(motion))), parts, Stages()).vertices()
    frames = min(len(played), len(again))
    assert np.abs(again[:frames] - played[:frames]).max(axis=(1, 2)).mean() < 0.1 * dog.height
    assert own_clips(parts, ("attack",)) == ()
