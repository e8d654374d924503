"""Commands that are stopped in the middle: killed at a file event and run again, or interrupted at a moment.

python tests/stops/stops.py kill --count 100        each long command, killed at so many events; the last line tells
python tests/stops/stops.py interrupt --count 20    each command, interrupted at so many moments
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tiny_inputs import MADE

from bunraku.cli.app import all_verbs

HOOK = '''
"""Counts what is done to files below a folder, and kills the whole session at one of these events."""
import os, signal, sys
_folder, _tally, _fatal = os.environ["STOPS_FOLDER"], os.environ["STOPS_TALLY"], int(os.environ["STOPS_FATAL"])
_EVENTS = {"open", "os.rename", "os.remove", "os.mkdir", "os.chmod", "os.rmdir", "os.utime", "os.truncate"}
def _hook(event, words):
    if event not in _EVENTS or not words or not isinstance(words[0], (str, bytes)):
        return
    path = os.fsdecode(words[0])
    if event == "open" and isinstance(words[2], int) and not words[2] & (os.O_WRONLY | os.O_RDWR):
        return
    if not os.path.abspath(path).startswith(_folder):
        return
    descriptor = os.open(_tally, os.O_WRONLY | os.O_APPEND)
    os.write(descriptor, b".")
    done = os.fstat(descriptor).st_size
    os.close(descriptor)
    if 0 < _fatal <= done:  # threads may have counted on since
        os.killpg(0, signal.SIGKILL)
sys.addaudithook(_hook)
'''


@dataclass(frozen=True)
class Command:
    """Words of a command line, in which OUT stands for the folder of its results, and the inputs that it needs."""

    name: str
    words: tuple[str, ...]
    needs: tuple[str, ...] = ()


LINES = ("a person walks", "a person waves", "jumps")
KILLED = (
    Command("samples", ("samples", "-o", "OUT")),
    Command(
        "animate --prompts",
        ("animate", "IN/mushroom.glb", "--prompts", "IN/lines.txt", "--seconds", "1", "--candidates", "1", "-o", "OUT"),
        ("mushroom",),
    ),
    Command(
        "transfer",
        (
            "transfer", "IN/mushroom.glb", "IN/person.glb", "--motions", "IN/one.npz", "IN/two.npz", "--jobs", "2",
            "-o", "OUT",
        ),
        ("mushroom", "person", "clips"),
    ),
    Command(
        "animate a folder",
        (
            "animate", "IN/characters", "--prompts", "IN/lines.txt", "--seconds", "1", "--candidates", "1", "--jobs",
            "2", "-o", "OUT",
        ),
        ("characters",),
    ),
    Command("data wardrobe", ("data", "wardrobe", "-o", "OUT", "--count", "2")),
    Command("data motions", ("data", "motions", "--source", "IN/archive", "-o", "OUT", "--jobs", "2"), ("archive",)),
    Command(
        "data characters",
        ("data", "characters", "--source", "IN/characters", "-o", "OUT", "--vertices", "400", "--code-made", "2"),
        ("characters",),
    ),
    Command("data mesh-bank", ("data", "mesh-bank", "--cache", "IN/cache", "-o", "OUT/bank.npz"), ("cache",)),
    Command(
        "data character-bank",
        (
            "data", "character-bank", "--source", "IN/characters", "--code-made", "1", "--variants", "1", "-o",
            "OUT/characters.npz",
        ),
        ("characters",),
    ),
    Command(
        "data bundle",
        ("data", "bundle", "--data", "IN/motions", "-o", "OUT/bundle.safetensors"),
        ("motions",),
    ),
    Command(
        "data examples",
        ("data", "examples", "--data", "IN/motions", "-o", "OUT/examples.safetensors"),
        ("motions",),
    ),
    Command(
        "data apparel",
        (
            "data", "apparel", "--motions", "IN/motions", "--wardrobe", "3", "--takes", "3", "--minutes", "0.2",
            "--seconds", "2", "--jobs", "2", "-o", "OUT",
        ),
        ("motions",),
    ),
    Command(
        "train handles",
        (
            "train", "handles", "--cache", "IN/cache", "--out", "OUT", "--minutes", "0", "--epochs", "2", "--batch",
            "2", "--validate-every", "1", "--predictor.levels", "8", "8", "8", "--predictor.hidden", "8", "8",
            "--predictor.anchors", "8", "--predictor.depth", "1", "--predictor.mesh-vertices", "300",
        ),
        ("cache",),
    ),
    Command(
        "train orientation",
        (
            "train", "orientation", "--cache", "IN/cache", "--out", "OUT", "--minutes", "0", "--steps", "6", "--batch",
            "2", "--validate-every", "2", "--predictor.width", "8", "--predictor.layers", "1", "--predictor.heads", "2",
            "--predictor.anchors", "8",
        ),
        ("cache",),
    ),
    Command(
        "train diffusion",
        (
            "train", "diffusion", "--data", "IN/motions", "--out", "OUT", "--minutes", "None", "--steps", "5",
            "--batch", "2", "--save-every", "0", "--validate-every", "2",
        ),
        ("motions",),
    ),
    *(
        Command(
            f"train {name}",
            (
                "train", name, "--data", "IN/motions", "--out", "OUT", "--minutes", "0", "--steps", "6", "--batch", "4",
                "--validate-every", "2", f"--{network}.width", "16", f"--{network}.layers", "1", f"--{network}.heads",
                "2", f"--{network}.feedforward", "16", f"--{network}.embedding", "8",
            ),
            ("motions",),
        )
        for name, network in (("extractor", "extractor"), ("ranker", "network"))
    ),
    Command(
        "train tagger",
        (
            "train", "tagger", "--pairs", "IN/pairs", "--out", "OUT", "--minutes", "0", "--steps", "6", "--batch", "8",
            "--validate-every", "2", "--encoded", "4", "--network.buckets", "64", "--network.width", "4",
        ),
        ("pairs",),
    ),
    *(
        Command(
            f"train {name}",
            (
                "train", name, *data, "--out", "OUT/run", "--minutes", "0", "--steps", "6", "--batch", "2",
                "--validate-every", "2", "--network.width", "8",
            ),
            needs,
        )
        for name, data, needs in (
            ("apparel-body", ("--data", "IN/apparel", "--characters", "3", "--network.features", "8"), ("apparel",)),
            (
                "apparel",
                ("--data", "IN/apparel", "--clips", "1", "--shortest", "5", "--longest", "6", "--network.blocks", "1"),
                ("apparel",),
            ),
            ("apparel-refinement", ("--data", "IN/apparel", "--characters", "2"), ("apparel",)),
        )
    ),
    Command(
        "train adaptation",
        (
            "train", "adaptation", "--diffusion", "IN/weights/diffusion.safetensors", "--cache", "IN/bank.npz",
            "--data", "IN/motions", "--out", "OUT", "--pairs", "6", "--frames", "12", "--steps", "5", "--batch", "2",
            "--edges", "100", "--mesh-size", "2", "--save-every", "0", "--validate-every", "2",
        ),
        ("motions", "bank", "weights"),
    ),
    Command(
        "train nbs",
        (
            "train", "nbs", "--data", "IN/apparel", "--out", "OUT/run", "--minutes", "0", "--steps", "5",
            "--validate-every", "2", "--vertices", "200", "--frames", "4", "--poses", "2", "--network.skinning", "4",
        ),
        ("apparel",),
    ),
    Command(
        "train transfer-baseline",
        (
            "train", "transfer-baseline", "--preset", "spt", "--apparel", "IN/apparel", "--out", "OUT/run", "--minutes",
            "0", "--steps", "5", "--validate-every", "2", "--most", "2", "--poses", "4", "--vertices", "200",
            "--network.levels", "4", "--network.code", "4",
        ),
        ("apparel",),
    ),
)  # fmt: skip
"""All that may run for long, on inputs with which they take seconds."""
DRAWN_ANEW = Command(
    "train few-steps",
    (
        "train", "few-steps", "--diffusion", "IN/weights/diffusion.safetensors", "--data", "IN/motions", "--out",
        "OUT", "--minutes", "0", "--steps", "5", "--batch", "2", "--validate-every", "2", "--no-critic", "--rank", "2",
        "--rows", "2", "--kept", "64",
    ),
    ("motions", "weights"),
)  # fmt: skip
"""A training that goes on with the network but with lessons that are drawn anew: gigabytes would have to be kept."""
_LIVE = (
    *KILLED,
    DRAWN_ANEW,
    Command("animate", ("animate", "IN/person.glb", "a person walks", "-o", "OUT/a.glb"), ("person",)),
    Command("rig", ("rig", "IN/person.glb", "-o", "OUT/r.glb"), ("person",)),
    Command("edit", ("edit", "IN/one.npz", "waves", "--keep", "legs", "-o", "OUT/e.npz"), ("clips",)),
    Command("render", ("render", "IN/person.glb", "-o", "OUT/p.png"), ("person",)),
    Command("inspect", ("inspect", "IN/person.glb"), ("person",)),
    Command("doctor", ("doctor",)),
)
# Those that need an archive are interrupted while they are loaded.
INTERRUPTED = (
    *_LIVE,
    *(
        Command(" ".join(verb), (*verb, "--help"))
        for verb in all_verbs()
        if not any(command.words[: len(verb)] == verb for command in _LIVE)
    ),
)


def run(*words: str, **how) -> subprocess.Popen:
    """The command line in a session of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "bunraku", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True, **how,
    )  # fmt: skip


