"""Transfer of motion, also within one rig."""

import gzip
import json
import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import bunraku
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES, JOINT_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Rig
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.core.motion import MeshMotion, SkeletalMotion, Skeleton
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError, OptionError
from bunraku.files import load_character
from bunraku.files.clips import clip_names as clip_names_of
from bunraku.files.clips import load_animation
from bunraku.files.motions.bvh import write_bvh
from bunraku.language.parse import parse
from bunraku.language.sentence import in_stretches
from bunraku.pipelines.animator import Animator, own_rig
from bunraku.pipelines.requests import Constraints, Request, Sampling, clip_names, is_cycle, with_loops
from bunraku.pipelines.to_reference import load_mesh_motion, load_motion, reference_motion
from bunraku.retarget.fit import Stages
from bunraku.retarget.pins import Pin
from bunraku_lab.synthetic.families import EVALUATION_SEED, code_made_character

_J = {name: joint for joint, name in enumerate(JOINT_NAMES)}
CARRIED = Stages(ground=False, feet=False, smooth=False, floor=False)


def waving(frames=12, fps=20.0):
    body = reference_body()
    turns = np.zeros((frames, 22, 3))
    turns[:, _J["left_shoulder"], 2] = np.linspace(-1.2, 0.8, frames)
    turns[:, _J["right_shoulder"], 2] = 1.2
    turns[:, _J["left_elbow"], 2] = 0.5
    return SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), np.tile(body.joints[0], (frames, 1)), fps)


@pytest.fixture(scope="module")
def person():
    return reference_body().character()


def test_onto_the_rig_and_onto_handles(person):
    motion, handles = waving(), reference_body().handles
    on_rig = bunraku.transfer(person, motion)
    on_handles = bunraku.transfer(person, motion, handles=handles)
    assert isinstance(on_rig, bunraku.RigAnimation) and isinstance(on_handles, bunraku.Animation)
    assert on_rig.reference is not None and on_handles.reference is not None
    error = np.linalg.norm(on_rig.vertices() - on_handles.vertices(), axis=-1)
    assert error.mean() < 0.01 * person.height  # the same joints, skinned by other weights


def test_rates(person):
    assert len(bunraku.transfer(person, waving(41, 40.0), fps=20)) == 21
    assert bunraku.transfer(person, waving(41, 40.0), fps=40).fps == 40


def test_bad_options(person):
    with pytest.raises(bunraku.OptionError, match="'handles', 'rig' or 'auto'"):
        bunraku.transfer(person, waving(), onto="bones")
    with pytest.raises(bunraku.OptionError, match="1 to 240"):
        bunraku.transfer(person, waving(), fps=0)
    with pytest.raises(bunraku.CharacterError, match="no rig"):
        bunraku.transfer(bunraku.Character("bare", person.vertices, person.faces), waving(), onto="rig")


def test_names_settle_what_no_rule_knows(person):
    motion = waving()
    own = Skeleton(tuple(f"j{number:02d}" for number in range(22)), motion.skeleton.parents, motion.skeleton.offsets)
    nameless = SkeletalMotion(own, motion.rotations, motion.root_translation, motion.fps)
    names = dict(zip(JOINT_NAMES, own.names, strict=True))
    want, have = (bunraku.transfer(person, some, names=known) for some, known in ((motion, None), (nameless, names)))
    assert np.abs(want.vertices() - have.vertices()).max() < 1e-4
    with pytest.raises(bunraku.MotionError, match="is not a joint"):
        bunraku.transfer(person, motion, names={"left_hip": "nowhere"})


def test_a_clip_of_the_same_skeleton_is_copied(person, tmp_path):
    path = bunraku.transfer(person, waving()).save(tmp_path / "clip.glb")
    character = bunraku.load_character(path)
    clip = load_motion(path)
    again = bunraku.transfer(character, path)
    assert isinstance(again, bunraku.RigAnimation)
    assert np.abs(again.vertices() - clip.vertices()).max() < 1e-5


def test_the_clip_of_a_rig_goes_onto_handles(person, tmp_path):
    moved = bunraku.transfer(person, waving(), stages=CARRIED)
    path = moved.save(tmp_path / "clip.glb")
    result = bunraku.transfer(person, path, onto="handles", handles=reference_body().handles, stages=CARRIED)
    assert np.linalg.norm(result.vertices() - moved.vertices(), axis=-1).mean() < 0.01 * person.height


def test_what_bunraku_wrote_is_read_by_its_reference(person, tmp_path):
    animation = bunraku.transfer(person, waving(), handles=reference_body().handles)
    for name in ("own.npz", "own.glb"):
        found = load_motion(animation.save(tmp_path / name))
        assert np.abs(found.rotations - animation.reference.rotations).max() < 1e-5


