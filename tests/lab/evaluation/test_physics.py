"""The measures of simulated apparel, each against what is known without them."""

import json
from dataclasses import replace

import igl
import numpy as np
import pytest

from bunraku.apparel.body import UnifiedBody
from bunraku.apparel.mask import apparel_mask
from bunraku.apparel.physics.rig import apparel_rig
from bunraku.cli import main
from bunraku.core.animation import RigAnimation
from bunraku.core.body.reference import reference_body
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError
from bunraku_lab.datasets.apparel.checks import BodyVolume, deep_inside
from bunraku_lab.evaluation.physics import PHYSICS_BARS, apparel_chains, chain_lengths, measure_physics
from bunraku_lab.synthetic.samples import make_sample
from bunraku_lab.synthetic.stock_motions import STOCK_MOTIONS, stock_motion
from bunraku_lab.synthetic.wardrobe import wardrobe_character

SEED = 1


@pytest.fixture(scope="module")
def character():
    return wardrobe_character(SEED)


@pytest.fixture(scope="module")
def body(character):
    return UnifiedBody.of(character)


def still(character, frames=3):
    bones = len(character.rig.names)
    return RigAnimation(character, np.tile(np.eye(3), (frames, bones, 1, 1)), np.zeros((frames, bones, 3)), 30.0)


