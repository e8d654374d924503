"""The body under apparel: one set of joints for all, its surface without apparel, its points, and depth in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b

import numpy as np
from scipy.ndimage import distance_transform_edt, label, maximum_filter, minimum_filter
from scipy.sparse import csr_matrix

from bunraku.anatomy.handles.networks import farthest_points
from bunraku.anatomy.names.bone_names import NO_HANDLE
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.mask import moved_joints
from bunraku.core.animation import RigAnimation, bone_order
from bunraku.core.avatars import mmd_model
from bunraku.core.body.layout import HANDLE_PARENTS, JOINT_COUNT, JOINT_PARENTS
from bunraku.core.character import Character
from bunraku.core.geometry.closest import surface_distances
from bunraku.core.geometry.rotations import adjugates
from bunraku.core.geometry.surface import split_long_edges, vertex_normals, winding_numbers
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError
from bunraku.retarget.rig_parts import RigParts


@dataclass(frozen=True, eq=False)
class UnifiedBody:
    """A character's rig as SMPL's 22 joints."""

    parts: RigParts  # the rig's bones as parts of the reference body
    # positions in the rest pose [m], shape (22, 3); joints that the rig lacks lie between their neighbours
    joints: np.ndarray
    weights: np.ndarray  # skinning weights of the vertices for the joints, shape (V, 22), float32, rows sum to 1
    # the bone that each joint is, shape (22,); of a joint that the rig lacks, that of the joint above it
    bones: np.ndarray
    joint_of: np.ndarray  # the joint that each bone goes along with, shape (J,)
    moved: np.ndarray  # bones that physics move and those below them, shape (J,), bool

    @classmethod
    def of(cls, character: Character) -> UnifiedBody:
        """Read a character's rig.

        Raises:
            CharacterError: There is no rig, or it is not that of a person.
        """
        parts = RigParts.of(character)
        if not parts.humanoid or character.rig is None:
            raise CharacterError(
                f"{character.name}: its rig has no pelvis, arms and legs that are known; apparel data need a person's"
            )
        rig = character.rig
        by_physics = moved_joints(character)
        moved = np.zeros(len(rig.names), bool) if by_physics is None else by_physics
        joint_of = _joints_of_bones(parts, moved)
        weights = np.zeros((len(character.vertices), JOINT_COUNT), np.float32)
        np.add.at(weights, (np.arange(len(weights))[:, None], joint_of[rig.indices]), rig.weights)
        weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
        bones = _leads(parts, joint_of, moved)
        present = bones >= 0
        for joint in range(1, JOINT_COUNT):
            if not present[joint]:
                bones[joint] = bones[JOINT_PARENTS[joint]]
        return cls(parts, _positions(rig.positions[bones], present), weights, bones, joint_of, moved)

    def transforms(self, animation: RigAnimation) -> np.ndarray:
        """T of Eq. 1: rotation from the rest pose and position of each joint, `[R | t]`, shape (N, 22, 3, 4), float32.

        A vertex of one joint goes to `R (v - J) + t` (Eq. 4).
        """
        affine = animation.transforms()[:, self.bones].astype(np.float64)
        affine[..., 3] += np.einsum("njab,jb->nja", affine[..., :3], self.joints)
        return affine.astype(np.float32)


def _joints_of_bones(parts: RigParts, moved: np.ndarray) -> np.ndarray:
    assert parts.character.rig is not None
    parents, model = parts.parents, mmd_model(parts.character)
    out = np.full(len(parents), -1)
    for bone in bone_order(parents):
        handle, parent = int(parts.parts[bone]), int(parents[bone])
        if not moved[bone] and handle != NO_HANDLE:
            while handle >= JOINT_COUNT:
                handle = HANDLE_PARENTS[handle]
            out[bone] = handle
        elif parent >= 0:
            out[bone] = out[parent]
    if model is not None and len(model.bones) == len(out):
        for bone, entry in enumerate(model.bones):  # helpers of MMD that rotate fully with another bone
            append = entry.append
            if append is None or not append.rotation or abs(append.ratio - 1) >= 1e-6:
                continue
            if not moved[bone] and parts.parts[bone] == NO_HANDLE:
                out[bone] = out[append.bone]
    return np.maximum(out, 0)


def _leads(parts: RigParts, joint_of: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """The bone that is each joint, -1 for none, shape (22,)."""
    out = parts.leads[:JOINT_COUNT].copy()
    for joint, bone in enumerate(out):
        if bone >= 0 and (moved[bone] or joint_of[bone] != joint):
            out[joint] = -1
    if out[0] < 0:
        raise CharacterError(
            f"{parts.character.name}: physics move the pelvis of its rig; apparel data need a body that follows the "
            "motion"
        )
    return out


def _positions(positions: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Joints with missing ones half way between the joints above and below that are there, or at the one above."""
    out = positions.copy()
    for joint in range(1, JOINT_COUNT):
        if not present[joint]:
            above = out[JOINT_PARENTS[joint]]
            below, line = joint, [other for other in range(joint + 1, JOINT_COUNT) if JOINT_PARENTS[other] == joint]
            while line and not present[below]:
                below = line[0]
                line = [other for other in range(below + 1, JOINT_COUNT) if JOINT_PARENTS[other] == below]
            out[joint] = (above + positions[below]) / 2 if present[below] else above
    return out


