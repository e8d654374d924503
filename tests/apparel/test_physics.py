"""Simulated apparel: forests of bodies, the simulation, and chains of VRM."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import BARE, body, chain, character, joint, still
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from bunraku.apparel.learned.features import OwnPendulum
from bunraku.apparel.physics.bodies import apparel_forest
from bunraku.apparel.physics.clothed_from_file import vertex_swing
from bunraku.apparel.physics.rig import VRM_RATE, ApparelRig, PhysicsSettings, apparel_rig, check_engine, vrm_rig
from bunraku.apparel.physics.simulate import simulate
from bunraku.core.animation import RigAnimation
from bunraku.core.avatars import VrmCollider, VrmModel, VrmSpring, VrmSpringJoint
from bunraku.core.character import Character, Rig
from bunraku.errors import CharacterError, MissingExtraError, MotionError, OptionError
from bunraku.pipelines.requests import Apparel


def test_what_simulates_is_asked_for_before_the_work(monkeypatch):
    check_engine("x")
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.setattr("bunraku.apparel.physics.rig.find_spec", lambda name: None)
    for motion in ("simulate", "chains"):
        with pytest.raises(MissingExtraError, match=rf"{motion}.*bunraku\[physics\]"):
            Apparel(motion).check("--")
    for motion in ("none", "learn", "auto"):
        Apparel(motion).check("--")


PARENTS = np.array([-1, 0, 1, 2, 0])


def hung(bodies, joints):
    forest = apparel_forest(tuple(bodies), tuple(joints), PARENTS)
    return {link.body: (link.parent, link.bone) for link in forest.links}, forest


def test_bodies_without_a_hold_hang_on_their_bones():
    links, forest = hung(
        [body("a", 2, [0, 1, 0]), body("b", 3, [0, 0, 0]), body("free", -1, [5, 5, 5])], [joint(0, 1, [0, 0.5, 0])]
    )
    assert links == {0: (-1, 1), 1: (0, -1), 2: (-1, -1)} and "hang on no body" in forest.notes[0]


def test_bodies_that_follow_a_moved_bone_are_carried():
    bodies = [
        body("root", 0, [0, 2, 0], 0),
        body("b", 1, [0, 1, 0]),
        body("on it", 3, [0, 0, 0], 0),
        body("c", 4, [0, 0, 1]),
    ]
    links, forest = hung(bodies, [joint(0, 1, [0, 2, 0]), joint(2, 3, [0, 0, 0])])
    assert forest.carried == {2: 1} and links == {1: (-1, 0), 3: (1, -1)}


GENE = Path(os.environ.get("BUNRAKU_DATA", "runs/data"), "apparel/mmd/gene/Gene.pmx")
WALK = Path(os.environ.get("BUNRAKU_DATA", "runs/data"), "apparel/mmd/motion/walk.vmd")


def test_a_pendulum_on_a_bone_that_is_shaken_swings_as_its_equation_says():
    length, size, wide, rate = 0.5, 0.2, 0.1, 6.0
    doll = character([[0, 2, 0], [0, 2, 0]], [-1, 0])
    ball = body("ball", 1, [0, 2 - length, 0], size=np.array([size, 0, 0]))
    rig = ApparelRig((body("root", 0, [0, 2, 0], 0), ball), (joint(0, 1, [0, 2, 0]),))
    times = np.arange(91) / 30
    animation = still(doll, 91)
    moved = animation.translations.copy()
    moved[:, 0, 0] = wide * (1 - np.cos(rate * times))
    animation = replace(animation, translations=moved)
    found = simulate(animation, rig, warmup=0, substeps=40, settings=BARE)
    inertia = length**2 + 0.4 * size**2  # over mass

    def equation(time, state):
        pull = wide * rate**2 * np.cos(rate * time)
        return [state[1], -length / inertia * (9.81 * np.sin(state[0]) + pull * np.cos(state[0]))]

    wanted = solve_ivp(equation, (0, times[-1]), [0, 0], t_eval=times, rtol=1e-9, atol=1e-9).y[0]
    angle = np.arctan2(found.animation.rotations[:, 1, 1, 0], found.animation.rotations[:, 1, 0, 0])
    assert np.abs(wanted).max() > 0.3
    assert np.abs(angle - wanted).max() < 0.03
    assert not found.report.recoveries


def test_the_air_slows_what_is_whirled_and_leaves_a_walk_alone():
    doll = character([[0, 2, 0], [0, 2, 0]], [-1, 0])
    bodies = body("root", 0, [0, 2, 0], 0), body("ball", 1, [0, 1.4, 0])
    rig = ApparelRig(bodies, (joint(0, 1, [0, 2, 0]),))

    def turns(wide: float, **air: float) -> np.ndarray:
        animation = still(doll, 61)
        moved = animation.translations.copy()
        moved[:, 0, 0] = wide * (1 - np.cos(9 * np.arange(61) / 30))
        settings = replace(PhysicsSettings(limbs=False), **air)
        return simulate(replace(animation, translations=moved), rig, warmup=0, settings=settings).animation.rotations

    np.testing.assert_array_equal(turns(0.1), turns(0.1, wind=0.0))
    steps = [np.abs(np.diff(turns(0.6, **air)[:, 1], axis=0)).sum(axis=(1, 2)).mean() for air in ({}, {"wind": 0.0})]
    assert steps[0] < 0.9 * steps[1]


def test_a_turning_bone_takes_its_pendulum_along():
    """A pendulum off the axis of a bone that turns steadily leans outwards by the angle at which gravity balances
    it.
    """
    doll = character([[0, 2, 0], [0.5, 2, 0]], [-1, 0])
    rig = ApparelRig(
        (body("root", 0, [0, 2, 0], 0), body("ball", 1, [0.5, 1.8, 0], angular_damping=0.9)),
        (joint(0, 1, [0.5, 2, 0]),),
    )
    frames, rate = 300, 3.0
    angle = rate * np.maximum(0, np.arange(frames) / 30 - 0.5)
    angle[:30] = rate * np.linspace(0, 1, 30) ** 2 / 2
    animation = still(doll, frames)
    turned = animation.rotations.copy()
    turned[:, 0] = Rotation.from_rotvec(angle[:, None] * [0, 1, 0]).as_matrix()
    found = simulate(replace(animation, rotations=turned), rig, warmup=0, settings=BARE).animation
    lean = np.arccos(found.world()[0][-30:, 1, 1, 1])
    balance = lean.mean()
    assert np.ptp(lean) < 0.02
    assert np.isclose(np.tan(balance), rate**2 * (0.5 + 0.2 * np.sin(balance)) / 9.81, rtol=0.05)


def test_positive_angles_of_a_file_swing_a_front_panel_forwards():
    """Bullet counts the turn of A in B; with limits 0 to 60 degrees about x, wind from the front does nothing and one
    from behind lifts it.
    """
    doll = character([[0, 2, 0], [0, 2, 0]], [-1, 0])
    limits = {"angle_lower": np.zeros(3), "angle_upper": np.radians([60.0, 0, 0])}
    for push, wanted in ((30.0, 60.0), (-30.0, 0.0)):
        for bodies in ((0, 1), (1, 0)):
            low, high = (
                (limits["angle_lower"], limits["angle_upper"])
                if bodies == (0, 1)
                else (-limits["angle_upper"], limits["angle_lower"])
            )
            rig = ApparelRig(
                (body("root", 0, [0, 2, 0], 0), body("panel", 1, [0, 1.8, 0], angular_damping=0.99)),
                (joint(*bodies, [0, 2, 0], angle_lower=low, angle_upper=high),),
                gravity=np.array([[0, 0, 0], [0, -1.0, push]]),
            )
            turn = simulate(still(doll, 60), rig, warmup=0, settings=BARE).animation.world()[0][-1, 1]
            tip = turn @ [0, -1, 0]
            assert np.degrees(np.arctan2(tip[2], -tip[1])) == pytest.approx(wanted, abs=3)


def test_a_spring_holds_what_its_unit_says():
    """Stiffness k of a file is k (0.08 m)^2 N m/rad: here it balances gravity at 30 degrees."""
    doll = character([[0, 2, 0], [0, 2, 0]], [-1, 0])
    torque = 9.81 * 0.2 * np.cos(np.radians(30))
    k = torque / np.radians(30) / 0.08**2
    only_z = {"angle_lower": np.array([0, 0, 1.0]), "angle_upper": np.array([0, 0, -1.0])}
    arm = body("arm", 1, [0.2, 2, 0], angular_damping=0.999)
    rig = ApparelRig(
        (body("root", 0, [0, 2, 0], 0), arm), (joint(0, 1, [0, 2, 0], angle_spring=np.full(3, k), **only_z),)
    )
    turn = simulate(still(doll, 120), rig, warmup=0, settings=BARE).animation.world()[0][-1, 1]
    assert np.degrees(np.arctan2(-turn[1, 0], turn[0, 0])) == pytest.approx(30, abs=0.5)


def test_chains_keep_their_length_and_come_to_rest():
    doll, rig = chain(4, angular_damping=0.9, linear_damping=0.9)
    animation = still(doll, 150)
    moved = animation.translations.copy()
    moved[:30, 0, 0] = 0.5 * np.sin(np.arange(30) / 3)
    moved[30:, 0, 0] = moved[29, 0, 0]
    found = simulate(replace(animation, translations=moved), rig, warmup=0.5)
    assert found.report.stretch < 1e-3 and found.report.rest_speed < 0.01 and not found.report.recoveries
    swing = found.animation.world()[1][:, -1, 0] - moved[:, 0, 0]
    assert np.abs(swing[5:40]).max() > 0.1 > 10 * abs(swing[-1])


def test_the_same_input_gives_the_same_bytes():
    doll, rig = chain(3)
    runs = [simulate(still(doll, 20), rig, warmup=0.2).animation for _ in range(2)]
    assert (
        runs[0].rotations.tobytes() == runs[1].rotations.tobytes()
        and runs[0].translations.tobytes() == runs[1].translations.tobytes()
    )


def test_a_collider_keeps_a_pendulum_out_and_masks_count():
    def height(mask, **settings):
        doll = character([[0, 2, 0], [0, 2, 0], [0.3, 1.9, 0]], [-1, 0, -1])
        ball = body("ball", 1, [0.6, 2, 0], angular_damping=0.9, size=np.array([0.05, 0, 0]), mask=2, group=0)
        stop = body("stop", 2, [0.5, 1.7, 0], 0, size=np.array([0.15, 0, 0]), mask=mask, group=1)
        rig = ApparelRig((body("root", 0, [0, 2, 0], 0), ball, stop), (joint(0, 1, [0, 2, 0]),))
        found = simulate(still(doll, 60), rig, warmup=0, settings=replace(BARE, **settings)).animation
        turns, positions = found.world()
        return np.linalg.norm((positions[-1, 1] + turns[-1, 1] @ [0.6, 0, 0]) - [0.5, 1.7, 0])

    assert height(1) > 0.19 and height(4) > 0.25  # held by the stop; hanging past it
    assert height(1) < 0.22


def test_what_overlaps_at_rest_may_stay():
    doll = character([[0, 2, 0], [0, 2, 0], [0, 1.8, 0]], [-1, 0, -1])
    ball = body("ball", 1, [0, 1.8, 0], size=np.array([0.05, 0, 0]), mask=2, group=0)
    stop = body("stop", 2, [0.02, 1.8, 0], 0, size=np.array([0.05, 0, 0]), mask=1, group=1)
    rig = ApparelRig((body("root", 0, [0, 2, 0], 0), ball, stop), (joint(0, 1, [0, 2, 0]),))
    found = simulate(still(doll, 60), rig, warmup=0, settings=BARE)
    assert np.abs(found.animation.rotations[:, 1] - np.eye(3)).max() < 0.02


def test_loops_are_held_softly():
    heads = [[0, 2, 0], [-0.1, 2, 0], [0.1, 2, 0]]
    doll = character(heads, [-1, 0, 0])
    bodies = (body("root", 0, [0, 2, 0], 0), body("left", 1, [-0.1, 1.8, 0]), body("right", 2, [0.1, 1.8, 0]))
    hangs = (joint(0, 1, [-0.1, 2, 0]), joint(0, 2, [0.1, 2, 0]))
    wind = np.array([[0, 0, 0], [-5.0, -9.81, 0], [5.0, -9.81, 0]])

    def apart(*more):
        turns, positions = simulate(
            still(doll, 90), ApparelRig(bodies, (*hangs, *more), gravity=wind), warmup=0
        ).animation.world()
        ends = [positions[-1, bone] + turns[-1, bone] @ [0, -0.2, 0] for bone in (1, 2)]
        return np.linalg.norm(ends[0] - ends[1])

    slides = {"lower": np.array([-0.02, 1, 0]), "upper": np.array([0.02, -1, 0])}
    assert apart() > 0.3
    assert apart(joint(1, 2, [0, 1.8, 0])) == pytest.approx(0.2, abs=0.02)
    assert apart(joint(1, 2, [0, 1.8, 0], **slides)) == pytest.approx(0.22, abs=0.02)


def test_jumps_take_apparel_along():
    doll, rig = chain(3)
    animation = still(doll, 40)
    moved = animation.translations.copy()
    moved[20:, 0, 0] = 50.0
    found = simulate(replace(animation, translations=moved), rig, warmup=0)
    assert not found.report.recoveries
    assert (found.animation.world()[0][:, 1:] @ [0, -1, 0])[..., 1].max() < -0.99


def test_bodies_that_fly_away_are_put_back_and_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    doll, rig = chain(2)
    for pull, settings in ((1e7, PhysicsSettings(patience=0)), (np.nan, PhysicsSettings())):
        wild = replace(rig, gravity=np.array([[0, 0, 0], [0, -1.0, 0], [pull, 0, 0]]))
        found = simulate(still(doll, 10), wild, warmup=0.1, settings=settings)
        assert found.report.recoveries and {one.body for one in found.report.recoveries} <= {"link0", "link1"}
        assert min(one.frame for one in found.report.recoveries) < 0  # in the warm-up
        assert np.isfinite(found.animation.rotations).all() and "put back" in found.report.problems()[-1]
    assert not list(tmp_path.iterdir())  # MuJoCo would write a log of what goes wrong


def test_broken_bodies():
    doll, rig = chain(2)
    with pytest.raises(CharacterError, match="'link1' has a size"):
        simulate(
            still(doll), replace(rig, bodies=(*rig.bodies[:2], replace(rig.bodies[2], size=np.array([np.nan, 0, 0]))))
        )
    with pytest.raises(CharacterError, match="'link1' has a size"):
        simulate(
            still(doll), replace(rig, bodies=(*rig.bodies[:2], replace(rig.bodies[2], size=np.array([-1.0, 0, 0]))))
        )
    light = replace(rig, bodies=(*rig.bodies[:2], replace(rig.bodies[2], mass=0.0, bone=99)))
    notes = simulate(still(doll, 3), light, warmup=0).report.notes
    assert any("no mass" in note for note in notes) and any("bone that does not exist" in note for note in notes)
    stray = replace(rig, joints=(*rig.joints, joint(0, 77, [0, 0, 0]), joint(1, 1, [0, 0, 0])))
    assert any(
        "2 joints are between bodies that do not exist" in note
        for note in simulate(still(doll, 3), stray, warmup=0).report.notes
    )
    many = ApparelRig((rig.bodies[0], *(rig.bodies[1] for _ in range(100_000))), rig.joints)
    with pytest.raises(CharacterError, match="100,000 dynamic rigid bodies"):
        simulate(still(doll), many)


def test_wrong_options_and_characters_without_physics():
    doll, rig = chain(2)
    assert apparel_rig(doll) is None
    with pytest.raises(CharacterError, match="nothing of this character is moved by physics"):
        simulate(still(doll))
    for wrong in ({"warmup": -1}, {"warmup": np.nan}, {"substeps": 0}):
        with pytest.raises(OptionError):
            simulate(still(doll), rig, **wrong)
    with pytest.raises(OptionError, match="gravity"):
        PhysicsSettings(gravity=np.nan)
    with pytest.raises(MotionError, match="too many"):
        simulate(still(doll, 3000), rig, substeps=10_000)


def test_transfer_needs_physics_to_simulate(tmp_path):
    from bunraku.pipelines.transfer import transfer

    doll, _ = chain(2)
    with pytest.raises(CharacterError, match="nothing of this character"):
        transfer(doll, tmp_path / "none.bvh", apparel="simulate")
    with pytest.raises(OptionError, match="'simulate', 'chains' or 'learn'"):
        transfer(doll, tmp_path / "none.bvh", apparel="jelly")


@pytest.mark.skipif(not GENE.exists(), reason="the real MMD characters are not unpacked here")
def test_a_real_character_walks():
    import bunraku

    gene = bunraku.load_character(GENE)
    animation = bunraku.transfer(gene, WALK, fps=30)
    assert isinstance(animation, RigAnimation)
    found = simulate(replace(animation, rotations=animation.rotations[:45], translations=animation.translations[:45]))
    assert found.report.bodies == 62 and found.report.stretch < 0.05 and not found.report.recoveries
    kept = [bone for bone, name in enumerate(gene.rig.names) if name == "下半身"]
    assert (found.animation.rotations[:, kept] == animation.rotations[:45, kept]).all()


def test_limbs_stand_in_where_a_file_has_no_colliders():
    heads = [[0, 2, 0], [0, 2, 0], [0, 0, 0]]
    doll = character(heads, [-1, 0, -1])
    around = np.random.default_rng(0).normal(size=(400, 3))
    around *= 0.15 / np.linalg.norm(
        around, axis=1, keepdims=True
    )  # a ball on the third bone, beside a ball that falls onto it
    ball = around + [0.45, 1.7, 0]
    rig = doll.rig
    whole = Rig(
        rig.names, rig.parents, rig.transforms, np.concatenate([rig.indices, np.full((400, 1), 2)]),
        np.concatenate([rig.weights, np.ones((400, 1))]),
    )  # fmt: skip
    doll = Character("doll", np.concatenate([doll.vertices, ball]).astype(np.float32), doll.faces, whole)
    falls = body("falls", 1, [0.5, 2, 0], angular_damping=0.9, size=np.array([0.05, 0, 0]), mask=1)
    apparel = ApparelRig((body("root", 0, [0, 2, 0], 0), falls), (joint(0, 1, [0, 2, 0]),))
    assert apparel.unguarded == (1,)

    def low(**settings):
        turns, _ = simulate(still(doll, 60), apparel, warmup=0, settings=replace(BARE, **settings)).animation.world()
        return 2 + (turns[-1, 1] @ [0.5, 0, 0])[1]

    assert low(limbs=False) < 1.55 and low(limbs=True) > 1.58
    assert low(limbs=None) == low(limbs=True)


class Source:
    """The nodes of a file: those of the rig, in its order."""

    def __init__(self, rig):
        self.tree = type("Tree", (), {"world": rig.transforms, "parents": rig.parents})()
        self.skins = type("Skins", (), {"nodes": list(range(len(rig.names)))})()


def doll(drag=0.4, stiffness=1.0, gravity=0.0, colliders=(), groups=(), chosen=()):
    made = character([[0, 1, 0], [0, 1.5, 0], [0.1, 1.5, 0], [0.2, 1.5, 0]], [-1, 0, 1, 2])
    made = replace(made, source=Source(made.rig))
    joints = tuple(VrmSpringJoint(node, stiffness, gravity, np.array([0, -1.0, 0]), drag, 0.02) for node in (1, 2, 3))
    return made, VrmModel("1.0", "", {}, (VrmSpring("hair", joints, tuple(chosen)),), tuple(colliders), tuple(groups))


def test_a_chain_hangs_on_the_bone_above():
    made, avatar = doll()
    rig = vrm_rig(made, avatar)
    assert [body.bone for body in rig.bodies] == [0, 1, 2] and [body.dynamic for body in rig.bodies] == [
        False,
        True,
        True,
    ]
    assert [joint.bodies for joint in rig.joints] == [(0, 1), (1, 2)]
    assert np.allclose(rig.bodies[1].position, [0.1, 1.5, 0]) and np.allclose(rig.joints[0].position, [0, 1.5, 0])


def test_a_joint_leans_as_vrm_lets_it():
    """Where gravity and stiffness balance: the tail of a chain of one joint, by VRM's own steps."""
    made, avatar = doll(gravity=0.5, drag=0.4)
    one = VrmModel("1.0", "", {}, (VrmSpring("hair", avatar.springs[0].joints[1:], ()),), (), ())
    found = simulate(still(made, 60), vrm_rig(made, one), warmup=0, settings=BARE).animation
    tail = before = np.array([0.1, 0.0])
    for _ in range(600):
        step = (1 - 0.4) * (tail - before) + np.array([1.0, 0]) / VRM_RATE + 0.5 * np.array([0, -1.0]) / VRM_RATE
        before, tail = tail, tail + step
        tail = 0.1 * tail / np.linalg.norm(tail)
    turn = found.world()[0][-1, 2] @ [1, 0, 0]
    assert np.isclose(np.arctan2(-turn[1], turn[0]), np.arctan2(-tail[1], tail[0]), atol=0.02)


