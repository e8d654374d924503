"""Training of the apparel networks: what is learned from, and runs that go on where they stopped."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bunraku.apparel.body import eq4_transforms
from bunraku.apparel.learned.network import DisplacementConfig
from bunraku.core.skinning import skin
from bunraku.errors import OptionError
from bunraku_lab.datasets.apparel import ApparelData
from bunraku_lab.datasets.apparel.build import build_apparel
from bunraku_lab.datasets.apparel.plan import choose_motions, motion_sources, plan_shards, wardrobe_sources
from bunraku_lab.datasets.motions.clips import write_clip, write_index
from bunraku_lab.nn.apparel import DisplacementNetwork, running_displacement
from bunraku_lab.synthetic.stock_motions import stock_motion
from bunraku_lab.training.apparel.body import (
    BodyConfig,
    BodyTrainConfig,
    BodyTrainer,
    pose_bank,
    posed_joints,
    train_body,
)
from bunraku_lab.training.apparel.displacement import (
    DisplacementTrainConfig,
    DisplacementTrainer,
    build_bank,
    truly_clothed,
)
from bunraku_lab.training.apparel.meshes import build_meshes
from bunraku_lab.training.apparel.refinement import (
    RefinementConfig,
    RefinementNetwork,
    RefinementTrainConfig,
    RefinementTrainer,
    seam_of,
    seam_sample,
)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Two seconds of a walk of one character of the wardrobe."""
    motions = tmp_path_factory.mktemp("motions")
    write_clip(motions / "a_walk.npz", stock_motion("walk", 4.5, 20.0))
    write_index(motions, {"a_walk": {"frames": 90, "split": "train"}})
    folder = tmp_path_factory.mktemp("apparel")
    source = replace(wardrobe_sources(1, 21)[0], split="train")
    plan, left = plan_shards([source], choose_motions(motion_sources(motions), 1), minutes=2 / 60, longest=2.0)
    assert not left and not build_apparel(folder, plan).failed
    return folder


@pytest.fixture(scope="module")
def bank(data, tmp_path_factory):
    return build_bank(ApparelData(data), tmp_path_factory.mktemp("nodes"), nodes=48)


def test_some_are_seen_as_bare_meshes_too(data, tmp_path, monkeypatch):
    monkeypatch.setattr("bunraku_lab.training.apparel.displacement.GUESSED_EVERY", 1)
    told, untold = build_bank(ApparelData(data), tmp_path, nodes=48)
    assert told.name == untold.name and told.path != untold.path
    assert np.unique(told.arrays["static_scalars"][:, -1]).tolist() == [1]
    assert np.unique(untold.arrays["static_scalars"][:, -1]).tolist() == [0]
    np.testing.assert_array_equal(told.moving["truth"], untold.moving["truth"])
    assert not np.allclose(told.moving["vectors"], untold.moving["vectors"])  # its pendulums are guessed


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    found = build_meshes(tmp_path_factory.mktemp("meshes"), 2, 10_001)
    return [one for split in found.values() for one in split]


def test_the_bank_holds_what_the_data_say(data, bank):
    found = ApparelData(data)
    clip, (character,) = found.clips[0], bank
    own, moving = character.arrays, character.moving
    true, loose = found.window(clip), found.character(clip)
    assert len(character) == clip.frames and own["starts"].tolist() == [0, clip.frames]
    carried = skin(loose.rest, loose.weights, eq4_transforms(true.transforms, loose.joints))[:, own["vertex"]]
    size = float(own["scale"])
    back = carried + size * np.einsum("nmab,nmb->nma", moving["turns"].astype(float), moving["truth"].astype(float))
    np.testing.assert_allclose(back, true.vertices[:, own["vertex"]], atol=2e-3)  # half precision
    assert loose.part[own["vertex"]].tolist() == own["part"].tolist()
    held = (loose.spring > 0) | (loose.limit < np.pi)  # by springs, or where a piece has none by its joints' limits
    assert held[np.unique(own["part"])].all() and (loose.mass > 0).all()
    again = build_bank(found, character.path.parent, nodes=48)
    assert again[0].path == character.path


def test_displacement_learns_one_clip(bank, tmp_path):
    config = DisplacementTrainConfig(
        out=tmp_path, minutes=0, steps=120, head=1.0, batch=4, warmup=5, rate=5e-3,
        network=DisplacementConfig(16, 1, 0),
    )  # fmt: skip
    trainer = DisplacementTrainer(config, bank)
    losses = [trainer.train_step()["head_loss"] for _ in range(60)]
    assert np.mean(losses[-8:]) < 0.8 * np.mean(losses[:8])


