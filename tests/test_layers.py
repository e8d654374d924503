"""The order of the rooms, stated here alone: a module imports only from rooms before its own, and no modules import
each other.

Every import counts: at the top, in a function, for the type checker, and as text, where a table names a module.
"""

import ast
import functools
import re
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "src"

LAYERS = (
    "errors", "core", "files", "language", "anatomy", "gestures", "retarget", "generation", "render", "apparel",
    "pipelines", "bunraku", "studio", "cli", "__main__",
)  # fmt: skip
"""Rooms of what a user runs, from the ground up. "bunraku" is the package's own face."""
LABORATORY = ("nn", "description", "synthetic", "baselines", "datasets", "training", "evaluation", "cli", "bunraku_lab")
"""Rooms of the laboratory, which stands on all of the other house."""
BUDGET = {
    "bunraku/errors": (46, 1),
    "bunraku/core": (3909, 29),  # arguments of public functions are checked, corrections by hand, the denoiser's layers
    "bunraku/files": (8423, 43),  # samples for the tasks page, long chains of bones
    "bunraku/language": (3328, 20),
    "bunraku/anatomy": (4310, 21),  # what stands beside a body, rigs known by their skin, corrections by hand
    "bunraku/gestures": (1810, 8),  # what is done once is made again, so that it fills its time
    "bunraku/retarget": (3497, 21),  # bones of MMD that take over others' rotations, swimming, clips of animals
    "bunraku/generation": (3128, 14),  # the verifier, candidates that fill their time
    "bunraku/render": (1301, 7),  # videos of takes side by side
    "bunraku/apparel": (4963, 28),
    "bunraku/pipelines": (2073, 11),  # a character that never stops, looks and reaches
    "bunraku/bunraku": (93, 1),
    "bunraku/studio": (3786, 24),  # Live, corrections by hand, bounds on every number of a record
    "bunraku/cli": (2775, 15),  # characters of a file to choose from, wrong options in one sentence
    "bunraku/__main__": (122, 1),
    "bunraku_lab/nn": (1239, 11),
    "bunraku_lab/description": (766, 5),
    "bunraku_lab/synthetic": (5940, 30),
    "bunraku_lab/baselines": (510, 3),
    "bunraku_lab/datasets": (3863, 21),  # volumes and registration of bodies, which only the laboratory needs now
    "bunraku_lab/training": (7321, 41),  # the pack of clips of animals
    "bunraku_lab/evaluation": (4220, 29),
    "bunraku_lab/cli": (745, 7),
    "bunraku_lab/bunraku_lab": (0, 1),
}
"""Lines of code and files that a room may have, by house and room. Raising a number takes one line and its reason."""
_NAMED = re.compile(r'"(bunraku(?:_lab)?(?:\.\w+)+)(?::\w+)?"')


def modules(sources):
    """Path of each module by its whole name."""
    found = {}
    for path in sorted(sources.rglob("*.py")):
        parts = path.relative_to(sources).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


class Facts(NamedTuple):
    """What a module says of itself."""

    named: set[tuple[str, str]]
    """Modules and what is taken of them: in import statements anywhere, and in text such as "bunraku.files.clips:x"."""
    packages: set[str]
    """What import statements name."""
    lines: int
    """Lines of code: without blank lines, comments and docstrings."""


def statements(body):
    """All statements of a body, those inside others too."""
    for node in body:
        yield node
        for inner in ("body", "orelse", "finalbody", "handlers", "cases"):
            yield from statements(getattr(node, inner, ()))


@functools.cache
def facts(path):
    """Facts of a file, which is parsed once for all tests."""
    text = path.read_text(encoding="utf-8")
    named, packages, prose = {(name, "") for name in _NAMED.findall(text)}, set(), set()
    for node in statements(ast.parse(text).body):
        if isinstance(node, ast.ImportFrom):
            packages.add(node.module or "")
            named |= {(node.module, alias.name) for alias in node.names if node.module and node.level == 0}
        elif isinstance(node, ast.Import):
            packages |= {alias.name for alias in node.names}
            named |= {(alias.name, "") for alias in node.names}
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            prose |= set(range(node.lineno, node.end_lineno + 1))
    lines = (line.strip() for number, line in enumerate(text.splitlines(), 1) if number not in prose)
    return Facts(named, packages, sum(bool(line) and not line.startswith("#") for line in lines))


def imports(path, known):
    """Modules among those that are known which a file names."""
    found = {f"{module}.{name}" if f"{module}.{name}" in known else module for module, name in facts(path).named}
    return found & known.keys()


@functools.cache
def arrows(sources):
    """What each module imports, by whole names."""
    known = modules(sources)
    return {name: imports(path, known) - {name} for name, path in known.items()}


def house(module):
    """The package of a module."""
    return module.split(".")[0]


