"""What a rig's bone names say: the handle of each joint, which way the rig stands, and the handles of its character."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import lru_cache

import numpy as np

from bunraku.anatomy.names.bone_words import left_axis, part_of_name, without_prefix
from bunraku.core.animation import bone_order
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_MIRROR, HANDLE_NAMES, HANDLE_PARENTS, JOINT_NAMES
from bunraku.core.body.reference import handle_positions
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.axes import AXES, axis_vector
from bunraku.core.motion import line_up
from bunraku.errors import CharacterError

NO_HANDLE = -1
_H = dict(zip(HANDLE_NAMES, range(len(HANDLE_NAMES)), strict=True))
_LIMB_KINDS = ("shoulder", "elbow", "leg")


KNEE = 0.25  # a bone that is shorter than this share of its leg's longest is no segment; by eye on a frog


class _Tree:
    """The joints with what their names say, and the walks over the hierarchy that the rules below need."""

    def __init__(
        self, names: Sequence[str], parents: Sequence[int], positions: np.ndarray | None, mass: np.ndarray | None
    ):
        self.parents = [int(p) for p in parents]
        read = [part_of_name(name) for name in names]
        self.kinds = [kind for kind, _, _, _ in read]
        self.numbers = [number for _, _, number, _ in read]
        self.sides = [side for _, side, _, _ in read]
        self.words = [re.sub(r"[^a-z]", "", name.lower()) for name in names]
        self.mass = None if mass is None else np.asarray(mass, float)
        for joint, (_, _, _, target) in enumerate(read):
            idle = self.mass is None or self.mass[joint] <= 0
            if target and idle and self.kinds[joint] not in ("front_foot", "hind_paw"):
                self.kinds[joint] = "none"
        self.children: list[list[int]] = [[] for _ in names]
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                self.children[parent].append(joint)
        self.order = bone_order(np.array(self.parents))
        self.depth = self.passed(range(len(names)))
        self.positions = None if positions is None else np.asarray(positions, float)
        self._settle_sides(names)
        self._drop_idle()
        self.copies = [re.sub(r"\.\d+$", "", name) for name in names]
        above: list[frozenset[str]] = [frozenset() for _ in names]
        for joint in self.order:  # words that mean one thing alone and another in company
            kind, parent, word = self.kinds[joint], self.parents[joint], self.words[joint]
            if parent >= 0:
                above[joint] = above[parent] | {self.kinds[parent]}
            again = kind in above[joint] and "front" not in word
            if kind == "hips" and self.sides[joint]:
                self.kinds[joint] = "leg" if self._bears_a_leg(joint) else "none"
            elif kind == "collar" and again and word.endswith("shoulder"):
                self.kinds[joint] = "shoulder"
            elif (kind == "foot" and again and "foot" in word) or (kind == "fingers" and "foot" in above[joint]):
                self.kinds[joint] = "toe"
            elif kind in _LIMB_KINDS and "twist" in word and not self.children[joint] and kind in above[joint]:
                self.kinds[joint] = ""  # a helper beside the limb that goes on below its own parent

    def _settle_sides(self, names: Sequence[str]) -> None:
        """Joints without a side take that of the limb above; where a limb's names disagree, its position decides."""
        sided = [bool(side) for side in self.sides]
        limb = list(range(len(names)))
        members_of: dict[int, list[int]] = {}
        for joint in self.order:
            parent = self.parents[joint]
            if parent >= 0 and not self.sides[joint]:
                self.sides[joint] = self.sides[parent]
            if parent >= 0 and self.sides[joint] and self.sides[parent]:
                limb[joint] = limb[parent]
            if self.sides[joint]:
                members_of.setdefault(limb[joint], []).append(joint)
        axis = None if self.positions is None else left_axis(names, self.positions)
        for first, members in members_of.items():
            if len({self.sides[j] for j in members}) < 2:
                continue
            side = self.sides[first]
            if axis is not None and self.positions is not None:
                across = self.positions @ axis
                marked = across[np.array(sided)]
                side = 1 if across[members].mean() > (marked.max() + marked.min()) / 2 else -1
            for joint in members:
                self.sides[joint] = side

    def _drop_idle(self) -> None:
        """Where a bone of a limb moves vertices, or bones that do, those of its part that move none are controls."""
        if self.mass is None:
            return
        moves = self.mass > 0
        for joint in reversed(self.order):
            if self.parents[joint] >= 0:
                moves[self.parents[joint]] |= moves[joint]
        limbs = [(kind, side) for kind, side in zip(self.kinds, self.sides, strict=True)]
        moving = {limb for limb, there in zip(limbs, moves, strict=True) if there}
        for joint, limb in enumerate(limbs):
            if limb[0] in _LIMB_KINDS and not moves[joint] and limb in moving:
                self.kinds[joint] = "none"

    def _bears_a_leg(self, joint: int) -> bool:
        """Whether a hip of one side is the first bone of its leg: not where a leg of that side begins beside it."""
        if self.child_kinds(joint) & {"leg", "foot"}:
            return True
        beside = self.children[self.parents[joint]] if self.parents[joint] >= 0 else []
        return not any(self.kinds[other] == "leg" and self.sides[other] == self.sides[joint] for other in beside)

    def passed(self, marked: Iterable[int]) -> list[int]:
        """How many of the marked joints are above each joint."""
        counts, out = (
            np.bincount(np.array([*marked], int), minlength=len(self.parents)).tolist(),
            [0] * len(self.parents),
        )
        for joint in self.order:
            parent = self.parents[joint]
            if parent >= 0:
                out[joint] = out[parent] + counts[parent]
        return out

    def of(self, *kinds: str) -> list[int]:
        """Joints of these kinds, near the root first."""
        return sorted((j for j, kind in enumerate(self.kinds) if kind in kinds), key=lambda j: (self.depth[j], j))

    def child_kinds(self, joint: int) -> set[str]:
        return {self.kinds[child] for child in self.children[joint]}

    def sided(self, joint: int, part: str) -> int:
        side = self.sides[joint]
        return _H[f"{'left' if side > 0 else 'right'}_{part}"] if side else NO_HANDLE


