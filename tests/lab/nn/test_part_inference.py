"""The part network: points of a mesh, numbers like torch's, labels of every vertex."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.apparel.part_network import (
    CARRIERS,
    FEATURES,
    PARTS,
    PartConfig,
    load_parts,
    loose_parts,
    part_points,
    point_features,
)
from bunraku.apparel.parts import find_parts
from bunraku.errors import CharacterError, WeightsError
from bunraku.files.samples import sample_character

SMALL = PartConfig(fine=8, middle=16, coarse=20, layers=2, heads=2, before=1, after=1)


def two_balls() -> tuple[np.ndarray, np.ndarray]:
    """A large and a small sphere above it, as two loose parts."""
    angle, rise = np.meshgrid(np.arange(24) * 2 * np.pi / 24, np.linspace(0.05, np.pi - 0.05, 20))
    ball = np.stack([np.sin(rise) * np.sin(angle), np.cos(rise), np.sin(rise) * np.cos(angle)], axis=-1).reshape(-1, 3)
    row, column = np.meshgrid(np.arange(19), np.arange(24), indexing="ij")
    a, b = row * 24 + column, row * 24 + (column + 1) % 24
    quads = np.stack([a, a + 24, b + 24, b], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return np.concatenate([ball, 0.3 * ball + [0, 1.4, 0]]), np.concatenate([faces, faces + len(ball)])


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    torch = pytest.importorskip("torch")
    from bunraku_lab.nn.parts import PartNetwork

    torch.manual_seed(0)
    return PartNetwork(SMALL).save(tmp_path_factory.mktemp("parts") / "parts.safetensors")


def test_points_lie_on_the_mesh_and_do_not_depend_on_where_it_stands_or_how_large_it_is():
    vertices, faces = two_balls()
    own = loose_parts(vertices, faces)
    seen = part_points(vertices, faces, own, seed=3)
    assert seen.surface.points.shape == (SMALL.points, 3)
    assert seen.gather.shape[0] == seen.beside.shape[0] == SMALL.centres and seen.gather_up.shape[0] == SMALL.tokens
    assert set(np.unique(seen.surface.part)) == {0, 1}
    size, middle = np.ptp(vertices, axis=0).max(), 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    placed = seen.surface.points * size + middle
    radius = np.where(seen.surface.part == seen.surface.part[placed[:, 1].argmin()], 1.0, 0.3)
    centre = np.where(radius[:, None] == 1.0, [0.0, 0, 0], [0.0, 1.4, 0])
    assert np.abs(np.linalg.norm(placed - centre, axis=1) - radius).max() < 0.03
    again = part_points(7 * vertices + [1, 2, 3], faces, own, seed=3)
    assert np.allclose(point_features(again.surface), point_features(seen.surface), atol=1e-4)
    assert point_features(seen.surface).shape == (SMALL.points, FEATURES)
    # The first points cover the surface: no point is far from them.
    gaps = np.linalg.norm(seen.surface.points[:, None] - seen.surface.points[None, : SMALL.tokens], axis=2).min(axis=1)
    assert gaps.max() < 0.12


def test_numbers_are_those_of_torch(checkpoint):
    torch = pytest.importorskip("torch")
    from bunraku_lab.nn.parts import PartNetwork, point_batch

    vertices, faces = two_balls()
    seen = part_points(vertices, faces, loose_parts(vertices, faces), np.full(vertices.shape, 0.4), seed=1)
    names = ("gather", "beside", "gather_up", "down", "fine", "down_shares", "fine_shares")
    row = {name: getattr(seen, name) for name in names}
    torch_one = PartNetwork.load(checkpoint)
    with torch.no_grad():
        expected = torch_one(
            point_batch([row], [point_features(seen.surface)], [seen.surface.points], [seen.surface.part])
        ).numpy()
    assert np.abs(load_parts(checkpoint).scores(seen) - expected).max() < 1e-4


def test_every_vertex_gets_probabilities_and_parts_do_not_run_into_one_another(checkpoint):
    vertices, faces = two_balls()
    vertices = np.concatenate([vertices, [[0.0, 0, 0]]])  # one without faces
    found = find_parts(vertices, faces, checkpoint=checkpoint)
    assert found.parts.shape == (len(vertices), len(PARTS)) and found.carriers.shape == (len(vertices), len(CARRIERS))
    assert np.allclose(found.parts.sum(axis=1), 1, atol=1e-4) and np.allclose(found.carriers.sum(axis=1), 1, atol=1e-4)
    assert ((found.hangs >= 0) & (found.hangs <= 1)).all()
    assert found.label.max() < len(PARTS)


def test_what_is_wrong_is_said(tmp_path, checkpoint):
    vertices, faces = two_balls()
    with pytest.raises(CharacterError):
        find_parts(vertices * np.nan, faces, checkpoint=checkpoint)
    with pytest.raises(WeightsError, match="no such checkpoint"):
        find_parts(vertices, faces, checkpoint=tmp_path / "none.safetensors")


def test_the_dancers_skirt_hangs_and_the_dog_has_nothing_on():
    dancer, dog = (sample_character(name) for name in ("dancer", "dog"))
    found = find_parts(dancer.vertices, dancer.faces)
    skirt = (found.label == PARTS.index("skirt")) & (dancer.areas > 0)
    assert dancer.areas[skirt].sum() > 0.2 * dancer.areas.sum()
    assert found.mask[skirt].mean() > 0.8
    marked = find_parts(dog.vertices, dog.faces).mask
    assert dog.areas[marked].sum() < 0.02 * dog.areas.sum()
