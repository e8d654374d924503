"""Motion on characters: how far edges change their lengths (ARAP-Loss, Eq. 12 of TapMo), whether standing feet slide,
sink or jitter, and what the adaptation and each stage of fitting do about it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.handles.predict import predict_handles
from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.graph import unique_edges
from bunraku.core.motion import HandleMotion, posed_points
from bunraku.core.skinning import skin
from bunraku.errors import BunrakuError
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.datasets.characters.build import HELD_OUT
from bunraku_lab.evaluation.handles.subjects import find_files, load_subject, subject_name

ARAP_PROMPTS: tuple[str, ...] = (
    "a person walks forward", "a person runs", "a person waves with the right hand", "a person kicks with the left leg",
    "a person jumps up and down", "a person dances",
)  # fmt: skip
CHUNK = 50


def arap_loss(vertices: np.ndarray, rest: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """ARAP-Loss L_ARAP [TapMo 12]: sum over the edges of the squared change of their length, in each frame, shape (N,).

    The unit is the square of the rest pose's largest extent. Finer meshes have more edges that change by less, so the
    sum hardly depends on tessellation.

    Args:
        vertices: Posed positions [m], shape (N, V, 3).
        rest: Rest positions [m], shape (V, 3).
        edges: Pairs of vertices, shape (E, 2).
    """
    size = float(np.ptp(rest, axis=0).max())
    still = np.linalg.norm(rest[edges[:, 0]].astype(np.float64) - rest[edges[:, 1]], axis=-1)
    out = np.empty(len(vertices))
    for frame, posed in enumerate(vertices):
        posed = np.ascontiguousarray(posed, np.float64)
        length = np.linalg.norm(posed[edges[:, 0]] - posed[edges[:, 1]], axis=-1)
        out[frame] = np.square((length - still) / size).sum()
    return out


def animation_arap(animation: Animation) -> float:
    """Mean over the frames of `arap_loss` on the edges of the character's faces."""
    character = animation.character
    edges = unique_edges(character.faces, len(character.vertices))
    weights = animation.handles.weights
    # an edge whose ends have equal weights keeps its length exactly
    edges = edges[np.abs(weights[edges[:, 0]] - weights[edges[:, 1]]).sum(axis=1) > 1e-6]
    frames = len(animation.motion)
    parts = [np.arange(start, min(start + CHUNK, frames)) for start in range(0, frames, CHUNK)]
    return float(
        np.concatenate([arap_loss(animation.vertices(part), character.vertices, edges) for part in parts]).mean()
    )


STRIDE = 2
"""Of this many frames the mesh is looked at in one."""


HUMAN = 1.7  # height at which lengths are given, by definition of the measures [m]
DOWN = 0.05  # a foot is down where its lowest vertex is so near to the ground, by definition, over the leg's length
# m/s at human size: a foot that moves faster along the ground than this and than the body does is swung, not slid
SWING = 1.0
POINTS = 300  # vertices of each foot that are looked at
SINK = 20000  # vertices of the body that are looked at
CLEANING = ("smooth", "feet", "floor")
"""The stages that clean a motion, as against those that fit it to a body."""


@dataclass(frozen=True, eq=False)
class Gauge:
    """What is measured on a character.

    Args:
        character: In its rest pose.
        handles: Its handles.
        feet: Vertices of each foot, arrays of indices; none without legs.
        legs: Length of each leg [m].
        stands: Vertices that must not sink, shape (n,): all of the surface but, for bodies on legs, what may hang
            lower than the feet such as a weapon in a hand (`standing`).
        present: Handles that the character has, shape (K,), bool.
        floor: Height of the ground [m].
    """

    character: Character
    handles: Handles
    feet: tuple[np.ndarray, ...]
    legs: tuple[float, ...]
    stands: np.ndarray
    present: np.ndarray
    floor: float

    @property
    def scale(self) -> float:
        """Centimetres at human size for each metre of the character's."""
        return 100 * HUMAN / self.character.height


