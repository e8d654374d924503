"""Run a command: from the words of the command line to a verb, and from an exception to a sentence and a status."""

from __future__ import annotations

import ast
import difflib
import importlib
import inspect
import io
import os
import sys
import textwrap
import traceback
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import fields, is_dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any, get_type_hints

from bunraku.errors import NotUnderstood, OptionError, is_fault, sentence_of

Verbs = dict[tuple[str, ...], tuple[str, str, str]]
"""Words -> module, its attribute that is the verb, one line of help."""

_TABLE = (
    ("animate", "animate", "Animate", "make a character do what a sentence says"),
    ("transfer", "transfer", "Transfer", "put an existing motion on a character, or many on many"),
    ("edit", "edit", "Edit", "keep a part of a clip and generate the rest"),
    ("rig", "rig", "Rig", "give a character its 30 handles as a skin, without motion"),
    ("merge", "edit", "Merge", "join the clips of one character from several files into one"),
    ("inspect", "inspect", "Inspect", "describe what a file holds"),
    ("render", "render", "Render", "make a video or a picture of an animated file, a character or a motion"),
    ("studio", "studio", "Studio", "open a page: drop a character, type a sentence, watch it move"),
    ("serve", "serving", "Serve", "let other programs call these tools, by MCP"),
    ("comfyui-nodes", "studio", "ComfyuiNodes", "write the nodes for ComfyUI, which call the studio"),
    ("godot-addon", "studio", "GodotAddon", "write the add-on for Godot 4, which calls the studio"),
    ("blender-addon", "studio", "BlenderAddon", "write the add-on for Blender, which calls the studio"),
    ("clips", "clips", "Clips", "list and search the clip library, or put a clip on a character"),
    ("samples", "clips", "Samples", "write the sample characters"),
    ("doctor", "doctor", "Doctor", "say what this installation has, what is missing, and what that costs"),
)
VERBS: Verbs = {(word,): (f"bunraku.cli.{module}", name, summary) for word, module, name, summary in _TABLE}

_GROUP = "bunraku.verbs"
"""Entry points by which other packages, the laboratory among them, add verbs."""


def all_verbs() -> Verbs:
    """The verbs of this package, then those that installed packages add."""
    from importlib.metadata import entry_points

    verbs = dict(VERBS)
    for entry in sorted(entry_points(group=_GROUP), key=lambda entry: entry.name):
        verbs |= {words: verb for words, verb in entry.load().items() if words not in VERBS}
    return verbs


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command, by default that of the process, and give its exit status: 0 done, 2 something that the user can
    fix, 130 interrupted, 1 a fault of Bunraku itself.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    debug = os.environ.get("BUNRAKU_DEBUG", "") not in ("", "0") or "--debug" in words
    words = [word for word in words if word != "--debug"]
    try:
        _repair_streams()
        status = _dispatch(words)
        sys.stdout.flush()
        return status
    except SystemExit as leave:  # the option parser has said what it had to say
        return leave.code if isinstance(leave.code, int) else 0 if leave.code is None else 2
    except BrokenPipeError:  # `bunraku inspect FILE | head`
        for stream in (sys.stdout, sys.stderr):  # what they still hold goes nowhere
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        return 141
    except KeyboardInterrupt:
        return _say_interrupted()
    except Exception as error:
        if isinstance(error.__cause__, KeyboardInterrupt):  # Python 3.11 wraps what `__set_name__` raises
            return _say_interrupted()
        if debug:
            traceback.print_exc()
        more = ", or go on with --force" if isinstance(error, NotUnderstood) else ""
        print(f"bunraku: error: {' '.join(sentence_of(error).split())}{more}", file=sys.stderr)
        return 1 if is_fault(error) else 2


def _say_interrupted() -> int:
    print("bunraku: interrupted", file=sys.stderr)
    return 130


