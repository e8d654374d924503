"""The bind pose as the rest pose: small skinned files whose nodes stand in another pose, with what hangs on their
joints.
"""

import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, Maker, textured_glb
from gltf_player import Player
from scipy.spatial.transform import Rotation

from bunraku.errors import OptionError
from bunraku.io import load_character, save_animation, save_character
from bunraku.io.play import load_animation

ARM = np.concatenate([CUBE * [0.1, 0.5, 0.1], CUBE * [0.1, 0.5, 0.1] + [0, 1, 0]]).astype(
    np.float32
)  # two boxes of height 1
ARM_FACES = np.concatenate([CUBE_FACES, CUBE_FACES + 8])


def quaternion(axis, degrees):
    return Rotation.from_euler(axis, degrees, degrees=True).as_quat().tolist()


def matrix(translation=(0, 0, 0), axis="x", degrees=0.0, scale=1.0):
    out = np.eye(4)
    out[:3, :3] = scale * Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    out[:3, 3] = translation
    return out


def columns(matrices):
    return np.array([m.T.reshape(-1) for m in matrices], np.float32)


def arm_glb(space, *, second=None, bent=40.0, turned=0.0, bones=(1.0, 1.0), clip=True):
    """An arm of two bones below an armature (scaled, turned, moved), bent in the default pose, with a box in its hand.

    `space` is the transform from the space of the inverse bind matrices to the world; `second` adds a mesh with a skin
    of its own whose matrices are those of the first times this, `turned` turns the upper bone about its length.
    """
    maker = Maker()
    armature = matrix((1, 2, 3), "y", 90, 0.5)
    raw = ARM.copy()  # in the armature's space
    to_space = np.linalg.inv(space) @ armature
    raw = (ARM @ to_space[:3, :3].T + to_space[:3, 3]).astype(np.float32)
    joints = np.zeros((16, 4), np.uint8)
    joints[8:, 0] = 1
    weights = np.tile([1, 0, 0, 0], (16, 1)).astype(np.float32)
    binds = [np.linalg.inv(to_space @ matrix((0, y, 0))) for y in (0.0, bones[0])]
    primitive = {
        "attributes": {
            "POSITION": maker.add(raw, bounds=True),
            "JOINTS_0": maker.add(joints),
            "WEIGHTS_0": maker.add(weights),
        },
        "indices": maker.add(ARM_FACES.reshape(-1).astype(np.uint16)),
    }
    box = {
        "attributes": {"POSITION": maker.add((0.05 * CUBE).astype(np.float32), bounds=True)},
        "indices": maker.add(CUBE_FACES.reshape(-1).astype(np.uint16)),
    }
    nodes = [
        {
            "name": "armature",
            "translation": [1, 2, 3],
            "rotation": quaternion("y", 90),
            "scale": [0.5] * 3,
            "children": [1],
        },
        {
            "name": "upper",
            "children": [2],
            "rotation": (Rotation.from_euler("z", bent, degrees=True) * Rotation.from_euler("y", turned, degrees=True))
            .as_quat()
            .tolist(),
        },
        {"name": "lower", "children": [3], "translation": [0, bones[1], 0], "rotation": quaternion("x", bent)},
        {"name": "hold", "children": [4], "translation": [0, 1, 0]},
        {"name": "box", "mesh": 1},
        {"name": "arm", "mesh": 0, "skin": 0},
    ]
    skins = [{"joints": [1, 2], "inverseBindMatrices": maker.add(columns(binds))}]
    meshes = [{"primitives": [primitive]}, {"primitives": [box]}]
    if second is not None:
        moved = (raw @ np.linalg.inv(second)[:3, :3].T + np.linalg.inv(second)[:3, 3]).astype(np.float32)
        other = {
            "attributes": {**primitive["attributes"], "POSITION": maker.add(moved, bounds=True)},
            "indices": primitive["indices"],
        }
        skins.append({"joints": [2, 1], "inverseBindMatrices": maker.add(columns([b @ second for b in binds[::-1]]))})
        other["attributes"]["JOINTS_0"] = maker.add((1 - joints).astype(np.uint8))
        meshes.append({"primitives": [other]})
        nodes.append({"name": "sleeve", "mesh": 2, "skin": 1})
    parts = {}
    if clip:
        times = maker.add(np.array([0, 1], np.float32), bounds=True)
        turn = maker.add(np.array([quaternion("z", 10), quaternion("z", 100)], np.float32))
        parts["animations"] = [
            {
                "channels": [{"sampler": 0, "target": {"node": 2, "path": "rotation"}}],
                "samplers": [{"input": times, "output": turn, "interpolation": "LINEAR"}],
            }
        ]
    scenes = [{"nodes": [0, 5, *([6] if second is not None else [])]}]
    return maker.glb(nodes=nodes, meshes=meshes, skins=skins, scenes=scenes, **parts)