def test_colliders_are_for_the_springs_that_name_them():
    shapes = [
        VrmCollider(0, "sphere", np.zeros(3), 0.1),
        VrmCollider(0, "capsule", np.zeros(3), 0.1, np.array([0, 0.5, 0])),
    ]
    shapes.append(VrmCollider(0, "plane", np.zeros(3), 0.0, np.array([0, 1.0, 0])))
    made, avatar = doll(colliders=shapes, groups=((0,), (1,), (2,)), chosen=(1, 2))
    rig = vrm_rig(made, avatar)
    stops = [body for body in rig.bodies if body.mask and not body.dynamic]
    assert [stop.shape for stop in stops] == ["capsule"] and np.isclose(stops[0].size[1], 0.5)
    swings = [body for body in rig.bodies if body.dynamic]
    assert all(body.mask >> stops[0].group & 1 and stops[0].mask >> body.group & 1 for body in swings)
    assert any("planes" in note for note in rig.notes)


_TURN = np.radians(20.0)


def hung_vertices(points, heads, bones, bodies, joints):
    """A doll whose vertices hang whole on the bones that are named, and what physics move of it."""
    doll = character(heads, np.arange(len(heads)) - 1)
    rig = Rig(doll.rig.names, doll.rig.parents, doll.rig.transforms, np.array(bones)[:, None], np.ones((len(bones), 1)))
    vertices = np.array(points, np.float32)
    faces = np.array([[0, 0, 0]])
    return replace(doll, vertices=vertices, faces=faces, rig=rig), ApparelRig(tuple(bodies), tuple(joints))


