"""The body network of section 4.2 of MMDMC (skinning weights for 22 joints), its use, and its training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import nn

from bunraku.apparel.body import eq4_transforms
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.fitting import fitted_clothes
from bunraku.apparel.learned.network import DisplacementNetwork
from bunraku.apparel.learned.player import ApparelPlayer
from bunraku.apparel.parts import find_parts
from bunraku.core.body.layout import JOINT_COUNT, JOINT_PARENTS
from bunraku.core.nn.checkpoints import dated
from bunraku.core.skinning import skin
from bunraku.errors import OptionError
from bunraku_lab.nn.checkpoints import SavedNetwork, lab_checkpoint
from bunraku_lab.nn.graph import EdgeBlock, NodeGraph, node_graph
from bunraku_lab.training.apparel.meshes import MeshSample, build_meshes, joint_distances, sampled_mesh
from bunraku_lab.training.losses.motion import edge_loss, smoothness_loss, vertex_loss
from bunraku_lab.training.runs.run import AveragedRun, Progress, Report, StepSettings

JOINT_INPUT = 3 + 1 + 3
"""Of a vertex and a joint: the way from it, its length, the vertex normal."""

SHARPNESS = 32.0
"""Of the attention before it has learned, a unit of the height."""
FLOOR = 1e-6
"""Of the attention where weights begin with it: a joint that it leaves out can come back; the kept
network was trained so.
"""


@dataclass(frozen=True)
class BodyConfig:
    """Shape of the network.

    Args:
        features: Channels D of the features of a joint.
        width: Channels of the PointNet f_s.
        geodesics: "attention" is Eq. 5 and 6; "none" goes without geodesic distances, every joint counting the same;
            "sorted" puts the ways to the joints in the order of these distances (RigNet's form, Table 4).
    """

    features: int = 24
    width: int = 96
    geodesics: Literal["attention", "none", "sorted"] = "attention"


class BodyNetwork(SavedNetwork):
    """The network."""

    kind = "apparel-body"
    shape = BodyConfig

    def __init__(self, config: BodyConfig | None = None):
        super().__init__()
        self.config = config = config or BodyConfig()
        wide = config.features
        self.joint_codes = nn.Parameter(0.1 * torch.randn(JOINT_COUNT, wide))
        self.encoder = nn.Sequential(nn.Linear(JOINT_INPUT, 32), nn.GELU(), nn.Linear(32, wide))
        last = nn.Linear(64, JOINT_COUNT)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.attention = nn.Sequential(nn.Linear(JOINT_COUNT, 64), nn.GELU(), last)
        self.sharpness = nn.Parameter(torch.tensor(SHARPNESS).log())
        entering = {"attention": wide + JOINT_COUNT, "none": wide, "sorted": 4 * JOINT_COUNT}[config.geodesics] + 6
        self.enter = nn.Sequential(nn.Linear(entering, config.width), nn.GELU(), nn.Linear(config.width, config.width))
        self.block = EdgeBlock(config.width)
        self.pooled = nn.Linear(config.width, config.width)
        self.decoder = nn.Sequential(
            nn.Linear(2 * config.width, config.width), nn.GELU(), nn.Linear(config.width, JOINT_COUNT)
        )

    def attention_map(self, geodesics: torch.Tensor) -> torch.Tensor:
        """M = Softmax(f_m(G)), how much each joint counts for each vertex [MMDMC 5], shape (N, J) -> (N, J).

        f_m begins as -32 G with G over the height, so that M begins as the prior that the distances are: the joint that
        is nearest along the surface, and others where they are nearly as near. How sharp it is is learned, and an MLP
        of how close all joints are, exp(-8 G), is added to it, which says nothing before it has learned.
        """
        far = self.attention(torch.exp(-8 * geodesics)) - self.sharpness.exp() * geodesics
        out: torch.Tensor = torch.softmax(far, dim=1)
        return out

    def fused(self, features: torch.Tensor, attention: torch.Tensor) -> torch.Tensor:
        """P'_i = sum_j P_ij M_ij [MMDMC 6], shapes (N, J, D) and (N, J) -> (N, D)."""
        return torch.einsum("njd,nj->nd", features, attention)

    def forward(
        self, points: torch.Tensor, normals: torch.Tensor, joints: torch.Tensor, geodesics: torch.Tensor,
        graph: NodeGraph,
    ) -> torch.Tensor:  # fmt: skip
        """Skinning weights W = Softmax(f_s(P')) [MMDMC 7], shape (N, J), rows sum to 1.

        Beside P' ours is given the place, the normal and the attention map itself, and what it says of a joint is how
        much more or less than M that joint holds the vertex: W = Softmax(log M + f_s), so that it begins as M. Where
        every joint counts the same, log M is nothing.

        Args:
            points: Of B meshes in units of their heights (`SampledMesh.points`), shape (N, 3).
            normals: Shape (N, 3).
            joints: J of each mesh in the same units, shape (B, J, 3).
            geodesics: G over the height, shape (N, J).
            graph: Neighbours, loose parts and meshes of the points.
        """
        way = points[:, None] - joints[graph.owner]
        length = way.norm(dim=2, keepdim=True)
        own = torch.cat([points, normals], dim=1)
        prior = points.new_zeros(1, JOINT_COUNT)
        if self.config.geodesics == "sorted":
            order = geodesics.argsort(dim=1)
            both = torch.cat([way, geodesics[..., None]], dim=2)
            fused = both.gather(1, order[..., None].expand_as(both)).flatten(1)
        else:
            pair = torch.cat([way, length, normals[:, None].expand_as(way)], dim=2)
            features = self.encoder(pair) + self.joint_codes
            if self.config.geodesics == "attention":
                attention = self.attention_map(geodesics)
                fused = torch.cat([self.fused(features, attention), 4 * attention], dim=1)
                prior = torch.log(attention + FLOOR)
            else:
                fused = features.mean(dim=1)  # Eq. 6 with the same attention for each joint
        x = self.block(self.enter(torch.cat([fused, own], dim=1)), graph)
        rows = graph.owner[:, None].expand_as(x)
        whole = x.new_full((len(joints), x.shape[1]), -1e4).scatter_reduce(0, rows, x, "amax")
        out: torch.Tensor = self.decoder(torch.cat([x, self.pooled(whole)[graph.owner]], dim=1))
        return torch.softmax(prior + out, dim=1)


@lru_cache(maxsize=4)
def _model(path: Path, changed: int) -> BodyNetwork:
    return BodyNetwork.load(path)


def body_weights(
    vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, checkpoint: str | Path | None = None
) -> np.ndarray:
    """Skinning weights W for the 22 joints, shape (V, 22), float32, rows sum to 1.

    Args:
        vertices: Rest mesh V [m], +Y up and facing +Z, shape (V, 3).
        faces: Shape (F, 3).
        joints: J [m], shape (22, 3).
        checkpoint: Weights of kind "apparel-body"; those of a checkout when not given.

    Raises:
        CharacterError: The mesh is broken.
        WeightsError: The checkpoint is missing or does not fit.
    """
    model = _model(*dated(lab_checkpoint("apparel-body") if checkpoint is None else Path(checkpoint)))
    mesh = sampled_mesh(vertices, faces, joints)
    geodesics = joint_distances(vertices, faces, joints, mesh.clean)
    with torch.no_grad():
        weights = model(
            torch.from_numpy(mesh.points), torch.from_numpy(mesh.normals),
            torch.from_numpy(mesh.joints)[None],
            torch.from_numpy(geodesics),
            node_graph([mesh.neighbours], [mesh.part]),
        ).numpy()  # fmt: skip
    full = mesh.spread(weights)
    return np.asarray(full / full.sum(axis=1, keepdims=True), np.float32)


def clothed_by_mask(
    true: ClothedCharacter, masks: Path | None = None, body: Path | None = None
) -> tuple[ClothedCharacter, np.ndarray]:
    """A character as the networks alone see it, and the weights that the body network gives all vertices, shape (V,
    22); of its own only mesh and joints are used.

    Args:
        true: The character.
        masks: Part network; the shipped one when not given.
        body: Body network; the shipped one when not given.

    Raises:
        WeightsError: A network is missing or broken.
    """
    weights = body_weights(true.rest, true.faces, true.joints, body)
    mask = find_parts(true.rest, true.faces, checkpoint=masks).mask
    return fitted_clothes(true.rest, true.faces, true.joints, weights, mask), weights


def tiled(
    clothed: ClothedCharacter, transforms: np.ndarray, network: DisplacementNetwork, frames: np.ndarray
) -> np.ndarray:
    """All vertices in some frames of a clip at 30 frames a second that begins from rest [m], shape (F, V, 3), float32.

    Args:
        clothed: The character.
        transforms: `[R | t]` of the joints, shape (N, 22, 3, 4).
        network: Of the displacement.
        frames: Which frames, rising, shape (F,).
    """
    affine = eq4_transforms(transforms[frames], clothed.joints)
    moved = np.array(skin(clothed.rest, clothed.weights, affine), np.float32)
    if clothed.apparel.any():
        player = ApparelPlayer(clothed, network)
        player.start(transforms[0])
        rows = {int(frame): row for row, frame in enumerate(frames)}
        for frame, pose in enumerate(transforms[: int(frames[-1]) + 1]):
            points = player.advance(pose)
            if frame in rows:
                moved[rows[frame], player.carrier.vertices] = points
    return moved


@dataclass(frozen=True, kw_only=True)
class BodyTrainConfig(StepSettings):
    """Settings of `bunraku train apparel-body`.

    Args:
        data: Folder that `bunraku data apparel` wrote, whose motions give the poses.
        meshes: Folder of sampled meshes, made where there are none.
        characters: How many characters of the wardrobe.
        poses: Poses of each.
        edges: Weight of Eq. 9; the paper's is 100, in its units.
        smooth: Weight of Eq. 10.
        network: Its shape.
    """

    data: Path = Path("data/apparel")
    out: Path = Path("runs/apparel-body")
    meshes: Path | None = None
    characters: int = 1500
    steps: int = 4000
    poses: int = 3
    edges: float = 1.0
    smooth: float = 0.01
    network: BodyConfig = field(default_factory=BodyConfig)


def pose_bank(data: Path, split: str, most: int = 4000) -> np.ndarray:
    """Rotations of the joints in a data set's motions, one frame of many, shape (P, 22, 3, 3), float32."""
    from bunraku_lab.datasets.apparel import ApparelData

    found = ApparelData(data, split)  # type: ignore[arg-type]
    each = max(1, most // max(len(found.clips), 1))
    out = []
    for clip in found.clips:
        turns = found.shard(clip.shard).frames("transforms", clip.first, clip.first + clip.frames)[..., :3]
        out.append(turns[np.linspace(0, len(turns) - 1, each).astype(np.int64)])
    return np.concatenate([np.zeros((0, JOINT_COUNT, 3, 3)), *out])[:most].astype(np.float32)


def posed_joints(turns: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Affine transforms of a body in poses, its pelvis where it is at rest, shape (P, 22, 3, 4), float32.

    Args:
        turns: Of the joints in the world, shape (P, 22, 3, 3).
        joints: J in the rest pose, shape (22, 3).
    """
    positions = np.zeros((len(turns), JOINT_COUNT, 3), np.float32)
    positions[:, 0] = joints[0]
    for joint in range(1, JOINT_COUNT):
        parent = JOINT_PARENTS[joint]
        positions[:, joint] = positions[:, parent] + turns[:, parent] @ (joints[joint] - joints[parent])
    moved = positions - np.einsum("pjab,jb->pja", turns, joints)
    return np.concatenate([turns, moved[..., None]], axis=3).astype(np.float32)


class BodyTrainer(AveragedRun[BodyNetwork]):
    """One run in memory."""

    kind = "apparel-body"

    def __init__(
        self, config: BodyTrainConfig, characters: Sequence[MeshSample], poses: np.ndarray,
        held_out: Sequence[MeshSample] = (), held_poses: np.ndarray | None = None,
    ):  # fmt: skip
        if not characters or not len(poses):
            raise OptionError("there are no characters or no poses to train on; build the data first")
        self.config, self.characters, self.held_out = config, list(characters), list(held_out)
        self.poses, self.held_poses = poses, poses if held_poses is None else held_poses
        self.set_up(lambda: BodyNetwork(config.network))

    @staticmethod
    def weights(model: BodyNetwork, meshes: Sequence[MeshSample]) -> tuple[torch.Tensor, NodeGraph]:
        """Predicted weights of all points of meshes, and their graph."""
        graph = node_graph([one.mesh.neighbours for one in meshes], [one.mesh.part for one in meshes])
        points = torch.from_numpy(np.concatenate([one.mesh.points for one in meshes]))
        normals = torch.from_numpy(np.concatenate([one.mesh.normals for one in meshes]))
        joints = torch.from_numpy(np.stack([one.mesh.joints for one in meshes]))
        geodesics = torch.from_numpy(np.concatenate([one.geodesics for one in meshes]))
        return model(points, normals, joints, geodesics, graph), graph

    def _deformed(
        self, meshes: Sequence[MeshSample], weights: torch.Tensor, poses: np.ndarray
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Points of all meshes in poses by the weights and by the true ones, (P, N, 3) each; and at rest (N, 3)."""
        own, true, start = [], [], 0
        for number, one in enumerate(meshes):
            affine = torch.from_numpy(posed_joints(poses[number], one.mesh.joints))
            rest = torch.nn.functional.pad(torch.from_numpy(one.mesh.points), (0, 1), value=1.0)
            moved = torch.einsum("pjac,nc->pnja", affine, rest)
            some = weights[start : start + len(rest)]
            own.append(torch.einsum("pnja,nj->pna", moved, some))
            true.append(torch.einsum("pnja,nj->pna", moved, torch.from_numpy(one.weights)))
            start += len(rest)
        rest_points = torch.from_numpy(np.concatenate([one.mesh.points for one in meshes]))
        return torch.cat(own, dim=1), torch.cat(true, dim=1), rest_points

    def step_loss(self) -> tuple[torch.Tensor, dict[str, float]]:
        """The loss L_vb + lambda L_eb + lambda L_s, over the body's points and edges."""
        config = self.config
        chosen = [self.characters[number] for number in self.rng.integers(len(self.characters), size=config.batch)]
        poses = self.poses[self.rng.integers(len(self.poses), size=(config.batch, config.poses))]
        weights, graph = self.weights(self.model, chosen)
        own, true, rest = self._deformed(chosen, weights, poses)
        body = torch.from_numpy(~np.concatenate([one.apparel for one in chosen]))
        edges = graph.edges[body[graph.edges].all(dim=1)]
        loss = vertex_loss(own[:, body], true[:, body]) + config.edges * edge_loss(own, rest, edges)
        loss = loss + config.smooth * smoothness_loss(weights, edges)
        return loss, {}

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Mean distance from the truth on characters and poses that were not learned from, over the height [%]."""
        random = np.random.default_rng(3)
        found = []
        for one in self.held_out:
            weights, _ = self.weights(self.average, [one])
            poses = self.held_poses[random.integers(len(self.held_poses), size=(1, 8))]
            own, true, _ = self._deformed([one], weights, poses)
            gap = (own - true).norm(dim=2).mean(dim=0).numpy()
            found.append([gap.mean(), gap[~one.apparel].mean(), gap[one.apparel].mean() if one.apparel.any() else 0.0])
        whole, body, cloth = 100 * np.mean(found, axis=0)
        return {"pmd": float(whole), "pmd_body": float(body), "pmd_apparel": float(cloth)}


def train_body(config: BodyTrainConfig, report: Report | None = None, progress: Progress | None = None) -> Path:
    """Train the body network, or go on where the run in `config.out` stopped.

    Raises:
        BunrakuError: No data, or the folder cannot be written.
    """
    config.prepare()
    meshes = build_meshes(config.meshes or config.out.with_name(f"{config.out.name}-meshes"), config.characters)
    poses, held_poses = pose_bank(config.data, "train"), pose_bank(config.data, "val", 500)
    trainer = BodyTrainer(config, meshes["train"], poses, meshes["val"] if len(held_poses) else [], held_poses)
    return trainer.learn(report, progress)
