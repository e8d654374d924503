"""Training of the Mesh Handle Predictor, and other forms of its meshes."""

import dataclasses

import numpy as np
import pytest
import torch

from bunraku.anatomy.handles.networks import PredictorConfig
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.errors import FormatError
from bunraku_lab.datasets.characters.build import reference_characters
from bunraku_lab.datasets.characters.training_character import (
    AugmentConfig,
    TrainingCharacter,
    TrainingMesh,
    augment,
    forward_kinematics,
    handle_target,
    plain_mesh,
)
from bunraku_lab.nn.graph import mesh_graph
from bunraku_lab.nn.handles import HandlePredictor
from bunraku_lab.training.handles import (
    HandleTrainConfig,
    HandleTrainer,
    MeshAugmentation,
    augment_mesh,
    on_base,
    train_handles,
    validate_handles,
    with_prop,
    write_mesh_bank,
)
from bunraku_lab.training.losses import handles as losses
from bunraku_lab.training.losses.handles import LossConfig

SMALL = PredictorConfig(levels=(8, 12, 16), hidden=(16, 16), anchors=12)


def worm(name: str = "pack/worm", count: int = 60) -> TrainingCharacter:
    """A tube of three bones along +Y: pelvis, spine2, head."""
    angle = np.arange(count) * 2.4
    y = np.linspace(-0.5, 0.5, count)
    vertices = np.stack([0.1 * np.cos(angle), y, 0.1 * np.sin(angle)], 1).astype(np.float32)
    joint = np.clip(((y + 0.5) * 3).astype(int), 0, 2)
    weights = np.eye(3, dtype=np.float32)[joint]
    handles = np.array([0, HANDLE_NAMES.index("spine2"), HANDLE_NAMES.index("head")])
    edges = np.stack([np.arange(count - 1), np.arange(1, count)], 1)
    joints = np.array([[0, -0.5, 0], [0, -1 / 6, 0], [0, 1 / 6, 0]])
    normals = vertices * [1, 0, 1] / 0.1
    return TrainingCharacter(
        name, vertices, normals.astype(np.float32), np.ones(count, np.float32), edges, weights, joints, np.array([-1, 0,
        1]), handles,
        handle_target(weights, handles), joints[0].astype(np.float32), 1.0,
    )  # fmt: skip


def test_forward_kinematics_of_an_arm_by_hand():
    joints = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # +X to +Y
    transforms = forward_kinematics(joints, np.array([-1, 0]), np.stack([quarter, quarter]))
    tip = transforms[1] @ [2.0, 0, 0, 1]
    np.testing.assert_allclose(tip, [-1.0, 1, 0], atol=1e-12)  # the elbow goes to +Y, the forearm then points to -X
    np.testing.assert_allclose(
        forward_kinematics(joints[::-1], np.array([1, -1]), np.stack([quarter, quarter]))[0], transforms[1], atol=1e-12
    )


def test_augmented_examples_are_normalised_and_the_root_rests():
    character, rng = worm(), np.random.default_rng(0)
    for _ in range(20):
        mesh = augment(character, rng)
        assert np.ptp(mesh.vertices, axis=0).max() == pytest.approx(1, abs=1e-5)
        np.testing.assert_allclose(mesh.vertices.min(0) + mesh.vertices.max(0), 0, atol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-4)
        pelvis = mesh.weights[:, 0] == 1
        np.testing.assert_allclose(
            mesh.posed[:, pelvis], np.broadcast_to(mesh.vertices[pelvis], mesh.posed[:, pelvis].shape), atol=1e-5
        )
        assert np.isfinite(mesh.posed).all()


def test_mirroring_swaps_sides():
    character = worm()
    left, right = HANDLE_NAMES.index("left_hip"), HANDLE_NAMES.index("right_hip")
    handles = np.array([0, left, -1])
    character = dataclasses.replace(character, handles=handles, target=handle_target(character.weights, handles))
    rng, still = np.random.default_rng(1), AugmentConfig(rest_rate=0, stretch=1.0, yaw=0.0)
    seen = set()
    for _ in range(12):
        mesh = augment(character, rng, still)
        flipped = np.abs(mesh.vertices[:, 0] - character.vertices[:, 0]).max() > 0.01
        assert mesh.handles.tolist() == [0, right if flipped else left, -1]
        assert (mesh.target[:, right if flipped else left] > 0).any()
        seen.add(flipped)
    assert seen == {True, False}