def test_a_moving_mesh(person, tmp_path):
    truth = bunraku.transfer(person, waving(6), handles=reference_body().handles, stages=CARRIED, fps=20.0)
    folder = truth.save(tmp_path / "frames.ply")
    moving = load_mesh_motion(folder)
    assert len(moving) == 6 and np.abs(moving.vertices - truth.vertices()).max() < 1e-5
    rest = MeshMotion(np.concatenate([person.vertices[None], moving.vertices]), moving.faces)
    result = bunraku.transfer(person, rest, handles=reference_body().handles, stages=CARRIED, fps=20.0)
    error = np.linalg.norm(result.vertices()[1:] - truth.vertices(), axis=-1).mean()
    moved = np.linalg.norm(person.vertices - truth.vertices(), axis=-1).mean()
    assert error < 0.25 * moved  # handles are predicted, so joints are not exact


def test_bad_meshes(person, tmp_path):
    with pytest.raises(bunraku.MotionError, match="frames, vertices, 3"):
        MeshMotion(person.vertices, person.faces)
    (tmp_path / "empty").mkdir()
    with pytest.raises(bunraku.FormatError, match="no .obj or .ply"):
        load_mesh_motion(tmp_path / "empty")
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "b.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    with pytest.raises(bunraku.FormatError, match="other triangles"):
        load_mesh_motion(tmp_path)


def test_on_the_spot():
    from bunraku.retarget.stages.feet import is_treadmill

    body, frames = reference_body(), 60
    phase = np.linspace(0, 6 * np.pi, frames)
    turns = np.zeros((frames, 22, 3))
    for side, sign in (("left", 1), ("right", -1)):
        turns[:, _J[f"{side}_hip"], 0] = -0.45 * sign * np.sin(phase)
        turns[:, _J[f"{side}_knee"], 0] = np.maximum(0.9 * sign * np.cos(phase), 0)
    still = np.tile(body.joints[0], (frames, 1))
    walking = SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), still, 20.0)
    assert is_treadmill(reference_motion(walking))
    assert not is_treadmill(reference_motion(waving(60)))


def test_files_of_skeletons(person, tmp_path):
    path = write_bvh(waving(), tmp_path / "wave.bvh")
    by_file, by_motion = bunraku.transfer(person, path), bunraku.transfer(person, waving())
    assert np.abs(by_file.vertices() - by_motion.vertices()).max() < 1e-3
    (tmp_path / "names.json").write_text(json.dumps({}))
    with pytest.raises(bunraku.FormatError):
        bunraku.transfer(person, tmp_path / "names.json")


FILES = Path(__file__).parents[1] / "files" / "data"
QUICK = Sampling(2.0, 1, 4, candidates=1)


def renamed(character, names):
    return replace(character, rig=replace(character.rig, names=names), source=None)


def test_bones_move_as_the_handles_do(person):
    animator = Animator.shipped()
    own = animator(person, Request("walks forward", QUICK))
    other = animator(person, Request("walks forward", QUICK, rig="handles"))
    assert isinstance(own, RigAnimation) and isinstance(other, Animation)
    assert own.character.rig is person.rig
    turns = own.world()[0]
    root = other.motion.root_rotation
    for part in ("left_shoulder", "right_elbow", "left_hip", "right_knee"):
        theirs = root @ other.motion.rotations[:, HANDLE_NAMES.index(part)]
        mine = turns[:, person.rig.names.index(part)]
        angle = np.degrees(np.arccos(np.clip((np.trace(np.swapaxes(mine, 1, 2) @ theirs, 0, 1, 2) - 1) / 2, -1, 1)))
        assert angle.mean() < 15, part


def test_bones_meet_pins_and_stay_in_place(person):
    pin = Pin("left_hand", 1.0, (0.3, 1.3, 0.35))
    own = Animator.shipped()(person, Request("stands", QUICK, Constraints.of(pins=[pin])))
    assert isinstance(own, RigAnimation)
    wrist = own.world()[1][20, person.rig.names.index("left_wrist")]
    assert np.linalg.norm(wrist - [0.3, 1.3, 0.35]) < 0.02
    asked = Request("walks forward", QUICK, Constraints.of(in_place=True))
    own = Animator.shipped()(person, asked).world()[1][:, 0, 2]
    handles = Animator.shipped()(person, replace(asked, rig="handles")).motion.root_translation[:, 2]
    assert np.abs((own - own[0]) - (handles - handles[0])).max() < 0.1  # of 1.1 m; the head of a bone beside its handle