def eq4_transforms(transforms: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Affine transforms for `skin` from `[R | t]` of [MMDMC 4], both (N, J, 3, 4), and rest positions [m] (J, 3)."""
    out = np.array(transforms, np.float32)
    out[..., 3] -= np.einsum("njab,jb->nja", out[..., :3], np.asarray(joints, np.float32))
    return out


_MOST_FACES = 12_000


@dataclass(frozen=True, eq=False)
class BodyVolume:
    """The surface of a character without what physics move, with fewer faces."""

    rest: np.ndarray  # vertices in the rest pose [m], shape (B, 3)
    faces: np.ndarray  # shape (F, 3), int64
    weights: np.ndarray  # for the 22 joints, shape (B, 22)

    @classmethod
    def of(cls, body: UnifiedBody, apparel: np.ndarray, most_faces: int = _MOST_FACES) -> BodyVolume:
        """The volume of a body and its mask (V,), bool; otherwise as `of_mesh`."""
        character = body.parts.character
        return cls.of_mesh(character.vertices, character.faces, body.weights, apparel, character.name, most_faces)

    @classmethod
    def of_mesh(
        cls, vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray, apparel: np.ndarray, name: str,
        most_faces: int = _MOST_FACES,
    ) -> BodyVolume:  # fmt: skip
        """The volume of a rest mesh [m] with weights for the 22 joints (V, 22) and its mask (V,), bool. A body with
        more faces than `most_faces` is simplified to about so many, which moves its surface by a millimetre or two.

        Raises:
            CharacterError: All of the character is apparel.
        """
        faces = faces[~apparel[faces].any(axis=1)]
        if not len(faces):
            raise CharacterError(f"{name}: the whole mesh counts as apparel, so no body is left; mark less of it")
        used = np.unique(faces)
        points, index = np.unique(np.round(vertices[used].astype(np.float64), 6), axis=0, return_inverse=True)
        numbering = np.full(len(vertices), -1)
        numbering[used] = index.ravel()
        shares = _means(weights[used], index.ravel(), len(points))
        faces = numbering[faces]
        faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
        if len(faces) <= most_faces:
            return cls(points, np.ascontiguousarray(faces, np.int64), shares)
        import fast_simplification

        few, few_faces, collapses = fast_simplification.simplify(
            points.astype(np.float32), faces.astype(np.int32), target_count=most_faces, return_collapses=True
        )
        few, few_faces, kept = fast_simplification.replay_simplification(
            points.astype(np.float32), faces.astype(np.int32), collapses
        )
        return cls(few.astype(np.float64), np.ascontiguousarray(few_faces, np.int64), _means(shares, kept, len(few)))

    def posed(self, transforms: np.ndarray) -> np.ndarray:
        """Vertices of frames [m], shape (N, B, 3), by transforms of the joints as `eq4_transforms` gives them."""
        return skin(self.rest.astype(np.float32), self.weights, transforms)


def _means(values: np.ndarray, groups: np.ndarray, count: int) -> np.ndarray:
    each = np.arange(len(groups))
    out = csr_matrix((np.ones(len(groups)), (groups, each)), (count, len(groups))) @ values.astype(np.float64)
    return np.asarray(out / np.maximum(out.sum(axis=1, keepdims=True), 1e-12), np.float32)


CELL = 0.015  # of the grid, over the character's size [m]; chosen by eye, half the width of a wrist
BAND = 6 * CELL  # distances beyond this are cut to it, over the character's size [m]
_MOST_CELLS = 2_000_000
_FACES = 6_000
OUTSIDE = 2.5  # cells from the body beyond which distances outside of it are good to a cell or two; by definition
_ROUGH = 1.5  # how far a surface may be from the cells of its triangles' middles [cells]; chosen by eye
CLOSE = 1.0  # cells from the surface within which every point is tested
_KEPT = 3  # grids of the last bodies; one takes up to 8 MB


@dataclass(frozen=True, eq=False)
class Unposed:
    """The way back to the rest pose for M points of a frame: `back @ (x - shift)`."""

    back: np.ndarray  # shape (M, 3, 3)
    shift: np.ndarray  # [m], shape (M, 3)
    joint: np.ndarray  # the joint that holds the body there, shape (M,)

    @classmethod
    def of(cls, blend: np.ndarray, joint: np.ndarray) -> Unposed:
        """From the affine transforms (M, 3, 4) and the joints (M,) of the body nearest to each point."""
        turn = blend[..., :3]
        other = adjugates(turn)
        volume = (turn[:, 0] * other[:, :, 0]).sum(axis=-1)
        return cls(other / np.where(np.abs(volume) > 0.05, volume, 1.0)[:, None, None], blend[..., 3], joint)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Points of the pose in the rest pose [m], shape (M, 3)."""
        return self.columns(points).T

    def columns(self, points: np.ndarray) -> np.ndarray:
        """The same, one row for each axis, shape (3, M)."""
        return np.asarray(np.einsum("mab,mb->am", self.back, points - self.shift))

    def take(self, rows: np.ndarray) -> Unposed:
        """The same for some of the points, or for others that go with them."""
        return Unposed(self.back.take(rows, axis=0), self.shift.take(rows, axis=0), self.joint.take(rows))


@dataclass(frozen=True, eq=False)
class BodyDepth:
    """The signed distance from a body in its rest pose, above 0 outside."""

    low: np.ndarray  # where the grid begins [m], shape (3,)
    cell: float  # width of a cell [m]
    values: np.ndarray  # distances at its corners [m], shape (X, Y, Z), float32

    @cached_property
    def _least(self) -> np.ndarray:
        """The least value at the corners of the cell that begins at each corner, flat: no value in it is below that."""
        out = self.values
        for axis in range(3):
            turned = np.moveaxis(out, axis, 0)
            out = np.moveaxis(np.concatenate([np.minimum(turned[:-1], turned[1:]), turned[-1:]]), 0, axis)
        return np.asarray(out.reshape(-1))

    @cached_property
    def _steps(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Steps in the flat grid along each axis and to the eight corners of a cell; its last position [cells]."""
        shape = np.array(self.values.shape)
        steps = np.array([shape[1] * shape[2], shape[2], 1])
        return steps, _CORNERS @ steps, (shape - 1.001).astype(np.float32)[:, None]

    def at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance of points of the rest pose [m], shape (M,), and its gradient, shape (M, 3): linear within a cell."""
        return self._linear(*self._cells(points.T))

    def _cells(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First corners of the cells with points (3, M), shape (M,), and positions in them, from 0 to 1, (3, M)."""
        position = (points - self.low[:, None]).astype(np.float32, copy=False)
        position /= np.float32(self.cell)
        np.maximum(position, 0, out=position)
        np.minimum(position, self._steps[2], out=position)
        first = position.astype(np.int64)
        position -= first
        x, y, z = first
        steps = self._steps[0]
        return x * steps[0] + y * steps[1] + z, position

    def _linear(self, corner: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance and gradient at positions in cells, as `_cells` gives them."""
        v = self.values.reshape(-1)[self._steps[1][:, None] + corner]
        x, y, z = share
        # along z, then y, then x
        dz = v[1::2] - v[::2]
        vz = v[::2] + z * dz
        dy, dzy = vz[1::2] - vz[::2], dz[::2] + y * (dz[1::2] - dz[::2])
        vy = vz[::2] + y * dy
        dx = vy[1] - vy[0]
        slope = np.stack([dx, dy[0] + x * (dy[1] - dy[0]), dzy[0] + x * (dzy[1] - dzy[0])], axis=1)
        return vy[0] + x * dx, slope / np.float32(self.cell)

    def push(self, points: np.ndarray, unposed: Unposed, gap: np.ndarray, most: float) -> tuple[np.ndarray, np.ndarray]:
        """What moves points of a pose out of the body until they are as far from it as `gap`: the rows of the moved
        points (P,), and by how much [m], shape (P, 3).

        Args:
            points: [m], shape (M, 3).
            unposed: Their way back.
            gap: [m], below 0 where a point may be inside, shape (M,).
            most: Points that would move by more stay: they are on the wrong side of something thin [m].
        """
        corner, share = self._cells(unposed.columns(points))
        # mostly few are near, and all corners are read for these alone
        rows = np.flatnonzero(self._least[corner] < gap)
        if not len(rows):
            return rows, np.zeros((0, 3), np.float32)
        distance, slope = self._linear(corner[rows], share[:, rows])
        step = gap[rows] - distance
        moved = np.flatnonzero((step > 0) & (step < most))
        rows = rows[moved]
        shift = np.einsum("mba,mb->ma", unposed.back[rows], slope[moved])
        length = np.maximum(np.einsum("ma,ma->m", shift, shift), 0.1)
        return rows, (step[moved] / length)[:, None] * shift

    def pushed(self, points: np.ndarray, unposed: Unposed, gap: np.ndarray, most: float) -> np.ndarray:
        """Points moved out of the body, shape (M, 3); arguments as of `push`."""
        rows, step = self.push(points, unposed, gap, most)
        out = np.array(points)
        out[rows] += step
        return out


_grids: dict[bytes, BodyDepth] = {}
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])


def body_depth(
    vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray, apparel: np.ndarray, scale: float = 1.0
) -> BodyDepth | None:
    """The grid of a body by its rest mesh [m], weights for the 22 joints (V, 22) and mask (V,), and the scale as of
    `ClothedCharacter`; None where all of it is apparel. Those of the last bodies are kept, because apparel is often
    made again for the same body.
    """
    if not len(faces[~apparel[faces].any(axis=1)]):
        return None
    arrays = (vertices, faces, weights, apparel, np.array(scale))
    key = b"".join(blake2b(part.tobytes(), digest_size=16).digest() for part in arrays)
    grid = _grids.get(key)
    if grid is None:
        grid = _grid(vertices, faces, weights, apparel, scale)
        while len(_grids) >= _KEPT:
            _grids.pop(next(iter(_grids)), None)
        _grids[key] = grid
    return grid


def _grid(vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray, apparel: np.ndarray, scale: float) -> BodyDepth:
    volume = BodyVolume.of_mesh(vertices, faces, weights, apparel, "the mesh", _FACES)
    band = BAND * scale
    low = volume.rest.min(axis=0) - band
    extent = volume.rest.max(axis=0) + band - low
    cell = max(CELL * scale, float(np.cbrt(np.prod(extent) / _MOST_CELLS)))
    shape = tuple(int(count) for count in np.ceil(extent / cell).astype(np.int64) + 1)
    corners = np.stack(np.meshgrid(*(np.arange(count) for count in shape), indexing="ij"), axis=-1)
    points = low + cell * corners.reshape(-1, 3)
    rest, triangles, _ = split_long_edges(np.asarray(volume.rest, np.float64), np.asarray(volume.faces, np.int64), cell)
    bare = np.ones(shape, bool)
    middle = np.round((rest[triangles].mean(axis=1) - low) / cell).astype(np.int64)
    bare[tuple(np.clip(middle, 0, np.array(shape) - 1).T)] = False
    # what lies farther than this from the cells of all middles is farther than `OUTSIDE` from all faces
    about = distance_transform_edt(bare).reshape(-1)
    near_surface = about <= OUTSIDE + _ROUGH
    gap = np.where(about * cell <= band, about * cell, np.inf)
    gap[near_surface] = surface_distances(points[near_surface], rest, triangles, cell, np.inf)
    inside = _inside(points, gap, cell, shape, volume)
    # far outside it does not matter how far
    near_surface = inside & ~near_surface & np.isfinite(gap)
    gap[near_surface] = surface_distances(points[near_surface], rest, triangles, cell, np.inf)
    near = np.isfinite(gap)
    out = np.full(len(points), band, np.float32)
    out[near] = np.minimum(gap[near], band) * np.where(inside[near], -1, 1)
    # what is far from all faces is inside or outside as a whole
    regions, count = label(~near.reshape(shape))
    regions = regions.reshape(-1)
    if count:
        first = np.array([np.flatnonzero(regions == number + 1)[0] for number in range(count)])
        deep = np.abs(winding_numbers(points[first], volume.rest, volume.faces)) > 0.5
        out[np.isin(regions, np.flatnonzero(deep) + 1)] = -band
    return BodyDepth(low.astype(np.float32), float(cell), out.reshape(shape))


def _inside(points: np.ndarray, gap: np.ndarray, cell: float, shape: tuple[int, ...], volume: BodyVolume) -> np.ndarray:
    """Whether the points of a grid that are near the body are in it, shape (P,), by winding numbers. These jump at the
    surface and are smooth elsewhere: of what is not close to it every second point is tested first, and the others
    where those about them differ. Far points have infinite gaps.
    """
    near, close = np.isfinite(gap).reshape(shape), (gap < CLOSE * cell).reshape(shape)
    every = np.zeros(shape, bool)
    every[::2, ::2, ::2] = True
    tested = near & (close | every)
    inside = np.zeros(shape, bool)
    inside[tested] = np.abs(winding_numbers(points[tested.reshape(-1)], volume.rest, volume.faces)) > 0.5
    asked = tested & every
    most, least = (filter(np.where(asked, inside, blank), size=3)
                   for filter, blank in ((maximum_filter, False), (minimum_filter, True)))  # fmt: skip
    alike = (most == least) & maximum_filter(asked, size=3)
    inside = np.where(tested, inside, most & alike)
    rest = near & ~tested & ~alike
    if rest.any():
        inside[rest] = np.abs(winding_numbers(points[rest.reshape(-1)], volume.rest, volume.faces)) > 0.5
    return np.asarray(inside.reshape(-1))


_ROWS = 64  # rows of distances at a time: they stay in the cache


@dataclass(frozen=True, eq=False)
class BodyPoints:
    """Points spread over the body."""

    rest: np.ndarray  # positions in the rest pose [m], shape (B, 3)
    normals: np.ndarray  # outward, shape (B, 3)
    weights: np.ndarray  # skinning weights for the 22 joints, shape (B, 22)
    joint: np.ndarray  # the joint that holds each most, shape (B,)

    def posed(self, affine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and normals in a frame, (B, 3) each, by transforms of the joints as of `eq4_transforms`."""
        return self.placed(self.blends(affine)), np.einsum("bac,bc->ba", affine[self.joint, :, :3], self.normals)

    def blends(self, affine: np.ndarray) -> np.ndarray:
        """Affine transform of each point, shape (B, 3, 4), by those of the joints."""
        return (self.weights @ affine.reshape(len(affine), 12)).reshape(-1, 3, 4)

    def placed(self, blends: np.ndarray) -> np.ndarray:
        """Positions of the points by these [m], shape (B, 3)."""
        return np.asarray(np.einsum("bac,bc->ba", blends[..., :3], self.rest) + blends[..., 3])


def body_points(clothed: ClothedCharacter, most: int = 512) -> BodyPoints:
    """Points of a clothed character's body, evenly spread; none where all of it is apparel."""
    normals = vertex_normals(clothed.rest, clothed.faces)
    used = np.zeros(len(clothed.rest), bool)
    used[clothed.faces] = True
    rows = np.flatnonzero(used & (clothed.part < 0) & (np.linalg.norm(normals, axis=1) > 0.5))
    if len(rows):
        rows = rows[farthest_points(clothed.rest[rows].astype(np.float64), min(most, len(rows)))]
    weights = clothed.weights[rows].astype(np.float32)
    return BodyPoints(
        clothed.rest[rows].astype(np.float32), normals[rows].astype(np.float32), weights,
        weights.argmax(axis=1) if len(rows) else np.zeros(0, np.int64),
    )  # fmt: skip


def nearest_point(points: np.ndarray, positions: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The plane of the nearest of the posed body's points (B, 3): signed distance of each point (M, 3) from it [m],
    shape (M,), and its normal (M, 3); far away where there is no body.
    """
    if not len(positions):
        return np.full(len(points), 10.0, np.float32), np.zeros_like(points)
    near = nearest_index(points, positions)
    return ((points - positions[near]) * normals[near]).sum(axis=-1), normals[near]


def nearest_index(points: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Index of the nearest position to each point, shapes (M, 3) and (B, 3) -> (M,)."""
    # one product: the square of a point's own length is the same for all
    table = np.empty((4, len(positions)), np.float32)
    np.multiply(positions.T, -2, out=table[:3])
    np.square(positions).sum(axis=1, out=table[3])
    ours = np.empty((len(points), 4), np.float32)
    ours[:, :3], ours[:, 3] = points, 1
    near = np.empty(len(points), np.int64)
    gaps = np.empty((min(_ROWS, len(points)), len(positions)), np.float32)
    for first in range(0, len(points), _ROWS):
        block = ours[first : first + _ROWS]
        np.matmul(block, table, out=gaps[: len(block)]).argmin(axis=1, out=near[first : first + _ROWS])
    return near
