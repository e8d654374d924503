"""Characters that lie or face backwards: what the command line says and does about them."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from bunraku.anatomy.handles.orientation import Orientation, ResolvedAxes
from bunraku.cli import main
from bunraku.cli.app import _joined
from bunraku.cli.inspect import describe
from bunraku.cli.options import resolve_file, said_axes
from bunraku.core.geometry.axes import ORIENTATIONS, upright_rotation
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.errors import WeightsError
from bunraku.files import load_character, save_character
from bunraku.files.registry import read_motion
from bunraku.files.samples import sample_character


def need_weights(*names):
    try:
        for name in names:
            shipped_checkpoint(name)
    except WeightsError:
        pytest.skip(f"needs the shipped weights: {', '.join(names)}")


def write_stl(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    """A binary STL, written without the library."""
    records = np.zeros(len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    records["corners"] = vertices[faces]
    path.write_bytes(bytes(80) + np.uint32(len(faces)).tobytes() + records.tobytes())
    return path


@pytest.fixture(scope="module")
def stls(tmp_path_factory):
    """The robot as STL: standing, and as a modelling program writes it, with +Z up and facing -Y; in millimetres."""
    folder, robot = tmp_path_factory.mktemp("stls"), sample_character("robot")
    lying = robot.vertices @ upright_rotation("+z", "-y").astype(np.float32)
    return write_stl(folder / "standing.stl", robot.vertices, robot.faces), write_stl(
        folder / "lying.stl", 1000 * lying, robot.faces
    )


def test_axes_are_checked_before_any_work(fails, good, tmp_path):
    out = tmp_path / "out.glb"
    assert "--up: 'w' is not an axis" in fails("rig", good, "-o", out, "--up", "w")
    assert "--front: 'up' is not an axis" in fails("animate", good, "walks", "-o", out, "--front", "up")
    for words in (("--up", "-z", "--front", "z"), ("--up", "y", "--front", "+Y")):
        assert "lie along the same axis" in fails("rig", good, "-o", out, *words)
    assert "same axis" in fails("render", good, "-o", tmp_path / "out.png", "--up=-x", "--front=+x")


def test_an_axis_may_begin_with_a_minus():
    assert _joined(["a", "--up", "-z", "--front", "+x", "-o", "b"]) == ["a", "--up=-z", "--front", "+x", "-o", "b"]
    assert _joined(["--up", "z", "-x"]) == ["--up", "z", "-x"]


def test_up_of_an_stl_gives_what_the_upright_file_gives(stls, tmp_path, capsys):
    need_weights("handles", "orientation")
    standing, lying = stls
    outs = tmp_path / "standing.glb", tmp_path / "lying.glb"
    assert main(["rig", str(standing), "-o", str(outs[0]), "--up", "y", "--front", "z"]) == 0
    assert main(["rig", str(lying), "-o", str(outs[1]), "--up", "z", "--front", "-y"]) == 0
    said = capsys.readouterr().err
    assert "taken as +" not in said and "lying.stl: 1,653 tall: probably millimetres; taken as 1.65 m" in said
    one, other = (load_character(path) for path in outs)
    assert np.abs(one.vertices - other.vertices).max() < 1e-5 * one.height
    assert np.abs(one.rig.positions - other.rig.positions).max() < 1e-4 * one.height
    assert np.abs(one.rig.dense_weights() - other.rig.dense_weights()).max() < 0.01


def test_animations_of_both_are_the_same_motion(stls, tmp_path):
    need_weights("handles", "orientation", "diffusion")
    options = ["a person waves", "--seconds", "1", "--steps", "2"]
    motions = []
    for path, axes in zip(stls, (("y", "z"), ("z", "-y")), strict=True):
        out = tmp_path / f"{path.stem}.npz"
        assert main(["animate", str(path), *options, "-o", str(out), "--up", axes[0], "--front", axes[1]]) == 0
        motions.append(read_motion(out))
    assert np.abs(motions[0].rotations - motions[1].rotations).max() < 2e-3
    assert np.abs(motions[0].root_translation - motions[1].root_translation).max() < 2e-3


def test_inspect_says_how_a_mesh_seems_to_stand_and_its_unit(stls, capsys):
    need_weights("orientation")
    standing, lying = (describe(path) for path in stls)
    assert (standing["orientation"]["up"], standing["orientation"]["front"]) == ("+y", "+z")
    assert standing["unit"] == {"name": "metres", "note": ""}
    found = lying["orientation"]
    assert (found["up"], found["front"]) == ("+z", "-y")
    assert 0 < found["up_confidence"] <= 1 and 0 < found["front_confidence"] <= 1
    assert lying["unit"]["name"] == "millimetres" and "taken as 1.65 m" in lying["unit"]["note"]
    assert main(["inspect", str(stls[1]), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["orientation"] == found
    assert main(["inspect", str(stls[1])]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "up +Z" in said and "millimetres" in said


def test_inspect_draws_how_it_may_stand(stls, tmp_path, fails, capsys):
    need_weights("orientation")
    image = pytest.importorskip("PIL.Image")
    assert main(["inspect", str(stls[1]), "--views", str(tmp_path / "views.png")]) == 0
    with image.open(tmp_path / "views.png") as picture:
        assert picture.width > 3.5 * 320 and picture.height > 360
    (tmp_path / "mine.png").write_bytes(b"mine")
    capsys.readouterr()
    assert "mine.png" in fails("inspect", stls[1], "--views", tmp_path / "mine.png")
    assert (tmp_path / "mine.png").read_bytes() == b"mine"


def test_inspect_works_without_the_weights(stls, monkeypatch, tmp_path):
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path))
    facts = describe(stls[0])["orientation"]
    assert (facts["up"], facts["front"], facts["up_confidence"]) == ("+y", "+z", None) and "assumed" in facts["note"]


def guess(up, front, up_sure, front_sure):
    """A guess; what is left of it lies on the next front, and on another axis up."""
    out = np.zeros(24)
    other = next(axes for axes in ORIENTATIONS if axes[0] == up and axes[1] != front)
    elsewhere = next(axes for axes in ORIENTATIONS if axes[0] != up)
    for axes, chance in (
        ((up, front), up_sure * front_sure), (other, up_sure * (1 - front_sure)), (elsewhere, 1 - up_sure)
    ):  # fmt: skip
        out[ORIENTATIONS.index(axes)] += chance
    return Orientation.of(out)


def test_what_is_said_about_a_guess():
    assert said_axes(ResolvedAxes("+z", "-y", guess("+z", "-y", 0.99, 0.98))) == ""  # sure
    cow = guess("+y", "+x", 0.76, 0.98)
    assert said_axes(ResolvedAxes("+y", "+x", cow)) == (
        "taken as +Y up, facing +X (74 % sure), perhaps +X up, facing +Y (24 %). To set it, type --up +y --front +x, "
        "or else --up +x --front +y; `bunraku inspect FILE --views views.png` shows which."
    )
    assert said_axes(ResolvedAxes("+z", "+x", guess("+z", "+x", 1, 0.6)), up="z") == (
        "taken as facing +X (60 % sure), perhaps facing -X (40 %). To set it, type --front +x, or else --front -x; "
        "`bunraku inspect FILE --views views.png` shows which."
    )
    assert said_axes(ResolvedAxes("+z", "-y", None)) == ""


def test_no_guess_below_85_percent_is_silent():
    rng = np.random.default_rng(3)
    for _ in range(300):
        chances = rng.dirichlet(np.full(24, rng.uniform(0.02, 2)))
        found = Orientation.of(chances)
        up, front = found.likeliest
        line = said_axes(ResolvedAxes(up, front, found))
        assert bool(line) == (found.probability(up, front) < 0.85)
        assert f"taken as {up.upper()} up, facing {front.upper()}" in line or not line
        said = [int(number) for number in re.findall(r"(\d+) %", line)]
        assert said == sorted(said, reverse=True)  # nothing is taken that is said to be less likely


def test_an_stl_is_turned_unasked(stls, capsys):
    need_weights("orientation")
    standing, lying = (load_character(path) for path in stls)
    turned, line = resolve_file(lying)
    assert (turned.up, turned.front) == ("+z", "-y") and (not line or "--up +z --front -y" in line)
    settled, line = resolve_file(standing)
    assert (settled.up, settled.front, line) == ("+y", "+z", "")


def test_a_glb_stands_unless_its_mesh_says_otherwise(stls, tmp_path, capsys):
    need_weights("handles", "orientation")
    standing, lying = (load_character(path) for path in stls)
    path = save_character(lying, tmp_path / "lying.glb")
    found, line = resolve_file(load_character(path))  # shape, mirror plane and ground all say so
    assert (found.up, found.front) == ("+z", "-y")
    kept, line = resolve_file(load_character(save_character(standing, tmp_path / "standing.glb")))
    assert (kept.up, kept.front, line) == ("+y", "+z", "")
    asked, line = resolve_file(load_character(path), up="z")
    assert (asked.up, asked.front) == ("+z", "-y")
    assert main(["rig", str(path), "-o", str(tmp_path / "rigged.glb"), "--up", "z", "--front=-y"]) == 0
    assert load_character(tmp_path / "rigged.glb").height == pytest.approx(standing.height, rel=1e-5)
    assert "rule" not in capsys.readouterr().err


def test_unit_gives_metres(stls, tmp_path, capsys):
    need_weights("handles", "orientation")
    robot, centimetres = load_character(stls[0]), tmp_path / "centimetres.stl"
    write_stl(centimetres, 100 * robot.vertices, robot.faces)
    heights = {}
    for unit in ("auto", "m", "cm", "mm", "in"):
        out = tmp_path / f"{unit}.glb"
        assert main(["rig", str(centimetres), "-o", str(out), "--unit", unit]) == 0
        said = capsys.readouterr().err
        told = "165.3 tall: probably centimetres; taken as 1.65 m. Type --unit m to keep its numbers" in said
        assert told == (unit == "auto")
        heights[unit] = load_character(out, unit="m").height / robot.height
    assert heights == pytest.approx({"auto": 1, "m": 100, "cm": 1, "mm": 0.1, "in": 2.54}, rel=1e-4)
    assert describe(centimetres)["unit"]["name"] == "centimetres"
    assert describe(centimetres, "cm")["height"] == pytest.approx(robot.height, rel=1e-3)
    assert main(["inspect", str(centimetres), "--unit", "in"]) == 0
    assert "inches" in capsys.readouterr().out
