"""Motion on any mesh by other methods: a skeleton's motion copied (MDM-SR, section 4.1 of TapMo), and Skeleton-free
Pose Transfer (Liao et al., ECCV 2022) for network meshes and whole characters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch

from bunraku.anatomy.handles.networks import HandlePredictor, load_predictor, mesh_graph
from bunraku.core.body.layout import HANDLE_MIRROR, JOINT_COUNT, JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.graph import clean_mesh
from bunraku.core.geometry.rotations import quaternion_from_matrix, rotation_between
from bunraku.core.geometry.simplify import NetworkMesh, network_mesh
from bunraku.core.geometry.surface import vertex_normals
from bunraku.core.motion import SkeletalMotion
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.core.skinning import register, skin
from bunraku.errors import CharacterError
from bunraku_lab.baselines.skinning import bone_heat, embedded_human
from bunraku_lab.nn.pose_transfer import PartGraph, TransferNetwork, affine_of, part_centres, part_graph

MOST_BONES = 4
"""Joints that move one vertex, as engines have it."""
_LEGS = (1, 4, 7)  # left hip, knee, ankle in SMPL's order


@dataclass(frozen=True, eq=False)
class RiggedMesh:
    """A mesh with the embedded human skeleton.

    Args:
        vertices: Rest positions [m], shape (V, 3).
        joints: Rest positions of SMPL's 22 joints in it [m], shape (22, 3).
        weights: Skinning weights, shape (V, 22), rows sum to 1.
    """

    vertices: np.ndarray
    joints: np.ndarray
    weights: np.ndarray


def rig_by_embedding(vertices: np.ndarray, faces: np.ndarray) -> RiggedMesh:
    """The human skeleton inside a mesh, with bone-heat weights.

    Args:
        vertices: Positions [m], +Y up, facing +Z, shape (V, 3).
        faces: Vertex indices, shape (F, 3).

    Raises:
        CharacterError: The mesh has no surface, or no skeleton can be placed in it.
    """
    mesh = clean_mesh(vertices, faces)
    try:
        skeleton, volume = embedded_human(mesh.vertices, mesh.faces)
        owners, tips = np.array(skeleton.bones()).T
        found = bone_heat(mesh.vertices, mesh.faces, skeleton.points[owners], skeleton.points[tips], owners, volume)
    except (ValueError, RuntimeError, IndexError) as error:  # of the solver, and of volumes without an inside
        raise CharacterError(f"the human skeleton cannot be embedded in this mesh: {error}") from error
    weights = np.zeros((len(mesh.vertices), JOINT_COUNT))
    weights[:, : found.shape[1]] = found
    least = np.partition(weights, -MOST_BONES, axis=1)[:, -MOST_BONES][:, None]
    weights = np.where(weights >= least, weights, 0)
    weights /= weights.sum(axis=1, keepdims=True)
    joints = skeleton.points[:JOINT_COUNT] * mesh.scale + mesh.center
    return RiggedMesh(np.asarray(vertices, float), joints, weights[mesh.index])


def copied_motion(rigged: RiggedMesh, motion: SkeletalMotion, aligned: bool = False) -> np.ndarray:
    """The mesh in each frame of a motion, shape (N, V, 3) [m].

    Args:
        rigged: The mesh and its skeleton.
        motion: Of SMPL's 22 joints on the reference body, whose T-pose is the identity.
        aligned: Turn each bone to its direction in the T-pose before the rotations are copied.
    """
    body = reference_body()
    turns, positions = motion.world()
    scale = _leg(rigged.joints) / _leg(body.joints)
    if aligned:
        turns = turns @ bone_rotations(rigged.joints, body.joints)
    roots = rigged.joints[0] + scale * (positions[:, 0] - body.joints[0])
    own = np.empty_like(positions)
    own[:, 0] = roots
    for joint in range(1, JOINT_COUNT):
        parent = JOINT_PARENTS[joint]
        own[:, joint] = own[:, parent] + turns[:, parent] @ (rigged.joints[joint] - rigged.joints[parent])
    out = np.empty((len(motion), len(rigged.vertices), 3))
    shifts = own - np.einsum("njab,jb->nja", turns, rigged.joints)
    for frame in range(len(motion)):
        turn = np.einsum("vj,jab->vab", rigged.weights, turns[frame])
        out[frame] = np.einsum("vab,vb->va", turn, rigged.vertices) + rigged.weights @ shifts[frame]
    return out


def _leg(joints: np.ndarray) -> float:
    hip, knee, ankle = joints[list(_LEGS)]
    return float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee))


def bone_rotations(own: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """For each joint the least rotation that takes its bone from one rest pose's direction to another's, shape (22, 3,
    3); a joint with several children turns not at all, one with none as its parent does.

    Args:
        own: Joints in the first rest pose, shape (22, 3).
        wanted: In the other, shape (22, 3).
    """
    out = np.tile(np.eye(3), (JOINT_COUNT, 1, 1))
    for joint in range(JOINT_COUNT):
        below = [child for child in range(JOINT_COUNT) if JOINT_PARENTS[child] == joint]
        if len(below) == 1:
            out[joint] = rotation_between(own[below[0]] - own[joint], wanted[below[0]] - wanted[joint])
        elif not below:  # hands and toes go on as what they hang from
            out[joint] = out[JOINT_PARENTS[joint]]
    return out


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
        weights: Of K parts, shape (M, K), rows sum to 1.
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
        turns = bone_rotations(reference_body().joints, joints)[None].astype(np.float32)
        return replace(self.mesh, rest=self.posed(turns)[0])


@lru_cache(maxsize=2)
def source_body(vertices: int = 1000) -> SourceBody:
    """The average reference body."""
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
    return np.asarray((model(graph).weights + mirrored)[graph.position] / 2, np.float32)


def source_rotations(turns: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Turns of the source's joints off its T-pose, in the frame of the root, shape (P, 22, 3, 3).

    Args:
        turns: Of a character's joints in the world, off its rest pose, shape (P, 22, 3, 3).
        joints: Of the character at rest, shape (22, 3).
    """
    to_rest = bone_rotations(reference_body().joints, joints)
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