def test_a_loop_of_bones_is_closed(person):
    loop = Animator.shipped()(person, Request("walks forward", QUICK, Constraints.of(loop=True)))
    assert isinstance(loop, RigAnimation)
    assert np.abs(loop.rotations[0, 1:] - loop.rotations[-1, 1:]).max() < 1e-3


def test_names_that_say_nothing_are_told_by_shape(person):
    nameless = renamed(person, tuple(f"joint{number:02d}" for number in range(len(person.rig.names))))
    parts = own_rig(nameless, Request("walks"))
    assert parts is not None and parts.humanoid
    known = own_rig(person, Request("walks"))
    limbs = [HANDLE_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("hip", "knee", "elbow")]
    assert np.array_equal(parts.leads[limbs], known.leads[limbs])


def test_the_wings_of_a_birds_own_bones_beat():
    bird = code_made_character("bird", EVALUATION_SEED)
    parts = own_rig(bird, Request("flies"))
    assert parts is not None and parts.winged and not parts.complete
    flown = Animator.shipped()(bird, Request("flies", QUICK))
    assert isinstance(flown, RigAnimation)
    wings = [bird.rig.names.index(f"{side}Wing") for side in ("Left", "Right")]
    trunk = flown.world()[0][:, bird.rig.names.index("Spine")]
    beaten = axis_angle_from_matrix(trunk.transpose(0, 2, 1)[:, None] @ flown.world()[0][:, wings])
    assert np.linalg.norm(np.ptp(beaten, axis=0), axis=-1).min() > 0.6


def test_the_clips_of_an_fbx_file_stay(tmp_path):
    path = tmp_path / "boxman.fbx"
    path.write_bytes(gzip.decompress((FILES / "boxman_y_up_m.fbx.gz").read_bytes()))
    character = load_character(path, clips=20.0)
    own = Animator.shipped()(character, Request("waves", QUICK, rig="own"))
    written = own.save(tmp_path / "out.glb", name="waves")
    names = clip_names_of(load_character(written).source.document)
    assert names == ["waves", *clip_names_of(character.source.document)] and len(names) > 1
    before, after = (load_animation(some, names[1], 20.0) for some in (path, written))
    seams = character.source.index  # where the file repeats vertices for their normals
    assert np.abs(before.vertices()[:, seams] - after.vertices()).max() < 1e-4 * character.height


def test_a_rig_that_is_not_understood_is_said_in_a_line(person, caplog):
    one = np.zeros(len(person.vertices), np.int32)[:, None]
    alone = replace(
        person.rig, names=("thing",), parents=np.array([-1]), transforms=np.eye(4)[None], indices=one,
        weights=np.ones((len(one), 1), np.float32),
    )  # fmt: skip
    odd = replace(person, rig=alone, source=None)
    with caplog.at_level(logging.WARNING):
        assert own_rig(odd, Request("walks")) is None
        assert Animator.shipped().body(odd, Request("walks")).parts is None
    assert len(caplog.records) == 1 and "30 handles move it" in caplog.text
    with pytest.raises(CharacterError, match="not understood"):
        own_rig(odd, Request("walks", rig="own"))
    with pytest.raises(CharacterError, match="no rig"):
        own_rig(replace(person, rig=None), Request("walks", rig="own"))


def test_the_bones_of_a_rig_of_rigid_blocks_move_it(caplog):
    """What they hold tells what they are, and each goes wholly with its block, wherever its head is."""
    boxes = [trimesh.creation.box(bounds=some) for some in (
        ((-0.25, 0.7, -0.12), (0.25, 1.3, 0.12)), ((-0.2, 1.3, -0.2), (0.2, 1.7, 0.2)),
        ((0.01, 0, -0.1), (0.22, 0.7, 0.1)), ((-0.22, 0, -0.1), (-0.01, 0.7, 0.1)),
    )]  # fmt: skip
    names = ("torso", "head", "leg-left", "leg-right")
    label = np.repeat(np.arange(4), [len(box.vertices) for box in boxes]).astype(np.int32)[:, None]
    mesh = trimesh.util.concatenate(boxes)
    rig = Rig(
        names, np.array([-1, 0, 0, 0]), np.tile(np.eye(4), (4, 1, 1)), label, np.ones((len(label), 1), np.float32)
    )
    figure = Character("figure", mesh.vertices.astype(np.float32), mesh.faces, rig=rig)
    with caplog.at_level(logging.WARNING):
        body = Animator.shipped().body(figure, Request("walks"))
    assert body.parts is not None and body.anatomy.handles.rigid and not caplog.records
    transforms = np.tile(np.eye(3, 4), (1, HANDLE_COUNT, 1, 1))
    transforms[0, :, :, :3] = matrix_from_axis_angle(np.random.default_rng(0).normal(size=(HANDLE_COUNT, 3)))
    rotations, positions = body.parts.world(transforms)
    moved = RigAnimation.of_world(figure, rotations, positions).vertices()[0]
    assert np.abs(moved - skin(figure.vertices, body.anatomy.handles.weights, transforms)[0]).max() < 1e-5


