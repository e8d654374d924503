"""Motion on the character's rig, and on the skeleton of an engine."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import bunraku
from bunraku import CharacterError, SkeletalMotion
from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.names.bone_names import handle_of_joints, rig_handles
from bunraku.anatomy.rig_limbs import four_legs_of_rig, legs_of_rig
from bunraku.core.animation import RigAnimation
from bunraku.core.body.layout import HANDLE_NAMES, JOINT_NAMES
from bunraku.core.body.reference import LIMB_CHILD, reference_body
from bunraku.core.character import Character, Rig
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.core.geometry.surface import vertex_normals
from bunraku.core.skinning import skin
from bunraku.errors import OptionError
from bunraku.files import load_character, save_character
from bunraku.files.gltf.document import mesh_document
from bunraku.files.gltf.nodes import read_nodes, read_skins
from bunraku.files.gltf.open import open_document
from bunraku.files.gltf.read import character_from_document
from bunraku.generation.features import body_handle_motion
from bunraku.generation.library import all_clips
from bunraku.pipelines.requests import Request, Sampling
from bunraku.retarget.engine_skeleton import carried, on_skeleton
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.rig_parts import RigParts, is_humanoid_rig, understood_rig
from bunraku.retarget.to_reference import bones_to_handles, handle_animation, motion_to_reference
from bunraku.retarget.to_rig import copied_bones, fit_rig
from bunraku_lab.synthetic.samples import make_sample

CARRIED = Stages(ground=False, feet=False, smooth=False, floor=False)
_J = {name: joint for joint, name in enumerate(JOINT_NAMES)}


def walking(frames=24):
    """Something like a walk: legs and arms swing, elbows and knees bend, the pelvis goes forward."""
    body = reference_body()
    phase = np.linspace(0, 2 * np.pi, frames)
    turns = np.zeros((frames, 22, 3))
    for side, sign in (("left", 1), ("right", -1)):
        turns[:, _J[f"{side}_hip"], 0] = -0.5 * sign * np.sin(phase)
        turns[:, _J[f"{side}_knee"], 0] = 0.4 - 0.4 * sign * np.cos(phase)
        turns[:, _J[f"{side}_shoulder"], 2] = -1.2 * sign
        turns[:, _J[f"{side}_elbow"], 1] = -0.6 * sign
    turns[:, _J["spine2"], 1] = 0.2 * np.sin(phase)
    path = body.joints[0] + np.stack([0 * phase, 0.02 * np.cos(2 * phase), 0.15 * phase], axis=1)
    return SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), path, 20.0)


def rested(scale=1.0, arms=0.0):
    """The reference body in another size, with its arms down by an angle [rad] in its rest pose."""
    body = reference_body()
    turns = np.zeros((1, 22, 3))
    for side, sign in (("left", -1), ("right", 1)):
        turns[0, _J[f"{side}_shoulder"], 2] = sign * arms
    rotations, positions = SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), body.joints[:1]).world()
    affine = np.concatenate(
        [rotations, (positions - np.einsum("njab,jb->nja", rotations, body.joints))[..., None]], axis=-1
    )
    plain, transforms = body.character(), np.tile(np.eye(4), (22, 1, 1))
    transforms[:, :3, 3] = positions[0] * scale
    rig = Rig(JOINT_NAMES, plain.rig.parents, transforms, plain.rig.indices, plain.rig.weights)
    return Character("rested", skin(body.vertices, body.joint_weights, affine)[0] * np.float32(scale), body.faces, rig)


def limbs(positions):
    bones = np.stack([positions[:, child] - positions[:, joint] for joint, child in LIMB_CHILD.items()], axis=1)
    return bones / np.linalg.norm(bones, axis=-1, keepdims=True)


def test_stiff_motion_has_the_rotations_of_the_joints():
    motion = walking()
    handles = body_handle_motion(motion)
    world = motion.world()[0]
    assert np.abs(handles.root_rotation[:, None] @ handles.rotations[:, :22] - world).max() < 1e-5


@pytest.mark.parametrize(("scale", "arms"), [(1.0, 0.0), (1.0, 1.1), (0.4, 0.6)])
def test_limbs_point_where_those_of_the_source_point(scale, arms):
    motion = walking()
    character = rested(scale, arms)
    moved = fit_rig(body_handle_motion(motion), character, CARRIED)
    want, have = limbs(motion.world()[1]), limbs(moved.world()[1])
    angles = np.degrees(np.arccos(np.clip((want * have).sum(axis=-1), -1, 1)))
    assert angles.max() < 0.5
    assert np.abs(moved.translations[:, 1:]).max() < 1e-4 * scale  # bones keep their lengths
    stride = moved.world()[1][:, 0, 2]
    assert stride[-1] - stride[0] == pytest.approx(scale * 0.3 * np.pi, rel=0.1)


def test_all_stages_stay_close_to_the_source():
    motion = walking()
    moved = fit_rig(body_handle_motion(motion), rested(1.0, 0.8), Stages(hands=True))
    angles = np.degrees(np.arccos(np.clip((limbs(motion.world()[1]) * limbs(moved.world()[1])).sum(axis=-1), -1, 1)))
    assert angles.mean() < 5
    assert moved.vertices()[..., 1].min() > -0.02


def test_the_way_back():
    reference = body_handle_motion(walking())
    parts = RigParts.of(rested(0.7, 0.9))
    moved = fit_rig(reference, parts, CARRIED)
    back = motion_to_reference(bones_to_handles(parts, *moved.world(), 20.0), parts.anatomy, own=True)
    assert (
        np.degrees(
            np.linalg.norm(
                axis_angle_from_matrix(np.swapaxes(back.rotations, -1, -2) @ reference.rotations)[:, 1:22], axis=-1
            )
        ).max()
        < 0.5
    )
    assert np.abs(back.root_translation - reference.root_translation).max() < 0.01
    again = fit_rig(back, parts, CARRIED)
    assert np.abs(again.vertices() - moved.vertices()).max() < 0.005 * parts.character.height


def test_the_rig_as_handles_is_the_same_animation():
    moved = fit_rig(body_handle_motion(walking()), rested(1.0, 0.5))
    assert np.abs(handle_animation(moved).vertices() - moved.vertices()).max() < 1e-3


def test_which_rigs_are_humanoid():
    character = rested()
    assert is_humanoid_rig(character)
    nameless = replace(character.rig, names=tuple(f"bone{number}" for number in range(22)))
    assert not is_humanoid_rig(replace(character, rig=nameless))
    with pytest.raises(CharacterError, match="do not tell"):
        RigParts.of(replace(character, rig=nameless))
    with pytest.raises(CharacterError, match="no rig"):
        RigParts.of(replace(character, rig=None))


def test_bones_of_the_same_skeleton_are_copied():
    moved = fit_rig(body_handle_motion(walking()), rested(1.0, 0.5), CARRIED)
    other = rested(2.0, 0.5)
    copied = copied_bones(moved.character, *moved.world(), 20.0, other)
    assert np.abs(copied.vertices() - 2 * moved.vertices()).max() < 1e-3
    assert copied_bones(moved.character, *moved.world(), 20.0, rested(2.0, 1.5)) is None  # rests in another pose
    renamed = replace(other.rig, names=("hips", *other.rig.names[1:]))
    assert copied_bones(moved.character, *moved.world(), 20.0, replace(other, rig=renamed)) is None


PARTS = {
    "pelvis": "hips", "hip": "upperleg", "knee": "lowerleg", "ankle": "foot", "foot": "toes", "shoulder": "upperarm",
    "elbow": "lowerarm", "collar": "clavicle",
}  # fmt: skip


def bones_of(parts):
    """Names of bones for the 22 joints, with ".l" and ".r"."""
    split = [name.rpartition("_") for name in JOINT_NAMES]
    return [f"{parts.get(part, part)}{'.' + side[0] if side else ''}" for side, _, part in split]


def test_a_wrist_bone_over_the_hand_leaves_the_turn_to_the_hand():
    plain = rested(1.0, 0.5)
    names = bones_of(PARTS | {"spine1": "spine", "spine2": "chest"})
    wrists = [names.index("wrist.l"), names.index("wrist.r")]
    rig, weights = plain.rig, plain.rig.dense_weights()
    hands = 0.8 * weights[:, wrists]
    weights[:, wrists] -= hands
    weights = np.concatenate([weights, hands], axis=1)
    order = np.argsort(-weights, axis=1)[:, :6]
    transforms = np.concatenate([rig.transforms, rig.transforms[wrists]])
    with_hands = Rig(
        (*names, "hand.l", "hand.r"),
        np.append(rig.parents, wrists),
        transforms,
        order,
        np.take_along_axis(weights, order, axis=1),
    )
    found = RigParts.of(replace(plain, rig=with_hands))
    assert found.humanoid and found.leads[[_J["left_wrist"], _J["right_wrist"]]].tolist() == [22, 23]
    moved = fit_rig(body_handle_motion(walking()), found, CARRIED)
    turns = np.array(moved.rotations)
    turns[:, 22] = matrix_from_axis_angle(np.array([0.7, 0.2, 0.1]))  # as a clip turns it
    clip = replace(moved, rotations=turns)
    back = fit_rig(
        motion_to_reference(bones_to_handles(found, *clip.world(), 20.0), found.anatomy, own=True), found, CARRIED
    )
    assert np.abs(back.vertices() - clip.vertices()).max() < 0.005 * plain.height


def test_half_of_a_pelvis_over_a_thigh_leaves_the_hip_to_the_thigh():
    plain = rested()
    names = bones_of(PARTS)
    rig, hips = plain.rig, [_J["left_hip"], _J["right_hip"]]
    parents = np.append(rig.parents, [0, 0])
    parents[hips] = [22, 23]
    transforms = np.concatenate([rig.transforms, rig.transforms[hips]])
    transforms[22:, 1, 3] += 0.1
    weights = np.concatenate([rig.dense_weights(), np.zeros((len(plain.vertices), 2))], axis=1)
    order = np.argsort(-weights, axis=1)[:, :4]
    halved = Rig(
        (*names, "pelvis.l", "pelvis.r"), parents, transforms, order, np.take_along_axis(weights, order, axis=1)
    )
    found = RigParts.of(replace(plain, rig=halved))
    assert found.leads[hips].tolist() == hips and (found.parts[22:] == -1).all()
    np.testing.assert_allclose(found.joints.positions[hips], rig.transforms[hips][:, :3, 3], atol=1e-6)


# VRM 1.0's table of humanoid bones: each required one, and the nearest required or optional one above it.
VRM_PARENTS = {
    "hips": "", "spine": "hips", "chest": "spine", "upperChest": "chest", "neck": "upperChest", "head": "neck",
    **{f"{s}{a}": b if b in ("hips", "upperChest") else f"{s}{b}" for s in ("left", "right") for a, b in (
        ("UpperLeg", "hips"), ("LowerLeg", "UpperLeg"), ("Foot", "LowerLeg"), ("Toes", "Foot"),
        ("Shoulder", "upperChest"), ("UpperArm", "Shoulder"), ("LowerArm", "UpperArm"), ("Hand", "LowerArm"))},
}  # fmt: skip
VRM_REQUIRED = {
    "hips", "spine", "head", *(f"{side}{part}" for side in ("left", "right")
    for part in ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")),
}  # fmt: skip
UNITY_MIXAMO = {
    "Hips", "Spine", "Head", *(f"{side}{part}" for side in ("Left", "Right")
    for part in ("UpLeg", "Leg", "Foot", "Arm", "ForeArm", "Hand")),
}  # fmt: skip


@pytest.fixture(scope="module")
def person():
    mesh = bunraku.sample_character("person")
    normals = vertex_normals(mesh.vertices, mesh.faces)
    document = mesh_document(Path("person"), mesh.vertices, [(mesh.faces, None)], normals=normals)
    character = character_from_document(document, "person")
    return character, Anatomy.of(character, bunraku.rig(character))


def heads(character):
    return dict(zip(character.rig.names, character.rig.positions, strict=True))


def test_vrm_has_the_bones_that_it_requires_below_those_that_it_asks_for(person):
    rig = on_skeleton(person[1], "vrm").rig
    parents = {name: "" if up < 0 else rig.names[up] for name, up in zip(rig.names, rig.parents, strict=True)}
    assert set(parents) >= VRM_REQUIRED and len(set(rig.names)) == len(rig.names)
    for name, above in VRM_PARENTS.items():
        while above and above not in parents:  # one that may be left out
            above = VRM_PARENTS[above]
        assert name not in parents or parents[name] == above, name


def test_unity_finds_the_bones_that_it_requires(person):
    names = on_skeleton(person[1], "mixamo").rig.names
    assert {name.removeprefix("mixamorig:") for name in names} >= UNITY_MIXAMO


def test_unreal_has_a_root_on_the_ground(person):
    rig = on_skeleton(person[1], "unreal").rig
    assert rig.names[0] == "root" and np.array_equal(rig.positions[0], np.zeros(3))
    assert rig.names[1] == "pelvis" and rig.parents[1] == 0 and (rig.parents == -1).sum() == 1


def test_it_rests_in_a_t_pose(person):
    made = on_skeleton(person[1], "vrm")
    at = heads(made)
    for side, way in (("left", 1.0), ("right", -1.0)):
        for upper, lower in (("UpperArm", "LowerArm"), ("LowerArm", "Hand")):
            arm = at[f"{side}{lower}"] - at[f"{side}{upper}"]
            assert arm[0] * way > 0.995 * np.linalg.norm(arm)
        leg = at[f"{side}Foot"] - at[f"{side}UpperLeg"]
        assert -leg[1] > 0.98 * np.linalg.norm(leg)
    assert abs(float(made.vertices[made.surface, 1].min())) < 1e-5
    assert np.array_equal(made.rig.transforms[:, :3, :3], np.tile(np.eye(3), (len(made.rig.names), 1, 1)))


def test_what_is_written_rests_and_is_bound_in_that_pose(person, tmp_path):
    made = on_skeleton(person[1], "mixamo")
    path = save_character(made, tmp_path / "hero.glb", rig=True)
    document = open_document(path, path.read_bytes())
    tree = read_nodes(document)
    skins = read_skins(document, tree)
    assert np.abs(tree.world[skins.nodes] @ skins.inverse[0] - np.eye(4)).max() < 1e-5  # bound where it rests
    again = load_character(path)
    assert np.abs(again.vertices - made.vertices).max() < 1e-5
    assert np.abs(again.rig.dense_weights() - made.rig.dense_weights()).max() < 1e-5
    primitive = document.items("meshes")[0]["primitives"][0]
    assert "NORMAL" in primitive["attributes"]
    normals = document.accessor(primitive["attributes"]["NORMAL"], ("VEC3",))
    faces = again.vertices[again.faces].astype(float)
    flat = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    size = np.linalg.norm(flat, axis=1)
    own = normals[again.faces[:, 0]].astype(float)
    cosine = (own * flat).sum(axis=1) / np.maximum(size, 1e-12)
    assert np.median(cosine[size > 1e-9]) > 0.95  # normals are turned with the mesh


def test_a_vrm_skeleton_is_written_as_a_vrm_humanoid(person, tmp_path):
    """By the schema of VRMC_vrm 1.0: what is required is there, and each bone is the node of its name."""
    made = on_skeleton(person[1], "vrm")
    path = save_character(made, tmp_path / "hero.glb", rig=True)
    document = open_document(path, path.read_bytes())
    assert "VRMC_vrm" in document.tree["extensionsUsed"]
    avatar = document.tree["extensions"]["VRMC_vrm"]
    assert avatar["specVersion"] == "1.0" and avatar["meta"]["name"] and avatar["meta"]["authors"]
    assert avatar["meta"]["licenseUrl"] == "https://vrm.dev/licenses/1.0/"  # the schema's one value
    bones = avatar["humanoid"]["humanBones"]
    nodes = document.items("nodes")
    assert set(bones) >= VRM_REQUIRED and all(nodes[bone["node"]]["name"] == name for name, bone in bones.items())
    assert set(bones) <= set(VRM_PARENTS) | {"leftMiddleProximal", "rightMiddleProximal"}
    read = load_character(path)
    assert read.avatar is not None and np.abs(read.vertices - made.vertices).max() < 1e-5
    for names in ("mixamo", "unreal"):
        path = save_character(on_skeleton(person[1], names), tmp_path / f"{names}.glb", rig=True)
        assert "extensions" not in open_document(path, path.read_bytes()).tree


def test_names_are_read_back_as_the_parts_that_they_are(person):
    for names in ("mixamo", "vrm", "unreal"):
        made = on_skeleton(person[1], names)
        parts = RigParts.of(made)
        assert parts.humanoid
        for part in ("pelvis", "left_hip", "right_knee", "left_shoulder", "right_elbow", "right_wrist", "head"):
            assert parts.leads[HANDLE_NAMES.index(part)] >= 0, (names, part)


def test_it_is_animated_as_any_skeleton(person, tmp_path):
    made = bunraku.with_skeleton(person[0], "unreal")
    moved = bunraku.Animator.shipped()(made, Request("walks forward", Sampling(2.0, 1, 4, candidates=1)))
    assert isinstance(moved, RigAnimation) and moved.character.rig.names[0] == "root"
    path = moved.save(tmp_path / "walk.glb")
    document = open_document(path, path.read_bytes())
    names = {document.items("nodes")[channel["target"]["node"]]["name"]
             for channel in document.items("animations")[0]["channels"]}  # fmt: skip
    assert {"pelvis", "thigh_l", "upperarm_r"} <= names
    walker, down = load_character(path), np.eye(4)  # a file whose rest pose lies below the ground of its clips
    down[1, 3] = -1
    lowered = replace(
        walker, vertices=walker.vertices + down[:3, 3], rig=replace(walker.rig, transforms=down @ walker.rig.transforms)
    )
    fresh = fit_rig(body_handle_motion(walking()), lowered).animation().vertices()
    assert abs(np.quantile(fresh[..., 1].min(axis=1), 0.2) - walker.vertices[:, 1].min()) < 0.05


def test_what_handles_do_is_carried_onto_it(person):
    character, anatomy = person
    moved = bunraku.Animator.shipped()(character, Request("waves", Sampling(1.0, 1, 4, candidates=1)))
    anatomy = Anatomy.of(moved.character, moved.handles)
    for names in ("vrm", "unreal"):
        made = carried(moved, anatomy, on_skeleton(anatomy, names))
        away = np.linalg.norm(made.vertices() - moved.vertices(), axis=-1)
        assert away.max() < 1e-3 * character.height and np.ptp(moved.vertices(), axis=0).max() > 0.1
    with pytest.raises(CharacterError, match="not the skeleton"):
        carried(moved, anatomy, character)


def test_who_is_no_person_is_refused(person):
    dog = bunraku.sample_character("dog")
    with pytest.raises(CharacterError, match="two arms and two legs"):
        bunraku.with_skeleton(dog, "mixamo")
    with pytest.raises(OptionError, match="mixamo, vrm, unreal"):
        on_skeleton(person[1], "daz")


@pytest.mark.parametrize("hard", [False, True])
def test_bones_are_known_by_the_skin_that_they_hold(hard):
    """Without names, and where each vertex is of one bone, a dog's own bones move it as its handles do."""
    from bunraku_lab.synthetic.stock_motions import stock_motion

    dog = make_sample("dog", rigged=True)
    names = tuple(f"b{number}" for number in range(len(dog.rig.names)))
    indices, weights = dog.rig.indices, dog.rig.weights
    if hard:
        first = weights.argmax(axis=1)[:, None]
        indices, weights = np.take_along_axis(indices, first, axis=1), np.ones(first.shape, np.float32)
    nameless = replace(dog, rig=replace(dog.rig, names=names, indices=indices, weights=weights))
    body = Anatomy.of(replace(dog, rig=None), rig_handles(dog))
    parts = RigParts.by_skin(replace(body, character=nameless))
    assert parts is not None and parts.complete
    walk = stock_motion("walk", 1.0, 20.0)
    moved, wanted = fit_rig(walk, parts).vertices(), fit_rig(walk, dog).vertices()
    away = np.linalg.norm(moved - wanted, axis=-1)
    assert np.quantile(away, 0.9) < (0.12 if hard else 0.06) * dog.height < 0.2 < np.ptp(wanted[:, :, 2], axis=0).min()
    alone = replace(nameless.rig, indices=np.zeros((len(dog.vertices), 1)), weights=np.ones((len(dog.vertices), 1)))
    assert RigParts.by_skin(replace(body, character=replace(dog, rig=alone))) is None


