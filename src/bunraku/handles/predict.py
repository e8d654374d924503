"""Handles for any mesh (Eq. 1 of TapMo): the trained predictor from a character's vertices to its handles."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_matrix, diags

from bunraku.bodies.reference import handle_positions
from bunraku.character import Character, Handles
from bunraku.geometry.simplify import NetworkMesh, network_mesh

if TYPE_CHECKING:
    from bunraku.handles.predictor import HandlePredictor

__all__ = ["predict_handles", "predict_weights", "smooth_weights", "stiffen_parts", "trim_weights"]


def smooth_weights(weights: np.ndarray, edges: np.ndarray, steps: int = 2, share: float = 0.5) -> np.ndarray:
    """Blend each vertex's weights with the mean of its neighbours', so that seams between handles bend softly.

    Args:
        weights: Shape (V, K), rows sum to 1; so they do afterwards.
        edges: Undirected edges, shape (E, 2).
        steps: How often.
        share: The neighbours' part in each step.
    """
    count = len(weights)
    both = np.concatenate([edges, edges[:, ::-1]])
    matrix = csr_matrix((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(count, count))
    degree = np.asarray(matrix.sum(axis=1)).ravel()
    mean = diags(np.where(degree > 0, 1 / np.maximum(degree, 1), 0)) @ matrix
    out = np.asarray(weights, np.float64)
    for _ in range(steps):
        out = np.where(degree[:, None] > 0, (1 - share) * out + share * (mean @ out), out)
    return out.astype(np.float32)


def trim_weights(weights: np.ndarray, least: float = 0.01) -> np.ndarray:
    """Weights without their tiny entries, renormalised; the largest of a row always stays. Shape (V, K)."""
    kept = np.where((weights >= least) | (weights == weights.max(axis=1, keepdims=True)), weights, 0)
    return (kept / kept.sum(axis=1, keepdims=True)).astype(np.float32)


def stiffen_parts(weights: np.ndarray, mesh: NetworkMesh, largest: float = 0.35, clear: float = 0.7) -> np.ndarray:
    """Give each small loose part (an eye, a button, a helmet, a sword) one weight for all of it, so that it moves as a whole.

    Args:
        weights: Shape (M, K), rows sum to 1.
        mesh: The network mesh, whose `components` are its loose parts.
        largest: Parts of a greater extent than this, as a share of the mesh's, may bend and stay as they are.
        clear: So do parts of which no handle holds this share; they reach over a joint, as a sleeve does.
    """
    if not mesh.components.any():
        return weights
    out = weights.copy()
    order = np.argsort(mesh.components, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(mesh.components[order])) + 1):
        if np.ptp(mesh.vertices[members], axis=0).max() > largest:
            continue
        mean = np.average(weights[members], axis=0, weights=mesh.areas[members] + 1e-12)
        if mean.max() >= clear:
            out[members] = mean
    return out


@lru_cache(maxsize=2)
def _model(path: Path, changed: int) -> HandlePredictor:
    from bunraku.handles.predictor import load_predictor

    return load_predictor(path)


def predict_weights(mesh: NetworkMesh, model: HandlePredictor) -> tuple[np.ndarray, np.ndarray]:
    """What the network says of a network mesh.

    Returns:
        Skinning weights (M, K) and the mesh deformation feature f_phi (448,), float32.
    """
    import torch

    from bunraku.handles.graph import mesh_graph

    graph = mesh_graph(mesh.vertices, mesh.normals, mesh.edges, mesh.areas, model.config.anchors).to(next(model.parameters()).device)
    with torch.no_grad():
        predicted = model.eval()(graph)
    return predicted.weights.float().cpu().numpy(), predicted.features.float().cpu().numpy()


def predict_handles(character: Character, checkpoint: str | Path | None = None) -> Handles:
    """The handles of a character (Eq. 1 of TapMo): positions, skinning weights of every vertex, and the feature f_phi.

    The network sees the normalised network mesh. Its weights are smoothed over that mesh, made one over small loose parts, and
    carried to every vertex of the original. Handle positions are weighted means by surface area, in the form of Eq. 4, so that
    tessellation does not matter; a handle without a surface stands where its parent stands.

    Args:
        character: Any mesh, +Y up and facing +Z; a rig it may have is not looked at.
        checkpoint: Weights of kind "handles"; the shipped ones when not given.

    Raises:
        CharacterError: The mesh has no surface.
        WeightsError: The checkpoint is missing or does not fit.
    """
    from bunraku.nn.checkpoints import shipped_checkpoint

    path = Path(checkpoint) if checkpoint is not None else shipped_checkpoint("handles")
    model = _model(path.resolve(), path.stat().st_mtime_ns if path.is_file() else 0)
    mesh = network_mesh(character.vertices, character.faces, model.config.mesh_vertices)
    weights, features = predict_weights(mesh, model)
    weights = trim_weights(stiffen_parts(smooth_weights(weights, mesh.edges), mesh))
    positions = handle_positions(mesh.vertices, weights, mesh.areas) * mesh.scale + mesh.center
    spread = np.maximum(mesh.push(weights), 0)
    total = spread.sum(axis=1, keepdims=True)
    spread = np.where(total > 1e-6, spread / np.maximum(total, 1e-6), np.eye(1, spread.shape[1]))  # a vertex of no surface follows the root
    return Handles(positions, trim_weights(spread), features)
