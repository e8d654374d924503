"""What a file is, whatever it is called, and one sentence for everything that is no character."""

import subprocess
import sys
import time

import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, cube_glb, glb_bytes, made_up_handles, made_up_motion, textured_glb

from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.errors import BunrakuError, CharacterError, FormatError, OptionError
from bunraku.io import load_character
from bunraku.io.registry import read_motion


@pytest.mark.parametrize("name", ["cube.glb", "cube.txt", "cube.obj", "cube", "cube.GLB", "cube.ply", "cube.vrm"])
def test_the_first_bytes_tell_a_glb(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(cube_glb())
    assert np.array_equal(load_character(path).vertices, CUBE)


def test_unknown_and_wrong_suffixes(tmp_path):
    path = tmp_path / "thing.xyz"
    path.write_text("1 2 3\n")
    with pytest.raises(
        FormatError,
        match=r"'\.xyz' is not a format for this; characters are read from \.glb, \.vrm, \.gltf, \.ply, \.obj, \.stl",
    ):
        load_character(path)
    with pytest.raises(FormatError, match="a file without a suffix"):
        load_character(path.rename(tmp_path / "thing"))
    for suffix in (".glb", ".ply"):
        path = tmp_path / f"thing{suffix}"
        path.write_text("1 2 3\n")
        with pytest.raises(FormatError, match=f"its contents are not those of a {suffix} file"):
            load_character(path)
    path = tmp_path / "thing.glb"
    path.write_bytes(cube_glb())
    with pytest.raises(FormatError, match="no handle motion of Bunraku"):
        read_motion(path)


def test_files_that_are_none(tmp_path):
    with pytest.raises(FormatError, match="there is no such file"):
        load_character(tmp_path / "none.glb")
    with pytest.raises(FormatError, match="this is a folder"):
        load_character(tmp_path)
    (tmp_path / "empty.glb").touch()
    with pytest.raises(FormatError, match="the file is empty"):
        load_character(tmp_path / "empty.glb")
    with pytest.raises(FormatError, match="not a plain file"):
        load_character("/dev/null")
    with pytest.raises(FormatError):
        load_character("a\0b.glb")


def test_a_file_of_3_gb_is_refused_unread(tmp_path):
    path = tmp_path / "huge.glb"
    with path.open("wb") as file:
        file.truncate(3 << 30)
    start = time.perf_counter()
    with pytest.raises(FormatError, match=r"3\.0 GiB but at most 2 GiB"):
        load_character(path)
    assert time.perf_counter() - start < 0.5


def is_one_sentence(error):
    return "\n" not in str(error) and len(str(error)) < 500


def test_truncated_files(tmp_path):
    whole, path = textured_glb(), tmp_path / "cut.glb"
    for length in range(0, len(whole), 41):
        path.write_bytes(whole[:length])
        with pytest.raises(BunrakuError, match=r"cut\.glb: ") as caught:
            load_character(path)
        assert is_one_sentence(caught.value)
    # A header that admits the shorter length leaves the buffers to find out.
    import json
    import struct

    size = struct.unpack_from("<I", whole, 12)[0]
    tree, binary = json.loads(whole[20 : 20 + size]), whole[28 + size :]
    for length in range(0, len(binary) - 8, 16):
        path.write_bytes(glb_bytes(tree, binary[:length]))
        with pytest.raises(FormatError, match="truncated"):
            load_character(path)


def test_flipped_bytes_give_a_character_or_one_sentence(tmp_path):
    from gltf_files import made_up_handles, made_up_motion

    from bunraku.core.animation import Animation

    rng, whole, path = np.random.default_rng(0), textured_glb(), tmp_path / "flipped.glb"
    outcomes = set()
    for _ in range(200):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), rng.integers(1, 6)):
            data[at] = rng.integers(256)
        path.write_bytes(data)
        try:
            character = load_character(path)
            Animation(character, made_up_handles(character, 4), made_up_motion(character, 3, 4)).save(
                tmp_path / "out.glb"
            )
            outcomes.add("read")
        except BunrakuError as error:
            assert is_one_sentence(error)
            outcomes.add("refused")
    assert outcomes == {"read", "refused"}


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_flipped_bytes_of_other_meshes(tmp_path, suffix):
    import trimesh

    path = tmp_path / f"flipped.{suffix}"
    trimesh.creation.icosphere(subdivisions=1).export(path)
    whole, rng = path.read_bytes(), np.random.default_rng(1)
    for turn in range(100):
        data = bytearray(whole[: rng.integers(1, len(whole)) if turn % 3 == 0 else None])
        for at in rng.integers(0, len(data), rng.integers(1, 5)):
            data[at] = rng.integers(256)
        path.write_bytes(data)
        try:
            load_character(path)
        except BunrakuError as error:
            assert is_one_sentence(error)


