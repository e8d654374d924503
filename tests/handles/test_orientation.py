"""How characters stand: what the shipped weights see, and what is made of it."""

import time

import numpy as np
import pytest

from bunraku.core.character import Character
from bunraku.errors import OptionError, WeightsError
from bunraku.geometry.axes import ORIENTATIONS, default_orientation, upright_rotation
from bunraku.handles.orientation import HABITS, SURE, guess_orientation, settle, upright
from bunraku.nn.checkpoints import shipped_checkpoint
from bunraku.synthetic.samples import sample_character, sample_names

try:
    shipped_checkpoint("orientation")
except WeightsError:
    pytest.skip("needs the shipped orientation weights", allow_module_level=True)


def laid(character, up, front):
    """The character lying so that `up` is up and `front` the front: `upright_rotation` undone."""
    rotation = upright_rotation(up, front)
    return Character(character.name, character.vertices @ rotation.astype(np.float32), character.faces)


@pytest.mark.parametrize("name", sample_names())
def test_the_samples_are_recognised_however_they_lie(name):
    character = sample_character(name)
    for up, front in ORIENTATIONS[::7]:
        guess = guess_orientation(laid(character, up, front))
        assert (guess.up, guess.front) == (up, front) and guess.confidence > 0.3
        assert guess.chances.sum() == pytest.approx(1)
        assert np.array_equal(guess.rotation, upright_rotation(up, front))


def test_turning_the_mesh_permutes_the_chances():
    character, even = sample_character("robot"), np.ones(24)
    chances = guess_orientation(character, prior=even).chances
    for up, front in ORIENTATIONS[::5]:
        rotation = upright_rotation(up, front)
        turns = [upright_rotation(*axes) @ rotation.T for axes in ORIENTATIONS]
        there = [
            next(n for n, axes in enumerate(ORIENTATIONS) if np.array_equal(upright_rotation(*axes), turn))
            for turn in turns
        ]
        assert np.abs(guess_orientation(laid(character, up, front), prior=even).chances - chances[there]).max() < 1e-4


def test_habits_weigh_what_the_shape_says():
    assert (
        HABITS.sum() == pytest.approx(1)
        and HABITS.argmax() == ORIENTATIONS.index(("+y", "+z"))
        and HABITS.min() > 0.005
    )
    character = sample_character("robot")
    shape, both = guess_orientation(character, prior=np.ones(24)).chances, guess_orientation(character).chances
    assert both == pytest.approx(shape * HABITS / (shape * HABITS).sum(), abs=1e-6)


def test_size_and_place_do_not_matter():
    character = sample_character("mushroom")
    chances = guess_orientation(character).chances
    for scale, move in ((1e-4, 0.0), (1780.0, 1e4)):
        other = Character("other", character.vertices.astype(np.float64) * scale + move, character.faces)
        assert np.abs(guess_orientation(other).chances - chances).max() < 0.02


def test_what_is_said_is_not_guessed():
    character = sample_character("robot")
    lying = laid(character, "+z", "-y")
    assert settle(lying, "+z", "-y").guess is None
    assert {(s.up, s.front) for s in (settle(lying, "Z"), settle(lying, front="-y"), settle(lying, "z", "-Y"))} == {
        ("+z", "-y")
    }
    assert np.array_equal(upright(lying, "+z", "-y").vertices, character.vertices)
    assert upright(lying, "+x").vertices[:, 1] == pytest.approx(lying.vertices[:, 0])
    for up, front in (("+y", "-y"), ("z", "z"), ("up", "auto"), ("auto", "w")):
        with pytest.raises(OptionError):
            settle(character, up, front)


def test_what_nobody_says_and_no_guess_decides_is_usual():
    assert default_orientation() == ("+y", "+z")
    assert default_orientation("+z") == ("+z", "-y") and default_orientation(front="-x") == ("+y", "-x")
    assert default_orientation(front="+y") == ("+z", "+y") and default_orientation("-y") == ("-y", "+z")
    for up, front in ORIENTATIONS:
        assert default_orientation(up, front) == (up, front)
        assert default_orientation(up)[0] == up and default_orientation(front=front)[1] == front
    lying = laid(sample_character("robot"), "+z", "-y")
    settled = settle(lying, sure=1.1)
    assert (settled.up, settled.front) == ("+y", "+z") and settled.guess is not None


def test_a_shape_that_tells_nothing_is_left_alone():
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    faces = [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ]
    cube = Character("cube", corners, faces)
    settled = settle(cube)
    assert settled.guess.confidence < SURE and (settled.up, settled.front) == ("+y", "+z") and upright(cube) is cube
    flat = Character("flat", [[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    assert upright(flat).name == "flat"


def test_a_large_mesh_is_quick():
    character = sample_character("person")
    large = Character(
        "large",
        np.tile(character.vertices, (12, 1)),
        np.concatenate([character.faces + n * len(character.vertices) for n in range(12)]),
    )
    guess_orientation(character)
    start = time.process_time()
    guess_orientation(large)
    assert time.process_time() - start < 1.5  # 0.3 s on a free core
