"""Labelled figures, their shards, and a step of the part network's training on them."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.apparel.part_network import CARRIERS, PARTS, PartConfig
from bunraku_lab.datasets.labelled.figures import code_made, draped
from bunraku_lab.datasets.labelled.locks import with_locks
from bunraku_lab.datasets.labelled.things import fused, with_things
from bunraku_lab.datasets.labelled.worn import with_accessories
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


@pytest.mark.parametrize("seed", range(5))
def test_more_hair_goes_with_the_head_and_things_lie_in_hands_or_under_feet(figure, seed):
    more = with_locks(figure, np.random.default_rng(seed))
    added = slice(len(figure.vertices), None)
    assert len(more.vertices) > len(figure.vertices)
    assert of(more, "hair")[added].all() and (more.carrier[added] == CARRIERS.index("head")).all()
    full = with_things(figure, np.random.default_rng(1), rate=1.0)
    props = full.vertices[of(full, "prop")]
    gap = np.linalg.norm(props[:, None] - figure.hands[None], axis=2).min()
    assert gap < 0.15 * np.ptp(figure.vertices[:, 1])
    assert (full.hangs[of(full, "prop") | of(full, "ground")] == 0).all()


def test_what_is_worn_on_top_is_new_and_does_not_swing(figure):
    more = with_accessories(figure, np.random.default_rng(2))
    added = slice(len(figure.vertices), None)
    assert len(more.vertices) > len(figure.vertices)
    assert not (more.hangs[added] == 1).any() and (more.part[added] != PARTS.index("prop")).all()
    size = np.ptp(figure.vertices, axis=0).max()
    assert np.ptp(more.vertices, axis=0).max() < 1.3 * size


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
