"""Springs in the page, against VRM's specification as the library has it."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from bunraku.core.character import Character, Rig
from bunraku.core.vrm_model import VrmCollider, VrmModel, VrmSpring, VrmSpringJoint
from bunraku.geometry.rotations import matrix_from_axis_angle, quaternion_from_matrix
from bunraku.io import save_character
from bunraku.physics.vrm_steps import VrmValues, between_frames, link_turns, vrm_steps

STUDIO = Path(__file__).resolve().parents[2] / "studio"
DOWN = np.array([0.0, -1, 0])


@pytest.fixture(scope="module")
def swung(tmp_path_factory):
    """Where the page's springs take bones: of a rod of four links and its poses."""
    if shutil.which("node") is None or not (STUDIO / "node_modules" / ".bin" / "rolldown").exists():
        pytest.skip("the page's tools are not installed: make studio")
    folder = tmp_path_factory.mktemp("springs")
    script = folder / "springs.mjs"
    packer = ["node_modules/.bin/rolldown", str(Path(__file__).with_name("springs.ts")), "--platform", "node"]
    subprocess.run([*packer, "--format", "esm", "-o", str(script)], cwd=STUDIO, check=True, capture_output=True)

    def run(spring, turns, places, colliders=()):
        avatar = VrmModel(
            "1.0", "rod", {}, (spring,), tuple(colliders), (tuple(range(len(colliders))),) * bool(colliders)
        )
        save_character(rod(), folder / "rod.glb", rig=True, avatar=avatar)
        poses = [
            {"turn": turn.tolist(), "place": place.tolist()}
            for turn, place in zip(quaternion_from_matrix(turns), places, strict=True)
        ]
        (folder / "poses.json").write_text(json.dumps(poses))
        words = ["node", str(script), str(folder / "rod.glb"), str(folder / "poses.json")]
        return np.array(json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout))

    return run


def rod():
    """A holder at the origin, three links that hang from it, and their end."""
    places = np.array([[0.0, 1.5, 0], [0.1, 1.5, 0], [0.15, 1.35, 0.05], [0.15, 1.2, 0.02], [0.2, 1.1, 0]])
    transforms = np.tile(np.eye(4), (5, 1, 1))
    transforms[:, :3, 3] = places
    vertices = np.concatenate([places, places + [0.0, 0, 0.02], places + [0.02, 0, 0]]).astype(np.float32)
    faces = np.array([[bone, bone + 5, bone + 10] for bone in range(5)])
    rig = Rig(tuple("abcde"), np.arange(-1, 4), transforms, np.tile(np.arange(5), 3)[:, None], np.ones((15, 1)))
    return Character("rod", vertices, faces, rig)


def swaying(frames=240):
    time = np.arange(frames) / 60
    angles = np.stack([0.3 * np.sin(5 * time), 0.8 * np.sin(2.2 * time), 0.1 * np.sin(7 * time)], axis=1)
    places = np.array([0.0, 1.5, 0]) + np.stack([0.2 * np.sin(3 * time), 0 * time, 0.1 * np.sin(4 * time)], axis=1)
    return matrix_from_axis_angle(angles), places


@pytest.mark.parametrize(("stiffness", "drag", "gravity"), [(1.0, 0.3, 0.1), (0.2, 0.1, 0.0), (4.0, 0.7, 0.3)])
def test_the_page_swings_springs_as_the_specification_says(swung, stiffness, drag, gravity):
    joints = tuple(VrmSpringJoint(bone, stiffness, gravity, DOWN, drag, 0.0) for bone in (1, 2, 3, 4))
    turns, places = swaying()
    rest = rod().rig.positions
    heads = places + np.einsum("nij,j->ni", turns, rest[1] - rest[0])
    values = VrmValues(*(np.array([[value]]) for value in (stiffness, drag, gravity)))
    turn, head = between_frames(turns[:, None], heads[:, None], 60.0)
    links = []
    for bone in np.diff(rest[1:], axis=0)[:, None]:
        links.append(np.stack(list(vrm_steps(turn, head, bone, values)))[:, :, 0])
        turn, head = link_turns(turn, head, bone, links[-1]), links[-1]
    wanted = np.concatenate(links, axis=1)
    found = swung(VrmSpring("rod", joints, ()), turns, places)
    assert np.abs(wanted[:, 2] - wanted[:1, 2]).max() > 0.2
    np.testing.assert_allclose(found[:, 2:], wanted, atol=2e-5)


def test_a_collider_keeps_springs_out_and_lengths_stay(swung):
    joints = tuple(VrmSpringJoint(bone, 0.1, 1.0, DOWN, 0.3, 0.02) for bone in (1, 2, 3, 4))
    ball = VrmCollider(0, "capsule", np.array([0.15, -0.45, -0.3]), 0.08, np.array([0.15, -0.45, 0.3]))
    turns, places = np.tile(np.eye(3), (240, 1, 1)), np.tile([0.0, 1.5, 0], (240, 1))
    free = swung(VrmSpring("rod", joints, ()), turns, places)
    kept = swung(VrmSpring("rod", joints, (0,)), turns, places, [ball])

    def near(found):  # of the tails to the axis of the capsule, which lies along z
        return np.linalg.norm(found[-1, 2:, :2] - [0.15, 1.05], axis=-1).min()

    assert near(free) < 0.08 and near(kept) > 0.099
    lengths = np.linalg.norm(np.diff(kept[:, 1:], axis=1), axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(lengths[0], lengths.shape), atol=1e-5)
