"""A person's joints in a skeleton whose names say nothing: two pairs of long twin chains are the legs and the arms."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from bunraku.core.motion import Skeleton

__all__ = ["joints_by_structure"]

ALIKE = 0.15  # twins differ by less than this share in length
LONG = 0.3  # of the longest chain: what is shorter is no limb
SHORT_BONE = 0.55  # a first bone shorter than this share of the next one is a collar bone, or joins a leg to the pelvis


def joints_by_structure(skeleton: Skeleton) -> dict[str, int]:
    """Joints by SMPL's names, as far as legs are found; without legs none.

    Sides are those of who faces where the feet point in the rest pose, +Z where there are none.
    """
    count, parents = len(skeleton.names), skeleton.parents
    children = [np.flatnonzero(parents == joint).tolist() for joint in range(count)]
    length = np.linalg.norm(skeleton.offsets, axis=-1)
    reach = np.zeros(count)  # length of the longest chain below, with the bone to it
    sizes = np.ones(count, int)
    for joint in range(count - 1, 0, -1):
        below = max((reach[child] + length[child] for child in children[joint]), default=0.0)
        reach[joint] = below
    for joint in range(count - 1, 0, -1):
        sizes[parents[joint]] += sizes[joint]
    depth = np.zeros(count, int)
    for joint in range(1, count):
        depth[joint] = depth[parents[joint]] + 1

    def chain(joint: int) -> list[int]:
        out = [joint]
        while children[out[-1]] and len(children[out[-1]]) < 3:
            out.append(max(children[out[-1]], key=lambda child: reach[child] + length[child]))
        return out

    longest = max((reach[j] for j in range(count)), default=0.0)
    pairs = []
    for joint in range(count):
        for a, b in combinations(children[joint], 2):
            far = min(reach[a], reach[b])
            if far > LONG * longest and abs(reach[a] - reach[b]) < ALIKE * far and len(chain(a)) == len(chain(b)) >= 3:
                pairs.append((joint, a, b))
    if not pairs:
        return {}
    positions = skeleton.positions
    pairs.sort(key=lambda pair: (depth[pair[0]], positions[chain(pair[1])[-1], 1]))
    legs = pairs[0]
    arms = next(
        (
            pair
            for pair in pairs[1:]
            if not {pair[1], pair[2]} & {legs[1], legs[2]} and not _within(pair[0], legs[1:], parents)
        ),
        None,
    )
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
            line = chain(max(upper, key=lambda child: (sizes[child], reach[child])))
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
