"""Losses on meshes: springs, fitted motions, the discriminator, and mesh-specific learning."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from oracles import skin_reference

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.names.bone_names import rig_handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import HandleMotion
from bunraku.errors import FormatError
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.datasets.characters.bank import load_character_bank
from bunraku_lab.synthetic.samples import make_sample
from bunraku_lab.training.losses.meshes import (
    LIMB_SPRINGS,
    MeshDraw,
    MeshLearning,
    adversarial_loss,
    discriminator_loss,
    fit_locals,
    handle_driven,
    local_motion,
    move_points,
    posed_positions,
    skeleton_driven,
    spring_loss,
)
from bunraku_lab.training.rows.banks import MeshBank, load_mesh_bank


def test_spring_loss_by_hand():
    """Eq. 7 for one spring of rest length 0.5 that is 0.6 long in frame 1 and 0.55 in frame 2, sigma 0.1."""
    second = LIMB_SPRINGS[0][1]
    rest, positions = torch.zeros(1, 30, 3), torch.zeros(1, 2, 30, 3)
    rest[0, second, 1] = 0.5
    positions[0, 0, second, 1], positions[0, 1, second, 0] = 0.6, 0.55
    springs = torch.zeros(1, 12, dtype=torch.bool)
    springs[0, 0] = True
    want = math.exp(-0.6) * (0.1**2 + 0.05**2) + 0.1**2 + 0.05**2
    assert math.isclose(float(spring_loss(positions, rest, springs, 0.1)), want, rel_tol=1e-4)
    assert float(spring_loss(positions, rest, torch.zeros_like(springs), 0.1)) == 0  # absent handles have no springs
    turned = rest[:, None] @ torch.tensor([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + 3
    assert float(spring_loss(turned, rest, springs)) < 1e-10  # rigid motion


@pytest.fixture
def motion():
    random = np.random.default_rng(3)
    vectors, translations = random.normal(0, 0.3, (3, 30, 3)), random.normal(0, 0.02, (3, 30, 3))
    vectors[:, 0], translations[:, 0] = 0, 0
    still = np.zeros((3, 3))
    return HandleMotion(translations, matrix_from_axis_angle(vectors), still, matrix_from_axis_angle(still))


@pytest.mark.parametrize("row", [1, 2])
def test_it_is_the_fit_of_animations(bank, motion, row):
    character = make_sample(bank.names[row].removeprefix("samples/"), 0.5, rigged=True)
    handles = rig_handles(character).top(4)
    off = {name: False for name in vars(Stages()) if name not in ("rest_pose", "attach")}
    fitted = fit_motion(motion, Anatomy.of(replace(character, rig=None), handles), Stages(**off))
    parts = (torch.from_numpy(np.array(part))[None] for part in (motion.rotations, motion.translations))
    found = fit_locals(*parts, bank, torch.tensor([row]))
    translations, positions = posed_positions(found, bank)
    np.testing.assert_allclose(found.rotations[0], fitted.rotations, atol=1e-5)
    np.testing.assert_allclose(translations[0], fitted.translations, atol=1e-5)
    np.testing.assert_allclose(positions[0], handles.positions + fitted.translations, atol=1e-5)


def test_delta_is_what_the_generator_would_add(bank, motion):
    """`generate.adapt`, then `fit_motion`, is `posed_positions` with delta."""
    from bunraku.generation.generate import adapt

    delta = np.random.default_rng(1).normal(0, 0.02, (3, 30, 3)).astype(np.float32)
    rotations = torch.from_numpy(np.array(motion.rotations))[None]
    whole = fit_locals(
        rotations, torch.from_numpy(np.array(adapt(motion, delta).translations))[None], bank, torch.tensor([3])
    )
    apart = fit_locals(rotations, torch.from_numpy(np.array(motion.translations))[None], bank, torch.tensor([3]))
    want, got = posed_positions(whole, bank)[0], posed_positions(apart, bank, torch.from_numpy(delta)[None])[0]
    torch.testing.assert_close(got, want, atol=1e-6, rtol=0)


def test_points_move_as_eq_3_says(bank, motion):
    row = torch.tensor([1])
    fitted = fit_locals(
        *(torch.from_numpy(np.array(part))[None] for part in (motion.rotations, motion.translations)), bank, row
    )
    translations = posed_positions(fitted, bank)[0]
    points, index, weights = bank.arm_points[row, :9], bank.arm_index[row, :9], bank.arm_weights[row, :9]
    moved = move_points(points, index, weights, fitted.rotations, bank.handles[row], translations)
    h = bank.handles[1].numpy()
    offset = h + translations[0].numpy() - np.einsum("nkij,kj->nki", fitted.rotations[0].numpy(), h)
    transforms = np.concatenate([fitted.rotations[0].numpy(), offset[..., None]], -1)
    dense = np.zeros((9, 30))
    np.add.at(dense, (np.arange(9)[:, None], index[0].numpy()), weights[0].numpy())
    np.testing.assert_allclose(moved[0], skin_reference(points[0].numpy(), dense, transforms), atol=1e-5)


def test_adversarial_loss_by_hand():
    """Eq. 8 with Disc(real) = 0.8 and Disc(fake) = 0.25."""
    real, fake = (torch.tensor([math.log(p / (1 - p))]) for p in (0.8, 0.25))
    assert math.isclose(float(adversarial_loss(fake)), math.log(0.75), rel_tol=1e-5)
    assert math.isclose(float(discriminator_loss(real, fake)), -(math.log(0.8) + math.log(0.75)), rel_tol=1e-5)


def test_arms_of_handles_and_of_bones_are_told_alike(bank, gesture):
    """A resting body looks the same either way; the chest's own motion does not show; the adaptation does."""
    rotations, translations = gesture("right_elbow", 4)
    row, picked = torch.tensor([1]), torch.arange(50)[None]
    fitted = fit_locals(torch.eye(3).expand_as(rotations), torch.zeros_like(translations), bank, row)
    still = handle_driven(fitted, bank, picked)
    assert still.shape == (1, 4, 50, 6)
    assert still[..., 3:].abs().max() < 0.015 and skeleton_driven(fitted, bank, picked)[..., 3:].abs().max() < 0.015
    fitted = fit_locals(rotations, translations, bank, row)
    moved = handle_driven(fitted, bank, picked)
    real = skeleton_driven(fitted, bank, picked)
    assert moved[:, 1:, :, 3:].abs().max() > 0.02
    assert (moved - real).abs().mean() < 0.3 * moved[..., 3:].abs().mean()  # the same motion
    shift = torch.zeros(1, 4, 30, 3)
    shift[:, :, 16:] = 0.02
    shift.requires_grad_(True)
    changed = handle_driven(fitted, bank, picked, shift)
    assert (changed - moved).abs().max() > 1e-3
    changed.square().sum().backward()
    assert shift.grad.abs().sum() > 0 and float(shift.grad[:, :, 0].abs().max()) == pytest.approx(0)


