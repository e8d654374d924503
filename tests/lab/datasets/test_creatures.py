"""Labelled clips of creatures and of people of games."""

import json
import re
from importlib import resources

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.names.bone_names import rig_handles
from bunraku.core.animation import Animation
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Handles
from bunraku.core.motion import HandleMotion
from bunraku.errors import CharacterError, FormatError
from bunraku.generation.features import encode
from bunraku.language.captions import mirror_words
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.datasets.characters.build import HELD_OUT
from bunraku_lab.datasets.motions.clips import load_clip, load_index
from bunraku_lab.datasets.motions.creatures import (
    HELD_OUT_SPECIES,
    add_creatures,
    clip_vertices,
    creature_body,
    creature_clips,
    creature_split,
    forward_speed,
    played_on,
    reference_clip,
    reference_motion,
)
from bunraku_lab.synthetic.samples import make_sample

TABLE = json.loads(
    resources.files("bunraku_lab.datasets.motions").joinpath("creature_clips.json").read_text(encoding="utf-8")
)


def test_labels_become_actions_and_sentences():
    clips = creature_clips(
        "quaternius/animals_pack/Horse", ["AnimalArmature|Gallop", "AnimalArmature|Idle_HitReact_Left", "Untold"]
    )
    assert [clip.action for clip in clips] == ["gallop", "hit reaction right"]  # what throws it to the left
    assert clips[0].name == "creature_quaternius-animals_pack-Horse_Gallop"
    assert "a horse gallops" in clips[0].texts and not clips[0].person
    assert clips[0].texts[-1].startswith("the animal gallops, throwing")
    (rex,) = creature_clips("quaternius/dinosaurs_pack/Trex", ["Armature|TRex_Bite", "Armature|TRex_Run"])[-1:]
    assert rex.action == "run" and rex.species[0] == "tyrannosaurus"
    (fish,) = creature_clips("quaternius/cute_fish_pack/Tuna", ["Attack"])
    assert fish.action == "attack" and "a tuna darts forward" in fish.texts
    assert creature_clips("nobody/knows", ["Walk"]) == []
    assert not creature_clips("quaternius2019/Male_Casual", ["Man_Walk"])  # people walk in motion capture


def watched_phrases():
    """(character, label, phrases) of every clip that was watched."""
    for file, known in TABLE["characters"].items():
        for label, phrases in known.get("watched", {}).items():
            yield file, label, phrases


def test_watched_labels_are_in_the_table_and_say_something():
    found = list(watched_phrases())
    assert len(found) > 300
    for file, label, phrases in found:
        known = TABLE["characters"][file]
        assert known["species"][0] != "person", file
        assert label in TABLE["labels"] or f"{known['plan']}:{label}" in TABLE["labels"], (file, label)
        assert label not in known.get("leave_out", {}), (file, label)
        assert 2 <= len(set(phrases)) == len(phrases) <= 3, (file, label)
        for phrase in phrases:
            assert phrase == phrase.strip() and phrase and phrase[0].islower() and phrase[-1].isalpha(), phrase
            assert phrase.split()[0].rstrip(",").endswith("s"), phrase  # a verb that follows "a wolf"
        assert len(phrases[0]) > len(phrases[-1]), (file, label)
    for file, known in TABLE["characters"].items():
        if "watched_like" in known:
            assert TABLE["characters"][known["watched_like"]].get("watched"), file


def test_sides_of_what_was_watched_change_places_in_a_mirrored_clip():
    sided = [phrase for _, _, phrases in watched_phrases() for phrase in phrases if {"left", "right"} & words(phrase)]
    assert len(sided) > 50
    for phrase in sided:
        mirrored = mirror_words(phrase)
        assert mirrored != phrase and mirror_words(mirrored) == phrase
        assert ("left" in words(mirrored)) == ("right" in words(phrase)), phrase
    for file in TABLE["characters"]:  # one clip is the other in the mirror
        clips = creature_clips(file, ["Idle_HitReact_Left", "Idle_HitReact_Right"])
        if len(clips) == 2:
            assert tuple(map(mirror_words, clips[0].texts)) == clips[1].texts, file
            assert mirror_words(clips[0].action) == clips[1].action, file


def words(phrase):
    return set(re.findall(r"\w+", phrase))


