"""A cape beside an arm goes with the trunk, a sleeve round it with the arm."""

from __future__ import annotations

import numpy as np
import trimesh

from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.geometry.simplify import network_mesh
from bunraku.handles.draped import freed_from_arms

H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}


def dressed_body():
    """A trunk with an arm along x, a sleeve round it that begins at the trunk, and a sheet behind it that hangs from
    the trunk's top; the predictor gives all that lies beyond x = 0.3 to the arm.
    """
    sleeve = trimesh.creation.annulus(0.12, 0.14, 0.6, transform=trimesh.geometry.align_vectors([0, 0, 1], [1, 0, 0]))
    pieces = [
        trimesh.creation.box((0.4, 1, 0.3)),
        trimesh.creation.box((0.8, 0.1, 0.1)).apply_translation([0.6, 0.4, 0]),
        sleeve.apply_translation([0.5, 0.4, 0]),
        trimesh.creation.box((0.8, 1.0, 0.02)).apply_translation([0.2, 0.02, -0.3]),
    ]
    whole = trimesh.util.concatenate([piece.subdivide_to_size(0.06) for piece in pieces])
    mesh = network_mesh(whole.vertices, whole.faces, 3000)
    position = mesh.vertices * mesh.scale + mesh.center
    weights = np.zeros((len(position), HANDLE_COUNT), np.float32)
    arm = position[:, 0] > 0.3
    outer = position[:, 0] > 0.7
    weights[~arm, H["spine3"]] = 1
    weights[arm & ~outer, H["left_shoulder"]] = 1
    weights[outer, H["left_wrist"]] = 1
    return mesh, position, weights


def test_a_cape_is_freed_and_a_sleeve_is_not():
    mesh, position, weights = dressed_body()
    found = freed_from_arms(mesh, weights)
    cape = position[:, 2] < -0.25
    assert (cape & (position[:, 0] > 0.3)).sum() > 20
    np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(found[~cape], weights[~cape])
    np.testing.assert_allclose(found[cape, H["spine3"]], 1, atol=1e-6)


def test_a_part_of_the_arm_stays_with_it():
    mesh, position, weights = dressed_body()
    cape = position[:, 2] < -0.25
    weights[cape] = 0
    weights[cape, H["left_elbow"]] = 1  # a shield: the arm holds its top as well
    np.testing.assert_array_equal(freed_from_arms(mesh, weights), weights)
