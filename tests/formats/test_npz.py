"""Handle motion as NPZ, there and back, and files that mean harm."""

import io
import struct
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, made_up_handles, made_up_motion

from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.errors import BunrakuError, FormatError, MotionError
from bunraku.io.registry import read_motion


@pytest.fixture
def animation():
    cube = Character("cube", CUBE, CUBE_FACES)
    return Animation(cube, made_up_handles(cube), made_up_motion(cube))


def test_there_and_back(animation, tmp_path):
    path = animation.save(tmp_path / "motion.npz")
    motion = read_motion(path)
    for name in ("translations", "rotations", "root_translation", "root_rotation"):
        assert np.allclose(getattr(motion, name), getattr(animation.motion, name), atol=1e-6)
    assert motion.fps == animation.motion.fps
    with np.load(path, allow_pickle=False) as plain:
        assert plain["rotations"].shape == (24, 30, 3, 3) and plain["handle_names"][0] == "pelvis"
        assert np.array_equal(plain["handle_positions"], animation.handles.positions)


def test_matrices_are_read_too(animation, tmp_path):
    motion = animation.motion
    parts = {
        name: getattr(motion, name)
        for name in ("translations", "rotations", "root_translation", "root_rotation", "fps")
    }
    np.savez(tmp_path / "m.npz", **parts)
    assert np.array_equal(read_motion(tmp_path / "m.npz").rotations, motion.rotations)


def test_broken_and_hostile_files(animation, tmp_path):
    whole, path = animation.save(tmp_path / "good.npz").read_bytes(), tmp_path / "bad.npz"

    def refused(data, match):
        path.write_bytes(data)
        with pytest.raises((FormatError, MotionError), match=match):
            read_motion(path)

    for length in range(1, len(whole), len(whole) // 40):
        refused(whole[:length], "bad.npz: ")
    rng = np.random.default_rng(0)
    for _ in range(100):
        data = bytearray(whole)
        data[rng.integers(len(data))] = rng.integers(256)
        path.write_bytes(data)
        try:
            read_motion(path)
        except BunrakuError as error:
            assert "\n" not in str(error)
    motion = animation.motion
    parts = {
        name: getattr(motion, name)
        for name in ("translations", "rotations", "root_translation", "root_rotation", "fps")
    }

    def packed(**changes):
        out = io.BytesIO()
        np.savez(out, **{**parts, **changes}, allow_pickle=True)
        return out.getvalue()

    refused(packed(fps=np.array([object()])), "not plain numbers")
    refused(packed(rotations=np.zeros((24, 30, 4))), "6D or 3 x 3")
    refused(packed(translations=np.full((24, 30, 3), np.nan)), "not numbers")
    refused(packed(fps=0), "from 1 to 1000")
    refused(packed(fps=np.ones(2)), "one number")
    refused(packed(root_translation=np.zeros((23, 3))), "shape")
    out = io.BytesIO()
    np.savez(out, a=1)
    refused(out.getvalue(), "lacks translations")
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in parts:
            header = io.BytesIO()
            np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (10**9, 3)})
            archive.writestr(f"{name}.npy", header.getvalue() + bytes(100))
    refused(out.getvalue(), "cut short")


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [("fps", np.inf, "fps"), ("fps", 1e-6, "fps"), ("fps", np.nan, "fps"), ("rotations", None, "handle 0")],
)
def test_numbers_that_make_no_motion_name_the_file(animation, tmp_path, name, value, match):
    with np.load(animation.save(tmp_path / "good.npz"), allow_pickle=False) as good:
        parts = dict(good)
    parts[name] = np.zeros_like(parts[name]) if value is None else np.float32(value)
    np.savez(tmp_path / "odd.npz", **parts)
    with pytest.raises((FormatError, MotionError), match=f"odd.npz.*{match}"):
        read_motion(tmp_path / "odd.npz")


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f4', 'fortran_order': False, 'shape': (3,",
        "{'descr': (), 'fortran_order': False, 'shape': (3,)}",
        "-" * 9000 + "1",
        "(" * 300,
    ],
)
def test_headers_that_are_no_header(tmp_path, header):
    text = header.encode() + b"\n"
    array = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(12)
    (tmp_path / "bad.npy").write_bytes(array)
    with zipfile.ZipFile(tmp_path / "bad.npz", "w") as archive:
        for name in ("translations", "rotations", "root_translation", "root_rotation", "fps"):
            archive.writestr(f"{name}.npy", array)
    for name in ("bad.npy", "bad.npz"):
        with pytest.raises(FormatError, match=name):
            read_motion(tmp_path / name)


def test_only_what_numpy_packs_is_unpacked(animation, tmp_path):
    with (
        zipfile.ZipFile(animation.save(tmp_path / "good.npz")) as good,
        zipfile.ZipFile(tmp_path / "bad.npz", "w", zipfile.ZIP_BZIP2) as bad,
    ):
        for name in good.namelist():
            bad.writestr(name, good.read(name))
    with pytest.raises(FormatError, match=r"bad\.npz"):
        read_motion(tmp_path / "bad.npz")


def test_what_body_a_motion_was_made_for_is_kept_and_older_files_say_all_of_it_by_one_name(animation, tmp_path):
    path = replace(animation, motion=replace(animation.motion, own_height=True)).save(tmp_path / "own.npz")
    found = read_motion(path)
    assert (found.own_kind, found.own_height, found.soft) == (False, True, False)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files if name not in ("own_kind", "own_height", "soft")}
    for value in (0.0, 1.0):
        np.savez(path, **arrays, native=np.float32(value))
        found = read_motion(path)
        assert (found.own_kind, found.own_height, found.soft) == (bool(value),) * 3
