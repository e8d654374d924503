"""The spring chains of a VRM avatar as rigid bodies and joints.

VRM moves the tail of each joint by Verlet steps of a sixtieth of a second: `x += (1 - drag) dx + stiffness dt * rest +
gravity dt * down`. Seen as differential equations that is an acceleration of 60 times stiffness towards the rest
direction, one of 60 times the gravity power, and a rate of -60 ln(1 - drag) at which speed is lost. Each joint becomes
a body at its tail on a free ball joint at its node, with that rate, that gravity, and a spring that turns the chain
below it back with that acceleration. In VRM the tail of a chain does not pull at its head; masses that halve from joint
to joint come near to that.
"""

from __future__ import annotations

import numpy as np

from bunraku.core.character import Character
from bunraku.core.mmd_model import MMD_METRE, MmdBody, MmdJoint
from bunraku.core.vrm_model import VrmCollider, VrmModel, VrmSpring
from bunraku.physics.apparel_rig import ApparelRig

__all__ = ["VRM_RATE", "vrm_rig"]

VRM_RATE = 60.0
"""Steps a second that VRM's numbers are meant for [1/s]."""
LIGHTER = 0.5  # mass of a joint over that of the one above
END = 0.07  # of a chain whose last node swings as well [m]
MOST_PAIRS = 1_000_000  # of a group of springs and a collider
GROUPS = 15  # of colliders; the first of MMD's 16 groups is that of the chains
SHORTEST = 5e-3  # of a joint [m]
_FREE = (np.ones(3), -np.ones(3))


def vrm_rig(character: Character, avatar: VrmModel) -> ApparelRig:
    """The bodies and joints of a VRM's springs and colliders.

    Args:
        character: The character that was read from the file, with its rig.
        avatar: What the file says of springs.
    """
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
                    "more groups of colliders than can be told apart; the last ones keep out what any of them keeps out"
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
        known: dict[tuple[int, ...], frozenset[int]] = {}
        left = MOST_PAIRS
        for spring in avatar.springs:
            if spring.groups not in known:
                left -= sum(len(avatar.groups[group]) for group in spring.groups)
                if left < 0:
                    self.note("springs name more colliders than can be worked with; the last springs pass through all")
                    known[spring.groups] = frozenset()
                else:
                    known[spring.groups] = frozenset(n for group in spring.groups for n in avatar.groups[group])
        return [known[spring.groups] for spring in avatar.springs]

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
        self.add(
            _still(
                f"collider {len(self.bodies)}",
                self.joint_of(collider.node),
                shape,
                size,
                (start + end) / 2,
                _along(end - start),
                group,
                1,
            )
        )

    def spring(self, spring: VrmSpring, mask: int) -> None:
        joints = spring.joints if spring.ends_free else spring.joints[:-1]
        nodes = [joint.node for joint in spring.joints]
        starts = np.array([self.world[node][:3, 3] for node in nodes])
        tails = list(starts[1:])
        if spring.ends_free:
            direction = starts[-1] - (
                starts[-2]
                if len(starts) > 1
                else self.world[self.parents[nodes[0]]][:3, 3]
                if self.parents[nodes[0]] >= 0
                else 0
            )
            direction = direction if np.linalg.norm(direction) > 1e-6 else np.array([0.0, -1, 0])
            tails.append(starts[-1] + END * direction / np.linalg.norm(direction))
        masses, ends = LIGHTER ** np.arange(len(joints)), np.array(tails[: len(joints)])
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
            none = np.zeros(3)
            self.joints.append(
                MmdJoint(swings.name, (above, index), head, np.eye(3), none, none, *_FREE, none, np.full(3, back))
            )
            above = index

    def holder(self, node: int, position: np.ndarray) -> int:
        """A body without size that follows a bone, for chains to hang on."""
        bone = self.joint_of(node)
        if bone not in self.holders:
            self.holders[bone] = self.add(
                _still(f"holder {bone}", bone, "sphere", np.zeros(3), position, np.eye(3), 0, 0)
            )
        return self.holders[bone]


def _still(
    name: str, bone: int, shape: str, size: np.ndarray, position: np.ndarray, axes: np.ndarray, group: int, mask: int
) -> MmdBody:
    return MmdBody(name, bone, shape, size, position, axes, 0.0, 0.0, 0.0, 0.0, 0.0, 0, group, mask)


def _unit(direction: np.ndarray) -> np.ndarray:
    length = float(np.linalg.norm(direction))
    return direction / length if length > 1e-9 else np.array([0.0, -1, 0])


def _along(direction: np.ndarray) -> np.ndarray:
    """Axes whose y is along a direction, columns, shape (3, 3)."""
    from bunraku.geometry.rotations import rotation_between

    length = float(np.linalg.norm(direction))
    return np.asarray(rotation_between(np.array([0.0, 1, 0]), direction / length)) if length > 1e-6 else np.eye(3)
