"""TapMo's Figure 2 as code: mesh -> handles -> motion from a sentence -> animation."""

from __future__ import annotations

import html
import logging
import sys
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.corrected import corrected_handles
from bunraku.anatomy.handles.orientation import as_said
from bunraku.anatomy.handles.predict import Predictor
from bunraku.anatomy.scene import separated
from bunraku.core.animation import AnimatedCharacter, Animation, RigAnimation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion, resample
from bunraku.core.nn.checkpoints import dated_checkpoint
from bunraku.core.nn.layers import each_in_one_thread, one_thread
from bunraku.core.request import SECONDS, Progress
from bunraku.core.travel import GroundPath
from bunraku.errors import CharacterError, FormatError, OptionError
from bunraku.generation.networks import Networks
from bunraku.language.sentence import Sentence, in_stretches
from bunraku.pipelines.apply import (
    GENERATED_STAGES,
    adapt_to_body,
    apply_locomotion,
    apply_motion,
    apply_rigged,
    reference_of,
    reference_path,
)
from bunraku.pipelines.requests import RATE, Apparel, Constraints, InPlace, Loop, Request, check_handles
from bunraku.retarget.stages import Stages

if TYPE_CHECKING:
    from bunraku.generation.candidates import SamplingSettings
    from bunraku.retarget.creatures import CreatureMotion
    from bunraku.retarget.rig_parts import RigParts

LEAST = 0.1
"""Seconds between two pictures of a bar; chosen by eye."""


def cell_progress() -> Progress | None:
    """Progress bars in the running cell of a notebook, one for each stage; None outside notebooks."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is None or type(shell).__name__ != "ZMQInteractiveShell":  # a terminal
        return None
    from importlib import import_module

    return _Bars(import_module("IPython.display"))


class _Bars:
    """Progress bars of stages; `shown` is the module `IPython.display`."""

    def __init__(self, shown: Any):
        self.shown, self.stages, self.handle, self.last = shown, {}, None, 0.0  # type: ignore[var-annotated]

    def __call__(self, stage: str, done: float) -> None:
        self.stages[stage] = min(max(float(done), 0.0), 1.0)
        now = time.monotonic()
        if done < 1 and now - self.last < LEAST:
            return
        self.last = now
        picture = self.shown.HTML("".join(
            f'<div><progress value="{share:.3f}"></progress> {html.escape(name)}</div>'
            for name, share in self.stages.items()
        ))  # fmt: skip
        if self.handle is None:
            self.handle = self.shown.display(picture, display_id=True)
        else:
            self.handle.update(picture)


AT_ONCE = 8
"""Sentences in one pass of the network."""
STRETCH = 40.0
"""Length of a stretch of a longer clip [s]; chosen by eye."""
HISTORY = 60
"""Frames of a stretch that the next one is made to follow."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Body:
    """A character as a request moves it."""

    character: Character
    feature: np.ndarray | None  # its mesh feature f_phi, which the denoiser sees, shape (448,)
    anatomy: Anatomy  # what is known of it and its handles, which are its bones where these move it
    parts: RigParts | None = None  # the bones of its rig, where these move it

    @property
    def takes_skeleton(self) -> bool:
        """Whether an engine's skeleton can be made for it: it is a person, and its own bones do not move it."""
        return self.parts is None and self.anatomy.is_person


def _silent(*messages: object) -> None:
    """Progress and notes that are not shown."""


