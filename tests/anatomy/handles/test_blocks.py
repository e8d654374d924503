"""Figures of rigid blocks, made with trimesh and read from GLB: which handle each block gets, and that nothing bends or
comes loose in a fitted motion, in the file that is written, and in what is read back.
"""

import numpy as np
import pytest
import trimesh
from rigid_blocks import block_motion

from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.anatomy.handles.blocks import find_blocks, rigid_handles
from bunraku.core.animation import Animation
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_from_axis_angle, nearest_rotation
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.files.clips import load_animation
from bunraku.files.gltf.write import clip_handles
from bunraku.files.registry import load_character
from bunraku.files.samples import sample_character
from bunraku.pipelines.transfer import TRANSFER_STAGES
from bunraku.retarget.fit import Stages, fit_motion

# Low and high corner of each block [m].
MAN = {
    "torso": ((-0.25, 0.7, -0.12), (0.25, 1.3, 0.12)),
    "head": ((-0.2, 1.3, -0.2), (0.2, 1.7, 0.2)),
    "arm-left": ((0.25, 0.6, -0.08), (0.42, 1.28, 0.08)),
    "arm-right": ((-0.42, 0.6, -0.08), (-0.25, 1.28, 0.08)),
    "leg-left": ((0.01, 0, -0.1), (0.22, 0.7, 0.1)),
    "leg-right": ((-0.22, 0, -0.1), (-0.01, 0.7, 0.1)),
}
JOINTED = {
    "Chest": ((-0.25, 1.0, -0.12), (0.25, 1.4, 0.12)),
    "Hips": ((-0.2, 0.8, -0.1), (0.2, 1.0, 0.1)),
    "Head": ((-0.15, 1.4, -0.15), (0.15, 1.7, 0.15)),
    "UpperArm_L": ((0.25, 1.25, -0.06), (0.55, 1.38, 0.06)),
    "LowerArm_L": ((0.55, 1.25, -0.06), (0.85, 1.38, 0.06)),
    "Hand_L": ((0.85, 1.25, -0.06), (0.95, 1.38, 0.06)),
    "UpperArm_R": ((-0.55, 1.25, -0.06), (-0.25, 1.38, 0.06)),
    "LowerArm_R": ((-0.85, 1.25, -0.06), (-0.55, 1.38, 0.06)),
    "Hand_R": ((-0.95, 1.25, -0.06), (-0.85, 1.38, 0.06)),
    "Thigh_L": ((0.02, 0.42, -0.08), (0.18, 0.8, 0.08)),
    "Shin_L": ((0.02, 0.08, -0.08), (0.18, 0.42, 0.08)),
    "Foot_L": ((0.02, 0, -0.08), (0.18, 0.08, 0.2)),
    "Thigh_R": ((-0.18, 0.42, -0.08), (-0.02, 0.8, 0.08)),
    "Shin_R": ((-0.18, 0.08, -0.08), (-0.02, 0.42, 0.08)),
    "Foot_R": ((-0.18, 0, -0.08), (-0.02, 0.08, 0.2)),
}
COW = {
    "body": ((-0.3, 0.5, -0.7), (0.3, 1.0, 0.6)),
    "head": ((-0.2, 0.8, 0.6), (0.2, 1.2, 1.0)),
    "leg-front-left": ((0.1, 0, 0.35), (0.3, 0.5, 0.55)),
    "leg-front-right": ((-0.3, 0, 0.35), (-0.1, 0.5, 0.55)),
    "leg-back-left": ((0.1, 0, -0.65), (0.3, 0.5, -0.45)),
    "leg-back-right": ((-0.3, 0, -0.65), (-0.1, 0.5, -0.45)),
    "tail": ((-0.04, 0.85, -1.1), (0.04, 0.93, -0.7)),
}
HARE = {
    "Body": ((-0.3, 0.1, -0.7), (0.3, 0.6, 0.6)),
    "Belly": ((-0.25, 0.05, -0.6), (0.25, 0.2, 0.5)),
    "Head": ((-0.2, 0.5, 0.5), (0.2, 0.9, 0.9)),
    "Ear_L": ((0.05, 0.85, 0.5), (0.15, 1.4, 0.6)),
    "Ear_R": ((-0.15, 0.85, 0.5), (-0.05, 1.4, 0.6)),
    "Leg_FL": ((0.1, 0, 0.35), (0.25, 0.15, 0.5)),
    "Leg_FR": ((-0.25, 0, 0.35), (-0.1, 0.15, 0.5)),
    "Leg_BL": ((0.1, 0, -0.65), (0.25, 0.15, -0.45)),
    "Leg_BR": ((-0.25, 0, -0.65), (-0.1, 0.15, -0.45)),
}
PARTS = {
    "torso": "spine2", "head": "head", "arm-left": "left_shoulder", "arm-right": "right_shoulder",
    "leg-left": "left_hip", "leg-right": "right_hip", "Chest": "spine3", "Hips": "pelvis", "Head": "head",
    "UpperArm_L": "left_shoulder", "LowerArm_L": "left_elbow", "Hand_L": "left_wrist", "UpperArm_R": "right_shoulder",
    "LowerArm_R": "right_elbow", "Hand_R": "right_wrist", "Thigh_L": "left_hip", "Shin_L": "left_knee",
    "Foot_L": "left_ankle", "Thigh_R": "right_hip", "Shin_R": "right_knee", "Foot_R": "right_ankle", "body": "pelvis",
    "leg-front-left": "left_shoulder", "leg-front-right": "right_shoulder", "leg-back-left": "left_hip",
    "leg-back-right": "right_hip", "tail": "tail", "Body": "pelvis", "Belly": "pelvis", "Ear_L": "head",
    "Ear_R": "head", "Leg_FL": "left_shoulder", "Leg_FR": "right_shoulder", "Leg_BL": "left_hip", "Leg_BR": "right_hip",
}  # fmt: skip
ABOVE = {
    "head": "torso", "arm-left": "torso", "arm-right": "torso", "leg-left": "torso", "leg-right": "torso",
    "Head": "Chest", "Hips": "Chest", "UpperArm_L": "Chest", "LowerArm_L": "UpperArm_L", "Hand_L": "LowerArm_L",
    "UpperArm_R": "Chest", "LowerArm_R": "UpperArm_R", "Hand_R": "LowerArm_R", "Thigh_L": "Hips", "Shin_L": "Thigh_L",
    "Foot_L": "Shin_L", "Thigh_R": "Hips", "Shin_R": "Thigh_R", "Foot_R": "Shin_R", "leg-front-left": "body",
    "leg-front-right": "body", "leg-back-left": "body", "leg-back-right": "body", "tail": "body", "Belly": "Body",
    "Ear_L": "Head", "Ear_R": "Head", "Leg_FL": "Body", "Leg_FR": "Body", "Leg_BL": "Body", "Leg_BR": "Body",
}  # fmt: skip
FIGURES = {"man": MAN, "jointed": JOINTED, "cow": COW, "hare": HARE}
TRUNK = np.eye(HANDLE_COUNT, dtype=np.float32)[HANDLE_NAMES.index("spine2")]