@pytest.fixture
def write(tmp_path):
    def write(data):
        path = tmp_path / "arm.glb"
        path.write_bytes(data)
        return path

    return write


ARMATURE = matrix((1, 2, 3), "y", 90, 0.5)
STRAIGHT = ARM @ ARMATURE[:3, :3].T + ARMATURE[:3, 3]


@pytest.mark.parametrize("space", [ARMATURE, np.eye(4)], ids=["of the armature", "of the world"])
def test_a_bent_arm_rests_straight_where_its_armature_stands(write, space):
    arm = load_character(write(arm_glb(space)))
    box, meshes = arm.vertices[:8], arm.vertices[8:]
    assert np.allclose(meshes, STRAIGHT, atol=1e-5)
    hand = 0.05 * CUBE + [0, 2, 0]
    assert np.allclose(box, hand @ ARMATURE[:3, :3].T + ARMATURE[:3, 3], atol=1e-5)
    assert np.allclose(
        arm.rig.positions, np.array([[0, 0, 0], [0, 1, 0]]) @ ARMATURE[:3, :3].T + ARMATURE[:3, 3], atol=1e-5
    )
    bent = load_character(write(arm_glb(space)), rest="default")
    assert np.allclose(bent.vertices, Player(write(arm_glb(space, clip=False))).vertices(0), atol=1e-5)
    assert np.abs(bent.vertices - arm.vertices).max() > 0.3


def test_a_skeleton_that_its_clip_turned_to_the_front_faces_the_front(write):
    data = arm_glb(ARMATURE, bent=0.0, turned=-90)
    arm = load_character(write(data))
    about = ARMATURE[:3, 3]
    assert np.allclose(
        arm.vertices[8:], (STRAIGHT - about) @ matrix(axis="y", degrees=-90)[:3, :3].T + about, atol=1e-5
    )


def test_skins_of_one_skeleton_rest_together(write):
    arm = load_character(write(arm_glb(ARMATURE, second=matrix((5, 0, 1), "z", 30, 2.0))))
    assert np.allclose(arm.vertices[8:24], STRAIGHT, atol=1e-5) and np.allclose(arm.vertices[24:], STRAIGHT, atol=1e-5)


@pytest.mark.parametrize(
    "data", [arm_glb(ARMATURE), arm_glb(np.eye(4), second=matrix((5, 0, 1), "z", 30, 2.0)), textured_glb()]
)
def test_clips_play_as_the_file_says(write, data):
    path = write(data)
    animation = load_animation(path, fps=4.0)
    player = Player(path)
    for frame, own in enumerate(animation.vertices()):
        assert np.allclose(own, player.vertices(frame / 4), atol=2e-5)


def test_what_is_written_stands_in_the_bind_pose(write, tmp_path):
    arm = load_character(write(arm_glb(ARMATURE)))
    again = load_character(save_character(arm, tmp_path / "out.glb"))
    assert np.allclose(again.vertices, arm.vertices, atol=1e-5) and np.array_equal(again.faces, arm.faces)
    animation = load_animation(write(arm_glb(ARMATURE)), fps=4.0)
    played = load_animation(save_animation(animation, tmp_path / "played.glb", fps=4.0), fps=4.0)
    assert np.allclose(played.vertices(), animation.vertices(), atol=1e-4)


@pytest.mark.parametrize(
    "data",
    [arm_glb(ARMATURE, bones=(0.0, 1.0)), arm_glb(ARMATURE, bones=(9.0, 1.0))],
    ids=["all joints in one point", "bones nine times as long"],
)
def test_a_bind_pose_without_sense_is_not_taken(write, data):
    path = write(data)
    assert np.allclose(load_character(path).vertices, load_character(path, rest="default").vertices)


def test_the_choice_is_checked(write):
    with pytest.raises(OptionError, match="'bind' or 'default', not 'sitting'"):
        load_character(write(textured_glb()), rest="sitting")
