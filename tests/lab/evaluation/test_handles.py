"""The evaluation of handles: subjects, rest poses, rigid blocks, the table."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from rigid_blocks import block_motion
from rigid_blocks import main as measure_blocks

from bunraku.anatomy.handles.orientation import resolve_axes
from bunraku.core.body.layout import JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.axes import ORIENTATIONS, upright_rotation
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.errors import CharacterError, FormatError, WeightsError
from bunraku.files import save_character
from bunraku_lab.datasets.characters.training_character import (
    TrainingCharacter,
    forward_kinematics,
    handle_target,
    random_pose,
)
from bunraku_lab.evaluation.handles.measures import carried
from bunraku_lab.evaluation.handles.rest_poses import REST_POSES, limb_directions, posed_limbs
from bunraku_lab.evaluation.handles.subjects import ARCHIVE, AVATARS, WARDROBE, detailed_subjects, find_files, subject
from bunraku_lab.evaluation.handles.table import (
    BARS,
    Reference,
    evaluate_handles,
    folder_subjects,
    measure_orientation,
    measure_subject,
    resolution_differences,
)
from bunraku_lab.synthetic.samples import make_sample

needs_weights = pytest.mark.skipif(
    not shipped_checkpoint("handles").is_file(), reason="the shipped weights are not there"
)


def knowing(character: Character) -> Handles:
    """The canonical handles of the reference body, for it in any pose and resolution."""
    body = reference_body()
    same = len(character.vertices) == len(body.vertices)
    weights = (
        body.handle_weights if same else carried(body.handle_weights, body.vertices, body.faces, character.vertices)
    )
    return Handles(handle_positions(character.vertices, weights, np.ones(len(weights))), weights)


def guessing(character: Character) -> Handles:
    """Handles by height alone."""
    level = np.clip((character.vertices[:, 1] / character.vertices[:, 1].max() * 30).astype(int), 0, 29)
    weights = np.eye(30, dtype=np.float32)[level]
    return Handles(handle_positions(character.vertices, weights, np.ones(len(weights))), weights)


def test_the_truth_gets_full_marks():
    person = subject(reference_body().character(), "reference/average")
    row = measure_subject(person, knowing, Reference.of(knowing), baselines=False)
    assert row["humanoid"] and all(row["parts"].values()) and len(row["parts"]) == 15
    assert row["same_meaning"] == 1 and row["same_meaning_vertices"] > 0.95
    assert row["root_error"] < 0.05 and row["part_purity"] > 0.75  # the hand is one joint and two handles
    assert row["pose_error"] < 0.005
    assert row["rest_pose_agreement"] == 1 and set(row["rest_poses"]) == {"A", "arms down", "sitting"}
    assert row["top4_error"] < 1e-3
    assert max(resolution_differences(person, knowing).values()) < 0.05


def test_a_guess_does_not():
    person = subject(reference_body().character(), "reference/average")
    row = measure_subject(person, guessing, Reference.of(knowing))
    assert row["same_meaning"] < 0.2 and row["part_purity"] < 0.8 and row["rest_pose_agreement"] < 0.9
    assert row["pose_error"] > 0.01 and row["pose_error"] > row["pose_error_clusters"]
    assert 0 < row["pose_error_bone_heat"] < 0.05


def test_samples_are_humanoids_or_not():
    kinds = {
        name: subject(make_sample(name, 0.3, rigged=True), name).humanoid
        for name in ("person", "dancer", "robot", "dog", "mushroom", "dragon")
    }
    assert [name for name, human in kinds.items() if human] == ["person", "dancer", "robot", "mushroom"]


def test_what_faces_sideways_is_turned():
    person = make_sample("person", 0.3, rigged=True)
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # left is at -Z now
    rig = person.rig
    transforms = rig.transforms.copy()
    transforms[:, :3, 3] = rig.positions @ turn.T
    sideways = Character(
        person.name, person.vertices @ turn.T, person.faces,
        type(rig)(rig.names, rig.parents, transforms, rig.indices, rig.weights),
    )  # fmt: skip
    a, b = subject(person, "person"), subject(sideways, "person")
    np.testing.assert_allclose(b.character.vertices, a.character.vertices, atol=1e-5)
    np.testing.assert_allclose(b.truth.joints, a.truth.joints, atol=1e-5)
    np.testing.assert_array_equal(b.truth.handles, a.truth.handles)


def test_no_rig_is_said():
    with pytest.raises(CharacterError, match="no rig"):
        subject(make_sample("dog", 0.3), "dog")


@needs_weights
@pytest.mark.parametrize("name", ["person", "dog"])
def test_orientation_is_what_settle_makes_of_each_turned_file(name):
    """Measured by permuting one look; here some of the turned meshes are looked at themselves."""
    one = subject(make_sample(name, 0.3, rigged=True), name)
    row = measure_orientation(one)
    kind = "orientation_humanoids" if one.humanoid else "orientation_creatures"
    assert row[kind] == row["orientation_up"] == row["orientation_front"] == row["orientation_upright"] == 1
    assert row["orientation_warned"] is None
    for up, front in ORIENTATIONS[::6]:
        vertices = one.character.vertices @ upright_rotation(up, front).astype(np.float32)
        found = resolve_axes(Character(name, vertices, one.character.faces), suffix=".obj")
        assert (found.up, found.front) == (up, front)


@needs_weights
def test_a_character_that_faces_backwards_counts_as_wrong():
    one = subject(make_sample("dog", 0.3, rigged=True), "dog")
    backwards = Character("dog", one.character.vertices * np.float32([-1, 1, -1]), one.character.faces)
    row = measure_orientation(replace(one, character=backwards))
    assert row["orientation_creatures"] == row["orientation_front"] == 0 and row["orientation_up"] == 1
    assert row["orientation_warned"] is not None


@pytest.fixture
def folder(tmp_path):
    """A folder like the archive: a held-out character, another one, and files without a rig."""
    return filled(tmp_path)


def filled(tmp_path):
    (tmp_path / "kaykit").mkdir()
    for name in ("kaykit/Rogue_Hooded", "kaykit/Other"):
        body = reference_body().character()
        rig = Handles(reference_body().handles.positions, reference_body().handle_weights)
        save_character(Character(name, body.vertices, body.faces), tmp_path / f"{name}.glb", rig)
    save_character(make_sample("mushroom", 0.3), tmp_path / "plain.glb")
    (tmp_path / "notes.txt").write_text("nothing")
    return tmp_path


def test_of_the_archive_only_what_training_never_saw_is_taken(folder):
    assert list(folder_subjects(folder)) == ["kaykit/Rogue_Hooded"]
    assert list(folder_subjects(folder, everything=True)) == ["kaykit/Other", "kaykit/Rogue_Hooded", "plain"]
    (folder / "kaykit" / "Rogue_Hooded.glb").unlink()
    assert len(find_files(folder)) == 2
    with pytest.raises(FormatError, match="no characters"):
        find_files(folder / "kaykit" / "none")


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """The table of a folder in this process, its progress, and its subjects."""
    calls = []
    loads = folder_subjects(filled(tmp_path_factory.mktemp("archive")), True)
    person = subject(make_sample("person", 0.3, rigged=True), "person")
    result = evaluate_handles(
        loads, detailed={"kaykit/Other": loads["kaykit/Other"], "person": lambda: person},
        progress=lambda stage, share: calls.append((stage, share)),
    )  # fmt: skip
    return result, calls, loads


@needs_weights
def test_the_table_as_a_whole(table):
    result, calls, _ = table
    assert json.loads(json.dumps(result)) == result
    assert set(BARS) <= set(result) and set(result["reached"]) == set(result["bars"])
    assert result["counts"] == {"characters": 2, "humanoids": 2, "resampled": 2, "detailed": 2}
    purity = {row["name"]: row["part_purity"] for row in result["characters"]}
    assert list(result["detailed"]) == ["kaykit/Other", "person"]
    assert result["detailed"]["kaykit/Other"] == purity["kaykit/Other"]
    assert result["part_purity_detailed"] == np.mean(list(result["detailed"].values()))
    assert result["pose_error_creatures"] is None  # both are people
    assert list(result["left_out"]) == ["plain"] and "no rig" in result["left_out"]["plain"]
    assert result["same_meaning"] > 0.8 and result["pose_error"] < result["pose_error_bone_heat"]
    assert ("characters", 1) in calls and ("resolutions", 1) in calls
    first, second = result["characters"]
    drawn = {"name", *(key for key in first if key.startswith("pose_error"))}  # each name has its own poses
    assert {key: first[key] for key in first.keys() - drawn} == {key: second[key] for key in first.keys() - drawn}


def test_files_that_are_not_there_are_left_out(tmp_path):
    (tmp_path / "valid").mkdir()
    (tmp_path / f"{ARCHIVE[-1]}.glb").write_bytes(b"")
    (tmp_path / "Other.pmx").write_bytes(b"")
    (tmp_path / AVATARS[1]).write_bytes(b"")
    assert list(detailed_subjects(tmp_path, tmp_path))[:2] == [ARCHIVE[-1], "Gene"]
    assert list(detailed_subjects()) == [f"wardrobe/{seed}" for seed in WARDROBE]


J = {name: index for index, name in enumerate(JOINT_NAMES)}


def stick_figure(seed: int | None = None) -> TrainingCharacter:
    """The reference body's joints as a mesh of 22 points, each wholly of its joint; with a seed in a random pose."""
    joints, parents = np.asarray(reference_body().joints, float), np.array(JOINT_PARENTS)
    none = np.zeros((0, 3))

    def figure(positions: np.ndarray) -> TrainingCharacter:
        weights = np.eye(22, dtype=np.float32)
        target = handle_target(weights, np.arange(22))
        return TrainingCharacter(
            "stick", positions, none, np.ones(22), none, weights, positions, parents, np.arange(22), target,
            positions[0], float(np.ptp(positions[:, 1])),
        )  # fmt: skip

    if seed is None:
        return figure(joints)
    turns = forward_kinematics(joints, parents, random_pose(np.random.default_rng(seed), figure(joints), 0.8))
    return figure(np.einsum("jab,jb->ja", turns[:, :, :3], joints) + turns[:, :, 3])


