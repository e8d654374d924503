"""In which unit a character's file is: the guess by its height, and what is said."""

import logging

import numpy as np
import pytest
import trimesh

import bunraku
from bunraku.core.character import Character
from bunraku.errors import OptionError
from bunraku.formats.frames import likely_unit
from bunraku.io import load_character, save_character
from bunraku.io.units import in_metres, resolve_unit
from bunraku.samples import sample_character


def box(path, size):
    """A box of this size, standing on the ground."""
    mesh = trimesh.creation.box(size)
    mesh.apply_translation([0, size[1] / 2, 0])
    mesh.export(path)
    return path


@pytest.mark.parametrize(
    ("height", "unit"), [(1780, "mm"), (400, "mm"), (399, "cm"), (145.9, "cm"), (10, "cm"), (9.9, "m"), (0.04, "m")]
)
def test_the_unit_that_makes_a_height_a_characters(height, unit):
    assert likely_unit(height) == unit and likely_unit(0.039) == ""


def test_only_formats_without_a_unit_are_scaled():
    dragon = resolve_unit(145.9, ".stl")
    assert dragon.unit == "cm" and dragon.note == "145.9 tall: probably centimetres; taken as 1.46 m"
    assert (
        resolve_unit(145.9, ".glb").unit == "m" and "against the unit of its format" in resolve_unit(145.9, ".glb").note
    )
    assert resolve_unit(145.9, ".stl", "in").unit == "in" and resolve_unit(1.7, ".obj").note == ""
    tiny = resolve_unit(0.0178, ".obj")
    assert tiny.unit == "m" and "left as it is" in tiny.note


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_a_file_in_centimetres_is_read_in_metres(tmp_path, suffix, caplog):
    path = box(tmp_path / f"box.{suffix}", (80, 170, 50))
    with caplog.at_level(logging.WARNING):
        character = bunraku.load_character(path)
    assert np.ptp(character.vertices, axis=0) == pytest.approx([0.8, 1.7, 0.5])
    assert 'probably centimetres; taken as 1.7 m; say unit="m" to keep its numbers' in caplog.text
    caplog.clear()
    for unit, factor in (("m", 1), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254)):
        sized = load_character(path, unit=unit)
        assert np.ptp(sized.vertices, axis=0) == pytest.approx(np.array([80, 170, 50]) * factor)
    assert caplog.text == ""
    again = load_character(save_character(character, tmp_path / "out.glb"))
    assert again.height == pytest.approx(1.7)


def test_the_height_is_that_of_the_up_axis(tmp_path):
    path = box(tmp_path / "flat.stl", (900, 30, 200))
    assert load_character(path, up="y").height == pytest.approx(0.3)
    assert load_character(path, up="z").height == pytest.approx(2.0)
    assert load_character(path, up="x").height == pytest.approx(0.9)


def test_a_lying_mesh_is_measured_as_it_would_stand(tmp_path):
    """A robot in millimetres that lies is 350 deep: read along its +Y, that would be centimetres."""
    robot = sample_character("robot")
    lying = robot.vertices[:, [0, 2, 1]] * np.float32([1000, -1000, 1000])
    path = tmp_path / "robot.stl"
    trimesh.Trimesh(lying, robot.faces, process=False).export(path)
    character = load_character(path)
    assert np.ptp(character.vertices, axis=0).max() == pytest.approx(np.ptp(robot.vertices, axis=0).max(), rel=1e-3)


def test_the_units_of_gltf_and_of_arrays_are_metres(tmp_path, caplog):
    tall = Character("tall", np.float32([[0, 0, 0], [20, 0, 0], [0, 170, 0]]), [[0, 1, 2]])
    assert in_metres(tall)[0] is tall
    path = save_character(tall, tmp_path / "tall.glb")
    assert load_character(path).height == pytest.approx(170) and caplog.text == ""
    assert load_character(path, unit="cm").height == pytest.approx(1.7)


def test_an_unknown_unit_is_one_sentence(tmp_path):
    path = box(tmp_path / "box.obj", (1, 2, 1))
    with pytest.raises(OptionError, match="'ft' is no unit of characters; there are auto, m, cm, mm, in"):
        load_character(path, unit="ft")
