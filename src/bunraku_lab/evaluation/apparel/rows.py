"""The row of one clip: learned apparel beside what skinning alone gives, against the truth."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from bunraku.apparel.body_volume import BodyVolume
from bunraku.apparel.displacement.body_points import body_points
from bunraku.apparel.displacement.features import clip_features
from bunraku.apparel.displacement.player import SAFE_POINTS, ApparelPlayer
from bunraku.apparel.displacement.safety import Safety
from bunraku.apparel.displacement.weights import DisplacementNetwork
from bunraku.core.skinning import posed_points
from bunraku_lab.datasets.apparel.body_inside import deep_inside
from bunraku_lab.evaluation.apparel.clips import TrueClip
from bunraku_lab.evaluation.apparel.measures import edge_score, oracle_skinning, point_distance

__all__ = ["clip_row", "drift_row", "frame_milliseconds", "insides", "safe_truth", "ten_frames"]

STRIDE = 10  # frames from one whose edges and insides are measured to the next
ORACLE = 60  # vertices that the best skinning is fitted for
DEEPEST = 300  # vertices whose insides are measured


def clip_row(clip: TrueClip, network: DisplacementNetwork, *, nodes: int = 256, slow: bool = True) -> dict[str, Any]:
    """Errors of a clip that begins from the rest pose [m], mean over its frames, and scores.

    Args:
        clip: The clip.
        network: The network.
        nodes: Most nodes.
        slow: Whether the best static skinning and insides are computed too.
    """
    chosen = clip.sample()
    truth, rigid = clip.truth(chosen), clip.carried(chosen)
    clothed = clip.clothed
    nearest = np.linalg.norm(clothed.rest[chosen][:, None] - clothed.joints[None], axis=-1).argmin(axis=1)
    near = np.asarray(posed_points(clip.affine[:, nearest], clothed.rest[chosen]))
    row: dict[str, Any] = {
        "name": clip.name, "motion": clip.motion, "vertices": len(clothed.rest),
        "apparel": float(clothed.apparel.mean()),
        "rigid": float(point_distance(rigid, truth).mean()), "nearest_joint": float(point_distance(near, truth).mean()),
    }  # fmt: skip
    variants = {"head": {"safe": False, "recurrent": False}, "learned": {"safe": False}, "safe": {}}
    if network.recurrent is None or network.recurrent.world:
        variants.pop("head")
    vertices = np.flatnonzero(clothed.apparel)
    index = np.full(len(clothed.rest), -1)
    index[vertices] = np.arange(len(vertices))
    edges, rest = index[clip.edges()], clothed.rest[vertices]
    few = slice(0, None, STRIDE)
    true_all = replace(clip, transforms=clip.transforms[few], offsets=clip.offsets[few]).truth(vertices)
    row["els_truth"] = edge_score(true_all, rest, edges)
    shown = {"truth": true_all, "rigid": replace(clip, transforms=clip.transforms[few]).carried(vertices)}
    for name, how in variants.items():
        player = ApparelPlayer(clothed, network, nodes=nodes, **how)
        moved = player.clip(clip.transforms)
        errors = point_distance(moved[:, index[chosen]], truth)
        row[name] = float(errors.mean())
        row[f"{name}_2s"] = float(errors[:60].mean())
        row[f"{name}_els"] = edge_score(moved[few], rest, edges)
        shown[name] = moved[few]
    if slow:
        some = np.linspace(0, len(chosen) - 1, min(ORACLE, len(chosen))).astype(np.int64)
        best = oracle_skinning(clothed.rest[chosen[some]], truth[:, some], clip.affine)
        row["oracle_skinning"] = float(point_distance(best, truth[:, some]).mean())
        shown["truth_safe"] = safe_truth(clip, nodes)[few]
        row |= insides(clip, vertices, few, shown)
    return row


def insides(clip: TrueClip, vertices: np.ndarray, few: slice, shown: dict[str, np.ndarray]) -> dict[str, float]:
    """Share of the apparel deeper than 1 cm in the body, of what is not there at rest.

    Args:
        clip: The clip.
        vertices: Of the apparel, shape (A,).
        few: The frames that are looked at.
        shown: By name, where these vertices are in these frames [m], each of shape (F, A, 3).
    """
    clothed = clip.clothed
    volume = BodyVolume.of_mesh(clothed.rest, clothed.faces, clothed.weights, clothed.apparel, clip.name)
    some = np.linspace(0, len(vertices) - 1, min(DEEPEST, len(vertices))).astype(np.int64)
    some = some[~deep_inside(volume, volume.rest, clothed.rest[vertices[some]])]
    if not len(some):
        return {}
    bodies = volume.posed(clip.affine[few])
    out = dict.fromkeys(shown, 0.0)
    for frame, body in enumerate(bodies):
        points = np.concatenate([moved[frame, some] for moved in shown.values()])
        deep = deep_inside(volume, body, points).reshape(len(shown), len(some)).mean(axis=1)
        for name, share in zip(shown, deep, strict=True):
            out[name] += float(share) / len(bodies)
    return {f"inside_{name}": value for name, value in out.items()}


def safe_truth(clip: TrueClip, nodes: int = 256) -> np.ndarray:
    """The truth after the safety stage: apparel vertices [m], shape (N, A, 3)."""
    from bunraku.apparel.displacement.carry import Carrier
    from bunraku.apparel.nodes import apparel_nodes

    clothed = clip.clothed
    own = apparel_nodes(clothed, nodes)
    carrier = Carrier(clothed, own)
    safety = Safety(clothed, own, body_points(clothed, SAFE_POINTS), carrier)
    affine = clip.affine
    turns = affine[:, own.joint, :, :3]
    true, carried = clip.truth(own.vertex), clip.carried(own.vertex)
    out = []
    for frame in range(len(affine)):
        kept = carried[frame] + safety.share * (true[frame] - carried[frame])
        positions, unposed = safety(kept, affine[frame])
        moved = (turns[frame].transpose(0, 2, 1) * (positions - carried[frame])[:, None, :]).sum(axis=-1)
        safe = carrier.positions(moved, affine[frame])
        out.append(safety.vertices(safe, unposed))
    return np.stack(out)


def ten_frames(clip: TrueClip, network: DisplacementNetwork, starts: int = 4, nodes: int = 256) -> dict[str, float]:
    """The paper's protocol: the ten frames after a true state. Mean errors [m] of the network, of parent-rigid skinning
    and of the true displacement kept as it was.
    """
    player = ApparelPlayer(clip.clothed, network, nodes=nodes, safe=False)
    frames = clip_features(clip.clothed, player.nodes, clip.transforms)
    turns = np.stack([frame.turns for frame in frames])
    own = player.nodes.vertex
    away = clip.truth(own) - clip.carried(own)
    states = np.einsum("nmba,nmb->nma", turns, away) / clip.clothed.scale
    vertices = player.carrier.vertices
    chosen = clip.sample()
    rows = np.searchsorted(vertices, chosen)
    truth, rigid = clip.truth(chosen), clip.carried(chosen)
    joints = clip.clothed.weights[chosen].argmax(axis=1)
    local = clip.affine[:, joints, :, :3]
    held = np.einsum("nmba,nmb->nma", local, truth - rigid)
    sums = np.zeros(3)
    for first in np.linspace(3, len(truth) - 11, starts).astype(int):
        player.start(clip.transforms[0])
        assert player.features is not None
        for pose in clip.transforms[: first - 3]:
            player.features.advance(pose)
        player.know(states[first - 3 : first], clip.transforms[first - 3 : first])
        moved = np.stack([player.advance(pose)[rows] for pose in clip.transforms[first : first + 10]])
        span = slice(first, first + 10)
        frozen = rigid[span] + np.einsum("nmab,mb->nma", local[span], held[first - 1])
        sums += [float(point_distance(points, truth[span]).mean()) for points in (moved, rigid[span], frozen)]
    learned, still, kept = sums / starts
    return {"learned": learned, "rigid": still, "frozen": kept}


def drift_row(clip: TrueClip, network: DisplacementNetwork, nodes: int = 256) -> dict[str, float]:
    """Errors of a long clip from rest [m]: in its second second and in its last one."""
    chosen = clip.sample()
    truth = clip.truth(chosen)
    player = ApparelPlayer(clip.clothed, network, nodes=nodes)
    player.start(clip.transforms[0])
    rows = np.searchsorted(player.carrier.vertices, chosen)
    errors = [float(np.linalg.norm(player.advance(pose)[rows] - truth[frame], axis=-1).mean())
              for frame, pose in enumerate(clip.transforms)]  # fmt: skip
    rigid = point_distance(clip.carried(chosen), truth)
    return {
        "second": float(np.mean(errors[30:60])), "last": float(np.mean(errors[-30:])), "all": float(np.mean(errors)),
        "rigid": float(rigid.mean()),
        "rigid_second": float(rigid[30:60].mean()), "rigid_last": float(rigid[-30:].mean()),
    }  # fmt: skip


def frame_milliseconds(clip: TrueClip, network: DisplacementNetwork, nodes: int = 256, frames: int = 60) -> float:
    """Time of a frame, median of some, the way back to the vertices included [ms]."""
    player = ApparelPlayer(clip.clothed, network, nodes=nodes)
    player.start(clip.transforms[0])
    times = []
    for pose in clip.transforms[:frames]:
        begin = time.perf_counter()
        player.advance(pose)
        times.append(time.perf_counter() - begin)
    return 1000 * float(np.median(times))