def room(module):
    """The layer of a module."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else parts[0]


def climbing(found):
    """Imports of a room that stands later in the list, and those that leave the first house for the second."""
    position = {("bunraku", layer): number for number, layer in enumerate(LAYERS)}
    position |= {("bunraku_lab", layer): number for number, layer in enumerate(LABORATORY, len(LAYERS))}
    at = {name: position[house(name), room(name)] for name in found}
    return sorted(f"{one} -> {other}" for one, others in found.items() for other in others if at[other] > at[one])


def circles_of_folders(found):
    """Folders inside a room that import each other in a loop, a folder's own files being one of them."""
    inside = {}
    for one, others in found.items():
        for other in others:
            pair = one.split("."), other.split(".")
            depth = next((n for n, (a, b) in enumerate(zip(*pair, strict=False)) if a != b), None)
            if depth is None or depth < 2:
                continue  # a package and its own module, or two rooms
            ends = [".".join(parts[: depth + 1]) if len(parts) > depth + 1 else "its own files" for parts in pair]
            if ends[0] != ends[1]:
                graph = inside.setdefault(".".join(pair[0][:depth]), {})
                graph.setdefault(ends[0], set()).add(ends[1])
                graph.setdefault(ends[1], set())
    return {folder: loops for folder, graph in inside.items() if (loops := circles(graph))}


def circles(found):
    """Groups of modules that import each other in a loop (Tarjan 1972)."""
    index, low, stack, groups = {}, {}, [], []

    def visit(node):
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(found[node]):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            group = [stack.pop()]
            while group[-1] != node:
                group.append(stack.pop())
            if len(group) > 1:
                groups.append(sorted(group))

    for node in sorted(found):
        if node not in index:
            visit(node)
    return groups


def test_every_room_is_in_the_list():
    found = {(house(name), room(name)) for name in modules(SOURCES)}
    assert found == {("bunraku", name) for name in LAYERS} | {("bunraku_lab", name) for name in LABORATORY}


def test_nothing_imports_what_stands_above_it():
    assert climbing(arrows(SOURCES)) == []


def test_no_modules_import_each_other_in_a_circle():
    assert circles(arrows(SOURCES)) == []


def test_all_others_import_files_by_its_face():
    past = [
        f"{name} -> {other}"
        for name, others in arrows(SOURCES).items()
        if not name.startswith("bunraku.files")
        for other in sorted(others)
        if other.startswith("bunraku.files.")
    ]
    assert past == []


def test_the_face_of_files_names_what_type_checkers_see():
    import bunraku.files

    tree = ast.parse(Path(bunraku.files.__file__).read_text(encoding="utf-8"))
    seen = {
        alias.name: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module.startswith("bunraku.files.")
        for alias in node.names
    }
    assert seen == bunraku.files._HOME
    assert all(hasattr(bunraku.files, name) for name in bunraku.files.__all__)


def test_nothing_that_a_user_runs_names_the_laboratory():
    found = arrows(SOURCES)
    assert [
        name for name in found if house(name) == "bunraku" and any(house(o) != "bunraku" for o in found[name])
    ] == []
    texts = [path for path in (SOURCES / "bunraku").rglob("*.py") if "bunraku_lab" in path.read_text(encoding="utf-8")]
    assert texts == []


def test_nothing_that_a_user_runs_imports_torch_or_libigl():
    assert [
        path
        for path in modules(SOURCES / "bunraku").values()
        for name in facts(path).packages
        if name.partition(".")[0] in ("torch", "igl") or name == "safetensors.torch"
    ] == []


def test_no_folders_of_a_room_import_each_other_in_a_circle():
    assert circles_of_folders(arrows(SOURCES)) == {}


def sizes(sources):
    """Lines of code and files of each room, by "house/room"."""
    found = {}
    for name, path in modules(sources).items():
        key = f"{house(name)}/{room(name)}"
        lines, files = found.get(key, (0, 0))
        found[key] = lines + facts(path).lines, files + 1
    return found


def test_every_room_keeps_its_budget():
    found = sizes(SOURCES)
    assert found.keys() == BUDGET.keys()
    over = {
        key: (found[key], most) for key, most in BUDGET.items() if found[key][0] > most[0] or found[key][1] > most[1]
    }
    assert over == {}


def test_lines_of_code_are_counted_without_prose(tmp_path):
    path = tmp_path / "one.py"
    prose = '"""Module.\n\nMore.\n"""\n\n# why\nX = 1\n"""What X is."""\n'
    path.write_text(prose + '\n\ndef f():\n    """Doc."""\n    return """text\nmore"""\n')
    assert facts(path).lines == 4


def test_the_docs_print_the_list():
    text = (ROOT / "docs" / "how-it-works.md").read_text(encoding="utf-8")
    assert re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE) == [*LAYERS, *LABORATORY]


@pytest.mark.parametrize(
    ("module", "line", "offence"),
    [
        ("core/low.py", "from bunraku.files.high import load", "bunraku.core.low -> bunraku.files.high"),
        ("core/low.py", "def f():\n    import bunraku.files.high", "bunraku.core.low -> bunraku.files.high"),
        ("core/low.py", 'TABLE = ("bunraku.files.high:load",)', "bunraku.core.low -> bunraku.files.high"),
        (
            "core/low.py",
            "if TYPE_CHECKING:\n    from bunraku.files import high",
            "bunraku.core.low -> bunraku.files.high",
        ),
    ],
)
def test_a_planted_import_is_found(tmp_path, module, line, offence):
    for name, text in ((module, line), ("files/high.py", ""), ("files/__init__.py", ""), ("__init__.py", "")):
        path = tmp_path / "bunraku" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    found = arrows(tmp_path)
    assert climbing(found) == [offence] and circles(found) == []
    (tmp_path / "bunraku" / "files" / "high.py").write_text("from bunraku.core.low import f")
    facts.cache_clear()
    assert circles(arrows.__wrapped__(tmp_path)) == [["bunraku.core.low", "bunraku.files.high"]]
