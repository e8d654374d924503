"""The command line as a whole, and bad input."""

import errno
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import bunraku
from bunraku.cli import main, shared
from bunraku.cli.app import all_verbs
from bunraku.cli.clips import Samples
from bunraku.cli.shared import slug
from bunraku.errors import is_fault, sentence_of


@pytest.mark.parametrize("verb", all_verbs())
def test_every_verb_helps_with_an_example(capsys, verb):
    assert main([*verb, "--help"]) == 0
    said = capsys.readouterr().out
    assert f"bunraku {' '.join(verb)}" in said
    assert f"Example: bunraku {' '.join(verb)}" in " ".join(said.split())


def test_help_names_every_verb(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"bunraku {bunraku.__version__}\n"
    assert main(["--help"]) == 0
    said = capsys.readouterr().out
    assert all(word in said for verb in all_verbs() for word in verb)
    assert "for research" in said.partition("  doctor ")[2] and "train apparel" not in said
    assert main(["data", "--help"]) == 0
    assert "animate" not in capsys.readouterr().out
    assert main(["help", "rig"]) == 0
    assert "how the character stands, which" in " ".join(re.sub("[│\n]", " ", capsys.readouterr().out).split())


def test_help_loads_nothing_heavy():
    """What makes it quick; the time itself depends on the machine."""
    code = "import sys; from bunraku.cli import main; main(['--help']); print('loaded', *sys.modules, file=sys.stderr)"
    shown = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    loaded = set(shown.stderr.split("loaded ")[-1].split())
    assert "animate" in shown.stdout and not loaded & {"numpy", "scipy", "torch", "transformers", "av"}


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (bunraku.OptionError("no"), 2, "no"),
        (OSError(errno.ENOSPC, "No space left on device", "a.glb"), 2, "a.glb: the disk is full"),
        (OSError(errno.EDQUOT, "Quota exceeded"), 2, "the disk is full"),
        (PermissionError(errno.EACCES, "Permission denied", b"a.glb"), 2, "a.glb: permission denied"),
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "a"), 2, "a: No such file"),
        (MemoryError(), 2, "memory"),
        (RuntimeError("[enforce fail at alloc_cpu.cpp:121] DefaultCPUAllocator: can't allocate memory"), 2, "memory"),
        (ZeroDivisionError("division by zero"), 1, "ZeroDivisionError"),
    ],
)
def test_what_is_raised_becomes_a_sentence(error, status, words):
    assert is_fault(error) == (status == 1) and words in sentence_of(error)


def _raising(error):
    def run(self):
        raise error

    return run


class _Interrupted:
    def __set_name__(self, owner, name):
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    "run",
    [_raising(KeyboardInterrupt()), lambda self: type("Form", (), {"field": _Interrupted()})],
    ids=["plainly", "while a class is made, which Python 3.11 reports as another error"],
)
def test_interrupt_is_130(monkeypatch, capsys, run):
    monkeypatch.setattr(Samples, "run", run)
    assert main(["samples"]) == 130
    assert capsys.readouterr().err == "bunraku: interrupted\n"


@pytest.mark.parametrize("how", ["option", "variable"])
def test_debug_shows_the_traceback(monkeypatch, capsys, how):
    monkeypatch.setattr(Samples, "run", _raising(bunraku.OptionError("two\nlines")))
    if how == "variable":
        monkeypatch.setenv("BUNRAKU_DEBUG", "1")
    assert main(["samples", *(["--debug"] if how == "option" else [])]) == 2
    said = capsys.readouterr().err
    assert "Traceback" in said and said.endswith("bunraku: error: two lines\n")


