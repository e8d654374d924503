"""A quick start leaves nothing out: modules that wait run when they are touched, and are then as they always were."""

import subprocess
import sys

import pytest

from bunraku.__main__ import LAZY_MODULES, LAZY_PARTS, QUICK
from bunraku.cli.app import VERBS


def run(code):
    """What a fresh interpreter prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_quick_commands_exist():
    assert set(QUICK) <= {verb[0] for verb in VERBS}


def test_modules_wait_and_are_whole_once_they_are_touched():
    names = sorted(LAZY_MODULES)
    code = f"""
import importlib, sys
from bunraku.__main__ import lazy_imports
lazy_imports(["animate"])
import numpy, scipy.spatial
assert type(scipy.spatial).__name__ == "Lazy"
scipy.spatial.Delaunay
waiting = [name for name in {names!r} if type(sys.modules.get(name)).__name__ == "Lazy"]
assert "scipy.spatial.transform" in waiting, waiting
assert numpy.ones(3).sum() == 3
assert "scipy.spatial.transform" in [name for name in waiting if type(sys.modules[name]).__name__ == "Lazy"]
from scipy.spatial.transform import Rotation
assert Rotation.identity().magnitude() == 0
for name in {names!r}:
    dir(importlib.import_module(name))
for name in {names!r}:  # again, since they enter their parts into each other
    print(name, sorted(dir(sys.modules[name])))
    assert type(sys.modules[name]).__name__ == "module", name
"""
    plain = f"""
import importlib, numpy, scipy.spatial
for name in {names!r}:
    print(name, sorted(dir(importlib.import_module(name))))
"""
    quick, ordinary = (dict(line.split(" ", 1) for line in run(one).splitlines()) for one in (code, plain))
    assert set(quick) == set(names)
    for name in names:
        assert set(eval(ordinary[name])) <= set(eval(quick[name])), name


def test_parts_are_had_without_their_packages_and_are_the_same():
    code = f"""
import importlib, sys
from bunraku.__main__ import lazy_imports
lazy_imports(["animate"])
import scipy.sparse
places = [name.rpartition(".")[::2] for name in {list(LAZY_PARTS)!r}]
early = {{place: getattr(importlib.import_module(place[0]), place[1]) for place in places}}
packages = sorted({{package for package, _ in places}})
assert all(type(sys.modules[name]).__name__ == "Lazy" for name in packages), packages
assert "scipy.linalg" not in sys.modules and "scipy.special" not in sys.modules
for name in packages:
    dir(sys.modules[name])
    assert type(sys.modules[name]).__name__ == "module", name
for (package, name), one in early.items():
    assert getattr(sys.modules[package], name) is one, name
"""
    run(code)


def test_a_name_that_is_not_there_is_an_attribute_error():
    assert run(
        "from bunraku.__main__ import lazy_imports; lazy_imports(['rig'])\nimport scipy.spatial\n"
        "try: scipy.spatial.transform.nothing_of_the_kind\nexcept AttributeError as error: print(error)"
    ).endswith("no attribute 'nothing_of_the_kind'")


def test_other_commands_load_all():
    code = "import sys; from bunraku.__main__ import lazy_imports\nprint(len(sys.meta_path))\n"
    for words in (["train", "handles"], ["evaluate", "motion"], ["--help"], []):
        code += f"lazy_imports({words!r}); print(len(sys.meta_path))\n"
    assert len(set(run(code).split())) == 1


@pytest.mark.parametrize("words, status", [(["inspect", "nowhere.glb"], 2), (["samples", "--help"], 0)])
def test_the_exit_status_and_what_was_said_survive(words, status):
    done = subprocess.run([sys.executable, "-m", "bunraku", *words], capture_output=True, text=True)
    assert done.returncode == status and (done.stdout or done.stderr).strip()
