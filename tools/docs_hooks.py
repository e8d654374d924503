"""Hooks of mkdocs: pages from elsewhere in the repository are taken into the site, and links to them lead there.

A page of docs/ links to the repository's files by "../"; those files come under repository/ in the site.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files, InclusionLevel

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md", "examples/README.md")
_UPWARDS = re.compile(r"\]\(\.\./([^)#]+)")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages of the repository, and every file that a page links to."""
    wanted = set(PAGES) | {path.relative_to(ROOT).as_posix() for path in (ROOT / "examples").glob("[0-9]*.py")}
    for page in (ROOT / "docs").glob("*.md"):
        found = (_target(name) for name in _UPWARDS.findall(page.read_text(encoding="utf-8")))
        wanted.update(name for name in found if (ROOT / name).is_file())
    for name in sorted(wanted):
        level = InclusionLevel.INCLUDED if name in PAGES else InclusionLevel.NOT_IN_NAV
        files.append(File.generated(config, f"repository/{name}", abs_src_path=str(ROOT / name), inclusion=level))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Make links between docs/ and the rest of the repository links of the site."""
    name = page.file.src_uri
    if "/" not in name:
        return _UPWARDS.sub(lambda link: f"](repository/{_target(link[1])}", markdown)
    if not name.startswith("repository/"):
        return markdown
    up = "../" * name.count("/")
    return re.sub(r"\]\((?:\.\./)*docs/", f"]({up}", markdown)


def _target(name: str) -> str:
    """The file that a link to a file or a folder means."""
    return f"{name.rstrip('/')}/README.md" if (ROOT / name).is_dir() else name
