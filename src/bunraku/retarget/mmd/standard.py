"""MMD's standard skeleton on the reference body, for motions that come without the model that they were made for.

Keys of a VMD are relative to some model's rest pose and move feet by their inverse kinematics in that model's size.
Those that are shared are made for bodies about 20 units tall whose hips are at 11 and whose arms hang 35 degrees below
level; so is this one.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from bunraku.body.layout import JOINT_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.mmd_model import MMD_METRE, MmdBone, MmdIk, MmdIkLink, MmdModel, MmdSdef, mmd_angles
from bunraku.core.motion import SkeletalMotion
from bunraku.formats.mmd.vmd import VMD_FPS, VmdMotion, load_vmd
from bunraku.retarget.mmd.play import mmd_poses_to_smpl, play_vmd

__all__ = ["standard_model", "vmd_motion"]

_J = {name: index for index, name in enumerate(JOINT_NAMES)}
_HIPS, _CENTRE, _ARMS = 11 * MMD_METRE, 8 * MMD_METRE, np.radians(35)
_KNEE = mmd_angles(np.radians([-180.0, 0, 0]), np.radians([-0.5, 0, 0]))


def vmd_motion(
    motion: VmdMotion | str | Path, model: MmdModel | None = None, *, fps: float = VMD_FPS
) -> SkeletalMotion:
    """A VMD as a motion of SMPL's 22 joints.

    Args:
        motion: The motion, or its file.
        model: The model that it was made for; `standard_model()` by default.
        fps: Frames a second of the result [1/s].

    Raises:
        FormatError: The file cannot be read.
        MotionError: It moves none of the model's bones, or the model lacks MMD's standard names.
    """
    vmd = motion if isinstance(motion, VmdMotion) else load_vmd(motion)
    return mmd_poses_to_smpl(play_vmd(standard_model() if model is None else model, vmd, fps))


@lru_cache(maxsize=1)
def standard_model() -> MmdModel:
    """A model without a mesh: the standard bones with the inverse kinematics of legs and toes, in an A-pose."""
    positions = _a_pose()
    hips = (positions[_J["left_hip"]] + positions[_J["right_hip"]]) / 2
    waist = np.array([0, positions[_J["spine1"], 1], hips[2]])
    bones: list[MmdBone] = []
    number: dict[str, int] = {}

    def add(name: str, position: np.ndarray, parent: str = "", moves: bool = False, ik: MmdIk | None = None) -> None:
        number[name] = len(bones)
        bones.append(
            MmdBone(
                name,
                "",
                np.asarray(position, float),
                number.get(parent, -1),
                layer=int(ik is not None),
                moves=moves,
                ik=ik,
            )
        )

    add("全ての親", np.zeros(3), moves=True)
    add("センター", np.array([0, _CENTRE, 0]), "全ての親", True)
    add("グルーブ", np.array([0, _CENTRE, 0]), "センター", True)
    add("腰", waist, "グルーブ", True)
    add("上半身", waist, "腰")
    add("上半身2", positions[_J["spine3"]], "上半身")
    add("首", positions[_J["neck"]], "上半身2")
    add("頭", positions[_J["head"]], "首")
    add("下半身", waist, "腰")
    for mark, side in (("左", "left"), ("右", "right")):
        for name, joint, parent in (
            ("肩", "collar", "上半身2"),
            ("腕", "shoulder", "肩"),
            ("ひじ", "elbow", "腕捩"),
            ("手首", "wrist", "手捩"),
        ):
            add(mark + name, positions[_J[f"{side}_{joint}"]], parent if parent in number else mark + parent)
            twist = {"腕": ("腕捩", "elbow"), "ひじ": ("手捩", "wrist")}.get(name)
            if twist:  # half way down the limb, turned by keys of its own
                add(
                    mark + twist[0],
                    (positions[_J[f"{side}_{joint}"]] + positions[_J[f"{side}_{twist[1]}"]]) / 2,
                    mark + name,
                )
        for name, joint, parent in (
            ("足", "hip", "下半身"),
            ("ひざ", "knee", "足"),
            ("足首", "ankle", "ひざ"),
            ("つま先", "foot", "足首"),
        ):
            add(mark + name, positions[_J[f"{side}_{joint}"]], parent if parent in number else mark + parent)
        ankle, toe = positions[_J[f"{side}_ankle"]], positions[_J[f"{side}_foot"]]
        links = (MmdIkLink(number[mark + "ひざ"], *_KNEE), MmdIkLink(number[mark + "足"]))
        add(mark + "足IK親", ankle * [1, 0, 1], "全ての親", True)
        add(mark + "足ＩＫ", ankle, mark + "足IK親", True, MmdIk(number[mark + "足首"], 40, 2.0, links))
        add(
            mark + "つま先ＩＫ",
            toe,
            mark + "足ＩＫ",
            True,
            MmdIk(number[mark + "つま先"], 3, 4.0, (MmdIkLink(number[mark + "足首"]),)),
        )
    nothing = np.zeros((0, 3))
    return MmdModel(
        "",
        "standard bones",
        "",
        tuple(bones),
        (),
        (),
        (),
        np.zeros(0, np.uint8),
        MmdSdef(np.zeros(0, int), nothing, nothing, nothing),
    )


def _a_pose() -> np.ndarray:
    """Joints of the reference body with its hips where MMD has them and its arms hanging [m], shape (22, 3)."""
    joints = reference_body().joints.astype(float)
    positions = joints * _HIPS / joints[[_J["left_hip"], _J["right_hip"]], 1].mean()
    positions -= [0, 0, positions[[_J["left_hip"], _J["right_hip"]], 2].mean()]
    for side, sign in (("left", 1), ("right", -1)):
        shoulder = positions[_J[f"{side}_shoulder"]].copy()
        cos, sin = np.cos(_ARMS), -sign * np.sin(_ARMS)
        turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        for part in ("elbow", "wrist"):
            positions[_J[f"{side}_{part}"]] = shoulder + turn @ (positions[_J[f"{side}_{part}"]] - shoulder)
    return positions