@pytest.mark.parametrize("seed", [None, 1, 2])
@pytest.mark.parametrize("pose", REST_POSES)
def test_limbs_point_where_the_pose_says(pose, seed):
    figure = stick_figure(seed)
    positions = posed_limbs(figure, pose).astype(float)
    for part, want in limb_directions(pose).items():
        side, name = part.split("_")
        child = {"shoulder": "elbow", "elbow": "wrist", "hip": "knee", "knee": "ankle"}[name]
        bone = positions[J[f"{side}_{child}"]] - positions[J[part]]
        before = figure.joints[J[f"{side}_{child}"]] - figure.joints[J[part]]
        assert np.linalg.norm(bone) == pytest.approx(np.linalg.norm(before), rel=1e-4)  # bones keep their lengths
        if name in ("hip", "knee") and pose != "sitting":
            assert abs(bone[2]) < 1e-4 and bone[1] < 0
        else:
            np.testing.assert_allclose(bone / np.linalg.norm(bone), want, atol=1e-4)
    np.testing.assert_allclose(positions[: J["left_hip"]], figure.joints[: J["left_hip"]], atol=1e-5)  # the root rests


def boxes():
    """Two unit boxes that touch at x = 0.5, as one character."""
    one, two = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1))
    two.apply_translation((1, 0, 0))
    both = trimesh.util.concatenate([one, two])
    label = np.repeat([0, 1], len(one.vertices))
    return Character("boxes", both.vertices, both.faces), label