def ball(radius=1.0, rings=40):
    """A sphere of triangles."""
    theta, phi = np.linspace(0, np.pi, rings), np.linspace(0, 2 * np.pi, 2 * rings, endpoint=False)
    points = np.stack(
        [
            np.outer(np.sin(theta), np.cos(phi)),
            np.outer(np.cos(theta), np.ones_like(phi)),
            -np.outer(np.sin(theta), np.sin(phi)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    a = np.arange(rings - 1)[:, None] * 2 * rings + np.arange(2 * rings)
    b = np.arange(rings - 1)[:, None] * 2 * rings + np.roll(np.arange(2 * rings), -1)
    quads = np.stack([a, a + 2 * rings, b + 2 * rings, b], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return radius * points, faces.astype(np.int64)


@pytest.mark.parametrize("open_end", [False, True])
def test_depth_in_a_ball_is_the_distance_to_its_surface(open_end):
    """Also where a tenth of it is cut away, as avatars have no skin under their clothes."""
    vertices, faces = ball()
    if open_end:
        faces = faces[(vertices[faces][..., 1] > -0.8).all(axis=1)]
    volume = BodyVolume(vertices, faces, np.ones((len(vertices), 1), np.float32))
    random = np.random.default_rng(0)
    directions = random.normal(size=(400, 3))
    directions[:, 1] = np.abs(directions[:, 1])  # away from the hole
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    radii = random.uniform(0.3, 1.5, 400)
    clear = np.abs(radii - 0.9) > 0.01
    deep = deep_inside(volume, vertices, directions * radii[:, None], 0.1)
    assert np.array_equal(deep[clear], (radii < 0.9)[clear])


def test_the_body_without_its_apparel_is_solid(character, body):
    """Joints of trunk and thighs are inside; points beside the character are not. Fewer faces change a millimetre or
    two.
    """
    mask = apparel_mask(character)
    fine, coarse = BodyVolume.of(body, mask, 10**9), BodyVolume.of(body, mask, 3000)
    assert len(coarse.faces) <= 3100 < len(fine.faces) and np.allclose(coarse.weights.sum(axis=1), 1, atol=1e-5)
    trunk = body.joints[[0, 3, 9, 15, 4, 5]]
    beside = trunk + [3.0, 0, 0]
    for volume in (fine, coarse):
        assert (
            deep_inside(volume, volume.rest, trunk, 0.005).sum() >= 5
            and not deep_inside(volume, volume.rest, beside).any()
        )
    away = np.sqrt(
        igl.point_mesh_squared_distance(np.ascontiguousarray(coarse.rest), np.ascontiguousarray(fine.rest), fine.faces)[
            0
        ]
    )
    assert np.quantile(away, 0.95) < 0.004
    with pytest.raises(CharacterError, match="the whole mesh counts as apparel"):
        BodyVolume.of(body, np.ones_like(mask))


def test_chains_hang_on_the_body_and_end_in_tips(character):
    rig = apparel_rig(character)
    chains = apparel_chains(character, rig)
    assert chains and all(not rig.bodies[chain.bodies[0]].dynamic for chain in chains)
    assert all(rig.bodies[body].dynamic for chain in chains for body in chain.bodies[1:])
    assert all(len(chain.joints) == len(chain.bodies) - 1 for chain in chains)
    assert {body for chain in chains for body in chain.bodies[1:]} == set(rig.dynamic)


def test_a_bone_that_is_pulled_out_stretches_its_chain(character):
    """By 1 cm, so the chain is 1 cm longer, and others are as long as they were."""
    rig, animation = apparel_rig(character), still(character)
    chains = apparel_chains(character, rig)
    assert np.allclose(chain_lengths(animation, rig, chains), [chain.length for chain in chains], atol=1e-5)
    chain = chains[0]
    moves = np.array(animation.translations)
    last = rig.bodies[chain.bodies[-1]].bone
    moves[1, last] = [0, 0, 0.01]
    longer = chain_lengths(replace(animation, translations=moves), rig, chains)
    assert longer[1, 0] - chain.length == pytest.approx(0.01, abs=1e-5) and longer[0, 0] == pytest.approx(
        chain.length, abs=1e-5
    )
    apart = [
        number for number, other in enumerate(chains) if last not in [rig.bodies[body].bone for body in other.bodies]
    ]
    assert np.allclose(longer[1, apart], [chains[number].length for number in apart], atol=1e-5)


@pytest.mark.parametrize("kind", STOCK_MOTIONS)
def test_motions_made_by_code(kind):
    """Someone stands on the ground, moves no part faster than people do, and does the same every time."""
    motion = stock_motion(kind, 7.0)
    reference = reference_body()
    vertices = skin(reference.vertices, reference.handle_weights, motion.transforms(reference.handles.positions))
    low = vertices[..., 1].min(axis=1)
    assert len(motion) == 210 and low.min() > -0.03 and low.max() < 0.05
    fastest = np.linalg.norm(np.diff(vertices[:, ::50], axis=0), axis=-1).max() * motion.fps
    assert 2 < fastest < 15
    assert np.array_equal(motion.rotations, stock_motion(kind, 7.0).rotations)
    if kind == "walk":
        assert np.ptp(vertices[:, :, 2].mean(axis=1)) == pytest.approx(1.2 * 209 / 30, rel=0.1)
    if kind == "kick":
        assert vertices[25, :, 2].max() > vertices[0, :, 2].max() + 0.4


def test_the_table_of_a_character(capsys):
    assert main(["evaluate", "physics", "--wardrobe", "1", "--seed", str(SEED), "--seconds", "3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(PHYSICS_BARS) | {"fly_aways"} <= set(found)
    assert (
        found["chain_stretch"] >= 0
        and found["rest_speed"] >= 0
        and found["realtime_factor"] > 0
        and found["fly_aways"] >= 0
    )
    (row,) = found["characters"]
    assert set(row["motions"]) == set(STOCK_MOTIONS) and 0 <= row["penetration"] <= 1 and row["bodies"] > 0


def test_a_character_without_apparel_is_named():
    with pytest.raises(CharacterError, match="no apparel that physics move"):
        measure_physics(make_sample("person", 0.3, rigged=True))


def test_bad_options_are_one_sentence(tmp_path, capsys):
    for words in (
        ["--seconds", "0"],
        [str(tmp_path / "none.pmx")],
        ["--motions", str(tmp_path / "none.bvh")],
        ["--clothes", str(tmp_path / "no")],
    ):
        assert main(["evaluate", "physics", *words]) == 2
        assert capsys.readouterr().err.count("\n") == 1
