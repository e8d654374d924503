"""What trails behind: ears that lag, and tails."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.joints import Joints, attach_joints
from bunraku.core.animation import Animation
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import HandleMotion
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.rig_parts import RigParts
from bunraku.retarget.stages.trailing import Lag, Tail, TailClear
from bunraku_lab.synthetic.samples import make_sample

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


FPS, FRAMES = 20.0, 60
LEVEL = np.tile(np.eye(3), (FRAMES, 1, 1))
TAIL, TIP = HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")


def body(rest: float) -> tuple[Handles, Joints]:
    """A tail of two parts that rests so far above the level behind the body [rad]."""
    positions = np.zeros((30, 3))
    back = np.array([0, np.sin(rest), -np.cos(rest)])
    joints = Joints(positions.copy(), np.zeros(30, int), np.ones(30, bool))
    joints.positions[TIP], positions[TAIL], positions[TIP] = back, 0.5 * back, 1.5 * back
    return Handles(positions, np.full((4, 30), 1 / 30)), joints


def pitch(rotations: np.ndarray, rest: float) -> np.ndarray:
    """How far the tip points up in each frame [rad]."""
    points = rotations[:, TIP] @ np.array([0, np.sin(rest), -np.cos(rest)])
    return np.arctan2(points[:, 1], -points[:, 2])


def lifted(angles: np.ndarray) -> np.ndarray:
    rotations = np.tile(np.eye(3), (FRAMES, 30, 1, 1))
    turns = matrix_from_axis_angle(angles[:, None] * np.array([1.0, 0, 0]))
    rotations[:, TAIL], rotations[:, TIP] = turns, turns
    return rotations


@pytest.mark.parametrize(
    ("rest", "raised", "expected"),
    [
        (0.0, 80, np.degrees(Tail().highest)),  # a rat's, as a horse's is raised in a gallop
        (-np.radians(70), 80, 10),  # the horse's own
        (np.radians(60), 80, 60),  # curled up at rest
        (0.0, 15, 15),
        (0.0, -40, -40),
    ],
)
def test_a_tail_is_held_no_higher_than_it_rests_or_streams(rest, raised, expected):
    handles, joints = body(rest)
    found = Tail().lowered(lifted(np.full(FRAMES, np.radians(raised))), handles, joints, FPS, LEVEL)
    np.testing.assert_allclose(np.degrees(pitch(found, rest)), expected, atol=1e-6)


def test_a_tail_still_wags():
    handles, joints = body(0.0)
    swing = 0.3 * np.sin(2 * np.pi * 2 * np.arange(FRAMES) / FPS)
    found = pitch(Tail().lowered(lifted(np.radians(80) + swing), handles, joints, FPS, LEVEL), 0.0)
    assert found[10:50].mean() == pytest.approx(Tail().highest, abs=0.03)
    assert np.ptp(found[10:50]) == pytest.approx(np.ptp(swing), rel=0.05)


def test_a_tail_is_turned_up_where_it_would_sink():
    dog = RigParts.of(make_sample("dog", rigged=True))
    motion = HandleMotion(
        np.zeros((FRAMES, 30, 3)), np.tile(np.eye(3), (FRAMES, 30, 1, 1)), np.zeros((FRAMES, 3)),
        np.tile(np.eye(3), (FRAMES, 1, 1)), FPS,
    )  # fmt: skip
    floor = float(dog.character.vertices[:, 1].min())
    assert TailClear().changed(motion, dog.anatomy) is motion
    hangs = matrix_from_axis_angle(-1.4 * np.sin(np.linspace(0, np.pi, FRAMES))[:, None] * np.array([1.0, 0, 0]))
    path, rotations = np.zeros((FRAMES, 3)), motion.rotations.copy()
    path[:, 1], rotations[:, [TAIL, TIP]] = -0.55 * dog.character.height, hangs[:, None]
    motion = replace(motion, rotations=rotations, root_translation=path)
    motion = attached(motion, dog)
    raised = TailClear().changed(motion, dog.anatomy)
    held = dog.handles.weights[:, [TAIL, TIP]].sum(axis=1) > 0.9
    low = [
        Animation(dog.character, dog.handles, one).vertices()[:, held, 1].min(axis=1) - floor
        for one in (motion, raised)
    ]
    assert low[0].min() < -0.03 * dog.character.height
    assert low[1].min() > -0.006 * dog.character.height
    np.testing.assert_allclose(raised.rotations[:, :20], motion.rotations[:, :20], atol=1e-6)


def attached(motion: HandleMotion, parts: RigParts) -> HandleMotion:
    rotations, translations = attach_joints(motion.rotations.astype(float), parts.handles.positions, parts.joints)
    return replace(motion, rotations=rotations, translations=translations)
