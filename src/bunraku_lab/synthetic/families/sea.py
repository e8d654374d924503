"""What swims: fish of all shapes, rays, whales and seahorses."""

from __future__ import annotations

import numpy as np

from bunraku_lab.synthetic.families.beasts import tail
from bunraku_lab.synthetic.families.human_head import eyes
from bunraku_lab.synthetic.families.model import SIDES, Chain, Model
from bunraku_lab.synthetic.surfaces import unit


def _spine(m: Model, marks: tuple[float, ...], tails: int) -> Chain:
    """Head, spine, pelvis and tail along Z; marks are where each begins, over the length, from the nose."""
    head, spine, hips, end, *_ = (np.array([0, 0, 0.5 - mark]) for mark in marks)
    m.bone("Hips", "", hips)
    m.bone("Spine", "Hips", spine)
    m.bone("Head", "Spine", head)
    names, positions = ["Head", "Spine", "Hips"], [head, spine, hips]
    for i in range(tails):
        at = end + (np.array([0, 0, marks[4] - 0.5]) - end) * i / tails
        m.bone(f"Tail{i + 1}", f"Tail{i}" if i else "Hips", at)
        names.append(f"Tail{i + 1}")
        positions.append(at)
    return Chain(names, positions)


def _fin(
    m: Model, root: np.ndarray, along: np.ndarray, out: np.ndarray, share: str | Chain, region: str, notch: float = 0.0
) -> None:
    """A flat fin on a line from `root` along `along`, reaching out."""
    t, v = np.linspace(0, 1, 7)[:, None, None], np.linspace(0, 1, 5)[None, :, None]
    high = (1 - m.u(0.3, 0.9) * t) * (1 - notch * np.sin(np.pi * t))
    grid = root + t * along * (1 - 0.3 * v) + v * high * out - v * np.array([0, 0, m.u(0.0, 0.4)]) * np.linalg.norm(out)
    m.sheet(grid, share, region, m.u(0.006, 0.03))


def fish(m: Model) -> None:
    """A fish, from the ball of a puffer to an eel, upright or flat."""
    u = m.u
    toy = m.chance(0.55)
    high, wide = (u(0.16, 0.4), u(0.12, 0.34)) if toy else (u(0.06, 0.26), u(0.035, 0.14))
    if m.chance(0.1):
        high, wide = wide * 0.8, high
    nose, peak, root = u(0.02, 0.12), u(0.25, 0.45), u(0.68, 0.82)
    marks = (
        (0.1, u(0.28, 0.38), u(0.46, 0.54), u(0.57, 0.63), 0.1)
        if toy
        else (0.1, u(0.18, 0.25), u(0.33, 0.42), u(0.5, 0.58), 0.05)
    )
    body = _spine(m, marks, int(m.rng.integers(3, 5)))
    stem = high * u(0.15, 0.35)
    z = [0.5 - nose - high * 0.4, 0.5 - peak, 0.5 - root, -0.42]
    radii = [high * u(0.4, 0.8), high, high * u(0.35, 0.6), stem]
    rise = u(-0.3, 0.3) * high
    m.limb(
        [(0, rise * 0.5, z[0]), (0, 0, z[1]), (0, 0, z[2]), (0, 0, z[3])], radii, body, "body",
        stretch=(wide / high, 1, 1), blend=1.2,
    )  # fmt: skip
    if m.chance(0.3):
        m.limb(
            [(0, rise * 0.5, z[0]), (0, rise * 0.5, 0.5 + u(0.0, 0.2))], [radii[0] * 0.7, u(0.01, 0.05)], body, "body",
            stretch=(wide / high, 1, 1),
        )  # fmt: skip
    bulge = u(0.6, 1.4) if toy else 0.5
    if m.chance(0.85):
        position, size = (
            np.array([wide * radii[0] / high * 0.85, 0.2 * high, z[0] - u(0, 0.3) * high]),
            high * u(0.12, 0.34) * bulge,
        )
        for _, s in SIDES:
            m.lump(position * [s, 1, 1], size, body, f"eye {s}", loose=True)
    span, fork = high * u(0.5, 1.5), u(0.0, 0.7)
    t, v = np.linspace(-1, 1, 9)[:, None], np.linspace(0, 1, 5)[None]
    reach = 0.08 + u(0.05, 0.22) * (1 - fork * (1 - np.abs(t)))
    grid = np.stack([0 * t * v, t * (stem + (span - stem) * v) + u(-0.3, 0.3) * span * v, -0.38 - reach * v], axis=-1)
    m.sheet(grid, body, "tail fin", u(0.006, 0.03))
    if m.chance(0.85):
        _fin(
            m, np.array([0, 0.85 * high, 0.5 - peak + u(-0.05, 0.1)]), np.array([0, -0.15 * high, -u(0.15, 0.45)]),
            np.array([0, high * u(0.3, 1.2), 0]), body, "dorsal", u(0, 0.5),
        )  # fmt: skip
    if m.chance(0.5):
        _fin(
            m, np.array([0, -0.8 * high, 0.5 - peak - 0.1]), np.array([0, 0.2 * high, -u(0.1, 0.3)]),
            np.array([0, -high * u(0.3, 0.9), 0]), body, "anal",
        )  # fmt: skip
    if m.chance(0.85):
        long, down, back = high * u(0.4, 1.2), u(0.0, 0.9), u(0.2, 1.2)
        loose = m.chance(0.25)  # fins with bones, as of sharks
        position = np.array([0.8 * wide, -0.3 * high, 0.5 - u(0.3, 0.45)])
        for side, s in SIDES:
            at = position * [s, 1, 1]
            direction = unit(np.array([s, -down, -back]))
            share: str | Chain = body
            if loose:
                m.bone(f"{side}Arm", "Spine", at)
                share = f"{side}Arm"
            _fin(m, at, np.array([0, -0.05 * high, -u(0.05, 0.16)]), direction * long, share, f"fin {side}")
    if m.chance(0.06):
        m.limb(
            [(0, high * 0.9, 0.3), (0, high * 1.7, 0.45), (0, high * 1.4, 0.6)], [0.015, 0.012, 0.012], body, "lure",
            loose=True,
        )  # fmt: skip
        m.lump((0, high * 1.4, 0.6), 0.05, body, "lure", loose=True)


