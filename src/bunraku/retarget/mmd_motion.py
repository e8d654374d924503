"""Motions of MMD models: a VMD played on a model or on MMD's standard skeleton, and any motion as keys for a VMD."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from bunraku.anatomy.names.skeleton_map import SkeletonMap, mmd_centre, mmd_skeleton_map
from bunraku.anatomy.names.to_smpl import rotations_of_rest, to_smpl
from bunraku.core.animation import RigAnimation, bone_order
from bunraku.core.avatars import MMD_METRE, MmdBone, MmdIk, MmdIkLink, MmdModel, MmdSdef, mmd_angles, mmd_model
from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.body.reference import leg_length, reference_body
from bunraku.core.character import Character
from bunraku.core.geometry.rotations import Resampling, axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.core.motion import SkeletalMotion, Skeleton, line_up, local_rotations, resample_motion
from bunraku.errors import MotionError
from bunraku.files import VMD_FPS, MmdClip, VmdMotion, load_vmd
from bunraku.retarget.mmd_pose import MmdPoses, pose_mmd

MOST_TRANSFORMS = 20_000_000  # of all bones in all frames: 1 GB


def model_of(target: Character | MmdModel) -> MmdModel:
    """The MMD model of a character; MotionError where it was not read from a PMX or PMD file."""
    model = target if isinstance(target, MmdModel) else mmd_model(target)
    if model is None:
        raise MotionError(f"{target.name}: this character is not an MMD model; load one from a PMX or PMD file")
    return model


def standard_bones(model: MmdModel) -> SkeletonMap:
    """Which bones of a model are which of SMPL's 22 joints; MotionError where they do not have MMD's standard names."""
    bones = mmd_skeleton_map(model.names)
    if bones is None:
        raise MotionError(
            f"{model.name or 'this model'}: its bones do not have MMD's standard names (下半身, 左足, 左ひざ ...)"
        )
    return bones


def play_vmd(target: Character | MmdModel, vmd: VmdMotion, fps: float = VMD_FPS) -> MmdPoses:
    """Pose an MMD model, or the one that a character was read from, by a VMD; bones that it lacks are passed over.
    MotionError where the character is no MMD model, none of its bones has keys, or there are too many frames.
    """
    model = model_of(target)
    bones = {_cut(name, 15): name for name in reversed(model.names)}
    if not bones.keys() & vmd.bones.keys():
        raise MotionError(
            f"the motion moves none of the {len(model.bones)} bones of {model.name or 'this model'}; take one that "
            "was made for MMD's standard bones"
        )
    count = vmd.frame_count(fps)
    if count * len(model.bones) > MOST_TRANSFORMS:
        raise MotionError(
            f"the motion has {count:,} frames for {len(model.bones):,} bones, too many; cut it or ask for fewer "
            "frames a second"
        )
    tracks = {bones[name]: track for name, track in vmd.sample(fps, bones).items()}
    frames = np.arange(count) * (VMD_FPS / fps)
    goals = [bone.name for bone in model.bones if bone.ik is not None]
    on = {name: _switched(vmd, _cut(name, 20), frames) for name in goals}
    return pose_mmd(model, tracks, on, frames=count, fps=fps)


def mmd_animation(character: Character, vmd: VmdMotion, fps: float = VMD_FPS) -> RigAnimation:
    """A VMD on the model's character, as an animation of its own rig; arguments and errors as of `play_vmd`."""
    poses = play_vmd(character, vmd, fps)
    return RigAnimation.of_world(character, poses.rotations, poses.positions, fps)


def _cut(name: str, size: int) -> str:
    """A name as VMD holds it."""
    return name.encode("cp932", "ignore")[:size].decode("cp932", "ignore")


def _switched(vmd: VmdMotion, name: str, frames: np.ndarray) -> np.ndarray:
    """Whether the inverse kinematics of a bone are on at frames of 30 a second."""
    out = np.ones(len(frames), bool)
    for start, states in vmd.switches:
        if name in states:
            out[frames >= start] = states[name]
    return out


