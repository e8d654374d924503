"""A request: what a character is to do and how, checked once for Python, the command line, the studio and its files."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

from bunraku.core.request.json_form import from_json, to_json
from bunraku.core.request.limits import CANDIDATES, GUIDANCE, SEED, STEPS, WHOLE
from bunraku.errors import OptionError
from bunraku.pipelines.requests.apparel import Apparel
from bunraku.pipelines.requests.constraints import Constraints

if TYPE_CHECKING:
    from bunraku.core.character import Handles
    from bunraku.language.sentence import Sentence
    from bunraku.retarget.fit import Stages

__all__ = ["HANDLES", "RIGS", "Request", "Sampling", "check_handles"]

HANDLES = ("predict", "rig")
"""How handles are made where none are given."""
RIGS = ("auto", "own", "handles")
"""What of a character moves."""


@dataclass(frozen=True)
class Sampling:
    """How a motion is drawn from a sentence.

    Args:
        seconds: Length of the clip, at least 0.5, and at most 120 in one pass; prompts in a row without seconds of
            their own share it.
        seed: The same seed and version give the same motion.
        steps: Sampling steps, 1 to 1000; more is slower. Default: 4, which the network was distilled into.
        guidance: How closely to follow the sentence, 0 to 20. Default: 3.5.
        candidates: Motions that are drawn, of which the one is taken that a ranker likes best, 1 to 16; 1 is the
            fastest.
    """

    seconds: float = 6.0
    seed: int = 0
    steps: int | None = None
    guidance: float | None = None
    candidates: int = 3

    def check(self, dashes: str = "") -> None:
        """Whether a motion can be drawn so.

        Args:
            dashes: What stands before the names of options in messages.

        Raises:
            OptionError: A number is outside its limits.
        """
        WHOLE.check(self.seconds, f"{dashes}seconds")
        SEED.check(self.seed, f"{dashes}seed")
        STEPS.check(self.steps, f"{dashes}steps")
        GUIDANCE.check(self.guidance, f"{dashes}guidance")
        CANDIDATES.check(self.candidates, f"{dashes}candidates")


@dataclass(frozen=True, eq=False)
class Request:
    """What a character is to do.

    Args:
        sentence: In English or a language of `language.words`; several in a row with their seconds: "walks:4; jumps:2".
            One that is parsed already (`language.parse`) is not parsed again.
        sampling: How the motion is drawn.
        constraints: What it must meet: a `GroundPath`, `Pin`, `Loop`, `Follow`, `InPlace`; of a clip that is edited a
            `Keep`, `Pose`, `Pin`.
        apparel: How hair and clothes move.
        stages: Which stages fit the motion to the character; the defaults when None.
        handles: The character's handles, or how to make them: "predict" or "rig" (see `bunraku.rig`).
        force: Go on even where no movement of the sentence is understood.
        rig: What moves: "own" the bones of the file's skeleton, "handles" the 30 handles, "auto" the bones where they
            are understood as those of a person, of four legs or of a bird and no handles are requested, and handles
            otherwise.
    """

    sentence: str | Sentence
    sampling: Sampling = field(default_factory=Sampling)
    constraints: Constraints = field(default_factory=Constraints)
    apparel: Apparel = field(default_factory=Apparel)
    stages: Stages | None = None
    handles: Handles | Literal["predict", "rig"] = "predict"
    force: bool = False
    rig: Literal["auto", "own", "handles"] = "auto"

    def __post_init__(self) -> None:
        if not isinstance(self.constraints, Constraints):
            object.__setattr__(self, "constraints", Constraints(self.constraints))

    @property
    def prompt(self) -> str:
        """The sentence as it was typed."""
        return self.sentence if isinstance(self.sentence, str) else self.sentence.prompt

    @cached_property
    def parsed(self) -> Sentence:
        """The sentence, parsed.

        Raises:
            OptionError: It is empty, too long or not understood, or a length is out of range.
        """
        from bunraku.language.parse import parse

        given = self.sentence
        return parse(given, self.sampling.seconds, self.force) if isinstance(given, str) else given

    def with_parsed(self) -> Request:
        """The same with its sentence parsed, which is then not parsed again."""
        return replace(self, sentence=self.parsed)

    def with_seed(self, seed: int) -> Request:
        """The same with another seed."""
        return replace(self, sampling=replace(self.sampling, seed=seed))

    def check(self, dashes: str = "", clip: bool = False) -> None:
        """Whether this can be requested; what the sentence says is checked where it is read.

        Args:
            dashes: What stands before the names of options in messages.
            clip: Whether a clip is edited.

        Raises:
            OptionError: A number is outside its limits, or parts of the request do not go together.
        """
        self.sampling.check(dashes)
        self.apparel.check(dashes)
        check_handles(self.handles)
        self.constraints.check(dashes, clip)
        if self.rig not in RIGS:
            raise OptionError(f"what moves is 'auto', 'own' or 'handles', not '{self.rig}'; choose one of the three")
        if self.rig == "own" and self.handles_given:
            raise OptionError(f"handles are no bones of the file; leave out {dashes}rig own or {dashes}handles")
        self.apparel.check_with(self.constraints, self.handles_given or self.rig == "handles", dashes)

    @property
    def handles_given(self) -> bool:
        """Whether it says which handles there are, or that they are made in another way than by default."""
        return not isinstance(self.handles, str) or self.handles != "predict"

    def to_json(self) -> dict[str, Any]:
        """The JSON form.

        Raises:
            OptionError: It holds handles or a clip themselves, and not their names.
        """
        if not isinstance(self.handles, str):
            raise OptionError("handles that were made have no form in JSON; say how they are made: 'predict' or 'rig'")
        return {
            "sentence": self.prompt, "sampling": to_json(self.sampling),
            "constraints": self.constraints.to_json(), "apparel": to_json(self.apparel),
            "stages": None if self.stages is None else to_json(self.stages), "handles": self.handles,
            "force": self.force, "rig": self.rig,
        }  # fmt: skip

    @classmethod
    def from_json(cls, data: object) -> Request:
        """The request of a JSON form, checked.

        Raises:
            OptionError: It is none, or cannot be requested.
        """
        form = from_json(_Form, data, "the request")
        stages = None
        if form.stages is not None:
            from bunraku.retarget.stages.switches import Stages

            stages = from_json(Stages, form.stages, "stages")
        constraints = Constraints.from_json(form.constraints)
        found = cls(
            form.sentence, form.sampling, constraints, form.apparel, stages, form.handles, form.force, form.rig
        )  # fmt: skip
        found.check(clip=any(one.kind in ("keep", "pose") for one in constraints))
        return found


@dataclass(frozen=True)
class _Form:
    """The keys of a request's JSON form, with what is read by classes of its own as it is."""

    sentence: str
    sampling: Sampling = field(default_factory=Sampling)
    constraints: tuple[object, ...] = ()
    apparel: Apparel = field(default_factory=Apparel)
    stages: object = None
    handles: Literal["predict", "rig"] = "predict"
    force: bool = False
    rig: Literal["auto", "own", "handles"] = "auto"


def check_handles(handles: object) -> None:
    """Raise OptionError unless these are handles, or a way to make them."""
    if isinstance(handles, str) and handles not in HANDLES:
        raise OptionError(f"handles are made by 'predict' or 'rig', not '{handles}'; choose one of the two")