def test_a_gap_is_how_far_blocks_come_apart():
    character, label = boxes()
    posed = np.tile(character.vertices, (3, 1, 1)).astype(np.float64)
    posed[1, label == 1] += [0.07, 0, 0]
    posed[2, label == 1] -= [0.03, 0, 0]  # sinks in
    found = block_motion(character, label, [(1, 0)], posed)
    np.testing.assert_allclose(found.gaps, [0.07], atol=0.006)
    assert found.shear < 1e-6


BOXES = {
    "torso": ((-0.25, 0.7, -0.12), (0.25, 1.3, 0.12)), "head": ((-0.2, 1.3, -0.2), (0.2, 1.7, 0.2)),
    "arm-left": ((0.25, 0.6, -0.08), (0.42, 1.28, 0.08)), "arm-right": ((-0.42, 0.6, -0.08), (-0.25, 1.28, 0.08)),
    "leg-left": ((0.01, 0, -0.1), (0.22, 0.7, 0.1)), "leg-right": ((-0.22, 0, -0.1), (-0.01, 0.7, 0.1)),
}  # fmt: skip


def test_a_figure_of_blocks_is_measured_and_a_ball_is_none(tmp_path, capsys):
    try:
        for name in ("handles", "orientation", "diffusion"):
            shipped_checkpoint(name)
    except WeightsError:
        pytest.skip("needs the shipped weights")
    scene = trimesh.Scene()
    for name, (low, high) in BOXES.items():
        box = trimesh.creation.box(bounds=(low, high))
        scene.add_geometry(box, node_name=name, geom_name=name)
    scene.export(tmp_path / "man.glb")
    trimesh.creation.icosphere(2).export(tmp_path / "ball.glb")
    status = measure_blocks([str(tmp_path / "man.glb"), str(tmp_path / "ball.glb"), "--seconds", "1"])
    man, ball = json.loads(capsys.readouterr().out)
    assert status == 0 and man["blocks"] == 6 and man["shear"] < 1e-4 and man["gap"] < 0.01
    assert ball["blocks"] == 0
