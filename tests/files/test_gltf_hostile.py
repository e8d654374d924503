"""Small glTF files that promise much: none takes more than four times its size and 300 MB, none ten seconds."""

import io
import json
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from gltf_files import CUBE, Maker, cube_glb
from PIL import Image

from bunraku.files import load_character
from bunraku.files.gltf.open import open_document

LOADS = """
import os, resource, sys
from bunraku.errors import BunrakuError
from bunraku.files import load_character
from bunraku.apparel.physics.rig import apparel_rig
def load(path):
    before = resource.getrusage(resource.RUSAGE_SELF)
    try:
        said = str(len(load_character(path).vertices))
        if path.endswith(".vrm"):
            rig = apparel_rig(load_character(path))
            said += f" {len(rig.bodies)} bodies"
    except BunrakuError as error:
        said = str(error)
    after = resource.getrusage(resource.RUSAGE_SELF)
    peak = open("/proc/self/status").read().split("VmHWM:")[1].split()[0]  # ru_maxrss would be the parent's
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(int(peak) * 1024, seconds, " ".join(said.split()), flush=True)
for line in sys.stdin:
    if os.fork() == 0:
        load(line.removesuffix("\\n"))
        os._exit(0)
    if os.wait()[1]:
        print(0, 0, "crashed", flush=True)
"""


def cube(maker):
    return maker.cube(np.uint16)


def text(tree):
    return json.dumps({"asset": {"version": "2.0"}, **tree}).encode()


def one_buffer_often(folder, names):
    (folder / "big.bin").write_bytes(bytes(4 << 20))
    return text({"buffers": [{"uri": name, "byteLength": (4 << 20) - index} for index, name in enumerate(names)]})


def one_image_often(folder):
    (folder / "big.png").write_bytes(bytes(4 << 20))
    return text({"images": [{"uri": "big.png"}] * 3000})


