"""FBX through Blender, read again by our own reader; skipped where there is no Blender."""

import os
import stat
import sys

import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, made_up_handles, made_up_motion

from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.errors import BunrakuError, OptionError
from bunraku.formats.fbx.export import BLENDER, BLENDER_PYTHON, blender_command
from bunraku.io import load_character
from bunraku.io.play import load_animation
from bunraku.io.registry import check_writer


@pytest.fixture
def animation():
    cube = Character("cube", CUBE, CUBE_FACES)
    return Animation(cube, made_up_handles(cube), made_up_motion(cube, frames=11))


@pytest.fixture
def blender():
    try:
        blender_command()
    except BunrakuError as error:
        pytest.skip(str(error))


@pytest.fixture
def alone(monkeypatch, tmp_path):
    """No Blender anywhere."""
    for variable in (BLENDER, BLENDER_PYTHON):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path / "none"))
    return monkeypatch


def program(path, text):
    """An executable that stands where Blender would."""
    path.write_text(f"#!{sys.executable}\n{text}")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


@pytest.mark.parametrize("options", [{}, {"up": "+z", "unit": "m", "name": "wave", "fps": 40}])
def test_what_blender_writes_moves_alike(blender, animation, tmp_path, options):
    path = animation.save(tmp_path / "dance.fbx", **options)
    read = load_animation(path, options.get("name", "dance"), options.get("fps", 20))
    want = Animation(animation.character, animation.handles.top(4), animation.motion).vertices()
    got = read.vertices()[:: 2 if options else 1]
    assert len(got) == 11 and load_character(path).height == pytest.approx(2, rel=1e-4)
    nearest = np.linalg.norm(want[:, :, None] - got[:, None], axis=-1).min(axis=2)  # Blender may split vertices
    assert nearest.max() < 1e-3 * animation.character.height
    assert [entry.name for entry in tmp_path.iterdir()] == ["dance.fbx"]


def test_without_blender(alone, animation, tmp_path):
    for attempt in (lambda: animation.save(tmp_path / "dance.fbx"), lambda: check_writer(tmp_path / "dance.fbx")):
        with pytest.raises(BunrakuError, match="needs Blender; install it from blender.org"):
            attempt()
    alone.setenv(BLENDER, str(tmp_path / "not there"))
    with pytest.raises(BunrakuError, match="no program that can be run"):
        check_writer(tmp_path / "dance.fbx")


@pytest.mark.skipif(os.name != "posix", reason="the stand-ins are POSIX scripts")
@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("import sys; print('Error: no room', file=sys.stderr); sys.exit(3)", "saying 'Error: no room'"),
        ("print('done, but nothing is written')", "Blender failed"),
        ("import time; time.sleep(60)", "took more than 1 s"),
    ],
)
def test_a_blender_that_fails(alone, animation, tmp_path, text, says):
    alone.setenv(BLENDER, str(program(tmp_path / "blender", text)))
    with pytest.raises(BunrakuError, match=says):
        animation.save(tmp_path / "dance.fbx", timeout=1)
    assert [entry.name for entry in tmp_path.iterdir()] == ["blender"]


def test_options_that_make_no_sense(alone, animation, tmp_path):
    for options in ({"up": "x"}, {"unit": "in"}):
        with pytest.raises(OptionError):
            animation.save(tmp_path / "dance.fbx", **options)