def mmd_poses_to_smpl(poses: MmdPoses) -> SkeletalMotion:
    """The motion of SMPL's 22 joints that moves as an MMD model does, inverse kinematics and all; MotionError where the
    bones do not have MMD's standard names.
    """
    bones = standard_bones(poses.model)
    parents = poses.model.parents
    lines = {joint: line_up(joint, parents) for joint in bones.joints if joint >= 0}
    shared = set.intersection(*(set(line) for line in lines.values()))
    root = next((bone for bone in next(iter(lines.values())) if bone in shared), -1)
    if root < 0:
        raise MotionError(f"{poses.model.name or 'this model'}: its legs and arms do not hang on one bone")
    held = {bone for line in lines.values() for bone in line[: line.index(root) + 1]}
    chosen = sorted(held, key=lambda bone: (len(line_up(bone, parents)), bone))
    index = {bone: number for number, bone in enumerate(chosen)}
    above = np.array([index.get(int(parents[bone]), -1) if bone != root else -1 for bone in chosen])
    rest = poses.model.positions[chosen]
    offsets = rest - np.where(above[:, None] >= 0, rest[above], 0)
    local = local_rotations(poses.rotations[:, chosen].astype(float), above)
    skeleton = Skeleton(tuple(poses.model.names[bone] for bone in chosen), above, offsets)
    motion = SkeletalMotion(skeleton, local, poses.positions[:, root], poses.fps)
    joints = tuple(index[joint] if joint >= 0 else -1 for joint in bones.joints)
    return to_smpl(motion, SkeletonMap(joints, bones.how, bones.convention))


_J = {name: index for index, name in enumerate(JOINT_NAMES)}
_SIDED = ("collar", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "foot")
_HIPS, _CENTRE, _ARMS = 11 * MMD_METRE, 8 * MMD_METRE, np.radians(35)
# MMD's own limits of knees, as the standard models' files define them.
_KNEE = mmd_angles(np.radians([-180.0, 0, 0]), np.radians([-0.5, 0, 0]))


def vmd_motion(path: str | Path, fps: float = VMD_FPS) -> SkeletalMotion:
    """A VMD file as a motion of SMPL's 22 joints at a rate [1/s], made for MMD's standard bones; MotionError where it
    moves none of them.
    """
    return mmd_poses_to_smpl(play_vmd(standard_model(), load_vmd(path), fps))


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
        above = number.get(parent, -1)
        bones.append(MmdBone(name, "", np.asarray(position, float), above, int(ik is not None), moves=moves, ik=ik))

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
        at = {part: positions[_J[f"{side}_{part}"]] for part in _SIDED}
        for name, part, parent in (
            ("肩", "collar", "上半身2"), ("腕", "shoulder", "肩"), ("ひじ", "elbow", "腕捩"), ("手首", "wrist", "手捩"),
            ("足", "hip", "下半身"), ("ひざ", "knee", "足"), ("足首", "ankle", "ひざ"), ("つま先", "foot", "足首"),
        ):  # fmt: skip
            add(mark + name, at[part], parent if parent in number else mark + parent)
            twist = {"腕": ("腕捩", "elbow"), "ひじ": ("手捩", "wrist")}.get(name)
            if twist:  # half way down the limb, rotated by keys of its own
                add(mark + twist[0], (at[part] + at[twist[1]]) / 2, mark + name)
        ankle, toe = at["ankle"], at["foot"]
        links = (MmdIkLink(number[mark + "ひざ"], *_KNEE), MmdIkLink(number[mark + "足"]))
        add(mark + "足IK親", ankle * [1, 0, 1], "全ての親", True)
        add(mark + "足ＩＫ", ankle, mark + "足IK親", True, MmdIk(number[mark + "足首"], 40, 2.0, links))
        toes = MmdIk(number[mark + "つま先"], 3, 4.0, (MmdIkLink(number[mark + "足首"]),))
        add(mark + "つま先ＩＫ", toe, mark + "足ＩＫ", True, toes)
    nothing = np.zeros((0, 3))
    blends = MmdSdef(np.zeros(0, int), nothing, nothing, nothing)
    return MmdModel("", "standard bones", "", tuple(bones), (), (), (), np.zeros(0, np.uint8), blends)


