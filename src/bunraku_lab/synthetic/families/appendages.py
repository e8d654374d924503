"""Figures with much on their heads: large ears, horns, antlers, a trunk, tusks, stalks with eyes, tentacles, long hair;
on stubby limbs or long ones, with wings and tails.

What stands out from a head is the head's, as in most files of artists, and never an arm.
"""

from __future__ import annotations

import numpy as np

from bunraku_lab.synthetic.families.beasts import tail, wings
from bunraku_lab.synthetic.families.human_head import eyes
from bunraku_lab.synthetic.families.model import SIDES, Chain, Model
from bunraku_lab.synthetic.surfaces import unit

_ON_TOP = ("round", "long", "flop", "cat", "horn", "ram", "antler", "stalk", "antenna", "strands", "twin", "fan")
_IN_FRONT = ("trunk", "beak", "tentacles", "tusks", "snout", "none")


def critter(m: Model) -> None:
    """A figure on two legs, from a head with feet to a tall one, with a large head."""
    u = m.u
    head, wide = u(0.22, 0.6), u(0.5, 1.3)
    leg = (1 - head) * (u(0.08, 0.3) if m.chance(0.6) else u(0.3, 0.55))
    trunk = 1 - head - leg
    girth = max(u(0.3, 0.75) * trunk, 0.12) if m.chance(0.7) else u(0.25, 0.4)
    depth = girth * u(0.65, 1.0)
    names = ["Hips", "Spine", "Spine1", "Spine2", "Neck"]
    marks = leg + trunk * np.array([0.1, 0.3, 0.52, 0.74, 0.96])
    positions = [np.array([0, mark, 0]) for mark in marks]
    for name, parent, at in zip(names, ["", *names], positions, strict=False):
        m.bone(name, parent, at)
    shape = u(0.5, 1.1)
    m.limb(
        [(0, leg + 0.3 * trunk, 0), (0, leg + 0.8 * trunk, 0)],
        [girth, girth * shape],
        Chain(names, positions),
        "body",
        stretch=(1, min(1.0, 0.4 * trunk / girth), depth / girth),
        blend=1.0,
    )
    m.bone("Head", "Neck", (0, leg + trunk, 0))
    size = 0.5 * head * np.array([wide, 1.0, u(0.7, 1.2)])
    centre = np.array([0, leg + trunk + 0.45 * head, u(-0.1, 0.25) * head])
    m.lump(centre, size, "Head", "head", blend=0.6)
    m.limb([positions[3], centre], [0.35 * girth, 0.35 * size[0]], ["Neck"], "head")
    _face(m, centre, size)
    _limbs(m, leg, trunk, girth * max(shape, 0.75), depth)
    if m.chance(0.35):
        tail(m, np.array([0, leg + 0.2 * trunk, -0.9 * depth]), u(0.15, 0.7), u(0.02, 0.1), u(-0.8, 0.8), u(-0.6, 1.2),
             int(m.rng.integers(2, 5)))  # fmt: skip
    if m.chance(0.3):
        wings(m, positions[3] + [0.3 * girth, 0, -0.8 * depth], u(0.3, 1.1), "Spine2")
    if m.chance(0.12):  # a cape down the back
        low = leg + u(-0.7, 0.3) * leg
        rows = [np.linspace([-g * girth, y, -d], [g * girth, y, -d], 9) for g, y, d in (
            (0.7, marks[4], 0.9 * depth), (1.0, leg + 0.5 * trunk, 1.25 * depth), (1.2, low, 1.4 * depth))]  # fmt: skip
        m.sheet(np.stack(rows), Chain(["Spine2", "Spine", "Hips"], positions[3::-2] + positions[:1]), "cape", 0.01)


