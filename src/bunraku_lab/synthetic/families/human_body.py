"""Bodies of people: trunk, arms and legs, hands and feet."""

from __future__ import annotations

import numpy as np

from bunraku_lab.synthetic.families.human_frame import Human, arm_chain, pose_skeleton
from bunraku_lab.synthetic.families.model import SIDES, Chain, Model
from bunraku_lab.synthetic.surfaces import unit

__all__ = ["build_body"]


def build_body(m: Model, h: Human) -> None:
    """Bones and flesh of everything but the head."""
    pose_skeleton(m, h)
    _trunk(m, h)
    hand = str(
        m.pick(
            "mitten",
            "fingers",
            "three",
            "stub",
            "claw",
            weights=(0.3, 0.33, 0.13, 0.15, 0.09) if h.kind != "realistic" else (0.1, 0.8, 0.05, 0.05, 0),
        )
    )
    slim, ball_joint = m.u(0.6, 0.95), h.kind == "robot" and m.chance(0.5)
    toes = m.chance(0.6)
    foot = (m.u(0.5, 0.9), m.u(0.8, 1.7), m.u(1.4, 2.8))  # heel, width and length over the ankle's radius
    calf, ankle_thin = m.u(0.75, 1.05), m.u(0.55, 0.95)
    swell = m.u(1.3, 2.2) if m.chance(0.2) else 1.0
    for side, s in SIDES:
        shoulder, elbow, wrist = arm_chain(m, side)
        collar = m.at(f"{side}Shoulder")
        if m.style.mode != "pieces" or m.chance(0.7):
            m.limb([collar, shoulder], [h.arm * 1.25, h.arm * 1.12], f"{side}Shoulder", "trunk", blend=1.0)
        m.limb([shoulder, elbow], [h.arm * 1.1, h.arm * slim], f"{side}Arm", f"arm {side}", blend=0.5)
        m.limb(
            [elbow, wrist],
            [h.arm * slim * (1.15 if swell > 1 else 1.0), h.arm * slim * 0.8 * swell],
            f"{side}ForeArm",
            f"arm {side}",
        )
        if ball_joint:
            m.lump(elbow, h.arm * 1.15, f"{side}ForeArm", f"arm {side}")
            m.lump(shoulder, h.arm * 1.5, f"{side}Arm", f"arm {side}")
        _hand(m, h, side, hand, h.arm * slim * 0.8 * swell)
        hip, knee, ankle = (m.at(f"{side}{name}") for name in ("UpLeg", "Leg", "Foot"))
        r_knee, r_ankle = h.thigh * 0.72 * slim**0.3, min(h.thigh * ankle_thin * 0.62 * swell, 0.95 * h.heel)
        m.limb([hip, knee], [h.thigh, r_knee], f"{side}UpLeg", f"leg {side}", blend=0.4)
        mid = 0.62 * knee + 0.38 * ankle + [0, 0, -0.25 * r_knee * calf]
        m.limb([knee, mid, ankle], [r_knee * 0.95, r_knee * calf, r_ankle], f"{side}Leg", f"leg {side}")
        if ball_joint:
            m.lump(knee, r_knee * 1.25, f"{side}Leg", f"leg {side}")
        _foot(m, h, side, s, ankle, r_ankle, foot, toes)


def _trunk(m: Model, h: Human) -> None:
    u, z = m.u, m.at("Spine2")[2]
    base, top = h.leg, h.top
    belly = u(0.0, 0.5) if m.chance(0.3) else 0.0
    shape = np.array([1.0, 1.0, h.deep])
    hips = (0, base + 0.06 * h.trunk, 0)
    torso = h.torso
    assert isinstance(torso, Chain)
    edge, soft = h.leg + u(-0.02, 0.05) * h.trunk, 0.004 + 0.03 * h.trunk

    def seat(points: np.ndarray) -> dict[str, np.ndarray]:
        """The lower sides of the pelvis go with the thighs."""
        low = edge - 0.9 * np.maximum(0.55 * h.hip - np.abs(points[:, 0]), 0) - points[:, 1]
        legs = 1 / (1 + np.exp(-np.clip(low / soft, -40, 40)))
        out = {name: value * (1 - legs) for name, value in torso.weights(points, m.style.soft).items()}
        return out | {"LeftUpLeg": legs * (points[:, 0] > 0), "RightUpLeg": legs * (points[:, 0] <= 0)}

    m.lump(hips, (h.pelvis, max(0.16 * h.trunk, 0.6 * h.thigh), max(h.pelvis * h.deep, 0.9 * h.thigh)), seat, "trunk")
    low, mid, high = base + 0.08 * h.trunk, base + 0.42 * h.trunk, base + u(0.7, 0.8) * h.trunk
    m.limb(
        [(0, low, 0), (0, mid, 0.4 * z)],
        [h.pelvis * 0.9, h.waist],
        seat,
        "trunk",
        stretch=shape * [1, 0.3, 1],
        blend=1.0,
    )
    m.limb(
        [(0, mid, 0.4 * z), (0, high, z)], [h.waist, h.chest], h.torso, "trunk", stretch=shape * [1, 0.4, 1], blend=1.0
    )
    m.limb(
        [(0, high, z), (0, top - 0.08 * h.trunk, z)],
        [h.chest * 0.98, h.chest * 0.55],
        h.torso,
        "trunk",
        stretch=shape * [1, 0.5, 0.9],
        blend=1.0,
    )
    if belly:
        m.lump(
            (0, base + u(0.25, 0.45) * h.trunk, h.waist * h.deep * belly),
            h.waist * np.array([0.95, 0.95, 0.9]),
            h.torso,
            "trunk",
            blend=1.0,
        )
    if h.kind != "robot" and m.chance(0.35):
        bust = h.chest * u(0.32, 0.5)
        for _, s in SIDES:
            m.lump(
                (s * h.chest * 0.45, base + 0.68 * h.trunk, z + h.chest * h.deep * 0.75),
                bust * np.array([1, 0.95, 0.9]),
                h.torso,
                "trunk",
                blend=0.8,
            )
    neck, head = m.at("Neck"), m.at("Head")
    if h.neck > 0.008:
        thick = (
            min(u(0.2, 0.42) * h.head, 0.55 * h.chest)
            if h.kind != "realistic"
            else u(0.22, 0.32) * h.head * h.girth**0.4
        )
        m.limb(
            [neck - [0, 0.03 * h.trunk, 0], head + [0, 0.06 * h.head, 0]],
            [thick * 1.1, thick * 0.9],
            "Neck",
            "trunk",
            blend=0.6,
        )


