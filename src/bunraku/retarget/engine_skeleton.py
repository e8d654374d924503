"""A character with a skeleton that engines' humanoid retargeting takes: named joints in a tree, in a T-pose.

The 30 handles are written as a tree of joints, each where its part meets its parent. The mesh is put into the T-pose
by the rotations that reconcile its rest pose with the reference body's, so that the pose in which the skin is bound is
the T-pose itself: arms along the x axis, legs down, the face to +Z, the soles on y = 0, no joint turned.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.body.layout import HANDLE_NAMES, HANDLE_PARENTS, REQUIRED, ROOTS, SKELETONS, engine_names
from bunraku.core.character import Character, Handles, Rig, top_influences
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError, OptionError
from bunraku.files import Source


def on_skeleton(anatomy: Anatomy, names: str, weights: np.ndarray | None = None) -> Character:
    """A person's mesh in a T-pose on a tree of joints.

    Args:
        names: Whose names the joints get: "mixamo", "vrm" or "unreal".
        weights: Skinning weights of the vertices for the handles in place of their own, shape (V, 30).

    Raises:
        CharacterError: It is no person: a humanoid has two arms and two legs.
        OptionError: There are no names of this kind.
    """
    if names not in SKELETONS:
        raise OptionError(f"the names of a skeleton are those of {', '.join(SKELETONS)}, not '{names}'; choose one")
    character = anatomy.character
    if not anatomy.is_person:
        raise CharacterError(
            f"{character.name}: it is {anatomy.plan.words}, and a humanoid skeleton has two arms and two legs; leave "
            "the skeleton out"
        )
    anatomy = _plain(anatomy)
    weights = anatomy.handles.weights if weights is None else weights
    moved, placed = t_pose(anatomy)
    vertices = skin(character.vertices, weights, moved[None, :, :3].astype(np.float32))[0]
    rig = _rig(anatomy, placed, names, weights)
    source = character.source
    if isinstance(source, Source):
        each = np.einsum("vk,kij->vij", weights.astype(np.float64), moved)
        source = replace(source, moved=each if source.moved is None else each @ source.moved)
    return replace(
        character, vertices=vertices.astype(np.float32), rig=rig, source=source, avatar=None
    )  # springs and bones of the avatar hang on the skeleton that the file had


def carried(animation: Animation, anatomy: Anatomy, skeleton: Character) -> RigAnimation:
    """What moves a person's 30 handles, on the tree of joints that it got.

    With M_k(t) what handle k does to its part from the rest pose on, and T_k what took that part into the T-pose, joint
    k does M_k(t) T_k^-1 to what is bound to it there. Where two parts blend, skin lies between other two rigid motions
    than before; all else is the same.

    Raises:
        CharacterError: That is another character.
    """
    names = skeleton.rig.names if skeleton.rig is not None else ()
    engine = next((kind for kind in SKELETONS if set(names) <= {*engine_names(kind), ROOTS.get(kind, "")}), None)
    if engine is None or not names or len(animation.handles.positions) != len(HANDLE_NAMES):
        raise CharacterError(f"{skeleton.name}: it is not the skeleton of the handles that move; make it of them")
    moved, placed = t_pose(_plain(anatomy))
    does = animation.motion.transforms(animation.handles.positions).astype(np.float64)
    turned = does[..., :3] @ np.swapaxes(moved[:, :3, :3], -1, -2)
    shift = does[..., 3] - np.einsum("nkij,kj->nki", turned, moved[:, :3, 3])
    heads = np.einsum("nkij,kj->nki", turned, placed) + shift
    rotations = np.tile(np.eye(3), (len(does), len(names), 1, 1))
    positions = np.zeros((len(does), len(names), 3))
    listed = engine_names(engine)
    for joint, name in enumerate(names):
        if name in listed:  # the root on the ground stands still
            handle = listed.index(name)
            rotations[:, joint], positions[:, joint] = turned[:, handle], heads[:, handle]
    return RigAnimation.of_world(skeleton, rotations, positions, animation.fps, animation.reference)


def _plain(anatomy: Anatomy) -> Anatomy:
    """The body with what stands out from its head as part of the head's top: a humanoid has no joints for it."""
    if anatomy.handles.roles is None:
        return anatomy
    handles = anatomy.handles
    weights = np.zeros_like(handles.weights)
    np.add.at(weights.T, handles.played, handles.weights.T)
    return Anatomy.of(anatomy.character, Handles(handles.positions, weights, handles.features))


def t_pose(anatomy: Anatomy) -> tuple[np.ndarray, np.ndarray]:
    """What takes each handle's part from the rest pose into the T-pose, shape (30, 4, 4), and where its joint is there,
    shape (30, 3) [m]: the hips over the origin, the soles on y = 0.
    """
    character, handles = anatomy.character, anatomy.handles
    turns, joints = anatomy.rest
    heads = np.where(joints.present[:, None], joints.positions, handles.positions).astype(np.float64)
    placed = heads.copy()
    moved = np.tile(np.eye(4), (len(heads), 1, 1))
    for handle, parent in enumerate(HANDLE_PARENTS):  # parents come first
        if parent >= 0:
            placed[handle] = placed[parent] + turns[parent] @ (heads[handle] - heads[parent])
        moved[handle, :3, :3] = turns[handle]
        moved[handle, :3, 3] = placed[handle] - turns[handle] @ heads[handle]
    vertices = skin(character.vertices, handles.weights, moved[None, :, :3].astype(np.float32))[0]
    middle = (placed[HANDLE_NAMES.index("left_hip")] + placed[HANDLE_NAMES.index("right_hip")]) / 2
    shift = -np.array([middle[0], float(vertices[character.surface, 1].min()), middle[2]])
    moved[:, :3, 3] += shift
    return moved, placed + shift


def _rig(anatomy: Anatomy, heads: np.ndarray, names: str, held: np.ndarray) -> Rig:
    """The joints of the parts that are there, and the weights of the others on the joints above them."""
    share = (held * anatomy.character.areas[:, None]).sum(axis=0) / max(anatomy.character.areas.sum(), 1e-30)
    there = (share > 1e-4) | np.isin(HANDLE_NAMES, REQUIRED)
    goes_to = np.arange(len(there))
    for handle, parent in enumerate(HANDLE_PARENTS):
        if not there[handle]:
            goes_to[handle] = goes_to[parent]
    kept = np.flatnonzero(there)
    place = {int(handle): number for number, handle in enumerate(kept)}
    weights = np.zeros((len(held), len(kept)), np.float32)
    for handle, target in enumerate(goes_to):
        weights[:, place[int(target)]] += held[:, handle]
    parents = [place[int(goes_to[HANDLE_PARENTS[handle]])] if handle else -1 for handle in kept]
    labels = [engine_names(names)[handle] for handle in kept]
    positions = heads[kept]
    indices, shares = top_influences(weights, 4)
    if names in ROOTS:
        labels, parents = [ROOTS[names], *labels], [-1, *(parent + 1 for parent in parents)]
        positions, indices = np.concatenate([np.zeros((1, 3)), positions]), indices + 1
    transforms = np.tile(np.eye(4), (len(labels), 1, 1))
    transforms[:, :3, 3] = positions
    return Rig(tuple(labels), np.array(parents), transforms, indices, shares)
