"""A sentence and a character with physics of its own: the body moves, and what hangs on it by itself."""

import numpy as np
import pytest

from bunraku.cli.app import main
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import CharacterError, OptionError
from bunraku.formats.mmd.export import write_pmx
from bunraku.nn.checkpoints import shipped_checkpoint
from bunraku.physics.from_file import apparel_rig
from bunraku.pipelines.animate import animate, generate
from bunraku.pipelines.apply import apply_simulated
from bunraku.retarget.to_rig import fit_rig
from bunraku_lab.synthetic.samples import make_sample
from bunraku_lab.synthetic.wardrobe import wardrobe_character

pytestmark = pytest.mark.skipif(
    not (shipped_checkpoint("handles").is_file() and shipped_checkpoint("diffusion").is_file()),
    reason="the shipped weights are not there",
)


@pytest.fixture(scope="module")
def dressed():
    return wardrobe_character(0)


def test_apparel_swings_and_the_body_does_what_it_does_without(dressed):
    animation = animate(dressed, "a person jumps", seconds=2.0, steps=5, apparel="simulate")
    assert isinstance(animation, RigAnimation) and animation.fps == 30 and len(animation) == 59
    from bunraku.core.resample import resample
    from bunraku.handles.predict import mesh_feature

    motion = generate("a person jumps", seconds=2.0, steps=5, mesh_feature=mesh_feature(dressed))
    stiff = fit_rig(resample(motion, 30.0), dressed)
    apparel = apparel_rig(dressed)
    assert apparel is not None
    moved = np.unique([apparel.bodies[index].bone for index in apparel.dynamic])
    turned = np.linalg.norm(animation.rotations - stiff.rotations, axis=(-2, -1)).max(axis=0)
    assert np.median(turned[moved]) > 0.02  # a degree and more
    assert np.delete(turned, moved).max() < 1e-5


def test_in_place_goes_nowhere(dressed):
    motion = generate("a person walks forward", seconds=2.0, steps=5)
    path = apply_simulated(motion, dressed, in_place=True).world()[1].mean(axis=1)
    way = apply_simulated(motion, dressed).world()[1].mean(axis=1)
    assert np.ptp(path[:, 2]) < 0.3 * np.ptp(way[:, 2])


def test_what_cannot_be_simulated_is_refused(dressed):
    for wrong in ({"loop": True}, {"after": generate("walks", seconds=1.0, steps=1)}, {"handles": "rig"}):
        with pytest.raises(OptionError, match="apparel"):
            animate(dressed, "walks", apparel="simulate", **wrong)
    with pytest.raises(OptionError, match="'simulate', 'chains' or 'learn'"):
        animate(dressed, "walks", apparel="jelly")
    with pytest.raises(CharacterError, match="nothing of this character is moved by physics"):
        animate(make_sample("person", 0.5), "walks", apparel="simulate")


def test_the_command_line_takes_one_prompt_or_many(dressed, tmp_path, capsys):
    (tmp_path / "doll.pmx").write_bytes(write_pmx(dressed))
    (tmp_path / "lines.txt").write_text("walks\njumps\n")
    shared = [str(tmp_path / "doll.pmx"), "--apparel", "simulate", "--seconds", "1", "--steps", "2"]
    assert main(["animate", *shared[:1], "waves", *shared[1:], "-o", str(tmp_path / "one.glb")]) == 0
    assert main(["animate", *shared, "--prompts", str(tmp_path / "lines.txt"), "-o", str(tmp_path / "all")]) == 0
    assert (tmp_path / "one.glb").is_file() and len(list((tmp_path / "all").glob("*.glb"))) == 2
    assert main(["animate", *shared[:1], "waves", *shared[1:], "--loop", "-o", str(tmp_path / "two.glb")]) == 2
    assert "neither --loop nor --after" in capsys.readouterr().err
