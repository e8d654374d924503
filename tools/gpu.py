"""Train the denoiser on a machine with a GPU that is lent for minutes: pack, train there, join here.

    python tools/gpu.py pack --data data/motions --mesh-bank data/mesh_bank.npz -o gpu
    python gpu/gpu.py train --minutes 25 --limit 10 --out back
    python tools/gpu.py join back -o runs/paper

The second line is for that machine, as often as it takes.

The packed folder holds the code, the text encoder and the data. There it needs Python 3.12 with torch, numpy, scipy
and safetensors; nothing is installed or fetched. See docs/training.md.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import signal
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
SOURCES = (HERE if (HERE / "src").is_dir() else HERE.parent) / "src"
sys.path.insert(0, str(SOURCES))

from bunraku.core.files import MAX_BYTES, atomic_write, check_input  # noqa: E402
from bunraku.errors import FormatError, OptionError  # noqa: E402

BUNDLE, WEIGHTS, LOG = "bundle.safetensors", "diffusion.safetensors", "log.csv"
WEIGHT_FILES = Path("bunraku") / "weights"
TEXT = WEIGHT_FILES / "text.safetensors"
ALONG = {TEXT, *(WEIGHT_FILES / name for name in ("ranker.safetensors", "examples.safetensors"))}
"""Weights that go along: those that rows are told by."""
LARGEST = 1 << 18
"""Of a file beside the code that goes along [bytes]; the page, the samples and all weights but a few stay."""
RESERVE = 25.0
"""Of the limit, kept for writing the state and the pieces [s]."""
SUFFIX = ".piece"
_LINE = 1024
"""Longest first line; a piece leaves so much room for it."""
_CHUNK = 1 << 20


def pack(options: argparse.Namespace) -> None:
    from bunraku_lab.datasets.motions.clips import write_bundle

    out = options.output
    out.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(out / "src", ignore_errors=True)
    for path in sorted(SOURCES.rglob("*")):
        position = path.relative_to(SOURCES)
        left = "__pycache__" in position.parts or "static" in position.parts
        small = path.suffix == ".py" or path.stat().st_size <= LARGEST
        if path.is_file() and not left and (("weights" not in position.parts and small) or position in ALONG):
            (out / "src" / position).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, out / "src" / position)
    shutil.copyfile(__file__, out / "gpu.py")
    if options.bundle is not None:
        shutil.copyfile(options.bundle, out / BUNDLE)
    else:
        print(f"{write_bundle(options.data, out / BUNDLE, options.mesh_bank).clips} clips")
    parts = {"data": [out / BUNDLE], "text encoder, ranker, examples": [out / "src" / path for path in sorted(ALONG)]}
    parts["all"] = [path for path in out.rglob("*") if path.is_file()]
    for name, paths in parts.items():
        print(f"{name}: {sum(path.stat().st_size for path in paths) / 2**20:.1f} MiB")
    print(f"wrote {out}")


def train(options: argparse.Namespace) -> None:
    begun = time.monotonic()

    def late(number: int, frame: object) -> None:
        print("the limit came before the first step; give more minutes", file=sys.stderr, flush=True)
        os._exit(1)  # an exception that comes out of a library half loaded may never arrive

    signal.signal(signal.SIGTERM, late)
    alarm = threading.Timer(max(60 * options.limit - RESERVE, 1.0), os.kill, (os.getpid(), signal.SIGTERM))
    alarm.daemon = True
    alarm.start()
    from bunraku_lab.training.diffusion.train import TrainingConfig, train_diffusion

    names = ("batch", "learning_rate", "steps", "examples", "drop_tokens", "ema", "warmup", "pool")
    settings = {name: getattr(options, name) for name in names}
    config = TrainingConfig(
        data=options.data or HERE / BUNDLE, out=options.run, preset=options.preset, start=options.start,
        device=options.device, threads=options.threads or min(os.cpu_count() or 1, 16), minutes=options.minutes,
        save_every=options.save_every, compose=0.15, creatures=0.2, events=0.3, workers=options.workers,
        **{name: value for name, value in settings.items() if value is not None},
    )  # fmt: skip
    try:
        train_diffusion(config, report=lambda row: print(*(f"{name} {value:.4g}" for name, value in row.items())))
    finally:
        alarm.cancel()
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
    bring(options)
    print(f"{time.monotonic() - begun:.0f} s in all")


# Each piece begins with one line of JSON: the file's name, which piece it is of how many, the file's size and SHA-256.


@dataclass(frozen=True)
class _Piece:
    """What the first line of a piece says, where the piece lies, and where its bytes start."""

    file: str
    piece: int
    pieces: int
    bytes: int
    sha256: str
    path: Path
    start: int


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def split_file(path: Path, folder: Path, most: int = 16 << 20) -> list[Path]:
    """Write a file as pieces "name.0.piece", "name.1.piece", ... and return them; older ones of it go.

    Args:
        path: The file; it stays.
        folder: To write to, made when it is not there.
        most: Largest piece [bytes].

    Raises:
        OptionError: A piece would hold nothing.
        FormatError: The file is missing or too large, or a piece cannot be written.
    """
    room = most - _LINE
    if room < 1:
        raise OptionError(f"a piece needs more than {_LINE} bytes, not {most}")
    size = check_input(path)
    count = -(-size // room)
    head = {"file": path.name, "pieces": count, "bytes": size, "sha256": _digest(path)}
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob(f"{path.name}.*{SUFFIX}"):
        old.unlink()
    written = []
    with path.open("rb") as source:
        for number in range(count):
            target = folder / f"{path.name}.{number}{SUFFIX}"
            with atomic_write(target) as file:
                file.write(json.dumps(head | {"piece": number}).encode() + b"\n")
                left = room
                while left and (part := source.read(min(left, _CHUNK))):
                    file.write(part)
                    left -= len(part)
            written.append(target)
    return written


def _head(path: Path) -> _Piece:
    try:
        with path.open("rb") as file:
            line = file.readline(_LINE)
        head = json.loads(line)
        name, numbers = head["file"], [head[key] for key in ("piece", "pieces", "bytes")]
        plain = isinstance(name, str) and name == Path(name).name and not name.startswith(".") and "\\" not in name
        if not plain or not line.endswith(b"\n") or not all(type(value) is int and value >= 0 for value in numbers):
            raise ValueError("its first line is another one")
        piece, pieces, size = numbers
        return _Piece(name, piece, pieces, size, str(head["sha256"]), path, len(line))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FormatError(path, f"this is no piece of a file ({error}); copy it again") from error


def join_pieces(folder: Path, output: Path) -> list[Path]:
    """Join all files whose pieces lie in a folder, and return them.

    Args:
        folder: With files "*.piece".
        output: Folder to write the files to, made when it is not there.

    Raises:
        FormatError: A piece is missing, damaged, or of another file than its fellows; nothing of that file is written.
    """
    files: dict[str, list[_Piece]] = {}
    for path in sorted(folder.glob(f"*{SUFFIX}")):
        head = _head(path)
        files.setdefault(head.file, []).append(head)
    if not files:
        raise FormatError(folder, f"there is no piece of a file (*{SUFFIX}) here; name the folder that they came to")
    output.mkdir(parents=True, exist_ok=True)
    return [_join(name, sorted(heads, key=lambda head: head.piece), output / name) for name, heads in files.items()]


def _join(name: str, heads: list[_Piece], target: Path) -> Path:
    folder = heads[0].path.parent
    if len({(head.pieces, head.bytes, head.sha256) for head in heads}) > 1:
        raise FormatError(folder, f"the pieces of {name} are of different files; copy all of one run")
    lacking = sorted(set(range(min(heads[0].pieces, 1 << 16))) - {head.piece for head in heads})
    if lacking:
        raise FormatError(folder, f"piece {lacking[0]} of {name} is missing; copy it again")
    held = sum(head.path.stat().st_size - head.start for head in heads)
    if len(heads) != heads[0].pieces or held != heads[0].bytes or held > MAX_BYTES:
        raise FormatError(folder, f"the pieces of {name} do not add up to its size; copy them again")
    found = hashlib.sha256()
    with atomic_write(target) as file:
        for head in heads:
            with head.path.open("rb") as source:
                source.seek(head.start)
                while part := source.read(_CHUNK):
                    found.update(part)
                    file.write(part)
        if found.hexdigest() != heads[0].sha256:
            raise FormatError(folder, f"the joined {name} is not what was split; copy its pieces again")
    return target


def bring(options: argparse.Namespace) -> None:
    """Pieces of the weights, and the log, where they are fetched from."""
    pieces = split_file(options.run / WEIGHTS, options.out, options.piece << 20)
    if len(pieces) + 1 > options.files:
        raise SystemExit(f"{len(pieces)} pieces and the log are more than {options.files} files; allow larger ones")
    shutil.copyfile(options.run / LOG, options.out / LOG)
    print(f"wrote {len(pieces)} pieces and {LOG} to {options.out}")


def join(options: argparse.Namespace) -> None:
    joined = join_pieces(options.folder, options.output)
    from bunraku_lab.nn.denoiser import load_denoiser  # not before: it loads torch

    for path in joined:
        notes = load_denoiser(path).notes
        print(f"wrote {path}: {notes.get('steps')} steps, {notes.get('minutes')} minutes")
    if (options.folder / LOG).is_file():
        shutil.copyfile(options.folder / LOG, options.output / LOG)


def parser() -> argparse.ArgumentParser:
    whole = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    verbs = whole.add_subparsers(required=True)
    one = verbs.add_parser("pack", help="here: code, text encoder and data in one folder")
    one.add_argument("-o", "--output", type=Path, required=True, help="folder to write")
    one.add_argument("--data", type=Path, default=Path("runs/data/motions"), help="of 'bunraku data motions'")
    one.add_argument("--mesh-bank", type=Path, help="of 'bunraku data mesh-bank'")
    one.add_argument("--bundle", type=Path, help="of 'bunraku data bundle', in the place of the data")
    one.set_defaults(do=pack)
    one = verbs.add_parser("train", help="there: train, or go on, until the limit")
    one.add_argument("--minutes", type=float, help="of training in all calls together; the rate falls towards its end")
    one.add_argument("--limit", type=float, default=10.0, help="minutes after which this call is killed")
    one.add_argument("--run", type=Path, default=HERE / "run", help="run folder; the same one goes on")
    one.add_argument("--out", type=Path, default=Path(os.environ.get("OUT") or HERE / "back"), help="folder of pieces")
    one.add_argument("--data", type=Path, help="bundle in the place of the packed one")
    one.add_argument("--preset", default="paper")
    one.add_argument("--start", type=Path, help="weights of the same preset to start from")
    one.add_argument("--device", help="'cuda', 'cpu'; CUDA where it is there")
    one.add_argument("--steps", type=int, help="at most")
    one.add_argument("--batch", type=int)
    one.add_argument("--learning-rate", type=float)
    one.add_argument("--warmup", type=int, help="steps")
    one.add_argument("--ema", type=float, help="decay of the averaged weights")
    one.add_argument("--examples", type=int, help="captured examples that the network attends to")
    one.add_argument("--drop-tokens", type=float, help="share of the text tokens that rows lack")
    one.add_argument("--workers", type=int, default=0, help="processes that draw rows into a pool on the device")
    one.add_argument("--pool", type=int, help="rows in it")
    one.add_argument("--threads", type=int, help="of the processor")
    one.add_argument("--save-every", type=float, default=2.0, help="minutes")
    one.add_argument("--piece", type=int, default=16, help="MiB of the largest file that comes back")
    one.add_argument("--files", type=int, default=8, help="files that come back at most")
    one.set_defaults(do=train)
    one = verbs.add_parser("join", help="here: the weights again, whole")
    one.add_argument("folder", type=Path, help="with the pieces")
    one.add_argument("-o", "--output", type=Path, required=True, help="run folder to write")
    one.set_defaults(do=join)
    return whole


def main(words: list[str] | None = None) -> None:
    from bunraku.errors import BunrakuError

    options = parser().parse_args(words)
    try:
        options.do(options)
    except BunrakuError as error:
        raise SystemExit(f"gpu.py: error: {error}") from error


if __name__ == "__main__":
    main()
