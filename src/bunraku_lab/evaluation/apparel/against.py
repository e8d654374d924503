"""MMDMC's table 2 on one clip: the whole mesh by ours and by what other methods cannot be better than, or stand on
(`evaluation.apparel.rivals` has the trained ones).

- Neural Blend Shapes moves apparel by linear blend skinning with weights of the joints. No such weights are better than
  those that are fitted to the very frames (`best_skinning`), so that row is what it can at most reach.
- SPT predicts weights of parts, and corrects the parts' motion by a trained network. Without the correction it is the
  predicted weights of the parts, moved as the joints are: the floor that its network starts from.

Each is measured twice: from the rest pose over 6 s, and as the paper has it over ten frames from a true state.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.displacement.features import clip_features
from bunraku.apparel.displacement.player import ApparelPlayer
from bunraku.apparel.displacement.weights import DisplacementNetwork
from bunraku.body.layout import HANDLE_NAMES, HANDLE_PARENTS, JOINT_NAMES
from bunraku.core.skinning import skin
from bunraku.geometry.graph import unique_edges
from bunraku_lab.evaluation.apparel.clips import TrueClip
from bunraku_lab.evaluation.apparel.measures import edge_score, point_distance
from bunraku_lab.training.apparel.networks.refinement import RefinementNetwork, refined
from bunraku_lab.training.apparel.networks.seam import seam_of

__all__ = [
    "STRIDE", "Figures", "best_skinning", "mean_figures", "our_ten_frames", "part_weights", "ten_frame_spans",
    "whole_figures",
]  # fmt: skip

Figures = dict[str, float]
ROUNDS = 400  # of the fit of weights
STARTS = 4
TEN = 10
STRIDE = 6
"""Of so many frames of a whole clip one is looked at."""


def whole_figures(clip: TrueClip, moved: np.ndarray, truth: np.ndarray) -> Figures:
    """PMD of all, apparel and body [cm], and ELS, of all vertices in some frames, shapes (F, V, 3)."""
    clothed, cloth = clip.clothed, clip.clothed.apparel
    edges = unique_edges(np.asarray(clothed.faces, np.int64), len(clothed.rest))
    return {
        "PMD": 100 * float(point_distance(moved, truth).mean()),
        "PMD_a": 100 * float(point_distance(moved[:, cloth], truth[:, cloth]).mean()),
        "PMD_b": 100 * float(point_distance(moved[:, ~cloth], truth[:, ~cloth]).mean()),
        "ELS": edge_score(moved, clothed.rest, edges),
    }


def best_skinning(rest: np.ndarray, truth: np.ndarray, affine: np.ndarray) -> np.ndarray:
    """The weights, not negative and with a sum of 1, that put vertices nearest to the truth of some frames, shape (V,
    J).

    The sum of squares is a quadratic of the weights, whose least on the simplex accelerated projected gradients find.

    Args:
        rest: In the rest pose [m], shape (V, 3).
        truth: In F frames [m], shape (F, V, 3).
        affine: Affine transforms of the joints, shape (F, J, 3, 4).
    """
    square = np.zeros((len(rest), affine.shape[1], affine.shape[1]))
    target = np.zeros((len(rest), affine.shape[1]))
    for pose, wanted in zip(affine.astype(np.float64), truth.astype(np.float64), strict=True):
        away = np.einsum("jac,vc->vja", pose[..., :3], rest) + pose[..., 3][None] - wanted[:, None]  # sums are 1
        square += away @ away.transpose(0, 2, 1)
    scale = np.maximum(np.trace(square, axis1=1, axis2=2), 1e-12)[:, None]
    weights = np.full(target.shape, 1 / target.shape[1])
    ahead, speed = weights, 1.0
    for _ in range(ROUNDS):
        gradient = np.einsum("vij,vj->vi", square, ahead) / scale
        moved = _on_simplex(ahead - gradient)
        faster = (1 + np.sqrt(1 + 4 * speed**2)) / 2
        ahead, weights, speed = moved + (speed - 1) / faster * (moved - weights), moved, faster
    return np.asarray(weights)


def _on_simplex(values: np.ndarray) -> np.ndarray:
    """The nearest rows that are not negative and have a sum of 1, shape (V, J)."""
    falling = -np.sort(-values, axis=1)
    over = (np.cumsum(falling, axis=1) - 1) / np.arange(1, values.shape[1] + 1)
    count = (falling > over).sum(axis=1)
    return np.maximum(values - over[np.arange(len(values)), count - 1][:, None], 0)


def part_weights(seen: np.ndarray) -> np.ndarray:
    """Weights of the joints from those that the Mesh Handle Predictor gives a clothed mesh, of which it sees nothing
    else, shape (V, 30) -> (V, 22); those of its other parts go to the joint above.
    """
    out = np.zeros((len(seen), len(JOINT_NAMES)))
    for handle in range(len(HANDLE_NAMES)):
        above = handle
        while HANDLE_NAMES[above] not in JOINT_NAMES:
            above = HANDLE_PARENTS[above]
        out[:, JOINT_NAMES.index(HANDLE_NAMES[above])] += seen[:, handle]
    return out / out.sum(axis=1, keepdims=True)


def ten_frame_spans(clip: TrueClip) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Ten frames at `STARTS` places of a clip: the first, affine transforms of the joints (10, 22, 3, 4), and where all
    vertices are [m], (10, V, 3).
    """
    everything = np.arange(len(clip.clothed.rest))
    for first in np.linspace(3, len(clip.transforms) - TEN - 1, STARTS).astype(int):
        span = slice(first, first + TEN)
        short = replace(clip, transforms=clip.transforms[span], offsets=clip.offsets[span])
        yield int(first), short.affine, short.truth(everything)


