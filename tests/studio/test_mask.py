"""What of a character is hair and clothes: shown, painted, kept, used by takes on chains."""

import json
import struct

import numpy as np
import pytest

from bunraku.apparel.artist_mask import artist_mask
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import FormatError, OptionError
from bunraku.formats.gltf.read import read_gltf
from bunraku.io import load_character, save_character
from bunraku.studio.tasks.table import run_task
from bunraku.studio.workspace.clips import Dressed, load_take
from bunraku.studio.workspace.mask import (
    WORN,
    clean_mask,
    found_mask,
    packed_bits,
    paint,
    painted_file,
    save_worn,
    shown_mask,
)
from bunraku.studio.workspace.workspace import Workspace
from bunraku_lab.synthetic.samples import make_sample


def parts_of(data):
    """Bits of `save_worn`, and the vertices of each primitive."""
    length = struct.unpack("<I", data[4:8])[0]
    header = json.loads(data[8 : 8 + length])
    at = 8 + length + len(packed_bits(np.zeros(header["vertices"], bool)))
    bits = np.unpackbits(np.frombuffer(data[8 + length : at], np.uint8), count=header["vertices"], bitorder="little")
    rows = {}
    for part in header["parts"]:
        rows[part["mesh"], part["primitive"]] = np.frombuffer(data, "<u4", part["rows"], at)
        at += 4 * part["rows"]
    assert at == len(data)
    return bits.astype(bool), rows


def test_rows_of_the_page_are_vertices_of_the_character(tmp_path):
    save_character(make_sample("dancer", 0.3), tmp_path / "dancer.glb")
    character = load_character(tmp_path / "dancer.glb")
    found = character.vertices[:, 1] > 0.5
    save_worn(character, found, tmp_path / WORN)
    bits, rows = parts_of((tmp_path / WORN).read_bytes())
    np.testing.assert_array_equal(bits, found)
    save_character(character, tmp_path / "mesh.glb")
    document = read_gltf(tmp_path / "mesh.glb", (tmp_path / "mesh.glb").read_bytes()).source.document
    drawn = {
        (mesh, primitive): document.accessor(entry["attributes"]["POSITION"], ("VEC3",))
        for mesh, one in enumerate(document.tree["meshes"])
        for primitive, entry in enumerate(one["primitives"])
    }
    assert set(drawn) == set(rows)
    for key, places in drawn.items():
        np.testing.assert_allclose(character.vertices[rows[key]], places, atol=1e-6)


def test_a_painted_mask_stands_in_for_what_was_found(tmp_path):
    save_character(make_sample("mushroom", 0.3), tmp_path / "mushroom.glb")
    character = load_character(tmp_path / "mushroom.glb")
    save_worn(character, None, tmp_path / WORN)
    painted = painted_file(tmp_path / "mushroom.glb")
    assert not parts_of(shown_mask(tmp_path / WORN, painted))[0].any()
    mask = np.arange(len(character.vertices)) % 3 == 0
    paint(clean_mask(tmp_path / WORN, packed_bits(mask)), painted)
    np.testing.assert_array_equal(parts_of(shown_mask(tmp_path / WORN, painted))[0], mask)
    np.testing.assert_array_equal(artist_mask(character), mask)  # what all that moves apparel goes by
    with pytest.raises(OptionError, match="no mask of"):
        clean_mask(tmp_path / WORN, b"1234")
    paint(mask[:5], painted)
    with pytest.raises(FormatError, match="paint it again"):
        shown_mask(tmp_path / WORN, painted)
    for broken in (b"", b"BNRM\xff\xff\xff\xff{}", b"BNRM\x04\x00\x00\x00null", b"BNRM\x02\x00\x00\x00{}"):
        (tmp_path / WORN).write_bytes(broken)
        with pytest.raises(FormatError):
            shown_mask(tmp_path / WORN, painted)