def whale(m: Model) -> None:
    """A whale, dolphin or seal: level flukes and flippers with bones."""
    u = m.u
    high, wide = u(0.09, 0.28), u(0.8, 1.3)
    body = _spine(m, (0.08, u(0.17, 0.24), u(0.33, 0.4), u(0.48, 0.56), 0.06), 3)
    radii = [high * u(0.5, 0.95), high, high * u(0.4, 0.7), high * 0.2]
    m.limb(
        [(0, 0, 0.48 - high), (0, 0, 0.15), (0, 0, -0.25), (0, u(0, 0.3) * high, -0.46)], radii, body, "body",
        stretch=(wide, 1, 1), blend=1.2,
    )  # fmt: skip
    if m.chance(0.4):
        m.limb(
            [(0, -0.2 * high, 0.45), (0, -0.3 * high, 0.5 + u(0.02, 0.12))], [high * 0.35, high * 0.2], "Head", "body"
        )
    for _, s in SIDES:
        m.lump((s * wide * radii[0] * 0.9, 0.1 * high, 0.48 - high), high * 0.12, "Head", f"eye {s}", loose=True)
    last, span, back = body.joints[-1], high * u(1.0, 2.0), u(0.05, 0.2)
    long, down = high * u(0.8, 2.4), u(0.1, 1.0)
    for side, s in SIDES:
        root = np.array([0, 0, -0.44])
        _fin(m, root, np.array([0, 0, -0.1]), np.array([s * span, 0, -back]), last, f"fluke {side}")
        at = np.array([s * 0.85 * wide * high, -0.4 * high, u(0.12, 0.25) if s > 0 else m.at("LeftArm")[2]])
        direction = unit(np.array([s, -down, -0.6]))
        points = [at, at + 0.4 * long * direction, at + 0.75 * long * direction]
        names = [f"{side}Arm", f"{side}ForeArm", f"{side}Hand"]
        m.bones_along(names, points, "Spine")
        m.limb(
            [points[0] - 0.1 * direction * long, points[1], at + long * direction],
            [0.3 * high, 0.25 * high, 0.08 * high], Chain(names, points), f"flipper {side}", stretch=(1, 0.35, 1),
        )  # fmt: skip
    if m.chance(0.6):
        _fin(
            m, np.array([0, 0.85 * high, 0.0]), np.array([0, -0.1 * high, -0.12]),
            np.array([0, high * u(0.4, 1.2), -0.05]), body, "dorsal",
        )  # fmt: skip


