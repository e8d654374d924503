"""Handles: predicted, of a rig, and of extra limbs and appendages."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

import bunraku
from bunraku.anatomy.handles.limbs import (
    FAMILIES,
    edge_lengths,
    find_appendages,
    find_limbs,
    split_limbs,
    with_appendages,
)
from bunraku.anatomy.handles.predict import mesh_feature, predict_handles, smooth_weights, trim_weights
from bunraku.anatomy.names.bone_names import resolve_joints, rig_handles
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_MIRROR, HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.simplify import NetworkMesh, network_mesh
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.errors import CharacterError, OptionError
from bunraku_lab.synthetic.samples import make_sample

needs_weights = pytest.mark.skipif(
    not shipped_checkpoint("handles").is_file(), reason="the shipped weights are not there"
)


def test_smoothing_by_hand():
    weights = np.array([[1.0, 0], [0, 1], [0, 1]])
    got = smooth_weights(weights, np.array([[0, 1]]), steps=1, share=0.5)
    np.testing.assert_allclose(got, [[0.5, 0.5], [0.5, 0.5], [0, 1]])


def test_trimming_by_hand():
    np.testing.assert_allclose(
        trim_weights(np.array([[0.6, 0.395, 0.005]])), [[0.6 / 0.995, 0.395 / 0.995, 0]], rtol=1e-6
    )


@needs_weights
@pytest.mark.parametrize("name", ["person", "robot", "dog"])
def test_left_and_right_are_where_they_are(name):
    character = make_sample(name, 0.5)
    handles = predict_handles(character)
    np.testing.assert_allclose(handles.weights.sum(axis=1), 1, atol=1e-5)
    assert handles.features.shape == (448,)
    for part in ("elbow", "knee"):
        left, right = (handles.positions[HANDLE_NAMES.index(f"{side}_{part}"), 0] for side in ("left", "right"))
        assert left > 0.02 * character.height > -0.02 * character.height > right
    assert handles.positions[HANDLE_NAMES.index("head"), 1] > handles.positions[0, 1]


@needs_weights
def test_a_finer_tessellation_has_the_same_handles():
    character = make_sample("person", 0.5)
    mesh = trimesh.Trimesh(character.vertices, character.faces, process=False).subdivide()
    coarse, fine = predict_handles(character), predict_handles(Character("fine", mesh.vertices, mesh.faces))
    used = coarse.weights.mean(axis=0) > 0.003  # a handle that moves next to nothing may stand anywhere
    assert used.sum() > 15
    np.testing.assert_allclose(fine.positions[used], coarse.positions[used], atol=0.02 * character.height)
    np.testing.assert_allclose(mesh.vertices[: len(character.vertices)], character.vertices, atol=1e-6)
    assert np.abs(fine.weights[: len(character.vertices)] - coarse.weights).sum(axis=1).mean() < 0.15


@needs_weights
def test_vertices_at_one_place_have_equal_weights():
    character = make_sample("person", 0.5)
    whole = predict_handles(character)
    soup = Character(
        "soup", character.vertices[character.faces].reshape(-1, 3), np.arange(3 * len(character.faces)).reshape(-1, 3)
    )
    got = predict_handles(soup).weights
    corner = character.faces.reshape(-1)
    first = np.unique(corner, return_index=True)[1]
    np.testing.assert_array_equal(got, got[first][np.searchsorted(np.unique(corner), corner)])
    np.testing.assert_allclose(got, whole.weights[corner], atol=1e-3)


@needs_weights
def test_what_shows_no_body_moves_as_one():
    """Paper cards that lie on one another have no limbs."""
    spots = [(2, 2, 0, 0), (1.2, 0.6, 0, 0.5), (0.4, 0.9, -0.4, -0.3), (0.4, 0.9, 0.4, -0.3)]
    cards = trimesh.util.concatenate(
        [trimesh.creation.box((width, height, 0.01)).apply_translation([x, y, 0.02 * number])
         for number, (width, height, x, y) in enumerate(spots)]
    )  # fmt: skip
    weights = predict_handles(Character("cards", np.asarray(cards.vertices), np.asarray(cards.faces))).weights
    assert (weights[:, 0] == 1).all()


@needs_weights
def test_the_feature_alone_is_that_of_the_prediction():
    character = make_sample("dog", 0.5)
    np.testing.assert_allclose(mesh_feature(character), predict_handles(character).features, atol=1e-5)


@needs_weights
def test_a_mirrored_character_has_mirrored_weights():
    character = make_sample("dragon", 0.5)
    flipped = Character("flipped", character.vertices * [-1, 1, 1], character.faces[:, ::-1])
    got = predict_handles(flipped).weights[:, list(HANDLE_MIRROR)]
    assert np.abs(got - predict_handles(character).weights).sum(axis=1).mean() < 0.1


def test_joints_without_a_name_join_their_nearest_known_ancestor():
    handles, parents = np.array([-1, 0, 16, -1, -1, 15]), np.array([-1, 0, 1, 2, 3, -1])
    np.testing.assert_array_equal(resolve_joints(handles, parents), [0, 0, 16, 16, 16, 15])


def test_handles_from_bone_names_hold_every_vertex():
    person = make_sample("person", 0.3, rigged=True)
    handles = rig_handles(person)
    np.testing.assert_allclose(handles.weights.sum(axis=1), 1, atol=1e-4)
    left = handles.weights[:, HANDLE_NAMES.index("left_wrist")] > 0.5
    assert left.any() and (person.vertices[left, 0] > 0.3).all()


def test_an_unknown_bone_follows_the_bone_that_it_hangs_on():
    person = make_sample("person", 0.3, rigged=True)
    names = list(person.rig.names)
    forearm = names.index("LeftForeArm")
    names[forearm] = "xyzzy"
    got = rig_handles(dataclasses.replace(person, rig=dataclasses.replace(person.rig, names=tuple(names))))
    part = person.rig.dense_weights()[:, forearm] > 0.6
    assert part.any() and (got.weights[part].argmax(axis=1) == HANDLE_NAMES.index("left_shoulder")).all()


def test_what_cannot_be_understood_is_said():
    with pytest.raises(CharacterError, match="no rig in this file"):
        rig_handles(make_sample("person", 0.3))
    person = make_sample("person", 0.3, rigged=True)
    names = tuple(f"Bone.{n:03d}" for n in range(len(person.rig.names)))
    with pytest.raises(CharacterError, match="do not tell which part"):
        rig_handles(dataclasses.replace(person, rig=dataclasses.replace(person.rig, names=names)))
    with pytest.raises(OptionError, match="'predict' or 'rig'"):
        bunraku.rig(person, handles="guess")


H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}
NECK = 0.9


def figure(ears: float = 0.5):
    """A box with a ball for a head, which has two cones of some length for ears."""
    pieces = [
        trimesh.creation.box((0.5, 0.9, 0.3)).apply_translation([0, 0.45, 0]),
        trimesh.creation.icosphere(3, 0.25).apply_translation([0, 1.1, 0]),
    ]
    if ears:
        for side in (-1, 1):
            cone = trimesh.creation.cone(0.06, ears).subdivide().subdivide()
            cone.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], [0.5 * side, 1, 0]))
            pieces.append(cone.apply_translation([0.11 * side, 1.31, 0]))
    whole = trimesh.util.concatenate([piece.subdivide() for piece in pieces])
    mesh = network_mesh(whole.vertices, whole.faces, 2500)
    position = mesh.vertices * mesh.scale + mesh.center
    weights = np.zeros((len(position), HANDLE_COUNT), np.float32)
    high = position[:, 1] > NECK
    weights[high, H["head"]], weights[~high, H["spine2"]] = 1, 1
    return mesh, position, weights


def test_two_ears_are_found_from_root_to_tip():
    mesh, position, weights = figure()
    found = find_appendages(mesh, weights)
    assert len(found) == 2
    sides = sorted(np.sign(position[one.members][:, 0].mean()) for one in found)
    assert sides == [-1, 1]
    for one in found:
        assert one.length * mesh.scale == pytest.approx(0.5, abs=0.1)
        assert position[one.members][:, 1].max() > position[:, 1].max() - 0.05


@pytest.mark.parametrize("ears", [0.0, 0.06])
def test_a_round_head_has_none(ears):
    mesh, _, weights = figure(ears)
    assert find_appendages(mesh, weights) == []
    same, _, roles = with_appendages(mesh, weights, mesh.push_clean(weights))
    assert roles is None and same is weights


def test_each_gets_a_spare_handle_that_plays_the_top_of_the_head():
    mesh, position, weights = figure()
    out, full, roles = with_appendages(mesh, weights, mesh.push_clean(weights))
    own = np.flatnonzero(roles != np.arange(HANDLE_COUNT))
    assert len(own) == 2 and (roles[own] == H["head_top"]).all()
    np.testing.assert_allclose(out.sum(axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(full.sum(axis=1), 1, atol=1e-5)
    tips = position[:, 1] > position[:, 1].max() - 0.1
    np.testing.assert_allclose(out[tips][:, own].max(axis=1), 1, atol=1e-5)
    body = position[:, 1] < NECK
    np.testing.assert_allclose(out[body], weights[body], atol=1e-6)


def test_handles_that_are_in_use_are_not_taken():
    mesh, position, weights = figure()
    below = position[:, 1] < 0.3
    weights[below] = 0
    used = ["face", "left_fingers", "right_fingers", "left_foot", "right_foot", "tail_tip", "tail", "left_wing"]
    for number, name in enumerate(used):
        weights[np.flatnonzero(below)[number :: len(used)], H[name]] = 1
    _, _, roles = with_appendages(mesh, weights, mesh.push_clean(weights))
    assert np.flatnonzero(roles != np.arange(HANDLE_COUNT)).tolist() == [H["right_wing"]]


SIDES = (("left", 1.0), ("right", -1.0))


def tube(
    start: np.ndarray, end: np.ndarray, radius: float, rings: int = 14, around: int = 8
) -> tuple[np.ndarray, np.ndarray]:
    """A closed tube: vertices and faces."""
    way = (end - start) / np.linalg.norm(end - start)
    side = np.cross(way, [0.31, 0.2, 0.93])
    side /= np.linalg.norm(side)
    other, angle = np.cross(way, side), 2 * np.pi * np.arange(around) / around
    ring = radius * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other)
    vertices = np.concatenate([*(start + t * (end - start) + ring for t in np.linspace(0, 1, rings)), [start], [end]])
    faces = []
    for r in range(rings - 1):
        for a in range(around):
            i, j = r * around + a, r * around + (a + 1) % around
            faces += [[i, j, i + around], [j, j + around, i + around]]
    for a in range(around):
        last = (rings - 1) * around
        faces += [[(a + 1) % around, a, rings * around], [last + a, last + (a + 1) % around, rings * around + 1]]
    return vertices, np.array(faces)


def crawler(positions: tuple[float, ...], boots: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """A body along +Z with a leg a side at each of these places; boots are loose tubes around the shins."""
    pieces = [tube(np.array([0, 0.5, -0.8]), np.array([0, 0.5, 0.8]), 0.2, 24, 16)]
    for _, s in SIDES:
        for z in positions:
            root, knee, tip = (
                np.array([s * 0.15, 0.5, z]),
                np.array([s * 0.5, 0.65, 1.2 * z]),
                np.array([s * 0.9, 0, 1.4 * z]),
            )
            pieces += [tube(root, knee, 0.04), tube(knee, tip, 0.04)]
            if boots:
                pieces.append(tube(knee + 0.5 * (tip - knee), tip, 0.06))
    counts = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    return np.concatenate([v for v, _ in pieces]), np.concatenate(
        [f + start for (_, f), start in zip(pieces, counts[:-1], strict=True)]
    )


def shared_weights(mesh: NetworkMesh) -> np.ndarray:
    """What a predictor says that knows one leg a side: soft from hip to knee by the way outwards."""
    x = mesh.vertices * mesh.scale + mesh.center
    out = np.zeros((len(x), HANDLE_COUNT), np.float32)
    out[:, 0] = np.interp(np.abs(x[:, 0]), [0.18, 0.26], [1, 0])
    knee = np.interp(np.abs(x[:, 0]), [0.4, 0.6], [0, 1])
    for side, s in SIDES:
        here = (1 - out[:, 0]) * (s * x[:, 0] > 0)
        out[:, H[f"{side}_hip"]], out[:, H[f"{side}_knee"]] = here * (1 - knee), here * knee
    return out / out.sum(axis=1, keepdims=True)


@pytest.fixture(scope="module")
def spider() -> tuple[NetworkMesh, np.ndarray, np.ndarray]:
    mesh = network_mesh(*crawler((0.6, 0.2, -0.2, -0.6)))
    weights, roles = split_limbs(mesh, shared_weights(mesh))
    assert roles is not None
    return mesh, weights, roles


def test_every_leg_has_its_own_hip_and_knee(spider: tuple[NetworkMesh, np.ndarray, np.ndarray]) -> None:
    mesh, weights, roles = spider
    for side, _ in SIDES:
        for part in ("hip", "knee"):
            assert (roles == H[f"{side}_{part}"]).sum() == 4
    x = mesh.vertices * mesh.scale + mesh.center
    shin = np.abs(x[:, 0]) > 0.65
    leg = np.array([0.6, 0.2, -0.2, -0.6])[
        np.abs(x[:, 2, None] / np.array([0.78, 0.26, -0.26, -0.78]) - 1).argmin(axis=1)
    ]
    main = weights[shin].argmax(axis=1)
    pairs = {(bool(s), float(z), int(k)) for s, z, k in zip(x[shin, 0] > 0, leg[shin], main, strict=True)}
    assert len(pairs) == 8 and len({k for *_, k in pairs}) == 8


def test_rows_sum_to_one_and_parts_keep_what_they_weigh(spider: tuple[NetworkMesh, np.ndarray, np.ndarray]) -> None:
    mesh, weights, roles = spider
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
    together = np.zeros_like(weights)
    for handle, role in enumerate(roles):
        together[:, role] += weights[:, handle]
    np.testing.assert_allclose(together, shared_weights(mesh), atol=1e-5)


def test_both_sides_are_alike(spider: tuple[NetworkMesh, np.ndarray, np.ndarray]) -> None:
    mesh, weights, roles = spider
    areas = mesh.areas / mesh.areas.sum()
    shares = [sorted((areas @ weights)[roles == H[f"{side}_knee"]]) for side, _ in SIDES]
    np.testing.assert_allclose(*shares, rtol=0.1)


@pytest.mark.parametrize("boots", [False, True])
def test_one_leg_a_side_stays_one(boots: bool) -> None:
    mesh = network_mesh(*crawler((0.3,), boots))
    weights = shared_weights(mesh)
    same, roles = split_limbs(mesh, weights)
    assert roles is None and same is weights
    assert len(find_limbs(mesh, weights, edge_lengths(mesh))[FAMILIES[0], "left"][0]) == 1


def test_boots_do_not_hide_further_legs() -> None:
    mesh = network_mesh(*crawler((0.5, -0.5), boots=True))
    _, roles = split_limbs(mesh, shared_weights(mesh))
    assert roles is not None and (roles == H["left_knee"]).sum() == 2 == (roles == H["right_knee"]).sum()


def test_a_person_is_left_alone() -> None:
    body = reference_body()
    mesh = network_mesh(body.vertices, body.faces)
    assert split_limbs(mesh, mesh.pull(body.handle_weights))[1] is None


def test_too_few_spare_handles_join_the_outer_parts() -> None:
    mesh = network_mesh(*crawler((0.75, 0.45, 0.15, -0.15, -0.45, -0.75)))
    weights = shared_weights(mesh)
    body = weights[:, 0].copy()
    busy = [handle for handle in range(HANDLE_COUNT) if handle >= 9 and handle not in (10, 11, *range(22, 30))]
    for handle in busy:
        weights[:, handle] = 0.9 * body / len(busy)
    weights[:, 0] = 0.1 * body
    split, roles = split_limbs(mesh, weights)
    assert roles is not None
    np.testing.assert_allclose(split.sum(axis=1), 1, atol=1e-5)
    assert (roles == H["left_hip"]).sum() == (roles == H["right_hip"]).sum() > 3


def test_a_part_that_gets_no_handle_moves_no_other(spider: tuple[NetworkMesh, np.ndarray, np.ndarray]) -> None:
    """Weights that differ a little must not deal other handles to the parts that both have."""
    mesh, _, roles = spider
    plain = shared_weights(mesh)
    spare = H["head_top"]
    taken = plain.copy()
    taken[:, spare] += 0.3 * taken[:, 0]  # no longer spare: only the part that had it goes elsewhere
    taken[:, 0] *= 0.7
    other = split_limbs(mesh, taken)[1]
    changed = {handle for handle in range(HANDLE_COUNT) if roles[handle] != other[handle]}
    assert spare in changed and len(changed) == 2


def test_roles_are_checked_and_kept() -> None:
    positions, weights = np.zeros((3, 3)), np.full((4, 3), 1 / 3)
    handles = Handles(positions, weights, roles=np.array([0, 1, 1]))
    assert handles.top(2).played.tolist() == [0, 1, 1] and Handles(positions, weights).played.tolist() == [0, 1, 2]
    for bad in ([1, 1, 2], [0, 0, 1], [0, 1, 3], [0, 1]):
        with pytest.raises(CharacterError):
            Handles(positions, weights, roles=np.array(bad))
