"""Phrases that a reader stumbles over: "who" without a noun before it, and people without a name.

    python tools/prose.py FILE_OR_FOLDER ...

prints those of Markdown pages and of the docstrings, comments and messages of Python modules.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

_NOUNS = """
    animator animators artist artists author authors character characters child children contributor contributors
    describer describers developer developers everyone he judge judges maker makers man men one ones participant
    participants people person persons player players reader readers rigger riggers scorer she stranger strangers those
    user users viewer viewers woman women writer writers you
"""
NOUNS = frozenset(_NOUNS.split())
"""Words that "who" may follow."""
VAGUE = frozenset({"somebody", "nobody", "whoever", "whomever"})
"""Words that are never used."""
PREPOSITIONS = frozenset({"at", "by", "for", "from", "of", "on", "to", "with"})
"""Words that may stand between the noun and "whom"."""
_MARKS = "\"'`*_()[]{}<>|,.;:!?…“”‘’"
_ENDS = (".", "!", "?", ":", ";")


def stumbles(text: str) -> list[str]:
    """Phrases in running text that say "who" without a noun, or name people vaguely.

    A question ("Who is it?") may begin with the word.
    """
    words = text.split()
    found = []
    for index, word in enumerate(words):
        bare = word.strip(_MARKS).lower().removesuffix("'s")
        before = words[index - 1] if index else ""
        if bare == "whom" and before.lower() in PREPOSITIONS:  # "people by whom"
            before = words[index - 2] if index > 1 else ""
        if bare in VAGUE or (bare in ("who", "whom") and not _has_noun(before) and not _asks(before, words[index:])):
            found.append(" ".join(words[max(index - 3, 0) : index + 4]))
    return found


def _has_noun(before: str) -> bool:
    """Whether the word before "who" is a noun of the same sentence."""
    return not before.endswith(_ENDS) and before.strip(_MARKS).lower() in NOUNS


def _asks(before: str, words: list[str]) -> bool:
    """Whether "who" begins a question."""
    if before.strip(_MARKS + "-#") and not before.endswith(_ENDS):
        return False
    end = next((word for word in words if word.rstrip("\"'`*)”").endswith((".", "!", "?"))), "")
    return end.rstrip("\"'`*)”").endswith("?")


def markdown_text(path: Path) -> str:
    """The running text of a page: no code, inline or in blocks."""
    lines, code = [], False
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.lstrip().startswith("```"):
            code = not code
        elif not code:
            lines.append("".join(part for index, part in enumerate(line.split("`")) if index % 2 == 0))
    return "\n".join(lines)


def source_texts(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of each docstring, message, help and comment of a module."""
    text = path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.lineno, node.value
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string.lstrip("# ")


def main() -> None:
    for name in sys.argv[1:]:
        root = Path(name)
        for path in [root] if root.is_file() else sorted(each for each in root.rglob("*") if each.is_file()):
            if path.suffix == ".md":
                texts = iter([(1, markdown_text(path))])
            elif path.suffix == ".py":
                texts = source_texts(path)
            else:
                continue
            for line, text in texts:
                for phrase in stumbles(text):
                    print(f"{path}:{line}: {phrase}")


if __name__ == "__main__":
    main()