def _limbs(m: Model, leg: float, trunk: float, girth: float, depth: float) -> None:
    u = m.u
    arm, thick = u(0.15, 0.6) if m.chance(0.6) else u(0.06, 0.15), u(0.14, 0.4) * girth
    drop = u(1.0, 1.5) if m.chance(0.5) else u(-0.4, 1.0)
    bend, glove, high = u(-0.1, 0.8), u(0.9, 1.8), leg + trunk * u(0.62, 0.85)
    stance, fat, foot = u(0.35, 0.65) * girth, u(0.25, 0.48) * girth, u(1.0, 1.9)
    seated = u(0.9, 1.5) if m.chance(0.12) else 0.0
    armed = m.chance(0.9)
    for side, s in SIDES:
        if armed:
            direction = unit(np.array([s * np.cos(drop), -np.sin(drop), u(-0.1, 0.3) if s > 0 else 0.1]))
            m.bone(f"{side}Shoulder", "Spine2", (s * 0.5 * girth, high, 0))
            a = m.bone(f"{side}Arm", f"{side}Shoulder", (s * 0.85 * girth, high, 0))
            b = m.bone(f"{side}ForeArm", f"{side}Arm", a + 0.5 * arm * direction)
            c = m.bone(f"{side}Hand", f"{side}ForeArm", b + 0.45 * arm * unit(direction + [0, 0, bend]))
            m.limb([a, b, c], [thick * u(0.8, 1.2), thick, thick * u(0.6, 1.0)], [f"{side}Arm", f"{side}ForeArm"],
                   f"arm {side}", blend=0.5)  # fmt: skip
            m.lump(c + 0.5 * thick * glove * direction, thick * glove * np.array([0.9, 0.9, 1]), f"{side}Hand",
                   f"arm {side}")  # fmt: skip
        hip = m.bone(f"{side}UpLeg", "Hips", (s * stance, leg + 0.06 * trunk, 0))
        forward = np.array([0, -np.cos(seated), np.sin(seated)])
        knee = m.bone(f"{side}Leg", f"{side}UpLeg", hip + 0.5 * leg * forward)
        flat = min(0.35 * leg, 0.7 * fat)
        ankle = m.bone(f"{side}Foot", f"{side}Leg", knee + (hip[1] - 0.5 * leg - flat) * np.array([0, -1, 0]))
        m.limb([hip, knee, ankle], [fat * u(1.0, 1.25), fat, fat * u(0.7, 1.0)], [f"{side}UpLeg", f"{side}Leg"],
               f"leg {side}", blend=0.5)  # fmt: skip
        m.lump(ankle + [0, 0, 0.35 * fat * foot], (fat * 0.95, flat, fat * foot), f"{side}Foot", f"leg {side}")


def stubby_beast(m: Model) -> None:
    """A beast on four legs that are short and thick, with a large head close to the trunk."""
    u = m.u
    leg, radius, head = u(0.06, 0.3), u(0.22, 0.42), u(0.25, 0.55)
    y, half = leg + 0.8 * radius, u(0.3, 0.55)
    names = ["Hips", "Spine", "Spine1", "Spine2"]
    positions = [np.array([0, y + 0.2 * radius, -0.8 * half + 1.5 * half * share]) for share in (0.0, 0.33, 0.62, 0.92)]
    for name, parent, at in zip(names, ["", *names], positions, strict=False):
        m.bone(name, parent, at)
    m.limb([(0, y, -half + 0.6 * radius), (0, y, half - 0.6 * radius)], [radius * u(0.8, 1.1), radius],
           Chain(names, positions), "trunk", stretch=(u(0.8, 1.1), 1, 1), blend=1.2)  # fmt: skip
    m.bone("Neck", "Spine2", (0, y + 0.3 * radius, half))
    at = m.bone("Head", "Neck", (0, y + u(0.2, 0.9) * radius, half + 0.25 * head))
    size = 0.5 * head * np.array([u(0.8, 1.3), 1.0, u(0.8, 1.1)])
    centre = at + [0, 0.25 * head, 0.3 * head]
    m.limb([positions[3], centre], [0.7 * radius, 0.7 * size[1]], "Neck", "head", blend=0.8)
    m.lump(centre, size, "Head", "head", blend=0.6)
    _face(m, centre, size)
    wide, thick, foot = u(0.45, 0.75) * radius, u(0.26, 0.5) * radius, u(1.0, 1.5)
    flat = 0.3 * leg
    for side, s in SIDES:
        for front, upper, lower, last, root in (
            (1, "Arm", "ForeArm", "Hand", "Shoulder"), (-1, "UpLeg", "Leg", "Foot", "")):  # fmt: skip
            z = front * (half - 0.75 * radius)
            parent = "Spine2" if front > 0 else "Hips"
            if root:
                parent = f"{side}{root}"
                m.bone(parent, "Spine2", (s * 0.5 * wide, y, z))
            top = m.bone(f"{side}{upper}", parent, (s * wide, leg + 0.3 * radius, z))
            mid = m.bone(f"{side}{lower}", f"{side}{upper}", (s * wide, flat + 0.5 * (top[1] - flat), z + 0.02 * front))
            end = m.bone(f"{side}{last}", f"{side}{lower}", (s * wide, flat, z))
            m.limb([top, mid, end], [1.15 * thick, thick, 0.9 * thick], [f"{side}{upper}", f"{side}{lower}"],
                   f"{upper} {side}", blend=0.6)  # fmt: skip
            m.lump(end + [0, 0, 0.3 * thick * foot], (thick, flat, thick * foot), f"{side}{last}", f"{upper} {side}")
    if m.chance(0.75):
        tail(m, np.array([0, y + 0.4 * radius, -half]), u(0.1, 0.7), u(0.02, 0.1), u(-0.9, 0.9), u(-0.6, 1.2),
             int(m.rng.integers(2, 5)))  # fmt: skip
    if m.chance(0.2):
        wings(m, positions[3] + [0.5 * radius, 0.6 * radius, 0], u(0.4, 1.1), "Spine2")