@pytest.fixture
def learning(bank):
    torch.manual_seed(0)
    return MeshLearning(bank, frames=12)


def test_only_the_adaptation_is_judged(learning, features, bank):
    """Gradients reach delta and nothing else; the discriminator learns only in its turn, the denoiser in the other
    (A.2).
    """
    clean = torch.from_numpy(features("left_elbow"))[None].float().expand(2, -1, -1).clone().requires_grad_(True)
    delta = torch.zeros(2, 60, 30, 3, requires_grad=True)
    armed = torch.from_numpy(np.flatnonzero(bank.arms.numpy())[:2])
    draw = MeshDraw(armed, torch.tensor([0, 30]), 12, (torch.arange(100) % bank.arm_points.shape[1]).expand(2, -1))
    spring, adversarial, real, fake = learning.losses(draw, clean, delta, learns=False)
    assert float(spring.detach()) > 0 > float(adversarial.detach())
    (spring + adversarial).backward()
    assert clean.grad is None and delta.grad.abs().sum() > 0
    assert float(delta.grad[0, 13:].abs().sum() + delta.grad[1, :29].abs().sum()) == 0  # outside of the stretches
    assert all(value.grad is None for value in learning.discriminator.parameters())
    kept = [value.detach().clone() for value in learning.discriminator.parameters()]
    loss, score = learning.learn(real, fake, learns=False)
    assert 0 < score < 1 and all(value.grad is None for value in learning.discriminator.parameters())
    assert all(torch.equal(old, new) for old, new in zip(kept, learning.discriminator.parameters(), strict=True))
    assert float(learning.losses(draw, clean, delta, learns=True)[1].detach()) == 0
    before = [value.detach().clone() for value in learning.discriminator.parameters()]
    assert float(learning.learn(real, fake, learns=True)[0]) == pytest.approx(float(loss))
    after = list(learning.discriminator.parameters())
    assert any(not torch.equal(old, new) for old, new in zip(before, after, strict=True))
    learning.score = 0.2
    assert not learning.learns
    learning.score = 0.4
    assert learning.learns


