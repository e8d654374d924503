"""How takes are drawn, directed and dressed: what several forms have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Literal

from bunraku.core.request.limits import CANDIDATES, GRAVITY, GUIDANCE, SECONDS, STEPS, STIFFNESS, Limit
from bunraku.errors import OptionError
from bunraku.pipelines.requests.apparel import Apparel
from bunraku.pipelines.requests.request import Sampling

if TYPE_CHECKING:
    from bunraku.core.ground_path import GroundPath
    from bunraku.retarget.fit import Stages
    from bunraku.retarget.stages.pins import Pin

__all__ = [
    "DressForm", "Drawn", "MOST_SEED", "Motion", "TIME", "check_pins", "read_path", "read_pins", "stages_without",
]  # fmt: skip

MOST_SEEDS = 8
MOST_SEED = 2**53
"""Seeds are less, so that a browser knows them exactly."""
TIME = Limit("time", 0, SECONDS.high)
Motion = Literal["rigid", "simulate", "chains", "learn"]
"""How apparel moves."""


def stages_without(names: Sequence[str]) -> Stages | None:
    """The stages of generated motions but those named; None where none is.

    Raises:
        OptionError: There is no such stage.
    """
    from bunraku.pipelines.apply import GENERATED_STAGES

    known = sorted(field.name for field in fields(GENERATED_STAGES))
    for name in names:
        if name not in known:
            raise OptionError(f"there is no stage '{name[:40]}'; there are {', '.join(known)}")
    return replace(GENERATED_STAGES, **dict.fromkeys(names, False)) if names else None


def read_pins(forms: Sequence[object]) -> list[Pin]:
    """Pins of their JSON forms.

    Raises:
        OptionError: One is none.
    """
    from bunraku.retarget.stages.pins import Pin

    found = [Pin.from_json(form) for form in forms]
    for pin in found:
        TIME.check(pin.time)
        TIME.check(pin.hold, "hold")
    return found


def check_pins(forms: Sequence[object]) -> None:
    """Whether these are JSON forms of pins.

    Raises:
        OptionError: One is none.
    """
    read_pins(forms)


def read_path(points: Sequence[object]) -> GroundPath | None:
    """Points of a path on the floor, x and z [m]; None where there are none.

    Raises:
        OptionError: They are no such points.
    """
    from bunraku.core.ground_path import LONGEST, GroundPath

    if not points:
        return None
    limit = Limit("x and z of a path", -LONGEST, LONGEST)
    positions = []
    for point in points:
        if not isinstance(point, list) or len(point) != 2 or not all(type(one) in (int, float) for one in point):
            raise OptionError("a path is a list of points, each with x and z")
        for one in point:
            limit.check(one)
        positions.append((float(point[0]), float(point[1])))
    return GroundPath(tuple(positions))


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """How takes are drawn.

    Args:
        seeds: One for each take.
        steps: Of the sampler; None takes the default.
        guidance: Of the sentence; None takes the default.
        candidates: Motions of which one is chosen.
        force: Go on where no movement is understood.
        without: Names of stages that are left out.
        pins: JSON forms of pins.
    """

    seeds: tuple[float, ...] = (0,)
    steps: int | None = None
    guidance: float | None = None
    candidates: int = 3
    force: bool = False
    without: tuple[str, ...] = ()
    pins: tuple[object, ...] = ()

    def __post_init__(self) -> None:
        if len(self.seeds) > MOST_SEEDS:
            raise OptionError(f"seeds has more than {MOST_SEEDS} entries")
        if any(seed != int(seed) or not 0 <= seed < MOST_SEED for seed in self.seeds):
            raise OptionError("seeds are whole numbers from 0 on")
        object.__setattr__(self, "seeds", tuple(int(seed) for seed in self.seeds) or (0,))
        STEPS.check(self.steps, "steps")
        GUIDANCE.check(self.guidance, "guidance")
        CANDIDATES.check(self.candidates, "candidates")

    def sampling(self, seconds: float) -> Sampling:
        """The same of a clip of some seconds."""
        return Sampling(seconds, int(self.seeds[0]), self.steps, self.guidance, self.candidates)


@dataclass(frozen=True, kw_only=True)
class DressForm:
    """How the apparel of takes moves.

    Args:
        apparel: With the body, by the physics of the file, by chains of bones, or as it is learned.
        stiffness: Factor on how stiff apparel is.
        gravity: Factor on the gravity of what is simulated.
    """

    apparel: Motion = "rigid"
    stiffness: float = 1.0
    gravity: float = 1.0

    def __post_init__(self) -> None:
        STIFFNESS.check(self.stiffness, "stiffness")
        GRAVITY.check(self.gravity, "gravity")

    @property
    def apparel_request(self) -> Apparel:
        """The same as a part of a request."""
        return Apparel(self.apparel, self.stiffness, self.gravity)
