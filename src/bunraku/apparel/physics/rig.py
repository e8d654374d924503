"""What physics move of a character, from an MMD or VRM file, and the settings of the simulation."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from bunraku.apparel.clothed import AIR, GRAVITY
from bunraku.core.avatars import MMD_METRE, MmdBody, MmdJoint, VrmCollider, VrmModel, VrmSpring, mmd_model, vrm_model
from bunraku.core.character import Character
from bunraku.errors import MissingExtraError, OptionError


@dataclass(frozen=True, eq=False)
class ApparelRig:
    """Rigid bodies and the joints between them."""

    bodies: tuple[MmdBody, ...]  # The bodies; `MmdBody.bone` is the index of a rig joint, -1 for none.
    joints: tuple[MmdJoint, ...]  # the joints, by indices of bodies
    notes: tuple[str, ...] = ()  # what of the file was left out or repaired, a sentence each
    # Acceleration of each body in place of the world's gravity [m/s^2], shape (B, 3); None for the world's.
    gravity: np.ndarray | None = None

    @property
    def dynamic(self) -> tuple[int, ...]:
        """Indices of the bodies that physics move."""
        return tuple(index for index, body in enumerate(self.bodies) if body.dynamic)

    @property
    def unguarded(self) -> tuple[int, ...]:
        """Dynamic bodies that may collide but that no body which follows its bone keeps out of the person."""
        still = {(body.group, body.mask) for body in self.bodies if not body.dynamic}

        def kept_out(body: MmdBody) -> bool:
            return any(body.mask >> group & 1 and mask >> body.group & 1 for group, mask in still)

        return tuple(i for i in self.dynamic if self.bodies[i].mask and not kept_out(self.bodies[i]))


def check_engine(purpose: str) -> None:
    """Check that MuJoCo is installed; `purpose` is how the message begins. MissingExtraError if it is not."""
    if find_spec("mujoco") is None:
        raise MissingExtraError("mujoco-core", "physics", purpose)


@dataclass(frozen=True)
class PhysicsSettings:
    """How a character's bodies become a world, and what counts as flying away. OptionError if a value is negative or no
    number, or the time step is not from 0.1 to 20 ms.
    """

    gravity: float = GRAVITY  # Downwards [m/s^2]; MMD's 98 units a second squared by default.
    step: float = 1 / 240  # longest time step [s]
    # the largest rate at which bodies lose speed against the air [1/s]; more in a file is friction in the joints
    air: float = AIR
    # resistance of the air over a body's mass and speed, by the speed beyond `calm` [1/m]: loose hair of MMD stood
    # above the head in a spin of two turns a second without it
    wind: float = 2.0
    calm: float = 2.5  # speed up to which the air resists as `air` says [m/s]; walks and dances are hardly faster
    most_rate: float = 30.0  # the largest rate at which bodies lose speed at all [1/s]
    least_ratio: float = 0.15  # least damping of every joint, as a share of the critical one
    fastest: float = 75.0  # springs swing at most this fast [rad/s]
    loop_time: float = 0.02  # time in which a joint that closes a loop pulls its bodies together [s]
    # Whether the body's mesh is a collider, bone by bone (`body_limbs`), for all apparel; None for apparel that no
    # collider of the file meets.
    limbs: bool | None = None
    nearby: float = 0.12  # apparel collides with those limbs that are nearer than this at rest [m]
    most_speed: float = 30.0  # a body that moves faster against its anchor has flown away [m/s]
    most_turn: float = 100.0  # joints rotate at most this fast [rad/s]
    patience: float = 0.1  # a body that would rotate faster for longer than this has flown away [s]
    cut: float = 25.0  # a bone that is faster than this has jumped, and takes its apparel with it [m/s]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None and not (0 <= value < float("inf")):
                raise OptionError(f"the physics setting '{name}' must be a number of 0 or more, not {value}")
        if not 1e-4 <= self.step <= 0.02:
            raise OptionError(f"the time step of physics must be from 0.0001 to 0.02 s, not {self.step:g}")


VRM_RATE = 60.0  # steps a second for which VRM's specification gives its parameters [1/s]
END = 0.07  # of a chain whose last node swings as well [m], by the specification of VRM 0.x
MOST_PAIRS = 1_000_000  # of a group of springs and a collider; a bound on hostile files, chosen by eye
GROUPS = 15  # of colliders; by the standard of MMD there are 16, the first of which is that of the chains
SHORTEST = 5e-3  # of a joint, an arm or a half extent [m]; by eye: what is shorter swings too fast


def vrm_rig(character: Character, avatar: VrmModel) -> ApparelRig:
    """The bodies and joints of a VRM's springs and colliders, for the character that was read from its file."""
    return _Chains(character).rig(avatar)


