"""Apparel data: shards, apparel in the body, and hems that stay up."""

import json
import os
import pickle
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from safetensors.numpy import load_file, save_file

from bunraku.apparel.body import UnifiedBody, eq4_transforms
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.physics.simulate import simulate
from bunraku.cli import main
from bunraku.core.animation import RigAnimation
from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.skinning import skin
from bunraku.errors import FormatError, OptionError
from bunraku_lab.datasets.apparel import ApparelData
from bunraku_lab.datasets.apparel import build as building
from bunraku_lab.datasets.apparel.build import record
from bunraku_lab.datasets.apparel.checks import BodyVolume, PushOut, deep_inside, standing_out
from bunraku_lab.datasets.apparel.plan import (
    MotionSource,
    character_split,
    choose_motions,
    motion_sources,
    plan_shards,
    wardrobe_sources,
)
from bunraku_lab.datasets.motions.clips import write_clip, write_index
from bunraku_lab.synthetic.stock_motions import stock_motion
from bunraku_lab.synthetic.wardrobe import wardrobe_character

SEED = 1
MINUTES = 0.05


def sources(count, seconds=10.0):
    return [
        MotionSource(f"m{number:03d}", split, "", seconds, "x", True)
        for split in ("train", "val", "test")
        for number in range(count)
    ]


@pytest.fixture(scope="module")
def body():
    return UnifiedBody.of(wardrobe_character(SEED))


@pytest.fixture(scope="module")
def motions(tmp_path_factory):
    """A folder as `bunraku data motions` writes it: a walk and a dance, and an animal that must not be taken."""
    folder = tmp_path_factory.mktemp("motions")
    clips = {}
    for name, kind in (("a_walk", "walk"), ("a_dance", "dance"), ("a_horse", "walk")):
        write_clip(folder / f"{name}.npz", stock_motion(kind, 4.5, 20.0))
        clips[name] = {"frames": 90, "split": "train"} | ({"species": "horse"} if name == "a_horse" else {})
    write_index(folder, clips)
    return folder


@pytest.fixture(scope="module")
def plan(motions):
    source = replace(wardrobe_sources(1, SEED)[0], split="train")
    shards, left = plan_shards([source], choose_motions(motion_sources(motions), 2), minutes=MINUTES, longest=1.5)
    assert not left
    clips = shards[0].clips
    return [replace(shards[0], clips=clips[:1]), replace(shards[0], part=1, clips=clips[1:])]


