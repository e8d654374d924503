"""TapMo's Figure 2 as code: mesh -> handles -> motion from a sentence -> animation."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from itertools import compress
from typing import Any, Literal, overload

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animated import AnimatedCharacter
from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.ground_path import GroundPath
from bunraku.core.motion import HandleMotion
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import OptionError
from bunraku.language.parse import parse
from bunraku.language.sentence import Sentence
from bunraku.pipelines.apply import apply_motion, apply_rigged, apply_simulated, reference_of, reference_path
from bunraku.pipelines.bodies import as_bodies_do, moved_ways
from bunraku.pipelines.together import check_apparel_option, check_together, moves_apparel
from bunraku.retarget.fit import Stages
from bunraku.retarget.stages.pins import Pin

__all__ = ["animate", "animate_each", "generate", "rig"]

_log = logging.getLogger(__name__)

Progress = Callable[[str, float], None]
AT_ONCE = 8
"""Prompts in one pass of the network."""


def rig(
    character: Character, *, handles: Literal["predict", "rig"] = "predict", progress: Progress | None = None
) -> Handles:
    """The handles of a character (Eq. 1 of TapMo): positions h, skinning weights s and the mesh feature f_phi.

    Args:
        character: Any mesh, +Y up and facing +Z.
        handles: "predict" them from the shape alone, or take those of the file's own "rig", told by the names of its
            bones.
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
    found = (
        replace(rig_handles(character), features=mesh_feature(character))
        if handles == "rig"
        else predict_handles(character)
    )
    found = found.top(4)  # what viewers read, so the file plays as the library does
    if progress:
        progress("handles", 1.0)
    return found


CANDIDATES = 3
"""Motions that are drawn for each that is given back."""


def _read(prompts: Sequence[str], seconds: float, anyway: bool) -> list[Sentence]:
    """Each prompt read; what cannot be generated is refused before anything is loaded, and what is not understood is
    told.
    """
    sentences = [parse(prompt, seconds, anyway) for prompt in prompts]
    for note in (note for sentence in sentences for note in sentence.notes):
        _log.warning("%s", note)
    return sentences


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
    path: GroundPath | None = ...,
    candidates: int = ...,
    body: Anatomy | None = ...,
    anyway: bool = ...,
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
    path: GroundPath | None = ...,
    candidates: int = ...,
    body: Anatomy | None = ...,
    anyway: bool = ...,
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
    path: GroundPath | None = None,
    candidates: int = CANDIDATES,
    body: Anatomy | None = None,
    anyway: bool = False,
    progress: Progress | None = None,
) -> HandleMotion | list[HandleMotion]:
    """Handle motions of the reference body from sentences (Eq. 2 of TapMo).

    Args:
        prompt: What the character does, in English or a language of `language.words`; several sentences in a row with
            their seconds ("walks:4; jumps:2; waves:3"); or a list of such prompts, which are made in one batch.
        seconds: Length [s], 0.5 to 120; what prompts without seconds of their own share.
        seed: The same seed and version give the same motion. One number gives each prompt of a list noise of its own,
            the first as when it is alone; a list has one for each.
        steps: Sampling steps; None takes the default.
        guidance: Classifier-free guidance scale; None takes the default.
        mesh_feature: f_phi of the character, shape (448,); None generates for no mesh in particular.
        loop: Make a loop: the last frame is the first again, at another place where the motion travels.
        after: Motion of the reference body whose last pose is the first of the new motion.
        path: What the root follows on the ground, in metres of the reference body.
        candidates: How many motions are drawn for each that is given back, the one that the ranker likes best, 1 to
            16. A motion that follows another is drawn once.
        body: The anatomy of the character that is to be moved: sentences are taken as such a body can, so that a fish
            swims that is told to walk. `mesh_feature` is that of its handles where it is None.
        anyway: Generate even where no movement of a sentence is understood.
        progress: Called with a stage's name and the share done.

    Raises:
        OptionError: A prompt is empty, too long or not understood, a length is out of range, or a loop is to follow
            another motion.
        MotionError: `after` is no motion of the reference body at 20 frames a second.
        WeightsError: The shipped weights are missing or broken.
    """
    prompts = [prompt] if isinstance(prompt, str) else list(prompt)
    sentences = _read(prompts, seconds, anyway)
    check_together("rigid", loop=loop, after=after is not None, path=path is not None)
    as_people = True
    if body is not None:
        sentences, as_people = as_bodies_do(sentences, body)
        mesh_feature = body.handles.features if mesh_feature is None else mesh_feature
    how: dict[str, Any] = {
        "steps": steps, "guidance": guidance, "mesh_feature": mesh_feature, "examples": as_people, "pull": as_people,
        "progress": progress,
    }  # fmt: skip
    motions = _generated(sentences, seed, loop, after, path, candidates, how)
    if body is not None:
        motions = [moved_ways(motion, one, body, loop) for motion, one in zip(motions, sentences, strict=True)]
    return motions[0] if isinstance(prompt, str) else motions


