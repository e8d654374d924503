"""Motion on characters: quality and ARAP-Loss."""

from dataclasses import replace

import numpy as np
import pytest

from bunraku.core.body.layout import HANDLE_COUNT
from bunraku.core.body.reference import reference_body
from bunraku.core.motion import HandleMotion
from bunraku_lab.evaluation.motion.characters import arap_loss, gauge, measure, pooled, stage_effects

FRAMES = 40
CM = 170 / reference_body().character().height  # at human size, for each metre of the reference body


def moving(path):
    """The reference body in its rest pose along a path (N, 3)."""
    frames = len(path)
    eye = np.tile(np.eye(3), (frames, HANDLE_COUNT, 1, 1))
    return HandleMotion(np.zeros((frames, HANDLE_COUNT, 3)), eye, path, eye[:, 0])


def line(x=0.0, y=0.0, z=0.0):
    return np.linspace(0, 1, FRAMES)[:, None] * [x, y, z]


def measured(motion):
    body = reference_body()
    return measure(gauge(body.character(), body.handles), motion)


def test_a_body_that_glides_slides_by_its_own_speed():
    assert measured(moving(line())).sliding == 0
    assert measured(moving(line(z=0.39))).sliding == pytest.approx(0.01 * CM, rel=1e-3)  # 1 cm a frame
    assert measured(moving(line(x=0.39) + [0, 0.5, 0])).sliding == 0  # in the air


def test_a_foot_that_swings_low_is_told_from_one_that_slides():
    path = np.zeros((FRAMES, 3))
    path[20:, 2] = np.arange(20) * 0.15  # 3 m/s, but the body goes with it: that is sliding
    what = gauge(reference_body().character(), reference_body().handles)
    quality = measure(what, moving(path))
    assert quality.contact_share == 1
    assert quality.sliding == quality.sliding_all == pytest.approx(0.15 * CM * 19 / 39, rel=1e-3)
    still = moving(np.zeros((FRAMES, 3)))
    shift = np.zeros_like(still.translations)
    shift[20:, [1, 4, 7, 10], 2] = (np.arange(20) * 0.15)[:, None]  # only the left leg does: a step
    quality = measure(what, replace(still, translations=shift))
    assert quality.contact_share == pytest.approx(1 - 19 / 39 / 2, abs=0.01)
    assert quality.sliding < 0.01 < 3 < quality.sliding_all


def test_jitter_is_the_third_difference():
    assert measured(moving(line(x=3) ** 1)).jitter == pytest.approx(0, abs=1e-3)
    cubic = moving((np.arange(FRAMES)[:, None] / 20.0) ** 3 * [0, 0, 1])
    assert measured(cubic).jitter == pytest.approx(6 / 20**3 * CM, rel=0.02)
    assert measured(moving(np.zeros((3, 3)))).jitter == 0


def test_pooling_weighs_by_feet_that_are_down():
    what = gauge(reference_body().character(), reference_body().handles)
    one, other = measure(what, moving(line())), measure(what, moving(line(z=0.39) + [0, 0.5, 0]))
    both = pooled([one, other])
    assert both.sliding == one.sliding == 0
    assert both.frames == 2 * FRAMES
    assert both.contact_share == pytest.approx(0.5)


def test_each_stage_has_its_effect():
    body = reference_body()
    rng = np.random.default_rng(0)
    faulty = moving(line(z=0.6) + 0.0004 * rng.normal(size=(FRAMES, 3)))
    rows = stage_effects([faulty], {"person": (body.character(), body.handles)})
    assert [row["without"] for row in rows] == ["nothing", "smooth", "feet", "floor", "smooth, feet, floor"] * 2
    own = {row["without"]: row for row in rows if row["character"] == "person"}
    assert own["nothing"]["sliding"] < 0.2 < 1 < own["feet"]["sliding"]
    assert own["nothing"]["jitter"] < 0.8 * own["smooth"]["jitter"]
    assert own["nothing"]["deepest"] < 0.5
    assert own["smooth, feet, floor"]["moved"] == 0


def test_arap_loss_by_hand():
    """Eq. 12: a triangle of extent 2 whose edges 2, 2 and 2.828 become 3, 2 and 3.606."""
    rest = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0]], np.float32)
    posed = np.stack([rest, rest])
    posed[1, 1, 0] = 3
    edges = np.array([[0, 1], [1, 2], [0, 2]])
    want = (1.0**2 + (np.sqrt(13) - np.sqrt(8)) ** 2) / 4
    np.testing.assert_allclose(arap_loss(posed, rest, edges), [0, want], rtol=1e-5)
