"""A notebook that is run by Jupyter's own client and kernel: bars while it works, a view of what was made."""

import json
import os
import sys

import pytest

nbclient = pytest.importorskip("nbclient")
nbformat = pytest.importorskip("nbformat")
pytest.importorskip("ipykernel")

from bunraku.pipelines.animator import cell_progress  # noqa: E402

CELL = """
import bunraku
animation = bunraku.animate(bunraku.sample_character("mushroom"), "waves", seconds=1, steps=4, candidates=1)
animation
"""


def test_a_cell_shows_bars_and_the_animation(tmp_path, monkeypatch):
    kernel = tmp_path / "kernels" / "here"
    kernel.mkdir(parents=True)
    argv = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
    (kernel / "kernel.json").write_text(json.dumps({"argv": argv, "display_name": "here", "language": "python"}))
    monkeypatch.setenv("JUPYTER_PATH", str(tmp_path) + os.pathsep + os.environ.get("JUPYTER_PATH", ""))
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(CELL)])
    nbclient.NotebookClient(book, kernel_name="here", timeout=500).execute()
    outputs = [output for output in book.cells[0].outputs if "data" in output]
    assert "<progress" in outputs[0]["data"]["text/html"]
    assert outputs[-1]["data"]["text/html"].startswith("<iframe")


def test_elsewhere_there_are_none():
    assert cell_progress() is None
