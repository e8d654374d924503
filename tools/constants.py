"""Module-level numbers with decimals that do not say where they come from.

    python tools/constants.py FOLDER ...

prints each with its file and line. A number says it in the text after it, in a comment on its lines or directly above,
or in the comment at the head of its block, which begins at the last blank line.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ORIGIN = re.compile(
    r"by eye|measured|fitted|median|tried|chosen (on|in|with)|set on|trained|goal|paper|et al\.|\b(19|20)\d\d\b|"
    r"defin|standard|specification|published|float32|Bullet|MuJoCo|MakeHuman",
    re.IGNORECASE,
)
"""What a note says that names a measurement, a source, a standard, a rounding, a goal, or a choice by eye."""


def constants(path: Path) -> Iterator[tuple[int, str, str]]:
    """Line, name and notes of each module-level value that has a float with decimals in it."""
    text = path.read_text(encoding="utf-8")
    lines, body = text.splitlines(), ast.parse(text).body
    for node, after in zip(body, [*body[1:], None], strict=False):
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and _has_decimals(node.value):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            notes = _comments(lines, node.lineno - 1)
            notes += [line.partition("#")[2] for line in lines[node.lineno - 1 : node.end_lineno]]
            if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                notes.append(str(after.value.value))
            yield node.lineno, ast.unparse(target), " ".join(" ".join(notes).replace("#", " ").split())


def _has_decimals(value: ast.expr) -> bool:
    return any(
        isinstance(part, ast.Constant) and isinstance(part.value, float) and not part.value.is_integer()
        for part in ast.walk(value)
    )


def _comments(lines: list[str], first: int) -> list[str]:
    """Comments directly above a line (counted from 0), and those at the head of its block."""
    head = first
    while head and lines[head - 1].strip():
        head -= 1
    above = first
    while above > head and lines[above - 1].startswith("#"):
        above -= 1
    below = head
    while below < first and lines[below].startswith("#"):
        below += 1
    return lines[head:below] + lines[above:first]


def without_origin(root: Path) -> list[str]:
    """File, line and name of each number without one."""
    return [
        f"{path}:{line}: {name}"
        for path in sorted(root.rglob("*.py"))
        for line, name, notes in constants(path)
        if not ORIGIN.search(notes)
    ]


def main() -> None:
    for name in sys.argv[1:]:
        print(*without_origin(Path(name)), sep="\n")


if __name__ == "__main__":
    main()