@pytest.fixture(scope="module")
def built(plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("apparel")
    states = []
    state = building.build_apparel(folder, plan, jobs=2, progress=lambda state: states.append(state.done))
    assert not state.failed, state.failed
    assert states == [0, 1, 2]
    return folder


def test_splits_are_fixed_by_name_and_apart():
    """The names were split so when the data set was made; a change would put test characters into training."""
    assert [source.seed for source in wardrobe_sources(30) if source.split == "test"] == [11, 16, 23, 29]
    assert [source.seed for source in wardrobe_sources(30) if source.split == "val"] == [3]
    counts = {
        split: sum(character.split == split for character in wardrobe_sources(1000))
        for split in ("train", "val", "test")
    }
    assert 90 <= counts["test"] <= 150 and 40 <= counts["val"] <= 80
    shards, left = plan_shards(wardrobe_sources(104), sources(25), minutes=210)
    assert not left and {shard.character.split for shard in shards} == {"train", "val", "test"}
    assert all(clip.motion.split == shard.character.split for shard in shards for clip in shard.clips)
    assert sum(shard.seconds for shard in shards) / 60 == pytest.approx(210, rel=0.01)
    assert len({shard.character.name for shard in shards}) == 104
    assert len({(clip.motion.name, clip.motion.split) for shard in shards for clip in shard.clips}) == 75
    assert max(shard.seconds for shard in shards) <= 120
    assert [shard.fingerprint() for shard in shards] == [
        shard.fingerprint() for shard in plan_shards(wardrobe_sources(104), sources(25), minutes=210)[0]
    ]


def test_a_split_without_motions_is_named():
    character = wardrobe_sources(1)[0]
    motion = [one for one in sources(1) if one.split != character.split]
    shards, left = plan_shards([character], motion, minutes=1)
    assert not shards and character.split in left[character.name]


def test_the_joints_are_the_rigs_own(body):
    """A wardrobe character has MMD's names, so knees and wrists are where those bones are, and no bone of apparel is a
    joint.
    """
    rig = body.parts.character.rig
    for joint, name in (
        ("left_knee", "左ひざ"),
        ("right_wrist", "右手首"),
        ("head", "頭"),
        ("neck", "首"),
        ("left_shoulder", "左腕"),
    ):
        assert np.allclose(body.joints[JOINT_NAMES.index(joint)], rig.positions[rig.names.index(name)])
    assert not body.moved[body.bones].any() and body.moved.any()
    assert np.allclose(body.weights.sum(axis=1), 1, atol=1e-5)
    for bone in np.flatnonzero(body.moved):
        assert body.joint_of[bone] == body.joint_of[rig.parents[bone]]
    assert np.isfinite(body.joints).all() and len(JOINT_PARENTS) == len(body.joints)


def test_a_recording_gives_the_vertices_back(body):
    """Against skinning with all bones, where bones of apparel turn and a knee is kept straight."""
    clip = building.body_animation(body, stock_motion("walk", 1.0))
    rotations, rig = np.array(clip.rotations), body.parts.character.rig
    angles = np.random.default_rng(0).normal(0, 0.4, (len(clip), int(body.moved.sum()), 3))
    rotations[:, body.moved] = matrix_from_axis_angle(angles)
    rotations[:, rig.names.index("左ひざ")] = np.eye(3)
    moved = RigAnimation(clip.character, rotations, clip.translations, clip.fps)
    recording = record(body, [moved, clip])
    truth = np.concatenate([moved.vertices(), clip.vertices()])
    found = skin(clip.character.vertices, body.weights, eq4_transforms(recording.transforms, body.joints)).copy()
    rigid = found.copy()
    found[:, recording.loose] += recording.offsets
    assert np.abs(found - truth).max() < recording.rounding + 1e-4
    assert np.abs(rigid[: len(clip)] - truth[: len(clip)]).max() > 0.02  # without offsets it is another thing
    assert 0 < recording.rounding < 1e-3
    still = np.setdiff1d(np.arange(len(body.weights)), recording.loose)
    assert len(still) > 0.5 * len(body.weights)  # bodies have no offsets


def test_the_clips_are_what_was_simulated(built, plan, body):
    """The body's vertices, read back, are those of the simulation itself, and so is apparel but where it is pushed out
    of the body.
    """
    data = ApparelData(built, fly_aways=True)
    assert len(data) == sum(len(shard.clips) for shard in plan) and data.characters == (plan[0].character.name,)
    assert data.minutes == pytest.approx(MINUTES, rel=0.02)
    clip = data.clips[0]
    truth = simulate(building._clip_animation(body, plan[0].clips[0])).animation
    window = data.window(clip)
    assert window.vertices.shape == (clip.frames, len(body.weights), 3) and window.vertices.dtype == np.float32
    character = data.character(clip)
    away = np.linalg.norm(window.vertices - truth.vertices(), axis=2)
    assert away[:, ~character.apparel].max() < 1e-3 and np.median(away[:, character.apparel]) < 1e-3
    assert away.max() < 0.2
    part = data.window(clip, 20, 30)
    assert np.array_equal(part.transforms, window.transforms[20:30]) and np.allclose(
        part.vertices, window.vertices[20:30], atol=1e-6
    )
    with pytest.raises(OptionError, match="not in a clip"):
        data.window(clip, 0, clip.frames + 1)


def test_without_physics_apparel_is_rigid(built):
    """Table 4 of the paper: distances of apparel vertices to each other stay as they are at rest where one joint holds
    them.
    """
    moving, rigid = ApparelData(built, fly_aways=True), ApparelData(built, physics=False, fly_aways=True)
    clip = moving.clips[0]
    character = moving.character(clip)
    a, b = moving.window(clip).vertices, rigid.window(clip).vertices
    assert np.abs(a - b)[:, ~character.apparel].max() == 0 and np.abs(a - b)[:, character.apparel].max() > 0.01
    joint = character.weights[character.apparel].sum(axis=0).argmax()
    held = np.flatnonzero(character.apparel & (character.weights[:, joint] > 0.9999))[:50]
    lengths = np.linalg.norm(b[:, held] - b[:, held[:1]], axis=-1)
    rest = np.linalg.norm(character.rest[held] - character.rest[held[:1]], axis=-1)
    assert np.abs(lengths - rest).max() < 1e-4


def test_a_second_run_mends_and_gives_the_same_bytes(built, plan, tmp_path):
    """One process or two, a shard that is gone and one that was cut short by a kill."""
    shards = {path.name: path.read_bytes() for path in (built / "shards").iterdir()}
    again = tmp_path / "again"
    (again / "shards").mkdir(parents=True)
    first, second = sorted(shards)
    (again / "shards" / first).write_bytes(shards[first])
    (again / "shards" / second).write_bytes(shards[second][: len(shards[second]) // 2])
    stamp = os.stat(again / "shards" / first).st_mtime_ns
    state = building.build_apparel(again, plan, jobs=1)
    assert state.done == 2 and {path.name: path.read_bytes() for path in (again / "shards").iterdir()} == shards
    assert os.stat(again / "shards" / first).st_mtime_ns == stamp
    assert (again / "index.json").read_bytes() == (built / "index.json").read_bytes()


def changed(built, tmp_path, edit):
    """A copy of the data whose first shard was changed by `edit(arrays, facts)`."""
    data = ApparelData(built, fly_aways=True)
    path = data.shard(data.clips[0].shard).path
    arrays, facts = load_file(path), dict(data.shard(data.clips[0].shard).facts)
    arrays = {name: array.copy() for name, array in arrays.items()}
    edit(arrays, facts)
    (tmp_path / "shards").mkdir()
    save_file(arrays, tmp_path / "shards" / path.name, {"bunraku": json.dumps(facts)})
    (tmp_path / "index.json").write_bytes((built / "index.json").read_bytes())
    return ApparelData(tmp_path, fly_aways=True)


@pytest.mark.parametrize(
    "edit",
    [
        lambda arrays, facts: arrays["faces"].__setitem__((0, 0), 10**6),
        lambda arrays, facts: arrays["loose"].__setitem__(0, -1),
        lambda arrays, facts: arrays["loose"].__setitem__(0, arrays["loose"][1]),
        lambda arrays, facts: arrays["bone_parents"].__setitem__(0, 10**6),
        lambda arrays, facts: arrays["rest"].__setitem__((0, 0), np.nan),
        lambda arrays, facts: arrays["weights"].__setitem__(0, 5.0),
        lambda arrays, facts: arrays["transforms"].__setitem__((0, 0, 0, 0), np.inf),
        lambda arrays, facts: arrays["offsets"].__setitem__((0, 0, 0), np.nan),
        lambda arrays, facts: arrays.__setitem__("offsets", arrays["offsets"][:, :-1]),
        lambda arrays, facts: arrays.__setitem__("offsets", arrays["offsets"].astype(np.float32)),
        lambda arrays, facts: arrays.pop("joints"),
        lambda arrays, facts: facts["clips"][0].__setitem__("frames", 10**9),
        lambda arrays, facts: facts["clips"][0].__setitem__("frames", "3"),
        lambda arrays, facts: facts.__setitem__("clips", 7),
        lambda arrays, facts: facts.__setitem__("format", "another"),
    ],
)
def test_hostile_shards_are_refused(built, tmp_path, edit):
    with pytest.raises(FormatError, match="bunraku data apparel"):
        data = changed(built, tmp_path, edit)
        data.window(data.clips[0], 0, 2)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"shards": []}', b"[" * 100_000, b"\x80\x04}."])
def test_hostile_indices_are_refused(tmp_path, content):
    (tmp_path / "index.json").write_bytes(content)
    with pytest.raises(FormatError):
        ApparelData(tmp_path)


@pytest.mark.parametrize("name", ["../outside", "/etc/passwd", "..", "a\\b", "a\0b"])
def test_no_path_leads_out_of_the_folder(tmp_path, name):
    (tmp_path / "index.json").write_text(json.dumps({"shards": {name: {"name": "x", "split": "train", "clips": []}}}))
    with pytest.raises(FormatError, match="plain name"):
        ApparelData(tmp_path)


def test_a_pickle_is_no_shard(built, tmp_path):
    (tmp_path / "shards").mkdir()
    (tmp_path / "index.json").write_bytes((built / "index.json").read_bytes())
    data = ApparelData(tmp_path, fly_aways=True)
    for content in (pickle.dumps({"rest": 1}), b"\xff" * 64, b""):
        (tmp_path / "shards" / f"{data.clips[0].shard}.safetensors").write_bytes(content)
        with pytest.raises(FormatError, match="damaged"):
            data.window(data.clips[0], 0, 1)


def test_what_went_wrong_is_named(tmp_path, plan):
    """A character that cannot be made and a motion that cannot be read do not stop the others."""
    bad = replace(plan[0], character=replace(plan[0].character, path=str(tmp_path / "gone.pmx")))
    assert "gone.pmx" in building.build_shard(tmp_path, bad)
    clip = plan[0].clips[0]
    bad = replace(plan[0], clips=(replace(clip, motion=replace(clip.motion, path=str(tmp_path / "gone.npz"))),))
    (tmp_path / "shards").mkdir()
    assert "gone.npz" in building.build_shard(tmp_path, bad) and not list((tmp_path / "shards").iterdir())


@pytest.mark.parametrize(
    ("words", "say"),
    [
        (["--wardrobe", "0"], "no characters"),
        (["--wardrobe", "-1"], "--wardrobe"),
        (["--minutes", "nan"], "--minutes"),
        (["--jobs", "many"], "--jobs"),
        (["--clothes", "/nowhere"], "no such folder"),
        (["--characters", "/nowhere.pmx"], "no such file"),
    ],
)
def test_bad_options_are_one_sentence(motions, tmp_path, capsys, words, say):
    assert main(["data", "apparel", "--motions", str(motions), "-o", str(tmp_path / "out"), *words]) == 2
    said = capsys.readouterr().err
    assert say in said and said.count("\n") == 1 and not (tmp_path / "out").exists()


def test_the_command_goes_on_where_it_stopped(motions, tmp_path, capsys):
    words = [
        "data", "apparel", "--motions", str(motions), "-o", str(tmp_path / "out"), "--wardrobe", "1", "--seed",
        str(SEED), "--jobs", "1",
    ]  # fmt: skip
    words += ["--minutes", "0.1", "--seconds", "3"]
    if character_split(f"wardrobe_{SEED:06d}") != "train":
        pytest.skip("this seed is not of the training split, and the motions are")
    assert main(words) == 0
    first = capsys.readouterr().out
    files = {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "shards").iterdir()}
    assert main(words) == 0
    assert capsys.readouterr().out == first and "0.1 minutes in 1 of 1 files" in first
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "shards").iterdir()} == files


