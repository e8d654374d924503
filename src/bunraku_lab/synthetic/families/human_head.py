"""Heads: skulls, faces, hair, hats, helmets, ears and horns. The head bone moves all of it."""

from __future__ import annotations

import numpy as np

from bunraku_lab.synthetic.families.human_body import Human
from bunraku_lab.synthetic.families.model import SIDES, Model
from bunraku_lab.synthetic.surfaces import cylinder_mesh, ring_mesh, unit

EARS = ("cat", "long", "round", "horn", "antenna")


def build_head(m: Model, h: Human) -> None:
    """The head of a person on the bone Head."""
    u = m.u
    half = h.head / 2
    centre = m.at("Head") * [1, 0, 1] + [0, 1 - half, 0.1 * half]
    if h.kind == "brute":
        centre = centre + [0, 0, 0.8 * (m.at("Head")[2] - m.at("Neck")[2])]
    if h.kind == "realistic":
        size = half * np.array([u(0.62, 0.72), 1.0, u(0.76, 0.88)])
    else:
        size = half * np.array([u(0.72, 1.25), 1.0, u(0.7, 1.1)])
    shape = m.pick(
        "egg", "ball", "box", "beast", weights=(0.45, 0.3, 0.06, 0.19) if h.kind != "robot" else (0.1, 0.25, 0.55, 0.1)
    )
    if h.kind == "realistic":
        shape = "egg"
    if shape == "egg":
        m.lump(centre + [0, 0.15 * half, -0.08 * half], size * [1, 0.85, 1], "Head", "head")
        m.lump(
            centre + [0, -0.4 * half, 0.12 * half], size * [u(0.6, 0.85), 0.6, u(0.7, 0.9)], "Head", "head", blend=1.2
        )
    elif shape == "box":
        m.block(centre, size * 0.95, "Head", "head", exponent=m.pick(4.0, 8.0, 20.0))
    else:
        m.lump(centre, size, "Head", "head")
    if shape == "beast":
        long = half * u(0.3, 0.9)
        m.limb(
            [centre + [0, -0.25 * half, 0.4 * size[2]], centre + [0, -u(0.25, 0.45) * half, size[2] * 0.8 + long]],
            [half * u(0.4, 0.6), half * u(0.18, 0.4)], "Head", "head", blend=0.8,
        )  # fmt: skip
    elif m.chance(0.6):
        m.limb(
            [centre + [0, 0, 0.85 * size[2]], centre + [0, -0.2 * half, size[2] * u(0.95, 1.25)]],
            [0.07 * half, 0.13 * half], "Head", "head",
        )  # fmt: skip
    eyes(m, centre, size, "Head")
    if shape != "beast" and m.chance(0.5):
        for _, s in SIDES:
            m.lump(centre + [s * size[0] * 0.98, 0, 0], half * np.array([0.1, 0.22, 0.14]), "Head", "head")
    if shape == "beast" or m.chance(0.55 if h.kind == "chibi" else 0.3):
        ears_and_horns(
            m, centre, size, "Head",
            ("cat", "long", "long", "long", "round", "horn", "antenna") if h.kind == "chibi" else EARS,
        )  # fmt: skip
    worn = str(m.pick(
        "hair", "hat", "helmet", "hood", "bald",
        weights=(0.5, 0.16, 0.1, 0.07, 0.17) if shape != "beast" else (0.1, 0.15, 0.1, 0.05, 0.6),
    ))  # fmt: skip
    if worn == "hair":
        _hair(m, h, centre, size)
    elif worn == "hat":
        _hat(m, centre, size)
    elif worn == "helmet":
        wide = u(1.1, 1.4)
        m.lump(centre + [0, 0.05 * half, -0.04 * half], size * wide, "Head", "helmet", loose=True)
        if m.chance(0.4):
            m.block(centre + [0, 0.05 * half, size[2] * wide * 0.85], size * [0.8, 0.3, 0.3], "Head", "visor")
        if m.chance(0.4):
            m.block(centre + [0, size[1] * wide, -0.1 * half], size * [0.08, 0.35, 0.8], "Head", "crest")
    elif worn == "hood":
        m.lump(centre + [0, 0.05 * half, -0.15 * size[2]], size * [1.18, 1.12, 1.15], "Head", "hood", loose=True)
        m.limb(
            [centre + [0, 0.5 * half, -0.7 * size[2]], centre + [0, u(0.2, 0.9) * half, -u(1.2, 1.7) * size[2]]],
            [0.5 * half, 0.12 * half], "Head", "hood", loose=True,
        )  # fmt: skip
        if m.chance(0.5):
            wide = h.shoulder * 0.9
            m.mesh(
                ring_mesh(
                    (0, h.top, m.at("Spine2")[2]), (wide * 0.6, wide * 0.55), (wide * 0.35, h.trunk * 0.12), 24, 8
                ),
                "Spine2",
                "collar",
            )
    if m.chance(0.14) and h.kind != "robot":
        long = half * u(0.3, 1.4)
        m.limb(
            [centre + [0, -0.55 * half, 0.7 * size[2]], centre + [0, -0.7 * half - long, u(0.6, 1.0) * size[2]]],
            [half * u(0.3, 0.45), half * u(0.05, 0.35)], "Head", "beard", loose=True, stretch=(1.25, 1, 0.6),
        )  # fmt: skip
    if m.chance(0.08):
        for _, s in SIDES:
            m.mesh(
                ring_mesh(
                    centre + [s * 0.38 * size[0], 0.05 * half, size[2] * 1.02], 0.26 * half, 0.035 * half, 14, 5,
                    np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
                ),
                "Head", "glasses",
            )  # fmt: skip