def test_handles_that_are_asked_for_move(person):
    assert own_rig(person, Request("walks", handles="rig")) is None
    assert own_rig(person, Request("walks", rig="handles")) is None
    with pytest.raises(OptionError, match="rig own"):
        Request("walks", handles="rig", rig="own").check()


def test_a_file_of_bunraku_is_animated_by_the_same_handles(person, tmp_path):
    animator = Animator.shipped()
    first = animator(person, Request("waves", QUICK, rig="handles"))
    again = load_character(first.save(tmp_path / "a.glb"))
    body = animator.body(again, Request("walks"))
    assert body.parts is None
    assert np.abs(body.anatomy.handles.positions - first.handles.positions).max() < 1e-5


def test_clips_are_loops_where_they_go_on():
    cycles = {"idle": True, "walks forward": True, "runs": True, "trots": True, "attacks": False, "jumps": False,
              "walks, then jumps": False, "turns around": False}  # fmt: skip
    assert {text: is_cycle(parse(text, 4)) for text in cycles} == cycles
    in_place = Constraints.of(in_place=True)
    asked = {text: Request(parse(text, 4), constraints=in_place) for text in ("runs", "attacks", "idle")}
    made = with_loops(asked)
    assert [one.constraints.loop for one in made.values()] == [True, False, True]
    assert all(one.constraints.in_place for one in made.values())
    assert made["runs"].constraints is made["idle"].constraints


def test_clips_have_the_names_that_they_are_given_or_their_words():
    said = ["idle", "Walk = walks forward", "walks forward", "walks forward", "runs:2; jumps:1"]
    names = {"idle": "idle", "Walk": "walks forward", "walks-forward": "walks forward",
             "walks-forward-2": "walks forward", "runs-2": "runs:2; jumps:1"}  # fmt: skip
    assert clip_names(said) == names


def test_clips_of_one_pass_are_those_of_several(person):
    asked = {"walk": Request("walks forward", QUICK), "jump": Request("jumps", QUICK)}
    clips = dict(Animator.shipped().clips(person, with_loops(asked)))
    assert list(clips) == ["walk", "jump"]
    alone = Animator.shipped()(person, asked["jump"])
    assert np.abs(clips["jump"].rotations - alone.rotations).max() < 1e-3


@pytest.mark.parametrize("text", ["walks:90; waves while walking:10; runs:50", "walks:300", "jumps:3"])
def test_a_long_sentence_is_cut_into_stretches(text):
    sentence = parse(text, 6)
    parts = in_stretches(sentence, 40.0)
    assert sum(part.seconds for part in parts) == pytest.approx(sentence.seconds)
    assert max(part.seconds for part in parts) <= 40.0 + 0.5 and min(part.seconds for part in parts) > 1.0
    said = [clause.text for part in parts for clause in part.clauses]
    assert list(dict.fromkeys(said)) == [clause.text for clause in sentence.clauses]


def test_stretches_go_on_where_the_last_one_ended(person):
    request = Request("walks:50", Sampling(6.0, 1, 2, candidates=1), rig="own")
    first, second = Animator.shipped().stretches(person, request)
    assert len(first.motion) + len(second.motion) - 1 == pytest.approx(1000, abs=1)
    ends = [one.vertices([frame])[0] for one, frame in ((first, -1), (second, 0))]
    assert np.abs(ends[0] - ends[1]).max() < 1e-3
    before, after = first.take(slice(-10, None)).vertices(), second.take(slice(4)).vertices()
    assert np.abs(np.diff(after, axis=0)).max() < 3 * np.abs(np.diff(before, axis=0)).max()


def test_what_a_long_clip_cannot_meet_is_refused(person):
    long = Request("walks:200", QUICK, Constraints.of(loop=True))
    with pytest.raises(OptionError, match="no loop, path, pin"):
        next(Animator.shipped().stretches(person, long))
    with pytest.raises(OptionError, match="0.5 to 120 seconds"):
        Animator.shipped()(person, Request("walks:200", QUICK))
