"""The apparel of takes: with the body, simulated by the file's physics, on chains of bones, or learned, with a dial for
how stiff it is.

A take can be dressed anew, which leaves its motion as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import CharacterError, OptionError
from bunraku.pipelines.requests.apparel import Apparel
from bunraku.retarget.fit import Stages
from bunraku.studio.workspace.clips import Dressed, Take, body_of

if TYPE_CHECKING:
    from bunraku.anatomy.anatomy import Anatomy
    from bunraku.physics.chains.laid import Chained

__all__ = ["chains_of", "check_fits", "dressed_anew", "found_apparel", "has_apparel", "put_on", "told_chains"]

Report = Callable[[str, float], None]
MOST_PLACES = 30_000_000
"""Vertices times frames of apparel that moves on its own, which takes 24 bytes for each."""
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
        OptionError: It moves on its own, and the mesh is too large for so long a clip.
    """
    from bunraku.physics.chains.animated import check_apparel
    from bunraku.pipelines.apparel import RATE

    if apparel.motion == "simulate":
        check_apparel(character)
    most = MOST_PLACES / (RATE * len(character.vertices))
    if apparel.motion in ("learn", "chains") and seconds > most:
        raise OptionError(
            f"moving apparel of {len(character.vertices):,} vertices does not fit into the studio for {seconds:g} "
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
    check_fits(apparel, body.character, len(body.motion) / body.fps)
    moved = dressed(body, apparel.motion, stiffness=apparel.stiffness, gravity=apparel.gravity, progress=report)
    if apparel.motion == "chains" and isinstance(moved, RigAnimation):
        return Dressed.of_chains(body, moved, apparel.stiffness, apparel.gravity)
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
    if apparel.motion in ("learn", "chains") or (not apparel.moves and isinstance(body, Animation)):
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


def found_apparel(character: Character, handles: Handles) -> np.ndarray | None:
    """Which vertices of a character are apparel: as its file says, or else as a network finds; shape (V,), bool. None
    where nobody can tell.
    """
    from bunraku.apparel.artist_mask import artist_mask
    from bunraku.apparel.fitting import joint_weights_of_handles, joints_of_handles
    from bunraku.apparel.mask import apparel_mask
    from bunraku.apparel.segmentation.predict import find_apparel
    from bunraku.body.layout import HANDLE_COUNT

    mask = artist_mask(character)
    if mask is None:
        mask = apparel_mask(character)
    if mask is None and len(handles.positions) == HANDLE_COUNT:
        joints = joints_of_handles(
            character.vertices, joint_weights_of_handles(handles), character.areas, handles.positions
        )
        mask = find_apparel(character.vertices, character.faces, joints).mask
    return mask


def has_apparel(mask: np.ndarray | None) -> bool:
    """Whether so much of a mesh is apparel that there is some."""
    return mask is not None and bool(mask.mean() >= LEAST)


def chains_of(anatomy: Anatomy) -> tuple[Chained | None, str]:
    """A character with chains of bones over its apparel; None with a sentence where there are none."""
    from bunraku.pipelines.clothes import rig_with_chains

    try:
        return rig_with_chains(anatomy), ""
    except CharacterError as error:
        return None, str(error)


def told_chains(made: Chained) -> list[dict[str, Any]]:
    """What a page shows of chains: name, kind, points at rest [m], and the handle that carries each."""
    carriers: dict[int, int] = {}
    told = []
    for chain in made.chains:
        carrier = carriers.get(chain.holder, int(chain.holder))
        carriers |= dict.fromkeys(chain.bones.tolist(), carrier)
        points = chain.points.astype(float).round(5).tolist()
        told.append({"name": chain.name, "kind": chain.kind, "joint": carrier, "points": points})
    return told