def ray(m: Model) -> None:
    """A flat ray: a disc or two broad wings, moved by bones from the middle outwards, and a thin tail."""
    u = m.u
    span, thick = u(0.35, 0.75), u(0.03, 0.08)
    m.bone("Hips", "", (0, 0, -0.05))
    m.bone("Spine", "Hips", (0, 0, 0.1))
    m.bone("Head", "Spine", (0, 0, 0.25))
    body = Chain(["Hips", "Spine", "Head"], [m.at("Hips"), m.at("Spine"), m.at("Head")])
    m.limb(
        [(0, 0, -0.25), (0, 0, 0.1), (0, 0, 0.35)], [thick * 0.7, thick * 1.6, thick], body, "body",
        stretch=(u(1.2, 2.5), 1, 1), blend=1.0,
    )  # fmt: skip
    eyes(m, np.array([0, 0.3 * thick, 0.28]), np.array([2.2, 1, 1]) * thick, "Head")
    front, back, sweep, droop = u(0.25, 0.4), u(-0.45, -0.25), u(-0.2, 0.15), u(-0.2, 0.25)
    power = u(0.8, 2.2)
    for side, s in SIDES:
        names = [f"{side}Arm", f"{side}ForeArm", f"{side}Hand"]
        points = [np.array([s * span * t, droop * t**1.5 * span, sweep * t]) for t in (0.2, 0.5, 0.78)]
        m.bones_along(names, points, "Spine")
        t, v = np.linspace(0, 1, 11)[:, None], np.linspace(0, 1, 7)[None]
        lead, trail = sweep * t + front * (1 - t**power), sweep * t + back * (1 - t**power)
        grid = np.stack([s * span * t + 0 * v, droop * t**1.5 * span + 0 * v, lead + v * (trail - lead)], axis=-1)
        m.sheet(grid, Chain(["Spine", *names], [np.zeros(3), *points]), f"wing {side}", thick * u(0.5, 1))
    if m.chance(0.6):
        for _, s in SIDES:
            m.limb(
                [(s * thick * 2, 0, 0.33), (s * thick * 1.6, 0, 0.48)], [thick * 0.5, thick * 0.25], "Head", f"horn {s}"
            )
    tail(m, np.array([0, 0, -0.28]), u(0.3, 1.0), thick * u(0.25, 0.5), u(-0.05, 0.1), u(-0.2, 0.4), 4)


def seahorse(m: Model) -> None:
    """A seahorse: upright, with a snout, a belly and a curled tail."""
    u = m.u
    names = ["Hips", "Spine", "Spine1", "Spine2", "Neck"]
    positions = [np.array([0, y, z]) for y, z in ((0.45, -0.02), (0.52, 0.0), (0.6, 0.02), (0.68, 0.02), (0.78, -0.02))]
    m.bones_along(names, positions)
    fat, head = u(0.06, 0.14), u(0.07, 0.14)
    m.limb(
        [(0, 0.42, -0.02), (0, 0.58, 0.03), (0, 0.75, 0.0)], [fat * 0.7, fat, fat * 0.7],
        Chain(names[:4], positions[:4]), "body", stretch=(0.8, 1, 1), blend=1.0,
    )  # fmt: skip
    top = m.bone("Head", "Neck", (0, 0.86, 0.02))
    m.limb([positions[4] - [0, 0.03, 0], top], [fat * 0.6, head * 0.6], "Neck", "body")
    m.lump(top + [0, 0.04, 0.02], head, "Head", "head")
    m.limb([top + [0, 0.02, 0.05], top + [0, -0.03, 0.1 + u(0.05, 0.2)]], [head * 0.45, head * 0.3], "Head", "head")
    eyes(m, top + [0, 0.04, 0.02], np.full(3, head), "Head")
    if m.chance(0.7):
        m.limb([top + [0, 0.1, 0], top + [0, 0.2, -0.03]], [head * 0.4, head * 0.15], "Head", "crest")
    count, angle, at = int(m.rng.integers(4, 6)), -np.pi / 2 - u(-0.1, 0.3), np.array([0, 0.42, -0.02])
    points = [at]
    for _ in range(count):
        points.append(points[-1] + 0.4 / count * np.array([0, np.sin(angle), -np.cos(angle)]))
        angle += u(0.2, 0.75)
    joints = [f"Tail{i + 1}" for i in range(count)]
    m.bones_along(joints, points, "Hips")
    m.limb(points, list(np.linspace(fat * 0.65, 0.02, count + 1)), joints, "tail", blend=0.5)
    if m.chance(0.7):
        _fin(
            m, np.array([0, 0.7, -0.5 * fat]), np.array([0, -0.2, 0]), np.array([0, 0, -u(0.06, 0.16)]), "Spine1",
            "dorsal",
        )  # fmt: skip