def eyes(m: Model, centre: np.ndarray, size: np.ndarray, share: str) -> None:
    """Eyes as loose parts, or none: painted on."""
    if not m.chance(0.55):
        return
    high, wide, radius = m.u(-0.1, 0.3), m.u(0.3, 0.55), m.u(0.08, 0.28) * float(size.min())
    position = np.array([wide, high, np.sqrt(max(1 - wide**2 - high**2, 0.2)) * 0.95])
    count = 1 if m.chance(0.05) else 2
    for _, s in SIDES[:count]:
        at = centre + position * size * [s if count == 2 else 0, 1, 1]
        m.lump(at, radius * np.array([1, m.u(1, 1.4) if s > 0 else 1.1, 0.6]), share, f"eye {s}", loose=True)


def ears_and_horns(m: Model, centre: np.ndarray, size: np.ndarray, share: str, kinds: tuple[str, ...] = EARS) -> None:
    """Two of a kind on top of a head."""
    kind = m.pick(*kinds)
    tall, tilt, out, fat, flat, tip = (
        m.u(0.35, 0.9), m.u(-0.3, 0.3), m.u(0.35, 0.75), m.u(0.6, 1.7), m.u(0.4, 1.0), m.u(0.1, 0.25),
    )  # fmt: skip
    loose = m.chance(0.5)
    for _, s in SIDES:
        root = centre + size * [s * out, 0.7, -0.05]
        direction = unit(np.array([s * m.u(0.2, 0.7) if s > 0 else -out, 1.0, tilt]))
        if kind == "cat":
            m.limb(
                [root, root + direction * size[1] * tall], [0.36 * size[0], 0.05 * size[0]], share, f"ear {s}",
                stretch=(1, 1, 0.4), loose=m.chance(0.5),
            )  # fmt: skip
        elif kind == "long":
            m.limb(
                [root, root + direction * size[1] * tall, root + direction * size[1] * 2.2 * tall],
                np.array([0.16, 0.26, tip])
                * fat
                * size[0],  # up to the girth of an arm, which it must not be taken for
                share,
                f"ear {s}" if loose else "head",
                stretch=(1, 1, flat),
                loose=loose,
            )
        elif kind == "round":
            m.lump(root, size[0] * np.array([0.38, 0.38, 0.18]), share, f"ear {s}", loose=m.chance(0.5))
        elif kind == "horn":
            mid = root + unit(np.array([s, 0.4, 0.1])) * size[0] * 0.4
            m.limb(
                [root, mid, mid + unit(np.array([s * 0.2, 1, 0.2])) * size[1] * tall],
                [0.2 * size[0], 0.16 * size[0], 0.03 * size[0]], share, f"horn {s}", loose=True,
            )  # fmt: skip
        else:
            m.limb(
                [root, root + direction * size[1] * tall * 1.2], [0.04 * size[0], 0.03 * size[0]], share, f"ear {s}",
                loose=True,
            )  # fmt: skip
            m.lump(root + direction * size[1] * tall * 1.2, np.full(3, 0.1 * size[0]), share, f"ear {s}", loose=True)


