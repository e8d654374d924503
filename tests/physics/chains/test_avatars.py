"""Chains in files of other programs: what is written is read back, and VRM's steps are those of its specification."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku import load_character, save_character, transfer, with_skeleton
from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.character import Character
from bunraku.core.mmd_model import mmd_model
from bunraku.core.rig_animation import RigAnimation
from bunraku.core.vrm_model import vrm_model
from bunraku.errors import CharacterError
from bunraku.formats.gltf.container.open import open_document
from bunraku.physics.chains.avatars import mmd_avatar, vrm_avatar
from bunraku.physics.chains.laid import Chained
from bunraku.physics.chains.moving import steady_simulation
from bunraku.physics.chains.vrm_fit import fitted_springs
from bunraku.physics.vrm_steps import VrmValues, between_frames, link_turns, vrm_steps
from bunraku.pipelines.animate import rig
from bunraku.pipelines.clothes import rig_with_chains
from bunraku.samples import sample_character
from bunraku_lab.evaluation.transfer.stock_motions import stock_motion
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


def swung(turns: np.ndarray, heads: np.ndarray, rest: np.ndarray, values: np.ndarray, fps: float) -> np.ndarray:
    """Tails of a chain by VRM's steps, link by link, shape (N, R, 3); values are of shape (R, 3)."""
    turns, heads = between_frames(turns[:, None], heads[:, None], fps)
    out = []
    for bone, one in zip(rest[:, None], values, strict=True):
        tails = np.stack(list(vrm_steps(turns, heads, bone, VrmValues(*one[:, None, None]))))[:, :, 0]
        turns, heads = link_turns(turns, heads, bone, tails), tails
        out.append(tails[:: round(60 / fps), 0])
    return np.stack(out, axis=1)


def test_springs_of_vrm_go_about_as_the_chains_do_in_a_walk_that_they_were_not_fitted_to(made: Chained) -> None:
    moved = transfer(made.character, stock_motion("walk", 3.0, 30.0), onto="rig")
    assert isinstance(moved, RigAnimation)
    turns, places = (values.astype(np.float64) for values in moved.world())
    ours = steady_simulation(moved, made.rig()).animation.world()[1]
    apart = rigid = 0.0
    for chain, end, values in zip(made.chains, made.ends, fitted_springs(made), strict=True):
        tails = [*chain.bones[1:], end]
        found = swung(turns[:, chain.holder], places[:, chain.bones[0]], np.diff(chain.points, axis=0), values, 30.0)
        apart += float(np.linalg.norm(found - ours[:, tails], axis=-1).mean())
        rigid += float(np.linalg.norm(places[:, tails] - ours[:, tails], axis=-1).mean())
    assert apart < 0.75 * rigid


def test_steps_of_a_spring() -> None:
    """Two links swing as the specification says, step by step."""
    turns, heads = np.tile(np.eye(3), (5, 1, 1)), np.zeros((5, 3))
    heads[1:, 0] = 0.1
    rest = np.array([[0.0, -0.2, 0], [0.0, -0.1, 0.05]])
    values = np.array([[0.5, 0.3, 0.1], [0.2, 0.1, 0.0]])
    found = swung(turns, heads, rest, values, 60.0)
    now = np.cumsum(rest, axis=0)
    before = now.copy()
    for frame in range(1, 5):
        head, turn, new = heads[frame], np.eye(3), now.copy()
        for link, (stiffness, drag, gravity) in enumerate(values):
            length, aim = np.linalg.norm(rest[link]), turn @ rest[link] / np.linalg.norm(rest[link])
            there = now[link] + (1 - drag) * (now[link] - before[link]) + stiffness / 60 * aim - [0, gravity / 60, 0]
            there = head + length * (there - head) / np.linalg.norm(there - head)
            turn = Rotation.align_vectors([there - head], [aim * length])[0].as_matrix() @ turn
            new[link] = head = there
        before, now = now, new
        np.testing.assert_allclose(found[frame], now, atol=1e-9)
