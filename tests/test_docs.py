"""The documentation: short, in plain English, complete in the site's list, and as its tools write it."""

import importlib.util
import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def tool(name):
    """A script of tools/ as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "tools" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


prose = tool("prose")
DOCS = sorted((ROOT / "docs").rglob("*.md"))
PAGES = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")] + DOCS
CARDS = sorted((ROOT / "src").rglob("weights/*.md"))
WORDS = 32_000
"""Of all pages together, as `wc -w` counts."""
HISTORY = 3_000


def words(path):
    return len(path.read_text(encoding="utf-8").split())


def test_the_documentation_is_short():
    assert sum(map(words, PAGES)) <= WORDS
    assert words(ROOT / "docs" / "history.md") <= HISTORY


@pytest.mark.parametrize("path", [*PAGES, ROOT / "SECURITY.md", *CARDS], ids=lambda path: path.name)
def test_who_follows_a_noun(path):
    assert prose.stumbles(prose.markdown_text(path)) == []


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("Only who walks does so.", 1),
        ("Who sits down gets up.", 1),
        ("It is done. Who falls stays down.", 1),
        ("arms of who lies, and legs as who walks", 2),
        ("for whom it may concern", 1),
        ("people by whom gestures are performed", 0),
        ("whoever turns, and nobody runs", 2),
        ("- who tabs", 1),
        ("a person who walks, people who sit, those who pass it on", 0),
        ("A character, who sits, stands up.", 0),
        ("Who is it? A person.", 0),
    ],
)
def test_stumbles_are_found(text, count):
    assert len(prose.stumbles(text)) == count


WORDINGS = ROOT / "src" / "bunraku_lab" / "description" / "captions.py"
"""Holds the ways in which people word a caption, "somebody" among them."""


@pytest.mark.parametrize("house", ["bunraku", "bunraku_lab"])
def test_texts_of_the_code_are_as_plain(house):
    paths = sorted(path for path in (ROOT / "src" / house).rglob("*.py") if path != WORDINGS)
    found = [
        (path.name, line, bad)
        for path in paths
        for line, text in prose.source_texts(path)
        for bad in prose.stumbles(text)
    ]
    assert found == []


def test_texts_of_a_module(tmp_path):
    path = tmp_path / "module.py"
    path.write_text('"""Moves who walks."""\nVALUE = 1  # of who sits\n"""For who stands."""\n')
    texts = [text for _, text in prose.source_texts(path)]
    assert [len(prose.stumbles(text)) for text in texts] == [1, 1, 1]
    page = tmp_path / "page.md"
    page.write_text("A page\n\n```sh\nwho -a\n```\n\nand `who walks`.\n")
    assert prose.stumbles(prose.markdown_text(page)) == []


NO_ORIGIN = 60
"""Module-level numbers with decimals that may lack a word on where they come from."""


def test_numbers_say_where_they_come_from(tmp_path):
    constants = tool("constants")
    assert len(missing := constants.without_origin(ROOT / "src")) <= NO_ORIGIN, missing
    path = tmp_path / "module.py"
    path.write_text(
        '# Chosen by eye.\nA = 0.5\nB = 0.25  # of it\n\nC = 2.0\nD = (1, 0.5)\n\nE = 1e-3\n"""Measured."""\n'
    )
    assert constants.without_origin(tmp_path) == [f"{path}:6: D"]


def test_the_site_lists_every_page():
    listed = re.findall(r": ([\w/-]+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    own = sorted(name for name in listed if not name.startswith("repository/"))
    assert own == sorted(path.relative_to(ROOT / "docs").as_posix() for path in DOCS)


def test_links_lead_to_headings_that_exist():
    headings = {path.resolve(): set(anchors(path)) for path in [*PAGES, *CARDS]}
    for path in headings:
        for link, anchor in re.findall(r"\]\(([^)#:]*)#([^)]+)\)", path.read_text(encoding="utf-8")):
            target = (path.parent / link).resolve() if link else path
            assert anchor in headings.get(target, {anchor}), f"{path.name} links to {link}#{anchor}"


def anchors(path):
    """Headings of a page as links name them."""
    for heading in re.findall(r"^#+ (.+)$", path.read_text(encoding="utf-8"), re.MULTILINE):
        yield re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", heading.lower()).strip())


def test_pages_of_figures_are_what_their_tool_writes():
    page = tool("make_tables_page")
    kept = json.loads((ROOT / "docs" / "tables.json").read_text(encoding="utf-8"))
    sections = json.loads((ROOT / "docs" / "measurements.json").read_text(encoding="utf-8"))["sections"]
    assert (ROOT / "docs" / "tables.md").read_text(encoding="utf-8") == page.page(kept["tables"])
    assert (ROOT / "docs" / "measurements.md").read_text(encoding="utf-8") == page.measurements_page(sections)
    for table in (table for section in sections for table in section["tables"]):
        assert {len(row) for row in table["rows"]} == {len(table["columns"])}, table["title"]
        assert table["conclusion"].endswith(".") and table["command"] and table["date"]
