"""Chains in files of other programs: what is written is read back, and VRM's steps are those of its specification."""

from pathlib import Path

import numpy as np
import pytest

from bunraku import load_character, save_character, with_skeleton
from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.character import Character
from bunraku.core.mmd_model import mmd_model
from bunraku.core.vrm_model import vrm_model
from bunraku.errors import CharacterError
from bunraku.formats.gltf.container.open import open_document
from bunraku.physics.chains.avatars import mmd_avatar, vrm_avatar
from bunraku.physics.chains.laid import Chained
from bunraku.physics.vrm_steps import VrmValues, vrm_tails
from bunraku.pipelines.animate import rig
from bunraku.pipelines.clothes import rig_with_chains
from bunraku.samples import sample_character
from bunraku_lab.synthetic.wardrobe import wardrobe_character


@pytest.fixture(scope="module")
def made() -> Chained:
    """Twin tails on a bare mesh, on VRM's skeleton."""
    model = wardrobe_character(810_003)
    bare = Character("tails", model.vertices, model.faces)
    return rig_with_chains(Anatomy.of(bare, rig(bare)), "vrm")


def test_vrm_is_read_back(made: Chained, tmp_path: Path) -> None:
    avatar = vrm_avatar(made)
    path = save_character(made.character, tmp_path / "tails.vrm", rig=True, avatar=avatar)
    read = load_character(path)
    found = vrm_model(read)
    assert found is not None and found.version == "1.0" and not found.warnings
    assert {"hips", "head", "leftHand", "rightFoot"} <= found.humanoid.keys()
    assert len(found.springs) == len(made.chains)
    for mine, theirs in zip(avatar.springs, found.springs, strict=True):
        assert [joint.node for joint in mine.joints] == [joint.node for joint in theirs.joints]
        for one, other in zip(mine.joints, theirs.joints, strict=True):
            assert one.stiffness == pytest.approx(other.stiffness, abs=1e-5)
            assert one.drag == pytest.approx(other.drag, abs=1e-5)
    assert len(found.colliders) == len(avatar.colliders)
    assert read.rig is not None and made.character.rig is not None
    np.testing.assert_allclose(read.rig.positions, made.character.rig.positions, atol=1e-5)


def test_springs_in_the_extras_of_a_glb(made: Chained, tmp_path: Path) -> None:
    path = save_character(made.character, tmp_path / "tails.glb", rig=True, avatar=vrm_avatar(made))
    tree = open_document(path, path.read_bytes()).tree
    springs = tree["extras"]["springs"]["springs"]  # type: ignore[index]
    names = [node.get("name") for node in tree["nodes"]]  # type: ignore[attr-defined]
    assert [names[spring["joints"][0]["node"]] for spring in springs] == [f"{chain.name}_1" for chain in made.chains]
    assert "VRMC_springBone" not in tree.get("extensions", {})  # type: ignore[operator]


def test_pmx_is_read_back(made: Chained, tmp_path: Path) -> None:
    path = save_character(made.character, tmp_path / "tails.pmx", rig=True, avatar=mmd_avatar(made))
    found, own = mmd_model(load_character(path)), made.rig()
    assert found is not None and not found.warnings
    assert [body.name for body in found.bodies] == [body.name for body in own.bodies]
    for mine, theirs in zip(own.joints, found.joints, strict=True):
        assert mine.bodies == theirs.bodies
        np.testing.assert_allclose(theirs.angle_upper, mine.angle_upper, atol=1e-6)
        np.testing.assert_allclose(theirs.position, mine.position, atol=1e-6)


def test_a_vrm_needs_its_skeleton(tmp_path: Path) -> None:
    character = sample_character("person")
    with pytest.raises(CharacterError, match="skeleton"):
        save_character(character, tmp_path / "person.vrm")
    with pytest.raises(CharacterError, match="T-pose"):
        save_character(with_skeleton(character, "mixamo"), tmp_path / "person.vrm", rig=True)
    assert not list(tmp_path.iterdir())


def test_steps_of_a_spring() -> None:
    """A single link without gravity swings as the specification says, step by step."""
    turns = np.tile(np.eye(3), (4, 1, 1))
    heads = np.zeros((4, 3))
    heads[1:, 0] = 0.1
    stiffness, drag = 0.5, 0.3
    values = VrmValues(np.array([stiffness]), np.array([drag]), np.array([0.0]))
    found = vrm_tails(turns, heads, np.array([[0.0, -0.2, 0]]), values, 60.0)[0, :, 0]
    before = now = np.array([0.0, -0.2, 0])
    for frame in range(1, 4):
        new = now + (1 - drag) * (now - before) + stiffness / 60 * np.array([0.0, -1, 0])
        new = heads[frame] + 0.2 * (new - heads[frame]) / np.linalg.norm(new - heads[frame])
        before, now = now, new
        np.testing.assert_allclose(found[frame], now, atol=1e-12)
