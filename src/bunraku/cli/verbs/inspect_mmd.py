"""What `bunraku inspect` says of MMD models, their motions, and VRM avatars."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bunraku.core.character import Character

__all__ = ["mmd_facts", "vmd_facts", "vrm_facts"]


def mmd_facts(character: Character) -> dict[str, Any]:
    """Bones, morphs, physics and apparel of a character that was read from a PMX or PMD file; nothing of any other."""
    import numpy as np

    from bunraku.apparel.mask import apparel_mask
    from bunraku.core.mmd_model import mmd_model

    model = mmd_model(character)
    if model is None:
        return {}
    mask = apparel_mask(character, model)
    deforms = np.bincount(model.deforms, minlength=5)
    kinds = dict(zip(("BDEF1", "BDEF2", "BDEF4", "SDEF", "QDEF"), map(int, deforms), strict=True))
    return {
        "model": " / ".join(dict.fromkeys(name for name in (model.name, model.english) if name)),
        "version": model.version,
        "bones": len(model.bones),
        "bones_that_take_over": sum(bone.append is not None for bone in model.bones),
        "inverse_kinematics": [bone.name for bone in model.bones if bone.ik is not None],
        "morphs": len(model.morphs),
        "rigid_bodies": len(model.bodies),
        "rigid_bodies_dynamic": sum(body.dynamic for body in model.bodies),
        "rigid_joints": len(model.joints),
        "apparel_vertices": 0 if mask is None else int(mask.sum()),
        **_drawn(character),
        "deforms": {kind: count for kind, count in kinds.items() if count},
        "warnings": list(model.warnings),
    }


def vmd_facts(path: Path) -> dict[str, Any]:
    """What a VMD file holds.

    Raises:
        FormatError: The file cannot be read.
    """
    from bunraku.formats.mmd.vmd import VMD_FPS, load_vmd
    from bunraku.skeletons.mmd_names import mmd_skeleton_map

    motion = load_vmd(path)
    return {
        "kind": "MMD motion",
        "model": motion.model,
        "frames": motion.last_frame + 1,
        "fps": VMD_FPS,
        "seconds": round(motion.last_frame / VMD_FPS, 3),
        "bones": sorted(motion.bones),
        "morphs": sorted(motion.morphs),
        "keys": sum(len(track.frames) for track in motion.bones.values()),
        "convention": "MikuMikuDance" if mmd_skeleton_map(list(motion.bones)) is not None else "unknown",
        "inverse_kinematics_off": sorted(
            {name for _, states in motion.switches for name, on in states.items() if not on}
        ),
    }


def vrm_facts(character: Character) -> dict[str, Any]:
    """The person's bones, springs and colliders of a VRM avatar; nothing of any other character."""
    from bunraku.apparel.mask import apparel_mask
    from bunraku.core.vrm_model import vrm_model

    model = vrm_model(character)
    if model is None:
        return {}
    mask = apparel_mask(character, model)
    return {
        "vrm_version": model.version,
        "title": model.title,
        "humanoid_bones": len(model.humanoid),
        "spring_chains": len(model.springs),
        "spring_joints": sum(len(spring.joints) for spring in model.springs),
        "colliders": len(model.colliders),
        "apparel_vertices": 0 if mask is None else int(mask.sum()),
        **_drawn(character),
        "warnings": list(model.warnings),
    }


def _drawn(character: Character) -> dict[str, Any]:
    """The file of a mask that somebody made by hand."""
    from bunraku.apparel.artist_mask import artist_mask_file

    path = artist_mask_file(character)
    return {} if path is None else {"apparel_mask": path.name}
