"""Rigged characters as training data."""

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bunraku.core.body.reference import reference_body
from bunraku.errors import CharacterError, FormatError
from bunraku.files import save_character
from bunraku.files.samples import sample_names
from bunraku_lab.datasets.characters.build import (
    HELD_OUT,
    build_characters,
    load_characters,
    rigged_files,
    training_character,
)
from bunraku_lab.datasets.characters.training_character import TrainingCharacter
from bunraku_lab.synthetic.samples import make_sample


def test_reference_character_knows_its_handles():
    body = reference_body()
    built = training_character(body.character(), "reference", mesh_vertices=600)
    assert len(built.vertices) <= 600 and built.height == pytest.approx(1, abs=0.05)
    np.testing.assert_allclose(built.weights.sum(1), 1, atol=1e-4)
    assert built.handles.tolist() == list(range(22))  # SMPL's own names are read as SMPL's own handles
    left_wrist = built.vertices[built.target[:, 20] > 0.5]
    assert len(left_wrist) and left_wrist[:, 0].min() > 0.2
    assert np.linalg.norm(built.root - built.joints[0]) < 1e-5


def test_characters_are_turned_to_face_forward():
    character = reference_body().character()
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # +Z to +X
    transforms = character.rig.transforms.copy()
    transforms[:, :3, 3] = transforms[:, :3, 3] @ quarter.T
    rig = type(character.rig)(
        character.rig.names, character.rig.parents, transforms, character.rig.indices, character.rig.weights
    )
    turned = type(character)("turned", character.vertices @ quarter.T.astype(np.float32), character.faces, rig)
    a, b = training_character(character, "a", 600), training_character(turned, "b", 600)
    np.testing.assert_allclose(b.joints, a.joints, atol=1e-3)


def test_characters_without_rigs_and_empty_folders(tmp_path):
    body = reference_body()
    bare = type(body.character())("bare", body.vertices, body.faces)
    with pytest.raises(CharacterError, match="no rig"):
        training_character(bare, "bare")
    with pytest.raises(FormatError, match="no GLB"):
        build_characters(tmp_path, tmp_path / "cache")


def test_variants_of_held_out_characters_are_neither_trained_on_nor_validated_twice(tmp_path):
    built = training_character(reference_body().character(), "x", mesh_vertices=300)
    for name in (HELD_OUT[0], HELD_OUT[0] + "~posed", "pack/free", "pack/free~posed"):
        path = tmp_path / f"{name}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        replace(built, name=name).save(path)
    train, held = load_characters(tmp_path)
    assert [c.name for c in train] == ["pack/free", "pack/free~posed"] and [c.name for c in held] == [HELD_OUT[0]]


DATA = Path(__file__).parents[2] / "files" / "data"


def test_all_kinds_become_training_characters(tmp_path):
    fbx = gzip.decompress((DATA / "boxman_z_up_cm.fbx.gz").read_bytes())
    (tmp_path / "mixamo").mkdir()
    (tmp_path / "mixamo" / "man.fbx").write_bytes(fbx)
    save_character(make_sample("mushroom", 0.3), tmp_path / "mixamo" / "man.glb")  # of the same name, and without a rig
    found = [path.relative_to(tmp_path).as_posix() for path in rigged_files(tmp_path)]
    assert found == ["mixamo/man.fbx", "mixamo/man.glb"]

    for name in sample_names():  # what is there already is kept, so the samples are not built again here
        (tmp_path / "cache" / "samples").mkdir(parents=True, exist_ok=True)
        (tmp_path / "cache" / "samples" / f"{name}.npz").touch()
    done, failed = build_characters(tmp_path, tmp_path / "cache", 300)
    names = {path.relative_to(tmp_path / "cache").with_suffix("").as_posix() for path in done}
    assert "mixamo/man" in names and list(failed) == ["mixamo/man.glb"] and "no rig" in failed["mixamo/man.glb"]
    man = TrainingCharacter.load(tmp_path / "cache" / "mixamo" / "man.npz")
    assert man.handles[0] == 0 and set(man.handles.tolist()) >= {0, 1, 2, 4, 5, 15, 16, 17, 18, 19}  # by Mixamo's names
    left = man.vertices[man.target[:, 18] > 0.9]
    assert len(left) and 0.9 < man.height <= 1.01 and left[:, 0].min() > 0
    assert len(man.vertices) <= 300
