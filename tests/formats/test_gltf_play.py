"""Clips of glTF files, played: what Bunraku writes comes back, and the three kinds of interpolation follow the rules of
glTF.
"""

import json
import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku import Animation, Character, FormatError, HandleMotion, Handles, OptionError
from bunraku.io import save_animation, save_character
from bunraku.io.play import load_animation
from bunraku_lab.synthetic.samples import make_sample


def random_animation(seed: int = 0, frames: int = 12, count: int = 5) -> Animation:
    rng = np.random.default_rng(seed)
    character = make_sample("mushroom", 0.3)
    positions = character.vertices[rng.integers(len(character.vertices), size=count)]
    weights = rng.dirichlet(np.ones(count), len(character.vertices)).astype(np.float32)
    rotations = (
        Rotation.from_rotvec(0.4 * rng.normal(size=(frames * count, 3))).as_matrix().reshape(frames, count, 3, 3)
    )
    translations = 0.1 * rng.normal(size=(frames, count, 3))
    rotations[:, 0], translations[:, 0] = np.eye(3), 0
    turns = Rotation.from_rotvec(rng.normal(size=(frames, 3))).as_matrix()
    return Animation(
        character,
        Handles(positions, weights).top(4),
        HandleMotion(translations, rotations, rng.normal(size=(frames, 3)), turns, 20.0),
    )


def test_what_is_written_plays_the_same(tmp_path):
    animation = random_animation()
    path = save_animation(animation, tmp_path / "a.glb", fps=20.0)
    played = load_animation(path, fps=20.0)
    assert len(played.motion) == len(animation.motion)
    expected, got = animation.vertices(), played.vertices()
    assert np.abs(got - expected).max() < 1e-3 * animation.character.height


def hand_made(how: str, kind: str, times: list[float], values: np.ndarray) -> bytes:
    """A triangle of one joint whose `kind` is animated by `values`, written without the library."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
    blocks = [
        corners,
        np.zeros((3, 4), "u1"),
        np.tile(np.array([1, 0, 0, 0], "<f4"), (3, 1)),
        np.array(times, "<f4"),
        np.asarray(values, "<f4"),
    ]
    kinds = [
        (5126, "VEC3"),
        (5121, "VEC4"),
        (5126, "VEC4"),
        (5126, "SCALAR"),
        (5126, "VEC4" if kind == "rotation" else "VEC3"),
    ]
    views, accessors, data = [], [], b""
    for index, (block, (component, shape)) in enumerate(zip(blocks, kinds, strict=True)):
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": block.nbytes})
        accessors.append({"bufferView": index, "componentType": component, "count": len(block), "type": shape})
        data += block.tobytes()
    accessors[0] |= {"min": [0, 0, 0], "max": [1, 1, 0]}
    tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0, "skin": 0}, {"name": "bone"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}}]}],
        "skins": [{"joints": [1]}],
        "animations": [
            {
                "name": "Armature|Move",
                "samplers": [{"input": 3, "output": 4, "interpolation": how}],
                "channels": [{"sampler": 0, "target": {"node": 1, "path": kind}}],
            }
        ],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def play(tmp_path, *made, fps=10.0) -> np.ndarray:
    path = tmp_path / "made.glb"
    path.write_bytes(hand_made(*made))
    return load_animation(path, "Move", fps=fps).vertices()


def test_linear_translation(tmp_path):
    got = play(tmp_path, "LINEAR", "translation", [0, 1], np.array([[0, 0, 0], [2, 0, 0]]))
    np.testing.assert_allclose(got[:, 0, 0], 2 * np.arange(11) / 10, atol=1e-6)


def test_step_holds_each_key_and_the_last_stays(tmp_path):
    got = play(tmp_path, "STEP", "translation", [0.2, 0.5, 1], np.array([[1, 0, 0], [2, 0, 0], [3, 0, 0]]))
    np.testing.assert_allclose(got[:, 0, 0], [1] * 5 + [2] * 5 + [3])


def test_cubic_spline_is_hermite(tmp_path):
    from scipy.interpolate import CubicHermiteSpline

    keys = np.array([[0, 1], [2, -1], [-1, 0.5]])  # value and slope of x
    values = np.zeros((9, 3))
    values[0::3, 0], values[1::3, 0], values[2::3, 0] = keys[:, 1], keys[:, 0], keys[:, 1]
    times = [0, 0.7, 1]
    got = play(tmp_path, "CUBICSPLINE", "translation", times, values)
    np.testing.assert_allclose(
        got[:, 0, 0], CubicHermiteSpline(times, keys[:, 0], keys[:, 1])(np.arange(11) / 10), atol=1e-5
    )


def test_rotation_is_slerp(tmp_path):
    quarter = Rotation.from_euler("z", 90, degrees=True).as_quat()
    got = play(
        tmp_path, "LINEAR", "rotation", [0, 1], np.stack([[0, 0, 0, 1], -quarter])
    )  # the long sign of the same turn
    angle = np.radians(90) * np.arange(11) / 10
    np.testing.assert_allclose(got[:, 1, :2], np.stack([np.cos(angle), np.sin(angle)], axis=1), atol=1e-5)


def test_scale_is_kept(tmp_path):
    got = play(tmp_path, "LINEAR", "scale", [0, 1], np.array([[1, 1, 1], [3, 1, 1]]))
    np.testing.assert_allclose(got[-1], [[0, 0, 0], [3, 0, 0], [0, 1, 0]], atol=1e-5)


def test_what_cannot_be_played(tmp_path):
    path = save_character(Character("t", np.eye(3), [[0, 1, 2]]), tmp_path / "still.glb")
    with pytest.raises(FormatError, match="no animation"):
        load_animation(path)
    with pytest.raises(OptionError, match="has no clip 'Fly'; it has Armature|Move"):
        (tmp_path / "m.glb").write_bytes(hand_made("LINEAR", "scale", [0, 1], np.ones((2, 3))))
        load_animation(tmp_path / "m.glb", "Fly")
    for times, values in (
        ([1, 0], np.ones((2, 3))),
        ([0, 1], np.ones((3, 3))),
        ([0, 1e9], np.ones((2, 3))),
        ([0, 1], np.full((2, 3), np.nan)),
    ):
        with pytest.raises(FormatError):
            play(tmp_path, "LINEAR", "translation", times, values)
