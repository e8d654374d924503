"""What the verbs do when all is well, with tiny real files."""

import dataclasses
import errno
import importlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
import tyro

import bunraku
from bunraku.cli import main
from bunraku.cli.app import all_verbs
from bunraku.cli.inspect import describe
from bunraku.cli.options import ApparelOptions
from bunraku.core.avatars import mmd_model
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.core.request import WHOLE
from bunraku.files.mmd.write import save_pmx
from bunraku.files.samples import sample_names
from bunraku_lab.synthetic.wardrobe import wardrobe_character

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def moving(tmp_path_factory) -> Path:
    """A GLB of a tetrahedron of two handles, of which one swings for half a second."""
    folder = tmp_path_factory.mktemp("moving")
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1.5, 0], [0, 0, 1]], np.float32)
    character = bunraku.Character("swing", vertices, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    handles = bunraku.Handles([[0, 0, 0], [0, 1.5, 0]], [[1, 0], [0.5, 0.5], [0, 1], [1, 0]])
    translations = np.zeros((11, 2, 3))
    translations[:, 1, 0] = np.sin(np.arange(11))
    rotations = np.tile(np.eye(3), (11, 2, 1, 1))
    motion = bunraku.HandleMotion(translations, rotations, np.zeros((11, 3)), np.tile(np.eye(3), (11, 1, 1)), fps=20)
    animation = bunraku.Animation(character, handles, motion)
    animation.save(folder / "swing.npz")
    return animation.save(folder / "swing.glb")


def test_inspect_counts_what_the_file_holds(good):
    facts = describe(good)
    assert (facts["vertices"], facts["faces"], facts["loose_parts"], facts["meshes"]) == (4, 4, 1, 1)
    assert facts["height"] == 1.5 and facts["extent"] == [1, 1.5, 1] and facts["lowest_corner"] == [0, 0, 0]
    assert facts["rig"] is None and facts["animations"] == [] and facts["orientation"]["taken_up"] == "+y"


def test_inspect_of_rig_clip_and_motion(moving, capsys):
    assert main(["inspect", str(moving), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["rig"]["joints"] == 2 and facts["rig"]["influences"] == 2
    assert facts["animations"][0]["seconds"] == pytest.approx(0.5)
    assert main(["inspect", str(moving)]) == 0
    said = capsys.readouterr().out
    assert "0.5 s" in said and "2 joints" in said
    facts = describe(moving.with_suffix(".npz"))
    assert (facts["kind"], facts["frames"], facts["fps"], facts["handles"]) == ("handle motion", 11, 20, 2)
    assert facts["seconds"] == pytest.approx(0.55)


@pytest.mark.parametrize(
    ("suffix", "magic", "at"), [(".mp4", b"ftyp", 4), (".webp", b"WEBP", 8), (".png", b"\x89PNG", 0)]
)
def test_render_plays_a_file(moving, tmp_path, capsys, suffix, magic, at):
    out = tmp_path / f"swing{suffix}"
    assert main(["render", str(moving), "-o", str(out), "--fps", "8", "--size", "96", "80"]) == 0
    assert out.read_bytes()[at : at + len(magic)] == magic
    assert f"wrote {out}" in capsys.readouterr().out


def test_render_of_a_character_is_a_still_beside_the_user(good, tmp_path, monkeypatch, fails):
    monkeypatch.chdir(tmp_path)
    assert "no animation" in fails("render", good, "-o", tmp_path / "still.mp4")
    assert main(["render", str(good), "--size", "96", "80"]) == 0
    from PIL import Image

    assert Image.open(tmp_path / "good.png").size == (96, 80)


def test_samples_are_written_and_listed(tmp_path, capsys):
    assert main(["samples", "--list"]) == 0
    assert capsys.readouterr().out.split() == [*sample_names(), "knight", "hero", "avatar", "walk", "ten"]
    assert main(["samples", "mushroom", "-o", str(tmp_path / "new")]) == 0
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["mushroom.glb"]


def test_samples_never_replace_another_file(tmp_path, capsys):
    path = tmp_path / "mushroom.glb"
    path.write_bytes(b"the user's own")
    assert main(["samples", "mushroom", "-o", str(tmp_path)]) == 2
    assert "--overwrite" in capsys.readouterr().err and path.read_bytes() == b"the user's own"
    assert main(["samples", "mushroom", "-o", str(tmp_path), "--overwrite"]) == 0
    stamp = path.stat().st_mtime_ns
    capsys.readouterr()
    assert main(["samples", "mushroom", "-o", str(tmp_path)]) == 0  # the same command again
    assert "1 of 1 samples are there already" in capsys.readouterr().out and path.stat().st_mtime_ns == stamp


def test_doctor_reports_in_words_and_in_json(capsys):
    status = main(["doctor", "--json"])
    findings = json.loads(capsys.readouterr().out)
    topics = {finding["topic"]: finding for finding in findings}
    weights = {"handles weights", "diffusion weights", "text weights"}
    assert weights | {"bunraku", "python", "torch", "numpy", "scipy", "preview"} <= set(topics)
    assert status == int(any(finding["state"] == "missing" for finding in findings))
    assert all(finding["cost"] for finding in findings if finding["state"] != "ok")
    assert main(["doctor"]) == status
    assert "torch" in capsys.readouterr().out


def test_missing_weights_are_one_sentence_and_the_doctor_tells_what_they_cost(
    monkeypatch, tmp_path, capsys, fails, good
):
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path / "none"))
    (tmp_path / "none").mkdir()
    assert "weights" in fails("animate", good, "walks", "-o", tmp_path / "out.glb")
    assert main(["doctor", "--json"]) == 1
    topics = {finding["topic"]: finding for finding in json.loads(capsys.readouterr().out)}
    assert topics["diffusion weights"]["state"] == "missing" and "animate" in topics["diffusion weights"]["cost"]


def need_weights() -> None:
    for name in ("handles", "diffusion"):
        try:
            shipped_checkpoint(name)
        except bunraku.WeightsError as error:
            pytest.skip(str(error))


def test_rig_writes_the_handles_as_a_skin(tmp_path, capsys):
    need_weights()
    assert main(["samples", "mushroom", "-o", str(tmp_path)]) == 0
    out, picture = tmp_path / "rigged.glb", tmp_path / "handles.png"
    assert main(["rig", str(tmp_path / "mushroom.glb"), "-o", str(out), "--preview", str(picture)]) == 0
    facts = describe(out)
    assert facts["rig"]["joints"] == 30 and facts["rig"]["influences"] <= 4
    assert facts["vertices"] == describe(tmp_path / "mushroom.glb")["vertices"]
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_rig_writes_what_can_be_written_and_says_why_the_rest_is_not(tmp_path, capsys):
    """A dragon has no skeleton of a person, which a VRM needs."""
    need_weights()
    assert main(["samples", "dragon", "-o", str(tmp_path)]) == 0
    avatar, mesh = tmp_path / "a.vrm", tmp_path / "a.glb"
    assert main(["rig", str(tmp_path / "dragon.glb"), "-o", str(avatar), "-o", str(mesh)]) == 2
    assert not avatar.exists() and describe(mesh)["rig"]["joints"] >= 30
    assert f"{avatar} was not written: " in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(("word", "factor"), [("stiff", 4), ("natural", 1), ("loose", 0.3), ("2.5", 2.5)])
def test_the_feel_of_apparel_is_a_word_or_a_factor(word, factor):
    assert tyro.cli(ApparelOptions, args=["--apparel-feel", word]).stiffness == factor


def test_rig_keeps_the_physics_that_a_file_brings(tmp_path, capsys):
    need_weights()
    path = save_pmx(wardrobe_character(3), tmp_path / "doll.pmx")
    assert main(["rig", str(path), "--apparel", "auto", "-o", str(tmp_path / "out.pmx")]) == 0
    assert "the physics of its file kept" in " ".join(capsys.readouterr().out.split())
    given, written = (mmd_model(bunraku.load_character(one)) for one in (path, tmp_path / "out.pmx"))
    assert [body.name for body in written.bodies] == [body.name for body in given.bodies]
    assert [joint.bodies for joint in written.joints] == [joint.bodies for joint in given.joints]


def test_animate_writes_every_output_and_names_the_default(tmp_path, monkeypatch, capsys):
    need_weights()
    monkeypatch.chdir(tmp_path)
    assert main(["samples", "person"]) == 0
    capsys.readouterr()
    options = ["--seconds", "1", "--steps", "2", "--candidates", "1", "--fps", "10", "--seed", "7"]
    outputs = ["-o", "new/walk.glb", "-o", "walk.npz", "-o", "frames.obj", "--preview", "walk.png"]
    assert main(["animate", "person.glb", "a person walks", *options, *outputs]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 4
    assert describe(Path("walk.npz"))["seconds"] == pytest.approx(1, abs=0.06)
    assert describe(Path("new/walk.glb"))["animations"][0]["seconds"] == pytest.approx(0.95, abs=0.06)
    assert len(list(Path("frames").glob("*.obj"))) == 10
    capsys.readouterr()
    assert main(["animate", "person.glb", "a person walks", *options, *outputs]) == 0  # the same command again
    capsys.readouterr()
    Path("walk.npz").write_bytes(b"the user's own")
    assert main(["animate", "person.glb", "a person walks", *options, *outputs]) == 2
    assert "walk.npz" in capsys.readouterr().err and Path("walk.npz").read_bytes() == b"the user's own"
    assert main(["animate", "person.glb", "a person walks", *options, *outputs, "--overwrite"]) == 0
    capsys.readouterr()
    assert main(["animate", "person.glb", "a person walks", *options]) == 0
    assert "wrote person-a-person-walks.glb" in capsys.readouterr().out
    first, second = (describe(Path(name))["animations"][0] for name in ("new/walk.glb", "person-a-person-walks.glb"))
    assert first["seconds"] == second["seconds"]


def test_what_is_whole_is_named_when_the_rest_fails(tmp_path, monkeypatch, capsys):
    need_weights()
    monkeypatch.chdir(tmp_path)
    assert main(["samples", "person"]) == 0
    capsys.readouterr()

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "no space left on device")

    monkeypatch.setattr("bunraku.render.save_preview", full)
    words = "animate person.glb walks --seconds 1 --steps 2 -o walk.glb --preview walk.mp4"
    assert main(words.split()) == 2
    said = capsys.readouterr()
    assert "wrote walk.glb" in said.out and "the disk is full" in said.err


def test_a_sample_becomes_the_file_that_is_named(tmp_path, fails, capsys):
    assert main(["samples", "person", "-o", str(tmp_path / "hero.glb")]) == 0
    capsys.readouterr()
    assert [path.name for path in tmp_path.iterdir()] == ["hero.glb"] and (tmp_path / "hero.glb").is_file()
    assert "do not go into one file" in fails("samples", "person", "dog", "-o", tmp_path / "two.glb")
    assert "end the name in .glb" in fails("samples", "person", "-o", tmp_path / "hero.obj")


def test_limits_and_defaults_agree_with_the_library():
    names = "language.prompts", "generation.candidates", "generation.denoiser"
    sequence, generate, denoiser = (importlib.import_module(f"bunraku.{name}") for name in names)
    assert (WHOLE.low, WHOLE.high) == (sequence.SHORTEST, sequence.LONGEST)
    text = (ROOT / "docs" / "cli.md").read_text()
    few = denoiser.load_few_steps(shipped_checkpoint("few-steps"))
    assert f"; {len(few.visited)} by default" in text and f"{generate.STEPS} with `--guidance`" in text
    assert few.guidance == generate.GUIDANCE and f"{generate.GUIDANCE} by default" in text


def options_of(kind):
    """Names of the options and arguments of a verb, those of the dataclasses that it holds among them."""
    for field in dataclasses.fields(kind):
        if dataclasses.is_dataclass(field.default_factory):
            yield from options_of(field.default_factory)
        elif "Suppress" not in str(field.type):
            named_type: object = importlib.import_module(kind.__module__)
            for part in str(field.type).split("."):  # a type with a name, in its module or another one
                named_type = getattr(named_type, part, None)
            told = [getattr(each, "name", None) for each in getattr(named_type, "__metadata__", ())]
            named = re.findall(r"""arg\(name=['"]([^'"]+)['"]""", str(field.type)) + [name for name in told if name]
            yield named[0] if named else field.name.replace("_", "-")


def test_every_option_is_documented():
    """In the section of its command or, for commands without one, in the tables below them; or among the options that
    several commands have. The page names no option that is not there.
    """
    text = (ROOT / "docs" / "cli.md").read_text()
    shared, _, rest = text.partition("## bunraku animate")
    tables = text[text.index("## Other commands") :]
    known = {"debug", "help", "version"}
    for verb, (module, name, _) in all_verbs().items():
        words = f"bunraku {' '.join(verb)}"
        assert words in text, f"docs/cli.md does not name {words}"
        kind = getattr(importlib.import_module(module), name)
        if isinstance(kind, type):
            _, heading, section = f"## bunraku animate{rest}".partition(f"## {words}\n")
            said = shared + (section.partition("\n## ")[0] if heading else tables)
            options = set(options_of(kind))
            known |= options
            missing = {each for each in options if f"--{each}" not in said and f"`{each.upper()}`" not in said}
            assert not missing, f"docs/cli.md does not name {sorted(missing)} of {words}"
    assert set(re.findall(r"--([a-z][a-z0-9-]*)", text)) <= known


def test_documents_link_to_files_that_exist():
    for path in [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), ROOT / "examples" / "README.md"]:
        for target in re.findall(r"\]\(([^)#]+)[^)]*\)", path.read_text()):
            if "://" not in target:
                assert (path.parent / target).exists(), f"{path.name} links to {target}"
