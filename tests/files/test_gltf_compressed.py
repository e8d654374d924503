"""GLB files packed with meshopt and with Draco: the vertices are those of the plain file."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from gltf_files import Maker, glb_bytes

from bunraku.core.geometry.graph import clean_mesh
from bunraku.errors import FormatError, MissingExtraError
from bunraku.files import load_character
from bunraku.files.gltf.read import read_gltf

meshoptimizer = pytest.importorskip("meshoptimizer")
draco = pytest.importorskip("DracoPy")

RNG = np.random.default_rng(3)
POINTS = RNG.normal(size=(400, 3)).astype(np.float32)
FACES = np.concatenate([RNG.permutation(400)[:399].reshape(-1, 3) for _ in range(5)]).astype(np.uint32)
PRIMITIVE = {"attributes": {"POSITION": 0}, "indices": 1}


def read(data, name="a.glb"):
    from pathlib import Path

    return read_gltf(Path(name), data)


def packed_view(maker, data, size, extension, plain=b""):
    """A view of `size` bytes in a fallback buffer that has none, packed in the GLB's own buffer."""
    where = maker.view(data)
    source = maker.views[where]
    maker.views[where] = {
        "buffer": 1,
        "byteLength": size,
        "extensions": {
            extension.pop("name"): {
                "buffer": 0,
                "byteOffset": source["byteOffset"],
                "byteLength": source["byteLength"],
                **extension,
            }
        },
    }
    return where


def meshopt_glb(
    name="EXT_meshopt_compression",
    points=POINTS,
    faces=FACES,
    index_size=4,
    change=None,
    required=True,
    mode="TRIANGLES",
):
    maker = Maker()
    vertices = np.ascontiguousarray(points, np.float32)
    data = bytes(meshoptimizer.encode_vertex_buffer(vertices, len(vertices), 12))
    attributes = {"name": name, "byteStride": 12, "count": len(vertices), "mode": "ATTRIBUTES"}
    attributes |= change or {}
    first = packed_view(maker, data, 12 * len(vertices), attributes)
    order = faces.reshape(-1).astype(np.uint32)
    encode = meshoptimizer.encode_index_buffer if mode == "TRIANGLES" else meshoptimizer.encode_index_sequence
    data = bytes(encode(order, len(order), len(vertices)))
    second = packed_view(
        maker,
        data,
        index_size * len(order),
        {"name": name, "byteStride": index_size, "count": len(order), "mode": mode},
    )
    maker.accessors += [
        {"bufferView": first, "componentType": 5126, "count": len(vertices), "type": "VEC3"},
        {
            "bufferView": second,
            "componentType": 5125 if index_size == 4 else 5123,
            "count": len(order),
            "type": "SCALAR",
        },
    ]
    used = {"extensionsUsed": [name], "extensionsRequired": [name]}
    tree = maker.tree(nodes=[{"mesh": 0}], meshes=[{"primitives": [PRIMITIVE]}], **used)
    size = 12 * len(vertices) + index_size * len(order)
    tree["buffers"].append({"byteLength": size, "extensions": {name: {"fallback": True}}})
    return glb_bytes(tree, maker.binary)


def draco_glb(points=POINTS, faces=FACES, change=None, counts=None, data=None, joints=None):
    maker = Maker()
    generic = {} if joints is None else {"generic_attributes": {7: joints}}
    packed = draco.encode(points, faces=faces, quantization_bits=16, preserve_order=True, **generic)
    found = draco.decode(packed)
    ids = {"POSITION": next(a["unique_id"] for a in found.attributes if a["attribute_type"] == 0)}
    view = maker.view(packed if data is None else data)
    count, corners = counts or (len(points), faces.size)
    maker.accessors += [
        {"componentType": 5126, "count": count, "type": "VEC3"},
        {"componentType": 5125, "count": corners, "type": "SCALAR"},
    ]
    primitive = {"attributes": {"POSITION": 0}, "indices": 1}
    if joints is not None:
        ids["_JOINTS"] = 7
        maker.accessors.append({"componentType": 5121, "count": count, "type": "VEC4"})
        primitive["attributes"]["_JOINTS"] = 2
    primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": view, "attributes": ids} | (change or {})}
    name = "KHR_draco_mesh_compression"
    return maker.glb(
        nodes=[{"mesh": 0}], meshes=[{"primitives": [primitive]}], extensionsUsed=[name], extensionsRequired=[name]
    )


