"""The committed page is what its sources give, and small enough."""

import gzip
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from bunraku.diffusion.generation.drawing import GUIDANCE, STEPS

ROOT = Path(__file__).resolve().parents[2]
STATIC = ROOT / "src" / "bunraku" / "studio" / "static"
VIEW = ROOT / "src" / "bunraku" / "render" / "view"


def test_the_script_is_small():
    total = sum(len(gzip.compress(path.read_bytes(), 9, mtime=0)) for path in (*STATIC.glob("*.js"), VIEW / "view.js"))
    assert 50_000 < total <= 250_000


def test_three_is_shipped_once():
    """The page takes what it needs of three.js from the view, which exports no more than that."""
    page, view = (
        (folder / name).read_text(encoding="utf-8") for folder, name in ((STATIC, "studio.js"), (VIEW, "view.js"))
    )
    (wanted,) = re.findall(r'import\{([^}]*)\}from"./view\.js"', page)
    (given,) = re.findall(r"export\{([^}]*)\};?\s*$", view)
    assert {name.split(" as ")[0] for name in wanted.split(",")} == {
        name.split(" as ")[-1] for name in given.split(",")
    }
    assert "WebGLRenderer:" not in page and all(len(path.read_bytes()) < 200_000 for path in STATIC.glob("*.js"))


def test_the_page_names_no_other_host():
    page = (STATIC / "index.html").read_text(encoding="utf-8")
    assert "//" not in page and "<style" not in page and " onload=" not in page
    assert "three 0." in (STATIC / "LICENSES.txt").read_text(encoding="utf-8")


def test_sliders_begin_at_the_guidance_and_the_steps_that_the_library_takes():
    text = (ROOT / "studio" / "src" / "takes.tsx").read_text(encoding="utf-8")
    found = {name: float(value) for name, value in re.findall(r"^const (GUIDANCE|STEPS) = ([0-9.]+);$", text, re.M)}
    assert found == {"GUIDANCE": GUIDANCE, "STEPS": STEPS}


def test_the_lock_file_names_no_registry():
    assert "resolved" not in (ROOT / "studio" / "package-lock.json").read_text(encoding="utf-8")


@pytest.mark.skipif(shutil.which("npm") is None, reason="there is no npm to build the studio's page with")
@pytest.mark.skipif(
    not (ROOT / "studio" / "node_modules" / "vite").is_dir(), reason="the page's tools are not installed: make studio"
)
def test_building_it_again_gives_the_same_bytes(tmp_path):
    subprocess.run(["npx", "tsc", "--noEmit"], cwd=ROOT / "studio", check=True, capture_output=True)
    subprocess.run(
        ["npx", "vite", "build", "--outDir", str(tmp_path / "static"), "--emptyOutDir"],
        cwd=ROOT / "studio", check=True, capture_output=True,
    )  # fmt: skip
    built = {path.name: path.read_bytes() for path in (tmp_path / "static").iterdir()}
    committed = {path.name: path.read_bytes() for path in STATIC.iterdir()}
    assert sorted(built) == sorted(committed)
    assert [name for name in built if built[name] != committed[name]] == []


@pytest.mark.skipif(
    not (ROOT / "studio" / "node_modules" / "vite").is_dir(), reason="the page's tools are not installed: make studio"
)
def test_building_the_view_again_gives_the_same_bytes(tmp_path):
    subprocess.run(
        ["npx", "vite", "build", "-c", "vite.view.config.js", "--outDir", str(tmp_path)],
        cwd=ROOT / "studio", check=True, capture_output=True,
    )  # fmt: skip
    assert {path.name for path in tmp_path.iterdir()} == {"view.js", "LICENSE-three.txt"}
    assert [path.name for path in tmp_path.iterdir() if path.read_bytes() != (VIEW / path.name).read_bytes()] == []
