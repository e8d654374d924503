"""Rules that find how a motion goes over the ground: turns, directions, gaits, speeds, curves and circles.

As in `events`, each rule says nothing where it is not sure, and treats left and right alike.
"""

from __future__ import annotations

import numpy as np

from bunraku.language.description.track import SIDES, Phrase, Track, runs, smooth
from bunraku_lab.description.peaks import peaks

__all__ = ["find_gaits", "find_turns"]


def find_turns(track: Track) -> list[Phrase]:
    """Turns of a quarter and more, faster than somebody walks a curve."""
    rate = np.gradient(track.angle) * track.fps if len(track) > 1 else np.zeros(1)
    found = []
    for sign, side in ((1, "left"), (-1, "right")):
        for start, stop in runs(sign * rate > 0.35, track.frames(0.3), track.frames(0.35)):
            turn = sign * (track.angle[stop - 1] - track.angle[start])
            seconds = (stop - start) / track.fps
            if turn < 1.05 or track.up[start:stop].min() < 0.6:
                continue
            if turn / seconds < 0.9 and track.speed[start:stop].min() > 0.3:
                continue  # a curve that is walked
            texts = _turn_words(turn, side, float(np.ptp(track.position[start:stop], axis=0).max()) < 0.5)
            if texts:
                found.append(Phrase("turn", texts, start, stop))
    return found


def _turn_words(turn: float, side: str, there: bool) -> tuple[str, ...]:
    degrees = np.degrees(turn)
    words: tuple[str, ...]
    spot = (f"{{turn}} on the spot to the {side}",) if there else ()
    if degrees < 65:
        return ()
    if degrees <= 115:
        words = (
            f"{{turn}} {side}",
            f"{{turn}} to the {side}",
            f"{{make}} a quarter turn to the {side}",
            f"{{turn}} 90 degrees to the {side}",
        )
    elif degrees < 145:
        words = (f"{{turn}} {side}", f"{{turn}} to the {side}")
    elif degrees <= 215:
        words = (
            f"{{turn}} around to the {side}",
            f"{{make}} a half turn to the {side}",
            f"{{turn}} 180 degrees to the {side}",
            f"{{turn}} round to the {side}",
        )
    elif degrees < 310:
        words = (f"{{turn}} around to the {side}", f"{{turn}} far around to the {side}")
    elif degrees <= 410:
        words = (
            f"{{make}} a full turn to the {side}",
            f"{{turn}} all the way around to the {side}",
            f"{{spin}} around once to the {side}",
        )
    else:
        words = (
            f"{{spin}} around to the {side}",
            f"{{turn}} around several times to the {side}",
            f"{{spin}} to the {side} more than once",
        )
    return words + (spot if degrees < 400 else ())


def _gait(track: Track, start: int, stop: int, side: str | None) -> str | None:
    """walk, run, or move where it is neither for sure; None for bodies that are not upright."""
    part = slice(start, stop)
    if np.quantile(track.up[part], 0.05) < 0.7:
        return None
    speed = float(track.speed[part].mean())
    lowest = track.feet[part].min(1)
    stride = (track.relative("left_ankle") - track.relative("right_ankle"))[part, 2]
    steps = len(peaks(stride, 0.2)) + len(peaks(-stride, 0.2))
    strides = steps >= (stop - start) / track.fps / 0.9 - 1 and steps >= 1
    low = track.height[part].mean() < -0.25
    flight = float((lowest > 0.09).mean())  # a walker's foot that rolls over the toes is up to 5 cm off the ground
    if low or not strides or side in SIDES:
        return "move"
    if flight < 0.06 and speed < 2.1:
        return "walk"
    if speed > 2.4 or (flight > 0.1 and speed > 1.7):
        return "run"
    return "move"


def _pace(track: Track, start: int, stop: int, gait: str) -> tuple[str, ...]:
    speed = track.speed[start:stop]
    slow, fast = {"walk": (0.75, 1.6), "run": (0.0, 4.0), "move": (0.45, 2.5)}[gait]
    if np.quantile(speed, 0.8) < slow:
        return ("slowly",)
    return ("quickly",) if np.quantile(speed, 0.2) > fast else ()


def _bend_of_path(track: Track, start: int, stop: int) -> tuple[float, bool]:
    """How far the course turns [rad] and whether it does so steadily to one side."""
    course = smooth(track.course[start:stop], 0.3, track.fps)
    step = np.diff(course)
    total = float(course[-1] - course[0])
    return total, bool(np.abs(step).sum() < 1.2 * abs(total))


