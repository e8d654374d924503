"""A few of the many stops that `make stops` tries."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from stops import DRAWN_ANEW, INTERRUPTED, KILLED, Command, Killer, contents, interrupt, make_inputs

from bunraku.cli.app import all_verbs
from bunraku.core.nn.checkpoints import save_checkpoint

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs the /proc of Linux")


def test_every_command_is_interrupted_and_every_writer_is_killed():
    for verb in all_verbs():
        assert any(command.words[: len(verb)] == verb for command in INTERRUPTED), verb
    killed = {command.words[:2] for command in (*KILLED, DRAWN_ANEW)}
    assert {words[0] for words in killed} >= {"samples", "animate", "transfer"}
    assert killed >= {verb for verb in all_verbs() if verb[0] in ("data", "train")}


def test_networks_are_compared_without_the_seconds_and_the_folder(tmp_path):
    value = {"weight": torch.arange(4.0)}
    for name, seconds, other in (("a", 1.0, 0), ("b", 2.0, 0), ("c", 1.0, 1)):
        config = {"out": str(tmp_path / name), "seconds": seconds, "steps": 3}
        save_checkpoint(tmp_path / name / "x.safetensors", {"weight": value["weight"] + other}, config, "handles")
        (tmp_path / name / "log.csv").write_text(str(seconds))
    first, second, third = (contents(tmp_path / name) for name in "abc")
    assert first == second != third


def test_samples_that_are_killed_are_made_again(tmp_path):
    killer = Killer(KILLED[0], tmp_path / "kill", tmp_path)
    assert killer.events > 12 and len(killer.whole) > 5
    for event in (1, killer.events - 1):
        killer.check(event)


def test_a_difference_is_seen(tmp_path):
    killer = Killer(Command("samples", ("samples", "mushroom", "-o", "OUT")), tmp_path / "kill", tmp_path)
    killer.whole["mushroom.glb"] = b"another"
    with pytest.raises(AssertionError, match="mushroom.glb"):
        killer.check(2)
    assert contents(tmp_path / "kill" / "whole" / "out")["mushroom.glb"] != b"another"


@pytest.mark.parametrize("seconds", [0.2, 1.5])
def test_an_interrupted_command_is_gone_with_one_line(tmp_path, seconds):
    command = next(command for command in INTERRUPTED if command.name == "rig")
    make_inputs(tmp_path, (Command("", (), ("person",)),))
    assert interrupt(command, tmp_path, tmp_path / "out", seconds) == ""