RADIUS, FRAMES = 0.3, 24


def worn():
    """A ball of 0.6 m and a sheet that hangs down beside it, 5 cm away, held at its top."""
    ball = trimesh.creation.icosphere(4, RADIUS)
    across, down = np.meshgrid(np.linspace(-0.15, 0.15, 13), np.linspace(0.3, -0.2, 21))
    sheet = np.stack([across, down, np.full_like(across, RADIUS + 0.05)], axis=-1).reshape(-1, 3)
    index = np.arange(len(sheet)).reshape(across.shape) + len(ball.vertices)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    faces = np.concatenate([ball.faces, quads[:, :3], quads[:, [0, 2, 3]]])
    rest = np.concatenate([ball.vertices, sheet]).astype(np.float32)
    weights = np.zeros((len(rest), JOINT_COUNT), np.float32)
    weights[:, 0] = 1
    apparel = np.arange(len(rest)) >= len(ball.vertices)
    joints = np.zeros((JOINT_COUNT, 3))
    return ClothedCharacter(
        rest, faces, joints, weights, apparel, np.where(apparel, 0, -1), np.zeros(1), np.full(1, 0.9)
    )


def swung(clothed, deepest):
    """The sheet swings into the ball and out again, the more the farther down; the ball stands still."""
    pose = np.concatenate([np.tile(np.eye(3), (JOINT_COUNT, 1, 1)), clothed.joints[..., None]], axis=2)
    loose = np.flatnonzero(clothed.apparel)
    low = np.clip((0.25 - clothed.rest[loose, 1]) / 0.45, 0, 1)
    way = np.zeros((FRAMES, len(loose), 3))
    way[:, :, 2] = -deepest * np.sin(np.linspace(0, np.pi, FRAMES))[:, None] * low
    return np.repeat(pose[None], FRAMES, axis=0).astype(np.float32), loose, way.astype(np.float16)


