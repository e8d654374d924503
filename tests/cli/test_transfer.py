"""`bunraku transfer` and `bunraku animate` for many files."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import signal
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from mmd_bytes import Bone, plank, pmx

from bunraku import transfer
from bunraku.cli import main
from bunraku.cli.animate import characters_of, clips_of, passes
from bunraku.cli.manifest import note_done
from bunraku.cli.shared import run_results, unfinished_results
from bunraku.cli.transfer import Transfer, batches, pairs_of, transfer_pairs
from bunraku.core.animation import RigAnimation
from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.files import weights_file
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.errors import FormatError
from bunraku.files import load_character
from bunraku.files.clips import load_clip
from bunraku.files.mmd.vmd import load_vmd
from bunraku.files.motions.bvh import write_bvh
from bunraku.pipelines.to_reference import load_motion
from bunraku.retarget.mmd_motion import mmd_animation, standard_model

SETTINGS = Transfer(())


def waving(skeleton=None, frames=8):
    body = reference_body()
    turns = np.zeros((frames, 22, 3))
    turns[:, JOINT_NAMES.index("left_shoulder"), 2] = np.linspace(-1.2, 0.5, frames)
    return SkeletalMotion(
        skeleton or body.skeleton, matrix_from_axis_angle(turns), np.tile(body.joints[0], (frames, 1)), 20.0
    )


@pytest.fixture
def files(tmp_path):
    """A rigged person, two waves and a file that is no motion."""
    character = reference_body().character()
    still = RigAnimation(character, np.tile(np.eye(3), (2, 22, 1, 1)), np.zeros((2, 22, 3)))
    still.save(tmp_path / "person.glb")
    write_bvh(waving(), tmp_path / "wave.bvh")
    write_bvh(waving(frames=12), tmp_path / "again.bvh")
    (tmp_path / "bad.bvh").write_text("this is none\n")
    return tmp_path


def run(*words):
    return main(["transfer", *map(str, words)])


def test_one_pair(files, capsys):
    out = files / "out.glb"
    assert run(files / "wave.bvh", files / "person.glb", "-o", out, "--fps", 20, "--preview", files / "out.webp") == 0
    said = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in said] == [str(out), str(files / "out.webp")]
    assert load_character(out).rig.names == JOINT_NAMES


def test_other_formats(files):
    assert run(files / "person.glb", files / "wave.bvh", "-o", files / "out.npz") == 0
    assert run(files / "person.glb", files / "wave.bvh", "-o", files / "out.bvh") == 0


@pytest.fixture
def doll(files):
    """The same person as an MMD model with the standard bones."""
    bones = [
        Bone(some.name, tuple(some.position * [1, 1, -1] / 0.08), some.parent, some.layer)
        for some in standard_model().bones
    ]
    (files / "doll.pmx").write_bytes(pmx(plank(bones=bones, bodies=[], joints=[], textures=[])))
    return files / "doll.pmx"


def test_axis_and_unit_of_what_is_written(files, fails, capsys):
    assert run(files / "wave.bvh", files / "person.glb", "-o", files / "own.bvh") == 0
    assert (
        run(files / "wave.bvh", files / "person.glb", "-o", files / "other.bvh", "--file-up", "+z", "--file-unit", "m")
        == 0
    )

    def offset(name):  # of the left hip
        lines = (files / name).read_text().splitlines()
        return np.array([line.split()[1:] for line in lines if line.strip().startswith("OFFSET")][1], float)

    x, y, z = offset("own.bvh")
    np.testing.assert_allclose(offset("other.bvh"), [x / 100, -z / 100, y / 100], atol=1e-4)
    capsys.readouterr()
    fails(
        ["transfer", str(files / "wave.bvh"), str(files / "person.glb"), "-o", str(files / "x.glb"), "--file-up", "+z"],
        "up",
    )


def test_vmd_of_an_mmd_character(files, doll, fails, capsys):
    assert run(doll, files / "wave.bvh", "--onto", "rig", "-o", files / "wave.vmd") == 0
    vmd, character = load_vmd(files / "wave.vmd"), load_character(doll)
    known = transfer(character, files / "wave.bvh", onto="rig", fps=30)
    assert np.abs(mmd_animation(character, vmd).vertices() - known.vertices()).max() < 1e-4
    assert run(doll, files / "wave.vmd", "-o", files / "again.vmd") == 0  # a VMD is played, so this is a copy
    assert np.abs(mmd_animation(character, load_vmd(files / "again.vmd")).vertices() - known.vertices()).max() < 1e-4
    capsys.readouterr()
    assert "transfer onto a .pmx" in fails(
        "transfer", files / "person.glb", files / "wave.bvh", "-o", files / "person.vmd"
    )


def test_a_batch_in_another_format(files, doll, fails, capsys):
    words = (doll, files / "wave.bvh", files / "again.bvh", "--onto", "rig", "-o", files / "out")
    for suffix in ("vmd", ".vrma", "BVH", "ply"):
        assert run(*words, "--format", suffix) == 0
        capsys.readouterr()
        assert run(*words, "--format", suffix) == 0
        assert "2 of 2 files are there already" in capsys.readouterr().out
    written = sorted(path.name for path in (files / "out").glob("doll*"))
    assert written == sorted(
        f"doll-{motion}{suffix}" for motion in ("again", "wave") for suffix in ("", ".bvh", ".vmd", ".vrma")
    )
    assert len(load_motion(files / "out" / "doll-wave.bvh")) == len(load_motion(files / "out" / "doll-wave.vrma")) == 11
    assert "--format" in fails("transfer", *words, "--format", "docx")


def test_a_process_that_is_killed_takes_no_other_pair_along(files):
    for name in ("third", "fourth", "fifth", "sixth"):
        shutil.copy2(files / "wave.bvh", files / f"{name}.bvh")
    pairs = pairs_of([files / "person.glb"], sorted(files.glob("*.bvh")), files, ".glb", SETTINGS)
    results = run_results(partial(transfer_pairs, SETTINGS), batches(pairs, 2), 2)
    done = dict([next(results)])
    victim = multiprocessing.active_children()[0]
    os.kill(victim.pid, signal.SIGKILL)  # as the system does where memory runs out
    for pair, reason in results:
        assert pair not in done
        done[pair] = reason
    assert set(done) == set(pairs)
    assert [pair.inputs[1].name for pair in pairs if done[pair]] == ["bad.bvh"]
    assert all(pair.path.is_file() for pair in pairs if pair.inputs[1].name != "bad.bvh")


def test_many_pairs(files, capsys):
    out = files / "out"
    words = (files / "person.glb", files / "wave.bvh", files / "again.bvh", files / "bad.bvh", "-o", out)
    assert run(*words) == 1
    said = capsys.readouterr()
    assert sorted(path.name for path in out.glob("*.glb")) == ["person-again.glb", "person-wave.glb"]
    failures = [line for line in said.err.splitlines() if line.startswith("bunraku: failed: ")]
    assert len(failures) == 1 and "bad.bvh" in failures[0] and "BVH" in failures[0]
    before = (out / "person-wave.glb").stat().st_mtime_ns
    assert run(*words[:3], "-o", out) == 0
    assert "2 of 2 files are there already" in capsys.readouterr().out
    assert (out / "person-wave.glb").stat().st_mtime_ns == before
    assert run(*words[:3], "-o", out, "--without", "hands") == 2  # other settings: nothing is replaced unasked
    assert "--overwrite" in capsys.readouterr().err and (out / "person-wave.glb").stat().st_mtime_ns == before
    assert run(*words[:3], "-o", out, "--without", "hands", "--overwrite") == 0
    assert (out / "person-wave.glb").stat().st_mtime_ns != before


def test_a_map_of_names(files, capsys):
    skeleton = reference_body().skeleton
    names = tuple(f"j{number:02d}" for number in range(22))
    write_bvh(waving(Skeleton(names, skeleton.parents, skeleton.offsets)), files / "nameless.bvh")
    (files / "names.json").write_text(json.dumps(dict(zip(JOINT_NAMES, names, strict=True))))
    assert (
        run(files / "person.glb", files / "nameless.bvh", "--map", files / "names.json", "-o", files / "out.glb") == 0
    )


def test_what_is_wrong_is_one_sentence(fails, files):
    person, wave = files / "person.glb", files / "wave.bvh"
    assert "no such file" in fails("transfer", person, files / "none.bvh")
    assert "HIERARCHY" in fails("transfer", person, files / "bad.bvh", "-o", files / "out.glb")
    assert "none of these files is a character" in fails("transfer", wave, files / "again.bvh")
    assert "after --motions" in fails("transfer", person, person)
    assert "name a folder" in fails("transfer", person, wave, files / "again.bvh", "-o", files / "out.glb")
    assert "--jobs" in fails("transfer", person, wave, "--jobs", "many")
    assert "--jobs" in fails("transfer", person, wave, "--jobs", "9" * 5000)
    assert "--without names no stage" in fails("transfer", person, wave, "--without", "arms")
    assert "--fps" in fails("transfer", person, wave, "--fps", 0)
    assert "overwrite the input" in fails("transfer", person, wave, "-o", person)
    (files / "list.json").write_text("[1]")
    assert "object of texts" in fails("transfer", person, wave, "--map", files / "list.json")
    (files / "wrong.json").write_text('{"tail": "x"}')
    assert "not one of SMPL's joints" in fails("transfer", person, wave, "--map", files / "wrong.json")


def test_ray(files, fails):
    try:
        import ray  # noqa: F401
    except ImportError:
        from bunraku.errors import MissingExtraError

        with pytest.raises(MissingExtraError, match=r"bunraku\[ray\]"):
            pairs = pairs_of([files / "person.glb"], [files / "wave.bvh"], files, ".glb", SETTINGS)
            list(run_results(partial(transfer_pairs, SETTINGS), [pairs], "ray"))
        pytest.skip("ray is not installed; only its absence is tested")
    assert run(files / "person.glb", files / "wave.bvh", files / "again.bvh", "-o", files / "out", "--jobs", "ray") == 0
    assert run(files / "person.glb", files / "wave.bvh", files / "again.bvh", "-o", files / "plain") == 0
    assert (files / "out" / "person-wave.glb").read_bytes() == (files / "plain" / "person-wave.glb").read_bytes()


def test_inputs_are_never_written_over(fails, files):
    taken = files / "person-wave.glb"
    taken.write_bytes((files / "person.glb").read_bytes())
    before = taken.read_bytes()
    assert "overwrite the input" in fails("transfer", files / "person.glb", taken, files / "wave.bvh", "-o", files)
    assert taken.read_bytes() == before


def test_a_bad_input_is_named_where_a_file_was_meant(fails, files):
    assert "none.bvh: there is no" in fails(
        "transfer", files / "person.glb", files / "wave.bvh", files / "none.bvh", "-o", files / "out.glb"
    )


def test_another_file_of_the_same_name_size_and_time_is_another(files):
    other = files / "other" / "wave.bvh"
    other.parent.mkdir()
    shutil.copy2(files / "wave.bvh", other)
    folder, person = files / "out", files / "person.glb"
    first, second = (pairs_of([person], [path], folder, ".glb", SETTINGS) for path in (files / "wave.bvh", other))
    folder.mkdir()
    first[0].path.write_bytes(b"done")
    note_done(first[0].path, first[0].mark)
    assert unfinished_results(first, False, "files") == []
    with pytest.raises(FormatError, match="--overwrite"):
        unfinished_results(second, False, "files")


def test_a_batch_never_replaces_a_file_that_it_did_not_write(files, fails, capsys):
    own = files / "out" / "person-wave.glb"
    own.parent.mkdir()
    own.write_bytes(b"the user's own")
    words = (files / "person.glb", files / "wave.bvh", files / "again.bvh", "-o", files / "out")
    assert "person-wave.glb" in fails("transfer", *words)
    assert own.read_bytes() == b"the user's own"
    assert run(*words, "--overwrite") == 0 and own.read_bytes().startswith(b"glTF")
    capsys.readouterr()
    assert run(*words) == 0 and "2 of 2 files are there already" in capsys.readouterr().out
    own.write_bytes(b"changed by the user")
    assert run(*words) == 2 and own.read_bytes() == b"changed by the user"


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
    tree = b'{"asset":{"generator":"bunraku"},"animations":[{}]}'
    (tmp_path / "a-walks.glb").write_bytes(b"glTF" + bytes(8) + len(tree).to_bytes(4, "little") + b"JSON" + tree)
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


def test_clips_of_this_folder_have_its_name(tmp_path, monkeypatch, capsys):
    (tmp_path / "heroes").mkdir()
    monkeypatch.chdir(tmp_path / "heroes")
    for name in ("a.glb", "b.glb"):
        Path(name).write_bytes(b"glTF")
    assert main(["animate", ".", "walks"]) == 1
    assert Path("heroes-clips").is_dir() and not Path("-clips").exists()


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