def _a_pose() -> np.ndarray:
    """Joints of the reference body with its hips where MMD has them and its arms hanging [m], shape (22, 3)."""
    joints = reference_body().joints.astype(float)
    hips = [_J["left_hip"], _J["right_hip"]]
    positions = joints * _HIPS / joints[hips, 1].mean()
    positions -= [0, 0, positions[hips, 2].mean()]
    for side, sign in (("left", 1), ("right", -1)):
        shoulder = positions[_J[f"{side}_shoulder"]].copy()
        cos, sin = np.cos(_ARMS), -sign * np.sin(_ARMS)
        turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        for part in ("elbow", "wrist"):
            positions[_J[f"{side}_{part}"]] = shoulder + turn @ (positions[_J[f"{side}_{part}"]] - shoulder)
    return positions


_LEGS = ("left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle")


def mmd_motion(target: Character | MmdModel, motion: SkeletalMotion) -> MmdClip:
    """A motion of SMPL's 22 joints as keys of an MMD model's bones.

    Args:
        motion: Of SMPL's 22 joints, as `to_smpl` gives it; at any rate.

    Returns:
        Keys at 30 frames a second of the centre and of all bones that play a joint's part.

    Raises:
        MotionError: The character is no MMD model, its bones lack MMD's standard names, or the motion has other joints.
    """
    model = model_of(target)
    if motion.skeleton.names != JOINT_NAMES:
        raise MotionError("MMD models take motions of SMPL's 22 joints; use bunraku.anatomy.names.to_smpl first")
    mapped = standard_bones(model)
    motion = resample_motion(motion, VMD_FPS)
    wanted, centre = _wanted(model, mapped, motion)
    parents, rest = model.parents, model.positions
    joint_rotations = np.tile(np.eye(3), (len(motion), len(parents), 1, 1))
    positions = np.broadcast_to(rest, (len(motion), *rest.shape)).copy()
    local: dict[int, np.ndarray] = {}
    for bone in bone_order(parents):
        parent = int(parents[bone])
        above = joint_rotations[:, parent] if parent >= 0 else np.eye(3)
        if bone in wanted:
            local[bone] = np.swapaxes(above, -1, -2) @ wanted[bone]
            joint_rotations[:, bone] = wanted[bone]
        else:
            joint_rotations[:, bone] = above
        if parent >= 0:
            away = np.einsum("nij,j->ni", joint_rotations[:, parent], rest[bone] - rest[parent])
            positions[:, bone] = positions[:, parent] + away
    hips = [mapped.of("left_hip"), mapped.of("right_hip")]
    shift = _hips(model, mapped, motion) - positions[:, hips].mean(axis=1)
    still = np.zeros_like(shift)
    bones = {model.names[bone]: (shift if bone == centre else still, rotations) for bone, rotations in local.items()}
    return MmdClip(bones, model.name, _leg_goals(model))


def _wanted(model: MmdModel, found: SkeletonMap, motion: SkeletalMotion) -> tuple[dict[int, np.ndarray], int]:
    """World rotation of each bone that plays a part, shape (N, 3, 3), and the bone that carries the body."""
    world = motion.world()[0].astype(float)
    back = np.swapaxes(rotations_of_rest(found, model.positions), -1, -2)
    out = {bone: world[:, joint] @ back[joint] for joint, bone in enumerate(found.joints) if bone >= 0}
    centre = mmd_centre(model.names, model.parents, found)
    out[centre] = world[:, 0] @ back[0]
    return out, centre


