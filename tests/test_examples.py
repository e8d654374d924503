"""Each example runs to its end, where its own check stands."""

import ast
import runpy
import sys
from pathlib import Path

import pytest

import bunraku
from bunraku.core.nn.checkpoints import shipped_checkpoint

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("[0-9]*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path, tmp_path, monkeypatch, capsys):
    for name in ("handles", "diffusion"):
        try:
            shipped_checkpoint(name)
        except bunraku.WeightsError as error:
            pytest.skip(str(error))
    monkeypatch.setattr(sys, "argv", [str(path), str(tmp_path)])
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")  # in this process, which loads the networks once for all
    assert capsys.readouterr().out.strip()


def test_examples_are_numbered_listed_and_checked():
    assert [int(path.name[:2]) for path in EXAMPLES] == list(range(1, len(EXAMPLES) + 1))
    listed = (ROOT / "examples" / "README.md").read_text()
    for path in EXAMPLES:
        tree = ast.parse(path.read_text())
        assert ast.get_docstring(tree) and path.name in listed
        assert isinstance(tree.body[-1], ast.Assert), f"{path.name} does not end in a check"
