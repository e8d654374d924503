"""The table of the Mesh Handle Predictor (`bunraku evaluate handles`); definitions are in `docs/evaluation.md`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from bunraku.anatomy.handles.orientation import Orientation, guess_orientation
from bunraku.anatomy.handles.orientation_evidence import kind_weights
from bunraku.anatomy.handles.predict import predict_handles
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.axes import ORIENTATIONS, right_angle_rotations, upright_rotation
from bunraku.core.geometry.surface import vertex_areas
from bunraku.core.motion import HandleMotion
from bunraku.core.parallel import run_parallel
from bunraku.core.skinning import skin
from bunraku.errors import BunrakuError, OptionError
from bunraku_lab.datasets.characters.training_character import AugmentConfig, forward_kinematics, random_pose
from bunraku_lab.evaluation.handles import measures as measure
from bunraku_lab.evaluation.handles.measures import FAR, carried, resampled, stretch_of
from bunraku_lab.evaluation.handles.rest_poses import REST_POSES, posed_limbs
from bunraku_lab.evaluation.handles.subjects import Subject, find_files, load_subject, subject, subject_name
from bunraku_lab.evaluation.report import Bar, measured_in, percent, reached_bars

BARE, RULED = ".obj", ".glb"
"""Formats that a character is judged in: one that does not say how it stands, and one whose rule is +Y up."""


def measure_orientation(one: Subject) -> dict[str, Any]:
    """How often a character is set up rightly, without its rig.

    Turning a mesh by right angles permutes what is seen of it and changes nothing else, so it is looked at once, and
    each of the 24 ways in which it may lie is judged from that.

    Args:
        one: The character, facing +Z; its place about the origin is that of its file.

    Returns:
        orientation_creatures or orientation_humanoids: share of the 24 orientations in which a file without a rule may
        have it from which it is turned upright and to the front. orientation_up, orientation_front: share whose up axis
        is right, and whose front is the likeliest given the right up. orientation_upright: whether it is left alone as
        it stands in a file with a rule. orientation_warned: of the wrong ones, the share that is called a guess; None
        where none is wrong.
    """
    seen = guess_orientation(one.character, prior=np.ones(len(ORIENTATIONS))).probabilities
    ups, fronts, both, warned = [], [], [], []
    for up, front in ORIENTATIONS:
        guess = _judged(seen[_permutation(up, front)], BARE)
        ups.append(guess.up == up)
        given = [guess.probability(*axes) if axes[0] == up else -1.0 for axes in ORIENTATIONS]
        fronts.append(ORIENTATIONS[int(np.argmax(given))][1] == front)
        both.append(guess.likeliest == (up, front))
        if not both[-1]:
            warned.append(not guess.sure)
    standing = _judged(seen, RULED)
    upright = standing.likeliest == ("+y", "+z")
    if not upright:
        warned.append(not standing.sure)
    return {
        "orientation_humanoids" if one.humanoid else "orientation_creatures": float(np.mean(both)),
        "orientation_up": float(np.mean(ups)), "orientation_front": float(np.mean(fronts)),
        "orientation_upright": float(upright), "orientation_warned": float(np.mean(warned)) if warned else None,
    }  # fmt: skip


def _judged(seen: np.ndarray, suffix: str) -> Orientation:
    chances = seen * kind_weights(suffix)
    return Orientation.of(chances / chances.sum())


def _permutation(up: str, front: str) -> np.ndarray:
    """For each of `ORIENTATIONS` of a mesh that was laid down: the one that it was when the mesh stood, shape (24,)."""
    rotations = right_angle_rotations()
    before = rotations @ upright_rotation(up, front).T
    return np.asarray((before[:, None] == rotations[None]).all(axis=(2, 3)).argmax(axis=1))


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
    """All measures of one character but resolution; None where one does not apply to it."""
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
        from bunraku_lab.baselines.skinning import embedded_bone_heat, geodesic_clusters

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
    from bunraku.files import Source, clip_names, load_animation, load_character
    from bunraku.retarget.to_reference import handle_motion_of_mesh

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
            out.append(handle_motion_of_mesh(
                one.character.vertices, posed, handles.weights, handles.positions, one.truth.areas, CLIP_RATE,
            ))  # fmt: skip
    return out


def _walk(one: Subject, handles: Handles) -> dict[str, float]:
    """How far edges stretch when the character walks; `whole_in_walks` is 1 where none is torn."""
    from bunraku.pipelines.animate import animate

    walk = animate(one.character, WALK, seconds=WALK_SECONDS, seed=0, handles=handles, candidates=1)
    found = stretch_of(one.character, handles, walk.motion)
    return found | {"whole_in_walks": float(found["most_stretched"] <= FAR)}


@cache
def _generated() -> HandleMotion:
    from bunraku.generation.generate import generate_motions
    from bunraku.language.parse import clauses_of

    return generate_motions([clauses_of([(SENTENCE, 4.0)])])[0]


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


RESAMPLED = 30
"""Characters on which resolutions are compared, evenly over the list."""
Load = Callable[[], Subject]

# Goals, set before anything was measured.
BARS: dict[str, Bar] = {
    "root_error": Bar("root: first handle to the root joint, over the height", most=0.03, show=percent(2)),
    "part_purity": Bar("part purity: vertices of a part that share its main handle", least=0.9, show=percent(1)),
    "part_purity_detailed": Bar("part purity of detailed people", least=0.9, show=percent(1)),
    "same_meaning": Bar(
        "same meaning: named parts whose main handle is the reference body's", least=0.9, show=percent(1)
    ),
    "same_meaning_vertices": Bar("  the same, vertex by vertex", show=percent(1)),
    "pose_error": Bar("pose error: random poses, over the height", most=0.015, show=percent(2)),
    "pose_error_creatures": Bar("pose error of non-humanoids", most=0.015, show=percent(2)),
    "pose_error_clusters": Bar("  of 30 geodesic k-means clusters", show=percent(2)),
    "pose_error_bone_heat": Bar("  of bone heat on an embedded skeleton", show=percent(2)),
    "pose_error_together": Bar("  of the handles, their motions fitted to one another", show=percent(2)),
    "pose_error_bone_heat_together": Bar("  of bone heat, fitted so", show=percent(2)),
    "resolution_l1": Bar(
        "resolution: L1 difference of weights at 1k, 5k and 50k vertices", most=0.05, show=measured_in("", 3)
    ),
    "rest_pose_agreement": Bar(
        "rest pose: main handle unchanged in A, arms down and sitting", least=0.9, show=percent(1)
    ),
    "orientation_creatures": Bar("orientation: non-humanoids set up from all 24", least=0.9, show=percent(1)),
    "orientation_humanoids": Bar("  of humanoids", show=percent(1)),
    "orientation_up": Bar("  up alone, of all", show=percent(1)),
    "orientation_front": Bar("  front given up, of all", show=percent(1)),
    "orientation_upright": Bar("orientation: left alone as a glTF that stands", least=0.98, show=percent(1)),
    "orientation_warned": Bar("orientation: wrong ones that are called a guess", least=1.0, show=percent(1)),
    "top4_error": Bar("top 4: error of four weights a vertex in motion, over the height", most=0.001, show=percent(2)),
    "stretched_edges": Bar("stretch: edges longer than twice their length in a walk", most=0.001, show=percent(2)),
    "whole_in_walks": Bar("stretch: characters with no edge over four times its length", least=0.95, show=percent(1)),
}
"""The measures in the order of the table."""


def folder_subjects(folder: Path, everything: bool = False) -> dict[str, Load]:
    """How to load each character of a folder (see `bunraku_lab.evaluation.handles.subjects.find_files`), by name."""
    return {
        subject_name(folder, file): partial(load_subject, file, subject_name(folder, file))
        for file in find_files(folder, everything)
    }


def code_made_subjects(count: int = 30) -> dict[str, Load]:
    """How to make each of the characters made by code that no training sees, by name."""
    from bunraku_lab.synthetic.families import EVALUATION_SEED, code_made_names

    return {
        f"code_made/{family}_{seed}": partial(_code_made, family, seed)
        for family, seed in code_made_names(count, EVALUATION_SEED)
    }


def _code_made(family: str, seed: int) -> Subject:
    from bunraku_lab.synthetic.families import code_made_character

    return subject(code_made_character(family, seed), f"code_made/{family}_{seed}")


def _measured(
    predict: Predict, reference: Reference, baselines: bool, seed: int, subjects: list[tuple[str, Load]]
) -> list[dict[str, Any] | str]:
    """The row of each character, or why there is none."""
    out: list[dict[str, Any] | str] = []
    for _, load in subjects:
        try:
            one = load()
            out.append(measure_subject(one, predict, reference, baselines, seed) | measure_orientation(one))
        except BunrakuError as error:
            out.append(str(error))
    return out


def _lost(reason: str) -> dict[str, Any] | str:
    return reason


def _evenly(names: list[str], count: int) -> set[str]:
    return {names[i] for i in np.unique(np.linspace(0, len(names) - 1, count).round().astype(int))}


def _mean(rows: Iterable[Mapping[str, float | None]], key: str) -> float | None:
    values = [value for row in rows if (value := row.get(key)) is not None]
    return float(np.mean(values)) if values else None


def evaluate_handles(
    subjects: dict[str, Load], *, detailed: dict[str, Load] | None = None, checkpoint: str | Path | None = None,
    baselines: bool = True, seed: int = 0, jobs: int | str = 1,
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Measure the predictor on characters.

    Args:
        subjects: How to load each character, by name (`folder_subjects`, `code_made_subjects`).
        detailed: Detailed people, of whom only the purity of parts is taken (`detailed_subjects`).
        checkpoint: Weights of the predictor; the shipped ones when None.
        baselines: Also pose the characters by clusters and by bone heat.
        seed: Of the random poses and of the clusters.
        jobs: How many processes share the characters, or "ray" for a cluster whose machines see the same files.

    Returns:
        Numbers and lists that JSON can say: the measures of `BARS` (shares, or seconds; None where no character fits
        one), "bars", "reached", "counts", "left_out" (name: reason), "characters" with a row for each, and "detailed"
        with the part purity of each detailed person.

    Raises:
        OptionError: None of the characters can be measured.
        WeightsError: The checkpoint is missing or does not fit.
        MissingExtraError: ray is not installed.
    """
    report = progress or (lambda stage, share: None)
    predict: Predict = partial(predict_handles, checkpoint=checkpoint)
    reference = Reference.of(predict)
    work = partial(_measured, predict, reference, baselines, seed)
    batches = [[(name, load)] for name, load in subjects.items()]
    alone = ((batch[0], work(batch)[0]) for batch in batches)
    found: dict[str, dict[str, Any] | str] = {}
    for (name, _), result_of in alone if jobs == 1 else run_parallel(work, batches, jobs, _lost):
        found[name] = result_of
        report("characters", len(found) / len(subjects))
    rows_by_name = {name: found[name] for name in subjects}
    rows = [row for row in rows_by_name.values() if isinstance(row, dict)]
    left_out = {name: reason for name, reason in rows_by_name.items() if isinstance(reason, str)}
    if not rows:
        raise OptionError(
            f"none of the {len(subjects)} characters can be measured "
            f"({next(iter(left_out.values()), 'there are none')})"
        )
    chosen = _evenly([row["name"] for row in rows], RESAMPLED)
    for number, row in enumerate(row for row in rows if row["name"] in chosen):
        row["resolutions"] = resolution_differences(subjects[row["name"]](), predict)
        row["resolution_l1"] = float(np.mean(list(row["resolutions"].values())))
        report("resolutions", (number + 1) / len(chosen))
    fine = _detailed(detailed or {}, {row["name"]: row["part_purity"] for row in rows}, predict, left_out, report)
    result: dict[str, Any] = {key: _mean(rows, key) for key in BARS}
    result["part_purity_detailed"] = float(np.mean(list(fine.values()))) if fine else None
    result["pose_error_creatures"] = _mean((row for row in rows if not row["humanoid"]), "pose_error")
    parts = [right for row in rows for right in row.get("parts", {}).values()]
    result["same_meaning"] = float(np.mean(parts)) if parts else None
    result["bars"] = {key: bar.bar for key, bar in BARS.items() if bar.bar is not None}
    result["reached"] = reached_bars(BARS, result)
    rivals = [result[key] for key in ("pose_error_clusters", "pose_error_bone_heat") if result[key] is not None]
    if rivals and result["reached"]["pose_error"]:
        result["reached"]["pose_error"] = bool(result["pose_error"] < min(rivals))
    result["counts"] = {
        "characters": len(rows), "humanoids": sum(row["humanoid"] for row in rows), "resampled": len(chosen),
        "detailed": len(fine),
    }  # fmt: skip
    return result | {"left_out": left_out, "characters": rows, "detailed": fine}


def _detailed(
    people: dict[str, Load], known: dict[str, float | None], predict: Predict, left_out: dict[str, str],
    report: Callable[[str, float], None],
) -> dict[str, float]:  # fmt: skip
    """Part purity of each detailed person by name; those that are measured already are not looked at again."""
    out: dict[str, float] = {}
    for number, (name, load) in enumerate(people.items()):
        try:
            value = known[name] if name in known else purity_of(load(), predict)
            if value is not None:
                out[name] = value
        except BunrakuError as error:
            left_out[name] = str(error)
        report("detailed people", (number + 1) / len(people))
    return out
