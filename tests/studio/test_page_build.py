"""The studio's page as it is built, its units, and the server over HTTP."""

import gzip
import os
import re
import shutil
import subprocess
import time
from pathlib import Path

import httpx2 as httpx
import pytest

from bunraku.files.clips import load_animation
from bunraku.files.samples import sample_character
from bunraku.generation.candidates import GUIDANCE, STEPS

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


def test_no_modules_of_the_page_import_each_other_in_a_circle():
    """Imports of types count too."""
    sources = [path for path in (ROOT / "studio" / "src").iterdir() if path.suffix in (".ts", ".tsx")]
    imports = {
        path.name.partition(".")[0]: set(re.findall(r'from "\./([\w-]+)"', path.read_text(encoding="utf-8")))
        for path in sources
    }
    assert imports["main"]
    left = dict(imports)
    while leaves := [name for name, others in left.items() if not others & left.keys()]:
        for name in leaves:
            del left[name]
    assert not left


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


STUDIO = Path(__file__).resolve().parents[2] / "studio"


@pytest.mark.skipif(shutil.which("npx") is None, reason="there is no npm to run the page's unit tests with")
@pytest.mark.skipif(
    not all((STUDIO / "node_modules" / name).is_dir() for name in ("vitest", "happy-dom")),
    reason="the page's tools are not installed: make studio",
)
def test_units_of_the_page():
    ran = subprocess.run(
        ["npx", "vitest", "run"], cwd=STUDIO, capture_output=True, text=True, env={**os.environ, "NO_COLOR": "1"},
        check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout + ran.stderr


@pytest.fixture
def client(studio):
    base, _, token = studio.address.partition("/#token=")
    with httpx.Client(base_url=f"{base}/api", headers={"authorization": f"Bearer {token}"}, timeout=60) as one:
        yield one


def test_a_sentence_from_a_client_to_a_moving_character(client, tmp_path):
    from bunraku import save_character

    mesh = save_character(sample_character("mushroom"), tmp_path / "mushroom.glb")
    made = client.post("/characters", params={"name": "mushroom.glb"}, content=mesh.read_bytes()).json()
    asked = {"script": [{"text": "waves", "seconds": 1}], "seeds": [1], "steps": 4, "candidates": 1, "draft": False}
    ended(client, made["job"])
    begun = client.post(f"/characters/{made['character']['id']}/takes", json=asked).json()
    ended(client, begun["job"])
    file = client.post(f"/takes/{begun['takes'][0]}/exports", json={"format": "fbx", "fps": 30}).json()
    ended(client, file["job"])
    (tmp_path / "wave.fbx").write_bytes(client.get(f"/exports/{file['export']}").content)
    assert load_animation(tmp_path / "wave.fbx", 0, 30).vertices().std(axis=0).max() > 0


def ended(client, job):
    end = time.monotonic() + 300
    while (found := client.get(f"/jobs/{job}").json())["state"] in ("waiting", "running"):
        assert time.monotonic() < end
        time.sleep(0.2)
    assert found["state"] == "done", found


def test_the_document_names_every_route_and_what_it_reads(client, studio):
    document = client.get("/openapi.json").json()
    assert document["openapi"] == "3.1.0" and "/openapi.json" in document["paths"]
    from bunraku.studio.routes import characters, general, takes
    from bunraku.studio.routes import general as files
    from bunraku.studio.routes import general as library

    rooms = (characters, files, general, library, takes)
    known = {(path, method.lower()) for room in rooms for path, methods, _ in room.ROUTES for method in methods}
    told = {(path, method) for path, entry in document["paths"].items() for method in entry}
    assert known <= told and len(told) == len(known) + 1
    assert all(entry["summary"] for path in document["paths"].values() for entry in path.values())
    body = document["paths"]["/characters/{name}/takes"]["post"]["requestBody"]["content"]["application/json"]["schema"]
    assert {"script", "seeds", "loop"} <= set(body["properties"])
    assert not re.search(r"object at 0x", str(document))
    assert httpx.get(str(client.base_url) + "openapi.json").status_code in (401, 403)
