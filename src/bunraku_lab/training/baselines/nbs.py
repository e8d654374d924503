"""Training of the skinning of Neural Blend Shapes with given joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from bunraku.errors import OptionError
from bunraku_lab.datasets.apparel import ApparelData
from bunraku_lab.nn.blend_shapes import EdgeMesh, NbsConfig, NbsNetwork, edge_mesh, moved_by
from bunraku_lab.training.baselines.banks import ClothedSample, build_clothed_bank
from bunraku_lab.training.runs.run import AveragedRun, Progress, Report, StepSettings


@dataclass(frozen=True, kw_only=True)
class NbsTrainConfig(StepSettings):
    """Settings of `bunraku train nbs`.

    Args:
        data: Folder that `bunraku data apparel` wrote.
        meshes: Folder that keeps its characters as meshes of network size.
        vertices: Of a mesh, about.
        frames: Of each character.
        poses: Of a mesh a step.
        network: Its shape.
    """

    data: Path = Path("data/apparel")
    out: Path = Path("runs/nbs")
    meshes: Path | None = None
    vertices: int = 1000
    frames: int = 48
    poses: int = 32
    batch: int = 1
    rate: float = 1e-3
    weight_decay: float = 0.0
    network: NbsConfig = field(default_factory=NbsConfig)


class NbsTrainer(AveragedRun[NbsNetwork]):
    """One run in memory."""

    kind = "nbs"

    def __init__(
        self, config: NbsTrainConfig, characters: Sequence[ClothedSample], held_out: Sequence[ClothedSample] = ()
    ):
        if not characters:
            raise OptionError("there are no characters to train on; build more of `bunraku data apparel`")
        self.config, self.characters, self.held_out = config, list(characters), list(held_out)
        self.meshes: dict[str, EdgeMesh] = {}
        self.set_up(lambda: NbsNetwork(config.network))

    def posed(self, model: NbsNetwork, one: ClothedSample, poses: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Where the network puts a character in some of its poses, and where it is, (P, M, 3) each, over its height."""
        if one.name not in self.meshes:
            self.meshes[one.name] = edge_mesh(one.faces, one.edges, len(one.rest))
        mesh = self.meshes[one.name]
        low, height = one.rest[:, 1].min(), float(np.ptp(one.rest[:, 1]))
        origin = np.array([one.joints[0, 0], low, one.joints[0, 2]], np.float32)
        points = torch.from_numpy((one.rest - origin) / np.float32(height))
        affine = torch.from_numpy(one.affine[poses])
        moved = moved_by(torch.from_numpy(one.rest), model(points, mesh), affine)
        return moved / height, torch.from_numpy(one.truth[poses]) / height

    def step_loss(self) -> tuple[torch.Tensor, dict[str, float]]:
        """The mean square of the vertices' errors over the height [%^2]."""
        total = torch.zeros(())
        for number in self.rng.integers(len(self.characters), size=self.config.batch):
            one = self.characters[number]
            poses = self.rng.permutation(len(one.truth))[: self.config.poses]
            own, truth = self.posed(self.model, one, poses)
            total = total + 1e4 * (own - truth).square().sum(dim=2).mean() / self.config.batch
        return total, {}

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Mean distance from the truth on characters that were not learned from, over the height [%]."""
        found = []
        for one in self.held_out:
            own, truth = self.posed(self.average, one, np.arange(0, len(one.truth), 4))
            gap, cloth = (own - truth).norm(dim=2).mean(dim=0).numpy(), one.apparel > 0.5
            found.append([gap.mean(), gap[~cloth].mean(), gap[cloth].mean() if cloth.any() else 0.0])
        whole, body, apparel = 100 * np.mean(found, axis=0)
        return {"pmd": float(whole), "pmd_body": float(body), "pmd_apparel": float(apparel)}


def train_nbs(config: NbsTrainConfig, report: Report | None = None, progress: Progress | None = None) -> Path:
    """Train Neural Blend Shapes, or go on where the run in `config.out` stopped.

    Raises:
        BunrakuError: No data, or the folder cannot be written.
    """
    config.prepare()
    folder = config.meshes or config.out.with_name(f"{config.out.name}-meshes")
    show_progress = None if progress is None else (lambda done: progress("meshes", done))
    held_out, characters = (
        build_clothed_bank(
            ApparelData(config.data, split), folder / split, config.vertices, config.frames, show_progress
        )  # type: ignore[arg-type]
        for split in ("val", "train")
    )
    return NbsTrainer(config, characters, held_out).learn(report, progress)
