"""A human skeleton placed inside any mesh, after Pinocchio (Baran & Popovic 2007), to compare handles with.

Joints go to centres of spheres packed inside the mesh. The best placement of the whole tree is found exactly by dynamic
programming over the skeleton's tree: each bone has a cost of length, direction and leaving the mesh, each joint one of
standing off the middle of the volume or on the wrong side of the body. Then each joint is moved a little to where its
bones cost least.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bunraku.body.layout import JOINT_NAMES, JOINT_PARENTS
from bunraku.body.reference import reference_body
from bunraku_lab.baselines.volume import Volume, volume_of

__all__ = ["EmbeddedSkeleton", "Template", "embed_skeleton", "embedded_human", "human_template", "sphere_centres"]

_LENGTH, _DIRECTION, _OUTSIDE, _DEPTH, _SIDE = 1.0, 0.5, 6.0, 0.4, 1.0
_ENDS = {"head": "top", "left_wrist": "tip", "right_wrist": "tip", "left_foot": "tip", "right_foot": "tip"}


@dataclass(frozen=True, eq=False)
class Template:
    """A skeleton to embed, in units of its height, standing on y = 0 and facing +Z.

    Args:
        points: Joints and the ends of the limbs, parents before children, shape (P, 3).
        parents: Shape (P,), -1 for the root.
        sides: +1 left, -1 right, 0 in the middle, shape (P,).
        joints: How many of the points, the first ones, are joints.
        lean: Share of the height by which a middle point may be off the middle, or a limb's over it, at a cost of 1.
    """

    points: np.ndarray
    parents: np.ndarray
    sides: np.ndarray
    joints: int
    lean: float = 0.1


@dataclass(frozen=True, eq=False)
class EmbeddedSkeleton:
    """A template inside a mesh.

    Args:
        points: Where the template's points are, shape (P, 3).
        parents: Shape (P,).
        joints: How many of the points are joints; the others are ends of limbs.
        cost: What the placement costs.
    """

    points: np.ndarray
    parents: np.ndarray
    joints: int
    cost: float

    def bones(self) -> list[tuple[int, int]]:
        """Each bone as (joint that moves it, point at its other end)."""
        return [(int(parent), point) for point, parent in enumerate(self.parents) if parent >= 0]


@lru_cache(maxsize=1)
def human_template() -> Template:
    """The reference body's 22 joints, and the top of its head, its finger tips and its toes."""
    body = reference_body()
    height = float(np.ptp(body.vertices[:, 1]))
    points, parents = list(body.joints), list(JOINT_PARENTS)
    for name in _ENDS:
        joint = JOINT_NAMES.index(name)
        own = body.vertices[body.joint_weights[:, joint] > 0.5]
        axis = body.joints[joint] - body.joints[JOINT_PARENTS[joint]]
        axis = (
            np.array([0, 1.0, 0])
            if name == "head"
            else np.array([0, 0, 1.0])
            if name.endswith("foot")
            else axis / np.linalg.norm(axis)
        )
        reach = float(((own - body.joints[joint]) @ axis).max())
        points.append(body.joints[joint] + 0.9 * reach * axis)
        parents.append(joint)
    names = [*JOINT_NAMES, *_ENDS]
    sides = np.array([1 if name.startswith("left") else -1 if name.startswith("right") else 0 for name in names])
    floor = body.vertices[:, 1].min()
    return Template((np.array(points) - [0, floor, 0]) / height, np.array(parents), sides, len(JOINT_NAMES))


def sphere_centres(volume: Volume, most: int = 350) -> tuple[np.ndarray, np.ndarray]:
    """Centres of spheres that fill a volume, the largest first, none of whose centres is inside a larger one.

    Args:
        volume: The inside of the mesh.
        most: Most spheres.

    Returns:
        Centres (S, 3) and radii (S,). Sheets without an inside get the grid points that are nearest to them.
    """
    depth = volume.depth
    inside = depth > 0
    if inside.sum() < 8:
        inside = depth > np.partition(depth.ravel(), -200)[-min(200, depth.size)]
    # On the medial surface the depth does not grow at full slope in any direction.
    slope = np.linalg.norm(np.stack(np.gradient(depth, volume.step)), axis=0)
    medial = inside & ((slope < 0.8) | (depth < 1.5 * volume.step))
    chosen = medial if medial.sum() >= 8 else inside
    points, radii = volume.points()[chosen], np.maximum(depth[chosen], 0.5 * volume.step)
    order = np.argsort(-radii, kind="stable")
    points, radii = points[order], radii[order]
    free = np.ones(len(points), bool)
    centres = []
    for number in range(len(points)):
        if not free[number]:
            continue
        centres.append(number)
        if len(centres) == most:
            break
        free &= np.square(points - points[number]).sum(axis=1) > radii[number] ** 2
    return points[centres], radii[centres]


