"""The parts of any mesh, found by the part network, before there are handles or joints."""

from __future__ import annotations

from dataclasses import dataclass

PARTS = ("body", "hair", "skirt", "cape", "sleeve", "tail", "prop", "accessory", "ground")
CARRIERS = ("head", "chest", "pelvis", "left arm", "right arm", "left leg", "right leg")


@dataclass(frozen=True)
class PartConfig:
    """Shape of the part network.

    Args:
        fine: Channels of points.
        middle: Channels of centres.
        coarse: Channels of tokens.
        layers: Transformer layers over the tokens.
        heads: Of their attention.
        before, after: Blocks over the centres before and after the transformer.
    """

    fine: int = 64
    middle: int = 112
    coarse: int = 160
    layers: int = 4
    heads: int = 5
    before: int = 2
    after: int = 2