def make_inputs(folder: Path, commands: tuple[Command, ...]) -> None:
    """What the commands read, in `folder`."""
    needs = {need for command in commands for need in command.needs}
    (folder / "lines.txt").write_text("\n".join(LINES) + "\n")
    for need in sorted(needs):
        if need in MADE:
            MADE[need](folder)
        else:
            _done(run("samples", need, "-o", str(folder)))
    for name, need, words in (
        ("cache", "characters", ("characters", "--source", "{}", "--vertices", "400", "--code-made", "4")),
        ("apparel", "motions", ("apparel", "--motions", "{}", "--wardrobe", "3", "--minutes", "0.2", "--seconds", "2")),
        ("bank.npz", "characters", ("character-bank", "--source", "{}", "--code-made", "3", "--variants", "1")),
    ):
        if name.removesuffix(".npz") in needs:
            if not (folder / need).is_dir():
                MADE[need](folder)
            given = [word.format(folder / need) for word in words]
            _done(run("data", *given, "-o", str(folder / name)))


def words_of(command: Command, inputs: Path, out: Path) -> list[str]:
    return [word.replace("OUT", str(out)).replace("IN/", f"{inputs}/") for word in command.words]


def _done(process: subprocess.Popen) -> str:
    _, said = process.communicate(timeout=900)
    if process.returncode != 0:
        raise RuntimeError(f"{process.args} ended with {process.returncode}: {said[-500:]}")
    return said


