"""Beasts on four legs: dogs to elephants, crocodiles, frogs, and dragons with wings."""

from __future__ import annotations

import numpy as np

from bunraku_lab.synthetic.families.human_head import ears_and_horns, eyes
from bunraku_lab.synthetic.families.model import SIDES, Chain, Model
from bunraku_lab.synthetic.surfaces import unit

# modelled by eye; ranges of: leg height, trunk radius, neck length, neck lift, head, snout, tail length, tail radius
# (all over the
# trunk's length)
_KINDS: dict[str, tuple[tuple[float, float], ...]] = {
    "dog": ((0.5, 0.85), (0.16, 0.27), (0.1, 0.35), (0.5, 1.2), (0.15, 0.3), (0.6, 1.5), (0.2, 0.7), (0.03, 0.1)),
    "cat": ((0.35, 0.6), (0.15, 0.25), (0.05, 0.25), (0.4, 1.1), (0.16, 0.32), (0.15, 0.6), (0.5, 1.0), (0.03, 0.06)),
    "horse": ((0.7, 1.1), (0.18, 0.25), (0.35, 0.65), (0.7, 1.2), (0.13, 0.18), (1.4, 2.2), (0.4, 0.8), (0.04, 0.09)),
    "cow": ((0.4, 0.65), (0.23, 0.34), (0.15, 0.3), (0.1, 0.6), (0.14, 0.2), (0.9, 1.5), (0.3, 0.7), (0.02, 0.04)),
    "pig": ((0.22, 0.45), (0.27, 0.42), (0.0, 0.12), (0.0, 0.4), (0.18, 0.28), (0.5, 1.2), (0.05, 0.2), (0.02, 0.04)),
    "elephant": ((0.45, 0.7), (0.3, 0.42), (0.08, 0.2), (0.2, 0.6), (0.24, 0.32), (0.3, 0.5), (0.2, 0.5), (0.02, 0.04)),
    "giraffe": ((0.9, 1.5), (0.2, 0.28), (0.7, 1.6), (1.0, 1.4), (0.13, 0.18), (1.0, 1.8), (0.3, 0.6), (0.02, 0.03)),
    "crocodile": ((0.15, 0.3), (0.12, 0.2), (0.08, 0.2), (-0.1, 0.2), (0.11, 0.16), (1.5, 3.2), (0.7, 1.3), (0.09,
    0.16)),
    "rat": ((0.15, 0.35), (0.22, 0.38), (0.0, 0.12), (0.0, 0.5), (0.16, 0.28), (0.7, 1.5), (0.6, 1.3), (0.02, 0.05)),
    "toy": ((0.2, 0.6), (0.25, 0.45), (0.0, 0.3), (0.3, 1.3), (0.25, 0.5), (0.1, 0.8), (0.05, 0.5), (0.03, 0.12)),
}  # fmt: skip


def tail(m: Model, root: np.ndarray, length: float, radius: float, lift: float, curl: float, count: int) -> None:
    """A tail backwards from a place, with a bone for each of its pieces."""
    points = [np.asarray(root, float)]
    angle = lift
    for _ in range(count):
        points.append(points[-1] + length / count * np.array([0, np.sin(angle), -np.cos(angle)]))
        angle += curl / count
    names = [f"Tail{i + 1}" for i in range(count)]
    m.bones_along(names, points, "Hips")
    ends = radius * (
        np.linspace(1, m.u(0.1, 1.0), count + 1) if radius < 0.07 else np.linspace(1, m.u(0.05, 0.35), count + 1)
    )
    m.limb(points, list(np.maximum(ends, 0.006)), Chain(names, points[:-1]), "tail", blend=0.5)
    if m.chance(0.15):
        m.lump(points[-1], ends[-1] * m.u(1.5, 3) + 0.02, names[-1], "tail")


