"""Chains of rigs that say nothing of physics, against what the files that they were made of say."""

from dataclasses import replace

import numpy as np
import pytest

from bunraku.apparel.mask import moved_joints
from bunraku.body.layout import HANDLE_NAMES
from bunraku.errors import CharacterError
from bunraku.physics.chains.animated import check_apparel, with_apparel
from bunraku.physics.chains.chain_rig import chain_rig
from bunraku.physics.chains.from_bones import apparel_bones, bone_chains
from bunraku.physics.chains.moving import dialled, moving_rig, steady_simulation
from bunraku.physics.settings import PhysicsSettings
from bunraku.pipelines.apply import apply_rigged
from bunraku.retarget.rig_parts import RigParts
from bunraku_lab.evaluation.transfer.stock_motions import stock_motion
from bunraku_lab.synthetic.wardrobe import wardrobe_character


def stripped(character, scrambled=False):
    """A character without its physics, and perhaps without the names of what they moved."""
    moved, rig = moved_joints(character), character.rig
    names = tuple(f"q{n}x" if scrambled and moved[n] else name for n, name in enumerate(rig.names))
    return replace(character, avatar=None, rig=replace(rig, names=names))


@pytest.fixture(scope="module")
def dressed():
    return wardrobe_character(700_008)


@pytest.mark.parametrize("scrambled", [False, True])
def test_what_physics_moved_is_found_and_nothing_else(dressed, scrambled):
    rig, moved = dressed.rig, moved_joints(dressed)
    mass = np.bincount(rig.indices.ravel(), rig.weights.ravel(), minlength=len(rig.names))
    held = moved & (mass > 1)
    found = np.zeros(len(moved), bool)
    found[list(apparel_bones(stripped(dressed, scrambled)))] = True
    assert not (found & ~moved).any()
    assert (found & held).sum() >= 0.95 * held.sum()


@pytest.mark.parametrize("seed", [9006, 9012, 9017])
def test_apparel_is_told_from_limbs_where_no_name_says_anything(seed):
    """A cape of two long chains beside the arms, a coat and twin tails, and a hem of a row of single bones."""
    character = wardrobe_character(seed)
    rig, moved = character.rig, moved_joints(character)
    held = np.bincount(rig.indices.ravel(), rig.weights.ravel(), minlength=len(rig.names)) > 1
    nameless = replace(rig, names=tuple(f"Bone.{number:03d}" for number in range(len(rig.names))))
    found = np.zeros(len(moved), bool)
    found[list(apparel_bones(replace(character, avatar=None, rig=nameless)))] = True
    assert not (found & held & ~moved).any()
    assert (found & moved & held).sum() >= 0.95 * (moved & held).sum()


@pytest.mark.parametrize("name", ["NeoHead", "head.x", "Head_End", "leg_scale_1.L"])
def test_what_is_called_by_a_part_of_the_body_does_not_swing(name):
    """A head that only its prefix hid, the end of one, and a helper of a leg swung like hair in files of others."""
    character = wardrobe_character(700_008)
    rig = character.rig
    silent = next(bone for bone, kind in apparel_bones(stripped(character)).items() if kind == "hair")
    names = [f"Neo{own}" if name.startswith("Neo") else own for own in rig.names]
    names[silent] = name
    assert silent not in apparel_bones(replace(character, avatar=None, rig=replace(rig, names=tuple(names))))


def test_long_hair_of_unknown_names_hangs_on_a_person():
    """Hair to the hips, whose bones a map takes along with the head, does not make a person lie down."""
    parts = RigParts.of(stripped(wardrobe_character(810_038), scrambled=True))
    assert parts.complete and parts.humanoid


def test_names_tell_kinds(dressed):
    kinds = apparel_bones(stripped(dressed))
    assert {kind for bone, kind in kinds.items() if "スカート" in dressed.rig.names[bone]} == {"skirt"}
    assert {kind for bone, kind in kinds.items() if "髪" in dressed.rig.names[bone]} <= {"hair"}


def test_chains_follow_the_bones(dressed):
    bare = stripped(dressed)
    rig, chains = bare.rig, bone_chains(bare)
    for chain in chains:
        np.testing.assert_allclose(chain.points[:-1], rig.positions[chain.bones], atol=1e-9)
        assert [int(rig.parents[bone]) for bone in chain.bones] == [chain.holder, *chain.bones[:-1].tolist()]
    made = chain_rig(chains, rig.positions)
    assert sorted(made.bodies[n].bone for n in made.dynamic) == sorted(b for chain in chains for b in chain.bones)
    assert set(made.unguarded) <= set(made.dynamic)
    skirts = [n for n, chain in enumerate(chains) if chain.kind == "skirt"]
    ties = [joint for joint in made.joints if " tie " in joint.name]
    assert len(ties) >= len(skirts)


