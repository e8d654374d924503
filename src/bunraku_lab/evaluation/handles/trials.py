"""The trials of one character that `bunraku_lab.evaluation.handles.table` puts in its table."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any
from zlib import crc32

import numpy as np

from bunraku.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.errors import BunrakuError
from bunraku.geometry.surface import vertex_areas
from bunraku_lab.datasets.characters.training_character import AugmentConfig, forward_kinematics, random_pose
from bunraku_lab.evaluation.handles import measures as measure
from bunraku_lab.evaluation.handles.resampling import carried, resampled
from bunraku_lab.evaluation.handles.rest_poses import REST_POSES, posed_limbs
from bunraku_lab.evaluation.handles.stretch import FAR, stretch_of
from bunraku_lab.evaluation.handles.subjects import Subject

__all__ = ["Predict", "Reference", "measure_subject", "prediction_seconds", "purity_of", "resolution_differences"]

POSES = 4
MOST_POSED = 50_000
"""Vertices that are posed; of larger meshes an even share of them."""
MOST_FITTED = 5_000
"""Vertices on which the handles' motions are fitted to one another."""
POINTS = (1_000, 5_000, 50_000)
CLIPS, CLIP_FRAMES, CLIP_RATE = 3, 24, 10.0
WALK, WALK_SECONDS = "walks forward", 3.0
SENTENCE = "a person walks forward, then waves with the right hand"

Predict = Callable[[Character], Handles]


@dataclass(frozen=True)
class Reference:
    """What the predictor says of the reference body.

    Args:
        accepted: The handles that mean each named part there (see `accepted_handles`).
    """

    accepted: dict[str, set[int]]

    @staticmethod
    def of(predict: Predict) -> Reference:
        """Look at the reference body with a predictor."""
        body = reference_body()
        weights = predict(Character("reference", body.vertices, body.faces)).weights
        return Reference(
            measure.accepted_handles(weights, vertex_areas(body.vertices, body.faces), body.handle_weights)
        )


def measure_subject(
    one: Subject, predict: Predict, reference: Reference, baselines: bool = True, seed: int = 0
) -> dict[str, Any]:
    """All measures of one character but resolution and speed; None where one does not apply to it."""
    handles, truth, keep = predict(one.character), one.truth, one.surface
    weights, areas = handles.weights[keep], truth.areas[keep]
    row: dict[str, Any] = {"name": one.name, "vertices": int(keep.sum()), "humanoid": one.humanoid}
    row["part_purity"] = measure.part_purity(measure.main_handles(weights), truth.weights[keep])
    if one.humanoid:
        row["root_error"] = measure.root_error(handles.positions[0], truth.root, one.height)
        parts, share = measure.part_meaning(weights, areas, truth.target[keep], reference.accepted)
        row |= {"same_meaning": float(np.mean(list(parts.values()))), "same_meaning_vertices": share, "parts": parts}
        row |= _rest_poses(one, predict)
    row |= pose_errors(one, weights, baselines, seed)
    row["top4_error"] = _top4(one, handles)
    return row | _walk(one, handles)


def purity_of(one: Subject, predict: Predict) -> float | None:
    """Part purity of one character; None where no vertex is surely of one part."""
    weights = predict(one.character).weights[one.surface]
    return measure.part_purity(measure.main_handles(weights), one.truth.weights[one.surface])


def _random(one: Subject, seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, crc32(one.name.encode())])  # whatever other characters are there


def pose_errors(one: Subject, weights: np.ndarray, baselines: bool, seed: int) -> dict[str, float]:
    """How far random poses by the handles are from those by the rig, over the height (`pose_error` and its rivals).

    Args:
        one: The character.
        weights: Of its handles at the vertices of its surface, shape (S, K).
        baselines: Whether clusters and bone heat are measured too.
        seed: Of the poses.
    """
    truth, rng = one.truth, _random(one, seed)
    keep = np.flatnonzero(one.surface)
    some = np.unique(np.linspace(0, len(keep) - 1, min(len(keep), MOST_POSED)).astype(int))
    keep, weights = keep[some], weights[some]
    angle = AugmentConfig().pose_angle
    frames = np.stack(
        [forward_kinematics(truth.joints, truth.parents, random_pose(rng, truth, angle)) for _ in range(POSES)]
    )
    rest = truth.vertices[keep]
    posed = skin(rest, truth.weights[keep], frames)
    fewer = np.unique(np.linspace(0, len(rest) - 1, min(len(rest), MOST_FITTED)).astype(int))
    out = {
        "pose_error": measure.pose_error(rest, posed, weights, one.height),
        "pose_error_together": measure.pose_error(
            rest[fewer], posed[:, fewer], weights[fewer], one.height, together=True
        ),
    }
    if baselines:
        from bunraku_lab.baselines.bone_heat import embedded_bone_heat
        from bunraku_lab.baselines.clusters import geodesic_clusters

        rivals = {
            "pose_error_clusters": lambda: geodesic_clusters(one.character.vertices, one.character.faces, seed=seed),
            "pose_error_bone_heat": lambda: embedded_bone_heat(one.character.vertices, one.character.faces),
        }
        for name, rival in rivals.items():
            rivals_weights = rival()[keep]
            out[name] = measure.pose_error(rest, posed, rivals_weights, one.height, rooted=False)
            if name == "pose_error_bone_heat":
                some = rivals_weights[fewer]
                out["pose_error_bone_heat_together"] = measure.pose_error(
                    rest[fewer], posed[:, fewer], some, one.height, False, together=True
                )
    return out


