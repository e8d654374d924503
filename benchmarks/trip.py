"""What one run of a command travels through: files, calls, and what is worked out twice.

    python benchmarks/trip.py [--tree ../other] [--runs animate-person transfer] [-o outputs/trip.json]

Each run is a process of its own that plays a real command under `sys.setprofile`; `--tree` names another checkout to
look at. Counted are calls of the interpreter in `bunraku` and `bunraku_lab`: functions, comprehensions, and each step
of a generator, but no bodies of modules and classes.

| column | meaning |
| --- | --- |
| files | files of the two packages in which a call was counted |
| calls | all calls counted |
| hops | calls whose caller stands in another file of the packages |
| language | share of the calls that stand in `bunraku/language/` |
| character, motion, prompt | climbs back to a higher room on the way of each, as defined below |
| bodies | what a run works with: a transfer has two, the one that the motion is of and the character |
| worked out | calls of each of a named list of functions, once a body at most; `find_joints` also takes the reference |
| opened | how often each file of the user was opened |

The way of a value is the rooms (`LAYERS` in `tests/test_layers.py`) that it comes to: all calls that are given the
value as an argument, in their order, its own methods apart. A climb is a step to a room that stands higher in the list
than the one before. The character is a `Character`, its `Handles` or an `Anatomy`; the motion is a `HandleMotion` or a
`SkeletalMotion`; the prompt is a text that stands in the user's prompt, a `Sentence` or `Clause`, or a list of these.

Static figures beside: functions of more than 8 parameters, parameters that are bags of `Any`, regular expressions in
`bunraku/language/` (raw texts and arguments of `re`, with their alternatives), lists of verbs of locomotion (texts and
collections outside the lexicon that name three or more), and lines of both houses.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

HERE = Path(__file__).resolve()
PROMPT = "walks forward, then waves with the left hand"
BARS = {
    "files": 100, "calls": 20_000, "hops": 3_000, "language": 0.10, "character": 10, "motion": 15, "prompt": 4,
    "long functions": 6, "bags of Any": 60, "regular expressions": 80, "lists of verbs": 1,
    "lines of runtime": 62_000, "lines of laboratory": 36_000,
}  # fmt: skip
"""At most; those of a run are held against `animate` of the sample person."""
ONCE = ("parse", "Anatomy.of", "fit_motion", "find_joints", "find_legs", "decimated", "stance_of", "plan_of")
"""Functions that one run needs once at most, by their qualified names."""
MOST = 8
"""Parameters of one function."""
VERBS = ("walk", "run", "jog", "march", "sneak", "crawl", "stroll", "sprint", "tiptoe", "hobble", "limp", "stride")


# ---- the run that is watched ----


class Trip:
    """Counts the calls of one process.

    Args:
        sources: The folder of the packages.
        layers: Rooms from the ground up.
        prompt: What the user typed, "" for none.
        files: What the user named.
    """

    def __init__(self, sources: Path, layers: list[str], prompt: str, files: list[str]) -> None:
        self.roots = tuple(f"{sources / house}{os.sep}" for house in ("bunraku", "bunraku_lab"))
        self.layers, self.prompt = layers, prompt.casefold()
        self.files = Counter({os.path.realpath(name): 0 for name in files})
        self.calls: Counter[CodeType] = Counter()
        self.hops = 0
        self.climbs: dict[str, list[tuple[str, str]]] = {"character": [], "motion": [], "prompt": []}
        self._counted: dict[CodeType, bool] = {}
        self._before = len(f"{sources}{os.sep}")

    def opened(self, event: str, args: tuple[Any, ...]) -> None:
        """An audit hook: notes each opening of a file of the user."""
        if event == "open" and isinstance(args[0], (str, bytes, os.PathLike)):
            name = os.path.realpath(os.fsdecode(args[0]))
            if name in self.files:
                self.files[name] += 1

    def __call__(self, frame: FrameType, event: str, arg: object) -> None:
        if event != "call":
            return
        code = frame.f_code
        counted = self._counted.get(code)
        if counted is None:
            counted = self._counted[code] = self._ours(code) and bool(code.co_flags & CO_OPTIMIZED)
        if not counted:
            return
        self.calls[code] += 1
        back = frame.f_back
        if back is not None and back.f_code.co_filename != code.co_filename and self._ours(back.f_code):
            self.hops += 1
        self._walk(frame, code)

    def _ours(self, code: CodeType) -> bool:
        return code.co_filename.startswith(self.roots)

    def _place(self, code: CodeType) -> str:
        """The path of a function's file inside its package."""
        return Path(code.co_filename[self._before :]).as_posix().split("/", 1)[1]

    def _walk(self, frame: FrameType, code: CodeType) -> None:
        for way in self.climbs:
            if any(self._is(way, value) for value in _arguments(frame, code)):
                position = self._place(code)
                self.climbs[way].append((position.split("/")[0].removesuffix(".py"), f"{position}:{code.co_qualname}"))

    def _is(self, way: str, value: object) -> bool:
        name = type(value).__name__
        if way == "character":
            return name in ("Character", "Anatomy", "Handles")
        if way == "motion":
            return name in ("HandleMotion", "SkeletalMotion")
        if isinstance(value, str):
            return " " in value.strip() and value.strip().casefold() in self.prompt
        if isinstance(value, (list, tuple)):
            return any(self._is(way, part) for part in value[:8])
        return name in ("Sentence", "Clause")

    def report(self) -> dict[str, Any]:
        """All figures of the run."""
        calls = sum(self.calls.values())
        language = sum(n for code, n in self.calls.items() if code.co_filename.startswith(f"{self.roots[0]}language/"))
        often: Counter[str] = Counter()
        for code, count in self.calls.items():
            often[f"{self._place(code)}:{code.co_qualname}"] += count
        return {
            "files": len({code.co_filename for code in self.calls}), "calls": calls, "hops": self.hops,
            "language": round(language / max(calls, 1), 4),
            **{way: len(self._steps_up(way)) for way in self.climbs},
            "worked out": {
                name: sum(n for code, n in self.calls.items() if code.co_qualname == name)
                for name in ONCE if any(code.co_qualname == name for code in self.calls)
            },
            "opened": {Path(name).name: count for name, count in self.files.items()},
            "climbs": {way: self._steps_up(way) for way in self.climbs},
            "way": {way: _once([room for room, _ in steps]) for way, steps in self.climbs.items()},
            "most called": dict(often.most_common(25)),
        }  # fmt: skip

    def _steps_up(self, way: str) -> list[str]:
        position = {room: number for number, room in enumerate(self.layers)}
        steps = self.climbs[way]
        return [
            f"{before} -> {after}"
            for (one, before), (other, after) in zip(steps, steps[1:], strict=False)
            if position.get(other, 99) < position.get(one, 99)
        ]


