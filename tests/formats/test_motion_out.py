"""Motions written as BVH, VRMA and NPZ, and read again; VRMA also as a file that says its T-pose with turned nodes."""

import json
import struct
from contextlib import suppress

import numpy as np
import pytest
from gltf_files import Maker
from motion_files import walk_about
from scipy.spatial.transform import Rotation

from bunraku.body.from_handles import skeleton_from_handles
from bunraku.body.reference import reference_body
from bunraku.core.motion import SkeletalMotion
from bunraku.errors import BunrakuError, FormatError, OptionError
from bunraku.formats.vrm.vrma import VRM_BONES
from bunraku.io import load_character
from bunraku.io.registry import read_motion
from bunraku.retarget.from_mesh import handle_motion_of_body
from bunraku.skeletons.to_smpl import to_smpl


def degrees(a, b):
    turns = np.swapaxes(a, -1, -2).astype(float) @ b
    return np.degrees(Rotation.from_matrix(turns.reshape(-1, 3, 3)).magnitude())


def matched(motion, names):
    """Which joint has each name."""
    return [motion.skeleton.names.index(name) for name in names]


@pytest.fixture(scope="module")
def motion():
    return walk_about(frames=31)


@pytest.fixture(scope="module")
def handles(motion):
    return handle_motion_of_body(motion)


@pytest.mark.parametrize("options", [{}, {"unit": "m", "up": "+z", "order": "xyz"}])
def test_a_handle_motion_as_bvh(handles, tmp_path, options):
    read = read_motion(handles.save(tmp_path / "walk.bvh", **options))
    want = skeleton_from_handles(handles)
    order = matched(read, want.skeleton.names)
    assert read.fps == pytest.approx(20)
    if options:  # a file in metres with +Z up says neither: it is read by its looks
        read = to_smpl(read)
        assert degrees(read.world()[0], to_smpl(want).world()[0]).max() < 0.01
    else:
        assert degrees(read.rotations[:, order], want.rotations).max() < 0.01  # the bar of the issue
        assert np.abs(read.root_translation - want.root_translation).max() < 1e-5


def test_a_handle_motion_as_npz_is_itself(handles, motion, tmp_path):
    assert np.array_equal(read_motion(handles.save(tmp_path / "walk.npz")).rotations, handles.rotations)
    with pytest.raises(OptionError, match="of a skeleton"):
        motion.save(tmp_path / "walk.npz")


def test_vrma_written_and_read_again(motion, tmp_path):
    read = read_motion(motion.save(tmp_path / "walk.vrma"))
    order = matched(read, [VRM_BONES[name] for name in motion.skeleton.names])
    assert read.fps == 20 and len(read) == len(motion)
    assert degrees(read.world()[0][:, order], motion.world()[0]).max() < 0.01
    assert np.abs(read.world()[1][:, order] - motion.world()[1]).max() < 1e-4
    assert (
        degrees(to_smpl(read).world()[0], motion.world()[0]).mean() < 1.5
    )  # limbs pointed into the reference's T-pose by their build


def test_what_a_vrma_says(motion, tmp_path):
    data = motion.save(tmp_path / "walk.vrma", fps=60, name="stroll").read_bytes()
    tree = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    extension = tree["extensions"]["VRMC_vrm_animation"]
    assert (
        extension["specVersion"] == "1.0"
        and tree["extensionsUsed"] == ["VRMC_vrm_animation"]
        and tree["animations"][0]["name"] == "stroll"
    )
    bones = extension["humanoid"]["humanBones"]
    required = {"hips", "spine", "head"} | {f"{side}{part}" for side in ("left", "right") for part in (
        "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot")}  # fmt: skip
    assert required <= set(bones)
    paths = {(channel["target"]["node"], channel["target"]["path"]) for channel in tree["animations"][0]["channels"]}
    assert {node for node, path in paths if path == "translation"} == {bones["hips"]["node"]}  # players take no other
    assert tree["accessors"][tree["animations"][0]["samplers"][0]["input"]]["count"] == 91
    assert tree["nodes"][0]["translation"][1] == pytest.approx(
        float(reference_body().joints[0, 1]), rel=1e-3
    )  # they scale by it


