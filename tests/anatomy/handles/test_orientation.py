"""How characters stand: what the shipped weights see, and what is made of it."""

import time
from dataclasses import replace

import numpy as np
import pytest
from gltf_files import CUBE_FACES

from bunraku.anatomy.handles.orientation import SURE, Orientation, guess_orientation, resolve_axes, upright
from bunraku.anatomy.handles.orientation_evidence import Combination, ShapeView, gathered, kind_weights
from bunraku.core.character import Character
from bunraku.core.geometry.axes import ORIENTATIONS, default_orientation, upright_rotation
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.errors import OptionError, WeightsError
from bunraku.files.samples import sample_character, sample_names
from bunraku_lab.synthetic.samples import make_sample

try:
    shipped_checkpoint("orientation")
except WeightsError:
    pytest.skip("needs the shipped orientation weights", allow_module_level=True)


def laid(character, up, front):
    """The character lying so that `up` is up and `front` the front: `upright_rotation` undone."""
    rotation = upright_rotation(up, front)
    vertices = character.vertices @ rotation.astype(np.float32)
    return Character(character.name, vertices, character.faces, colors=character.colors)


@pytest.mark.parametrize("name", sample_names())
def test_the_samples_are_recognised_however_they_lie(name):
    character = sample_character(name)
    for up, front in ORIENTATIONS[::7]:
        guess = guess_orientation(laid(character, up, front))
        assert (guess.up, guess.front) == (up, front) and guess.confidence > 0.3
        assert guess.probabilities.sum() == pytest.approx(1)
        assert np.array_equal(guess.rotation, upright_rotation(up, front))


def test_a_rigged_figure_that_faces_backwards_is_turned():
    """Its bones and its shape say so, whatever rigged files are like."""
    person = make_sample("person", rigged=True)
    assert guess_orientation(person, suffix=".glb").front == "+z"
    turn = np.diag([-1.0, 1, -1, 1])
    rig = replace(person.rig, transforms=turn @ person.rig.transforms)
    back = Character("back", person.vertices @ turn[:3, :3].astype(np.float32), person.faces, rig=rig)
    found = resolve_axes(back, suffix=".glb")
    assert (found.up, found.front) == ("+y", "-z") and found.guess.sure


def test_turning_the_mesh_permutes_the_chances():
    character, even = sample_character("robot"), np.ones(24)
    chances = guess_orientation(character, prior=even).probabilities
    for up, front in ORIENTATIONS[::5]:
        rotation = upright_rotation(up, front)
        turns = [upright_rotation(*axes) @ rotation.T for axes in ORIENTATIONS]
        there = [
            next(n for n, axes in enumerate(ORIENTATIONS) if np.array_equal(upright_rotation(*axes), turn))
            for turn in turns
        ]
        seen = guess_orientation(laid(character, up, front), prior=even).probabilities
        assert np.abs(seen - chances[there]).max() < 1e-4


def test_the_format_weighs_what_the_mesh_says():
    character = sample_character("robot")
    seen = guess_orientation(character, prior=np.ones(24)).probabilities
    for suffix in ("", ".stl", ".glb"):
        both = guess_orientation(character, suffix=suffix).probabilities
        weights = kind_weights(suffix)
        assert both == pytest.approx(seen * weights / (seen * weights).sum(), abs=1e-6)


def test_size_does_not_matter_and_place_only_by_the_ground():
    character = sample_character("mushroom")
    chances = guess_orientation(character).probabilities
    for scale in (1e-4, 1780.0):
        other = Character("other", character.vertices.astype(np.float64) * scale, character.faces)
        assert np.abs(guess_orientation(other).probabilities - chances).max() < 0.02
    far = [
        guess_orientation(Character("far", character.vertices + move, character.faces)).probabilities
        for move in (np.float32([0, 50, 0]), np.float32([20, -30, 40]))
    ]
    assert np.abs(far[0] - far[1]).max() < 0.02


def chances(**weights):
    """Probabilities with these weights, such as yx for +Y up and +X ahead; what is left is even."""
    names = {name: (f"+{name[0]}", f"+{name[1]}") for name in weights}
    out = np.full(24, (1 - sum(weights.values())) / (24 - len(weights)))
    for name, weight in weights.items():
        out[ORIENTATIONS.index(names[name])] = weight
    return out


def test_up_is_summed_over_fronts_and_the_front_is_given_up():
    seen = np.zeros(24)
    for axes, chance in {("+z", "+x"): 0.4, ("+y", "+x"): 0.35, ("+y", "-x"): 0.25}.items():
        seen[ORIENTATIONS.index(axes)] = chance
    guess = Orientation.of(seen)
    assert (guess.up, guess.front) == ("+y", "+x")
    assert guess.up_confidence == pytest.approx(0.6) and guess.front_confidence == pytest.approx(0.35 / 0.6)
    assert guess.confidence == pytest.approx(0.35) and not guess.sure
    assert guess.next_best("+y", "+x") == ("+z", "+x") and guess.probability("+y", "-x") == pytest.approx(0.25)