def figure(tmp_path, boxes, named=True):
    """A figure read from a GLB of one node a box, and its boxes in the order of its blocks."""
    scene = trimesh.Scene()
    for number, (name, (low, high)) in enumerate(boxes.items()):
        box = trimesh.creation.box(np.subtract(high, low))
        box.apply_translation(np.add(low, high) / 2)
        called = name if named else f"Cube.{number:03d}"
        scene.add_geometry(box, node_name=called, geom_name=called)
    path = tmp_path / "figure.glb"
    path.write_bytes(scene.export(file_type="glb"))
    character = load_character(path)
    blocks = find_blocks(character)
    names = list(boxes)
    order = [name if named else names[int(name.split(".")[1][:3])] for name in blocks.names]
    return character, blocks, order


def handles_of(character):
    return rigid_handles(character, np.tile(TRUNK, (len(character.vertices), 1)))


def joints_of(order, boxes):
    pairs = ABOVE | ({"head": "body"} if "body" in boxes else {}) | ({"Head": "Body"} if "Body" in boxes else {})
    return [(order.index(name), order.index(pairs[name])) for name in order if name in pairs]


def swaying(frames=40, most=0.9):
    """A motion of the reference body in which every handle swings about an axis of its own, soft parts and all."""
    random = np.random.default_rng(3)
    phase, axes = random.uniform(0, 7, HANDLE_COUNT), random.normal(size=(HANDLE_COUNT, 3))
    axes *= most / np.linalg.norm(axes, axis=1, keepdims=True)
    swing = np.sin(np.arange(frames)[:, None] / 4 + phase)
    rotations = matrix_from_axis_angle(swing[..., None] * axes)
    translations = 0.05 * swing[..., None] * axes
    root, path = 0.3 * rotations[:, 0] + 0.7 * np.eye(3), np.zeros((frames, 3))
    path[:, 2] = np.arange(frames) / 20
    rotations[:, 0], translations[:, 0] = np.eye(3), 0
    return HandleMotion(translations, rotations, path, nearest_rotation(root))


