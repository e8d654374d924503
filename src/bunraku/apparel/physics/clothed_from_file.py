"""A character with physics in its file as the apparel networks see it: its apparel, its stiffness and its swing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_matrix

from bunraku.apparel.body import UnifiedBody
from bunraku.apparel.clothed import FREE, SWING_NUMBERS, ClothedCharacter, Swing
from bunraku.apparel.mask import apparel_mask
from bunraku.apparel.nodes import apparel_parts, clothed_with_springs
from bunraku.apparel.physics.bodies import (
    SLACK,
    TINY,
    Forest,
    Link,
    apparel_forest,
    freedoms,
    loss_rate,
)
from bunraku.apparel.physics.rig import ApparelRig, PhysicsSettings, apparel_rig
from bunraku.core.avatars import MMD_METRE, MmdBody
from bunraku.core.character import Character
from bunraku.errors import CharacterError


def body_springs(rig: ApparelRig) -> np.ndarray:
    """Spring against swinging of the joint that holds each body, in the file's units, shape (B,)."""
    out = np.zeros(len(rig.bodies))
    for joint in rig.joints:
        for held in joint.bodies:  # the joint that holds a body is the stiffest: ties to neighbours have no springs
            out[held] = max(out[held], float(np.mean(np.abs(joint.angle_spring)[[0, 2]])))
    return out


def bending_limits(rig: ApparelRig, parents: np.ndarray) -> np.ndarray:
    """How far each dynamic body may bend against its holder, by the limits of its joint about the axes across its
    length [rad], shape (B,); pi where it hangs freely, and of bodies that follow their bones. `parents` are those of
    the bones, shape (J,).
    """
    out = np.full(len(rig.bodies), FREE)
    joints = tuple(joint for joint in rig.joints if min(joint.bodies) >= 0 and max(joint.bodies) < len(rig.bodies))
    for link in apparel_forest(rig.bodies, joints, parents).links:
        joint = link.joint
        if joint is None:
            continue
        far = np.maximum(np.abs(joint.angle_lower), np.abs(joint.angle_upper))
        half = np.where(joint.angle_lower > joint.angle_upper, FREE, np.minimum(far, FREE))
        along = rig.bodies[link.body].position - joint.position
        length = float(np.linalg.norm(along))
        across = 1 - np.square(joint.rotation.T @ along / length) if length > 1e-6 else np.ones(3)
        out[link.body] = np.sqrt(float((np.square(half) * across).sum() / across.sum()))
    return out


# The displacement networks were trained with this.
SHORT = 0.01  # levers count as no shorter where something slides [m]


@dataclass(frozen=True, eq=False)
class _Joint:
    """What a dynamic body hangs on."""

    pivot: np.ndarray  # its centre of rotation [m], shape (3,)
    axes: np.ndarray  # of rotation, in the world at rest, rows, shape (A, 3)
    # lower, upper: limits about each [rad], shape (A,)
    lower: np.ndarray
    upper: np.ndarray
    stiffness: np.ndarray  # about each [N m / rad], shape (A,)
    sag: np.ndarray  # how far that gives way to the weight that hangs on it, lying level [rad], shape (A,)
    slides: float  # how far it slides [m]
    frame: np.ndarray  # its own axes, columns, shape (3, 3)

    @property
    def turn(self) -> float:
        """About how far it rotates [rad]."""
        if not len(self.axes):
            return TINY
        return max(float(np.minimum(0.5 * (self.upper - self.lower), self.sag).max()), TINY)


