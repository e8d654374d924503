"""Skeletal motion from FBX: Blender's clips against Blender's vertices, hand-written curves against another reader."""

import json

import numpy as np
import pytest
from fbx_files import Scene
from test_fbx import DATA, from_blender, saved, unpacked

from bunraku import FormatError, OptionError, load_character
from bunraku.files.fbx.clips import load_fbx_motion


def data(right: float, left: float, *weights: int) -> list[float]:
    """Slopes after a key and before the next, and how long their tangents are in 1 / 9999 of the span."""
    first, second = weights or (3333, 3333)
    return [right, left, float(np.array([first | (second << 16)], np.uint32).view(np.float32)[0]), 0]


def moved(tmp_path, *tracks) -> list[np.ndarray]:
    """X, Y and Z of one joint over 2.7 s, for each track."""
    out = []
    for axes in tracks:
        scene = Scene(UnitScaleFactor=100.0)
        joint = scene.model("Root")
        layer = scene.clip()
        scene.track(layer, joint, "Lcl Translation", **axes)
        scene.track(layer, joint, "Lcl Scaling", X=([0, 2.7], [1, 1]))
        out.append(load_fbx_motion(saved(scene, tmp_path), fps=10).root_translation[:28])
    return out


@pytest.mark.parametrize("name", ["boxman_z_up_cm", "boxman_y_up_m"])
def test_the_joints_carry_the_mesh_as_in_blender(tmp_path, name):
    path, blender = unpacked(name, tmp_path), np.load(DATA / "boxman.npz")
    character, motion = load_character(path), load_fbx_motion(path, "Wave", fps=24)
    rotations, positions = motion.world()
    order = [motion.skeleton.names.index(joint) for joint in character.rig.names]
    rest = motion.skeleton.positions[order]
    assert np.abs(rest - character.rig.positions).max() < 1e-6
    turned = (
        np.einsum("njab,vjb->nvja", rotations[:, order], character.vertices[:, None] - rest)
        + positions[:, order][:, None]
    )
    posed = np.einsum("vj,nvja->nva", character.rig.dense_weights(), turned)
    frames = np.round(blender["times"] * 24).astype(int)
    assert np.abs(posed[frames] - from_blender(blender["posed"])).max() < 3e-6


def test_curves_are_those_of_another_reader(tmp_path):
    expected = json.loads((DATA / "fbx_expected.json").read_text())
    user, bent = 8 | 0x400, 8 | 0x400 | 0x0100_0000 | 0x0200_0000
    got = moved(tmp_path, {
        "X": ([0, 0.5, 1.5], [0, 5, -2], [user] * 3, [data(3, -8), data(2, 20), data(0, 0)]),
        "Y": ([0, 1], [1, 3], [2, 2], [data(0, 0)] * 2),
        "Z": ([0, 1.2], [1, 3], [bent] * 2, [data(10, 100, 7000, 1500), data(0, 0)]),
    })[0]  # fmt: skip
    assert np.abs(got.T - expected["curves"]).max() < 1e-3


def test_automatic_tangents_are_those_of_another_reader(tmp_path):
    expected = iter(json.loads((DATA / "fbx_expected.json").read_text())["auto"])
    for flag in (0x108, 0x1108, 0x2108, 0x6108, 0x508):
        more = [flag] * 4, [data(0, 0)] * 4
        got = moved(
            tmp_path,
            {"X": ([0, 0.5, 1.5, 2.5], [0, 90, 20, 30], *more), "Y": ([0, 0.5, 1.5, 2.5], [0, 10, 60, 61], *more)},
        )[0]
        assert np.abs(got[:, 0] - next(expected)).max() < 1e-3
        assert np.abs(got[:, 1] - next(expected)).max() < 1e-3


def walker(tmp_path, hip=None, **joint):
    scene = Scene(UnitScaleFactor=100.0)
    hips = scene.model("Hips", Lcl_Translation=(0.0, 1.0, 0.0), **(hip or {}))
    leg = scene.model("Leg", below=hips, Lcl_Translation=(0.5, 0.0, 0.0), **joint)
    scene.model("Foot", below=leg, Lcl_Translation=(0.0, -1.0, 0.0))
    return scene, hips, leg


def test_joints_without_keys_keep_their_place_and_empty_clips_are_passed_over(tmp_path):
    scene, _, leg = walker(tmp_path)
    scene.clip("Take 001")
    scene.track(scene.clip("Armature|Kick"), leg, "Lcl Rotation", X=([0, 1], [0, -90]))
    path = saved(scene, tmp_path)
    positions = load_fbx_motion(path, fps=10).world()[1]
    assert np.allclose(positions[0], [[0, 1, 0], [0.5, 1, 0], [0.5, 0, 0]], atol=1e-6)
    assert np.allclose(positions[-1], [[0, 1, 0], [0.5, 1, 0], [0.5, 1, 1]], atol=1e-6)
    assert len(load_fbx_motion(path, "Kick")) == len(load_fbx_motion(path, 0)) == 21
    with pytest.raises(OptionError, match=r"has no clip 'Jump'; it has Armature\|Kick"):
        load_fbx_motion(path, "Jump")


@pytest.mark.parametrize("most", [True, False])
def test_joints_oriented_by_pre_rotation_rest_without_keys(tmp_path, most):
    oriented = {"RotationActive": 1, "PreRotation": (0.0, 0.0, 90.0)}
    scene, _, leg = walker(tmp_path, oriented if most else None, **oriented, Lcl_Rotation=(90.0, 0.0, 0.0))
    scene.track(scene.clip(), leg, "Lcl Rotation", X=([0, 1], [0, 0]))
    rest = load_fbx_motion(saved(scene, tmp_path)).skeleton.positions
    # Most joints oriented: the keys of the default pose do not count. One of three: it is the rest pose as it is.
    assert np.allclose(
        rest, [[0, 1, 0], [0, 1.5, 0], [0, 2.5, 0]] if most else [[0, 1, 0], [0.5, 1, 0], [0.5, 1, -1]], atol=1e-6
    )


def test_endless_clips_are_refused(tmp_path):
    scene, _, leg = walker(tmp_path)
    scene.track(scene.clip(), leg, "Lcl Rotation", X=([0, 1e8], [0, 90]))
    with pytest.raises(FormatError, match="too many to read"):
        load_fbx_motion(saved(scene, tmp_path))