def alone(session: int) -> bool:
    """Whether no process of a session is left."""
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] not in "ZX":
            return False
    return True


def contents(folder: Path) -> dict[str, object]:
    """What a folder holds, but for when and where: files with their bytes, the ledger's names with what they were made
    of, and networks without the seconds that they took. What tells of the course of a training is left out.
    """
    found: dict[str, object] = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = str(path.relative_to(folder))
        if path.name == ".bunraku-ledger.jsonl":
            rows = [json.loads(line) for line in path.read_text().splitlines()]
            found[name] = {row[0]: row[1] for row in rows}
        elif path.suffix == ".safetensors":
            found[name] = _network(path, str(folder))
        elif path.name != "log.csv" and path.parent.name != "events":
            found[name] = path.read_bytes()
    return found


def _network(path: Path, folder: str) -> object:
    """The numbers of a checkpoint or a training state, and what is said of them."""
    data = path.read_bytes()
    end = 8 + int.from_bytes(data[:8], "little")
    head = json.loads(data[8:end].decode().replace(folder, "OUT"))
    said = {name: _timeless(json.loads(text)) if text[:1] in "{[" else text
            for name, text in head.pop("__metadata__", {}).items()}  # fmt: skip
    tensors = {name: (one["dtype"], one["shape"], data[end + one["data_offsets"][0] : end + one["data_offsets"][1]])
               for name, one in head.items()}  # fmt: skip
    return said, tensors


def _timeless(value: object) -> object:
    """JSON without what it took."""
    if isinstance(value, dict):
        return {name: _timeless(item) for name, item in value.items() if name not in ("seconds", "minutes")}
    if isinstance(value, list):
        return [_timeless(item) for item in value if not (isinstance(item, list) and item[:1] == ["seconds"])]
    return value