def _rest_poses(one: Subject, predict: Predict) -> dict[str, Any]:
    """Agreement of each rest pose with the T-pose, and their mean."""
    weights = []
    for pose in REST_POSES:
        moved = Character(one.name, posed_limbs(one.truth, pose), one.character.faces)
        weights.append(predict(moved).weights[one.surface])
    shares = {
        pose: measure.same_main_handle(weights[0], other)
        for pose, other in zip(REST_POSES[1:], weights[1:], strict=True)
    }
    return {"rest_pose_agreement": float(np.mean(list(shares.values()))), "rest_poses": shares}


def _top4(one: Subject, handles: Handles) -> float:
    """Truncation error in the file's own clips, or, without any, in a generated motion."""
    motions = _clips(one, handles) or [_fitted(one, handles)]
    keep, cut = one.surface, handles.top(4)
    errors = [
        measure.truncation_error(
            one.character.vertices[keep],
            handles.weights[keep],
            cut.weights[keep],
            motion.transforms(handles.positions),
            one.height,
        )
        for motion in motions
    ]
    return float(np.mean(errors))


def _clips(one: Subject, handles: Handles) -> list[HandleMotion]:
    """A few of the file's clips as motions of the handles, by weighted registration (section A.2 of TapMo)."""
    from bunraku.formats.gltf.read import Source
    from bunraku.io.play import clip_names, load_animation
    from bunraku.io.registry import load_character
    from bunraku.retarget.from_mesh import handle_motion_of_mesh

    if one.path is None:
        return []
    source = load_character(one.path).source
    names = clip_names(source.document) if isinstance(source, Source) else []
    out = []
    for number in np.unique(np.linspace(0, len(names) - 1, CLIPS).round().astype(int)) if names else ():
        try:
            animation = load_animation(one.path, int(number), CLIP_RATE)
        except BunrakuError:  # a clip of morph targets, or a broken one
            continue
        count = len(animation.motion)
        frames = np.unique(np.linspace(0, count - 1, CLIP_FRAMES).round().astype(int))
        posed = animation.vertices(frames) @ one.turn.T.astype(np.float32)
        if np.isfinite(posed).all():
            out.append(
                handle_motion_of_mesh(
                    one.character.vertices, posed, handles.weights, handles.positions, one.truth.areas, CLIP_RATE
                )
            )
    return out


def _walk(one: Subject, handles: Handles) -> dict[str, float]:
    """How far edges are stretched when the character walks: `stretched_edges`, `most_stretched`, and
    `whole_in_walks`, 1 where none is torn.
    """
    from bunraku.pipelines.animate import animate

    walk = animate(one.character, WALK, seconds=WALK_SECONDS, seed=0, handles=handles, candidates=1)
    found = stretch_of(one.character, handles, walk.motion)
    return found | {"whole_in_walks": float(found["most_stretched"] <= FAR)}


@cache
def _generated() -> HandleMotion:
    from bunraku.diffusion.generation.generate import generate_motion

    return generate_motion(SENTENCE, 4.0, seed=0)


def _fitted(one: Subject, handles: Handles) -> HandleMotion:
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.retarget.fit import fit_motion

    return fit_motion(_generated(), Anatomy.of(one.character, handles))


def resolution_differences(one: Subject, predict: Predict) -> dict[str, float]:
    """L1 difference of the weights of a character at about 1k, 5k and 50k vertices, for each pair.

    Two meshes are compared at the vertices of the coarser one; the finer one's weights are read at the closest points
    of its surface. (The other way about, the coarse mesh's triangles would blur what is sharp on the fine one: with the
    very same weights on both, that alone comes to about 0.1 on a person.)
    """
    meshes = [resampled(one.character, count) for count in POINTS]
    weights = [predict(mesh).weights for mesh in meshes]
    out = {}
    for coarse, fine in ((0, 1), (1, 2), (0, 2)):
        read = carried(weights[fine], meshes[fine].vertices, meshes[fine].faces, meshes[coarse].vertices)
        out[f"{POINTS[coarse] // 1000}k-{POINTS[fine] // 1000}k"] = measure.weight_difference(weights[coarse], read)
    return out


def prediction_seconds(count: int, predict: Predict, repeats: int = 3) -> float:
    """Time of a prediction for the reference body with this many vertices, best of some [s]."""
    body = reference_body()
    mesh = resampled(Character("reference", body.vertices, body.faces), count)
    predict(mesh)
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        predict(mesh)
        times.append(time.perf_counter() - start)
    return min(times)
