"""Writing GLB: the mesh, moving points as morph targets, and the rig of the file."""

import hashlib
import resource
import sys
from dataclasses import replace

import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, Maker, made_up_handles, made_up_motion, textured_glb
from gltf_player import Player

from bunraku import RigAnimation
from bunraku.core.animation import Animation, PointAnimation
from bunraku.core.body.layout import handle_names
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import HandleMotion
from bunraku.errors import CharacterError, FormatError, OptionError
from bunraku.files import load_character, save, save_character
from bunraku.files.clips import load_animation
from bunraku.files.gltf.open import open_document
from bunraku.files.gltf.read import rotated
from bunraku.files.gltf.write_points import key_shapes, mixed_shapes
from bunraku.files.presets import save_clips


def animate(character, count=30, **options):
    handles = made_up_handles(character, count)
    return Animation(character, handles, made_up_motion(character, count=count, **options))


@pytest.fixture
def ball():
    """A character of arrays alone: a sphere of 1,200 vertices."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 40), np.linspace(0, np.pi, 30))
    points = np.stack([np.sin(v) * np.cos(u), 1 + np.cos(v), np.sin(v) * np.sin(u)], -1).reshape(-1, 3)
    i = np.arange(1200).reshape(30, 40)[:-1, :-1].reshape(-1)
    faces = np.concatenate([np.stack([i, i + 1, i + 40], 1), np.stack([i + 1, i + 41, i + 40], 1)])
    return Character("ball", points, faces, colors=np.random.default_rng(0).integers(0, 256, (1200, 3)))


def test_the_player_sees_what_the_library_computes(thing, ball, tmp_path):
    for character in (thing, ball):
        animation = animate(character)
        player = Player(save(animation, tmp_path / "out.glb"))
        top = Animation(character, animation.handles.top(), animation.motion).vertices()
        for frame in (0, 7, 23):
            played = player.vertices(frame / 20)
            assert np.abs(played - top[frame]).max() < 2e-5 * character.height
            mean = np.linalg.norm(played - animation.vertices([frame])[0], axis=1).mean()
            assert mean < 1e-3 * character.height


def test_the_default_pose_is_the_rest_pose(thing, ball, tmp_path):
    for character in (thing, ball):
        for handles in (made_up_handles(character), None):
            path = save_character(character, tmp_path / "rig.glb", handles)
            assert np.abs(Player(path).vertices(0) - character.vertices).max() < 1e-5
            again = load_character(path)
            assert np.abs(again.vertices - character.vertices).max() < 1e-5 and np.array_equal(
                again.faces, character.faces
            )
            assert np.abs(again.colors.astype(int) - character.colors).max() <= 1
            assert "animations" not in Player(path).tree and ("skins" in Player(path).tree) == (handles is not None)


def fingerprint(player, node):
    """What must not change of a mesh: everything but its positions, normals and skin."""
    out = []
    for primitive in player.tree["meshes"][node["mesh"]]["primitives"]:
        hashes = {
            name: hashlib.sha256(player.accessor(index).tobytes()).hexdigest()
            for name, index in primitive["attributes"].items()
            if name.startswith(("TEXCOORD", "COLOR"))
        }
        out.append(
            (player.tree["accessors"][primitive["attributes"]["POSITION"]]["count"], hashes, primitive.get("material"))
        )
    return out


def test_meshes_materials_textures_and_extras_are_the_same(thing, tmp_path):
    before, after = Player(tmp_path / "thing.glb"), Player(save(animate(thing), tmp_path / "out.glb"))
    meshes = [[node for node in player.nodes if "mesh" in node] for player in (before, after)]
    assert [node["name"] for node in meshes[1]] == ["body", "hat", "mirrored hat"]
    for old, new in zip(*meshes, strict=True):
        assert fingerprint(before, old) == fingerprint(after, new)
        assert old.get("extras") == new.get("extras") and "skin" in new
    for key in ("materials", "textures", "samplers"):
        assert before.tree[key] == after.tree[key]
    assert after.tree["meshes"][0]["extras"] == {"maker": "us"} and after.tree["scenes"][0]["name"] == "stage"
    images = []
    for player in (before, after):
        view = player.tree["bufferViews"][player.tree["images"][0]["bufferView"]]
        images.append(player.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])
    assert images[0] == images[1]
    hat = [
        player.tree["meshes"][nodes[1]["mesh"]]["primitives"][0]
        for player, nodes in zip((before, after), meshes, strict=True)
    ]
    for name in ("POSITION",):  # a mesh that its node only places keeps its raw positions
        assert np.array_equal(before.accessor(hat[0]["attributes"][name]), after.accessor(hat[1]["attributes"][name]))
    assert np.array_equal(before.accessor(hat[0]["indices"]), after.accessor(hat[1]["indices"]))


def test_normals_of_a_bent_rest_pose_bend_with_it(thing, tmp_path):
    thing = load_character(thing.source.document.path, rest="default")
    after = Player(save_character(thing, tmp_path / "out.glb"))
    primitive = after.tree["meshes"][0]["primitives"][0]
    normals = after.accessor(primitive["attributes"]["NORMAL"])
    angle = 2 * np.arcsin(0.1736482)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    high = CUBE[:, 1] > 0
    raw = (CUBE - [0, 1, 0]) / np.sqrt(3)
    assert np.allclose(normals[~high], raw[~high], atol=1e-6) and np.allclose(
        normals[high], raw[high] @ turn.T, atol=1e-6
    )


def test_a_mirrored_mesh_is_turned_outwards(thing, tmp_path):
    again = load_character(save_character(thing, tmp_path / "out.glb", made_up_handles(thing)))
    corners = again.vertices[again.faces[24:]].astype(float) - again.vertices[again.faces[24:]].mean(axis=(0, 1))
    original = CUBE[CUBE_FACES] - CUBE.mean(axis=0)
    signs = [np.sign(np.einsum("ij,ij->i", c[:, 0], np.cross(c[:, 1], c[:, 2]))) for c in (corners, original)]
    assert np.array_equal(*signs)


def test_morph_targets_stay(tmp_path):
    maker = Maker()
    attributes = {"POSITION": maker.add(CUBE), "JOINTS_0": maker.add(np.tile([0, 1, 0, 0], (8, 1)).astype(np.uint8))}
    attributes["WEIGHTS_0"] = maker.add(np.c_[CUBE[:, 1] / 2, 1 - CUBE[:, 1] / 2, 0 * CUBE[:, :2]].astype(np.float32))
    primitive = {
        "attributes": attributes,
        "targets": [{"POSITION": maker.add(np.full_like(CUBE, 0.5))}],
        "indices": maker.add(CUBE_FACES.reshape(-1).astype(np.uint8)),
    }
    nodes = [{"mesh": 0, "skin": 0, "children": [1, 2]}, {"rotation": [0, 0.6, 0, 0.8]}, {"scale": [1, 2, 1]}]
    (tmp_path / "in.glb").write_bytes(
        maker.glb(nodes=nodes, meshes=[{"primitives": [primitive], "weights": [1]}], skins=[{"joints": [1, 2]}])
    )
    character = load_character(tmp_path / "in.glb")
    for handles in (None, made_up_handles(character)):
        path = save_character(character, tmp_path / "out.glb", handles)
        assert Player(path).tree["meshes"][0]["weights"] == [1]
        assert np.abs(load_character(path).vertices - character.vertices).max() < 1e-5


def test_the_skin_is_what_viewers_read(thing, tmp_path):
    player = Player(save(animate(thing), tmp_path / "out.glb"))
    names = [player.nodes[joint]["name"] for joint in player.tree["skins"][0]["joints"]]
    assert len(names) == 30 and names[0] == "pelvis" and names[29] == "tail_tip"
    assert all(len(skin["joints"]) == 30 for skin in player.tree["skins"])
    assert player.nodes[0]["children"] == list(range(1, 30))
    for mesh in player.tree["meshes"]:
        for primitive in mesh["primitives"]:
            weights, joints = (player.accessor(primitive["attributes"][name]) for name in ("WEIGHTS_0", "JOINTS_0"))
            assert (
                np.abs(weights.astype(float).sum(axis=1) - 1).max() < 2e-7
                and (weights >= 0).all()
                and joints.max() < 30
            )
            assert not joints[weights == 0].any()
    assert player.tree["asset"]["generator"] == "bunraku"


def test_channels_are_lean_and_quaternions_keep_their_sign(thing, tmp_path):
    animation = animate(thing, frames=60)
    player = Player(save(animation, tmp_path / "out.glb", name="dance"))
    clip = player.tree["animations"][0]
    assert clip["name"] == "dance" and len(clip["channels"]) == 60
    keys = {}
    for channel in clip["channels"]:
        sampler = clip["samplers"][channel["sampler"]]
        values = player.accessor(sampler["output"])
        keys[channel["target"]["node"], channel["target"]["path"]] = len(values)
        if channel["target"]["path"] == "rotation":
            assert np.allclose(np.linalg.norm(values, axis=1), 1, atol=1e-6)
            assert ((values[1:] * values[:-1]).sum(axis=1) > 0).all()
        times = player.tree["accessors"][sampler["input"]]
        assert times["min"] == [0] and times["count"] == len(values)
    assert keys[5, "rotation"] == keys[5, "translation"] == 1 and keys[0, "rotation"] == keys[6, "translation"] == 60


def test_another_frame_rate_follows_the_same_motion(thing, tmp_path):
    animation = animate(thing, frames=21)
    slow = Player(save(animation, tmp_path / "slow.glb"))
    fast = Player(save(animation, tmp_path / "fast.glb", fps=60))
    assert (
        max(
            entry["count"]
            for entry in fast.tree["accessors"]
            if entry.get("max") == [1.0] and entry["type"] == "SCALAR"
        )
        == 61
    )
    for at in (0.0, 0.1, 1 / 3, 0.5167, 1.0):
        assert np.abs(slow.vertices(at) - fast.vertices(at)).max() < 3e-3
    for at in (0.0, 0.5, 1.0):
        assert np.abs(slow.vertices(at) - fast.vertices(at)).max() < 1e-5


def test_a_motion_that_stands_still_keeps_its_length(thing, tmp_path):
    frames = 41
    still = HandleMotion(
        np.zeros((frames, 30, 3)),
        np.tile(np.eye(3), (frames, 30, 1, 1)),
        np.zeros((frames, 3)),
        np.tile(np.eye(3), (frames, 1, 1)),
    )
    player = Player(save(Animation(thing, made_up_handles(thing), still), tmp_path / "out.glb"))
    assert (
        max(entry["max"][0] for entry in player.tree["accessors"] if entry["type"] == "SCALAR" and "max" in entry) == 2
    )


def test_failures_leave_nothing_behind(thing, tmp_path, monkeypatch):
    animation = animate(thing)
    with pytest.raises(FormatError, match="does not exist"):
        save(animation, tmp_path / "a" / "b" / "out.glb")
    assert save(animation, tmp_path / "a" / "out.glb").is_file()
    with pytest.raises(FormatError, match="this is a folder"):
        save(animation, tmp_path / "a")
    with pytest.raises(FormatError, match="are written to .glb"):
        save(animation, tmp_path / "out.xyz")
    with pytest.raises(OptionError, match="no option 'speed'"):
        save(animation, tmp_path / "out.glb", speed=2)
    for fps in (0, -1, float("nan"), "fast", 1e9):
        with pytest.raises(OptionError, match="fps must be"):
            save(animation, tmp_path / "out.glb", fps=fps)
    with pytest.raises(CharacterError, match="handles weigh 3 vertices"):
        save_character(thing, tmp_path / "out.glb", Handles(np.zeros((1, 3)), np.ones((3, 1))))
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a", "thing.glb"]


def test_a_full_disk_leaves_the_old_file(thing, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # modules imported meanwhile would be cut off, for good
    animation = animate(thing)
    (tmp_path / "full").mkdir()
    path = save(animation, tmp_path / "full" / "out.glb")
    old, limits = path.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200, limits[1]))
    try:
        for name in ("out.glb", "out.npz", "out.obj"):
            with pytest.raises(FormatError, match="cannot be written"):
                save(animation, path.with_name(name))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == old and [entry.name for entry in path.parent.iterdir()] == ["out.glb"]


FPS, FRAMES = 20.0, 25


def ripples(points, frames, seed=0):
    """Waves that run round points and swing, smooth in time and space [m], shape (N, M, 3)."""
    rng, time = np.random.default_rng(seed), np.arange(frames)[:, None] / FPS
    angle = np.arctan2(points[:, 0], points[:, 2])
    out = sum(
        np.sin(count * angle + rate * time + rng.uniform(0, 6))[..., None] * rng.normal(0, 0.02, 3)
        for count, rate in ((0, 3), (1, 4), (3, 6))
    )
    return (out - out[0]).astype(np.float32)


def skirt(character, frames=FRAMES):
    """An animation of whose vertices those of the hips move on their own."""
    handles = made_up_handles(character)
    animation = Animation(character, handles, made_up_motion(character, frames=frames, fps=FPS))
    low, high = np.quantile(character.vertices[:, 1], [0.3, 0.6])
    own = (character.vertices[:, 1] >= low) & (character.vertices[:, 1] <= high)
    offsets = np.zeros((frames, len(character.vertices), 3), np.float32)
    offsets[:, own] = ripples(character.vertices[own], frames)
    return PointAnimation(animation, offsets), own


@pytest.fixture(scope="module")
def body():
    return skirt(reference_body().character())


@pytest.mark.parametrize("shapes", ["mixed", "keys", "auto", "bones"])
def test_vertices_are_where_they_should_be(body, tmp_path, shapes):
    moved, own = body
    limit = 1e-3 if shapes != "bones" else 3e-2
    player = Player(moved.save(tmp_path / "skirt.glb", shapes=shapes, tolerance=limit))
    assert moved.animation.character.source is None  # so the file's vertices are in the character's order
    plain = Animation(moved.character, moved.animation.handles.top(4), moved.motion).vertices()
    for frame in (0, 7, 13, 24):
        posed = player.vertices(frame / FPS)
        assert np.linalg.norm(posed - moved.vertices([frame])[0], axis=1)[own].max() < 1.02 * limit
        assert np.abs(posed - plain[frame])[~own].max() < 1e-4  # what does not move on its own is only skinned
        assert np.linalg.norm(posed - plain[frame], axis=1)[own].max() > 2 * limit or frame == 0


def test_bones_are_taken_where_they_are_smaller(body, tmp_path):
    """Stiff pieces that turn are a few bones; the names of the other joints stay."""
    moved, own = body
    x, y, _ = moved.character.vertices.T
    pieces = [own & (y > np.median(y[own])) & (side * x > 0.05) for side in (1, -1)]
    vertices = moved.animation.vertices()
    for side, piece in zip((1, -1), pieces, strict=True):
        points = moved.character.vertices[piece]
        turns = matrix_from_axis_angle(np.linspace(0, 0.8, FRAMES)[:, None] * [0.3, 0.2, side])
        vertices[:, piece] = np.einsum("nab,mb->nma", turns, points - points.mean(axis=0)) + points.mean(axis=0)
    swinging = PointAnimation.of_vertices(moved.animation, vertices)
    auto, mixed = (swinging.save(tmp_path / f"{how}.glb", shapes=how, tolerance=2e-3) for how in ("auto", "mixed"))
    assert auto.stat().st_size < mixed.stat().st_size
    player = Player(auto)
    assert "targets" not in player.tree["meshes"][0]["primitives"][0]
    names = [node["name"] for node in player.tree["nodes"]]
    handles = handle_names(moved.animation.handles.played)
    assert names[: len(handles)] == list(handles) and "apparel_4" in names
    for frame in (5, 20):
        posed, wanted = player.vertices(frame / FPS), swinging.vertices([frame])[0]
        assert np.linalg.norm(posed - wanted, axis=1)[pieces[0] | pieces[1]].max() < 2e-3


def test_what_bones_cannot_say_is_named(body, tmp_path):
    moved, own = body
    noise = np.zeros_like(moved.offsets)
    noise[:, own] = np.random.default_rng(0).normal(0, 0.05, noise[:, own].shape)
    with pytest.raises(OptionError, match="larger tolerance"):
        PointAnimation(moved.animation, noise).save(tmp_path / "noise.glb", shapes="bones", tolerance=1e-5)


def test_a_file_of_several_meshes_keeps_its_materials(tmp_path):
    (tmp_path / "in.glb").write_bytes(textured_glb())
    character = load_character(tmp_path / "in.glb")
    moved, _ = skirt(character)
    everywhere = PointAnimation(moved.animation, 0.3 * ripples(character.vertices, FRAMES))
    player = Player(everywhere.save(tmp_path / "out.glb"))
    assert [material["name"] for material in player.tree["materials"]] == ["cloth", "felt"]
    order = character.source.index  # the file's vertices by the character's
    want = everywhere.vertices([12])[0][order]
    assert np.abs(player.vertices(12 / FPS) - want).max() < 2e-3 * character.height


def test_morph_targets_that_the_file_has_already_stay(tmp_path):
    maker = Maker()
    smile = maker.add(np.full((8, 3), 0.25, np.float32), bounds=True)
    primitive = {
        "attributes": {"POSITION": maker.add(CUBE, bounds=True)},
        "indices": maker.add(CUBE_FACES.reshape(-1).astype(np.uint16)),
        "targets": [{"POSITION": smile}],
    }
    mesh = {"primitives": [primitive], "weights": [0.0], "extras": {"targetNames": ["smile"]}}
    (tmp_path / "in.glb").write_bytes(maker.glb(nodes=[{"mesh": 0, "scale": [2, 1, 1]}], meshes=[mesh]))
    moved, _ = skirt(load_character(tmp_path / "in.glb"))
    everywhere = PointAnimation(moved.animation, ripples(moved.character.vertices, FRAMES))
    player = Player(everywhere.save(tmp_path / "out.glb", shapes="keys"))
    assert np.abs(player.vertices(0.6) - everywhere.vertices([12])[0]).max() < 2e-3
    kept = player.tree["meshes"][0]
    assert np.allclose(player.accessor(kept["primitives"][0]["targets"][0]["POSITION"]), 0.25)
    assert kept["extras"]["targetNames"][:2] == ["smile", "move_0"] and len(kept["extras"]["targetNames"]) == len(
        kept["weights"]
    )
    assert len(kept["weights"]) == len(kept["primitives"][0]["targets"]) and kept["weights"][0] == 0


def test_from_vertices_and_at_another_rate(body):
    moved, _ = body
    again = PointAnimation.of_vertices(moved.animation, moved.vertices())
    assert np.abs(again.offsets - moved.offsets).max() < 1e-6
    faster = moved.at(40)
    assert np.allclose(faster.offsets[::2], moved.offsets) and np.allclose(
        faster.offsets[1], (moved.offsets[0] + moved.offsets[1]) / 2, atol=1e-6
    )
    assert faster.motion.fps == 40 and moved.at(20) is moved


@pytest.mark.parametrize("fit", [key_shapes, mixed_shapes])
def test_shapes_keep_the_tolerance_and_pay_for_what_is_there(fit):
    time = np.arange(60)
    offsets = ripples(np.random.default_rng(1).normal(size=(40, 3)), 60)
    for tolerance in (1e-4, 1e-3, 1e-2):
        found = fit(offsets, tolerance)
        assert np.linalg.norm(found.offsets(60) - offsets, axis=-1).max() <= tolerance * 1.01
        assert found.weights.min() >= 0 and found.weights.max() <= 1
    assert len(fit(offsets, 5e-2).shapes) < len(fit(offsets, 1e-4).shapes)
    straight = (time[:, None, None] * np.ones((1, 5, 3)) / 60).astype(np.float32)
    assert len(fit(straight, 1e-4).shapes) <= 2
    assert len(key_shapes(np.zeros((4, 3, 3), np.float32), 1e-3).shapes) == 0


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
    character = {"own": textured, "turned": rotated(textured, "+z", "-y"), "plain": reference_body().character()}[kind]
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