def handle_of_joints(
    names: Sequence[str],
    parents: Sequence[int] | np.ndarray,
    positions: np.ndarray | None = None,
    mass: np.ndarray | None = None,
) -> np.ndarray:
    """The handle that each joint of a rig moves.

    Args:
        names: Joint names, length J.
        parents: Parent of each joint, -1 for a root, shape (J,).
        positions: Joint positions [m], shape (J, 3); settle sides that names have wrong.
        mass: Total skin weight of each joint, shape (J,); lets the rules pass over joints that move nothing.

    Returns:
        Handle indices of `bunraku.core.body.layout.HANDLE_NAMES`, shape (J,); -1 where a name says nothing.
    """
    places, masses = (None if array is None else np.asarray(array, float).tobytes() for array in (positions, mass))
    return _handle_of_joints(tuple(names), tuple(int(parent) for parent in parents), places, masses).copy()


@lru_cache(maxsize=16)  # each question about a rig begins with this one
def _handle_of_joints(
    names: tuple[str, ...], parents: tuple[int, ...], places: bytes | None, masses: bytes | None
) -> np.ndarray:
    positions = None if places is None else np.frombuffer(places).reshape(-1, 3)
    mass = None if masses is None else np.frombuffer(masses)
    own = [re.sub(r"_[2-9]\d*$", "", name) for name in names]  # left_hip_2 moves the second left leg
    whole = len(names) == len(HANDLE_NAMES) or set(JOINT_NAMES) <= set(names)
    if whole and set(own) <= set(HANDLE_NAMES):  # a rig that Bunraku wrote: its "shoulder" is not a collar bone
        return np.array([_H[name] for name in own], np.int64)
    tree = _Tree(without_prefix(names), parents, positions, mass)
    out = np.full(len(names), NO_HANDLE, np.int64)
    plain = {"head_top": "head_top", "face": "face", "neck": "neck", "head": "head", "hips": "pelvis"}
    sided = {"fingers": "fingers", "wrist": "wrist", "elbow": "elbow", "shoulder": "shoulder", "collar": "collar",
    "wing": "wing",
             "front_foot": "wrist", "hip_bone": "hip", "toe": "foot", "hind_paw": "foot"}  # fmt: skip
    for joint, kind in enumerate(tree.kinds):
        if kind in plain:
            out[joint] = _H[plain[kind]]
        elif kind in sided:
            out[joint] = tree.sided(joint, sided[kind])
        elif kind == "face_bone":
            out[joint] = _H["face" if tree.of("head") else "head"]
    _legs(tree, out)
    _flippers(tree, out)
    _trunk(tree, out)
    _empty_hands(tree, out)
    _between(tree, out)
    for joint in tree.of("held", ""):
        part = out[tree.parents[joint]] if tree.parents[joint] >= 0 else NO_HANDLE
        if part >= _H["neck"] and (tree.kinds[joint] == "held" or part in (_H["head"], _H["face"])):
            out[joint] = part
    return out


