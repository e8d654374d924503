"""A person's joints in a skeleton whose names say nothing: two pairs of long twin chains are the legs and the arms."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from bunraku.core.motion import Skeleton

__all__ = ["joints_by_structure"]

ALIKE = 0.15  # twins differ by less than this share in length
LONG = 0.3  # of the longest twins: what is shorter is no limb
FARTHER = 1.5  # times as far as all others of three and more: what goes on a limb, with twists or sleeves beside it
LEVEL = 0.1  # of the same: twins that end as low as others do, or begin as high
SHORT_BONE = 0.55  # a first bone shorter than this share of the next one is a collar bone, or joins a leg to the pelvis


def joints_by_structure(skeleton: Skeleton, mass: np.ndarray | None = None) -> dict[str, int]:
    """Joints by SMPL's names, as far as legs are found; without legs none.

    Sides are those of who faces where the feet point in the rest pose, +Z where there are none.

    Args:
        skeleton: Each joint after its parent.
        mass: How much skin each joint holds, shape (J,): what holds none, as targets for the feet do, is no limb.
    """
    count, parents, positions = len(skeleton.names), skeleton.parents, skeleton.positions
    children = [np.flatnonzero(parents == joint).tolist() for joint in range(count)]
    length = np.linalg.norm(skeleton.offsets, axis=-1)
    reach = np.zeros(count)  # length of the longest chain below, with the bone to it
    sizes = np.ones(count, int)
    held = np.ones(count) if mass is None else np.array(mass, float)
    for joint in range(count - 1, 0, -1):
        below = max((reach[child] + length[child] for child in children[joint]), default=0.0)
        reach[joint] = below
    for joint in range(count - 1, 0, -1):
        sizes[parents[joint]] += sizes[joint]
        held[parents[joint]] += held[joint]
    depth = np.zeros(count, int)
    for joint in range(1, count):
        depth[joint] = depth[parents[joint]] + 1

    def chain(joint: int) -> list[int]:
        out = [joint]
        while children[out[-1]]:
            after = sorted(children[out[-1]], key=lambda child: -(reach[child] + length[child]))
            whole = [reach[child] + length[child] for child in after]
            if len(after) > 2 and whole[0] < FARTHER * whole[1]:  # fingers
                break
            out.append(after[0])
        return out

    def top_of(joint: int) -> float:
        """How high what hangs on a joint reaches."""
        out, queue = -np.inf, [joint]
        while queue:
            one = queue.pop()
            out = max(out, float(positions[one, 1]))
            queue += children[one]
        return out

    twins = []
    for joint in range(count):
        for a, b in combinations([child for child in children[joint] if held[child] > 0], 2):
            far = min(reach[a], reach[b])
            if far > 0 and abs(reach[a] - reach[b]) < ALIKE * far and len(chain(a)) == len(chain(b)) >= 3:
                twins.append((joint, a, b))
    longest = max((reach[a] for _, a, _ in twins), default=0.0)  # one long plait must not make the arms look short
    pairs = [pair for pair in twins if min(reach[pair[1]], reach[pair[2]]) > LONG * longest]
    if not pairs:
        return {}
    level = LEVEL * longest

    def low(pair: tuple[int, int, int]) -> float:
        return float(positions[[chain(first)[-1] for first in pair[1:]], 1].mean())

    ground = min(low(pair) for pair in pairs)
    legs = min(pairs, key=lambda pair: (low(pair) > ground + level, depth[pair[0]], low(pair)))
    others = [pair for pair in pairs
              if not {pair[1], pair[2]} & {legs[1], legs[2]} and not _within(pair[0], legs[1:], parents)]  # fmt: skip
    hips = float(positions[list(legs[1:]), 1].mean())

    def reaches(pair: tuple[int, int, int]) -> tuple[bool, float]:
        """Whether twins end in hands, and how far apart they end over their length: arms reach to the sides, where
        hair, skirts and capes hang down.
        """
        ends = [chain(first)[-1] for first in pair[1:]]
        hands = all(len(children[end]) > 2 for end in ends)
        gap = positions[ends[0]] - positions[ends[1]] - (positions[pair[1]] - positions[pair[2]])
        return hands, float(np.hypot(gap[0], gap[2])) / (reach[pair[1]] + reach[pair[2]])

    # what hangs about the hips as a skirt does is no arm where there are others
    higher = [pair for pair in others if positions[list(pair[1:]), 1].mean() > hips + level]
    arms = max(higher or others, key=reaches, default=None)
    out = {"pelvis": legs[0]}
    lines = [chain(joint) for joint in legs[1:]]
    if len(lines[0]) >= 4 and length[lines[0][1]] < SHORT_BONE * length[lines[0][2]]:
        lines = [line[1:] for line in lines]
    toes = (
        np.sum([positions[line[3]] - positions[line[2]] for line in lines if len(line) > 3], axis=0)
        if len(lines[0]) > 3
        else np.zeros(3)
    )
    forward = np.array([toes[0], 0, toes[2]]) if np.hypot(toes[0], toes[2]) > 1e-6 else np.array([0.0, 0, 1])
    left = np.cross([0, 1, 0], forward)
    for line, side in zip(lines, _sides(lines, positions, left), strict=True):
        out |= {f"{side}_{part}": joint for part, joint in zip(("hip", "knee", "ankle", "foot"), line, strict=False)}
    if arms is not None:
        lines = [chain(joint) for joint in arms[1:]]
        collared = len(lines[0]) >= 4 or length[lines[0][1]] < SHORT_BONE * length[lines[0][2]]
        parts = ("collar", "shoulder", "elbow", "wrist")[0 if collared else 1 :]
        for line, side in zip(lines, _sides(lines, positions, left), strict=True):
            out |= {f"{side}_{part}": joint for part, joint in zip(parts, line, strict=False)}
        upper = [child for child in children[arms[0]] if child not in arms[1:]]
        if upper:
            line = chain(max(upper, key=lambda child: (top_of(child), sizes[child])))
            out |= {"neck": line[0], "head": line[1]} if len(line) > 1 else {"head": line[0]}
    return out


def _within(joint: int, roots: tuple[int, ...], parents: np.ndarray) -> bool:
    while joint >= 0:
        if joint in roots:
            return True
        joint = int(parents[joint])
    return False


def _sides(lines: list[list[int]], positions: np.ndarray, left: np.ndarray) -> tuple[str, str]:
    across = [float(positions[line].mean(axis=0) @ left) for line in lines]
    return ("left", "right") if across[0] >= across[1] else ("right", "left")
