"""Sentences on the bones of a file's own skeleton, and clips that are made together."""

import gzip
import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.animation import Animation
from bunraku.core.character import Character, Rig
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import CharacterError, OptionError
from bunraku.geometry.rotations import axis_angle_from_matrix
from bunraku.io import load_character
from bunraku.io.play import clip_names as clip_names_of
from bunraku.io.play import load_animation
from bunraku.language.parse import parse
from bunraku.language.sentence import in_stretches
from bunraku.pipelines.animator import Animator, own_rig
from bunraku.pipelines.clips import clip_names, is_cycle, with_loops
from bunraku.pipelines.requests.constraints import Constraints
from bunraku.pipelines.requests.request import Request, Sampling
from bunraku.retarget.stages.pins import Pin
from bunraku_lab.synthetic.families import EVALUATION_SEED, code_made_character

FILES = Path(__file__).parents[1] / "formats" / "data"
QUICK = Sampling(2.0, 1, 4, candidates=1)


@pytest.fixture(scope="module")
def person():
    return reference_body().character()


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


def test_nothing_is_said_of_a_rig_of_rigid_blocks(caplog):
    """Handles move the blocks as the bones would."""
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
    assert body.parts is None and body.anatomy.handles.rigid and not caplog.records


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


@pytest.mark.parametrize("rig", ["own", "handles"])
def test_stretches_go_on_where_the_last_one_ended(person, rig):
    request = Request("walks:50", Sampling(6.0, 1, 2, candidates=1), rig=rig)
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