def _face(m: Model, centre: np.ndarray, size: np.ndarray) -> None:
    """All that stands out from a head: one or two kinds above, at most one in front."""
    eyes(m, centre, size, "Head")
    for kind in m.rng.choice(_ON_TOP, 1 + int(m.chance(0.35)), replace=False):
        _on_top(m, str(kind), centre, size)
    if m.chance(0.45):
        _in_front(m, m.pick(*_IN_FRONT), centre, size)


def _horn(m: Model, name: str, curve: list[np.ndarray], radii: list[float], *, flat: float = 1.0) -> None:
    """A tapered curve that stands out from the head."""
    m.limb(curve, radii, "Head", name, loose=m.chance(0.3), stretch=(1, 1, flat), blend=0.5)


def _on_top(m: Model, kind: str, centre: np.ndarray, size: np.ndarray) -> None:
    u = m.u
    big, out, tilt = u(0.5, 1.9), u(0.35, 0.8), u(-0.4, 0.4)
    fat, flat, curl = u(0.14, 0.42), u(0.3, 1.0), u(0.2, 1.0)
    count = int(m.rng.integers(2, 6))
    for side, s in SIDES:
        root = centre + size * [s * out, np.sqrt(1 - out**2) * 0.9, -0.1]
        up = unit(np.array([s * out, 1.0, tilt]))
        long, r = big * size[1], fat * size[0]
        if kind == "round":  # discs beside the head, up to its own size
            disc = u(0.35, 1.0) * size[1] if s > 0 else fat * 2.2 * size[1]
            at = centre + [s * (size[0] + 0.75 * disc), (0.9 * tilt + 0.3) * size[1], 0]
            m.lump(at, disc * np.array([1, 1, max(0.25, 0.4 * flat)]), "Head", f"ear {side}", blend=0.5)
        elif kind in ("long", "cat"):
            _horn(m, f"{side}Ear", [root, root + 0.6 * long * up, root + (1.4 if kind == "long" else 0.8) * long * up],
                  [r, 1.3 * r, 0.3 * r], flat=flat)  # fmt: skip
        elif kind in ("flop", "twin"):  # hanging beside the body
            at = centre + [s * 0.95 * size[0], 0.4 * size[1], -0.1 * size[2]]
            away = at + [s * (0.4 + 0.5 * curl) * size[0], 0.0, -0.2 * size[2]]
            end = away + [s * 0.3 * tilt * size[0], -u(0.8, 2.6) * size[1] if s > 0 else -1.4 * big * size[1], 0.0]
            name = f"{side}Ear" if kind == "flop" else f"{side}Hair"
            _horn(m, name, [at, away, end], [0.7 * r, 1.2 * r, 0.5 * r], flat=flat)
        elif kind in ("horn", "ram"):
            mid = root + unit(np.array([s, 0.5, 0.1])) * 0.5 * long
            turn = [s * 0.2, 1, 0.2] if kind == "horn" else [s * 0.3, -0.9, 0.8]
            _horn(m, f"{side}Horn", [root, mid, mid + unit(np.array(turn)) * 0.6 * long], [r, 0.75 * r, 0.1 * r])
        elif kind == "antler":
            tip = root + 1.3 * long * up
            _horn(m, f"{side}Antler", [root, root + 0.6 * long * up + [s * 0.2 * long, 0, 0], tip],
                  [0.45 * r, 0.4 * r, 0.15 * r])  # fmt: skip
            for rank in range(count):
                start = root + (0.3 + 0.7 * rank / count) * 1.2 * long * up
                m.limb([start, start + unit(np.array([s * u(-0.3, 1), 0.7, u(-0.6, 1)])) * 0.4 * long],
                       [0.3 * r, 0.1 * r], "Head", f"{side}Antler")  # fmt: skip
        elif kind in ("stalk", "antenna"):
            tip = root + long * unit(up + [0, 0, 0.3 * curl])
            thin = 0.5 * r if kind == "stalk" else 0.22 * r
            _horn(m, f"{side}Antenna", [root, root + 0.5 * long * up, tip], [thin, thin, thin])
            m.lump(tip, r * (u(0.9, 1.6) if kind == "stalk" else u(0.3, 0.8)), "Head", f"{side}Antenna")
    if kind == "strands":  # locks all around, down to the chest
        for rank in range(2 * count):
            angle = np.pi * (rank + 0.5) / (2 * count) + np.pi  # behind and beside
            way = np.array([np.cos(angle), 0, np.sin(angle)])
            at = centre + 0.9 * size * way
            _horn(m, f"Hair{rank}", [at, at + 0.4 * size * way, at + 0.5 * size * way - [0, u(0.5, 2.0) * size[1], 0]],
                  [0.2 * size[0], 0.2 * size[0], 0.1 * size[0]])  # fmt: skip
    elif kind == "fan":  # a crest, a stalk, or a plume in the middle
        at = centre + [0, 0.9 * size[1], 0]
        _horn(m, "Crest", [at, at + [0, 0.5 * big * size[1], 0], at + [0, big * size[1], -curl * size[2]]],
              [fat * size[0], 1.2 * fat * size[0], 0.4 * fat * size[0]], flat=flat)  # fmt: skip


