"""Rules that find what a motion plainly shows: what limbs do (jump, kick, wave, sit) and how the body travels."""

from __future__ import annotations

import re

import numpy as np

from bunraku.generation.verifier import SIDES, Track, smooth
from bunraku_lab.description.phrases import Phrase, runs


def peaks(values: np.ndarray, prominence: float, height: float | None = None) -> np.ndarray:
    """Where a curve has peaks, shape (P,).

    Args:
        values: Shape (N,).
        prominence: By how much they stand out at the least.
        height: How high they are at the least.
    """
    from scipy.signal import find_peaks  # which loads half of scipy, a second that few importers need

    return np.asarray(find_peaks(values, height=height, prominence=prominence)[0])


_OTHER = {"left": "right", "right": "left"}


def find_jumps(track: Track) -> list[Phrase]:
    """Jumps from both feet: both off the ground, the root thrown up and falling as things fall."""
    lowest = track.feet.min(1)
    root = track.height
    fall = (
        np.gradient(np.gradient(smooth(root, 0.05, track.fps))) * track.fps**2 if len(root) > 2 else np.zeros_like(root)
    )
    found = []
    for start, stop in runs(lowest > 0.06, track.frames(0.15)):
        before, after = max(start - track.frames(0.6), 0), min(stop + track.frames(0.3), len(track))
        if stop - start > track.frames(1.2) or start < 2 or stop > len(track) - 2 or track.up[start:stop].min() < 0.6:
            continue
        rise = float(root[start:stop].max() - root[before : start + 1].min())
        ends = abs(track.feet[start - 1, 0] - track.feet[start - 1, 1]), abs(track.feet[stop, 0] - track.feet[stop, 1])
        if (
            rise < 0.12
            or fall[start:stop].mean() > -3
            or max(ends) > 0.15
            or float(track.speed[start:stop].mean()) > 2.2
        ):
            continue
        moved = track.position[stop] - track.position[start - 1]
        angle = track.angle[start]
        ahead, aside = (
            moved[1] * np.cos(angle) + moved[0] * np.sin(angle),
            moved[0] * np.cos(angle) - moved[1] * np.sin(angle),
        )
        high = float(root[start:stop].max()) > 0.38
        texts = ["{jump} high", "{jump} high into the air"] if high else ["{jump}"]
        if ahead > 0.35 and abs(aside) < 0.5 * ahead:
            texts = ["{jump} forward"]
        elif ahead < -0.3 and abs(aside) < -0.5 * ahead:
            texts = ["{jump} backwards"]
        elif abs(aside) > 0.35 and abs(ahead) < 0.5 * abs(aside):
            texts = [f"{{jump}} to the {'left' if aside > 0 else 'right'}"]
        elif not high and float(np.hypot(*moved)) < 0.2:
            texts = ["{jump}", "{jump} up", "{jump} in place"]
        found.append(Phrase("jump", tuple(texts), max(start - 2, 0), after))
    return found


def find_kicks(track: Track) -> list[Phrase]:
    """Fast swings of a stretched leg while the other foot stands, and a leg held up."""
    found = []
    for index, side in enumerate(SIDES):
        ankle = track.relative(f"{side}_ankle")
        reach = np.hypot(*(ankle - track.relative(f"{side}_hip"))[:, [0, 2]].T)
        pace = np.linalg.norm(np.gradient(ankle, axis=0), axis=1) * track.fps if len(track) > 1 else np.zeros(1)
        height, stands = track.feet[:, index], track.feet[:, 1 - index] < 0.12
        for start, stop in runs(height > 0.25, track.frames(0.1), 1):
            part = slice(start, stop)
            if not stands[part].all() or start == 0 or stop == len(track) or track.up[part].min() < 0.45:
                continue
            top = start + int(height[part].argmax())
            far = float(reach[part][height[part] > 0.35].max(initial=0))
            if (
                stop - start <= track.frames(1.3)
                and pace[part].max() > 3
                and far > 0.5
                and track.speed[part].mean() < 1.5
            ):
                texts = [f"{{kick}} with the {side} foot", f"{{kick}} with the {side} leg"]
                if height[top] > 1.0:
                    texts = [f"{{kick}} high with the {side} foot", f"{{do}} a high kick with the {side} leg"]
                elif ankle[top, 2] > 0.45 and abs(ankle[top, 0]) < 0.3:
                    texts.append(f"{{kick}} forward with the {side} foot")
                found.append(Phrase("kick", tuple(texts), max(start - 2, 0), min(stop + 2, len(track))))
            elif (
                stop - start >= track.frames(1.0)
                and track.speed[part].max() < 0.35
                and track.height[part].min() > -0.25
            ):
                other = _OTHER[side]
                texts = [
                    f"{{stand}} on the {other} leg",
                    f"{{lift}} the {side} leg",
                    f"{{balance}} on the {other} foot with the {side} leg up",
                ]
                found.append(Phrase("leg", tuple(texts), start, stop, (texts[0],)))
    return found