def links(limits, damping=0.5):
    """Links of 20 cm below a head at 2 m, with some limits [rad], and a vertex at the end of each."""
    heads = [[0, 2, 0], *([0, 2 - 0.2 * link, 0] for link in range(len(limits)))]
    size = np.array([0.02, 0.0, 0.0])
    bodies = [body("root", 0, [0, 2, 0], 0)]
    joints = []
    for link, limit in enumerate(limits):
        middle = [0, 1.9 - 0.2 * link, 0]
        far = np.full(3, limit)
        bodies.append(
            body(f"link {link}", link + 1, middle, size=size, linear_damping=damping, angular_damping=damping)
        )
        joints.append(joint(link, link + 1, heads[link + 1], angle_lower=-far, angle_upper=far))
    points = [[0, 2.1, 0], *([0, 1.8 - 0.2 * link, 0] for link in range(len(limits)))]
    return hung_vertices(points, heads, range(len(limits) + 1), bodies, joints)


def test_two_like_links_share_the_turn():
    doll, rig = links([_TURN, _TURN])
    swing = vertex_swing(doll, rig)
    np.testing.assert_allclose(swing.share, [0, 1, 1])
    # by hand: half of a turn about 2 m, half about 1.8 m
    np.testing.assert_allclose(swing.lever[1:], [[0, -0.1, 0], [0, -0.3, 0]], atol=1e-6)
    np.testing.assert_allclose(swing.away[1:], [[0, -0.2, 0], [0, -0.3, 0]], atol=1e-6)
    np.testing.assert_allclose(swing.upper[2], 2 * _TURN, atol=1e-6)
    np.testing.assert_allclose(swing.lower[2], -2 * _TURN, atol=1e-6)


@pytest.mark.parametrize("limits", [[np.pi], [0.15], [0.3, 0.3, 0.3]])
def test_pendulums_swing_as_the_simulation_has_it(limits):
    """The head is shaken from side to side; the ends of the strand go where MuJoCo takes them."""
    doll, rig = links(limits, damping=0.7)
    times = np.arange(120) / 30
    animation = still(doll, len(times))
    moved = animation.translations.copy()
    moved[:, 0, 0] = 0.15 * (1 - np.cos(5.0 * times))
    animation = replace(animation, translations=moved)
    settings = PhysicsSettings(limbs=False)
    truth = simulate(animation, rig, warmup=0, settings=settings).animation.vertices()[:, 1:]
    carried = doll.vertices[1:] + moved[:, :1]
    swing = vertex_swing(doll, rig).take(np.arange(1, len(doll.vertices)))
    turns = np.tile(np.eye(3), (len(carried[0]), 1, 1))
    own = OwnPendulum(swing, carried[0], turns)
    found = np.stack([own.advance(positions, turns) for positions in carried])
    rigid = np.linalg.norm(truth - carried, axis=-1).mean()
    assert rigid > 0.01
    assert np.linalg.norm(carried + found - truth, axis=-1).mean() < 0.4 * rigid