def _hair(m: Model, h: Human, centre: np.ndarray, size: np.ndarray) -> None:
    u, half = m.u, float(size[1])
    loose = m.chance(0.75)
    cap = u(1.04, 1.22)
    m.lump(centre + [0, 0.22 * half, -0.16 * size[2]], size * cap * [1, 0.88, 0.98], "Head", "hair", loose=loose)
    kind = m.pick(
        "short", "bob", "long", "spikes", "tail", "twin", "bun", "afro", "fringe", weights=(3, 2, 3, 2, 2, 1, 1, 1, 2)
    )
    if kind in ("bob", "long"):
        down = u(0.7, 1.1) if kind == "bob" else u(1.2, 3.4)
        low = centre[1] - half * down
        m.limb(
            [centre + [0, 0.2 * half, -0.45 * size[2]], [0, low, centre[2] - size[2] * u(0.6, 1.0)]],
            [size[0] * 0.85, size[0] * u(0.4, 0.95)], "Head", "hair", loose=loose, stretch=(1.1, 1, 0.55),
        )  # fmt: skip
        if m.chance(0.6):
            for _, s in SIDES:
                m.limb(
                    [
                        centre + [s * size[0] * 0.95, 0.2 * half, 0.1],
                        [s * size[0] * u(0.8, 1.1), low + u(0, 0.4) * half, centre[2] + 0.2 * size[2]],
                    ],
                    [0.26 * half, 0.12 * half], "Head", "hair", loose=loose,
                )  # fmt: skip
    elif kind == "spikes":
        for _ in range(int(m.rng.integers(5, 13))):
            direction = unit(np.array([u(-1, 1), u(0.1, 1), u(-1, 0.6)]))
            m.limb(
                [centre + direction * size * 0.85, centre + direction * size * u(1.25, 1.8)],
                [0.32 * half, 0.02 * half], "Head", "hair", loose=loose,
            )  # fmt: skip
    elif kind == "tail":
        root = centre + [0, u(0, 0.7) * half, -size[2] * 1.1]
        long = half * u(0.8, 3.5)
        m.limb(
            [root, root + [0, -0.1 * half, -0.45 * half], root + [0, -long, -u(0.1, 0.6) * half]],
            [0.16 * half, u(0.25, 0.4) * half, 0.06 * half], "Head", "ponytail", loose=loose,
        )  # fmt: skip
    elif kind == "twin":
        long = half * u(0.8, 3.0)
        for _, s in SIDES:
            root = centre + [s * size[0] * 1.1, 0.3 * half, -0.2 * size[2]]
            m.limb(
                [root, root + [s * 0.4 * half, -0.1 * half, 0], root + [s * u(0.3, 0.7) * half, -long, 0]],
                [0.12 * half, 0.28 * half, 0.05 * half], "Head", f"twin {s}", loose=loose,
            )  # fmt: skip
    elif kind == "bun":
        m.lump(
            centre + [0, u(0.3, 1.2) * half, -size[2] * u(0.5, 1.1)], half * u(0.25, 0.5), "Head", "bun", loose=loose
        )
    elif kind == "afro":
        m.lump(centre + [0, 0.35 * half, -0.2 * size[2]], size * u(1.25, 1.7), "Head", "hair", loose=loose)
    elif kind == "fringe":
        for _ in range(4):
            x = u(-0.7, 0.7)
            m.limb(
                [centre + size * [x, 0.85, 0.55], centre + size * [x * 1.2, u(0.2, 0.55), 1.0]],
                [0.22 * half, 0.06 * half], "Head", "hair", loose=loose,
            )  # fmt: skip


def _hat(m: Model, centre: np.ndarray, size: np.ndarray) -> None:
    u, half, top = m.u, float(size[1]), centre + [0, size[1] * m.u(0.35, 0.6), 0]
    kind = m.pick("cone", "wide", "top", "cap", "crown")
    radius = float(max(size[0], size[2])) * u(0.95, 1.1)
    if kind in ("cone", "wide", "top") and (kind != "cone" or m.chance(0.6)):
        brim = radius * u(1.2, 2.1)
        m.mesh(cylinder_mesh(top, top + [0, 0.08 * half, 0], (brim, brim * u(0.9, 1.0)), 20, 1), "Head", "brim")
    if kind == "cone":
        tip = top + [0, half * u(0.9, 2.2), u(-0.8, 0.2) * half]
        m.mesh(cylinder_mesh(top, tip, (radius, radius * 0.04), 16, 3), "Head", "hat")
    elif kind == "crown":
        m.mesh(cylinder_mesh(top, top + [0, half * u(0.3, 0.6), 0], (radius * 0.8, radius), 12, 1), "Head", "hat")
    elif kind == "cap":
        m.lump(top, (radius * 1.02, half * 0.75, radius * 1.02), "Head", "hat", loose=True)
        m.block(top + [0, 0, radius * 1.2], (radius * 0.7, 0.05 * half, radius * 0.6), "Head", "brim", exponent=3.0)
    else:
        m.mesh(
            cylinder_mesh(top, top + [0, half * u(0.5, 1.4), 0], (radius * u(0.75, 1.0), radius * u(0.7, 1.1)), 16, 2),
            "Head",
            "hat",
        )