def find_arms(track: Track) -> list[Phrase]:
    """Hands raised above the head or to shoulder height, and waved."""
    top = track.points["head_top"][:, 1]
    standing = (track.up > 0.8) & (track.height > -0.35)
    raised: dict[str, list[tuple[int, int]]] = {}
    for side in SIDES:
        wrist, shoulder = track.points[f"{side}_wrist"][:, 1], track.points[f"{side}_shoulder"][:, 1]
        raised[side] = []
        for start, stop in runs((wrist > top + 0.02) & standing, track.frames(0.25), track.frames(0.15)):
            begin = max(start - track.frames(1.6), 0)
            low = np.flatnonzero(wrist[begin:start] < shoulder[begin:start] - 0.1)
            if len(low) and standing[begin + low[-1] : start].all():
                raised[side].append((begin + int(low[-1]), min(start + track.frames(0.25), stop)))
    high = ("{raise} the # hand above the head", "{lift} the # arm over the head", "{raise} the # arm up high")
    level = ("{raise} the # arm to shoulder height", "{stretch} out the # arm", "{lift} the # arm")
    found = _sided(raised, high) + _sided({side: _stretches(track, side) for side in SIDES}, level)
    return found + [phrase for side in SIDES for phrase in _waves(track, side)]


def _sided(spans: dict[str, list[tuple[int, int]]], texts: tuple[str, ...]) -> list[Phrase]:
    """One phrase for what both hands do together, one for each hand alone; # stands for the side."""

    def together(a: tuple[int, int], b: tuple[int, int]) -> bool:
        return min(a[1], b[1]) - max(a[0], b[0]) > 0.4 * min(a[1] - a[0], b[1] - b[0])

    left, right = spans["left"], spans["right"]
    found = []
    plural = tuple(re.sub(r"the # (\w+)", r"both \1s", text) for text in texts)
    for a in left:
        found += [Phrase("arm", plural, min(a[0], b[0]), max(a[1], b[1])) for b in right if together(a, b)]
    for side, own, other in (("left", left, right), ("right", right, left)):
        words = tuple(text.replace("#", side) for text in texts)
        found += [Phrase("arm", words, *span) for span in own if not any(together(span, one) for one in other)]
    return found


def _waves(track: Track, side: str) -> list[Phrase]:
    """A raised hand that goes to and fro while the other hangs and the body stays."""
    wrist, elbow, shoulder = (track.points[f"{side}_{part}"] for part in ("wrist", "elbow", "shoulder"))
    other = _OTHER[side]
    hangs = track.points[f"{other}_wrist"][:, 1] < track.points[f"{other}_shoulder"][:, 1] - 0.12
    up = (
        (wrist[:, 1] > shoulder[:, 1] - 0.1)
        & (wrist[:, 1] > elbow[:, 1] + 0.01)
        & (track.speed < 0.35)
        & (track.up > 0.8)
        & hangs
    )
    arm = track.relative(f"{side}_wrist") - track.relative(f"{side}_elbow")
    found = []
    for start, stop in runs(up, track.frames(0.7), 2):
        swing = (arm[start:stop] - arm[start:stop].mean(0)) @ np.linalg.svd(
            arm[start:stop] - arm[start:stop].mean(0), full_matrices=False
        )[2][0]
        found += _swings(track, swing, side, start)
    return found


