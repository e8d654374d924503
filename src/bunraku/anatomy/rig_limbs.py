"""The limbs of a rig by the shape of its tree and by the skin that its bones hold, whatever their names: of bodies on
four legs and on more.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from bunraku.anatomy.handles.limbs import ARMS, LEGS
from bunraku.core.animation import bone_order
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.body.reference import handle_positions
from bunraku.core.character import Character, Handles, Rig
from bunraku.core.motion import line_up

# Of legs that are found by the shape of the tree, over the longest; chosen by eye on two spiders.
ALIKE_LEGS = 0.6  # how long a leg is at the least
LEVEL = 0.15  # how much higher than the lowest a tip is
NEAR_MIDDLE = 0.25  # how far to the side a leg begins, and what is before or behind the legs
SHORT = 0.1  # a bone that is shorter goes with the one above it
_SPARE = (
    "left_wing", "right_wing", "left_fingers", "right_fingers", "left_foot", "right_foot", "left_collar",
    "right_collar", "head_top", "face", "spine3", "tail_tip",
)  # fmt: skip
"""Handles of which a body on many legs can do without."""
_LIMBS = [*LEGS, *ARMS]
_LEGS_AND_ARMS = [handle for limb in _LIMBS for handle in limb]
_TAIL = [HANDLE_NAMES.index("tail"), HANDLE_NAMES.index("tail_tip")]
_NECK, _HEAD = HANDLE_NAMES.index("neck"), HANDLE_NAMES.index("head")
_TRUNK = [HANDLE_NAMES.index(name) for name in ("spine1", "spine2", "spine3")]
_FRONT = [_NECK, _HEAD, HANDLE_NAMES.index("head_top"), HANDLE_NAMES.index("face")]
_COLLARS = [HANDLE_NAMES.index("left_collar"), HANDLE_NAMES.index("right_collar")]
# Of two pairs of legs; chosen by eye on the 68 animals of 0 A.D.
ONE_SIDE = 0.75  # share of its skin that a limb has on its side; halfway from a trunk to a leg
ASIDE = 0.3  # how far a leg is from the middle at the least, and a tail at the most, over the farthest leg
NEAR_GROUND = 0.15  # how far over the floor a leg ends at the most, over the height
ALIKE_PAIR = 0.3  # how far apart along the body the legs of a pair are, over the distance of the pairs
ANCHOR = 0.1  # a bone that begins in the middle and holds less of the skin of its leg is part of the trunk
STUB = 0.5  # so is one that is shorter than this share of the next one, before three others
# Elbows of front legs bend backward: what bends so far ahead, over the length, ends a shoulder blade. Seen on a wolf
# whose leg lay over its back; of 41 rigs on four legs it finds blades in seven, five of which are named so.
ELBOW = 0.1
TOES = 0.2  # a bone that begins so low over the floor, over the height of the leg, is a foot


def legs_of_rig(character: Character) -> Handles | None:
    """The handles of a body whose bones make three pairs of legs or more, each leg with handles of its own, by the
    shape of the tree alone; None for other rigs.

    Legs are chains of bones that leave the trunk near the middle, with a partner on the other side, about as long as
    the longest, and whose tips are about level. The hindmost are a person's legs, the foremost its arms, and those
    between have handles that nothing else needs.
    """
    rig = character.rig
    if rig is None:
        return None
    order, parents, at = bone_order(rig.parents), rig.parents, rig.positions
    bears = np.bincount(parents[parents >= 0], minlength=len(parents))
    chains = []
    for tip in np.flatnonzero((bears == 0) & (parents >= 0)).tolist():
        chain = [tip]
        while parents[chain[-1]] >= 0 and bears[parents[chain[-1]]] == 1:
            chain.append(int(parents[chain[-1]]))
        if len(chain) > 2 and parents[chain[-1]] >= 0:
            chains.append(chain[::-1])
    reach = np.array([np.linalg.norm(at[chain[-1]] - at[chain[0]]) for chain in chains])
    long = [chain for chain, far in zip(chains, reach, strict=True) if far > ALIKE_LEGS * reach.max()]
    lowest = min((at[chain[-1], 1] for chain in long), default=0.0)
    legs = [chain for chain in long if at[chain[-1], 1] < lowest + LEVEL * reach.max()
            and abs(at[chain[0], 0]) < NEAR_MIDDLE * reach.max()]  # fmt: skip
    sides = [sorted((leg for leg in legs if side * at[leg[-1], 0] > 0), key=lambda leg: at[leg[-1], 2])
             for side in (1, -1)]  # fmt: skip
    count = len(sides[0])
    if count < 3 or len(sides[1]) != count:
        return None
    handles, roles = np.zeros(len(parents), int), np.arange(HANDLE_COUNT)
    start = np.mean([at[leg[0], 2] for leg in legs])
    for bone in order:  # before the legs is the head, behind them the tail, and each bears what is below it
        above = int(parents[bone])
        if above >= 0:
            part = HANDLE_NAMES.index("head") if at[bone, 2] > start else _TAIL[0]
            beyond = abs(at[bone, 2] - start) > NEAR_MIDDLE * reach.max()
            handles[bone] = handles[above] or (part if beyond else 0)
    spare = iter(map(HANDLE_NAMES.index, _SPARE))
    for number in range(count):
        for side, own in enumerate(sides):
            leg, columns = own[number], _LIMBS[side][:3]
            if number == count - 1:
                columns = _LIMBS[2 + side][:3]
            elif number:
                columns = [handle for _, handle in zip(columns, spare, strict=False)]
            roles[columns] = _LIMBS[side][: len(columns)]
            if not columns:
                return None
            length = np.linalg.norm(np.diff(at[leg], axis=0), axis=1)
            bent = [bone for bone, far in zip(leg, length, strict=False) if far > SHORT * length.sum()]
            for bone in leg:
                place = max(sum(leg.index(bone) >= leg.index(other) for other in bent) - 1, 0)
                handles[bone] = columns[min(place, len(columns) - 1)]
    weights = rig.dense_weights() @ np.eye(HANDLE_COUNT, dtype=np.float32)[handles]
    weights[:, 0] += 1 - weights.sum(axis=1)
    return Handles(handle_positions(character.vertices, weights, character.areas), weights, roles=roles)


def four_legs_of_rig(character: Character, known: np.ndarray) -> np.ndarray | None:
    """Handle of each bone, -1 for none, shape (J,), of a body on four legs that faces +Z; None of other bodies.

    A leg is a branch of the tree whose skin is on one side and reaches the ground. Two pairs, one before the other
    rather than over it, make a body on four legs. Names say what they say of the trunk, the neck, the head and the
    tail, as far as these are where they belong.

    Args:
        character: In its rest pose.
        known: The handle of each bone by its name, shape (J,).
    """
    rig = character.rig
    if rig is None:
        return None
    tree = _SkinTree(character, rig)
    floor = float(character.vertices[character.surface, 1].min())
    limbs = [limb for limb in tree.limbs() if tree.low[limb].min() < floor + NEAR_GROUND * character.height]
    wide = ASIDE * max((abs(float(tree.middle(limb)[0])) for limb in limbs), default=0.0)
    limbs = [limb for limb in limbs if abs(tree.middle(limb)[0]) > wide]
    pairs = [sorted((limb for limb in limbs if side * tree.middle(limb)[0] > 0), key=lambda limb: tree.middle(limb)[2])
             for side in (1, -1)]  # fmt: skip
    if [len(side) for side in pairs] != [2, 2] or min(len(limb) for limb in limbs) < 2:
        return None
    middles = np.array([[tree.middle(limb) for limb in side] for side in pairs])  # by side, hind and front
    away = middles[:, 1].mean(axis=0) - middles[:, 0].mean(axis=0)
    if away[2] < abs(away[1]) or np.abs(middles[0, :, 2] - middles[1, :, 2]).max() > ALIKE_PAIR * away[2]:
        return None
    out = tree.trunk(known, pairs, middles[:, :, 2].mean(axis=0), wide)
    if 0 not in out or _HEAD not in out:
        return None
    for side, (hind, front) in enumerate(pairs):
        tree.spread(hind, LEGS[side], floor, out, 0 if out[rig.parents[hind[0]]] == 0 else -1)
        tree.spread(front, ARMS[side], floor, out, _COLLARS[side])
    return out


class _SkinTree:
    """The bones of a rig with the skin that they hold."""

    def __init__(self, character: Character, rig: Rig):
        self.parents, self.at, self.order = rig.parents, rig.positions.astype(float), bone_order(rig.parents)
        count, across = len(self.parents), character.vertices[:, 0]
        held = rig.weights * character.areas[:, None]

        def of_bones(shares: np.ndarray) -> np.ndarray:
            return np.bincount(rig.indices.ravel(), (held * shares[:, None]).ravel(), minlength=count)

        main = np.take_along_axis(rig.indices, rig.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
        self.low = np.full(count, np.inf)  # the lowest skin of each bone [m]
        np.minimum.at(self.low, main[character.surface], character.vertices[character.surface, 1])
        self.own = of_bones(np.ones(len(across)))  # skin of each bone
        self.moments = np.stack([of_bones(axis) for axis in character.vertices.T], axis=1)
        sides = np.stack([of_bones(side * across > 0) for side in (1, -1)])
        self.children: list[list[int]] = [[] for _ in range(count)]
        for bone in reversed(self.order):
            if self.parents[bone] >= 0:
                self.children[self.parents[bone]].append(bone)
                sides[:, self.parents[bone]] += sides[:, bone]
        self.skin = sides.sum(axis=0)  # of each bone and all below it
        self.sided = (self.skin > 0) & (sides.max(axis=0) > ONE_SIDE * self.skin)

    def below(self, bone: int) -> list[int]:
        """A bone and all below it, from the body outwards."""
        out = [bone]
        for above in out:
            out += self.children[above]
        return out

    def limbs(self) -> list[list[int]]:
        """The branches whose skin is on one side, each with its first bone at the beginning."""
        return [self.below(bone) for bone in self.order
                if self.sided[bone] and (self.parents[bone] < 0 or not self.sided[self.parents[bone]])]  # fmt: skip

    def middle(self, bones: list[int]) -> np.ndarray:
        """The middle of the skin of some bones [m], shape (3,)."""
        return np.asarray(self.moments[bones].sum(axis=0) / max(float(self.own[bones].sum()), 1e-12))

    def spread(self, limb: list[int], parts: list[int], floor: float, out: np.ndarray, collar: int) -> None:
        """Give the bones of a leg its parts, from the body outwards, in place: three segments and a foot. What comes
        before them is its `collar`.
        """
        tips = [bone for bone in limb if self.own[bone] > 0 and not self.skin[self.children[bone]].any()]
        lines = [[bone for bone in line_up(tip, self.parents)[::-1] if bone in limb] for tip in tips]
        line = max(lines, key=lambda line: float(np.linalg.norm(np.diff(self.at[line], axis=0), axis=1).sum()))
        end = np.array([self.at[line[-1]][0], floor, self.at[line[-1]][2]])
        out[limb] = -1
        while len(line) > 2:
            points = [*self.at[line], end]
            length = [float(np.linalg.norm(below - above)) for above, below in pairwise(points)]
            upper = [place for place in range(len(line)) if points[place][1] - floor > TOES * (points[0][1] - floor)]
            bare = self.own[line[0]] < ANCHOR * self.own[limb].sum() and abs(points[0][0]) < STUB * abs(points[1][0])
            straight = (end - points[0]) / max(float(np.linalg.norm(end - points[0])), 1e-12)
            ahead = (points[1] - points[0]) @ (np.array([0, 0, 1]) - straight[2] * straight)
            blade = collar in _COLLARS and ahead > ELBOW * sum(length)
            if len(upper) > 2 and (bare or blade or length[0] < STUB * length[1]):
                out[line.pop(0)] = collar
            elif len(upper) > 3:
                del line[min(upper[1:], key=lambda place: length[place])]  # it goes along with the one above
            else:
                break
        out[line] = [parts[min(rank, len(parts) - 1)] for rank in range(len(line))]

    def trunk(self, known: np.ndarray, pairs: list[list[list[int]]], along: np.ndarray, wide: float) -> np.ndarray:
        """Handles of what is no leg, shape (J,): the bone that bears the hind legs is the pelvis, what bears the front
        ones the spine; of the branches that bear none, the one ahead is neck and head, and the one behind the tail.
        """
        legs = [leg for side in pairs for leg in side]
        limb = {bone for leg in legs for bone in leg}
        bears = np.zeros(len(self.parents), int)
        for leg in legs:
            for bone in line_up(leg[0], self.parents)[1:]:
                bears[bone] += 1
        hind = [set(line_up(side[0][0], self.parents)[1:]) for side in pairs]
        pelvis = next((b for b in line_up(pairs[0][0][0], self.parents)[1:] if b in hind[1]), -1)
        above = set(line_up(pelvis, self.parents)) if pelvis >= 0 else set()
        out = np.full(len(self.parents), -1)
        heads, tails = list[int](), list[int]()
        for bone in self.order:
            part, parent = int(known[bone]), int(self.parents[bone])
            if bone in limb:
                continue
            if bears[bone]:
                share = (self.at[bone, 2] - along[0]) / max(along[1] - along[0], 1e-9)
                out[bone] = _TRUNK[int(np.clip(3 * share, 0, 2))] if bone not in above else 0 if part == 0 else -1
                out[bone] = part if part in (*_TRUNK, _NECK) else out[bone]
            elif parent < 0 or bears[parent]:
                below = self.below(bone)
                out[below] = np.where(np.isin(known[below], _LEGS_AND_ARMS), -1, known[below])
                aside, _, ahead = self.middle(below)
                if self.skin[bone] and abs(aside) < wide:
                    (heads if ahead > along[1] else tails if ahead < along[0] else []).append(bone)
        if pelvis >= 0:
            out[pelvis] = 0
        self._headed(heads, known, out)
        if tails:
            first = max(tails, key=lambda bone: self.skin[bone])
            depth = np.array([len(line_up(bone, self.parents)) for bone in self.below(first)])
            out[self.below(first)] = np.where(2 * depth < depth.min() + depth.max() + 1, *_TAIL)
        return out

    def _headed(self, branches: list[int], known: np.ndarray, out: np.ndarray) -> None:
        """Neck and head on the branch ahead that holds the most, in place."""
        if not branches:
            return
        bones = self.below(max(branches, key=lambda bone: self.skin[bone]))
        named = _HEAD in known[bones]
        out[bones] = np.where(np.isin(known[bones], _FRONT), known[bones], -1)
        if named:
            return
        head = bones[0]
        while len(more := [bone for bone in self.children[head] if self.skin[bone] > 0]) == 1:
            out[head], head = _NECK, more[0]
        out[head] = _HEAD
