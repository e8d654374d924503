"""Training of the adaptation's last layer, and its labels."""

import os
import signal
from dataclasses import replace

import numpy as np
import pytest
import torch

from bunraku.anatomy.joints import attach_joints, reference_joints
from bunraku.core.animation import Animation
from bunraku.core.body.reference import reference_body
from bunraku.core.motion import HandleMotion
from bunraku.errors import OptionError
from bunraku.generation.features import encode
from bunraku_lab.evaluation.motion.characters import animation_arap
from bunraku_lab.nn.checkpoints import load_training_state
from bunraku_lab.nn.denoiser import joint_offsets, load_denoiser, save_denoiser
from bunraku_lab.training.adaptation.labels import EdgeSystem, arap_labels, edge_system
from bunraku_lab.training.adaptation.train import AdaptationConfig, _Run, train_adaptation
from bunraku_lab.training.losses.meshes import fit_locals


def one_edge():
    """An edge of rest length 1 that is 1.2 long along x, one end on handle 1."""
    spread = torch.zeros(1, 1, 3)
    spread[0, 0, 1] = 1
    return EdgeSystem(torch.tensor([[[[1.2, 0, 0]]]]), spread, torch.ones(1, 1), torch.ones(1), torch.zeros(1, 1, 3, 3))


def test_one_step_by_hand():
    """Eq. 10 for one edge: nu (0.2 + d)^2 + d^2 is least at d = -0.2 nu / (1 + nu)."""
    label = arap_labels(one_edge(), torch.zeros(1, 1, 3, 3), strength=0.2, steps=1)
    torch.testing.assert_close(label[0, 0, 1], torch.tensor([-0.2 * 0.2 / 1.2, 0, 0]))
    assert float(label[0, 0, [0, 2]].abs().max()) == 0
    torch.testing.assert_close(one_edge().loss(label), torch.tensor([[(0.2 - 0.2 * 0.2 / 1.2) ** 2]]))


def test_labels_lower_the_loss_of_a_character(bank, gesture):
    row = torch.tensor([1])
    system = edge_system(fit_locals(*gesture("left_elbow", 5, 1.5), bank, row), bank)
    label = arap_labels(system, torch.zeros(1, 5, 30, 3))
    before, after = system.loss()[0], system.loss(label)[0]
    assert float(before[0]) < float(before[-2]) and float(after.mean()) < 0.9 * float(before.mean())
    assert float(label.norm(dim=-1).max()) < 0.051


def test_the_sampled_loss_is_that_of_the_whole_mesh(bank, gesture):
    """Of the dancer: what the bank's edges say is what `animation_arap` says of all edges, up to sampling."""
    from bunraku.anatomy.names.bone_names import rig_handles
    from bunraku_lab.synthetic.samples import make_sample
    from bunraku_lab.training.losses.meshes import posed_positions

    character = make_sample("dancer", 0.5, rigged=True)
    handles = rig_handles(character).top(4)
    fitted = fit_locals(*gesture("left_elbow", 4, 1.5), bank, torch.tensor([1]))
    still = np.zeros((4, 3))
    motion = HandleMotion(
        posed_positions(fitted, bank)[0][0], fitted.rotations[0], still, np.tile(np.eye(3), (4, 1, 1))
    )
    whole = animation_arap(Animation(character, handles, motion))
    assert abs(float(edge_system(fitted, bank).loss().mean()) / whole - 1) < 0.2


@pytest.fixture
def settings(swings, bank_path, denoiser, tmp_path):
    model = denoiser()
    torch.nn.init.zeros_(model.adaptation_out.weight)
    torch.nn.init.zeros_(model.adaptation_out.bias)
    path = save_denoiser(tmp_path / "denoiser.safetensors", model, {"characters": 3}, half=False)
    small = {
        "pairs": 8, "frames": 16, "steps": 4, "batch": 4, "edges": 150, "mesh_size": 4, "validate_every": 2,
        "device": "cpu",
    }  # fmt: skip
    return lambda **how: AdaptationConfig(
        **{"diffusion": path, "cache": bank_path, "data": swings, "out": tmp_path / "run", **small, **how}
    )


def test_moved_joints_are_what_attaching_them_elsewhere_gives():
    random = np.random.default_rng(0)
    body, joints = reference_body(), reference_joints()
    from bunraku.core.geometry.rotations import matrix_from_axis_angle

    vectors, moves = random.normal(0, 0.4, (4, 30, 3)), random.normal(0, 0.03, (30, 3))
    vectors[:, 0], moves[0] = 0, 0
    vectors[:, ~joints.present] = 0
    rotations = matrix_from_axis_angle(vectors)
    present = np.ones(30, bool)
    known = replace(joints, present=present)
    before = attach_joints(rotations, body.handles.positions, known)[1]
    after = attach_joints(rotations, body.handles.positions, replace(known, positions=joints.positions + moves))[1]
    still = np.zeros((4, 3))
    features = torch.from_numpy(encode(HandleMotion(before, rotations, still, matrix_from_axis_angle(still))))[None]
    found = joint_offsets(torch.from_numpy(moves).float().expand(1, 4, 30, 3), features)
    np.testing.assert_allclose(found[0], after - before, atol=1e-5)


