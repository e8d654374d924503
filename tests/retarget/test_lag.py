"""The lag of ears and tails: against the equation of a damped spring, solved by another solver; causal; at any rate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.character import Handles
from bunraku.core.motion import HandleMotion
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.stages.trailing.lag import Lag

H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}
EAR = H["face"]


@pytest.fixture(scope="module")
def eared() -> Anatomy:
    """The reference body, of whose head all over the eyes is an ear."""
    body = reference_body()
    weights = np.array(body.handle_weights)
    top = body.vertices[:, 1] > body.vertices[:, 1].max() - 0.12
    weights[:, H["head"]] += weights[:, EAR]
    weights[:, EAR] = 0
    weights[top] = 0
    weights[top, EAR] = 1
    roles = np.arange(HANDLE_COUNT)
    roles[EAR] = H["head_top"]
    positions = np.array(body.handles.positions)
    positions[EAR] = body.vertices[top].mean(axis=0)
    return Anatomy.of(body.character(), Handles(positions, weights, roles=roles))


def nodding(fps: float, seconds: float = 2.0, still: float = 0.5) -> HandleMotion:
    """A body that stands, and from some time on nods smoothly."""
    times = np.arange(round(seconds * fps) + 1) / fps
    angle = 0.4 * np.sin(2 * np.pi * 1.5 * np.maximum(times - still, 0)) ** 3
    turns = matrix_from_axis_angle(angle[:, None] * np.array([1.0, 0, 0]))
    rotations = np.tile(np.eye(3), (len(times), HANDLE_COUNT, 1, 1))
    for name in ("head", "head_top", "face"):
        rotations[:, H[name]] = turns
    still_root = np.zeros((len(times), 3)), np.tile(np.eye(3), (len(times), 1, 1))
    return HandleMotion(np.zeros((len(times), HANDLE_COUNT, 3)), rotations, *still_root, fps=fps)


def test_a_point_on_a_spring_goes_by_its_equation():
    stage, frequency, fps = Lag(), 9.0, 20.0
    times = np.arange(41) / fps
    goal = np.stack([np.sin(3 * times), times**2, 0 * times], axis=1)

    def between(time: float) -> tuple[np.ndarray, np.ndarray]:
        frame = min(int(time * fps), 39)
        speed = (goal[frame + 1] - goal[frame]) * fps
        return goal[frame] + speed * (time - frame / fps), speed

    def change(time: float, state: np.ndarray) -> np.ndarray:
        where, speed = between(time)
        pull = frequency**2 * (where - state[:3]) + 2 * stage.damping * frequency * (speed - state[3:])
        return np.concatenate([state[3:], pull])

    start = np.concatenate([goal[0], (goal[1] - goal[0]) * fps])
    solved = solve_ivp(change, (0, times[-1]), start, t_eval=times, max_step=0.002, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(stage.followed(goal, frequency, fps), solved.y[:3].T, atol=2e-3)


def test_what_moves_steadily_has_no_lag():
    goal = np.linspace(0, 3, 30)[:, None] * np.array([1.0, 0.5, 0])
    np.testing.assert_allclose(Lag().followed(goal, 7.0, 20.0), goal, atol=1e-12)


def test_nothing_moves_before_what_moves_it(eared):
    stiff = fit_motion(nodding(20.0), eared, replace(Stages(), lag=False, smooth=False))
    lagging = fit_motion(nodding(20.0), eared, replace(Stages(), smooth=False))
    apart = np.abs(stiff.rotations - lagging.rotations).max(axis=(2, 3))
    assert apart[:11, EAR].max() < 1e-6 and apart[12:, EAR].max() > 0.05
    assert np.delete(apart, EAR, axis=1).max() < 1e-6


def test_the_lag_is_the_same_at_any_rate(eared):
    slow, fast = (
        Lag().lagging(fit_motion(nodding(fps), eared, replace(Stages(), lag=False)), eared, [[EAR]]).rotations[:, EAR]
        for fps in (20.0, 60.0)
    )
    away = np.degrees(np.arccos(np.clip((np.einsum("nij,nij->n", slow, fast[::3]) - 1) / 2, -1, 1)))
    assert away.max() < 2


def test_the_root_of_an_ear_stays_where_it_is(eared):
    joint, roots = eared.joints.positions[EAR], []
    for on in (True, False):
        world = fit_motion(nodding(20.0), eared, replace(Stages(), lag=on)).transforms(eared.handles.positions)
        roots.append(world[:, EAR, :, :3] @ joint + world[:, EAR, :, 3])
    np.testing.assert_allclose(*roots, atol=1e-5)


def test_bodies_without_such_parts_are_left_alone():
    body = reference_body()
    anatomy = Anatomy.of(body.character(), body.handles)
    motion = nodding(20.0)
    one, other = (fit_motion(motion, anatomy, replace(Stages(), lag=on)) for on in (True, False))
    np.testing.assert_array_equal(one.rotations, other.rotations)