def vertex_swing(character: Character, rig: ApparelRig) -> Swing:
    """What the chains of a rig mean for each vertex; zeros on the body.

    The joints k of a chain, at p_k, are taken to rotate by shares c_k of one rotation w, by how far their limits and
    springs let them; they add up to 1. A point x below the first n of them goes by w x sum_k c_k (x - p_k). Mass,
    springs and friction of the whole are those of its links along such levers.
    """
    skeleton = character.rig
    assert skeleton is not None
    whole = tuple(joint for joint in rig.joints if min(joint.bodies) >= 0 and max(joint.bodies) < len(rig.bodies))
    forest = apparel_forest(rig.bodies, whole, skeleton.parents)
    joints = _joints(rig, forest, skeleton.positions)
    above = {link.body: link.parent for link in forest.links}
    weights, heaviest = {body: max(rig.bodies[body].mass, 1e-4) for body in above}, dict[int, int]()
    for link in reversed(forest.links):  # a link comes after the one that it hangs on
        if link.parent >= 0:
            weights[link.parent] += weights[link.body]
            if weights[link.body] > weights.get(heaviest.get(link.parent, -1), 0.0):
                heaviest[link.parent] = link.body
    count = len(character.vertices)
    out, most, total = np.zeros((count, SWING_NUMBERS)), np.zeros(count), np.zeros(count)
    axes = np.broadcast_to(np.eye(3), (count, 3, 3)).copy()
    whose = np.repeat(np.arange(count), skeleton.indices.shape[1])
    skin = coo_matrix(
        (skeleton.weights.reshape(-1), (whose, skeleton.indices.reshape(-1))), (count, len(skeleton.names))
    ).tocsc()
    skin.sum_duplicates()
    for bone, body in _moved_bones(rig, skeleton.parents).items():
        column = slice(skin.indptr[bone], skin.indptr[bone + 1])
        heavy = skin.data[column] > 1e-4
        rows, held = skin.indices[column][heavy], skin.data[column][heavy]
        if not len(rows) or body not in joints:
            continue
        chain = [body]
        while above[chain[0]] >= 0:
            chain.insert(0, above[chain[0]])
        line = list(chain)
        while heaviest.get(line[-1], -1) >= 0:
            line.append(heaviest[line[-1]])
        own_swing = _swing(rig, chain, line, joints, character.vertices[rows].astype(np.float64))
        out[rows] += held[:, None] * own_swing.rows()
        total[rows] += held
        first = held > most[rows]
        axes[rows[first]], most[rows] = own_swing.axes[first], np.maximum(most[rows], held)
    swing = Swing.of_rows((out / np.maximum(total, 1e-9)[:, None]).astype(np.float32))
    return replace(swing, axes=axes.astype(np.float32), share=total.astype(np.float32))


