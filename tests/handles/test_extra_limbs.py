"""Legs beyond two: who has them gets handles for each, and nobody else does."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.character import Handles
from bunraku.errors import CharacterError
from bunraku.geometry.simplify import NetworkMesh, network_mesh
from bunraku.handles.extra_limbs import split_limbs
from bunraku.handles.limbs import FAMILIES, edge_lengths, find_limbs

H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}
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
