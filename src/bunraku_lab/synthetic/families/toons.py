"""Toys and monsters: mascots on thin limbs, slimes, ghosts, mushrooms, skulls, and blobs that fly."""

from __future__ import annotations

import numpy as np

from bunraku_lab.synthetic.families.beasts import tail, wings
from bunraku_lab.synthetic.families.human_head import ears_and_horns, eyes
from bunraku_lab.synthetic.families.model import SIDES, Chain, Model
from bunraku_lab.synthetic.surfaces import unit


def mascot(m: Model) -> None:
    """One lump that is body and head, such as a fruit, a monster or a box, on thin arms and legs."""
    u = m.u
    half = np.array([u(0.2, 0.42), u(0.25, 0.5), u(0.14, 0.38)])
    leg = u(0.1, 0.5)
    y = leg + half[1] * 0.95
    low = y - half[1]
    marks = np.array([0.12, 0.3, 0.42, 0.5, 0.6, 0.68]) * 2 * half[1] + low
    names = ["Hips", "Spine", "Spine1", "Spine2", "Neck", "Head"]
    positions = [np.array([0, mark, 0]) for mark in marks]
    m.bones_along(names, positions)
    body = Chain(names, positions)
    shape = m.pick("egg", "pear", "box", "round", "tall", "slab")
    if shape == "box":
        m.block((0, y, 0), half, body, "body", exponent=m.pick(3.0, 5.0, 12.0))
        m.lump((0, y, 0), half * 0.85, body, "body")
    elif shape == "pear":
        m.limb(
            [(0, low + half[0] * 0.9, 0), (0, y + half[1] * 0.6, 0)], [half[0], half[0] * u(0.35, 0.75)], body, "body",
            stretch=(1, 1, half[2] / half[0]), blend=1.0,
        )  # fmt: skip
    elif shape == "tall":
        bend = u(-0.2, 0.2)
        points = [(0, low + 0.15, -bend), (0, y, 0.3 * bend), (0, y + half[1] * 0.9, -bend)]
        m.limb(points, [half[2] * u(0.6, 1), half[2], half[2] * u(0.4, 1)], body, "body", blend=1.0)
    else:
        m.lump((0, y, 0), half * ([1, 1, 0.5] if shape == "slab" else [1, 1, 1]), body, "body")
    depth = half[2] * (0.5 if shape == "slab" else 1.0)
    eyes(m, np.array([0, y + 0.25 * half[1], 0]), np.array([half[0], half[1], depth]) * 0.95, "Head")
    if m.chance(0.5):
        ears_and_horns(m, np.array([0, y + 0.3 * half[1], 0]), half * [0.9, 0.8, 1], "Head")
    elif m.chance(0.6):  # a stalk or a leaf
        tip = m.bone("HeadTop_End", "Head", (0, y + half[1] * 0.97, 0))
        m.limb(
            [tip - [0, 0.05, 0], tip + [u(-0.1, 0.1), u(0.08, 0.25), u(-0.1, 0.1)]], [u(0.02, 0.06), u(0.01, 0.06)],
            "HeadTop_End", "stalk", loose=m.chance(0.5),
        )  # fmt: skip
        if m.chance(0.5):
            for _, s in SIDES:
                m.lump(tip + [s * 0.1, 0.1, 0], (0.12, 0.05, 0.06), "HeadTop_End", f"leaf {s}", loose=True)
    if m.chance(0.2):
        tail(
            m, np.array([0, low + 0.25 * half[1], -0.8 * depth]), u(0.2, 0.5), u(0.03, 0.09), u(-0.2, 0.8), u(-0.3, 1),
            3,
        )  # fmt: skip
    arm, thick = u(0.15, 0.45), u(0.02, 0.07)
    drop, bend = u(-0.3, 1.2) if m.chance(0.6) else u(-0.1, 0.15), u(0, 0.7)
    foot, glove, stance = u(1.2, 2.4), u(1.0, 2.2), half[0] * u(0.25, 0.6)
    high, fingers = u(-0.15, 0.25) * half[1], m.chance(0.3)
    side_at = (
        half[0]
        * np.sqrt(max(1 - (high / half[1]) ** 2, 0))
        * (0.95 if shape not in ("tall", "pear") else 0.8 * half[2] / half[0] + 0.1)
    )
    for side, s in SIDES:
        direction = np.array([s * np.cos(drop), -np.sin(drop), 0.1])
        m.bone(f"{side}Shoulder", "Spine2", (s * 0.6 * side_at, y + high, 0))
        m.lump(
            (s * 0.72 * side_at, y + high, 0), np.array([0.22 * side_at, 0.35 * half[1], 0.5 * depth]),
            f"{side}Shoulder", "body", blend=1.0,
        )  # fmt: skip
        a = m.bone(f"{side}Arm", f"{side}Shoulder", (s * side_at, y + high, 0))
        b = m.bone(f"{side}ForeArm", f"{side}Arm", a + direction * 0.45 * arm)
        c = m.bone(f"{side}Hand", f"{side}ForeArm", b + unit(direction + [0, 0, bend]) * 0.45 * arm)
        m.limb(
            [a - direction * 0.05, b, c], [thick * 1.1, thick, thick], [f"{side}Arm", f"{side}ForeArm"], f"arm {side}"
        )
        m.lump(c + direction * thick * glove * 0.7, thick * glove * np.array([1, 0.9, 1]), f"{side}Hand", f"arm {side}")
        if fingers:
            for i in range(3):
                bone = m.bone(
                    f"{side}HandIndex{i}" if i else f"{side}HandThumb1", f"{side}Hand", c + direction * thick * glove
                )
                m.limb(
                    [bone, bone + unit(direction + [0, 0, i - 1]) * thick * glove * 1.4], [thick * 0.6, thick * 0.45],
                    f"{side}HandIndex{i}" if i else f"{side}HandThumb1", f"arm {side}",
                )  # fmt: skip
        hip = m.bone(f"{side}UpLeg", "Hips", (s * stance, leg + 0.05, 0))
        m.lump(
            (s * stance, low + 0.16 * half[1], 0), np.array([0.3 * half[0], 0.14 * half[1], 0.55 * depth]),
            f"{side}UpLeg", "body", blend=1.0,
        )  # fmt: skip
        knee = m.bone(f"{side}Leg", f"{side}UpLeg", (s * stance, leg * 0.55, u(0, 0.03)))
        flat = thick * foot * 0.5
        ankle = m.bone(f"{side}Foot", f"{side}Leg", (s * stance, flat, 0))
        m.limb(
            [hip + [0, 0.05, 0], knee, ankle], [thick * 1.2, thick * 1.05, thick], [f"{side}UpLeg", f"{side}Leg"],
            f"leg {side}",
        )  # fmt: skip
        m.lump(
            ankle + [0, 0, 0.5 * thick * foot], (thick * foot * 0.8, flat * 0.98, thick * foot * 1.3), f"{side}Foot",
            f"leg {side}",
        )  # fmt: skip