@pytest.mark.parametrize("boxes", FIGURES.values(), ids=FIGURES)
@pytest.mark.parametrize("named", [True, False], ids=["named", "unnamed"])
def test_each_block_is_of_the_part_that_it_is(tmp_path, boxes, named):
    character, blocks, order = figure(tmp_path, boxes, named)
    handles = handles_of(character)
    found = {}
    for block, name in enumerate(order):
        own = handles.weights[blocks.label == block]
        assert (own == own[:1]).all()
        assert own[0].max() == 1
        found[name] = HANDLE_NAMES[int(own[0].argmax())]
    assert found == {name: PARTS[name] for name in boxes}


@pytest.mark.parametrize("boxes", FIGURES.values(), ids=FIGURES)
def test_nothing_bends_or_comes_loose(tmp_path, boxes):
    character, blocks, order = figure(tmp_path, boxes, named=False)
    handles = handles_of(character)
    motion = fit_motion(swaying(), Anatomy.of(character, handles), TRANSFER_STAGES)
    path = Animation(character, handles, motion).save(tmp_path / "moved.glb")
    back = load_animation(path, fps=33)  # between the frames of the file too
    assert back.character.rig.weights.max(axis=1).min() == 1
    posed = skin(character.vertices, back.handles.weights, back.motion.transforms(back.handles.positions))
    assert np.ptp(posed, axis=0).max() > 0.1  # it moves
    found = block_motion(character, blocks.label, joints_of(order, boxes), np.asarray(posed)[::5])
    assert found.shear < 1e-5
    assert found.gaps.max() < 0.01


def test_legs_of_one_block_neither_sink_nor_hover(tmp_path):
    character, _, _ = figure(tmp_path, MAN)
    handles = handles_of(character)
    frames = 40
    rotations, path = np.tile(np.eye(3), (frames, HANDLE_COUNT, 1, 1)), np.zeros((frames, 3))
    swing = np.radians(35) * np.sin(np.arange(frames) / 2)[:, None] * [1.0, 0, 0]
    for side, sign in (("left", 1), ("right", -1)):
        for part in ("hip", "knee", "ankle", "foot"):
            rotations[:, HANDLE_NAMES.index(f"{side}_{part}")] = matrix_from_axis_angle(sign * swing)
    path[:, 1] = 0.05 * np.sin(np.arange(frames) / 3)  # as if knees made up for it
    still = np.tile(np.eye(3), (frames, 1, 1))
    motion = HandleMotion(np.zeros((frames, HANDLE_COUNT, 3)), rotations, path, still, own_height=True)
    anatomy = Anatomy.of(character, handles)
    fitted = fit_motion(motion, anatomy, Stages(smooth=False, feet=False))
    low = skin(character.vertices, handles.weights, fitted.transforms(handles.positions))[..., 1].min(axis=1)
    body = reference_body()
    want = reference_anatomy().surface_reach.lowest(motion.transforms(body.handles.positions))
    assert np.ptp(want) > 0.05  # the reference body leaves the ground in between
    assert low.min() > -0.005 * character.height
    assert low.max() < (np.ptp(want) * anatomy.scale) + 0.005 * character.height
    bare = fit_motion(motion, anatomy, Stages(smooth=False, feet=False, floor=False))
    sunk = skin(character.vertices, handles.weights, bare.transforms(handles.positions))[..., 1].min()
    assert sunk < -0.02 * character.height


def test_an_arm_that_hangs_beside_the_trunk_turns_at_its_upper_end(tmp_path):
    character, _, _ = figure(tmp_path, MAN, named=False)
    shoulder = handles_of(character).positions[HANDLE_NAMES.index("left_shoulder")]
    np.testing.assert_allclose(shoulder[[0, 2]], [0.25, 0], atol=0.02)
    assert 1.1 < shoulder[1] < 1.28