def _legs(tree: _Tree, out: np.ndarray) -> None:
    """Legs of two segments are hip and knee, of three hip, knee and ankle; front legs are arms."""
    long: set[int] = set()
    front = set(tree.of("arm_leg"))
    chain_of: dict[int, list[int]] = {}
    legs, capped_by = set(tree.of("leg", "arm_leg")), tree.passed(tree.of("hip_bone"))
    for joint in tree.of("leg", "arm_leg"):
        if legs & set(tree.children[joint]):
            continue
        line = [joint]
        while tree.parents[line[0]] in legs:
            line.insert(0, tree.parents[line[0]])
        for member in line:
            if len(line) > len(chain_of.get(member, [])):
                chain_of[member] = line
    for whole in sorted({tuple(c) for c in chain_of.values()}):
        chain = _segments(tree, whole)
        upper = [bool(re.search(r"up(per)?leg|legup|uparm|armup", tree.words[j])) for j in chain]
        capped = capped_by[chain[0]] > 0
        if chain[0] in front:
            collared = len(chain) == 3 and upper[1]
            parts = ["collar", "shoulder", "elbow"] if collared else ["shoulder", "elbow", "wrist"]
        elif len(chain) >= 3 and upper[1] and not capped:
            parts = ["hip", "hip", "knee", "ankle"]
        else:
            parts = ["hip", "knee", "ankle", "foot"]
            if len(chain) >= 3:
                long.add(tree.sides[chain[0]])
        if len(chain) == 1 and re.search(r"low|knee|shin|calf|down", tree.words[chain[0]]):
            parts = parts[1:]
        rank = -1
        for joint in whole:
            rank += joint in chain
            out[joint] = tree.sided(joint, parts[min(rank, len(parts) - 1)])
    for joint in tree.of("foot"):
        arm = "front" in tree.words[joint]
        out[joint] = tree.sided(joint, "wrist" if arm else "foot" if tree.sides[joint] in long else "ankle")


def _segments(tree: _Tree, chain: tuple[int, ...]) -> list[int]:
    """The first bone of each segment of a leg: `thigh.L.001` below `thigh.L` is its second half, unless all bones of
    the leg are called alike, and a bone that is but a knee is none.
    """
    copies = [tree.copies[joint] for joint in chain]
    firsts = [joint for rank, joint in enumerate(chain) if rank == 0 or copies[rank] != copies[rank - 1]]
    firsts = firsts if len(firsts) > 1 else list(chain)
    if tree.positions is None or len(firsts) < 3:
        return firsts
    ends = tree.positions[[*firsts, *(tree.children[chain[-1]] or chain)[:1]]]
    length = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    return [
        joint
        for joint, far in zip(firsts, length, strict=True)
        if far > KNEE * length.max() or joint in (chain[0], chain[-1])
    ]


def _flippers(tree: _Tree, out: np.ndarray) -> None:
    flippers = tree.of("flipper")
    rank = tree.passed(flippers)
    for joint in flippers:
        out[joint] = tree.sided(joint, ("shoulder", "elbow", "wrist")[min(rank[joint], 2)])