def vrma(turn, bones=("hips", "leftUpperLeg", "rightUpperLeg", "leftLowerLeg", "rightLowerLeg"), **extension):
    """A VRMA whose nodes are turned at rest, with the hips under another node, and half a second of CUBICSPLINE
    keys.
    """
    maker = Maker()
    x, y, z, w = Rotation.from_rotvec(turn).as_quat()
    keys = maker.add(np.array([0, 0.5], np.float32), bounds=True)
    bend = Rotation.from_rotvec([0.8, 0, 0])
    rest = Rotation.from_rotvec(turn)
    start, end = (
        rest.as_quat(),
        (bend * rest).as_quat(),
    )  # leftUpperLeg bends about the axis that is X in the T-pose of the hips' children
    flat = np.zeros((2, 3, 4), np.float32)
    flat[0, 1], flat[1, 1] = start, end
    nodes = [
        {"name": "above", "children": [1], "translation": [0, 0.5, 0]},
        {"name": "a", "children": [2, 3], "translation": [0, 0.4, 0]},
        {"name": "b", "children": [4], "translation": [0.1, -0.05, 0], "rotation": [x, y, z, w]},
        {"name": "c", "children": [5], "translation": [-0.1, -0.05, 0]},
        {"name": "d", "translation": rest.inv().apply([0, -0.4, 0]).tolist()},
        {"name": "e", "translation": [0, -0.4, 0]},
    ]
    clip = {
        "channels": [{"sampler": 0, "target": {"node": 2, "path": "rotation"}}],
        "samplers": [{"input": keys, "output": maker.add(flat.reshape(6, 4)), "interpolation": "CUBICSPLINE"}],
    }
    human = {name: {"node": node} for node, name in enumerate(bones, 1)}
    return maker.glb(
        nodes=nodes, animations=[clip], extensionsUsed=["VRMC_vrm_animation"],
        extensions={"VRMC_vrm_animation": {"specVersion": "1.0", "humanoid": {"humanBones": human}, **extension}},
    )  # fmt: skip


@pytest.mark.parametrize("turn", [[0.0, 0, 0], [0.3, -1.2, 2.0]])
def test_nodes_turned_at_rest_say_the_same(tmp_path, turn):
    (tmp_path / "bend.vrma").write_bytes(vrma(turn))
    read = read_motion(tmp_path / "bend.vrma")
    assert set(read.skeleton.names) == {"hips", "leftUpperLeg", "rightUpperLeg", "leftLowerLeg", "rightLowerLeg"}
    assert read.fps == 2 and len(read) == 2 and np.allclose(read.root_translation, [0, 0.9, 0], atol=1e-6)
    world, positions = read.world()
    leg, knee = matched(read, ("leftUpperLeg", "leftLowerLeg"))
    assert np.allclose(world[0], np.eye(3), atol=1e-6)
    assert np.allclose(world[1, [leg, knee]], Rotation.from_rotvec([0.8, 0, 0]).as_matrix(), atol=1e-6)
    assert np.allclose(positions[1, knee], [0.1, 0.85 - 0.4 * np.cos(0.8), -0.4 * np.sin(0.8)], atol=1e-6)


@pytest.mark.parametrize(
    ("broken", "says"),
    [
        ({"humanoid": {"humanBones": {"spine": {"node": 1}}}}, "no humanoid with hips"),
        ({"humanoid": {"humanBones": {"hips": {"node": 99}}}}, "whole number"),
        ({"humanoid": {"humanBones": {"hips": {"node": 1}, "spine": {"node": 1}}}}, "two of its bones"),
        ({"humanoid": {"humanBones": {"hips": {"node": 2}, "spine": {"node": 1}}}}, "do not all hang on the hips"),
        ({"humanoid": {"humanBones": {"hips": 5}}}, "no object"),
    ],
)
def test_broken_vrma(tmp_path, broken, says):
    (tmp_path / "bad.vrma").write_bytes(vrma([0.0, 0, 0], **broken))
    with pytest.raises(FormatError, match=says):
        read_motion(tmp_path / "bad.vrma")


