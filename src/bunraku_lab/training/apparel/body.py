"""Training of the body network (section 4.2) on posed characters of the wardrobe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from bunraku.body.layout import JOINT_COUNT, JOINT_PARENTS
from bunraku.errors import OptionError
from bunraku_lab.nn.apparel.graph import NodeGraph, node_graph
from bunraku_lab.training.apparel.mesh_bank import MeshSample, build_meshes
from bunraku_lab.training.apparel.networks.body import BodyConfig, BodyNetwork, save_body
from bunraku_lab.training.losses.apparel_losses import edge_loss, smoothness_loss, vertex_loss
from bunraku_lab.training.runs.averaged_run import AveragedRun, TrainingNote
from bunraku_lab.training.runs.settings import StepSettings
from bunraku_lab.training.runs.training_run import Progress, Report

__all__ = ["BodyTrainConfig", "BodyTrainer", "pose_bank", "posed_joints", "train_body"]


@dataclass(frozen=True, kw_only=True)
class BodyTrainConfig(StepSettings):
    """Settings of `bunraku train apparel-body`.

    Args:
        data: Folder that `bunraku data apparel` wrote, whose motions give the poses.
        meshes: Folder of sampled meshes, those of `bunraku train apparel-mask`.
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
    """Turns of the joints in the motions of a data set, one frame of many, shape (P, 22, 3, 3), float32; none of a
    split that has no motion.
    """
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
    """One run in memory.

    Args:
        config: Settings.
        characters: To learn from.
        poses: Turns of the joints, shape (P, 22, 3, 3).
        held_out: To validate on, in `held_poses`.
        held_poses: As `poses`.
    """

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
        normals = torch.from_numpy(np.concatenate([one.mesh.features[:, 3:6] for one in meshes]))
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

    def write(self, note: TrainingNote) -> Path:
        """Write the checkpoint."""
        return save_body(self.checkpoint, self.average, note, half=True)


def train_body(config: BodyTrainConfig, report: Report | None = None, progress: Progress | None = None) -> Path:
    """Train the body network, or go on where the run in `config.out` stopped.

    Args:
        config: Settings.
        report: Called at each validation with its figures (the row of log.csv).
        progress: Called with a stage's name and the share done.

    Returns:
        The checkpoint.

    Raises:
        BunrakuError: No data, or the folder cannot be written.
    """
    config.prepare()
    meshes = build_meshes(config.meshes or config.out.with_name(f"{config.out.name}-meshes"), config.characters)
    poses, held_poses = pose_bank(config.data, "train"), pose_bank(config.data, "val", 500)
    trainer = BodyTrainer(config, meshes["train"], poses, meshes["val"] if len(held_poses) else [], held_poses)
    return trainer.learn(report, progress)
