"""Which part of a body each rigid block is: by its name where that is understood, by where it is where not."""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np

from bunraku.body.layout import HANDLE_NAMES
from bunraku.handles.blocks.contacts import BlockShapes
from bunraku.skeletons.bone_words import block_of_name

__all__ = ["BlockParts", "block_parts"]

TOUCH = 0.03  # blocks touch that are no farther apart, over the height
FLOOR = 0.06  # what ends so near to the lowest point stands on it, over the height
ASIDE = 0.2  # what is so far from the middle of the trunk is at a side of it, over half of its width
SHORT = 0.55  # a second piece so short is a hand or a foot, over the length of the first
_H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}
_LIMBS = ("arm", "leg", "front leg", "wing")


@dataclass(frozen=True, eq=False)
class BlockParts:
    """What blocks are.

    Args:
        handles: Handle of each block, shape (B,).
        upright: Whether it stands on two legs or none, and not on four.
        named: Whether names told the limbs of both sides.
        trunk: The blocks of the trunk.
    """

    handles: np.ndarray
    upright: bool
    named: bool
    trunk: list[int]


@dataclass(frozen=True, eq=False)
class _Branch:
    """What hangs on the trunk by one block: its blocks from there on, what it is, and the side (1 left, -1 right)."""

    blocks: list[int]
    limb: str
    side: int
    named: bool


def block_parts(shapes: BlockShapes) -> BlockParts | None:
    """The part that each block is; None where they make no body with two arms, or with two or four legs."""
    words = [block_of_name(name) for name in shapes.blocks.names]
    tree = _Tree(shapes, words)
    trunk = tree.trunk()
    branches = [tree.branch(block, trunk) for block in tree.hanging(trunk)]
    limbs = _paired(branches, shapes)
    if limbs is None:
        return None
    front = [branch for branch in limbs if branch.limb == "front leg"]
    handles = np.full(len(words), -1)
    _fill_trunk(handles, trunk, shapes, upright=not front)
    for branch in limbs:
        _fill_limb(handles, branch, tree)
    for block in tree.order:  # what is no part of its own goes along with what it hangs on
        if handles[block] < 0:
            handles[block] = handles[tree.parents[block]]
    sides = {(branch.limb, branch.side) for branch in limbs if branch.named}
    named = any((limb, 1) in sides and (limb, -1) in sides for limb in _LIMBS)
    return BlockParts(handles, not front, named, trunk)