def test_closed_pipes_and_streams_are_quiet(good):
    """`bunraku inspect FILE | head -c 1`: the reader goes away. Or there are no streams at all."""
    words = [sys.executable, "-m", "bunraku", "inspect", str(good)]
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as pipe:
        done = subprocess.run([*words, "--json"], stdout=pipe, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 141 and done.stderr == ""
    done = subprocess.run(["sh", "-c", '"$@" >&- 2>&-', "sh", *words], capture_output=True, text=True)
    assert done.returncode in (0, 141) and "fault" not in done.stderr and "Traceback" not in done.stderr


def test_slug():
    assert slug("Walks forward, then waves!") == "walks-forward-then-waves"
    assert slug("../../etc/passwd") == "etc-passwd"
    assert slug("!!") == "motion"
    assert len(slug("x" * 500)) <= 40 and len(slug("word " * 100)) <= 40
    assert slug("word " * 100) != slug("word " * 99)  # what begins alike is told apart


def test_a_long_stage_tells_how_far_it_is(capsys, monkeypatch):
    monkeypatch.setattr(shared, "LINE", 0.0)
    with shared.stages() as report:
        for done in (0.0, 0.5, 1.0):
            report("stretches", done)
    assert "stretches: 50%" in capsys.readouterr().err


def test_a_stream_of_few_letters_is_no_fault(tmp_path, glb):
    path = tmp_path / "füchsin.glb"
    path.write_bytes(glb())
    done = subprocess.run(
        [sys.executable, "-m", "bunraku", "inspect", str(path)],
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"},
    )
    assert done.returncode == 0 and b"f\\xfcchsin" in done.stdout and b"fault" not in done.stderr


@pytest.mark.parametrize("after", [0.0, 0.15])
def test_an_interrupt_at_the_start_is_one_line(good, after):
    """It is sent as soon as the command's own module runs; before that Python itself starts."""
    code = (
        "import os, signal, sys, threading, time, bunraku.__main__ as command\n"
        f"stop = lambda: (time.sleep({after}), os.kill(os.getpid(), signal.SIGINT))\n"
        "real = signal.signal\n"
        "real(signal.SIGINT, signal.default_int_handler)  # a job in the background inherits one that is ignored\n"
        "def ready(*words):\n"
        "    signal.signal = real\n"
        "    out = real(*words)\n"
        "    threading.Thread(target=stop).start()\n"
        "    return out\n"
        "signal.signal = ready\n"
        f"sys.argv = ['bunraku', 'animate', {str(good)!r}, 'walks', '--seconds', '20']\n"
        "command.run()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=good.parent)
    assert done.returncode == 130 and done.stderr == "bunraku: interrupted\n"


@pytest.mark.skipif(os.name == "nt", reason="Windows sends no such signal")
def test_an_interrupt_that_is_ignored_stays_ignored():
    """As for a command that a shell starts in the background."""
    code = (
        "import signal\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "import sys, bunraku.cli, bunraku.__main__ as command\n"
        "real = bunraku.cli.main\n"
        "bunraku.cli.main = lambda: (signal.raise_signal(signal.SIGINT), real())[1]\n"
        "sys.argv = ['bunraku', '--version']\n"
        "command.run()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == "" and done.stdout.startswith("bunraku ")


@pytest.mark.skipif(os.name == "nt", reason="Windows sends no such signal")
def test_an_interrupt_after_all_is_done_says_nothing():
    code = (
        "import atexit, os, signal, sys, bunraku.cli\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "sys.argv = ['bunraku', '--version']\n"
        "real = bunraku.cli.main\n"
        "def main():\n"
        "    atexit.register(lambda: (os.kill(os.getpid(), signal.SIGINT), print('interrupted')))\n"
        "    return real()\n"
        "bunraku.cli.main = main\n"
        "from bunraku.__main__ import run\n"
        "run()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stderr == "" and done.stdout.splitlines()[1:] == ["interrupted"]


CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1.5, 0], [0, 0, 1]], "<f4")
NOT_NUMBERS = np.where(CORNERS == 1.5, np.nan, CORNERS).astype("<f4")
PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
    b"end_header\n0 0 0\n1 1 1\n"
)

# Name of the file, its bytes or what makes them of the fixture `glb`, and a word of the reason.
BAD_FILES = {
    "empty.glb": (b"", "empty"),
    "no-mesh.glb": (lambda glb: glb(CORNERS[:0], np.zeros((0, 3), "<u2")), "empty"),
    "points.glb": (lambda glb: glb(CORNERS, None), "without faces"),
    "truncated.glb": (lambda glb: glb()[:-20], "truncated"),
    "header-only.glb": (lambda glb: glb()[:10], "truncated"),
    "nan.glb": (lambda glb: glb(NOT_NUMBERS), "not numbers"),
    "one-point.glb": (lambda glb: glb(CORNERS * 0), "one point"),
    "text.glb": (b"this is not a mesh at all, whatever its name says", "broken"),
    "empty.obj": (b"# nothing\n", "empty"),
    "points.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "without faces"),
    "nan.obj": (b"v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n", "not numbers"),
    "points.ply": (PLY, "without faces"),
    "truncated.stl": (b"\0" * 80 + b"\x10\0\0\0" + b"\0" * 50, ""),
    "scene.fbx": (b"Kaydara FBX Binary  \0", "ends in the middle of its header"),
    "scene.dae": (b"<COLLADA>", "not a format"),
    "noise": (bytes(range(256)) * 4, "without a suffix"),
}