class Killer:
    """One command, whose undisturbed result is known, to be killed at any of its events."""

    def __init__(self, command: Command, folder: Path, inputs: Path):
        self.command, self.inputs, self.folder = command, inputs, folder
        (folder / "hook").mkdir(parents=True)
        (folder / "hook" / "sitecustomize.py").write_text(HOOK)
        self.tally = folder / "tally"
        self._run(folder / "whole" / "out", 0)
        self.events = self.tally.stat().st_size
        self.whole = contents(folder / "whole" / "out")
        assert self.whole, f"{command.name} writes nothing"

    def _run(self, out: Path, fatal: int) -> int:
        """Exit status of a run that is killed at its event number `fatal`; 0 for none."""
        out.parent.mkdir(parents=True, exist_ok=True)
        self.tally.write_bytes(b"")
        paths = [str(self.folder / "hook"), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
        environment = {
            **os.environ, "PYTHONPATH": os.pathsep.join(path for path in paths if path),
            "STOPS_FOLDER": str(out), "STOPS_TALLY": str(self.tally), "STOPS_FATAL": str(fatal),
        }  # fmt: skip
        process = run(*words_of(self.command, self.inputs, out), env=environment)
        said = process.communicate(timeout=900)[1]
        if process.returncode not in (0, -signal.SIGKILL):
            raise AssertionError(f"{self.command.name}, event {fatal}: {process.returncode} {said[-500:]}")
        if not alone(process.pid):
            time.sleep(1)
            assert alone(process.pid), f"{self.command.name}, event {fatal}: a process is left"
        return process.returncode

    def check(self, fatal: int) -> None:
        """Kill it at an event, run it again, and compare what is there with the undisturbed result."""
        out = self.folder / f"event-{fatal}" / "out"
        assert self._run(out, fatal) == -signal.SIGKILL, f"{self.command.name} was not killed at event {fatal}"
        self._run(out, 0)
        found = contents(out)
        wrong = sorted(name for name in found.keys() | self.whole.keys() if found.get(name) != self.whole.get(name))
        assert not wrong, f"{self.command.name}, killed at event {fatal} of {self.events}: {wrong} differ"


def interrupt(command: Command, inputs: Path, out: Path, seconds: float) -> str:
    """Interrupt a command after so many seconds, as a terminal does; what is wrong with how it ends, "" for nothing."""
    out.mkdir(parents=True, exist_ok=True)
    process = run(*words_of(command, inputs, out))
    time.sleep(seconds)
    sent, before = time.monotonic(), _worked(process.pid)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGINT)
    late = 0.0
    while process.poll() is None and time.monotonic() - sent < 60:
        late = _worked(process.pid) - before
        time.sleep(0.02)
    said = process.communicate(timeout=1)[1]
    while not alone(process.pid):
        if time.monotonic() - sent > 70:
            return "a process is left"
        time.sleep(0.02)
    lines = [line for line in said.splitlines() if line]
    if process.returncode == 0:
        return ""  # it had ended
    if process.returncode not in (130, -signal.SIGINT, 1):
        return f"exit status {process.returncode}: {said[-300:]}"
    if late > 2:
        return f"{late:.1f} s of processor time late"
    if "Traceback" in said:  # Python itself was starting, and hardly a line of ours ran
        ours = [line for line in lines if "/bunraku/" in line and "/bunraku/__init__.py" not in line]
        return f"traceback: {said[-300:]}" if ours or seconds > 2 else ""
    if lines and lines[-1] != "bunraku: interrupted":
        return f"it says {said[-300:]}"
    return ""


def _worked(process: int) -> float:
    """Processor time of a process [s], 0 where it has ended; other work on the machine does not count."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> int:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell has it ignored for a job in the background
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("kill", "interrupt"))
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=())
    options = parser.parse_args()
    chance = random.Random(options.seed)
    commands = KILLED if options.what == "kill" else INTERRUPTED
    commands = tuple(each for each in commands if not options.only or each.name in options.only)
    tried, faults = 0, []
    with tempfile.TemporaryDirectory(prefix="bunraku-stops-") as name:
        inputs = Path(name) / "inputs"
        inputs.mkdir()
        make_inputs(inputs, commands)
        for index, command in enumerate(commands):
            folder = Path(name) / str(index)
            if options.what == "kill":
                killer = Killer(command, folder, inputs)
                trials = [chance.randint(1, killer.events) for _ in range(options.count)]
            else:
                folder.mkdir()
                start = time.monotonic()
                _done(run(*words_of(command, inputs, folder / "whole")))
                length = time.monotonic() - start
                trials = [chance.uniform(0, length) for _ in range(options.count)]
            for number, trial in enumerate(trials):
                tried += 1
                try:
                    if options.what == "kill":
                        killer.check(trial)
                    elif said := interrupt(command, inputs, folder / str(number), trial):
                        raise AssertionError(f"{command.name}, after {trial:.2f} s: {said}")
                except AssertionError as fault:
                    faults.append(str(fault))
                    print(fault, flush=True)
            print(f"{command.name}: {len(trials)} times", flush=True)
    print(f"{options.what}: {tried} times, {len(faults)} faults")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
