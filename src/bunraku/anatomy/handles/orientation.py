"""Which way up a mesh belongs and which way it faces, and how to stand it up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bunraku.anatomy.handles.orientation_evidence import Combination, ShapeView, gathered, has_rule, kind_weights
from bunraku.anatomy.names.bone_words import without_prefix
from bunraku.core.character import Character
from bunraku.core.geometry.axes import AXES, ORIENTATIONS, axis_name, upright_rotation
from bunraku.core.geometry.surface import surface_points
from bunraku.core.request import checked
from bunraku.files import Source, rotated

if TYPE_CHECKING:
    from bunraku.anatomy.handles.networks import OrientationPredictor

SURE = 0.85
"""From this probability on nothing is said of a guess."""
_POINTS, _AGAIN = 2048, (1024, 4096)
"""Points that the network's tokens stand for, and those of its further looks: which tokens it happens to get may turn a
front that hardly differs from the back. Three looks have a cross-entropy of .236 in place of .286 on the 37 files for
priors, other things being equal."""
ENOUGH = 0.97
"""Where the shape is so sure at the first look, there is no other."""


@dataclass(frozen=True, eq=False)
class Orientation:
    """What is up and what is the front of a character.

    Args:
        up: Its up axis, such as "+y": the likeliest, whatever the front.
        front: The axis that it faces, such as "+z": the likeliest with that axis up.
        up_confidence: How likely the up axis is right, 0 to 1.
        front_confidence: How likely the front is right if the up axis is, 0 to 1.
        probabilities: How likely each of `geometry.axes.ORIENTATIONS` is, shape (24,), sums to 1.
    """

    up: str
    front: str
    up_confidence: float
    front_confidence: float
    probabilities: np.ndarray

    @staticmethod
    def of(probabilities: np.ndarray) -> Orientation:
        """The likeliest up axis, p(up) = sum over fronts of p(up, front), and the likeliest front given that axis, by
        p(front | up) = p(up, front) / p(up).
        """
        ups = np.array([up for up, _ in ORIENTATIONS])
        total = {up: float(probabilities[ups == up].sum()) for up in AXES}
        likely = max(total, key=lambda up: total[up])
        best = int(np.where(ups == likely, probabilities, -1).argmax())
        return Orientation(
            likely, ORIENTATIONS[best][1], total[likely], float(probabilities[best]) / total[likely], probabilities
        )

    @property
    def confidence(self) -> float:
        """How likely both axes are right, 0 to 1."""
        return self.up_confidence * self.front_confidence

    @property
    def sure(self) -> bool:
        """Whether both axes are right with a probability of at least 0.85."""
        return self.confidence >= SURE

    @property
    def rotation(self) -> np.ndarray:
        """What makes the character stand up along +Y and face +Z, shape (3, 3)."""
        return upright_rotation(self.up, self.front)

    def probability(self, up: str, front: str) -> float:
        """How likely an orientation is, 0 to 1."""
        return float(self.probabilities[ORIENTATIONS.index((up, front))])

    @property
    def likeliest(self) -> tuple[str, str]:
        """The likeliest up axis and front together."""
        return ORIENTATIONS[int(self.probabilities.argmax())]

    def next_best(self, up: str, front: str) -> tuple[str, str]:
        """The likeliest orientation beside one that is known to be wrong."""
        wrong = ORIENTATIONS.index((up, front))
        return ORIENTATIONS[int(np.where(np.arange(len(ORIENTATIONS)) == wrong, -1, self.probabilities).argmax())]


@lru_cache(maxsize=2)
def _model(path: Path, changed: int) -> OrientationPredictor:
    from bunraku.anatomy.handles.networks import load_orientation_predictor

    return load_orientation_predictor(path)


@checked
def guess_orientation(
    character: Character,
    *,
    up: str | None = None,
    front: str | None = None,
    suffix: str | None = None,
    prior: np.ndarray | None = None,
    checkpoint: str | Path | None = None,
) -> Orientation:
    """The likeliest up axis of a character, and the likeliest front with that axis up.

    Combined are the network, which sees the shape, the evidence of `orientation_evidence.EVIDENCE`, what files of its
    kind are like, and bones whose names tell left from right.

    Args:
        character: Any mesh.
        up: Its up axis where that is known.
        front: The axis that it faces where that is known.
        suffix: The format of its file, such as ".stl"; that of its source when not given.
        prior: How likely each of `ORIENTATIONS` is before anyone looks at the mesh, shape (24,), in place of what the
            file and its bones say; equal numbers let the mesh speak alone.
        checkpoint: Weights of kind "orientation"; the shipped ones when not given.

    Raises:
        OptionError: What is known are no axes at a right angle.
        WeightsError: The checkpoint is missing or does not fit.
    """
    from bunraku.core.nn.checkpoints import dated_checkpoint

    allowed = _allowed(up, front)
    model = _model(*dated_checkpoint("orientation", checkpoint))
    bones = _axes_of_bones(character) if prior is None else None
    if prior is None:
        prior = kind_weights(_suffix(character) if suffix is None else suffix, _moved(character), bones is not None)
    prior = np.where(allowed, prior, 0)
    surface = surface_points(character.vertices, character.faces, _POINTS)
    used = character.surface
    paint = None if character.colors is None else (np.cumsum(used)[character.faces] - 1, character.colors[used])
    vertices, combined = character.vertices[used], Combination()
    logs, worth = gathered(ShapeView(vertices, surface, paint, _named(character))), combined.worth(vertices)
    looks = [_look(model, *surface)]
    if combined(looks[0], logs, worth).max() < ENOUGH:
        looks += [_look(model, *surface_points(character.vertices, character.faces, count)) for count in _AGAIN]
    mean = np.exp(np.log(looks).mean(axis=0))
    return Orientation.of(combined(mean / mean.sum(), logs, worth, prior, bones))


def _look(model: OrientationPredictor, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """What the network gives each of `ORIENTATIONS` by some points of a surface, none of it nothing, shape (24,)."""
    from bunraku.anatomy.handles.networks import shape_tokens
    from bunraku.core.nn.layers import one_thread

    tokens = shape_tokens(points, normals, np.ones(len(points)), model.config.anchors)
    with one_thread():
        seen = np.asarray(model.probabilities(tokens)) + 1e-4
    return seen / seen.sum()


def _axes_of_bones(character: Character) -> tuple[str, str] | None:
    """Up and front as the bones of its rig have them; None where there is none or they do not say."""
    from bunraku.anatomy.names.bone_names import rig_axes

    rig = character.rig
    return None if rig is None else rig_axes(rig.names, rig.parents, rig.positions)


def _named(character: Character) -> tuple[Sequence[str], np.ndarray] | None:
    """Names of its bones, or of its meshes where it has none, and where they are, shape (n, 3); None without a file."""
    source = character.source
    if character.rig is not None:
        return without_prefix(character.rig.names), character.rig.positions
    if not isinstance(source, Source) or not source.fits(character):
        return None
    nodes, placed = source.document.items("nodes"), list(source.placed())
    places = np.array([character.vertices[index].mean(axis=0) for _, index in placed])
    return [str(nodes[part.node].get("name") or "")[:200] for part, _ in placed], places


def _suffix(character: Character) -> str:
    """The format that a character came from; "" where it came from none."""
    return str(getattr(character.source, "suffix", ""))


def _moved(character: Character) -> bool:
    """Whether its file has a skin or a clip."""
    document = getattr(character.source, "document", None)
    return character.rig is not None or (document is not None and bool(document.items("animations")))


def _allowed(up: str | None, front: str | None) -> np.ndarray:
    """Which of `ORIENTATIONS` agree with what is known, shape (24,), bool."""
    up, front = (None if axis is None else axis_name(axis) for axis in (up, front))
    if up is not None and front is not None:
        upright_rotation(up, front)
    return np.array([(up is None or u == up) and (front is None or f == front) for u, f in ORIENTATIONS])


@dataclass(frozen=True, eq=False)
class ResolvedAxes:
    """How a character is taken to stand."""

    up: str  # its up axis, such as "+z"
    front: str  # the axis that it faces
    # What was guessed, whether or not it was followed; None where both axes were said.
    guess: Orientation | None = None

    @property
    def sure(self) -> float:
        """How likely these axes are by the guess, 0 to 1; 1 where nothing was guessed."""
        return 1.0 if self.guess is None else self.guess.probability(self.up, self.front)

    @property
    def other(self) -> tuple[str, str] | None:
        """The likeliest other axes; None where nothing was guessed."""
        return None if self.guess is None else self.guess.next_best(self.up, self.front)


def resolve_axes(
    character: Character, up: str = "auto", front: str = "auto", *, suffix: str | None = None
) -> ResolvedAxes:
    """How a character stands, from what is said here or else in the file beside its own, from its mesh, and from the
    rule of its format. OptionError if an axis is none of the six, or the two are not at a right angle; WeightsError if
    the weights are missing or broken, and something is to be guessed.

    Args:
        character: Any character.
        up: The axis that is up in it, such as "+z", or "auto" to guess.
        front: The axis that it faces, or "auto" to guess.
        suffix: The format of its file, such as ".stl"; that of its source when not given.
    """
    given = [None if axis.strip().lower() == "auto" else axis_name(axis) for axis in (up, front)]
    said = character.corrections
    if given == [None, None] and said is not None and said.has_axes:
        return resolve_axes(replace(character, corrections=None), said.up, said.front, suffix=suffix)
    if given[0] is not None and given[1] is not None:
        upright_rotation(given[0], given[1])
        return ResolvedAxes(given[0], given[1])
    suffix = _suffix(character) if suffix is None else suffix
    rule = has_rule(suffix) and given == [None, None]
    # What is said against a rule says that the file breaks it, so the rest is judged as in a format without one.
    kind = "" if has_rule(suffix) and not rule else suffix
    guess = guess_orientation(character, up=given[0], front=given[1], suffix=kind)
    return ResolvedAxes(*guess.likeliest, guess)


def as_said(character: Character) -> Character:
    """The character upright where the file beside its own says how it stands; others as they are."""
    said = character.corrections
    return upright(character) if said is not None and said.has_axes else character


@checked
def upright(character: Character, up: str = "auto", front: str = "auto") -> Character:
    """The character standing along +Y and facing +Z, as everything here wants it.

    Args:
        character: Any character.
        up: The axis that is up in it, such as "+z", or "auto" to guess.
        front: The axis that it faces, or "auto" to guess; `guess_orientation` says how sure a guess is.

    Raises:
        OptionError: An axis is none of the six, or the two are not at a right angle.
        WeightsError: The weights are missing or broken, and something is to be guessed.
    """
    resolved = resolve_axes(character, up, front)
    return rotated(character, resolved.up, resolved.front)