def test_a_bone_that_bears_legs_is_their_pelvis_whatever_its_skin_says():
    """Of a six-legged robot the trunk was taken for a tail, and thighs for the pelvis: legs came off."""
    dog = make_sample("dog", rigged=True)
    known, handles = handle_of_joints(dog.rig.names, dog.rig.parents), rig_handles(dog)
    pelvis, hip, tail = map(HANDLE_NAMES.index, ("pelvis", "left_hip", "tail_tip"))
    weights = handles.weights.copy()
    weights[:, tail] += weights[:, pelvis]
    weights[:, pelvis], weights[:, hip] = weights[:, hip], 0
    body = Anatomy.of(replace(dog, rig=None), rig_handles(dog))
    parts = RigParts.by_skin(replace(body, character=dog, handles=replace(handles, weights=weights)))
    assert parts is not None
    assert (parts.parts[known == pelvis] == pelvis).all() and (parts.parts[known == hip] == hip).all()


def test_a_forearm_that_is_taken_for_a_leg_is_of_its_arm():
    """Hands that hang beside the hips were taken for legs on one side, and came off."""
    person = make_sample("person", rigged=True)
    known, handles = handle_of_joints(person.rig.names, person.rig.parents), rig_handles(person)
    for sides in (("left",), ("left", "right")):
        weights = handles.weights.copy()
        for side in sides:
            elbow, hip = (HANDLE_NAMES.index(f"{side}_{part}") for part in ("elbow", "hip"))
            weights[:, hip] += weights[:, elbow]
            weights[:, elbow] = 0
        body = Anatomy.of(replace(person, rig=None), handles)
        parts = RigParts.by_skin(replace(body, character=person, handles=replace(handles, weights=weights)))
        assert parts is not None
        assert (parts.parts[known == elbow] == elbow).all()


