"""The apparel of an animation, whatever its character is: as it is, simulated by its file's physics, by the bones of
its hair and clothes or by chains laid over its mesh, or learned.

`auto` takes the file's physics, or else its bones, or else lays chains where the mesh has apparel, or else leaves all
with the body; a mask says which vertices are apparel.
"""

from __future__ import annotations

import logging
from functools import lru_cache
from pathlib import Path

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.apparel.body import UnifiedBody, eq4_transforms
from bunraku.apparel.chains.body_collisions import CHAIN_REPAIRS, BindToSkin
from bunraku.apparel.chains.chain import parameters_beside
from bunraku.apparel.chains.chain_rig import on_handle_rig
from bunraku.apparel.chains.cloth_repairs import DressedChains, MendTears
from bunraku.apparel.chains.from_shape import with_parts_from_file
from bunraku.apparel.chains.moving import moving_rig, steady_simulation, with_apparel
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.fitting import eased_border
from bunraku.apparel.learned.network import DisplacementNetwork, load_displacement
from bunraku.apparel.learned.player import ApparelPlayer
from bunraku.apparel.mask import artist_mask, artist_mask_file, read_artist_mask
from bunraku.apparel.physics.clothed_from_file import clothed_from_file
from bunraku.apparel.physics.rig import apparel_rig
from bunraku.core.animation import Animation, PointAnimation, RigAnimation
from bunraku.core.body.layout import JOINT_COUNT
from bunraku.core.character import Character
from bunraku.core.nn.checkpoints import dated_checkpoint
from bunraku.core.request import Progress
from bunraku.errors import CharacterError
from bunraku.pipelines.apply import LEAST
from bunraku.pipelines.clothes import (
    body_of_handles,
    excess_apparel_note,
    may_have_apparel,
    separate_apparel,
    with_apparel_chains,
)
from bunraku.pipelines.requests import Apparel

RATE = 30.0
RELAID = 3
"""How often chains are laid anew without the parts that they tear."""
_log = logging.getLogger(__name__)


@lru_cache(maxsize=2)
def _network(path: Path, changed: int) -> DisplacementNetwork:
    return load_displacement(path)


def shipped_displacement(clothed: ClothedCharacter | None = None) -> DisplacementNetwork:
    """The displacement network that comes with Bunraku: there is one for characters whose files say how their apparel
    swings, and one for those of which it is guessed; the first when None. WeightsError where it is missing or broken.
    """
    from_file = clothed is None or clothed.swing is not None
    return _network(*dated_checkpoint("apparel" if from_file else "apparel-guessed"))


def dressed(
    animation: Animation | RigAnimation, apparel: Apparel, progress: Progress | None = None,
    anatomy: Anatomy | None = None,
) -> Animation | RigAnimation | PointAnimation:  # fmt: skip
    """An animation, in which apparel goes with the body, with its apparel moved. The anatomy, of the character by the
    handles that move it, is found where it is needed and None.

    Raises:
        OptionError: Apparel cannot move so.
        CharacterError: It is to be simulated without physics, or learned where there is none.
        FormatError: The mask is broken or belongs to another mesh.
        WeightsError: The shipped weights are missing or broken.
    """
    apparel.check()
    if not apparel.moves:
        return animation
    auto = apparel.motion == "auto"
    of_bones = auto and isinstance(animation, RigAnimation) and moving_rig(animation.character) is not None
    if of_bones or apparel.motion == "simulate":
        return with_apparel(animation, progress, apparel.stiffness, apparel.gravity)
    if auto:
        if not _person(animation, anatomy):
            return animation
        clothed, _, _ = animated_clothed(animation)
        if _little(animation.character, clothed.apparel):
            return animation
        problem = (
            "" if artist_mask_file(animation.character) else excess_apparel_note(animation.character, clothed.apparel)
        )
        if problem:
            _log.warning("%s", problem)
            return animation
        try:
            return _untorn(animation, clothed, apparel, progress)
        except CharacterError:  # all of it is too short to swing
            return animation
    if apparel.motion == "chains":
        clothed, _, _ = animated_clothed(animation)
        return _untorn(animation, clothed, apparel, progress)
    mask = None if apparel.mask is None else read_artist_mask(apparel.mask, animation.character)
    return learned(animation, mask, apparel.stiffness, progress)


def chained(
    animation: Animation | RigAnimation, clothed: ClothedCharacter, apparel: Apparel, progress: Progress | None
) -> tuple[RigAnimation, DressedChains]:
    """An animation on its bones, or on its handles as bones, with further bones for its apparel, which are simulated,
    and what the chains are laid over. CharacterError where no part of the mesh is apparel that chains can be laid over.
    """
    progress = progress or (lambda stage, done: None)
    progress("apparel", 0.0)
    moved, bones = _boned(animation)
    assert moved.character.rig is not None
    chain_rig = with_apparel_chains(moved.character, clothed, bones, apparel.stiffness, apparel.gravity)
    dressed = DressedChains(chain_rig, clothed, bones, moved.character.rig)
    result = steady_simulation(
        chain_rig.on(moved), chain_rig.rig(tied=False), progress=lambda done: progress("apparel", done)
    )
    for problem in result.report.problems():
        _log.warning("%s: %s", animation.character.name, problem)
    calm = result.animation
    for repair in CHAIN_REPAIRS:
        calm = repair(calm, dressed)
    return calm, dressed


