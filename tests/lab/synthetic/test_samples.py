"""The sample characters, marching cubes and thinning."""

from __future__ import annotations

import igl
import numpy as np
import pytest
import trimesh
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from bunraku.core.animation import Animation
from bunraku.core.character import Handles
from bunraku.core.geometry.surface import face_normals
from bunraku.core.motion import HandleMotion
from bunraku.errors import OptionError
from bunraku.files.gltf.open import open_document
from bunraku.files.gltf.write import write_animation
from bunraku.files.samples import sample_character, sample_file, sample_names
from bunraku_lab.synthetic.fields import grid_surface, thinned
from bunraku_lab.synthetic.samples import DETAILS, make_sample

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


def test_an_unknown_name_is_refused_in_one_sentence():
    with pytest.raises(OptionError, match="unicorn.*person"):
        sample_character("unicorn")


def welded(character):
    """Vertices and faces with vertices at one place made one, by exact position."""
    vertices, index = np.unique(character.vertices, axis=0, return_inverse=True)
    return vertices.astype(float), index.ravel()[character.faces]


def edges_of(faces):
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def parts(vertices, faces):
    """The faces of each connected part."""
    ends = edges_of(faces)
    _, label = connected_components(
        csr_matrix((np.ones(len(ends)), ends.T), shape=(len(vertices),) * 2), directed=False
    )
    label = label[faces[:, 0]]
    return [faces[label == value] for value in np.unique(label)]


def volume(vertices, faces):
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("detail", DETAILS)
def test_every_part_is_closed_and_wound_outward(name, detail):
    vertices, faces = welded(make_sample(name, detail))
    for part in parts(vertices, faces):
        forward, count = np.unique(edges_of(part), axis=0, return_counts=True)
        assert count.max() == 1, "an edge is used twice in one direction"
        backward = np.unique(edges_of(part)[:, ::-1], axis=0)
        assert np.array_equal(forward, backward), "an edge has no partner: the part is open"
        euler = len(np.unique(part)) - len(forward) // 2 + len(part)
        assert euler in (2, 0), "a part is neither a ball nor a ring"
        assert volume(vertices, part) > 0


@pytest.mark.parametrize("name", NAMES)
def test_the_rig_follows_the_body(name):
    bare, character = sample_character(name), make_sample(name, rigged=True)
    rig = character.rig
    assert rig is not None and np.array_equal(bare.vertices, character.vertices)
    joints = dict(zip(rig.names, rig.positions, strict=True))
    assert {"Hips", "Spine", "Head", "LeftArm", "RightArm", "LeftFoot", "RightFoot"} <= set(joints)
    for joint, position in joints.items():
        if joint.startswith("Left"):
            assert position[0] > 0.02
            np.testing.assert_allclose(joints[joint.replace("Left", "Right")], position * [-1, 1, 1], atol=1e-9)
    assert (rig.parents < np.arange(len(rig.names))).all() and (rig.parents == -1).sum() == 1
    np.testing.assert_allclose(rig.weights.sum(axis=1), 1, atol=1e-5)
    # every joint's vertices gather around it, and those of a left joint are on the left
    dense = rig.dense_weights()
    for index, joint in enumerate(rig.names):
        mine = dense[:, index] > 0.5
        if not mine.any():
            continue
        near = np.linalg.norm(character.vertices[mine] - joints[joint], axis=1)
        assert np.median(near) < 0.45, joint
        if joint.startswith("Left"):
            assert character.vertices[mine, 0].min() > -0.02, joint
    used = dense.max(axis=0) > 0.5
    assert used.mean() > 0.8, [n for n, u in zip(rig.names, used, strict=True) if not u]


def test_bad_requests_are_refused_in_one_sentence():
    with pytest.raises(OptionError, match="unicorn.*person"):
        make_sample("unicorn")
    for detail in (0.0, 5.0, float("nan")):
        with pytest.raises(OptionError, match="detail"):
            make_sample("person", detail)


def test_a_rough_field_has_a_closed_surface_of_a_balls_volume():
    """A ball under white noise, so that the surface crosses cubes in many ways."""
    x, y, z = np.mgrid[-15:16, -15:16, -15:16]
    values = np.sqrt(x**2 + y**2 + z**2) - 10 + np.random.default_rng(0).normal(size=x.shape)
    vertices, faces = grid_surface(values, 0.1, np.full(3, -1.5))
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).tolist()
    once = set(map(tuple, sides))
    assert len(once) == len(sides) and once == {(b, a) for a, b in once}
    assert volume(vertices, faces) == pytest.approx(4 / 3 * np.pi, rel=0.1)  # wound outward


def test_a_ball_stays_a_closed_ball():
    ball = trimesh.creation.icosphere(4, 1.0)
    vertices, faces = thinned(np.asarray(ball.vertices), np.asarray(ball.faces), 1000)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert 950 < len(faces) <= 1000 and mesh.is_watertight and mesh.is_winding_consistent and mesh.euler_number == 2
    assert abs(mesh.volume / ball.volume - 1) < 0.02
    theirs, few, _, _ = igl.decimate(
        np.asfortranarray(ball.vertices), np.asfortranarray(np.asarray(ball.faces, np.int32)), 1000
    )
    wide, other = (np.ptp(trimesh.Trimesh(v, f, process=False).edges_unique_length)
                   for v, f in ((vertices, faces), (theirs, np.asarray(few))))  # fmt: skip
    assert wide < 1.3 * other
