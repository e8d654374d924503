"""The apparel of takes: with the body, simulated by the file's physics, or learned, with a dial for how stiff it is.

A take can be dressed anew, which leaves its motion as it is.
"""

from __future__ import annotations

from collections.abc import Callable

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import OptionError
from bunraku.pipelines.requests.apparel import Apparel
from bunraku.retarget.fit import Stages
from bunraku.studio.workspace.clips import Dressed, Take, body_of

__all__ = ["check_fits", "dressed_anew", "has_apparel", "put_on"]

Report = Callable[[str, float], None]
MOST_PLACES = 30_000_000
"""Vertices times frames of learned apparel, which takes 24 bytes for each."""
LEAST = 0.01
"""Share of a mesh that is apparel where there is some."""


def check_fits(apparel: Apparel, character: Character, seconds: float) -> None:
    """Whether apparel of a clip can move so, before the work.

    Args:
        apparel: How it is to move.
        character: The character.
        seconds: Length of the clip.

    Raises:
        CharacterError: It is to be simulated, and the file says nothing of physics.
        OptionError: It is to be learned, and the mesh is too large for so long a clip.
    """
    from bunraku.physics.chains.animated import check_apparel
    from bunraku.pipelines.apparel import RATE

    if apparel.motion == "simulate":
        check_apparel(character)
    most = MOST_PLACES / (RATE * len(character.vertices))
    if apparel.motion == "learn" and seconds > most:
        raise OptionError(
            f"learned apparel of {len(character.vertices):,} vertices does not fit into the studio for {seconds:g} "
            f"seconds; take at most {most:.1f}, or use the command line"
        )


def put_on(body: Animation | RigAnimation, apparel: Apparel, report: Report) -> Take:
    """A take of an animation, with apparel that moves as is requested.

    Args:
        body: The animation, apparel going with the body.
        apparel: How it is to move.
        report: Called with a stage's name and the share done.

    Raises:
        CharacterError: The mesh has no apparel.
        OptionError: See `check_fits`.
    """
    from bunraku.core.point_animation import PointAnimation
    from bunraku.pipelines.apparel import dressed

    if not apparel.moves:
        return body
    if apparel.motion == "learn":
        check_fits(apparel, body.character, len(body.motion) / body.fps)
    moved = dressed(body, apparel.motion, stiffness=apparel.stiffness, progress=report)
    return Dressed(body, moved, apparel.stiffness) if isinstance(moved, PointAnimation) else moved


def dressed_anew(
    take: Take,
    apparel: Apparel,
    handles: Handles,
    *,
    in_place: bool = False,
    stages: Stages | None = None,
    report: Report,
) -> Take:
    """A take of the same motion whose apparel moves otherwise.

    Args:
        take: The take.
        apparel: How apparel moves.
        handles: Those of the character.
        in_place: Whether the way over the ground was taken out of its motion.
        stages: Which stages fit the motion to the character, where that has to be done again.
        report: Called with a stage's name and the share done.

    Raises:
        CharacterError: There is no such apparel.
        OptionError: What moves its bones is not known as a motion of the body.
    """
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.pipelines.apply import apply_motion, apply_simulated, reference_of
    from bunraku.pipelines.requests.constraints import Constraints

    body = body_of(take)
    check_fits(apparel, body.character, len(body.motion) / body.fps)
    if apparel.motion == "learn" or (not apparel.moves and isinstance(body, Animation)):
        return put_on(body, apparel, report)
    if isinstance(body, RigAnimation) and body.reference is None:
        raise OptionError(
            "the bones of this take were moved by its file; drop that file again with other hair and clothes"
        )
    anatomy = Anatomy.of(body.character, handles)
    motion: HandleMotion = reference_of(body)
    if apparel.motion == "simulate":
        return apply_simulated(motion, body.character, in_place=in_place, stages=stages, progress=report)
    return apply_motion(motion, anatomy, Constraints.of(in_place=in_place), stages, report)


def has_apparel(character: Character, handles: Handles) -> bool:
    """Whether a character has apparel that can be learned."""
    from bunraku.apparel.fitting import joint_weights_of_handles, joints_of_handles
    from bunraku.apparel.mask import apparel_mask
    from bunraku.apparel.segmentation.predict import find_apparel
    from bunraku.body.layout import HANDLE_COUNT

    mask = apparel_mask(character)
    if mask is None and len(handles.positions) == HANDLE_COUNT:
        joints = joints_of_handles(
            character.vertices, joint_weights_of_handles(handles), character.areas, handles.positions
        )
        mask = find_apparel(character.vertices, character.faces, joints).mask
    return mask is not None and bool(mask.mean() >= LEAST)
