"""TapMo's Figure 2 as code: mesh -> handles -> motion from a sentence -> animation."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animated import AnimatedCharacter
from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.ground_path import GroundPath
from bunraku.core.motion import HandleMotion
from bunraku.core.rig_animation import RigAnimation
from bunraku.diffusion.drawing import Drawing
from bunraku.diffusion.networks import Networks
from bunraku.errors import OptionError
from bunraku.handles.predict import Predictor
from bunraku.language.parse import parse
from bunraku.language.sentence import Sentence
from bunraku.pipelines.apply import apply_motion, apply_rigged, reference_of, reference_path
from bunraku.pipelines.bodies import as_bodies_do, moved_ways
from bunraku.pipelines.requests.apparel import Apparel
from bunraku.pipelines.requests.constraints import Constraints
from bunraku.pipelines.requests.request import Request, check_handles
from bunraku.retarget.stages.switches import Stages

__all__ = ["AT_ONCE", "Animator", "Body", "moved_by"]

Progress = Callable[[str, float], None]
AT_ONCE = 8
"""Sentences in one pass of the network."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Body:
    """A character as a request moves it.

    Args:
        character: Any mesh, +Y up and facing +Z.
        feature: Its mesh feature f_phi, which the denoiser sees, shape (448,).
        anatomy: What is known of it and its handles; None where the bones of its rig move it.
    """

    character: Character
    feature: np.ndarray | None
    anatomy: Anatomy | None = None


def _silent(stage: str, done: float) -> None:
    """Progress that nobody looks at."""


