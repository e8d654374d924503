"""Apparel in pipelines, and clothes added to a character."""

import inspect
from dataclasses import replace

import numpy as np
import pytest
import torch

from bunraku.anatomy.anatomy import Anatomy
from bunraku.apparel.clothed import BESIDE
from bunraku.apparel.fitting import eased_border, fitted_clothes, joints_of_handles
from bunraku.apparel.learned.network import DisplacementConfig
from bunraku.apparel.part_network import PartConfig
from bunraku.cli.options import ApparelOptions
from bunraku.core.animation import Animation, PointAnimation
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character
from bunraku.core.geometry.surface import vertex_areas
from bunraku.errors import CharacterError, OptionError
from bunraku.files.samples import sample_character
from bunraku.pipelines.animate import animate, rig
from bunraku.pipelines.apparel import dressed, learned
from bunraku.pipelines.clothes import MOST, body_of_handles, excess_apparel_note, may_have_apparel, separate_apparel
from bunraku.pipelines.requests import Apparel, Constraints, Loop, Request
from bunraku.pipelines.transfer import transfer
from bunraku_lab.nn.apparel import DisplacementNetwork
from bunraku_lab.nn.parts import PartNetwork
from bunraku_lab.synthetic.stock_motions import stock_motion

MOTION = stock_motion("walk", 1.0, 20.0)


@pytest.fixture
def weights(tmp_path, monkeypatch):
    """Networks that know nothing, in place of the shipped ones."""
    torch.manual_seed(0)
    for name in ("apparel", "apparel-guessed"):
        DisplacementNetwork(DisplacementConfig(8, 1, 0)).save(tmp_path / f"{name}.safetensors")
    PartNetwork(PartConfig(8, 16, 16, 1, 2, 1, 1)).save(tmp_path / "parts.safetensors")
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path))
    return tmp_path


@pytest.fixture(scope="module")
def animation():
    """The reference body with an apron, on its handles."""
    body = reference_body()
    x, y = np.meshgrid(np.linspace(-0.1, 0.1, 5), np.linspace(0, 0.4, 6))
    apron = np.stack([x, body.joints[0, 1] - y, np.full_like(x, body.joints[0, 2] + 0.2)], axis=-1).reshape(-1, 3)
    index = np.arange(30).reshape(6, 5)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    faces = np.concatenate([body.faces, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]) + len(body.vertices)])
    character = replace(
        body.character(),
        rig=None,
        vertices=np.concatenate([body.vertices, apron]).astype(np.float32),
        faces=faces,
        colors=None,
    )
    own = np.zeros((30, body.handles.weights.shape[1]), np.float32)
    own[:, 1] = 1  # its skin says the left thigh
    handles = replace(body.handles, weights=np.concatenate([body.handles.weights, own]).astype(np.float32))
    return Animation(character, handles, MOTION)


def apron_of(animation: Animation) -> np.ndarray:
    return np.arange(len(animation.character.vertices)) >= len(animation.character.vertices) - 30


def test_apparel_of_a_mesh_on_handles_moves(animation, weights):
    mask = apron_of(animation)
    result = learned(animation, mask, safe=False)
    assert isinstance(result, PointAnimation) and result.fps == 30 and len(result.offsets) == len(result.motion)
    assert np.abs(result.offsets[:, ~mask]).max() == 0
    # the network knows nothing, so the apron goes with the pelvis, whatever its skin says
    affine = result.motion.transforms(result.handles.positions)[:, 0]
    rest = animation.character.vertices[mask]
    wanted = np.einsum("nab,vb->nva", affine[..., :3], rest) + affine[:, None, :, 3]
    np.testing.assert_allclose(result.vertices()[:, mask], wanted, atol=0.01)


def test_a_mask_file_is_taken(animation, weights, tmp_path):
    np.save(tmp_path / "mask.npy", apron_of(animation).astype(np.float32))
    result = dressed(animation, Apparel(str(tmp_path / "mask.npy")))
    assert isinstance(result, PointAnimation)
    saved = result.save(tmp_path / "out.glb")
    assert saved.stat().st_size > 1000
    assert dressed(animation, Apparel("none")) is animation and dressed(animation, Apparel("rigid")) is animation