def _spread(joints: list[int], out: np.ndarray) -> None:
    """Spine bones over the three spine handles: one takes the middle, two the ends."""
    parts = (_H["spine1"], _H["spine2"], _H["spine3"])
    for rank, joint in enumerate(joints):
        out[joint] = parts[round(rank * 2 / (len(joints) - 1)) if len(joints) > 1 else 1]


def _trunk(tree: _Tree, out: np.ndarray) -> None:
    """Pelvis, spine and tail, which rigs name in the most ways."""
    pelvis, limbs = _H["pelvis"], {"leg", "hip_bone"}
    tail = tree.of("tail", "sting")
    insect = any("thorax" in tree.words[j] for j in tree.of("spine"))
    spine = tree.of("spine", *(() if insect else ("abdomen",)))
    if insect:
        tail = tree.of("abdomen") + tail
    swims = not tree.of("leg", "arm_leg", "hips") and bool(tree.of("tail")) and len(spine) >= 3
    if tree.of("main"):
        mains = tree.of("main")
        middle = len(mains) // 2 if len(mains) > 4 else 1
        last = middle - (len(mains) > 4)
        out[mains[: last + 1]] = pelvis
        if middle > 1:
            out[mains[1:2]] = _H["spine2"]
        out[mains[0]] = _H["head"]
        tail = mains[max(last + 1, 2 if middle > 1 else 1) :]
    elif swims:  # Spine1 is behind the head, the middle of the fish is its pelvis, what follows drives the tail
        out[spine[0]], out[spine[1]] = _H["spine2"], pelvis
        tail = spine[2:] + tail
        for joint in tree.of("root"):
            if tree.parents[joint] < 0:
                out[joint] = pelvis
    elif tree.of("chest_bone"):  # four-legged: Back, Hips, Body, Torso, Shoulders from the rump to the neck
        out[tree.of("chest_bone")] = _H["spine3"]
        out[tree.of("back")] = pelvis
        out[tree.of("body")] = _H["spine1"]
        out[spine] = _H["spine2"]
        out[[joint for joint in tree.of("root") if tree.child_kinds(joint) & limbs]] = pelvis
    else:
        for joint in tree.of("back"):
            if tree.child_kinds(joint) & (limbs | {"tail"}):
                out[joint] = pelvis
            else:
                spine.append(joint)
        for joint in tree.of("body"):
            if tree.child_kinds(joint) & (limbs | {"hips", "back"}) or not (out == pelvis).any():
                out[joint] = pelvis
            else:
                spine.insert(0, joint)
        for joint in tree.of("root"):
            below = tree.child_kinds(joint)
            if below & limbs or (below & {"spine", "hips"} and not (out == pelvis).any()):
                out[joint] = pelvis
        spine = _without_head(tree, _by_height(tree, spine), out)
        _spread(spine, out)
        if tree.mass is not None and spine and not (tree.mass[out == pelvis] > 0).any():
            heavy = [j for j in spine if tree.mass[j] > 0]
            if heavy:
                out[heavy[0]] = pelvis
                _spread(heavy[1:], out)
    above, under = tree.passed(tail), dict.fromkeys(tail, 0)
    for joint in reversed(tree.order):
        if joint in under:
            under[joint] = max((1 + under[child] for child in tree.children[joint] if child in under), default=0)
            out[joint] = _H["tail" if above[joint] < (above[joint] + under[joint] + 1) / 2 else "tail_tip"]


def _without_head(tree: _Tree, spine: list[int], out: np.ndarray) -> list[int]:
    """The spine bones below the arms. Where no name tells of a head or a neck and the spine goes on above the arms, its
    last bone is the head and those before it the neck, as in Rigify's `spine.004` to `spine.006`.
    """
    arms = tree.of("collar", "shoulder")
    bearing = set()
    for joint in arms:
        above = tree.parents[joint]
        while above >= 0 and above not in bearing:
            bearing.add(above)
            above = tree.parents[above]
    last = [joint for joint in spine if joint in bearing][-1:]
    beyond = tree.passed(last)
    over = [joint for joint in spine if joint not in bearing and beyond[joint]]
    if not over or tree.of("head", "neck"):
        return spine
    out[over] = _H["neck"]
    out[over[-1]] = _H["head"]
    return [joint for joint in spine if joint not in over]