def deep_share(clothed, loose, offsets):
    """Share of the sheet's vertices that are deeper than 1 cm in the still ball, mean over the frames."""
    ball = BodyVolume.of_mesh(clothed.rest, clothed.faces, clothed.weights, clothed.apparel, "the mesh")
    return np.mean([deep_inside(ball, ball.rest, clothed.rest[loose] + frame) for frame in offsets.astype(float)])


def test_apparel_leaves_the_body():
    clothed = worn()
    transforms, loose, before = swung(clothed, 0.12)
    after = PushOut(clothed)(transforms, loose, before)
    assert after.dtype == np.float16 and after.shape == before.shape
    rigid, deep, left = (deep_share(clothed, loose, offsets) for offsets in (0 * before, before, after))
    assert rigid == 0 and deep > 0.03 and left < 0.1 * deep
    # by hand: no vertex is nearer to the middle than the radius, less what is let be
    assert np.linalg.norm(clothed.rest[loose] + after.astype(float), axis=-1).min() > RADIUS - 0.007
    assert np.linalg.norm(clothed.rest[loose] + before.astype(float), axis=-1).min() < RADIUS - 0.02
    # smooth in time: no frame jumps farther from its neighbours than some millimetres more than before
    jerk = [np.abs(np.diff(offsets.astype(float), 2, axis=0)).max() for offsets in (before, after)]
    assert jerk[1] < jerk[0] + 0.01


