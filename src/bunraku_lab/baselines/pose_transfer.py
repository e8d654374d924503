"""Skeleton-free Pose Transfer (Liao et al., ECCV 2022) on meshes of network size: parts of a mesh, how those of a posed
source move, and what the trained networks make of it for a target.

All lengths are over the mesh's height, and poses are in the frame of the root, which neither turns nor travels: how it
does is the motion's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch

from bunraku.body.layout import HANDLE_MIRROR, JOINT_COUNT, JOINT_PARENTS
from bunraku.body.reference import reference_body
from bunraku.core.skinning import skin
from bunraku.geometry.registration import register
from bunraku.geometry.rotations import quaternion_from_matrix
from bunraku.geometry.simplify import NetworkMesh, network_mesh
from bunraku.geometry.surface import vertex_normals
from bunraku.handles.inference.graph import mesh_graph
from bunraku.handles.inference.predictor import HandlePredictor, load_predictor
from bunraku.nn.checkpoints import shipped_checkpoint
from bunraku_lab.baselines.skeletal_retarget import bone_turns
from bunraku_lab.nn.baselines.part_graph import PartGraph, part_graph
from bunraku_lab.nn.baselines.pose_transfer import TransferNetwork, affine_of, part_centres

__all__ = [
    "ROOM", "PartMesh", "SourceBody", "SourcePoses", "graph_of", "in_metres", "in_root_frame", "over_height",
    "part_transforms", "predicted_parts", "source_body", "source_poses", "source_turns", "transferred",
]  # fmt: skip

ROOM = 1.7
"""Vertices that a network mesh has room for, over those that it comes to."""
LEAST = 3
"""Vertices that a part has at the least for it to turn."""
CHUNK = 16


@dataclass(frozen=True, eq=False)
class PartMesh:
    """A mesh of network size and its parts.

    Args:
        rest: Vertices over the height, feet at 0, shape (M, 3), float32.
        faces: Shape (F, 3).
        edges: Of the faces, and those that join loose parts, shape (E, 2).
        weights: Of K parts, shape (M, K), rows sum to 1; of none where they are predicted.
    """

    rest: np.ndarray
    faces: np.ndarray
    edges: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True, eq=False)
class SourceBody:
    """The reference body as a source.

    Args:
        mesh: Its mesh, with the canonical handles as parts.
        skinning: Weights of the joints, shape (M, 22).
        joints: Over its height, shape (22, 3).
        height: [m].
        network: The way from its own vertices.
    """

    mesh: PartMesh
    skinning: np.ndarray
    joints: np.ndarray
    height: float
    network: NetworkMesh

    def posed(self, turns: np.ndarray) -> np.ndarray:
        """Its vertices with joints turned, the pelvis where it is at rest, shape (P, M, 3).

        Args:
            turns: Of the joints in the frame of the root, off the T-pose, shape (P, 22, 3, 3).
        """
        places = np.zeros((len(turns), JOINT_COUNT, 3), np.float32)
        places[:, 0] = self.joints[0]
        for joint in range(1, JOINT_COUNT):
            parent = JOINT_PARENTS[joint]
            places[:, joint] = places[:, parent] + turns[:, parent] @ (self.joints[joint] - self.joints[parent])
        shifts = places - np.einsum("pjab,jb->pja", turns, self.joints)
        affine = np.concatenate([turns, shifts[..., None]], axis=3)
        return np.asarray(skin(self.mesh.rest, self.skinning, affine))

    def resting_as(self, joints: np.ndarray) -> PartMesh:
        """Its mesh in a character's rest pose, from which the source's parts turn as the character's do.

        Args:
            joints: Of the character at rest, shape (22, 3).
        """
        turns = bone_turns(reference_body().joints, joints)[None].astype(np.float32)
        return replace(self.mesh, rest=self.posed(turns)[0])


@lru_cache(maxsize=2)
def source_body(vertices: int = 1000) -> SourceBody:
    """The average reference body.

    Args:
        vertices: Of its mesh, about.
    """
    body = reference_body()
    mesh = network_mesh(body.vertices, body.faces, round(ROOM * vertices))
    rest = mesh.pull(body.vertices)
    height = float(np.ptp(body.vertices[:, 1]))
    origin = np.array([body.joints[0, 0], rest[:, 1].min(), body.joints[0, 2]], np.float32)
    skinning, weights = mesh.pull(body.joint_weights), mesh.pull(body.handle_weights)
    parts = PartMesh((rest - origin) / height, mesh.faces, mesh.edges, weights)
    joints = ((body.joints - origin) / height).astype(np.float32)
    return SourceBody(parts, skinning, joints, height, mesh)


@lru_cache(maxsize=1)
def _predictor() -> HandlePredictor:
    return load_predictor(shipped_checkpoint("handles"))


def predicted_parts(rest: np.ndarray, normals: np.ndarray, edges: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Weights of the 30 handles that the Mesh Handle Predictor gives a mesh of network size as it is, shape (M, 30):
    the first of what `predict_handles` does, and the only one that many meshes need to be learned from.

    Args:
        rest: Vertices in any unit, shape (M, 3).
        normals: Shape (M, 3).
        edges: Those that join loose parts among them, shape (E, 2).
        areas: Surface of each vertex, shape (M,).
    """
    low, high = rest.min(axis=0), rest.max(axis=0)
    points = ((rest - (low + high) / 2) / (high - low).max()).astype(np.float32)
    model = _predictor()
    graph = mesh_graph(points, np.asarray(normals, np.float32), edges, areas, model.config.anchors)
    mirrored = model(graph.mirrored()).weights[:, list(HANDLE_MIRROR)]
    return np.asarray((model(graph).weights + mirrored) / 2, np.float32)


