"""Figures of rigid blocks: a file's blocks, where they touch, which part of the body each one is, and their handles."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from heapq import heappop, heappush
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from bunraku.anatomy.names.bone_words import block_of_name
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES, HANDLE_PARENTS
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.closest import least_distance
from bunraku.core.geometry.graph import clean_mesh
from bunraku.core.geometry.surface import surface_points
from bunraku.files import Source

# Chosen by eye on the figures of benchmarks/rigid_blocks.md; CUT was measured on figures cut from one surface, which
# have .27 to .87.
LEAST, MOST = 3, 100  # blocks of a figure
WHOLE = 0.999  # weight with which a vertex belongs to one joint
COAT, PEER = 0.5, 0.25  # overlap of the boxes of two coats of one part, over either box
CUT = 0.1  # share of common rim edges from which on two blocks were cut from one surface


@dataclass(frozen=True, eq=False)
class Blocks:
    """The blocks of a character."""

    label: np.ndarray  # block of each vertex, -1 for those without faces, shape (V,)
    names: tuple[str, ...]  # what the file calls them, length B
    origins: np.ndarray  # where their nodes stand, about which their authors turned them [m], shape (B, 3)
    above: np.ndarray  # the block whose node is above each in the file, -1 for none, shape (B,)


def find_blocks(character: Character) -> Blocks | None:
    """The blocks of a character; None where it has too few, or one surface goes over several: also where it was
    cut into several nodes, whose rims then fit together.
    """
    blocks = _of_joints(character) if character.rig is not None else _of_nodes(character)
    if blocks is None or len(blocks.names) > MOST:
        return None
    blocks = _without_coats(character, blocks)
    if len(blocks.names) < LEAST:
        return None
    faces = blocks.label[character.faces]
    return blocks if (faces == faces[:, :1]).all() and _fitting(character, faces[:, 0]) < CUT else None


def _without_coats(character: Character, blocks: Blocks) -> Blocks:
    """The same with what lies in one place made one block, where the names differ by a number alone: a sheep's leg and
    the wool around it.
    """
    names = [re.sub(r"[\d_. ]+$", "", name).lower() for name in blocks.names]
    boxes = [character.vertices[blocks.label == block] for block in range(len(names))]
    low, high = np.array([box.min(axis=0) for box in boxes]), np.array([box.max(axis=0) for box in boxes])
    size = np.maximum(high - low, 1e-3 * float((high.max(axis=0) - low.min(axis=0)).max()))
    first = np.arange(len(names))
    for one, name in enumerate(names):
        for other in range(one):
            shared = np.prod(np.clip(np.minimum(high[one], high[other]) - np.maximum(low[one], low[other]), 0, None))
            less, more = sorted((size[one].prod(), size[other].prod()))
            if name and name == names[other] and shared > max(COAT * less, PEER * more):
                first[one] = first[other]
                break
    kept, number = np.unique(first, return_inverse=True)
    new = np.append(number, -1)  # the last entry is that of vertices without a block, and of none above
    above = new[blocks.above[kept]]
    above[above == np.arange(len(kept))] = -1
    return Blocks(new[blocks.label], tuple(blocks.names[block] for block in kept), blocks.origins[kept], above)


def _fitting(character: Character, owner: np.ndarray) -> float:
    """Share of the edges on the rims of blocks that lie on the rims of two; 0 where all blocks are closed.

    Args:
        character: V vertices, F faces.
        owner: Block of each face, shape (F,).
    """
    clean = clean_mesh(character.vertices, character.faces)
    corners = clean.index[character.faces]
    ends = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    real = ends[:, 0] != ends[:, 1]
    key, times = np.unique(
        np.stack([ends[real, 0] * len(clean.vertices) + ends[real, 1], np.tile(owner, 3)[real]]), axis=1,
        return_counts=True,
    )  # fmt: skip
    sides = np.unique(key[0, times == 1], return_counts=True)[1]
    return float(sides[sides > 1].sum() / max(sides.sum(), 1))


def _of_joints(character: Character) -> Blocks | None:
    rig = character.rig
    assert rig is not None
    if rig.weights[character.surface].max(axis=1).min() < WHOLE:
        return None
    rows = np.arange(len(rig.indices))
    joint = np.where(character.surface, rig.indices[rows, rig.weights.argmax(axis=1)], -1)
    used = np.unique(joint[joint >= 0])
    return _numbered(joint, used, rig.names, rig.positions, rig.parents)


def _of_nodes(character: Character) -> Blocks | None:
    source = character.source
    if not isinstance(source, Source) or not len(source.index):
        return None
    if int(source.index.max()) + 1 != len(character.vertices):
        return None
    nodes, parents = source.document.items("nodes"), source.tree.parents
    names = [str(node.get("name") or "")[:200] for node in nodes]
    label, start = np.full(len(character.vertices), -1), 0
    moved = np.tile(np.eye(4), (len(nodes), 1, 1))
    for part in source.parts:
        stop = start + sum(len(group.vertices) for group in part.groups)
        index = source.index[start:stop]
        start = stop
        if not len(index):
            continue
        owner = _named_above(part.node, names, parents, {other.node for other in source.parts})
        if (np.isin(label[index], [-1, owner], invert=True)).any():
            return None  # a seam was closed: what files call parts is one surface
        label[index] = owner
        if source.moved is not None:
            moved[owner] = source.moved[index[0]]
    label[~character.surface] = -1
    origins = np.einsum("nij,nj->ni", moved[:, :3, :3], source.tree.world[:, :3, 3]) + moved[:, :3, 3]
    return _numbered(label, np.unique(label[label >= 0]), names, origins, parents)


def _named_above(node: int, names: list[str], parents: np.ndarray, meshes: set[int]) -> int:
    """The node that names a mesh: its own, or one above it without a mesh, where that alone is understood."""
    above = node
    while block_of_name(names[above])[0] == "":
        above = int(parents[above])
        if above < 0 or above in meshes:
            return node
    return above if block_of_name(names[above])[0] in ("arm", "leg", "front leg", "head", "tail", "wing") else node


def _numbered(
    label: np.ndarray, used: np.ndarray, names: list[str] | tuple[str, ...], origins: np.ndarray, parents: np.ndarray
) -> Blocks:
    number = {int(node): block for block, node in enumerate(used)}
    above = []
    for node in used:
        other, steps = int(parents[node]), 0
        while other >= 0 and other not in number and steps < len(parents):
            other, steps = int(parents[other]), steps + 1
        above.append(number.get(other, -1))
    block_of = np.full(max(len(names), 1) + 1, -1)  # the last entry is that of vertices without one
    block_of[used] = np.arange(len(used))
    return Blocks(block_of[label], tuple(names[int(node)] for node in used), origins[used], np.array(above))


# Chosen by eye on the figures of benchmarks/rigid_blocks.md.
SPACING = 0.008  # of the points spread over a block, over the height
POINTS = (200, 6000)  # of a block, at the least and at the most
NEAR = 0.02  # points touch if they are at most this much farther apart than the nearest, over the height
REACH = 0.04  # a node marks a joint if it is this near to the boxes of both blocks, over the height
ALONG = 0.5  # share of its length from which on a block that touches another lies along it
ROUND = 1.25  # length over width from which on a block is long


@dataclass(frozen=True, eq=False)
class BlockShapes:
    """The surfaces of blocks as points."""

    blocks: Blocks
    points: list[np.ndarray]  # points spread over each block by area [m], a list of arrays (P, 3)
    areas: np.ndarray  # surface of each block [m^2], shape (B,)
    height: float  # of the character [m]

    @classmethod
    def of(cls, character: Character, blocks: Blocks) -> BlockShapes:
        """Spread the points."""
        vertices, height = character.vertices.astype(np.float64), character.height
        owner, step = blocks.label[character.faces[:, 0]], SPACING * character.height
        points, areas = [], []
        for block in range(len(blocks.names)):
            faces = character.faces[owner == block]
            corners = vertices[faces]
            double = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            area = float(np.linalg.norm(double, axis=1).sum()) / 2
            spread = surface_points(vertices, faces, int(np.clip(area / step**2, *POINTS)))[0]
            points.append(np.concatenate([spread, vertices[np.unique(faces)]]))
            areas.append(area)
        return cls(blocks, points, np.array(areas), height)

    @cached_property
    def low(self) -> np.ndarray:
        """Lowest corner of each block's box [m], shape (B, 3)."""
        return np.array([points.min(axis=0) for points in self.points])

    @cached_property
    def high(self) -> np.ndarray:
        """Highest corner of each block's box [m], shape (B, 3)."""
        return np.array([points.max(axis=0) for points in self.points])

    @property
    def centers(self) -> np.ndarray:
        """Middle of each block's box [m], shape (B, 3)."""
        return 0.5 * (self.low + self.high)

    @cached_property
    def gaps(self) -> np.ndarray:
        """Least distance between points of two blocks over the height, shape (B, B)."""
        count, trees = len(self.points), [cKDTree(points) for points in self.points]
        out = np.zeros((count, count))
        for block in range(count):
            for other in range(block):
                out[block, other] = out[other, block] = least_distance(trees[block], self.points[other]) / self.height
        return out

    def pivot(self, own: list[int], other: list[int]) -> np.ndarray:
        """About which point blocks turn on other blocks [m], shape (3,).

        That is where the node of theirs that touches the others stands, if that is near both; else the middle of the
        contact. Of a long block that lies along the other, as an arm that hangs beside the trunk does, it is the upper
        end of the contact.
        """
        first = min(own, key=lambda block: float(self.gaps[block, other].min()))
        onto = min(other, key=lambda block: float(self.gaps[first, block]))
        origin, reach = self.blocks.origins[first], REACH * self.height
        low = np.maximum(self.low[first], self.low[onto]) - reach
        high = np.minimum(self.high[first], self.high[onto]) + reach
        shared = np.flatnonzero(np.abs(self.blocks.origins - origin).max(axis=1) < 1e-6 * self.height)
        if (origin >= low).all() and (origin <= high).all() and len(shared) == 1:
            return np.asarray(origin, np.float64)
        mine, theirs = self.points[first], self.points[onto]
        gap, near = cKDTree(theirs).query(mine)
        touching = gap <= gap.min() + NEAR * self.height
        contact = 0.5 * (mine[touching] + theirs[near[touching]])
        spread = mine - mine.mean(axis=0)
        values, vectors = np.linalg.eigh(np.cov(spread.T))
        along = vectors[:, 2] * (1 if vectors[1, 2] >= 0 else -1)
        length = np.ptp(mine @ along)
        if values[2] > ROUND**2 * values[1] and np.ptp(contact @ along) > ALONG * length:
            width = float(np.sqrt(12 * values[1]))
            top = (mine @ along).max()
            upper = contact @ along > min(top, (contact @ along).max()) - width
            center = contact[upper].mean(axis=0)
            return np.asarray(center)
        return np.asarray(contact.mean(axis=0))


