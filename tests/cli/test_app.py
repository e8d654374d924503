"""The command line's frame: help, version, exit statuses."""

import errno
import os
import subprocess
import sys

import pytest

import bunraku
from bunraku.cli import main
from bunraku.cli.app import _explain, all_verbs
from bunraku.cli.output.checks import slug
from bunraku.cli.output.outputs import size_text
from bunraku.cli.verbs.samples import Samples


@pytest.mark.parametrize("verb", all_verbs())
def test_every_verb_helps_with_an_example(capsys, verb):
    assert main([*verb, "--help"]) == 0
    said = capsys.readouterr().out
    assert f"bunraku {' '.join(verb)}" in said
    assert f"Example: bunraku {' '.join(verb)}" in " ".join(said.split())


def test_help_names_every_verb(capsys):
    assert main(["--help"]) == 0
    said = capsys.readouterr().out
    assert all(" ".join(verb) in said for verb in all_verbs())
    assert main(["data", "--help"]) == 0
    assert "animate" not in capsys.readouterr().out


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"bunraku {bunraku.__version__}\n"


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
    got, sentence = _explain(error)
    assert got == status and words in sentence


def _raising(error):
    def run(self):
        raise error

    return run


def test_interrupt_is_130(monkeypatch, capsys):
    monkeypatch.setattr(Samples, "run", _raising(KeyboardInterrupt()))
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


def test_closed_pipe_is_quiet(good):
    """`bunraku inspect FILE | head -c 1`: the reader goes away."""
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as pipe:
        done = subprocess.run(
            [sys.executable, "-m", "bunraku", "inspect", str(good), "--json"],
            stdout=pipe,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert done.returncode == 141 and done.stderr == ""


def test_slug():
    assert slug("Walks forward, then waves!") == "walks-forward-then-waves"
    assert slug("../../etc/passwd") == "etc-passwd"
    assert slug("!!") == "motion"
    assert len(slug("x" * 500)) <= 40 and len(slug("word " * 100)) <= 40
    assert slug("word " * 100) != slug("word " * 99)  # what begins alike is told apart


def test_size_text():
    assert [size_text(n) for n in (0, 999, 1500, 2_500_000, 3 * 10**9)] == [
        "0 bytes",
        "999 bytes",
        "1.5 kB",
        "2.5 MB",
        "3.0 GB",
    ]


@pytest.mark.parametrize("stream", ["stdout", "stderr", "both"])
def test_closed_streams_are_no_fault(good, stream):
    closed = {"stdout": ">&-", "stderr": "2>&-", "both": ">&- 2>&-"}[stream]
    words = [sys.executable, "-m", "bunraku", "inspect", str(good)]
    done = subprocess.run(["sh", "-c", f'"$@" {closed}', "sh", *words], capture_output=True, text=True)
    assert done.returncode in (0, 141) and "fault" not in done.stderr and "Traceback" not in done.stderr


def test_a_stream_of_few_letters_is_no_fault(tmp_path, glb):
    path = tmp_path / "füchsin.glb"
    path.write_bytes(glb())
    done = subprocess.run(
        [sys.executable, "-m", "bunraku", "inspect", str(path)],
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"},
    )
    assert done.returncode == 0 and b"f\\xfcchsin" in done.stdout and b"fault" not in done.stderr


@pytest.mark.parametrize("after", [0.0, 0.05, 0.15])
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


@pytest.mark.skipif(os.name == "nt", reason="Windows sends no such signal")
def test_an_interrupt_of_what_torch_calls_while_it_is_loaded_is_no_abort():
    """Its module for distributed work asks for modules from C++ that lets no exception through."""
    code = (
        "import signal, sys, bunraku.cli\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def main():\n"
        "    inside = []\n"
        "    def look(frame, event, what):\n"
        "        if event == 'c_call' and what.__name__ == '_c10d_init':\n"
        "            inside.append(what)\n"
        "        elif event == 'call' and inside:\n"
        "            sys.setprofile(None)\n"
        "            signal.raise_signal(signal.SIGINT)\n"
        "    sys.setprofile(look)\n"
        "    import torch\n"
        "bunraku.cli.main = main\n"
        "from bunraku.__main__ import run\n"
        "run()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 130 and done.stderr == "bunraku: interrupted\n"
