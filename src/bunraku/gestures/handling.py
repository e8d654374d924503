"""Things that are taken, held and put somewhere: one gesture through the places that a sentence names."""

from __future__ import annotations

import functools

from bunraku.gestures.places import place_pose
from bunraku.gestures.pose import Gesture, Key, Pose, again
from bunraku.language.handling import Handling

__all__ = ["handled"]

NAME = "handle"
THERE = {"take": 0.9, "put": 0.95, "hold": 0.85}
"""Seconds from the place before."""
STAYS = {"take": 0.35, "put": 0.3, "hold": 0.5}
"""Seconds that hands are there."""
LOW = {"floor": 0.35, "low": 0.2}
"""Seconds by which it takes longer to bend down, or to get up."""
BACK = 0.85
"""Seconds from the last place to standing."""
AGAIN = 3
"""How often something is done that is done again and again."""


@functools.lru_cache(maxsize=64)
def handled(handling: Handling) -> Gesture:
    """What a sentence says is done with a thing, as a gesture. What is held at its beginning is so from the first
    moment, and what is held at its end stays there.
    """
    places = [(one.place, one.does == "hold") for one in handling.stations]
    poses = [place_pose(place.height, place.way, handling.hands, held) for place, held in places]
    if handling.repeated:
        played, repeat = again(poses, 0.9 * len(poses), AGAIN, start=1.1, end=1.1)
        return Gesture(NAME, (), played, (repeat.start, repeat.stop - repeat.period), repeat=repeat)
    keys: list[Key] = [] if handling.stations[0].does == "hold" else [(0.0, Pose())]
    moment, before = 0.0, ""
    for station, pose in zip(handling.stations, poses, strict=True):
        low = max(LOW.get(height, 0.0) for height in (before, station.place.height))
        moment += THERE[station.does] + low if keys else 0.0
        keys.append((moment, pose))
        moment += STAYS[station.does]
        keys.append((moment, pose))
        before = station.place.height
    if handling.stations[-1].does == "put":
        keys.append((moment + BACK + LOW.get(before, 0.0), Pose()))
    cycle = (0.0, moment) if handling.only_held else None
    return Gesture(NAME, (), tuple(keys), cycle)
