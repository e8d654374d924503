"""Where the time of `bunraku animate` goes, stage by stage:

    python benchmarks/stages.py [--sizes 2000 20000 200000 500000] [--runs 3] [--tree ../other] [-o outputs/stages.json]

A sample character, subdivided and simplified to each number of vertices, is animated from its GLB for 6 s by the
command itself, in a process of its own each time. Each stage is a function (`STAGES`); its time is what passes in it
and not in a stage that it calls. Printed are medians of the runs in seconds of the processor, all threads together,
which depends less than the clock on what else a machine does; `other` is all that is left. `--tree` names another
checkout, which takes turns with this one.

| row | meaning |
| --- | --- |
| total | seconds of the processor, start of Python and imports among them |
| clock | the same by the clock |
| memory | most at a time [MB] |
| us a vertex | what a vertex costs more than in the size before, of the total |
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve()
PROMPT = "walks forward, then waves with the left hand"
STAGES: dict[str, tuple[str, ...]] = {
    "imports": ("builtins:__import__", "importlib:import_module"),
    "options": ("bunraku.cli.app:_parse",),
    "sentence": ("bunraku.language.parse:parse",),
    "load": ("bunraku.files.registry:load_character",),
    "orientation": ("bunraku.anatomy.handles.orientation:resolve_axes",),
    "network mesh": ("bunraku.core.geometry.simplify:network_views",),
    "handles' network": ("bunraku.anatomy.handles.predict:predict_weights",),
    "handles on vertices": ("bunraku.anatomy.handles.predict:predict_handles",),
    "anatomy": (
        "bunraku.anatomy.anatomy:Anatomy.of", "bunraku.anatomy.anatomy:Anatomy.measured",
        "bunraku.anatomy.anatomy:decimated",
    ),
    "reading weights": ("bunraku.core.nn.checkpoints:load_checkpoint", "bunraku.language.encoders:text_encoder"),
    "encoding": ("bunraku.generation.networks:Texts.__init__",),
    "retrieval": ("bunraku.generation.guide:GuidanceExamples.__init__",),
    "examples": ("bunraku.generation.guide:GuidanceExamples.of",),
    "denoiser": ("bunraku.generation.denoiser:Denoiser.__call__",),
    "pull": ("bunraku.generation.candidates:Pull.__call__",),
    "drawing": ("bunraku.generation.candidates:draw_candidates",),
    "choosing": ("bunraku.generation.candidates:choose",),
    "ways": ("bunraku.pipelines.apply:apply_locomotion",),
    "fit: hands clear": ("bunraku.retarget.stages.hands:HandsClear.__call__",),
    "fit: shape": ("bunraku.retarget.stages.shape:Shape.__call__",),
    "fit: the rest": ("bunraku.retarget.fit:fit_motion",),
    "write": ("bunraku.files.registry:save",),
}  # fmt: skip
"""Rows, and the functions that each is."""


class Watch:
    """Times functions, each without those that it calls."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = defaultdict(float)
        self._open: list[str] = []
        self._since = time.process_time()

    def _turn(self) -> None:
        now = time.process_time()
        self.spent[self._open[-1] if self._open else "other"] += now - self._since
        self._since = now

    def timed(self, row: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """A function whose time counts for a row."""

        def call(*args: Any, **options: Any) -> Any:
            self._turn()
            self._open.append(row)
            try:
                return function(*args, **options)
            finally:
                self._turn()
                self._open.pop()

        return call

    def put(self, row: str, place: str) -> None:
        """Put the timer where a function stands, and where modules have it by name already."""
        module, _, name = place.partition(":")
        owner: Any = importlib.import_module(module)
        *path, last = name.split(".")
        for part in path:
            owner = getattr(owner, part)
        found = owner.__dict__[last]
        if isinstance(found, classmethod):
            setattr(owner, last, classmethod(self.timed(row, found.__func__)))
            return
        new = self.timed(row, found)
        setattr(owner, last, new)
        for other in list(sys.modules.values()) if not path else ():
            if getattr(other, "__name__", "").startswith("bunraku") and other.__dict__.get(last) is found:
                setattr(other, last, new)


def watch(told: dict[str, Any]) -> None:
    """Play the command in this process; print what each stage took."""
    from bunraku.__main__ import lazy_imports

    lazy_imports(told["words"])
    timer = Watch()
    timer.spent["start of Python"] = time.process_time()
    for row, places in STAGES.items():
        for place in places:
            try:
                timer.put(row, place)
            except (ImportError, KeyError, AttributeError):
                print(f"{place} is not there", file=sys.stderr)
    from bunraku.cli import main

    status = main(told["words"])
    timer._turn()
    if status:
        raise SystemExit(status)
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1000 if sys.platform != "darwin" else 1e6)
    Path(told["report"]).write_text(json.dumps({"spent": timer.spent, "memory": most}))


