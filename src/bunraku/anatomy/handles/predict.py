"""Handles for any mesh (Eq. 1 of TapMo): the trained predictor from a character's vertices to its handles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_matrix, diags

from bunraku.anatomy.handles.blocks import rigid_handles
from bunraku.anatomy.handles.limbs import split_limbs, with_appendages
from bunraku.anatomy.handles.repairs import SeatParts, repaired
from bunraku.core.body.layout import HANDLE_MIRROR
from bunraku.core.body.reference import handle_positions
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.simplify import NetworkMesh, network_mesh, network_views

if TYPE_CHECKING:
    from bunraku.anatomy.handles.networks import HandlePredictor

VIEWS = (
    (0.0, 0.0, 0.0),
    (0.5, 0.5, 0.5),
    (0.25, 0.75, 0.5),
)  # how the grids lie whose network meshes are averaged, in cells

UNSURE = 1.25
"""Mean entropy of the network's weights over a surface [nats], from which on it sees no body in it. Of 91 meshes, three
made of flat cards and a room have 1.28 to 1.60; of figures the most is 1.20, a statue of tentacles.
"""


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
    kept = weights * (weights >= np.minimum(weights.max(axis=1, keepdims=True), least))
    kept /= kept.sum(axis=1, keepdims=True)
    return kept.astype(np.float32, copy=False)


def entropy(weights: np.ndarray) -> np.ndarray:
    """How unsure each row of weights is [nats], shape (V, K) -> (V,)."""
    return np.asarray(-(weights * np.log(weights + 1e-9)).sum(axis=1))


@lru_cache(maxsize=2)
def _model(path: Path, changed: int) -> HandlePredictor:
    from bunraku.anatomy.handles.networks import load_predictor

    return load_predictor(path)


def predict_weights(mesh: NetworkMesh, model: HandlePredictor) -> tuple[np.ndarray, np.ndarray]:
    """What the network says of a network mesh: the mean over the mesh and its mirror image, so that it favours no side.

    Returns:
        Skinning weights (M, K) and the mesh deformation feature f_phi (448,) of the mesh as it is, float32.
    """
    from bunraku.anatomy.handles.networks import mesh_graph
    from bunraku.core.nn.layers import one_thread, parallel

    graph = mesh_graph(mesh.vertices, mesh.normals, mesh.edges, mesh.areas, model.config.anchors)
    with one_thread():
        plain, mirrored = parallel(lambda: model(graph), lambda: model(graph.mirrored()))
        weights = np.float32(0.5) * (plain.weights + mirrored.weights[:, list(HANDLE_MIRROR)])
    return weights[graph.position], plain.features


def _load(checkpoint: str | Path | None) -> HandlePredictor:
    from bunraku.core.nn.checkpoints import dated_checkpoint

    return _model(*dated_checkpoint("handles", checkpoint))


def predict_handles(character: Character, checkpoint: str | Path | None = None) -> Handles:
    """The handles of a character [TapMo 1]: positions, skinning weights of every vertex, and the feature f_phi.

    The network sees the normalised network mesh in three tessellations, each also mirrored, and the mean of its answers
    counts: they differ a little with the tessellation. Where it sees no body, all moves as one. The weights are
    smoothed over that mesh, divided among the legs of a body with more than two (`split_limbs`) or else repaired
    (`REPAIRS`), made one over small loose parts (`SeatParts`), and carried to every vertex of the original; vertices at
    one position get equal weights. Handle positions are weighted means by surface area, in the form of Eq. 4; loose
    parts count as the network sees them, not as they are bound, for a pivot belongs where the joint is. A handle
    without a surface stands where its parent stands. A file of rigid blocks has the handles of these
    (`handles.blocks`). CharacterError if the mesh has no surface; WeightsError if the checkpoint is missing or does not
    fit.

    Args:
        character: Any mesh, +Y up and facing +Z; a rig it may have is not looked at, but for one that bends nothing.
        checkpoint: Weights of kind "handles"; the shipped ones when not given.
    """
    model = _load(checkpoint)
    mesh, *others = network_views(character.vertices, character.body_faces, model.config.mesh_vertices, offsets=VIEWS)
    weights, features = predict_weights(mesh, model)
    weights = np.mean([weights, *(mesh.carry(predict_weights(view, model)[0], view) for view in others)], axis=0)
    if mesh.areas @ entropy(weights) > UNSURE * mesh.areas.sum():  # it moves as one
        weights = np.eye(1, weights.shape[1])[np.zeros(len(weights), int)]
    weights, roles = split_limbs(mesh, trim_weights(smooth_weights(weights, mesh.edges)))
    if roles is None:  # of many legs one handle holds several regions before they are told apart
        weights = repaired(mesh, weights)
    full = SeatParts()(mesh, weights, stiff=roles is None)
    rigid = rigid_handles(character, full[mesh.clean.index])
    if rigid is not None:
        return replace(rigid, features=features)
    if roles is None:
        weights, full, roles = with_appendages(mesh, weights, full)
    positions = handle_positions(mesh.vertices, weights, mesh.areas) * mesh.scale + mesh.center
    weights = trim_weights(full)[mesh.clean.index]
    if character.beside is not None:  # nothing moves it, so it may not count as a part
        weights[character.beside] = np.eye(1, weights.shape[1])
    return Handles(positions, weights, features, roles)


def mesh_feature(character: Character, checkpoint: str | Path | None = None) -> np.ndarray:
    """The mesh deformation feature f_phi of a character, shape (448,), for handles that do not come from the predictor.

    Arguments and errors are those of `predict_handles`.
    """
    model = _load(checkpoint)
    return predict_weights(network_mesh(character.vertices, character.body_faces, model.config.mesh_vertices), model)[1]


@dataclass(frozen=True)
class Predictor:
    """Gives the handles of characters."""

    checkpoint: str | Path | None = None  # weights of kind "handles"; the shipped ones when not given

    def __call__(self, character: Character) -> Handles:
        """The handles of a character (see `predict_handles`)."""
        return predict_handles(character, self.checkpoint)

    def feature(self, character: Character) -> np.ndarray:
        """The mesh deformation feature f_phi of a character, shape (448,)."""
        return mesh_feature(character, self.checkpoint)
