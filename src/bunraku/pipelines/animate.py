"""TapMo's Figure 2 as code: mesh -> handles -> motion from a sentence -> animation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal, TypeVar, cast, overload

import numpy as np

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import MotionError, OptionError
from bunraku.pipelines.apply import fit_performed, perform, perform_dressed, reference_of
from bunraku.retarget.fit import Stages

__all__ = ["animate", "edit", "generate", "rig"]

Progress = Callable[[str, float], None]


def rig(character: Character, *, handles: Literal["predict", "rig"] = "predict", progress: Progress | None = None) -> Handles:
    """The handles of a character (Eq. 1 of TapMo): positions h, skinning weights s and the mesh feature f_phi.

    Args:
        character: Any mesh, +Y up and facing +Z.
        handles: "predict" them from the shape alone, or take those of the file's own "rig", told by the names of its bones.
        progress: Called with a stage's name and the share done, 0 to 1.

    Raises:
        CharacterError: The handles are to be the rig's, and there is none, or its bones have no telling names.
        OptionError: `handles` is neither.
        WeightsError: The shipped weights are missing or broken.
    """
    from bunraku.handles.from_rig import rig_handles
    from bunraku.handles.predict import mesh_feature, predict_handles

    if handles not in ("predict", "rig"):
        raise OptionError(f"handles are made by 'predict' or 'rig', not '{handles}'; choose one of the two")
    if progress:
        progress("handles", 0.0)
    found = replace(rig_handles(character), features=mesh_feature(character)) if handles == "rig" else predict_handles(character)
    found = found.top(4)  # what viewers read, so the file plays as the library does
    if progress:
        progress("handles", 1.0)
    return found


def _scripts(prompts: Sequence[str], seconds: float) -> list[list[tuple[str, float]]]:
    """The clauses of each prompt with their seconds; what cannot be generated is refused before anything is loaded."""
    from bunraku.language.clauses import timed_clauses
    from bunraku.language.encoders import check_prompt
    from bunraku.language.sequence import parse_sequence, timed_sequence

    scripts = []
    for prompt in prompts:
        if not isinstance(prompt, str):
            raise OptionError("the prompt must be a sentence")
        timed = timed_sequence(parse_sequence(prompt), seconds)
        scripts.append([clause for part, length in timed for clause in timed_clauses(check_prompt(part), length)])
    return scripts


@overload
def generate(
    prompt: str,
    *,
    seconds: float = ...,
    seed: int | Sequence[int] = ...,
    steps: int | None = ...,
    guidance: float | None = ...,
    mesh_feature: object | None = ...,
    loop: bool = ...,
    after: HandleMotion | None = ...,
    progress: Progress | None = ...,
) -> HandleMotion: ...


@overload
def generate(
    prompt: list[str] | tuple[str, ...],
    *,
    seconds: float = ...,
    seed: int | Sequence[int] = ...,
    steps: int | None = ...,
    guidance: float | None = ...,
    mesh_feature: object | None = ...,
    loop: bool = ...,
    after: HandleMotion | None = ...,
    progress: Progress | None = ...,
) -> list[HandleMotion]: ...


def generate(
    prompt: str | list[str] | tuple[str, ...],
    *,
    seconds: float = 6.0,
    seed: int | Sequence[int] = 0,
    steps: int | None = None,
    guidance: float | None = None,
    mesh_feature: object | None = None,
    loop: bool = False,
    after: HandleMotion | None = None,
    progress: Progress | None = None,
) -> HandleMotion | list[HandleMotion]:
    """Handle motions of the reference body from sentences (Eq. 2 of TapMo).

    Args:
        prompt: What the character does, in English; several sentences in a row with their seconds ("walks:4; jumps:2; waves:3");
            or a list of such prompts, which are made in one batch.
        seconds: Length [s], 0.5 to 120; what prompts without seconds of their own share.
        seed: The same seed and version give the same motion. One number gives each prompt of a list noise of its own, the first
            as when it is alone; a list has one for each.
        steps: Sampling steps; None takes the default.
        guidance: Classifier-free guidance scale; None takes the default.
        mesh_feature: f_phi of the character, shape (448,); None generates for no mesh in particular.
        loop: Make a loop: the last frame is the first again, at another place where the motion travels.
        after: Motion of the reference body whose last pose is the first of the new motion.
        progress: Called with a stage's name and the share done.

    Raises:
        OptionError: A prompt is empty or too long, a length is out of range, or a loop is to follow another motion.
        MotionError: `after` is no motion of the reference body at 20 frames a second.
        WeightsError: The shipped weights are missing or broken.
    """
    prompts = [prompt] if isinstance(prompt, str) else list(prompt)
    scripts = _scripts(prompts, seconds)
    if loop and after is not None:
        raise OptionError("a loop ends where it starts, so it cannot follow another motion; leave one of the two out")
    how: dict[str, Any] = {"steps": steps, "guidance": guidance, "mesh_feature": mesh_feature, "progress": progress}
    from bunraku.diffusion.generate import generate_motions

    if after is None:
        motions = generate_motions(scripts, seeds=seed, loop=loop, **how)
    else:
        from bunraku.diffusion.editing import continue_motion

        seeds = [seed + index for index in range(len(scripts))] if isinstance(seed, int) else list(seed)
        if len(seeds) != len(scripts):
            raise OptionError(f"{len(scripts)} motions need as many seeds, not {len(seeds)}")
        motions = [continue_motion(after, script, seed=one, **how) for script, one in zip(scripts, seeds, strict=True)]
    return motions[0] if isinstance(prompt, str) else motions


@overload
def animate(
    character: Character,
    prompt: str,
    *,
    seconds: float = ...,
    seed: int = ...,
    steps: int | None = ...,
    guidance: float | None = ...,
    handles: Handles | Literal["predict", "rig"] = ...,
    apparel: Literal["rigid"] = ...,
    loop: bool = ...,
    in_place: bool = ...,
    after: HandleMotion | Animation | None = ...,
    stages: Stages | None = ...,
    progress: Progress | None = ...,
) -> Animation: ...


@overload
def animate(
    character: Character,
    prompt: str,
    *,
    seconds: float = ...,
    seed: int = ...,
    steps: int | None = ...,
    guidance: float | None = ...,
    apparel: Literal["simulate"],
    in_place: bool = ...,
    stages: Stages | None = ...,
    progress: Progress | None = ...,
) -> RigAnimation: ...


def animate(
    character: Character,
    prompt: str,
    *,
    seconds: float = 6.0,
    seed: int = 0,
    steps: int | None = None,
    guidance: float | None = None,
    handles: Handles | Literal["predict", "rig"] = "predict",
    apparel: Literal["rigid", "simulate"] = "rigid",
    loop: bool = False,
    in_place: bool = False,
    after: HandleMotion | Animation | None = None,
    stages: Stages | None = None,
    progress: Progress | None = None,
) -> Animation | RigAnimation:
    """Make a character do what a sentence says.

    Args:
        character: Any mesh, +Y up and facing +Z.
        prompt: What it does, in English; or several sentences in a row with their seconds: "walks:4; jumps:2; waves:3".
        seconds: Length [s], 0.5 to 120; what sentences without seconds of their own share.
        seed: The same seed and version give the same animation.
        steps: Sampling steps; None takes the default.
        guidance: Classifier-free guidance scale; None takes the default.
        handles: The character's handles, or how to make them: "predict" or "rig" (see `rig`).
        apparel: "rigid" moves hair and clothes with the body; "simulate" moves the bones of the character's own rig, and hair and clothes
            by the rigid bodies or springs of its MMD or VRM file.
        loop: Make a loop: the last pose is the first again, at another place where the motion travels.
        in_place: Take the way over the ground out, as game engines want it that move the character themselves.
        after: Start in the last pose of this: an animation of the same character, or a motion of the reference body.
        stages: Which stages fit the motion to the character; `retarget.perform.PERFORM_STAGES` when None.
        progress: Called with a stage's name and the share done, 0 to 1.

    Returns:
        The animation at 20 frames a second, or at 30 where apparel is simulated.

    Raises:
        OptionError: The prompt is empty or too long, the length is out of range, a loop is to follow another clip, or simulated apparel is
            to be looped, to follow a clip, or to be moved by handles.
        CharacterError: `handles` are not 30, or cannot be taken from the rig; or there are no physics to simulate.
        WeightsError: The shipped weights are missing or broken.
    """
    _scripts([prompt], seconds)
    if apparel not in ("rigid", "simulate"):
        raise OptionError(f"apparel moves by 'rigid' or 'simulate', not '{apparel}'; choose one of the two")
    if apparel == "simulate":
        if loop or after is not None:
            raise OptionError("simulated apparel starts from the rest pose, so it neither loops nor follows another clip; leave that out")
        if handles != "predict":
            raise OptionError("apparel is simulated on the bones of a character's rig; leave handles out")
        from bunraku.handles.predict import mesh_feature
        from bunraku.physics.animated import check_apparel

        check_apparel(character)  # before the work
        found = mesh_feature(character)
        made = generate(prompt, seconds=seconds, seed=seed, steps=steps, guidance=guidance, mesh_feature=found, progress=progress)
        return perform_dressed(made, character, in_place=in_place, stages=stages, progress=progress)
    if not isinstance(handles, Handles):
        handles = rig(character, handles=handles or "predict", progress=progress)
    before = after if isinstance(after, HandleMotion) or after is None else reference_of(after)
    motion = generate(
        prompt, seconds=seconds, seed=seed, steps=steps, guidance=guidance, mesh_feature=handles.features, loop=loop, after=before, progress=progress
    )  # fmt: skip
    return perform(motion, character, handles, loop=loop, in_place=in_place, after=after, stages=stages, progress=progress)


Clip = TypeVar("Clip", bound=HandleMotion | Animation)


def edit(
    clip: Clip,
    prompt: str,
    *,
    keep: str | Sequence[str] = (),
    span: tuple[float, float] | None = None,
    seed: int = 0,
    steps: int | None = None,
    guidance: float | None = None,
    stages: Stages | None = None,
    progress: Progress | None = None,
) -> Clip:
    """Keep chosen handles, or all but a span of seconds, and generate the rest from a sentence (section A.3 of TapMo).

    Args:
        clip: An animation, or a motion of the reference body at 20 frames a second.
        prompt: What is done instead, in English.
        keep: What stays as it is: root, legs, arms, left arm, upper body, lower body, head, torso, tail, wings, ... or single
            handles such as left_wrist; a list, or one text with commas.
        span: Seconds from and to which is generated; all of the clip by default.
        seed: The same seed and version give the same motion.
        steps: Sampling steps; None takes the default.
        guidance: Classifier-free guidance scale; None takes the default.
        stages: Which stages fit an animation's new motion to its character; all when None.
        progress: Called with a stage's name and the share done, 0 to 1.

    Returns:
        As many frames. What is kept holds the same arrays bit for bit: those of the animation's own motion, and of its `reference`.

    Raises:
        OptionError: Nothing is kept, or everything; the prompt is empty or too long; or the span is outside the clip.
        MotionError: The motion is not that of 30 handles at 20 frames a second.
        WeightsError: The shipped weights are missing or broken.
    """
    from bunraku.body.parts import kept_handles
    from bunraku.diffusion.editing import edit_motion, put_back, span_frames

    how: dict[str, Any] = {"keep": keep, "span": span, "seed": seed, "steps": steps, "guidance": guidance, "progress": progress}
    if isinstance(clip, HandleMotion):
        return cast(Clip, edit_motion(clip, prompt, **how))
    assert isinstance(clip, Animation)
    handles = clip.handles
    if handles.features is None:
        from bunraku.handles.predict import mesh_feature

        handles = replace(handles, features=mesh_feature(clip.character))
    reference = reference_of(clip)
    if len(reference) != len(clip.motion):
        raise MotionError(f"the clip has {len(clip.motion)} frames and its motion of the reference body {len(reference)}; save it again")
    made = edit_motion(reference, prompt, mesh_feature=handles.features, **how)
    if progress:
        progress("fit", 0.0)
    kept = np.zeros(len(handles.positions), bool)
    if keep:
        kept = kept_handles(keep)[handles.played]  # a spare handle that plays a kept part is kept with it
    first, after = (0, len(made)) if span is None else span_frames(span, len(made), made.fps)
    fitted = put_back(fit_performed(made, clip.character, handles, stages), clip.motion, kept, first, after)
    if progress:
        progress("fit", 1.0)
    return cast(Clip, Animation(clip.character, clip.handles, fitted, made))