def sized(count: int, path: Path) -> int:
    """Write the sample person with about so many vertices; how many it has."""
    import numpy as np
    from fast_simplification import simplify

    import bunraku
    from bunraku.core.character import Character

    character = bunraku.sample_character("person")
    vertices, faces = character.vertices.astype(np.float64), character.faces
    while len(vertices) < count:
        vertices, faces = divided(vertices, faces)
    points, triangles = simplify(
        vertices.astype(np.float32), faces.astype(np.int32), target_count=int(len(faces) * count / len(vertices))
    )
    bunraku.save_character(Character("person", points, triangles), path)
    return len(points)


def divided(vertices: Any, faces: Any) -> tuple[Any, Any]:
    """Each triangle as four."""
    import numpy as np

    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, index = np.unique(edges, axis=0, return_inverse=True)
    a, b, c = faces.T
    ab, bc, ca = len(vertices) + index.reshape(-1, 3).T
    four = [np.stack(corners, axis=1) for corners in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
    return np.concatenate([vertices, vertices[edges].mean(axis=1)]), np.concatenate(four)


def played(tree: Path, mesh: Path, seconds: float, folder: Path) -> dict[str, float]:
    """What one run of a checkout took."""
    report = folder / "report.json"
    words = ["animate", str(mesh), PROMPT, "--seconds", str(seconds), "-o", str(folder / "out.glb"), "--overwrite"]
    told = json.dumps({"words": words, "report": str(report)})
    threads = os.environ.get("OMP_NUM_THREADS", "1")
    environment = {**os.environ, "PYTHONPATH": str(tree / "src"), "OMP_NUM_THREADS": threads}
    start, used = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, str(HERE), "--watch", told], env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(done.stderr[-2000:])
    clock, now = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    found = json.loads(report.read_text())
    total = now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime
    return {**found["spent"], "total": total, "clock": clock, "memory": found["memory"]}


def table(rows: dict[int, dict[str, float]]) -> str:
    """Sizes as columns, stages as rows, those that take long at the largest first."""
    sizes = sorted(rows)
    last = ("total", "clock", "memory")
    names = sorted({name for row in rows.values() for name in row if name not in last}, key=lambda name: -max(
        row.get(name, 0.0) for row in rows.values()
    ))  # fmt: skip
    lines = ["| " + " | ".join(["stage", *(f"{size:,}" for size in sizes)]) + " |", "| --- |" + " ---: |" * len(sizes)]
    for name in (*names, *last):
        digits = 0 if name == "memory" else 2
        lines.append(f"| {name} | " + " | ".join(f"{rows[size].get(name, 0.0):.{digits}f}" for size in sizes) + " |")
    more = [
        f"{1e6 * (rows[size]['total'] - rows[before]['total']) / (size - before):.1f}"
        for before, size in zip(sizes, sizes[1:], strict=False)
    ]
    return "\n".join([*lines, "| us a vertex | | " + " | ".join(more) + " |"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[2000, 20000, 200000, 500000])
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--tree", type=Path, help="another checkout, which takes turns with this one")
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--watch", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.watch:
        watch(json.loads(args.watch))
        return
    trees = [HERE.parents[1]] + ([args.tree.resolve()] if args.tree else [])
    found: dict[str, dict[int, dict[str, float]]] = {str(tree): {} for tree in trees}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for size in args.sizes:
            mesh = folder / f"{size}.glb"
            count = sized(size, mesh)
            runs: dict[str, list[dict[str, float]]] = {str(tree): [] for tree in trees}
            for _ in range(args.runs):
                for tree in trees:
                    runs[str(tree)].append(played(tree, mesh, args.seconds, folder))
            for tree, each in runs.items():
                found[tree][count] = {
                    row: statistics.median(run.get(row, 0.0) for run in each) for row in sorted(set().union(*each))
                }
    for tree, rows in found.items():
        print(f"{tree}\n\n{table(rows)}\n")
    if args.output:
        args.output.parent.mkdir(parents=True, exist_ok=True)
        args.output.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