class _Tree:
    """Blocks as they hang on one another, from a block of the trunk on."""

    def __init__(self, shapes: BlockShapes, words: list[tuple[str, str]]):
        self.shapes, self.words = shapes, words
        count = len(words)
        middle = 0.5 * float(shapes.low[:, 0].min() + shapes.high[:, 0].max())
        self.sides = (shapes.low[:, 0] > middle).astype(int) - (shapes.high[:, 0] < middle)  # 0 goes over the middle
        touching = (shapes.gaps < TOUCH).sum(axis=1)
        likely = [block for block in range(count) if words[block][0] == "trunk"]
        likely = likely or np.flatnonzero(self.sides == 0).tolist() or list(range(count))
        self.root = max(likely, key=lambda block: (touching[block], shapes.areas[block]))
        self.parents, self.order = self._hung()

    def _cost(self, one: int, other: int) -> float:
        """How unlikely it is that two blocks are jointed."""
        authored = self.shapes.blocks.above[one] == other or self.shapes.blocks.above[other] == one
        if authored:
            return 0.1
        first, second = self.words[one][0], self.words[other][0]
        apart = "trunk" not in (first, second) and bool(first and second) and "carried" not in (first, second)
        across = self.sides[one] * self.sides[other] < 0
        gap = float(self.shapes.gaps[one, other])
        return 1 + gap / TOUCH + 10 * (gap > TOUCH) + 10 * (across or (apart and first != second))

    def _hung(self) -> tuple[np.ndarray, list[int]]:
        """The block that each hangs on, -1 for the root, and all blocks with those first on which others hang."""
        count = len(self.words)
        parents, best = np.full(count, -1), np.full(count, np.inf)
        best[self.root], queue, order = 0.0, [(0.0, self.root)], []
        while queue:
            far, block = heappop(queue)
            if block in order:
                continue
            order.append(block)
            for other in range(count):
                cost = far + self._cost(block, other) if other not in order else np.inf
                if cost < best[other]:
                    best[other], parents[other] = cost, block
                    heappush(queue, (cost, other))
        return parents, order

    def below(self, block: int) -> list[int]:
        """A block and what hangs on it, nearest first."""
        out = [block]
        for member in out:
            out.extend(np.flatnonzero(self.parents == member).tolist())
        return out

    def trunk(self) -> list[int]:
        """The blocks of the trunk: those named so that hang on one another, and those on which limbs of both sides
        stand.
        """
        shapes, out = self.shapes, [self.root]
        floor = float(shapes.low[:, 1].min()) + FLOOR * shapes.height
        for member in out:
            for child in np.flatnonzero(self.parents == member).tolist():
                feet = {int(self.sides[other]) for other in self.below(child)[1:] if shapes.low[other, 1] < floor}
                limb = self.words[child][0]
                if limb == "trunk" or (limb == "" and {-1, 1} <= feet):
                    out.append(child)
        return out

    def hanging(self, trunk: list[int]) -> list[int]:
        """The blocks that hang on the trunk."""
        return [block for block in self.order if block not in trunk and int(self.parents[block]) in trunk]

    def branch(self, block: int, trunk: list[int]) -> _Branch:
        """What hangs on the trunk by a block."""
        shapes, blocks = self.shapes, self.below(block)
        low, high = shapes.low[blocks].min(axis=0), shapes.high[blocks].max(axis=0)
        trunk_low, trunk_high = shapes.low[trunk].min(axis=0), shapes.high[trunk].max(axis=0)
        middle, half = 0.5 * (trunk_low + trunk_high), 0.5 * (trunk_high - trunk_low)
        aside = float(0.5 * (low + high)[0] - middle[0])
        side = 0 if abs(aside) < ASIDE * half[0] else int(np.sign(aside))
        named = next((self.words[member][0] for member in blocks if self.words[member][0] not in ("", "carried")), "")
        if named == "" and all(self.words[member][0] == "carried" for member in blocks):
            named = "carried"
        limb = named or self._shaped(block, low, high, middle, half, side)
        return _Branch(blocks, limb, side, bool(named))

    def _shaped(
        self, block: int, low: np.ndarray, high: np.ndarray, middle: np.ndarray, half: np.ndarray, side: int
    ) -> str:
        """What a branch without a telling name is, by its box and the trunk's."""
        shapes, center = self.shapes, 0.5 * (low + high)
        floor = float(shapes.low[:, 1].min())
        if side and low[1] < floor + FLOOR * shapes.height and center[1] < middle[1]:
            return "leg"
        if side and center[1] > floor + 0.2 * shapes.height:
            return "arm"
        if side:
            return "carried"
        if center[2] < middle[2] - half[2]:
            return "tail" if (high - low)[2] > 0.5 * (high - low)[1] else "carried"
        above, before = center[1] > middle[1] + 0.5 * half[1], center[2] > middle[2] + half[2]
        return "head" if above or before else "carried"


def _paired(branches: list[_Branch], shapes: BlockShapes) -> list[_Branch] | None:
    """The branches that are limbs, one of a kind and side; None where they make no body."""
    legs = {side: [one for one in branches if "leg" in one.limb and one.side == side] for side in (1, -1)}

    def ahead(branch: _Branch) -> float:
        return float(shapes.centers[branch.blocks, 2].mean())

    def size(branch: _Branch) -> float:
        return float(shapes.areas[branch.blocks].sum())

    if len(legs[1]) != len(legs[-1]) or len(legs[1]) > 2:
        return None
    out = []
    for side in (1, -1):
        ordered = sorted(legs[side], key=ahead)
        for branch, limb in zip(ordered, ("leg", "front leg"), strict=False):
            out.append(_Branch(branch.blocks, limb, side, branch.named))
    four = len(legs[1]) == 2
    for limb in ("arm", "wing", "head", "tail"):
        sides = (1, -1) if limb in _LIMBS else (1, 0, -1)
        found = [one for one in branches if one.limb == limb and one.side in sides]
        if limb == "arm" and four:
            continue
        groups = [[one for one in found if one.side == side] for side in sides] if limb in _LIMBS else [found]
        out += [max(group, key=size) for group in groups if group]
    arms = sum(branch.limb == "arm" for branch in out)
    return out if four or len(legs[1]) == 1 or arms == 2 else None


