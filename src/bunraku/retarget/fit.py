"""From the reference body to any character: the analytic adaptation of a handle motion.

The diffusion model speaks of the reference body: its proportions and its T-pose. The stages of `STAGES`, each of which
can be left out, clean its motion and turn it into one of another character, in the order of that list.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.motion import HandleMotion
from bunraku.retarget.stages import Stages
from bunraku.retarget.stages.animals import Front, Gait
from bunraku.retarget.stages.feet import Feet
from bunraku.retarget.stages.ground import Floor, Ground, Leap, Soles
from bunraku.retarget.stages.hands import Hands, HandsClear
from bunraku.retarget.stages.rest_pose import Attach, Blocks, Fins, Legless, Level, RestPose
from bunraku.retarget.stages.shape import Shape, Smooth
from bunraku.retarget.stages.stage import Fitting, Stage
from bunraku.retarget.stages.trailing import Lag, Tail, TailClear

STAGES: tuple[Stage, ...] = (
    Smooth(), Gait(), Blocks(), RestPose(), Legless(), Fins(), Tail(), Front(), Attach(), Shape(), Level(),
    Ground(), Leap(), Soles(), Feet(), Hands(), HandsClear(), Lag(), TailClear(), Floor(),
)  # fmt: skip
"""All stages, in the order in which they run."""
_NAMED = {stage.name: stage for stage in STAGES}


def running(stages: Stages) -> tuple[Stage, ...]:
    """The stages that are switched on, and those that they need with them."""

    def on(name: str) -> bool:
        return bool(getattr(stages, name)) and all(map(on, _NAMED[name].needs))

    return tuple([stage for stage in STAGES if on(stage.name)])


POSING = running(Stages(smooth=False, ground=False, feet=False, hands_clear=False, floor=False))
"""The stages that turn and join parts."""


def fit_motion(
    motion: HandleMotion, anatomy: Anatomy, stages: Stages | None = None, heights: np.ndarray | None = None
) -> HandleMotion:
    """A handle motion of the reference body, fitted to a character.

    Args:
        motion: Motion of the reference body's handles, feet on y = 0.
        stages: Which stages run; all but `hands` and `shape` when None.
        heights: Of the lowest point of the body that moves, where that is not the reference body, in its scale [m],
            shape (N,).

    Returns:
        The motion for the character, its root path scaled by the height of the root handle above the floor.
    """
    stages = stages or Stages()
    if not stages.rest_pose:
        anatomy = anatomy.unturned
    return _through(running(stages), Fitting.of(motion, anatomy, heights), anatomy)


def posed(motion: HandleMotion, anatomy: Anatomy) -> HandleMotion:
    """A motion of the reference body as a character's parts do it, before anything looks at the ground or the mesh: the
    stages of `POSING` alone.
    """
    return _through(POSING, Fitting.of(motion, anatomy), anatomy)


def _through(stages: Iterable[Stage], fitting: Fitting, anatomy: Anatomy) -> HandleMotion:
    for stage in stages:
        if stage.applies(fitting, anatomy):
            fitting = stage(fitting, anatomy)
    return fitting.motion