def test_only_the_layer_learns_and_edges_keep_their_lengths(settings, encoder, tmp_path):
    rows = []
    path = train_adaptation(
        settings(steps=30, learning_rate=2e-3, validate_every=15, pairs=12), rows.append, encoder=encoder
    )
    assert [row["step"] for row in rows] == [15, 30]
    assert rows[-1]["seen"] < rows[0]["seen"] < 1 and 0 < rows[-1]["delta"] < 0.05
    before, after = load_denoiser(settings().diffusion), load_denoiser(path)
    assert (
        after.config.adaptation_frame == "joints"
        and after.config.adaptation_mesh
        and after.notes["adaptation_steps"] == 30
    )
    for name, value in before.state_dict().items():
        if not name.startswith("adaptation_out"):
            torch.testing.assert_close(after.state_dict()[name], value, atol=2e-3, rtol=1e-3)  # stored as float16
    assert float(after.adaptation_out.weight.abs().max()) > 0


@pytest.mark.parametrize("frame", ["root", "joints"])
def test_the_saved_denoiser_says_what_the_run_says(settings, encoder, frame, monkeypatch, tmp_path):
    """The whole denoiser's adaptation, at the pairs' frames, is what validation measured."""
    found = []
    original = _Run.save

    def keep(self, folder):
        found.append(self)
        original(self, folder)

    monkeypatch.setattr(_Run, "save", keep)
    path = train_adaptation(settings(frame=frame), encoder=encoder)
    run, model = found[-1], load_denoiser(path)
    seen = run.pairs.seen[:2].float()
    said = model.adaptation_out(seen).reshape(2, -1, 30, 3)
    want = run.head(seen).flatten(1, 2)
    torch.testing.assert_close(said, want, atol=2e-3, rtol=2e-2)


def test_a_run_that_was_stopped_goes_on_to_the_same_weights(settings, encoder, tmp_path, monkeypatch):
    train_adaptation(settings(out=tmp_path / "whole"), encoder=encoder)
    update = _Run.update

    def update_then_stop(self):
        loss = update(self)
        if self.step == 2:
            os.kill(os.getpid(), signal.SIGTERM)
        return loss

    with monkeypatch.context() as patch:
        patch.setattr(_Run, "update", update_then_stop)
        train_adaptation(settings(), encoder=encoder)
    state = tmp_path / "run" / "state.safetensors"
    assert load_training_state(state).step == 2
    train_adaptation(settings(), encoder=encoder)
    whole, parts = load_training_state(tmp_path / "whole" / "state.safetensors"), load_training_state(state)
    assert parts.step == 4 and all(
        torch.equal(value, parts.models["head"][name]) for name, value in whole.models["head"].items()
    )


@pytest.mark.parametrize("which", ["spring_weight", "adversarial_weight"])
def test_meshes_teach_the_layer_without_labels(settings, encoder, which, tmp_path, monkeypatch):
    """Eq. 7: springs change less with what was learned than without it; Eq. 8: the discriminator learns and is kept."""
    found, original = [], _Run.save

    def keep(self, results):
        found.append(self)
        return original(self, results)

    monkeypatch.setattr(_Run, "save", keep)
    how = {"label_weight": 0.0, which: 1.0, "steps": 40, "validate_every": 40, "mesh_frames": 12}
    how |= {"batch": 8, "learning_rate": 6e-3}
    rows = []
    train_adaptation(settings(**how), rows.append, encoder=encoder)
    state, run = load_training_state(tmp_path / "run" / "state.safetensors"), found[-1]
    assert "discriminator" in state.models and (state.values["score"] > 0) == (which == "adversarial_weight")
    assert rows[-1]["delta"] > 0
    if which == "spring_weight":
        features = run.pairs.motion.float() * run.model.std + run.model.mean
        said = run.head(run.pairs.seen.float()[..., : run.inputs]).flatten(1, 2)
        losses = [
            float(run.mesh_losses(features, run._moves(scale * said, features), run.pairs.row, random).detach())
            for scale, random in ((0.0, np.random.default_rng(0)), (1.0, np.random.default_rng(0)))
        ]
        assert losses[1] < 0.97 * losses[0]


def test_wrong_settings_are_clear(settings, encoder):
    for how, words in ({"frame": "world"}, "unknown"), ({"steps": 0}, "positive"), ({"label_weight": 0.0}, "weight"):
        with pytest.raises(OptionError, match=words):
            train_adaptation(settings(**how), encoder=encoder)
    train_adaptation(settings(steps=1), encoder=encoder)
    with pytest.raises(OptionError, match="another denoiser, bank or layer"):
        train_adaptation(settings(steps=1, mesh=False), encoder=encoder)
