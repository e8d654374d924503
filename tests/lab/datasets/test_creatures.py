"""Clips of creatures: the table, and a made archive from files to the index."""

import json
import re
from importlib import resources

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.animation import Animation
from bunraku.core.motion import HandleMotion
from bunraku.diffusion.features import encode
from bunraku.errors import CharacterError, FormatError
from bunraku.handles.from_rig import rig_handles
from bunraku.language.captions.phrases import mirror_words
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


def test_the_table_speaks_the_words_of_captions():
    words = json.loads(resources.files("bunraku.language").joinpath("creature_captions.json").read_text("utf-8"))
    known = set(words["actions"]) | {"spell", "aim", "block", "reload"}  # these only people do
    assert {entry["action"] for entry in TABLE["labels"].values()} <= known
    assert all(entry["phrases"] for entry in TABLE["labels"].values())
    assert set(HELD_OUT_SPECIES) <= {entry["species"][0] for entry in TABLE["characters"].values()}


def watched_phrases():
    """(character, label, phrases) of every clip that was watched."""
    for file, known in TABLE["characters"].items():
        for label, phrases in known.get("watched", {}).items():
            yield file, label, phrases


def test_what_was_watched_takes_the_place_of_the_labels_words():
    (attack, other) = creature_clips("quaternius2019/Bat", ["Bat_Attack", "Bat_Attack2"])
    assert attack.action == other.action == "attack" and not set(attack.texts) & set(other.texts)
    assert attack.texts[0].startswith("a bat leans forward, folds its wings and spins")
    assert not any("in another way" in text for text in other.texts)
    (stegosaurus,) = creature_clips("quaternius/dinosaurs_pack/Apatosaurus", ["Stegosaurus_Death"])
    assert "left side" in stegosaurus.texts[0] and stegosaurus.texts[0].startswith(
        "an apatosaurus raises its long neck"
    )
    (white,) = creature_clips("quaternius/animals_pack/Horse_White", ["Walk"])  # a recoloured horse with its clips
    assert "a horse walks on all fours with even steps" in white.texts
    (unwatched,) = creature_clips("quaternius/cyberpunk_pack/Enemy_Flying", ["Shoot"])
    assert "a drone fires a gun" in unwatched.texts
    assert not creature_clips("quaternius2019/Eagle", ["Eagle|Idle"])


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
        body.character,
        body.handles,
        fit_motion(motion.of_own_body(), Anatomy.of(body.character, body.handles), bare),
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
