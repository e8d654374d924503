"""Edges that keep their lengths, against scipy's optimiser and against properties."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin_reference
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.retarget.stages.shape import Shape


def _bar(smooth: bool = True) -> tuple[Character, Handles]:
    """A flat bar along x with the root's handle at 0, one at its left and one at its right end."""
    x, y = np.meshgrid(np.linspace(-0.8, 0.8, 17), np.linspace(-0.1, 0.1, 3))
    vertices = np.stack([x.ravel(), y.ravel(), 0.01 * np.cos(7 * x.ravel())], axis=1)
    corner = (np.arange(2)[:, None] * 17 + np.arange(16)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + 18], 1), np.stack([corner, corner + 18, corner + 17], 1)]
    )
    right = np.clip(0.5 + x.ravel() / 0.4, 0, 1) if smooth else (x.ravel() > 0).astype(float)
    weights = np.stack([np.zeros_like(right), 1 - right, right], axis=1)
    positions = np.array([[0, 0, 0], [-0.4, 0, 0], [0.4, 0, 0.0]])
    return Character("bar", vertices, faces), Handles(positions, weights)


def _pose(frames: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """The right half turns about z, and its handle is pulled away."""
    rotations = np.tile(np.eye(3), (frames, 3, 1, 1))
    rotations[:, 2] = matrix_from_axis_angle(np.linspace(0, 1.2, frames)[:, None] * [0, 0, 1.0])
    translations = np.zeros((frames, 3, 3))
    translations[:, 2] = np.linspace(0, 0.02, frames)[:, None] * [1, 1, 0]
    return rotations, translations


def _stretch(character: Character, handles: Handles, rotations: np.ndarray, translations: np.ndarray) -> np.ndarray:
    """Sum of the squared changes of all edges' lengths over the extent, a frame each, through the reference
    skinning.
    """
    frames = len(rotations)
    motion = HandleMotion(translations, rotations, np.zeros((frames, 3)), np.tile(np.eye(3), (frames, 1, 1)), 20.0)
    posed = skin_reference(character.vertices, handles.weights, motion.transforms(handles.positions))
    edges = np.unique(np.sort(character.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)

    def lengths(points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points[..., edges[:, 0], :] - points[..., edges[:, 1], :], axis=-1)

    change = (lengths(posed.astype(float)) - lengths(character.vertices.astype(float))) / np.ptp(
        character.vertices, axis=0
    ).max()
    return np.square(change).sum(-1)


def test_the_mesh_is_stretched_less_and_the_root_stays() -> None:
    character, handles = _bar()
    rotations, translations = _pose()
    moved = Shape().moves(rotations, translations, character, handles, 1.0)
    before, after = (_stretch(character, handles, rotations, some) for some in (translations, translations + moved))
    assert (after[1:] < 0.8 * before[1:]).all()
    assert not moved[:, 0].any()
    assert np.linalg.norm(moved, axis=-1).max() <= Shape().longest * (1 + 1e-6)


def test_it_is_the_least_squares_solution() -> None:
    character, handles = _bar()
    rotations, translations = (values[3:4] for values in _pose())
    moved = Shape(steps=30, longest=1.0, stride=1).moves(rotations, translations, character, handles, 1.0)
    loss = float(_stretch(character, handles, rotations, translations)[0])
    weight = Shape().strength / (loss + Shape().calm)

    def objective(unknown: np.ndarray) -> float:
        delta = np.concatenate([np.zeros(3), unknown]).reshape(1, 3, 3)
        return float(unknown @ unknown + weight * _stretch(character, handles, rotations, translations + delta)[0])

    found = minimize(
        objective, np.zeros(6), method="Nelder-Mead", options={"maxfev": 20_000, "xatol": 1e-7, "fatol": 1e-13}
    ).x
    np.testing.assert_allclose(moved[0, 1:].ravel(), found, atol=2e-4)


def test_what_moves_as_one_is_left_alone() -> None:
    character, handles = _bar()
    turn = np.tile(matrix_from_axis_angle(np.array([0.3, 0.2, 0.9])), (4, 3, 1, 1))
    pivots = handles.positions - np.einsum("kij,kj->ki", turn[0], handles.positions)
    translations = np.tile(-pivots, (4, 1, 1))  # one rigid turn about the origin
    assert np.abs(Shape().moves(turn, translations, character, handles, 1.0)).max() < 1e-5


def test_handles_with_hard_borders_and_one_frame() -> None:
    character, handles = _bar(smooth=False)
    rotations, translations = (values[-1:] for values in _pose())
    moved = Shape().moves(rotations, translations, character, handles, 1.0)
    assert moved.shape == (1, 3, 3) and np.isfinite(moved).all() and moved[0, 1:].any()


def test_one_handle_for_all_has_nothing_to_keep() -> None:
    character, handles = _bar()
    alone = Handles(handles.positions, np.tile([0.0, 1, 0], (len(character.vertices), 1)))
    assert not Shape().moves(*_pose(), character, alone, 1.0).any()