@dataclass(frozen=True, eq=False)
class Animator:
    """Makes characters do what sentences say: holds the networks, and its call is the pipeline.

    Args:
        predictor: Gives the handles of a character, and its mesh feature.
        networks: Denoiser, text encoder, ranker, critic, examples.
        progress: Called with a stage's name and the share done, 0 to 1.
    """

    predictor: Predictor = field(default_factory=Predictor)
    networks: Networks = field(default_factory=Networks)
    progress: Progress = _silent

    @classmethod
    def shipped(cls, progress: Progress | None = None) -> Animator:
        """One with the networks that come with Bunraku, each loaded when it is first needed."""
        return cls(progress=progress or _silent)

    def __call__(self, character: Character | Body, request: Request) -> AnimatedCharacter:
        """A character that does what a request says.

        Args:
            character: Any mesh, +Y up and facing +Z; or what `body` made of one.
            request: What it does, and how.

        Returns:
            An `Animation` at 20 frames a second, or a `RigAnimation` at 30 where apparel is simulated, or a
            `PointAnimation` at 30 where it is learned.

        Raises:
            OptionError: The request cannot be met.
            CharacterError: The handles are not 30, or cannot be taken from the rig; or there are no physics to
                simulate.
            WeightsError: Weights are missing or broken.
        """
        return next(self.each(character, [request]))

    def each(
        self, character: Character | Body, requests: Sequence[Request], only: Collection[int] | None = None
    ) -> Iterator[AnimatedCharacter]:
        """An animation of a character for each request, apparel and all, several in one pass of the denoiser.

        An animation does not depend on those beside it, but for the last bits of its numbers: sums are rounded
        otherwise in a pass of another size.

        Args:
            character: As of a single request.
            requests: They differ in sentence and seed alone.
            only: Indices of those whose animations are wanted, all where None. Those beside them are generated along,
                so that each is bit for bit the one that all of them would give.

        Raises:
            OptionError: The requests differ in more; and as of a single request.
        """
        for moved in self.moved(character, requests, only):
            yield self.dress(moved, requests[0].apparel)

    def moved(
        self, character: Character | Body, requests: Sequence[Request], only: Collection[int] | None = None
    ) -> Iterator[Animation | RigAnimation]:
        """As `each`, with apparel that goes with the body."""
        sentences, request = _read(requests), _common(requests)
        request.check()
        body = character if isinstance(character, Body) else self.body(character, request)
        sentences, as_people = _for_body(sentences, body.anatomy)
        drawing = self._drawing(request, body.feature, as_people)
        path = request.constraints.path
        path = path if body.anatomy is None else reference_path(path, body.anatomy)
        wanted = range(len(requests)) if only is None else sorted(only)
        for start in range(0, len(requests), AT_ONCE):
            some = range(start, min(start + AT_ONCE, len(requests)))
            if any(number in some for number in wanted):
                seeds = [requests[number].sampling.seed for number in some]
                motions = self._draw([sentences[number] for number in some], seeds, request.constraints, path, drawing)
                for number in some:
                    if number in wanted:
                        yield self._fitted(motions[number - start], sentences[number], body, request)

    def generate(
        self,
        requests: Sequence[Request],
        seeds: int | Sequence[int],
        feature: object | None = None,
        body: Anatomy | None = None,
    ) -> list[HandleMotion]:
        """Handle motions of the reference body, all in one pass of the denoiser (Eq. 2 of TapMo).

        Args:
            requests: They differ in sentence and seed alone. A path is in metres of the reference body.
            seeds: One for each motion; a single number gives each motion noise of its own, the first as when it is
                alone.
            feature: Mesh feature f_phi of the character, shape (448,); that of the handles of `body` when None.
            body: Of the character that is to be moved: sentences are taken as such a body can.
        """
        sentences, request = _read(requests), _common(requests)
        request.check()
        sentences, as_people = _for_body(sentences, body)
        feature = body.handles.features if feature is None and body is not None else feature
        drawing, constraints = self._drawing(request, feature, as_people), request.constraints
        motions = self._draw(sentences, seeds, constraints, constraints.path, drawing)
        if body is None:
            return motions
        return [moved_ways(motion, one, body, constraints.loop) for motion, one in zip(motions, sentences, strict=True)]

    def handles(self, character: Character, handles: Handles | str = "predict") -> Handles:
        """The handles of a character (Eq. 1 of TapMo), at most four weights a vertex, as viewers read them.

        Args:
            character: Any mesh, +Y up and facing +Z.
            handles: Those that are known, or how they are made: "predict" or "rig".

        Raises:
            CharacterError: They are to be the rig's, and there is none, or its bones have no telling names.
            OptionError: They are to be made otherwise.
            WeightsError: The weights are missing or broken.
        """
        if isinstance(handles, Handles):
            return handles
        check_handles(handles)
        self.progress("handles", 0.0)
        if handles == "rig":
            from bunraku.handles.from_rig import rig_handles

            found = replace(rig_handles(character), features=self.predictor.feature(character))
        else:
            found = self.predictor(character)
        found = found.top(4)
        self.progress("handles", 1.0)
        return found

    def body(self, character: Character, request: Request) -> Body:
        """A character as a request moves it; several runs of one character share it.

        Raises:
            CharacterError: Apparel is to be simulated, and its file says nothing of physics; or as of `handles`.
        """
        if moved_by(character, request) == "bones":
            return Body(character, self.predictor.feature(character))
        handles = self.handles(character, request.handles)
        return Body(character, handles.features, Anatomy.of(character, handles))

    def dress(self, moved: Animation | RigAnimation, apparel: Apparel) -> AnimatedCharacter:
        """An animation with its apparel moved.

        Raises:
            CharacterError: It is to be simulated without physics, or learned where there is none.
            FormatError: A mask is broken or belongs to another mesh.
            WeightsError: The weights are missing or broken.
        """
        if not apparel.moves:
            return moved
        from bunraku.pipelines.apparel import dressed

        return dressed(moved, apparel.motion, stiffness=apparel.stiffness, progress=self.progress)

    def _drawing(self, request: Request, feature: object | None, as_people: bool) -> Drawing:
        how = request.sampling
        return Drawing(
            how.steps, how.guidance, feature, self.progress, candidates=how.candidates, examples=as_people,
            pull=as_people, held=self.networks,
        )  # fmt: skip

    def _draw(
        self,
        sentences: Sequence[Sentence],
        seeds: int | Sequence[int],
        constraints: Constraints,
        path: GroundPath | None,
        drawing: Drawing,
    ) -> list[HandleMotion]:
        """A motion of the reference body for each sentence, along a path in its metres."""
        from bunraku.diffusion.editing import continue_motion
        from bunraku.diffusion.generate import generate_motions

        given, scripts = constraints.after, [sentence.clauses for sentence in sentences]
        if given is None:
            return generate_motions(scripts, seeds=seeds, loop=constraints.loop, path=path, **vars(drawing))
        before = given if isinstance(given, HandleMotion) else reference_of(given)
        own = [seeds + index for index in range(len(scripts))] if isinstance(seeds, int) else list(seeds)
        if len(own) != len(scripts):
            raise OptionError(f"{len(scripts)} motions need as many seeds, not {len(own)}")
        once = vars(replace(drawing, candidates=1))  # nothing is chosen of what goes on from a pose
        return [continue_motion(before, script, seed=seed, **once) for script, seed in zip(scripts, own, strict=True)]

    def _fitted(
        self, motion: HandleMotion, sentence: Sentence, body: Body, request: Request
    ) -> Animation | RigAnimation:
        """A motion of the reference body on a character."""
        constraints, stages = request.constraints, request.stages
        if body.anatomy is None:
            return apply_rigged(
                motion, body.character, in_place=constraints.in_place, stages=stages, progress=self.progress
            )
        motion = moved_ways(motion, sentence, body.anatomy, constraints.loop)
        return apply_motion(motion, body.anatomy, constraints, stages, self.progress)


