"""Clips that are written stretch by stretch hold what they would hold in one piece."""

import numpy as np
import pytest
from gltf_files import made_up_handles, made_up_motion, textured_glb

from bunraku.core.animation import Animation
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import FormatError, OptionError
from bunraku.formats.gltf.container.open import open_document
from bunraku.formats.gltf.stream import write_stretches
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.io import load_character
from bunraku.io.play import load_animation


@pytest.fixture
def textured(tmp_path):
    path = tmp_path / "textured.glb"
    path.write_bytes(textured_glb())
    return load_character(path)


def whole(character, kind, frames=41):
    if kind == "handles":
        handles = made_up_handles(character).top(4)
        return Animation(character, handles, made_up_motion(character, frames=frames))
    bones, share = len(character.rig.names), np.linspace(0, 3, frames)[:, None, None]
    turns = matrix_from_axis_angle(np.sin(share) * np.random.default_rng(0).normal(size=(1, bones, 3)))
    return RigAnimation(character, turns, 0.1 * np.sin(share) * np.ones((1, bones, 3)), 20.0)


def cut(animation, at):
    """Stretches of which each begins with the last frame of the one before."""
    bounds = [0, *at, 40]
    return [animation.take(slice(low, high + 1)) for low, high in zip(bounds, bounds[1:], strict=False)]


@pytest.mark.parametrize("kind", ["handles", "bones"])
@pytest.mark.parametrize("fps", [20.0, 30.0, 12.0])
def test_stretches_play_as_the_whole_does(textured, tmp_path, kind, fps):
    animation = whole(textured, kind)
    one = write_stretches([animation], tmp_path / "one.glb", fps=fps)
    some = write_stretches(iter(cut(animation, [7, 8, 29])), tmp_path / "some.glb", fps=fps)
    known = load_animation(animation.save(tmp_path / "known.glb", fps=fps), 0, fps)
    for path in (one, some):
        played = load_animation(path, 0, fps)
        assert len(played.motion) == len(known.motion)
        assert np.abs(played.vertices() - known.vertices()).max() < 1e-4 * textured.height
    assert not list(tmp_path.glob(".*"))


def test_the_clips_of_the_file_stay(textured, tmp_path):
    path = write_stretches([whole(textured, "bones")], tmp_path / "a.glb", name="long")
    clips = open_document(path, path.read_bytes()).tree["animations"]
    assert [clip.get("name") for clip in clips[:1]] == ["long"]
    assert len(clips) == 1 + len(textured.source.document.tree["animations"])


def test_what_is_no_stretch_is_refused(textured, tmp_path):
    with pytest.raises(OptionError, match="nothing to write"):
        write_stretches([], tmp_path / "a.glb")
    with pytest.raises(FormatError, match=r"\.glb"):
        write_stretches([whole(textured, "handles")], tmp_path / "a.fbx")
