"""Clips of one character in one file: by merging, by adding, end to start; other characters are refused."""

from dataclasses import replace

import numpy as np
import pytest
from gltf_files import made_up_handles, made_up_motion, textured_glb

import bunraku
from bunraku.core.animation import Animation
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import FormatError, OptionError
from bunraku.formats.gltf.container.open import open_document
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.io import load_character
from bunraku.io.merge import merge
from bunraku.io.play import load_animation
from bunraku.io.save_clips import save_clips


def names_of(path):
    return [clip.get("name") for clip in open_document(path, path.read_bytes()).tree["animations"]]


@pytest.fixture
def textured(tmp_path):
    path = tmp_path / "textured.glb"
    path.write_bytes(textured_glb())
    return load_character(path)


def swinging(character, frames=5, seed=0):
    random = np.random.default_rng(seed)
    bones = len(character.rig.names)
    turns = np.linspace(0, 1, frames)[:, None, None] * random.normal(size=(1, bones, 3))
    return RigAnimation(character, matrix_from_axis_angle(turns), np.zeros((frames, bones, 3)), 20.0)


def handled(character, seed):
    handles = made_up_handles(character).top(4)
    return Animation(character, handles, made_up_motion(character, frames=6, seed=seed))


def test_merged_clips_play_as_they_did(textured, tmp_path):
    first, second = swinging(textured), swinging(textured, seed=1)
    save_clips({"swing": first}, tmp_path / "a.glb")
    save_clips({"swing": second}, tmp_path / "b.glb")
    path = merge([tmp_path / "a.glb", tmp_path / "b.glb"], tmp_path / "c.glb")
    names = names_of(path)
    assert names[0] == "swing" and "swing-2" in names
    for number, clip in ((0, first), (names.index("swing-2"), second)):
        played = load_animation(path, number, 20.0)
        assert np.abs(played.vertices() - clip.vertices()).max() < 1e-5 * textured.height


def test_the_first_file_stays_as_it_is(textured, tmp_path):
    for name, seed in (("a", 0), ("b", 1)):
        save_clips({name: swinging(textured, seed=seed)}, tmp_path / f"{name}.glb")
    path = merge([tmp_path / "a.glb", tmp_path / "b.glb"], tmp_path / "c.glb")
    old, new = (open_document(some, some.read_bytes()) for some in (tmp_path / "a.glb", path))
    for key in ("nodes", "skins", "meshes", "materials", "textures", "scenes"):
        assert new.tree[key] == old.tree[key]
    for number in range(len(old.tree["bufferViews"])):
        assert bytes(new.view(number)) == bytes(old.view(number))


def test_clips_of_another_character_are_refused(textured, tmp_path):
    save_clips({"a": swinging(textured)}, tmp_path / "a.glb")
    names = tuple(f"x{name}" for name in textured.rig.names)
    renamed = replace(textured, rig=replace(textured.rig, names=names), source=None)
    save_clips({"b": swinging(renamed)}, tmp_path / "b.glb")
    with pytest.raises(FormatError, match="another character"):
        merge([tmp_path / "a.glb", tmp_path / "b.glb"], tmp_path / "c.glb")
    assert not (tmp_path / "c.glb").exists()


def test_bones_that_rest_elsewhere_are_another_character(textured, tmp_path):
    own = replace(textured, source=None, avatar=None)
    save_clips({"a": swinging(own)}, tmp_path / "a.glb")
    moved = np.array(own.rig.transforms)
    moved[-1, :3, 3] += 0.2 * own.height
    save_clips({"b": swinging(replace(own, rig=replace(own.rig, transforms=moved)))}, tmp_path / "b.glb")
    with pytest.raises(FormatError, match="rest elsewhere"):
        merge([tmp_path / "a.glb", tmp_path / "b.glb"], tmp_path / "c.glb")


def test_clips_are_added_to_those_of_a_file(textured, tmp_path):
    path = tmp_path / "a.glb"
    clips = {name: handled(textured, seed) for name, seed in (("walk", 0), ("run", 1))}
    save_clips({"walk": clips["walk"]}, path)
    save_clips({"run": clips["run"]}, path, add=True)
    save_clips({"run": clips["run"]}, path, add=True)
    assert names_of(path) == ["walk", "run", "run-2"]
    for number, name in enumerate(("walk", "run", "run")):
        played = load_animation(path, number, clips[name].fps)
        assert np.abs(played.vertices() - clips[name].vertices()).max() < 1e-4 * textured.height
    assert not list(tmp_path.glob(".*.tmp"))


def test_one_clip_of_all_end_to_start(textured, tmp_path):
    for name, seed in (("a", 0), ("b", 1)):
        save_clips({name: swinging(textured, 21, seed)}, tmp_path / f"{name}.glb")
    whole = merge([tmp_path / "a.glb", tmp_path / "b.glb"], tmp_path / "c.glb", end_to_start=True, fps=20.0)
    lengths = [len(load_animation(whole, number, 20.0).motion) for number in range(2)]
    parts = [len(load_animation(tmp_path / f"{name}.glb", n, 20.0).motion) for name in "ab" for n in range(2)]
    assert names_of(whole)[0] == "c" and lengths[0] == sum(parts) - len(parts) + 1


def test_what_is_no_set_of_clips_is_refused(textured, tmp_path):
    one = swinging(textured)
    with pytest.raises(OptionError, match="no clip"):
        save_clips({}, tmp_path / "a.glb")
    with pytest.raises(OptionError, match="has no name"):
        save_clips({" ": one}, tmp_path / "a.glb")
    with pytest.raises(FormatError, match=r"\.glb"):
        save_clips({"a": one}, tmp_path / "a.bvh")
    with pytest.raises(OptionError, match="one character"):
        save_clips({"a": one, "b": swinging(replace(textured, name="other"))}, tmp_path / "a.glb")
    assert bunraku.save_clips is save_clips