def source_turns(turns: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Turns of the source's joints off its T-pose, in the frame of the root, shape (P, 22, 3, 3).

    Args:
        turns: Of a character's joints in the world, off its rest pose, shape (P, 22, 3, 3).
        joints: Of the character at rest, shape (22, 3).
    """
    to_rest = bone_turns(reference_body().joints, joints)
    own: np.ndarray = np.swapaxes(turns[:, :1], 2, 3) @ turns @ to_rest
    return own.astype(np.float32)


def in_root_frame(affine: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Transforms of joints and positions as they are where the root stays as it is at rest.

    Args:
        affine: Affine transforms of the joints, the root's first, shape (P, J, 3, 4).
        points: Shape (P, M, 3).
    """
    turns, shift = affine[:, :1, :, :3], affine[:, :1, :, 3]
    back = np.swapaxes(turns, 2, 3)
    own = np.concatenate([back @ affine[..., :3], (back @ (affine[..., 3] - shift)[..., None])], axis=3)
    return own.astype(np.float32), np.einsum("pba,pmb->pma", turns[:, 0], points - shift).astype(np.float32)


def over_height(affine: np.ndarray, origin: np.ndarray, height: float) -> np.ndarray:
    """Affine transforms [m] as they are where lengths are over a height and begin at an origin, shape (..., 3, 4).

    Args:
        affine: Shape (..., 3, 4).
        origin: [m], shape (3,).
        height: [m].
    """
    out = np.array(affine, np.float32)
    out[..., 3] = (affine[..., :3] @ origin + affine[..., 3] - origin) / height
    return out


def in_metres(affine: np.ndarray, origin: np.ndarray, height: float) -> np.ndarray:
    """The inverse of `over_height`, shape (..., 3, 4)."""
    out = np.array(affine, np.float32)
    out[..., 3] = height * affine[..., 3] + origin - affine[..., :3] @ origin
    return out


def part_transforms(rest: np.ndarray, posed: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """How the parts of a mesh move, each by the vertices of which it has the largest weight, shape (P, K, 7):
    translation and unit quaternion, w first, about the part's centre. Parts without vertices stay where they are.

    Args:
        rest: Shape (M, 3).
        posed: Shape (P, M, 3).
        weights: Shape (M, K).
    """
    most = np.eye(weights.shape[1])[weights.argmax(axis=1)]
    centres = part_centres(torch.from_numpy(rest), torch.from_numpy(np.asarray(weights, np.float32))).numpy()
    turns, shifts = register(rest, posed, most, handles=centres)
    few = most.sum(axis=0) < LEAST
    turns[:, few], shifts[:, few] = np.eye(3), 0
    quaternions = np.roll(quaternion_from_matrix(turns), 1, axis=-1)
    return np.concatenate([shifts, quaternions], axis=2).astype(np.float32)


def graph_of(meshes: Sequence[PartMesh], posed: Sequence[np.ndarray] | None = None) -> PartGraph:
    """A block of meshes for the networks.

    Args:
        meshes: The meshes.
        posed: Where their vertices are, shape (M, 3) each; at rest when None.
    """
    points = [one.rest for one in meshes] if posed is None else posed
    return part_graph(
        [(where, vertex_normals(where, one.faces), one.edges) for where, one in zip(points, meshes, strict=True)]
    )


@dataclass(frozen=True, eq=False)
class SourcePoses:
    """A source's poses as the networks see them, whatever the target.

    Args:
        codes: Of the poses, shape (P, K, C).
        own: Transforms of the source's parts, shape (P, K, 7).
    """

    codes: torch.Tensor
    own: torch.Tensor


@torch.no_grad()
def source_poses(model: TransferNetwork, source: PartMesh, posed: np.ndarray) -> SourcePoses:
    """What the networks take from the poses of a source.

    Args:
        model: The trained networks.
        source: At rest.
        posed: Its vertices, shape (P, M, 3).
    """
    rest = graph_of([source])
    weights = model.weights(rest) if model.config.predictor else torch.from_numpy(source.weights)
    own = part_transforms(source.rest, posed, weights.numpy())
    codes = []
    for start in range(0, len(posed), CHUNK):
        some = list(posed[start : start + CHUNK])
        codes.append(model.pose_codes(rest, graph_of([source] * len(some), some), weights))
    return SourcePoses(torch.cat(codes), torch.from_numpy(own))


@torch.no_grad()
def transferred(
    model: TransferNetwork, poses: SourcePoses, target: PartMesh, joints: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Affine transforms of the target's parts in each pose of the source, shape (P, K, 3, 4), and its weights, (M, K).

    Args:
        model: The trained networks.
        poses: Of the source.
        target: At rest.
        joints: Affine transforms of given joints of the target, over its height, shape (P, J, 3, 4); for networks with
            parts that are tied to them.
    """
    still = graph_of([target])
    weights = model.weights(still) if model.config.predictor else torch.from_numpy(target.weights)
    shape = model.encoder(still, weights).expand_as(poses.codes)
    said = model.decoded(poses.codes, shape, poses.own)
    affine = affine_of(part_centres(still.inputs[:, :3], weights), said).numpy()
    if joints is not None:
        affine[:, : joints.shape[1]] = joints
    return affine, weights.numpy()