def find_gaits(track: Track, turns: list[Phrase], human: bool = True) -> list[Phrase]:
    """Stretches of going in one direction, with the direction, the speed, and circles and curves.

    Args:
        track: The motion.
        turns: Its turns, in which nobody goes anywhere unless in a circle.
        human: Whether gaits have names; else all "move".
    """
    away = track.speed > 0.3
    found = []
    for start, stop in runs(away, track.frames(1.5), track.frames(0.2)):
        circle = _circle(track, start, stop, human)
        if circle:
            found.append(circle)
            away[start:stop] = False
    for turn in turns:
        away[turn.start : turn.stop] = False
    direction = np.arctan2(smooth(track.velocity[:, 1], 0.3, track.fps), smooth(track.velocity[:, 0], 0.3, track.fps))
    classes = {
        "forward": np.abs(direction) < 0.6,
        "backwards": np.abs(direction) > 2.5,
        "left": np.abs(direction - np.pi / 2) < 0.6,
        "right": np.abs(direction + np.pi / 2) < 0.6,
    }
    for name, mask in classes.items():
        for start, stop in runs(away & mask, track.frames(0.8), track.frames(0.25)):
            length = float(np.linalg.norm(np.diff(track.position[start:stop], axis=0), axis=1).sum())
            gait = _gait(track, start, stop, name)
            if length < 0.5 or gait is None or track.speed[start:stop].mean() < 0.35:
                continue
            gait = gait if human else "move"
            way = f"sideways to the {name}" if name in SIDES else name
            pace = _pace(track, start, stop, gait) if human else ()
            found.append(_going(track, start, stop, gait, way, pace))
    return found


def _circle(track: Track, start: int, stop: int, human: bool) -> Phrase | None:
    total, steady = _bend_of_path(track, start, stop)
    length = float(np.linalg.norm(np.diff(track.position[start:stop], axis=0), axis=1).sum())
    turned = track.angle[stop - 1] - track.angle[start]
    if abs(total) < 5.4 or not steady or abs(turned - total) > 1.2 or not 0.35 < length / abs(total) < 6:
        return None
    gait = _gait(track, start, stop, None)
    if gait is None:
        return None
    gait, side = gait if human else "move", "left" if total > 0 else "right"
    pace = _pace(track, start, stop, gait) if human else ()
    word = "circles" if abs(total) > 10.5 else "a circle"
    texts = [f"{{{gait}}} in {word} to the {side}", f"{{{gait}}} around in {word} to the {side}"]
    turns = "counterclockwise" if total > 0 else "clockwise"  # seen from above
    texts.append(f"{{{gait}}} {turns} in {word}")
    part = (f"{{{gait}}} in a curve to the {side}",)
    return Phrase("go", _paced(texts, pace), start, stop, _paced(part, pace), (f"in {word} to the {side}", *pace))


def _paced(texts: list[str] | tuple[str, ...], pace: tuple[str, ...]) -> tuple[str, ...]:
    if not pace:
        return tuple(texts)
    return tuple(f"{pace[0]} {text}" if index % 2 else f"{text} {pace[0]}" for index, text in enumerate(texts))


def _going(track: Track, start: int, stop: int, gait: str, way: str, pace: tuple[str, ...]) -> Phrase:
    texts = [f"{{{gait}}} {way}"]
    manner: tuple[str, ...] = (way, *pace)
    part: tuple[str, ...] = ()
    total, steady = _bend_of_path(track, start, stop)
    if way == "forward" and steady and abs(total) > 0.9 and stop - start >= track.frames(1.5):
        side = "left" if total > 0 else "right"
        texts = [
            f"{{{gait}}} in a curve to the {side}",
            f"{{{gait}}} forward, curving to the {side}",
            f"{{{gait}}} in an arc to the {side}",
        ]
        manner = (f"in a curve to the {side}", *pace)
        part = _paced((f"{{{gait}}} forward",), pace)
    elif way == "forward":
        straight = abs(total) < 0.35 and float(np.ptp(track.course[start:stop])) < 0.6
        texts += [f"{{{gait}}} ahead"] if gait != "move" else []
        texts += [f"{{{gait}}} straight ahead"] if straight else []
    elif way == "backwards":
        texts += [f"{{{gait}}} backward"]
    else:
        texts += [f"{{step}} {way}" if not pace else f"{{{gait}}} {way}"]
    return Phrase("go", _paced(texts, pace), start, stop, part or _paced(texts, pace), manner)
