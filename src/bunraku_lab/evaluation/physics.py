"""Simulated apparel (`bunraku evaluate physics`): stretch, rest, apparel inside the body, and their table."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.apparel.body import UnifiedBody, eq4_transforms
from bunraku.apparel.physics.rig import ApparelRig, apparel_rig
from bunraku.apparel.physics.simulate import simulate
from bunraku.core.animation import RigAnimation
from bunraku.core.character import Character
from bunraku.core.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix, quaternion_slerp
from bunraku.core.motion import HandleMotion, posed_points
from bunraku.core.parallel import run_parallel
from bunraku.core.skinning import skin
from bunraku.errors import BunrakuError, CharacterError
from bunraku_lab.datasets.apparel.build import body_animation, source_character
from bunraku_lab.datasets.apparel.checks import DEEP, BodyVolume, deep_inside
from bunraku_lab.datasets.apparel.plan import CharacterSource
from bunraku_lab.evaluation.report import Bar, measured_in, percent, reached_bars
from bunraku_lab.synthetic.stock_motions import STOCK_MOTIONS, stock_motion

# By definition of the measures.
_FREE = 1e-3  # a joint that lets its bodies come apart by more [m] is no link of a chain
_SHORT = 5e-3  # chains under this have no length to speak of [m]


@dataclass(frozen=True)
class Chain:
    """Bodies that hang on each other, from one that follows its bone to a last one.

    Args:
        bodies: Indices of the bodies, the one that holds the chain first.
        joints: Indices of the joints between them, one fewer.
        length: At rest [m]: from joint to joint, and from the last one to the last body's centre.
    """

    bodies: tuple[int, ...]
    joints: tuple[int, ...]
    length: float


def apparel_chains(character: Character, rig: ApparelRig) -> list[Chain]:
    """Chains of a character: the shortest paths over its joints from bodies that follow bones to those at the ends.

    Joints that close loops (the cross-links of skirts) are left out, and joints that let bodies come apart.
    """
    beside: dict[int, list[tuple[int, int]]] = {}
    for number, joint in enumerate(rig.joints):
        a, b = joint.bodies
        if (joint.upper - joint.lower > _FREE).any() or (joint.lower > joint.upper).any():
            continue
        beside.setdefault(a, []).append((number, b))
        beside.setdefault(b, []).append((number, a))
    above: dict[int, tuple[int, int]] = {}
    drivers: dict[int, int] = {}  # the first dynamic body of each bone; others do not show in the bones
    for index, body in enumerate(rig.bodies):
        if body.dynamic and body.bone >= 0:
            drivers.setdefault(body.bone, index)
    queue = [(0, -1, index, -1) for index, body in enumerate(rig.bodies) if not body.dynamic and body.bone >= 0]
    known = {index for _, _, index, _ in queue}
    done: set[int] = set()
    heapq.heapify(queue)
    while queue:
        distance, number, at, parent = heapq.heappop(queue)
        if at in done:
            continue
        done.add(at)
        if parent >= 0:
            above[at] = (parent, number)
        for link, other in beside.get(at, ()):
            entry = rig.bodies[other]
            if other not in done and other not in known and entry.dynamic and drivers.get(entry.bone) == other:
                heapq.heappush(queue, (distance + 1, link, other, at))
    ends = set(above) - {parent for parent, _ in above.values()}
    chains = []
    for end in sorted(ends):
        bodies, joints = [end], list[int]()
        while bodies[-1] in above:
            parent, number = above[bodies[-1]]
            bodies.append(parent)
            joints.append(number)
        positions = [
            link_position(character, rig, body, number)
            for body, number in zip(bodies[-2::-1], joints[::-1], strict=True)
        ] + [rig.bodies[end].position]
        length = float(sum(np.linalg.norm(b - a) for a, b in zip(positions[:-1], positions[1:], strict=True)))
        if length > _SHORT:
            chains.append(Chain(tuple(bodies[::-1]), tuple(joints[::-1]), length))
    return chains


def link_position(character: Character, rig: ApparelRig, body: int, joint: int) -> np.ndarray:
    """Where a body hangs at rest [m], shape (3,): at its joint, or at the bone's head (mode 2)."""
    entry = rig.bodies[body]
    assert character.rig is not None
    return np.asarray(character.rig.positions[entry.bone] if entry.mode == 2 else rig.joints[joint].position)