def away_from(points: np.ndarray, start: np.ndarray) -> np.ndarray:
    """The direction in which a block leads away from its joint, unit, shape (3,): its longest axis where it is long, or
    that of its middle.

    Args:
        points: Spread over its surface [m], shape (P, 3).
        start: The joint [m], shape (3,).
    """
    middle = points.mean(axis=0)
    values, vectors = np.linalg.eigh(np.cov((points - middle).T))
    away = middle - start
    if values[2] > ROUND**2 * values[1]:
        away = vectors[:, 2] * (1 if vectors[:, 2] @ away >= 0 else -1)
    length = float(np.linalg.norm(away))
    return np.asarray(away / length) if length > 1e-9 else np.array([0.0, -1.0, 0.0])


# Chosen by eye on the figures of benchmarks/rigid_blocks.md.
TOUCH = 0.03  # largest gap between blocks that touch, over the height
FLOOR = 0.06  # largest distance to the lowest point of a block that stands on the ground, over the height
ASIDE = 0.2  # distance from the middle of the trunk from which on a block is at its side, over half its width
SHORT = 0.55  # a second piece shorter than this is a hand or a foot, over the length of the first
_H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}
_LIMBS = ("arm", "leg", "front leg", "wing")


@dataclass(frozen=True, eq=False)
class BlockParts:
    """What blocks are."""

    handles: np.ndarray  # handle of each block, shape (B,)
    upright: bool  # whether it stands on two legs or none, and not on four
    named: bool  # whether names say what the limbs of both sides are
    trunk: list[int]  # the blocks of the trunk


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
    for block in tree.order:  # what is not a part of its own goes along with what it hangs on
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
        apart |= any(
            self.words[own][1] in ("face", "head_top") and self.words[on][0] not in ("", "carried", "head")
            for own, on in ((one, other), (other, one))
        )
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
        """Blocks of the trunk: those named so that hang on one another, and those that bear limbs of both sides."""
        shapes, out = self.shapes, [self.root]
        floor = float(shapes.low[:, 1].min()) + FLOOR * shapes.height
        for member in out:
            for child in np.flatnonzero(self.parents == member).tolist():
                feet = {int(self.sides[other]) for other in self.below(child)[1:] if shapes.low[other, 1] < floor}
                limb = self.words[child][0]
                shell = not self.sides[child] and _shared(shapes, member, child).min() > COAT
                if limb == "trunk" or (limb == "" and ({-1, 1} <= feet or shell)):
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
        paired = [one for one in branches if one.limb == limb and one.side in sides]
        if limb == "arm" and four:
            continue
        groups = [[one for one in paired if one.side == side] for side in sides] if limb in _LIMBS else [paired]
        out += [max(group, key=lambda branch: (branch.named, size(branch))) for group in groups if group]
    arms = sum(branch.limb == "arm" for branch in out)
    return out if four or len(legs[1]) == 1 or arms == 2 else None