def _boned(animation: Animation | RigAnimation) -> tuple[RigAnimation, np.ndarray]:
    """An animation on its bones, or on its handles as bones, and the bone that each of the 22 joints is."""
    body = _unified(animation.character) if isinstance(animation, RigAnimation) else None
    if body is not None and isinstance(animation, RigAnimation):
        return animation.at(RATE), body.bones
    handles = animation.animation() if isinstance(animation, RigAnimation) else animation
    return on_handle_rig(handles.at(RATE)), np.arange(JOINT_COUNT)


def _little(character: Character, apparel: np.ndarray) -> bool:
    """Whether so little of a mesh is apparel that it has none."""
    areas = character.areas
    return float(areas[apparel].sum()) < LEAST * float(areas.sum())


def _untorn(
    animation: Animation | RigAnimation, clothed: ClothedCharacter, apparel: Apparel, progress: Progress | None
) -> Animation | RigAnimation:
    """`chained` with its tears mended. Parts that are torn all the same go with the body; the animation comes back as
    it is where that is all apparel. Parts of an artist's mask move all the same, and a line says so.
    """
    plain, drawn = animation.at(RATE), artist_mask_file(animation.character) is not None
    name = animation.character.name
    for attempt in range(RELAID):
        try:
            mended, dressed = chained(animation, clothed, apparel, progress)
        except CharacterError:
            if attempt:
                break
            raise
        mended, torn = MendTears()(BindToSkin()(mended, plain, dressed), plain, dressed)
        if not torn:
            return mended
        if drawn:
            _log.warning("%s: %d parts of the mask are torn; paint them to an edge of their surface", name, len(torn))
            return mended
        _log.warning("%s: %d parts of hair or clothes would be torn and go with the body", name, len(torn))
        kept = clothed.apparel & ~np.isin(clothed.part, list(torn))
        if _little(animation.character, kept):
            break
        clothed, _, _ = animated_clothed(animation, kept)
    return animation


def animated_clothed(
    animation: Animation | RigAnimation, mask: np.ndarray | None = None, *, stiffness: float = 1.0
) -> tuple[ClothedCharacter, np.ndarray, Animation]:
    """The character of an animation as the networks see it, its joints' transforms (N, 22, 3, 4), and the animation, at
    30 frames a second. Vertices of the mask are apparel; the file's, or else what the part network finds, when None.
    """
    character = animation.character
    moved = animation.at(RATE)
    if mask is None:
        mask = artist_mask(character)
    body = _unified(character) if isinstance(moved, RigAnimation) else None
    if body is not None and isinstance(moved, RigAnimation):
        transforms, joints, weights = body.transforms(moved), body.joints, body.weights
        if mask is None and apparel_rig(character) is not None:
            return clothed_from_file(character, body, stiffness), transforms, moved.animation()
    else:
        moved = moved.animation() if isinstance(moved, RigAnimation) else moved
        weights, joints = body_of_handles(character, moved.handles)
        affine = moved.motion.transforms(moved.handles.positions)[:, : len(joints)]
        positions = np.einsum("njab,jb->nja", affine[..., :3], joints) + affine[..., 3]
        transforms = np.concatenate([affine[..., :3], positions[..., None]], axis=3).astype(np.float32)
    clothed = separate_apparel(character, joints, weights, mask, stiffness)
    return clothed, transforms, moved.animation() if isinstance(moved, RigAnimation) else moved


def _person(animation: Animation | RigAnimation, anatomy: Anatomy | None) -> bool:
    """Whether apparel is looked for on a character that is animated; where an artist says what is, always."""
    character = animation.character
    if artist_mask(character) is not None:
        return True
    if isinstance(animation, RigAnimation):
        return _unified(character) is not None
    return may_have_apparel(anatomy or Anatomy.of(character, animation.handles))


def _unified(character: Character) -> UnifiedBody | None:
    """The 22 joints of a person's rig; None for other rigs."""
    try:
        return UnifiedBody.of(character)
    except CharacterError:
        return None


def learned(
    animation: Animation | RigAnimation, mask: np.ndarray | None = None, stiffness: float = 1.0,
    progress: Progress | None = None, safe: bool = True,
) -> PointAnimation:  # fmt: skip
    """An animation at 30 frames a second whose apparel the displacement network moves: vertices of the mask (V,), of
    the file's, or else what the part network finds. CharacterError where there is none.
    """
    clothed, transforms, moved = animated_clothed(animation, mask, stiffness=stiffness)
    clothed = with_parts_from_file(clothed, parameters_beside(animation.character))
    if not clothed.apparel.any():
        raise CharacterError(
            f"{moved.character.name}: no apparel was found on this mesh; name its vertices in a mask (--apparel "
            "mask.npy)"
        )
    progress = progress or (lambda stage, done: None)
    player = ApparelPlayer(clothed, shipped_displacement(clothed), safe=safe)
    player.start(transforms[0])
    chosen = player.carrier.vertices
    skinned = moved.vertices()
    positions = np.zeros((len(transforms), len(chosen), 3), np.float32)
    for frame, pose in enumerate(transforms):
        positions[frame] = player.advance(pose)
        if frame % 16 == 0:
            progress("apparel", frame / len(transforms))
    offsets = np.zeros((len(transforms), len(clothed.rest), 3), np.float32)
    offsets[:, chosen] = eased_border(clothed)[chosen, None] * (positions - skinned[:, chosen])
    if safe:
        bind = BindToSkin()
        frames = bind.seen(len(transforms))
        affine = eq4_transforms(transforms[frames], clothed.joints)
        offsets *= bind.free(clothed, affine, skinned[frames] + offsets[frames], skinned[frames])[:, None]
    progress("apparel", 1.0)
    return PointAnimation(moved, offsets)