def beast_head(m: Model, at: np.ndarray, size: float, snout: float, dip: float, region: str = "head") -> np.ndarray:
    """A head with a snout of a length over its size; returns its centre."""
    u = m.u
    direction = unit(np.array([0, -dip, 1.0]))
    centre = at + direction * size * 0.5
    radii = size * np.array([u(0.75, 1.1), u(0.75, 1.0), u(0.8, 1.1)])
    m.lump(centre, radii, "Head", region, blend=0.8)
    if snout > 0.05:
        start = centre + direction * size * 0.4 - [0, 0.2 * size, 0]
        m.limb(
            [start, start + direction * (0.4 + snout) * size], [size * u(0.5, 0.75), size * u(0.22, 0.55)], "Head",
            region, stretch=(u(0.8, 1.3), 1, 1), blend=0.7,
        )  # fmt: skip
        if m.chance(0.3):
            m.limb(
                [
                    start - [0, 0.3 * size, 0],
                    start - [0, 0.35 * size, 0] + unit(direction - [0, 0.25, 0]) * (0.2 + snout) * size,
                ],
                [size * 0.3, size * 0.2], "Head", region, loose=m.chance(0.5),
            )  # fmt: skip
        if m.chance(0.4):
            m.lump(start + direction * (0.4 + snout) * size * 1.08, size * u(0.1, 0.25), "Head", "nose", loose=True)
    eyes(m, centre, radii, "Head")
    return np.asarray(centre)


def _animal_ears(m: Model, centre: np.ndarray, size: float) -> None:
    """Ears that stand out have their own bones, horns go with the head."""
    kind = m.pick("up", "side", "round", "none", weights=(0.5, 0.2, 0.15, 0.15))
    tall = m.u(0.5, 1.5) * size
    for side, s in SIDES:
        root = centre + size * np.array([s * 0.55, 0.6, -0.15])
        if kind in ("up", "side"):
            name = "Head"
            if tall > 0.85 * size:
                name = f"{side}Ear"
                m.bone(name, "Head", root)
            direction = unit(np.array([s * 0.3, 1, 0.05]) if kind == "up" else np.array([s, -0.3, 0]))
            m.limb(
                [root, root + 0.55 * tall * direction, root + tall * direction],
                [0.22 * size, 0.26 * size, 0.04 * size], name, f"ear {side}", stretch=(1, 1, 0.45),
                loose=m.style.mode == "pieces",
            )  # fmt: skip
        elif kind == "round":
            m.lump(root, size * np.array([0.35, 0.35, 0.15]), "Head", f"ear {side}")
    if m.chance(0.22):
        ears_and_horns(m, centre, np.full(3, size), "Head", ("horn",))


def wings(m: Model, root: np.ndarray, span: float, parent: str, kind: str | None = None) -> None:
    """Two wings, spread or raised or folded, with a bone or two each."""
    u = m.u
    kind = kind or m.pick("spread", "raised", "folded", weights=(0.5, 0.3, 0.2))
    lift = {"spread": u(-0.15, 0.3), "raised": u(0.5, 1.2), "folded": u(-0.5, 0.2)}[kind]
    chord, sweep = span * u(0.25, 0.6), span * (u(0.6, 1.2) if kind == "folded" else u(0.0, 0.35))
    out = span * (0.25 if kind == "folded" else 1.0)
    teeth, curve = u(0, 0.35) * float(m.chance(0.5)), u(0.4, 1.3)
    number = int(m.rng.integers(2, 6))
    for side, s in SIDES:
        base = root * [1, 1, 1] + [s * abs(root[0]) - root[0], 0, 0] if root[0] else root + [s * 0.04 * span, 0, 0]
        tip = base + np.array([s * out * np.cos(lift), out * np.sin(lift), -sweep])
        t = np.linspace(0, 1, 13)[:, None]
        lead = base + t * (tip - base) + np.sin(np.pi * t) * np.array([0, 0.12 * span, 0.1 * span])
        deep = chord * ((1 - t**curve) * 0.9 + 0.1) * (1 - teeth * np.abs(np.sin(np.pi * number * t)))
        back = np.array([0, -0.25 - 0.5 * (kind == "folded"), -1.0])
        trail = lead + deep * unit(back)
        grid = np.stack([lead + v * (trail - lead) for v in np.linspace(0, 1, 5)], axis=1)
        first = f"{side}Wing"
        m.bone(first, parent, base)
        second = f"{side}Wing2"
        m.bone(second, first, base + 0.5 * (tip - base))
        m.sheet(grid, Chain([first, second], [base, base + 0.5 * (tip - base)]), f"wing {side}", u(0.005, 0.02))
        if m.chance(0.5):
            m.limb(
                [lead[0], lead[6], lead[12]], [0.05 * span, 0.04 * span, 0.015 * span], [first, second], f"wing {side}"
            )