def _joint_costs(template: Template, points: np.ndarray, radii: np.ndarray, middle: float, size: float) -> np.ndarray:
    """Cost of each candidate for each point of the template, shape (P, S)."""
    off = (points[:, 0] - middle) / size
    shallow = 1 / (1 + radii / (0.03 * size))
    out = np.empty((len(template.points), len(points)))
    for point, side in enumerate(template.sides):
        away = np.abs(off) if side == 0 else np.maximum(-side * off, 0)
        out[point] = _SIDE * (away / template.lean) ** 2 + _DEPTH * shallow
    return out


def _bone_costs(start: np.ndarray, end: np.ndarray, wanted: np.ndarray, size: float) -> np.ndarray:
    """Cost of the length and the direction of bones from starts to ends, shapes [..., 3] x 2 -> [...].

    Args:
        wanted: The template's bone, at the size of the mesh, shape (3,).
    """
    bone = end - start
    length = np.sqrt(np.square(bone).sum(-1) + 1e-12)
    want = float(np.linalg.norm(wanted))
    stretch = np.log((length + 0.03 * size) / (want + 0.03 * size)) ** 2
    turn = 1 - (bone @ (wanted / want)) / length
    share = want / size + 0.05  # long bones count for more
    return np.asarray(_LENGTH * stretch + _DIRECTION * turn * (1 + turn) * share / 0.1)


def _outside_costs(start: np.ndarray, end: np.ndarray, volume: Volume, size: float) -> np.ndarray:
    """Cost of bones that leave the mesh, shapes [..., 3] x 2 -> [...]."""
    return np.asarray(_OUTSIDE * np.maximum(-volume.shallowest(start, end) - 0.5 * volume.step, 0) / size / 0.02)


def embed_skeleton(template: Template, volume: Volume, low: np.ndarray, high: np.ndarray) -> EmbeddedSkeleton:
    """Place a template inside a volume at the least cost.

    Args:
        template: The skeleton.
        volume: The inside of the mesh.
        low, high: Corners of the mesh's bounding box, shape (3,).
    """
    size = float(high[1] - low[1]) or float((high - low).max())
    points, radii = sphere_centres(volume)
    costs = _joint_costs(template, points, radii, float(low[0] + high[0]) / 2, size)
    count = len(template.points)
    outside = _outside_costs(points[:, None], points[None], volume, size)
    best = np.zeros((count, len(points)), np.int64)  # where each point goes, for each place of its parent
    for point in range(count - 1, 0, -1):
        parent = int(template.parents[point])
        bones = _bone_costs(
            points[:, None], points[None], (template.points[point] - template.points[parent]) * size, size
        )
        total = bones + outside + costs[point]
        best[point] = total.argmin(axis=1)
        costs[parent] += total.min(axis=1)
    index = np.zeros(count, np.int64)
    index[0] = costs[0].argmin()
    for point in range(1, count):
        index[point] = best[point, index[template.parents[point]]]
    found = _refined(template, points[index], volume, low, high, size)
    return EmbeddedSkeleton(found, template.parents, template.joints, float(costs[0].min()))


def _refined(
    template: Template,
    points: np.ndarray,
    volume: Volume,
    low: np.ndarray,
    high: np.ndarray,
    size: float,
    rounds: int = 6,
) -> np.ndarray:
    """Joints moved by shrinking steps wherever that lowers the cost of what they touch."""
    points = points.copy()
    middle = float(low[0] + high[0]) / 2
    children = [np.flatnonzero(template.parents == point) for point in range(len(points))]
    offsets = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    for turn in range(rounds):
        step = 1.5 * volume.step * 0.7**turn
        for point, parent in enumerate(template.parents):
            tried = points[point] + step * offsets
            unary = template.__class__(
                template.points[[point]], template.parents[[point]], template.sides[[point]], 1, template.lean
            )
            cost = _joint_costs(unary, tried, np.maximum(volume.at(tried), 0), middle, size)[0]
            if parent >= 0:
                cost += _bone_costs(
                    points[parent], tried, (template.points[point] - template.points[parent]) * size, size
                )
                cost += _outside_costs(points[parent], tried, volume, size)
            for child in children[point]:
                cost += _bone_costs(
                    tried, points[child], (template.points[child] - template.points[point]) * size, size
                )
                cost += _outside_costs(tried, points[child], volume, size)
            points[point] = tried[cost.argmin()]
    return points


def embedded_human(vertices: np.ndarray, faces: np.ndarray) -> tuple[EmbeddedSkeleton, Volume]:
    """The human skeleton inside a mesh that stands up and faces +Z, and the volume it was found in.

    Args:
        vertices: Positions, shape (V, 3).
        faces: Vertex indices, shape (F, 3).
    """
    volume = volume_of(vertices, faces)
    return embed_skeleton(human_template(), volume, vertices.min(axis=0), vertices.max(axis=0)), volume