@pytest.mark.parametrize("verb", ["animate", "rig", "inspect", "render"])
@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_file(fails, glb, tmp_path, name, verb):
    content, reason = BAD_FILES[name]
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content(glb))
    words = {
        "animate": ["walks", "-o", tmp_path / "out.glb"],
        "rig": ["-o", tmp_path / "out.glb"],
        "render": ["-o", tmp_path / "out.png"],
    }
    sentence = fails(verb, path, *words.get(verb, []))
    assert name in sentence and reason in sentence


def test_three_gigabytes(fails, tmp_path):
    path = tmp_path / "huge.glb"
    with path.open("wb") as file:
        file.write(b"glTF")
        file.truncate(3 << 30)  # a hole: no disk is used
    assert "3.0 GiB" in fails("animate", path, "walks", "-o", tmp_path / "out.glb")


def test_missing_file_and_folder(fails, tmp_path):
    assert "no such file" in fails("animate", tmp_path / "nowhere.glb", "walks", "-o", tmp_path / "out.glb")
    assert "folder" in fails("inspect", tmp_path)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--seconds", "0"], "--seconds must be from 0.5 to 36000, not 0"),
        (["--seconds", "-1"], "not -1"),
        (["--seconds", "36001"], "not 36001"),
        (["--seconds", "nan"], "not nan"),
        (["--seconds", "inf"], "not inf"),
        (["--fps", "0"], "--fps must be from 1 to 240"),
        (["--steps", "0"], "--steps"),
        (["--guidance", "-3"], "--guidance"),
        (["--seed", "-1"], "--seed"),
        (["-o", "out.dae"], "'.dae' cannot be written here; end the name in .glb"),
        (["-o", "out"], "a file without a suffix"),
        (["--preview", "out.avi"], ".mp4"),
        (["--without", "magic"], "there are smooth, gait, blocks, rest-pose"),
    ],
)
def test_bad_option_of_animate(fails, good, monkeypatch, tmp_path, options, reason):
    monkeypatch.chdir(tmp_path)
    assert reason in fails("animate", good, "walks", *options)


@pytest.mark.parametrize(
    ("prompt", "reason"), [("", "empty"), (" \t\n", "empty"), ("?!", "no words"), ("walk " * 2000, "10,000 characters")]
)
def test_bad_prompt(fails, good, tmp_path, prompt, reason):
    assert reason in fails("animate", good, prompt, "-o", tmp_path / "out.glb")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder that even root cannot write to")
def test_a_prompt_that_is_not_understood_is_refused_before_the_work(fails, good, tmp_path):
    said = fails("animate", good, "asdf qwer", "-o", tmp_path / "out.glb")
    assert "'asdf', 'qwer'" in said and "--force" in said and said.count("'a person ") == 3
    assert "'zxcv'" in fails("edit", good, "zxcv", "--keep", "legs", "-o", tmp_path / "out.glb")
    (tmp_path / "prompts.txt").write_text("walks\nqwer zxcv\n", encoding="utf-8")
    assert "line 2: no movement" in fails("animate", good, "--prompts", tmp_path / "prompts.txt")
    assert "no handle motion" in fails("edit", good, "zxcv", "--force", "--keep", "legs", "-o", tmp_path / "out.glb")


@pytest.mark.parametrize("verb", [["animate", "walks"], ["rig"]])
def test_folder_that_cannot_be_written(fails, good, verb):
    assert "cannot be written" in fails(verb[0], good, *verb[1:], "-o", "/proc/out.glb")


def test_output_folder_missing_or_a_file(fails, good, tmp_path):
    assert "do not exist" in fails("animate", good, "walks", "-o", tmp_path / "a" / "b" / "out.glb")
    assert "not a folder" in fails("animate", good, "walks", "-o", good / "out.glb")
    folder = tmp_path / "folder.glb"
    folder.mkdir()
    assert "folder" in fails("rig", good, "-o", folder)
    assert "the name is too long" in fails("animate", good, "walks", "-o", tmp_path / f"{'x' * 264}.glb")


def test_outputs_that_would_meet(fails, good, tmp_path, monkeypatch):
    before = good.read_bytes()
    assert "overwrite" in fails("rig", good, "-o", good)
    assert good.read_bytes() == before
    monkeypatch.chdir(tmp_path)
    for one, other in (("walk.glb", "./walk.glb"), ("walk.obj", "walk.ply")):
        assert "both" in fails("animate", good, "walks", "-o", one, "-o", other)


