"""Creatures on two legs: dinosaurs, birds and machines that walk."""

from __future__ import annotations

import numpy as np

from bunraku_lab.synthetic.families.beasts import beast_head, tail, wings
from bunraku_lab.synthetic.families.human_head import eyes
from bunraku_lab.synthetic.families.model import SIDES, Chain, Model
from bunraku_lab.synthetic.surfaces import unit


def _claws(
    m: Model, at: np.ndarray, share: str, region: str, radius: float, count: int, reach: float, back: bool = False
) -> None:
    """Toes in a fan, and one backwards."""
    for turn in np.linspace(-0.6, 0.6, count):
        m.limb(
            [at, at + reach * np.array([np.sin(turn), 0, np.cos(turn)]) - [0, at[1] - 0.6 * radius, 0]],
            [radius, radius * 0.55], share, region,
        )  # fmt: skip
    if back:
        m.limb([at, at - [0, at[1] - 0.5 * radius, 0.6 * reach]], [radius * 0.8, radius * 0.4], share, region)


def dinosaur(m: Model) -> None:
    """A reptile on its hind legs: long tail, small arms, the trunk level or upright."""
    u = m.u
    radius, leg, tilt = u(0.18, 0.3), u(0.45, 0.9), u(-0.1, 0.55) if m.chance(0.7) else u(0.55, 1.35)
    direction = np.array([0, np.sin(tilt), np.cos(tilt)])
    hips = np.array([0, leg + 0.1, 0])
    steps = (0, u(0.15, 0.25), u(0.32, 0.42), u(0.55, 0.65))
    names, positions = ["Hips", "Spine", "Spine1", "Spine2"], [hips + direction * s for s in steps]
    m.bones_along(names, positions)
    trunk = Chain(names, positions)
    chest = hips + direction * 0.65
    m.limb(
        [hips, hips + direction * 0.35, chest], [radius, radius * u(0.85, 1.15), radius * u(0.6, 0.9)], trunk, "trunk",
        stretch=(u(0.65, 1.0), 1, 1), blend=1.5,
    )  # fmt: skip
    reach, lift, head = u(0.1, 0.45), tilt + u(-0.1, 0.7), u(0.14, 0.26)
    m.bone("Neck", "Spine2", chest)
    top = m.bone("Head", "Neck", chest + reach * np.array([0, np.sin(lift), np.cos(lift)]))
    m.limb([chest, top], [radius * 0.65, head * 0.7], "Neck", "neck", blend=1.0)
    centre = beast_head(m, top, head, u(0.3, 1.6), u(-0.1, 0.4))
    if m.chance(0.2):
        m.limb(
            [centre + [0, 0.4 * head, 0], centre + [0, 1.0 * head, -u(0.6, 1.6) * head]], [0.3 * head, 0.12 * head],
            "Head", "crest",
        )  # fmt: skip
    tail(
        m, hips - direction * 0.1, u(0.6, 1.4), radius * u(0.55, 0.85), u(-0.35, 0.15), u(-0.1, 0.5),
        int(m.rng.integers(4, 7)),
    )  # fmt: skip
    thick, arm, claws = radius * u(0.3, 0.45), u(0.12, 0.4), m.chance(0.6)
    hock, three = u(0.15, 0.3) if m.chance(0.5) else 0.0, m.pick(3, 2)
    wide, step = radius * u(0.55, 0.9), u(-0.12, 0.12) * float(m.chance(0.4))
    arm_drop = u(-0.3, 1.0)
    for side, s in SIDES:
        hip = m.bone(f"{side}UpLeg", "Hips", hips + [s * wide, -0.05, 0.03])
        foot_y = thick * 0.7
        knee = m.bone(
            f"{side}Leg", f"{side}UpLeg",
            (
                hip[0] + s * 0.02, foot_y + 0.52 * (hip[1] - foot_y),
                u(0.08, 0.14) if s > 0 else m.at("LeftLeg")[2] + step,
            ),
        )  # fmt: skip
        if hock:
            mid = m.bone(
                f"{side}Foot", f"{side}Leg", (hip[0] + s * 0.02, foot_y + hock * (hip[1] - foot_y), knee[2] - 0.22)
            )
            at = m.bone(f"{side}ToeBase", f"{side}Foot", (hip[0] + s * 0.02, foot_y, knee[2] - 0.08))
            m.limb(
                [hip, knee, mid, at], [thick * 2.1, thick * 1.25, thick * 0.8, thick * 0.7],
                [f"{side}UpLeg", f"{side}Leg", f"{side}Foot"], f"leg {side}", blend=0.7,
            )  # fmt: skip
            share = f"{side}ToeBase"
        else:
            at = m.bone(f"{side}Foot", f"{side}Leg", (hip[0] + s * 0.02, foot_y, knee[2] - u(0.08, 0.16)))
            m.limb(
                [hip, knee, at], [thick * 2.1, thick * 1.2, thick * 0.8], [f"{side}UpLeg", f"{side}Leg"], f"leg {side}",
                blend=0.7,
            )  # fmt: skip
            share = f"{side}Foot"
        _claws(m, at, share, f"leg {side}", thick * 0.65, 3, thick * u(2.0, 3.2))
        m.bone(f"{side}Shoulder", "Spine2", chest + [s * 0.35 * radius, -0.2 * radius, -0.06])
        a = m.bone(f"{side}Arm", f"{side}Shoulder", chest + [s * radius * 0.75, -0.3 * radius, -0.04])
        b = m.bone(
            f"{side}ForeArm", f"{side}Arm", a + arm * 0.5 * unit(np.array([s * 0.4, -1.0, -0.2 + 0.3 * arm_drop]))
        )
        c = m.bone(f"{side}Hand", f"{side}ForeArm", b + arm * 0.5 * unit(np.array([0, -arm_drop, 0.8])))
        r = max(arm * u(0.12, 0.2), 0.02)
        m.limb([m.at(f"{side}Shoulder"), a], [r * 1.8, r * 1.6], f"{side}Shoulder", "trunk", blend=1.0)
        m.limb([a, b, c], [r * 1.5, r, r * 0.8], [f"{side}Arm", f"{side}ForeArm"], f"arm {side}")
        for i in range(three if claws else 1):
            m.limb(
                [c, c + unit(np.array([(i - 0.5) * 0.6, -0.5, 0.8])) * arm * 0.22], [r * 0.8, r * 0.3 if claws else r],
                f"{side}Hand", f"arm {side}",
            )  # fmt: skip
    if m.chance(0.25):
        for z in np.linspace(0, 0.6, 6):
            at = hips + direction * z + np.array([0, np.cos(tilt), -np.sin(tilt)]) * radius
            m.limb(
                [at, at + radius * 0.7 * np.array([0, np.cos(tilt), -np.sin(tilt)])], [0.25 * radius, 0.02], trunk,
                "plates", stretch=(0.35, 1, 1), loose=True,
            )  # fmt: skip