def _four_legs(
    m: Model, kind: str, length: float, leg: float, radius: float, z_hip: float, z_arm: float, y: float
) -> None:
    u = m.u
    column = kind in ("elephant", "pig", "toy", "crocodile") or m.chance(0.35)
    thick = radius * u(0.22, 0.42) * (1.6 if kind in ("elephant", "toy") else 1.0)
    wide = radius * u(0.5, 0.85)
    splay = u(0.3, 1.0) * leg if kind == "crocodile" else u(0.0, 0.12) * leg
    paw = thick * u(0.75, 1.3)
    elbow_at, knee_at, hock_at = u(0.42, 0.62), u(0.55, 0.7), u(0.28, 0.4)
    thigh, bend, walk = u(1.2, 2.0), u(0.05, 0.22), u(-0.15, 0.15) * leg * float(m.chance(0.3))
    heel = max(paw * 0.6, 0.06 * leg)
    for side, s in SIDES:
        top = np.array([s * wide, y - 0.25 * radius, z_arm])
        m.bone(f"{side}Shoulder", "Spine2", (s * 0.6 * wide, y + 0.1 * radius, z_arm))
        m.bone(f"{side}Arm", f"{side}Shoulder", top)
        m.lump((s * 0.85 * wide, y, z_arm), radius * np.array([0.35, 0.6, 0.42]), f"{side}Shoulder", "trunk", blend=1.0)
        elbow = m.bone(
            f"{side}ForeArm",
            f"{side}Arm",
            [top[0] + s * splay, heel + elbow_at * (top[1] - heel), z_arm - bend * 0.4 * leg + s * walk * 0.5],
        )
        wrist = m.bone(f"{side}Hand", f"{side}ForeArm", [top[0] + s * splay, heel, z_arm + s * walk])
        m.limb([top, elbow], [thick * thigh * 0.9, thick], f"{side}Arm", f"front {side}", blend=0.6)
        m.limb([elbow, wrist], [thick, thick * 0.8], f"{side}ForeArm", f"front {side}")
        m.lump(wrist + [0, 0, 0.35 * paw], (paw, heel * 0.98, paw * 1.35), f"{side}Hand", f"front {side}")
        hip = m.bone(f"{side}UpLeg", "Hips", (s * wide, y - 0.1 * radius, z_hip))
        x = hip[0] + s * splay
        if column:
            knee = m.bone(
                f"{side}Leg",
                f"{side}UpLeg",
                (x, heel + 0.5 * (hip[1] - heel), z_hip + bend * 0.5 * leg - s * walk * 0.5),
            )
            ankle = m.bone(f"{side}Foot", f"{side}Leg", (x, heel, z_hip - bend * 0.3 * leg - s * walk))
            m.limb([hip, knee], [thick * thigh * 1.1, thick * 1.05], f"{side}UpLeg", f"hind {side}", blend=0.6)
            m.limb([knee, ankle], [thick * 1.05, thick * 0.85], f"{side}Leg", f"hind {side}")
            m.lump(ankle + [0, 0, 0.35 * paw], (paw, heel * 0.98, paw * 1.35), f"{side}Foot", f"hind {side}")
        else:
            knee = m.bone(f"{side}Leg", f"{side}UpLeg", (x, heel + knee_at * (hip[1] - heel), z_hip + bend * leg * 0.9))
            hock = m.bone(
                f"{side}Foot", f"{side}Leg", (x, heel + hock_at * (hip[1] - heel), z_hip - bend * leg - s * walk)
            )
            toe = m.bone(f"{side}ToeBase", f"{side}Foot", (x, heel, z_hip - bend * 0.5 * leg - s * walk))
            m.limb([hip, knee], [thick * thigh * 1.2, thick * 1.25], f"{side}UpLeg", f"hind {side}", blend=0.6)
            m.limb([knee, hock], [thick * 1.2, thick * 0.75], f"{side}Leg", f"hind {side}")
            m.limb([hock, toe], [thick * 0.75, thick * 0.7], f"{side}Foot", f"hind {side}")
            m.lump(toe + [0, 0, 0.35 * paw], (paw, heel * 0.98, paw * 1.35), f"{side}ToeBase", f"hind {side}")


