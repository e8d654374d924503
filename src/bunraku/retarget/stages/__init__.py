""""""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

from bunraku.errors import OptionError

__all__ = ["Stages"]


@dataclass(frozen=True)
class Stages:
    """Which stages fit a motion of the reference body to a character, in the order in which they run
    (`retarget.fit.STAGES`).

    Args:
        smooth: The generator's noise is taken out; fast moves stay.
        gait: Legs beyond those of a person step in turn.
        blocks: Arms and legs of one rigid block point to where a person's hand or foot is.
        rest_pose: Limbs are rotated from the character's rest direction into the reference body's.
        legless: The foot of a snail takes no steps, and the branches of a tree do not swing as arms.
        fins: Fins, claws and forelegs that nothing was drawn for stay near their rest.
        tail: Tails that are held up higher than they rest are lowered.
        front: Heads of bodies that lie along their spine are kept above the ground.
        attach: Handles stay joined to their parents.
        shape: Handles move a little where that keeps the mesh's edges at their lengths.
        level: Bodies that lie along their spine take a third of a person's tilt of the pelvis.
        ground: The lowest point is as high above the ground as the reference body's.
        leap: Bodies on short legs leap as high as is fit for their whole height.
        soles: Feet that are long for their legs are held flatter where they would sink into the ground.
        feet: Standing feet do not slide.
        hands: Hands that touch the body stay near it.
        hands_clear: Hands and forearms stay out of the body.
        lag: Ears, horns, a trunk and a tail that nothing moves follow what they grow from with a damped lag.
        tail_clear: A tail that would sink into the ground is turned up.
        floor: Nothing sinks into the ground, and feet that stand, and legs of a body that lies, are on it.
    """

    smooth: bool = True
    gait: bool = True
    blocks: bool = True
    rest_pose: bool = True
    legless: bool = True
    fins: bool = True
    tail: bool = True
    front: bool = True
    attach: bool = True
    shape: bool = False
    level: bool = True
    ground: bool = True
    leap: bool = True
    soles: bool = True
    feet: bool = True
    hands: bool = False
    hands_clear: bool = True
    lag: bool = True
    tail_clear: bool = True
    floor: bool = True

    def without(self, names: Iterable[str], option: str = "without") -> Stages:
        """The same but for some stages by name, in which dashes may stand for underscores; OptionError, about the
        option, where there is none of a name.
        """
        there = {field.name.replace("_", "-"): field.name for field in fields(self)}
        dashed = [name.replace("_", "-") for name in names]
        for name in dashed:
            if name not in there:
                raise OptionError(f"{option} names no stage '{name[:40]}'; there are {', '.join(there)}")
        return replace(self, **{there[name]: False for name in dashed})
