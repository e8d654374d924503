"""`edit`: keep a part of a motion or of an animation, and generate the rest."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar, cast

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.parts import kept_handles
from bunraku.core.animation import Animation
from bunraku.core.motion import HandleMotion
from bunraku.diffusion.generation.drawing import Drawing
from bunraku.errors import MotionError, OptionError
from bunraku.language.parse import clause_of
from bunraku.pipelines.animator import Animator
from bunraku.pipelines.apply import fitted_motion, reference_of
from bunraku.pipelines.requests.constraints import Constraints, Keep, Pose
from bunraku.pipelines.requests.request import Request, Sampling
from bunraku.retarget.fit import Stages
from bunraku.retarget.stages.pins import Pin, meet_pins

__all__ = ["edit", "edited"]

_log = logging.getLogger(__name__)
Clip = TypeVar("Clip", bound=HandleMotion | Animation)


def edited(animator: Animator, clip: Clip, request: Request) -> Clip:
    """A clip of which a part is kept and the rest generated from a sentence (section A.3 of TapMo).

    Args:
        animator: Holds the networks.
        clip: An animation, or a motion of the reference body at 20 frames a second.
        request: What is done instead, and with `Keep`, `Pose` and `Pin` what stays. It has the clip's length, and one
            candidate is drawn. Results and errors are those of `edit`.
    """
    from bunraku.core.travel import put_back_runs
    from bunraku.diffusion.generation.editing import edit_motion, generated_runs, pose_frames, span_frames

    how, sentence = request.sampling, request.parsed
    for note in sentence.notes:
        _log.warning("%s", note)
    clause = clause_of(sentence.english)
    request.check(clip=True)
    parts, span = request.constraints.keep.parts, request.constraints.keep.span
    poses, pins = [pose.time for pose in request.constraints.poses], request.constraints.pins

    def generated(motion: HandleMotion, feature: np.ndarray | None) -> HandleMotion:
        drawing = Drawing(how.steps, how.guidance, feature, animator.progress, held=animator.networks)
        return edit_motion(motion, clause, keep=parts, span=span, poses=poses, seed=how.seed, **vars(drawing))

    if isinstance(clip, HandleMotion):
        if pins:
            raise OptionError("pins are places of a character's hands and feet; edit an animation of it")
        return cast(Clip, generated(clip, None))
    assert isinstance(clip, Animation)
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
        kept = kept_handles(parts)[handles.played]  # a spare handle that plays a kept part is kept with it
    first, after = (0, len(made)) if span is None else span_frames(span, len(made), made.fps)
    runs = generated_runs(first, after, pose_frames(poses, len(made), made.fps))
    fitted = put_back_runs(fitted_motion(made, anatomy, request.stages), clip.motion, kept, runs)
    fitted = meet_pins(fitted, anatomy, pins)
    animator.progress("fit", 1.0)
    return cast(Clip, Animation(clip.character, clip.handles, fitted, made))


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
    progress: Callable[[str, float], None] | None = None,
) -> Clip:
    """Keep chosen handles, or all but a span of seconds, and generate the rest from a sentence (section A.3 of TapMo).

    Args:
        clip: An animation, or a motion of the reference body at 20 frames a second.
        prompt: What is done instead, in English or a language of `language.words`.
        keep: What stays as it is: root, legs, arms, left arm, upper body, lower body, head, torso, tail, wings, ... or
            single handles such as left_wrist; a list, or one text with commas.
        span: Seconds from and to which is generated; all of the clip by default.
        poses: Seconds of single poses that stay as they are; what is between them is generated.
        pins: Where hands and feet of an animation are at some times; what is kept is bent near them too.
        seed: The same seed and version give the same motion.
        steps: Sampling steps; None takes the default.
        guidance: Classifier-free guidance scale; None takes the default.
        stages: Which stages fit an animation's new motion to its character; all when None.
        force: Generate even where no movement of the sentence is understood.
        progress: Called with a stage's name and the share done, 0 to 1.

    Returns:
        As many frames. What is kept holds the same arrays bit for bit: those of the animation's own motion, and of its
        `reference`.

    Raises:
        OptionError: Nothing is kept, or everything; the prompt is empty, too long or not understood; the span or a
            pose is outside the clip; or a pin cannot be met.
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
