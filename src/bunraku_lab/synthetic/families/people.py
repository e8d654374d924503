"""What people wear and carry, and people put together of body, head and clothes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bunraku_lab.synthetic.families.human_body import Human, arm_chain, build_body, draw_human
from bunraku_lab.synthetic.families.human_head import build_head
from bunraku_lab.synthetic.families.model import SIDES, Chain, Model
from bunraku_lab.synthetic.surfaces import ring_mesh, unit


def _leg_share(
    m: Model, waist: float, hem: float, strength: float, blur: float
) -> Callable[[np.ndarray], dict[str, np.ndarray]]:
    """Shares of cloth that hangs from the waist: the pelvis holds it, the legs move it more the lower it is."""
    knee = (m.at("LeftLeg")[1] + m.at("RightLeg")[1]) / 2

    def share(points: np.ndarray) -> dict[str, np.ndarray]:
        down = np.clip((waist - points[:, 1]) / max(waist - min(hem, knee), 1e-6), 0, 1)
        legs = strength * np.minimum(2.2 * down, 1)
        left = 0.5 + 0.5 * np.tanh(points[:, 0] / blur)
        lower = 0.8 / (1 + np.exp(np.clip((points[:, 1] - knee) / (0.25 * blur + 1e-4), -40, 40)))
        out = {"Hips": 1 - legs}
        for side, part in (("Left", left), ("Right", 1 - left)):
            out[f"{side}UpLeg"], out[f"{side}Leg"] = legs * part * (1 - lower), legs * part * lower
        return out

    return share


def _round(
    m: Model, h: Human, heights: np.ndarray, radii: np.ndarray, around: int, gap: float = 0.0, folds: float = 0.0
) -> np.ndarray:
    """Rings about the trunk with an opening of angle `gap` at the front, shape (R, S, 3)."""
    angle = np.linspace(gap / 2, 2 * np.pi - gap / 2, around, endpoint=gap > 0)
    down = np.linspace(0, 1, len(heights))[:, None]
    wave = 1 + folds * down * np.cos(int(m.rng.integers(5, 12)) * angle)[None]
    deep = h.deep + (0.92 - h.deep) * np.minimum(1.5 * down, 1)
    wide = radii[:, None] * wave
    return np.stack(
        [wide * np.sin(angle), np.broadcast_to(heights[:, None], wide.shape), wide * deep * np.cos(angle)], axis=-1
    )


def _skirt(m: Model, h: Human, long: bool) -> None:
    u = m.u
    waist = h.leg + h.trunk * u(0.1, 0.5)
    hem = h.leg * (u(0.02, 0.3) if long else u(0.4, 0.75))
    flare = h.pelvis * 1.05 + (waist - hem) * (u(0.0, 0.4) if m.chance(0.75) else u(0.4, 1.0))
    stance = abs(m.at("LeftFoot")[0]) + h.thigh * 0.8
    heights = np.linspace(waist, hem, 9)
    share = np.linspace(0, 1, 9)
    start = float(h.half_width(waist)) * 1.04 + 0.004
    radii = start + (max(flare, stance, h.hip + 1.1 * h.thigh) - start) * share ** u(0.4, 1.1)
    grid = _round(m, h, heights, radii, int(m.rng.integers(10, 40)), folds=u(0, 0.1) if m.chance(0.5) else 0.0)
    m.sheet(
        grid, _leg_share(m, h.leg + 0.1 * h.trunk, hem, u(0.75, 1.0), u(0.015, 0.07)), "skirt", u(0.004, 0.015),
        wrap=True,
    )  # fmt: skip


def _coat(m: Model, h: Human) -> None:
    u = m.u
    hem, top = h.leg * u(0.1, 0.8), h.top - 0.1 * h.trunk
    heights = np.linspace(top, hem, 14)
    radii = h.half_width(heights) * u(1.06, 1.2) + 0.006 + np.maximum(h.leg - heights, 0) * u(0.05, 0.35)
    radii = np.where(heights < h.leg, np.maximum(radii, h.hip + 1.15 * h.thigh), radii)
    grid = _round(m, h, heights, radii, int(m.rng.integers(12, 36)), gap=u(0.15, 1.2))
    legs, blur, torso = _leg_share(m, h.leg + 0.05 * h.trunk, hem, u(0.75, 1.0), u(0.015, 0.07)), m.style.soft, h.torso
    assert isinstance(torso, Chain)

    def share(points: np.ndarray) -> dict[str, np.ndarray]:
        high = 1 / (1 + np.exp(-np.clip((points[:, 1] - h.leg - 0.05 * h.trunk) / 0.01, -40, 40)))
        out = {name: value * high for name, value in torso.weights(points, blur).items()}
        for name, value in legs(points).items():
            out[name] = out.get(name, 0) + value * (1 - high)
        return out

    m.sheet(grid, share, "coat", u(0.004, 0.015))


def _cape(m: Model, h: Human) -> None:
    u = m.u
    top, hem = h.top - u(0.0, 0.12) * h.trunk, u(0.05, 0.9) * h.leg
    rows, columns = 9, int(m.rng.integers(5, 14))
    down, across = np.linspace(0, 1, rows)[:, None], np.linspace(-1, 1, columns)[None]
    wide = h.shoulder * u(0.7, 1.1) + down * h.shoulder * u(-0.1, 0.9)
    bulge = h.chest * h.deep * u(1.0, 1.4) + down * u(0.0, 0.25) * (top - hem)
    fold = u(0, 0.012) * np.cos(across * m.u(6, 14)) * down
    curl = u(0.0, 0.5) * h.chest * across**2
    z = m.at("Spine2")[2] - bulge + curl + fold
    grid = np.stack(
        [np.broadcast_to(wide * across, z.shape), np.broadcast_to(top + (hem - top) * down, z.shape), z], axis=-1
    )
    m.sheet(grid, "Spine2", "cape", u(0.004, 0.014))


def _thick(m: Model, h: Human, name: str, first: float, last: float, radii: tuple[float, float], kind: str) -> None:
    """A tube around a part of each limb: sleeves, trouser legs, boots, bracers."""
    ends = {
        "Arm": ("Arm", "ForeArm"),
        "ForeArm": ("ForeArm", "Hand"),
        "UpLeg": ("UpLeg", "Leg"),
        "Leg": ("Leg", "Foot"),
    }[name]
    if name == "Leg":  # feet stay in sight
        radii = (min(radii[0], 0.3 * h.leg), min(radii[1], 1.1 * h.heel + 0.2 * h.thigh))
    elif name == "ForeArm":  # and hands
        radii = (radii[0], min(radii[1], max(0.5 * h.hand, 1.05 * h.arm)))
        last = min(last, 1 - 0.8 * radii[1] / h.fore)
        first = min(first, last - 0.1)
    for side, _ in SIDES:
        a, b = m.at(side + ends[0]), m.at(side + ends[1])
        region = f"{'arm' if 'Arm' in name else 'leg'} {side}" if kind == "merged" else f"{name} wear {side}"
        m.limb([a + first * (b - a), a + last * (b - a)], list(radii), f"{side}{name}", region, loose=kind != "merged")


def build_clothes(m: Model, h: Human) -> None:
    """Clothes from shoes to scarves, each in a share of the people."""
    u, chance = m.u, m.chance
    kind = "merged" if chance(0.5) else "loose"
    dressed = m.rng.random() if not h.seated else 1.0
    if dressed < 0.10:
        _skirt(m, h, long=False)
    elif dressed < 0.22:
        _skirt(m, h, long=True)
    elif dressed < 0.32:
        _coat(m, h)
    elif dressed < 0.42:
        _thick(m, h, "UpLeg", 0.0, 0.9, (h.thigh * 1.15, h.thigh * u(1.0, 1.5)), kind)
        if chance(0.6):
            _thick(m, h, "Leg", 0.0, u(0.75, 0.95), (h.thigh * u(0.95, 1.2), h.thigh * u(0.9, 1.6)), kind)
    if chance(0.1):
        _cape(m, h)
    if chance(0.3):
        _thick(m, h, "Arm", 0.0, u(0.3, 1.0), (h.arm * u(1.2, 1.6), h.arm * u(1.1, 1.7)), kind)
    if chance(0.22):
        _thick(m, h, "ForeArm", u(0.0, 0.5), u(0.8, 0.95), (h.arm * u(0.95, 1.3), h.arm * u(1.1, 2.2)), kind)
    if chance(0.3):
        _thick(m, h, "Leg", u(0.1, 0.6), 0.97, (h.thigh * u(0.8, 1.1), h.thigh * u(0.7, 1.1)), kind)
    if chance(0.16):
        size = h.arm * u(1.6, 2.8)
        for side, s in SIDES:
            at = m.at(f"{side}Arm") + [s * 0.2 * size, 0.35 * size, 0]
            m.lump(
                at, (size, size * u(0.5, 0.9), size), m.pick(f"{side}Arm", f"{side}Shoulder"), f"pad {side}", loose=True
            )
    if chance(0.15):
        half = np.array([h.chest * u(0.5, 1.0), h.trunk * u(0.22, 0.42), h.chest * u(0.25, 0.6)])
        at = np.array([0, h.leg + h.trunk * u(0.5, 0.75), m.at("Spine2")[2] - h.chest * h.deep - 0.8 * half[2]])
        (m.block if chance(0.6) else m.lump)(at, half, "Spine2", "backpack")
    if chance(0.22):
        y = h.leg + h.trunk * u(0.08, 0.3)
        wide = float(h.half_width(y)) * 1.06
        band = h.trunk * u(0.02, 0.06)
        m.mesh(ring_mesh((0, y, 0), (wide, wide * h.deep * 1.1), (0.25 * band + 0.006, band), 24, 6), h.torso, "belt")
    if chance(0.12):
        size = h.head * u(0.3, 0.45)
        at = m.at("Neck") + [0, 0.2 * h.neck, 0]
        m.mesh(
            ring_mesh(tuple(at), (size, size * 0.95), (h.head * u(0.08, 0.2), h.head * u(0.06, 0.16)), 20, 8),
            "Neck" if chance(0.5) else "Spine2",
            "scarf",
        )
    if chance(0.15):
        for i in range(int(m.rng.integers(2, 5))):  # buttons
            y = h.leg + h.trunk * (0.3 + 0.15 * i)
            m.lump(
                (0, y, 0.5 * m.at("Spine2")[2] + float(h.half_width(y)) * h.deep),
                h.trunk * np.array([0.03, 0.03, 0.015]), h.torso, f"button {i}", loose=True,
            )  # fmt: skip
    if chance(0.12):
        for side, s in SIDES[: m.pick(1, 2)]:  # pouches
            half = h.trunk * np.array([u(0.06, 0.12), u(0.08, 0.16), u(0.06, 0.1)])
            m.block(
                (s * (h.pelvis + 0.6 * half[0]), h.leg + u(-0.05, 0.1) * h.trunk, 0), half,
                "Hips" if chance(0.5) else f"{side}UpLeg", "pouch", exponent=5.0,
            )  # fmt: skip
    if chance(0.12):
        m.block(
            (0, h.leg + 0.68 * h.trunk, m.at("Spine2")[2] + 0.15 * h.chest),
            (h.chest * 1.12, 0.22 * h.trunk, h.chest * h.deep), h.torso, "armour",
        )  # fmt: skip
    if chance(0.05):
        length, droop = u(0.3, 0.7) * h.leg, u(-0.6, 0.4)
        points = [
            np.array([0, h.leg + 0.05 * h.trunk, -0.8 * h.pelvis * h.deep])
            + length * s * unit(np.array([0, droop + 0.6 * s * s, -1.0]))
            for s in (0, 0.33, 0.67, 1.0)
        ]
        for i in range(3):
            m.bone(f"Tail{i + 1}", f"Tail{i}" if i else "Hips", points[i])
        radius = h.thigh * u(0.25, 0.6)
        m.limb(points, [radius, radius, radius * 0.9, radius * 0.5], ["Tail1", "Tail2", "Tail3"], "tail")
    if chance(0.03):
        _back_wings(m, h)


def _back_wings(m: Model, h: Human) -> None:
    u = m.u
    span, high, sweep = u(0.25, 0.6), u(0.15, 0.5), u(0.05, 0.3)
    for side, s in SIDES:
        root = m.at("Spine2") + [s * 0.25 * h.chest, 0.3 * h.trunk, -h.chest * h.deep]
        m.bone(f"{side}Wing", "Spine2", root)
        t = np.linspace(0, 1, 7)[:, None]
        lead = root + t * np.array([s * span, high, -sweep])
        trail = root + [0, -0.12, -0.02] + t * np.array([s * span * 0.8, high * u(-0.8, 0.4), -sweep * 0.8])
        grid = np.stack([lead + v * (trail - lead) for v in np.linspace(0, 1, 5)], axis=1)
        m.sheet(grid, f"{side}Wing", f"wing {side}", 0.008)


def _sword(m: Model, at: np.ndarray, direction: np.ndarray, length: float, thick: float, share: str) -> None:
    turn = np.stack(
        [
            unit(np.cross(direction, [0.3, 0.2, 0.9])),
            direction,
            np.cross(unit(np.cross(direction, [0.3, 0.2, 0.9])), direction),
        ],
        axis=1,
    )
    m.block(at + direction * length * 0.42, (thick, length * 0.5, thick * m.u(0.15, 0.6)), share, f"item {share}", turn)
    m.block(
        at + direction * length * 0.02, (thick * m.u(1.5, 3.5), thick * 0.5, thick * 0.8), share, f"item {share}", turn
    )


def build_items(m: Model, h: Human) -> None:
    """Swords, staffs, shields, guns and tools in the hands or on the back; a hand's own share moves them."""
    u = m.u
    for side, s in SIDES:
        if not m.chance(0.13):
            continue
        _, elbow, wrist = arm_chain(m, side)
        along = unit(wrist - elbow)
        grip, share = wrist + along * 0.5 * h.hand, f"{side}Hand"
        ahead = unit(np.array([0, u(-0.3, 1.0), 1.0]))
        direction = unit(ahead - along * (ahead @ along))
        length, thick = u(0.2, 0.75), u(0.008, 0.035)
        what = m.pick("sword", "staff", "shield", "gun", "hammer", weights=(0.35, 0.2, 0.15, 0.2, 0.1))
        if what == "sword":
            _sword(m, grip, direction, length, thick, share)
        elif what == "staff":
            m.limb(
                [grip - direction * length * 0.6, grip + direction * length], [thick * 0.6, thick * 0.6], share,
                f"item {side}", loose=True,
            )  # fmt: skip
            m.lump(grip + direction * length, np.full(3, thick * u(1.2, 3.0)), share, f"item {side}", loose=True)
        elif what == "shield":
            wide = u(0.1, 0.24)
            out = unit(np.array([s, 0, 0.4]))
            turn = np.stack([np.cross([0, 1.0, 0], out), [0, 1.0, 0], out], axis=1)
            m.block(
                grip + out * 0.03, (wide, wide * u(0.9, 1.5), u(0.008, 0.03)), share, f"item {side}", turn,
                exponent=m.pick(2.0, 4.0, 10.0),
            )  # fmt: skip
        elif what == "gun":
            m.block(
                grip + direction * 0.3 * length, (thick, 0.5 * length, thick * 1.4), share, f"item {side}",
                np.stack(
                    [
                        unit(np.cross(direction, along)), direction,
                        np.cross(unit(np.cross(direction, along)), direction),
                    ],
                    1,
                ),
            )  # fmt: skip
            m.limb(
                [grip, grip - along * 0.1 * length - np.array([0, 0.1 * length, 0])], [thick, thick], share,
                f"item {side}", loose=True,
            )  # fmt: skip
        else:
            m.limb(
                [grip - direction * length * 0.3, grip + direction * length * 0.7], [thick * 0.6, thick * 0.6], share,
                f"item {side}", loose=True,
            )  # fmt: skip
            m.block(grip + direction * length * 0.7, np.array([1, 1, 1.8]) * thick * u(1.5, 3), share, f"item {side}")
    if m.chance(0.06):
        at = np.array([0, h.leg + 0.5 * h.trunk, m.at("Spine2")[2] - h.chest * h.deep - 0.03])
        _sword(m, at - [0.12, 0.15, 0], unit(np.array([u(0.3, 1), 1.0, 0])), u(0.3, 0.6), u(0.01, 0.03), "Spine2")


def humanoid(m: Model) -> None:
    """A person, a robot or an animal that stands as a person does."""
    kind = m.pick("realistic", "stylised", "chibi", "robot", "brute", weights=(0.29, 0.26, 0.25, 0.13, 0.07))
    if kind == "robot":
        if m.chance(0.75):
            m.restyle(mode="pieces", exponent=m.pick(2.0, 4.0, 8.0, 20.0), cap=m.u(0.25, 0.9), faces=None)
        if m.chance(0.6):
            m.restyle(soft=0.0)
    elif kind == "realistic" and m.chance(0.6):
        m.restyle(mode=m.pick("clay", "regions"), exponent=2.0)
    h = draw_human(m, kind)
    build_body(m, h)
    build_head(m, h)
    build_clothes(m, h)
    build_items(m, h)