def test_held_out_species_and_characters_are_never_trained_on():
    for file in TABLE["characters"]:
        for clip in creature_clips(file, ["Attack", "Walk", "Death", "Idle", "Swim"]):
            split = creature_split(clip)
            if clip.species[0] in HELD_OUT_SPECIES or file in HELD_OUT:
                assert split == "test"
    horse, other = (
        creature_clips(file, ["Jump", "Walk"])[0] for file in ("quaternius/animals_pack/Horse", "quaternius2019/Horse")
    )
    assert creature_split(horse) == "train" and creature_split(other) == "test"


def write_dog(path, frames=30):
    """The rigged dog as a GLB whose clip wags the tail and hops."""
    dog = make_sample("dog", 0.3, rigged=True)
    handles = rig_handles(dog)
    phase = np.linspace(0, 2 * np.pi, frames)
    rotations = np.tile(np.eye(3), (frames, 30, 1, 1))
    rotations[:, HANDLE_NAMES.index("tail")] = Rotation.from_rotvec(
        0.6 * np.sin(phase)[:, None] * [0, 1, 0]
    ).as_matrix()
    path_up = np.stack([0 * phase, 0.2 * dog.height * (1 - np.cos(phase)), 0 * phase], axis=1)
    motion = HandleMotion(np.zeros((frames, 30, 3)), rotations, path_up, np.tile(np.eye(3), (frames, 1, 1)))
    path.parent.mkdir(parents=True, exist_ok=True)
    Animation(dog, handles, motion).save(path, name="Armature|Jump")


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("archive")
    write_dog(folder / "quaternius2019" / "Pug.glb")
    write_dog(folder / "quaternius2019" / "Sheep.glb", frames=5)
    (folder / "quaternius2019" / "Pig.glb").write_bytes(b"glTF is not here")
    return folder


def test_a_clip_goes_to_the_reference_body_and_back(archive):
    body = creature_body(archive / "quaternius2019" / "Pug.glb", "quaternius2019/Pug")
    vertices = clip_vertices(body, "Jump")
    motion = reference_motion(body, vertices)
    bare = Stages(feet=False, smooth=False, floor=False)
    again = Animation(
        body.character, body.handles, fit_motion(motion.of_own_body(), Anatomy.of(body.character, body.handles), bare)
    ).vertices()
    error = np.linalg.norm(again - vertices, axis=-1).mean() / body.character.height
    assert error < 0.02
    assert encode(motion)[:, 3].max() > 0.1  # it is off the ground
    with pytest.raises(CharacterError, match="at least 8"):
        reference_motion(body, vertices[:5])
    with pytest.raises(CharacterError, match="its size"):
        reference_motion(body, vertices * 10)


def test_an_archive_is_added_to_the_index(archive, tmp_path):
    (tmp_path / "index.json").write_text(json.dumps({"clips": {"cmu_01": {"texts": ["walk"], "split": "train"}}}))
    seen = []
    added, failed = add_creatures(archive, tmp_path, lambda stage, share: seen.append(share))
    assert added == ["creature_quaternius2019-Pug_Jump"] and seen[-1] == 1
    assert set(failed) == {"quaternius2019/Pig", "creature_quaternius2019-Sheep_Jump"}
    entry = load_index(tmp_path)[added[0]]
    assert (
        entry["species"] == "pug"
        and entry["action"] == "jump"
        and entry["character"] == "quaternius2019/Pug"
        and entry["split"] == "train"
    )
    assert "cmu_01" in load_index(tmp_path) and len(load_clip(tmp_path / f"{added[0]}.npz")) == entry["frames"] == 30
    before = (tmp_path / f"{added[0]}.npz").stat().st_mtime_ns
    assert add_creatures(archive, tmp_path)[0] == added
    assert (tmp_path / f"{added[0]}.npz").stat().st_mtime_ns == before


def test_what_is_missing_is_said(tmp_path):
    with pytest.raises(FormatError, match="no index"):
        add_creatures(tmp_path, tmp_path)
    (tmp_path / "index.json").write_text(json.dumps({"clips": {}}))
    with pytest.raises(FormatError, match="none of the known characters"):
        add_creatures(tmp_path, tmp_path)


