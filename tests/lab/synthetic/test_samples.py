"""The sample characters, marching cubes and thinning."""

from __future__ import annotations

from functools import lru_cache

import igl
import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter
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
from bunraku_lab.synthetic.fields import CUBE, marching_cubes, thinned
from bunraku_lab.synthetic.samples import make_sample as shared_sample

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


make_sample = shared_sample.__wrapped__  # made anew at each call


@lru_cache
def sample(name, detail=1.0, rigged=False):
    return make_sample(name, detail, rigged=rigged)


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
@pytest.mark.parametrize("detail", [0.3, 1.0, 2.0])
def test_every_part_is_closed_and_wound_outward(name, detail):
    vertices, faces = welded(sample(name, detail))
    for part in parts(vertices, faces):
        forward, count = np.unique(edges_of(part), axis=0, return_counts=True)
        assert count.max() == 1, "an edge is used twice in one direction"
        backward = np.unique(edges_of(part)[:, ::-1], axis=0)
        assert np.array_equal(forward, backward), "an edge has no partner: the part is open"
        euler = len(np.unique(part)) - len(forward) // 2 + len(part)
        assert euler in (2, 0), "a part is neither a ball nor a ring"
        assert volume(vertices, part) > 0


@pytest.mark.parametrize(
    ("name", "euler", "count"),
    [("person", 2, 11), ("dancer", 2, 20), ("dog", 2, 9), ("mushroom", 2, 8), ("dragon", 2, 36)],
)
def test_the_body_is_one_ball_with_loose_parts(name, euler, count):
    vertices, faces = welded(sample(name))
    found = parts(vertices, faces)
    body = max(found, key=lambda part: volume(vertices, part))
    assert len(np.unique(body)) - len(np.unique(np.sort(edges_of(body), axis=1), axis=0)) + len(body) == euler
    assert len(found) >= count


def test_the_robot_is_of_many_parts():
    assert len(parts(*welded(sample("robot")))) > 40


@pytest.mark.parametrize("name", NAMES)
def test_it_stands_on_the_ground_in_its_colours(name):
    character = sample(name)
    assert character.name == name and character.rig is None
    assert np.isfinite(character.vertices).all()
    assert abs(character.vertices[:, 1].min()) < 1e-6
    assert 0.9 < character.height < 1.8
    assert 3000 <= len(character.vertices) <= 9000
    assert character.colors is not None and len(np.unique(character.colors, axis=0)) >= 4
    assert len(np.unique(character.faces)) == len(character.vertices), "every vertex belongs to a face"
    # one colour a face: seams double the vertices
    assert (np.ptp(character.colors[character.faces].astype(int), axis=1) == 0).all()


@pytest.mark.parametrize("name", NAMES)
def test_the_rig_follows_the_body(name):
    bare, character = sample(name), sample(name, rigged=True)
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


@pytest.mark.parametrize("name", [n for n in NAMES if n not in ("dog", "dragon")])
def test_people_stand_in_t_pose_with_limbs_apart(name):
    rig = (character := sample(name, rigged=True)).rig
    dense = rig.dense_weights()
    hand = character.vertices[dense[:, rig.names.index("LeftHand")] > 0.5]
    body = character.vertices[dense[:, rig.names.index("Hips")] > 0.5]
    assert hand[:, 0].min() > body[:, 0].max() - (0.0 if name != "dancer" else 0.2)
    left, right = (character.vertices[dense[:, rig.names.index(f"{side}Foot")] > 0.5] for side in ("Left", "Right"))
    assert left[:, 0].min() - right[:, 0].max() > 0.01
    # toes point to +Z
    ankle = rig.positions[rig.names.index("LeftFoot"), 2]
    feet = character.vertices[character.vertices[:, 1] < 0.03]
    assert feet[:, 2].max() - ankle > ankle - feet[:, 2].min()


def test_bad_requests_are_refused_in_one_sentence():
    with pytest.raises(OptionError, match="unicorn.*person"):
        make_sample("unicorn")
    for detail in (0.0, 5.0, float("nan")):
        with pytest.raises(OptionError, match="detail"):
            make_sample("person", detail)


@pytest.mark.parametrize("name", NAMES)
def test_the_shipped_file_is_what_is_made(name):
    made, shipped = sample(name), sample_character(name)
    np.testing.assert_allclose(shipped.vertices, made.vertices, atol=1e-6)
    assert np.array_equal(shipped.faces, made.faces) and np.array_equal(shipped.colors, made.colors)


THEIRS = np.array([0, 1, 3, 2, 4, 5, 7, 6])
"""Corners of a cube in the order of libigl."""


def grid(values):
    """The surface of values on a grid, ours and libigl's."""
    shape = values.shape
    points = np.argwhere(np.ones(shape)).astype(float)
    cells = np.argwhere(np.ones(np.array(shape) - 1))
    cubes = np.ravel_multi_index(np.moveaxis(cells[:, None] + CUBE, -1, 0), shape)
    theirs = igl.marching_cubes(values.reshape(-1), points, np.ascontiguousarray(cubes[:, THEIRS]), 0.0)[:2]
    return marching_cubes(values.reshape(-1), points, cubes), theirs


def volume_isosurface(vertices, faces):
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return float((np.cross(a, b) * c).sum() / 6)


def test_a_smooth_field_has_the_volume_that_libigl_finds():
    values = gaussian_filter(np.random.default_rng(1).normal(size=(24, 24, 24)), 3.0)
    values[[0, -1]] = values[:, [0, -1]] = values[:, :, [0, -1]] = 0.01
    ours, theirs = (volume_isosurface(np.asarray(one[0]), np.asarray(one[1])) for one in grid(values))
    assert ours == pytest.approx(theirs, rel=5e-3) and ours > 100  # wound outward


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
