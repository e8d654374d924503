"""Animations as one file a frame, read back by trimesh."""

import numpy as np
import pytest
import trimesh
from gltf_files import CUBE, CUBE_FACES, made_up_handles, made_up_motion

from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.errors import FormatError, OptionError


@pytest.fixture
def animation():
    cube = Character("cube", CUBE, CUBE_FACES, colors=np.arange(24).reshape(8, 3))
    return Animation(cube, made_up_handles(cube), made_up_motion(cube, frames=21))


@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_each_frame_is_a_mesh(animation, tmp_path, suffix):
    folder = animation.save(tmp_path / f"dance.{suffix}")
    assert folder == tmp_path / "dance"
    files = sorted(folder.iterdir())
    assert [file.name for file in files[::20]] == [f"dance_0000.{suffix}", f"dance_0020.{suffix}"] and len(files) == 21
    expected = animation.vertices()
    for frame in (0, 7, 20):
        mesh = trimesh.load(files[frame], process=False)
        assert np.allclose(mesh.vertices, expected[frame], atol=1e-6) and np.array_equal(mesh.faces, CUBE_FACES)
    if suffix == "ply":
        assert np.array_equal(mesh.visual.vertex_colors[:, :3], animation.character.colors)


def test_another_frame_rate_and_an_earlier_sequence(animation, tmp_path):
    assert len(list(animation.save(tmp_path / "dance.ply").iterdir())) == 21
    assert len(list(animation.save(tmp_path / "dance.ply", fps=10).iterdir())) == 11
    (tmp_path / "dance" / "thesis.txt").write_text("precious")
    with pytest.raises(FormatError, match="holds other files"):
        animation.save(tmp_path / "dance.ply")
    assert (tmp_path / "dance" / "thesis.txt").exists() and [entry.name for entry in tmp_path.iterdir()] == ["dance"]


def test_axis_and_unit(animation, tmp_path):
    folder = animation.save(tmp_path / "dance.obj", up="+z", unit="cm")
    mesh = trimesh.load(folder / "dance_0007.obj", process=False)
    x, y, z = animation.vertices()[7].T
    assert np.allclose(mesh.vertices, 100 * np.stack([x, -z, y], axis=1), atol=1e-4)
    for options in ({"up": "+x"}, {"unit": "league"}):
        with pytest.raises(OptionError):
            animation.save(tmp_path / "dance.ply", **options)