def test_a_cow_keeps_its_sure_front_though_its_up_is_unsure():
    """Up +Y 86 %, front +X 98 % given that: facing +X was dropped for the default."""
    seen = np.zeros(24)
    for axes, chance in {("+y", "+x"): 0.86 * 0.98, ("+y", "-x"): 0.86 * 0.02, ("-y", "+x"): 0.14}.items():
        seen[ORIENTATIONS.index(axes)] = chance
    guess = Orientation.of(seen)
    assert guess.up_confidence == pytest.approx(0.86) and guess.front_confidence == pytest.approx(0.98)
    assert guess.likeliest == ("+y", "+x") and not guess.sure


def test_a_dragon_below_a_half_keeps_its_front():
    """Up +Y 38 %, front +X 91 % given that."""
    seen = chances(yx=0.38 * 0.91)
    for front in ("-x", "+z", "-z"):
        seen[ORIENTATIONS.index(("+y", front))] = 0.38 * 0.03
    rest = [n for n, (up, _) in enumerate(ORIENTATIONS) if up != "+y"]
    seen[rest] = 0.62 / len(rest)
    guess = Orientation.of(seen)
    assert guess.up_confidence == pytest.approx(0.38) and guess.front_confidence == pytest.approx(0.91)
    assert guess.likeliest == ("+y", "+x") and not guess.sure


def scorpion():
    """A flat body with legs on both sides and a tail that bends up behind, its lowest point at 0."""
    points = []
    for z in np.linspace(-0.5, 0.5, 21):
        points += [(side * width, height, z) for side in (-1, 1) for width in (0.05, 0.3) for height in (0.0, 0.1)]
    points += [(0.0, 0.1 + 0.8 * share, -0.5 + 0.3 * share**2) for share in np.linspace(0, 1, 15)]
    return np.array(points, np.float32)


def combined(seen, vertices, suffix):
    """Probabilities by the network, the vertices and the kind of file."""
    combination = Combination()
    logs = gathered(ShapeView(vertices))
    return combination(seen, logs, combination.worth(vertices), kind_weights(suffix))


def test_a_scorpion_with_its_lowest_point_at_0_does_not_stand_on_its_tail():
    """The network alone says that -Z is up."""
    seen = np.full(24, 0.12 / 22)
    seen[ORIENTATIONS.index(("-z", "+y"))], seen[ORIENTATIONS.index(("+y", "+z"))] = 0.75, 0.13
    alone = Orientation.of(Combination()(seen, gathered(ShapeView())))
    assert (alone.up, alone.front) == ("-z", "+y")
    found = Orientation.of(combined(seen, scorpion(), ".obj"))
    assert (found.up, found.front) == ("+y", "+z") and found.up_confidence > SURE
    laid_down = scorpion() @ upright_rotation("+z", "-y").astype(np.float32)
    rotation = upright_rotation("+z", "-y")
    turns = [upright_rotation(*axes) @ rotation.T for axes in ORIENTATIONS]
    there = [[np.array_equal(upright_rotation(*axes), turn) for axes in ORIENTATIONS].index(True) for turn in turns]
    found = Orientation.of(combined(seen[there], laid_down, ".stl"))
    assert (found.up, found.front) == ("+z", "-y")


def test_what_is_said_is_not_guessed():
    character = sample_character("robot")
    lying = laid(character, "+z", "-y")
    assert resolve_axes(lying, "+z", "-y").guess is None
    assert {
        (s.up, s.front)
        for s in (resolve_axes(lying, "Z"), resolve_axes(lying, front="-y"), resolve_axes(lying, "z", "-Y"))
    } == {("+z", "-y")}
    assert np.array_equal(upright(lying, "+z", "-y").vertices, character.vertices)
    assert upright(lying, "+x").vertices[:, 1] == pytest.approx(lying.vertices[:, 0])
    for up, front in (("+y", "-y"), ("z", "z"), ("up", "auto"), ("auto", "w")):
        with pytest.raises(OptionError):
            resolve_axes(character, up, front)


def test_what_nobody_says_and_no_guess_decides_is_usual():
    assert default_orientation() == ("+y", "+z")
    assert default_orientation("+z") == ("+z", "-y") and default_orientation(front="-x") == ("+y", "-x")
    assert default_orientation(front="+y") == ("+z", "+y") and default_orientation("-y") == ("-y", "+z")
    for up, front in ORIENTATIONS:
        assert default_orientation(up, front) == (up, front)
        assert default_orientation(up)[0] == up and default_orientation(front=front)[1] == front


def test_a_shape_that_tells_nothing_is_left_alone():
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    cube = Character("cube", corners, CUBE_FACES)
    settled = resolve_axes(cube)
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
