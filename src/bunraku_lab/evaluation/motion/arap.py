"""ARAP-Loss (Eq. 12 of TapMo): how far edges change their lengths while a character moves, and what the adaptation does
to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.diffusion.features import FeatureStatistics, decode
from bunraku.geometry.graph import unique_edges
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.datasets.characters.build import HELD_OUT

__all__ = ["ARAP_PROMPTS", "ArapRow", "ArapTable", "animation_arap", "arap_loss", "measure_adaptation"]

ARAP_PROMPTS: tuple[str, ...] = (
    "a person walks forward", "a person runs", "a person waves with the right hand", "a person kicks with the left leg",
    "a person jumps up and down", "a person dances",
)  # fmt: skip
CHUNK = 50


def arap_loss(vertices: np.ndarray, rest: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """ARAP-Loss L_ARAP [TapMo 12]: sum over the edges of the squared change of their length, in each frame, shape (N,).

    The unit is the square of the rest pose's largest extent. Finer meshes have more edges that change by less, so the
    sum hardly depends on tessellation.

    Args:
        vertices: Posed positions [m], shape (N, V, 3).
        rest: Rest positions [m], shape (V, 3).
        edges: Pairs of vertices, shape (E, 2).
    """
    size = float(np.ptp(rest, axis=0).max())
    still = np.linalg.norm(rest[edges[:, 0]].astype(np.float64) - rest[edges[:, 1]], axis=-1)
    out = np.empty(len(vertices))
    for frame, posed in enumerate(vertices):
        posed = np.ascontiguousarray(posed, np.float64)
        length = np.linalg.norm(posed[edges[:, 0]] - posed[edges[:, 1]], axis=-1)
        out[frame] = np.square((length - still) / size).sum()
    return out


def animation_arap(animation: Animation) -> float:
    """Mean over the frames of `arap_loss` on the edges of the character's faces."""
    character = animation.character
    edges = unique_edges(character.faces, len(character.vertices))
    weights = animation.handles.weights
    # an edge whose ends have equal weights keeps its length exactly
    edges = edges[np.abs(weights[edges[:, 0]] - weights[edges[:, 1]]).sum(axis=1) > 1e-6]
    frames = len(animation.motion)
    parts = [np.arange(start, min(start + CHUNK, frames)) for start in range(0, frames, CHUNK)]
    return float(
        np.concatenate([arap_loss(animation.vertices(part), character.vertices, edges) for part in parts]).mean()
    )


@dataclass(frozen=True)
class ArapRow:
    """One character, means over all prompts.

    Args:
        name: Its name.
        unseen: Whether no training sees it.
        adapted: ARAP-Loss with the adaptation: the network's, and its last step on the very mesh, which is the stage
            `shape`.
        learned: With the network's adaptation alone.
        plain: Without both: delta = 0.
        loose: Without the stage `attach` too: the paper's setting without adaptation.
        delta: Mean length of delta over frames and handles but the root [m of the reference body].
    """

    name: str
    unseen: bool
    adapted: float
    learned: float
    plain: float
    loose: float
    delta: float


@dataclass(frozen=True)
class ArapTable:
    """Rows of characters."""

    rows: tuple[ArapRow, ...]

    def ratio(self, unseen: bool, kind: str = "adapted") -> float:
        """ARAP-Loss with the adaptation over without, each the mean over the characters that are (un)seen; NaN without
        any.

        Args:
            unseen: Which characters.
            kind: "adapted", or "learned" for the network's share alone.
        """
        rows = [row for row in self.rows if row.unseen == unseen]
        return (
            sum(getattr(row, kind) for row in rows) / max(sum(row.plain for row in rows), 1e-30)
            if rows
            else float("nan")
        )

    def means(self, unseen: bool) -> dict[str, float]:
        """Mean of each figure over the characters that are (un)seen."""
        rows = [row for row in self.rows if row.unseen == unseen]
        names = ("adapted", "learned", "plain", "loose", "delta")
        return {name: float(np.mean([getattr(row, name) for row in rows])) for name in names} if rows else {}


STRIDE = 2
"""Of so many frames the mesh is looked at in one."""


def measure_adaptation(
    characters: Sequence[tuple[str, Character, Handles]],
    prompts: Sequence[str] = ARAP_PROMPTS,
    *,
    seconds: float = 3.0,
    steps: int | None = None,
    seed: int = 0,
    checkpoint: str | Path | None = None,
    stages: Stages | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> ArapTable:
    """ARAP-Loss of generated motions on characters, with and without the adaptation; the motions are the same.

    Args:
        characters: Name in the archive, character facing +Z, and its handles with f_phi.
        prompts: What they do.
        seconds: Length of each clip [s].
        steps: Sampling steps; None takes the default.
        seed: Of the first prompt; each has its own.
        checkpoint: Weights in place of the shipped ones.
        stages: Stages of the fit; all when None.
        progress: Called with a stage's name and the share done.
    """
    from bunraku.diffusion.generation.generate import GUIDANCE, STEPS, adapt
    from bunraku.diffusion.generation.networks import load_generator
    from bunraku.diffusion.sampling.sampler import Solver, sample
    from bunraku.nn.threads import one_thread

    model, encoder = load_generator(checkpoint)
    text = encoder.encode(list(prompts))
    statistics = FeatureStatistics(model.mean, model.std)
    stages = stages or Stages(shape=True)
    rows = []
    for done, (name, character, handles) in enumerate(characters):
        if progress is not None:
            progress("ARAP-Loss", done / len(characters))
        mesh = None
        if model.knows_meshes and handles.features is not None:
            mesh = np.asarray(handles.features, np.float32)[None].repeat(len(prompts), axis=0)
        frames = max(1, round(seconds * model.config.fps))
        with one_thread():
            found = sample(
                model,
                text,
                frames,
                Solver(STEPS if steps is None else steps, GUIDANCE),
                mesh_features=mesh,
                seed=seed,
            )
        figures, anatomy = [], Anatomy.of(character, handles)
        for values, offset in zip(found.values, found.adaptation, strict=True):
            plain = decode(statistics.restore(values), model.config.fps)
            bare, adapted = replace(stages, shape=False), adapt(plain, offset)
            kinds = ((adapted, stages), (adapted, bare), (plain, bare), (plain, replace(bare, attach=False)))
            figures.append([_of(fit_motion(motion, anatomy, how), character, handles) for motion, how in kinds])
            figures[-1].append(float(np.linalg.norm(offset[:, 1:], axis=-1).mean()))
        rows.append(ArapRow(name, name.partition("~")[0] in HELD_OUT, *np.mean(figures, axis=0).tolist()))
    if progress is not None:
        progress("ARAP-Loss", 1.0)
    return ArapTable(tuple(rows))


def _of(motion: HandleMotion, character: Character, handles: Handles) -> float:
    some = replace(motion.take(slice(None, None, STRIDE)), fps=motion.fps / STRIDE)
    return animation_arap(Animation(character, handles, some))
