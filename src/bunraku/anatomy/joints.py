"""Where handles meet: the joints that skinning weights imply, also of bodies with more limbs than a person."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product, starmap

import numpy as np
from scipy.spatial import cKDTree

from bunraku.anatomy.handles.limbs import FAMILIES, SIDES, has_extra_legs, limb_handles
from bunraku.core.body.layout import HANDLE_NAMES, HANDLE_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import axis_angle_from_matrix, inverses
from bunraku.core.geometry.surface import vertex_areas

# Tried in a short run of the sample person and dog: 0.7 and 1.4 times OVERLAP, TRACE or CLOSE change nothing, 0.7 times
# PRESENT moves the dog by up to 3 cm.
PRESENT = 2e-3  # share of the surface under which a handle counts as absent and follows its parent
OVERLAP = 5e-3  # common share of a part and its parent below which they are pieces that only touch
ASTRAY = 2.0  # the way from the middle of one part to that of the next by their joint, over the straight one, at most
TRACE = 0.2  # weight below which a vertex is not of a part, over the part's largest
GROUP = 4000  # vertices of a part looked at to find where it meets another
HIP_BY_THIGH = 0.75
"""How far a bent hip follows the thigh instead of the overlap of weights: measured on archive humanoids made to sit."""
CLOSE = 0.1  # how fast closeness fades, as a share of a part's size


@dataclass(frozen=True)
class Joints:
    """Where handles meet their parents, in the rest pose."""

    positions: np.ndarray  # joint between each handle and its parent [m], shape (K, 3); for the root the handle itself
    parents: np.ndarray  # nearest ancestor that is present, shape (K,); -1 for the root
    present: np.ndarray  # whether a handle has vertices of its own, shape (K,)


def find_joints(character: Character, handles: Handles) -> Joints:
    """Joints between neighbouring handles, where both weights are large.

    The joint of k and p is the mean of the vertices weighted by area times s_k times s_p. Where the weights hardly
    overlap (loose parts; a trace of both may lie anywhere), it is half way between the two nearest groups of vertices.
    """
    areas = character.areas
    mass = handles.weights * areas[:, None]
    share = mass.sum(axis=0) / max(areas.sum(), 1e-30)
    present = share > PRESENT
    present[0] = True
    vertices = character.vertices.astype(np.float64)
    positions = handles.positions.astype(np.float64)
    parents = np.full(len(positions), -1)
    for handle in range(1, len(positions)):
        parent = HANDLE_PARENTS[handle]
        while parent > 0 and not present[parent]:
            parent = HANDLE_PARENTS[parent]
        parents[handle] = parent
        if not present[handle]:
            continue
        shared = _shared(vertices, handles, areas, handle, parent)
        if shared is not None:
            positions[handle] = (shared * areas) @ vertices / float(shared @ areas)
            continue
        below, above = (
            np.where(handles.weights[:, part] > TRACE * handles.weights[:, part].max(), mass[:, part], 0)
            for part in (handle, parent)
        )
        positions[handle] = _between(vertices, below, above) if above.any() else positions[parent]
    return Joints(positions, parents, present)


def _shared(vertices: np.ndarray, handles: Handles, areas: np.ndarray, handle: int, parent: int) -> np.ndarray | None:
    """How much each vertex is of the place where two handles meet, the product of their shares, shape (V,); None where
    they hardly overlap, or where what they share lies nowhere between them: a trace of an arm on all fingers is no
    elbow.
    """
    own = handles.weights[:, handle].astype(np.float64)
    both = own * handles.weights[:, parent]
    mass = both * areas
    total = float(mass.sum())
    if total <= OVERLAP * float(own @ areas):
        return None
    middle, part, above = mass @ vertices / total, handles.positions[handle], handles.positions[parent]
    way = np.linalg.norm(middle - part) + np.linalg.norm(middle - above)
    return None if way > ASTRAY * np.linalg.norm(part - above) else both


def _between(vertices: np.ndarray, mass: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Where two groups of vertices are closest to each other, shape (3,): the mean over both of what is nearest to the
    other.

    Which vertices those are hardly depends on how a hinge is bent.
    """
    groups = [np.flatnonzero(some > 0.2 * some.max()) for some in (mass, other)]
    groups = [group[:: max(1, len(group) // GROUP)] for group in groups]
    points = [vertices[group] for group in groups]
    sides = []
    for own, far, group, some in ((points[0], points[1], groups[0], mass), (points[1], points[0], groups[1], other)):
        gap = cKDTree(far).query(own)[0]
        softness = CLOSE * max(float(np.sqrt(((own - own.mean(axis=0)) ** 2).sum(axis=1).mean())), 1e-12)
        share = some[group] * np.exp((gap.min() - gap) / softness)
        sides.append(share @ own / share.sum())
    return np.asarray(0.5 * (sides[0] + sides[1]))


def refined_joints(character: Character, handles: Handles, joints: Joints, rotations: np.ndarray) -> Joints:
    """Joints as they are where the rest pose has been bent: estimates of `find_joints` rid of what the bend and the
    estimate add.

    Where the weights of two handles overlap, skinning has taken a vertex p of the unbent surface to `j + M (p - j')`,
    where M = (1 - s) R_p^T + s R_k^T blends what undoes the rotations of both. Bent back, the overlap's centre lies
    from the joint where it lies on the reference body, whose true joints are known, in each part's own scale; that
    fixes j.

    Args:
        character: In its rest pose.
        handles: Its handles.
        joints: The estimate.
        rotations: Rotation of each handle from the rest pose to the reference body's, shape (K, 3, 3).
    """
    body, estimated = reference_body(), estimated_reference_joints()
    centres = body.handles.positions
    areas = character.areas
    positions = joints.positions.copy()
    h = handles.positions.astype(np.float64)
    pairs = [
        (handle, int(joints.parents[handle]))
        for handle in range(1, len(body.joints))
        if joints.present[handle] and joints.parents[handle] == HANDLE_PARENTS[handle]
    ]
    overlaps = _unbent(character, handles, areas, pairs, rotations, joints.positions)
    for handle, parent in pairs:
        j = joints.positions[handle]
        moved = rotations[handle] @ (h[handle] - j) + rotations[parent] @ (j - h[parent])
        size = float(np.linalg.norm(moved) / np.linalg.norm(centres[handle] - centres[parent]))
        offset = (estimated.positions[handle] - body.joints[handle]) * size
        if handle not in overlaps:  # the parts do not overlap
            positions[handle] -= 0.5 * (rotations[handle] + rotations[parent]).T @ offset
            continue
        where, unbend, mass = overlaps[handle]
        unbend *= (mass / mass.sum())[:, None, None]
        centre = np.einsum("vij,vj->i", unbend, character.vertices[where].astype(np.float64))
        positions[handle] = np.linalg.solve(unbend.sum(axis=0), centre - offset)
    return replace(joints, positions=_bent_hips(positions, joints.present, h, rotations))


def _bent_hips(positions: np.ndarray, present: np.ndarray, h: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Joint positions with hips that are bent put most of the way to where the thigh, from its knee to its middle, says
    that they are, shape (K, 3).

    The estimate by overlap is off by some per cent of the height where clothes or wide hips make the overlap large,
    which shows as shorter legs once a bent hip is straightened.
    """
    out, body = positions.copy(), reference_body()
    centres = body.handles.positions
    for side in ("left", "right"):
        hip, knee = HANDLE_NAMES.index(f"{side}_hip"), HANDLE_NAMES.index(f"{side}_knee")
        if present[[hip, knee]].all():
            bend = np.degrees(np.linalg.norm(axis_angle_from_matrix(rotations[hip])))
            size = np.linalg.norm(h[hip] - positions[knee]) / np.linalg.norm(centres[hip] - body.joints[knee])
            thigh = positions[knee] + rotations[hip].T @ (body.joints[hip] - body.joints[knee]) * size
            out[hip] += HIP_BY_THIGH * np.interp(bend, [30, 60], [0, 1]) * (thigh - positions[hip])
    return out


def _unbent(
    character: Character, handles: Handles, areas: np.ndarray, pairs: Sequence[tuple[int, int]], rotations: np.ndarray,
    joints: np.ndarray,
) -> dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]]:  # fmt: skip
    """For each handle of these pairs with its parent, the vertices of which both hold a share (n,), what bends each of
    them back (n, 3, 3), and the mass of each in the overlap, by its area when bent back (n,). Handles that do not
    overlap with their parents are left out.
    """
    shared: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
    blends, corners, count = [np.zeros((0, 3, 3))], [np.zeros((0, 3), np.int64)], 0
    for handle, parent in pairs:
        own, above = handles.weights[:, handle].astype(np.float64), handles.weights[:, parent].astype(np.float64)
        both = _shared(character.vertices, handles, areas, handle, parent)
        if both is None:
            continue
        near = both > 1e-3 * both.max()
        share = np.divide(own, own + above, out=np.zeros_like(own), where=near)
        touched, faces = np.unique(character.faces[near[character.faces].any(axis=1)], return_inverse=True)
        share[touched] = np.where(near[touched], share[touched], own[touched] > above[touched])
        part = share[touched][:, None, None]
        blends.append((1 - part) * rotations[parent].T + part * rotations[handle].T)
        corners.append(faces.reshape(-1, 3) + count)
        shared[handle] = touched, near[touched], both[touched]
        count += len(touched)
    unbend = inverses(np.concatenate(blends) + 1e-9 * np.eye(3))
    flat, start = np.zeros((count, 3)), 0
    for handle, (touched, _, _) in shared.items():
        rows = slice(start, start := start + len(touched))
        flat[rows] = np.einsum("vij,vj->vi", unbend[rows], character.vertices[touched] - joints[handle])
    flat_areas, start = vertex_areas(flat, np.concatenate(corners)), 0
    out = {}
    for handle, (touched, kept, both) in shared.items():
        rows = slice(start, start := start + len(touched))
        out[handle] = touched[kept], unbend[rows][kept], both[kept] * flat_areas[rows][kept]
    return out


def attach_joints(rotations: np.ndarray, positions: np.ndarray, joints: Joints) -> tuple[np.ndarray, np.ndarray]:
    """Local rotations and translations in which every joint holds; absent handles move with their parents.

    Args:
        rotations: Local rotations of the handles, shape (N, K, 3, 3).
        positions: Of the handles at rest [m], shape (K, 3).
        joints: Where they meet.

    Returns:
        The rotations, shape (N, K, 3, 3), and the translations [m], shape (N, K, 3).
    """
    rotations = rotations.copy()
    translations = np.zeros((*rotations.shape[:2], 3))
    h = positions.astype(np.float64)
    for handle in downwards(joints.parents)[1:]:
        parent = int(joints.parents[handle])
        if not joints.present[handle]:
            rotations[:, handle] = rotations[:, parent]
        joint = joints.positions[handle]
        position = np.einsum("nij,j->ni", rotations[:, parent], joint - h[parent]) + h[parent] + translations[:, parent]
        translations[:, handle] = position - np.einsum("nij,j->ni", rotations[:, handle], joint - h[handle]) - h[handle]
    return rotations, translations


def downwards(parents: Sequence[int] | np.ndarray) -> list[int]:
    """All handles, every parent before its children."""
    depth = np.zeros(len(parents), int)
    for handle, parent in enumerate(parents):
        while parent >= 0:
            depth[handle], parent = depth[handle] + 1, parents[parent]
    return [int(handle) for handle in np.argsort(depth, kind="stable")]


@lru_cache(maxsize=1)
def reference_joints() -> Joints:
    """The reference body's handles with its true joints, positions [m] of shape (30, 3)."""
    body, estimated = reference_body(), estimated_reference_joints()
    return replace(estimated, positions=np.concatenate([body.joints, estimated.positions[len(body.joints) :]]))


@lru_cache(maxsize=1)
def estimated_reference_joints() -> Joints:
    """The reference body's joints as `find_joints` sees them, to compare others with [m], shape (30, 3)."""
    body = reference_body()
    return find_joints(body.character(), body.handles)


_LIMBS = [*starmap(limb_handles, product(SIDES, FAMILIES))]
_LEAVES = sorted(set(range(len(HANDLE_NAMES))) - set(HANDLE_PARENTS))


@dataclass(frozen=True, eq=False)
class LimbView:
    """A character as if it had one limb of each kind."""

    # Handles that all play their own parts, as their `roles` say where it has further limbs. What other limbs weigh is
    # on one that the character lacks.
    handles: Handles
    members: np.ndarray  # handle of the character that plays each of them, -1 for none, shape (K,)
    own: list[int]  # which of them this view speaks for


def _limb_of(role: int) -> list[int]:
    return next((limb for limb in _LIMBS if role in limb), [role])


def further_limbs(handles: Handles) -> list[list[int]]:
    """The handles of each further limb, from the body outwards; a part is of the limb that its weights touch most, or,
    where each vertex goes with one bone, of the nearest.
    """
    out: list[list[int]] = []
    roles, weights, positions = handles.played, handles.weights, handles.positions
    further = np.flatnonzero(roles != np.arange(len(roles)))
    for handle in further[np.argsort(roles[further], kind="stable")].tolist():
        limb = _limb_of(int(roles[handle]))
        open_ends = [other for other in out if roles[other[-1]] in limb and roles[other[-1]] < roles[handle]]
        if not open_ends or roles[handle] == limb[0]:
            out.append([handle])
            continue
        ends = [other[-1] for other in open_ends]
        touch, away = weights[:, handle] @ weights[:, ends], positions[ends] - positions[handle]
        nearest = touch if touch.max() > 0 else -np.linalg.norm(away, axis=1)
        open_ends[int(nearest.argmax())].append(handle)
    return out


def limb_views(handles: Handles, further: list[list[int]] | None = None) -> list[LimbView]:
    """The character without its further limbs, and, for each of them, with that limb in place of the first of its
    kind.

    Args:
        handles: Its handles.
        further: Its further limbs; None looks for them.
    """
    count = len(handles.positions)
    plain = np.where(handles.played == np.arange(count), np.arange(count), -1)
    views = [_view(handles, plain, np.flatnonzero(plain >= 0).tolist())]
    for limb in further_limbs(handles) if further is None else further:
        members, roles = plain.copy(), handles.played[limb]
        members[_limb_of(int(roles[0]))] = -1
        members[roles] = limb
        views.append(_view(handles, members, roles.tolist()))
    return views


def _view(handles: Handles, members: np.ndarray, own: list[int]) -> LimbView:
    there = members >= 0
    weights, positions = np.zeros_like(handles.weights), handles.positions.copy()
    weights[:, there] = handles.weights[:, members[there]]
    positions[there] = handles.positions[members[there]]
    for handle in np.flatnonzero(~there):
        positions[handle] = positions[HANDLE_PARENTS[handle]]
    idle = next((leaf for leaf in reversed(_LEAVES) if not there[leaf]), 0)
    weights[:, idle] += 1 - weights.sum(axis=1)
    roles = np.arange(len(members)) if has_extra_legs(handles) else None
    return LimbView(Handles(positions, weights, roles=roles), members, own)


def by_limb(
    handles: Handles, solve: Callable[[Handles], tuple[np.ndarray, Joints]], views: list[LimbView] | None = None
) -> tuple[np.ndarray, Joints]:
    """Rotations and joints of a character, limb by limb.

    Args:
        handles: Its handles, K = 30.
        solve: Gives rotations (K, 3, 3) and joints for handles that play their own parts; called once for each limb, in
            the order of `limb_views`.
        views: Those views, where they are known.

    Returns:
        Rotations (K, 3, 3) and joints of all its handles; each hangs on one of its own limb, and the first of a limb on
        the body.
    """
    if handles.roles is None:
        return solve(handles)
    count = len(handles.positions)
    turns, parents, present = np.tile(np.eye(3), (count, 1, 1)), np.full(count, -1), np.zeros(count, bool)
    positions = handles.positions.astype(np.float64)
    for view in views or limb_views(handles):
        turned, joints = solve(view.handles)
        for role in view.own:
            handle, above = view.members[role], int(joints.parents[role])
            while above > 0 and view.members[above] < 0:
                above = HANDLE_PARENTS[above]
            turns[handle], present[handle] = turned[role], joints.present[role]
            positions[handle] = joints.positions[role]
            parents[handle] = view.members[above] if above >= 0 else -1
    return turns, Joints(positions, parents, present)


def reference_parts(handles: Handles, joints: Joints) -> tuple[np.ndarray, np.ndarray]:
    """Parents (K,) and presence (K,) of the handles in a body with one limb of each kind: further limbs are absent."""
    itself = handles.played == np.arange(len(handles.positions))
    parents = np.where(itself, joints.parents, HANDLE_PARENTS)
    for handle in np.flatnonzero(~itself):
        while parents[handle] > 0 and not itself[parents[handle]]:
            parents[handle] = HANDLE_PARENTS[parents[handle]]
    return parents, joints.present & itself
