"""`transfer`: motion that exists already, put on any character.

Every motion of a person becomes one of the reference body first (`to_reference`), and from there goes to the handles of
the character (TapMo, section 3.2) or to its own rig. Motion of other bodies goes from one rest pose to the other
(`retarget.creatures`).
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

from bunraku.anatomy.anatomy import Anatomy
from bunraku.apparel.chains.moving import check_apparel
from bunraku.core.animation import AnimatedCharacter, Animation, RigAnimation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.nn.layers import one_thread
from bunraku.core.request import Progress, checked
from bunraku.errors import CharacterError
from bunraku.files import bones_of
from bunraku.pipelines.animate import opened
from bunraku.pipelines.animator import Animator, left_out
from bunraku.pipelines.requests import RATE, Apparel, TransferRequest
from bunraku.pipelines.to_reference import Motion, creature_motion, load_motion, reference_motion
from bunraku.retarget.creatures import CreatureMotion, fit_body
from bunraku.retarget.fit import Stages
from bunraku.retarget.rig_parts import RigParts
from bunraku.retarget.stages.feet import is_treadmill

_log = logging.getLogger(__name__)
TRANSFER_STAGES = Stages(hands=True, shape=True)
"""The stages by default: those of fitting, hands that touch the body stay near it, and the mesh keeps its shape."""


@dataclass(frozen=True, eq=False)
class Source:
    """A motion to be transferred, read and taken to the reference body once, however many characters get it."""

    given: Motion | str | Path  # the motion, or its file
    fps: float = RATE  # frames a second of the result [1/s]
    # The skeleton's joint by SMPL's name, for joints that are missed or mistaken; "" for none.
    names: Mapping[str, str] | None = None
    clip: int | str = 0  # number or name of the clip of a file with several

    @property
    def path(self) -> Path | None:
        """The file, None where the motion itself was given."""
        return Path(self.given) if isinstance(self.given, str | Path) else None

    @cached_property
    def motion(self) -> Motion:
        """The motion as its file has it."""
        given = self.given
        return load_motion(given, fps=self.fps, clip=self.clip) if isinstance(given, str | Path) else given

    @cached_property
    def creature(self) -> CreatureMotion | None:
        """The motion of a body on four legs or more, or on none; None where it is a person's."""
        return creature_motion(self.motion, fps=self.fps, names=self.names)

    @cached_property
    def reference(self) -> HandleMotion:
        """The motion of the reference body."""
        return reference_motion(self.motion, fps=self.fps, names=self.names)


@one_thread()
def transferred(
    animator: Animator, character: Character, motion: Motion | Source | str | Path, request: TransferRequest
) -> AnimatedCharacter:
    """A character that does what a motion does: F(V, J, T) of [MMDMC 1]. The motion, the results and the errors are
    those of `transfer`.
    """
    request.check()
    if request.apparel.motion == "simulate":
        check_apparel(character)  # before the work
    source = motion if isinstance(motion, Source) else Source(motion, request.fps, request.names, request.clip)
    animator.progress("read", 0.0)
    moved: Animation | RigAnimation | None = None
    if request.onto != "handles" and not isinstance(request.handles, Handles):
        moved = None if source.path is None else played_by_mmd(character, source.path, source.fps)
        moved = moved or same_skeleton(character, source.motion)
    if moved is None:
        reference = source.creature or source.reference
        animator.progress("read", 1.0)
        moved = fitted_transfer(animator, character, reference, request)
    return animator.dress(moved, request.apparel)


