"""Takes that are made, and what a page changes of their records."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any, Literal

from bunraku.core.request.json_form import to_json
from bunraku.errors import OptionError
from bunraku.pipelines.requests.constraints import Constraints
from bunraku.pipelines.requests.request import Request
from bunraku.studio.forms.drawing import Drawn, DressForm, Motion, read_path, read_pins, stages_without
from bunraku.studio.forms.script import Part, read_script, sequence_of

__all__ = ["TakeForm", "TakeRecordForm"]

MOST_TITLE = 80


@dataclass(frozen=True, kw_only=True)
class TakeForm(Drawn):
    """Takes that are made from sentences.

    Args:
        script: What the character does.
        draft: Show a quick one first.
        loop: Make loops.
        in_place: Take the path over the ground out.
        apparel: How apparel moves.
        stiffness: How stiff apparel is.
        gravity: How strongly what is simulated is drawn downwards.
        path: Points that the root passes, x and z [m].
        after: The take in whose last pose these start.
        rig: What moves: handles, or the bones of the file's own skeleton.
    """

    script: tuple[Part, ...] = ()
    draft: bool = True
    loop: bool = False
    in_place: bool = False
    apparel: Motion = "rigid"
    stiffness: float = 1.0
    gravity: float = 1.0
    path: tuple[object, ...] | None = None
    after: str | None = None
    rig: Literal["handles", "own"] = "handles"

    def request(self, handles: Literal["predict", "rig"] = "predict") -> Request:
        """The request, checked; the take that is followed is only named.

        Args:
            handles: How the handles of the character were made.

        Raises:
            OptionError: It cannot be requested, or a sentence is not understood.
        """
        script = read_script(self.script)
        found = Request(
            sequence_of(script), self.sampling(sum(part.seconds for part in script)),
            Constraints.of(
                loop=self.loop, in_place=self.in_place, after=self.after or None, path=read_path(self.path or ()),
                pins=read_pins(self.pins),
            ),
            self.dress.apparel_request, stages_without(self.without),
            "predict" if self.apparel == "simulate" else handles, self.force,
            self.rig if self.rig == "own" else "auto" if self.apparel in ("simulate", "learn") else "handles",
        )  # fmt: skip
        found.check()
        return found.with_parsed()

    @property
    def dress(self) -> DressForm:
        """How apparel moves."""
        return DressForm(apparel=self.apparel, stiffness=self.stiffness, gravity=self.gravity)

    def pieces(self, handles: Literal["predict", "rig"] = "predict") -> list[dict[str, Any]]:
        """The JSON forms of clips and of requests of the sentences between them, of a script with clips.

        Raises:
            OptionError: It cannot be requested, or a sentence is not understood.
        """
        if self.after:
            raise OptionError("a script with clips follows no other take; put its clip or sentence before them")
        found: list[dict[str, Any]] = []
        for played, parts in itertools.groupby(read_script(self.script), lambda part: bool(part.clip)):
            some = tuple(parts)
            if played:
                found += [{"clip": part.clip, "seconds": part.seconds} for part in some]
            else:
                own = replace(self, script=some, loop=False, in_place=False, path=None, pins=(), apparel="rigid")
                seconds = sum(part.seconds for part in some)
                found.append({"seconds": seconds, "request": own.request(handles).to_json()})
        return found

    def constraints(self) -> Constraints:
        """What a script with clips must meet; alone a clip that loops can be a loop."""
        return Constraints.of(
            loop=self.loop and len(self.script) == 1, in_place=self.in_place, path=read_path(self.path or ()),
            pins=read_pins(self.pins),
        )  # fmt: skip

    def asked(self) -> dict[str, Any]:
        """What a take's record keeps of it, for links."""
        kept = (
            "seeds",
            "steps",
            "guidance",
            "loop",
            "in_place",
            "apparel",
            "stiffness",
            "gravity",
            "path",
            "pins",
            "rig",
        )
        return {name: to_json(getattr(self, name)) for name in kept}


@dataclass(frozen=True, kw_only=True)
class TakeRecordForm:
    """What a page changes of a take that is there.

    Args:
        star: Whether it is starred.
        deleted: Whether it is given up.
        title: Its name; "" is that of its sentence.
    """

    star: bool | None = None
    deleted: bool | None = None
    title: str | None = None

    def __post_init__(self) -> None:
        if len(self.title or "") > MOST_TITLE:
            raise OptionError(f"title has more than {MOST_TITLE} characters")
