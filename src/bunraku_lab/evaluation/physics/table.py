"""What simulated apparel is worth: the table of `bunraku evaluate physics`."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.apparel.body_volume import BodyVolume
from bunraku.apparel.skinning import eq4_transforms
from bunraku.apparel.unified import UnifiedBody
from bunraku.core.character import Character
from bunraku.core.motion import HandleMotion
from bunraku.core.rig_animation import RigAnimation
from bunraku.core.skinning import skin
from bunraku.errors import BunrakuError, CharacterError
from bunraku.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix, quaternion_slerp
from bunraku.nn.spread import spread
from bunraku.physics.apparel_rig import ApparelRig
from bunraku.physics.from_file import apparel_rig
from bunraku.physics.simulate import simulate
from bunraku_lab.datasets.apparel.body_inside import deep_inside
from bunraku_lab.datasets.apparel.build import body_animation, source_character
from bunraku_lab.datasets.apparel.plan import CharacterSource
from bunraku_lab.evaluation.physics.measures import apparel_chains, body_speeds, chain_lengths
from bunraku_lab.evaluation.physics.penetration import deep_share, nearest_joint_vertices, sample_apparel
from bunraku_lab.evaluation.report import Bar, measured_in, percent, reached_bars
from bunraku_lab.evaluation.transfer.stock_motions import STOCK_MOTIONS, stock_motion

__all__ = ["PHYSICS_BARS", "evaluate_physics", "joined", "measure_physics"]

FPS = 30.0
REST = 3.0  # seconds after which bodies should be at rest
STRIDE = 6  # frames from one whose penetration is measured to the next
BLEND = 0.7  # seconds from the end of a motion into the start of the next
Progress = Callable[[str, float], None]
_Source = tuple[str, Callable[[], Character]]

PHYSICS_BARS: dict[str, Bar] = {
    "chain_stretch": Bar("largest stretch of a chain over its rest length", most=0.05, show=percent(2)),
    "penetration_ratio": Bar("apparel deeper than 1 cm in the body, against rigid motion", most=1 / 3, show=percent(2)),
    "rest_speed": Bar(
        "mean speed of dynamic bodies after 3 s of rest",
        most=0.01,
        show=measured_in(" m/s", 4),
        show_limit=measured_in(" m/s", 4),
    ),
    "fly_away_free": Bar("clips of a minute without a fly-away", least=0.99, show=percent(2)),
    "realtime_factor": Bar("simulated over needed time, one core", least=1.0, show=measured_in(" x", 1)),
    "deterministic": Bar("the same twice", least=1.0, show=percent(2)),
}


def evaluate_physics(
    files: Sequence[str | Path] = (),
    wardrobe: Sequence[CharacterSource] = (),
    *,
    motions: Sequence[str | Path] = (),
    seconds: float = 60.0,
    quick: bool = False,
    jobs: int | str = 1,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Measure all rows.

    Args:
        files: PMX, PMD or VRM files.
        wardrobe: Characters of the wardrobe.
        motions: Motion files; a walk, a dance and kicks made by code when there are none. A VMD is played as MMD plays
            it.
        seconds: Length of the clip that every character plays: the motions one after the other, each as long, repeated
            where it is shorter [s].
        quick: Leave out what takes longest: penetration, rest and whether the same comes out twice, which are None
            then.
        jobs: How many processes share the characters, or "ray" for a cluster whose machines see the same files.
        progress: Called with the name of a character and the share done.

    Returns:
        The rows, the worst of all characters, with the bars reached and a row for each character.
    """
    from bunraku.io import load_character

    progress = progress or (lambda stage, done: None)
    sources: list[_Source] = []
    resolved = Path.absolute if jobs == "ray" else Path  # other machines work in other folders
    for path in map(Path, files):
        sources.append((path.name, partial(load_character, resolved(path))))
    for source in wardrobe:
        clothes, body_data = (str(resolved(Path(own))) if own else "" for own in (source.clothes, source.body_data))
        sources.append((source.name, partial(source_character, replace(source, clothes=clothes, body_data=body_data))))
    work = partial(_measured, [resolved(Path(path)) for path in motions], seconds, quick)
    batches = [[(number, *source)] for number, source in enumerate(sources)]
    alone = ((batch[0], work(batch, progress)[0]) for batch in batches)
    found: dict[int, dict[str, Any] | str] = {}
    for (number, name, _), row_of in alone if jobs == 1 else spread(work, batches, jobs, _lost):
        found[number] = row_of
        progress(name, 1.0)
    rows_by_name = [(name, found[number]) for number, (name, _) in enumerate(sources)]
    rows = [row for _, row in rows_by_name if isinstance(row, dict)]
    failed = {name: reason for name, reason in rows_by_name if isinstance(reason, str)}
    if not rows:
        raise CharacterError(f"no character could be measured: {next(iter(failed.values()), 'none was named')}")
    out: dict[str, Any] = {
        "chain_stretch": max(row["chain_stretch"] for row in rows),
        "penetration_ratio": None if quick else _ratio(rows, "penetration", "penetration_nearest_joint"),
        "rest_speed": None if quick else max(row["rest_speed"] for row in rows),
        "fly_aways": sum(row["fly_aways"] for row in rows),
        "fly_away_free": float(np.mean([not row["fly_aways"] for row in rows])),
        "realtime_factor": min(row["realtime_factor"] for row in rows),
        "deterministic": None if quick else all(row["deterministic"] for row in rows),
    }
    reached = reached_bars(PHYSICS_BARS, out)
    return out | {
        "reached": reached,
        "seconds": seconds,
        "motions": list(rows[0]["motions"]),
        "characters": rows,
        "failed": failed,
    }


