"""Soles of MMD models that a VMD moves by leg IK: how far they are from where the IK targets put them.

The leg's target is where the ankle shall be, the toes' target is where the toes shall point from there. A target can be
farther from the hip than the leg is long, because a VMD made for one model is played on another: such frames are
counted by themselves.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.character import Character
from bunraku.core.mmd_model import MmdIkLink, MmdModel
from bunraku.errors import BunrakuError
from bunraku.formats.mmd.vmd import VmdMotion
from bunraku.geometry.rotations import matrix_from_axis_angle

__all__ = ["leg_reach", "measure_soles", "sole_gaps"]

KEYS = ("soles", "soles_reached", "soles_beyond", "soles_target")
HAIR = 1e-5  # a leg that is stretched to within so much of its reach is as good as there [m]


def measure_soles(folder: str | Path | None, failed: dict[str, str]) -> dict[str, float | None]:
    """Each model of a folder with each VMD that moves legs by their IK targets.

    Args:
        folder: Searched through for .pmx, .pmd and .vmd files; None measures nothing.
        failed: Gets the files that could not be read, and why.

    Returns:
        `soles`, the largest distance of an ankle or toe from where the targets put it, in frames in which the leg
        reaches [m]; `soles_reached`, the share of these; `soles_beyond`, in the other frames the largest distance of an
        ankle from the position nearest to its target that the leg can reach [m]; `soles_target`, the largest from the
        target itself [m]. None without files.
    """
    from bunraku.core.mmd_model import mmd_model
    from bunraku.formats.mmd.vmd import load_vmd
    from bunraku.io import load_character

    files = [] if folder is None else sorted(path for path in Path(folder).rglob("*") if path.is_file())
    motions: dict[str, VmdMotion] = {}
    found: list[dict[str, np.ndarray]] = []
    for path in files:
        if path.suffix.lower() == ".vmd":
            try:
                motions[path.name] = load_vmd(path)
            except BunrakuError as error:
                failed[path.name] = str(error)
    for path in files:
        if path.suffix.lower() in (".pmx", ".pmd"):
            try:
                character = load_character(path)
                model = mmd_model(character)
                assert model is not None
                for vmd in motions.values():
                    if any(_moves(vmd, name) for name in _goals(model)):
                        found += sole_gaps(character, model, vmd)
            except BunrakuError as error:
                failed[path.name] = str(error)
    if not found:
        return dict.fromkeys(KEYS)
    reached, gap, beyond, target = (
        np.concatenate([legs[key] for legs in found]) for key in ("reached", "gap", "beyond", "target")
    )
    return {
        "soles": float(gap[reached].max()) if reached.any() else None,
        "soles_reached": float(reached.mean()),
        "soles_beyond": 0.0 if reached.all() else float(beyond[~reached].max()),
        "soles_target": float(target.max()),
    }


def sole_gaps(character: Character, model: MmdModel, vmd: VmdMotion) -> list[dict[str, np.ndarray]]:
    """Both legs of a model that plays a VMD, at 30 frames a second.

    Args:
        character: That was read from the model; a `transfer` of the VMD onto it is what is measured.
        model: The model.
        vmd: The motion.

    Returns:
        For each leg, arrays of N frames: `reached`, whether the ankle's target is within the leg's reach; `gap`, the
        larger of the ankle's and the toe's distance from where the targets put them [m]; `beyond`, that of the ankle
        from the position nearest to its target that the leg reaches [m]; `target`, that of the ankle from its target
        [m].

    Raises:
        MotionError: The motion moves none of the model's bones.
    """
    from bunraku.retarget.mmd.play import mmd_animation

    positions = mmd_animation(character, vmd).world()[1]
    out = []
    for name, toe_name in _goals(model).items():
        goal, toe_goal = model.bone(name), model.bone(toe_name)
        ik = model.bones[goal].ik
        if ik is None or len(ik.links) != 2:
            continue
        ankle, hip = ik.target, ik.links[1].bone
        away = positions[:, goal] - positions[:, hip]
        distance = np.linalg.norm(away, axis=-1)
        reach = leg_reach(model, ik.links[0], hip, ankle)
        gap = target = np.linalg.norm(positions[:, ankle] - positions[:, goal], axis=-1)
        toe_ik = model.bones[toe_goal].ik if toe_goal >= 0 else None
        if toe_ik is not None:
            line, toe = positions[:, toe_goal] - positions[:, goal], toe_ik.target
            length = np.linalg.norm(model.positions[toe] - model.positions[ankle])
            want = positions[:, goal] + line * (length / np.maximum(np.linalg.norm(line, axis=-1), 1e-9))[:, None]
            gap = np.maximum(gap, np.linalg.norm(positions[:, toe] - want, axis=-1))
        nearest = positions[:, hip] + away * np.minimum(1, reach / np.maximum(distance, 1e-9))[:, None]
        beyond = np.linalg.norm(positions[:, ankle] - nearest, axis=-1)
        out.append({"reached": distance <= reach + HAIR, "gap": gap, "beyond": beyond, "target": target})
    return out


def leg_reach(model: MmdModel, knee: MmdIkLink, hip: int, ankle: int) -> float:
    """How far from the hip the ankle can be [m], with the knee between its limits; for a knee without limits, the leg's
    length.
    """
    rest = model.positions
    thigh, shin = rest[knee.bone] - rest[hip], rest[ankle] - rest[knee.bone]
    if knee.lower is None or knee.upper is None:
        return float(np.linalg.norm(thigh) + np.linalg.norm(shin))
    angles = np.linspace(knee.lower, knee.upper, 3601)
    if np.count_nonzero(np.ptp(angles, axis=0)) > 1:  # more than one axis is free
        return float(np.linalg.norm(thigh) + np.linalg.norm(shin))
    return float(np.linalg.norm(thigh + matrix_from_axis_angle(angles) @ shin, axis=-1).max())


def _goals(model: MmdModel) -> dict[str, str]:
    """The bones whose places are targets of ankles, each with that of its toes."""
    names = {f"{side}足ＩＫ": f"{side}つま先ＩＫ" for side in "左右"}
    return {name: toe for name, toe in names.items() if model.bone(name) >= 0}


def _moves(vmd: VmdMotion, name: str) -> bool:
    track: Any = vmd.bones.get(name)
    return track is not None and len(track.frames) > 1
