"""The f_phi of many characters, and which of them a training row gets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from bunraku.errors import FormatError
from bunraku_lab.datasets.motions.bundle import read_bundle

__all__ = ["MeshBank", "load_mesh_bank"]


@dataclass(frozen=True, eq=False)
class MeshBank:
    """Mesh features to train with.

    Args:
        features: f_phi, shape (C, 448).
        rows: Rows of each character by its name; what follows a "~" in a name says which variant it is and is left out.
        humanoid: Rows of upright bodies with arms; all rows where the bank does not say.
    """

    features: Tensor
    rows: dict[str, np.ndarray]
    humanoid: np.ndarray

    def __len__(self) -> int:
        return len(self.features)

    def draw(
        self, meshes: Sequence[str | None] | None, size: int, random: np.random.Generator, cross: float = 0.0
    ) -> tuple[Tensor, np.ndarray]:
        """A feature for each row of a batch.

        Args:
            meshes: Character that a row's motion belongs to, None for any humanoid; None in place of all for a batch
                without creatures.
            size: Rows B.
            random: Draws them.
            cross: Share of the humanoids' rows that take any character at all.

        Returns:
            Features (B, 448), and whether they are known, shape (B,): a creature that the bank lacks has the null mesh.
        """
        chosen = self.choose(meshes, size, random, cross)
        return self.features[torch.from_numpy(np.maximum(chosen, 0))], chosen >= 0

    def choose(
        self, meshes: Sequence[str | None] | None, size: int, random: np.random.Generator, cross: float = 0.0
    ) -> np.ndarray:
        """Row of the feature that `draw` gives each row of a batch, -1 where it is not known, shape (B,)."""
        chosen = np.zeros(size, np.int64)
        for index, name in enumerate(meshes or [None] * size):
            pick, any_body = random.random(), random.random() < cross
            if name is None:
                chosen[index] = (
                    int(pick * len(self.features)) if any_body else self.humanoid[int(pick * len(self.humanoid))]
                )
                continue
            rows = self.rows.get(name.partition("~")[0])
            if rows is None:
                chosen[index] = -1
            else:
                chosen[index] = rows[int(pick * len(rows))]
        return chosen


def load_mesh_bank(path: Path, size: int) -> MeshBank:
    """The training rows of what `bunraku train handles` wrote.

    Args:
        path: NPZ with `features` (C, `size`) and perhaps `names` (C,), `split` (C,) and `humanoid` (C,); or a bundle
            that has them (see `datasets.motions.bundle`).
        size: Length of f_phi.

    Raises:
        FormatError: The file is damaged, or its features have another shape.
    """
    try:
        found = _arrays(path)
        bank = np.asarray(found["features"], np.float32)
    except FormatError:
        raise
    except Exception as error:
        raise FormatError(
            path, f"the mesh features cannot be read ({error}); write them with 'bunraku train handles'"
        ) from error
    if bank.ndim != 2 or bank.shape[1] != size or not len(bank) or not np.isfinite(bank).all():
        raise FormatError(
            path, f"the mesh features must be finite numbers of shape (characters, {size}), not {bank.shape}"
        )
    if any(value.shape[:1] != bank.shape[:1] for value in found.values()):
        raise FormatError(
            path,
            "the names, splits and features are not as many; write the features again with 'bunraku train handles'",
        )
    kept = np.flatnonzero(found["split"] == "train") if "split" in found else np.arange(len(bank))
    if not len(kept):
        raise FormatError(
            path, "no row of the mesh features is of the split 'train'; write them again with 'bunraku train handles'"
        )
    rows: dict[str, list[int]] = {}
    for row, name in enumerate(found["names"][kept] if "names" in found else []):
        rows.setdefault(str(name).partition("~")[0], []).append(row)
    upright = np.flatnonzero(found["humanoid"][kept].astype(bool)) if "humanoid" in found else np.arange(len(kept))
    return MeshBank(
        torch.from_numpy(bank[kept]),
        {name: np.array(own) for name, own in rows.items()},
        upright if len(upright) else np.arange(len(kept)),
    )


def _arrays(path: Path) -> dict[str, np.ndarray]:
    if path.suffix == ".safetensors":
        return read_bundle(path).meshes or {}
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in ("features", "names", "split", "humanoid") if name in file.files}