def quadruped(m: Model, kind: str | None = None, neck_scale: float = 1.0) -> None:
    """An animal on four legs."""
    u = m.u
    kind = kind or m.pick(*_KINDS)
    leg, radius, neck, lift, head, snout, tail_long, tail_fat = (u(*limits) for limits in _KINDS[kind])
    neck *= neck_scale
    y, back, front = leg + 0.55 * radius, -0.5, 0.5
    positions = [np.array([0, y + 0.35 * radius, back + 0.1])]
    rise = u(-0.15, 0.15) * radius
    positions += [
        np.array([0, y + 0.3 * radius + rise * s, back + 0.1 + 0.9 * s])
        for s in (u(0.22, 0.32), u(0.48, 0.58), u(0.76, 0.88))
    ]
    names = ["Hips", "Spine", "Spine1", "Spine2"]
    m.bones_along(names, positions)
    trunk = Chain(names, positions)
    rump, belly, chest = radius * u(0.75, 1.1), radius * u(0.75, 1.15), radius * u(0.85, 1.2)
    flat = (u(0.75, 1.05), 1.0, 1.0)
    m.limb(
        [(0, y, back + 0.7 * rump), (0, y - 0.1 * radius, 0), (0, y + rise, front - 0.7 * chest)], [rump, belly, chest],
        trunk, "trunk", stretch=flat, blend=1.5,
    )  # fmt: skip
    _four_legs(m, kind, 1.0, leg, radius, back + 0.75 * rump, front - 0.75 * chest, y)
    base = np.array([0, y + rise + 0.25 * chest, front - 0.35 * chest])
    direction = np.array([0, np.sin(lift), np.cos(lift)])
    reach = neck + 0.35 * chest
    m.bone("Neck", "Spine2", base)
    top = m.bone("Head", "Neck", base + direction * (reach + (0.2 if neck > 0.2 else 0.5) * head))
    thick = min(u(0.7, 1.1) * head, chest) if kind != "giraffe" else head * u(0.6, 0.9)
    m.limb(
        [base - direction * 0.2 * chest, base + direction * reach * 0.5, top],
        [chest * u(0.6, 0.85), min((thick + 0.5 * chest) / 2, 1.15 * thick), thick * 0.85], "Neck", "neck", blend=0.9,
    )  # fmt: skip
    centre = beast_head(m, top, head, snout, u(0.0, 0.9) if lift > 0.5 else u(-0.1, 0.4))
    if kind == "elephant":
        points = [
            centre + [0, -0.3 * head, 0.8 * head],
            centre + [0, -1.2 * head, 1.4 * head],
            centre + [0, -u(2.0, 2.6) * head, u(1.2, 2.0) * head],
        ]
        m.limb(points, [0.4 * head, 0.3 * head, 0.18 * head], "Head", "nose")
        for side, s in SIDES:
            m.bone(f"{side}Ear", "Head", centre + [s * 0.8 * head, 0, -0.2 * head])
            m.lump(
                centre + [s * 1.3 * head, 0, -0.3 * head], head * np.array([0.7, u(0.7, 1.2), 0.12]), f"{side}Ear",
                f"ear {side}",
            )  # fmt: skip
    elif kind != "crocodile":
        _animal_ears(m, centre, head)
    if m.chance(0.9):
        lift, curl = u(-0.9, 0.9), u(-0.6, 1.2)
        if kind == "crocodile":
            lift, curl = u(-0.15, 0.15), u(0.0, 1.0)
        elif leg < 0.4:
            lift, curl = u(-0.2, 0.9), u(0.0, 1.0)
        elif kind in ("horse", "cow"):
            lift = u(-1.2, -0.1)
        count = 2 if tail_long < 0.25 else int(m.rng.integers(3, 6))
        tail(
            m, np.array([0, y + 0.4 * rump, back + 0.15 * rump]), tail_long, min(tail_fat, rump * 0.8), lift, curl,
            count,
        )  # fmt: skip
    if kind not in ("horse", "giraffe") and m.chance(0.1):  # a shell, or a fleece
        if m.chance(0.5):
            m.lump(
                (0, y + 0.35 * radius, 0), (radius * u(1.0, 1.4), radius * u(0.8, 1.2), 0.55), trunk, "shell",
                loose=True,
            )  # fmt: skip
        else:
            for _ in range(14):
                direction = unit(m.rng.normal(size=3) * [1, 1, 1.6] + [0, 0.5, 0])
                m.lump(np.array([0, y, 0]) + direction * [radius, radius, 0.45], radius * u(0.4, 0.6), trunk, "trunk")
    if m.chance(0.12):
        for z in np.linspace(back + 0.1, front, int(m.rng.integers(4, 9))):
            m.limb(
                [(0, y + 0.7 * radius, z), (0, y + radius * u(1.2, 1.8), z - 0.05)], [0.25 * radius, 0.02], trunk,
                "spikes", stretch=(0.4, 1, 1), loose=True,
            )  # fmt: skip
    if kind in ("horse", "toy") and m.chance(0.4):
        m.limb(
            [base + [0, 0.3 * chest, 0], top + [0, 0.6 * head, -0.3 * head]], [0.25 * head + 0.02, 0.3 * head], "Neck",
            "mane", stretch=(0.35, 1, 1.3), loose=True,
        )  # fmt: skip


