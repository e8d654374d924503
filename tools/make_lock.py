"""Write requirements.lock: the versions that are installed here of everything that `bunraku[dev,studio,compressed]`
needs.

    .venv/bin/python tools/make_lock.py

It is a file of constraints: `pip install -c requirements.lock ...` takes these versions of what it installs anyway.
PyTorch is left out, whose build depends on the machine; the Makefile pins it.
"""

from __future__ import annotations

import tomllib
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

__all__ = ["locked_versions"]

ROOT = Path(__file__).resolve().parents[1]
HEAD = """\
# Versions that were tested together. tools/make_lock.py writes this file.
# Use: pip install -c requirements.lock ...
"""
EXTRAS = ("dev", "studio", "compressed")
LEFT_OUT = {"bunraku", "torch"}


def locked_versions() -> dict[str, str]:
    """Version by name of every package that is needed, with those that these need in turn."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = project["optional-dependencies"]
    texts = [*project["dependencies"], *(text for extra in EXTRAS for text in groups[extra])]
    waiting = [Requirement(text) for text in texts]
    found: dict[str, str] = {}
    seen: set[str] = set()
    while waiting:
        wanted = waiting.pop()
        name = canonicalize_name(wanted.name)
        if str(wanted) in seen:
            continue
        seen.add(str(wanted))
        if name == "bunraku":
            waiting += [Requirement(text) for extra in wanted.extras for text in groups[extra]]
        if name in LEFT_OUT:
            continue
        distribution = metadata.distribution(name)
        found[name] = distribution.version
        for text in distribution.requires or ():
            inner = Requirement(text)
            if inner.marker is None or any(
                inner.marker.evaluate({"extra": extra}) for extra in ("", *sorted(wanted.extras))
            ):
                waiting.append(inner)
    return dict(sorted(found.items()))


if __name__ == "__main__":
    lines = [f"{name}=={version}\n" for name, version in locked_versions().items()]
    (ROOT / "requirements.lock").write_text(HEAD + "".join(lines), encoding="utf-8")
