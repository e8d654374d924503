"""Characters with further limbs, as 30 plain handles for each limb: so all that is said of a leg is said of every
leg.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product, starmap

import numpy as np

from bunraku.anatomy.joints import Joints
from bunraku.body.layout import HANDLE_NAMES, HANDLE_PARENTS
from bunraku.core.character import Handles
from bunraku.handles.limbs import FAMILIES, SIDES, further_legged, limb_handles

__all__ = ["LimbView", "by_limb", "further_limbs", "limb_views", "reference_parts"]

TOUCH = 1e-3  # least overlap of two parts of one limb, over that of the outer one with itself

_LIMBS = [*starmap(limb_handles, product(SIDES, FAMILIES))]
_LEAVES = sorted(set(range(len(HANDLE_NAMES))) - set(HANDLE_PARENTS))


@dataclass(frozen=True, eq=False)
class LimbView:
    """A character as if it had one limb of each kind.

    Args:
        handles: Handles that all play their own parts, as their `roles` say where it has further limbs. What other
            limbs weigh is on one that the character lacks.
        members: Handle of the character that plays each of them, -1 for none, shape (K,).
        own: Which of them this view speaks for.
    """

    handles: Handles
    members: np.ndarray
    own: list[int]


def _limb_of(role: int) -> list[int]:
    return next((limb for limb in _LIMBS if role in limb), [role])


def further_limbs(handles: Handles) -> list[list[int]]:
    """The handles of each further limb, from the body outwards; a part belongs to the limb that its weights touch
    most.
    """
    out: list[list[int]] = []
    roles = handles.played
    further = np.flatnonzero(roles != np.arange(len(roles)))
    for handle in further[np.argsort(roles[further], kind="stable")].tolist():
        role = int(roles[handle])
        open_ends = [limb for limb in out if roles[limb[-1]] in _limb_of(role) and roles[limb[-1]] < role]
        touch = [float(handles.weights[:, handle] @ handles.weights[:, limb[-1]]) for limb in open_ends]
        if touch and max(touch) > TOUCH * float((handles.weights[:, handle] ** 2).sum()):
            open_ends[int(np.argmax(touch))].append(handle)
        else:
            out.append([handle])
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
    roles = np.arange(len(members)) if further_legged(handles) else None
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
            turns[handle], positions[handle], present[handle] = (
                turned[role],
                joints.positions[role],
                joints.present[role],
            )
            parents[handle] = view.members[above] if above >= 0 else -1
    return turns, Joints(positions, parents, present)


def reference_parts(handles: Handles, joints: Joints) -> tuple[np.ndarray, np.ndarray]:
    """Parents (K,) and presence (K,) of the handles as parts of a body that has one limb of each kind: further limbs
    are absent.
    """
    own = handles.played == np.arange(len(handles.positions))
    parents = np.where(own, joints.parents, HANDLE_PARENTS)
    for handle in np.flatnonzero(~own):
        while parents[handle] > 0 and not own[parents[handle]]:
            parents[handle] = HANDLE_PARENTS[parents[handle]]
    return parents, joints.present & own
