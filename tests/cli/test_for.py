"""`animate --for` and `transfer --for`: the file that a program wants."""

import numpy as np
import pytest

from bunraku import save_character
from bunraku.cli import main
from bunraku.io import load_character
from bunraku.io.play import clip_names, load_animation
from bunraku.io.registry import load_with_clips
from bunraku.samples import sample_character

QUICK = ["--seconds", "1", "--steps", "4", "--candidates", "1"]


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return save_character(sample_character("person"), tmp_path_factory.mktemp("for") / "person.glb")


def test_a_person_without_a_skeleton_gets_that_of_the_engine(mesh, tmp_path):
    out = tmp_path / "moves.fbx"
    plain = tmp_path / "plain.glb"
    character = load_character(mesh)
    save_character(type(character)("plain", character.vertices, character.faces), plain)
    assert main(["animate", str(plain), "waves", "--for", "unreal", "-o", str(out), *QUICK]) == 0
    read = load_character(out)
    assert {"root", "pelvis", "hand_l", "calf_r"} <= set(read.rig.names)
    assert clip_names(load_with_clips(out, 30.0).source.document) == ["waves"]
    posed = load_animation(out, 0, 30.0).vertices()  # waving goes on as it is, so it is a loop
    assert len(posed) == 31 and np.abs(posed[-1] - posed[0]).max() < 0.02 < np.ptp(posed, axis=0).max()


def test_a_file_for_each_clip_where_the_program_wants_it(mesh, tmp_path, capsys):
    given = ["animate", str(mesh), "waves", "Nod=nods", "--for", "unreal", "-o", str(tmp_path / "p.fbx"), *QUICK]
    assert main(given) == 0
    assert sorted(path.name for path in tmp_path.glob("*.fbx")) == ["p-Nod.fbx", "p-waves.fbx"]
    (tmp_path / "q-waves.fbx").write_bytes(b"mine")
    given[given.index(str(tmp_path / "p.fbx"))] = str(tmp_path / "q.fbx")
    assert main(given) == 2 and (tmp_path / "q-waves.fbx").read_bytes() == b"mine"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--for", "maya"], "maya"),
        (["--for", "unity", "--add"], "--add"),
        (["--for", "unity", "-o", "a.glb"], ".fbx"),
        (["--for", "godot", "-o", "a.fbx"], ".glb"),
    ],
)
def test_what_cannot_be_is_refused(mesh, words, says, capsys):
    assert main(["animate", str(mesh), "waves", *words]) == 2
    said = capsys.readouterr()
    assert says in said.out + said.err


@pytest.fixture(scope="module")
def motions(mesh):
    """Two motions of files."""
    files = [mesh.with_name("walk.bvh"), mesh.with_name("wave.bvh")]
    for sentence, path in zip(("walks", "waves"), files, strict=True):
        assert main(["animate", str(mesh), sentence, "-o", str(path), *QUICK]) == 0
    return [str(path) for path in files]


def test_motions_become_the_clips_that_a_program_takes(mesh, motions, tmp_path, capsys):
    out = tmp_path / "moves.fbx"
    assert main(["transfer", str(mesh), *motions, "--for", "unity", "-o", str(out)]) == 0
    assert "walk, wave" in capsys.readouterr().out
    assert "mixamorig:Hips" in load_character(out).rig.names
    assert clip_names(load_with_clips(out, 30.0).source.document) == ["walk", "wave"]
    apart = [str(mesh), *motions, "--for", "unreal", "-o", str(tmp_path / "u.fbx")]
    assert main(["transfer", *apart]) == 0
    assert sorted(path.name for path in tmp_path.glob("u*.fbx")) == ["u-walk.fbx", "u-wave.fbx"]
    assert load_animation(tmp_path / "u-walk.fbx", 0, 30.0).vertices().std(axis=0).max() > 0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--for", "unity", "-o", "a.glb"], ".fbx"),
        (["--for", "unity", "--preview", "a.mp4"], "--preview"),
        (["--for", "unity", "--format", "bvh"], "--format"),
        (["--for", "unity", "--file-unit", "m"], "--file-unit"),
    ],
)
def test_what_a_program_does_not_take_is_refused(mesh, motions, words, says, capsys):
    assert main(["transfer", str(mesh), *motions, *words]) == 2
    said = capsys.readouterr()
    assert says in said.out + said.err


def test_a_program_takes_the_clips_of_one_character(mesh, motions, tmp_path, capsys):
    other = save_character(sample_character("robot"), tmp_path / "robot.glb")
    assert main(["transfer", str(mesh), str(other), *motions, "--for", "unity"]) == 2
    assert "one character" in capsys.readouterr().err
