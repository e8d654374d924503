"""How a page stands: what it keeps in its project, what a project file brings, and what undo takes back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

from bunraku.core.ground_path import LONGEST
from bunraku.core.request.json_form import from_json
from bunraku.core.request.limits import GRAVITY, GUIDANCE, SECONDS, STEPS, STIFFNESS, Limit
from bunraku.errors import OptionError
from bunraku.studio.forms.changes import PoseForm
from bunraku.studio.forms.drawing import MOST_SEED, TIME, Motion, check_pins
from bunraku.studio.forms.script import MOST_PARTS

__all__ = ["View", "checked_view", "read_view"]


@dataclass(frozen=True)
class _Sentence:
    """A sentence as it is being typed, which may be empty, or too long for a take; or a clip of the library."""

    text: str
    seconds: float
    clip: str = ""

    def __post_init__(self) -> None:
        SECONDS.check(self.seconds)


@dataclass(frozen=True, kw_only=True)
class View:
    """How a page stands; the names are the page's.

    Args:
        character, take: What is chosen.
        script: The sentences of the timeline.
        sentence: Which of them is in the box.
        seed: Of the first take.
        count: How many takes are made.
        loop: Make loops.
        inPlace: Take the path over the ground out.
        apparel: How hair and clothes move.
        stiffness, gravity: How stiff they are, and how strongly they are drawn downwards, as factors.
        live: Whether their springs swing in the page.
        guidance, steps: Of the sampler; None takes its own.
        pins: JSON forms of pins.
        poses: Poses that stay.
        path: Points that the root passes, x and z [m].
        span: Seconds from and to which is generated.
        keep: Parts that stay.
        rig: What moves.
    """

    character: str | None = None
    take: str | None = None
    script: tuple[_Sentence, ...] = (_Sentence("walks", 4.0),)
    sentence: int = 0
    seed: int = 0
    count: Literal[1, 4] = 1
    loop: bool = False
    inPlace: bool = False
    apparel: Motion = "rigid"
    stiffness: float = 1.0
    gravity: float = 1.0
    live: bool = False
    guidance: float | None = None
    steps: int | None = None
    pins: tuple[object, ...] = ()
    poses: tuple[PoseForm, ...] = ()
    path: tuple[tuple[float, float], ...] = ()
    span: tuple[float, float] | None = None
    keep: tuple[str, ...] = ()
    rig: Literal["handles", "own"] = "handles"

    def __post_init__(self) -> None:
        if not 1 <= len(self.script) <= MOST_PARTS:
            raise OptionError(f"script has 1 to {MOST_PARTS} entries")
        Limit("sentence", 0, MOST_PARTS - 1).check(self.sentence)
        Limit("seed", 0, MOST_SEED - 1).check(self.seed)
        STIFFNESS.check(self.stiffness)
        GRAVITY.check(self.gravity)
        GUIDANCE.check(self.guidance)
        STEPS.check(self.steps)
        for point in self.path:
            for one in point:
                Limit("x and z of a path", -LONGEST, LONGEST).check(one)
        for second in self.span or ():
            TIME.check(second, "span")
        check_pins(self.pins)


def checked_view(view: object) -> dict[str, Any]:
    """The view that a page sent; none is an empty one.

    Raises:
        OptionError: It holds what a page cannot show.
    """
    form: Any = {} if view is None else view
    from_json(View, form, "the view")
    return dict(form)


def read_view(view: object) -> dict[str, Any]:
    """What can be shown of a view that was kept, by this version or another: the rest is left out."""
    known: Sequence[str] = [field.name for field in fields(View)]
    found = {name: view[name] for name in known if name in view} if isinstance(view, dict) else {}
    for name in list(found):
        try:
            from_json(View, {name: found[name]})
        except OptionError:
            del found[name]
    return found
