"""The simulation: an animation of a character's rig in, the same with its apparel moved by physics out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from bunraku.apparel.physics.bodies import body_limbs
from bunraku.apparel.physics.rig import ApparelRig, PhysicsSettings, apparel_rig, check_engine
from bunraku.apparel.physics.world import World, build_world
from bunraku.core.animation import RigAnimation, bone_order
from bunraku.core.geometry.rotations import matrix_from_quaternion, matrix_y, quaternion_from_matrix, quaternion_slerp
from bunraku.errors import CharacterError, MotionError, OptionError

# Chosen by eye on simulations of Uka, Gene and the wardrobe.
BLEND = 0.6  # share of the warm-up in which the pose changes; in the rest of it apparel settles


def lead_in(animation: RigAnimation, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """World rotations (frames, J, 3, 3) and positions [m] (frames, J, 3) of the bones from the rest pose into the first
    frame of a clip. The rest pose has the position and heading of the first frame, so that apparel is not thrown about.
    """
    rig = animation.character.rig
    assert rig is not None
    first = RigAnimation(animation.character, animation.rotations[:1], animation.translations[:1], animation.fps)
    rotations, positions = (array[0] for array in first.world())
    rest = rig.positions
    mean = rotations.mean(axis=0)
    yaw = np.asarray(matrix_y(np.array(np.arctan2(mean[0, 2] - mean[2, 0], mean[0, 0] + mean[2, 2]))))
    shift = positions.mean(axis=0) - yaw @ rest.mean(axis=0)
    count = len(rest)
    share = np.clip(np.arange(frames) / max(BLEND * frames, 1), 0, 1)
    share = share * share * (3 - 2 * share)
    roots = rig.parents < 0
    local = np.tile(np.eye(3), (count, 1, 1))
    local[roots] = yaw
    away = np.zeros((count, 3))
    away[roots] = rest[roots] @ yaw.T + shift - rest[roots]
    start, end = quaternion_from_matrix(local), quaternion_from_matrix(animation.rotations[0].astype(float))
    blended = quaternion_slerp(start[None], end[None], np.broadcast_to(share[:, None], (frames, count)))
    moved = away + share[:, None, None] * (animation.translations[0] - away)
    return _forward(rig.parents, rest, matrix_from_quaternion(blended), moved)


def _forward(
    parents: np.ndarray, rest: np.ndarray, local: np.ndarray, moved: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    rotations, positions = np.array(local), rest + moved
    for bone in bone_order(parents):
        parent = int(parents[bone])
        if parent >= 0:
            rotations[:, bone] = rotations[:, parent] @ local[:, bone]
            away = rest[bone] - rest[parent] + moved[:, bone]
            positions[:, bone] = positions[:, parent] + np.einsum("nij,nj->ni", rotations[:, parent], away)
    return rotations, positions


@dataclass
class Drive:
    """The motion of driven bones, by frames.

    Between frames positions go along cubic curves (Catmull and Rom's) and so do quaternions, which are normalised: at
    30 frames a second that is a slerp whose speed does not jump. Where a bone jumps, faster than `cut`, nothing lies
    between.
    """

    positions: np.ndarray  # of the bones [m], shape (F, R, 3)
    quaternions: np.ndarray  # wxyz, shape (F, R, 4), without jumps of sign
    jumps: np.ndarray  # whether the way from a frame to the next one is a jump, shape (F - 1,)

    @classmethod
    def of(cls, rotations: np.ndarray, positions: np.ndarray, fps: float, cut: float) -> Drive:
        """From world rotations (F, R, 3, 3) and positions (F, R, 3) of the bones."""
        quaternions = quaternion_from_matrix(np.asarray(rotations, float))[..., [3, 0, 1, 2]]
        signs = np.where((quaternions[1:] * quaternions[:-1]).sum(-1) < 0, -1.0, 1.0)
        quaternions[1:] *= np.cumprod(signs, axis=0)[..., None]
        speed = np.linalg.norm(np.diff(positions, axis=0), axis=-1) * fps
        jumps = (speed > cut).any(axis=1) if speed.size else np.zeros(len(speed), bool)
        return cls(np.asarray(positions, float), quaternions, jumps)

    def between(self, frame: int, parts: int) -> tuple[np.ndarray, np.ndarray]:
        """Positions (parts, R, 3) and quaternions (parts, R, 4) from a frame, which is left out, to the next one."""
        if self.jumps[frame]:
            positions, quaternions = (np.repeat(values[frame + 1][None], parts, 0)
                                      for values in (self.positions, self.quaternions))  # fmt: skip
            return positions, quaternions
        share = (np.arange(1, parts + 1) / parts)[:, None, None]
        positions = self._curve(self.positions, frame, share)
        quaternions = self._curve(self.quaternions, frame, share)
        return positions, quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)

    def _curve(self, values: np.ndarray, frame: int, s: np.ndarray) -> np.ndarray:
        start, end = values[frame], values[frame + 1]
        before, after = self._tangent(values, frame), self._tangent(values, frame + 1)
        s2, s3 = s * s, s * s * s
        return np.asarray(
            (2 * s3 - 3 * s2 + 1) * start + (s3 - 2 * s2 + s) * before + (3 * s2 - 2 * s3) * end + (s3 - s2) * after
        )

    def _tangent(self, values: np.ndarray, frame: int) -> np.ndarray:
        if frame == 0:  # from rest
            return np.zeros_like(values[frame])
        back = not self.jumps[frame - 1]
        on = frame < len(values) - 1 and not self.jumps[frame]
        first, last = frame - 1 if back else frame, frame + 1 if on else frame
        return np.asarray((values[last] - values[first]) / max(last - first, 1))


def joints_moved(parents: np.ndarray, rig: ApparelRig) -> np.ndarray:
    """Joints that dynamic bodies move, and all joints below them, shape (J,), bool."""
    out = np.zeros(len(parents), bool)
    out[[rig.bodies[index].bone for index in rig.dynamic if 0 <= rig.bodies[index].bone < len(out)]] = True
    for bone in bone_order(parents):
        out[bone] |= parents[bone] >= 0 and bool(out[parents[bone]])
    return out


def posed(
    animation: RigAnimation, rig: ApparelRig, bodies: np.ndarray, body_rotations: np.ndarray, positions: np.ndarray
) -> RigAnimation:
    """The animation with the bones of D dynamic bodies at their world rotations from rest (N, D, 3, 3) and centres [m]
    (N, D, 3); bones below follow as they are keyed. A bone takes the rotation of the first of its bodies. It goes where
    a body of mode 1 goes; one of mode 2 is held at its parent.
    """
    skeleton = animation.character.rig
    assert skeleton is not None
    rest, parents = skeleton.positions, skeleton.parents
    rotations, translations = animation.rotations.astype(float), animation.translations.astype(float)
    movers: dict[int, tuple[int, int]] = {}
    for column, index in sorted(enumerate(bodies), key=lambda item: item[1]):
        movers.setdefault(rig.bodies[index].bone, (int(column), int(index)))
    world, heads = np.array(rotations), rest + translations
    for bone in bone_order(parents):
        parent = int(parents[bone])
        above = world[:, parent] if parent >= 0 else np.eye(3)
        offset = rest[bone] - (rest[parent] if parent >= 0 else 0)
        start = heads[:, parent] if parent >= 0 else np.zeros(3)
        if bone in movers:
            column, index = movers[bone]
            body = rig.bodies[index]
            world[:, bone] = body_rotations[:, column]
            rotations[:, bone] = np.swapaxes(above, -1, -2) @ body_rotations[:, column]
            if body.mode == 1:
                heads[:, bone] = positions[:, column] + body_rotations[:, column] @ (rest[bone] - body.position)
                translations[:, bone] = np.einsum("...ji,...j->...i", above, heads[:, bone] - start) - offset
                continue
        else:
            world[:, bone] = above @ rotations[:, bone]
        heads[:, bone] = start + np.einsum("...ij,...j->...i", above, offset + translations[:, bone])
    return replace(animation, rotations=rotations, translations=translations)


def stretched(animation: RigAnimation, rig: ApparelRig, bodies: np.ndarray) -> float:
    """The largest change of the distance of a bone that a body moves from its parent, over that at rest."""
    skeleton = animation.character.rig
    assert skeleton is not None
    bones = np.array(
        sorted({rig.bodies[index].bone for index in bodies if 0 <= rig.bodies[index].bone < len(skeleton.parents)}),
        np.int64,
    )
    bones = bones[skeleton.parents[bones] >= 0]
    above = skeleton.parents[bones]
    rest = np.linalg.norm(skeleton.positions[bones] - skeleton.positions[above], axis=1)
    long = rest > 5e-3  # other bones have no length to keep [m]
    bones, above, rest = bones[long], above[long], rest[long]
    if not len(bones):
        return 0.0
    heads = animation.world()[1]
    length = np.linalg.norm(heads[:, bones] - heads[:, above], axis=-1)
    return float(np.abs(length / rest - 1).max())


MOST_STEPS = 20_000_000  # of time, in all; a bound on what a user may ask for, chosen by eye


@dataclass(frozen=True)
class Recovery:
    """A body that flew away and was put back, by its name, in a frame of the clip, below 0 in the warm-up."""

    body: str
    frame: int


@dataclass(frozen=True)
class SimulationReport:
    """What happened."""

    recoveries: tuple[Recovery, ...]  # bodies that flew away and were put back to rest, with all that hangs on them
    stretch: float  # as of `stretched`
    rest_speed: float  # mean speed of the dynamic bodies in the last frame [m/s]
    seconds: float  # time that the simulation of clip and warm-up took, without building the world [s]
    # frames, steps, bodies: number of frames, of time steps in each, and of dynamic bodies
    frames: int
    steps: int
    bodies: int
    notes: tuple[str, ...]  # what of the physics was left out or repaired

    def problems(self) -> tuple[str, ...]:
        """What a user should know, a sentence each."""
        if not self.recoveries:
            return self.notes
        names = list(dict.fromkeys(recovery.body for recovery in self.recoveries))
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        first = self.recoveries[0]
        return (
            *self.notes,
            f"rigid bodies flew away and were put back {len(self.recoveries)} times, first in frame {first.frame}: "
            f"{', '.join(names[:3])}{more}",
        )


@dataclass(frozen=True, eq=False)
class Simulation:
    """The animation with apparel moved, of the same frames, and what happened."""

    animation: RigAnimation
    report: SimulationReport


def simulate(
    animation: RigAnimation, rig: ApparelRig | None = None, *, warmup: float = 1.0, substeps: int | None = None,
    settings: PhysicsSettings | None = None, progress: Callable[[float], None] | None = None,
) -> Simulation:  # fmt: skip
    """Move the apparel of a character by physics. The same arguments give the same bytes. CharacterError if the file
    says nothing of physics, or its bodies cannot be simulated; OptionError if `warmup` or `substeps` is out of range;
    MotionError if the motion is too long; MissingExtraError if MuJoCo is not installed.

    Args:
        animation: The motion of its rig; what it says of bones that physics move does not count.
        rig: Its bodies and joints; those of its file by default.
        warmup: Time from the rest pose into the first frame, before the clip [s].
        substeps: Time steps a frame; as many as `settings.step` needs by default.
        settings: What no file holds.
        progress: Called with the share done, 0 to 1.
    """
    check_engine("a simulation")
    character = animation.character
    settings = settings or PhysicsSettings()
    if not 0 <= warmup <= 60:
        raise OptionError(f"the warm-up must be from 0 to 60 seconds, not {warmup:g}")
    if substeps is not None and not 1 <= substeps <= 10_000:
        raise OptionError(f"there must be from 1 to 10,000 time steps a frame, not {substeps}")
    rig = apparel_rig(character) if rig is None else rig
    if rig is None or not rig.dynamic:
        raise CharacterError(
            f"{character.name}: nothing of this character is moved by physics; take a PMX, PMD or VRM with rigid "
            "bodies or springs"
        )
    parts = substeps or max(1, int(np.ceil(1 / (animation.fps * settings.step) - 1e-9)))
    lead = round(warmup * animation.fps)
    if (lead + len(animation)) * parts > MOST_STEPS:
        raise MotionError(f"{len(animation):,} frames are too many to simulate at once; cut the motion")
    skeleton = character.rig
    assert skeleton is not None
    reach = float(np.ptp(character.vertices, axis=0).max())
    wanted = bool(rig.unguarded) if settings.limbs is None else settings.limbs
    limbs = body_limbs(character, joints_moved(skeleton.parents, rig)) if wanted else []
    rotations, positions = animation.world()
    if lead:
        before = lead_in(animation, lead)
        rotations, positions = np.concatenate([before[0], rotations]), np.concatenate([before[1], positions])
    names = [body.name for body in rig.bodies]
    with _quiet():
        world = build_world(
            rig, skeleton.positions, skeleton.parents, 1 / (animation.fps * parts), settings, limbs, reach
        )
        drive = Drive.of(rotations[:, world.bones], positions[:, world.bones], animation.fps, settings.cut)
        start = time.perf_counter()
        run = _Run(world, drive, settings)
        moved_rotations, moved_positions = run.through(parts, lead, names, progress)
        seconds = time.perf_counter() - start
    result = posed(animation, rig, world.bodies, moved_rotations[lead:], moved_positions[lead:])
    report = SimulationReport(
        tuple(run.recoveries), stretched(result, rig, world.bodies), run.mean_speed(), seconds, len(rotations), parts,
        len(world.bodies), world.notes
    )  # fmt: skip
    return Simulation(result, report)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the warnings that MuJoCo writes to a file in the current folder; `_Run` checks for their causes."""
    import mujoco

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


class _Run:
    """A world on its way through a motion."""

    def __init__(self, world: World, drive: Drive, settings: PhysicsSettings):
        import mujoco

        self.mj, self.world, self.drive, self.settings = mujoco, world, drive, settings
        self.recoveries: list[Recovery] = []
        self.gone: set[int] = set()  # put back within this frame
        model, data = world.model, world.data
        self.mass = model.body_mass[world.ids][:, None]
        self.moment = model.body_inertia[world.ids].mean(axis=1)[:, None]
        self.tops = model.body_rootid[world.ids]
        index = {int(body): number for number, body in enumerate(world.ids)}
        self.above = np.array([index.get(int(body), -1) for body in world.anchors], np.int64)
        count = len(world.bones)
        self.qpos = world.root_qpos[:, None] + np.arange(7)
        self.qvel = world.root_qvel[:, None] + np.arange(6)
        state = np.concatenate([drive.positions[0], drive.quaternions[0]], axis=1) if count else np.zeros((0, 7))
        data.qpos[self.qpos] = state
        mujoco.mj_forward(model, data)
        self.state = state
        self.speed = np.zeros((count, 6))
        self.hot = np.zeros(model.nv, np.int64)  # for how many steps each has been at the largest speed
        free = np.ones(model.nv, bool)
        free[self.qvel.ravel()] = False
        self.own = np.flatnonzero(free)

    def through(
        self, parts: int, lead: int, names: list[str], progress: Callable[[float], None] | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """World rotations (F, D, 3, 3) and positions (F, D, 3) of the dynamic bodies."""
        world, frames = self.world, len(self.drive.positions)
        model, data = world.model, world.data
        rotations, positions = np.empty((frames, len(world.ids), 3, 3)), np.empty((frames, len(world.ids), 3))
        for frame in range(frames):
            if frame:
                self.frame(frame - 1, parts)
            self.recoveries += [Recovery(names[world.bodies[number]], frame - lead) for number in self.lost()]
            self.mj.mj_kinematics(model, data)
            rotations[frame] = data.xmat[world.ids].reshape(-1, 3, 3)
            positions[frame] = data.xpos[world.ids]
            if progress is not None and frame % 16 == 0:
                progress(frame / frames)
        if progress is not None:
            progress(1.0)
        return rotations, positions

    def frame(self, frame: int, parts: int) -> None:
        """From a frame to the next one."""
        world, mj = self.world, self.mj
        model, data, step = world.model, world.data, world.step
        positions, quaternions = self.drive.between(frame, parts)
        jump = bool(self.drive.jumps[frame])
        states = np.concatenate([positions, quaternions], axis=-1)
        before = np.concatenate([self.state[None], states[:-1]])
        speeds = np.zeros((parts, len(world.bones), 6))
        if not jump:
            speeds[..., :3] = (states[..., :3] - before[..., :3]) / step
            speeds[..., 3:] = _turning(before[..., 3:], states[..., 3:]) / step
        bound = self.settings.most_turn
        for part in range(parts):
            if not jump:
                data.qfrc_applied[self.qvel] = world.weight * (speeds[part] - self.speed) / step
            else:
                data.qfrc_applied[self.qvel] = 0.0
            self.push()
            mj.mj_step(model, data)
            self.state, self.speed = states[part], speeds[part]
            data.qpos[self.qpos], data.qvel[self.qvel] = self.state, self.speed
            if len(self.own) and not np.abs(data.qvel[self.own]).max() < bound:
                self.hold()
            elif self.hot.any():
                self.hot[:] = 0

    def push(self) -> None:
        """Drag of the air, and gravity of bodies that have their own."""
        world, data = self.world, self.world.data
        turning, moving = self.velocity()
        beyond = np.maximum(np.linalg.norm(moving, axis=1, keepdims=True) - self.settings.calm, 0)
        drag = world.drags[0] + self.settings.wind * beyond
        data.xfrc_applied[world.ids, :3] = self.mass * (world.pulls - drag * moving)
        data.xfrc_applied[world.ids, 3:] = -self.moment * world.drags[1] * turning

    def velocity(self) -> tuple[np.ndarray, np.ndarray]:
        """How fast the dynamic bodies turn [rad/s] and move [m/s], shapes (D, 3)."""
        data, ids = self.world.data, self.world.ids
        speed = data.cvel[ids]
        away = data.xipos[ids] - data.subtree_com[self.tops]
        turning = speed[:, :3]
        return turning, speed[:, 3:] + _cross(turning, away)

    def mean_speed(self) -> float:
        """Of the dynamic bodies [m/s]."""
        self.mj.mj_forward(self.world.model, self.world.data)
        return float(np.linalg.norm(self.velocity()[1], axis=1).mean())

    def hold(self) -> None:
        """Hold joints to the largest speed; put back bodies that are too fast for too long, or nowhere."""
        world, data, most = self.world, self.world.data, self.settings.most_turn
        if np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all():
            self.hot = np.where(np.abs(data.qvel) >= most, self.hot + 1, 0)
            np.clip(data.qvel, -most, most, out=data.qvel)
            data.qvel[self.qvel] = self.speed  # driven bones are as fast as they are
            long = self.hot * world.step > self.settings.patience
            lost = {n for n, (_, qvel) in enumerate(world.states) if long[qvel].any()}
            self.rest(lost)
        else:
            broken = [
                not np.isfinite(np.concatenate([data.qpos[qpos], data.qvel[qvel]])).all() for qpos, qvel in world.states
            ]
            lost = set(np.flatnonzero(broken).tolist()) or set(range(len(world.ids)))
            self.mj.mj_resetData(world.model, data)
            data.qpos[self.qpos], data.qvel[self.qvel] = self.state, self.speed
        if lost:
            self.hot[:] = 0
            self.gone |= lost

    def lost(self) -> list[int]:
        """Bodies that were put back since the last frame, or now, as too fast for their anchors."""
        _, moving = self.velocity()
        of_anchor = np.where(self.above[:, None] >= 0, moving[self.above], self.world.data.cvel[self.world.anchors, 3:])
        fast = np.linalg.norm(moving - of_anchor, axis=1) > self.settings.most_speed
        too_fast = set(np.flatnonzero(fast).tolist())
        self.rest(too_fast)
        out, self.gone = sorted(too_fast | self.gone), set()
        return out

    def rest(self, bodies: set[int]) -> None:
        """Put bodies and all that hangs on them to rest."""
        world, data = self.world, self.world.data
        for number in bodies:
            for index in world.below[number]:
                qpos, qvel = world.states[index]
                data.qpos[qpos], data.qvel[qvel] = world.model.qpos0[qpos], 0.0
        if bodies:
            data.qacc_warmstart[:] = 0.0


def _turning(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Rotation vectors from quaternions wxyz (..., 4) to others, in the axes of the first, shape (..., 3)."""
    w = (start * end).sum(-1)
    xyz = start[..., :1] * end[..., 1:] - end[..., :1] * start[..., 1:] - _cross(start[..., 1:], end[..., 1:])
    sign = np.where(w < 0, -1.0, 1.0)
    length = np.linalg.norm(xyz, axis=-1)
    angle = 2 * np.arctan2(length, np.abs(w))
    return np.asarray(xyz * (sign * np.where(length > 1e-12, angle / np.maximum(length, 1e-12), 2.0))[..., None])


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out
