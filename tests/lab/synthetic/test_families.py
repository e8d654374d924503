import numpy as np
import pytest

from bunraku.anatomy.names.bone_names import handle_of_joints
from bunraku.core.body.layout import HANDLE_MIRROR, HANDLE_NAMES
from bunraku.errors import OptionError
from bunraku_lab.synthetic.families import EVALUATION_SEED, FAMILIES, code_made_character, code_made_names

H = {name: index for index, name in enumerate(HANDLE_NAMES)}
UPRIGHT = ("humanoid", "mascot", "mech", "seahorse")
LEGGED = ("humanoid", "mascot", "quadruped", "dragon", "frog", "dinosaur", "bird", "mech", "insect", "spider", "crab")


@pytest.fixture(scope="module")
def herd():
    """Three characters of each family, with the handle of each joint and the share of each handle in each vertex."""
    out = {}
    for family in FAMILIES:
        for seed in range(EVALUATION_SEED, EVALUATION_SEED + 3):
            character = code_made_character(family, seed)
            dense = character.rig.dense_weights()
            handles = handle_of_joints(
                character.rig.names, character.rig.parents, character.rig.positions, dense.sum(axis=0)
            )
            share = np.zeros((len(dense), len(HANDLE_NAMES)))
            np.add.at(share.T, handles, dense.T)
            out[family, seed] = character, handles, share
    return out


def centre(character, share, name):
    weights = share[:, H[name]]
    return weights @ character.vertices / weights.sum() if weights.sum() > 1 else None


def test_every_family_makes_sound_rigged_meshes(herd):
    for (family, seed), (character, handles, _) in herd.items():
        rig, what = character.rig, f"{family} {seed}"
        assert 50 < len(character.vertices) < 60_000, what
        assert character.vertices[:, 1].min() == pytest.approx(0, abs=1e-5), what
        np.testing.assert_allclose(rig.weights.sum(axis=1), 1, atol=1e-4, err_msg=what)
        assert (handles >= 0).all(), f"{what}: {[n for n, h in zip(rig.names, handles, strict=True) if h < 0]}"
        assert (rig.parents < np.arange(len(rig.names))).all() and (rig.parents < 0).sum() == 1, what
        low, high = character.vertices.min(axis=0), character.vertices.max(axis=0)
        reach = 0.15 * (high - low).max()
        assert (rig.positions > low - reach).all() and (rig.positions < high + reach).all(), what
        corners = character.vertices[character.faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        assert (area > 0).mean() > 0.95, what


def test_left_is_left_and_heads_are_up_or_in_front(herd):
    for (family, seed), (character, handles, share) in herd.items():
        size, what = float(np.ptp(character.vertices, axis=0).max()), f"{family} {seed}"
        for index, name in enumerate(HANDLE_NAMES):
            if name.startswith("left_"):
                left, right = (
                    centre(character, share, name),
                    centre(character, share, HANDLE_NAMES[HANDLE_MIRROR[index]]),
                )
                hidden = family == "humanoid"  # by a coat
                assert (left is None) == (right is None) or hidden, f"{what} {name}"
                if left is not None and right is not None:
                    assert left[0] > right[0], f"{what} {name}"
        head, pelvis, joint = (
            centre(character, share, "head"),
            centre(character, share, "pelvis"),
            character.rig.positions[handles == 0].mean(axis=0),
        )
        assert pelvis is not None and np.linalg.norm(pelvis - joint) < 0.4 * size, what
        if family in UPRIGHT:
            assert head[1] > pelvis[1], what
        elif family in ("quadruped", "dragon", "fish", "whale", "ray", "insect", "spider", "bee"):
            assert head[2] > pelvis[2] + 0.1 * size, what
        tail = centre(character, share, "tail")
        if tail is not None and family != "seahorse":
            assert tail[2] < joint[2], what
        if family in LEGGED:
            feet = [centre(character, share, n) for n in ("left_ankle", "left_foot")]
            assert min(foot[1] for foot in feet if foot is not None) < joint[1], what


def test_families_have_the_parts_that_they_should(herd):
    def shown(family, name):
        return [share[:, H[name]].max() > 0.5 for (kind, _), (_, _, share) in herd.items() if kind == family]

    limbs = ["left_shoulder", "right_elbow", "left_wrist", "left_hip", "right_knee", "left_ankle"]
    for name in ("pelvis", "spine3", "head", *limbs):
        assert sum(shown("humanoid", name)) >= 2, name  # one of three may lack a part, such as a hand
    for family in ("dragon", "bee"):
        assert all(shown(family, "left_wing")) and all(shown(family, "right_wing"))
    for name in ("left_shoulder", "left_elbow", "left_wrist", "left_hip", "left_knee", "tail", "head"):
        assert all(shown("spider", name)), name
    for name in ("head", "spine2", "pelvis", "tail", "tail_tip"):
        assert all(shown("fish", name)), name


def test_the_same_seed_gives_the_same_character_and_another_another():
    first, again, other = (code_made_character("humanoid", seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.vertices, again.vertices)
    np.testing.assert_array_equal(first.rig.weights, again.rig.weights)
    assert first.vertices.shape != other.vertices.shape or not np.allclose(first.vertices, other.vertices)


def test_names_are_shared_out_and_bad_ones_are_refused():
    names = code_made_names(200)
    assert names[:40] == code_made_names(40) and len(set(names)) == 200
    assert {family for family, _ in names} == set(FAMILIES)
    assert sum(family == "humanoid" for family, _ in names) == pytest.approx(90, abs=3)
    with pytest.raises(OptionError, match="no family"):
        code_made_character("unicorn", 0)
    with pytest.raises(OptionError, match="0 or more"):
        code_made_character("fish", -1)