def bird(m: Model) -> None:
    """A bird: chick to ostrich, wings folded, spread or none, tail feathers, beak."""
    u = m.u
    round_, leg = u(0.2, 0.42), u(0.1, 0.6) if m.chance(0.75) else u(0.6, 1.1)
    tilt = u(0.0, 1.0) if m.chance(0.75) else u(1.0, 1.5)
    direction = np.array([0, np.sin(tilt), np.cos(tilt)])
    body = np.array([0, leg + 0.7 * round_, 0])
    hips, spine, base = (
        body - direction * 0.5 * round_, body + direction * u(-0.05, 0.15) * round_, body + direction * 0.8 * round_,
    )  # fmt: skip
    m.bone("Hips", "", hips)
    m.bone("Spine", "Hips", spine)
    trunk = Chain(["Hips", "Spine"], [hips, spine])
    m.limb(
        [body - direction * 0.45 * round_, body + direction * 0.35 * round_],
        [round_ * u(0.65, 1.0), round_ * u(0.75, 1.0)], trunk, "trunk", stretch=(u(0.75, 1.1), 1, 1), blend=1.2,
    )  # fmt: skip
    neck, head = u(0.0, 0.25) if m.chance(0.6) else u(0.25, 0.9), u(0.13, 0.34)
    lift = u(0.9, 1.6)
    m.bone("Neck", "Spine", base)
    top = m.bone("Head", "Neck", base + (neck + 0.15 * round_) * np.array([0, np.sin(lift), np.cos(lift)]))
    thin = head * u(0.45, 0.9)
    m.limb([base - direction * 0.3 * round_, top], [max(round_ * 0.55, thin), thin], "Neck", "neck", blend=1.0)
    centre = top + [0, 0.5 * head, 0.2 * head]
    m.lump(centre, head * np.array([u(0.8, 1.0), u(0.8, 1.0), u(0.9, 1.1)]), "Head", "head", blend=0.8)
    long = head * u(0.4, 1.8)
    m.limb(
        [centre + [0, -0.1 * head, 0.7 * head], centre + [0, -u(0.1, 0.5) * head, 0.8 * head + long]],
        [head * u(0.25, 0.45), head * u(0.03, 0.3)], "Head", "beak", stretch=(u(0.8, 1.4), 1, 1), loose=m.chance(0.6),
    )  # fmt: skip
    eyes(m, centre, np.full(3, head), "Head")
    if m.chance(0.25):
        m.limb(
            [centre + [0, 0.7 * head, 0.2 * head], centre + [0, 1.3 * head, -0.5 * head]], [0.3 * head, 0.1 * head],
            "Head", "comb", stretch=(0.4, 1, 1),
        )  # fmt: skip
    if m.chance(0.75):
        root = hips - direction * 0.3 * round_
        end = u(0.3, 1.2) * round_
        count = 2 if end > 0.6 * round_ else 1
        slope = u(-0.3, 0.7)
        back = np.array([0, np.sin(slope), -np.cos(slope)])
        for i in range(count + 1):
            m.bone(f"Tail{i + 1}", f"Tail{i}" if i else "Hips", root + back * end * i / (count + 1))
        names = [f"Tail{i + 1}" for i in range(count + 1)]
        points = [m.at(n) for n in names]
        m.limb(
            [root + direction * 0.3 * round_, root + back * end], [round_ * 0.4, round_ * u(0.2, 0.5)],
            Chain(names, points), "tail", stretch=(u(0.9, 1.6), u(0.2, 0.5), 1), blend=0.8,
        )  # fmt: skip
    if m.chance(0.8):
        if m.chance(0.55):  # small folded wings that lie on the sides
            for side, s in SIDES:
                at = body + [s * round_ * 0.85, 0.15 * round_, 0.2 * round_]
                m.bone(f"{side}Wing", "Spine", at)
                wing_tip = at + unit(np.array([s * 0.15, -0.5, -1.0])) * round_ * u(0.9, 1.5)
                m.limb(
                    [at, wing_tip], [round_ * 0.45, round_ * 0.15], f"{side}Wing", f"wing {side}", stretch=(0.35, 1, 1),
                    loose=m.chance(0.3),
                )  # fmt: skip
        else:
            wings(m, body + [0.7 * round_, 0.3 * round_, 0.2 * round_], u(0.5, 1.6), "Spine")
    r = u(0.015, 0.05)
    wide, drum = round_ * u(0.3, 0.55), u(0.25, 0.5)
    for side, s in SIDES:
        hip = m.bone(f"{side}UpLeg", "Hips", (s * wide, leg + 0.35 * round_, body[2] - 0.05 * round_))
        knee = m.bone(f"{side}Leg", f"{side}UpLeg", (s * wide, leg * (1 - drum) + 0.02, body[2] - u(0.0, 0.15) * leg))
        ankle = m.bone(f"{side}Foot", f"{side}Leg", (s * wide, r, body[2]))
        m.limb([hip, knee], [max(round_ * u(0.22, 0.4), 1.5 * r), r * 1.3], f"{side}UpLeg", f"leg {side}", blend=0.6)
        m.limb([knee, ankle], [r * 1.1, r], f"{side}Leg", f"leg {side}")
        _claws(m, ankle, f"{side}Foot", f"leg {side}", r, 3, u(0.08, 0.16) + r, back=m.chance(0.7))