def test_local_motion_is_what_decode_says(features, motion_of):
    values = features("right_knee")
    motion = motion_of(values)
    rotations, translations = local_motion(torch.from_numpy(values)[None])
    np.testing.assert_allclose(rotations[0], motion.rotations, atol=1e-5)
    np.testing.assert_allclose(translations[0], motion.translations, atol=1e-6)


def test_a_damaged_bank_is_refused(bank_path, tmp_path):
    with pytest.raises(FormatError, match="bunraku data character-bank"):
        load_character_bank(tmp_path / "none.npz")
    with np.load(bank_path) as file:
        whole = dict(file)
    for name, value in {
        "edge_index": whole["edge_index"] + 40,
        "features": whole["features"][:2],
        "handles": whole["handles"] * np.nan,
    }.items():
        np.savez(tmp_path / "bad.npz", **{**whole, name: value})
        with pytest.raises(FormatError, match=r"bad\.npz.*bunraku data character-bank"):
            load_character_bank(tmp_path / "bad.npz")


def write(path, **parts):
    np.savez(path, **{name: np.array(value) for name, value in parts.items()})
    return path


def test_a_row_takes_the_mesh_of_its_character(tmp_path):
    names = ["a/Horse", "a/Horse~posed", "b/Man", "b/Man~fine", "c/Held"]
    features = np.arange(5, dtype=np.float32)[:, None] * np.ones((5, 3), np.float32)
    split, humanoid = ["train"] * 4 + ["test"], [False, False, True, True, True]
    bank = load_mesh_bank(
        write(tmp_path / "bank.npz", features=features, names=names, split=split, humanoid=humanoid), 3
    )
    assert len(bank) == 4
    random = np.random.default_rng(0)
    drawn = [bank.draw(["a/Horse", None, "a/Cow", "c/Held"], 4, random) for _ in range(40)]
    assert {int(values[0, 0]) for values, _ in drawn} == {0, 1} and {int(values[1, 0]) for values, _ in drawn} == {2, 3}
    assert all(known.tolist() == [True, True, False, False] for _, known in drawn)
    assert {int(bank.draw(None, 1, random, cross=1.0)[0][0, 0]) for _ in range(60)} == {0, 1, 2, 3}


def test_a_bank_without_names_gives_any_row(tmp_path):
    bank = load_mesh_bank(write(tmp_path / "bank.npz", features=np.eye(3, dtype=np.float32)), 3)
    assert isinstance(bank, MeshBank)
    values, known = bank.draw([None] * 50, 50, np.random.default_rng(0))
    assert known.all() and bool((values.sum(0) > 5).all())
    with pytest.raises(FormatError, match="not as many"):
        load_mesh_bank(write(tmp_path / "bad.npz", features=np.eye(3), names=["a"]), 3)
    with pytest.raises(FormatError, match="split 'train'"):
        load_mesh_bank(write(tmp_path / "bad.npz", features=np.eye(3), split=["test"] * 3), 3)
