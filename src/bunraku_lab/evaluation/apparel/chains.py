"""Chains of apparel that are laid over the shape alone, against the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bunraku.apparel.chains.body_collisions import CHAIN_REPAIRS
from bunraku.apparel.chains.chain_rig import with_chains
from bunraku.apparel.chains.cloth_repairs import DressedChains
from bunraku.apparel.chains.from_shape import shape_chains
from bunraku.apparel.chains.moving import steady_simulation
from bunraku.core.animation import RigAnimation
from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.character import Character, Rig, top_influences
from bunraku_lab.evaluation.apparel.clips import RATE, TrueClip, edge_score, insides, point_distance

STRIDE = 10  # frames from one whose edges are measured to the next


def chained_clip(clip: TrueClip) -> tuple[np.ndarray, int]:
    """All vertices of a clip [m], shape (N, V, 3), and how many bodies flew away in what is shown."""
    clothed = clip.clothed
    transforms = np.tile(np.eye(4), (JOINT_COUNT, 1, 1))
    transforms[:, :3, 3] = clothed.joints
    rig = Rig(JOINT_NAMES, np.array(JOINT_PARENTS), transforms, *top_influences(clothed.weights, 4))
    character = Character(clip.name, clothed.rest, clothed.faces, rig)
    body = RigAnimation.of_world(character, clip.transforms[..., :3], clip.transforms[..., 3], RATE)
    made = with_chains(character, shape_chains(clothed), np.arange(JOINT_COUNT))
    if not made.chains:
        return body.vertices(), 0
    found = steady_simulation(made.on(body), made.rig(tied=False))
    moved, dressed = found.animation, DressedChains(made, clothed, np.arange(JOINT_COUNT), rig)
    for repair in CHAIN_REPAIRS:
        moved = repair(moved, dressed)
    return moved.vertices(), sum(one.frame >= 0 for one in found.report.recoveries)


def chain_row(clip: TrueClip) -> dict[str, Any]:
    """Mean errors of a clip from rest [m], of chains and of parent-rigid skinning, ELS of both and of the truth, and
    fly-aways, and the shares of all three that are deep in the body."""
    clothed, chosen, few = clip.clothed, clip.sample(), slice(0, None, STRIDE)
    truth = clip.truth(chosen)
    moved, lost = chained_clip(clip)
    vertices = np.flatnonzero(clothed.apparel)
    index = np.full(len(clothed.rest), -1)
    index[vertices] = np.arange(len(vertices))
    edges, rest = index[clip.edges()], clothed.rest[vertices]
    shown = {
        "rigid": clip.carried(vertices)[few], "chains": moved[few][:, vertices], "truth": clip.truth(vertices)[few],
    }  # fmt: skip
    return insides(clip, vertices, few, shown) | {
        "name": clip.name, "motion": clip.motion,
        "rigid": float(point_distance(clip.carried(chosen), truth).mean()),
        "chains": float(point_distance(moved[:, chosen], truth).mean()),
        "chains_els": edge_score(moved[few][:, vertices], rest, edges),
        "els_truth": edge_score(clip.truth(vertices)[few], rest, edges),
        "lost": lost,
    }  # fmt: skip


def chain_summary(rows: Sequence[dict[str, Any]]) -> dict[str, float | None]:
    """Error over that of rigid apparel (mean, and median of clips), ELS less the truth's, and clips with fly-aways."""
    if not rows:
        return {}
    ratios = [row["chains"] / max(row["rigid"], 1e-9) for row in rows]
    return {
        "chains_over_rigid": float(sum(row["chains"] for row in rows) / max(sum(row["rigid"] for row in rows), 1e-9)),
        "chains_mean_ratio": float(np.mean(ratios)),
        "chains_median_ratio": float(np.median(ratios)),
        "chains_worst_ratio": float(max(ratios)),
        "chains_els_minus_truth": float(np.mean([row["chains_els"] - row["els_truth"] for row in rows])),
        "chains_fly_aways": float(sum(row["lost"] > 0 for row in rows)),
        "chains_clips": float(len(rows)),
        "chains_inside_over_rigid": _inside(rows, "chains") / max(_inside(rows, "rigid"), 1e-9),
        "chains_inside_over_truth": _inside(rows, "chains") / max(_inside(rows, "truth"), 1e-9),
    }


def _inside(rows: Sequence[dict[str, Any]], which: str) -> float:
    return float(sum(row.get(f"inside_{which}", 0.0) for row in rows))