class _Chains:
    def __init__(self, character: Character):
        self.world = character.source.tree.world
        self.parents = character.source.tree.parents
        self.joint_of_node = {node: joint for joint, node in enumerate(character.source.skins.nodes)}
        self.bodies: list[MmdBody] = []
        self.joints: list[MmdJoint] = []
        self.gravity: list[np.ndarray] = []
        self.notes: list[str] = []
        self.holders: dict[int, int] = {}
        self.taken: set[int] = set()

    def rig(self, avatar: VrmModel) -> ApparelRig:
        sets = self.kept_out_of(avatar)
        kinds = sorted({chosen for chosen in sets if chosen}, key=sorted)
        users: dict[int, list[int]] = {}
        for index, kind in enumerate(kinds):
            for number in kind:
                users.setdefault(number, []).append(index)
        signatures: dict[tuple[int, ...], int] = {}
        groups: dict[int, int] = {}
        for number, collider in enumerate(avatar.colliders):
            signature = tuple(users.get(number, ()))
            if not signature:
                continue
            if collider.shape == "plane" or collider.inside:
                self.note("planes, and colliders that springs are kept inside of, are not simulated")
                continue
            if signature not in signatures and len(signatures) == GROUPS:
                self.note(
                    "more groups of colliders than there are bits; the last ones keep out what any of them keeps out"
                )
                signature = list(signatures)[-1]
            groups[number] = signatures.setdefault(signature, len(signatures) + 1)
        bits = {chosen: sum({1 << groups[number] for number in chosen if number in groups}) for chosen in set(sets)}
        for number, group in groups.items():
            self.collider(avatar.colliders[number], group)
        for spring, chosen in zip(avatar.springs, sets, strict=True):
            self.spring(spring, bits[chosen])
        return ApparelRig(
            tuple(self.bodies), tuple(self.joints), tuple(self.notes), np.array(self.gravity).reshape(-1, 3)
        )

    def kept_out_of(self, avatar: VrmModel) -> list[frozenset[int]]:
        """The colliders that each spring is kept out of."""
        colliders: dict[tuple[int, ...], frozenset[int]] = {}
        left = MOST_PAIRS
        for spring in avatar.springs:
            if spring.groups not in colliders:
                left -= sum(len(avatar.groups[group]) for group in spring.groups)
                if left < 0:
                    self.note("springs name more colliders than can be worked with; the last springs pass through all")
                    colliders[spring.groups] = frozenset()
                else:
                    colliders[spring.groups] = frozenset(n for group in spring.groups for n in avatar.groups[group])
        return [colliders[spring.groups] for spring in avatar.springs]

    def note(self, sentence: str) -> None:
        if sentence not in self.notes:
            self.notes.append(sentence)

    def joint_of(self, node: int) -> int:
        """The joint of the rig at or above a node, -1 for none."""
        while node >= 0 and node not in self.joint_of_node:
            node = int(self.parents[node])
        return self.joint_of_node.get(node, -1)

    def add(self, body: MmdBody, gravity: np.ndarray | None = None) -> int:
        self.bodies.append(body)
        self.gravity.append(np.zeros(3) if gravity is None else gravity)
        return len(self.bodies) - 1

    def collider(self, collider: VrmCollider, group: int) -> None:
        world = self.world[collider.node]
        scale = float(np.cbrt(abs(np.linalg.det(world[:3, :3]))))
        start = world[:3, :3] @ collider.offset + world[:3, 3]
        end = start if collider.tail is None else world[:3, :3] @ collider.tail + world[:3, 3]
        length = float(np.linalg.norm(end - start))
        size = np.array([collider.radius * scale, length, 0.0])
        shape = "capsule" if length > 1e-6 else "sphere"
        bone, middle = self.joint_of(collider.node), (start + end) / 2
        self.add(still_body(f"collider {len(self.bodies)}", bone, middle, shape, size, _along(end - start), group, 1))

    def spring(self, spring: VrmSpring, mask: int) -> None:
        joints = spring.joints if spring.ends_free else spring.joints[:-1]
        nodes = [joint.node for joint in spring.joints]
        starts = np.array([self.world[node][:3, 3] for node in nodes])
        tails = list(starts[1:])
        if spring.ends_free:
            root = int(self.parents[nodes[0]])
            before = starts[-2] if len(starts) > 1 else self.world[root][:3, 3] if root >= 0 else 0
            direction = starts[-1] - before
            direction = direction if np.linalg.norm(direction) > 1e-6 else np.array([0.0, -1, 0])
            tails.append(starts[-1] + END * direction / np.linalg.norm(direction))
        masses, ends = 0.5 ** np.arange(len(joints)), np.array(tails[: len(joints)])
        above = -1
        for number, joint in enumerate(joints):
            if joint.node in self.taken:
                self.note("nodes are in several springs; the first one counts")
                return
            self.taken.add(joint.node)
            head, tail = starts[number], tails[number]
            length = float(np.linalg.norm(tail - head))
            if length < SHORTEST:
                tail, length = head + [0.0, -SHORTEST, 0.0], SHORTEST
            if above < 0:
                above = self.holder(int(self.parents[joint.node]), head)
            lever = np.maximum(np.linalg.norm(ends[number:] - head, axis=1), SHORTEST)
            inertia = float((masses[number:] * lever**2).sum())
            rate = -VRM_RATE * np.log1p(-min(max(joint.drag, 0.0), 1 - 1e-6))
            lost = float(-np.expm1(-min(rate, 30.0)))
            swings = MmdBody(
                f"{spring.name or 'spring'} {number + 1}", self.joint_of_node.get(joint.node, -1), "sphere",
                np.array([joint.radius, 0.0, 0.0]), tail,
                np.eye(3), float(masses[number]), lost, lost, 0.0, 0.0, 2, 0, mask if joint.radius > 0 else 0,
            )  # fmt: skip
            index = self.add(swings, VRM_RATE * joint.gravity * _unit(joint.gravity_direction))
            back = max(joint.stiffness, 0.0) * VRM_RATE / length * inertia / MMD_METRE**2
            none, free = np.zeros(3), np.ones(3)
            self.joints.append(
                MmdJoint(swings.name, (above, index), head, np.eye(3), none, none, free, -free, none, np.full(3, back))
            )
            above = index

    def holder(self, node: int, position: np.ndarray) -> int:
        """A body without size that follows a bone, for chains to hang on."""
        bone = self.joint_of(node)
        if bone not in self.holders:
            self.holders[bone] = self.add(still_body(f"holder {bone}", bone, position))
        return self.holders[bone]