def dragon(m: Model) -> None:
    """A dragon: four legs, wings, a long neck and tail."""
    quadruped(m, m.pick("dog", "cat", "horse", "crocodile", "toy"), m.u(1.0, 2.5))
    root = m.at("Spine2") + [0.12, 0.1, 0]
    wings(m, root, m.u(0.6, 1.6), "Spine2")


def frog(m: Model) -> None:
    """A frog or toad: wide head, folded hind legs, short front legs."""
    u = m.u
    wide, high, lift = u(0.28, 0.45), u(0.16, 0.3), u(0.02, 0.25)
    y = lift + high
    positions = [np.array([0, y - 0.1, -0.4]), np.array([0, y, -0.12]), np.array([0, y + 0.06, 0.15])]
    names = ["Hips", "Spine", "Neck"]
    m.bones_along(names, positions)
    m.limb(
        [(0, y - 0.08, -0.3), (0, y, 0.1)], [wide * 0.75, wide], Chain(names, positions), "trunk",
        stretch=(1, high / wide, 1), blend=1.5,
    )  # fmt: skip
    head = m.bone("Head", "Neck", (0, y + 0.06, 0.3))
    radii = np.array([wide * u(0.85, 1.15), high * u(0.6, 0.9), u(0.2, 0.35)])
    m.lump(head + [0, 0.04, 0.12], radii, "Head", "head", blend=1.0)
    for _, s in SIDES:
        m.lump(
            head + [s * 0.6 * radii[0], radii[1] * 0.95, 0.1], radii[1] * u(0.3, 0.5), "Head", f"eye {s}",
            loose=m.chance(0.5),
        )  # fmt: skip
    r = high * u(0.18, 0.32)
    for side, s in SIDES:
        m.bone(f"{side}Shoulder", "Spine", (s * 0.6 * wide, y - 0.05, 0.15))
        a = m.bone(f"{side}Arm", f"{side}Shoulder", (s * 0.85 * wide, y - 0.08, 0.18))
        b = m.bone(f"{side}ForeArm", f"{side}Arm", (s * (wide + u(0.05, 0.2)), 0.45 * y, u(0.0, 0.15)))
        c = m.bone(f"{side}Hand", f"{side}ForeArm", (s * (wide + 0.12), r * 0.8, u(0.2, 0.35)))
        m.limb([a, b, c], [r * 1.3, r, r * 0.8], [f"{side}Arm", f"{side}ForeArm"], f"front {side}")
        for turn in (-0.6, 0.0, 0.6):
            m.limb(
                [c, c + 0.13 * np.array([np.sin(turn + 0.3 * s), -0.02, np.cos(turn)])], [r * 0.6, r * 0.45],
                f"{side}Hand", f"front {side}",
            )  # fmt: skip
        hip = m.bone(f"{side}UpLeg", "Hips", (s * 0.5 * wide, y - 0.08, -0.38))
        knee = m.bone(f"{side}Leg", f"{side}UpLeg", (s * (wide + u(0.1, 0.3)), y * u(0.6, 1.0), u(-0.1, 0.1)))
        hock = m.bone(f"{side}Foot", f"{side}Leg", (s * (wide + u(0.0, 0.2)), r * 1.1, -0.45))
        toe = m.bone(f"{side}ToeBase", f"{side}Foot", (s * (wide + u(0.15, 0.35)), r * 0.6, u(-0.2, 0.0)))
        m.limb(
            [hip, knee, hock, toe], [r * 1.9, r * 1.3, r, r * 0.7], [f"{side}UpLeg", f"{side}Leg", f"{side}Foot"],
            f"hind {side}", blend=0.6,
        )  # fmt: skip
        for turn in (-0.5, 0.1, 0.7):
            m.limb(
                [toe, toe + 0.18 * np.array([np.sin(turn * s + 0.3 * s), -0.01, np.cos(turn)])], [r * 0.5, r * 0.4],
                f"{side}ToeBase", f"hind {side}",
            )  # fmt: skip