def test_a_folder_of_other_files_is_known_before_the_work(fails, good, tmp_path, monkeypatch):
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path))  # any work would fail for the lack of weights
    (tmp_path / "walk").mkdir()
    (tmp_path / "walk" / "letter.txt").write_text("mine")
    assert "holds other files" in fails("animate", good, "walks", "-o", tmp_path / "walk.obj")


def test_motion_without_a_character(fails, good, tmp_path):
    motion = tmp_path / "motion.npz"
    np.savez(motion, a=np.zeros(3))
    assert "--character" in fails("render", motion)
    assert "--character" in fails("render", good, "--character", good)
    assert "motion.npz" in fails("inspect", motion)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["animate"], "missing from bunraku animate: CHARACTER; `bunraku animate --help` shows"),
        (["animate", "a.glb", "walks", "--seconds", "soon"], "a number is expected, not 'soon'"),
        (["animate", "a.glb", "walks", "--secnds", "2"], "no option '--secnds'; did you mean '--seconds'?"),
        (["animate", "a.glb", "walks", "--rig", "mine"], "'mine' for argument '--rig'. Expected one of ('auto',"),
        (["inspect", "a.glb", "--nonsense=4"], "there is no option '--nonsense'"),
        (["inspect", "a.glb", "b.glb"], "not understood: b.glb"),
        (
            ["train", "handles", "--cache", "a", "--out", "b", "--loss.root-unit", "big"],
            "a number is expected, not 'big'",
        ),
        (["samples", "persona"], "person"),
        (["animte"], "did you mean 'animate'"),
        (["data", "motion"], "did you mean 'motions'"),
    ],
)
def test_wrong_words_are_one_sentence(fails, tmp_path, monkeypatch, words, sentence):
    monkeypatch.chdir(tmp_path)
    assert sentence in fails(*words)


def test_first_attempts_are_answered_sensibly(fails, good, monkeypatch):
    monkeypatch.chdir(good.parent)
    assert "where a sentence is expected; the character comes first" in fails("animate", "walks", good.name)
    assert "`bunraku samples person -o .` writes the sample" in fails("animate", "person", "walks")
    assert 'stands in quotes: "walks forward"' in fails("animate", good.name, "walks", "forward")
    assert "download it first" in fails("animate", "https://example.org/a.glb", "walks")
    assert "did you mean `bunraku animate good.glb ...`?" in fails(good.name, "walks")
    assert "no option '--play'; `bunraku clips --help` lists them" in fails("clips", "dance", "--play")


def test_usage_without_a_command_has_status_2(capsys):
    for words in ([], ["train"]):
        assert main(words) == 2 and "COMMAND" in capsys.readouterr().out


def test_help_keeps_no_line_breaks_of_the_source(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    assert main(["animate", "--help"]) == 0
    rows = [" ".join(line.strip("│ ").split()) for line in capsys.readouterr().out.splitlines()]
    row = next(row for row in rows if "File to write: .glb" in row)
    assert "the handle motion), .bvh or .vrma (what the humanoid skeleton does), .vmd" in row


def test_nothing_heavy_loads_before_the_checks(good, tmp_path):
    """In a fresh interpreter, bad options are refused without torch or the text encoder."""
    calls = [
        ["animate", str(good), "walks", "--seconds", "36001"],
        ["animate", str(good), ""],
        ["animate", str(good), "walks", "-o", str(tmp_path / "out.dae")],
        ["animate", str(tmp_path / "nowhere.glb"), "walks"],
    ]
    code = (
        f"import sys\nfrom bunraku.cli import main\nfor call in {calls!r}:\n    assert main(call) == 2\n"
        f"print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"torch", "transformers", "diffusers", "trimesh"}.intersection(done.stdout.split())


LIMITED = """
import resource, sys
from bunraku.cli import main
sys.dont_write_bytecode = True  # what Python keeps of the modules would be cut off too, for good
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))  # as a disk with room for 1 kB
sys.exit(main(sys.argv[1:]))
"""


def test_full_disk(tmp_path):
    """Nothing half-written stays when the disk takes no more."""
    out = tmp_path / "out"
    out.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, "samples", "mushroom", "-o", str(out)], capture_output=True, text=True
    )
    assert done.returncode == 2, done.stderr
    assert "bunraku: error: " in done.stderr and "Traceback" not in done.stderr
    assert list(out.iterdir()) == []