def _by_height(tree: _Tree, joints: list[int]) -> list[int]:
    """In order along the body: by depth in the hierarchy, and from below where two are side by side."""
    height = np.zeros(len(tree.parents)) if tree.positions is None else tree.positions[:, 1]
    return sorted(joints, key=lambda j: (tree.depth[j], float(height[j]), j))


def _between(tree: _Tree, out: np.ndarray) -> None:
    """Where no name tells of an upper limb, the bone that its lower one hangs on is it, if nothing else is known of it:
    `bicep.L` between `collar.L` and `forearm.L`.
    """
    for side in ("left", "right"):
        for upper, lower in (("shoulder", "elbow"), ("hip", "knee")):
            if (out == _H[f"{side}_{upper}"]).any():
                continue
            lowers = np.flatnonzero(out == _H[f"{side}_{lower}"]).tolist()
            first = min(lowers, key=lambda j: tree.depth[j], default=-1)
            above = tree.parents[first] if first >= 0 else -1
            if above >= 0 and out[above] == NO_HANDLE and tree.parents[above] >= 0:
                out[above] = _H[f"{side}_{upper}"]


def _empty_hands(tree: _Tree, out: np.ndarray) -> None:
    """Where no hand bone moves anything, the first finger bones are the hand."""
    for side, word in ((1, "left"), (-1, "right")):
        hands = out == _H[f"{word}_wrist"]
        if hands.any() and (tree.mass is None or (tree.mass[hands] > 0).any()):
            continue
        for joint in tree.of("fingers"):
            if tree.sides[joint] == side and tree.parents[joint] >= 0 and tree.kinds[tree.parents[joint]] != "fingers":
                out[joint] = _H[f"{word}_wrist"]


