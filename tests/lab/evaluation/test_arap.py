import math

import numpy as np

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku_lab.evaluation.motion.arap import ArapRow, ArapTable, animation_arap, arap_loss, measure_adaptation


def test_arap_loss_by_hand():
    """Eq. 12: a triangle of extent 2 whose edges 2, 2 and 2.828 become 3, 2 and 3.606."""
    rest = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0]], np.float32)
    posed = np.stack([rest, rest])
    posed[1, 1, 0] = 3
    edges = np.array([[0, 1], [1, 2], [0, 2]])
    want = (1.0**2 + (np.sqrt(13) - np.sqrt(8)) ** 2) / 4
    np.testing.assert_allclose(arap_loss(posed, rest, edges), [0, want], rtol=1e-5)


def test_a_rigid_motion_costs_nothing():
    character = Character(
        "tetra", np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), [[0, 1, 2], [0, 1, 3], [1, 2, 3]]
    )
    handles = Handles(np.zeros((2, 3)), [[1, 0], [1, 0], [0.5, 0.5], [0, 1]])
    turn = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0.0]])
    motion = HandleMotion(np.zeros((1, 2, 3)), np.tile(np.eye(3), (1, 2, 1, 1)), np.ones((1, 3)), turn[None])
    assert animation_arap(Animation(character, handles, motion)) < 1e-12


def test_the_ratio_is_that_of_the_means():
    seen = (ArapRow("a", False, 1.0, 1.5, 2.0, 5.0, 0.01), ArapRow("b", False, 3.0, 3.0, 3.0, 5.0, 0.03))
    table = ArapTable((*seen, ArapRow("c", True, 9.0, 9.5, 10.0, 12.0, 0.02)))
    assert table.ratio(unseen=False) == 4 / 5 and table.ratio(unseen=True) == 0.9
    assert math.isclose(table.means(unseen=False)["delta"], 0.02) and math.isnan(ArapTable(()).ratio(unseen=True))


def test_a_generated_clip_is_measured_with_and_without():
    """The shipped weights on a small character: the three rows come from one motion, and the stage `attach` keeps edges
    together.
    """
    from dataclasses import replace

    from bunraku.handles.from_rig import rig_handles
    from bunraku_lab.synthetic.samples import make_sample

    character = make_sample("dancer", 0.4, rigged=True)
    handles = replace(rig_handles(character).top(4), features=np.zeros(448, np.float32))
    told = []
    table = measure_adaptation(
        [("samples/dancer", replace(character, rig=None), handles)],
        ["a person waves"],
        seconds=2.0,
        steps=8,
        progress=lambda stage, share: told.append(share),
    )
    row = table.rows[0]
    assert row.name == "samples/dancer" and not row.unseen and told[-1] == 1
    assert 0 < row.plain < row.loose and row.adapted > 0 and 0 <= row.delta < 0.05
    assert row.adapted < row.plain and (row.learned == row.plain) == (row.delta == 0)
