"""How much work the pose of an MMD model is, so that a file that asks for hours of it is refused before it starts."""

from __future__ import annotations

import numpy as np

from bunraku.core.mmd_model import MmdModel
from bunraku.core.rig_animation import bone_order
from bunraku.errors import MotionError

__all__ = ["check_work", "pose_work"]

MOST = 200_000  # bones placed in one frame; large models with inverse kinematics in their hair need a tenth
MOST_IN_ALL = 1_000_000_000  # bones placed in all frames: minutes


def check_work(model: MmdModel, frames: int) -> None:
    """Raise MotionError if so many frames of a model are too much work."""
    work = pose_work(model)
    if work > MOST or work * frames > MOST_IN_ALL:
        raise MotionError(
            f"{model.name or 'this model'}: its bones and inverse kinematics ask for {work:,} steps in each of "
            f"{frames:,} frames, too many;"
            " lower the loops of its inverse kinematics or shorten the motion"
        )


def pose_work(model: MmdModel) -> int:
    """How many bones are placed in a frame: each once, all below one that takes over of others, and chains of inverse
    kinematics in each loop.
    """
    parents = model.parents
    below = np.ones(len(parents), np.int64)  # a bone and those under it
    for index in reversed(bone_order(parents)):
        if parents[index] >= 0:
            below[parents[index]] += below[index]
    work = len(parents)
    for goal, bone in enumerate(model.bones):
        if bone.append is not None:
            work += int(below[goal])
        if bone.ik is None:
            continue
        line = {bone.ik.target: 1}
        at = int(parents[bone.ik.target])
        while at >= 0 and at != goal:
            line[at] = len(line) + 1
            at = int(parents[at])
        chain = [link.bone for link in bone.ik.links if link.bone in line]
        work += bone.ik.loops * sum(line[link] for link in chain) + max((int(below[link]) for link in chain), default=0)
    return work
