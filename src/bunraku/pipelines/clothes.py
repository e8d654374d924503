"""What of a character is apparel, and a rig with bones for it, without any motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.apparel.chains.chain import parameters_beside, with_parameters
from bunraku.apparel.chains.chain_rig import Chained, LaidChains, handle_rig, with_chains
from bunraku.apparel.chains.from_shape import shape_chains
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.fitting import (
    carried,
    fitted_clothes,
    fitted_rig,
    joint_weights_of_handles,
    joints_of_handles,
)
from bunraku.apparel.mask import apparel_mask, artist_mask
from bunraku.apparel.parts import parts_of
from bunraku.core.body.layout import HANDLE_COUNT, JOINT_COUNT, JOINT_PARENTS, engine_names
from bunraku.core.character import Character, Handles
from bunraku.errors import CharacterError
from bunraku.retarget.engine_skeleton import on_skeleton, t_pose

MOST = 0.75
"""Share of the surface above which an apparel mask is doubted; chosen by eye."""
ONE, STIFF = 0.99, 0.8
"""A machine or a skeleton: more than 0.8 of its surface has one handle with a weight above 0.99; chosen by eye."""


def body_of_handles(character: Character, handles: Handles) -> tuple[np.ndarray, np.ndarray]:
    """Weights (V, 22) and positions (22, 3) [m] of the joints that the 30 handles of a body stand for; CharacterError
    where the handles are not the 30 of a body.
    """
    if len(handles.positions) < HANDLE_COUNT:
        raise CharacterError(f"{character.name}: its handles are not the 30 of a body; let them be predicted")
    weights = joint_weights_of_handles(handles)
    return weights, joints_of_handles(character.vertices, weights, character.areas, handles.positions)


def separate_apparel(
    character: Character, joints: np.ndarray, weights: np.ndarray, mask: np.ndarray | None, stiffness: float = 1.0
) -> ClothedCharacter:
    """A character with its apparel separated from its body, each part on the joint that carries it.

    Args:
        joints: Positions of the 22 joints [m], shape (22, 3).
        weights: Of the vertices for them, shape (V, 22).
        mask: Vertices that are apparel; what the part network finds when None.
        stiffness: Factor on how stiff they are.
    """
    parts = parts_of(character)
    return fitted_clothes(
        character.vertices, character.faces, joints, weights, parts.hangs if mask is None else mask, parts, stiffness
    )


def excess_apparel_note(character: Character, apparel: np.ndarray) -> str:
    """What to say where the apparel that the network found on a mesh, shape (V,), is so much that it is hardly true; ""
    where it is not.
    """
    share = float(character.areas[apparel].sum() / max(float(character.areas.sum()), 1e-30))
    if share <= MOST:
        return ""
    return (
        f"{character.name}: {share:.0%} of this mesh was taken for apparel, which is hardly true; name its vertices in "
        "a mask (--apparel mask.npy)"
    )


def may_have_apparel(anatomy: Anatomy) -> bool:
    """Whether what the part network finds on a body counts. It was trained on people: it takes the legs of a
    horse for sleeves and the plates of a machine for skirts. A person's long hair may have been taken for wings.
    """
    areas = anatomy.character.areas
    stiff = float(areas[anatomy.handles.weights.max(axis=1) > ONE].sum()) > STIFF * float(areas.sum())
    plan = anatomy.plan
    return (plan.kind == "person" or (plan.kind == "two legs" and plan.upright and plan.wings)) and not stiff


def with_apparel_chains(
    character: Character, clothed: ClothedCharacter, bones: np.ndarray, stiffness: float = 1.0, gravity: float = 1.0
) -> Chained:
    """A character with a rig, and with chains of bones over its apparel. `bones` (22,) are those that each of the 22
    joints is; stiffness and gravity are factors. CharacterError where there is no apparel that chains can be laid over.
    """
    laid = _laid(character, clothed, stiffness, gravity)
    return with_chains(fitted_rig(character, clothed, bones), laid, bones)


def rig_with_chains(
    anatomy: Anatomy, skeleton: str | None = None, mask: np.ndarray | None = None, stiffness: float = 1.0,
    gravity: float = 1.0, clothed: ClothedCharacter | None = None,
) -> Chained:  # fmt: skip
    """A character with bones for its body, handles or a skeleton in a T-pose, and for its apparel.

    Args:
        skeleton: Whose names the bones get, as of `on_skeleton`; None for the handles.
        mask: As of `clothed_of`.
        stiffness, gravity: Factors.
        clothed: What `clothed_of` says of it, where that is known.

    Raises:
        CharacterError: No part of the mesh is apparel that chains can be laid over, or it is no person.
    """
    character, handles = anatomy.character, anatomy.handles
    clothed = clothed or clothed_of(anatomy, mask)
    if skeleton is None:
        return with_apparel_chains(handle_rig(character, handles), clothed, np.arange(JOINT_COUNT), stiffness, gravity)
    laid = _laid(character, clothed, stiffness, gravity)
    share, joint = carried(clothed)
    carrier = np.eye(handles.weights.shape[1], dtype=np.float32)[joint]
    shown = on_skeleton(anatomy, skeleton, handles.weights * (1 - share[:, None]) + carrier * share[:, None])
    assert shown.rig is not None
    place = {name: bone for bone, name in enumerate(shown.rig.names)}
    names, bones = engine_names(skeleton), np.zeros(JOINT_COUNT, np.int64)
    for number, parent in enumerate(JOINT_PARENTS):
        bones[number] = place.get(names[number], int(bones[parent]) if parent >= 0 else 0)
    return with_chains(shown, laid.moved(t_pose(anatomy)[0][:JOINT_COUNT]), bones)


def clothed_of(anatomy: Anatomy, mask: np.ndarray | None = None) -> ClothedCharacter:
    """A character whose apparel is looked for, as the networks see it. Vertices of the mask are apparel; what the file
    says, or else what the part network finds, when None. CharacterError where it is no person, or so much was taken for
    apparel that it is hardly true.
    """
    character, handles = anatomy.character, anatomy.handles
    weights, joints = body_of_handles(character, handles)
    if mask is None:
        mask = artist_mask(character)
    if mask is None and character.rig is not None:
        mask = apparel_mask(character)
    if mask is None and not may_have_apparel(anatomy):
        raise CharacterError(
            f"{character.name}: it is {anatomy.plan.words}, on which no apparel is looked for; name its vertices in a "
            "mask (--apparel mask.npy)"
        )
    clothed = separate_apparel(character, joints, weights, mask)
    problem = excess_apparel_note(character, clothed.apparel) if mask is None else ""
    if problem:
        raise CharacterError(problem)
    return clothed


def _laid(character: Character, clothed: ClothedCharacter, stiffness: float, gravity: float) -> LaidChains:
    laid = shape_chains(clothed)
    laid = replace(laid, chains=with_parameters(laid.chains, parameters_beside(character))).turned(stiffness, gravity)
    if not laid.chains:
        raise CharacterError(
            f"{character.name}: no apparel was found on this mesh that could swing; name its vertices in a mask "
            "(--apparel mask.npy)"
        )
    return laid
