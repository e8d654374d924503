"""The modules of MMDMC one by one: the mask, the body's weights (Table 4), and what each adds (Table 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bunraku.apparel.displacement.weights import DisplacementNetwork
from bunraku.apparel.fitting import fitted_clothes
from bunraku.apparel.segmentation.predict import find_apparel
from bunraku.core.skinning import skin
from bunraku.errors import WeightsError
from bunraku.geometry.graph import unique_edges
from bunraku_lab.evaluation.apparel.against import STRIDE, Figures, our_ten_frames, whole_figures
from bunraku_lab.evaluation.apparel.clips import TrueClip
from bunraku_lab.evaluation.apparel.measures import edge_score
from bunraku_lab.evaluation.apparel.names import OURS
from bunraku_lab.evaluation.apparel.rivals import floor_movers, mover_rows
from bunraku_lab.nn.checkpoints import lab_checkpoint
from bunraku_lab.training.apparel.networks.body import load_body
from bunraku_lab.training.apparel.networks.body_predict import body_weights
from bunraku_lab.training.apparel.networks.refinement import RefinementNetwork, refined
from bunraku_lab.training.apparel.networks.seam import seam_of
from bunraku_lab.training.apparel.networks.tiled import clothed_by_mask, tiled

__all__ = ["body_table", "mask_scores", "module_row"]

MOST = 2000  # vertices that distances are taken of


def mask_scores(clip: TrueClip, masks: Path | None = None) -> dict[str, float]:
    """Intersection over union of the mask that is found, and the mean error of log10 stiffness where there is
    apparel.
    """
    clothed = clip.clothed
    found = find_apparel(clothed.rest, clothed.faces, clothed.joints, masks)
    both, any_ = (found.mask & clothed.apparel).sum(), (found.mask | clothed.apparel).sum()
    error = np.abs(found.stiffness - clothed.stiffness[clothed.part])[clothed.apparel].mean()
    return {"iou": float(both / max(any_, 1)), "stiffness": float(error)}


def module_row(
    clip: TrueClip, network: DisplacementNetwork, masks: Path | None = None, body: Path | None = None,
    refinement: RefinementNetwork | None = None,
) -> tuple[dict[str, dict[str, float]], dict[str, dict[str, float]]]:  # fmt: skip
    """Tables 2 and 3 for a clip, from rest: the body module alone, with apparel that is found, with the joint
    refinement, and with the file's mask, but not its stiffness; and what needs no training
    (`evaluation.apparel.rivals`). Body and apparel are skinned by predicted weights, and nothing of the file but its
    joints is used where it does not say so. Then table 2 over ten frames from true states.
    """
    true = clip.clothed
    guessed, weights = clothed_by_mask(true, masks, body)
    found = find_apparel(true.rest, true.faces, true.joints, masks)
    given = fitted_clothes(true.rest, true.faces, true.joints, weights, true.apparel, found.stiffness, found.damping)
    frames = np.arange(0, len(clip.transforms), STRIDE)
    short = replace(clip, transforms=clip.transforms[frames], offsets=clip.offsets[frames])
    truth = short.truth(np.arange(len(true.rest)))
    bare = np.asarray(skin(true.rest, weights, short.affine))
    rows = {"body module": whole_figures(clip, bare, truth)}
    tens: dict[str, Figures] = {}
    for name, mover in floor_movers(true, truth, short.affine).items():
        rows[name], tens[name] = mover_rows(clip, mover)
    for clothed, name in ((guessed, ""), (given, ", true mask")):
        moved = tiled(clothed, clip.transforms, network, frames)
        rows[f"body + apparel{name}"] = whole_figures(clip, moved, truth)
        if refinement is not None:
            seam = seam_of(clothed, weights)
            merged = np.stack([refined(refinement, seam, *pair) for pair in zip(moved, short.affine, strict=True)])
            rows[f"with joint refinement{name}"] = whole_figures(clip, merged, truth)
    return rows, {**tens, OURS: our_ten_frames(clip, guessed, weights, network, refinement)}


def body_table(clips: Sequence[TrueClip], bodies: Sequence[Path]) -> dict[str, dict[str, float]]:
    """Table 4: body networks by what they do with geodesic distances; apparel follows the joints in the truth.

    Args:
        clips: What is measured on.
        bodies: Checkpoints; the shipped one when empty.
    """
    paths = list(bodies)
    if not paths:
        try:
            paths = [lab_checkpoint("apparel-body")]
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
    clothed = clip.clothed
    few = slice(0, None, 3 * STRIDE)
    short = replace(clip, transforms=clip.transforms[few], offsets=clip.offsets[few])
    chosen = np.linspace(0, len(clothed.rest) - 1, min(MOST, len(clothed.rest))).astype(np.int64)
    weights = body_weights(clothed.rest, clothed.faces, clothed.joints, path)
    everything = np.arange(len(clothed.rest))
    truth, moved = short.carried(everything), np.array(skin(clothed.rest, weights, short.affine))
    cloth = clothed.apparel[chosen]
    edges = unique_edges(np.asarray(clothed.faces, np.int64), len(clothed.rest))
    gap = np.linalg.norm(moved[:, chosen] - truth[:, chosen], axis=-1).mean(axis=0)
    return {
        "PMD": 100 * float(gap.mean()), "PMD_a": 100 * float(gap[cloth].mean()),
        "PMD_b": 100 * float(gap[~cloth].mean()),
        "ELS": edge_score(moved, clothed.rest, edges),
    }  # fmt: skip
