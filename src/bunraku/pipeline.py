"""TapMo's Figure 2 as code: mesh -> handles -> motion from a sentence -> animation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

from bunraku.animation import Animation
from bunraku.character import Character, Handles
from bunraku.errors import OptionError
from bunraku.motion import HandleMotion
from bunraku.retarget.fit import Stages, fit_motion

__all__ = ["LONGEST", "SHORTEST", "animate", "generate", "rig"]

SHORTEST, LONGEST = 0.5, 120.0
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


def _check(prompt: str, seconds: float) -> None:
    """Refuse what cannot be generated, before anything is loaded."""
    from bunraku.diffusion.text import check_prompt

    check_prompt(prompt)
    if not math.isfinite(seconds) or not SHORTEST <= seconds <= LONGEST:
        raise OptionError(f"a clip lasts {SHORTEST:g} to {LONGEST:g} seconds, not {seconds:g}; choose a length in between")


def generate(
    prompt: str,
    *,
    seconds: float = 6.0,
    seed: int = 0,
    steps: int | None = None,
    guidance: float | None = None,
    mesh_feature: object | None = None,
    progress: Progress | None = None,
) -> HandleMotion:
    """A handle motion of the reference body from a sentence (Eq. 2 of TapMo).

    Args:
        prompt: What the character does, in English.
        seconds: Length [s], 0.5 to 120.
        seed: The same seed and version give the same motion.
        steps: Sampling steps; None takes the default.
        guidance: Classifier-free guidance scale; None takes the default.
        mesh_feature: f_phi of the character, shape (448,); None generates for no mesh in particular.
        progress: Called with a stage's name and the share done.

    Raises:
        OptionError: The prompt is empty or too long, or the length is out of range.
        WeightsError: The shipped weights are missing or broken.
    """
    from bunraku.diffusion.generate import generate_motion

    _check(prompt, seconds)
    return generate_motion(prompt, seconds, seed=seed, steps=steps, guidance=guidance, mesh_feature=mesh_feature, progress=progress)


def animate(
    character: Character,
    prompt: str,
    *,
    seconds: float = 6.0,
    seed: int = 0,
    steps: int | None = None,
    guidance: float | None = None,
    handles: Handles | Literal["predict", "rig"] = "predict",
    stages: Stages | None = None,
    progress: Progress | None = None,
) -> Animation:
    """Make a character do what a sentence says.

    Args:
        character: Any mesh, +Y up and facing +Z.
        prompt: What it does, in English.
        seconds: Length [s], 0.5 to 120.
        seed: The same seed and version give the same animation.
        steps: Sampling steps; None takes the default.
        guidance: Classifier-free guidance scale; None takes the default.
        handles: The character's handles, or how to make them: "predict" or "rig" (see `rig`).
        stages: Which stages fit the motion to the character; all when None.
        progress: Called with a stage's name and the share done, 0 to 1.

    Returns:
        The animation at 20 frames a second.

    Raises:
        OptionError: The prompt is empty or too long, or the length is out of range.
        CharacterError: `handles` are not 30, or cannot be taken from the rig.
        WeightsError: The shipped weights are missing or broken.
    """
    _check(prompt, seconds)
    if not isinstance(handles, Handles):
        handles = rig(character, handles=handles or "predict", progress=progress)
    motion = generate(prompt, seconds=seconds, seed=seed, steps=steps, guidance=guidance, mesh_feature=handles.features, progress=progress)
    if progress:
        progress("fit", 0.0)
    fitted = fit_motion(motion, character, handles, stages)
    if progress:
        progress("fit", 1.0)
    return Animation(character, handles, fitted)
