"""The apparel of takes: with the body, simulated by the file's physics, or learned, with a dial for how stiff it is.

A take can be dressed anew, which leaves its motion as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import OptionError
from bunraku.retarget.fit import Stages
from bunraku.studio.clips import Dressed, Take, body_of

__all__ = ["Apparel", "dressed_anew", "is_worn"]

Report = Callable[[str, float], None]
MOST_PLACES = 30_000_000
"""Vertices times frames of learned apparel, which takes 24 bytes for each."""
LEAST = 0.01
"""Share of a mesh that is apparel where there is some."""


@dataclass(frozen=True)
class Apparel:
    """How the apparel of takes moves.

    Args:
        way: "rigid", "simulate" or "learn".
        stiffness: Factor on how stiff learned apparel is.
    """

    way: str = "rigid"
    stiffness: float = 1.0

    @classmethod
    def of(cls, params: dict[str, Any]) -> Apparel:
        """From what a task is given."""
        return cls(str(params.get("apparel") or "rigid"), float(params.get("stiffness") or 1.0))

    def on_bones(self, character: Character, predicted: bool, directed: bool) -> bool:
        """Whether a generated motion moves the bones of the character, as in `pipelines.animate`.

        Args:
            character: The character.
            predicted: Whether its handles are predicted, and not those of its file.
            directed: Whether a path or pins are to be met, which handles do.
        """
        from bunraku.retarget.rig_parts import is_humanoid_rig

        if self.way == "simulate":
            return True
        return self.way == "learn" and predicted and not directed and is_humanoid_rig(character)

    def check(self, character: Character, seconds: float) -> None:
        """Whether this can be, before the work.

        Raises:
            CharacterError: It is to be simulated, and the file says nothing of physics.
            OptionError: It is to be learned, and the mesh is too large for so long a clip.
        """
        from bunraku.physics.animated import check_apparel
        from bunraku.pipelines.apparel import RATE

        if self.way == "simulate":
            check_apparel(character)
        most = MOST_PLACES / (RATE * len(character.vertices))
        if self.way == "learn" and seconds > most:
            raise OptionError(
                f"learned apparel of {len(character.vertices):,} vertices does not fit into the studio for {seconds:g} "
                f"seconds; take at most {most:.1f}, or use the command line"
            )

    def put_on(self, body: Animation | RigAnimation, report: Report) -> Take:
        """A take of an animation: with learned apparel where that is asked for.

        Raises:
            CharacterError: The mesh has no apparel.
            OptionError: See `check`.
        """
        if self.way != "learn":
            return body
        from bunraku.core.point_animation import PointAnimation
        from bunraku.pipelines.apparel import dressed

        self.check(body.character, len(body.motion) / body.fps)
        points = dressed(body, "learn", stiffness=self.stiffness, progress=report)
        assert isinstance(points, PointAnimation)
        return Dressed(body, points, self.stiffness)


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

    body = body_of(take)
    apparel.check(body.character, len(body.motion) / body.fps)
    if apparel.way == "learn" or (apparel.way == "rigid" and isinstance(body, Animation)):
        return apparel.put_on(body, report)
    if isinstance(body, RigAnimation) and body.reference is None:
        raise OptionError(
            "the bones of this take were moved by its file; drop that file again with other hair and clothes"
        )
    anatomy = Anatomy.of(body.character, handles)
    motion: HandleMotion = reference_of(body)
    if apparel.way == "simulate":
        return apply_simulated(motion, body.character, in_place=in_place, stages=stages, progress=report)
    return apply_motion(motion, anatomy, in_place=in_place, stages=stages, progress=report)


def is_worn(character: Character, handles: Handles) -> bool:
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