def _in_front(m: Model, kind: str, centre: np.ndarray, size: np.ndarray) -> None:
    u = m.u
    front = centre + [0, -0.2 * size[1], 0.9 * size[2]]
    long, r = u(0.8, 3.0) * size[1], u(0.16, 0.36) * size[0]
    if kind == "trunk":
        lift = u(-1.0, 0.8)
        mid = front + [0, -0.35 * long, 0.35 * long]
        _horn(
            m, "Snout", [front, mid, mid + 0.6 * long * unit(np.array([0, lift, u(-0.3, 0.9)]))], [r, 0.8 * r, 0.5 * r]
        )
    elif kind in ("beak", "snout"):
        flat = u(0.3, 1.2)
        _horn(m, "Snout", [front, front + [0, -0.1 * long, 0.5 * min(long, 1.6 * size[1])]],
              [1.8 * r, (0.2 if kind == "beak" else 1.2) * r], flat=flat)  # fmt: skip
    elif kind == "tentacles":
        for rank in range(int(m.rng.integers(3, 7))):
            at = front + [u(-0.6, 0.6) * size[0], -0.3 * size[1], -0.1 * size[2]]
            mid, tip = at + [0, -0.3 * long, 0.15 * long], at + [0, -0.7 * long, u(-0.1, 0.4) * long]
            _horn(m, f"Whisker{rank}", [at, mid, tip], [0.5 * r, 0.4 * r, 0.2 * r])
    elif kind == "tusks":
        for side, s in SIDES:
            at = front + [s * 0.45 * size[0], -0.2 * size[1], -0.1 * size[2]]
            mid = at + 0.3 * long * np.array([s * 0.3, -0.3, 0.7])
            tip = at + 0.5 * long * np.array([s * 0.2, 0.1, 0.9])
            _horn(m, f"{side}Tooth", [at, mid, tip], [0.5 * r, 0.4 * r, 0.1 * r])