@dataclass(frozen=True, eq=False)
class Animator:
    """Makes characters do what sentences say: holds the networks, and its call is the pipeline.

    Args:
        predictor: Gives the handles of a character, and its mesh feature.
        networks: Denoiser, text encoder, ranker, critic, examples.
        progress: Called with a stage's name and the share done, 0 to 1.
        note: Called with a sentence for each thing that is requested and the body cannot do.
    """

    predictor: Predictor = field(default_factory=Predictor)
    networks: Networks = field(default_factory=Networks)
    progress: Progress = _silent
    note: Callable[[str], None] = _silent

    @classmethod
    def shipped(cls, progress: Progress | None = None, note: Callable[[str], None] | None = None) -> Animator:
        """One with the networks that come with Bunraku, each loaded when it is first needed."""
        return cls(progress=progress or cell_progress() or _silent, note=note or _silent)

    def __call__(self, character: Character | Body, request: Request) -> AnimatedCharacter:
        """A character, or its `body`, that does what a request says; results and errors are those of
        `bunraku.animate`.
        """
        return next(self.each(character, [request]))

    def each(
        self, character: Character | Body, requests: Sequence[Request], only: Collection[int] | None = None
    ) -> Iterator[AnimatedCharacter]:
        """An animation of a character for each request, apparel and all, several in one pass of the denoiser.

        An animation does not depend on those beside it, except in the last bits: sums are rounded differently in a pass
        of another size.

        Args:
            only: Indices of the animations that are wanted, all where None. Those beside them are generated along, so
                that each is bit for bit the one that all of them would give.

        Raises:
            OptionError: The requests differ in more; and as for a single request.
        """

        def dressed() -> Iterator[AnimatedCharacter]:
            sentences, request, body = self._prepared(character, requests)
            for moved in self._moved(body, sentences, request, requests, only):
                yield self.dress(moved, request.apparel, body.anatomy)

        return each_in_one_thread(dressed())

    def moved(
        self, character: Character | Body, requests: Sequence[Request], only: Collection[int] | None = None
    ) -> Iterator[Animation | RigAnimation]:
        """As `each`, with apparel that goes with the body."""
        sentences, request, body = self._prepared(character, requests)
        return each_in_one_thread(self._moved(body, sentences, request, requests, only))

    def _prepared(
        self, character: Character | Body, requests: Sequence[Request]
    ) -> tuple[list[Sentence], Request, Body]:
        """The sentences, what all requests share, and the body; what cannot be met is refused before the work."""
        sentences, request = _read(requests), _common(requests)
        request.check()
        _check_lengths(sentences)
        return sentences, request, character if isinstance(character, Body) else self.body(character, request)

    def _moved(
        self, body: Body, sentences: list[Sentence], request: Request, requests: Sequence[Request],
        only: Collection[int] | None,
    ) -> Iterator[Animation | RigAnimation]:  # fmt: skip
        sentences, as_people = adapt_to_body(sentences, body.anatomy)
        drawing = self._drawing(request, body.feature, as_people)
        path = reference_path(request.constraints.path, body.anatomy)
        wanted = range(len(requests)) if only is None else sorted(only)
        for note in dict.fromkeys(note for number in wanted for note in sentences[number].cannot):
            self.note(note)
        for start in range(0, len(requests), AT_ONCE):
            numbers = range(start, min(start + AT_ONCE, len(requests)))
            if any(number in numbers for number in wanted):
                seeds = {number: requests[number].sampling.seed for number in numbers}
                creatures = {} if request.constraints else _after_animals(sentences, seeds, body)
                left = [number for number in numbers if number not in creatures]
                motions: dict[int, HandleMotion] = {}
                if any(number in left for number in wanted):
                    group = [sentences[number] for number in left]
                    drawn = self._draw(group, [seeds[number] for number in left], request.constraints, path, drawing)
                    motions = dict(zip(left, drawn, strict=True))
                for number in numbers:
                    if number in wanted and number in creatures:
                        yield _fitted_creature(creatures[number], body, request)
                    elif number in wanted:
                        yield self._fitted(motions[number], sentences[number], body, request)

    @one_thread()
    def steered(
        self, body: Body, request: Request, change: Callable[[HandleMotion], HandleMotion]
    ) -> AnimatedCharacter:
        """An animation whose motion of the reference body is changed before it is fitted to the body."""
        sentences, as_people = adapt_to_body([request.parsed], body.anatomy)
        drawing = replace(self._drawing(request, body.feature, as_people), all_led=True)
        (motion,) = self._draw(sentences, [request.sampling.seed], request.constraints, None, drawing)
        return self._fitted(change(motion), sentences[0], body, request)

    def clips(
        self, character: Character | Body, requests: Mapping[str, Request]
    ) -> Iterator[tuple[str, AnimatedCharacter]]:
        """The animation of each request by its name, all moved by the same handles or bones, as the clips of one file
        are (`bunraku.save_clips`). The first request says what moves the character. Requests that differ in sentence
        and seed alone share passes of the denoiser.

        Raises:
            OptionError: A request cannot be met.
        """
        left = dict(requests)
        while left:
            lead = next(iter(left.values()))
            body = character = character if isinstance(character, Body) else self.body(character, lead)
            group = {name: request for name, request in left.items() if alike(request, lead)}
            yield from zip(group, self.each(body, list(group.values())), strict=True)
            left = {name: request for name, request in left.items() if name not in group}

    def stretches(self, character: Character | Body, request: Request) -> Iterator[AnimatedCharacter]:
        """A clip of any length, stretch by stretch, so that only one is in memory (`files.write_stretches`). The first
        frame of each stretch is the last of the one before. Loops, paths, pins and moving apparel go with clips of one
        pass only.

        Raises:
            OptionError: The request cannot be met so.
        """
        (sentence,) = _read([request])
        kinds = {constraint.kind for constraint in request.constraints} - {"in_place", "after"}
        if kinds or request.apparel.moves:
            raise OptionError(
                f"a clip of more than {SECONDS.high:g} seconds goes with no loop, path, pin or apparel that moves; "
                "leave these out, or make it shorter"
            )
        body = character if isinstance(character, Body) else self.body(character, request)
        parts = list(in_stretches(sentence, STRETCH))
        for number, part in enumerate(parts):

            def report(stage: str, done: float, number: int = number) -> None:
                within = 0.8 * done if stage == "generate" else 0.8
                self.progress("stretches", (number + within) / len(parts))

            seed = request.sampling.seed + number
            motion = replace(self, progress=report)(body, replace(request.with_seed(seed), sentence=part))
            yield motion
            self.progress("stretches", (number + 1) / len(parts))
            last = motion.take(slice(-HISTORY, None))
            request = replace(request, constraints=request.constraints.following(last))

    def generate(
        self, requests: Sequence[Request], seeds: int | Sequence[int], feature: object | None = None,
        body: Anatomy | None = None,
    ) -> list[HandleMotion]:  # fmt: skip
        """Handle motions of the reference body, all in one pass of the denoiser (Eq. 2 of TapMo).

        Args:
            requests: They differ in sentence and seed alone. A path is in metres of the reference body.
            seeds: One for each motion; a single number gives each motion different noise, the first as when it is
                alone.
            feature: Mesh feature f_phi of the character, shape (448,); that of the handles of `body` when None.
            body: The anatomy of the character, to which the sentences are adapted.
        """
        sentences, request = _read(requests), _common(requests)
        request.check()
        _check_lengths(sentences)
        sentences, as_people = (sentences, True) if body is None else adapt_to_body(sentences, body)
        feature = body.handles.features if feature is None and body is not None else feature
        drawing, constraints = self._drawing(request, feature, as_people), request.constraints
        motions = self._draw(sentences, seeds, constraints, constraints.path, drawing)
        if body is None:
            return motions
        return [
            apply_locomotion(motion, sentence, body, constraints.loop)
            for motion, sentence in zip(motions, sentences, strict=True)
        ]

    @one_thread()
    def handles(self, character: Character, handles: Handles | str = "predict") -> Handles:
        """The handles of a character (Eq. 1 of TapMo), at most four weights a vertex, as viewers read them.

        Args:
            handles: Known ones, or how to make them: "predict" or "rig". Errors are those of `bunraku.rig`.
        """
        if isinstance(handles, Handles):
            return handles
        check_handles(handles)
        self.progress("handles", 0.0)
        if handles == "rig":
            from bunraku.anatomy.names.bone_names import rig_handles

            best = replace(rig_handles(character), features=self.predictor.feature(character))
        else:
            from bunraku.apparel.parts import handles_of_body

            best = corrected_handles(character, handles_of_body(character, self.predictor).top(4))
        best = best.top(4)
        self.progress("handles", 1.0)
        return best

    def _anatomy(self, character: Character, handles: Handles | str) -> Anatomy:
        """The measured anatomy of a character by its handles. The character keeps the last one, so that its next
        sentence need not find them again.
        """
        by = dated_checkpoint("handles", self.predictor.checkpoint) if handles == "predict" else handles
        kept: tuple[object, Anatomy] | None = character.__dict__.get("_measured")
        arrays = isinstance(by, Handles) or (kept is not None and isinstance(kept[0], Handles))
        if kept is None or (kept[0] is not by if arrays else kept[0] != by):
            kept = by, Anatomy.of(character, self.handles(character, handles)).measured()
            character.__dict__["_measured"] = kept
        return kept[1]

    @one_thread()
    def body(self, character: Character, request: Request) -> Body:
        """A character as a request moves it; several runs of one character share it.

        Raises:
            CharacterError: Apparel is to be simulated without physics; the bones are to move the character, and they
                are not understood; or as for `handles`.
        """

        character, lines = separated(character if request.handles_given else as_said(character))
        for line in lines:
            _log.warning("%s: %s", character.name, line)

        @cache
        def on_handles() -> Anatomy:
            return self._anatomy(character, request.handles)

        parts = own_rig(character, request, on_handles)
        if parts is not None:
            feature = parts.handles.features
            return Body(
                character, self.predictor.feature(character) if feature is None else feature, parts.anatomy, parts
            )
        written = None if request.rig == "handles" or request.handles_given else _written_handles(character)
        if written is not None:
            handles = replace(written, features=self.predictor.feature(character))
            return Body(character, handles.features, Anatomy.of(character, handles).measured())
        _note_rig(character, on_handles().handles, request)
        return Body(character, on_handles().handles.features, on_handles())

    def dress(
        self, moved: Animation | RigAnimation, apparel: Apparel, anatomy: Anatomy | None = None
    ) -> AnimatedCharacter:
        """An animation with its apparel moved; errors are those of `pipelines.apparel.dressed`.

        Args:
            anatomy: Of the character by what moves it; found where it is needed and None.
        """
        if not apparel.moves:
            return moved
        from bunraku.pipelines.apparel import dressed

        return dressed(moved, apparel, self.progress, anatomy)

    def _drawing(self, request: Request, feature: object | None, as_people: bool) -> SamplingSettings:
        from bunraku.generation.candidates import SamplingSettings  # which a body's parts are found without

        how = request.sampling
        return SamplingSettings(
            how.steps, how.guidance, feature, self.progress, candidates=how.candidates, examples=as_people,
            classifier_guidance=as_people, note=self.note, held=self.networks,
        )  # fmt: skip

    def _draw(
        self, sentences: Sequence[Sentence], seeds: int | Sequence[int], constraints: Constraints,
        path: GroundPath | None, drawing: SamplingSettings,
    ) -> list[HandleMotion]:  # fmt: skip
        """A motion of the reference body for each sentence, along a path in its metres."""
        from bunraku.generation.generate import continue_motion, generate_motions

        given, scripts = constraints.after, [sentence.clauses for sentence in sentences]
        if given is None:
            return generate_motions(scripts, seeds=seeds, loop=constraints.loop, path=path, **vars(drawing))
        before = given if isinstance(given, HandleMotion) else reference_of(given)
        each = [seeds + index for index in range(len(scripts))] if isinstance(seeds, int) else list(seeds)
        if len(each) != len(scripts):
            raise OptionError(f"{len(scripts)} motions need as many seeds, not {len(each)}")
        once = vars(replace(drawing, candidates=1))  # motions that follow a pose are not ranked
        return [continue_motion(before, script, seed=seed, **once) for script, seed in zip(scripts, each, strict=True)]

    def _fitted(
        self, motion: HandleMotion, sentence: Sentence, body: Body, request: Request
    ) -> Animation | RigAnimation:
        """A motion of the reference body on a character."""
        constraints, stages = request.constraints, request.stages
        motion = apply_locomotion(motion, sentence, body.anatomy, constraints.loop)
        if body.parts is None:
            return apply_motion(motion, body.anatomy, constraints, stages, self.progress)
        if request.apparel.moves:
            motion = resample(motion, RATE)  # apparel swings faster than the network's 20 frames a second can show
        return apply_rigged(motion, body.parts, constraints, stages, self.progress)