def test_the_recurrent_part_goes_about_a_trained_head(bank, tmp_path):
    shape = DisplacementConfig(8, 1, 0)
    config = DisplacementTrainConfig(out=tmp_path / "a", minutes=0, steps=3, head=1.0, batch=2, warmup=1, network=shape)
    first = DisplacementTrainer(config, bank)
    for _ in range(3):
        first.train_step()
    path = first.save({})
    head = DisplacementNetwork.load(path).anchor.state_dict()
    second = replace(
        config, out=tmp_path / "b", start=path, head=0.0, clips=1, shortest=5, longest=6,
        network=DisplacementConfig(8, 1, 8),
    )  # fmt: skip
    trainer = DisplacementTrainer(second, bank)
    for _ in range(3):
        assert "recurrent_loss" in trainer.train_step()
    done = DisplacementNetwork.load(trainer.save({}))
    assert done.recurrent is not None
    for (
        name,
        value,
    ) in done.anchor.state_dict().items():  # the head did not learn; matrices are stored in half precision
        assert torch.allclose(value, head[name], atol=1e-3)
    with pytest.raises(OptionError, match="another shape"):
        DisplacementTrainer(replace(second, network=DisplacementConfig(16, 1, 8)), bank)


def test_the_body_is_learned(meshes, data, tmp_path):
    poses = pose_bank(data, "train", 20)
    config = BodyTrainConfig(
        out=tmp_path, minutes=0, steps=80, batch=1, poses=2, warmup=5, rate=5e-3, network=BodyConfig(8, 16)
    )
    trainer = BodyTrainer(config, meshes, poses, meshes)
    trainer.train_step()
    before = trainer.validate()
    for _ in range(45):
        trainer.train_step()
    results = trainer.validate()
    assert results["pmd"] < 0.9 * before["pmd"] and results["pmd_body"] < before["pmd_body"]
    trainer.save(results)
    assert BodyTrainer(config, meshes, poses).resume()


def test_the_body_learns_from_data_without_motions_to_validate_with(data, tmp_path):
    assert pose_bank(data, "val").shape == (0, 22, 3, 3)
    config = BodyTrainConfig(
        data=data, out=tmp_path / "body", characters=2, minutes=0, steps=1, batch=1, poses=1, network=BodyConfig(8, 8)
    )
    assert train_body(config).is_file()


def test_posed_joints_by_hand():
    """A knee that is bent by a quarter turn takes the ankle along, and nothing above it."""
    joints = np.zeros((22, 3))
    joints[1], joints[4], joints[7] = [0, 1, 0], [0, 0.5, 0], [0, 0, 0]
    turns = np.tile(np.eye(3, dtype=np.float32), (1, 22, 1, 1))
    turns[0, [4, 7]] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # +Y to +Z
    affine = posed_joints(turns, joints)[0]
    ankle = affine[7, :, :3] @ joints[7] + affine[7, :, 3]
    np.testing.assert_allclose(ankle, [0, 0.5, -0.5], atol=1e-6)
    np.testing.assert_allclose(affine[1], np.eye(3, 4), atol=1e-6)


def test_the_refinement_is_learned(data, tmp_path):
    """Both modules' results are the truth with a torn seam; what is learned closes it."""
    found = ApparelData(data)
    clip = found.clips[0]
    clothed = truly_clothed(found.character(clip))
    frames = np.array([4, 8])
    network = running_displacement(DisplacementNetwork(DisplacementConfig(8, 1, 0)))
    transforms = found.shard(clip.shard).frames("transforms", clip.first, clip.first + 9)
    truth = found.window(clip, 0, 9).vertices[frames]
    sample = seam_sample(clothed, clothed.weights, transforms, truth, frames, network)
    assert sample.positions.shape == sample.truth.shape and len(sample.positions) == 2
    torn = sample.truth.copy()
    torn[:, ::3, 1] += 0.02
    seam = seam_of(clothed, clothed.weights)
    affine = eq4_transforms(transforms[frames], clothed.joints)
    rows = []
    for frame in range(2):
        indices = np.array(truth[frame], np.float32)
        indices[seam.vertices[::3], 1] += 0.02 * clothed.scale
        rows.append(seam.frame(indices, affine[frame]))
    sample = replace(
        sample, positions=torn, inputs=np.stack([row.inputs for row in rows]),
        vectors=np.stack([row.vectors for row in rows]), turns=np.stack([row.turns for row in rows]),
    )  # fmt: skip
    config = RefinementTrainConfig(
        out=tmp_path, minutes=0, steps=60, batch=1, warmup=5, rate=1e-2, decay=0.9, network=RefinementConfig(16)
    )
    trainer = RefinementTrainer(config, [sample], [sample])
    assert trainer.validate()["vertices"] == pytest.approx(1)
    for _ in range(60):
        trainer.train_step()
    results = trainer.validate()
    assert results["vertices"] < 0.8 and results["edges"] < 0.7
    assert RefinementNetwork.load(trainer.save(results)).config.width == 16
    assert RefinementTrainer(config, [sample]).resume()
