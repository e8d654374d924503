"""The table of equations, held to the docstrings."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "src"
TAG = re.compile(r"\[((?:TapMo|MMDMC) \d+)\]")
ROW = re.compile(r"^\| ((?:TapMo|MMDMC) \d+) \| [^|]+ \| `([\w/]+\.py)` \| `([\w.]+)` \|$", re.MULTILINE)


def homes():
    """(equation, file, function) of each mark in a docstring's first line."""
    found = []
    for path in SOURCES.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        scopes = [(node, "") for node in tree.body]
        scopes += [
            (member, f"{node.name}.") for node in tree.body if isinstance(node, ast.ClassDef) for member in node.body
        ]
        for node, prefix in scopes:
            if isinstance(node, ast.FunctionDef):
                first = (ast.get_docstring(node) or "").split("\n")[0]
                found += [(tag, path.relative_to(SOURCES).as_posix(), prefix + node.name) for tag in TAG.findall(first)]
    return found


def test_each_equation_has_the_home_that_the_table_says():
    table = ROW.findall((ROOT / "docs" / "equations.md").read_text(encoding="utf-8"))
    assert sorted(homes()) == sorted(table)
    equations = [tag for tag, _, _ in table]
    assert len(set(equations)) == len(equations)
    assert {f"TapMo {number}" for number in range(1, 15)} <= set(equations)


def test_marks_stand_nowhere_else():
    marks = sum(len(TAG.findall(path.read_text(encoding="utf-8"))) for path in SOURCES.rglob("*.py"))
    assert marks == len(homes())