def test_hostile_json_values(tmp_path):
    """Any value of the tree replaced by one of another kind: a character or one sentence."""
    import copy
    import json
    import struct

    whole, path = textured_glb(), tmp_path / "hostile.glb"
    size = struct.unpack_from("<I", whole, 12)[0]
    tree, binary = json.loads(whole[20 : 20 + size]), whole[28 + size :]
    spots = []

    def collect(item, above):
        for key in item if isinstance(item, dict) else range(len(item)):
            spots.append((*above, key))
            if isinstance(item[key], dict | list):
                collect(item[key], (*above, key))

    collect(tree, ())
    values = [-1, 0, 1e9, 2**63, 1e308, "x", None, [], {}, True, [[]], "\ud800"]
    for number, spot in enumerate(spots):
        for value in values[number % 3 :: 3]:
            changed = copy.deepcopy(tree)
            item = changed
            for key in spot[:-1]:
                item = item[key]
            item[spot[-1]] = value
            path.write_bytes(glb_bytes(changed, binary))
            try:
                load_character(path)
            except BunrakuError as error:
                assert is_one_sentence(error)


def test_importing_the_formats_loads_nothing_heavy():
    heavy = ["torch", "scipy", "PIL", "trimesh", "pygltflib", "zipfile"]
    code = f"import sys, bunraku.io; print([name for name in {heavy} if name in sys.modules])"
    assert (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"
    )


def test_outputs_that_are_not_files(tmp_path):
    import os

    from gltf_files import CUBE_FACES

    from bunraku.core.character import Character
    from bunraku.io import save_character

    cube = Character("cube", CUBE, CUBE_FACES)
    os.mkfifo(tmp_path / "pipe.glb")
    with pytest.raises(FormatError, match="not a plain file"):
        save_character(cube, tmp_path / "pipe.glb")
    with pytest.raises(FormatError, match="zero byte"):
        save_character(cube, tmp_path / "a\0b.glb")
    with pytest.raises(FormatError, match=r"'\.stl' is not a format for this; characters are written to \.glb"):
        save_character(cube, tmp_path / "cube.stl")
    with pytest.raises(CharacterError, match="a VRM needs a skeleton with VRM's names"):
        save_character(cube, tmp_path / "cube.vrm")
    with pytest.raises(FormatError, match="cannot be written"):
        save_character(cube, tmp_path / f"{'x' * 300}.glb")
    assert [entry.name for entry in tmp_path.iterdir()] == ["pipe.glb"]


@pytest.mark.parametrize(
    ("suffix", "magic"), [("mp4", b"ftyp"), ("webp", b"RIFF"), ("gif", b"GIF8"), ("png", b"\x89PNG")]
)
def test_pictures_are_saved_by_their_suffix(tmp_path, suffix, magic):
    cube = Character("cube", CUBE, CUBE_FACES)
    animation = Animation(cube, made_up_handles(cube), made_up_motion(cube, frames=3))
    assert magic in animation.save(tmp_path / f"dance.{suffix}", fps=10, size=(64, 48)).read_bytes()[:12]


def test_saving_under_a_name_that_says_nothing(tmp_path):
    cube = Character("cube", CUBE, CUBE_FACES)
    animation = Animation(cube, made_up_handles(cube), made_up_motion(cube, frames=3))
    with pytest.raises(FormatError, match=r"animations are written to \.glb, .*\.bvh, \.vrma, .*\.mp4"):
        animation.save(tmp_path / "dance.xyz")
    with pytest.raises(FormatError, match=r"motions are written to .*\.npz, \.bvh, \.vrma"):
        animation.motion.save(tmp_path / "dance.glb")
    with pytest.raises(OptionError, match="have no option 'unit'"):
        animation.save(tmp_path / "dance.glb", unit="cm")
    assert not list(tmp_path.iterdir())


def test_a_character_travels_between_processes(tmp_path):
    import pickle

    from bunraku.io import save_character

    path = tmp_path / "thing.glb"
    path.write_bytes(textured_glb())
    character = load_character(path)
    again = pickle.loads(pickle.dumps(character))
    one, two = (save_character(thing, tmp_path / "out.glb").read_bytes() for thing in (character, again))
    assert one == two