def _generated(
    sentences: Sequence[Sentence],
    seed: int | Sequence[int],
    loop: bool,
    after: HandleMotion | None,
    path: GroundPath | None,
    candidates: int,
    how: dict[str, Any],
) -> list[HandleMotion]:
    """A motion for each sentence; arguments as for `generate`."""
    from bunraku.diffusion.generate import generate_motions

    scripts = [sentence.clauses for sentence in sentences]
    if after is None:
        return generate_motions(scripts, seeds=seed, loop=loop, path=path, candidates=candidates, **how)
    from bunraku.diffusion.editing import continue_motion

    seeds = [seed + index for index in range(len(scripts))] if isinstance(seed, int) else list(seed)
    if len(seeds) != len(scripts):
        raise OptionError(f"{len(scripts)} motions need as many seeds, not {len(seeds)}")
    return [continue_motion(after, script, seed=one, **how) for script, one in zip(scripts, seeds, strict=True)]


def animate(
    character: Character,
    prompt: str,
    *,
    seconds: float = 6.0,
    seed: int = 0,
    steps: int | None = None,
    guidance: float | None = None,
    handles: Handles | Literal["predict", "rig"] = "predict",
    apparel: str = "rigid",
    stiffness: float = 1.0,
    loop: bool = False,
    in_place: bool = False,
    after: HandleMotion | AnimatedCharacter | None = None,
    path: GroundPath | None = None,
    pins: Sequence[Pin] = (),
    stages: Stages | None = None,
    candidates: int = CANDIDATES,
    anyway: bool = False,
    progress: Progress | None = None,
) -> AnimatedCharacter:
    """Make a character do what a sentence says.

    Args:
        character: Any mesh, +Y up and facing +Z.
        prompt: What it does, in English or a language of `language.words`; or several sentences in a row with their
            seconds: "walks:4; jumps:2; waves:3". A body that is no person's does it as its own kind does, whoever is
            named: "a person walks" makes a dog walk on four legs.
        seconds: Length [s], 0.5 to 120; what sentences without seconds of their own share.
        seed: The same seed and version give the same animation.
        steps: Sampling steps; None takes the default.
        guidance: Classifier-free guidance scale; None takes the default.
        handles: The character's handles, or how to make them: "predict" or "rig" (see `rig`).
        apparel: "rigid" or "none" moves hair and clothes with the body; "simulate" moves the bones of the character's
            own rig, and hair and clothes by the rigid bodies or springs of its MMD or VRM file; "learn" moves by a
            network what it takes to be apparel of any mesh, or what a mask says, named by its file; "auto" simulates
            where the file has physics and learns where the mesh has apparel.
        stiffness: Factor on how stiff learned apparel is, 0.001 to 1000.
        loop: Make a loop: the last pose is the first again, at another place where the motion travels.
        in_place: Take the way over the ground out, as game engines want it that move the character themselves.
        after: Start in the last pose of this: an animation of the same character, or a motion of the reference body.
        path: What the root follows on the ground, in the character's metres; the clip starts where the path does.
        pins: Where hands and feet are at some times, in the world of the clip.
        stages: Which stages fit the motion to the character; `pipelines.apply.GENERATED_STAGES` when None.
        candidates: How many motions are drawn, of which the ranker chooses the best, 1 to 16.
        anyway: Animate even where no movement of a sentence is understood.
        progress: Called with a stage's name and the share done, 0 to 1.

    Returns:
        An `Animation` at 20 frames a second, or a `RigAnimation` at 30 where apparel is simulated, or a
        `PointAnimation` at 30 where it is learned.

    Raises:
        OptionError: The prompt is empty, too long or not understood, the length is out of range, a loop is to follow
            another clip, moving apparel is to be looped, to follow a clip, or simulated to be moved by handles, a path
            is to be looped, walked on the spot or to follow a clip, or a pin cannot be met.
        CharacterError: `handles` are not 30, or cannot be taken from the rig; or there are no physics to simulate.
        WeightsError: The shipped weights are missing or broken.
    """
    return next(
        animate_each(
            character, [prompt], seconds=seconds, seed=seed, steps=steps, guidance=guidance, handles=handles,
            apparel=apparel, stiffness=stiffness, loop=loop,
            in_place=in_place, after=after, path=path, pins=pins, stages=stages, candidates=candidates, anyway=anyway,
            progress=progress,
        )
    )  # fmt: skip


