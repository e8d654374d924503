"""The package: its face, its data, and the equations that docstrings cite."""

import ast
import importlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import bunraku

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("torch", "transformers", "diffusers", "trimesh", "av", "scipy", "igl", "pygltflib", "tyro", "rich", "numpy")


def loaded_after(code: str) -> set[str]:
    """Top-level modules that a fresh interpreter holds after this code."""
    script = f"{code}\nimport sys\nprint('\\n'.join({{name.split('.')[0] for name in sys.modules}}))"
    return set(
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    )


def test_import_is_light():
    assert not loaded_after("import bunraku").intersection(HEAVY)


def test_command_line_import_is_light():
    assert not loaded_after("from bunraku.cli import main\nmain(['--help'])").intersection(HEAVY)


def test_core_types_do_not_load_the_networks():
    heavy = {"torch", "transformers", "diffusers", "av", "trimesh"}
    assert not loaded_after("import bunraku\nbunraku.Character, bunraku.Animation, bunraku.HandleMotion").intersection(
        heavy
    )


@pytest.mark.parametrize("name", bunraku.__all__)
def test_public_name_resolves_and_is_documented(name):
    value = getattr(bunraku, name)
    assert name in dir(bunraku)
    if callable(value):
        assert value.__doc__ and value.__module__.startswith("bunraku.")


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'animte'"):
        _ = bunraku.animte


def test_every_error_is_a_bunraku_error():
    errors = importlib.import_module("bunraku.errors")
    for name in errors.__all__:
        assert not name.endswith("Error") or issubclass(getattr(errors, name), bunraku.BunrakuError)


def test_version_is_said_once():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["version"] == bunraku.__version__
    assert f"## {bunraku.__version__}" in (ROOT / "CHANGELOG.md").read_text()


def test_only_faces_list_what_is_public():
    """Elsewhere an underscore says what is private, so that a name is listed once."""
    faces = {"__init__.py", "errors.py"}
    for path in sorted((ROOT / "src").rglob("*.py")):
        listed = re.search(r"^__all__\b", path.read_text(), re.MULTILINE)
        assert path.name in faces or not listed, f"{path.relative_to(ROOT)} lists its names"


def test_extras_that_errors_name_exist():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for path in (ROOT / "src").rglob("*.py"):
        for extra in re.findall(r'MissingExtraError\("[^"]+", "([^"]+)"', path.read_text()):
            assert extra in extras, f"{path.name} names the extra '{extra}'"


def test_every_import_is_a_declared_dependency():
    """What the package imports anywhere, against what a plain install brings."""
    names = {"PIL": "pillow", "igl": "libigl", "mujoco": "mujoco-core"}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = {re.split(r"[<>=\[ ]", requirement)[0] for requirement in project["dependencies"]}
    used = set()
    for path in (ROOT / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                used |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                used.add(node.module.split(".")[0])
    used -= set(sys.stdlib_module_names) | {
        "bunraku",
        "bunraku_lab",
        "bpy",
        "mathutils",
    }  # the last two are Blender's own
    packages = {names.get(name, name.replace("_", "-")) for name in used}
    optional = {
        re.split(r"[<>=\[ ]", requirement)[0]
        for extra in ("clip", "compressed", "lab", "physics", "ray", "serve", "studio", "train", "usd")
        for requirement in project["optional-dependencies"][extra]
    }
    assert packages - declared <= optional  # used inside functions that say what is missing
    assert not declared - packages


def test_the_lock_fits_what_is_declared():
    """Every package that the image and CI install has one version there, within the bounds, and no host is named."""
    pins = {}
    for line in (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            name, version = re.fullmatch(r"([a-z0-9-]+)==([\w.+]+)", line).groups()
            assert pins.setdefault(name, version) == version
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    texts = [*project["dependencies"], *(text for name in ("dev", "studio", "compressed") for text in extras[name])]
    for text in texts:
        requirement = Requirement(text)
        name = canonicalize_name(requirement.name)
        if name not in ("bunraku", "torch"):
            assert requirement.specifier.contains(pins[name], prereleases=True), text
    assert all("<" in text for text in project["dependencies"])


def test_the_image_is_built_from_an_exact_base_with_the_lock():
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    bases = re.findall(r"^FROM (\S+)", text, re.MULTILINE)
    assert len(bases) == 2 and all(re.fullmatch(r"python:\d+\.\d+\.\d+-slim-\w+", base) for base in bases)
    assert "requirements.lock" in text and "requirements.lock" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


def test_the_api_page_has_every_public_name():
    page = set(
        re.findall(r"^::: bunraku\.(\w+)$", (ROOT / "docs" / "api.md").read_text(encoding="utf-8"), re.MULTILINE)
    )
    errors = {name for name in bunraku.__all__ if name.endswith("Error")}
    assert page - {"errors"} == {name for name in bunraku.__all__ if name != "__version__"} - errors


SOURCES = ROOT / "src"
TAG = re.compile(r"\[((?:TapMo|MMDMC) \d+)\]")
ROW = re.compile(r"^\| ((?:TapMo|MMDMC) \d+) \| [^|]+ \| `([\w/]+\.py)` \| `([\w.]+)` \|$", re.MULTILINE)


def homes():
    """(equation, file, function) of each mark in a docstring's first line."""
    found = []
    for path in SOURCES.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text if TAG.search(text) else "")
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
