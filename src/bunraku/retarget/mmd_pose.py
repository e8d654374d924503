"""Poses of MMD models: bones in order of deformation, inherited transforms, inverse kinematics, and their cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bunraku.core.animation import bone_order
from bunraku.core.avatars import MmdIk, MmdIkLink, MmdModel
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.errors import MotionError

MOST = 200_000  # bones placed in one frame; large models with inverse kinematics in their hair need a tenth
MOST_IN_ALL = 1_000_000_000  # bones placed in all frames: minutes


def check_work(model: MmdModel, frames: int) -> None:
    """Raise MotionError if this many frames of a model are too much work."""
    work = pose_work(model)
    if work > MOST or work * frames > MOST_IN_ALL:
        raise MotionError(
            f"{model.name or 'this model'}: its bones and inverse kinematics ask for {work:,} steps in each of "
            f"{frames:,} frames, too many; lower the loops of its inverse kinematics or shorten the motion"
        )


def pose_work(model: MmdModel) -> int:
    """How many bones are placed in a frame: each once, all below one that takes over of others, and chains of inverse
    kinematics in each loop.
    """
    parents = model.parents
    below = np.ones(len(parents), np.int64)  # a bone and those under it
    for index in reversed(bone_order(parents)):
        if parents[index] >= 0:
            below[parents[index]] += below[index]
    work = len(parents)
    for goal, bone in enumerate(model.bones):
        if bone.append is not None:
            work += int(below[goal])
        if bone.ik is None:
            continue
        line = {bone.ik.target: 1}
        at = int(parents[bone.ik.target])
        while at >= 0 and at != goal:
            line[at] = len(line) + 1
            at = int(parents[at])
        chain = [link.bone for link in bone.ik.links if link.bone in line]
        work += bone.ik.loops * sum(line[link] for link in chain) + max((int(below[link]) for link in chain), default=0)
    return work


CHUNK = 256  # frames at once
NEAR = 1e-6  # of a goal [m]: as good as there

Tracks = Mapping[str, tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class MmdPoses:
    """Where the bones of a model are in N frames."""

    model: MmdModel
    rotations: np.ndarray  # world rotation of each bone, the identity at rest, shape (N, B, 3, 3)
    positions: np.ndarray  # world position of each bone [m], shape (N, B, 3)
    fps: float = 30.0

    def __len__(self) -> int:
        return len(self.positions)


def pose_mmd(
    model: MmdModel, tracks: Tracks, ik: Mapping[str, np.ndarray] | None = None, *, frames: int | None = None,
    fps: float = 30.0,
) -> MmdPoses:  # fmt: skip
    """Pose a model.

    Args:
        tracks: By bones' names: how far each is moved from its rest position [m] (N, 3), and how it is turned (N, 3,
            3), in its parent's axes. Bones without a track rest; names that the model lacks are passed over.
        ik: By names of bones with inverse kinematics: whether they are on, shape (N,), bool; on where nothing is said.
        frames: N, where there are no tracks to tell.

    Returns:
        The poses, in float32.

    Raises:
        MotionError: The model asks for too much work; see `mmd_work`.
    """
    count = frames if frames is not None else max((len(positions) for positions, _ in tracks.values()), default=1)
    check_work(model, count)
    bones = len(model.bones)
    rotations, positions = np.empty((count, bones, 3, 3), np.float32), np.empty((count, bones, 3), np.float32)
    numbers = {name: index for index, name in reversed(list(enumerate(model.names)))}
    for start in range(0, count, CHUNK):
        stop = min(start + CHUNK, count)
        state = _State(model, stop - start)
        for name, (moved, turned) in tracks.items():
            if name in numbers:
                state.keyed_moves[:, numbers[name]] = moved[start:stop]
                state.keyed_rotations[:, numbers[name]] = turned[start:stop]
        switches = {name: np.asarray(on)[start:stop] for name, on in (ik or {}).items()}
        state.solve(switches)
        rotations[start:stop], positions[start:stop] = state.rotations, state.positions
    return MmdPoses(model, rotations, positions, fps)


class _State:
    """Some frames of a model on their way to a pose."""

    def __init__(self, model: MmdModel, frames: int):
        count = len(model.bones)
        self.model = model
        self.parents = model.parents
        self.offsets = model.positions - np.where(self.parents[:, None] >= 0, model.positions[self.parents], 0)
        self.children: list[list[int]] = [[] for _ in range(count)]
        for bone, parent in enumerate(self.parents):
            if parent >= 0:
                self.children[parent].append(bone)
        self.keyed_moves = np.zeros((frames, count, 3))
        self.keyed_rotations = np.tile(np.eye(3), (frames, count, 1, 1))
        self.solved: dict[int, np.ndarray] = {}  # what inverse kinematics add to the keys of a link
        self.taken_rotations: dict[int, np.ndarray] = {}
        self.taken_moves: dict[int, np.ndarray] = {}

    def solve(self, switches: Mapping[str, np.ndarray]) -> None:
        """World rotations and positions from the keys."""
        bones = self.model.bones
        self.local, self.moves = self.keyed_rotations.copy(), self.keyed_moves.copy()
        self.rotations, self.positions = np.empty_like(self.local), np.empty_like(self.moves)
        for root in np.flatnonzero(self.parents < 0):
            self._carry(int(root))
        for bone in self.model.order:
            if bones[bone].append is not None:
                self._take_over(bone)
                self._carry(bone)
            ik = bones[bone].ik
            if ik is not None:
                on = switches.get(bones[bone].name)
                chosen = np.arange(len(self.positions)) if on is None else np.flatnonzero(on)
                if len(chosen) and ik.links:
                    self._reach(bone, ik, chosen)

    def _carry(self, bone: int) -> None:
        """World transform of a bone and of all below it from their local ones."""
        stack = [bone]
        while stack:
            at = stack.pop()
            self._place(at)
            stack += self.children[at]

    def _place(self, bone: int, chosen: slice | np.ndarray = slice(None)) -> None:
        parent = self.parents[bone]
        offset = self.offsets[bone] + self.moves[chosen, bone]
        if parent < 0:
            self.rotations[chosen, bone], self.positions[chosen, bone] = self.local[chosen, bone], offset
        else:
            above = self.rotations[chosen, parent]
            self.rotations[chosen, bone] = above @ self.local[chosen, bone]
            self.positions[chosen, bone] = self.positions[chosen, parent] + (above @ offset[..., None])[..., 0]

    def _take_over(self, bone: int) -> None:
        """What a bone takes of another: of its keys and inverse kinematics, or of what that one takes itself."""
        append = self.model.bones[bone].append
        assert append is not None
        source = append.bone
        if append.rotation:
            if append.local:
                turn = self.local[:, source]
            else:
                turn = self.taken_rotations.get(source, self.keyed_rotations[:, source])
                turn = self.solved[source] @ turn if source in self.solved else turn
            if append.ratio != 1:
                turn = matrix_from_axis_angle(append.ratio * axis_angle_from_matrix(turn))
            self.taken_rotations[bone] = turn
        if append.translation:
            move = self.moves[:, source] if append.local else self.taken_moves.get(source, self.keyed_moves[:, source])
            self.taken_moves[bone] = append.ratio * move
        turn = self.keyed_rotations[:, bone]
        turn = self.solved[bone] @ turn if bone in self.solved else turn
        self.local[:, bone] = turn @ self.taken_rotations[bone] if bone in self.taken_rotations else turn
        self.moves[:, bone] = self.keyed_moves[:, bone] + self.taken_moves.get(bone, 0)

    def _reach(self, goal: int, ik: MmdIk, chosen: np.ndarray) -> None:
        """Turn the links so that the target is at the goal, in some of the frames."""
        path = [ik.target]
        while path[-1] >= 0 and path[-1] != goal:
            path.append(int(self.parents[path[-1]]))
        links = [link for link in ik.links if link.bone in path[1:]]
        if not links:
            return
        below = {link.bone: path[: path.index(link.bone) + 1][::-1] for link in links}  # from a link down to the target
        before = {link.bone: self.local[:, link.bone].copy() for link in links}
        planes = {link.bone: axis for link in links if (axis := _hinge(link)) is not None}
        angles = {bone: np.zeros(len(chosen)) for bone in planes}
        where = self.positions[chosen, goal]
        for bone in planes:  # hinges start from rest, whatever their keys say
            self.local[chosen, bone] = np.eye(3)
        self._refresh(below[links[-1].bone], chosen)
        hinged = [link.bone in planes for link in links]
        if hinged == [True, False] and path.index(links[0].bone) < path.index(links[1].bone):
            self._bend(links, planes[links[0].bone], ik.target, where, angles, below, chosen)
            links = links[::-1]  # the hip first: the knee is as it shall be
        for loop in range(ik.loops):
            for link in links:
                self._step(link, planes.get(link.bone), angles, ik, where, loop, chosen)
                self._refresh(below[link.bone], chosen)
            if np.linalg.norm(self.positions[chosen, ik.target] - where, axis=-1).max() < NEAR:
                break
        for bone in before:
            self._keep(bone, before[bone])
        self._carry(max(before, key=path.index))

    def _keep(self, bone: int, before: np.ndarray) -> None:
        """Remember what inverse kinematics did to a link, for bones that take over of it."""
        taken = self.taken_rotations.get(bone)
        keyed = before if taken is None else before @ np.swapaxes(taken, -1, -2)
        now = self.local[:, bone] if taken is None else self.local[:, bone] @ np.swapaxes(taken, -1, -2)
        solved = now @ np.swapaxes(keyed, -1, -2)
        self.solved[bone] = solved @ self.solved[bone] if bone in self.solved else solved

    def _refresh(self, line: list[int], chosen: np.ndarray) -> None:
        for bone in line:
            self._place(bone, chosen)

    def _bend(
        self, links: list[MmdIkLink], axis: int, target: int, where: np.ndarray, angles: dict[int, np.ndarray],
        below: dict[int, list[int]], chosen: np.ndarray,
    ) -> None:  # fmt: skip
        """Turn a knee to the angle at which the target is as far from the hip as the goal is."""
        knee, hip = links[0].bone, links[1].bone
        assert links[0].lower is not None and links[0].upper is not None
        frame = self.rotations[chosen, knee]  # at rest, so its parent's
        thigh = _into(frame, self.positions[chosen, knee] - self.positions[chosen, hip])
        shin = _into(frame, self.positions[chosen, target] - self.positions[chosen, knee])
        y, z = (axis + 1) % 3, (axis + 2) % 3
        along = thigh[:, y] * shin[:, y] + thigh[:, z] * shin[:, z]
        across = thigh[:, z] * shin[:, y] - thigh[:, y] * shin[:, z]
        reach = ((where - self.positions[chosen, hip]) ** 2).sum(-1)
        want = (reach - (thigh**2).sum(-1) - (shin**2).sum(-1)) / 2 - thigh[:, axis] * shin[:, axis]
        spread = np.arccos(np.clip(want / np.maximum(np.hypot(along, across), 1e-12), -1, 1))
        middle = np.arctan2(across, along)
        low, high = float(links[0].lower[axis]), float(links[0].upper[axis])
        options = np.stack([_wrapped(middle + spread), _wrapped(middle - spread)])
        outside = np.maximum(np.maximum(low - options, options - high), 0)
        first = outside[0] <= outside[1]
        angles[knee] = np.clip(np.where(first, options[0], options[1]), low, high)
        self.local[chosen, knee] = _about(axis, angles[knee])
        self._refresh(below[hip], chosen)

    def _step(
        self, link: MmdIkLink, axis: int | None, angles: dict[int, np.ndarray], ik: MmdIk, where: np.ndarray, loop: int,
        chosen: np.ndarray,
    ) -> None:  # fmt: skip
        """One step of the descent: turn a link so that the target comes as near to the goal as it can."""
        bone, frame, position = link.bone, self.rotations[chosen, link.bone], self.positions[chosen, link.bone]
        now, want = _into(frame, self.positions[chosen, ik.target] - position), _into(frame, where - position)
        if axis is not None and link.lower is not None and link.upper is not None:
            y, z = (axis + 1) % 3, (axis + 2) % 3
            across = now[:, y] * want[:, z] - now[:, z] * want[:, y]
            turn = np.arctan2(across, now[:, y] * want[:, y] + now[:, z] * want[:, z])
            turn = np.clip(turn, -ik.limit, ik.limit) if ik.limit > 0 else turn
            low, high = float(link.lower[axis]), float(link.upper[axis])
            if loop == 0:  # a straight hinge may start towards the side to which it cannot bend
                there, back = angles[bone] + turn, angles[bone] - turn
                wrong = ((there < low) | (there > high)) & (back > low) & (back < high)
                turn = np.where(wrong, -turn, turn)
            angles[bone] = np.clip(angles[bone] + turn, low, high)
            self.local[chosen, bone] = _about(axis, angles[bone])
            return
        normal = np.cross(now, want)
        length = np.linalg.norm(normal, axis=-1)
        angle = np.arctan2(length, (now * want).sum(-1))
        angle = np.minimum(angle, ik.limit) if ik.limit > 0 else angle
        turned = matrix_from_axis_angle(normal / np.maximum(length, 1e-12)[:, None] * angle[:, None])
        local = self.local[chosen, bone] @ turned
        self.local[chosen, bone] = (
            local if link.lower is None or link.upper is None else _limited(local, link.lower, link.upper)
        )


def _into(frame: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) in the axes of frames (N, 3, 3)."""
    return np.asarray(np.einsum("nji,nj->ni", frame, vectors))


def _hinge(link: MmdIkLink) -> int | None:
    """The one axis that a link may turn about, or None where there are more."""
    if link.lower is None or link.upper is None:
        return None
    free = np.flatnonzero((np.abs(link.lower) > 1e-6) | (np.abs(link.upper) > 1e-6))
    return int(free[0]) if len(free) == 1 else None


def _about(axis: int, angles: np.ndarray) -> np.ndarray:
    return np.asarray(matrix_from_axis_angle(angles[:, None] * np.eye(3)[axis]))


def _wrapped(angles: np.ndarray) -> np.ndarray:
    """From -pi to pi."""
    return np.asarray(np.mod(angles + np.pi, 2 * np.pi) - np.pi)


def _limited(rotations: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) with their angles about y, x, z clipped."""
    from scipy.spatial.transform import Rotation

    angles = Rotation.from_matrix(rotations).as_euler("YXZ")
    low, high = np.minimum(lower, upper)[[1, 0, 2]], np.maximum(lower, upper)[[1, 0, 2]]
    return np.asarray(Rotation.from_euler("YXZ", np.clip(angles, low, high)).as_matrix())