def test_cached_character_comes_back(tmp_path):
    character = worm()
    character.save(tmp_path / "worm.npz")
    again = TrainingCharacter.load(tmp_path / "worm.npz")
    assert again.name == character.name and np.array_equal(again.target, character.target)
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(FormatError):
        TrainingCharacter.load(tmp_path / "bad.npz")


def trainer(out) -> HandleTrainer:
    config = HandleTrainConfig(out=out, minutes=0, epochs=40, rate=5e-3, warmup=5, predictor=SMALL, decay=0.8)
    return HandleTrainer(config, [worm() for _ in range(4)], [worm()])


def test_training_learns_and_goes_on_as_if_never_stopped(tmp_path):
    torch.set_num_threads(1)
    whole = trainer(tmp_path / "a")
    first = whole.train_epoch()["total"]
    whole.train_epoch()
    whole.save({"held_accuracy": 0.0})
    rest = [whole.train_epoch()["total"] for _ in range(2)]
    cut = trainer(tmp_path / "a")
    assert cut.resume() and cut.epoch == 2
    assert [cut.train_epoch()["total"] for _ in range(2)] == pytest.approx(rest, rel=1e-6)
    for _ in range(7):
        last = whole.train_epoch()["total"]
    assert last < 0.8 * first
    figures = validate_handles(whole.average, [worm()])
    assert 0 <= figures["accuracy"] <= 1 and figures["pose"] < 0.3


def test_train_handles_writes_a_checkpoint_and_a_log(tmp_path):
    for number in range(3):
        folder = tmp_path / "cache" / "pack"
        folder.mkdir(parents=True, exist_ok=True)
        worm(f"pack/worm{number}").save(folder / f"worm{number}.npz")
    rows = []
    config = HandleTrainConfig(
        cache=tmp_path / "cache", out=tmp_path / "run", minutes=0, epochs=1, predictor=SMALL, reference_share=0.0
    )
    path = train_handles(config, rows.append)
    assert HandlePredictor.load(path).config == SMALL
    assert len((tmp_path / "run" / "log.csv").read_text().splitlines()) == 2 and rows[0]["epoch"] == 1
    assert train_handles(config, rows.append) == path and len(rows) == 1  # done is done


def test_mesh_bank_says_who_is_held_out_and_who_is_a_person(tmp_path):
    torch.manual_seed(0)
    model, person = HandlePredictor(SMALL).eval(), reference_characters(300)[0]
    characters = [worm("pack/worm~posed"), worm("pack/other"), person]
    path = write_mesh_bank(model, characters, tmp_path / "bank.npz", variants=1, held_out={"pack/worm"})
    with np.load(path) as bank:
        assert bank["names"].tolist() == ["pack/worm~posed", *["pack/other"] * 2, *[person.name] * 2]
        assert bank["split"].tolist() == ["test", *["train"] * 4]
        assert bank["humanoid"].tolist() == [False, False, False, True, True]


def test_a_run_that_goes_on_keeps_the_feature_where_it_is_told_to(tmp_path):
    """The same steps with and without the loss: with it, f_phi of a mesh stays nearer to what it was."""
    torch.manual_seed(0)
    start = HandlePredictor(SMALL).save(tmp_path / "start.safetensors")
    before = HandlePredictor.load(start)
    mesh = plain_mesh(worm(), np.random.default_rng(0))
    graph = mesh_graph(mesh.vertices, mesh.normals, mesh.edges, mesh.areas, SMALL.anchors)
    moved = []
    for weight in (0.0, 100.0):
        config = HandleTrainConfig(
            out=tmp_path / str(weight), minutes=0, epochs=12, batch=1, rate=3e-3, warmup=1, decay=0.0, predictor=SMALL,
            start=start, loss=LossConfig(feature=weight, feature_rate=1.0),
        )  # fmt: skip
        trainer = HandleTrainer(config, [worm()], [])
        for _ in range(12):
            trainer.train_epoch()
        with torch.no_grad():
            moved.append(float(losses.feature_loss(trainer.model(graph).features, before(graph).features)))
    assert 0 < moved[1] < 0.5 * moved[0]


