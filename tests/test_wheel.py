"""The built wheel, not only the source tree: all that is needed is in it, nothing else is, and it runs."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import bunraku

pytest.importorskip("hatchling", reason="hatchling builds the wheel; make develop brings it")
ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (path,) = folder.glob("*.whl")
    return path


def test_wheel_holds_every_file_of_the_package(wheel):
    assert wheel.name == f"bunraku-{bunraku.__version__}-py3-none-any.whl"
    names = set(zipfile.ZipFile(wheel).namelist())
    for path in (ROOT / "src").rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts and path.suffix != ".pyc":
            left_out = path.is_relative_to(ROOT / "src/bunraku_lab/weights") or path.name == "coarse_samples.npz"
            assert (path.relative_to(ROOT / "src").as_posix() in names) != left_out
    assert all(
        name.startswith(("bunraku/", "bunraku_lab/", f"bunraku-{bunraku.__version__}.dist-info/")) for name in names
    )
    assert not any(name.endswith((".pyc", ".part", ".tmp")) for name in names)
    assert all(any(name.endswith(f"licenses/{text}") for name in names) for text in ("LICENSE", "NOTICE"))
    assert wheel.stat().st_size < 80e6


def test_unpacked_wheel_runs(wheel, tmp_path):
    """From another folder, with the wheel's files before everything else."""
    site = tmp_path / "site"
    zipfile.ZipFile(wheel).extractall(site)
    environment = os.environ | {"PYTHONPATH": str(site)}

    def run(*words: str) -> str:
        return subprocess.run(
            [sys.executable, *words], check=True, capture_output=True, text=True, cwd=tmp_path, env=environment
        ).stdout

    assert Path(run("-c", "import bunraku; print(bunraku.__file__)").strip()).is_relative_to(site)
    run("-m", "bunraku", "samples", "mushroom", "-o", str(tmp_path / "out"))
    facts = json.loads(run("-m", "bunraku", "inspect", str(tmp_path / "out" / "mushroom.glb"), "--json"))
    assert facts["vertices"] > 1000