def test_a_hand_that_hangs_on_a_target_goes_along_with_its_arm():
    person = make_sample("person", rigged=True)
    known, rig, count = handle_of_joints(person.rig.names, person.rig.parents), person.rig, len(person.rig.names)
    hand, arm = (int(np.flatnonzero(known == HANDLE_NAMES.index(f"left_{part}"))[0]) for part in ("wrist", "elbow"))
    parents = np.append(np.where(rig.parents < 0, count, rig.parents), -1)
    parents[hand] = count
    names, transforms = tuple(f"b{bone}" for bone in range(count + 1)), np.append(rig.transforms, [np.eye(4)], axis=0)
    character = replace(person, rig=Rig(names, parents, transforms, rig.indices, rig.weights))
    parts = RigParts.by_skin(replace(Anatomy.of(replace(person, rig=None), rig_handles(person)), character=character))
    assert parts is not None
    assert parts.parents[hand] == arm and parts.parts[hand] == parts.parts[arm] == HANDLE_NAMES.index("left_elbow")


def test_a_rig_of_several_roots_is_read():
    dog = make_sample("dog", rigged=True)
    names = tuple(f"b{bone}" for bone in range(len(dog.rig.names)))
    assert understood_rig(replace(dog, rig=replace(dog.rig, names=names, parents=np.full(len(names), -1)))) is None


