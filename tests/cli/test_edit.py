"""`bunraku edit`, and options for engines."""

import numpy as np
import pytest

from bunraku import save_character
from bunraku.cli import main
from bunraku.cli.edit import parse_span
from bunraku.core.body.layout import kept_handles
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.errors import OptionError
from bunraku.files import load_character
from bunraku.files.clips import clip_names, load_animation, load_clip
from bunraku.files.registry import load_with_clips
from bunraku.files.samples import sample_character

needs_weights = pytest.mark.skipif(
    not (shipped_checkpoint("handles").is_file() and shipped_checkpoint("diffusion").is_file()),
    reason="the shipped weights are not there",
)
QUICK = ["--steps", "2"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    from bunraku.files import save_character
    from bunraku_lab.synthetic.samples import make_sample

    folder = tmp_path_factory.mktemp("edit")
    save_character(make_sample("person", 0.3), folder / "person.glb")
    if shipped_checkpoint("diffusion").is_file():
        words = ["animate", str(folder / "person.glb"), "walks:1.5; waves:1.5", *QUICK]
        assert main([*words, "-o", str(folder / "clip.glb"), "-o", str(folder / "clip.npz")]) == 0
    return folder


@needs_weights
def test_a_sequence_lasts_as_long_as_its_parts(folder):
    clip = load_clip(folder / "clip.glb")
    assert len(clip.motion) == 60
    assert np.array_equal(clip.motion.rotations, load_clip(folder / "clip.npz").motion.rotations)


@needs_weights
def test_kept_handles_are_the_same_in_the_new_file(folder):
    before = load_clip(folder / "clip.glb")
    words = ["edit", str(folder / "clip.glb"), "jumps", "--keep", "legs", "-o", str(folder / "edit.glb")]
    assert main([*words, *QUICK]) == 0
    after, legs = load_clip(folder / "edit.glb"), kept_handles("legs")
    for one, other in ((before.motion, after.motion), (before.reference, after.reference)):
        assert np.array_equal(one.rotations[:, legs], other.rotations[:, legs])
        assert np.array_equal(one.translations[:, legs], other.translations[:, legs])
        assert np.array_equal(one.root_translation, other.root_translation)
        assert not np.array_equal(one.rotations, other.rotations)


@needs_weights
@pytest.mark.parametrize("character", [False, True])
def test_a_span_of_an_npz(folder, character, capsys):
    out = folder / f"span-{character}.npz"
    words = ["edit", str(folder / "clip.npz"), "jumps", "--span", "0.5:2", "-o", str(out), *QUICK]
    assert main([*words, *(["--character", str(folder / "person.glb")] if character else [])]) == 0
    assert ("--character" in capsys.readouterr().err) == (not character)
    before, after = load_clip(folder / "clip.npz"), load_clip(out)
    outside = np.r_[0:10, 40:60]
    assert np.array_equal(after.reference.rotations[outside], before.reference.rotations[outside])
    ours = before.motion if character else before.reference
    assert np.array_equal(after.motion.rotations[outside], ours.rotations[outside])
    assert not np.array_equal(after.motion.rotations, ours.rotations)


@needs_weights
def test_after_another_clip_and_loops(folder):
    person, clip = str(folder / "person.glb"), load_clip(folder / "clip.glb")
    words = ["animate", person, "jumps", "--seconds", "1", "--after", str(folder / "clip.glb")]
    assert main([*words, "-o", str(folder / "next.npz"), *QUICK]) == 0
    found = load_clip(folder / "next.npz").motion
    assert np.array_equal(found.rotations[0], clip.motion.rotations[-1]) and np.array_equal(
        found.root_translation[0], clip.motion.root_translation[-1]
    )
    words = ["animate", person, "walks", "--seconds", "1.5", "--loop", "--in-place"]
    assert main([*words, "-o", str(folder / "loop.npz"), *QUICK]) == 0
    found = load_clip(folder / "loop.npz").motion
    assert len(found) == 31 and np.array_equal(found.rotations[0], found.rotations[-1])
    np.testing.assert_allclose(found.root_translation[0], found.root_translation[-1], atol=1e-4)


@needs_weights
def test_a_file_of_prompts_goes_on_where_it_stopped(folder, capsys):
    (folder / "prompts.txt").write_text("walks\n\njumps; waves\nruns:1\n", encoding="utf-8")
    files = ["--prompts", str(folder / "prompts.txt"), "-o", str(folder / "clips")]
    words = ["animate", str(folder / "person.glb"), *files, "--seconds", "1", *QUICK]
    assert main(words) == 0
    files = sorted((folder / "clips").glob("*.glb"))
    assert [path.name for path in files] == ["001-walks.glb", "002-jumps-waves.glb", "003-runs-1.glb"]
    one = load_clip(files[1]).motion
    files[1].unlink()
    stamp = files[0].stat().st_mtime_ns
    capsys.readouterr()
    assert main(words) == 0
    assert "2 of 3 clips are there already" in capsys.readouterr().out and files[0].stat().st_mtime_ns == stamp
    np.testing.assert_allclose(load_clip(files[1]).motion.rotations, one.rotations, atol=2e-3)  # alone as among others
    before = files[0].read_bytes()
    for other in (["--seed", "1"], ["--seconds", "2"]):  # not these clips, so nothing is said to be there already
        assert main([*words, *other]) == 2
        assert "--overwrite" in capsys.readouterr().err and files[0].read_bytes() == before
    assert main([*words, "--seed", "1", "--overwrite"]) == 0 and files[0].read_bytes() != before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["animate", "{}", "walks:20000; runs:20000"], "40000 seconds in all"),
        (["animate", "{}", "walks;;runs"], "part 2"),
        (["animate", "{}", ""], "prompt is empty"),
        (["animate", "{}", "walks", "--loop", "--after", "{}"], "do not go together"),
        (["animate", "{}", "walks", "--prompts", "{}"], "both given"),
        (["animate", "{}", "walks", "--after", "none.glb"], "no such file"),
        (["edit", "{}", "walks"], "nothing is kept"),
        (["edit", "{}", "walks", "--keep", "legz"], "no part 'legz'"),
        (["edit", "{}", "walks", "--span", "3"], "--span is two seconds"),
        (["edit", "{}", "walks", "--keep", "legs"], "no handle motion of Bunraku"),
        (["edit", "{}", "walks", "--keep", "legs", "-o", "{}"], "overwrite the input"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(words, said, folder, capsys):
    assert main([word.format(folder / "person.glb") for word in words]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


def test_prompts_name_their_line(folder, capsys):
    (folder / "bad.txt").write_text("walks\n...\n")
    assert main(["animate", str(folder / "person.glb"), "--prompts", str(folder / "bad.txt")]) == 2
    assert "bad.txt, line 2: " in capsys.readouterr().err


def test_spans():
    assert parse_span("1.0:3.0") == (1, 3) and parse_span("0:.5") == (0, 0.5)
    for text in ("1", "3:1", "a:b", "-1:2", "1:2:3", "nan:2", ":"):
        with pytest.raises(OptionError, match="--span"):
            parse_span(text)


QUICK_EDIT = ["--seconds", "1", "--steps", "4", "--candidates", "1"]


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return save_character(sample_character("person"), tmp_path_factory.mktemp("for") / "person.glb")


def test_a_person_without_a_skeleton_gets_that_of_the_engine(mesh, tmp_path):
    out = tmp_path / "moves.fbx"
    plain = tmp_path / "plain.glb"
    character = load_character(mesh)
    save_character(type(character)("plain", character.vertices, character.faces), plain)
    assert main(["animate", str(plain), "waves", "--for", "unreal", "-o", str(out), *QUICK_EDIT]) == 0
    read = load_character(out)
    assert {"root", "pelvis", "hand_l", "calf_r"} <= set(read.rig.names)
    assert clip_names(load_with_clips(out, 30.0).source.document) == ["waves"]
    posed = load_animation(out, 0, 30.0).vertices()  # waving goes on as it is, so it is a loop
    assert len(posed) == 31 and np.abs(posed[-1] - posed[0]).max() < 0.02 < np.ptp(posed, axis=0).max()


def test_a_file_for_each_clip_where_the_program_wants_it(mesh, tmp_path, capsys):
    given = ["animate", str(mesh), "waves", "Nod=nods", "--for", "unreal", "-o", str(tmp_path / "p.fbx"), *QUICK_EDIT]
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
        assert main(["animate", str(mesh), sentence, "-o", str(path), *QUICK_EDIT]) == 0
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
