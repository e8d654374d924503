"""The measures of simulated apparel, each against what is known without them."""

import json
from dataclasses import replace

import igl
import numpy as np
import pytest
from scipy.spatial import cKDTree

from bunraku.apparel.body_volume import BodyVolume
from bunraku.apparel.mask import apparel_mask
from bunraku.apparel.skinning import eq4_transforms
from bunraku.apparel.unified import UnifiedBody
from bunraku.body.reference import reference_body
from bunraku.cli import main
from bunraku.core.rig_animation import RigAnimation
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError, OptionError
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.physics.from_file import apparel_rig
from bunraku_lab.datasets.apparel.body_inside import deep_inside
from bunraku_lab.datasets.apparel.build import body_animation
from bunraku_lab.datasets.apparel.plan import CharacterSource
from bunraku_lab.evaluation.physics.measures import apparel_chains, body_speeds, chain_lengths
from bunraku_lab.evaluation.physics.penetration import nearest_joint_vertices, sample_apparel
from bunraku_lab.evaluation.physics.table import PHYSICS_BARS, evaluate_physics, joined, measure_physics
from bunraku_lab.evaluation.transfer.stock_motions import STOCK_MOTIONS, stock_motion
from bunraku_lab.synthetic.samples import make_sample
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
    with pytest.raises(CharacterError, match="all of it is apparel"):
        BodyVolume.of(body, np.ones_like(mask))


def test_the_body_follows_its_joints(character, body):
    clip = body_animation(body, stock_motion("kick", 1.0))
    volume = BodyVolume.of(body, apparel_mask(character), 10**9)
    posed = volume.posed(eq4_transforms(body.transforms(clip), body.joints))[20]
    truth = clip.vertices([20])[0][~apparel_mask(character)]
    assert np.quantile(cKDTree(truth).query(posed)[0], 0.99) < 1e-3


def test_rigid_with_the_nearest_joint(character, body):
    chosen = sample_apparel(apparel_mask(character), 100)
    assert len(chosen) == 100 and apparel_mask(character)[chosen].all()
    rest = eq4_transforms(body.transforms(still(character)), body.joints)
    assert np.allclose(nearest_joint_vertices(body, chosen, rest)[1], character.vertices[chosen], atol=1e-5)
    turned = rest.copy()
    turned[..., :3], turned[..., 3] = matrix_from_axis_angle(np.array([0, np.pi / 2, 0])), [1.0, 0, 0]
    x, y, z = character.vertices[chosen].T
    assert np.allclose(nearest_joint_vertices(body, chosen, turned)[0], np.stack([z + 1, y, -x], axis=1), atol=1e-5)


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


def test_turning_about_its_joints_stretches_no_chain(character, body):
    rig = apparel_rig(character)
    if any(
        np.linalg.norm(joint.position - character.rig.positions[rig.bodies[joint.bodies[1]].bone]) > 1e-4
        for joint in rig.joints
    ):
        pytest.skip("joints of this character are not at its bones")
    animation = still(character)
    turns = np.array(animation.rotations)
    turns[:, body.moved] = matrix_from_axis_angle(
        np.random.default_rng(0).normal(0, 0.5, (len(turns), int(body.moved.sum()), 3))
    )
    chains = apparel_chains(character, rig)
    lengths = chain_lengths(replace(animation, rotations=turns), rig, chains)
    assert np.allclose(lengths, [chain.length for chain in chains], atol=1e-4)


def test_speed_of_bodies_that_are_carried(character):
    """All bones move by 2 cm a frame at 30 frames a second: 0.6 m/s."""
    animation = still(character, 4)
    moves = np.array(animation.translations)
    moves[:, character.rig.parents < 0, 0] = 0.02 * np.arange(4)[:, None]
    rig = apparel_rig(character)
    speeds = body_speeds(replace(animation, translations=moves), rig)
    assert speeds.shape == (3, len(rig.dynamic)) and np.allclose(speeds, 0.6, atol=1e-4)


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


def test_no_other_motion_is_made_by_code():
    with pytest.raises(OptionError, match="walk"):
        stock_motion("swim")


def test_motions_are_joined_without_jumps(body):
    parts = [body_animation(body, stock_motion(kind, 1.0)) for kind in ("walk", "kick")]
    whole, bounds = joined(parts, 0.5)
    assert bounds == [(0, 30), (30, 75)] and len(whole) == 75
    assert np.allclose(whole.rotations[45:], parts[1].rotations, atol=1e-6)
    steps = np.linalg.norm(np.diff(whole.world()[1], axis=0), axis=-1).max(axis=1)
    own = max(np.linalg.norm(np.diff(part.world()[1], axis=0), axis=-1).max() for part in parts)
    assert steps[28:46].max() < 2 * own


def test_the_table_of_a_character(capsys):
    assert main(["evaluate", "physics", "--wardrobe", "1", "--seed", str(SEED), "--seconds", "3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(PHYSICS_BARS) | {"fly_aways"} <= set(found) and found["deterministic"] is True
    assert (
        found["chain_stretch"] >= 0
        and found["rest_speed"] >= 0
        and found["realtime_factor"] > 0
        and found["fly_aways"] >= 0
    )
    (row,) = found["characters"]
    assert set(row["motions"]) == set(STOCK_MOTIONS) and 0 <= row["penetration"] <= 1 and row["bodies"] > 0


def test_processes_give_the_same_table_of_physics():
    """But for the time that simulations take."""
    wardrobe = [CharacterSource(f"wardrobe {seed}", "test", seed) for seed in (2, 1)]
    alone, shared = (evaluate_physics(wardrobe=wardrobe, seconds=3, quick=True, jobs=jobs) for jobs in (1, 2))
    assert [row["name"] for row in shared["characters"]] == ["wardrobe 2", "wardrobe 1"]
    for one, other in zip(alone["characters"], shared["characters"], strict=True):
        assert one | {"realtime_factor": 0, "motions": 0, "chain_stretch": 0} == other | {
            "realtime_factor": 0, "motions": 0, "chain_stretch": 0,
        }  # fmt: skip
        assert one["chain_stretch"] == pytest.approx(other["chain_stretch"], abs=1e-6)


def test_a_character_without_apparel_is_named():
    with pytest.raises(CharacterError, match="nothing of apparel"):
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
