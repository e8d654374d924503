"""The extensions of VRM in a glTF document: humanoid bones, spring bones and colliders."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bunraku.core.avatars import VrmCollider, VrmModel, VrmSpring, VrmSpringJoint, warning_sentences
from bunraku.core.body.layout import HANDLE_NAMES, REQUIRED, engine_names
from bunraku.core.character import Rig
from bunraku.files.gltf.document import Document
from bunraku.files.gltf.nodes import NodeTree, read_nodes

MOST = 10_000  # joints of springs, and colliders: no avatar has more
LONGEST = 300  # joints of one spring: what simulates them takes memory by the square of it
_log = logging.getLogger(__name__)


def read_vrm(document: Document) -> VrmModel | None:
    """What a document with VRM's extensions holds, None where it has none. Broken springs and colliders are left out
    with a warning. FormatError if the nodes of the document are broken.
    """
    extensions = document.extensions
    if not {"VRM", "VRMC_vrm"} & extensions.keys():
        return None
    reader = _Reader(document, read_nodes(document))
    avatar = reader.first(extensions["VRM"]) if "VRM" in extensions else reader.second(extensions)
    avatar = replace(avatar, warnings=warning_sentences(reader.notes))
    for warning in avatar.warnings:
        _log.warning("%s: %s", document.path, warning)
    return avatar


class _Reader:
    """Reads the extensions; what makes no sense is noted and left out."""

    def __init__(self, document: Document, tree: NodeTree):
        self.nodes = document.items("nodes")
        self.tree = tree
        self.below: list[list[int]] = [[] for _ in self.nodes]
        for node, parent in enumerate(tree.parents):
            if parent >= 0:
                self.below[int(parent)].append(node)
        self.notes: dict[str, list[str]] = {}
        self.swinging = 0

    def note(self, problem: str, name: object = "") -> None:
        self.notes.setdefault(problem, []).append(str(name))

    def node(self, value: Any) -> int:
        """A node's index, -1 where there is no such node."""
        return value if type(value) is int and 0 <= value < len(self.nodes) else -1

    def called(self, node: int) -> str:
        return str(self.nodes[node].get("name") or f"node {node}")

    def first(self, data: Any) -> VrmModel:
        """VRM 0.x."""
        data = _object(data)
        humanoid: dict[str, int] = {}
        for entry in _objects(_object(data.get("humanoid")).get("humanBones")):
            self.bone(humanoid, entry.get("bone"), entry.get("node"))
        swings = _object(data.get("secondaryAnimation"))
        colliders: list[VrmCollider] = []
        groups: list[tuple[int, ...]] = []
        for group in _objects(swings.get("colliderGroups")):
            start = len(colliders)
            for entry in _objects(group.get("colliders")):
                offset, radius = _point(entry.get("offset")) * [1, 1, -1], _number(entry, "radius", 0.0)
                self.collider(colliders, VrmCollider(self.node(group.get("node")), "sphere", offset, radius))
            groups.append(tuple(range(start, len(colliders))))
        springs: list[VrmSpring] = []
        taken: set[int] = set()
        for group in _objects(swings.get("boneGroups")):
            values = (
                _number(group, "stiffiness", 1.0), _number(group, "gravityPower", 0.0),
                _point(group.get("gravityDir", [0, -1, 0])) * [-1, 1, 1], _number(group, "dragForce", 0.4),
                _number(group, "hitRadius", 0.02),
            )  # fmt: skip
            groups_of_spring = self.group_numbers(group.get("colliderGroups"), len(groups), group.get("comment", ""))
            for root in _list(group.get("bones")):
                if self.node(root) < 0:
                    self.note("springs begin at nodes that do not exist and are left out", root)
                    continue
                for chain in self.chains(root, taken):
                    if len(chain) > LONGEST:
                        self.note(f"springs are longer than {LONGEST} joints and are cut there", self.called(root))
                    joints = tuple(VrmSpringJoint(node, *values) for node in chain[:LONGEST])
                    name, center = str(group.get("comment") or ""), self.node(group.get("center"))
                    self.spring(springs, VrmSpring(name, joints, groups_of_spring, center, True))
        title = str(_object(data.get("meta")).get("title") or "")[:200]
        return VrmModel("0.x", title, humanoid, tuple(springs), tuple(colliders), tuple(groups))

    def second(self, extensions: dict[str, object]) -> VrmModel:
        """VRM 1.0."""
        data, swings = _object(extensions.get("VRMC_vrm")), _object(extensions.get("VRMC_springBone"))
        humanoid: dict[str, int] = {}
        for name, entry in _object(_object(data.get("humanoid")).get("humanBones")).items():
            self.bone(humanoid, name, _object(entry).get("node"))
        colliders: list[VrmCollider] = []
        number: dict[int, int] = {}
        for index, entry in enumerate(_objects(swings.get("colliders"))):
            if self.collider(colliders, self.shape(entry)):
                number[index] = len(colliders) - 1
        groups = []
        for group in _objects(swings.get("colliderGroups")):
            members = [value for value in _list(group.get("colliders")) if type(value) is int]
            groups.append(tuple(number[member] for member in members if member in number))
        springs: list[VrmSpring] = []
        for entry in _objects(swings.get("springs")):
            name = str(entry.get("name") or "")
            if self.swinging >= MOST:
                self.note(f"springs beyond {MOST:,} joints are left out")
                break
            joints = self.joints(_objects(entry.get("joints")), name)
            groups_of_spring = self.group_numbers(entry.get("colliderGroups"), len(groups), name)
            self.spring(springs, VrmSpring(name, joints, groups_of_spring, self.node(entry.get("center", -1))))
        title = str(_object(data.get("meta")).get("name") or "")[:200]
        return VrmModel("1.0", title, humanoid, tuple(springs), tuple(colliders), tuple(groups))

    def bone(self, humanoid: dict[str, int], name: Any, node: Any) -> None:
        if self.node(node) < 0 or not isinstance(name, str):
            self.note("bones of the person are nodes that do not exist and are left out", name)
        else:
            humanoid.setdefault(name[:40], node)

    def shape(self, entry: dict[str, object]) -> VrmCollider:
        node, shape = self.node(entry.get("node")), _object(entry.get("shape"))
        extended = _object(_object(entry.get("extensions")).get("VRMC_springBone_extended_collider")).get("shape")
        shape = _object(extended) or shape
        if "plane" in shape:
            plane = _object(shape["plane"])
            return VrmCollider(node, "plane", _point(plane.get("offset")), 0.0, _point(plane.get("normal", [0, 0, 1])))
        kind = "capsule" if "capsule" in shape else "sphere"
        body = _object(shape.get(kind))
        tail, radius = _point(body.get("tail")) if kind == "capsule" else None, _number(body, "radius", 0.0)
        return VrmCollider(node, kind, _point(body.get("offset")), radius, tail, body.get("inside") is True)

    def collider(self, colliders: list[VrmCollider], new: VrmCollider) -> bool:
        """Keep a collider that can be used."""
        numbers = [new.radius, *new.offset, *([] if new.tail is None else new.tail)]
        if new.node < 0:
            self.note("colliders are on nodes that do not exist and are left out")
        elif not all(map(math.isfinite, numbers)) or new.radius < 0:
            self.note("colliders have a size that is negative or not a number and are left out", self.called(new.node))
        elif len(colliders) >= MOST:
            self.note(f"more than {MOST:,} colliders are left out")
        else:
            colliders.append(new)
            return True
        return False

    def spring(self, springs: list[VrmSpring], new: VrmSpring) -> None:
        """Keep a spring that can be used."""
        name = new.name or (self.called(new.joints[0].node) if new.joints else "")
        numbers = [
            [joint.stiffness, joint.gravity, joint.drag, joint.radius, *joint.gravity_direction] for joint in new.joints
        ]
        if not new.joints or (len(new.joints) < 2 and not new.ends_free):
            self.note("springs have no chain of nodes and are left out", name)
        elif not np.isfinite(numbers).all() or min(joint.radius for joint in new.joints) < 0:
            self.note("springs hold values that are negative or no numbers and are left out", name)
        elif self.swinging + len(new.joints) > MOST:
            self.note(f"springs beyond {MOST:,} joints are left out")
        else:
            self.swinging += len(new.joints)
            springs.append(new)

    def joints(self, entries: list[dict[str, object]], name: str) -> tuple[VrmSpringJoint, ...]:
        """The joints of a spring of VRM 1.0, up to one that is not below the one before."""
        out: list[VrmSpringJoint] = []
        if len(entries) > LONGEST:
            self.note(f"springs are longer than {LONGEST} joints and are cut there", name)
        for entry in entries[:LONGEST]:
            node = self.node(entry.get("node"))
            if node < 0 or (out and not self.is_below(node, out[-1].node)):
                self.note("springs go on at nodes that are not below and are cut there", name or entry.get("node"))
                break
            stiffness, gravity = _number(entry, "stiffness", 1.0), _number(entry, "gravityPower", 0.0)
            drag, radius = _number(entry, "dragForce", 0.5), _number(entry, "hitRadius", 0.0)
            direction = _point(entry.get("gravityDir", [0, -1, 0]))
            out.append(VrmSpringJoint(node, stiffness, gravity, direction, drag, radius))
        return tuple(out)

    def is_below(self, node: int, other: int) -> bool:
        """Whether a node is below another, by at most `LONGEST` nodes."""
        for _ in range(LONGEST):
            node = int(self.tree.parents[node])
            if node < 0 or node == other:
                break
        return node == other

    def chains(self, root: int, taken: set[int]) -> list[list[int]]:
        """All nodes at and below one as chains, with a chain of its own for each branch; a node swings only once."""
        out: list[list[int]] = []
        starts = [root]
        while starts:
            node = starts.pop()
            chain = []
            while node >= 0 and node not in taken:
                taken.add(node)
                chain.append(node)
                starts += self.below[node][:0:-1]
                node = self.below[node][0] if self.below[node] else -1
            if chain:
                out.append(chain)
        return out

    def group_numbers(self, values: Any, count: int, name: Any) -> tuple[int, ...]:
        numbers = _list(values)
        good = tuple(value for value in numbers if type(value) is int and 0 <= value < count)
        if len(good) < len(numbers):
            self.note("springs name groups of colliders that do not exist", name)
        return good