def promised_vertices(folder):
    accessor = {"count": 20_000_000, "type": "VEC3", "componentType": 5126}
    mesh = {"primitives": [{"attributes": {"POSITION": 0}}]}
    return text({"scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "accessors": [accessor], "meshes": [mesh]})


def placed_often(folder):
    maker = Maker()
    grid = np.random.default_rng(0).random((90_000, 3)).astype(np.float32)
    mesh = {"primitives": [{"attributes": {"POSITION": maker.add(grid)}}]}
    return maker.glb(scenes=[{"nodes": list(range(200))}], nodes=[{"mesh": 0}] * 200, meshes=[mesh])


def nodes_with_meshes(folder):
    maker = Maker()
    mesh = {"primitives": [cube(maker)]}
    return maker.glb(scenes=[{"nodes": list(range(16000))}], nodes=[{"mesh": 0}] * 16000, meshes=[mesh])


def joints_below_a_long_chain(folder):
    maker = Maker()
    nodes = [{"children": [node + 1]} for node in range(7999)]
    nodes += [{"children": list(range(8000, 16000))}] + [{"mesh": 0}] * 8000
    skins = [{"joints": list(range(8000, 16000))}]
    return maker.glb(scenes=[{"nodes": [0]}], nodes=nodes, skins=skins, meshes=[{"primitives": [cube(maker)]}])


def a_skin_for_each_mesh(folder):
    maker = Maker()
    nodes = [{"children": list(range(1, 8001))}] + [{"mesh": 0, "skin": skin} for skin in range(8000)] + [{}] * 8000
    skins = [{"joints": [8001 + skin]} for skin in range(8000)]
    return maker.glb(scenes=[{"nodes": [0]}], nodes=nodes, skins=skins, meshes=[{"primitives": [cube(maker)]}])


def many_meshes_of_a_large_skin(folder):
    maker = Maker()
    nodes = [{"mesh": 0, "skin": 0}] * 10_000 + [{}] * 30_000
    skins = [{"joints": list(range(10_000, 40_000))}]
    meshes = [{"primitives": [cube(maker)]}]
    return maker.glb(scenes=[{"nodes": list(range(10_000))}], nodes=nodes, skins=skins, meshes=meshes)


def skins_of_the_same_joints(folder):
    maker = Maker()
    skins = [{"joints": list(range(1, 1001))}] * 1000
    nodes = [{"mesh": 0, "skin": 0}] + [{}] * 1000
    return maker.glb(scenes=[{"nodes": [0]}], nodes=nodes, skins=skins, meshes=[{"primitives": [cube(maker)]}])


def morph_targets(folder):
    maker = Maker()
    position = maker.add(np.random.default_rng(0).random((50_000, 3)).astype(np.float32))
    primitive = {"attributes": {"POSITION": position}, "targets": [{"POSITION": position}] * 20_000}
    return maker.glb(nodes=[{"mesh": 0, "weights": [0.001] * 20_000}], meshes=[{"primitives": [primitive]}])


def colours_of_shared_vertices(folder):
    maker = Maker()
    count = 90_000
    position = maker.add(np.random.default_rng(0).random((count, 3)).astype(np.float32))
    shade = maker.add(np.zeros((count, 4), np.uint8), normalized=True)
    primitive = {
        "attributes": {"POSITION": position, "COLOR_0": shade},
        "indices": maker.add(np.arange(3, dtype=np.uint8)),
    }
    return maker.glb(nodes=[{"mesh": 0}], meshes=[{"primitives": [primitive] * 4000}])


def skins_of_shared_vertices(folder):
    maker = Maker()
    count = 90_000
    position = maker.add(np.random.default_rng(0).random((count, 3)).astype(np.float32))
    joints, weights = maker.add(np.zeros((count, 4), np.uint8)), maker.add(np.ones((count, 4), np.float32))
    indices = maker.add(np.arange(3, dtype=np.uint8))
    again = len(maker.accessors)
    maker.accessors += [dict(maker.accessors[joints]) for _ in range(1000)]
    primitives = [
        {"attributes": {"POSITION": position, "JOINTS_0": again + number, "WEIGHTS_0": weights}, "indices": indices}
        for number in range(1000)
    ]
    nodes = [{"mesh": 0, "skin": 0}, {}]
    return maker.glb(
        scenes=[{"nodes": [0, 1]}], nodes=nodes, skins=[{"joints": [1]}], meshes=[{"primitives": primitives}]
    )


def picture(size, mode, kind, **options):
    out = io.BytesIO()
    Image.new(mode, size).save(out, kind, **options)
    return out.getvalue()


def with_images(data, count, copies):
    """A cube with an image in each of its materials, all of the same view or of one each."""
    maker = Maker()
    views = [maker.view(data) for _ in range(copies)]
    first = cube(maker)
    first["attributes"]["TEXCOORD_0"] = maker.add(CUBE[:, :2].copy())
    return maker.glb(
        nodes=[{"mesh": 0}],
        images=[{"bufferView": views[number % copies]} for number in range(count)],
        textures=[{"source": number} for number in range(count)],
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": number}}} for number in range(count)],
        meshes=[{"primitives": [{**first, "material": number} for number in range(count)]}],
    )


def lists_of_nothing(folder):
    return b'{"asset":{"version":"2.0"},"extras":[' + b"{}," * 3_000_000 + b"{}]}"


def springs(version, count=300):
    def make(folder):
        maker = Maker()
        bones = 3000
        nodes = [{"mesh": 0, "skin": 0}]
        nodes += [{"children": [bone + 1], "translation": [0, 0.01, 0]} for bone in range(1, bones)] + [{}]
        if version == 0:
            extensions = {"VRM": {"secondaryAnimation": {"boneGroups": [{"bones": [1 + n]} for n in range(300)]}}}
        else:
            chain = [{"node": bone} for bone in range(1, bones + 1)]
            extensions = {"VRMC_vrm": {}, "VRMC_springBone": {"springs": [{"joints": chain}] * count}}
        return maker.glb(
            scenes=[{"nodes": [0, 1]}],
            nodes=nodes,
            skins=[{"joints": list(range(1, bones + 1))}],
            meshes=[{"primitives": [cube(maker)]}],
            extensions=extensions,
        )

    return make


CASES = {
    "buffer.gltf": lambda folder: one_buffer_often(folder, ["big.bin"] * 3000),
    "buffer by many names.gltf": lambda folder: one_buffer_often(
        folder, ["./" * (n % 9) + "big.bin" for n in range(3000)]
    ),
    "image.gltf": one_image_often,
    "promise.gltf": promised_vertices,
    "placed.glb": placed_often,
    "nodes.glb": nodes_with_meshes,
    "empty nodes.gltf": lambda folder: text({"scenes": [{"nodes": [0]}], "nodes": [{}] * 90_000}),
    "chain.glb": joints_below_a_long_chain,
    "skins.glb": a_skin_for_each_mesh,
    "skin.glb": many_meshes_of_a_large_skin,
    "same joints.glb": skins_of_the_same_joints,
    "morphs.glb": morph_targets,
    "colours.glb": colours_of_shared_vertices,
    "weights.glb": skins_of_shared_vertices,
    "large image.glb": lambda folder: with_images(picture((8300, 8300), "RGBA", "PNG"), 1, 1),
    "same image.glb": lambda folder: with_images(picture((5000, 4000), "RGBA", "PNG"), 200, 1),
    "progressive.glb": lambda folder: with_images(picture((5000, 4000), "RGB", "JPEG", progressive=True), 8, 8),
    "lists.gltf": lists_of_nothing,
    "springs 0.vrm": springs(0),
    "springs 1.vrm": springs(1),
}


@pytest.fixture(scope="module")
def loads():
    """Load a file in a process of its own, a copy of one that has imported all: peak memory [bytes], time [s] and what
    is said.
    """
    with subprocess.Popen(
        [sys.executable, "-c", LOADS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:

        def load(path):
            process.stdin.write(f"{path}\n")
            process.stdin.flush()
            memory, seconds, said = process.stdout.readline().split(" ", 2)
            assert said != "crashed\n"
            return int(memory), float(seconds), said

        yield load
        process.stdin.close()


@pytest.mark.parametrize("name", CASES)
def test_a_small_file_takes_little_memory_and_time(tmp_path, loads, name):
    path = tmp_path / name
    path.write_bytes(CASES[name](tmp_path))
    size = sum(file.stat().st_size for file in tmp_path.iterdir())
    memory, seconds, said = loads(path)
    assert memory <= 4 * size + 300e6, said
    assert seconds <= 10, said


def test_what_many_name_is_read_once(tmp_path):
    (tmp_path / "one.bin").write_bytes(bytes(range(100)))
    tree = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": uri, "byteLength": 90} for uri in ("one.bin", "./one.bin")],
    }
    document = open_document(Path(tmp_path / "thing.gltf"), json.dumps(tree).encode())
    assert [bytes(buffer) for buffer in document.buffers] == [bytes(range(90))] * 2
    assert np.shares_memory(*(np.frombuffer(buffer, np.uint8) for buffer in document.buffers))


def test_a_character_can_be_pickled(tmp_path):
    (tmp_path / "cube.glb").write_bytes(cube_glb())
    character = load_character(tmp_path / "cube.glb")
    again = pickle.loads(pickle.dumps(character)).source.document
    assert bytes(again.view(0)) == bytes(character.source.document.view(0)) == CUBE.tobytes()


def test_a_long_spring_is_cut_and_says_so(tmp_path, caplog):
    path = tmp_path / "long.vrm"
    path.write_bytes(springs(1, 1)(tmp_path))
    from bunraku.apparel.physics.rig import apparel_rig

    assert (
        len(apparel_rig(load_character(path)).bodies) == 300
    )  # a holder and 299 joints that swing: the last is a tail
    assert "longer than 300 joints" in caplog.text