def chain_lengths(animation: RigAnimation, rig: ApparelRig, chains: list[Chain]) -> np.ndarray:
    """How long the chains are in each frame [m], shape (N, C): along their joints, gaps at joints included.

    What is seen counts, which is the bones: a body that is held at its bone hangs on that bone's parent.

    Args:
        animation: The result; bodies are where their bones are.
        rig: Its bodies and joints.
        chains: From `apparel_chains`.
    """
    rotations, positions = animation.world()
    skeleton = animation.character.rig
    assert skeleton is not None
    rest = skeleton.positions
    out = np.empty((len(animation), len(chains)))

    def carried(bone: int, point: np.ndarray) -> np.ndarray:
        return np.asarray(positions[:, bone] + rotations[:, bone] @ (point - rest[bone]))

    gaps: dict[tuple[int, int, int], np.ndarray] = {}
    for column, chain in enumerate(chains):
        total = np.full(len(animation), chain.length)
        for a, b, number in zip(chain.bodies[:-1], chain.bodies[1:], chain.joints, strict=True):
            if (a, b, number) not in gaps:
                point, entry = link_position(animation.character, rig, b, number), rig.bodies[b]
                above = int(skeleton.parents[entry.bone]) if entry.mode == 2 else rig.bodies[a].bone
                gaps[a, b, number] = np.linalg.norm(carried(max(above, 0), point) - carried(entry.bone, point), axis=-1)
            total = total + gaps[a, b, number]
        out[:, column] = total
    return out


def body_speeds(animation: RigAnimation, rig: ApparelRig) -> np.ndarray:
    """How fast the centres of the dynamic bodies move from each frame to the next [m/s], shape (N - 1, D)."""
    rotations, positions = animation.world()
    skeleton = animation.character.rig
    assert skeleton is not None
    moving = [body for body in rig.bodies if body.dynamic and body.bone >= 0]
    bones = np.array([body.bone for body in moving], np.int64)
    offsets = np.array([body.position for body in moving]).reshape(-1, 3) - skeleton.positions[bones]
    centres = positions[:, bones] + np.einsum("ndab,db->nda", rotations[:, bones], offsets)
    return np.asarray(np.linalg.norm(np.diff(centres, axis=0), axis=-1) * animation.fps)


_MOST_POINTS = 1_500


def deep_share(volume: BodyVolume, transforms: np.ndarray, clouds: list[np.ndarray], depth: float = DEEP) -> np.ndarray:
    """Share of the points that are deeper inside the body than this, in each frame and for each cloud, shape (N, C).

    Args:
        volume: The body.
        transforms: Affine transforms of its joints, shape (N, 22, 3, 4).
        clouds: Points of the frames [m], each (N, P, 3).
        depth: [m].
    """
    posed = volume.posed(transforms)
    sizes = [cloud.shape[1] for cloud in clouds]
    out = np.zeros((len(posed), len(clouds)))
    for frame, vertices in enumerate(posed):
        deep = deep_inside(volume, vertices, np.concatenate([cloud[frame] for cloud in clouds]), depth)
        out[frame] = [part.mean() if len(part) else 0.0 for part in np.split(deep, np.cumsum(sizes)[:-1])]
    return out


def nearest_joint_vertices(body: UnifiedBody, chosen: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """Vertices moved rigidly with the body joint that is nearest in the rest pose [m], shape (N, P, 3).

    Args:
        body: The character's joints.
        chosen: Which vertices, shape (P,).
        transforms: Affine transforms of the joints, shape (N, 22, 3, 4).
    """
    points = body.parts.character.vertices[chosen]
    nearest = np.linalg.norm(points[:, None] - body.joints[None], axis=-1).argmin(axis=1)
    own = transforms[:, nearest]
    return np.asarray(posed_points(own, points))


def sample_apparel(apparel: np.ndarray, most: int = _MOST_POINTS) -> np.ndarray:
    """Vertices of apparel, evenly taken where they are many, shape (P,)."""
    found = np.flatnonzero(apparel)
    return found if len(found) <= most else found[np.linspace(0, len(found) - 1, most).astype(np.int64)]


FPS = 30.0
REST = 3.0  # seconds after which bodies should be at rest
STRIDE = 6  # frames from one whose penetration is measured to the next
BLEND = 0.7  # seconds from the end of a motion into the start of the next, by definition of the measure
Progress = Callable[[str, float], None]
_Source = tuple[str, Callable[[], Character]]

# Goals, set before anything was measured.
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
}


