"""Clips that Bunraku wrote, read again to be edited or followed."""

import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, made_up_handles, made_up_motion

from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.errors import FormatError, MotionError
from bunraku.formats.gltf.bunraku_clip import KEY
from bunraku.io import save_character
from bunraku.io.clips import load_clip, load_clip_animation
from bunraku.io.registry import read_motion

ARRAYS = ("translations", "rotations", "root_translation", "root_rotation")


@pytest.fixture
def animation():
    cube = Character("cube", CUBE, CUBE_FACES)
    motion = made_up_motion(cube)
    return Animation(cube, made_up_handles(cube), motion, motion.take(np.arange(len(motion))[::-1]))


def same(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ARRAYS) and one.fps == other.fps


@pytest.mark.parametrize("suffix", ["npz", "glb"])
def test_motions_come_back_bit_for_bit(animation, tmp_path, suffix):
    path = animation.save(tmp_path / f"clip.{suffix}", **({"fps": 30} if suffix == "glb" else {}))
    clip = load_clip(path)
    assert (
        same(clip.motion, animation.motion)
        and same(clip.reference, animation.reference)
        and same(read_motion(path), animation.motion)
    )
    assert clip.is_of(animation.handles) and clip.on(animation.character, animation.handles).reference is clip.reference
    again = Animation(animation.character, animation.handles, clip.motion, clip.reference).save(
        tmp_path / f"again.{suffix}"
    )
    assert same(load_clip(again).motion, animation.motion)


@pytest.mark.parametrize("roles", [None, {26: 1, 27: 4}])
def test_a_glb_brings_its_character_and_handles(animation, tmp_path, roles):
    handles = animation.handles
    if roles:
        played = np.arange(30)
        played[list(roles)] = list(roles.values())
        handles = Handles(handles.positions, handles.weights, roles=played)
    found = load_clip_animation(
        Animation(animation.character, handles.top(4), animation.motion, animation.reference).save(
            tmp_path / "clip.glb"
        )
    )
    np.testing.assert_allclose(found.handles.positions, handles.positions, atol=1e-6)
    np.testing.assert_allclose(found.handles.weights, handles.top(4).weights, atol=1e-6)
    assert np.array_equal(found.handles.played, handles.played)
    np.testing.assert_allclose(
        found.vertices([0, 7]),
        Animation(animation.character, handles.top(4), animation.motion).vertices([0, 7]),
        atol=1e-5,
    )


def test_whose_motion_it_is(animation, tmp_path):
    body = reference_body()
    clip = load_clip(animation.save(tmp_path / "clip.npz"))
    assert not clip.is_of(body.handles) and same(clip.of_the_reference_body(), animation.reference)
    assert clip.on(body.character(), body.handles) is None
    lone = load_clip(Animation(animation.character, animation.handles, animation.motion).save(tmp_path / "lone.npz"))
    assert lone.reference is None
    with pytest.raises(MotionError, match="name that character"):
        lone.of_the_reference_body()
    ours = load_clip(Animation(body.character(), body.handles, animation.motion).save(tmp_path / "ours.npz"))
    assert same(ours.of_the_reference_body(), animation.motion)


def test_files_without_a_motion_of_ours(animation, tmp_path):
    rigged = save_character(animation.character, tmp_path / "rigged.glb", animation.handles)
    for call in (load_clip, read_motion, load_clip_animation):
        with pytest.raises(FormatError, match="no handle motion of Bunraku"):
            call(rigged)
    (tmp_path / "clip.bvh").write_text("HIERARCHY")
    with pytest.raises(FormatError, match="glb and .npz"):
        load_clip(tmp_path / "clip.bvh")


def test_the_mark_does_not_outlive_the_motion(animation, tmp_path):
    from bunraku.io import load_character

    character = load_character(animation.save(tmp_path / "clip.glb"))
    plain = save_character(character, tmp_path / "plain.glb")
    assert KEY.encode() not in plain.read_bytes()


def test_broken_and_hostile_files(animation, tmp_path):
    whole, path = animation.save(tmp_path / "good.glb").read_bytes(), tmp_path / "bad.glb"
    mark = f'"{KEY}":'.encode()
    at = whole.index(mark) + len(mark)
    end = at + min(whole[at : at + 8].find(stop) for stop in (b"}", b",") if stop in whole[at : at + 8])
    number = whole[at:end]
    for other in (
        b"9" * len(number),
        b"0" * (len(number) - 1) + b"0",
        b'""'[: len(number)].ljust(len(number)),
        b"-1"[: len(number)].ljust(len(number)),
    ):
        path.write_bytes(whole[:at] + other + whole[end:])
        with pytest.raises(FormatError, match="bad.glb"):
            load_clip(path)
    rng = np.random.default_rng(0)
    start = whole.rindex(b"PK\x01\x02") - 2000
    for _ in range(60):
        data = bytearray(whole)
        data[rng.integers(start, len(data))] = rng.integers(256)
        path.write_bytes(data)
        try:
            load_clip(path)
        except (FormatError, MotionError) as error:
            assert "\n" not in str(error)


def test_names_are_the_handles(animation, tmp_path):
    found = load_clip_animation(animation.save(tmp_path / "clip.glb"))
    assert found.character.rig.names == HANDLE_NAMES
