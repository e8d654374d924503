"""People before they have flesh: proportions, and a skeleton in some rest pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku_lab.synthetic.families.model import SIDES, Chain, Model
from bunraku_lab.synthetic.surfaces import unit

__all__ = ["Human", "arm_chain", "draw_human", "pose_skeleton"]


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
    for name, parent, at in zip(names, ["", *names], positions, strict=False):
        m.bone(name, parent, at)
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
