"""Labelled figures, their shards, and a step of the part network's training on them."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.apparel.part_network import CARRIERS, PARTS, PartConfig
from bunraku_lab.datasets.labelled.avatars import avatar
from bunraku_lab.datasets.labelled.figures import code_made, draped
from bunraku_lab.datasets.labelled.things import fused, with_things
from bunraku_lab.training.parts import PartTrainConfig, PartTrainer, seen_row
from bunraku_lab.training.parts_data import PartData, build_shard


def of(figure, name):
    return figure.part == PARTS.index(name)


@pytest.fixture(scope="module")
def figure():
    return draped(3)


def test_a_draped_character_hangs_where_it_is_cloth_or_hair(figure):
    cloth = of(figure, "skirt") | of(figure, "cape") | of(figure, "sleeve")
    assert cloth.any() and of(figure, "hair").any() and of(figure, "body").any()
    assert not (figure.hangs[of(figure, "body")] == 1).any()
    assert (figure.hangs[cloth] == 1).mean() > 0.5
    heads = figure.carrier[of(figure, "hair")] == CARRIERS.index("head")
    assert heads.mean() > 0.95
    assert figure.hands[0, 0] > 0 > figure.hands[1, 0]


def test_things_lie_in_hands(figure):
    full = with_things(figure, np.random.default_rng(1), rate=1.0)
    props = full.vertices[of(full, "prop")]
    gap = np.linalg.norm(props[:, None] - figure.hands[None], axis=2).min()
    assert gap < 0.15 * np.ptp(figure.vertices[:, 1])
    assert (full.hangs[of(full, "prop") | of(full, "ground")] == 0).all()


@pytest.mark.parametrize("seed", range(8))
def test_avatars_hang_below_the_waist_and_the_chin_and_their_bodies_do_not(seed):
    one = avatar(seed)
    assert np.isfinite(one.vertices).all() and len(one.faces)
    assert not (one.hangs[of(one, "body")] == 1).any()
    body = one.vertices[of(one, "body")]
    head = body[one.carrier[of(one, "body")] == CARRIERS.index("head")]
    hair = one.vertices[of(one, "hair") & (one.hangs == 1)]
    assert not len(hair) or np.median(hair[:, 1]) < head[:, 1].mean()
    skirt = one.vertices[of(one, "skirt") & (one.hangs == 1)]
    assert not len(skirt) or skirt[:, 1].max() < head[:, 1].min()
    assert (one.carrier[of(one, "skirt")] == CARRIERS.index("pelvis")).all()


def test_one_skin_keeps_the_labels_of_what_it_covers(figure):
    one = fused(figure, np.random.default_rng(0))
    assert {name for name in PARTS if of(one, name).any()} <= {name for name in PARTS if of(figure, name).any()}
    head = figure.vertices[of(figure, "hair")][:, 1].mean()
    assert abs(one.vertices[of(one, "hair")][:, 1].mean() - head) < 0.15 * np.ptp(figure.vertices[:, 1])


def test_what_animals_have_by_nature_does_not_hang():
    beast = code_made("quadruped", 7)
    assert of(beast, "tail").any()
    assert not beast.hangs.any()


@pytest.mark.parametrize("family", ["critter", "stubby_beast"])
def test_figures_with_much_on_their_heads_are_labelled(family):
    one = code_made(family, 3)
    assert len(one.part) == len(one.vertices) == len(one.hangs) == len(one.carrier)
    assert of(one, "body").mean() > 0.2


def test_a_step_learns_from_shards_and_a_run_goes_on(tmp_path):
    for validation in (False, True):
        build_shard(tmp_path / "data", tmp_path, 1, 2, validation, views=1, sources={"wardrobe": 0.5, "humanoid": 0.5})
    rows = PartData(tmp_path / "data", "train")
    features, points, carrier, pieces = seen_row(rows.row(0), np.random.default_rng(0))
    assert np.isfinite(features).all() and len(features) == len(points) == len(carrier) == len(pieces)
    shape = PartConfig(fine=8, middle=16, coarse=20, layers=1, heads=2, before=1, after=1)
    config = PartTrainConfig(
        out=tmp_path / "run", shards=tmp_path / "data", minutes=0, steps=2, batch=2, validate_every=1, network=shape
    )
    config.prepare()
    first = PartTrainer(config)
    before = first.model.get_parameter("enter.0.weight").detach().clone()
    assert first.learn().is_file()
    assert not np.allclose(before.numpy(), first.model.get_parameter("enter.0.weight").detach().numpy())
    again = PartTrainer(config)
    assert again.resume() and again.step == 2
