"""A generated motion on a character, and the way back from an animation to what was generated."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animation import AnimatedCharacter, Animation, RigAnimation
from bunraku.core.character import Character
from bunraku.core.motion import HandleMotion
from bunraku.core.request import Constraint, Progress
from bunraku.core.travel import GroundPath, bent_to_path
from bunraku.pipelines.requests import Constraints
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.pins import meet_pins

if TYPE_CHECKING:
    from bunraku.retarget.rig_parts import RigParts

__all__ = [
    "GENERATED_STAGES", "apply_motion", "apply_rigged", "apply_simulated", "fitted_motion", "reference_of",
    "reference_path",
]  # fmt: skip
GENERATED_STAGES = Stages(shape=True)
"""The stages that run by default."""


def apply_motion(
    motion: HandleMotion,
    anatomy: Anatomy,
    constraints: Iterable[Constraint] = (),
    stages: Stages | None = None,
    progress: Progress | None = None,
) -> Animation:
    """A motion of the reference body, as `generate` makes them, on a character.

    Args:
        motion: N frames.
        anatomy: Of the character.
        constraints: What it must meet. It was generated as a loop where it is one, for its path (`reference_path`), and
            to follow the motion of the reference body that it follows.
        stages: Which stages fit the motion to the character; `GENERATED_STAGES` when None.
        progress: Called with a stage's name and the share done, 0 to 1.
    """
    if progress:
        progress("fit", 0.0)
    constraints = Constraints(constraints)
    after, loop, path = constraints.after, constraints.loop, constraints.path
    stages = stages or GENERATED_STAGES
    if (
        after is not None and not isinstance(after, HandleMotion) and after.reference is None
    ):  # what the stage did to that clip is in the way back from it already
        stages = replace(stages, shape=False)
    fitted = fitted_motion(motion, anatomy, stages, loop)
    if after is not None and not isinstance(after, HandleMotion):
        from bunraku.core.travel import follow

        fitted = follow(fitted, after.motion)
    if constraints.in_place:
        from bunraku.core.travel import in_place as in_place_motion

        fitted = in_place_motion(fitted, loop)
    if path is not None:
        low = float(anatomy.character.vertices[:, 1].min())
        fitted = bent_to_path(fitted, path, size=float(anatomy.handles.positions[0, 1]) - low)
    if constraints.pins:
        fitted = meet_pins(fitted, anatomy, constraints.pins)
    if progress:
        progress("fit", 1.0)
    return Animation(anatomy.character, anatomy.handles, fitted, motion)


def apply_simulated(
    motion: HandleMotion,
    character: Character,
    *,
    in_place: bool = False,
    stages: Stages | None = None,
    fps: float = 30.0,
    progress: Progress | None = None,
) -> RigAnimation:
    """A motion of the reference body on the bones of a character, whose hair and clothes its file's physics move.

    Args:
        motion: N frames.
        character: With a rig and physics, +Y up and facing +Z.
        in_place: Take the travel over the ground out; apparel then hangs as on a treadmill.
        stages: Which stages fit the motion to the rig; all when None.
        fps: Frames a second of the result [1/s]; apparel swings faster than 20 can show.
        progress: Called with a stage's name and the share done, 0 to 1.

    Raises:
        CharacterError: There is no physics in the file, or the names of its bones do not tell their parts.
    """
    from bunraku.apparel.chains.moving import simulated
    from bunraku.core.motion import resample
    from bunraku.retarget.rig_parts import RigParts

    own = Constraints.of(in_place=in_place)
    return simulated(apply_rigged(resample(motion, fps), RigParts.of(character), own, stages, progress), progress)


def apply_rigged(
    motion: HandleMotion,
    parts: RigParts,
    constraints: Iterable[Constraint] = (),
    stages: Stages | None = None,
    progress: Progress | None = None,
) -> RigAnimation:
    """A motion of the reference body on the bones of a character, hair and clothes going along: it is fitted to the 30
    handles that its bones are, as `apply_motion` does, but for the stage `shape`: bones keep their lengths.

    Args:
        motion: N frames.
        parts: The rig.
        constraints: What it must meet; what is followed moves the bones of the same rig.
        stages: Which stages fit the motion to the rig; all when None.
        progress: Called with a stage's name and the share done, 0 to 1.
    """
    from bunraku.retarget.to_reference import handle_animation
    from bunraku.retarget.to_rig import on_bones, stiff

    constraints = Constraints(constraints)
    after = constraints.after
    if isinstance(after, RigAnimation):
        constraints = constraints.following(handle_animation(after))
    own = replace(stages or Stages(), shape=False)
    return on_bones(parts, apply_motion(stiff(motion), parts.anatomy, constraints, own, progress).motion, motion)


def reference_path(path: GroundPath | None, anatomy: Anatomy) -> GroundPath | None:
    """A path for a character as one for the reference body, whose strides have another length."""
    return None if path is None else path.moved(1 / anatomy.scale)


def fitted_motion(motion: HandleMotion, anatomy: Anatomy, stages: Stages | None, loop: bool = False) -> HandleMotion:
    """`fit_motion`, with the rounds before and after a loop in sight, so that no stage treats its ends as ends."""
    if not loop or len(motion) < 3:
        return fit_motion(motion, anatomy, stages)
    from bunraku.core.travel import closed_loop, repeated

    margin = round(2 * motion.fps)
    fitted = fit_motion(repeated(motion, margin, margin), anatomy, stages)
    return closed_loop(fitted.take(slice(margin, margin + len(motion))), motion)


def reference_of(animation: AnimatedCharacter, anatomy: Anatomy | None = None) -> HandleMotion:
    """The motion of the reference body that an animation plays: the one that it was fitted from, or the way back from
    its own.

    Args:
        animation: Of 30 handles.
        anatomy: Of its character by its handles; None works it out where it is needed.
    """
    if animation.reference is not None:
        return animation.reference
    from bunraku.retarget.to_reference import motion_to_reference

    return motion_to_reference(animation.motion, anatomy or Anatomy.of(animation.character, animation.handles))
