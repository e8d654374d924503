"""Many clips of `bunraku animate`: passes of the network, folders of characters, several processes."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from bunraku.cli import main
from bunraku.cli.verbs.batch import characters_of, clips_of, passes
from bunraku.errors import FormatError
from bunraku.formats.files import weights_file
from bunraku.io.clips import load_clip

needs_weights = pytest.mark.skipif(
    not (weights_file("diffusion.safetensors")).is_file(), reason="the shipped weights are not there"
)
QUICK = ("--seconds", "0.5", "--steps", "2", "--candidates", "1")


def test_clips_of_a_pass_stay_together():
    prompts = [f"walks {number}" for number in range(5)]
    clips = clips_of(Path("out"), Path("c.glb"), prompts, 2, lambda character, prompt: f"{character} {prompt}")
    assert [clip.path.name for clip in clips[:2]] == ["001-walks-0.glb", "002-walks-1.glb"]
    assert [(clip.number, clip.beside[clip.number]) for clip in clips] == [
        (number % 2, prompt) for number, prompt in enumerate(prompts)
    ]
    assert [len(some) for some in passes(clips)] == [2, 2, 1]
    assert [len(some) for some in passes([clips[0], clips[3], clips[4]])] == [1, 1, 1]
    same = clips_of(Path("out"), Path("c.glb"), ["walks"] * 4, 2, lambda character, prompt: prompt)
    assert [len(some) for some in passes(same)] == [2, 2]  # equal passes are not one


def test_characters_of_a_folder(tmp_path):
    with pytest.raises(FormatError, match="no character"):
        characters_of(tmp_path)
    for name in ("b.obj", "a.GLB", "a.ply", "notes.txt", "walk.bvh"):
        (tmp_path / name).write_text("x")
    (tmp_path / "folder.glb").mkdir()
    found = {path.name: name for path, name in characters_of(tmp_path).items()}
    assert found == {"a.GLB": "a.GLB", "a.ply": "a.ply", "b.obj": "b"}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("walks", "--preview", "p.mp4"), "without --preview"),
        (("walks", "--jobs", "none"), "--jobs is a number"),
        (("",), "prompt is empty"),
    ],
)
def test_what_a_folder_does_not_take(tmp_path, capsys, words, said):
    (tmp_path / "a.glb").write_bytes(b"glTF")
    assert main(["animate", str(tmp_path), *words]) == 2
    assert said in capsys.readouterr().err


def test_clips_do_not_go_among_the_characters(good, capsys):
    assert main(["animate", str(good.parent), "walks", "-o", str(good.parent)]) == 2
    assert "among the characters" in capsys.readouterr().err
    assert main(["animate", str(good), "walks", "--jobs", "2"]) == 2
    assert "leave it out" in capsys.readouterr().err


@needs_weights
def test_a_folder_of_characters_on_two_processes(tmp_path, capsys):
    folder, out, alone = tmp_path / "characters", tmp_path / "out", tmp_path / "alone"
    assert main(["samples", "mushroom", "-o", str(folder)]) == 0
    shutil.copy2(folder / "mushroom.glb", folder / "second.glb")
    (folder / "bad.glb").write_bytes(b"glTF and nothing")
    (tmp_path / "lines.txt").write_text("a person walks\nwaves\n")
    words = ["--prompts", str(tmp_path / "lines.txt"), *QUICK]
    capsys.readouterr()
    assert main(["animate", str(folder), *words, "--jobs", "2", "-o", str(out)]) == 1
    said = capsys.readouterr().err.splitlines()
    assert [line for line in said if "failed" in line and "bad.glb" in line]
    made = sorted(path.relative_to(out).as_posix() for path in out.rglob("*.glb"))
    names = ("001-a-person-walks.glb", "002-waves.glb")
    assert made == [f"{character}/{name}" for character in ("mushroom", "second") for name in names]
    assert main(["animate", str(folder / "mushroom.glb"), *words, "-o", str(alone)]) == 0
    for name in names:
        one, other = load_clip(out / "mushroom" / name).motion, load_clip(alone / name).motion
        np.testing.assert_allclose(one.rotations, other.rotations, atol=1e-4)
        assert (out / "second" / name).read_bytes() == (out / "mushroom" / name).read_bytes()
    capsys.readouterr()
    assert main(["animate", str(folder), *words, "-o", str(out)]) == 1  # the bad one is tried again, nothing else
    assert "4 of 6 clips are there already" in capsys.readouterr().out
