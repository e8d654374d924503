"""The torch fit is held together with the numpy one that animations go through."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.residuals import LOOSE_ON_PEOPLE
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin_reference
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.handles.from_rig import rig_handles
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.nn.residuals import capped_on_people
from bunraku_lab.synthetic.samples import make_sample
from bunraku_lab.training.losses.batched_fit import bone_positions, fit_locals, move_points, posed_positions


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
    from bunraku.diffusion.generation.generate import adapt

    delta = np.random.default_rng(1).normal(0, 0.02, (3, 30, 3)).astype(np.float32)
    rotations = torch.from_numpy(np.array(motion.rotations))[None]
    whole = fit_locals(
        rotations, torch.from_numpy(np.array(adapt(motion, delta).translations))[None], bank, torch.tensor([3])
    )
    apart = fit_locals(rotations, torch.from_numpy(np.array(motion.translations))[None], bank, torch.tensor([3]))
    want, got = posed_positions(whole, bank)[0], posed_positions(apart, bank, torch.from_numpy(delta)[None])[0]
    torch.testing.assert_close(got, want, atol=1e-6, rtol=0)


def test_rows_of_a_batch_do_not_mix(bank, motion):
    rotations, translations = (
        torch.from_numpy(np.array(part))[None] for part in (motion.rotations, motion.translations)
    )
    both = fit_locals(
        rotations.expand(2, -1, -1, -1, -1), translations.expand(2, -1, -1, -1), bank, torch.tensor([2, 1])
    )
    for index, row in enumerate((2, 1)):
        alone = fit_locals(rotations, translations, bank, torch.tensor([row]))
        torch.testing.assert_close(both.stiff[index], alone.stiff[0])


def test_residuals_are_cut():
    cut = capped_on_people(torch.tensor([[0.3, 0.0, 0.4], [0.01, 0.0, 0.0]]))
    torch.testing.assert_close(cut, torch.tensor([[0.03, 0.0, 0.04], [0.01, 0.0, 0.0]]))
    assert LOOSE_ON_PEOPLE == 0.05 and bool(
        torch.isfinite(torch.autograd.functional.jacobian(capped_on_people, torch.zeros(3))).all()
    )


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


def test_bones_keep_their_lengths(bank, motion):
    row = torch.tensor([1])
    fitted = fit_locals(
        *(torch.from_numpy(np.array(part))[None] for part in (motion.rotations, motion.translations)), bank, row
    )
    positions = bone_positions(fitted, bank)[1][0]
    parents = bank.bone_parents[1]
    some = torch.nonzero(parents >= 0).flatten()
    assert len(some) > 5
    length = (positions[:, some] - positions[:, parents[some]]).norm(dim=-1)
    rest = (bank.bone_joints[1, some] - bank.bone_joints[1, parents[some]]).norm(dim=-1)
    torch.testing.assert_close(length, rest.expand_as(length), atol=1e-5, rtol=0)
