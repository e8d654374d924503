"""Dressing in the studio: the mask and the springs."""

import json
import shutil
import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from packed import unpacked_apparel, unpacked_clip
from scipy.spatial import cKDTree

from bunraku import load_character
from bunraku.anatomy.anatomy import Anatomy
from bunraku.apparel.chains.avatars import between_frames, link_turns, vrm_steps
from bunraku.apparel.mask import artist_mask
from bunraku.core.animation import Animation, PointAnimation, RigAnimation
from bunraku.core.avatars import VrmModel, VrmSpring, VrmSpringJoint
from bunraku.core.character import Character, Rig
from bunraku.core.geometry.rotations import matrix_from_axis_angle, matrix_from_quaternion, quaternion_from_matrix
from bunraku.core.skinning import skin
from bunraku.errors import FormatError, OptionError
from bunraku.files import save_character
from bunraku.files.gltf.read import read_gltf
from bunraku.pipelines.animate import rig
from bunraku.pipelines.apply import apply_motion
from bunraku.pipelines.requests import Apparel, Constraints, Keep, Request, Sampling
from bunraku.studio.dressing import (
    WORN,
    apparel_mask_of,
    clean_mask,
    found_mask,
    has_apparel,
    packed_bits,
    paint,
    painted_file,
    redress_take,
    save_worn,
    shown_mask,
)
from bunraku.studio.tasks import run_task
from bunraku.studio.wire import Dressed, load_take, packed_clip, save_handles, save_take
from bunraku.studio.workspace import Settings, Workspace, opened_character
from bunraku_lab.synthetic.samples import make_sample
from bunraku_lab.synthetic.stock_motions import stock_motion
from bunraku_lab.synthetic.wardrobe import wardrobe_character

STUDIO = Path(__file__).resolve().parents[2] / "studio"


def quiet(stage, done):
    """Nobody listens."""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A character as the studio keeps it."""
    path = tmp_path_factory.mktemp("dressing") / "dancer.glb"
    save_character(make_sample("dancer", 0.5), path)
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
    dancer, _ = opened_character(file, Settings())
    girl = wardrobe_character(3)
    assert has_apparel(apparel_mask_of(dancer)) and has_apparel(apparel_mask_of(girl))
    assert has_apparel(apparel_mask_of(replace(girl, rig=None, source=None)))  # by the network


def test_a_take_is_dressed_anew_and_its_motion_stays(body):
    soft = redress_take(body, Apparel("learn", 0.05), body.handles, report=quiet)
    stiff = redress_take(soft, Apparel("learn", 20.0), body.handles, report=quiet)
    assert soft.body is body and stiff.body is body and (soft.stiffness, stiff.stiffness) == (0.05, 20.0)
    away = [np.abs(one.points.offsets).max(axis=-1).max(axis=0) for one in (soft, stiff)]
    assert np.abs(soft.points.offsets - stiff.points.offsets).max() > 1e-3 and away[0].max() > 0.01
    assert redress_take(stiff, Apparel("rigid"), body.handles, report=quiet) is body
    girl = wardrobe_character(3)
    count = len(girl.rig.names)
    bones = RigAnimation(girl, np.tile(np.eye(3), (2, count, 1, 1)), np.zeros((2, count, 3)))
    with pytest.raises(OptionError, match="drop that file again"):
        redress_take(bones, Apparel("rigid"), body.handles, report=quiet)


def test_the_worker_makes_and_dresses_and_writes(file, tmp_path):
    """The tasks of the worker in this process: a sentence with learned apparel, dressed anew, as files."""
    position = tmp_path / "characters" / "one"
    (position / "source").mkdir(parents=True)
    (position / "source" / "dancer.glb").write_bytes(file.read_bytes())
    for name in ("a", "b", "c"):
        (tmp_path / "takes" / name).mkdir(parents=True)
    (tmp_path / "exports" / "e").mkdir(parents=True)
    settings = {"up": "auto", "front": "auto", "unit": "auto", "handles": "predict"}
    record = {"name": "dancer", "file": "source/dancer.glb", "settings": settings}
    (position / "record.json").write_text(json.dumps(record))
    workspace = Workspace(str(tmp_path))
    told = []
    asked = Request("walks:1", Sampling(1.0, steps=2, candidates=1), apparel=Apparel("learn", 0.2))
    params = {"character": "one", "takes": ["a"], "seeds": [0], "request": asked.to_json()}
    run_task(workspace, "open", {"character": "one", "file": record["file"], "settings": settings}, quiet, told.append)
    dropped = (position / record["file"]).rename(tmp_path / "away.glb")  # what was opened is not read again
    run_task(workspace, "animate", params, quiet, told.append)
    dropped.rename(position / record["file"])
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
    assert at + (2 * header["vertices"] if header["numbered"] else 0) == len(data)
    return bits.astype(bool), rows


def test_rows_of_the_page_are_vertices_of_the_character(tmp_path):
    save_character(make_sample("dancer", 0.3), tmp_path / "dancer.glb")
    character = load_character(tmp_path / "dancer.glb")
    found = character.vertices[:, 1] > 0.5
    numbers = np.where(found, 2, -1)
    save_worn(character, found, tmp_path / WORN, numbers)
    bits, rows = parts_of((tmp_path / WORN).read_bytes())
    np.testing.assert_array_equal(bits, found)
    written = np.frombuffer((tmp_path / WORN).read_bytes()[-2 * len(found) :], "<u2")
    np.testing.assert_array_equal(written, numbers + 1)
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
    with pytest.raises(OptionError, match="not a mask of"):
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

    opened = run("open", file=record["file"], settings=settings)["body"]
    knee = next(joint["point"] for joint in opened["joints"] if joint["name"] == "left_knee")
    lower = [knee[0], round(knee[1] - 0.05, 4), knee[2]]
    (folder / "source" / "dancer.body.toml").write_text(f"[joints]\nleft_knee = {lower}\n")
    again = run("open", file=record["file"], settings=settings, again=True)["body"]
    assert next(joint["point"] for joint in again["joints"] if joint["name"] == "left_knee") == lower
    assert again["said"]["joints"] == {"left_knee": lower} and "body" in {part["kind"] for part in again["parts"]}
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


DOWN = np.array([0.0, -1, 0])


@pytest.fixture(scope="module")
def swung(tmp_path_factory):
    """Where the page's springs take bones: of a rod of four links and its poses."""
    if shutil.which("node") is None or not (STUDIO / "node_modules" / ".bin" / "rolldown").exists():
        pytest.skip("the page's tools are not installed: make studio")
    folder = tmp_path_factory.mktemp("springs")
    script = folder / "springs.mjs"
    packer = ["node_modules/.bin/rolldown", str(Path(__file__).with_name("springs.ts")), "--platform", "node"]
    subprocess.run([*packer, "--format", "esm", "-o", str(script)], cwd=STUDIO, check=True, capture_output=True)

    def run(spring, turns, places, colliders=()):
        avatar = VrmModel(
            "1.0", "rod", {}, (spring,), tuple(colliders), (tuple(range(len(colliders))),) * bool(colliders)
        )
        save_character(rod(), folder / "rod.glb", rig=True, avatar=avatar)
        poses = [
            {"turn": turn.tolist(), "place": place.tolist()}
            for turn, place in zip(quaternion_from_matrix(turns), places, strict=True)
        ]
        (folder / "poses.json").write_text(json.dumps(poses))
        words = ["node", str(script), str(folder / "rod.glb"), str(folder / "poses.json")]
        return np.array(json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout))

    return run


