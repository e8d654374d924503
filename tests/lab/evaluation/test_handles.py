"""The table of handles, with a predictor that knows the truth and with the shipped one."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles
from bunraku.errors import CharacterError, FormatError, OptionError
from bunraku.geometry.axes import ORIENTATIONS, upright_rotation
from bunraku.handles.orientation import resolve_axes
from bunraku.io import save_character
from bunraku.nn.checkpoints import shipped_checkpoint
from bunraku_lab.evaluation.handles.orientation import measure_orientation
from bunraku_lab.evaluation.handles.resampling import carried
from bunraku_lab.evaluation.handles.subjects import find_files, subject
from bunraku_lab.evaluation.handles.table import BARS, code_made_subjects, evaluate_handles, folder_subjects
from bunraku_lab.evaluation.handles.trials import Reference, measure_subject, prediction_seconds, resolution_differences
from bunraku_lab.synthetic.families import EVALUATION_SEED
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
        person.name,
        person.vertices @ turn.T,
        person.faces,
        type(rig)(rig.names, rig.parents, transforms, rig.indices, rig.weights),
    )
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
        loads,
        detailed={"kaykit/Other": loads["kaykit/Other"], "person": lambda: person},
        speed=False,
        progress=lambda stage, share: calls.append((stage, share)),
    )
    return result, calls, loads


@needs_weights
def test_the_table_as_a_whole(table):
    result, calls, _ = table
    assert json.loads(json.dumps(result)) == result
    assert set(BARS) <= set(result) and result["seconds_5k"] is None and set(result["reached"]) == set(result["bars"])
    assert result["counts"] == {"characters": 2, "humanoids": 2, "resampled": 2, "detailed": 2}
    purity = {row["name"]: row["part_purity"] for row in result["characters"]}
    assert list(result["detailed"]) == ["kaykit/Other", "person"]
    assert result["detailed"]["kaykit/Other"] == purity["kaykit/Other"]
    assert result["part_purity_detailed"] == np.mean(list(result["detailed"].values()))
    assert result["pose_error_creatures"] is None  # both are people
    assert list(result["left_out"]) == ["plain"] and "no rig" in result["left_out"]["plain"]
    assert result["same_meaning"] > 0.8 and result["pose_error"] < result["pose_error_bone_heat"]
    assert calls[-1] == ("speed", 1) and ("characters", 1) in calls and ("resolutions", 1) in calls
    first, second = result["characters"]
    drawn = {"name", *(key for key in first if key.startswith("pose_error"))}  # each name has its own poses
    assert {key: first[key] for key in first.keys() - drawn} == {key: second[key] for key in first.keys() - drawn}


@needs_weights
def test_processes_give_the_same_table(table):
    result, _, loads = table
    names = {name: load for name, load in loads.items() if name != "kaykit/Other"}
    shared = evaluate_handles(names, baselines=False, speed=False, jobs=2)
    assert list(shared["left_out"]) == list(result["left_out"]) == ["plain"]
    alone = {row["name"]: row for row in result["characters"]}
    for row in shared["characters"]:
        numbers = {key: value for key, value in row.items() if isinstance(value, float)}
        other = alone[row["name"]]
        assert len(numbers) > 5 and {key: other[key] for key in numbers} == pytest.approx(numbers, abs=1e-3)
    assert [row["name"] for row in shared["characters"]] == ["kaykit/Rogue_Hooded"]


def test_nothing_to_measure_is_said(tmp_path):
    save_character(make_sample("mushroom", 0.3), tmp_path / "plain.glb")
    if shipped_checkpoint("handles").is_file():
        with pytest.raises(OptionError, match="no rig"):
            evaluate_handles(folder_subjects(tmp_path), speed=False)


def test_predictions_are_timed():
    assert 0 < prediction_seconds(1_000, guessing, 2) < 5


def test_code_made_characters_are_of_seeds_that_nothing_trains_on():
    loads = code_made_subjects()
    assert len(loads) == 30 and all(int(name.rsplit("_", 1)[1]) >= EVALUATION_SEED for name in loads)
    name, load = next(iter(loads.items()))
    first = load()
    assert first.name == name and first.humanoid
    assert first.truth.weights.shape[1] == len(first.truth.joints) and first.truth.target.shape[1] == len(HANDLE_NAMES)