def animate_each(
    character: Character,
    prompts: Sequence[str],
    *,
    seconds: float = 6.0,
    seed: int = 0,
    steps: int | None = None,
    guidance: float | None = None,
    handles: Handles | Literal["predict", "rig"] = "predict",
    apparel: str = "rigid",
    stiffness: float = 1.0,
    loop: bool = False,
    in_place: bool = False,
    after: HandleMotion | AnimatedCharacter | None = None,
    path: GroundPath | None = None,
    pins: Sequence[Pin] = (),
    stages: Stages | None = None,
    candidates: int = CANDIDATES,
    anyway: bool = False,
    only: Collection[int] | None = None,
    progress: Progress | None = None,
) -> Iterator[AnimatedCharacter]:
    """One animation for each prompt, as `animate` makes them, several in one pass of the network.

    Each has the same seed, so that it does not depend on those beside it, but for the last bits of its numbers: sums
    are rounded otherwise in a pass of another size. Other arguments, results and errors are those of `animate`.

    Args:
        character: As for `animate`.
        prompts: What each does.
        only: Indices of the prompts whose animations are wanted, all where None. Those beside them are generated along,
            so that each is bit for bit the one that all of them would give.
    """
    sentences = _read(prompts, seconds, anyway)
    check_together(
        apparel, loop=loop, after=after is not None, handles=handles != "predict", path=path is not None,
        in_place=in_place, pins=bool(pins),
    )  # fmt: skip
    check_apparel_option(apparel, stiffness)
    as_people, anatomy = True, None
    moved_by = apparel_way(character, apparel, handles)
    if moved_by != "handles" and (path is not None or pins):
        moved_by = "handles"  # what goes along a path or meets pins
    if moved_by != "handles":
        from bunraku.handles.predict import mesh_feature

        feature: np.ndarray | None = mesh_feature(character)
    else:
        if not isinstance(handles, Handles):
            handles = rig(character, handles=handles or "predict", progress=progress)
        anatomy, feature = Anatomy.of(character, handles), handles.features
        sentences, as_people = as_bodies_do(sentences, anatomy)
    before = after if isinstance(after, HandleMotion) or after is None else reference_of(after)
    way = path if anatomy is None else reference_path(path, anatomy)
    how: dict[str, Any] = {
        "steps": steps, "guidance": guidance, "mesh_feature": feature, "examples": as_people, "pull": as_people,
        "progress": progress,
    }  # fmt: skip
    for start in range(0, len(sentences), AT_ONCE):
        some = sentences[start : start + AT_ONCE]
        wanted = [only is None or number in only for number in range(start, start + len(some))]
        if not any(wanted):
            continue
        motions = _generated(some, [seed] * len(some), loop, before, way, candidates, how)
        for number, motion in compress(enumerate(motions, start), wanted):
            if moved_by == "simulate":
                yield apply_simulated(motion, character, in_place=in_place, stages=stages, progress=progress)
                continue
            if anatomy is None:
                moved: Animation | RigAnimation = apply_rigged(
                    motion, character, in_place=in_place, stages=stages, progress=progress
                )
            else:
                motion = moved_ways(motion, sentences[number], anatomy, loop)
                moved = apply_motion(
                    motion, anatomy, loop=loop, in_place=in_place, after=after, path=path, pins=pins,
                    stages=stages, progress=progress
                )  # fmt: skip
            if moves_apparel(apparel):
                from bunraku.pipelines.apparel import dressed

                yield dressed(moved, apparel, stiffness=stiffness, progress=progress)
            else:
                yield moved


def apparel_way(character: Character, apparel: str, handles: object = "predict") -> str:
    """What moves a character whose apparel moves so: "handles", its "rig", or "simulate", its rig and the physics of
    its file.

    Args:
        character: The character.
        apparel: As of `animate`.
        handles: As of `animate`; where they are given or asked for they are what moves.

    Raises:
        CharacterError: It is to be simulated, and its file says nothing of physics.
    """
    from bunraku.physics.animated import check_apparel
    from bunraku.physics.from_file import apparel_rig
    from bunraku.retarget.rig_parts import is_humanoid_rig

    if apparel == "simulate":
        check_apparel(character)  # before the work
        return "simulate"
    if not moves_apparel(apparel) or handles != "predict" or not is_humanoid_rig(character):
        return "handles"
    return "simulate" if apparel == "auto" and apparel_rig(character) is not None else "rig"