@pytest.fixture
def mesh() -> TrainingMesh:
    """A strip of two rows of vertices whose labels and poses are linear in x, so that any mean of rows must stay on the
    line.
    """
    count = 40
    x = np.repeat(np.linspace(-0.5, 0.5, count // 2), 2)
    vertices = np.stack([x, np.tile([0.0, 0.05], count // 2), 0 * x], axis=1).astype(np.float32)
    edges = np.array([(i, i + 1) for i in range(0, count, 2)] + [(i, i + 2) for i in range(count - 2)])
    weights = np.stack([0.5 + x, 0.5 - x], axis=1).astype(np.float32)
    target = np.zeros((count, 30), np.float32)
    target[:, 3:5] = weights
    return TrainingMesh(
        vertices=vertices, normals=np.tile(np.float32([0, 0, 1]), (count, 1)), areas=np.full(count, 0.1, np.float32),
        edges=edges, weights=weights,
        handles=np.array([3, 4]), target=target, root=np.zeros(3, np.float32), height=0.05,
        posed=np.stack([2 * vertices, vertices + 1]),
    )  # fmt: skip


def check(mesh: TrainingMesh) -> None:
    np.testing.assert_allclose(mesh.weights[:, 0], 0.5 + mesh.vertices[:, 0], atol=1e-6)
    np.testing.assert_allclose(mesh.target[:, 4], mesh.weights[:, 1], atol=1e-6)
    np.testing.assert_allclose(mesh.posed[0], 2 * mesh.vertices, atol=1e-6)
    np.testing.assert_allclose(mesh.posed[1], mesh.vertices + 1, atol=1e-6)
    assert mesh.edges.max() < len(mesh.vertices) and (mesh.edges[:, 0] != mesh.edges[:, 1]).all()


def test_damage_is_random_but_repeatable(mesh):
    always = MeshAugmentation(1, 0.4, 1, 0.45, 1, 0.1, 1, 0, 0.12, 0, 0, 0)
    first, second = (augment_mesh(mesh, np.random.default_rng(5), always) for _ in range(2))
    check(first)
    np.testing.assert_array_equal(first.vertices, second.vertices)
    assert augment_mesh(mesh, np.random.default_rng(5), MeshAugmentation(*[0] * 12)) is mesh


def test_a_base_goes_with_the_root_and_a_prop_with_its_hand():
    """The base rests in poses in which the root does; the prop keeps its shape and its distance to the hand."""
    rng, body = np.random.default_rng(3), worm(count=200)
    handles = np.array([0, HANDLE_NAMES.index("spine2"), HANDLE_NAMES.index("left_wrist")])
    mesh = plain_mesh(dataclasses.replace(body, handles=handles, target=handle_target(body.weights, handles)), rng)
    mesh = dataclasses.replace(mesh, weights=mesh.weights.astype(np.float32), target=mesh.target.astype(np.float32))
    count = len(mesh.vertices)
    based, held = on_base(mesh, rng), with_prop(mesh, rng)
    assert based.target.dtype == held.weights.dtype == np.float32  # what the network computes with
    base = slice(count, None)
    assert len(based.vertices) > count < len(held.vertices)
    assert (based.target[base, 0] == 1).all() and np.ptp(based.vertices, axis=0).max() == pytest.approx(1, abs=1e-5)
    assert based.vertices[base, 1].min() < based.vertices[:count, 1].min()
    np.testing.assert_allclose(based.posed[:, base], np.tile(based.vertices[base], (len(based.posed), 1, 1)), atol=1e-5)
    rest = np.linalg.norm(held.vertices[count] - held.vertices[base], axis=1)
    for frame in held.posed:
        np.testing.assert_allclose(np.linalg.norm(frame[count] - frame[base], axis=1), rest, atol=1e-5)
    hands = held.target[base][:, [HANDLE_NAMES.index(f"{side}_wrist") for side in ("left", "right")]]
    assert hands.sum(axis=1).min() > 0.5
