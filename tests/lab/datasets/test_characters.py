import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bunraku.body.reference import reference_body
from bunraku.errors import CharacterError, FormatError
from bunraku.samples import sample_names
from bunraku_lab.datasets.characters.build import (
    HELD_OUT,
    build_characters,
    load_characters,
    reference_characters,
    training_character,
)
from bunraku_lab.datasets.characters.training_character import TrainingCharacter


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


def test_reference_shapes():
    shapes = reference_characters(mesh_vertices=300)
    assert len(shapes) > 3
    for shape in shapes[:2]:
        np.testing.assert_allclose(shape.target.sum(1), 1, atol=1e-3)


def test_variants_of_held_out_characters_are_neither_trained_on_nor_validated_twice(tmp_path):
    built = training_character(reference_body().character(), "x", mesh_vertices=300)
    for name in (HELD_OUT[0], HELD_OUT[0] + "~posed", "pack/free", "pack/free~posed"):
        path = tmp_path / f"{name}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        replace(built, name=name).save(path)
    train, held = load_characters(tmp_path)
    assert [c.name for c in train] == ["pack/free", "pack/free~posed"] and [c.name for c in held] == [HELD_OUT[0]]


def test_archive(tmp_path):
    folder = Path(os.environ.get("BUNRAKU_DATA", "../shared/data")) / "characters"
    file = folder / "kaykit" / "Knight.glb"
    if not file.is_file():
        pytest.skip("the character archive is not unpacked under BUNRAKU_DATA")
    small = tmp_path / "in" / "kaykit"
    small.mkdir(parents=True)
    (small / "Knight.glb").write_bytes(file.read_bytes())
    (small / "Broken.glb").write_bytes(b"glTF broken")
    done, failed = build_characters(tmp_path / "in", tmp_path / "cache", 600)
    assert [d.stem for d in done if d.parent.name == "kaykit"] == [
        "Knight",
        "Knight~coarse",
        "Knight~fine",
        "Knight~posed",
    ]
    assert set(failed) == {"kaykit/Broken"}
    sizes = [len(TrainingCharacter.load(d).vertices) for d in done[:4]]
    assert sizes[1] < sizes[0] < sizes[2]
    assert sorted(d.stem for d in done if d.parent.name == "samples") == sorted(sample_names())
    assert len(HELD_OUT) == 32
    assert sum(name.startswith("mesh2motion/") for name in HELD_OUT) == 2
