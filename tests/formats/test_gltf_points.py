"""GLB where vertices move on their own, played by the tests' own player, and the shapes that they are made of."""

import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, Maker, made_up_handles, made_up_motion, textured_glb
from gltf_player import Player

from bunraku.body.layout import handle_names
from bunraku.body.reference import reference_body
from bunraku.core.animation import Animation
from bunraku.core.point_animation import PointAnimation
from bunraku.errors import MotionError, OptionError
from bunraku.formats.gltf.morph_targets import key_shapes, mixed_shapes
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.io import load_character

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


def test_targets_hold_only_what_moves(body, tmp_path):
    moved, own = body
    player = Player(moved.save(tmp_path / "skirt.glb", shapes="mixed"))
    targets = player.tree["meshes"][0]["primitives"][0]["targets"]
    counts = {player.tree["accessors"][target["POSITION"]]["sparse"]["count"] for target in targets}
    assert counts == {int(own.sum())} and 3 <= len(targets) < FRAMES // 2
    for sampler in player.tree["animations"][0]["samplers"]:
        if player.tree["accessors"][sampler["output"]]["type"] == "SCALAR":
            weights = player.accessor(sampler["output"])
            assert weights.min() >= 0 and weights.max() <= 1


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
    handles = handle_names(moved.animation.handles)
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


def test_nothing_moves_on_its_own(body, tmp_path):
    moved, _ = body
    still = PointAnimation(moved.animation, np.zeros_like(moved.offsets))
    assert "targets" not in Player(still.save(tmp_path / "still.glb")).tree["meshes"][0]["primitives"][0]


def test_from_vertices_and_at_another_rate(body):
    moved, _ = body
    again = PointAnimation.of_vertices(moved.animation, moved.vertices())
    assert np.abs(again.offsets - moved.offsets).max() < 1e-6
    faster = moved.at(40)
    assert np.allclose(faster.offsets[::2], moved.offsets) and np.allclose(
        faster.offsets[1], (moved.offsets[0] + moved.offsets[1]) / 2, atol=1e-6
    )
    assert faster.motion.fps == 40 and moved.at(20) is moved


def test_what_makes_no_sense(body, tmp_path):
    moved, _ = body
    with pytest.raises(MotionError, match="must have shape"):
        PointAnimation(moved.animation, moved.offsets[:, :5])
    with pytest.raises(MotionError, match="not numbers"):
        PointAnimation(moved.animation, np.full_like(moved.offsets, np.nan))
    for options in ({"shapes": "some"}, {"tolerance": 0}, {"tolerance": float("nan")}, {"fps": 0}):
        with pytest.raises(OptionError):
            moved.save(tmp_path / "x.glb", **options)


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
