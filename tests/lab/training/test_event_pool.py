"""Events of clips whose words are given by hand."""

from dataclasses import replace

import numpy as np
import pytest

from bunraku.diffusion.features import FeatureStatistics, decode
from bunraku.language.description.track import Phrase
from bunraku_lab.training.rows.event_pool import ENOUGH, EventPool
from bunraku_lab.training.rows.training_clip import TrainingClip


def turn(side, start=5):
    return Phrase("turn", (f"{{turn}} {side}",), start, start + 20)


@pytest.fixture
def pool(features):
    """A hundred turns to either side, one jump, walks of which one goes backwards, and a creature."""
    values = features("spine1", frames=60)
    statistics = FeatureStatistics.measure([values])
    clip = TrainingClip.prepare("a", {"features": values, "texts": ["a person moves"]}, statistics, 60)
    way = Phrase("go", ("{walk} forward",), 0, 30, manner=("forward",))
    back = Phrase("go", ("{walk} backwards",), 0, 30, manner=("backwards", "slowly"))
    told = [[turn("left"), turn("right")]] * 50 + [[Phrase("jump", ("{jump}",), 3, 20), way], [back], [turn("left")]]
    clips = [replace(clip, name=str(number)) for number in range(52)] + [replace(clip, name="52", species="dog")]
    return EventPool(clips, lambda clip: told[int(clip.name)], lambda clip: decode(clip.values), 60)


def test_left_and_right_are_one_kind_and_plain_walks_are_none(pool):
    assert {name: len(found) for name, found in pool.kinds.items()} == {
        "{turn} left": 100, "{jump}": 1, "{walk} backwards": 1,
    }  # fmt: skip


def test_the_rare_is_drawn_more_often_than_it_is_there(pool):
    """By the root of how often it is there, up to a bound: 1 of sqrt(40) + 2 instead of 1 of 102."""
    random = np.random.default_rng(0)
    drawn = [pool.draw(random)[1].texts[0] for _ in range(2000)]
    expected = 1 / (ENOUGH**0.5 + 2)
    assert abs(drawn.count("{jump}") / 2000 - expected) < 0.03
    assert min(drawn.count("{turn} left"), drawn.count("{turn} right")) > 500


def test_nothing_is_drawn_where_nothing_is_told():
    assert EventPool([], lambda clip: [], lambda clip: None, 60).draw(np.random.default_rng(0)) is None