def spider(legs=4, bent=0.3) -> Character:
    """A ball and legs of two bones on each side, on a skeleton without names: bones are boxes of one bone each; knees
    are higher and tips lower by `bent`.
    """
    heads, parents, ends = [np.array([0.0, 0.3, 0])], [-1], [np.array([0.0, 0.3, 0.1])]
    for side in (-1, 1):
        for number in range(legs):
            away = np.array([side, 0, 1.2 * number / (legs - 1) - 0.6])
            line = [[0, 0.3, 0] + 0.1 * away, [0, 0.3 + bent, 0] + 0.5 * away, [0, 0.3 - bent, 0] + away]
            for part in range(2):
                parents.append(0 if part == 0 else len(heads) - 1)
                heads.append(line[part])
                ends.append(line[part + 1])
            parents.append(len(heads) - 1)
            heads.append(line[2])
            ends.append(None)
    vertices, faces, bones = [], [], []
    for bone, (head, end) in enumerate(zip(heads, ends, strict=True)):
        if end is None:
            continue
        piece = trimesh.creation.cylinder(0.1 if bone == 0 else 0.03, segment=[head, end], sections=8)
        piece = piece.subdivide().subdivide()
        faces.append(piece.faces + sum(map(len, vertices)))
        vertices.append(piece.vertices)
        bones.append(np.full(len(piece.vertices), bone))
    transforms = np.tile(np.eye(4), (len(heads), 1, 1))
    transforms[:, :3, 3] = heads
    held = np.concatenate(bones)[:, None]
    names = tuple(f"b{number}" for number in range(len(heads)))
    rig = Rig(names, np.array(parents), transforms, held, np.ones(held.shape))
    return Character("spider", np.concatenate(vertices), np.concatenate(faces), rig)


