"""Chains of apparel: from bones, from the shape, of avatars, with parameters of a file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku import load_character, save_character, transfer, with_skeleton
from bunraku.anatomy.anatomy import Anatomy
from bunraku.apparel.chains.avatars import between_frames, fitted_springs, link_turns, mmd_avatar, vrm_avatar, vrm_steps
from bunraku.apparel.chains.chain import (
    Chain,
    LaidShape,
    parameters_beside,
    parameters_of,
    parameters_of_laid,
    with_parameters,
    write_parameters,
)
from bunraku.apparel.chains.chain_rig import Chained, LaidChains, chain_rig, with_chains
from bunraku.apparel.chains.from_bones import apparel_bones, bone_chains
from bunraku.apparel.chains.from_shape import shape_chains, with_parts_from_file
from bunraku.apparel.chains.moving import check_apparel, dialled, moving_rig, steady_simulation, with_apparel
from bunraku.apparel.chains.sheets import pieces_of
from bunraku.apparel.clothed import LOADS, ClothedCharacter, Swing
from bunraku.apparel.fitting import kinds_of
from bunraku.apparel.mask import moved_joints
from bunraku.apparel.parts import find_parts
from bunraku.apparel.physics.clothed_from_file import clothed_from_file
from bunraku.apparel.physics.rig import PhysicsSettings
from bunraku.core.animation import RigAnimation
from bunraku.core.avatars import mmd_model, vrm_model
from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Rig, top_influences
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.errors import CharacterError, FormatError
from bunraku.files.gltf.open import open_document
from bunraku.files.mmd.write import save_pmx
from bunraku.files.samples import sample_character
from bunraku.pipelines.animate import rig
from bunraku.pipelines.apply import apply_rigged
from bunraku.pipelines.clothes import rig_with_chains
from bunraku.retarget.rig_parts import RigParts
from bunraku_lab.synthetic.stock_motions import stock_motion
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


@pytest.mark.parametrize("factor", [0.002, 100.0])
def test_chains_are_the_same_in_any_unit(dressed, factor):
    bare = stripped(dressed)
    transforms = bare.rig.transforms.copy()
    transforms[:, :3, 3] *= factor
    other = replace(bare, vertices=bare.vertices * factor, rig=replace(bare.rig, transforms=transforms))
    for chain, same in zip(bone_chains(bare), bone_chains(other), strict=True):
        np.testing.assert_array_equal(same.bones, chain.bones)
        np.testing.assert_allclose(same.points, factor * chain.points, rtol=1e-4, atol=1e-5 * factor)


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


JOINTS = np.arange(JOINT_COUNT)
Laid = tuple[Chained, LaidChains, Character]


@pytest.fixture(scope="module", params=[870_003, 810_016])
def laid(request: pytest.FixtureRequest) -> Laid:
    """A character with long hair, and one with ears, a tail and a scarf; their files' bones are
    not told.
    """
    clothed = clothed_from_file(wardrobe_character(request.param))
    transforms = np.tile(np.eye(4), (JOINT_COUNT, 1, 1))
    transforms[:, :3, 3] = clothed.joints
    rig = Rig(JOINT_NAMES, np.array(JOINT_PARENTS), transforms, *top_influences(clothed.weights, 4))
    found = shape_chains(clothed)
    body = Character("bare", clothed.rest, clothed.faces, rig)
    return with_chains(body, found, JOINTS), found, body


def _swung(made: Chained, body: Character) -> RigAnimation:
    """The body leans from side to side, all of it."""
    frames = 45
    rotations = np.tile(np.eye(3), (frames, JOINT_COUNT, 1, 1))
    angles = 0.5 * np.sin(np.arange(frames) / 30 * 2 * np.pi)
    rotations[:, 0] = matrix_from_axis_angle(np.stack([0 * angles, 0.5 * angles, angles], axis=1))
    return made.on(RigAnimation(body, rotations, np.zeros((frames, JOINT_COUNT, 3)), 30.0))


def test_what_is_held(laid: Laid) -> None:
    made, found, _ = laid
    assert len(found.chains) > 3
    assert (found.shares >= 0).all() and found.shares.sum(axis=1).max() < 1 + 1e-9
    assert found.links.max() < sum(map(len, found.chains))
    rig = made.character.rig
    assert rig is not None
    np.testing.assert_allclose(rig.weights.sum(axis=1), 1, atol=1e-5)
    # each chain hangs on a bone above it, and its end is a bone of its own
    for chain, end in zip(made.chains, made.ends, strict=True):
        assert rig.parents[chain.bones[0]] == chain.holder < chain.bones[0]
        assert rig.parents[end] == chain.bones[-1]
        np.testing.assert_allclose(rig.positions[end], chain.points[-1])


def test_a_tail_hangs_from_the_head_and_not_from_the_hip_that_it_touches() -> None:
    """A tuft on the skull, and a strip that begins behind it and lies on the hips on its way to the floor."""
    body = reference_body()
    head, pelvis = (body.joints[JOINT_NAMES.index(name)] for name in ("head", "pelvis"))
    back = body.vertices[np.abs(body.vertices[:, 1] - pelvis[1]) < 0.03][:, 2].min() - 0.005
    down = np.interp(np.linspace(0, 1, 40), [0, 0.5, 1], [head[1] + 0.1, pelvis[1], 0.1])
    away = np.interp(down, [0.1, pelvis[1], head[1] + 0.1], [back - 0.1, back, head[2] - 0.3])
    tail = np.stack([np.tile([-0.03, 0.03], 40), np.repeat(down, 2), np.repeat(away, 2)], axis=1)
    tuft = head + [[-0.03, 0.1, -0.05], [0.03, 0.1, -0.05], [-0.03, 0.15, -0.05], [0.03, 0.15, -0.05]]
    first = np.arange(0, 78, 2)[:, None]
    strip = np.concatenate([first + [0, 2, 1], first + [1, 2, 3]])
    hair = np.concatenate([tail, tuft])
    faces = np.concatenate([strip, [[80, 81, 82], [81, 83, 82]]]) + len(body.vertices)
    apparel = np.arange(len(body.vertices) + len(hair)) >= len(body.vertices)
    held = np.tile(np.eye(JOINT_COUNT, dtype=np.float32)[JOINT_NAMES.index("head")], (len(hair), 1))
    part = np.full(len(apparel), -1)
    part[apparel] = np.repeat([0, 1], [80, 4])
    clothed = ClothedCharacter(
        np.concatenate([body.vertices, hair]).astype(np.float32), np.concatenate([body.faces, faces]),
        np.asarray(body.joints), np.concatenate([body.joint_weights, held]).astype(np.float32), apparel, part,
        np.full(2, -1, np.float32), np.full(2, 0.9, np.float32), kinds=("hair", "hair"),
    )  # fmt: skip
    (piece,) = pieces_of(clothed)[0]
    order = np.argsort(-piece.points[:, 1])
    order = order[piece.points[order, 2] < head[2] - 0.1]
    assert (np.diff(piece.along[order]) > -0.02).all()
    assert piece.along[order[-1]] > 0.9 * (down[0] - down[-1])


def test_seams_stay_closed(laid: Laid) -> None:
    """Vertices of one place are held by the same links, so no motion opens a seam."""
    made, _, body = laid
    moved = steady_simulation(_swung(made, body), made.rig()).animation.vertices([20, 44])
    _, first, index = np.unique(np.round(made.character.vertices, 6), axis=0, return_index=True, return_inverse=True)
    index = index.reshape(-1)
    gap = np.linalg.norm(moved - moved[:, first[index]], axis=-1)
    own = np.ptp(made.character.vertices[:, 1])
    assert np.percentile(gap, 99.9) < 1e-3 * own


def test_chains_swing_and_do_not_fly(laid: Laid) -> None:
    made, found, body = laid
    animation = _swung(made, body)
    result = steady_simulation(animation, made.rig())
    assert not result.report.recoveries
    away = np.linalg.norm(result.animation.vertices() - animation.vertices(), axis=-1)
    size = float(np.ptp(made.character.vertices[:, 1]))
    stiff = with_chains(body, found.turned(10.0, 1.0), JOINTS)
    less = steady_simulation(_swung(stiff, body), stiff.rig()).animation.vertices() - animation.vertices()
    assert np.linalg.norm(less, axis=-1).max() < 0.7 * away.max()
    assert away[:, found.vertices].max() > 0.005 * size
    assert away.max() < 0.5 * size
    still = np.ones(len(made.character.vertices), bool)
    still[found.vertices] = False
    assert away[:, still].max() < 1e-5


def test_a_skirt_is_tied_all_round() -> None:
    """A cone about a post: as many columns all round, each tied to the next on both sides, all of one length."""
    turn = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    rows = [(0.1, 1.7), (0.1, 1.0), (0.1, 0.0)], [(0.12, 1.0), (0.2, 0.85), (0.28, 0.7), (0.36, 0.55)]
    points, faces = [], []
    for rings in rows:
        start = 32 * len(points)
        points += [np.stack([r * np.sin(turn), np.full(32, y), r * np.cos(turn)], axis=1) for r, y in rings]
        for row in range(len(rings) - 1):
            a = start + 32 * row + np.arange(32)
            b = start + 32 * row + (np.arange(32) + 1) % 32
            faces += [np.stack([a, b, a + 32], axis=1), np.stack([b, b + 32, a + 32], axis=1)]
    vertices = np.concatenate(points).astype(np.float32)
    cloth = np.arange(len(vertices)) >= 96
    weights = np.zeros((len(vertices), JOINT_COUNT), np.float32)
    weights[:, 0] = 1
    joints = np.zeros((JOINT_COUNT, 3), np.float32)
    joints[:, 1] = 0.95
    one = np.zeros(1, np.float32)
    found = shape_chains(
        ClothedCharacter(
            vertices, np.concatenate(faces), joints, weights, cloth, np.where(cloth, 0, -1), one, one, kinds=("skirt",)
        )
    )
    assert {chain.kind for chain in found.chains} == {"skirt"} and len(found.chains) >= 6
    assert (np.bincount(np.array(found.ties).ravel()) == 2).all()
    lengths = [chain.length for chain in found.chains]
    assert max(lengths) < 1.05 * min(lengths)
    hem = np.flatnonzero(vertices[found.vertices, 1] < 0.56)
    np.testing.assert_allclose(found.shares[hem].sum(axis=1), 1, atol=1e-6)


@pytest.fixture(scope="module")
def clothed():
    return clothed_from_file(wardrobe_character(810_003))


def test_a_part_is_as_stiff_as_its_kind_is_told(clothed) -> None:
    guessed = replace(clothed, swing=None)
    laid = shape_chains(guessed)
    kinds = np.array(kinds_of(guessed, find_parts(guessed.rest, guessed.faces).label))
    kind = laid.chains[0].kind
    assert kind in kinds
    told = with_parts_from_file(guessed, {kind: {"limit": 3.0, "damping": 0.5}})
    assert (
        with_parts_from_file(guessed, {}) is guessed
        and with_parts_from_file(guessed, {"no such": {"limit": 1}}) is guessed
    )
    moved = told.stiffness != guessed.stiffness
    assert moved[kinds == kind].any()
    held = moved & (kinds == kind)
    assert told.stiffness[held] == pytest.approx(LOADS - np.log10(np.radians(3.0)), abs=1e-4)
    assert told.damping[held] == pytest.approx(0.5, abs=1e-5)
    others = kinds != kind
    np.testing.assert_allclose(told.stiffness[others], guessed.stiffness[others], atol=0.5)
    assert told.swing is None


def test_what_hangs_freely_swings_wider_than_what_lies_on_the_body_or_stands() -> None:
    """A ponytail beside a bob of the same length, and hair that stands: also once it is laid over a mesh."""
    free, bob, stands = LaidShape(0.4, 5.0, 0.1, 1.0), LaidShape(0.4, 5.0, 0.005, 1.0), LaidShape(0.4, 5.0, 0.1, -1.0)
    tail, others = parameters_of_laid("hair", free), [parameters_of_laid("hair", one) for one in (bob, stands)]
    assert all(tail.limit > 1.9 * one.limit and tail.stiffness < one.stiffness for one in others)
    assert others[1].gravity == 0 < tail.gravity  # its weight does not bend what stands
    assert parameters_of_laid("skirt", replace(free, slim=np.inf)).gravity == 0  # nor what is drawn as it hangs
    short = parameters_of_laid("hair", replace(free, length=0.05))
    assert short.limit < 0.5 * tail.limit


def test_vertices_of_a_file_swing_as_far_as_the_links_of_their_chain(clothed) -> None:
    laid = shape_chains(clothed)
    longest = max(laid.chains, key=len)
    told = with_parts_from_file(clothed, {longest.name: {"limit": 2.0, "stiffness": 4.0, "gravity": 0.5}})
    assert told.swing is not None and clothed.swing is not None
    changed = np.flatnonzero((told.swing != clothed.swing).any(axis=1))
    assert len(changed) and np.isin(changed, laid.vertices).all()
    swing, before = Swing.of_rows(told.swing[changed]), Swing.of_rows(clothed.swing[changed])
    np.testing.assert_allclose(swing.upper, np.radians(2.0) * len(longest), rtol=1e-5)
    np.testing.assert_allclose(swing.lower, -swing.upper)
    assert (swing.weight == 0.5).all() and (swing.drag == before.drag).all()


HAIR = Chain(
    "hair_1", "hair", np.array([1]), np.array([[0, 1, 0], [0, 0.8, 0.0]]), 0, np.array([0.02]), 0.01,
    parameters_of("hair"),
)  # fmt: skip


def test_kinds_and_names(tmp_path: Path) -> None:
    character = load_character(save_pmx(wardrobe_character(810_003), tmp_path / "one.pmx"))
    assert parameters_beside(character) == {}
    (tmp_path / "one.apparel.toml").write_text("[hair]\nlimit = 30\nstiffness = 2\n[hair_1]\nstiffness = 5\n")
    told = parameters_beside(character)
    (chain,) = with_parameters([HAIR], told)
    assert chain.parameters.limit == pytest.approx(np.radians(30)) and chain.parameters.stiffness == 5
    assert chain.parameters.damping == HAIR.parameters.damping
    (other,) = with_parameters([HAIR], {"skirt": {"limit": 3}})
    assert other is HAIR


@pytest.mark.parametrize(
    ("text", "said"),
    [("limit = 3", "outside"), ("[hair]\nlimits = 3", "not known"), ("[hair]\nlimit = 300", "from 0 to 90"),
     ("[hair]\nlimit = nan", "from 0 to 90"), ("[hair", "not TOML"), (f"[hair]\nlimit = {'9' * 5000}", "not TOML")],
)  # fmt: skip
def test_what_is_wrong_is_said(tmp_path: Path, text: str, said: str) -> None:
    character = load_character(save_pmx(wardrobe_character(810_003), tmp_path / "one.pmx"))
    (tmp_path / "one.apparel.toml").write_text(text)
    with pytest.raises(FormatError, match=said):
        parameters_beside(character)


def test_what_is_written_changes_nothing_until_a_sign_is_taken_away(tmp_path: Path) -> None:
    character = load_character(save_pmx(wardrobe_character(810_003), tmp_path / "one.pmx"))
    path = tmp_path / "one.apparel.toml"
    facts = {"name": '前髪 "1"', "kind": "hair", "links": 3, "hangs_on": "head\n[tail]", "limit": 12.5,
             "stiffness": 0.3, "damping": 0.93, "gravity": 1.0, "mass": 0.5}  # fmt: skip
    write_parameters([facts, {**facts, "name": "hair_1"}], path)
    assert parameters_beside(character) == {'前髪 "1"': {}, "hair_1": {}}
    assert with_parameters([HAIR], parameters_beside(character)) == (HAIR,)
    path.write_text(path.read_text("utf-8").replace("# limit = 12.5", "limit = 40"), "utf-8")
    told = parameters_beside(character)
    assert told["hair_1"] == {"limit": 40}
    (chain,) = with_parameters([HAIR], told)
    assert chain.parameters.limit == pytest.approx(np.radians(40))


@pytest.fixture(scope="module")
def made() -> Chained:
    """Twin tails on a bare mesh, on VRM's skeleton."""
    model = wardrobe_character(810_003)
    bare = Character("tails", model.vertices, model.faces)
    return rig_with_chains(Anatomy.of(bare, rig(bare)), "vrm")