def test_other_skeletons_become_smpls(motion, tmp_path):
    names = tuple(f"mixamorig:{name}" for name in (
        "Hips", "LeftUpLeg", "RightUpLeg", "Spine", "LeftLeg", "RightLeg", "Spine1", "LeftFoot", "RightFoot", "Spine2",
        "LeftToeBase", "RightToeBase",
        "Neck", "LeftShoulder", "RightShoulder", "Head", "LeftArm", "RightArm", "LeftForeArm", "RightForeArm",
        "LeftHand", "RightHand"))  # fmt: skip
    skeleton = type(motion.skeleton)(names, motion.skeleton.parents, motion.skeleton.offsets)
    other = SkeletalMotion(skeleton, motion.rotations, motion.root_translation, motion.fps)
    read = read_motion(other.save(tmp_path / "walk.vrma"))
    order = matched(read, [VRM_BONES[name] for name in motion.skeleton.names])
    assert degrees(read.world()[0][:, order], motion.world()[0]).max() < 0.1


def test_a_vrma_is_no_character(motion, tmp_path):
    with pytest.raises(Exception, match="walk.vrma"):
        load_character(motion.save(tmp_path / "walk.vrma"))
    with pytest.raises(OptionError, match="fps must be"):
        motion.save(tmp_path / "walk.vrma", fps=0)


def test_flipped_and_missing_bytes_give_a_motion_or_one_sentence(motion, tmp_path):
    data, rng, path = motion.save(tmp_path / "walk.vrma").read_bytes(), np.random.default_rng(0), tmp_path / "bad.vrma"
    text = 20 + struct.unpack_from("<I", data, 12)[0]
    for trial in range(120):
        broken = bytearray(data)
        for _ in range(3):
            broken[int(rng.integers(0, text if trial % 2 else len(data)))] = int(rng.integers(0, 256))
        path.write_bytes(broken if trial % 4 else data[: int(rng.integers(1, len(data)))])
        with suppress(BunrakuError):
            read_motion(path)


def test_a_vrma_that_means_harm_gets_one_sentence(tmp_path, monkeypatch):
    def refused(match, maker, nodes, hips, channels, samplers):
        humanoid = {"humanBones": {"hips": {"node": hips}}}
        clip = {"channels": channels, "samplers": samplers}
        (tmp_path / "bad.vrma").write_bytes(
            maker.glb(nodes=nodes, animations=[clip], extensions={"VRMC_vrm_animation": {"humanoid": humanoid}})
        )
        with pytest.raises(FormatError, match=match):
            read_motion(tmp_path / "bad.vrma")

    maker, deep = Maker(), 3000  # of 18,001 frames, 7 GB
    keys, values = maker.add(np.array([0, 1, 5, 600], np.float32), bounds=True), maker.add(np.zeros((4, 3), np.float32))
    sampler, move = {"input": keys, "output": values}, {"sampler": 0, "target": {"node": 0, "path": "translation"}}
    refused(
        "nodes in 18001 frames",
        maker,
        [{"children": [node + 1]} for node in range(deep)] + [{}],
        deep,
        [move],
        [sampler],
    )
    monkeypatch.setattr("bunraku.formats.gltf.curves.MAX_KEYS", 100_000)
    maker, count = Maker(), 1000  # the same keys for 101 nodes
    sampler = {
        "input": maker.add(np.arange(count, dtype=np.float32) / 100, bounds=True),
        "output": maker.add(np.zeros((count, 3), np.float32)),
    }
    moves = [{"sampler": 0, "target": {"node": node, "path": "translation"}} for node in range(101)]
    refused("more than 100,000 keys", maker, [{} for _ in range(101)], 0, moves, [sampler])
    strange = {"sampler": 0, "target": {"node": 0, "path": []}}
    refused("does not exist", Maker(), [{}], 0, [strange, move], [{}])
