"""The page's own unit tests: views, links, the timeline, undo, what it asks the server, panels."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

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