def _fill_trunk(handles: np.ndarray, trunk: list[int], shapes: BlockShapes, upright: bool) -> None:
    """The trunk from the pelvis on, blocks that lie along one another as one; what is all one turns as the middle of a
    body does that stands upright.
    """
    axis, along = (1 if upright else 2), (0, _H["spine1"], _H["spine2"], _H["spine3"])
    ordered = sorted(trunk, key=lambda block: float(shapes.centers[block, axis]))
    segments = [0]
    for before, block in pairwise(ordered):
        segments.append(segments[-1] + int(_shared(shapes, before, block)[axis] < COAT))
    for block, segment in zip(ordered, segments, strict=True):
        share = segment / segments[-1] if segments[-1] else 2 / 3 * upright
        handles[block] = along[round(3 * share)]


def _shared(shapes: BlockShapes, block: int, other: int) -> np.ndarray:
    """How much of the shorter side the boxes of two blocks have in common along each axis, shape (3,)."""
    low, high = shapes.low[[block, other]], shapes.high[[block, other]]
    return np.asarray((high.min(axis=0) - low.max(axis=0)) / np.maximum((high - low).min(axis=0), 1e-9))


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
        of_branch = [block for block in below if tree.words[block][0] == branch.limb] or below
        of_branch = [block for block in of_branch if tree.shapes.areas[block] > 0.05 * tree.shapes.areas[chain[0]]]
        if not of_branch:
            return chain
        chain.append(max(of_branch, key=lambda block: float(tree.shapes.areas[tree.below(block)].sum())))