def blob(m: Model) -> None:
    """A slime, a ghost, a mushroom, a skull or an eye: a lump with or without stubs of arms."""
    u = m.u
    kind = m.pick("slime", "ghost", "mushroom", "skull", "stack")
    half = np.array([u(0.35, 0.55), u(0.28, 0.6), u(0.35, 0.55)])
    names = ["Hips", "Spine", "Neck", "Head"]
    marks = np.array([0.2, u(0.32, 0.42), u(0.5, 0.56), u(0.58, 0.66)])
    if kind == "slime":
        marks = np.array([0.25, 0.6, 0.72, 0.8])
    elif kind == "ghost":
        half *= [0.7, 1.5, 0.7]
        marks = np.array([0.12, 0.32, 0.5, 0.58])
    elif kind == "mushroom":
        half *= [0.5, 1.1, 0.5]
    elif kind == "skull":
        marks = np.array([0.05, 0.12, 0.18, 0.24])
    positions = [np.array([0, mark * 2 * half[1], 0]) for mark in marks]
    m.bones_along(names, positions)
    body = Chain(names, positions, 1.5)
    top = 2 * half[1]
    if kind == "slime":
        m.limb(
            [(0, half[0] * 0.45, 0), (0, max(top - half[0], half[0] * 0.5), 0)], [half[0], half[0] * u(0.55, 1)], body,
            "body", stretch=(1, 1, half[2] / half[0]),
        )  # fmt: skip
    elif kind == "ghost":
        m.limb(
            [(0, 0.1, 0), (0, half[1], 0), (0, top - half[0] * 0.8, 0)],
            [half[0] * u(0.15, 1.2), half[0], half[0] * u(0.8, 1.1)], body, "body", blend=1.0,
        )  # fmt: skip
    elif kind == "mushroom":
        m.limb([(0, half[0] * 0.5, 0), (0, half[1] * 1.1, 0)], [half[0], half[0] * u(0.5, 0.9)], body, "body")
        wide = half[0] * u(1.5, 3.0)
        m.lump(
            (0, half[1] * 1.35, 0), (wide, half[1] * u(0.4, 0.7), wide), "Head", "cap", loose=m.chance(0.5), blend=0.2
        )
    elif kind == "skull":
        m.lump((0, half[1] * 1.15, 0), half * [1, 0.85, 1.05], body, "body")
        m.lump((0, half[1] * 0.45, half[2] * 0.25), half * [0.6, 0.45, 0.7], body, "body", blend=0.8)
    else:
        for share, size, height in (("Hips", 1.0, 0.25), ("Spine", 0.85, 0.55), ("Head", u(0.6, 1.1), 0.85)):
            m.lump((0, top * height, 0), half * size * [1, 0.45, 1], share, "body")
    middle = np.array([0, (0.62 if kind != "mushroom" else 0.35) * top, 0])
    eyes(m, middle, half * [1.0, 0.5, 1.0], "Head" if kind != "mushroom" else "Spine")
    if kind != "mushroom" and m.chance(0.35):
        ears_and_horns(m, np.array([0, 0.62 * top, 0]), half * [0.8, 0.5, 0.8], "Head")
    if m.chance(0.45):
        arm, r, drop = u(0.12, 0.4), u(0.04, 0.09), u(-0.5, 0.8)
        for side, s in SIDES:
            a = np.array([s * half[0] * 0.9, (0.45 if kind != "mushroom" else 0.3) * top, 0.05])
            direction = np.array([s * np.cos(drop), -np.sin(drop), 0.2])
            m.bone(f"{side}Arm", "Spine", a)
            b = m.bone(f"{side}ForeArm", f"{side}Arm", a + direction * arm * 0.5)
            c = m.bone(f"{side}Hand", f"{side}ForeArm", a + direction * arm)
            m.limb([a, b, c], [r, r * 0.9, r * 0.8], [f"{side}Arm", f"{side}ForeArm"], f"arm {side}", blend=0.6)
            m.lump(c + direction * r * 0.5, r * u(1.0, 1.7), f"{side}Hand", f"arm {side}")
    if kind in ("mushroom", "skull", "stack") and m.chance(0.5):
        r = half[0] * u(0.2, 0.35)
        leg = u(0.12, 0.3)
        for side, s in SIDES:
            hip = m.bone(f"{side}UpLeg", "Hips", (s * 0.45 * half[0], 0.1 * top, 0))
            knee = m.bone(f"{side}Leg", f"{side}UpLeg", (s * 0.5 * half[0], 0.05 - 0.4 * leg, 0))
            foot = m.bone(f"{side}Foot", f"{side}Leg", (s * 0.5 * half[0], -leg, 0))
            m.limb([hip, knee, foot], [r, r * 0.8, r * 0.7], [f"{side}UpLeg", f"{side}Leg"], f"leg {side}")
            m.lump(foot + [0, 0, 0.6 * r], (r, r * 0.6, r * 1.7), f"{side}Foot", f"leg {side}")


