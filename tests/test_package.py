"""The package as a whole: light to import, complete in what it promises, and its version said once."""

import ast
import importlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import bunraku

ROOT = Path(__file__).resolve().parents[1]
HEAVY = (
    "torch",
    "transformers",
    "diffusers",
    "trimesh",
    "av",
    "scipy",
    "igl",
    "pygltflib",
    "tyro",
    "rich",
    "numpy",
)


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
        assert issubclass(getattr(errors, name), bunraku.BunrakuError)


def test_version_is_said_once():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["version"] == bunraku.__version__
    assert f"## {bunraku.__version__}" in (ROOT / "CHANGELOG.md").read_text()


def test_every_module_says_what_is_public():
    """Each module with public names has an `__all__`; found by reading, so that nothing heavy is imported."""
    for path in sorted((ROOT / "src").rglob("*.py")):
        text = path.read_text()
        if path.name != "__main__.py" and re.search(r"^(?:def|class) [A-Za-z]", text, re.MULTILINE):
            assert re.search(r"^__all__\b", text, re.MULTILINE), f"{path.relative_to(ROOT)} has no __all__"


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


def test_the_api_page_has_every_public_name():
    page = set(
        re.findall(r"^::: bunraku\.(\w+)$", (ROOT / "docs" / "api.md").read_text(encoding="utf-8"), re.MULTILINE)
    )
    errors = {name for name in bunraku.__all__ if name.endswith("Error")}
    assert page - {"errors"} == {name for name in bunraku.__all__ if name != "__version__"} - errors