def _after_animals(sentences: Sequence[Sentence], seeds: Mapping[int, int], body: Body) -> dict[int, CreatureMotion]:
    """What sentences ask for, by number, where clips of animals show all of it (`retarget.creature_clips`)."""
    from bunraku.retarget.creature_clips import creature_motion

    taken = {
        number: creature_motion(sentences[number], body.anatomy, seed, body.parts) for number, seed in seeds.items()
    }
    return {number: motion for number, motion in taken.items() if motion is not None}


def _fitted_creature(motion: CreatureMotion, body: Body, request: Request) -> Animation | RigAnimation:
    """A motion after clips of animals on a character."""
    from bunraku.retarget.creatures import fit_body

    if body.parts is None:
        return fit_body(motion, body.anatomy, request.stages or GENERATED_STAGES)
    return fit_body(motion.at(RATE) if request.apparel.moves else motion, body.parts, request.stages or Stages())


def own_rig(character: Character, request: Request, on_handles: Callable[[], Anatomy] | None = None) -> RigParts | None:
    """The rig whose bones move a character by a request; None where its handles do.

    Args:
        on_handles: Gives its anatomy by its handles, by which bones are known that have other names; None for names
            alone.

    Raises:
        CharacterError: Apparel is to be simulated without physics; or the character's bones are to move it, and there
            are none, or they are not understood.
    """
    if request.apparel.motion == "simulate":
        from bunraku.apparel.chains.moving import check_apparel
        from bunraku.retarget.rig_parts import RigParts

        check_apparel(character)  # before the work
        return RigParts.of(character)
    if request.rig == "handles" or request.handles_given or (request.rig == "auto" and character.rig is None):
        return None
    if _written_handles(character) is not None:
        return None
    from bunraku.retarget.rig_parts import RigParts, understood_rig

    said = character.corrections is not None and character.corrections.changes_body
    parts = None if said and on_handles is not None else understood_rig(character)
    parts = parts or (RigParts.by_skin(on_handles()) if on_handles and character.rig else None)
    if parts is not None or request.rig == "auto":
        return parts
    if character.rig is None:
        raise CharacterError(
            f"{character.name}: there is no rig in this file; move its handles instead (--rig handles)"
        )
    raise CharacterError(f"{character.name}: {_not_understood(character)}; move its handles instead (--rig handles)")