def _object(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _objects(value: Any) -> list[dict[str, Any]]:
    return [item for item in _list(value) if isinstance(item, dict)]


def _number(owner: dict[str, object], key: str, default: float) -> float:
    """A number, NaN if it is not one."""
    value = owner.get(key, default)
    try:
        return float(value) if isinstance(value, int | float) and type(value) is not bool else math.nan
    except OverflowError:
        return math.nan


def _point(value: Any) -> np.ndarray:
    """Three numbers from a list or from x, y, z, 0 by default; NaN if they are not numbers."""
    if isinstance(value, list) and len(value) == 3:
        value = dict(zip("xyz", value, strict=True))
    elif value is None:
        value = {}
    return np.array([_number(value, axis, 0.0) for axis in "xyz"]) if isinstance(value, dict) else np.full(3, np.nan)


_NAMES = dict(zip(HANDLE_NAMES, engine_names("vrm"), strict=True))
_BONES = frozenset(name for handle, name in _NAMES.items() if name != handle or handle in ("neck", "head"))
"""The bones of a humanoid among the joints that the 30 handles become; tail, wings and face are not among them."""
_NEEDED = frozenset(_NAMES[handle] for handle in REQUIRED)
_ARMS = (("leftUpperArm", "leftHand", 1.0), ("rightUpperArm", "rightHand", -1.0))
_ALONG = 0.9  # least cosine between an arm and the x axis in a T-pose
_META = {
    "version": "1", "authors": ["unknown"], "licenseUrl": "https://vrm.dev/licenses/1.0/",
    "avatarPermission": "onlyAuthor", "commercialUsage": "personalNonProfit", "creditNotation": "required",
    "modification": "prohibited",
}  # fmt: skip
"""The rights that the format asks for, of which nothing is known here: the strictest of each."""


def add_humanoid(tree: dict[str, Any], rig: Rig, nodes: Sequence[int], title: str) -> None:
    """Make a document that of a VRM 1.0 humanoid of a title where a rig, with these nodes for its bones, has the names
    of one and rests in a T-pose; what the document has of the extension stays.
    """
    place = {name: number for number, name in enumerate(rig.names)}
    extensions = tree.setdefault("extensions", {})
    if not place.keys() >= _NEEDED or {"VRM", "VRMC_vrm"} & set(extensions):
        if not extensions:
            del tree["extensions"]
        return
    for upper, hand, side in _ARMS:
        arm = rig.positions[place[hand]] - rig.positions[place[upper]]
        if side * arm[0] < _ALONG * float((arm**2).sum()) ** 0.5:
            return
    bones = {name: {"node": nodes[number]} for name, number in place.items() if name in _BONES}
    extensions["VRMC_vrm"] = {"specVersion": "1.0", "meta": {"name": title, **_META}, "humanoid": {"humanBones": bones}}


SPRINGS = "VRMC_springBone"


def add_springs(tree: dict[str, Any], avatar: VrmModel, nodes: Sequence[int]) -> None:
    """Add an avatar's springs and colliders as `VRMC_springBone`, with the node of each bone."""
    if avatar.springs:
        tree.setdefault("extensions", {})[SPRINGS] = {"specVersion": "1.0", **_springs(avatar, nodes)}


def add_spring_extras(tree: dict[str, Any], avatar: VrmModel, nodes: Sequence[int]) -> None:
    """Add an avatar's springs to the document's extras, as `springs`, in the form of `VRMC_springBone`."""
    if avatar.springs:
        extras = tree.get("extras")
        tree["extras"] = {**(extras if isinstance(extras, dict) else {}), "springs": _springs(avatar, nodes)}


def _springs(avatar: VrmModel, nodes: Sequence[int]) -> dict[str, Any]:
    colliders = []
    for collider in avatar.colliders:
        body: dict[str, Any] = {"offset": _numbers(collider.offset), "radius": round(collider.radius, 6)}
        if collider.tail is not None:
            body["tail"] = _numbers(collider.tail)
        colliders.append({"node": nodes[collider.node], "shape": {collider.shape: body}})
    springs = []
    for spring in avatar.springs:
        joints = [
            {"node": nodes[joint.node], "hitRadius": round(joint.radius, 6), "stiffness": round(joint.stiffness, 6),
             "gravityPower": round(joint.gravity, 6), "gravityDir": _numbers(joint.gravity_direction),
             "dragForce": round(joint.drag, 6)}
            for joint in spring.joints
        ]  # fmt: skip
        entry: dict[str, Any] = {"name": spring.name, "joints": joints}
        if spring.groups:
            entry["colliderGroups"] = list(spring.groups)
        springs.append(entry)
    out: dict[str, Any] = {"springs": springs}
    if colliders:
        out["colliders"] = colliders
        out["colliderGroups"] = [{"name": "body", "colliders": list(group)} for group in avatar.groups]
    return out


def _numbers(values: np.ndarray) -> list[float]:
    return [round(float(value), 6) for value in values]
