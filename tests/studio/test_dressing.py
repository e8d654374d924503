"""Learned apparel in the studio: made, shown, kept, dressed anew, written."""

import json
import shutil
import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from bunraku import load_character
from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animation import Animation
from bunraku.core.point_animation import PointAnimation
from bunraku.core.rig_animation import RigAnimation
from bunraku.core.skinning import skin
from bunraku.errors import FormatError, OptionError
from bunraku.formats.gltf.read import read_gltf
from bunraku.geometry.rotations import matrix_from_quaternion
from bunraku.io import save_character
from bunraku.pipelines.animate import rig
from bunraku.pipelines.apply import apply_motion
from bunraku.pipelines.requests.apparel import Apparel
from bunraku.pipelines.requests.constraints import Constraints, Keep
from bunraku.pipelines.requests.request import Request, Sampling
from bunraku.samples import sample_character
from bunraku.studio.tasks.table import run_task
from bunraku.studio.workspace import dressing
from bunraku.studio.workspace.clips import (
    Dressed,
    load_take,
    packed_clip,
    save_handles,
    save_take,
    unpacked_apparel,
    unpacked_clip,
)
from bunraku.studio.workspace.dressing import check_fits, dressed_anew, found_apparel, has_apparel
from bunraku.studio.workspace.opened import Settings, opened_character
from bunraku.studio.workspace.workspace import Workspace
from bunraku_lab.evaluation.transfer.stock_motions import stock_motion
from bunraku_lab.synthetic.samples import make_sample
from bunraku_lab.synthetic.wardrobe import wardrobe_character

STUDIO = Path(__file__).resolve().parents[2] / "studio"


def quiet(stage, done):
    """Nobody listens."""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A character as the studio keeps it."""
    path = tmp_path_factory.mktemp("dressing") / "dragon.glb"
    save_character(make_sample("dragon", 0.4), path)
    return path


@pytest.fixture(scope="module")
def body(file):
    """A second of walking."""
    character, _ = opened_character(file, Settings())
    return apply_motion(stock_motion("walk", 1.0, 20.0), Anatomy.of(character, rig(character)))


@pytest.fixture(scope="module")
def waving(body):
    """The take with a third of its vertices waving in the world, as cloth of a network would."""
    moved = body.at(30.0)
    rest = moved.character.vertices
    loose = rest[:, 1] > np.quantile(rest[:, 1], 0.66)
    phase = np.arange(len(moved.motion))[:, None] / 5 + rest[:, 0]
    offsets = np.zeros((len(moved.motion), len(rest), 3), np.float32)
    offsets[..., 0], offsets[..., 2] = 0.05 * np.sin(phase) * loose, 0.03 * np.cos(2 * phase) * loose
    return Dressed(body, PointAnimation(moved, offsets), 2.0)


def test_the_mesh_the_tracks_and_the_apparel_make_the_animation(waving, tmp_path):
    """What the page does, by hand: the mesh's own skin after the displacements of apparel; `points.vertices()`."""
    character = waving.points.character
    save_character(character, tmp_path / "mesh.glb", waving.handles)
    mesh = read_gltf(tmp_path / "mesh.glb", (tmp_path / "mesh.glb").read_bytes())
    data = packed_clip(waving)
    fps, translations, rotations = unpacked_clip(data)
    assert fps == 30 and len(data) % 4 == 0
    parts = unpacked_apparel(data)
    document = mesh.source.document.tree["meshes"]
    assert {(m, p) for m, one in enumerate(document) for p in range(len(one["primitives"]))} == set(parts)
    turn = matrix_from_quaternion(rotations.astype(float))
    positions, weights = mesh.rig.positions, mesh.rig.dense_weights()
    worst = 0.0
    wanted = waving.points.vertices()
    for frame in (0, 11, len(wanted) - 1):
        rest = np.array(mesh.vertices, float)
        at = 0
        for number, one in enumerate(document):  # one group of vertices a primitive in this file
            for primitive, entry in enumerate(one["primitives"]):
                rows, moves = parts[number, primitive]
                count = mesh.source.document.tree["accessors"][entry["attributes"]["POSITION"]]["count"]
                raw = np.zeros((count, 3))
                raw[rows] = moves[frame]
                index = mesh.source.index[at : at + count]
                rest[index] = np.array(mesh.vertices, float)[index] + raw
                at += count
        root = np.zeros((1, translations.shape[1], 3, 4))
        for joint in range(translations.shape[1]):
            a, b = turn[frame, joint], translations[frame, joint].astype(float)
            if joint:
                a, b = turn[frame, 0] @ a, turn[frame, 0] @ b + translations[frame, 0]
            root[0, joint, :, :3], root[0, joint, :, 3] = a, b - a @ positions[joint].astype(float)
        posed = skin(rest.astype(np.float32), weights, root.astype(np.float32))[0]
        worst = max(worst, float(np.abs(posed - wanted[frame]).max()))
    assert np.abs(waving.points.offsets).max() > 0.04
    assert worst * 1.7 / character.height < 1e-4  # 0.1 mm at human size