def _measured(
    motions: Sequence[Path],
    seconds: float,
    quick: bool,
    characters: list[tuple[int, str, Callable[[], Character]]],
    progress: Progress | None = None,
) -> list[dict[str, Any] | str]:
    """The row of each character, or why there is none."""
    out: list[dict[str, Any] | str] = []
    for _, name, load in characters:
        report = partial(progress, name) if progress else None
        try:
            if report:
                report(0.0)
            out.append({"name": name} | measure_physics(load(), motions, seconds, quick, report))
        except BunrakuError as error:
            out.append(str(error))
    return out


def _lost(reason: str) -> dict[str, Any] | str:
    return reason


def measure_physics(
    character: Character,
    motions: Sequence[str | Path] = (),
    seconds: float = 60.0,
    quick: bool = False,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """The row of one character.

    Args:
        character: With a rig of a person and physics.
        motions: As in `evaluate_physics`.
        seconds: As in `evaluate_physics`.
        quick: As in `evaluate_physics`.
        progress: Called with the share done.

    Raises:
        CharacterError: It has no rig of a person, or nothing that physics move.
    """
    from bunraku.apparel.mask import apparel_mask

    progress = progress or (lambda done: None)
    rig, mask = apparel_rig(character), apparel_mask(character)
    if rig is None or mask is None or not mask.any():
        raise CharacterError(f"{character.name}: its file says nothing of apparel that physics move")
    body = UnifiedBody.of(character)
    names, parts = _parts(body, motions, seconds)
    progress(0.1)
    animation, bounds = joined(parts)
    used = time.process_time()
    simulation = simulate(animation, rig)
    used = time.process_time() - used
    progress(0.6)
    result = simulation.animation
    chains = apparel_chains(character, rig)
    stretch = (
        chain_lengths(result, rig, chains) / np.array([chain.length for chain in chains]) - 1
        if chains
        else np.zeros((len(result), 1))
    )
    worst = np.unravel_index(int(stretch.argmax()), stretch.shape)
    row: dict[str, Any] = {
        "motions": {
            name: {"chain_stretch": float(stretch[start:stop].max(initial=0))}
            for name, (start, stop) in zip(names, bounds, strict=True)
        },
        "chain_stretch": float(stretch.max()),
        "worst_chain": rig.bodies[chains[worst[1]].bodies[-1]].name if chains else "",
        "chains": len(chains),
        "bodies": sum(one.dynamic for one in rig.bodies),
        "fly_aways": len(simulation.report.recoveries),
        "fly_away_bodies": sorted({lost.body for lost in simulation.report.recoveries}),
        "realtime_factor": len(result) / result.fps / max(used, 1e-9),
    }
    if quick:
        return row
    frames = np.arange(0, len(result), STRIDE)
    deep, inside = _penetration(body, mask, result, frames)
    progress(0.9)
    for name, (start, stop) in zip(names, bounds, strict=True):
        part = deep[(frames >= start) & (frames < stop)].mean(axis=0)
        row["motions"][name] |= {"penetration": float(part[0]), "penetration_nearest_joint": float(part[1])}
    return row | {
        "penetration": float(deep[:, 0].mean()),
        "penetration_nearest_joint": float(deep[:, 1].mean()),
        "penetration_parents": float(deep[:, 2].mean()),
        "penetration_at_rest": inside,
        "penetration_ratio": _ratio([{"a": deep[:, 0].mean(), "b": deep[:, 1].mean()}], "a", "b"),
        "rest_speed": _rest_speed(character, rig),
        "deterministic": _deterministic(animation, rig),
    }


def joined(parts: Sequence[RigAnimation], blend: float = BLEND) -> tuple[RigAnimation, list[tuple[int, int]]]:
    """Animations of one character one after the other, each set off where the last one ended, with short ways between.

    Args:
        parts: The animations, of the same rate.
        blend: Length of a way [s].

    Returns:
        The whole, and the first frame and the one after the last of each part; ways belong to the part that they lead
        to.
    """
    fps, steps = parts[0].fps, max(1, round(blend * parts[0].fps))
    shares = np.arange(1, steps + 1) / (steps + 1)
    shares = shares * shares * (3 - 2 * shares)
    rotations, translations, bounds = (
        [np.asarray(parts[0].rotations)],
        [np.asarray(parts[0].translations)],
        [(0, len(parts[0]))],
    )
    for part in parts[1:]:
        rig = part.character.rig
        assert rig is not None
        before = RigAnimation(part.character, rotations[-1][-1:], translations[-1][-1:], fps)
        core = int(
            np.argmax(np.bincount(rig.indices.ravel(), rig.weights.ravel(), minlength=len(rig.names)))
        )  # a bone of the trunk or of a head
        shift = before.world()[1][0, core] - part.world()[1][0, core]
        moved = np.array(part.translations)
        moved[:, rig.parents < 0] += np.array([shift[0], 0, shift[2]], np.float32)
        start, end = (
            quaternion_from_matrix(rotations[-1][-1].astype(float)),
            quaternion_from_matrix(part.rotations[0].astype(float)),
        )
        between = [quaternion_slerp(start, end, np.full(len(start), share)) for share in shares]
        path = np.array([(1 - share) * translations[-1][-1] + share * moved[0] for share in shares])
        rotations += [matrix_from_quaternion(np.array(between)), np.asarray(part.rotations)]
        translations += [path, moved]
        bounds.append((bounds[-1][1], bounds[-1][1] + steps + len(part)))
    return RigAnimation(parts[0].character, np.concatenate(rotations), np.concatenate(translations), fps), bounds


def _parts(body: UnifiedBody, motions: Sequence[str | Path], seconds: float) -> tuple[list[str], list[RigAnimation]]:
    """The motions on the character, each of its share of the time."""
    from bunraku.io.motions import load_motion
    from bunraku.pipelines.to_reference import reference_motion
    from bunraku.pipelines.transfer import played_by_mmd

    if not motions:
        each = seconds / len(STOCK_MOTIONS)
        return list(STOCK_MOTIONS), [body_animation(body, stock_motion(kind, each, FPS)) for kind in STOCK_MOTIONS]
    names: list[str] = []
    out: list[RigAnimation] = []
    wanted = max(2, round(seconds / len(motions) * FPS))
    for path in map(Path, motions):
        played = played_by_mmd(body.parts.character, path, FPS)
        if played is None:
            reference: HandleMotion = reference_motion(load_motion(path, fps=FPS), fps=FPS)
            played = body_animation(body, reference.take(slice(0, wanted)))
        again = 1 + max(0, int(np.ceil((wanted - len(played)) / (len(played) + round(BLEND * FPS)))))
        whole = joined([played] * again)[0]
        names.append(path.stem)
        out.append(RigAnimation(whole.character, whole.rotations[:wanted], whole.translations[:wanted], FPS))
    return names, out


def _penetration(
    body: UnifiedBody, mask: np.ndarray, result: RigAnimation, frames: np.ndarray
) -> tuple[np.ndarray, float]:
    """Share of apparel that is deep in the body, and the share that is so at rest and is left out, since no motion put
    it there.

    Returns:
        As simulated, rigid with the nearest joint, and rigid with what its bones hang on, shape (N, 3); and the share
        at rest.
    """
    character, rig = body.parts.character, body.parts.character.rig
    assert rig is not None
    volume, chosen = BodyVolume.of(body, mask), sample_apparel(mask)
    inside = deep_inside(volume, volume.rest, character.vertices[chosen])
    chosen = chosen[~inside]
    if not len(chosen):
        raise CharacterError(
            f"{character.name}: all of its apparel is inside its body at rest, so penetration says nothing"
        )
    points = character.vertices[chosen]
    dense = replace(rig, indices=rig.indices[chosen], weights=rig.weights[chosen]).dense_weights()
    bones = np.flatnonzero(dense.any(axis=0))
    out = []
    for start in range(0, len(frames), 64):
        some = frames[start : start + 64]
        cut = RigAnimation(character, result.rotations[some], result.translations[some], result.fps)
        transforms = eq4_transforms(body.transforms(cut), body.joints)
        simulated = skin(points, dense[:, bones], cut.transforms()[:, bones])
        held = skin(points, body.weights[chosen], transforms)
        out.append(deep_share(volume, transforms, [simulated, nearest_joint_vertices(body, chosen, transforms), held]))
    return np.concatenate(out), float(inside.mean())


def _rest_speed(character: Character, rig: ApparelRig) -> float:
    """Mean speed of the dynamic bodies in the second after the first 3 s of rest [m/s]; nothing is warmed up."""
    skeleton = character.rig
    assert skeleton is not None
    frames, bones = round((REST + 1) * FPS) + 1, len(skeleton.names)
    still = RigAnimation(
        character, np.tile(np.eye(3, dtype=np.float32), (frames, bones, 1, 1)), np.zeros((frames, bones, 3)), FPS
    )
    speeds = body_speeds(simulate(still, rig, warmup=0.0).animation, rig)
    return float(speeds[round(REST * FPS) :].mean()) if speeds.size else 0.0


def _deterministic(animation: RigAnimation, rig: ApparelRig) -> bool:
    """Whether two simulations of the first three seconds give the same bytes."""
    few = round(3 * FPS)
    cut = RigAnimation(animation.character, animation.rotations[:few], animation.translations[:few], animation.fps)
    first, second = (simulate(cut, rig).animation for _ in range(2))
    return (
        first.rotations.tobytes() == second.rotations.tobytes()
        and first.translations.tobytes() == second.translations.tobytes()
    )


def _ratio(rows: Sequence[Mapping[str, float]], key: str, against: str) -> float | None:
    """Means of rows over each other; None where rigid motion does not go into the body either."""
    under = float(np.mean([row[against] for row in rows]))
    over = float(np.mean([row[key] for row in rows]))
    return over / under if under > 0 else 0.0 if over == 0 else None