def test_vrm_is_read_back(made: Chained, tmp_path: Path) -> None:
    avatar = vrm_avatar(made)
    path = save_character(made.character, tmp_path / "tails.vrm", rig=True, avatar=avatar)
    read = load_character(path)
    found = vrm_model(read)
    assert found is not None and found.version == "1.0" and not found.warnings
    assert {"hips", "head", "leftHand", "rightFoot"} <= found.humanoid.keys()
    assert len(found.springs) == len(made.chains)
    for mine, theirs in zip(avatar.springs, found.springs, strict=True):
        assert [joint.node for joint in mine.joints] == [joint.node for joint in theirs.joints]
        for one, other in zip(mine.joints, theirs.joints, strict=True):
            assert one.stiffness == pytest.approx(other.stiffness, abs=1e-5)
            assert one.drag == pytest.approx(other.drag, abs=1e-5)
    assert len(found.colliders) == len(avatar.colliders)
    assert read.rig is not None and made.character.rig is not None
    np.testing.assert_allclose(read.rig.positions, made.character.rig.positions, atol=1e-5)


def test_springs_in_the_extras_of_a_glb(made: Chained, tmp_path: Path) -> None:
    path = save_character(made.character, tmp_path / "tails.glb", rig=True, avatar=vrm_avatar(made))
    tree = open_document(path, path.read_bytes()).tree
    springs = tree["extras"]["springs"]["springs"]  # type: ignore[index]
    names = [node.get("name") for node in tree["nodes"]]  # type: ignore[attr-defined]
    assert [names[spring["joints"][0]["node"]] for spring in springs] == [f"{chain.name}_1" for chain in made.chains]
    assert "VRMC_springBone" not in tree.get("extensions", {})  # type: ignore[operator]


