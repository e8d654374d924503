"""A character's rigid bodies as a world of MuJoCo: which collide, how near bodies may come, and the model itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bunraku.apparel.clothed import LAYER
from bunraku.apparel.physics.bodies import (
    TINY,
    Forest,
    Freedom,
    Link,
    Loop,
    add_rods,
    add_shape,
    apparel_forest,
    free_axes,
    freedoms,
    inertia,
    locked_axes,
    loss_rate,
)
from bunraku.apparel.physics.rig import ApparelRig, PhysicsSettings
from bunraku.core.avatars import MmdBody
from bunraku.errors import CharacterError

MOST_CLASSES = 31  # bits of a mask of collisions, as MuJoCo defines it

Kind = tuple[int, int, bool]


def collision_bits(bodies: Sequence[MmdBody], moving: Sequence[bool]) -> tuple[list[tuple[int, int]], int]:
    """contype and conaffinity of each body, 0 where it collides with none, and how many bodies collide with nothing
    because there are more classes than bits. Two bodies that physics do not move (`moving`) do not collide.
    """
    kinds: list[Kind] = [(body.group, body.mask, bool(moves)) for body, moves in zip(bodies, moving, strict=True)]
    counts: dict[Kind, int] = {}
    for kind in kinds:
        counts[kind] = counts.get(kind, 0) + 1
    useful = [kind for kind in counts if any(_meet(kind, other) for other in counts)]
    useful.sort(key=lambda kind: (-counts[kind], kind))
    chosen = {kind: bit for bit, kind in enumerate(useful[:MOST_CLASSES])}
    bits = {
        kind: (1 << bit, sum(1 << there for other, there in chosen.items() if _meet(kind, other)))
        for kind, bit in chosen.items()
    }
    return [bits.get(kind, (0, 0)) for kind in kinds], sum(counts[kind] for kind in useful[MOST_CLASSES:])


def _meet(a: Kind, b: Kind) -> bool:
    return (a[2] or b[2]) and bool(a[1] >> b[0] & 1) and bool(b[1] >> a[0] & 1)


# Chosen by eye on simulations of Uka, Gene and the wardrobe.
SLACK = 4e-3  # less than `LAYER` of the distance between apparel and a limb at rest is kept by so much [m]
DEEP = 0.8  # a body that is deeper in a limb at rest, as a share of its radius, is not kept out of it


def fit_contacts(spec: Any, model: Any, settings: PhysicsSettings, step: float) -> None:
    """Add the contacts that are exceptions to a world (`MjSpec`) and the model that it compiles to, at rest; shapes
    named "limb ..." are limbs of the body, and "rod ..." those of apparel that collide with them.
    """
    import mujoco

    data = mujoco.MjData(model)
    how = {"solref": [max(0.02, 2.5 * step), 1.0]}
    margins = model.geom_margin.copy()
    model.geom_margin[:] = TINY  # shapes that are nearer at rest may come as near as that, and no nearer
    mujoco.mj_forward(model, data)
    deepest: dict[tuple[str, str], float] = {}
    for contact in data.contact[: data.ncon]:
        first, second = sorted(model.geom(int(geom)).name for geom in contact.geom)
        deepest[first, second] = min(deepest.get((first, second), np.inf), float(contact.dist))
    model.geom_margin[:] = margins
    for (first, second), depth in sorted(deepest.items()):
        rough = max(spec.geom(name).condim for name in (first, second))
        friction = max(spec.geom(name).friction[0] for name in (first, second))
        spec.add_pair(
            geomname1=first, geomname2=second, margin=depth - TINY, condim=rough,
            friction=[friction, friction, 0, 0, 0], **how,
        )  # fmt: skip
    for first, second, distance in _near_limbs(model, data, settings.nearby):
        spec.add_pair(
            geomname1=first, geomname2=second, margin=min(distance, LAYER) - SLACK, condim=1, friction=[0.0] * 5, **how
        )


def _near_limbs(model: Any, data: Any, near: float) -> list[tuple[str, str, float]]:
    """Rods and limbs near each other, and their distance; a rod deep in a limb would be pushed to any side."""
    import mujoco

    names = [model.geom(geom).name for geom in range(model.ngeom)]
    limbs = np.array([geom for geom, name in enumerate(names) if name.startswith("limb")], np.int64)
    out = []
    for rod in (geom for geom, name in enumerate(names) if name.startswith("rod")):
        apart = np.linalg.norm(data.geom_xpos[limbs] - data.geom_xpos[rod], axis=1)
        apart = apart - model.geom_rbound[limbs] - model.geom_rbound[rod]
        for limb in limbs[apart < near]:
            distance = float(mujoco.mj_geomDistance(model, data, rod, int(limb), near, None))
            if -DEEP * model.geom_size[limb, 0] < distance < near:
                out.append((names[rod], names[limb], distance))
    return out


MOST_DYNAMIC = 2000  # a bound on hostile files, chosen by eye
_NO_CONTACT = {"contype": 0, "conaffinity": 0}  # as MuJoCo defines it

# Chosen by eye on simulations of Uka, Gene and the wardrobe.
HEAVY = 1e4  # mass of a driven bone over that of all apparel
LIGHT = 0.05  # mass of a slider over that of the lighter body


@dataclass
class World:
    """What is simulated."""

    # model, data: MuJoCo's
    model: Any
    data: Any
    step: float  # time step [s]
    bones: np.ndarray  # bones that drive it, shape (R,)
    # root_qpos, root_qvel: beginnings of their states, shape (R,)
    root_qpos: np.ndarray
    root_qvel: np.ndarray
    weight: float  # mass of a driven bone [kg], and its moment of inertia [kg m^2]
    bodies: np.ndarray  # indices of the dynamic bodies, in the order of the forest, shape (D,)
    # ids, anchors: muJoCo's body of each, and of its holder, shape (D,)
    ids: np.ndarray
    anchors: np.ndarray
    # rate at which each loses speed against the air [1/s], shape (D, 1), of displacement and of rotation
    drags: tuple[np.ndarray, np.ndarray]
    pulls: np.ndarray  # acceleration of each in place of gravity [m/s^2], shape (D, 3)
    states: list[tuple[np.ndarray, np.ndarray]]  # indices of the qpos and qvel of each
    below: list[list[int]]  # indices in this list of each body and of all that hang on it
    notes: tuple[str, ...]  # what was left out or repaired


def build_world(
    rig: ApparelRig, positions: np.ndarray, parents: np.ndarray, step: float, settings: PhysicsSettings,
    limbs: Sequence[MmdBody] = (), reach: float = np.inf,
) -> World:  # fmt: skip
    """The world of a character at rest, with bones at positions [m] (J, 3) and their parents (J,), and boxes of limbs
    that follow its bones (`body_limbs`). A body that is farther from its joint than `reach` weighs at its joint [m].
    CharacterError if there are too many dynamic bodies, or MuJoCo cannot make a world of them.
    """
    count = len(rig.dynamic)
    if count > MOST_DYNAMIC:
        raise CharacterError(
            f"the file has {count:,} dynamic rigid bodies and at most {MOST_DYNAMIC:,} are simulated; leave some out"
        )
    return _Builder(rig, positions, parents, step, settings, limbs, reach).world()


class _Builder:
    def __init__(
        self, rig: ApparelRig, positions: np.ndarray, parents: np.ndarray, step: float, settings: PhysicsSettings,
        limbs: Sequence[MmdBody], reach: float,
    ):  # fmt: skip
        import mujoco

        self.mj = mujoco
        self.settings, self.step, self.limbs, self.reach = settings, step, limbs, reach
        # A body whose mask is empty is meant to collide with nothing.
        masked = (index for index in rig.dynamic if rig.bodies[index].mask)
        self.kept_out = set(masked if settings.limbs else rig.unguarded)
        self.notes: list[str] = list(rig.notes)
        self.bodies = [self.repaired(body, len(positions)) for body in rig.bodies]
        self.gravity = rig.gravity
        joints = tuple(
            joint
            for joint in rig.joints
            if max(joint.bodies) < len(self.bodies) and min(joint.bodies) >= 0 and joint.bodies[0] != joint.bodies[1]
        )
        if len(joints) < len(rig.joints):
            self.notes.append(
                f"{len(rig.joints) - len(joints)} joints are between bodies that do not exist, and are left out"
            )
        self.positions = positions
        self.forest: Forest = apparel_forest(tuple(self.bodies), joints, parents)
        self.notes += self.forest.notes
        self.spec: Any = mujoco.MjSpec()
        self.nodes: dict[int, Any] = {}  # MuJoCo's bodies by dynamic body
        self.roots: dict[int, Any] = {}  # and by bone
        self.joints: dict[int, list[tuple[Any, Freedom]]] = {}
        self.weight = HEAVY * max(sum(body.mass for body in self.bodies if body.dynamic), 1e-3)

    def repaired(self, body: MmdBody, bones: int) -> MmdBody:
        """The body with what can be repaired; one from code may be as broken as one of a file."""
        numbers = [*body.size, *body.position, *body.rotation.ravel(), body.mass, body.friction]
        if not np.isfinite([*numbers, body.linear_damping, body.angular_damping]).all() or body.size.min() < 0:
            raise CharacterError(
                f"rigid body '{body.name}' has a size, position or mass that is negative or not a number; correct it "
                "or leave it out"
            )
        if not -1 <= body.bone < bones:
            self.notes.append(f"rigid body '{body.name}' is on a bone that does not exist and hangs on none")
            body = replace(body, bone=-1)
        if body.dynamic and body.mass <= 0:
            self.notes.append(f"rigid body '{body.name}' has no mass and follows its bone")
            body = replace(body, mode=0, mass=0.0)
        return body

    def world(self) -> World:
        mj = self.mj
        option = self.spec.option
        option.timestep, option.gravity = self.step, [0.0, -self.settings.gravity, 0.0]
        option.integrator = mj.mjtIntegrator.mjINT_IMPLICITFAST
        option.disableflags = int(mj.mjtDisableBit.mjDSBL_AUTORESET | mj.mjtDisableBit.mjDSBL_FILTERPARENT)
        self.spec.compiler.degree = False
        moving = [body.dynamic or index in self.forest.carried for index, body in enumerate(self.bodies)]
        bits, lost = collision_bits(self.bodies, moving)
        if lost:
            kinds = f"there are more than {MOST_CLASSES} kinds of groups and masks"
            self.notes.append(f"{lost} rigid bodies collide with nothing: {kinds}")
        self.bits = bits
        for index, body in enumerate(self.bodies):
            if not moving[index] and bits[index][1]:
                self.shape(self.root(body.bone), body, index, self.root_position(body.bone))
        for number, limb in enumerate(self.limbs):
            add_rods(self.root(limb.bone), limb, self.root_position(limb.bone), f"limb {number} ", _NO_CONTACT)
        for link in self.forest.links:
            self.hang(link)
        for index, mover in self.forest.carried.items():
            if bits[index][1]:
                self.shape(self.nodes[mover], self.bodies[index], index, self.bodies[mover].position)
        for number, loop in enumerate(self.forest.loops):
            self.close(loop, number)
        try:
            model = self.spec.compile()
            fit_contacts(self.spec, model, self.settings, self.step)
            self.springs(model)
            model = self.spec.compile()
        except (ValueError, mj.FatalError) as error:
            raise CharacterError(f"MuJoCo cannot make a world of these rigid bodies: {error}") from error
        return self.found(model)

    def root_position(self, bone: int) -> np.ndarray:
        return self.positions[bone] if bone >= 0 else np.zeros(3)

    def root(self, bone: int) -> Any:
        """The driven body of a bone."""
        if bone < 0:
            return self.spec.worldbody
        if bone not in self.roots:
            node = self.spec.worldbody.add_body(
                name=f"r{bone}", pos=self.positions[bone], gravcomp=1.0, mass=self.weight, ipos=np.zeros(3),
                inertia=[self.weight] * 3,
            )  # fmt: skip
            node.explicitinertial = True
            node.add_freejoint()
            self.roots[bone] = node
        return self.roots[bone]

    def shape(self, owner: Any, body: MmdBody, index: int, position: np.ndarray) -> None:
        rough = body.dynamic and body.friction > 0.02
        # Bullet multiplies frictions and MuJoCo takes the larger one: bodies of the skeleton have none, and the others
        # half of theirs.
        settings = {
            "contype": self.bits[index][0], "conaffinity": self.bits[index][1], "condim": 3 if rough else 1,
            "friction": [body.friction / 2 if rough else 0.0, 0.0, 0.0],
        }  # fmt: skip
        add_shape(owner, body, position, f"g{index}", settings)

    def hang(self, link: Link) -> None:
        body = self.bodies[link.body]
        above = self.nodes[link.parent] if link.parent >= 0 else self.root(link.bone)
        origin = self.bodies[link.parent].position if link.parent >= 0 else self.root_position(link.bone)
        anchor = self.anchor(link)
        if link.parent >= 0:
            self.spec.add_exclude(bodyname1=f"b{link.parent}", bodyname2=f"b{link.body}")
        weighted = self.gravity is not None
        node = above.add_body(
            name=f"b{link.body}", pos=body.position - origin, mass=body.mass, ipos=np.zeros(3), inertia=inertia(body),
            gravcomp=float(weighted),
        )  # fmt: skip
        node.explicitinertial = True
        if np.linalg.norm(body.position - anchor) > self.reach:
            self.notes.append(
                f"rigid body '{body.name}' is farther from its joint than the character is tall, and weighs at its "
                "joint"
            )
            node.ipos = anchor - body.position
        else:
            quaternion = np.empty(4)
            self.mj.mju_mat2Quat(quaternion, np.ascontiguousarray(body.rotation, float).ravel())
            node.iquat = quaternion
            if self.bits[link.body][1]:
                self.shape(node, body, link.body, body.position)
            if self.limbs and link.body in self.kept_out:
                add_rods(node, body, body.position, f"rod {link.body} ", _NO_CONTACT)
        types = self.mj.mjtJoint
        kinds = {"slide": types.mjJNT_SLIDE, "hinge": types.mjJNT_HINGE, "ball": types.mjJNT_BALL}
        joints = []
        for freedom in freedoms(link):
            joint = node.add_joint(type=kinds[freedom.kind], axis=freedom.axis, pos=anchor - body.position)
            if freedom.limited:
                joint.limited, joint.range = self.mj.mjtLimited.mjLIMITED_TRUE, [freedom.lower, freedom.upper]
                joint.solref_limit = [max(0.02, 2.5 * self.step), 1.0]
            joints.append((joint, freedom))
        self.nodes[link.body], self.joints[link.body] = node, joints

    def anchor(self, link: Link) -> np.ndarray:
        """Position at which a body hangs: its joint, or, where physics only rotate it, its bone."""
        body = self.bodies[link.body]
        if link.joint is not None and (body.mode != 2 or body.bone < 0):
            return link.joint.position
        return self.positions[body.bone] if body.bone >= 0 else body.position

    def close(self, loop: Loop, number: int) -> None:
        """A joint that closes a loop, as a soft constraint, by a slider where its bodies may come apart."""
        joint, mj = loop.joint, self.mj
        first = self.nodes[loop.a] if loop.a >= 0 else self.root(loop.bone_a)
        second = self.nodes[loop.b] if loop.b >= 0 else self.root(loop.bone_b)
        position = self.bodies[loop.a].position if loop.a >= 0 else self.root_position(loop.bone_a)
        free, locked = free_axes(joint.lower, joint.upper), locked_axes(joint)
        at = joint.position - position
        if not locked.all():
            mass = LIGHT * min(self.bodies[end].mass for end in (loop.a, loop.b) if end >= 0)
            first = first.add_body(
                name=f"s{number}", pos=at, gravcomp=1.0, mass=mass, ipos=np.zeros(3), inertia=[mass * 1e-4] * 3
            )
            first.explicitinertial = True
            at = np.zeros(3)
            for axis in np.flatnonzero(~locked):
                slide = first.add_joint(type=mj.mjtJoint.mjJNT_SLIDE, axis=joint.rotation[:, axis])
                if not free[axis]:
                    slide.limited, slide.range = mj.mjtLimited.mjLIMITED_TRUE, [joint.lower[axis], joint.upper[axis]]
        stiff = (joint.angle_upper - joint.angle_lower >= 0) & (joint.angle_upper - joint.angle_lower <= TINY)
        equality = self.spec.add_equality(
            objtype=mj.mjtObj.mjOBJ_BODY, name1=first.name or "world", name2=second.name or "world"
        )
        equality.solref = [max(self.settings.loop_time, 2.5 * self.step), 1.0]
        data = np.zeros(len(equality.data))
        if stiff.all():  # a quaternion of zeros stands for the pose at rest
            equality.type, data[10] = mj.mjtEq.mjEQ_WELD, 1.0
        else:
            equality.type, data[:3] = mj.mjtEq.mjEQ_CONNECT, at
        equality.data = data

    def springs(self, model: Any) -> None:
        """Springs that the time step can follow, and damping; both need the inertia that hangs on each joint."""
        settings = self.settings
        for link in self.forest.links:
            body = self.bodies[link.body]
            lever = max(float(np.linalg.norm(body.position - self.anchor(link))), 0.02)
            for joint, freedom in self.joints[link.body]:
                address = int(model.jnt_dofadr[joint.id])
                mass = float(model.dof_M0[address : address + (3 if freedom.kind == "ball" else 1)].mean())
                stiffness = min(freedom.stiffness, settings.fastest**2 * mass)
                swing = np.sqrt(stiffness / mass + (settings.gravity / lever if freedom.kind != "slide" else 0))
                rate = loss_rate(
                    body.linear_damping if freedom.kind == "slide" else body.angular_damping, settings.most_rate
                )
                rate = max(rate - settings.air, 2 * settings.least_ratio * swing)
                joint.stiffness = [stiffness, 0, 0]
                joint.damping = [rate * mass, 0, 0]

    def found(self, model: Any) -> World:
        mj = self.mj
        data = mj.MjData(model)
        links = self.forest.links
        index = {link.body: number for number, link in enumerate(links)}
        ids = np.array([self.nodes[link.body].id for link in links])
        below: list[list[int]] = [[number] for number in range(len(links))]
        for number in range(len(links) - 1, -1, -1):
            if links[number].parent >= 0:
                below[index[links[number].parent]] += below[number]
        roots = [self.roots[bone].id for bone in self.roots]
        first = model.body_jntadr[roots]
        dof = np.ones(model.nv, bool)
        for start in model.jnt_dofadr[first]:
            dof[start : start + 6] = False
        if dof.any():  # the solver's tolerance counts in this; heavy bones would make it blind
            model.stat.meaninertia = max(float(model.dof_M0[dof].mean()), 1e-9)
        chosen = [self.bodies[link.body] for link in links]
        air = self.settings.air
        linear = np.array([min(loss_rate(body.linear_damping, self.settings.most_rate), air) for body in chosen])
        angular = np.array([min(loss_rate(body.angular_damping, self.settings.most_rate), air) for body in chosen])
        pulls = np.zeros((len(links), 3)) if self.gravity is None else self.gravity[[link.body for link in links]]
        return World(
            model, data, self.step, np.array(list(self.roots), np.int64), np.array(model.jnt_qposadr[first], np.int64),
            np.array(model.jnt_dofadr[first], np.int64), self.weight, np.array([link.body for link in links], np.int64),
            ids,
            np.array(model.body_parentid[ids]), (linear[:, None], angular[:, None]), pulls,
            [self.state(model, int(body)) for body in ids], below, tuple(self.notes),
        )  # fmt: skip

    def state(self, model: Any, body: int) -> tuple[np.ndarray, np.ndarray]:
        """Indices of the state of a body's own joints."""
        ball = self.mj.mjtJoint.mjJNT_BALL
        qpos, qvel = [], []
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            wide = model.jnt_type[joint] == ball
            qpos += list(range(model.jnt_qposadr[joint], model.jnt_qposadr[joint] + (4 if wide else 1)))
            qvel += list(range(model.jnt_dofadr[joint], model.jnt_dofadr[joint] + (3 if wide else 1)))
        return np.array(qpos, np.int64), np.array(qvel, np.int64)