def _written_handles(character: Character) -> Handles | None:
    """The handles of a file that Bunraku wrote; None of others."""
    if character.rig is None:
        return None
    from bunraku.files import clip_handles

    try:
        return clip_handles(Path(character.name), character)
    except FormatError:
        return None


def _note_rig(character: Character, handles: Handles, request: Request) -> None:
    """Log that handles move a character, although it has a rig or clips, and what is left out for it."""
    left = left_out(character)
    if left and request.rig == "auto" and not request.handles_given:
        why = "its clips move nodes without a skin" if character.rig is None else _not_understood(character)
        _log.warning("%s: %s; %d handles move it, without %s", character.name, why, len(handles.positions), left)


def left_out(character: Character) -> str:
    """What of a file is left out where handles move its character, in words; "" for nothing."""
    document = getattr(character.source, "document", None)
    clips = 0 if document is None else len(document.items("animations"))
    return " and ".join(
        ["its bones"] * (character.rig is not None) + [f"its {clips} clip{'s'[: clips - 1]}"] * (clips > 0)
    )


def _not_understood(character: Character) -> str:
    assert character.rig is not None
    names = ", ".join(character.rig.names[:3])
    return (
        f"its rig of {len(character.rig.names)} bones ({names} ...) is not understood: neither their names nor the "
        "skin that they hold make them the limbs of its body"
    )