def _hips(model: MmdModel, found: SkeletonMap, motion: SkeletalMotion) -> np.ndarray:
    """Where the model's hips shall be [m], (N, 3): as far above its ankles as the motion's, by the legs' ratio."""
    hips = motion.world()[1][:, [_J["left_hip"], _J["right_hip"]]].mean(axis=1).astype(float)
    rest = motion.skeleton.positions.astype(float)
    points, reference = model.positions, reference_body().joints
    joints = [found.of(name) for name in _LEGS]
    sides = joints[0::2], joints[1::2]
    legs = [np.linalg.norm(points[a] - points[b]) + np.linalg.norm(points[b] - points[c]) for a, b, c in sides]
    length = float(np.mean(legs))
    source = leg_length(rest)
    feet = [_J["left_foot"], _J["right_foot"]]
    toes = reference[feet, 1].mean() * source / leg_length(reference)
    low = toes - motion.skeleton.offsets[feet, 1].mean()  # of the source's ankles above its floor
    ratio = length / max(source, 1e-9)
    return np.asarray(hips * ratio + [0, points[joints[4:6], 1].mean() - low * ratio, 0])


def mmd_clip(animation: RigAnimation) -> MmdClip:
    """An animation of an MMD character's rig as keys of its bones, resampled to 30 frames a second; MotionError where
    the character is no MMD model.

    What a bone takes over of another ("grant") is taken off its keys again, since MMD adds it. Bones that stand still
    on their parents have no keys: those of them that take over follow in MMD as the model's maker meant them to.
    """
    model = model_of(animation.character)
    rotations, translations = _resampled(animation)
    return MmdClip(_keys(model, rotations, translations), model.name, _leg_goals(model))


def _keys(model: MmdModel, rotations: np.ndarray, translations: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Keys of bones that move, from how each stands on its parent: rotations (N, B, 3, 3), translations (N, B, 3)."""
    keyed_rotations, keyed_moves = rotations.copy(), translations.copy()
    still = _still(rotations, translations)
    keyed_rotations[:, still], keyed_moves[:, still] = np.eye(3), 0
    taken_rotations: dict[int, np.ndarray] = {}
    taken_moves: dict[int, np.ndarray] = {}
    for bone in model.order:
        append = model.bones[bone].append
        if append is not None and append.rotation:
            keyed = taken_rotations.get(append.bone, keyed_rotations[:, append.bone])
            source = rotations[:, append.bone] if append.local else keyed
            taken_rotations[bone] = matrix_from_axis_angle(append.ratio * axis_angle_from_matrix(source))
            if not still[bone]:
                keyed_rotations[:, bone] = rotations[:, bone] @ np.swapaxes(taken_rotations[bone], -1, -2)
        if append is not None and append.translation:
            keyed = taken_moves.get(append.bone, keyed_moves[:, append.bone])
            move = translations[:, append.bone] if append.local else keyed
            taken_moves[bone] = append.ratio * move
            if not still[bone]:
                keyed_moves[:, bone] = translations[:, bone] - taken_moves[bone]
    moving = np.flatnonzero(~_still(keyed_rotations, keyed_moves))
    return {model.names[bone]: (keyed_moves[:, bone], keyed_rotations[:, bone]) for bone in moving}


def _still(rotations: np.ndarray, translations: np.ndarray) -> np.ndarray:
    """Bones that stand on their parents as they do at rest, shape (B,), bool."""
    return np.asarray(
        (np.abs(rotations - np.eye(3)).max(axis=(0, 2, 3)) < 1e-5) & (np.abs(translations).max(axis=(0, 2)) < 1e-5)
    )


def _resampled(animation: RigAnimation) -> tuple[np.ndarray, np.ndarray]:
    """Local rotations (N, B, 3, 3) and translations (N, B, 3) at 30 frames a second."""
    rotations, translations = animation.rotations.astype(float), animation.translations.astype(float)
    if abs(animation.fps - VMD_FPS) < 1e-6 or len(animation) == 1:
        return rotations, translations
    between = Resampling.of(len(animation), animation.fps, VMD_FPS)
    return between.rotations(rotations), between.linear(translations)


def _leg_goals(model: MmdModel) -> tuple[str, ...]:
    """Bones whose inverse kinematics move legs or feet; all that have some where the names do not say what legs are."""
    bones = mmd_skeleton_map(model.names)
    goals = [(bone.name, {link.bone for link in bone.ik.links}) for bone in model.bones if bone.ik is not None]
    legs = None if bones is None else {bones.of(name) for name in _LEGS}
    return tuple(name for name, links in goals if legs is None or legs & links)
