"""FBX files that are broken or mean harm: one sentence, bounded memory, nothing read outside the folder."""

import gzip
import struct
import tracemalloc
import zlib
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from fbx_files import HEAD, Scene, binary, node, text

from bunraku import BunrakuError, FormatError, load_character
from bunraku.formats.fbx.motion import load_fbx_motion
from bunraku.formats.fbx.nodes import Allowance, FbxArray

DATA = Path(__file__).parent / "data"
SQUARE = [[-1.0, 0, 0], [1, 0, 0], [1, 2, 0], [-1, 2, 0]]


def refused(folder: Path, data: bytes, match: str, read=load_character) -> None:
    path = folder / "bad.fbx"
    path.write_bytes(data)
    with pytest.raises(FormatError, match=match) as caught:
        read(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def square(**settings) -> Scene:
    scene = Scene(**settings)
    scene.mesh(scene.model("m", "Mesh"), SQUARE, [[0, 1, 2, 3]])
    return scene


def test_other_versions_are_named(tmp_path):
    refused(tmp_path, HEAD + struct.pack("<I", 6100) + bytes(20), "FBX 6.1, which is not read")
    refused(tmp_path, HEAD + struct.pack("<I", 9000) + bytes(20), "FBX 9.0, newer than what is read")
    refused(
        tmp_path,
        b"; FBX 6.1.0 project file\nFBXHeaderExtension:  {\n\tFBXVersion: 6100\n}\n",
        "FBX 6.1, which is not read",
    )
    refused(tmp_path, b"; FBX project file\nHello: 1\n", "not an FBX file, or its header is missing")


def test_cut_off_anywhere(tmp_path):
    whole = gzip.decompress((DATA / "boxman_y_up_m.fbx.gz").read_bytes())
    path = tmp_path / "cut.fbx"
    for stop in [*range(23, 200, 29), *np.linspace(300, len(whole) - 400, 12).astype(int).tolist()]:
        path.write_bytes(whole[:stop])
        with pytest.raises(BunrakuError, match="broken"):
            load_character(path)


def test_flipped_bytes_never_leave_a_traceback(tmp_path):
    whole = gzip.decompress((DATA / "boxman_y_up_m.fbx.gz").read_bytes())
    rng = np.random.default_rng(0)
    path = tmp_path / "flip.fbx"
    for _ in range(20):
        data = bytearray(whole)
        for at in rng.integers(27, len(data), 3):
            data[at] = rng.integers(256)
        path.write_bytes(data)
        for read in (load_character, load_fbx_motion):
            with suppress(BunrakuError):
                read(path)


def test_a_packed_bomb_is_refused_in_little_memory(tmp_path):
    scene = square()
    geometry = next(entry for entry in scene.objects if entry[0] == "Geometry")
    geometry[2][0] = node("Vertices", np.arange(3.0))
    data = binary(scene.nodes())
    real, bomb = zlib.compress(np.arange(3.0).tobytes()), zlib.compress(bytes(100_000_000))
    at = data.index(real)
    tracemalloc.start()
    # 100 MB where three numbers are said to be, in a node that ends where it did, and numbers that no so short an array
    # can hold
    swapped = bytearray(
        data[: at - 12] + struct.pack("<III", 3, 1, len(real)) + bomb[: len(real)] + data[at + len(real) :]
    )
    refused(tmp_path, bytes(swapped), "broken")
    swapped[at - 12 : at - 8] = struct.pack("<I", 134_000_000)
    refused(tmp_path, bytes(swapped), "longer than the file")
    array = FbxArray(Allowance(tmp_path), np.dtype("<f8"), 3, True, memoryview(bomb))
    assert array.numbers().tolist() == [0, 0, 0]  # no more is unpacked than was asked for
    assert tracemalloc.get_traced_memory()[1] < 30_000_000
    tracemalloc.stop()


def test_many_arrays_share_one_allowance(tmp_path, monkeypatch):
    monkeypatch.setattr("bunraku.formats.fbx.tree.Allowance.__init__.__defaults__", (1000,), raising=False)
    scene = Scene()
    for number in range(20):
        scene.mesh(scene.model(f"m{number}", "Mesh"), SQUARE, [[0, 1, 2, 3]])
    refused(tmp_path, binary(scene.nodes()), "arrays take more than")


def test_deep_nesting_and_loops(tmp_path):
    deep = node("Deep")
    for _ in range(200):
        deep = node("Deep", children=[deep])
    refused(tmp_path, binary([deep]), "nested more than 64 deep")
    refused(tmp_path, b"; FBX\nFBXVersion: 7400\n" + b"Deep: {\n" * 100_000, "nested more than 64 deep")
    scene = square()
    first = scene.model("a", "Null")
    scene.link(first, scene.model("b", "Null", below=first))
    scene.links = [link for link in scene.links if link[1][1:] != [first, 0]]
    refused(tmp_path, binary(scene.nodes()), "form a cycle")


def test_meshes_and_skins_that_point_nowhere(tmp_path):
    scene = Scene()
    scene.mesh(scene.model("m", "Mesh"), SQUARE, [[0, 1, 7]])
    refused(tmp_path, binary(scene.nodes()), "uses vertex 7 but there are 4")
    scene = square()
    scene.cluster(scene.skin(scene.next), scene.model("j"), [0, 99], [1, 1], np.eye(4), np.eye(4))
    refused(tmp_path, binary(scene.nodes()), "moves vertex 99 but there are 4")
    scene = Scene()
    scene.model("only", "Null")
    refused(tmp_path, binary(scene.nodes()), "holds no mesh")
    refused(tmp_path, binary([]), "holds no mesh")


def test_curves_that_do_not_fit(tmp_path):
    scene = square()
    joint = scene.model("j")
    scene.track(scene.clip(), joint, "Lcl Translation", X=([0, 1, 0.5], [0, 1, 2]))
    refused(tmp_path, binary(scene.nodes()), "keys that do not fit together", load_fbx_motion)


def test_broken_text(tmp_path):
    whole = text(square().nodes())
    refused(tmp_path, whole.replace(b"*12", b"*13"), "has 12 numbers but says 13")
    refused(tmp_path, whole[: len(whole) // 2], "broken")
    refused(tmp_path, whole + b"}\n", "never opened")
    refused(tmp_path, whole.replace(b"-1.0,", b"-1.0.3,", 1), "not a number")


def test_numbers_that_are_none_are_refused_or_passed_over(tmp_path):
    scene = Scene(UnitScaleFactor=float("nan"))
    scene.mesh(scene.model("m", "Mesh", Lcl_Translation=(float("inf"), 0.0, 0.0)), SQUARE, [[0, 1, 2, 3]])
    path = tmp_path / "nan.fbx"
    path.write_bytes(binary(scene.nodes()))
    assert np.allclose(load_character(path).vertices, np.array(SQUARE) / 100)
    scene.objects[-1] = (*scene.objects[-1][:2], [node("Vertices", np.full(12, np.nan)), *scene.objects[-1][2][1:]])
    path.write_bytes(binary(scene.nodes()))
    with pytest.raises(BunrakuError, match="not numbers"):
        load_character(path)