def test_a_last_bone_that_holds_little_does_not_end_a_chain(dressed):
    """A skirt of a file of others stood still: the last bone of each row held a little of the hem, most of nothing."""
    bare = stripped(dressed)
    rig = bare.rig
    chain = max((one for one in bone_chains(bare) if one.kind == "skirt"), key=len)
    last, parent = int(chain.bones[-1]), int(chain.bones[-1])
    end = np.eye(4)
    end[:3, 3] = chain.points[-1]
    number = len(rig.names)
    indices = np.concatenate([rig.indices, np.full((len(rig.indices), 1), number)], axis=1)
    share = 0.1 * (rig.weights * (rig.indices == last)).sum(axis=1, keepdims=True)
    grown = replace(
        rig, names=(*rig.names, f"{rig.names[last]}_end"), parents=np.append(rig.parents, parent),
        transforms=np.concatenate([rig.transforms, end[None]]), indices=indices,
        weights=np.concatenate([rig.weights * (1 - share), share], axis=1),
    )  # fmt: skip
    found = {one.name: one for one in bone_chains(replace(bare, rig=grown))}
    np.testing.assert_array_equal(found[chain.name].bones, chain.bones)


def test_a_body_without_apparel_has_none(dressed):
    bare = stripped(dressed)
    found = apparel_bones(bare)
    rig = bare.rig
    kept = np.array([n for n in range(len(rig.names)) if n not in found])
    index = np.zeros(len(rig.names), np.int64)
    index[kept] = np.arange(len(kept))
    above = rig.parents.copy()
    for bone in found:
        while above[bone] in found:
            above[bone] = above[above[bone]]
    up = np.array([above[n] if n in found else n for n in range(len(rig.names))])
    parents = np.where(rig.parents[kept] < 0, -1, index[rig.parents[kept]])
    body = replace(
        bare,
        rig=replace(rig, names=tuple(rig.names[n] for n in kept), parents=parents, transforms=rig.transforms[kept],
                    indices=index[up[rig.indices]]),
    )  # fmt: skip
    assert apparel_bones(body) == {}
    with pytest.raises(CharacterError, match="bones of hair or clothes"):
        check_apparel(body)


def test_it_moves_and_stays_together(dressed):
    bare = stripped(dressed)
    walk = apply_rigged(stock_motion("walk", 1.0, 30.0), RigParts.of(bare))
    moved = with_apparel(walk)
    bones = [int(bone) for chain in bone_chains(bare) for bone in chain.bones]
    assert np.abs(moved.rotations[-1, bones] - walk.rotations[-1, bones]).max() > 0.02
    others = np.setdiff1d(np.arange(len(bare.rig.names)), bones)
    np.testing.assert_array_equal(moved.rotations[:, others], walk.rotations[:, others])
    stiff = with_apparel(walk, stiffness=1000.0)
    away = [np.abs(one.world()[1][:, bones] - walk.world()[1][:, bones]).mean() for one in (moved, stiff)]
    assert away[1] < 0.5 * away[0]


def test_what_flies_off_is_simulated_again(dressed):
    bare = stripped(dressed)
    walk = apply_rigged(stock_motion("walk", 0.5, 30.0), RigParts.of(bare))
    rig = moving_rig(bare)
    calm = steady_simulation(walk, rig)
    assert not calm.report.recoveries
    nervous = PhysicsSettings(most_speed=0.05)  # nearly all speeds count as flying off
    held = steady_simulation(walk, rig, settings=nervous)
    assert held.report.steps > calm.report.steps
    assert not [lost for lost in held.report.recoveries if lost.frame >= 0]


def test_the_dial_narrows_limits_and_stiffens_springs(dressed):
    rig = moving_rig(dressed)
    other = dialled(rig, 4.0, 0.5)
    one, two = rig.joints[0], other.joints[0]
    np.testing.assert_allclose(two.angle_spring, 4 * one.angle_spring)
    np.testing.assert_allclose(two.angle_upper, one.angle_upper / 2)
    np.testing.assert_allclose(other.gravity, np.tile([0, -0.5 * PhysicsSettings().gravity, 0], (len(rig.bodies), 1)))
    assert dialled(rig) is rig


def test_handles_of_the_layout_are_known():
    assert {"head_top", "tail", "tail_tip", "face"} <= set(HANDLE_NAMES)