def in_metres(affine: np.ndarray, origin: np.ndarray, height: float) -> np.ndarray:
    """Affine transforms whose lengths are over a height and begin at an origin, in metres, shape (..., 3, 4)."""
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
    weights = torch.from_numpy(source.weights)
    own = part_transforms(source.rest, posed, source.weights)
    codes = []
    for start in range(0, len(posed), CHUNK):
        some = list(posed[start : start + CHUNK])
        codes.append(model.pose_codes(rest, graph_of([source] * len(some), some), weights))
    return SourcePoses(torch.cat(codes), torch.from_numpy(own))


@torch.no_grad()
def transferred(model: TransferNetwork, poses: SourcePoses, target: PartMesh) -> np.ndarray:
    """Affine transforms of the target's parts in each pose of the source, shape (P, K, 3, 4).

    Args:
        model: The trained networks.
        poses: Of the source.
        target: At rest.
    """
    still = graph_of([target])
    weights = torch.from_numpy(target.weights)
    shape = model.encoder(still, weights).expand_as(poses.codes)
    said = model.decoded(poses.codes, shape, poses.own)
    return np.asarray(affine_of(part_centres(still.inputs[:, :3], weights), said).numpy())


@dataclass(frozen=True, eq=False)
class SourceMotion:
    """A motion of the reference body as pose transfer takes it, whatever the target.

    Args:
        poses: In the frame of the root.
        turns: Of the root, shape (N, 3, 3).
        path: Of the root from where it is at rest [m], shape (N, 3).
    """

    poses: SourcePoses
    turns: np.ndarray
    path: np.ndarray