def test_what_a_request_knows_of_the_body_is_not_asked_again(animation):
    anatomy = Anatomy.of(animation.character, animation.handles)
    vars(anatomy)["plan"] = replace(anatomy.plan, arms=False, wings=False)  # as if it were no person
    assert dressed(animation, Apparel("auto"), anatomy=anatomy) is animation


def test_the_command_and_python_move_apparel_alike_where_nothing_is_said():
    said = {inspect.signature(function).parameters["apparel"].default for function in (animate, transfer)}
    assert said == {Apparel().motion} == {ApparelOptions().motion}
    assert not Apparel().moves and not Apparel("rigid").moves


def test_no_apparel_is_said(animation, weights):
    with pytest.raises(CharacterError, match="no apparel was found"):
        learned(animation, np.zeros(len(animation.character.vertices), bool))


def test_options_that_cannot_be():
    for apparel in ("auto", "none", "rigid", "simulate", "learn", "mine.npy"):
        Apparel(apparel).check()
    with pytest.raises(OptionError, match="learn"):
        Apparel("float").check()
    with pytest.raises(OptionError, match="stiffness"):
        Apparel("learn", 0.0).check()
    with pytest.raises(OptionError, match="loop"):
        Request("walks", constraints=Constraints([Loop()]), apparel=Apparel("learn")).check()
    Request("walks", constraints=Constraints([Loop()]), apparel=Apparel("none")).check()


def test_parts_hang_on_what_they_touch(animation):
    body = reference_body()
    mask = apron_of(animation)
    character: Character = animation.character
    weights = np.concatenate([body.joint_weights, np.eye(22, dtype=np.float32)[np.full(30, 1)]])
    clothed = fitted_clothes(character.vertices, character.faces, body.joints, weights, mask)
    assert clothed.part.max() == 0 and (clothed.weights[mask].argmax(axis=1) == 0).all()
    np.testing.assert_array_equal(clothed.weights[~mask], weights[~mask])


def test_a_sheet_is_not_torn_where_its_mask_has_an_edge(animation):
    body, character = reference_body(), animation.character
    weights = np.concatenate([body.joint_weights, np.eye(22, dtype=np.float32)[np.full(30, 1)]])

    def eased(mask):
        clothed = fitted_clothes(character.vertices, character.faces, body.joints, weights, mask)
        return clothed, eased_border(clothed)

    apron = apron_of(animation)
    np.testing.assert_array_equal(eased(apron)[1], apron)  # a piece of its own goes whole
    edge = float(np.median(character.vertices[~apron, 1]))
    clothed, share = eased((character.vertices[:, 1] > edge) & ~apron)
    up = (character.vertices[:, 1] - edge) / clothed.scale
    assert (share[up <= 0] == 0).all() and (share[(up > BESIDE) & ~apron] == 1).all()
    near = (up > 0) & (up < 0.3 * BESIDE) & ~apron
    assert near.sum() > 20 and share[near].mean() < 0.5  # not 0: border vertices are a few centimetres apart


def test_joints_lie_between_their_handles():
    body = reference_body()
    joints = joints_of_handles(
        body.vertices, body.joint_weights, vertex_areas(body.vertices, body.faces), body.handles.positions
    )
    gap = np.linalg.norm(joints - body.joints, axis=1)
    assert np.median(gap) < 0.06 * np.ptp(body.vertices[:, 1])


def test_animals_wear_nothing() -> None:
    dog = sample_character("dog")
    assert not may_have_apparel(Anatomy.of(dog, rig(dog)))


def test_a_mask_counts_on_anybody() -> None:
    dog = sample_character("dog")
    mask = dog.vertices[:, 1] > np.quantile(dog.vertices[:, 1], 0.8)
    weights, joints = body_of_handles(dog, rig(dog))
    assert separate_apparel(dog, joints, weights, mask).apparel.any()


def test_too_much_is_asked_about() -> None:
    person = sample_character("person")
    order = np.argsort(person.vertices[:, 1])
    share = np.cumsum(person.areas[order]) / person.areas.sum()
    little, much = np.zeros(len(order), bool), np.zeros(len(order), bool)
    little[order[share < MOST - 0.05]] = True
    much[order[share < MOST + 0.05]] = True
    assert excess_apparel_note(person, little) == ""
    assert f"{MOST + 0.05:.0%}" in excess_apparel_note(person, much) and "mask" in excess_apparel_note(person, much)
