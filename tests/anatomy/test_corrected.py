"""What a person says about a character in the file beside it."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import bunraku
from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.corrected import corrected_handles
from bunraku.anatomy.handles.predict import predict_handles
from bunraku.anatomy.scene import separated
from bunraku.cli.app import main
from bunraku.core.body.layout import HANDLE_INDEX
from bunraku.core.character import Character
from bunraku.errors import FormatError
from bunraku.files import rotated, save_character
from bunraku_lab.synthetic.samples import make_sample

KNEE, HEAD, WRIST = (HANDLE_INDEX[name] for name in ("left_knee", "head", "left_wrist"))


@pytest.fixture(scope="module")
def person():
    body = make_sample("person")
    return Character("one", body.vertices, body.faces)


@pytest.fixture(scope="module")
def handles(person):
    return predict_handles(person)


def said(character, folder, text, name="one"):
    """A character read from a file with corrections beside it."""
    path = save_character(character, folder / f"{name}.glb")
    (folder / f"{name}.body.toml").write_text(text)
    return bunraku.load_character(path)


def test_a_joint_that_is_moved_takes_the_skin_along_and_nothing_else(person, handles, tmp_path):
    before = Anatomy.of(person, handles).joints.positions[KNEE]
    lower = before - [0, 0.12, 0]
    character = said(person, tmp_path, f"[joints]\nleft_knee = {lower.tolist()}\n")
    after = corrected_handles(character, handles)
    np.testing.assert_allclose(Anatomy.of(character, after).joints.positions[KNEE], lower, atol=1e-6)
    shin, was = (person.vertices[some.weights.argmax(axis=1) == KNEE, 1].max() for some in (after, handles))
    assert shin < was - 0.06
    moved = np.abs(after.weights - handles.weights).sum(axis=1) > 0.05
    assert (np.abs(person.vertices[moved] - before) < 0.3).all()
    again = corrected_handles(character, bunraku.rig(replace(character, corrections=None))).top(4)  # as the studio does
    assert np.array_equal(bunraku.rig(character).weights, again.weights)


def test_pieces_are_what_they_are_said_to_be(person, handles, tmp_path):
    hand = person.vertices[handles.weights.argmax(axis=1) == WRIST].mean(axis=0)
    sword = trimesh.creation.box((0.03, 0.03, 0.8)).apply_translation(hand)
    plate = trimesh.creation.box((0.3, 0.4, 0.3)).apply_translation([2.0, 0.2, 0])
    count = len(person.vertices)
    whole = Character(
        "one",
        np.concatenate([person.vertices, sword.vertices, plate.vertices]),
        np.concatenate([person.faces, sword.faces + count, plate.faces + count + len(sword.vertices)]),
    )
    weights = np.zeros((len(whole.vertices), 30), np.float32)
    weights[:count], weights[count:, 0] = handles.weights, 1
    found = replace(handles, weights=weights)
    text = "".join(
        f'[[part]]\nkind = "{kind}"\nat = [{np.round(at, 4).tolist()}]\n'
        for kind, at in (("prop", hand + [0, 0, 0.4]), ("ground", plate.vertices[0]), ("hair", [0.1, 1.0, 0.12]))
    )
    character = separated(said(whole, tmp_path, text))[0]
    after = corrected_handles(character, found)
    held = after.weights[count : count + len(sword.vertices)]
    assert (held[:, WRIST] == 1).all()  # it goes with the hand that it touches
    assert character.beside[count + len(sword.vertices) :].all() and not character.beside[:count].any()
    assert (after.weights[:count].argmax(axis=1) == HEAD).sum() > (handles.weights.argmax(axis=1) == HEAD).sum()


def test_axes_are_heard_once_by_every_door(person, tmp_path, capsys):
    lying = rotated(person, "+y", "-x")
    text = 'up = "+y"\nfront = "+x"\n'
    character = said(replace(lying, name="one"), tmp_path, text)
    upright = bunraku.upright(character)
    expected = person.vertices
    np.testing.assert_allclose(upright.vertices, expected, atol=1e-5)
    assert bunraku.upright(bunraku.upright(character)).vertices.tobytes() == upright.vertices.tobytes()
    moved = bunraku.animate(tmp_path / "one.glb", "walks forward", seconds=1, candidates=1)
    travel = moved.motion.root_translation[-1] - moved.motion.root_translation[0]
    assert travel[2] > 0.3 > abs(travel[0])
    np.testing.assert_allclose(moved.character.vertices, expected, atol=1e-5)
    capsys.readouterr()
    assert main(["inspect", str(tmp_path / "one.glb"), "--json", "--body", str(tmp_path / "two.body.toml")]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["orientation"]["taken_front"] == "+x"
    lines = (tmp_path / "two.body.toml").read_text().splitlines()
    assert 'front = "+x"' in lines and any(line.startswith("# left_knee = [") for line in lines)
    assert [line for line in lines if line.startswith("# kind = ")].count('# kind = "leg"') == 2


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("up = 3", "up must be a text"),
        ('up = "+y"\nfront = "-y"', "along the same axis"),
        ("[joints]\nknie = [0, 0, 0]", "there is no joint 'knie'"),
        ("[joints]\nleft_knee = [0, 0]", "three"),
        ("[joints]\nleft_knee = [0, 0, nan]", "finite"),
        ('[[part]]\nkind = "sword"\nat = [[0, 0, 0]]', "kind is one of body, arm"),
        ('[[part]]\nkind = "prop"\nat = []', "at least one point"),
        ("ground = 1", "the file has no 'ground'"),
        ("up = ", "this is not TOML"),
        ("character = " + "9" * 5000, "this is not TOML"),
    ],
)
def test_mistakes_get_a_sentence_that_names_the_file(person, tmp_path, text, part):
    with pytest.raises(FormatError, match=r"one\.body\.toml: ") as error:
        said(person, tmp_path, text)
    assert part in str(error.value) and "\n" not in str(error.value)