@pytest.fixture(scope="module")
def positions(tmp_path_factory):
    """The page's own code, packed so that node runs it without a browser."""
    if shutil.which("node") is None or not (STUDIO / "node_modules" / ".bin" / "rolldown").exists():
        pytest.skip("the page's tools are not installed: make studio")
    out = tmp_path_factory.mktemp("positions") / "places.mjs"
    packer = ["node_modules/.bin/rolldown", str(Path(__file__).with_name("places.ts")), "--platform", "node"]
    subprocess.run([*packer, "--format", "esm", "-o", str(out)], cwd=STUDIO, check=True, capture_output=True)
    return out


@pytest.mark.parametrize("kind", ["body", "apparel"])
def test_the_pages_own_code_puts_the_mesh_where_the_library_has_it(body, waving, positions, tmp_path, kind):
    take = waving if kind == "apparel" else body
    shown = waving.points if kind == "apparel" else body
    save_character(shown.character, tmp_path / "mesh.glb", shown.handles)
    (tmp_path / "clip.bin").write_bytes(packed_clip(take))
    frames = [0, 7, len(shown.motion) - 1]
    times = [str(frame / shown.fps) for frame in frames]
    told = subprocess.run(
        ["node", str(positions), str(tmp_path / "mesh.glb"), str(tmp_path / "clip.bin"), *times],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    for found, wanted in zip(json.loads(told.stdout), shown.vertices(frames), strict=True):
        off, _ = cKDTree(wanted).query(np.array(found))
        back, _ = cKDTree(np.array(found)).query(wanted)
        worst = max(off.max(), back.max()) * 1.7 / shown.character.height
        print(f"{kind}: {1000 * worst:.4f} mm")
        assert worst < 1e-4  # 0.1 mm at human size


def test_a_dressed_take_comes_back(waving, tmp_path):
    path = tmp_path / "motion.npz"
    save_take(waving, path)
    back = load_take(path, waving.body.character, waving.body.handles)
    assert isinstance(back, Dressed) and back.stiffness == 2.0 and isinstance(back.body, Animation)
    np.testing.assert_allclose(back.points.vertices([3]), waving.points.vertices([3]), atol=1e-5)
    with np.load(tmp_path / "apparel.npz") as arrays:
        held = dict(arrays)
    np.savez(tmp_path / "apparel.npz", **{**held, "vertices": held["vertices"] + 10**6})
    with pytest.raises(FormatError, match="another mesh"):
        load_take(path, waving.body.character, waving.body.handles)


def test_a_dressed_take_of_bones_comes_back_with_what_it_was_fitted_from(tmp_path):
    character = wardrobe_character(3)
    count = len(character.rig.names)
    turns = np.tile(np.eye(3, dtype=np.float32), (30, count, 1, 1))
    still = RigAnimation(character, turns, np.zeros((30, count, 3)), 30.0, stock_motion("walk", 1.0, 20.0))
    offsets = np.zeros((30, len(character.vertices), 3), np.float32)
    offsets[5, 7] = 0.25
    take = Dressed(still, PointAnimation(still.animation(), offsets), 0.5)
    save_take(take, tmp_path / "motion.npz")
    back = load_take(tmp_path / "motion.npz", character, rig(character))
    assert isinstance(back.body, RigAnimation) and len(back.body.reference) == 20
    np.testing.assert_allclose(back.points.offsets, offsets)
    data = packed_clip(back)
    header = json.loads(data[8 : 8 + struct.unpack("<I", data[4:8])[0]])
    assert header["root"] > 0  # the first joint of bones stands still, and no camera follows it


def test_what_is_worn_is_found(file):
    dragon, _ = opened_character(file, Settings())
    assert has_apparel(found_apparel(dragon, rig(dragon)))
    girl = wardrobe_character(3)
    assert has_apparel(found_apparel(girl, rig(girl)))
    bare = replace(girl, rig=None, source=None)  # neither physics nor a network that could look
    handles = rig(bare)
    weights = np.ones((len(bare.vertices), 9)) / 9
    few = replace(handles, positions=handles.positions[:9], weights=weights, features=None, roles=None)
    assert found_apparel(bare, few) is None


def test_too_many_places_are_refused_before_the_work(monkeypatch):
    dragon = sample_character("dragon")
    monkeypatch.setattr(dressing, "MOST_PLACES", 100_000)
    with pytest.raises(OptionError, match="take at most 0.4"):
        check_fits(Apparel("learn"), dragon, 4.0)
    check_fits(Apparel("learn"), dragon, 0.2)
    check_fits(Apparel("rigid"), dragon, 120.0)


def test_a_take_is_dressed_anew_and_its_motion_stays(body):
    soft = dressed_anew(body, Apparel("learn", 0.05), body.handles, report=quiet)
    stiff = dressed_anew(soft, Apparel("learn", 20.0), body.handles, report=quiet)
    assert soft.body is body and stiff.body is body and (soft.stiffness, stiff.stiffness) == (0.05, 20.0)
    away = [np.abs(one.points.offsets).max(axis=-1).max(axis=0) for one in (soft, stiff)]
    assert np.abs(soft.points.offsets - stiff.points.offsets).max() > 1e-3 and away[0].max() > 0.01
    assert dressed_anew(stiff, Apparel("rigid"), body.handles, report=quiet) is body
    girl = wardrobe_character(3)
    count = len(girl.rig.names)
    bones = RigAnimation(girl, np.tile(np.eye(3), (2, count, 1, 1)), np.zeros((2, count, 3)))
    with pytest.raises(OptionError, match="drop that file again"):
        dressed_anew(bones, Apparel("rigid"), body.handles, report=quiet)


def test_the_worker_makes_and_dresses_and_writes(file, tmp_path):
    """The tasks of the worker in this process: a sentence with learned apparel, dressed anew, as files."""
    position = tmp_path / "characters" / "one"
    (position / "source").mkdir(parents=True)
    (position / "source" / "dragon.glb").write_bytes(file.read_bytes())
    for name in ("a", "b", "c"):
        (tmp_path / "takes" / name).mkdir(parents=True)
    (tmp_path / "exports" / "e").mkdir(parents=True)
    settings = {"up": "auto", "front": "auto", "unit": "auto", "handles": "predict"}
    record = {"name": "dragon", "file": "source/dragon.glb", "settings": settings}
    (position / "record.json").write_text(json.dumps(record))
    workspace = Workspace(str(tmp_path))
    told = []
    asked = Request("walks:1", Sampling(1.0, steps=2, candidates=1), apparel=Apparel("learn", 0.2))
    params = {"character": "one", "takes": ["a"], "seeds": [0], "request": asked.to_json()}
    run_task(workspace, "open", {"character": "one", "file": record["file"], "settings": settings}, quiet, told.append)
    run_task(workspace, "animate", params, quiet, told.append)
    draft, done = told
    assert (draft["clip"], draft["fps"], draft["stiffness"]) == ("draft.bin", 20.0, None)
    assert (done["fps"], done["frames"], done["skin"]) == (30.0, 29, "handles") and done["stiffness"] == 0.2
    first = workspace.take("a", "one")
    assert not unpacked_apparel((tmp_path / "takes/a/draft.bin").read_bytes())
    dress = {"character": "one", "takes": ["b"], "parent": "a", "apparel": "learn", "stiffness": 5.0}
    run_task(workspace, "dress", dress, quiet, told.append)
    second = workspace.take("b", "one")
    np.testing.assert_array_equal(first.body.motion.rotations, second.body.motion.rotations)
    assert told[-1]["stiffness"] == 5.0 and np.abs(first.points.offsets - second.points.offsets).max() > 1e-4
    asked = Request("waves", Sampling(steps=2, candidates=1), Constraints([Keep(("legs",))]), Apparel("learn", 5.0))
    edit = {**params, "takes": ["c"], "parent": "b", "request": asked.to_json()}
    run_task(workspace, "edit", edit, quiet, told.append)
    assert isinstance(workspace.take("c", "one"), Dressed)
    for suffix in ("glb", "bvh"):
        export = {"export": "e", "file": f"take.{suffix}", "take": "b", "character": "one", "fps": 30}
        run_task(workspace, "export", export, quiet, told.append)
    assert (tmp_path / "exports/e/take.bvh").read_bytes().startswith(b"HIERARCHY")
    glb = tmp_path / "exports/e/take.glb"
    written = read_gltf(glb, glb.read_bytes()).source.document.tree["meshes"]
    assert any("targets" in primitive for mesh in written for primitive in mesh["primitives"])
    save_handles(second.body.handles, tmp_path / "again.npz")
    assert load_character(glb).height == pytest.approx(second.points.character.height, rel=1e-4)
