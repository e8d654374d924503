"""Previews: videos, sheets, and the page with a view."""

from __future__ import annotations

import base64
import html
import re
import shutil
import subprocess

import numpy as np
import pytest
from PIL import Image
from tubes import swinging

import bunraku.core.saving as saving
from bunraku.core.animation import Animation, PointAnimation, RigAnimation
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.errors import FormatError, OptionError
from bunraku.files.clips import load_animation
from bunraku.render import contact_sheet, render_animation, render_frames, save_preview, save_still
from bunraku.render import frames as frames_module
from bunraku.render.pictures import page
from bunraku.render.preview import save_beside


@pytest.mark.parametrize(("fps", "expected"), [(None, 11), (20, 11), (30, 16)])
def test_mp4_has_its_frames_and_size(tmp_path, fps, expected):
    av = pytest.importorskip("av")
    told = []
    path = save_preview(
        swinging(),
        tmp_path / "out.mp4",
        size=(161, 121),
        fps=fps,
        progress=lambda done, total: told.append((done, total)),
    )
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert float(stream.average_rate) == pytest.approx(fps or 20)
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert len(pictures) == expected
    assert pictures[0].shape == (120, 160, 3)
    drawn = list(render_animation(swinging(), size=(160, 120), fps=fps))
    assert np.abs(pictures[3].astype(int) - drawn[3]).mean() < 4
    assert told == [(done, expected) for done in range(1, expected + 1)]
    assert list(tmp_path.iterdir()) == [path]
    assert b"moov" in path.read_bytes()[:200]  # the index comes first, so that a page can play it while it loads


def test_animations_stand_side_by_side_the_shorter_ones_in_their_last_pose(tmp_path):
    whole = swinging()
    path = save_beside([whole, whole.take(slice(3)), whole], tmp_path / "out.gif", size=(200, 160), fps=20)
    with Image.open(path) as picture:
        assert picture.size == (200, 160) and picture.n_frames > 3
        pictures = []
        for frame in range(picture.n_frames):
            picture.seek(frame)
            pictures.append(np.asarray(picture.convert("RGB"), int))
    moves = np.abs(pictures[-1] - pictures[4]) > 40
    assert moves[:80, :100].any() and moves[80:, :100].any()
    assert not moves[:80, 100:].any() and not moves[80:, 100:].any()  # it has ended; there is none


@pytest.mark.parametrize("suffix", [".webp", ".gif"])
def test_moving_pictures_have_their_frames(tmp_path, suffix):
    path = save_preview(swinging(), tmp_path / f"out{suffix}", size=(120, 90))
    with Image.open(path) as picture:
        assert picture.size == (120, 90)
        assert picture.n_frames == 11
        picture.seek(3)
        picture.load()
        assert picture.info["duration"] == 50
        drawn = list(render_animation(swinging(), size=(120, 90)))
        assert np.abs(np.asarray(picture.convert("RGB")).astype(int) - drawn[3]).mean() < 5


def test_sheet_holds_the_frames_it_names(tmp_path):
    animation = swinging()
    path = save_preview(animation, tmp_path / "out.png", frames=6, columns=3, size=(100, 120), title="a tube swings")
    sheet = np.asarray(Image.open(path).convert("RGB"))
    pictures = list(render_animation(animation, size=(100, 120), times=np.array([0, 2, 4, 6, 8, 10]) / 20))
    found = 0
    for picture in pictures:
        windows = np.argwhere((sheet[:-119, :-99] == picture[0, 0]).all(axis=-1))
        found += any((sheet[y : y + 120, x : x + 100] == picture).all() for y, x in windows)
    assert found == 6
    assert sheet.shape[1] < 330 and sheet.shape[0] > 2 * 120 + 40