def walker(speed, frames=40, fps=20.0, height=1.0):
    """Two feet of four points under a body: each stands for half a second and moves back with `speed`, then swings
    forward high.
    """
    moments = np.arange(frames) / fps
    vertices = np.zeros((frames, 9, 3))
    vertices[:, 8] = [0, height, 0]
    square = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0, 0.05], [0.05, 0, 0.05]])
    for foot, shift in enumerate((0.0, 0.5)):
        phase = (moments + shift) % 1.0
        stands = phase < 0.5
        z = np.where(stands, -speed * phase, -speed * 0.5 + speed * (phase - 0.5))
        y = np.where(stands, 0, 0.3 * np.sin((phase - 0.5) * 2 * np.pi))
        vertices[:, 4 * foot : 4 * foot + 4] = square + np.stack([np.full(frames, 0.2 * foot), y, z], axis=1)[:, None]
    return vertices


@pytest.mark.parametrize("speed", [0.2, 1.0, 3.0])
def test_standing_feet_tell_the_speed(speed):
    assert forward_speed(walker(speed), np.ones(9, bool), 1.0, 20.0) == pytest.approx(speed, rel=0.05)


def turning(frames, end):
    """A handle that turns from 0 to `end` and moves on by 0.1 m a frame."""
    from scipy.spatial.transform import Rotation

    rotations = np.tile(np.eye(3), (frames, 2, 1, 1))
    rotations[:, 1] = Rotation.from_euler("x", np.linspace(0, end, frames)[:, None]).as_matrix()
    path = np.outer(np.arange(frames), [0, 0, 0.1])
    return HandleMotion(np.zeros((frames, 2, 3)), rotations, path, np.broadcast_to(np.eye(3), (frames, 3, 3)))


def test_a_loop_is_played_on_without_a_seam():
    loop = played_on(turning(11, 2 * np.pi), 40)
    assert len(loop) == 40  # four rounds of ten: the eleventh frame is the first again
    np.testing.assert_allclose(loop.rotations[10], loop.rotations[0], atol=1e-6)
    np.testing.assert_allclose(np.diff(loop.root_translation[:, 2]), 0.1, atol=1e-5)
    short = played_on(turning(10, 2 * np.pi * 0.9), 40)  # its last frame is one step before the first
    assert len(short) == 40 and np.abs(np.diff(short.rotations[:, 1, 1, 1])).max() < 0.7
    once = turning(10, 1.5)
    assert played_on(once, 40) is once and played_on(loop, 40) is loop


def arm_raised(side, degrees=70, frames=12):
    """The rigged person raising one arm, driven by its own joints."""
    person = make_sample("person", 0.3, rigged=True)
    rig, sign = person.rig, 1 if side == "left" else -1
    shoulder = rig.names.index(f"{side.capitalize()}Arm")
    moved = {shoulder}
    for joint, parent in enumerate(rig.parents):  # parents come before children in the samples
        if parent in moved:
            moved.add(joint)
    joints = len(rig.names)
    rotations = np.tile(np.eye(3), (frames, joints + 1, 1, 1))
    translations = np.zeros((frames, joints + 1, 3))
    turn = Rotation.from_rotvec(np.linspace(0, sign * np.radians(degrees), frames)[:, None] * [0, 0, 1]).as_matrix()
    for joint in moved:
        arm = rig.positions[joint] - rig.positions[shoulder]
        rotations[:, joint + 1] = turn
        translations[:, joint + 1] = turn @ arm - arm
    weights = np.concatenate([np.zeros((len(person.vertices), 1)), rig.dense_weights()], axis=1)
    handles = Handles(np.concatenate([np.zeros((1, 3)), rig.positions]), weights / weights.sum(axis=1, keepdims=True))
    still = np.broadcast_to(np.eye(3), (frames, 3, 3))
    return Animation(person, handles, HandleMotion(translations, rotations, np.zeros((frames, 3)), still, 20.0))


@pytest.mark.parametrize(("side", "other"), [("left", "right"), ("right", "left")])
def test_a_raised_arm_is_raised_on_the_reference_body(side, other):
    motion = reference_clip(arm_raised(side))
    body = reference_body()
    posed = Animation(body.character(), body.handles, motion).vertices()
    hand = body.handle_weights[:, HANDLE_NAMES.index(f"{side}_wrist")] > 0.5
    idle = body.handle_weights[:, HANDLE_NAMES.index(f"{other}_wrist")] > 0.5
    arm = np.linalg.norm(body.joints[20] - body.joints[16])
    rise = posed[-1, hand, 1].mean() - posed[0, hand, 1].mean()
    assert rise == pytest.approx(arm * np.sin(np.radians(70)), rel=0.3)
    assert abs(posed[-1, idle, 1].mean() - posed[0, idle, 1].mean()) < 0.05
    assert np.abs(posed[..., 1].min(axis=1)).max() < 0.03