def _arguments(frame: FrameType, code: CodeType) -> Iterator[object]:
    values = frame.f_locals
    for name in code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]:
        if name in values and name != "self":
            yield values[name]


def _once(rooms: list[str]) -> list[str]:
    return [room for number, room in enumerate(rooms) if number == 0 or rooms[number - 1] != room]


def watch(told: dict[str, Any]) -> None:
    """Play a command in this process and write what was counted."""
    trip = Trip(Path(told["sources"]), told["layers"], told["prompt"], told["files"])
    sys.addaudithook(trip.opened)
    from bunraku.cli import main

    sys.setprofile(trip)
    status = main(told["words"])
    sys.setprofile(None)
    Path(told["report"]).write_text(json.dumps({"status": status, **trip.report()}), encoding="utf-8")


# ---- the commands ----


def prepare(folder: Path, play: Callable[..., None]) -> dict[str, dict[str, Any]]:
    """Write what the runs read, with commands of their own; words, prompt and files of each run."""
    play("samples", "person", "dog", "dancer", "-o", folder)
    play("animate", folder / "person.glb", "walks forward", "--seconds", 3, "-o", folder / "walk.bvh")
    play("data", "wardrobe", "-o", folder / "wardrobe", "--count", 1)
    person, dog, dancer, walk = (folder / name for name in ("person.glb", "dog.glb", "dancer.glb", "walk.bvh"))
    dressed = next((folder / "wardrobe").rglob("*.pmx"))
    bodies = {"animate-person": 1, "animate-dog": 1, "transfer": 2, "transfer-simulate": 2}
    runs: dict[str, tuple[list[Path], list[object], str]] = {
        "animate-person": ([person], ["animate", person, PROMPT], PROMPT),
        "animate-dog": ([dog], ["animate", dog, "walks forward, then jumps"], "walks forward, then jumps"),
        "transfer": ([dancer, walk], ["transfer", dancer, walk], ""),
        "transfer-simulate": ([dressed, walk], ["transfer", dressed, walk, "--apparel", "simulate"], ""),
    }
    return {
        name: {
            "words": [*map(str, words), "-o", str(folder / f"{name}.glb")],
            "prompt": prompt,
            "files": [str(path) for path in files],
            "bodies": bodies[name],
        }
        for name, (files, words, prompt) in runs.items()
    }