def test_frames_between_frames_are_interpolated():
    animation = swinging()
    halfway = next(iter(render_animation(animation, times=np.array([0.125, 0.2]), size=(120, 90))))
    posed = animation.vertices([2, 3, 4])
    expected = render_frames(
        np.stack([posed[:2].mean(axis=0), posed[2]]),
        animation.character.faces,
        animation.character.colors,
        size=(120, 90),
    )
    assert np.abs(halfway.astype(int) - expected[0]).mean() < 0.5


def test_a_large_mesh_is_drawn_simplified(monkeypatch):
    animation = swinging(60, 80, frames=2)
    whole = list(render_animation(animation, size=(120, 90)))
    monkeypatch.setattr(frames_module, "MOST_FACES", 2000)
    monkeypatch.setattr(frames_module, "KEPT_FACES", 1000)
    fewer = list(render_animation(animation, size=(120, 90)))
    assert len(frames_module._take(animation, np.zeros(1), "texture").faces) < 2000
    assert 0 < np.abs(whole[1].astype(int) - fewer[1]).mean() < 3


def test_a_vertex_without_faces_does_not_draw_the_camera_away():
    plain = swinging()
    vertices, weights = (
        np.concatenate([plain.character.vertices, [[0, -90, 0]]]),
        np.concatenate([plain.handles.weights, [[1, 0]]]),
    )
    colors = np.full((len(vertices), 3), 120, np.uint8)
    stray = Animation(
        Character("stray", vertices, plain.character.faces, colors=colors),
        Handles(plain.handles.positions, weights),
        plain.motion,
    )
    pictures = [
        np.stack(list(render_animation(animation, size=(96, 96), times=np.array([0, 0.3]))))
        for animation in (plain, stray)
    ]
    assert np.array_equal(*pictures)


def test_stills_show_the_handles(tmp_path):
    animation = swinging()
    plain = np.asarray(Image.open(save_still(animation.character, tmp_path / "plain.png", size=(100, 120))))
    tinted = np.asarray(
        Image.open(
            save_still(animation.character, tmp_path / "handles.png", animation.handles, size=(100, 120), views=2)
        )
    )
    assert plain.shape == (120, 100, 3) and tinted.shape == (120, 200, 3)
    assert np.ptp(tinted, axis=-1).max() > 80 > np.ptp(plain, axis=-1).max()
    with pytest.raises(OptionError):
        save_still(animation.character, tmp_path / "three.png", views=3)


def test_contact_sheet_keeps_to_its_limit(tmp_path):
    rng = np.random.default_rng(0)
    noisy = [np.clip(120 + 30 * rng.normal(size=(160, 200, 3)), 0, 255).astype(np.uint8) for _ in range(6)]
    labels = [f"prompt {i} that is far too long to stand below so small a picture" for i in range(6)]
    path = contact_sheet(noisy, labels, tmp_path / "s.png", title="t")
    assert path.stat().st_size <= 300_000
    with pytest.raises(OptionError):
        contact_sheet(noisy, ["one"], tmp_path / "s.png")
    with pytest.raises(OptionError):
        contact_sheet([], None, tmp_path / "s.png")


@pytest.mark.parametrize("name", ["out.avi", "out", "missing/deeper/out.mp4", "file/out.mp4", "."])
def test_targets_that_cannot_be_written(tmp_path, name):
    (tmp_path / "file").write_text("")
    with pytest.raises(FormatError):
        save_preview(swinging(), tmp_path / name)
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_a_failure_midway_leaves_the_old_file(tmp_path):
    path = tmp_path / "out.mp4"
    path.write_bytes(b"old")

    def stop(done: int, total: int) -> None:
        if done == 4:
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        save_preview(swinging(), path, size=(64, 64), progress=stop)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("options", [{"fps": 0}, {"fps": 1000}, {"color": "mood"}, {"background": "plaid"}])
def test_bad_options_write_nothing(tmp_path, options):
    with pytest.raises(OptionError):
        save_preview(swinging(), tmp_path / "out.mp4", **options)
    assert not list(tmp_path.iterdir())