def _check_lengths(sentences: Sequence[Sentence]) -> None:
    """Raise OptionError where a sentence is too long for one pass."""
    for sentence in sentences:
        if not SECONDS.low <= sentence.seconds <= SECONDS.high + 1e-9:
            raise OptionError(
                f"a clip that is made in one pass lasts {SECONDS.low:g} to {SECONDS.high:g} seconds, not "
                f"{sentence.seconds:g}; choose a length in between, or make it stretch by stretch "
                "(`Animator.stretches`), as `bunraku animate` does where it writes a .glb"
            )


def _read(requests: Sequence[Request]) -> list[Sentence]:
    """The parsed sentence of each request; what is not understood is logged."""
    sentences = [request.parsed for request in requests]
    for note in (note for sentence in sentences for note in sentence.notes):
        _log.warning("%s", note)
    return sentences


def _common(requests: Sequence[Request]) -> Request:
    """The first of requests that differ in sentence and seed alone."""
    if not requests:
        raise OptionError("there is nothing to generate; give at least one request")
    first = requests[0]
    if not all(alike(request, first) for request in requests[1:]):
        raise OptionError("requests of one pass differ in sentence and seed alone; make the others separately")
    return first


def alike(one: Request, other: Request) -> bool:
    """Whether two requests differ in sentence and seed alone, so that one pass of the network makes both."""
    same = ("constraints", "apparel", "stages", "handles", "force", "rig")
    if not all(_alike(getattr(one, name), getattr(other, name)) for name in same):
        return False
    return replace(one.sampling, seed=other.sampling.seed) == other.sampling


def _alike(one: object, other: object) -> bool:
    """Whether two parts of requests are one object, or equal ones; arrays are not compared."""
    if one is other:
        return True
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_alike, one, other))
    return isinstance(one, str | bool | Apparel | Stages | Loop | InPlace) and one == other
