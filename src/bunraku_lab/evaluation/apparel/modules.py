"""The modules of MMDMC one by one: the mask, the body's weights (Table 4), and what each adds (Table 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bunraku.apparel.body.network import load_body
from bunraku.apparel.body.predict import body_weights
from bunraku.apparel.displacement.network import DisplacementNetwork
from bunraku.apparel.fitting import fitted_wearer
from bunraku.apparel.refinement.network import RefinementNetwork, refined
from bunraku.apparel.refinement.seam import seam_of
from bunraku.apparel.refinement.tiled import found_wearer, tiled
from bunraku.apparel.segmentation.predict import find_apparel
from bunraku.core.skinning import skin
from bunraku.errors import WeightsError
from bunraku.geometry.graph import unique_edges
from bunraku.nn.checkpoints import shipped_checkpoint
from bunraku_lab.evaluation.apparel.clips import TrueClip
from bunraku_lab.evaluation.apparel.measures import edge_score, point_distance

__all__ = ["body_table", "mask_scores", "module_row"]

STRIDE = 6
MOST = 2000  # vertices that distances are taken of


def mask_scores(clip: TrueClip, masks: Path | None = None) -> dict[str, float]:
    """Intersection over union of the mask that is found, and the mean error of log10 stiffness where there is
    apparel.
    """
    wearer = clip.wearer
    found = find_apparel(wearer.rest, wearer.faces, wearer.joints, masks)
    both, any_ = (found.mask & wearer.apparel).sum(), (found.mask | wearer.apparel).sum()
    error = np.abs(found.stiffness - wearer.stiffness[wearer.part])[wearer.apparel].mean()
    return {"iou": float(both / max(any_, 1)), "stiffness": float(error)}


def module_row(
    clip: TrueClip, network: DisplacementNetwork, masks: Path | None = None, body: Path | None = None,
    refinement: RefinementNetwork | None = None,
) -> dict[str, dict[str, float]]:  # fmt: skip
    """Table 3 for a clip: the body module alone, with apparel that is found, with the joint refinement, and with the
    file's mask. Body and apparel are skinned by predicted weights, and nothing of the file but its joints is used where
    it does not say so.
    """
    true = clip.wearer
    guessed, weights = found_wearer(true, masks, body)
    told = fitted_wearer(
        true.rest, true.faces, true.joints, weights, true.apparel,
        true.stiffness[true.part] * true.apparel, true.damping[true.part] * true.apparel,
    )  # fmt: skip
    frames = np.arange(0, len(clip.transforms), STRIDE)
    short = replace(clip, transforms=clip.transforms[frames], offsets=clip.offsets[frames])
    truth = short.truth(np.arange(len(true.rest)))
    bare = np.asarray(skin(true.rest, weights, short.affine))
    rows = {"body module": _whole(clip, bare, truth)}
    for wearer, name in ((guessed, ""), (told, ", true mask")):
        moved = tiled(wearer, clip.transforms, network, frames)
        rows[f"body + apparel{name}"] = _whole(clip, moved, truth)
        if refinement is not None:
            seam = seam_of(wearer, weights)
            merged = np.stack([refined(refinement, seam, *pair) for pair in zip(moved, short.affine, strict=True)])
            rows[f"with joint refinement{name}"] = _whole(clip, merged, truth)
    return rows


def _whole(clip: TrueClip, moved: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """PMD of all, apparel and body [cm], and ELS of the whole mesh."""
    wearer = clip.wearer
    cloth = wearer.apparel
    edges = unique_edges(np.asarray(wearer.faces, np.int64), len(wearer.rest))
    return {
        "PMD": 100 * float(point_distance(moved, truth).mean()),
        "PMD_a": 100 * float(point_distance(moved[:, cloth], truth[:, cloth]).mean()),
        "PMD_b": 100 * float(point_distance(moved[:, ~cloth], truth[:, ~cloth]).mean()),
        "ELS": edge_score(moved, wearer.rest, edges),
    }


def body_table(clips: Sequence[TrueClip], bodies: Sequence[Path]) -> dict[str, dict[str, float]]:
    """Table 4: body networks by what they do with geodesic distances; apparel follows the joints in the truth.

    Args:
        clips: What is measured on.
        bodies: Checkpoints; the shipped one when empty.
    """
    paths = list(bodies)
    if not paths:
        try:
            paths = [shipped_checkpoint("apparel-body")]
        except WeightsError:
            return {}
    out: dict[str, dict[str, float]] = {}
    for path in paths:
        rows = []
        for clip in {clip.name: clip for clip in clips}.values():
            rows.append(_body_row(clip, path))
        out[load_body(path).config.geodesics] = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
    return out


def _body_row(clip: TrueClip, path: Path) -> dict[str, float]:
    wearer = clip.wearer
    few = slice(0, None, 3 * STRIDE)
    short = replace(clip, transforms=clip.transforms[few], offsets=clip.offsets[few])
    chosen = np.linspace(0, len(wearer.rest) - 1, min(MOST, len(wearer.rest))).astype(np.int64)
    weights = body_weights(wearer.rest, wearer.faces, wearer.joints, path)
    everything = np.arange(len(wearer.rest))
    truth, moved = short.carried(everything), np.array(skin(wearer.rest, weights, short.affine))
    cloth = wearer.apparel[chosen]
    edges = unique_edges(np.asarray(wearer.faces, np.int64), len(wearer.rest))
    gap = np.linalg.norm(moved[:, chosen] - truth[:, chosen], axis=-1).mean(axis=0)
    return {
        "PMD": 100 * float(gap.mean()), "PMD_a": 100 * float(gap[cloth].mean()),
        "PMD_b": 100 * float(gap[~cloth].mean()),
        "ELS": edge_score(moved, wearer.rest, edges),
    }  # fmt: skip