def test_blocks_that_bend_are_not_rigid(tmp_path):
    trousers = {"a": MAN["torso"], "b": MAN["head"], "c": ((-0.22, 0, -0.1), (0.22, 0.7, 0.1))}
    trousers |= {"d": MAN["arm-left"], "e": MAN["arm-right"]}
    character, blocks, order = figure(tmp_path, trousers, named=False)
    whole = np.tile(TRUNK, (len(character.vertices), 1))
    weights = whole.copy()
    legs = blocks.label == order.index("c")
    weights[legs] = 0
    weights[legs, HANDLE_NAMES.index("left_knee")] = weights[legs, HANDLE_NAMES.index("right_knee")] = 0.5
    assert rigid_handles(character, whole) is not None
    assert rigid_handles(character, weights) is None


def test_a_body_over_short_legs_does_not_bend_whatever_is_seen_in_it(tmp_path):
    character, blocks, order = figure(tmp_path, HARE, named=False)
    body = blocks.label == order.index("Body")
    weights = np.tile(TRUNK, (len(character.vertices), 1))
    weights[body] = 0
    weights[np.ix_(body, [HANDLE_NAMES.index(f"{side}_knee") for side in ("left", "right")])] = 0.5
    assert rigid_handles(character, weights) is not None


def test_what_touches_head_and_trunk_goes_with_the_head_if_its_name_says_so(tmp_path):
    boxes = HARE | {"Ear_L": ((0.05, 0.55, 0.45), (0.15, 1.4, 0.6))}
    character, blocks, order = figure(tmp_path, boxes)
    ear = handles_of(character).weights[blocks.label == order.index("Ear_L")]
    assert (ear.argmax(axis=1) == HANDLE_NAMES.index("head")).all()


def test_written_handles_stay_rigid(tmp_path):
    character, _, _ = figure(tmp_path, MAN)
    handles = handles_of(character)
    path = Animation(character, handles, swaying(4, 0)).save(tmp_path / "still.glb")
    back = clip_handles(path, load_character(path))
    assert back.rigid
    np.testing.assert_allclose(back.positions, handles.positions, atol=1e-5)


def test_coats_of_a_part_are_one_block(tmp_path):
    """A sheep whose parts have wool around them, each in a node that is named like the part but for a number."""
    coats = {f"{name}_{number}": box for number, (name, box) in enumerate(COW.items())}
    for number, (name, (low, high)) in enumerate(COW.items()):
        if name != "tail":
            low = (low[0] - 0.03, low[1] + 0.4 * (high[1] - low[1]), low[2] - 0.03)
            coats[f"{name}_{number + 20}"] = low, np.add(high, 0.03)
    character, blocks, _ = figure(tmp_path, coats)
    assert sorted(name.rsplit("_", 1)[0] for name in blocks.names) == sorted(COW)
    handles = handles_of(character)
    assert handles is not None and handles.rigid
    held = {HANDLE_NAMES[handles.weights[blocks.label == n][0].argmax()] for n in range(len(blocks.names))}
    assert {"left_hip", "right_hip", "left_shoulder", "right_shoulder"} <= held
    sunk = dict(MAN) | {"arm-left": ((0.1, 0.6, -0.08), (0.42, 1.28, 0.08))}  # unnamed, half in the trunk, but no coat
    assert len(figure(tmp_path, sunk, named=False)[1].names) == len(MAN)


def test_a_person_of_one_surface_has_no_blocks():
    assert find_blocks(sample_character("person")) is None


def test_one_surface_cut_into_nodes_is_no_figure_of_blocks(tmp_path):
    body = sample_character("person")
    middle = body.vertices[body.faces].mean(axis=1)
    names = np.select([np.abs(middle[:, 0]) > 0.25, middle[:, 1] < 0.5 * body.height], ["arm", "leg"], "torso").astype(
        "U16"
    )
    limbs = names != "torso"
    names[limbs] = np.char.add(names[limbs], np.where(middle[limbs, 0] > 0, "-left", "-right"))
    scene = trimesh.Scene()
    for name in np.unique(names):
        scene.add_geometry(trimesh.Trimesh(body.vertices, body.faces[names == name]), node_name=name, geom_name=name)
    path = tmp_path / "cut.glb"
    path.write_bytes(scene.export(file_type="glb"))
    character = load_character(path)
    assert find_blocks(character) is None  # its author cut it along its limbs, as with a knife