def test_many_legs_are_known_by_the_tree_of_their_bones():
    parts = understood_rig(spider())
    assert parts is not None and not parts.anatomy.upright
    assert parts.anatomy.plan.legs == len(parts.anatomy.legs) == 8  # each with a knee
    legs = parts.parts[1:].reshape(8, 3)
    assert len(set(legs[:, 0])) == 8 and len(set(legs[:, :2].ravel())) == 16  # each has handles of its own
    assert legs_of_rig(spider(2)) is None and legs_of_rig(make_sample("dog", rigged=True)) is None


def nameless(kind: str, anchors: bool = False, blades: float = 0.0) -> Character:
    """A rigged sample whose bones are called by numbers; where `anchors`, each thigh hangs on a further bone that
    begins in the middle of the body and holds nothing, as in rigs of horses. Upper arms hang on `blades`, which begin
    so far over and behind them [m], and hold a third of their skin.
    """
    character = make_sample(kind, rigged=True)
    rig = character.rig
    parents, transforms = [*rig.parents], [*rig.transforms]
    for thigh in [rig.names.index(f"{side}UpLeg") for side in ("Left", "Right")] if anchors else []:
        transforms.append(transforms[thigh] * np.where(np.arange(16).reshape(4, 4) == 3, 0, 1))
        parents.append(parents[thigh])
        parents[thigh] = len(parents) - 1
    indices = rig.indices.copy()
    for arm in [rig.names.index(f"{side}Arm") for side in ("Left", "Right")] if blades else []:
        transforms.append(
            transforms[arm] + blades * np.array([[0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 0, -1], [0, 0, 0, 0]])
        )
        parents.append(parents[arm])
        parents[arm] = len(parents) - 1
        indices[::3][indices[::3] == arm] = parents[arm]
    names = tuple(f"b{number}" for number in range(len(parents)))
    return replace(
        character, rig=Rig(names, np.array(parents), np.stack(transforms), indices, rig.weights), source=None
    )