def _fill_trunk(handles: np.ndarray, trunk: list[int], shapes: BlockShapes, upright: bool) -> None:
    """The trunk: one block turns as its middle does where it stands upright, several from the pelvis on."""
    if len(trunk) == 1:
        handles[trunk[0]] = _H["spine2"] if upright else 0
        return
    ordered = sorted(trunk, key=lambda block: float(shapes.centers[block, 1 if upright else 2]))
    for rank, block in enumerate(ordered):
        share = rank / (len(ordered) - 1)
        handles[block] = (0, _H["spine1"], _H["spine2"], _H["spine3"])[round(3 * share)]


def _fill_limb(handles: np.ndarray, branch: _Branch, tree: _Tree) -> None:
    """The blocks of a limb from the trunk outwards; what is beside its chain is left."""
    chain = _chain(branch, tree)
    kinds, word = [tree.words[block][1] for block in chain], "left" if branch.side > 0 else "right"
    if branch.limb == "head":
        second = len(chain) > 1 and kinds[0] == "neck"
        for block, part in zip(chain, ("neck", "head") if second else ("head",), strict=False):
            handles[block] = _H[part]
    elif branch.limb in ("tail", "wing"):
        parts = ("tail", "tail_tip") if branch.limb == "tail" else (f"{word}_wing",)
        for block, part in zip(chain, parts, strict=False):
            handles[block] = _H[part]
    else:
        slots = ["hip", "knee", "ankle", "foot"] if branch.limb == "leg" else ["shoulder", "elbow", "wrist", "fingers"]
        if kinds[0] == "collar" and len(chain) > 1 and branch.limb == "arm":
            handles[chain[0]] = _H[f"{word}_collar"]
            chain, kinds = chain[1:], kinds[1:]
        for block, slot in zip(chain, _slots(chain, kinds, tree.shapes, branch.limb), strict=True):
            if slot >= 0:
                handles[block] = _H[f"{word}_{slots[slot]}"]


def _slots(chain: list[int], kinds: list[str], shapes: BlockShapes, limb: str) -> list[int]:
    """Which piece of a limb each block is, counted from the trunk; -1 for what goes along with the one before.

    The foot of a leg in one piece goes along with it: turned by itself it would be a knee.
    """
    extents = [float((shapes.high[block] - shapes.low[block]).max()) for block in chain]
    out, last = [0], 0
    for number in range(1, len(chain)):
        end = kinds[number] in ("wrist", "fingers", "foot", "toe", "front_foot", "hind_paw")
        end |= number == len(chain) - 1 and extents[number] < SHORT * extents[number - 1] and kinds[number] == ""
        slot = max(last + 1, 2) if end else last + 1
        if slot > 3 or (slot == 2 and last == 0 and limb != "arm"):
            out.append(-1)
            continue
        out.append(slot)
        last = slot
    return out


def _chain(branch: _Branch, tree: _Tree) -> list[int]:
    """The blocks of a limb, each hanging on the one before: those of the same name, or else the largest."""
    chain = [branch.blocks[0]]
    while True:
        below = [
            block for block in np.flatnonzero(tree.parents == chain[-1]).tolist() if tree.words[block][0] != "carried"
        ]
        own = [block for block in below if tree.words[block][0] == branch.limb] or below
        own = [block for block in own if tree.shapes.areas[block] > 0.05 * tree.shapes.areas[chain[0]]]
        if not own:
            return chain
        chain.append(max(own, key=lambda block: float(tree.shapes.areas[tree.below(block)].sum())))
