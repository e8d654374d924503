"""The sample characters as they are shipped: small files with normals and colours."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from bunraku.core.animation import Animation
from bunraku.core.character import Handles
from bunraku.core.motion import HandleMotion
from bunraku.errors import OptionError
from bunraku.formats.gltf.container.open import open_document
from bunraku.formats.gltf.write import write_animation
from bunraku.geometry.surface import face_normals
from bunraku.samples import sample_character, sample_file, sample_names

NAMES = sample_names()


def normals_of(path):
    """Unit normals of the vertices of a file whose primitives share them, shape (V, 3)."""
    document = open_document(path, path.read_bytes())
    (mesh,) = document.items("meshes")
    (accessor,) = {primitive["attributes"]["NORMAL"] for primitive in mesh["primitives"]}
    return document.accessor(accessor, ("VEC3",))


@pytest.mark.parametrize("name", NAMES)
def test_normals_are_units_and_look_outward(name):
    character, normals = sample_character(name), normals_of(sample_file(name))
    assert character.name == name and character.rig is None
    assert 3000 <= len(character.vertices) <= 9000 and len(normals) == len(character.vertices)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-4)
    faces = face_normals(character.vertices, character.faces)
    faces /= np.linalg.norm(faces, axis=1, keepdims=True)
    along = np.einsum("fci,fi->fc", normals[character.faces], faces)
    assert np.mean(along > 0.7) > 0.95  # wings and fins have sharp rims
    # smooth: copies of a vertex on the two sides of a seam between colours mostly agree
    _, first, group = np.unique(character.vertices, axis=0, return_index=True, return_inverse=True)
    assert np.median(np.einsum("vi,vi->v", normals, normals[first[group.ravel()]])) > 0.99


def test_animations_keep_the_normals(tmp_path):
    character = sample_character("mushroom")
    handles = Handles(np.zeros((1, 3)), np.ones((len(character.vertices), 1)))
    still = HandleMotion(
        np.zeros((2, 1, 3)), np.tile(np.eye(3), (2, 1, 1, 1)), np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)), 20.0
    )
    path = write_animation(Animation(character, handles, still), tmp_path / "out.glb")
    assert np.array_equal(normals_of(path), normals_of(sample_file("mushroom")))


def test_the_files_are_small():
    assert sum(sample_file(name).stat().st_size for name in NAMES) <= 1_500_000


def test_an_unknown_name_is_refused_in_one_sentence():
    with pytest.raises(OptionError, match="unicorn.*person"):
        sample_character("unicorn")


def test_listing_the_names_loads_nothing_heavy():
    code = (
        "import sys, bunraku.samples as s; s.sample_names(); sys.exit(any(m in sys.modules for m in "
        "('igl', 'scipy', 'torch')))"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}, check=False
        ).returncode
        == 0
    )
