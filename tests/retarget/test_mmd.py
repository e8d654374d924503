"""MMD bones: what they take over, inverse kinematics, and the way to SMPL's joints and back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mmd_bytes import Bone, plank, pmx
from scipy.spatial.transform import Rotation

from bunraku.core.animation import bone_order
from bunraku.core.avatars import MmdAppend, MmdBone, MmdIk, MmdIkLink, mmd_model
from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.character import Rig
from bunraku.core.motion import SkeletalMotion
from bunraku.errors import FormatError, MotionError, OptionError
from bunraku.files import load_character
from bunraku.files.mmd.vmd import VmdMotion, VmdTrack, load_vmd, pack_vmd, read_vmd
from bunraku.retarget.creatures import stick_character
from bunraku.retarget.mmd_motion import (
    mmd_animation,
    mmd_clip,
    mmd_motion,
    mmd_poses_to_smpl,
    play_vmd,
    standard_model,
    vmd_motion,
)
from bunraku.retarget.mmd_pose import pose_mmd, pose_work
from bunraku.retarget.to_rig import fit_rig


def about(x=0.0, y=0.0, z=0.0):
    return Rotation.from_rotvec([x, y, z]).as_matrix()


def degrees(a, b):
    return np.degrees(
        2 * np.arcsin(np.clip(np.linalg.norm(np.asarray(a, float) - b, axis=(-1, -2)) / np.sqrt(8), 0, 1))
    )


def track(rotation=None, position=(0, 0, 0), frames=1):
    turns = np.broadcast_to(np.eye(3) if rotation is None else rotation, (frames, 3, 3))
    return np.broadcast_to(np.asarray(position, float), (frames, 3)), turns


def model_of(*bones):
    return replace(standard_model(), bones=bones)


def bone(name, position, parent=-1, **more):
    return MmdBone(name, "", np.array(position, float), parent, **more)


def test_what_bones_take_over():
    given = about(0.4, -0.6, 0.2)
    model = model_of(
        bone("a", (0, 0, 0)),
        bone("half", (1, 0, 0), append=MmdAppend(0, 0.5, True, True)),
        bone("half of half", (2, 0, 0), append=MmdAppend(1, 0.5, True, False)),
        bone("against", (3, 0, 0), 0, append=MmdAppend(0, -1.0, True, False)),
        bone("below", (1, 1, 0), 1),
    )
    poses = pose_mmd(model, {"a": track(given, (0.3, 0, 0)), "half": track(about(y=0.1))})
    half = Rotation.from_rotvec(0.5 * Rotation.from_matrix(given).as_rotvec()).as_matrix()
    quarter = Rotation.from_rotvec(0.25 * Rotation.from_matrix(given).as_rotvec()).as_matrix()
    assert np.allclose(poses.rotations[0, 1], about(y=0.1) @ half, atol=1e-6) and np.allclose(
        poses.positions[0, 1], [1.15, 0, 0]
    )
    assert np.allclose(poses.rotations[0, 2], quarter, atol=1e-6)  # of what is taken over, not of the bone's own keys
    assert np.allclose(poses.rotations[0, 3], np.eye(3), atol=1e-6)  # its parent's turn is taken back
    assert np.allclose(poses.positions[0, 4], poses.positions[0, 1] + poses.rotations[0, 1] @ [0, 1, 0], atol=1e-6)


def test_what_is_deformed_later_sees_what_was_deformed_before():
    early = bone("late source", (0, 0, 0), layer=2, append=MmdAppend(2, 1.0, True, False))
    model = model_of(
        early, bone("follower", (1, 0, 0), layer=1, append=MmdAppend(0, 1.0, True, False)), bone("keyed", (2, 0, 0))
    )
    poses = pose_mmd(model, {"keyed": track(about(x=0.5))})
    assert np.allclose(poses.rotations[0, 0], about(x=0.5), atol=1e-6)
    assert np.allclose(poses.rotations[0, 1], np.eye(3))  # it came before
    later = model_of(early, replace(model.bones[1], after_physics=True), model.bones[2])
    assert np.allclose(pose_mmd(later, {"keyed": track(about(x=0.5))}).rotations[0, 1], about(x=0.5), atol=1e-6)


def legs(frames=40, seed=0):
    """Feet that move about within reach, on a body that turns."""
    rng, time = np.random.default_rng(seed), np.linspace(0, 6, frames)[:, None]
    feet = {
        mark: np.array([0.1, 0.15, 0.3]) * np.sin(time * rng.uniform(0.5, 2, 3) + rng.uniform(0, 6, 3)) + [0, 0.3, 0]
        for mark in "左右"
    }
    turns = Rotation.from_rotvec(0.3 * np.sin(time * [1.0, 0.7, 0.4])).as_matrix()
    tracks = {
        f"{mark}足ＩＫ": (positions, np.broadcast_to(np.eye(3), (frames, 3, 3))) for mark, positions in feet.items()
    }
    return tracks | {"下半身": (np.zeros((frames, 3)), turns)}


def test_feet_reach_their_goals_and_knees_bend_backward_about_x_only():
    model, tracks = standard_model(), legs()
    poses = pose_mmd(model, tracks)
    for mark in "左右":
        hip, knee, ankle, goal = (model.bone(mark + name) for name in ("足", "ひざ", "足首", "足ＩＫ"))
        assert np.linalg.norm(poses.positions[:, ankle] - poses.positions[:, goal], axis=-1).max() < 1e-5
        bend = np.swapaxes(poses.rotations[:, hip], -1, -2) @ poses.rotations[:, knee]
        angles = Rotation.from_matrix(bend).as_rotvec()
        assert (
            np.abs(angles[:, 1:]).max() < 1e-5 and np.radians(0.4) < angles[:, 0].min() and angles[:, 0].max() < np.pi
        )
    for name in ("頭", "左腕", "センター"):
        assert np.allclose(poses.rotations[:, model.bone(name)], np.eye(3))


def test_inverse_kinematics_switched_off_in_some_frames():
    model, tracks = standard_model(), legs()
    on = np.arange(40) < 15
    poses, solved = pose_mmd(model, tracks, {"左足ＩＫ": on}), pose_mmd(model, tracks)
    knee = model.bone("左ひざ")
    assert np.allclose(poses.rotations[on], solved.rotations[on], atol=1e-6)
    assert np.allclose(poses.rotations[~on, knee], poses.rotations[~on, model.bone("下半身")], atol=1e-6)
    assert np.allclose(poses.positions[:, model.bone("右足首")], solved.positions[:, model.bone("右足首")])


def test_goals_out_of_reach_stretch_the_leg_towards_them():
    model = standard_model()
    poses = pose_mmd(model, {"左足ＩＫ": track(position=(0, -1.0, 2.0))})
    hip, knee, ankle, goal = (poses.positions[0, model.bone("左" + name)] for name in ("足", "ひざ", "足首", "足ＩＫ"))
    way, leg = goal - hip, ankle - hip
    assert way @ leg > 0.999 * np.linalg.norm(way) * np.linalg.norm(leg)
    assert np.linalg.norm(leg) > 0.999 * (np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee))


def vmd_of(tracks, switches=()):
    bones = {}
    for name, (positions, rotations) in tracks.items():
        frames = np.arange(len(positions))
        quaternions = Rotation.from_matrix(rotations).as_quat()
        bones[name] = VmdTrack(
            frames, np.array(positions), quaternions, np.tile([20, 20, 107, 107], (len(positions), 4, 1)) / 127
        )
    return VmdMotion("", bones, {}, tuple(switches))


def test_a_vmd_with_switches_on_a_model_and_onto_smpl():
    vmd = vmd_of(legs(31), [(0, {"左足ＩＫ": True}), (10, {"左足ＩＫ": False})])
    model = standard_model()
    poses = play_vmd(model, vmd, 60.0)
    assert len(poses) == 61 and poses.fps == 60
    gap = np.linalg.norm(poses.positions[:, model.bone("左足首")] - poses.positions[:, model.bone("左足ＩＫ")], axis=-1)
    assert gap[:20].max() < 1e-5 < 1e-2 < gap[20:].max() and play_vmd(model, vmd).positions.shape[0] == 31
    motion = mmd_poses_to_smpl(poses)
    assert motion.skeleton.names == JOINT_NAMES and motion.fps == 60
    _, joints = motion.world()
    for name, own in (("left_ankle", "左足首"), ("right_knee", "右ひざ"), ("head", "頭"), ("left_wrist", "左手首")):
        assert np.allclose(joints[:, JOINT_NAMES.index(name)], poses.positions[:, model.bone(own)], atol=2e-3)
    assert np.abs(motion.skeleton.offsets[[18, 20], 1]).max() < 0.03  # arms are level: the A-pose is reconciled


def test_a_vmd_file_is_a_motion_for_any_character(tmp_path):
    from bunraku.files.mmd.vmd import MmdClip, write_vmd
    from bunraku.pipelines.to_reference import load_motion

    path = write_vmd(MmdClip(legs(31)), tmp_path / "feet.vmd")
    motion = load_motion(path, fps=20.0)
    assert (
        len(motion) == 21
        and motion.skeleton.names == JOINT_NAMES
        and np.allclose(motion.rotations, vmd_motion(path, fps=20.0).rotations)
    )


def test_motions_and_models_that_do_not_fit():
    with pytest.raises(MotionError, match="moves none of the"):
        play_vmd(standard_model(), vmd_of({"尻尾": track()}))
    strange = model_of(bone("Bone", (0, 0, 0)))
    with pytest.raises(MotionError, match="standard names"):
        mmd_poses_to_smpl(pose_mmd(strange, {}, frames=1))
    motion = mmd_poses_to_smpl(play_vmd(standard_model(), vmd_of(legs(3))))
    with pytest.raises(MotionError, match="standard names"):
        mmd_motion(strange, motion)
    from bunraku.core.body.reference import reference_body

    with pytest.raises(MotionError, match="not an MMD model"):
        mmd_motion(reference_body().character(), motion)


def dance(frames=20):
    """A motion of SMPL's joints on the standard model's bones that no MMD motion would make, with the spine in one
    piece.
    """
    from bunraku.core.body.reference import reference_body

    rng, time = np.random.default_rng(1), np.linspace(0, 3, frames)[:, None, None]
    angles = (
        0.5
        * np.sin(time * rng.uniform(0.5, 2, (1, 22, 1)) + rng.uniform(0, 6, (1, 22, 1)))
        * rng.normal(0, 1, (1, 22, 3))
    )
    rotations = Rotation.from_rotvec(angles.reshape(-1, 3)).as_matrix().reshape(frames, 22, 3, 3)
    rotations[:, JOINT_NAMES.index("spine2")] = np.eye(3)  # the standard model has two bones for three
    root = np.stack([np.sin(time), 1 + 0.1 * np.cos(time), time], -1)[:, 0, 0]
    return SkeletalMotion(reference_body().skeleton, rotations, root, 30.0)


def test_smpl_onto_mmd_bones_and_back():
    motion, model = dance(), standard_model()
    clip = mmd_motion(model, motion)
    assert set(clip.ik_off) == {"左足ＩＫ", "左つま先ＩＫ", "右足ＩＫ", "右つま先ＩＫ"} and len(clip) == 20
    back = mmd_poses_to_smpl(play_vmd(model, read_vmd(Path("dance.vmd"), pack_vmd(clip))))
    assert degrees(motion.world()[0], back.world()[0]).max() < 0.05
    from bunraku.core.body.reference import leg_length

    scale = leg_length(back.skeleton.positions) / leg_length(motion.skeleton.positions)
    travel, wanted = np.ptp(back.root_translation, axis=0), np.ptp(motion.root_translation, axis=0) * scale
    assert (
        np.abs(travel - wanted).max() < 0.12
    )  # the pelvis of MMD is at the waist, and the hips are what is carried over


def rigged(tmp_path, model):
    """A character with the bones of a model and a mesh between them, by way of a file."""
    bones = [
        Bone(some.name, tuple(some.position * [1, 1, -1] / 0.08), some.parent, some.layer,
             append=(some.append.bone, some.append.ratio, 0x100) if some.append else None)
        for some in model.bones
    ]  # fmt: skip
    (tmp_path / "doll.pmx").write_bytes(pmx(plank(bones=bones, bodies=[], joints=[], textures=[])))
    return load_character(tmp_path / "doll.pmx")


def test_vertices_follow_the_bones(tmp_path):
    character = rigged(tmp_path, standard_model())
    vmd = vmd_of(legs(4))
    animation = mmd_animation(character, vmd)
    poses, rig = play_vmd(character, vmd), character.rig
    moved = poses.positions - np.einsum("nbij,bj->nbi", poses.rotations, poses.model.positions)
    transforms = np.concatenate([poses.rotations, moved[..., None]], axis=-1)
    bound = np.einsum("nvbij,vb->nvij", transforms[:, rig.indices].reshape(4, *rig.indices.shape, 3, 4), rig.weights)
    posed = np.einsum("nvij,vj->nvi", bound[..., :3], character.vertices) + bound[..., 3]
    assert np.abs(animation.vertices() - posed).max() < 1e-5


def test_an_animation_of_the_rig_as_keys_and_played_again(tmp_path):
    plain = standard_model()
    hip = plain.bone("左足")
    double = bone("左足D", plain.positions[hip], plain.bone("下半身"), layer=2, append=MmdAppend(hip, 1.0, True, False))
    character = rigged(tmp_path, replace(plain, bones=(*(replace(some, ik=None) for some in plain.bones), double)))
    solved = pose_mmd(plain, legs())
    tracks = {name: (np.zeros((40, 3)), np.swapaxes(solved.rotations[:, parent], -1, -2) @ solved.rotations[:, index])
              for index, (name, parent) in enumerate(zip(plain.names, plain.parents,
              strict=True)) if parent >= 0}  # fmt: skip
    from bunraku.core.animation import RigAnimation

    poses = pose_mmd(mmd_model(character), tracks)
    clip = mmd_clip(RigAnimation.of_world(character, poses.rotations, poses.positions, 30.0))
    assert "左足" in clip.bones and "左足D" not in clip.bones  # MMD itself makes it follow
    again = play_vmd(character, read_vmd(Path("x.vmd"), pack_vmd(clip)))
    assert (
        np.abs(again.positions - poses.positions).max() < 1e-4
        and degrees(again.rotations, poses.rotations).max() < 0.02
    )


def modern(plain):
    """A model as makers build them today: the skin of legs hangs on bones that take over the legs' rotation, the legs
    undo the turn of 腰, and the goal of a tie hangs on センター.
    """
    bones = list(plain.bones)
    at = {some.name: index for index, some in enumerate(bones)}

    def add(name, position, parent, source=-1, ratio=1.0):
        at[name] = len(bones)
        append = MmdAppend(source, ratio, True, False) if source >= 0 else None
        bones.append(bone(name, position, at[parent], layer=2, append=append))
        return at[name]

    add("ネクタイＩＫ", (0, 1, 0.1), "センター")
    for mark in "左右":
        undone = add("腰キャンセル" + mark, plain.positions[at[mark + "足"]], "下半身", at["腰"], -1.0)
        bones[at[mark + "足"]] = replace(bones[at[mark + "足"]], parent=undone)
        above = "腰キャンセル" + mark
        for name in ("足", "ひざ", "足首"):
            add(f"{mark}{name}D", plain.positions[at[mark + name]], above, at[mark + name])
            above = f"{mark}{name}D"
        bones[at[mark + "つま先"]] = replace(bones[at[mark + "つま先"]], name=mark + "足先EX", parent=at[above])
    return replace(plain, bones=tuple(bones))


def skinned(model):
    """A character of sticks on the bones that are a body's, skinned as makers do it: where a bone takes over another's
    rotation, the skin hangs on it.
    """
    names = [name.translate(str.maketrans("", "", "左右D")) for name in model.names]
    doubled = {some.append.bone for some in model.bones if some.append is not None and some.append.ratio > 0}
    body = dict.fromkeys(("上半身", "上半身2", "首", "頭", "下半身", "肩", "腕", "ひじ", "手首", "足", "ひざ", "足首"))
    body |= dict.fromkeys(("足先EX", "つま先"))
    held = np.array([name in body and index not in doubled for index, name in enumerate(names)])
    order = bone_order(model.parents)
    place = np.argsort(order)
    parents = np.where(model.parents[order] >= 0, place[model.parents[order]], -1)
    sticks = stick_character(
        "doll", tuple(model.names[bone] for bone in order), parents, model.positions[order], held[order]
    )
    rig = Rig(
        model.names,
        model.parents,
        sticks.rig.transforms[place],
        np.array(order)[sticks.rig.indices],
        sticks.rig.weights,
    )
    return replace(sticks, rig=rig, avatar=model)


def test_bones_that_take_over_follow_the_ones_that_motions_move():
    from bunraku_lab.synthetic.stock_motions import stock_motion

    plain, walk = standard_model(), stock_motion("walk", 1.2, 30.0)
    model = modern(plain)
    moved, known = (fit_rig(walk, skinned(some)) for some in (model, plain))
    rotations, positions = moved.world()
    turned, wanted = known.world()
    for mark in "左右":
        for name in ("足", "ひざ", "足首"):
            double, lead = model.bone(f"{mark}{name}D"), plain.bone(mark + name)
            assert degrees(rotations[:, double], turned[:, lead]).max() < 5
            assert np.abs(positions[:, double] - wanted[:, lead]).max() < 0.03
        knee = degrees(turned[:, plain.bone(mark + "足")], turned[:, plain.bone(mark + "ひざ")])
        assert np.ptp(knee) > 20  # it walks
    hips, tie = (positions[:, model.bone(name)] for name in ("下半身", "ネクタイＩＫ"))
    assert np.abs((tie - tie[0]) - (hips - hips[0]))[:, 2].max() < 0.05 < 0.5 < np.ptp(hips[:, 2])
    clip = mmd_clip(moved)
    again = mmd_animation(moved.character, read_vmd(Path("walk.vmd"), pack_vmd(clip)))
    assert "左足" in clip.bones and "左足D" not in clip.bones
    assert np.abs(again.vertices() - moved.vertices()).max() < 1e-3


def test_hours_of_frames_are_refused_before_they_are_made():
    still = np.zeros((1, 3))
    track = VmdTrack(np.array([432_000]), still, np.array([[0.0, 0, 0, 1]]), np.zeros((1, 4, 4)))
    vmd = VmdMotion("", {"センター": track} | {f"bone {number}": track for number in range(5000)}, {}, ())
    with pytest.raises(MotionError, match="too many"):
        play_vmd(standard_model(), vmd, 240)


def test_models_that_ask_for_hours_are_refused_before_they_are_posed():
    import time

    assert (
        pose_work(
            model_of(
                bone("a", (0, 0, 0)),
                bone("b", (1, 0, 0), 0, append=MmdAppend(0, 1.0, True, False)),
                bone("c", (2, 0, 0), 1),
            )
        )
        == 5
    )
    plain = standard_model()
    assert pose_work(plain) < 2_000
    length = 600  # one chain, and half of it are goals of inverse kinematics that turn all above them, a thousand times
    chain = [bone(str(index), (0, index, 0), index - 1) for index in range(length)]
    greedy = MmdIk(length - 1, 1000, 1.0, tuple(MmdIkLink(index) for index in range(length - 2, length - 258, -1)))
    start = time.process_time()
    with pytest.raises(MotionError, match="too many"):
        pose_mmd(
            model_of(*chain, *(bone(f"goal {number}", (1, 1, 1), ik=greedy, layer=1) for number in range(300))), {}
        )
    takers = [
        bone(str(index), (0, index, 0), index - 1, append=MmdAppend(0, 1.0, True, False)) for index in range(3000)
    ]
    with pytest.raises(MotionError, match="too many"):
        pose_mmd(model_of(*takers), {})
    assert time.process_time() - start < 2
    with pytest.raises(MotionError, match="10,000,000 frames"):
        pose_mmd(plain, {}, frames=10_000_000)


def test_an_animation_of_an_mmd_character_is_saved_as_vmd(tmp_path):
    character = rigged(tmp_path, standard_model())
    animation = mmd_animation(character, vmd_of(legs(8)))
    again = mmd_animation(character, load_vmd(animation.save(tmp_path / "legs.vmd")))
    assert len(again) == 8 and np.abs(again.vertices() - animation.vertices()).max() < 1e-4
    with pytest.raises(OptionError, match="30 frames a second"):
        animation.save(tmp_path / "legs.vmd", fps=24)
    with pytest.raises(FormatError, match="a humanoid skeleton is found from the 30 handles"):
        animation.animation().save(tmp_path / "bones.vmd")
    assert not (tmp_path / "bones.vmd").exists()
    from bunraku.core.animation import RigAnimation
    from bunraku.core.body.reference import reference_body

    person = reference_body().character()
    with pytest.raises(FormatError, match="which this character is not; transfer onto a .pmx"):
        RigAnimation(person, np.tile(np.eye(3), (2, 22, 1, 1)), np.zeros((2, 22, 3))).save(tmp_path / "person.vmd")