def test_a_page_paints_and_takes_it_back(client, ready):
    state = client.app.state.studio
    folder = state.store.folder_of("characters", ready)
    (folder / "source").mkdir()
    save_character(make_sample("mushroom", 0.3), folder / "source" / "one.glb")
    path = f"/api/characters/{ready}/mask"
    assert client.get(path).status_code == 404  # it is not looked at yet
    character = load_character(folder / "source" / "one.glb")
    save_worn(character, None, folder / WORN)
    mask = character.vertices[:, 1] > 0.5
    answer = client.put(path, content=packed_bits(mask))
    assert answer.status_code == 200 and answer.json()["painted"] and answer.json()["apparel"]
    np.testing.assert_array_equal(parts_of(client.get(path).content)[0], mask)
    assert [job["kind"] for job in state.jobs.all()] == ["lay-chains"]
    client.put(path, content=packed_bits(~mask))
    assert len(state.jobs.all()) == 1  # one that waits does for both
    assert client.put(path, content=b"12").status_code == 400
    assert client.put(path, content=bytes(2 << 20)).status_code == 413
    assert not client.delete(path).json()["painted"]
    assert not parts_of(client.get(path).content)[0].any()


def test_a_painted_skirt_swings_on_chains(tmp_path):
    """The tasks of the worker in this process: a mask that is painted, chains over it, a take on them, its files."""
    folder = tmp_path / "characters" / "one"
    (folder / "source").mkdir(parents=True)
    save_character(make_sample("dancer", 0.3), folder / "source" / "dancer.glb")
    for name in ("takes/a", "takes/b", "exports/e"):
        (tmp_path / name).mkdir(parents=True)
    settings = {"up": "auto", "front": "auto", "unit": "auto", "handles": "predict"}
    record = {"name": "dancer", "file": "source/dancer.glb", "settings": settings}
    (folder / "record.json").write_text(json.dumps(record))
    shop, told = Workspace(str(tmp_path)), []

    def run(task, **params):
        return run_task(shop, task, {"character": "one", **params}, lambda stage, done: None, told.append)

    run("open", file=record["file"], settings=settings)
    run("find-out")
    found = found_mask(folder / WORN)
    assert found.any()
    nothing = np.zeros(len(shop.character("one")[0].vertices), bool)
    paint(nothing, painted_file(folder / "source" / "dancer.glb"))
    assert run("lay-chains")["chains"] == [] and not (folder / "chains.glb").exists()
    low = shop.character("one")[0].vertices
    skirt = (low[:, 1] > 0.42) & (low[:, 1] < 0.85) & (np.abs(low[:, [0, 2]]).max(axis=1) > 0.12)
    paint(skirt, painted_file(folder / "source" / "dancer.glb"))
    laid = run("lay-chains")
    assert laid["chains"] and {chain["kind"] for chain in laid["chains"]} <= {"skirt", "ribbon", "cape"}
    springs = read_gltf(folder / "chains.glb", (folder / "chains.glb").read_bytes()).source.document.tree["extras"]
    assert len(springs["springs"]["springs"]) == len(laid["chains"])
    assert run("find-out")["painted"]
    np.testing.assert_array_equal(found_mask(folder / WORN), found)  # what is painted is not what was found
    run(
        "play", takes=["a"], seeds=[0], pieces=[{"seconds": 1.0, "clip": "walk-catwalk"}], apparel="chains", gravity=2.0
    )
    assert (told[-1]["worn"], told[-1]["gravity"], told[-1]["stiffness"]) == ("chains", 2.0, 1.0)
    take = shop.take("a", "one")
    assert isinstance(take, Dressed) and isinstance(take.bones, RigAnimation) and take.motion == "chains"
    moved = np.abs(take.points.offsets).max(axis=(0, 2))
    assert moved[skirt].max() > 0.005 and moved[low[:, 1] > 1.2].max(initial=0) < 1e-3
    np.testing.assert_allclose(take.points.vertices([7]), take.bones.vertices()[7:8], atol=2e-4)
    run("export", export="e", file="take.glb", take="a", fps=30)
    written = load_character(tmp_path / "exports/e/take.glb").rig.names
    assert {f"{chain['name']}_1" for chain in laid["chains"]} <= set(written)
    with np.load(tmp_path / "takes/a/apparel.npz") as arrays:
        held = dict(arrays)
    np.savez(tmp_path / "takes/a/apparel.npz", **{**held, "rig_parents": held["rig_parents"][:3]})
    with pytest.raises(FormatError, match="no chains"):
        load_take(tmp_path / "takes/a/motion.npz", *shop.character("one"))
