"""People without clothes: proportions, a skeleton in some rest pose, and on it trunk, arms, legs, hands and feet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku_lab.synthetic.families.model import SIDES, Chain, Model
from bunraku_lab.synthetic.surfaces import unit


@dataclass
class Human:
    """Measures of a person whose height is about 1.

    Args:
        kind: "realistic", "stylised", "chibi", "robot" or "brute".
        head: Height of the head.
        neck: Length of the neck.
        leg: Height of the hip joints.
        hip: Half the distance of the hip joints.
        shoulder: Half the distance of the shoulder joints.
        upper, fore: Lengths of the arm's segments.
        hand: Length of the hand.
        girth: Factor on all radii.
        arm, thigh: Radii.
        deep: Depth of the trunk over its width.
        waist, chest, pelvis: Half widths of the trunk.
        long_fingers: Factor on the length of the fingers.
        seated: Whether it sits.
        heel: Height of the ankles over the ground.
        torso: The trunk's share of the bones.
    """

    kind: str
    head: float
    neck: float
    leg: float
    hip: float
    shoulder: float
    upper: float
    fore: float
    hand: float
    girth: float
    arm: float
    thigh: float
    deep: float
    waist: float
    chest: float
    pelvis: float
    long_fingers: float
    seated: bool = False
    heel: float = 0.05
    torso: Chain | str = "Hips"

    @property
    def trunk(self) -> float:
        """Length of the trunk from the hip joints to the neck."""
        return 1 - self.head - self.neck - self.leg

    @property
    def top(self) -> float:
        """Height of the base of the neck."""
        return self.leg + self.trunk

    def half_width(self, height: float | np.ndarray) -> np.ndarray:
        """Half the width of the trunk at heights."""
        share = (np.asarray(height) - self.leg) / self.trunk
        return np.interp(
            share, [-0.2, 0.05, 0.4, 0.8, 1.0], [self.pelvis, self.pelvis, self.waist, self.chest, 0.6 * self.chest]
        )


def draw_human(m: Model, kind: str) -> Human:
    """Random proportions of a kind of people."""
    u = m.u
    girth = float(np.exp(m.rng.normal(0, 0.2)))
    if kind == "realistic":
        head, neck = u(0.125, 0.15), u(0.035, 0.05)
        leg, wide, arms = u(0.49, 0.545), u(0.09, 0.125), u(0.40, 0.46)
    elif kind == "chibi":
        head, neck = u(0.27, 0.5), u(0.0, 0.02)
        leg, wide, arms = u(0.32, 0.52) * (1 - head), u(0.08, 0.15), u(0.22, 0.34)
    elif kind == "brute":
        head, neck = u(0.11, 0.2), u(0.0, 0.02)
        leg, wide, arms = u(0.28, 0.42), u(0.15, 0.25), u(0.42, 0.62)
        girth *= u(1.2, 1.8)
    else:
        head, neck = u(0.14, 0.27), u(0.01, 0.04)
        leg, wide, arms = u(0.40, 0.58) * (1 - head), u(0.09, 0.16), u(0.30, 0.46)
    if kind in ("stylised", "robot"):
        girth *= u(0.7, 1.5)
    thick = {"realistic": 0.029, "stylised": 0.031, "chibi": 0.038, "robot": 0.036, "brute": 0.036}[kind] * girth
    chest = wide * u(0.82, 1.02)
    return Human(
        kind=kind,
        head=head,
        neck=neck,
        leg=leg,
        hip=wide * u(0.48, 0.68),
        shoulder=wide,
        upper=arms * u(0.34, 0.42),
        fore=arms * u(0.3, 0.36),
        hand=arms * u(0.2, 0.3),
        girth=girth,
        arm=thick * u(0.8, 1.25),
        thigh=min(thick * u(1.35, 1.9), 0.28 * leg),
        deep=u(0.55, 0.85),
        waist=chest * u(0.68, 1.0) * girth**0.6,
        chest=chest,
        pelvis=wide * u(0.75, 1.05) * girth**0.3,
        long_fingers=u(0.9, 1.25),
    )


def pose_skeleton(m: Model, h: Human) -> None:
    """The bones from the pelvis to wrists and ankles, in a random rest pose."""
    u = m.u
    lift = h.trunk * u(0.02, 0.12)
    base = h.leg + lift
    length = h.top - base
    lean = u(-0.06, 0.06) * h.trunk
    positions = [np.array([0, base + length * s, lean * s]) for s in (0, u(0.05, 0.15), u(0.26, 0.44), u(0.4, 0.62))]
    names = ["Hips", "Spine", "Spine1", "Spine2"]
    m.bones_along(names, positions)
    h.torso = Chain(names, positions)
    neck = m.bone("Neck", "Spine2", (0, h.top, lean))
    slouch = u(0.02, 0.12) if h.kind == "brute" else u(-0.01, 0.035) * (1 if h.kind != "chibi" else 0.3)
    m.bone("Head", "Neck", neck + [0, h.neck + u(0.0, 0.06) * h.head, slouch])
    pose = m.pick("T", "A", "down", "idle", "free", "sit", weights=(0.44, 0.22, 0.12, 0.13, 0.06, 0.03))
    h.seated = pose == "sit"
    drop = {
        "T": u(-0.08, 0.12),
        "A": u(0.4, 1.0),
        "down": u(1.05, 1.4),
        "idle": u(0.7, 1.35),
        "free": 0.0,
        "sit": u(0.2, 1.3),
    }[pose]
    forward, bend = u(-0.1, 0.15), u(0.0, 0.12) if pose == "T" else u(0.0, 0.5)
    spread, stride = u(0.0, 0.12), u(-0.25, 0.25) if pose in ("idle", "free") and m.chance(0.6) else 0.0
    shoulder_y = h.top - h.trunk * u(0.06, 0.2)
    heel, halves = h.leg * u(0.07, 0.13), u(0.47, 0.53)
    h.heel = heel
    lift_knee, fold_knee = u(-0.3, 0.3), u(-0.4, 1.0)
    if drop > 0.9:
        spread_arm = max(h.pelvis * 1.05 - h.shoulder, 0) + h.arm * 0.9
    else:
        spread_arm = 0.0
    for side, s in SIDES:
        own = drop + m.rng.normal(0, 0.12) if pose == "idle" else u(-1.1, 1.3) if pose == "free" else drop
        ahead = forward + (m.rng.normal(0, 0.2) if pose in ("idle", "free") else 0)
        crook = bend + (abs(m.rng.normal(0, 0.4)) if pose in ("idle", "free") else 0)
        direction = unit(np.array([s * np.cos(own) * np.cos(ahead), -np.sin(own), np.sin(ahead) + 0.02]))
        front = unit(np.array([0, 0.25, 1.0]) - direction * (np.array([0, 0.25, 1.0]) @ direction))
        along = unit(np.cos(crook) * direction + np.sin(crook) * front)
        shoulder = np.array([s * (h.shoulder + 0.5 * spread_arm), shoulder_y, lean])
        m.bone(f"{side}Shoulder", "Spine2", (s * 0.25 * h.shoulder, shoulder_y + 0.02 * h.trunk, lean))
        m.bone(f"{side}Arm", f"{side}Shoulder", shoulder)
        elbow = m.bone(f"{side}ForeArm", f"{side}Arm", shoulder + h.upper * direction)
        m.bone(f"{side}Hand", f"{side}ForeArm", elbow + h.fore * along)
        turn_out, step, knee_bend = spread + u(-0.02, 0.04), s * stride, abs(stride) * u(0, 1.2) + u(0, 0.08)
        hip = m.bone(f"{side}UpLeg", "Hips", (s * h.hip, h.leg, 0))
        thigh = (h.leg - heel) * halves
        down = unit(np.array([s * turn_out, -1.0, step]))
        knee = m.bone(f"{side}Leg", f"{side}UpLeg", hip + thigh * down / max(-down[1], 0.5))
        lower = unit(np.array([s * turn_out, -1.0, step - knee_bend]))
        ankle = knee + (knee[1] - heel) * lower / max(-lower[1], 0.5)
        if h.seated:
            knee = m.bone(
                f"{side}Leg", f"{side}UpLeg", hip + thigh * unit(np.array([s * (0.15 + spread), lift_knee, 1.0]))
            )
            ankle = knee + (h.leg - heel - thigh) * unit(np.array([s * 0.05, -1.0, fold_knee]))
        m.bone(f"{side}Foot", f"{side}Leg", ankle)


def arm_chain(m: Model, side: str) -> list[np.ndarray]:
    """Shoulder, elbow and wrist of a side, each shape (3,)."""
    return [m.at(f"{side}{name}") for name in ("Arm", "ForeArm", "Hand")]


def build_body(m: Model, h: Human) -> None:
    """Bones and flesh of everything but the head."""
    pose_skeleton(m, h)
    _trunk(m, h)
    hand = str(m.pick(
        "mitten", "fingers", "three", "stub", "claw",
        weights=(0.3, 0.33, 0.13, 0.15, 0.09) if h.kind != "realistic" else (0.1, 0.8, 0.05, 0.05, 0),
    ))  # fmt: skip
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
            [elbow, wrist], [h.arm * slim * (1.15 if swell > 1 else 1.0), h.arm * slim * 0.8 * swell], f"{side}ForeArm",
            f"arm {side}",
        )  # fmt: skip
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
        [(0, low, 0), (0, mid, 0.4 * z)], [h.pelvis * 0.9, h.waist], seat, "trunk", stretch=shape * [1, 0.3, 1],
        blend=1.0,
    )  # fmt: skip
    m.limb(
        [(0, mid, 0.4 * z), (0, high, z)], [h.waist, h.chest], h.torso, "trunk", stretch=shape * [1, 0.4, 1], blend=1.0
    )
    m.limb(
        [(0, high, z), (0, top - 0.08 * h.trunk, z)], [h.chest * 0.98, h.chest * 0.55], h.torso, "trunk",
        stretch=shape * [1, 0.5, 0.9], blend=1.0,
    )  # fmt: skip
    if belly:
        m.lump(
            (0, base + u(0.25, 0.45) * h.trunk, h.waist * h.deep * belly), h.waist * np.array([0.95, 0.95, 0.9]),
            h.torso, "trunk", blend=1.0,
        )  # fmt: skip
    if h.kind != "robot" and m.chance(0.35):
        bust = h.chest * u(0.32, 0.5)
        for _, s in SIDES:
            m.lump(
                (s * h.chest * 0.45, base + 0.68 * h.trunk, z + h.chest * h.deep * 0.75),
                bust * np.array([1, 0.95, 0.9]), h.torso, "trunk", blend=0.8,
            )  # fmt: skip
    neck, head = m.at("Neck"), m.at("Head")
    if h.neck > 0.008:
        thick = (
            min(u(0.2, 0.42) * h.head, 0.55 * h.chest)
            if h.kind != "realistic"
            else u(0.22, 0.32) * h.head * h.girth**0.4
        )
        m.limb(
            [neck - [0, 0.03 * h.trunk, 0], head + [0, 0.06 * h.head, 0]], [thick * 1.1, thick * 0.9], "Neck", "trunk",
            blend=0.6,
        )  # fmt: skip


def _foot(
    m: Model, h: Human, side: str, s: float, ankle: np.ndarray, radius: float, size: tuple[float, float, float],
    toes: bool,
) -> None:  # fmt: skip
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
            [thick * 0.8, thick * 0.6], name, region,
        )  # fmt: skip
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
            [fat, fat * 0.9, fat * (0.25 if kind == "claw" else 0.75)], f"{side}Hand{words[i]}1", region, blend=0.2,
        )  # fmt: skip
    root = wrist + along * palm * 0.3 + thumb * wide * 0.7
    bone = m.bone(f"{side}HandThumb1", name, root)
    direction = unit(along * 0.7 + thumb * 0.8)
    m.limb(
        [
            bone, bone + direction * size * 0.2,
            bone + direction * size * 0.2 + unit(along + 0.3 * thumb) * size * 0.22 * longer,
        ],
        [fat * 1.1, fat, fat * 0.8], f"{side}HandThumb1", region, blend=0.4,
    )  # fmt: skip
