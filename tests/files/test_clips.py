"""Clips of files: choosing, merging, and motion that is written as motion alone."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, Maker, made_up_handles, made_up_motion
from hostile import damaged, outcomes
from motion_files import walk_about
from scipy.spatial.transform import Rotation

import bunraku
from bunraku.anatomy.names.to_smpl import to_smpl
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.body.joint_rotations import skeleton_from_handles
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import SkeletalMotion
from bunraku.errors import FormatError, MotionError, OptionError
from bunraku.files import save_character
from bunraku.files.clips import load_animation, load_clip, load_clip_animation, merge
from bunraku.files.gltf.open import open_document
from bunraku.files.gltf.vrma import VRM_BONES
from bunraku.files.gltf.write import KEY
from bunraku.files.presets import save_clips
from bunraku.files.registry import read_motion
from bunraku_lab.datasets.motions.build import handle_motion_of_body

ARRAYS = ("translations", "rotations", "root_translation", "root_rotation")


@pytest.fixture
def animation():
    cube = Character("cube", CUBE, CUBE_FACES)
    motion = made_up_motion(cube)
    return Animation(cube, made_up_handles(cube), motion, motion.take(np.arange(len(motion))[::-1]))


def same(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ARRAYS) and one.fps == other.fps


@pytest.mark.parametrize("suffix", ["npz", "glb"])
def test_motions_come_back_bit_for_bit(animation, tmp_path, suffix):
    path = animation.save(tmp_path / f"clip.{suffix}", **({"fps": 30} if suffix == "glb" else {}))
    clip = load_clip(path)
    assert (
        same(clip.motion, animation.motion)
        and same(clip.reference, animation.reference)
        and same(read_motion(path), animation.motion)
    )
    assert clip.is_of(animation.handles) and clip.on(animation.character, animation.handles).reference is clip.reference
    again = Animation(animation.character, animation.handles, clip.motion, clip.reference).save(
        tmp_path / f"again.{suffix}"
    )
    assert same(load_clip(again).motion, animation.motion)


@pytest.mark.parametrize("roles", [None, {26: 1, 27: 4}])
def test_a_glb_brings_its_character_and_handles(animation, tmp_path, roles):
    handles = animation.handles
    if roles:
        played = np.arange(30)
        played[list(roles)] = list(roles.values())
        handles = Handles(handles.positions, handles.weights, roles=played)
    found = load_clip_animation(
        Animation(animation.character, handles.top(4), animation.motion, animation.reference).save(
            tmp_path / "clip.glb"
        )
    )
    np.testing.assert_allclose(found.handles.positions, handles.positions, atol=1e-6)
    np.testing.assert_allclose(found.handles.weights, handles.top(4).weights, atol=1e-6)
    assert np.array_equal(found.handles.played, handles.played)
    np.testing.assert_allclose(
        found.vertices([0, 7]),
        Animation(animation.character, handles.top(4), animation.motion).vertices([0, 7]),
        atol=1e-5,
    )


def test_whose_motion_it_is(animation, tmp_path):
    body = reference_body()
    clip = load_clip(animation.save(tmp_path / "clip.npz"))
    assert not clip.is_of(body.handles) and same(clip.of_the_reference_body(), animation.reference)
    assert clip.on(body.character(), body.handles) is None
    lone = load_clip(Animation(animation.character, animation.handles, animation.motion).save(tmp_path / "lone.npz"))
    assert lone.reference is None
    with pytest.raises(MotionError, match="name that character"):
        lone.of_the_reference_body()
    ours = load_clip(Animation(body.character(), body.handles, animation.motion).save(tmp_path / "ours.npz"))
    assert same(ours.of_the_reference_body(), animation.motion)


def test_files_without_a_motion_of_ours(animation, tmp_path):
    rigged = save_character(animation.character, tmp_path / "rigged.glb", animation.handles)
    for call in (load_clip, read_motion, load_clip_animation):
        with pytest.raises(FormatError, match="no handle motion of Bunraku"):
            call(rigged)
    (tmp_path / "clip.bvh").write_text("HIERARCHY")
    with pytest.raises(FormatError, match="glb and .npz"):
        load_clip(tmp_path / "clip.bvh")


def test_broken_and_hostile_files(animation, tmp_path):
    whole, path = animation.save(tmp_path / "good.glb").read_bytes(), tmp_path / "bad.glb"
    mark = f'"{KEY}":'.encode()
    at = whole.index(mark) + len(mark)
    end = at + min(whole[at : at + 8].find(stop) for stop in (b"}", b",") if stop in whole[at : at + 8])
    number = whole[at:end]
    for other in (
        b"9" * len(number),
        b"0" * (len(number) - 1) + b"0",
        b'""'[: len(number)].ljust(len(number)),
        b"-1"[: len(number)].ljust(len(number)),
    ):
        path.write_bytes(whole[:at] + other + whole[end:])
        with pytest.raises(FormatError, match="bad.glb"):
            load_clip(path)
    outcomes(path, damaged(whole, 60, most=1, first=whole.rindex(b"PK\x01\x02") - 2000), load_clip)


def names_of(path):
    return [clip.get("name") for clip in open_document(path, path.read_bytes()).tree["animations"]]


def swinging(character, frames=5, seed=0):
    random = np.random.default_rng(seed)
    bones = len(character.rig.names)
    turns = np.linspace(0, 1, frames)[:, None, None] * random.normal(size=(1, bones, 3))
    return RigAnimation(character, matrix_from_axis_angle(turns), np.zeros((frames, bones, 3)), 20.0)


def handled(character, seed):
    handles = made_up_handles(character).top(4)
    return Animation(character, handles, made_up_motion(character, frames=6, seed=seed))


def test_merged_clips_play_as_they_did(thing, tmp_path):
    first, second = swinging(thing), swinging(thing, seed=1)
    save_clips({"swing": first}, tmp_path / "a.glb")
    save_clips({"swing": second}, tmp_path / "b.glb")
    path = merge([tmp_path / "a.glb", tmp_path / "b.glb"], tmp_path / "c.glb")
    names = names_of(path)
    assert names[0] == "swing" and "swing-2" in names
    for number, clip in ((0, first), (names.index("swing-2"), second)):
        played = load_animation(path, number, 20.0)
        assert np.abs(played.vertices() - clip.vertices()).max() < 1e-5 * thing.height


def test_the_first_file_stays_as_it_is(thing, tmp_path):
    for name, seed in (("a", 0), ("b", 1)):
        save_clips({name: swinging(thing, seed=seed)}, tmp_path / f"{name}.glb")
    path = merge([tmp_path / "a.glb", tmp_path / "b.glb"], tmp_path / "c.glb")
    old, new = (open_document(some, some.read_bytes()) for some in (tmp_path / "a.glb", path))
    for key in ("nodes", "skins", "meshes", "materials", "textures", "scenes"):
        assert new.tree[key] == old.tree[key]
    for number in range(len(old.tree["bufferViews"])):
        assert bytes(new.view(number)) == bytes(old.view(number))


def test_clips_of_another_character_are_refused(thing, tmp_path):
    save_clips({"a": swinging(thing)}, tmp_path / "a.glb")
    names = tuple(f"x{name}" for name in thing.rig.names)
    renamed = replace(thing, rig=replace(thing.rig, names=names), source=None)
    save_clips({"b": swinging(renamed)}, tmp_path / "b.glb")
    with pytest.raises(FormatError, match="another character"):
        merge([tmp_path / "a.glb", tmp_path / "b.glb"], tmp_path / "c.glb")
    assert not (tmp_path / "c.glb").exists()


def test_bones_that_rest_elsewhere_are_another_character(thing, tmp_path):
    own = replace(thing, source=None, avatar=None)
    save_clips({"a": swinging(own)}, tmp_path / "a.glb")
    moved = np.array(own.rig.transforms)
    moved[-1, :3, 3] += 0.2 * own.height
    save_clips({"b": swinging(replace(own, rig=replace(own.rig, transforms=moved)))}, tmp_path / "b.glb")
    with pytest.raises(FormatError, match="rest elsewhere"):
        merge([tmp_path / "a.glb", tmp_path / "b.glb"], tmp_path / "c.glb")


def test_clips_are_added_to_those_of_a_file(thing, tmp_path):
    path = tmp_path / "a.glb"
    clips = {name: handled(thing, seed) for name, seed in (("walk", 0), ("run", 1))}
    save_clips({"walk": clips["walk"]}, path)
    save_clips({"run": clips["run"]}, path, add=True)
    save_clips({"run": clips["run"]}, path, add=True)
    assert names_of(path) == ["walk", "run", "run-2"]
    for number, name in enumerate(("walk", "run", "run")):
        played = load_animation(path, number, clips[name].fps)
        assert np.abs(played.vertices() - clips[name].vertices()).max() < 1e-4 * thing.height
    assert not list(tmp_path.glob(".*.tmp"))


def test_one_clip_of_all_end_to_start(thing, tmp_path):
    for name, seed in (("a", 0), ("b", 1)):
        save_clips({name: swinging(thing, 21, seed)}, tmp_path / f"{name}.glb")
    whole = merge([tmp_path / "a.glb", tmp_path / "b.glb"], tmp_path / "c.glb", end_to_start=True, fps=20.0)
    lengths = [len(load_animation(whole, number, 20.0).motion) for number in range(2)]
    parts = [len(load_animation(tmp_path / f"{name}.glb", n, 20.0).motion) for name in "ab" for n in range(2)]
    assert names_of(whole)[0] == "c" and lengths[0] == sum(parts) - len(parts) + 1


def test_what_is_no_set_of_clips_is_refused(thing, tmp_path):
    one = swinging(thing)
    with pytest.raises(OptionError, match="no clip"):
        save_clips({}, tmp_path / "a.glb")
    with pytest.raises(OptionError, match="has no name"):
        save_clips({" ": one}, tmp_path / "a.glb")
    with pytest.raises(FormatError, match=r"\.glb"):
        save_clips({"a": one}, tmp_path / "a.bvh")
    with pytest.raises(OptionError, match="one character"):
        save_clips({"a": one, "b": swinging(replace(thing, name="other"))}, tmp_path / "a.glb")
    assert bunraku.save_clips is save_clips


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
    monkeypatch.setattr("bunraku.files.gltf.nodes.MAX_KEYS", 100_000)
    maker, count = Maker(), 1000  # the same keys for 101 nodes
    sampler = {
        "input": maker.add(np.arange(count, dtype=np.float32) / 100, bounds=True),
        "output": maker.add(np.zeros((count, 3), np.float32)),
    }
    moves = [{"sampler": 0, "target": {"node": node, "path": "translation"}} for node in range(101)]
    refused("more than 100,000 keys", maker, [{} for _ in range(101)], 0, moves, [sampler])
    strange = {"sampler": 0, "target": {"node": 0, "path": []}}
    refused("does not exist", Maker(), [{}], 0, [strange, move], [{}])