def mech(m: Model) -> None:
    """A machine on two legs, with reversed knees, a big cabin, and guns or arms."""
    u = m.u
    if m.chance(0.85):
        m.restyle(mode="pieces", exponent=m.pick(2.0, 4.0, 10.0, 20.0), cap=u(0.3, 0.9), faces=None)
    if m.chance(0.7):
        m.restyle(soft=0.0)
    leg, wide = u(0.6, 1.1), u(0.22, 0.4)
    body = np.array([u(0.22, 0.45), u(0.18, 0.4), u(0.2, 0.4)])
    y = leg + 0.5 * body[1]
    m.bone("Hips", "", (0, y - 0.3 * body[1], 0))
    m.bone("Spine", "Hips", (0, y + 0.6 * body[1], 0))
    m.bone("Neck", "Spine", (0, y + 0.95 * body[1], 0))
    m.bone("Head", "Neck", (0, y + 1.1 * body[1], 0.05))
    m.lump((0, y, 0), body, "Hips", "body")
    if m.chance(0.5):
        m.lump((0, y - 0.5 * body[1], 0), (wide * 0.9, 0.4 * body[1], 0.6 * body[2]), "Hips", "body")
    upper = u(0.4, 1.0)
    m.lump((0, y + body[1] * 0.85, u(-0.1, 0.1)), body * upper * [1, 0.6, 1], "Spine", "chest")
    head = u(0.1, 0.3)
    m.limb(
        [(0, y + body[1] * (1 + 0.3 * upper), 0), (0, y + body[1] * (1.05 + 0.4 * upper) + 0.4 * head, 0.02)],
        [head * 0.5, head * 0.5], "Neck", "head",
    )  # fmt: skip
    at = np.array([0, y + body[1] * (1.05 + 0.4 * upper) + 0.7 * head, 0.05])
    m.lump(at, head * np.array([u(0.7, 1.3), u(0.6, 1.0), u(0.7, 1.3)]), "Head", "head")
    eyes(m, at, np.full(3, head), "Head")
    r, back = u(0.05, 0.11), u(0.15, 0.35) * m.pick(1.0, 1.0, -0.5)
    three, pads = m.chance(0.6), u(1.2, 2.6)
    caps, flat = m.chance(0.5), (u(1.1, 1.8), u(1.8, 3.2)) if m.chance(0.6) else None
    arms = m.pick("none", "guns", "arms")
    for side, s in SIDES:
        x = s * (wide + r)
        hip = m.bone(f"{side}UpLeg", "Hips", (x, leg + 0.1, 0))
        if three:
            knee = m.bone(f"{side}Leg", f"{side}UpLeg", (x, leg * 0.68, back))
            hock = m.bone(f"{side}Foot", f"{side}Leg", (x, leg * 0.38, -back * 0.7))
            foot = m.bone(f"{side}ToeBase", f"{side}Foot", (x, r * 0.8, back * 0.2))
            m.limb(
                [hip, knee, hock, foot], [r * 1.4, r, r * 1.1, r * 0.7], [f"{side}UpLeg", f"{side}Leg", f"{side}Foot"],
                f"leg {side}",
            )  # fmt: skip
            share = f"{side}ToeBase"
        else:
            knee = m.bone(f"{side}Leg", f"{side}UpLeg", (x, leg * 0.5, -back))
            foot = m.bone(f"{side}Foot", f"{side}Leg", (x, r * 0.8, 0))
            m.limb([hip, knee, foot], [r * 1.4, r * 1.1, r * 0.8], [f"{side}UpLeg", f"{side}Leg"], f"leg {side}")
            share = f"{side}Foot"
        if caps:
            m.lump(knee, r * 1.5, f"{side}Leg", f"leg {side}")
        m.lump(hip, (r * 1.2, r * pads, r * pads), f"{side}UpLeg", f"leg {side}")
        if flat:
            m.block(foot + [0, 0, r], (r * flat[0], r * 0.7, r * flat[1]), share, f"foot {side}")
        else:
            _claws(m, foot, share, f"foot {side}", r * 0.6, 3, r * 3, back=True)
        if arms == "guns":
            m.bone(f"{side}Shoulder", "Spine", (s * body[0] * 0.9, y + 0.3 * body[1], 0))
            a = m.bone(f"{side}Arm", f"{side}Shoulder", (s * (body[0] + 1.5 * r), y + 0.3 * body[1], 0))
            m.lump(a, r * 1.4, f"{side}Arm", f"arm {side}")
            m.limb(
                [a, a + [0, -0.2 * r, u(0.25, 0.6)]], [r * u(0.8, 1.3), r * u(0.6, 1.2)], f"{side}Arm", f"arm {side}"
            )
        elif arms == "arms":
            m.bone(f"{side}Shoulder", "Spine", (s * body[0] * 0.9, y + 0.5 * body[1], 0))
            drop = (
                u(0, 1.2)
                if s > 0
                else float(
                    np.arctan2(m.at("LeftArm")[1] - m.at("LeftForeArm")[1], m.at("LeftForeArm")[0] - m.at("LeftArm")[0])
                )
            )
            direction = np.array([s * np.cos(drop), -np.sin(drop), 0.1])
            a = m.bone(f"{side}Arm", f"{side}Shoulder", (s * (body[0] + r), y + 0.5 * body[1], 0))
            b = m.bone(f"{side}ForeArm", f"{side}Arm", a + direction * 0.35)
            c = m.bone(f"{side}Hand", f"{side}ForeArm", b + unit(direction + [0, 0, 0.5]) * 0.35)
            m.lump(m.at(f"{side}Shoulder"), r * 1.3, f"{side}Shoulder", "chest")
            m.limb([a, b, c], [r, r * 0.8, r * u(0.8, 1.5)], [f"{side}Arm", f"{side}ForeArm"], f"arm {side}")
            m.lump(c + unit(direction) * r, r * u(0.9, 1.5), f"{side}Hand", f"arm {side}")
