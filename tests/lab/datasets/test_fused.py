"""Fused forms, held against bodies whose parts are known by where they lie."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from bunraku.core.character import Character, Rig
from bunraku.errors import CharacterError
from bunraku.geometry.surface import face_normals
from bunraku.samples import sample_names
from bunraku_lab.datasets.characters.build import build_characters, training_character
from bunraku_lab.datasets.characters.fused import fused_character
from bunraku_lab.datasets.characters.remeshed import fused_mesh
from bunraku_lab.datasets.characters.training_character import TrainingCharacter
from bunraku_lab.synthetic.families.shapes import block_mesh
from bunraku_lab.synthetic.samples.fields import bar

DATA = Path(__file__).parents[2] / "formats" / "data"


def two_bars():
    """Two upright bars side by side that cut into each other by a tenth of their radius, each moved by one joint."""
    made = [block_mesh(bar((x, 0.2, 0), (x, 1.0, 0), (0.2, 0.2)), 2.0, 12) for x in (-0.19, 0.19)]
    vertices = np.concatenate([mesh[0] for mesh in made])
    faces = np.concatenate([made[0][1], made[1][1] + len(made[0][0])])
    transforms = np.tile(np.eye(4), (2, 1, 1))
    transforms[:, :3, 3] = [[-0.19, 0.2, 0], [0.19, 0.2, 0]]
    own = np.repeat([0, 1], [len(mesh[0]) for mesh in made])
    rig = Rig(("Hips", "Spine"), np.array([-1, 0]), transforms, own[:, None], np.ones((len(own), 1), np.float32))
    return Character("bars", vertices.astype(np.float32), faces, rig)


def test_the_mesh_of_a_ball_is_closed_and_looks_outwards():
    points = np.random.default_rng(3).normal(size=(60_000, 3))
    points = [1, 2, 3] + 0.5 * points / np.linalg.norm(points, axis=1, keepdims=True)
    vertices, faces = fused_mesh(points, 40)
    assert np.abs(np.linalg.norm(vertices - [1, 2, 3], axis=1) - 0.5).max() < 1.5 / 40
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert (np.unique(ends, axis=0, return_counts=True)[1] == 2).all()
    middles = vertices[faces].mean(axis=1) - [1, 2, 3]
    volume = (face_normals(vertices, faces) * middles).sum() / 6
    assert volume == pytest.approx(4 / 3 * np.pi * 0.5**3, rel=0.15)


def test_bars_that_touch_become_one_skin_of_two_parts():
    character = two_bars()
    truth = training_character(character, "bars")
    for seed in range(4):
        fused = fused_character(character, truth, "bars", np.random.default_rng(seed))
        weights = fused.rig.dense_weights()
        x = fused.vertices[:, 0] - fused.rig.positions[:, 0].mean()
        turned = fused.rig.positions[1, 0] - fused.rig.positions[0, 0]
        assert turned > 0.1
        far = np.abs(x) > 0.1 * np.ptp(x)
        assert ((weights[:, 1] > 0.5) == (x > 0))[far].mean() > 0.98, seed
        ends = fused.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        crosses = (x[ends[:, 0]] < 0) != (x[ends[:, 1]] < 0)
        assert crosses.any(), "the two are still apart"
        inside = np.abs(x) < 0.02 * np.ptp(x)
        assert np.hypot(fused.vertices[inside, 0], fused.vertices[inside, 2]).min(initial=1) > 0.01


def test_a_bare_mesh_cannot_be_fused():
    character = two_bars()
    bare = Character("bare", character.vertices, character.faces)
    with pytest.raises(CharacterError, match="no rig"):
        fused_character(bare, training_character(character, "bars"), "bare", np.random.default_rng(0))


def test_fused_forms_lie_beside_the_characters_that_they_are_of(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "man.fbx").write_bytes(gzip.decompress((DATA / "boxman_z_up_cm.fbx.gz").read_bytes()))
    cache = tmp_path / "out"
    (cache / "samples").mkdir(parents=True)
    for name in sample_names():  # what is there already is kept, so the samples are not built again here
        (cache / "samples" / f"{name}.npz").touch()
        (cache / "samples" / f"{name}~fused0.npz").touch()
    files, failed = build_characters(tmp_path / "in", cache, 400, appendages=1, fused=1)
    names = {file.relative_to(cache).with_suffix("").as_posix() for file in files}
    assert not failed
    assert {"man", "man~fused0", "code_made/stubby_beast_0", "code_made/stubby_beast_0~fused0"} <= names
    whole, fused = (TrainingCharacter.load(cache / f"man{kind}.npz") for kind in ("", "~fused0"))
    assert fused.handles.tolist() == whole.handles.tolist()
    assert not np.array_equal(fused.vertices, whole.vertices)
