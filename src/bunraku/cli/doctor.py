"""`bunraku doctor`: what this installation has, what is missing, and what that costs."""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path

from bunraku.cli.shared import size_text

PACKAGES = ("numpy", "scipy", "fast-simplification", "av")
WEIGHTS = {
    "handles": "no character can be rigged; `bunraku animate` and `bunraku rig` do not work",
    "orientation": "`bunraku animate` and `bunraku rig` do not see how a mesh stands; they need --up and --front",
    "diffusion": "no sentence can become a motion; `bunraku animate` does not work",
    "text": "sentences cannot be read; `bunraku animate` does not work",
    "reader": "what a sentence names is not read; `bunraku animate` does not work",
    "ranker": "`bunraku animate` cannot choose among candidates; say --candidates 1",
    "tagger": "words of German, French, Spanish, Japanese and Chinese that the table of words lacks are not read",
    "critic": "`bunraku animate` does not guide motions towards their sentences, and fewer do what these say",
}
DISTRIBUTIONS = {"pxr": "usd-core", "mujoco": "mujoco-core"}
"""Names of packages that are imported by another."""
EXTRAS = {
    "mujoco": ("physics", "`--apparel simulate` and `chains` do not work"),
    "DracoPy": ("compressed", "GLB packed with Draco is not read"),
    "meshoptimizer": ("compressed", "GLB packed with meshopt is not read"),
    "torch": ("lab", "nothing is trained or measured, and no data are built; all else needs none"),
    "tensorboard": ("train", "a training draws no curves"),
    "transformers": ("clip", "weights that were trained with CLIP cannot be used; the shipped ones were not"),
    "ray": ("ray", "`--jobs ray` does not work; `--jobs` with a number needs nothing"),
    "pxr": ("usd", "USD is not written"),
    "mcp": ("serve", "`bunraku serve` does not work"),
    "anny": ("body", "the reference body cannot be built again; the shipped one is all that a user needs"),
}


@dataclass(frozen=True)
class Finding:
    """One line of the report: what was looked at, and found; its state, "ok", "optional" (missing, and nothing is
    broken without it) or "missing"; and what the user loses where it is not there.
    """

    topic: str
    state: str
    detail: str
    cost: str = ""


@dataclass(frozen=True)
class Doctor:
    """Tell what this installation has, what is missing, and what that costs.

    Paste the output into a bug report. The exit status is 1 when something that `bunraku animate` needs is missing.

    Example: bunraku doctor --json
    """

    json: bool = False
    """Print JSON for programs."""

    def run(self) -> int:
        findings: list[Finding] = []
        for look in (_system, _packages, _processor, _preview, _weights, _body, _extras):
            findings.extend(_guarded(look))
        if self.json:
            import json

            print(json.dumps([asdict(finding) for finding in findings], indent=2))
        else:
            _print(findings)
        return int(any(finding.state == "missing" for finding in findings))


def _guarded(look: Callable[[], Iterator[Finding]]) -> Iterator[Finding]:
    """What a check finds; a check that fails is a finding too."""
    try:
        yield from look()
    except Exception as error:
        cost, reason = "this part of the installation is broken", f"{type(error).__name__}: {error}"
        yield Finding(look.__name__.strip("_"), "missing", reason, cost)


def _print(findings: list[Finding]) -> None:
    width = shutil.get_terminal_size((100, 24)).columns
    for finding in findings:
        mark = {"ok": "ok", "optional": "--", "missing": "NO"}[finding.state]
        said = f"{mark} {finding.topic}: {finding.detail}{finding.cost and f' - {finding.cost}'}"
        print(textwrap.fill(said, width, subsequent_indent="     ", break_long_words=False, break_on_hyphens=False))


def _system() -> Iterator[Finding]:
    from bunraku import __version__

    yield Finding("bunraku", "ok", __version__)
    yield Finding("python", "ok", f"{platform.python_version()} at {sys.executable}")
    yield Finding("system", "ok", platform.platform())


def _packages() -> Iterator[Finding]:
    for name in PACKAGES:
        try:
            yield Finding(name, "ok", metadata.version(name))
        except metadata.PackageNotFoundError:
            yield Finding(name, "missing", "not installed", "install Bunraku again: pip install bunraku")


def _processor() -> Iterator[Finding]:
    from bunraku.core.nn.layers import usable_threads

    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    yield Finding("processor", "ok", f"{usable} of {os.cpu_count()} threads usable, networks use {usable_threads()}")


def _preview() -> Iterator[Finding]:
    from bunraku.render.kernels import native

    loops = native()
    if loops.library is not None:
        yield Finding("preview", "ok", f"compiled loops: {loops.reason}")
    else:
        cost = "previews are the same pictures, and take about ten times as long; install a C compiler such as gcc"
        yield Finding("preview", "optional", f"loops in numpy: {loops.reason}", cost)


def _weights() -> Iterator[Finding]:
    from bunraku.core.files import weights_file
    from bunraku.language.tokenizer import encoder_file

    for name, cost in WEIGHTS.items():
        path = encoder_file() if name == "text" else weights_file(f"{name}.safetensors")
        if not path.is_file():
            yield Finding(f"{name} weights", "missing", f"{path} is not there", cost)
            continue
        from safetensors import safe_open

        with safe_open(path, framework="np") as file:
            count = len(list(file.keys()))
        card = path.with_suffix(".md")
        about = f"card {card.name}" if card.is_file() else "no model card"
        yield Finding(f"{name} weights", "ok", f"{path}, {size_text(path.stat().st_size)}, {count} tensors, {about}")


def _body() -> Iterator[Finding]:
    folder = Path(__file__).resolve().parents[1] / "core" / "body"
    files = ", ".join(f"{path.name}, {size_text(path.stat().st_size)}" for path in sorted(folder.glob("*.npz")))
    if files:
        yield Finding("reference body", "ok", files)
    else:
        cost = "motions cannot be converted; install Bunraku again"
        yield Finding("reference body", "missing", f"nothing in {folder}", cost)


def _extras() -> Iterator[Finding]:
    for name, (extra, cost) in EXTRAS.items():
        if importlib.util.find_spec(name) is None:
            yield Finding(name, "optional", "not installed", f"{cost}; pip install 'bunraku[{extra}]'")
            continue
        try:
            yield Finding(name, "ok", metadata.version(DISTRIBUTIONS.get(name, name)))
        except metadata.PackageNotFoundError:
            yield Finding(name, "ok", "of unknown version")
    yield Finding("FBX", "ok", "read and written by Bunraku itself")
