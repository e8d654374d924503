"""Trainings of Neural Blend Shapes and Skeleton-free Pose Transfer, on the reference body in a few poses."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bunraku.core.body.layout import JOINT_COUNT
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.geometry.simplify import network_mesh
from bunraku.core.skinning import skin
from bunraku.errors import FormatError
from bunraku_lab.nn.blend_shapes import NbsConfig, NbsNetwork
from bunraku_lab.nn.pose_transfer import TransferConfig, TransferNetwork
from bunraku_lab.training.baselines.banks import ClothedSample, clothed_target, drawn_pairs, posed_sample, rootless
from bunraku_lab.training.baselines.nbs import NbsTrainConfig, NbsTrainer
from bunraku_lab.training.baselines.transfer import TransferTrainConfig, TransferTrainer

SMALL = TransferConfig(levels=(8, 8), code=8)


def poses(count=6, seed=0):
    """Affine transforms of the reference body's joints, which turn as chance says; the body faces anywhere."""
    body, random = reference_body(), np.random.default_rng(seed)
    turns = np.tile(np.eye(3), (count, JOINT_COUNT, 1, 1))
    positions = np.zeros((count, JOINT_COUNT, 3))
    positions[:, 0] = body.joints[0] + random.normal(0, 0.5, (count, 3))
    for joint in range(JOINT_COUNT):
        parent = int(body.skeleton.parents[joint])
        own = matrix_from_axis_angle(random.normal(0, 0.35, (count, 3)))
        turns[:, joint] = own if parent < 0 else turns[:, parent] @ own
        if parent >= 0:
            offset = body.joints[joint] - body.joints[parent]
            positions[:, joint] = positions[:, parent] + turns[:, parent] @ offset
    shifts = positions - np.einsum("njab,jb->nja", turns, body.joints)
    return np.concatenate([turns, shifts[..., None]], axis=3).astype(np.float32)


@pytest.fixture(scope="module")
def clothed():
    """The body of about 200 vertices, its truth being its own skinning."""
    body = reference_body()
    mesh = network_mesh(body.vertices, body.faces, 340)
    rest, weights = mesh.pull(body.vertices), mesh.pull(body.joint_weights)
    affine = poses()
    none = np.zeros(len(rest), np.float32)
    return ClothedSample(
        "body", rest, mesh.normals, mesh.faces, mesh.edges, mesh.areas, body.joints.astype(np.float32), weights, none,
        affine, np.ascontiguousarray(skin(rest, weights, affine), np.float32),
    )  # fmt: skip


def nbs_config(folder, **settings):
    known = {"steps": 60, "minutes": 0, "poses": 4, "rate": 3e-3, "warmup": 5, "decay": 0.8, "validate_every": 1000}
    return NbsTrainConfig(out=folder, network=NbsConfig(skinning=(16, 16)), **{**known, **settings})


def test_a_skinning_branch_learns(clothed, tmp_path):
    trainer = NbsTrainer(nbs_config(tmp_path), [clothed], [clothed])
    before = trainer.validate()["pmd"]
    trainer.learn()
    assert trainer.validate()["pmd"] < 0.6 * before
    assert NbsNetwork.load(trainer.checkpoint).config == trainer.config.network


def test_targets_of_the_data_set_have_the_source_in_their_pose(clothed):
    """Truth and source are in the frame of the root, in which the body stays where it is."""
    target = clothed_target(clothed)
    assert target.turns is not None
    np.testing.assert_allclose(target.mesh.weights.sum(axis=1), 1, atol=1e-4)
    (pair,) = drawn_pairs([target], 1, np.random.default_rng(0))
    body = target.truth[pair.pose]  # the target is the source's own body, of other vertices
    assert np.abs(pair.posed.min(axis=0) - body.min(axis=0)).max() < 0.05
    assert np.abs(pair.posed.max(axis=0) - body.max(axis=0)).max() < 0.05


def transfer_config(folder, preset, **settings):
    known = {"steps": 30, "minutes": 0, "warmup": 5, "decay": 0.8, "validate_every": 1000}
    return TransferTrainConfig(out=folder, preset=preset, network=SMALL, **{**known, **settings})


@pytest.mark.parametrize("preset", ["sfpt", "spt"])
def test_every_preset_learns_and_comes_back(preset, clothed, tmp_path):
    targets = [clothed_target(clothed)]
    if preset == "sfpt":
        targets = [replace(targets[0], name=name, turns=None) for name in ("reference_average", "other")]
    config = transfer_config(tmp_path, preset, steps=3)
    trainer = TransferTrainer(config, targets, targets[:1])
    figures = [trainer.train_step()["loss"] for _ in range(3)]
    assert np.isfinite(figures).all() and np.isfinite(list(trainer.validate().values())).all()
    trainer.save({})
    again = TransferTrainer(config, targets)
    assert again.resume() and again.step == 3
    for name, value in trainer.average.state_dict().items():
        assert torch.equal(again.average.state_dict()[name], value), name
    assert TransferNetwork.load(trainer.checkpoint).config == config.network


def test_transfer_learns_what_the_source_s_parts_lack(clothed, tmp_path):
    """A target that goes half as far again as the source: its own transforms cannot say so, the network can."""
    target = clothed_target(clothed)
    far = target.truth + 0.5 * (target.truth - target.mesh.rest)
    target = replace(target, truth=far.astype(np.float32))
    trainer = TransferTrainer(transfer_config(tmp_path, "spt", steps=24, rate=4e-3, edges=0.0), [target], [target])
    before = trainer.validate()
    assert before["pmd"] == pytest.approx(before["pmd_floor"], rel=0.1)  # it begins as the source's own transforms
    losses = [trainer.train_step()["loss"] for _ in range(24)]
    assert np.mean(losses[-5:]) < 0.9 * np.mean(losses[:5])


def test_posed_characters_share_their_poses(tmp_path):
    """The reference body's shapes in the same poses, without turns or steps of the root."""
    from bunraku.core.motion import HandleMotion

    random = np.random.default_rng(0)
    turns = np.tile(np.eye(3), (2, 30, 1, 1))
    turns[:, 16:19:2] = matrix_from_axis_angle(random.normal(0, 0.6, (2, 1, 3)))  # the left arm
    root = matrix_from_axis_angle(random.normal(0, 1, (2, 3)))
    motion = HandleMotion(np.zeros((2, 30, 3)), turns, random.normal(size=(2, 3)), root)
    assert np.abs(rootless(motion).root_translation).max() == 0
    found = posed_sample(reference_body().character(), "average", motion, 300)
    assert found.truth.shape == (2, len(found.mesh.rest), 3) and abs(np.ptp(found.mesh.rest[:, 1]) - 1) < 0.05
    legs = found.skinning[:, [1, 2, 4, 5, 7, 8, 10, 11]].sum(axis=1) > 0.95
    arm = found.skinning[:, [16, 18, 20]].sum(axis=1) > 0.95
    away = np.abs(found.truth - found.mesh.rest).max(axis=(0, 2))
    assert away[legs].max() < 0.02 and away[arm].min() > 0.01


def test_a_cache_of_characters_is_told_from_characters(tmp_path):
    from bunraku_lab.evaluation.handles.subjects import find_files

    (tmp_path / "one.npz").write_bytes(b"")
    with pytest.raises(FormatError, match="made for training"):
        find_files(tmp_path)
    (tmp_path / "one.npz").unlink()
    with pytest.raises(FormatError, match="no characters here"):
        find_files(tmp_path)