def still_body(
    name: str, bone: int, position: np.ndarray, shape: str = "sphere", size: np.ndarray | None = None,
    axes: np.ndarray | None = None, group: int = 0, mask: int = 0,
) -> MmdBody:  # fmt: skip
    """A body that follows a bone; by default one without size that meets no other."""
    size, axes = np.zeros(3) if size is None else size, np.eye(3) if axes is None else axes
    return MmdBody(name, bone, shape, size, position, axes, 0.0, 0.0, 0.0, 0.0, 0.0, 0, group, mask)


def _unit(direction: np.ndarray) -> np.ndarray:
    length = float(np.linalg.norm(direction))
    return direction / length if length > 1e-9 else np.array([0.0, -1, 0])


def _along(direction: np.ndarray) -> np.ndarray:
    """Axes whose y is along a direction, columns, shape (3, 3)."""
    from bunraku.core.geometry.rotations import rotation_between

    length = float(np.linalg.norm(direction))
    return np.asarray(rotation_between(np.array([0.0, 1, 0]), direction / length)) if length > 1e-6 else np.eye(3)


def apparel_rig(character: Character) -> ApparelRig | None:
    """What physics move of a character with a rig; None where its file says nothing of physics, or nothing of it can be
    used. FormatError if the nodes of its file are broken.
    """
    if character.rig is None:
        return None
    model = mmd_model(character)
    if model is not None:
        rig = ApparelRig(model.bodies, model.joints)
    else:
        avatar = vrm_model(character)
        if avatar is None:
            return None

        rig = vrm_rig(character, avatar)
    return rig if rig.dynamic else None