def source_motion(model: TransferNetwork, motion: SkeletalMotion) -> SourceMotion:
    """A motion of the reference body's joints.

    Args:
        model: The networks that take it.
        motion: Of SMPL's 22 joints.
    """
    turns, positions = motion.world()
    own = (np.swapaxes(turns[:, :1], 2, 3) @ turns).astype(np.float32)
    body = source_body()
    poses = source_poses(model, body.mesh, body.posed(own))
    return SourceMotion(poses, turns[:, 0], positions[:, 0] - reference_body().joints[0])


@dataclass(frozen=True, eq=False)
class TransferTarget:
    """A character, and the networks that move it.

    Args:
        rest: Vertices at rest [m], shape (V, 3).
        weights: Of the parts at each vertex, shape (V, K).
        model: The networks.
        network: The mesh that they see.
        mesh: The same with its parts, over the height.
        origin: Where lengths over the height begin [m], shape (3,).
        height: [m].
    """

    rest: np.ndarray
    weights: np.ndarray
    model: TransferNetwork
    network: NetworkMesh
    mesh: PartMesh
    origin: np.ndarray
    height: float

    @classmethod
    def of(
        cls, vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray, root: np.ndarray,
        model: TransferNetwork, size: int = 1000,
    ) -> TransferTarget:  # fmt: skip
        """A mesh, facing +Z.

        Args:
            vertices: At rest [m], shape (V, 3).
            faces: Shape (F, 3).
            weights: Of the parts, shape (V, K).
            root: Position of the root [m], shape (3,).
            model: The networks.
            size: Vertices of the mesh that they see, about.

        Raises:
            CharacterError: The mesh has no surface.
        """
        network = network_mesh(vertices, faces, round(ROOM * size))
        rest = network.pull(vertices)
        height = float(np.ptp(vertices[:, 1]))
        origin = np.array([root[0], rest[:, 1].min(), root[2]], np.float32)
        own = network.pull(weights)
        own /= own.sum(axis=1, keepdims=True)
        mesh = PartMesh((rest - origin) / np.float32(height), network.faces, network.edges, own)
        return cls(np.asarray(vertices, np.float32), weights, model, network, mesh, origin, height)

    def with_joints(self, affine: np.ndarray, joints: np.ndarray) -> np.ndarray:
        """Its vertices where joints that are known move so [m], shape (P, V, 3); the source rests as it does, and takes
        the same pose.

        Args:
            affine: Affine transforms of its joints, shape (P, 22, 3, 4).
            joints: J at rest [m], shape (22, 3).
        """
        body = source_body()
        posed = body.posed(source_rotations(affine[..., :3], joints))
        moved = self._moved(source_poses(self.model, body.resting_as(joints), posed))
        turns, shift = affine[:, :1, :, :3], affine[:, :1, :, 3:]
        world = np.concatenate([turns @ moved[..., :3], turns @ moved[..., 3:] + shift], axis=3)
        return np.asarray(skin(self.rest, self.weights, world))

    def with_motion(self, motion: SourceMotion, root: np.ndarray) -> np.ndarray:
        """Its vertices as the reference body moves [m], shape (N, V, 3); its path is longer the higher its root is.

        Args:
            motion: Of the reference body, as `source_motion` gives it for the same networks.
            root: Position of its own root at rest [m], shape (3,).
        """
        moved = self._moved(motion.poses)
        body = reference_body()
        scale = (root[1] - self.origin[1]) / (body.joints[0, 1] - body.vertices[:, 1].min())
        points = np.asarray(skin(self.rest, self.weights, moved)) - root
        path = root + scale * motion.path
        return np.asarray(np.einsum("nab,nvb->nva", motion.turns, points) + path[:, None], np.float32)

    def _moved(self, poses: SourcePoses) -> np.ndarray:
        """Affine transforms of the parts in the frame of the root [m], (P, K, 3, 4)."""
        return in_metres(transferred(self.model, poses, self.mesh), self.origin, self.height)