def _swing(rig: ApparelRig, chain: list[int], line: list[int], joints: dict[int, _Joint], points: np.ndarray) -> Swing:
    """How points (N, 3) of the last body of a chain swing, by it and by `line`, it and what hangs on it in turn."""
    counts = np.array([joints[index].turn for index in line])
    counts /= counts.sum()
    pivots = np.array([joints[index].pivot for index in line])
    bodies = [rig.bodies[index] for index in line]
    masses = np.array([max(body.mass, 1e-4) for body in bodies])
    middles = np.array([body.position for body in bodies])
    # how far each body goes by a turn of the chain, and how much it turns itself
    turned = np.cumsum(counts)
    levers = turned[:, None] * middles - np.cumsum(counts[:, None] * pivots, axis=0)
    inertias = np.array([_own_inertia(body) for body in bodies])
    inertia = max(float(masses @ (np.square(levers).sum(axis=1) + inertias * turned**2)), 1e-9)
    moment = masses @ levers
    arm = moment * inertia / max(float(moment @ moment), 1e-9)
    frame = joints[line[0]].frame
    lower, upper, spring, friction = np.zeros(3), np.zeros(3), np.zeros(3), 0.0
    settings = PhysicsSettings()
    for number, index in enumerate(line):
        joint = joints[index]
        seen = joint.axes @ frame
        ends = np.stack([seen * joint.lower[:, None], seen * joint.upper[:, None]])
        lower, upper = lower + ends.min(axis=0).sum(axis=0), upper + ends.max(axis=0).sum(axis=0)
        spring = spring + counts[number] ** 2 * (np.square(seen) * joint.stiffness[:, None]).sum(axis=0)
        below = masses[number:] @ (np.square(middles[number:] - joint.pivot).sum(axis=1) + inertias[number:])
        rate = loss_rate(bodies[number].angular_damping, settings.most_rate)
        friction += counts[number] ** 2 * float(below) * max(rate - settings.air, 0)
    reached = len(chain)
    lever = turned[reached - 1] * points - counts[:reached] @ pivots[:reached]
    away = points - counts[:reached] @ pivots[:reached] / turned[reached - 1]
    slid = sum(joints[index].slides for index in chain) / np.maximum(np.linalg.norm(lever, axis=1), SHORT)[:, None]
    gravity = 1.0
    if rig.gravity is not None:
        gravity = float(np.linalg.norm(rig.gravity[line], axis=1).mean() / settings.gravity)
    drag = np.mean([min(loss_rate(body.linear_damping, settings.most_rate), settings.air) for body in bodies])
    each = np.ones(len(points))
    return Swing(
        lever, away, np.broadcast_to(arm, lever.shape), np.broadcast_to(frame, (len(points), 3, 3)),
        np.maximum(lower - slid, -FREE), np.minimum(upper + slid, FREE),
        np.broadcast_to(np.minimum(spring / inertia, settings.fastest**2), lever.shape), friction / inertia * each,
        drag * each, gravity * each, each,
    )  # fmt: skip


def _own_inertia(body: MmdBody) -> float:
    """Of a body about its own middle, over its mass [m^2]: that of a box."""
    size = np.abs(np.asarray(body.size, float))
    half = {"sphere": np.full(3, size[0]), "capsule": np.array([size[0], size[0], size[0] + size[1] / 2])}
    small, middle, large = np.sort(half.get(body.shape, size))
    return float((large**2 + 0.5 * (small**2 + middle**2)) / 3)


def _joints(rig: ApparelRig, forest: Forest, positions: np.ndarray) -> dict[int, _Joint]:
    """The joint of each dynamic body, by its number."""
    count = len(rig.bodies)
    pull = np.full(count, PhysicsSettings().gravity)
    if rig.gravity is not None:
        pull = np.linalg.norm(rig.gravity, axis=1)
    weight = np.array([max(body.mass, 1e-4) if body.dynamic else 0.0 for body in rig.bodies]) * pull
    moment = weight[:, None] * np.array([body.position for body in rig.bodies]).reshape(-1, 3)
    for link in reversed(forest.links):
        if link.parent >= 0:
            weight[link.parent] += weight[link.body]
            moment[link.parent] += moment[link.body]
    out = {}
    for link in forest.links:
        pivot = _pivot(rig, link, positions)
        lever = float(np.linalg.norm(moment[link.body] - weight[link.body] * pivot))
        axes, lower, upper, stiffness, sag, slides = [], [], [], [], [], 0.0
        for freedom in freedoms(link):
            if freedom.kind == "slide":
                slides += min(max(abs(freedom.lower), abs(freedom.upper)), SLACK)
                continue
            ball = freedom.kind == "ball" and freedom.limited
            low, high = -freedom.upper if ball else freedom.lower, freedom.upper
            for axis in np.eye(3) if freedom.kind == "ball" else (freedom.axis,):
                axes.append(axis)
                lower.append(max(low, -FREE))
                upper.append(min(high, FREE))
                stiffness.append(freedom.stiffness)
                sag.append(min(lever / freedom.stiffness, FREE) if freedom.stiffness > 0 else FREE)
        frame = np.eye(3) if link.joint is None else np.asarray(link.joint.rotation)
        out[link.body] = _Joint(
            pivot, np.array(axes).reshape(-1, 3), np.array(lower), np.array(upper), np.array(stiffness), np.array(sag),
            slides, frame,
        )  # fmt: skip
    return out