def measure(tree: Path, chosen: list[str]) -> dict[str, Any]:
    """Play the runs with the sources of a checkout."""
    sources = tree / "src"
    environment = {**os.environ, "PYTHONPATH": str(sources), "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")}
    layers = layers_of(tree)
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)

        def play(*words: object) -> None:
            _play([sys.executable, "-m", "bunraku", *map(str, words)], environment)

        for run, told in prepare(folder, play).items():
            if run in chosen:
                report = folder / f"{run}.json"
                told |= {"sources": str(sources), "layers": layers, "report": str(report)}
                start = time.perf_counter()
                _play([sys.executable, str(HERE), "--watch", json.dumps(told)], environment)
                found[run] = json.loads(report.read_text(encoding="utf-8"))
                found[run]["bodies"] = told["bodies"]
                found[run]["seconds"] = round(time.perf_counter() - start, 1)
    return found


def _play(command: list[str], environment: dict[str, str]) -> None:
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command[:6])} ...: {done.stderr[-2000:]}")


# ---- what stands in the sources ----


def layers_of(tree: Path) -> list[str]:
    """The rooms that a checkout's test of layers lists."""
    for node in ast.parse((tree / "tests" / "test_layers.py").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "LAYERS":
            return list(ast.literal_eval(node.value))
    raise SystemExit(f"{tree} has no list of layers")


def static(tree: Path) -> dict[str, Any]:
    """Figures of the sources themselves."""
    lines, long, bags, patterns, alternatives, lists = {"bunraku": 0, "bunraku_lab": 0}, [], [], 0, 0, []
    for path in sorted((tree / "src").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        parts = path.relative_to(tree / "src").parts
        lines[parts[0]] += text.count("\n")
        module, body = "/".join(parts), ast.parse(text)
        for node in ast.walk(body):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                count, any_bags = parameters(node)
                if count > MOST and not any("overload" in ast.unparse(mark) for mark in node.decorator_list):
                    long.append(f"{module}:{node.name} {count}")
                bags += [f"{module}:{node.name} {name}" for name in any_bags]
        if parts[:2] == ("bunraku", "language"):
            found = list(expressions(body, text))
            patterns += len(found)
            alternatives += sum(pattern.count("|") + 1 for pattern in found)
        if parts[0] == "bunraku":
            lists += [f"{module}:{line}" for line in lists_of_verbs(body)]
    return {
        "long functions": len(long), "bags of Any": len(bags), "regular expressions": patterns,
        "alternatives": alternatives, "lists of verbs": len(lists), "lines of runtime": lines["bunraku"],
        "lines of laboratory": lines["bunraku_lab"],
        "where": {"long functions": long, "bags of Any": bags, "lists of verbs": lists},
    }  # fmt: skip


def parameters(node: ast.FunctionDef | ast.AsyncFunctionDef) -> tuple[int, list[str]]:
    """Number of parameters, `self` and `cls` apart, and names of those that are bags of `Any`."""
    found = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    count = sum(argument.arg not in ("self", "cls") for argument in found)
    bags = [a.arg for a in found if a.annotation is not None and "dict[str, Any]" in ast.unparse(a.annotation)]
    rest = node.args.kwarg
    if rest is not None and rest.annotation is not None and "Any" in ast.unparse(rest.annotation):
        bags.append(f"**{rest.arg}")
    return count + sum(argument is not None for argument in (node.args.vararg, rest)), bags


def expressions(body: ast.Module, text: str) -> Iterator[str]:
    """Regular expressions of a file: raw texts, and what is given to `re` as a pattern."""
    given = {
        id(node.args[0])
        for node in ast.walk(body)
        if isinstance(node, ast.Call) and node.args and ast.unparse(node.func).startswith("re.")
    }
    inside = {id(part) for node in ast.walk(body) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)} - {
        id(node) for node in ast.walk(body) if isinstance(node, ast.JoinedStr)
    }
    for node in ast.walk(body):
        if id(node) in inside or not (
            isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))
        ):
            continue
        source = ast.get_source_segment(text, node) or ""
        if id(node) in given or source[:2].lower() in ('r"', "r'", "rf", "fr"):
            yield source