@checked
def transfer(
    character: Character | str | Path,
    motion: Motion | Source | str | Path,
    *,
    onto: Literal["auto", "handles", "rig"] = "auto",
    handles: Handles | Literal["predict", "rig"] = "predict",
    apparel: str = "none",
    stiffness: float = 1.0,
    gravity: float = 1.0,
    stages: Stages | None = None,
    fps: float = RATE,
    names: Mapping[str, str] | None = None,
    clip: int | str = 0,
    progress: Progress | None = None,
) -> AnimatedCharacter:
    """Put a motion on a character: F(V, J, T), Eq. 1 of MMDMC.

    Args:
        character: Any mesh, +Y up and facing +Z, or its file.
        motion: Motion of any skeleton; handle motion of the reference body; an animated character; a moving mesh; a
            file with any of these; or a `Source`, whose `fps`, `names` and `clip` then hold.
        onto: "handles" moves the 30 handles of the character, "rig" the bones of its own rig, "auto" the rig of a
            humanoid that has one and handles otherwise.
        handles: The character's handles, or how to make them: "predict" or "rig" (see `bunraku.rig`).
        apparel: How hair and clothes move; see `Apparel`.
        stiffness: Factor on how stiff apparel is, 0.001 to 1000.
        gravity: Factor on the gravity of apparel that is simulated, 0 to 10.
        stages: Which stages run; `TRANSFER_STAGES` when None.
        fps: Frames a second of the result [1/s].
        names: The skeleton's joint by SMPL's name, for joints that are missed or mistaken; "" for none.
        clip: Number or name of the clip of a file with several.
        progress: Called with a stage's name and the share done, 0 to 1.

    Returns:
        An `Animation`, a `RigAnimation` where the rig is moved, or a `PointAnimation` where apparel is learned. A clip
        of a character with the same skeleton is copied bone by bone, at its own rate, unless handles are requested.

    Raises:
        OptionError: `onto` is none of the three, or `fps` is not from 1 to 240.
        CharacterError: The rig is to be moved, and there is none, or its bones are not understood; or the motion is
            that of a body on four legs, or on none, and the character has another kind of body.
        MotionError: No pelvis and legs are found in the skeleton.
        FormatError: The file cannot be read.
    """
    request = TransferRequest(onto, Apparel(apparel, stiffness, gravity), stages, handles, fps, names, clip)
    return transferred(Animator.shipped(progress), opened(character), motion, request)


def fitted_transfer(
    animator: Animator, character: Character, reference: HandleMotion | CreatureMotion, request: TransferRequest
) -> Animation | RigAnimation:
    """What `reference_motion` or `creature_motion` gives, on the rig or the handles of a character, as a
    request says.
    """
    stages = request.stages or TRANSFER_STAGES
    if stages.feet and isinstance(reference, HandleMotion) and is_treadmill(reference):
        stages = replace(stages, feet=False)  # feet that are held would carry the character away
    parts = _rig_parts(character, request)
    animator.progress("fit", 0.0)
    if isinstance(reference, HandleMotion):
        reference = reference.of_own_body(False)  # generated for another body, or for none
    left = left_out(character) if parts is None else ""
    if left and request.onto == "auto" and not isinstance(request.handles, Handles):
        _log.warning("%s: handles move it, without %s; to move its bones, transfer onto its rig", character.name, left)
    body = parts or Anatomy.of(character, animator.handles(character, request.handles)).measured()
    result = fit_body(reference, body, stages)
    animator.progress("fit", 1.0)
    return result


def _rig_parts(character: Character, request: TransferRequest) -> RigParts | None:
    """The rig that a motion goes onto; None where handles take it."""
    if request.onto == "rig":
        return RigParts.of(character)
    if request.onto == "handles" or character.rig is None or isinstance(request.handles, Handles):
        return None
    try:
        parts = RigParts.of(character)
    except CharacterError:
        return None
    return parts if parts.humanoid else None


def same_skeleton(character: Character, motion: Motion) -> RigAnimation | None:
    """The clip of a character that has the same skeleton, bone by bone; None for other motions."""
    from bunraku.retarget.to_rig import copied_bones

    if character.rig is None or not isinstance(motion, Animation | RigAnimation) or motion.character.rig is None:
        return None
    if isinstance(motion, RigAnimation):
        return copied_bones(motion.character, *motion.world(), motion.fps, character)
    if len(motion.handles.positions) != len(motion.character.rig.names) + 1:
        return None
    return copied_bones(motion.character, *bones_of(motion), motion.motion.fps, character)


def played_by_mmd(character: Character, path: str | Path, fps: float) -> RigAnimation | None:
    """A VMD on the bones of an MMD model, which it was made for; None for other files and characters. MotionError where
    it moves none of the model's bones.
    """
    if Path(path).suffix.lower() != ".vmd":
        return None
    from bunraku.core.avatars import mmd_model
    from bunraku.files import load_vmd
    from bunraku.retarget.mmd_motion import mmd_animation

    return None if mmd_model(character) is None else mmd_animation(character, load_vmd(path), fps)
