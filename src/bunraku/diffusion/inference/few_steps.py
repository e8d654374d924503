"""What a denoiser that was distilled for few steps changes in the weights of its teacher (`bunraku train few-steps`).

Each matrix W of the teacher becomes W + U D with thin U and D (low-rank adaptation, Hu et al. 2022), so the changes
take a tenth of the teacher's room, and the teacher stays beside them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.diffusion.denoiser_config import TRAINING_STEPS
from bunraku.errors import WeightsError
from bunraku.nn.checkpoints import load_checkpoint

__all__ = ["KIND", "FewSteps", "fingerprint", "load_few_steps"]

KIND = "few-steps"
_MARK = "motion_out.weight"


def fingerprint(state: Mapping[str, np.ndarray]) -> str:
    """Tells weights of a denoiser from others: of its last layer, in half precision."""
    found = state.get(_MARK)
    return "" if found is None else hashlib.sha256(found.astype(np.float16).tobytes()).hexdigest()[:32]


@dataclass(frozen=True, eq=False)
class FewSteps:
    """Changes to a denoiser's weights, and the steps that they are for.

    Args:
        of: `fingerprint` of the teacher.
        visited: Diffusion steps, falling.
        guidance: Scale of the teacher's guidance by sentences, which the changes hold.
        changes: Up (O, R) and down (R, I) by the name of the matrix (O, I).
    """

    of: str
    visited: tuple[int, ...]
    guidance: float
    changes: Mapping[str, tuple[np.ndarray, np.ndarray]]

    def fits(self, state: Mapping[str, np.ndarray]) -> bool:
        """Whether these are the teacher's weights."""
        return self.of == fingerprint(state)

    def on(self, state: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
        """The teacher's weights, each changed when it is asked for, so that they are never all there twice.

        Raises:
            ValueError: A change is of no matrix of theirs.
        """
        for name, (up, down) in self.changes.items():
            matrix = state.get(name)
            if matrix is None or up.ndim != 2 or down.ndim != 2 or matrix.shape != (len(up), down.shape[1]):
                raise ValueError(f"'{name}' is no matrix of the denoiser that has this change's size")
        return _Changed(state, self.changes)


class _Changed(Mapping[str, np.ndarray]):
    def __init__(self, state: Mapping[str, np.ndarray], changes: Mapping[str, tuple[np.ndarray, np.ndarray]]):
        self._state, self._changes = state, changes

    def __getitem__(self, name: str) -> np.ndarray:
        matrix, change = self._state[name], self._changes.get(name)
        if change is None:
            return matrix
        up, down = (part.astype(np.float32) for part in change)
        return np.asarray(matrix.astype(np.float32) + up @ down)

    def __iter__(self) -> Iterator[str]:
        return iter(self._state)

    def __len__(self) -> int:
        return len(self._state)


def load_few_steps(path: str | Path) -> FewSteps:
    """Read what `bunraku train few-steps` wrote.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or names no steps.
    """
    state, config = load_checkpoint(path, KIND, half=True)
    visited: Any = config.get("visited")
    steps = visited if isinstance(visited, list) else []
    whole = all(isinstance(one, int) and 0 <= one < TRAINING_STEPS for one in steps)
    if not steps or not whole or any(a <= b for a, b in zip(steps, steps[1:], strict=False)):
        raise WeightsError(f"{path}: it names no falling diffusion steps; distil the denoiser again")
    names = sorted({name.rpartition(".")[0] for name in state})
    try:
        changes = {name: (state[f"{name}.up"], state[f"{name}.down"]) for name in names}
        return FewSteps(str(config["of"]), tuple(steps), float(config["guidance"]), changes)
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsError(
            f"{path}: a change of the weights is not whole ({error}); distil the denoiser again"
        ) from error