def _for_body(sentences: list[Sentence], anatomy: Anatomy | None) -> tuple[list[Sentence], bool]:
    """Sentences as a body does them, and whether it moves as people do."""
    return (sentences, True) if anatomy is None else as_bodies_do(sentences, anatomy)


def moved_by(character: Character, request: Request) -> Literal["handles", "bones"]:
    """What moves a character by a request: its "handles", or the "bones" of its rig, where its apparel is simulated or
    learned. Handles that are given or asked for are what moves, and what goes along a path or meets pins is handles.

    Raises:
        CharacterError: Apparel is to be simulated, and its file says nothing of physics.
    """
    from bunraku.physics.animated import check_apparel
    from bunraku.retarget.rig_parts import is_humanoid_rig

    if request.apparel.motion == "simulate":
        check_apparel(character)  # before the work
        return "bones"
    predicted = isinstance(request.handles, str) and request.handles == "predict"
    directed = request.constraints.path is not None or bool(request.constraints.pins)
    bones = request.apparel.moves and predicted and not directed and is_humanoid_rig(character)
    return "bones" if bones else "handles"


def _read(requests: Sequence[Request]) -> list[Sentence]:
    """The sentence of each request; what cannot be generated is refused before anything is loaded, and what is not
    understood is told.
    """
    sentences = [
        one.sentence if isinstance(one.sentence, Sentence) else parse(one.sentence, one.sampling.seconds, one.force)
        for one in requests
    ]
    for note in (note for sentence in sentences for note in sentence.notes):
        _log.warning("%s", note)
    return sentences


def _common(requests: Sequence[Request]) -> Request:
    """What requests say that differ in sentence and seed alone."""
    if not requests:
        raise OptionError("there is nothing to generate; give at least one request")
    first = requests[0]
    for one in requests[1:]:
        same = ("constraints", "apparel", "stages", "handles", "force")
        alike = all(_alike(getattr(one, name), getattr(first, name)) for name in same)
        if not alike or replace(one.sampling, seed=first.sampling.seed) != first.sampling:
            raise OptionError("requests of one pass differ in sentence and seed alone; make the others apart")
    return first


def _alike(one: object, other: object) -> bool:
    """Whether two parts of requests are one object, or equal ones; arrays are not compared."""
    if one is other:
        return True
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_alike, one, other))
    return isinstance(one, str | bool | Apparel | Stages) and one == other