@pytest.mark.parametrize("blades", [0.0, 0.15])
def test_four_legs_are_known_by_the_skin_of_their_bones(blades):
    dog = nameless("dog", anchors=True, blades=blades)
    plan = understood_rig(dog).anatomy.plan
    assert plan.kind == "four legs" and plan.tail and (plan.hind, plan.front) == (2, 2)
    parts = four_legs_of_rig(dog, np.full(len(dog.rig.names), -1))
    named = make_sample("dog", rigged=True).rig.names
    told = {named[bone]: HANDLE_NAMES[part] for bone, part in enumerate(parts[: len(named)]) if part >= 0}
    for bone, part in (("LeftUpLeg", "left_hip"), ("RightLeg", "right_knee"), ("LeftArm", "left_shoulder"),
                       ("RightForeArm", "right_elbow"), ("Head", "head"), ("Tail1", "tail")):  # fmt: skip
        assert told[bone] == part
    for kind in ("person", "robot"):
        assert four_legs_of_rig(nameless(kind), np.full(len(nameless(kind).rig.names), -1)) is None


def test_legs_that_rest_level_stand():
    body = understood_rig(spider(bent=0)).anatomy
    stance = body.stance[0].vertices
    tips = [stance[leg.sole, 1].min() for leg in body.legs]
    assert len(tips) == 8 and max(tips) < stance[body.mesh_handles.weights[:, 0] > 0.5, 1].min()


def test_many_legs_go_straight_on():
    parts = understood_rig(spider())
    walk = next(clip for clip in all_clips() if "walk" in clip.tags).motion().of_own_body()
    way = fit_motion(walk, parts.anatomy).root_translation
    across, along = np.abs(way[-1] - way[0])[[0, 2]]
    assert across < 0.1 * along
