"""The gesture of what a clause says that is done with a thing, or that follows from where somebody walks or looks."""

from __future__ import annotations

from bunraku.gestures.contact import touched
from bunraku.gestures.handling import handled
from bunraku.gestures.looking import looked
from bunraku.gestures.pose import Gesture
from bunraku.gestures.treading import trodden
from bunraku.language.contact import Contact
from bunraku.language.footing import Footing
from bunraku.language.handling import Handling
from bunraku.language.told import Told

__all__ = ["made_of"]


def made_of(told: Told) -> Gesture:
    """The gesture of one of the forms of `Told`."""
    if isinstance(told, Handling):
        return handled(told)
    if isinstance(told, Contact):
        return touched(told)
    return trodden(told) if isinstance(told, Footing) else looked(told)
