"""What a body is: its joints, legs and plan, and how it stands, worked out once from a character and its handles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.sparse import csr_matrix

from bunraku.anatomy.corrected import joint_numbers, moved_joints
from bunraku.anatomy.handles.limbs import LIMB_HANDLES, has_extra_legs
from bunraku.anatomy.joints import (
    Joints,
    LimbView,
    attach_joints,
    by_limb,
    find_joints,
    further_limbs,
    limb_views,
    reference_joints,
    refined_joints,
)
from bunraku.anatomy.legs import BodyPlan, Leg, Reach, find_arms, find_legs, plan_of, standing, stride_scale
from bunraku.anatomy.rest_pose import block_rest, rest_of_limbs, stance_of, upright
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.surface import extreme_points, part_extremes, vertex_areas
from bunraku.core.motion import HandleMotion
from bunraku.errors import CharacterError

CELLS = 8000  # about how many vertices the surface is left with
MANY = 12000  # characters with fewer vertices are left as they are
# By definition: the mean of |x| + |y| + |z| of unit normals is 3/2.
SPREAD = 1.5  # cells of a grid that a surface goes through, over its area in faces of them


def decimated(character: Character, handles: Handles) -> tuple[Character, Handles]:
    """The character and its handles on fewer vertices; both as they are where there are few.

    Vertices in one cell of a grid that one handle moves the most become one, at the mean of their positions and
    weights. The extreme points of every part stay themselves, so feet stand where they stood. Handle positions and
    roles stay.
    """
    if len(character.vertices) <= MANY:
        return character, handles
    vertices, used = character.vertices, np.flatnonzero(character.surface)
    low = vertices[used].min(axis=0)
    sample = character.faces[:: max(1, len(character.faces) // MANY)]
    of_some = float(vertex_areas(vertices[sample.ravel()], np.arange(sample.size).reshape(-1, 3)).sum())
    area = of_some * len(character.faces) / len(sample)
    cell = max(float(np.sqrt(SPREAD * area / CELLS)), 1e-4 * float(np.ptp(vertices[used], axis=0).max()))
    corner = ((vertices[used] - low) / cell).astype(np.int64)
    wide = corner.max(axis=0) + 1
    weights = handles.weights[used]
    key = ((corner[:, 0] * wide[1] + corner[:, 1]) * wide[2] + corner[:, 2]) * weights.shape[1] + weights.argmax(axis=1)
    extremes = part_extremes(vertices[used], weights)
    key[extremes] = -1 - np.arange(len(extremes))
    label = np.unique(key, return_inverse=True)[1]
    count = int(label.max()) + 1
    mean = csr_matrix((np.ones(len(used), np.float32), (label, np.arange(len(used)))), shape=(count, len(used)))
    total = np.bincount(label, minlength=count)[:, None]
    index = np.zeros(len(vertices), np.int64)
    index[used] = label
    faces = index[character.faces]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    ordered = np.sort(faces, axis=1)
    first = np.unique((ordered[:, 0] * count + ordered[:, 1]) * count + ordered[:, 2], return_index=True)[1]
    kept = np.unique(faces[first])
    if len(kept) < 100:  # nothing but crumbs
        return character, handles
    again = np.full(count, -1)
    again[kept] = np.arange(len(kept))
    light = Character(character.name, ((mean @ vertices[used]) / total)[kept], again[faces[first]])
    shares = ((mean @ weights) / total)[kept]
    shares = shares / shares.sum(axis=1, keepdims=True)
    return light, Handles(handles.positions, shares, handles.features, handles.roles, handles.rigid)


SHORT = 0.75
"""Legs are short that are less than this share of a person's, for the body's height; chosen by eye on stubby bodies,
below what most people and avatars have (0.77 to 1.1)."""
_FRONT = ("neck", "head", "head_top", "face")
_TAIL = ("tail", "tail_tip")


@dataclass(frozen=True, eq=False)
class Anatomy:
    """What is known of a body, in its rest pose."""

    character: Character  # the character, +Y up and facing +Z [m]
    # its handles, K = 30 with the reference body's meaning; those with `roles` move as the handles whose parts they
    # play, about their own joints
    handles: Handles
    mesh: Character  # the character on few vertices, V, on which all else is measured (`decimated`)
    mesh_handles: Handles  # the handles with the weights of those vertices
    # What a rig or rigid blocks tell of the rest pose: the rotation of each handle into the reference body's, shape (K,
    # 3, 3), and the joints. None measures them.
    known: tuple[np.ndarray, Joints] | None = None
    named: bool = False  # whether the names of a rig's bones tell that its limbs are limbs

    @classmethod
    def of(cls, character: Character, handles: Handles, known: tuple[np.ndarray, Joints] | None = None) -> Anatomy:
        """The anatomy of a character by its handles. CharacterError if the handles are not as many as the reference
        body's.

        Args:
            character: +Y up and facing +Z, in the pose that its motions are relative to.
            handles: Its handles.
            known: What a rig tells of the rest pose.
        """
        count = len(HANDLE_NAMES)
        if len(handles.positions) != count:
            raise CharacterError(
                f"a motion is fitted to {count} handles, not {len(handles.positions)}; take those of `bunraku.rig`"
            )
        light = decimated(character, handles)
        if known is None and handles.rigid:
            known = block_rest(*light)
        return cls(character, handles, *light, known)

    def measured(self) -> Anatomy:
        """The same, with all worked out that the stages of fitting ask of every body."""
        _ = self.plan, self.arms, self.scale, self.floor, self.reach, self.has_extra_legs
        return self

    @cached_property
    def upright(self) -> bool:
        """Whether the head is over the hips rather than before them."""
        return upright(self.handles)

    @cached_property
    def has_extra_legs(self) -> bool:
        """Whether it has limbs beyond those of a person."""
        return has_extra_legs(self.handles)

    @property
    def is_person(self) -> bool:
        """Whether it is upright, with two arms and two legs."""
        return self.plan.kind == "person" and not self.has_extra_legs

    @cached_property
    def further(self) -> list[list[int]]:
        """The handles of each limb beyond those of a person, from the body outwards."""
        return [limb for limb in self._beyond if limb[0] not in self.appendages]

    @cached_property
    def appendages(self) -> list[int]:
        """The handles of what stands out from the head, such as ears, horns and a trunk: they play the head's top."""
        played = self.handles.played
        beside = np.flatnonzero(played != np.arange(len(played)))
        return [handle for handle in beside.tolist() if int(played[handle]) not in LIMB_HANDLES]

    @cached_property
    def own(self) -> np.ndarray:
        """Which handles are there and play their own parts, shape (K,), bool."""
        played = self.handles.played
        return np.asarray(self.joints.present & (played == np.arange(len(played))))

    @cached_property
    def extra_limbs(self) -> list[list[int]]:
        """The handles beside those of a person, limb by limb, by all vertices' weights; appendages are among them."""
        return further_limbs(self.handles)

    @cached_property
    def _beyond(self) -> list[list[int]]:
        return further_limbs(self.mesh_handles) if self.handles.roles is not None else []

    @cached_property
    def _views(self) -> list[LimbView]:
        return [] if self.handles.roles is None else limb_views(self.mesh_handles, self._beyond)

    @cached_property
    def _estimates(self) -> list[Joints]:
        """Joints as the weights imply them, of the body with each further limb in turn."""
        all_handles = [view.handles for view in self._views] or [self.mesh_handles]
        return [self._as_said(find_joints(self.mesh, some)) for some in all_handles]

    @cached_property
    def _said(self) -> dict[int, np.ndarray]:
        return joint_numbers(self.character, self.handles)

    def _as_said(self, joints: Joints) -> Joints:
        """Joints where a person said that they are."""
        return replace(joints, positions=moved_joints(self._said, joints.positions)) if self._said else joints

    @cached_property
    def rest(self) -> tuple[np.ndarray, Joints]:
        """The rotation of each handle from the rest pose into the reference body's (K, 3, 3), and the joints."""
        if self.known is not None:
            turns, joints = self.known
            return turns, self._as_said(joints) if self.handles.rigid else joints  # bones are where their rig has them
        guess = iter(self._estimates)
        turns, joints = by_limb(
            self.mesh_handles, lambda some: rest_of_limbs(self.mesh, some, next(guess)), self._views
        )
        joints = self._as_said(joints)
        for array in (turns, joints.positions, joints.parents, joints.present):
            array.setflags(write=False)
        return turns, joints

    @property
    def rotations(self) -> np.ndarray:
        """The rotation of each handle from the rest pose into the reference body's, shape (K, 3, 3)."""
        return self.rest[0]

    @property
    def joints(self) -> Joints:
        """Where handles meet in the rest pose."""
        return self.rest[1]

    @cached_property
    def unturned(self) -> Anatomy:
        """The same body with its rest pose taken as the reference body's: no limb is turned."""
        still = np.tile(np.eye(3), (len(self.handles.positions), 1, 1))
        if self.known is not None:
            return replace(self, known=(still, self.known[1]))
        guess = iter(self._estimates)
        rest = by_limb(
            self.mesh_handles, lambda some: (still, refined_joints(self.mesh, some, next(guess), still)), self._views
        )
        return replace(self, known=rest)

    @cached_property
    def legs(self) -> list[Leg]:
        """The limbs that it stands on; empty where it has no legs."""
        return find_legs(self.mesh, self.mesh_handles, self.joints, self.upright, self.named)

    @cached_property
    def _all_arms(self) -> list[Leg]:
        return find_arms(self.mesh, self.mesh_handles, self.joints, self.legs)

    @cached_property
    def arms(self) -> list[Leg]:
        """The arms with hands that are not among its legs."""
        return [arm for arm in self._all_arms if arm.foot]

    @cached_property
    def stumps(self) -> list[Leg]:
        """The arms that are not among its legs and have no hand of their own, such as those of one rigid block, which
        end in what may be a fist.
        """
        return [arm for arm in self._all_arms if not arm.foot]

    @cached_property
    def plan(self) -> BodyPlan:
        """What it stands and moves with."""
        return plan_of(self.mesh, self.mesh_handles, self.joints, self.legs, self.further, self.upright)

    def attached(self, rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Local rotations (N, K, 3, 3) and translations (N, K, 3) [m] in which every joint holds (`attach_joints`)."""
        return attach_joints(rotations, self.handles.positions, self.joints)

    @cached_property
    def _to_stance(self) -> tuple[np.ndarray, np.ndarray]:
        """Rotations (1, K, 3, 3) and translations (1, K, 3) from the rest pose into the reference body's stance."""
        return self.attached(self.rotations[None].astype(np.float64))

    @cached_property
    def stance_transforms(self) -> np.ndarray:
        """Transforms of the handles from the rest pose into the reference body's stance, shape (K, 3, 4)."""
        rotations, translations = self._to_stance
        motion = HandleMotion(translations, rotations, np.zeros((1, 3)), np.eye(3)[None])
        return motion.transforms(self.handles.positions)[0]

    @cached_property
    def stance(self) -> tuple[Character, Handles]:
        """The body in the reference body's stance, and its handles there."""
        return stance_of(self.mesh, self.mesh_handles, self.stance_transforms, self._to_stance[1][0])

    @cached_property
    def stands(self) -> np.ndarray:
        """Vertices of `mesh` that may stand on the ground, shape (V,), bool."""
        return standing(*self.stance)

    @cached_property
    def reach(self) -> Reach:
        """The extreme points of what may stand on the ground."""
        return self.reach_of(self.stands)

    @cached_property
    def surface_reach(self) -> Reach:
        """The extreme points of the whole surface."""
        return self.reach_of(self.mesh.surface)

    def reach_of(self, vertices: np.ndarray) -> Reach:
        """The extreme points of some vertices of `mesh`: a mask of shape (V,), or their numbers."""
        return Reach.of(self.mesh.vertices[vertices], self.mesh_handles.weights[vertices])

    @cached_property
    def scale(self) -> float:
        """Length of its strides over the reference body's."""
        return stride_scale(*self.stance, self.stands)

    @cached_property
    def leap(self) -> float:
        """Height of its leaps over the reference body's: as its legs are, or as its whole body where they are short."""
        size = self.mesh.height / reference_anatomy().mesh.height
        return max(self.scale, min(2 * SHORT * size - self.scale, size))

    @cached_property
    def floor(self) -> float:
        """Height of the ground that the rest pose stands on [m]."""
        return float(self.mesh.vertices[self.stands, 1].min())

    @cached_property
    def rise(self) -> float:
        """How much higher the floor is in the rest pose than in the stance [m]: a body that sits at rest stands up."""
        return self.floor - float(self.stance[0].vertices[self.stands, 1].min())

    @cached_property
    def lever(self) -> np.ndarray:
        """From the root's position in the stance to that at rest [m], shape (3,): the root turns about the former."""
        return np.asarray(self.handles.positions[0] - self.stance[1].positions[0])

    @cached_property
    def front(self) -> np.ndarray:
        """Extreme vertices of the neck and the head, shape (n,); none where there are hardly any."""
        return self._extremes(_FRONT)

    @cached_property
    def muzzle(self) -> int:
        """The foremost vertex of the head, or of a body that is all head."""
        front = self.front if len(self.front) else np.flatnonzero(self.mesh.surface)
        return int(front[self.mesh.vertices[front, 2].argmax()])

    @cached_property
    def tail(self) -> np.ndarray:
        """Extreme vertices of the tail, shape (n,); none where there are hardly any."""
        return self._extremes(_TAIL)

    def _extremes(self, names: tuple[str, ...]) -> np.ndarray:
        columns = np.isin(self.handles.played, [HANDLE_NAMES.index(name) for name in names])
        held = np.flatnonzero(self.mesh.surface & (self.mesh_handles.weights[:, columns].sum(axis=1) > 0.5))
        if len(held) < 4:
            return held[:0]
        return np.asarray(held[extreme_points(self.mesh.vertices[held].astype(np.float64))])

    def path(self, translation: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """The root's path on this body [m], shape (N, 3), from that of the reference body [m], shape (N, 3), and the
        root's rotation, shape (N, 3, 3).
        """
        path = translation * self.scale + np.array([0, self.rise, 0])
        return np.asarray(path + (rotation - np.eye(3)) @ self.lever)


@lru_cache(maxsize=1)
def reference_anatomy() -> Anatomy:
    """The anatomy of the reference body, whose true joints are known and whose rest pose is its stance."""
    body = reference_body()
    character, still = body.character(), np.tile(np.eye(3), (len(body.handles.positions), 1, 1))
    return Anatomy(character, body.handles, character, body.handles, (still, reference_joints())).measured()