def lists_of_verbs(body: ast.Module) -> Iterator[int]:
    """Lines of module-level statements that name three or more verbs of locomotion in one text or collection."""
    for statement in body.body:
        if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value is not None:
            texts = " ".join(
                node.value.lower()
                for node in ast.walk(statement.value)
                if isinstance(node, ast.Constant) and isinstance(node.value, str)
            )
            words = set("".join(letter if letter.isalpha() else " " for letter in texts).split())
            if sum(any(word.startswith(verb) and len(word) <= len(verb) + 4 for word in words) for verb in VERBS) >= 3:
                yield statement.lineno


# ---- the table ----


def table(found: dict[str, Any], sources: dict[str, Any]) -> str:
    """Figures as Markdown."""
    rows = [
        "| run | files | calls | hops | language | climbs of character | of motion | of prompt | bodies | worked out "
        "| opened |"
    ]
    rows.append("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | --- | --- |")
    for run, row in found.items():
        more = ", ".join(f"`{name}` {count}" for name, count in row["worked out"].items())
        opened = ", ".join(f"{name} {count}" for name, count in row["opened"].items())
        rows.append(
            f"| {run} | {row['files']} | {row['calls']:,} | {row['hops']:,} | {row['language']:.1%}"
            f" | {row['character']} | {row['motion']} | {row['prompt']} | {row['bodies']} | {more} | {opened} |"
        )
    rows.append(
        f"| bar (animate-person) | {BARS['files']} | {BARS['calls']:,} | {BARS['hops']:,} | {BARS['language']:.0%}"
        f" | {BARS['character']} | {BARS['motion']} | {BARS['prompt']} | 1 | 1 a body | 1 each |"
    )
    rows += ["", "| sources | figure | bar |", "| --- | ---: | ---: |"]
    for name, value in sources.items():
        if name != "where":
            rows.append(f"| {name} | {value:,} | {format(BARS[name], ',') if name in BARS else ''} |")
    return "\n".join(rows)


def main() -> None:
    """Measure a checkout and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tree", type=Path, default=HERE.parents[1], help="the checkout to look at")
    names = ["animate-person", "animate-dog", "transfer", "transfer-simulate"]
    parser.add_argument("--runs", nargs="*", choices=names, default=names, help="which runs; none for static figures")
    parser.add_argument("-o", "--output", type=Path, help="write all figures here as JSON")
    parser.add_argument("--watch", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.watch:
        watch(json.loads(arguments.watch))
        return
    tree = arguments.tree.resolve()
    sources = static(tree)
    found = measure(tree, arguments.runs) if arguments.runs else {}
    print(table(found, sources))
    if arguments.output:
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        arguments.output.write_text(json.dumps({"runs": found, "sources": sources}, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