def test_pmx_is_read_back(made: Chained, tmp_path: Path) -> None:
    path = save_character(made.character, tmp_path / "tails.pmx", rig=True, avatar=mmd_avatar(made))
    found, own = mmd_model(load_character(path)), mmd_avatar(made)
    assert found is not None and not found.warnings
    limbs = {body.name for body in made.colliders}  # those that something lies in at rest stay out of the file
    rest = [[body.name for body in rig.bodies if body.name not in limbs] for rig in (found, own)]
    assert rest[0] == rest[1] and {body.name for body in found.bodies} & limbs
    for mine, theirs in zip(own.joints, found.joints, strict=True):
        assert mine.bodies == theirs.bodies
        np.testing.assert_allclose(theirs.angle_upper, mine.angle_upper, atol=1e-6)
        np.testing.assert_allclose(theirs.position, mine.position, atol=1e-6)


def test_a_vrm_needs_its_skeleton(tmp_path: Path) -> None:
    character = sample_character("person")
    with pytest.raises(CharacterError, match="skeleton"):
        save_character(character, tmp_path / "person.vrm")
    with pytest.raises(CharacterError, match="T-pose"):
        save_character(with_skeleton(character, "mixamo"), tmp_path / "person.vrm", rig=True)
    assert not list(tmp_path.iterdir())