# Chosen by eye on the figures of benchmarks/rigid_blocks.md, and on trousers, which are not such figures.
BENDS = 0.1  # share of a surface that knees and elbows of either side hold, from which on it bends
EVEN = 0.5  # a leg may hold a little of the other knee that it touches: less than this, over its own
FORK = (0.15, 0.2)  # a block is forked that has nothing in this share of its width in the lowest share of its height
_OUTER = [
    [[HANDLE_NAMES.index(f"{side}_{part}") for part in parts] for side in ("left", "right")]
    for parts in (("elbow", "wrist", "fingers"), ("knee", "ankle", "foot"))
]


def rigid_handles(character: Character, weights: np.ndarray) -> Handles | None:
    """The handles of a figure of rigid blocks; None of others.

    Args:
        character: +Y up and facing +Z.
        weights: What the predictor says of its vertices, shape (V, 30). Where no names tell the limbs, it is asked
            whether a block is one: a pair of trousers is none.
    """
    blocks = find_blocks(character)
    if blocks is None:
        return None
    shapes = BlockShapes.of(character, blocks)
    parts = block_parts(shapes)
    if parts is None or (not parts.named and _bends(character, shapes, parts, weights)):
        return None
    full = np.zeros((len(character.vertices), HANDLE_COUNT), np.float32)
    label = np.where(blocks.label >= 0, blocks.label, parts.trunk[0])
    full[np.arange(len(label)), parts.handles[label]] = 1
    return Handles(_positions(shapes, parts), full, rigid=True)