def mean_figures(rows: Sequence[Figures]) -> Figures:
    """The mean of each figure."""
    return {key: float(np.mean([one[key] for one in rows])) for key in rows[0]}


def our_ten_frames(
    clip: TrueClip, guessed: ClothedCharacter, weights: np.ndarray, network: DisplacementNetwork,
    refinement: RefinementNetwork | None,
) -> Figures:  # fmt: skip
    """The mean figures of ours over ten frames from true states.

    Args:
        clip: The clip.
        guessed: The character as our networks see it.
        weights: Of the joints by the body network, shape (V, J).
        network: Of the displacement.
        refinement: Of where body and apparel meet.
    """
    found = []
    for first, affine, truth in ten_frame_spans(clip):
        moved = np.array(skin(clip.clothed.rest, weights, affine), np.float32)
        if guessed.apparel.any():
            moved = _from_true_state(clip, guessed, network, first, moved)
            if refinement is not None:
                seam = seam_of(guessed, weights)
                moved = np.stack([refined(refinement, seam, *pair) for pair in zip(moved, affine, strict=True)])
        found.append(whole_figures(clip, moved, truth))
    return mean_figures(found)


def _from_true_state(
    clip: TrueClip, guessed: ClothedCharacter, network: DisplacementNetwork, first: int, moved: np.ndarray
) -> np.ndarray:
    """The skinned vertices with apparel as the network moves it on from the three true frames before `first`."""
    player = ApparelPlayer(guessed, network, safe=False)
    player.start(clip.transforms[0])
    assert player.features is not None
    for pose in clip.transforms[: first - 3]:
        player.features.advance(pose)
    before = slice(first - 3, first)
    known = replace(clip, transforms=clip.transforms[before], offsets=clip.offsets[before])
    own = player.nodes.vertex
    away = known.truth(own) - replace(known, clothed=guessed).carried(own)
    turns = np.stack([one.turns for one in clip_features(guessed, player.nodes, clip.transforms[:first])])[-3:]
    player.know(np.einsum("nmba,nmb->nma", turns, away) / guessed.scale, known.transforms)
    for row, pose in enumerate(clip.transforms[first : first + TEN]):
        moved[row, player.carrier.vertices] = player.advance(pose)
    return moved