def limb_parents(handles: np.ndarray, parents: Sequence[int] | np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Parents with loose limb ends put back on their limbs, for posing.

    Rigs made for inverse kinematics hang the feet on the root, so that turning the knee would leave the foot behind. A
    joint whose ancestors hold no part of its own limb gets the nearest joint of the next part up the limb as its
    parent.

    Args:
        handles: Handle of each joint (`handle_of_joints`), shape (J,).
        parents: Parent of each joint, shape (J,).
        positions: Joint positions [m], shape (J, 3).

    Returns:
        Parent of each joint, shape (J,).
    """
    out = np.array(parents, np.int64)
    above = [0] * len(out)  # bit h for handle h

    def settle(joints: Iterable[int]) -> None:
        for joint in joints:
            if out[joint] >= 0:
                above[joint] = above[out[joint]] | (1 << int(max(handles[out[joint]], 0)))

    children: list[list[int]] = [[] for _ in out]
    for joint, parent in enumerate(out.tolist()):
        if parent >= 0:
            children[parent].append(joint)
    order = bone_order(out)
    settle(order)
    for joint in order:
        handle = int(handles[joint])
        limb = [part for part in line_up(handle, HANDLE_PARENTS)[1:] if part > 0] if handle > 0 else []
        if not limb or any(above[joint] >> part & 1 for part in (*limb, handle)):
            continue
        below = dict.fromkeys([joint])
        for bone in (queue := [joint]):
            fresh = [child for child in children[bone] if child not in below]
            below |= dict.fromkeys(fresh)
            queue += fresh
        for part in limb:
            candidates = [bone for bone in np.flatnonzero(handles == part).tolist() if bone not in below]
            if candidates:
                distances = np.linalg.norm(positions[candidates] - positions[joint], axis=1)
                if out[joint] >= 0:
                    children[out[joint]].remove(joint)
                out[joint] = candidates[int(distances.argmin())]
                children[out[joint]].append(joint)
                settle(below)
                break
    return out


_CLEAR = 0.85  # least cosine between a direction and the axis that it is taken for
_TOPS = [_H["left_hip"], _H["right_hip"]]
_FEET = list(map(_H.__getitem__, ["left_foot", "right_foot", "left_ankle", "right_ankle", "left_knee", "right_knee"]))


def rig_axes(
    names: Sequence[str], parents: Sequence[int] | np.ndarray, positions: np.ndarray
) -> tuple[str, str] | None:
    """The axis that is up and the axis that a rig faces, such as ("+y", "+z").

    Legs say what is down, and what is left and right by name says the rest.

    Args:
        names: Joint names, length J.
        parents: Parent of each joint, -1 for a root, shape (J,).
        positions: Joint positions in the rest pose [m], shape (J, 3).

    Returns:
        None where the names or the places leave a doubt: no two legs, no left and right, or directions between the
            axes.
    """
    handles = handle_of_joints(names, parents)
    centres = {int(h): positions[handles == h].mean(axis=0) for h in np.unique(handles) if h != NO_HANDLE}
    both = [(a, b) for a, b in zip(_FEET[::2], _FEET[1::2], strict=True) if a in centres and b in centres]
    if not both or any(top not in centres for top in _TOPS):
        return None
    up = np.mean([centres[top] for top in _TOPS], axis=0) - np.mean([centres[foot] for foot in both[0]], axis=0)
    mirrored = [(h, m) for h, m in enumerate(HANDLE_MIRROR) if HANDLE_NAMES[h].startswith("left_")]
    pairs = [centres[h] - centres[m] for h, m in mirrored if h in centres and m in centres]
    lengths = np.linalg.norm(pairs, axis=1)
    left = np.sum(pairs, axis=0)
    if np.linalg.norm(left) < 0.7 * lengths.sum():  # left and right of the parts do not agree
        return None
    found = [_axis(direction) for direction in (up, np.cross(left, up))]
    return (found[0], found[1]) if found[0] and found[1] and found[0][1] != found[1][1] else None


def _axis(direction: np.ndarray) -> str:
    """The axis that a direction lies along; "" where it lies along none."""
    shares = np.array([axis_vector(axis) for axis in AXES]) @ direction / max(float(np.linalg.norm(direction)), 1e-12)
    best = int(shares.argmax())
    return AXES[best] if shares[best] >= _CLEAR else ""


def resolve_joints(handles: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Handles of joints where those whose names say nothing join their nearest ancestor that has one, or the root.

    Args:
        handles: Handle of each joint, -1 for none, shape (J,).
        parents: Parent of each joint, -1 for roots, any order, shape (J,).

    Returns:
        Shape (J,), none of them -1.
    """
    out = np.array(handles, np.int64)
    for joint in bone_order(np.asarray(parents)):
        if out[joint] == NO_HANDLE:
            out[joint] = max(int(out[parents[joint]]), 0) if parents[joint] >= 0 else 0
    return out


def rig_handles(character: Character, least: int = 2) -> Handles:
    """Handles of a rigged character from its own bones: the weights of all bones of a part added up. CharacterError if
    it has no rig, or its bones have no names that tell which part they move.

    Args:
        character: With a rig; +Y up and facing +Z.
        least: How many of the 30 parts the bones' names must tell at the least.
    """
    rig = character.rig
    if rig is None:
        raise CharacterError(
            f"{character.name}: there is no rig in this file to take the handles from; let them be predicted"
        )
    dense = rig.dense_weights()
    areas = character.areas
    mass = (dense * areas[:, None]).sum(axis=0)
    known = handle_of_joints(rig.names, rig.parents, rig.positions, mass)
    if len(np.unique(known[known != NO_HANDLE])) < least:
        some = ", ".join(rig.names[:3])
        raise CharacterError(
            f"{character.name}: the names of the rig's {len(rig.names)} bones ({some} ...) do not tell which part each "
            "moves; rename them (hips, spine, head, left_hand ...) or let the handles be predicted"
        )
    weights = dense @ np.eye(HANDLE_COUNT, dtype=np.float32)[resolve_joints(known, rig.parents)]
    total = weights.sum(axis=1, keepdims=True)
    weights = np.where(total > 1e-6, weights / np.maximum(total, 1e-6), np.eye(1, HANDLE_COUNT, dtype=np.float32))
    return Handles(handle_positions(character.vertices, weights, areas), weights)