def test_vertices_that_move_on_their_own_are_drawn_where_they_are():
    animation = swinging()
    count = len(animation.character.vertices)
    offsets = np.random.default_rng(0).normal(0, 0.1, (len(animation.motion), count, 3)).astype(np.float32)
    moved = PointAnimation(animation, offsets)
    times = np.array([0.0, 3.5, 6.0]) / animation.motion.fps
    drawn = list(frames_module._take(moved, times, "texture").frames())
    known = moved.vertices()
    np.testing.assert_allclose(drawn[0], known[0], atol=1e-5)
    np.testing.assert_allclose(drawn[1], (known[3] + known[4]) / 2, atol=1e-5)
    np.testing.assert_allclose(drawn[2], known[6], atol=1e-5)


@pytest.fixture(scope="module")
def bowing():
    turns = np.zeros((12, 22, 3))
    turns[:, 3, 0] = np.linspace(0, 0.8, 12)
    return RigAnimation(reference_body().character(), matrix_from_axis_angle(turns), np.zeros((12, 22, 3)))


def model_of(page, tmp_path):
    text = re.search(r'<script id="model" type="text/plain">([^<]*)</script>', page).group(1)
    (tmp_path / "model.glb").write_bytes(base64.b64decode(text))
    return load_animation(tmp_path / "model.glb", 0, 20)


def test_the_page_holds_all_that_it_shows(bowing, tmp_path):
    page = bowing.save(tmp_path / "bow.html", name="<b>bow</b>").read_text(encoding="utf-8")
    assert "<b>" not in page and "&lt;b&gt;bow&lt;/b&gt;" in page
    assert not re.search(r"""(src|href)=["']""", page) and page.count("</script>") == 2
    assert np.abs(model_of(page, tmp_path).vertices() - bowing.vertices()).max() < 1e-4
    points = PointAnimation(bowing.animation(), np.zeros((12, len(bowing.character.vertices), 3)))
    assert points.save(tmp_path / "points.html").stat().st_size > 100_000


def test_a_notebook_gets_a_view_and_of_large_models_a_picture(bowing, tmp_path, monkeypatch):
    shown = bowing._repr_html_()
    page = html.unescape(re.fullmatch(r'<iframe style="[^"]*" srcdoc="([^"]*)"></iframe>', shown).group(1))
    assert len(model_of(page, tmp_path).motion) == 12
    monkeypatch.setattr(saving, "LARGEST_VIEW", 1000)
    picture = bowing._repr_html_()
    assert picture.startswith("<img") and len(picture) < 1_000_000
    with pytest.raises(FormatError, match="larger than"):
        bowing.save(tmp_path / "large.html", most=1000)
    assert not (tmp_path / "large.html").exists()


def test_a_browser_draws_it(bowing, tmp_path):
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("needs Chromium")
    path = bowing.save(tmp_path / "bow.html")
    subprocess.run(
        [chromium, "--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
         "--virtual-time-budget=3000", "--window-size=400,300", f"--user-data-dir={tmp_path / 'profile'}",
         f"--screenshot={tmp_path / 'shot.png'}", path.as_uri()],
        capture_output=True, check=True, timeout=200,
    )  # fmt: skip
    pixels = np.asarray(Image.open(tmp_path / "shot.png").convert("RGB")).astype(int)
    middle = pixels[60:240, 120:280]
    assert np.abs(middle - [0xDF, 0xE4, 0xE9]).max(axis=-1).mean() > 3  # something stands there


def test_the_picture_stays_and_text_stands_below():
    picture = np.full((60, 200, 3), 90, np.uint8)
    short = page(picture, "dog", ["one line"])
    assert short.shape[1] == 200 and np.array_equal(short[:60], picture)
    assert (short[60:] < 128).any()
    long = page(picture, "dog", ["many words " * 30])
    assert len(long) > len(short)
    assert (long[-30:] < 128).any() and (long[:, -10:][60:] > 200).all()  # folded, and nothing runs over the edge