def _swings(track: Track, swing: np.ndarray, side: str, start: int) -> list[Phrase]:
    """Waves in how far a raised hand is out: three small ways to and fro in a row, or two wide ones."""
    for least, prominence in ((3, 0.05), (2, 0.1)):
        ends = np.sort(np.concatenate([peaks(sign * swing, prominence) for sign in (1, -1)]))
        found = []
        for first, last in runs(np.diff(ends) < track.frames(0.7), least):
            often = {2: "twice", 3: "three times", 4: "four times"}.get((last - first + 1) // 2)
            texts = [
                f"{{wave}} with the {side} hand",
                f"{{wave}} the {side} hand",
                f"{{raise}} the {side} hand and {{wave}}",
            ]
            begin, end = start + int(ends[first]), start + int(ends[last]) + 1
            whole = (*texts, f"{{wave}} {often} with the {side} hand") if often else tuple(texts)
            found.append(Phrase("arm", whole, max(begin - 3, 0), min(end + 3, start + len(swing)), tuple(texts[:2])))
        if found:
            return found
    return []


def _stretches(track: Track, side: str) -> list[tuple[int, int]]:
    """Spans in which a stretched arm is brought up to the height of the shoulder and held there."""
    wrist, shoulder = track.points[f"{side}_wrist"], track.points[f"{side}_shoulder"]
    level = np.abs(wrist[:, 1] - shoulder[:, 1]) < 0.15
    far = np.linalg.norm(wrist - shoulder, axis=1) > 0.44
    found = []
    for start, stop in runs(level & far & (track.up > 0.8) & (track.height > -0.25), track.frames(0.5), 1):
        begin = max(start - track.frames(1.5), 0)
        low = np.flatnonzero(wrist[begin:start, 1] < shoulder[begin:start, 1] - 0.4)
        if len(low) and track.speed[begin:stop].max() < 0.5:
            found.append((begin + int(low[-1]), min(start + track.frames(0.4), stop)))
    return found


def find_bends(track: Track) -> list[Phrase]:
    """Squats, bending over, going down to the ground and getting up from it."""
    found = []
    root, head = (
        track.height,
        track.points["head"][:, 1] - track.points["head"][:, 1].max() if len(track) else track.height,
    )
    stands = track.feet.max(1) < 0.15
    for start, stop in runs(root < -0.15, track.frames(0.3)):
        part = slice(start, stop)
        whole = start > 0 and stop < len(track)
        if (
            whole
            and stop - start < track.frames(4)
            and root[part].min() < -0.3
            and track.up[part].min() > 0.7
            and stands[part].all()
        ):
            texts = (
                "{squat} down and {stand} up again", "{bend} the knees into a squat and {rise} again", "{do} a squat",
            )  # fmt: skip
            found.append(Phrase("bend", texts, max(start - 2, 0), min(stop + 2, len(track))))
    lying = runs((track.up < 0.45) & (root < -0.6), track.frames(0.5), track.frames(0.5))
    upright = (track.up > 0.85) & (root > -0.2)
    for start, stop in lying:
        before = np.flatnonzero(upright[max(start - track.frames(4), 0) : start])
        if len(before):
            texts = ("{go} down to the ground", "{get} down on the ground", "{end} up on the floor")
            found.append(
                Phrase("bend", texts, max(start - track.frames(4), 0) + int(before[-1]), start + track.frames(0.5))
            )
        after = np.flatnonzero(upright[stop : stop + track.frames(5)])
        if len(after):
            texts = ("{get} up from the ground", "{stand} up from the ground", "{rise} from the floor")
            found.append(Phrase("bend", texts, max(stop - 2, 0), stop + int(after[0]) + 1))
    squats = np.zeros(len(track), bool)
    for phrase in found:
        squats[phrase.start : phrase.stop] = True
    for start, stop in runs((head < -0.5) & (root > -0.3) & stands, track.frames(0.3), 2):
        if start > 0 and stop < len(track) and stop - start < track.frames(6) and not squats[start:stop].any():
            begin, end = max(start - track.frames(0.4), 0), min(stop + track.frames(0.4), len(track))
            found.append(Phrase("bend", ("{bend} over", "{bend} down", "{lean} far down"), begin, end))
    return found


def find_punches(track: Track) -> list[Phrase]:
    """A fist that shoots forward until the arm is stretched, with its side; of clips that are labelled as punches."""
    found = []
    for side in SIDES:
        wrist, shoulder = track.relative(f"{side}_wrist"), track.relative(f"{side}_shoulder")
        away = wrist - shoulder
        reach = np.linalg.norm(away, axis=1)
        pace = np.gradient(wrist[:, 2]) * track.fps if len(track) > 1 else np.zeros(1)
        for top in peaks(reach, 0.1, height=0.4).tolist():
            start = max(top - track.frames(0.35), 0)
            if away[top, 2] > 0.25 and abs(away[top, 1]) < 0.3 and pace[start : top + 1].max() > 2.0:
                punches = ("{punch} with the # hand", "{throw} a # punch", "{throw} a punch with the # hand")
                texts = tuple(text.replace("#", side) for text in (*punches, "{hit} out with the # hand"))
                found.append(Phrase("punch", texts, start, min(top + track.frames(0.3), len(track))))
    return found


def find_seats(track: Track) -> list[Phrase]:
    """Sitting down from standing and standing up from a seat; of clips that are labelled as sitting."""
    upright = (track.up > 0.85) & (track.height > -0.1)
    low = (track.height < -0.2) & (track.up > 0.5) & (track.feet.max(1) < 0.2)
    found = []
    for start, stop in runs(low, track.frames(0.7), track.frames(0.2)):
        floor = float(np.median(track.height[start:stop])) < -0.55
        seat, on = ("on the floor", "from the floor") if floor else ("on a chair", "from the chair")
        before = np.flatnonzero(upright[max(start - track.frames(3), 0) : start])
        if len(before):
            begin = max(start - track.frames(3), 0) + int(before[-1])
            texts = ("{sit} down", f"{{sit}} down {seat}", "{sit} down" if floor else "{take} a seat")
            found.append(Phrase("sit", tuple(dict.fromkeys(texts)), begin, min(start + track.frames(1), stop)))
        after = np.flatnonzero(upright[stop : stop + track.frames(3)])
        if len(after):
            texts = (f"{{stand}} up {on}", f"{{get}} up {on}", "{stand} up")
            found.append(Phrase("sit", texts, max(stop - track.frames(0.7), start), stop + int(after[0]) + 1))
    return found


def find_stillness(track: Track) -> list[Phrase]:
    """Standing upright without a move."""
    parts = ("left_wrist", "right_wrist", "left_ankle", "right_ankle", "head")
    pace = (
        np.max([np.linalg.norm(np.gradient(track.points[name], axis=0), axis=1) for name in parts], axis=0) * track.fps
        if len(track) > 1
        else 0
    )
    calm = (smooth(pace * np.ones(len(track)), 0.1, track.fps) < 0.12) & (track.up > 0.85) & (track.height > -0.12)
    texts = ("{stand} still", "{stay} still", "{wait}")
    return [Phrase("still", texts, start, stop, texts) for start, stop in runs(calm, track.frames(1.2))]


def find_turns(track: Track) -> list[Phrase]:
    """Turns of a quarter and more, faster than a walk along a curve."""
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
            f"{{turn}} {side}", f"{{turn}} to the {side}", f"{{make}} a quarter turn to the {side}",
            f"{{turn}} 90 degrees to the {side}",
        )  # fmt: skip
    elif degrees < 145:
        words = (f"{{turn}} {side}", f"{{turn}} to the {side}")
    elif degrees <= 215:
        words = (
            f"{{turn}} around to the {side}", f"{{make}} a half turn to the {side}",
            f"{{turn}} 180 degrees to the {side}", f"{{turn}} round to the {side}",
        )  # fmt: skip
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
        turns: Its turns, in which the body stays in place or goes in a circle.
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
        "forward": np.abs(direction) < 0.6, "backwards": np.abs(direction) > 2.5,
        "left": np.abs(direction - np.pi / 2) < 0.6, "right": np.abs(direction + np.pi / 2) < 0.6,
    }  # fmt: skip
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