def _foot(
    m: Model,
    h: Human,
    side: str,
    s: float,
    ankle: np.ndarray,
    radius: float,
    size: tuple[float, float, float],
    toes: bool,
) -> None:
    heel, wide, length = size
    high = max(h.heel * 0.55, 0.012)
    floor = ankle[1] - h.heel
    reach = max(h.leg * 0.09 * length, 1.5 * radius)
    direction = unit(np.array([s * 0.12, 0, 1.0]))
    back = np.array([ankle[0], floor + high, ankle[2] - 0.25 * reach * heel])
    ball_at = np.array([ankle[0], floor + high * 0.9, ankle[2]]) + direction * reach * 0.6
    tip = ball_at + direction * reach * 0.4
    w = radius * wide
    m.limb([ankle, (ankle + back) / 2], [radius, max(radius * 0.9, high * 0.8)], f"{side}Foot", f"leg {side}")
    flat = (w / high, 1.0, 1.0) if w > high else (1.0, 1.0, 1.0)
    m.limb([back, ball_at], [high, high * 0.9], f"{side}Foot", f"leg {side}", stretch=flat, blend=0.6)
    share = f"{side}Foot"
    if toes:
        share = f"{side}ToeBase"
        m.bone(share, f"{side}Foot", ball_at)
    m.limb([ball_at, tip], [high * 0.88, high * 0.6], share, f"leg {side}", stretch=flat, blend=0.6)


def _hand(m: Model, h: Human, side: str, kind: str, radius: float) -> None:
    """A hand at the end of the forearm: "mitten", "fingers", "three" (of them), "stub" or "claw"."""
    _, elbow, wrist = arm_chain(m, side)
    along = unit(wrist - elbow)
    ahead = np.array([0.0, 0, 1]) if abs(along[2]) < 0.8 else np.array([0.0, 1, 0])
    thumb = unit(ahead - along * (ahead @ along))
    normal = np.cross(along, thumb)
    turn = np.stack([along, normal, thumb], axis=1)
    name, region, size = f"{side}Hand", f"arm {side}", h.hand
    if kind == "stub":
        fist = max(size * 0.45, radius * 1.1)
        m.lump(wrist + along * max(size * 0.35, 0.75 * fist), np.full(3, fist), name, region)
        return
    palm = size * (0.6 if kind == "mitten" else 0.5)
    wide, thick = max(size * 0.25, radius * 0.9), max(size * 0.13, radius * 0.6)
    m.lump(wrist + along * palm * 0.55, (palm * 0.65, thick, wide), name, region, turn=turn, blend=0.8)
    if kind == "mitten":
        m.lump(wrist + along * size * 0.75, (size * 0.35, thick * 0.9, wide * 0.9), name, region, turn=turn, blend=0.8)
        m.limb(
            [wrist + along * palm * 0.35 + thumb * wide * 0.6, wrist + along * palm * 0.85 + thumb * wide * 1.5],
            [thick * 0.8, thick * 0.6],
            name,
            region,
        )
        return
    count, longer = {"fingers": 4, "three": 3, "claw": 3}[kind], h.long_fingers
    fat = thick * 0.9 if kind == "claw" else wide * 1.1 / count
    words = ("Index", "Middle", "Ring", "Pinky")
    for i in range(count):
        across = (0.85 - 1.7 * i / (count - 1)) * wide
        bone = m.bone(f"{side}Hand{words[i]}1", name, wrist + along * palm + thumb * across)
        reach = size * (0.48, 0.54, 0.5, 0.4)[i] * longer
        direction = unit(along + thumb * 0.15 * across / wide)
        m.limb(
            [bone - along * 0.1 * size, bone + direction * reach * 0.5, bone + direction * reach],
            [fat, fat * 0.9, fat * (0.25 if kind == "claw" else 0.75)],
            f"{side}Hand{words[i]}1",
            region,
            blend=0.2,
        )
    root = wrist + along * palm * 0.3 + thumb * wide * 0.7
    bone = m.bone(f"{side}HandThumb1", name, root)
    direction = unit(along * 0.7 + thumb * 0.8)
    m.limb(
        [
            bone,
            bone + direction * size * 0.2,
            bone + direction * size * 0.2 + unit(along + 0.3 * thumb) * size * 0.22 * longer,
        ],
        [fat * 1.1, fat, fat * 0.8],
        f"{side}HandThumb1",
        region,
        blend=0.4,
    )
