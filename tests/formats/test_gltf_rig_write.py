"""A rig's animation as GLB: what the file had is there still, and a player poses the vertices that the library
poses.
"""

from dataclasses import replace

import numpy as np
import pytest
from gltf_files import textured_glb

from bunraku import OptionError, RigAnimation
from bunraku.body.reference import reference_body
from bunraku.formats.gltf.container.open import open_document
from bunraku.formats.gltf.turning import turned
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.io import load_character
from bunraku.io.play import load_animation
from bunraku.io.save_clips import save_clips


def swinging(character, frames=5, seed=0):
    random = np.random.default_rng(seed)
    bones = len(character.rig.names)
    swing = np.linspace(0, 1, frames)[:, None, None]
    turns = matrix_from_axis_angle(swing * random.normal(size=(1, bones, 3)))
    return RigAnimation(character, turns, swing * 0.1 * random.normal(size=(1, bones, 3)), 20.0)


@pytest.fixture
def textured(tmp_path):
    path = tmp_path / "textured.glb"
    path.write_bytes(textured_glb())
    return load_character(path)


def test_the_file_keeps_its_nodes_materials_and_skins(textured, tmp_path):
    path = swinging(textured).save(tmp_path / "out.glb", name="swing")
    old, new = textured.source.document.tree, open_document(path, path.read_bytes()).tree
    assert [node.get("name") for node in new["nodes"]] == [node.get("name") for node in old["nodes"]]
    assert (
        new["materials"] == old["materials"]
        and new["textures"] == old["textures"]
        and new["scenes"][0]["name"] == "stage"
    )
    assert new["meshes"][0]["extras"] == {"maker": "us"} and new["nodes"][0]["extras"] == {"part": "body"}
    assert new["skins"][0]["joints"] == old["skins"][0]["joints"]
    assert [clip.get("name") for clip in new["animations"]] == ["swing", old["animations"][0].get("name")]


def test_the_clips_of_the_file_keep_their_keys(textured, tmp_path):
    document = textured.source.document
    path = swinging(textured).save(tmp_path / "out.glb", name="swing")
    written = open_document(path, path.read_bytes())
    old, new = document.tree["animations"][0], written.tree["animations"][1]
    assert [channel["target"] for channel in new["channels"]] == [channel["target"] for channel in old["channels"]]
    for before, after in zip(old["samplers"], new["samplers"], strict=True):
        for key in ("input", "output"):
            kinds = ("SCALAR", "VEC3", "VEC4")
            assert np.array_equal(
                document.accessor(before[key], kinds, raw=True), written.accessor(after[key], kinds, raw=True)
            )
        assert after.get("interpolation", "LINEAR") == before.get("interpolation", "LINEAR")


def test_several_clips_go_into_one_file(textured, tmp_path):
    clips = {"swing": swinging(textured), "sway": swinging(textured, frames=9, seed=1)}
    path = save_clips(clips, tmp_path / "out.glb")
    for number, clip in enumerate(clips.values()):
        played = load_animation(path, number, 20.0)
        assert np.abs(played.vertices() - clip.vertices()).max() < 1e-5 * textured.height
    names = [clip.get("name") for clip in open_document(path, path.read_bytes()).tree["animations"]]
    assert names[:2] == ["swing", "sway"] and len(names) == 3


@pytest.mark.parametrize("kind", ["own", "turned", "plain"])
def test_a_player_sees_the_same_vertices(textured, tmp_path, kind):
    character = {"own": textured, "turned": turned(textured, "+z", "-y"), "plain": reference_body().character()}[kind]
    animation = swinging(character)
    played = load_animation(animation.save(tmp_path / "out.glb"), 0, 20.0)
    assert len(played.motion) == 5
    assert np.abs(played.vertices() - animation.vertices()).max() < 1e-5 * character.height


def test_a_rig_of_another_source_gets_a_plain_skin(textured, tmp_path):
    character = replace(textured, source=None, avatar=None)
    animation = swinging(character)
    again = load_character(animation.save(tmp_path / "out.glb"))
    assert again.rig.names == character.rig.names and np.array_equal(again.rig.parents, character.rig.parents)
    assert (
        np.abs(load_animation(tmp_path / "out.glb", 0, 20.0).vertices() - animation.vertices()).max()
        < 1e-5 * character.height
    )


def test_other_rates(textured, tmp_path):
    animation = swinging(textured, frames=9)
    played = load_animation(animation.save(tmp_path / "out.glb", fps=40), 0, 20.0)
    assert np.abs(played.vertices() - animation.vertices()).max() < 1e-5 * textured.height
    with pytest.raises(OptionError, match="1 to 1000"):
        animation.save(tmp_path / "bad.glb", fps=0)


def test_one_that_stands_still_keeps_its_length(textured, tmp_path):
    bones = len(textured.rig.names)
    still = RigAnimation(textured, np.tile(np.eye(3), (11, bones, 1, 1)), np.zeros((11, bones, 3)), 20.0)
    assert len(load_animation(still.save(tmp_path / "out.glb"), 0, 20.0).motion) == 11