def _pivot(rig: ApparelRig, link: Link, positions: np.ndarray) -> np.ndarray:
    """Centre of rotation of a dynamic body [m], shape (3,)."""
    body = rig.bodies[link.body]
    if body.mode == 2 and body.bone >= 0:  # held at its bone
        return np.asarray(positions[body.bone])
    if link.joint is not None:
        return np.asarray(link.joint.position)
    return np.asarray(positions[body.bone] if body.bone >= 0 else body.position)


def _moved_bones(rig: ApparelRig, parents: np.ndarray) -> dict[int, int]:
    """The dynamic body that takes each bone along, by bone."""
    out: dict[int, int] = {}
    for number, body in enumerate(rig.bodies):
        if body.dynamic and body.bone >= 0:
            out.setdefault(body.bone, number)
    for bone in range(len(parents)):
        path: list[int] = []
        at = bone
        while at >= 0 and at not in out and len(path) <= len(parents):
            path.append(at)
            at = int(parents[at])
        if at in out:
            out |= dict.fromkeys(path, out[at])
    return out


@dataclass(frozen=True, eq=False)
class PartSprings:
    """Means over the bodies that hold the vertices of each of P parts."""

    spring: np.ndarray  # stiffness of a joint against swinging [N m / rad], shape (P,), float32
    mass: np.ndarray  # of a body, as in the file, shape (P,)
    damping: np.ndarray  # share of the velocity that a body loses in a second, shape (P,)
    limit: np.ndarray  # how far a joint may bend [rad], shape (P,)


def part_springs(character: Character, rig: ApparelRig, parts: np.ndarray) -> PartSprings:
    """What the file says of each part, by the part of each vertex (V,); 0 where no bone of it has a body."""
    skeleton = character.rig
    assert skeleton is not None
    count = int(parts.max(initial=-1)) + 1
    values = np.zeros((len(skeleton.names), 5))
    for spring, limit, body in zip(
        body_springs(rig) * MMD_METRE**2, bending_limits(rig, skeleton.parents), rig.bodies, strict=True
    ):
        if body.dynamic and body.bone >= 0:
            values[body.bone] += [spring, body.mass, body.linear_damping, limit, 1.0]
    sums = np.zeros((count, 5))
    cloth = parts >= 0
    for bone, share in zip(skeleton.indices[cloth].T, skeleton.weights[cloth].T, strict=True):
        has_body = values[bone, 4] > 0
        mean = values[bone] / np.maximum(values[bone, 4:], 1.0)
        np.add.at(sums, parts[cloth], mean * (share * has_body)[:, None])
    means = sums[:, :4] / np.maximum(sums[:, 4:], 1e-9)
    means[sums[:, 4] <= 0, 3] = FREE
    return PartSprings(*means.astype(np.float32).T)


def clothed_from_file(character: Character, body: UnifiedBody | None = None, dial: float = 1.0) -> ClothedCharacter:
    """A person with the apparel of its file, and a factor on its stiffness; `body` are its joints, where they are
    known. CharacterError if the rig is not that of a person, or the file says nothing of physics.
    """
    body = body or UnifiedBody.of(character)
    rig, mask = apparel_rig(character), apparel_mask(character)
    if rig is None or mask is None or not mask.any():
        raise CharacterError(
            f"{character.name}: its file has no apparel that physics move; choose another way with --apparel"
        )
    part = apparel_parts(character.vertices, character.faces, mask)
    springs = part_springs(character, rig, part)
    limp = np.zeros(len(springs.spring), np.float32)
    clothed = ClothedCharacter(
        character.vertices, character.faces, body.joints, body.weights, mask, part, limp, springs.damping
    )
    swing = vertex_swing(character, rig)
    return clothed_with_springs(clothed, springs.spring, springs.mass, springs.limit, dial, swing)