@dataclass(frozen=True)
class MotionQuality:
    """What is measured of motions; lengths at human size.

    Args:
        sliding: Mean way of a foot along the ground from frame to frame while it is down and not swung [cm].
        sliding_all: The same with feet that are swung low over the ground [cm].
        down: How many times a foot was down from one frame to the next: the weight of the two above.
        contact_share: Share of feet that are down, and not swung, 0 to 1.
        sunk: Mean depth of the lowest vertex below the ground, 0 where it is not below [% of the height].
        deepest: Depth of the lowest vertex of all frames [% of the height].
        jitter: Mean third difference of the handles' positions [cm].
        frames: How many.
    """

    sliding: float
    sliding_all: float
    down: int
    contact_share: float
    sunk: float
    deepest: float
    jitter: float
    frames: int


def gauge(character: Character, handles: Handles) -> Gauge:
    """What to measure on a character; the same for all its motions."""
    anatomy = Anatomy(character, handles, character, handles)  # on all vertices
    joints, legs, stands = anatomy.joints, anatomy.legs, np.flatnonzero(anatomy.stands)
    floor = float(character.vertices[stands, 1].min())
    feet = tuple(leg.foot_area[:: max(1, len(leg.foot_area) // POINTS)] for leg in legs)
    return Gauge(
        character, handles, feet, tuple(leg.length for leg in legs), stands[:: max(1, len(stands) // SINK)],
        joints.present, floor,
    )  # fmt: skip


def _slides(what: Gauge, transforms: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Paths of feet that are down [cm], whether each is no swing, and the number of pairs of frames and feet."""
    ways, slid, count = [], [], 0
    h = what.handles.positions
    root = transforms[:, 0, :, :3] @ h[0] + transforms[:, 0, :, 3]
    body = np.linalg.norm(np.diff(root[:, [0, 2]], axis=0), axis=1) * what.scale
    for foot, leg in zip(what.feet, what.legs, strict=True):
        posed = skin(what.character.vertices[foot], what.handles.weights[foot], transforms)
        low = posed[..., 1] < what.floor + DOWN * leg
        low = low[1:] & low[:-1]
        course = np.linalg.norm(np.diff(posed[..., [0, 2]], axis=0), axis=-1)
        down = low.any(axis=1)
        mean = (course * low).sum(axis=1)[down] / low.sum(axis=1)[down] * what.scale
        ways.append(mean)
        slid.append(mean <= np.maximum(1.01 * body[down], 100 * SWING / fps))
        count += len(low)
    if not ways:
        return np.zeros(0), np.zeros(0, bool), 0
    return np.concatenate(ways), np.concatenate(slid), count


def _depths(what: Gauge, transforms: np.ndarray) -> np.ndarray:
    """How deep the lowest vertex is below the ground in each frame [% of the height], shape (N,)."""
    vertices, weights = what.character.vertices[what.stands], what.handles.weights[what.stands]
    lowest = np.concatenate(
        [skin(vertices, weights, transforms[n : n + 50])[..., 1].min(axis=1) for n in range(0, len(transforms), 50)]
    )
    return np.maximum(what.floor - lowest, 0) / what.character.height * 100


def _jitter(what: Gauge, transforms: np.ndarray) -> float:
    positions = posed_points(transforms, what.handles.positions)
    if len(positions) < 4:
        return 0.0
    return float(
        np.linalg.norm(np.diff(positions[:, what.present].astype(np.float64), 3, axis=0), axis=-1).mean() * what.scale
    )


def measure(what: Gauge, motion: HandleMotion) -> MotionQuality:
    """All measures of one motion of a character."""
    transforms = motion.transforms(what.handles.positions)
    ways, slid, count = _slides(what, transforms, motion.fps)
    depths = _depths(what, transforms)
    return MotionQuality(
        sliding=float(ways[slid].mean()) if slid.any() else 0.0,
        sliding_all=float(ways.mean()) if len(ways) else 0.0,
        down=int(slid.sum()),
        contact_share=float(slid.sum() / count) if count else 0.0,
        sunk=float(depths.mean()),
        deepest=float(depths.max()),
        jitter=_jitter(what, transforms),
        frames=len(motion),
    )


def pooled(found: Sequence[MotionQuality]) -> MotionQuality:
    """Measures of many motions as of one: means over all frames and feet, and the deepest of all."""
    frames, down = np.array([each.frames for each in found], float), np.array([each.down for each in found], float)

    def mean(name: str, weight: np.ndarray) -> float:
        return float(np.average([getattr(each, name) for each in found], weights=weight)) if weight.sum() else 0.0

    return MotionQuality(
        sliding=mean("sliding", down), sliding_all=mean("sliding_all", down), down=int(down.sum()),
        contact_share=mean("contact_share", frames),
        sunk=mean("sunk", frames), deepest=max((each.deepest for each in found), default=0.0),
        jitter=mean("jitter", frames), frames=int(frames.sum()),
    )  # fmt: skip


def stage_effects(
    motions: Sequence[HandleMotion], characters: Mapping[str, tuple[Character, Handles]]
) -> list[dict[str, float | str]]:
    """What each cleaning stage does: every motion on every character with all, without each, and with none of them.

    Returns:
        A row for each character and case: `character` (of all together: "all"), `without` (a stage, "nothing" or
        "smooth, feet, floor") and the fields of `MotionQuality`; `moved` is the mean distance of the handles' positions
        in the root's frame from those without any of the stages [cm].
    """
    everything = Stages(shape=True)
    cases = {"nothing": everything, **{name: replace(everything, **{name: False}) for name in CLEANING}}
    none = ", ".join(CLEANING)
    cases[none] = replace(everything, **dict.fromkeys(CLEANING, False))
    results: dict[str, list[tuple[str, MotionQuality, float]]] = {case: [] for case in cases}
    for name, (character, handles) in characters.items():
        what, anatomy = gauge(character, handles), Anatomy.of(character, handles)
        for motion in motions:
            plain = fit_motion(motion, anatomy, cases[none])
            for case, stages in cases.items():
                fitted = plain if case == none else fit_motion(motion, anatomy, stages)
                results[case].append((name, measure(what, fitted), _moved(what, plain, fitted)))
    rows: list[dict[str, float | str]] = []
    for name in [*characters, "all"]:
        for case, found in results.items():
            own = [(quality, moved) for owner, quality, moved in found if name in ("all", owner)]
            if own:
                quality = pooled([each for each, _ in own])
                values = {field.name: getattr(quality, field.name) for field in fields(quality)}
                rows.append(
                    {"character": name, "without": case, **values, "moved": float(np.mean([moved for _, moved in own]))}
                )
    return rows


def _moved(what: Gauge, before: HandleMotion, after: HandleMotion) -> float:
    """Mean distance between the handles' positions of two motions of a character in the root's frame [cm]."""
    away = np.linalg.norm(after.translations - before.translations, axis=-1)[:, what.present]
    return float(away.mean() * what.scale)


_log = logging.getLogger(__name__)

Named = tuple[str, Character, Handles]
Progress = Callable[[float], None]


def chosen_files(folder: Path, unseen: bool, count: int) -> list[Path]:
    """At most `count` character files of a folder, evenly over their names: those unseen in training, or the others.

    Raises:
        FormatError: There are no characters.
    """
    files = [file for file in find_files(folder, everything=True) if (subject_name(folder, file) in HELD_OUT) == unseen]
    if len(files) <= count:
        return files
    return [files[index] for index in np.linspace(0, len(files) - 1, count).round().astype(int)]


def load_named(
    files: Sequence[Path], folder: Path, humanoids: bool = False, progress: Progress | None = None
) -> list[Named]:
    """Characters facing +Z with predicted handles; files that cannot be used are left out with a warning."""
    found: list[Named] = []
    for done, file in enumerate(files, 1):
        try:
            subject = load_subject(file, subject_name(folder, file))
            if subject.humanoid or not humanoids:
                found.append((subject.name, subject.character, predict_handles(subject.character).top(4)))
        except BunrakuError as error:
            _log.warning("%s is left out: %s", file, error)
        if progress is not None:
            progress(done / len(files))
    return found