def swung(turns: np.ndarray, heads: np.ndarray, rest: np.ndarray, values: np.ndarray, fps: float) -> np.ndarray:
    """Tails of a chain by VRM's steps, link by link, shape (N, R, 3); values are of shape (R, 3)."""
    turns, heads = between_frames(turns[:, None], heads[:, None], fps)
    out = []
    for bone, one in zip(rest[:, None], values, strict=True):
        tails = np.stack(list(vrm_steps(turns, heads, bone, tuple(one[:, None, None]))))[:, :, 0]
        turns, heads = link_turns(turns, heads, bone, tails), tails
        out.append(tails[:: round(60 / fps), 0])
    return np.stack(out, axis=1)


def test_springs_of_vrm_go_about_as_the_chains_do_in_a_walk_that_they_were_not_fitted_to(made: Chained) -> None:
    moved = transfer(made.character, stock_motion("walk", 3.0, 30.0), onto="rig")
    assert isinstance(moved, RigAnimation)
    turns, places = (values.astype(np.float64) for values in moved.world())
    ours = steady_simulation(moved, made.rig()).animation.world()[1]
    apart = rigid = 0.0
    for chain, end, values in zip(made.chains, made.ends, fitted_springs(made), strict=True):
        tails = [*chain.bones[1:], end]
        found = swung(turns[:, chain.holder], places[:, chain.bones[0]], np.diff(chain.points, axis=0), values, 30.0)
        apart += float(np.linalg.norm(found - ours[:, tails], axis=-1).mean())
        rigid += float(np.linalg.norm(places[:, tails] - ours[:, tails], axis=-1).mean())
    assert apart < 0.75 * rigid


def test_steps_of_a_spring() -> None:
    """Two links swing as the specification says, step by step."""
    turns, heads = np.tile(np.eye(3), (5, 1, 1)), np.zeros((5, 3))
    heads[1:, 0] = 0.1
    rest = np.array([[0.0, -0.2, 0], [0.0, -0.1, 0.05]])
    values = np.array([[0.5, 0.3, 0.1], [0.2, 0.1, 0.0]])
    found = swung(turns, heads, rest, values, 60.0)
    now = np.cumsum(rest, axis=0)
    before = now.copy()
    for frame in range(1, 5):
        head, turn, new = heads[frame], np.eye(3), now.copy()
        for link, (stiffness, drag, gravity) in enumerate(values):
            length, aim = np.linalg.norm(rest[link]), turn @ rest[link] / np.linalg.norm(rest[link])
            there = now[link] + (1 - drag) * (now[link] - before[link]) + stiffness / 60 * aim - [0, gravity / 60, 0]
            there = head + length * (there - head) / np.linalg.norm(there - head)
            turn = Rotation.align_vectors([there - head], [aim * length])[0].as_matrix() @ turn
            new[link] = head = there
        before, now = now, new
        np.testing.assert_allclose(found[frame], now, atol=1e-9)
