"""Short forms of the pipeline (`pipelines.animator`): `rig`, `generate`, `animate`, and `edit`, which keeps a part."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, TypedDict, TypeVar, Unpack, cast, overload

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.handles.orientation import as_said
from bunraku.core.animation import AnimatedCharacter, Animation
from bunraku.core.body.layout import kept_handles
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.nn.layers import one_thread
from bunraku.core.request import Progress, checked
from bunraku.core.travel import GroundPath
from bunraku.errors import MotionError, OptionError
from bunraku.files import load_character
from bunraku.generation.candidates import SamplingSettings
from bunraku.language.parse import clause_of
from bunraku.pipelines.animator import Animator
from bunraku.pipelines.apply import fitted_motion, reference_of
from bunraku.pipelines.requests import Apparel, Constraints, Keep, Pose, Request, Sampling, whole_number
from bunraku.retarget.fit import Stages
from bunraku.retarget.pins import Pin, meet_pins


def opened(character: Character | str | Path) -> Character:
    """A character, read where its file is given; see `bunraku.load_character`."""
    return as_said(load_character(character)) if isinstance(character, str | Path) else character


@checked
def rig(
    character: Character | str | Path,
    *,
    handles: Literal["predict", "rig"] = "predict",
    progress: Progress | None = None,
) -> Handles:
    """The handles of a character (Eq. 1 of TapMo): positions h, skinning weights s and the mesh feature f_phi.

    Args:
        character: Any mesh, +Y up and facing +Z, or its file.
        handles: "predict" them from the shape alone, or take the bones of the file's own "rig", by their names.
        progress: Called with a stage's name and the share done, 0 to 1.

    Raises:
        CharacterError: The handles are to be the rig's, and there is none, or the names of its bones are not known.
        OptionError: `handles` is neither.
        WeightsError: The shipped weights are missing or broken.
    """
    return Animator.shipped(progress).handles(opened(character), handles)


@checked
def with_skeleton(
    character: Character | str | Path, names: Literal["mixamo", "vrm", "unreal"], *,
    handles: Handles | Literal["predict", "rig"] = "predict", progress: Progress | None = None,
) -> Character:  # fmt: skip
    """A person's mesh in a T-pose on a tree of joints for engines' humanoid retargeting; `animate` then moves these,
    and `save_character` writes them.

    Args:
        character: A person, +Y up and facing +Z, or its file.
        names: The program that names the joints.
        handles: The character's handles, which become joints, or how to make them (see `rig`).
        progress: Called with a stage's name and the share done, 0 to 1.

    Raises:
        CharacterError: It is not a person.
        OptionError: There are no such names.
        WeightsError: The shipped weights are missing or broken.
    """
    from bunraku.retarget.engine_skeleton import on_skeleton

    character = opened(character)
    return on_skeleton(Anatomy.of(character, Animator.shipped(progress).handles(character, handles)), names)


class _Generating(TypedDict, total=False):
    """Keyword arguments of `generate`."""

    seconds: float | None
    seed: int | Sequence[int]
    steps: int | None
    guidance: float | None
    mesh_feature: object | None
    loop: bool
    after: HandleMotion | None
    path: GroundPath | None
    candidates: int
    body: Anatomy | None
    force: bool
    progress: Progress | None


@overload
def generate(prompt: str, **how: Unpack[_Generating]) -> HandleMotion: ...


@overload
def generate(prompt: list[str] | tuple[str, ...], **how: Unpack[_Generating]) -> list[HandleMotion]: ...


@checked
def generate(
    prompt: str | list[str] | tuple[str, ...],
    *,
    seconds: float | None = None,
    seed: int | Sequence[int] = 0,
    steps: int | None = None,
    guidance: float | None = None,
    mesh_feature: object | None = None,
    loop: bool = False,
    after: HandleMotion | None = None,
    path: GroundPath | None = None,
    candidates: int = 3,
    body: Anatomy | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> HandleMotion | list[HandleMotion]:
    """Handle motions of the reference body from sentences (Eq. 2 of TapMo).

    Args:
        prompt: What the character does, in English or a language of `language.words`; several sentences in a row with
            their seconds ("walks:4; jumps:2; waves:3"); or a list of such prompts, which are made in one batch.
        seconds: Length [s], 0.5 to 120, shared by sentences without seconds of their own; None takes what fits the
            action (see `Sampling`).
        seed: The same seed and version give the same motion. One number gives each prompt of a list different noise,
            the first as when it is alone; a list has a seed for each prompt.
        steps: Sampling steps; None takes the default.
        guidance: Classifier-free guidance scale; None takes the default.
        mesh_feature: f_phi of the character, shape (448,); None generates for no mesh in particular.
        loop: Make a loop: the last frame equals the first, at another position where the motion travels.
        after: Motion of the reference body whose last pose is the first of the new motion.
        path: What the root follows on the ground, in metres of the reference body.
        candidates: Motions that are drawn, 1 to 16; a ranker chooses the best. A motion that follows another is drawn
            once.
        body: The anatomy of the character: sentences are adapted to it, so that a fish swims where the sentence says
            walk. `mesh_feature` is that of its handles where it is None.
        force: Generate where no movement of a sentence is understood.
        progress: Called with a stage's name and the share done.

    Raises:
        OptionError: A prompt is refused, a length is out of range, or a loop is to follow another motion.
        MotionError: `after` is not a motion of the reference body at 20 frames a second.
        WeightsError: The shipped weights are missing or broken.
    """
    prompts = [prompt] if isinstance(prompt, str) else list(prompt)
    if not prompts:
        return []
    several = cast("Sequence[int]", seed) if np.ndim(seed) else None
    seeds = whole_number("seed", seed) if several is None else [whole_number("seed", each) for each in several]
    sampling = Sampling(seconds, 0 if isinstance(seeds, list) else seeds, steps, guidance, candidates)
    constraints = Constraints.of(loop=loop, after=after, path=path)
    requests = [Request(text, sampling, constraints, force=force) for text in prompts]
    motions = Animator.shipped(progress).generate(requests, seeds, mesh_feature, body)
    return motions[0] if isinstance(prompt, str) else motions


class _Animating(TypedDict, total=False):
    """Keyword arguments of `animate`."""

    seconds: float | None
    seed: int
    steps: int | None
    guidance: float | None
    handles: Handles | Literal["predict", "rig"]
    apparel: str
    stiffness: float
    gravity: float
    loop: bool
    in_place: bool
    after: HandleMotion | AnimatedCharacter | None
    path: GroundPath | Sequence[Sequence[float]] | None
    pins: Sequence[Pin]
    stages: Stages | None
    candidates: int
    force: bool
    rig: Literal["auto", "own", "handles"]
    progress: Progress | None


@overload
def animate(character: Character | str | Path, prompt: str, **how: Unpack[_Animating]) -> AnimatedCharacter: ...


@overload
def animate(
    character: Character | str | Path, prompt: list[str] | tuple[str, ...], **how: Unpack[_Animating]
) -> list[AnimatedCharacter]: ...


@checked
def animate(
    character: Character | str | Path,
    prompt: str | list[str] | tuple[str, ...],
    *,
    seconds: float | None = None,
    seed: int = 0,
    steps: int | None = None,
    guidance: float | None = None,
    handles: Handles | Literal["predict", "rig"] = "predict",
    apparel: str = "none",
    stiffness: float = 1.0,
    gravity: float = 1.0,
    loop: bool = False,
    in_place: bool = False,
    after: HandleMotion | AnimatedCharacter | None = None,
    path: GroundPath | Sequence[Sequence[float]] | None = None,
    pins: Sequence[Pin] = (),
    stages: Stages | None = None,
    candidates: int = 3,
    force: bool = False,
    rig: Literal["auto", "own", "handles"] = "auto",
    progress: Progress | None = None,
) -> AnimatedCharacter | list[AnimatedCharacter]:
    """Make a character do what a sentence says.

    Args:
        character: Any mesh, +Y up and facing +Z, or its file.
        prompt: What it does, in English or a language of `language.words`; or several sentences in a row with their
            seconds: "walks:4; jumps:2; waves:3"; or a list of such prompts, which are made in shared passes, all with
            the same seed. Other bodies than a person's do it as their kind does: "a person walks" makes a dog walk on
            four legs.
        seconds: Length [s], 0.5 to 120, shared by sentences without seconds of their own; None takes what fits the
            action (see `Sampling`).
        seed: The same seed and version give the same animation.
        steps: Sampling steps; None takes the default.
        guidance: Classifier-free guidance scale; None takes the default.
        handles: The character's handles, or how to make them: "predict" or "rig" (see `rig`).
        apparel: How hair and clothes move; see `Apparel`.
        stiffness: Factor on the stiffness of apparel, 0.001 to 1000.
        gravity: Factor on the gravity of simulated apparel, 0 to 10.
        loop: Make a loop: the last pose equals the first, at another position where the motion travels.
        in_place: Remove the travel over the ground, for game engines that move the character themselves.
        after: Start in the last pose of this: an animation of the same character, or a motion of the reference body.
        path: What the root follows on the ground, in the character's metres, or its points; the clip starts where the
            path does.
        pins: Where hands and feet are at given times, in the world of the clip.
        stages: Which stages fit the motion to the character; `pipelines.apply.GENERATED_STAGES` when None.
        candidates: Motions that are drawn, 1 to 16; a ranker chooses the best.
        force: Animate where no movement of a sentence is understood.
        rig: What moves; see `Request`.
        progress: Called with a stage's name and the share done, 0 to 1.

    Returns:
        An `Animation` or, where its own bones move it, a `RigAnimation`, at 20 frames a second; at 30 where apparel is
        simulated, and a `PointAnimation` where it is learned. A list of them for a list of prompts.

    Raises:
        OptionError: The prompt is refused, a number is out of range, parts of the request do not go together, or a pin
            cannot be met.
        CharacterError: `handles` are not 30, or cannot be taken from the rig; or there are no physics to simulate.
        WeightsError: The shipped weights are missing or broken.
    """
    sampling = Sampling(seconds, seed, steps, guidance, candidates)
    constraints = Constraints.of(loop=loop, in_place=in_place, after=after, path=path, pins=pins)
    moved = Apparel(apparel, stiffness, gravity)
    requests = [
        Request(text, sampling, constraints, moved, stages, "predict" if handles is None else handles, force, rig)
        for text in ([prompt] if isinstance(prompt, str) else prompt)
    ]
    made = list(Animator.shipped(progress).each(opened(character), requests)) if requests else []
    return made[0] if isinstance(prompt, str) else made


_log = logging.getLogger(__name__)
Clip = TypeVar("Clip", bound=HandleMotion | Animation)


@one_thread()
def edited(animator: Animator, clip: Clip, request: Request) -> Clip:
    """A clip of which a part is kept and the rest generated from a sentence (section A.3 of TapMo).

    Args:
        request: What is done instead, and with `Keep`, `Pose` and `Pin` what stays. One candidate of the clip's length
            is drawn. Results and errors are those of `edit`.
    """
    from bunraku.core.travel import put_back_runs
    from bunraku.generation.generate import edit_motion, generated_runs, pose_frames, span_frames

    how, sentence = request.sampling, request.parsed
    for note in sentence.notes:
        _log.warning("%s", note)
    clause = clause_of(sentence.english)
    request.check(clip=True)
    parts, span = request.constraints.keep.parts, request.constraints.keep.span
    poses, pins = [pose.time for pose in request.constraints.poses], request.constraints.pins

    def generated(motion: HandleMotion, feature: np.ndarray | None) -> HandleMotion:
        drawing = SamplingSettings(how.steps, how.guidance, feature, animator.progress, held=animator.networks)
        return edit_motion(motion, clause, keep=parts, span=span, poses=poses, seed=how.seed, **vars(drawing))

    if isinstance(clip, HandleMotion):
        if pins:
            raise OptionError("pins are positions of a character's hands and feet; edit an animation of it")
        return cast(Clip, generated(clip, None))
    if not isinstance(clip, Animation):
        raise OptionError(
            f"a motion or an Animation of handles is edited, not {type(clip).__name__}; animate with rig='handles'"
        )
    handles = clip.handles
    if handles.features is None:
        handles = replace(handles, features=animator.predictor.feature(clip.character))
    anatomy = Anatomy.of(clip.character, handles)
    reference = reference_of(clip, anatomy)
    if len(reference) != len(clip.motion):
        raise MotionError(
            f"the clip has {len(clip.motion)} frames and its motion of the reference body {len(reference)}; save it "
            "again"
        )
    made = generated(reference, handles.features)
    animator.progress("fit", 0.0)
    kept = np.zeros(len(handles.positions), bool)
    if parts:
        kept = kept_handles(parts)[handles.played]  # a spare handle of a kept part is kept with it
    first, after = (0, len(made)) if span is None else span_frames(span, len(made), made.fps)
    runs = generated_runs(first, after, pose_frames(poses, len(made), made.fps))
    fitted = put_back_runs(fitted_motion(made, anatomy, request.stages), clip.motion, kept, runs)
    fitted = meet_pins(fitted, anatomy, pins)
    animator.progress("fit", 1.0)
    return cast(Clip, Animation(clip.character, clip.handles, fitted, made))


@checked
def edit(
    clip: Clip,
    prompt: str,
    *,
    keep: str | Sequence[str] = (),
    span: tuple[float, float] | None = None,
    poses: Sequence[float] = (),
    pins: Sequence[Pin] = (),
    seed: int = 0,
    steps: int | None = None,
    guidance: float | None = None,
    stages: Stages | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Clip:
    """Keep chosen handles, or all but a span of seconds, and generate the rest from a sentence (section A.3 of TapMo).

    Args:
        clip: An animation, or a motion of the reference body at 20 frames a second.
        prompt: What is done instead, in English or a language of `language.words`.
        keep: What stays: root, legs, arms, left arm, upper body, lower body, head, torso, tail, wings, ... or single
            handles such as left_wrist; a list, or one text with commas.
        span: The first and the last second that are generated; all of the clip by default.
        poses: Seconds of single poses that stay; what is between them is generated.
        pins: Where hands and feet of an animation are at given times; what is kept is bent near them too.
        seed: The same seed and version give the same motion.
        steps: Sampling steps; None takes the default.
        guidance: Classifier-free guidance scale; None takes the default.
        stages: Which stages fit an animation's new motion to its character; all when None.
        force: Generate where no movement of the sentence is understood.
        progress: Called with a stage's name and the share done, 0 to 1.

    Returns:
        As many frames. What is kept holds the same arrays bit for bit: those of the animation's own motion, and of its
        `reference`.

    Raises:
        OptionError: Nothing is kept, or everything; the prompt is refused; the span or a pose is outside the clip; or a
            pin cannot be met.
        MotionError: The motion is not that of 30 handles at 20 frames a second.
        WeightsError: The shipped weights are missing or broken.
    """
    parts = ((keep,) if keep else ()) if isinstance(keep, str) else tuple(keep)
    stays = [Keep(parts, span)] if parts or span is not None else []
    request = Request(
        prompt, Sampling(seed=seed, steps=steps, guidance=guidance),
        Constraints((*stays, *map(Pose, poses), *pins)), stages=stages, force=force,
    )  # fmt: skip
    return edited(Animator.shipped(progress), clip, request)
