import numpy as np
import pytest
import torch

from bunraku.errors import FormatError
from bunraku_lab.datasets.characters.bank_file import load_character_bank
from bunraku_lab.training.diffusion.mesh_learning import MeshLearning, local_motion
from bunraku_lab.training.rows.mesh_bank import MeshBank, load_mesh_bank


@pytest.fixture
def learning(bank):
    torch.manual_seed(0)
    return MeshLearning(bank, torch.device("cpu"), characters=2, frames=12, sigma=0.0)


def test_rows_are_drawn_from_people_without_a_character_of_their_own(learning):
    draw = learning.draw(
        np.random.default_rng(0),
        np.array([40, 5, 60, 30]),
        [None, None, "quaternius/animals_pack/Horse", None],
        cross=0.0,
    )
    assert draw.rows.tolist() == [0, 3] and draw.frames == 12 and draw.picked.shape == (2, 100)
    assert bool(learning.bank.humanoid[draw.characters].all()) and bool((draw.characters > 0).all())
    again = learning.draw(
        np.random.default_rng(0),
        np.array([40, 5, 60, 30]),
        [None, None, "quaternius/animals_pack/Horse", None],
        cross=0.0,
    )
    assert torch.equal(draw.starts, again.starts) and torch.equal(draw.characters, again.characters)
    assert learning.draw(np.random.default_rng(0), np.array([40]), ["a creature"], 0.0) is None


def test_only_the_adaptation_is_judged(learning, features, bank):
    """Gradients reach delta and nothing else; the discriminator learns only in its turn, the denoiser in the other
    (A.2).
    """
    clean = torch.from_numpy(features("left_elbow"))[None].float().expand(3, -1, -1).clone().requires_grad_(True)
    delta = torch.zeros(3, 60, 30, 3, requires_grad=True)
    draw = learning.draw(np.random.default_rng(0), np.array([60, 60, 60]), None, cross=1.0)
    spring, adversarial, real, fake = learning.losses(draw, clean, delta, learns=False)
    assert float(spring.detach()) > 0 > float(adversarial.detach())
    (spring + adversarial).backward()
    assert clean.grad is None and delta.grad.abs().sum() > 0
    idle = [row for row in range(3) if row not in draw.rows.tolist()]
    assert float(delta.grad[idle].abs().sum()) == 0
    assert all(value.grad is None for value in learning.discriminator.parameters())
    loss, score = learning.learn(real, fake, learns=False)
    assert 0 < score < 1 and all(value.grad is None for value in learning.discriminator.parameters())
    assert float(learning.losses(draw, clean, delta, learns=True)[1].detach()) == 0
    assert float(learning.learn(real, fake, learns=True)[0]) == pytest.approx(float(loss))
    assert any(value.grad is not None for value in learning.discriminator.parameters())
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
