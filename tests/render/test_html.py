"""The page that shows an animation, and what a notebook gets."""

import base64
import html
import re
import shutil
import subprocess

import numpy as np
import pytest
from PIL import Image

import bunraku.core.saving as saving
from bunraku.body.reference import reference_body
from bunraku.core.point_animation import PointAnimation
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import FormatError
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.io.play import load_animation


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


def test_a_sheet_has_as_many_pictures(bowing, tmp_path):
    (tmp_path / "sheet.png").write_bytes(bowing.sheet(4, columns=2))
    one = Image.open(tmp_path / "sheet.png")
    assert one.width < one.height and one.width > 400


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