def _bends(character: Character, shapes: BlockShapes, parts: BlockParts, weights: np.ndarray) -> bool:
    """Whether the predictor sees knees or elbows of both sides in one block. Where other blocks are legs, it sees legs
    where the block is forked: a belly over short legs is none.
    """
    mass, label = weights * character.areas[:, None], shapes.blocks.label
    stands = bool(np.isin(parts.handles, [_H["left_hip"], _H["right_hip"]]).any())
    for block, points in enumerate(shapes.points):
        own = mass[label == block].sum(axis=0)
        aside = np.abs(points[:, 0] - shapes.centers[block, 0]) / max(float(np.ptp(points[:, 0])), 1e-9)
        low = points[:, 1] < shapes.low[block, 1] + FORK[0] * np.ptp(points[:, 1])
        forked = aside[low].min() > FORK[1] / 2
        for limb, sides in enumerate(_OUTER):
            less, more = sorted(float(own[side].sum()) for side in sides)
            legs = stands and (limb == 1 or not parts.upright)
            if less > max(BENDS * float(own.sum()), EVEN * more) and (forked or not legs):
                return True
    return False


def joint_parents(present: np.ndarray) -> np.ndarray:
    """The handle that each hangs on, by which have blocks, shape (K,); -1 for the root.

    Where the pelvis has none, legs and all else hang on the lowest block of the trunk.
    """
    spine = [HANDLE_NAMES.index(f"spine{number}") for number in (1, 2, 3)]
    base = 0 if present[0] else next((handle for handle in spine if present[handle]), 0)
    out = np.full(len(present), -1)
    for handle in range(1, len(present)):
        above = HANDLE_PARENTS[handle]
        while above > 0 and not present[above]:
            above = HANDLE_PARENTS[above]
        out[handle] = above if above > 0 or handle == base or handle in spine[: _rank(spine, base)] else base
    return out


def _rank(spine: list[int], base: int) -> int:
    return spine.index(base) if base in spine else 0


def _positions(shapes: BlockShapes, parts: BlockParts) -> np.ndarray:
    """Where each handle stands [m], shape (K, 3): at its joint; the root between the legs, and absent ones where their
    parents stand. A head that is not there stands at the upper or the front end of the trunk.
    """
    members = [np.flatnonzero(parts.handles == handle).tolist() for handle in range(HANDLE_COUNT)]
    present = np.array([bool(some) for some in members])
    above = joint_parents(present)
    out = np.zeros((HANDLE_COUNT, 3))
    hips = [handle for handle, name in enumerate(HANDLE_NAMES) if name.endswith("_hip") and members[handle]]
    low, high = shapes.low[parts.trunk].min(axis=0), shapes.high[parts.trunk].max(axis=0)
    bottom = np.array([0.5 * (low + high)[0], low[1], 0.5 * (low + high)[2]])
    out[0] = np.mean([shapes.pivot(members[hip], members[above[hip]]) for hip in hips], axis=0) if hips else bottom
    base = int(above[hips[0]]) if hips else 0
    for handle in range(1, HANDLE_COUNT):
        parent = int(above[handle])
        jointed = members[handle] and members[parent] and handle != base
        out[handle] = shapes.pivot(members[handle], members[parent]) if jointed else out[max(parent, 0)]
    head = HANDLE_NAMES.index("head")
    if not members[head]:
        middle = 0.5 * (low + high)
        front = np.array([middle[0], out[0, 1] + 0.5 * (high[1] - out[0, 1]), high[2] + (high[1] - low[1])])
        out[head] = np.array([middle[0], high[1], middle[2]]) if parts.upright else front
    return out.astype(np.float32)