def evaluate_physics(
    files: Sequence[str | Path] = (), wardrobe: Sequence[CharacterSource] = (), *, motions: Sequence[str | Path] = (),
    seconds: float = 60.0, quick: bool = False, jobs: int | str = 1, progress: Progress | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Measure all rows.

    Args:
        files: PMX, PMD or VRM files.
        wardrobe: Characters of the wardrobe.
        motions: Motion files, a VMD as MMD plays it; a walk, a dance and kicks made by code when there are none.
        seconds: Length of the clip that every character plays [s], shared by the motions.
        quick: Leave out what takes longest (penetration and rest), which is None then.
        jobs: How many processes share the characters, or "ray" for a cluster whose machines see the same files.
        progress: Called with the name of a character and the share done.

    Returns:
        The rows, the worst of all characters, with the bars reached and a row for each character.
    """
    from bunraku.files import load_character

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
    for (number, name, _), row_of in alone if jobs == 1 else run_parallel(work, batches, jobs, _lost):
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
    motions: Sequence[Path], seconds: float, quick: bool, characters: list[tuple[int, str, Callable[[], Character]]],
    progress: Progress | None = None,
) -> list[dict[str, Any] | str]:  # fmt: skip
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
    character: Character, motions: Sequence[str | Path] = (), seconds: float = 60.0, quick: bool = False,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """The row of one character.

    Args:
        character: With a rig of a person and physics.
        motions: As in `evaluate_physics`.
        seconds: As in `evaluate_physics`.
        quick: As in `evaluate_physics`.

    Raises:
        CharacterError: It has no rig of a person, or nothing that physics move.
    """
    from bunraku.apparel.mask import apparel_mask

    progress = progress or (lambda done: None)
    rig, mask = apparel_rig(character), apparel_mask(character)
    if rig is None or mask is None or not mask.any():
        raise CharacterError(
            f"{character.name}: its file has no apparel that physics move; choose another way with --apparel"
        )
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
        "penetration_at_rest": inside,
        "penetration_ratio": _ratio([{"a": deep[:, 0].mean(), "b": deep[:, 1].mean()}], "a", "b"),
        "rest_speed": _rest_speed(character, rig),
    }


def joined(parts: Sequence[RigAnimation], blend: float = BLEND) -> tuple[RigAnimation, list[tuple[int, int]]]:
    """Animations of one character one after the other, each set off where the last one ended, with short ways between.

    Args:
        parts: The animations, of the same rate.
        blend: Length of a way [s].

    Returns:
        The whole, and the first frame and the one after the last of each part; a transition belongs to the next part.
    """
    fps, steps = parts[0].fps, max(1, round(blend * parts[0].fps))
    shares = np.arange(1, steps + 1) / (steps + 1)
    shares = shares * shares * (3 - 2 * shares)
    rotations, translations, bounds = (
        [np.asarray(parts[0].rotations)], [np.asarray(parts[0].translations)], [(0, len(parts[0]))],
    )  # fmt: skip
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
    from bunraku.pipelines.to_reference import load_motion, reference_motion
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
    """Share of apparel that is deep in the body, without what is so at rest, and that share at rest."""
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
        out.append(deep_share(volume, transforms, [simulated, nearest_joint_vertices(body, chosen, transforms)]))
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


def _ratio(rows: Sequence[Mapping[str, float]], key: str, against: str) -> float | None:
    """Means of rows over each other; None where rigid motion does not go into the body either."""
    under = float(np.mean([row[against] for row in rows]))
    over = float(np.mean([row[key] for row in rows]))
    return over / under if under > 0 else 0.0 if over == 0 else None