@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
@pytest.mark.parametrize("size", [2, 4])
def test_meshopt_gives_the_very_vertices(name, size):
    got = read(meshopt_glb(name, index_size=size))
    assert np.array_equal(got.vertices, POINTS)
    own, want = (np.sort(np.roll(faces, 0, axis=1), axis=1) for faces in (got.faces, FACES))
    assert np.array_equal(own[np.lexsort(own.T)], want[np.lexsort(want.T)])
    assert not got.source.document.tree["extensionsRequired"] and not got.source.document.tree["extensionsUsed"]


def test_meshopt_filters_are_undone():
    """Positions with a shared exponent: 24 bits of mantissa and 8 of exponent, as the extension defines them."""
    whole = np.round(POINTS * 1000).astype(np.int64)
    packed = ((np.uint32(-10 & 0xFF) << 24) | (whole & 0xFFFFFF).astype(np.uint32)).astype(np.uint32)
    got = read(meshopt_glb(points=packed.view(np.float32), change={"filter": "EXPONENTIAL"}))
    assert np.allclose(got.vertices, whole * 2.0**-10)


@pytest.mark.parametrize(
    "change",
    [
        {"byteStride": 16}, {"byteStride": 13}, {"byteStride": 0}, {"count": 401}, {"count": 3}, {"count": 49_000_000},
        {"mode": "MAGIC"}, {"filter": "COLOR"}, {"filter": "OCTAHEDRAL"}, {"buffer": 7}, {"byteLength": 5},
        {"byteOffset": 10**9}, {"count": -1},
    ],
)  # fmt: skip
def test_broken_meshopt_is_refused(change):
    with pytest.raises(FormatError, match=r"a\.glb"):
        read(meshopt_glb(change=change))


def test_draco_gives_the_same_vertices():
    joints = RNG.integers(0, 255, (400, 4)).astype(np.uint8)
    got = read(draco_glb(joints=joints))
    step = np.ptp(POINTS, axis=0).max() / (2**16 - 1)
    assert np.abs(got.vertices - POINTS).max() <= step  # half a step, and rounding
    assert np.array_equal(got.faces, FACES)
    document = got.source.document
    assert np.array_equal(document.accessor(2, ("VEC4",), raw=True), joints)
    assert "extensions" not in document.tree or "KHR_draco" not in str(document.tree["extensionsUsed"])


@pytest.mark.parametrize(
    "how",
    [
        {"change": {"attributes": {"POSITION": 99}}}, {"change": {"attributes": {"POSITION": "0"}}},
        {"change": {"attributes": None}}, {"change": {"bufferView": 5}}, {"counts": (399, FACES.size)},
        {"counts": (400, 6)}, {"counts": (49_000_000, FACES.size)}, {"data": b"DRACO"}, {"data": bytes(500)},
    ],
)  # fmt: skip
def test_broken_draco_is_refused(how):
    with pytest.raises(FormatError, match=r"a\.glb"):
        read(draco_glb(**how))


def test_damaged_draco_ends_in_one_sentence():
    """Whatever a flipped byte makes of it, the reader itself lives on."""
    packed = bytearray(draco.encode(POINTS, faces=FACES, quantization_bits=16, preserve_order=True))
    for position in (11, 12, 13, 14, 20, len(packed) // 2):
        changed = packed.copy()
        changed[position] ^= 0x7F
        try:
            got = read(draco_glb(data=bytes(changed)))
        except FormatError as error:
            assert "a.glb" in str(error)
        else:
            assert len(got.vertices) == 400


def test_the_extra_is_named(monkeypatch):
    import bunraku.files.gltf.open as module

    monkeypatch.setitem(sys.modules, "meshoptimizer", None)
    with pytest.raises(MissingExtraError, match=r"meshoptimizer.*bunraku\[compressed\]"):
        read(meshopt_glb())
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"DracoPy.*bunraku\[compressed\]"):
        read(draco_glb())


def test_a_packed_character_is_written_plain(tmp_path):
    """What is saved again needs no decoder."""
    import bunraku
    from bunraku.core.body.reference import reference_body

    body = reference_body()
    path = tmp_path / "person.glb"
    path.write_bytes(meshopt_glb(points=body.vertices, faces=body.faces.astype(np.uint32)))
    character = load_character(path)
    still = np.zeros((3, 30, 3))
    turns = np.broadcast_to(np.eye(3), (3, 30, 3, 3))
    motion = bunraku.HandleMotion(still, turns, np.zeros((3, 3)), turns[:, 0])
    out = bunraku.Animation(character, body.handles, motion).save(tmp_path / "out.glb")
    assert b"meshopt" not in out.read_bytes()
    again = load_character(out)
    assert len(clean_mesh(again.vertices, again.faces).vertices) == len(clean_mesh(body.vertices, body.faces).vertices)
    assert len(again.vertices) == len(character.vertices)