def rod():
    """A holder at the origin, three links that hang from it, and their end."""
    places = np.array([[0.0, 1.5, 0], [0.1, 1.5, 0], [0.15, 1.35, 0.05], [0.15, 1.2, 0.02], [0.2, 1.1, 0]])
    transforms = np.tile(np.eye(4), (5, 1, 1))
    transforms[:, :3, 3] = places
    vertices = np.concatenate([places, places + [0.0, 0, 0.02], places + [0.02, 0, 0]]).astype(np.float32)
    faces = np.array([[bone, bone + 5, bone + 10] for bone in range(5)])
    rig = Rig(tuple("abcde"), np.arange(-1, 4), transforms, np.tile(np.arange(5), 3)[:, None], np.ones((15, 1)))
    return Character("rod", vertices, faces, rig)


def swaying(frames=240):
    time = np.arange(frames) / 60
    angles = np.stack([0.3 * np.sin(5 * time), 0.8 * np.sin(2.2 * time), 0.1 * np.sin(7 * time)], axis=1)
    places = np.array([0.0, 1.5, 0]) + np.stack([0.2 * np.sin(3 * time), 0 * time, 0.1 * np.sin(4 * time)], axis=1)
    return matrix_from_axis_angle(angles), places


@pytest.mark.parametrize(("stiffness", "drag", "gravity"), [(1.0, 0.3, 0.1), (0.2, 0.1, 0.0), (4.0, 0.7, 0.3)])
def test_the_page_swings_springs_as_the_specification_says(swung, stiffness, drag, gravity):
    joints = tuple(VrmSpringJoint(bone, stiffness, gravity, DOWN, drag, 0.0) for bone in (1, 2, 3, 4))
    turns, places = swaying()
    rest = rod().rig.positions
    heads = places + np.einsum("nij,j->ni", turns, rest[1] - rest[0])
    values = tuple(np.array([[value]]) for value in (stiffness, drag, gravity))
    turn, head = between_frames(turns[:, None], heads[:, None], 60.0)
    links = []
    for bone in np.diff(rest[1:], axis=0)[:, None]:
        links.append(np.stack(list(vrm_steps(turn, head, bone, values)))[:, :, 0])
        turn, head = link_turns(turn, head, bone, links[-1]), links[-1]
    wanted = np.concatenate(links, axis=1)
    found = swung(VrmSpring("rod", joints, ()), turns, places)
    assert np.abs(wanted[:, 2] - wanted[:1, 2]).max() > 0.2
    np.testing.assert_allclose(found[:, 2:], wanted, atol=2e-5)
