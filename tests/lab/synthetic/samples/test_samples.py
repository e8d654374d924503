"""The sample characters: closed, wound outward, symmetric, on the ground, the same every time."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from bunraku.errors import OptionError
from bunraku.samples import sample_character, sample_names
from bunraku_lab.synthetic.samples import make_sample as shared_sample

make_sample = shared_sample.__wrapped__  # made anew at each call

NAMES = sample_names()
SYMMETRIC = ("mushroom", "dog", "dragon", "robot")


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
def test_triangles_are_well_shaped(name):
    vertices, faces = welded(sample(name))
    corners = vertices[faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    # 1 for an equilateral triangle, 0 for a degenerate one
    quality = 4 * np.sqrt(3) * area / (sides**2).sum(axis=1)
    assert area.min() > 1e-9
    assert np.median(quality) > (0.5 if name == "robot" else 0.8)
    assert np.mean(quality < 0.1) < 0.04


@pytest.mark.parametrize("name", NAMES)
def test_neighbouring_faces_do_not_fold_over(name):
    vertices, faces = welded(sample(name))
    # wings and spikes have sharp rims, so the largest part is looked at
    faces = max(parts(vertices, faces), key=lambda part: volume(vertices, part))
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ends = np.sort(edges_of(faces), axis=1)
    order = np.lexsort(ends.T)
    owner = (order % len(faces)).reshape(-1, 2)
    cosine = (normals[owner[:, 0]] * normals[owner[:, 1]]).sum(axis=1)
    assert np.mean(cosine < -0.5) < 0.002


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


@pytest.mark.parametrize("name", SYMMETRIC)
def test_left_and_right_are_images(name):
    vertices = np.unique(sample(name).vertices, axis=0)
    if name == "robot":  # its chest panel is not
        vertices = vertices[np.abs(vertices[:, 0]) > 0.2]
    distance, _ = cKDTree(vertices).query(vertices * [-1, 1, 1])
    assert np.quantile(distance, 0.98) < 1e-3
    assert distance.max() < 0.02


@pytest.mark.parametrize("name", NAMES)
def test_the_same_every_time_and_finer_with_detail(name):
    first, again = sample(name), make_sample(name)
    assert np.array_equal(first.vertices, again.vertices) and np.array_equal(first.faces, again.faces)
    assert np.array_equal(first.colors, again.colors)
    counts = [len(sample(name, detail).vertices) for detail in (0.3, 1.0, 2.0)]
    assert counts[0] < 0.75 * counts[1] and counts[1] < 0.8 * counts[2]


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
