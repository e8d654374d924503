"""Write a person as VRM 1.0: a GLB in a T-pose whose bones are those of a humanoid, with springs and colliders."""

from __future__ import annotations

from pathlib import Path

from bunraku.core.character import Character, Handles
from bunraku.core.vrm_model import VrmModel
from bunraku.errors import CharacterError
from bunraku.formats.files import check_output_folder
from bunraku.formats.gltf.scene.spring_write import add_springs
from bunraku.formats.gltf.write import finish_document
from bunraku.formats.gltf.write_rig import plain_rig

__all__ = ["write_avatar"]


def write_avatar(
    character: Character, handles: Handles | None, path: Path, *, rig: bool = False, avatar: VrmModel | None = None
) -> Path:
    """Write a person on a skeleton with VRM's names.

    Args:
        character: With a rig in a T-pose, as `bunraku.with_skeleton(character, "vrm")` makes one.
        handles: None; a VRM has bones.
        path: The file.
        rig: Whether the rig is what is to be written.
        avatar: Springs and colliders of its bones.

    Raises:
        CharacterError: It has no such rig.
        FormatError: The file cannot be written.
    """
    hint = "make one with --skeleton vrm, or with `bunraku.with_skeleton`"
    if character.rig is None or not rig or handles is not None:
        raise CharacterError(f"{character.name}: a VRM needs a skeleton with VRM's names; {hint}")
    check_output_folder(path)
    builder, nodes = plain_rig(character)
    if "VRMC_vrm" not in builder.tree.get("extensions", {}):
        raise CharacterError(f"{character.name}: its rig is not that of a VRM in a T-pose; {hint}")
    if avatar is not None:
        add_springs(builder.tree, avatar, nodes)
    return finish_document(builder, path)