def flyer(m: Model) -> None:
    """A ball that flies: an imp or bat with wings, or a drone with arms."""
    u = m.u
    half = np.array([u(0.25, 0.45), u(0.25, 0.45), u(0.25, 0.45)])
    middle = np.array([0, 1.0, 0])
    if m.chance(0.3):
        m.bone("Hips", "", middle - [0, 0.7 * half[1], 0])
        m.bone("Spine", "Hips", middle - [0, 0.4 * half[1], 0])
        m.bone("Head", "Spine", middle)
        m.lump(middle, half, "Head", "body")
        eyes(m, middle, half, "Head")
        r, long = u(0.05, 0.12), u(0.2, 0.5)
        for side, s in SIDES:
            points = [middle + [s * (half[0] + long * t), u(-0.05, 0.0), 0] for t in (-0.1, 0.15, 0.55, 1.0)]
            for name, parent, at in zip(
                ("Shoulder", "Arm", "ForeArm", "Hand"), ("", "Shoulder", "Arm", "ForeArm"), points, strict=True
            ):
                m.bone(f"{side}{name}", f"{side}{parent}" if parent else "Spine", at)
            m.limb(
                points, [r * 1.4, r, r * 0.6, r * 0.9], [f"{side}{n}" for n in ("Shoulder", "Arm", "ForeArm")],
                f"arm {side}",
            )  # fmt: skip
            m.lump(points[-1] + [s * r, 0, 0], r * np.array([1.4, 1.2, 1.6]), f"{side}Hand", f"arm {side}")
        return
    names = ["Hips", "Spine", "Neck", "Head"]
    positions = [middle + [0, t * half[1], 0] for t in (-0.6, -0.3, 0.0, 0.15)]
    m.bones_along(names, positions)
    if m.chance(0.5):
        m.lump(middle, half, Chain(names, positions), "body")
        face, size = middle + [0, 0.3 * half[1], 0], half * [0.95, 0.7, 0.95]
    else:  # a head on a small body
        m.lump(middle - [0, 0.5 * half[1], 0], half * [0.55, 0.7, 0.5], Chain(names[:2], positions[:2]), "body")
        face, size = middle + [0, 0.55 * half[1], 0.1], half * u(0.6, 0.9)
        m.lump(face, size, "Head", "head")
        m.limb([middle, face], [0.3 * half[0], 0.3 * half[0]], "Neck", "head")
    eyes(m, face, size, "Head")
    if m.chance(0.7):
        ears_and_horns(m, face, size, "Head")
    wings(m, middle + [0.8 * half[0], -0.1 * half[1], -0.4 * half[2]], u(0.4, 1.2), "Spine", m.pick("spread", "raised"))
    if m.chance(0.35):
        tail(m, middle - [0, 0.6 * half[1], 0.6 * half[2]], u(0.2, 0.6), u(0.02, 0.06), u(-0.8, 0.5), u(0, 1.5), 3)
    if m.chance(0.4):
        r = u(0.03, 0.08)
        for side, s in SIDES:
            hip = m.bone(f"{side}UpLeg", "Hips", middle + [s * 0.4 * half[0], -0.75 * half[1], 0])
            knee = m.bone(f"{side}Leg", f"{side}UpLeg", hip - [0, 0.12, 0])
            foot = m.bone(f"{side}Foot", f"{side}Leg", knee - [0, 0.12, 0.03])
            m.limb([hip, knee, foot], [r, r * 0.9, r * 0.8], [f"{side}UpLeg", f"{side}Leg"], f"leg {side}")
            m.lump(foot + [0, 0, 0.5 * r], (r * 1.1, r * 0.8, r * 1.8), f"{side}Foot", f"leg {side}")