def _repair_streams() -> None:
    """Let nothing that is printed fail: closed streams swallow it, and those of few letters escape the others."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 -- for the whole run
        elif isinstance(stream := getattr(sys, name), io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _dispatch(words: list[str]) -> int:
    if words[:1] == ["help"] and len(words) > 1:
        return _dispatch([*words[1:], "--help"])
    if not words or words[0] in ("-h", "--help", "help"):
        _print_help(all_verbs())
        return 0 if words else 2
    if words[0] in ("-V", "--version", "version"):
        from bunraku import __version__

        print(f"bunraku {__version__}")
        return 0
    verbs, verb = VERBS, tuple(words[:1])
    if verb not in verbs:
        verbs = all_verbs()
        group = {key: value for key, value in verbs.items() if key[0] == words[0]}
        if not group:
            if os.path.isfile(words[0]):
                raise OptionError(f"a command stands first; did you mean `bunraku animate {words[0]} ...`?")
            raise OptionError(_unknown("command", words[0], sorted({key[0] for key in verbs})))
        if len(words) < 2 or words[1] in ("-h", "--help"):
            _print_help(group, words[0])
            return 0 if len(words) > 1 else 2
        verb = tuple(words[:2])
        if verb not in verbs:
            raise OptionError(_unknown(f"'{words[0]}' command", words[1], [key[1] for key in group]))
    module, name, summary = verbs[verb]
    target: Any = getattr(importlib.import_module(module), name)
    # A verb is a dataclass with `run`, or a function that gives another module's dataclass and what to do with it.
    kind, action = target() if inspect.isfunction(target) else (target, target.run)
    return action(_parse(kind, verb, _joined(words[len(verb) :]), target.__doc__ or summary)) or 0


def _parse(kind: type, verb: tuple[str, ...], words: list[str], text: str) -> Any:
    import tyro

    prog = " ".join(("bunraku", *verb))
    if {"-h", "--help"} & set(words):
        _explain(kind)
    else:
        _check_options(kind, words, prog)
    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said):
            return tyro.cli(
                kind, prog=prog, args=words, description=_reflowed(text),
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.PositionalMetavarFromFieldName),
            )  # fmt: skip
    except SystemExit as left:
        if not left.code:
            print(said.getvalue(), end="")
            raise
    raise OptionError(f"{_first_part(said.getvalue())}; `{prog} --help` shows the options")


def _first_part(box: str) -> str:
    """What the option parser says first in its box: without the title, the texts of help that are set in, and all that
    follows a rule.
    """
    out: list[str] = []
    for line in box.splitlines()[1:]:
        row = line.strip("│|").rstrip()
        if not row.strip(" ─-") and out:
            break
        if row.strip(" ─-") and not row.startswith(" " * 9):
            out.append(row.strip())
    said = " ".join(out).rstrip(".").replace("Unrecognized options", "Not understood")
    for words, kind in (
        ("could not convert string to float:", ""),
        ("invalid literal for int() with base 10:", "whole "),
        ("no type matching {None}|FLOAT could be instantiated from", ""),
        ("no type matching {None}|INT could be instantiated from", "whole "),
    ):
        said = said.replace(words, f"a {kind}number is expected, not")
    return said[:1].lower() + said[1:].replace("not ['", "not '").replace("']", "'")


def _reflowed(text: str) -> str:
    """A docstring whose paragraphs are one line each."""
    return "\n\n".join(" ".join(part.split()) for part in text.strip().split("\n\n"))


def _explain(kind: Any) -> None:
    """Give the fields of a command, and of the dataclasses that it holds, their docstrings as texts of help whose
    paragraphs are one line each: the parser keeps the line breaks of docstrings that are indented.
    """
    texts: dict[str, str] = {}
    for parent in reversed([parent for parent in kind.__mro__ if is_dataclass(parent)]):
        body = ast.parse(textwrap.dedent(inspect.getsource(parent))).body[0].body  # type: ignore[attr-defined, arg-type]
        for above, node in pairwise(body):
            if isinstance(above, ast.AnnAssign) and isinstance(above.target, ast.Name) and isinstance(node, ast.Expr):
                texts[above.target.id] = _reflowed(ast.literal_eval(node.value))
    hints = get_type_hints(kind)
    for each in fields(kind):
        if is_dataclass(hints[each.name]):
            _explain(hints[each.name])
        elif each.name in texts:
            each.metadata = MappingProxyType({**each.metadata, "help": texts[each.name]})  # type: ignore[assignment]


def _check_options(kind: type, words: Sequence[str], prog: str) -> None:
    """Raise OptionError where an option is none, or one that takes one path is given twice; of other options the last
    counts, as usual in a shell.
    """
    given = [word.partition("=")[0].replace("_", "-") for word in words if word.startswith("-")]
    options = list(_options(kind))
    known = sorted({name for names, _ in options for name in names if name.startswith("--")})
    for name in given:
        if name.startswith("--") and name not in ("--", *known):
            close = difflib.get_close_matches(name[2:], [option[2:] for option in known], 1)
            hint = f"did you mean '--{close[0]}'?" if close else f"`{prog} --help` lists them"
            raise OptionError(f"there is no option '{name}'; {hint}")
    for names, single in options:
        repeated = [name for name in given if single and name in names]
        if len(repeated) > 1:
            raise OptionError(f"{repeated[-1]} is given {len(repeated)} times, and one is taken; leave the others out")


def _options(kind: Any) -> Iterator[tuple[set[str], bool]]:
    """The names of each option, and whether it takes one path, with the options of dataclasses that a verb holds."""
    import tyro

    hints = get_type_hints(kind, include_extras=True)
    for field in fields(kind) if is_dataclass(kind) else ():
        hint = hints[field.name]
        notes = getattr(hint, "__metadata__", ())
        if is_dataclass(getattr(hint, "__origin__", hint)):
            prefix = field.name.replace("_", "-")  # which the parser keeps where the command does not leave it out
            for names, single in _options(getattr(hint, "__origin__", hint)):
                yield names | {f"--{prefix}.{name[2:]}" for name in names if name.startswith("--")}, single
            continue
        names = {f"--{field.name.replace('_', '-')}"}
        for note in notes:
            names = {f"--{name}" for name in [getattr(note, "name", None)] if name} or names
            names |= set(getattr(note, "aliases", None) or ())
        yield names, "Path" in str(hint) and tyro.conf.UseAppendAction not in notes


def _joined(words: list[str]) -> list[str]:
    """`--up -z` as `--up=-z`; the parser would take the axis for an option."""
    out: list[str] = []
    for word in words:
        if out and out[-1] in ("--up", "--front") and len(word) == 2 and word[0] == "-":
            out[-1] += f"={word}"
        else:
            out.append(word)
    return out


def _unknown(kind: str, word: str, known: list[str]) -> str:
    close = difflib.get_close_matches(word, known, 1)
    hint = f"did you mean '{close[0]}'?" if close else f"there are {', '.join(known)}"
    return f"there is no {kind} '{word}'; {hint}"


def _print_help(verbs: Verbs, group: str = "") -> None:
    prefix = f"bunraku {group}".strip()
    print(f"usage: {prefix} COMMAND [options]\n")
    if not group:
        print("A sentence animates any character mesh.\n")
    shown = verbs if group else VERBS
    width = max(len(" ".join(verb)) for verb in shown)
    for verb, (_, _, summary) in shown.items():
        print(f"  {' '.join(verb):<{width}}  {summary}")
    if not group:
        research: dict[str, list[str]] = {}
        for verb in verbs.keys() - VERBS.keys():
            research.setdefault(verb[0], []).extend(verb[1:])
        if research:
            print("\nfor research, each with a list of its own (`bunraku help train`):")
        for word, names in sorted(research.items()):
            start = f"  {word:<{width}}  "
            wrap = textwrap.TextWrapper(100, start, " " * len(start), break_on_hyphens=False)
            print(wrap.fill(", ".join(sorted(names))))
        print("\n  --version  print the version\n  --debug    show the traceback of an error (or set BUNRAKU_DEBUG=1)")
        print(
            '\nexample: bunraku animate dragon.glb "walks forward, then waves" --seconds 6 -o dragon-wave.glb '
            "--preview dragon-wave.mp4"
        )
    print(f"\n`{prefix} COMMAND --help` shows the options of a command.")