def skirt() -> ClothedCharacter:
    """Ten vertices around the knees that hang from the pelvis, at 1 m."""
    angle = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    rest = np.stack([0.3 * np.cos(angle), np.full(10, 0.5), 0.3 * np.sin(angle)], axis=1).astype(np.float32)
    weights = np.zeros((10, JOINT_COUNT), np.float32)
    weights[:, 0] = 1
    joints = np.zeros((JOINT_COUNT, 3), np.float32)
    joints[0, 1], joints[-1, 1] = 1.0, 1.7
    none = np.zeros(1, np.float32)
    faces = np.array([[0, 1, 2]])
    return ClothedCharacter(rest, faces, joints, weights, np.ones(10, bool), np.zeros(10, np.int64), none, none)


def poses(raised: slice) -> np.ndarray:
    out = np.zeros((90, JOINT_COUNT, 3, 4), np.float32)
    out[..., :3] = np.eye(3)
    out[raised, JOINT_NAMES.index("left_hip"), :, :3] = matrix_from_axis_angle(np.array([-1.2, 0, 0]))
    return out


def test_a_hem_that_stays_up_after_the_leg_came_down_stands_out_and_one_on_the_leg_does_not():
    clothed, loose = skirt(), np.arange(10)
    up = np.zeros((90, 10, 3))
    up[:, :3, 1] = 0.06 * clothed.scale + 0.01
    transforms = poses(slice(10, 30))
    calm_and_settled = 90 - 30 - 15
    assert standing_out(clothed, transforms, loose, up) == 1.0
    falls = up.copy()
    falls[30 + 15 + 9 :] = 0  # it hangs for nine of the frames that count, and is moving when it falls
    found = standing_out(clothed, transforms, loose, falls)
    assert 7 / calm_and_settled <= found <= 9 / calm_and_settled
    assert standing_out(clothed, poses(slice(0, 90)), loose, up) == 0.0
    assert standing_out(clothed, transforms, loose, 0 * up) == 0.0
