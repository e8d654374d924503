"""The list of stages is what the switches, their help and the docs say."""

import inspect
import itertools
import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import bunraku
from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.motion import HandleMotion
from bunraku.handles.from_rig import rig_handles
from bunraku.retarget.fit import STAGES, fit_motion, running
from bunraku.retarget.stages.stage import Fitting
from bunraku.retarget.stages.switches import Stages
from bunraku_lab.synthetic.samples import make_sample

DOCS = Path(__file__).resolve().parents[2] / "docs"


def said(stage) -> str:
    """The first line of a stage's docstring."""
    return inspect.getdoc(stage).splitlines()[0]


def test_switches_are_the_list():
    assert bunraku.Stages is Stages
    assert [field.name for field in fields(Stages)] == [stage.name for stage in STAGES]
    assert [field.default for field in fields(Stages)] == [not stage.on_request for stage in STAGES]
    words = dict(re.findall(r"^    (\w+): (.*)$", inspect.getdoc(Stages), re.MULTILINE))
    assert words == {stage.name: said(stage) for stage in STAGES}


def test_docs_print_the_list():
    text = (DOCS / "how-it-works.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\d+\. `([a-z-]+)`: (.*)$", text[text.index("retarget/fit.py`") :], re.MULTILINE)
    assert listed == [(stage.name.replace("_", "-"), said(stage)) for stage in STAGES]


def test_the_command_line_s_page_lists_them():
    rows = [line for line in (DOCS / "cli.md").read_text(encoding="utf-8").splitlines() if "`smooth`, `gait`" in line]
    assert len(rows) == 1
    assert re.findall(r"`([a-z-]+)`", rows[0].split(":", 1)[1]) == [stage.name.replace("_", "-") for stage in STAGES]


def test_thresholds_have_words():
    for stage in STAGES:
        own = [field.name for field in fields(stage)]
        assert set(own) <= set(re.findall(r"^    (\w+): ", inspect.getdoc(stage), re.MULTILINE)), stage.name


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_a_stage_needs_only_what_there_is_and_runs_alone(stage):
    names = [other.name for other in STAGES]
    assert set(stage.needs) <= set(names)
    alone = Stages(**{name: name == stage.name or name in stage.needs for name in names})
    assert [other.name for other in running(alone)] == [
        name for name in names if name == stage.name or name in stage.needs
    ]
    without = Stages(**{name: name not in stage.needs for name in names})
    assert (stage in running(without)) == (not stage.needs)
    still = np.tile(np.eye(3), (6, 30, 1, 1))
    motion = HandleMotion(np.zeros((6, 30, 3)), still, np.zeros((6, 3)), still[:, 0])
    fitted = fit_motion(motion, reference_anatomy(), alone)
    np.testing.assert_allclose(fitted.transforms(reference_anatomy().handles.positions)[..., 3], 0, atol=2e-3)


def test_without_stages_a_motion_is_played_in_the_body_s_own_scale():
    still = np.tile(np.eye(3), (3, 30, 1, 1))
    motion = HandleMotion(np.zeros((3, 30, 3)), still, np.arange(9).reshape(3, 3), still[:, 0])
    fitting = Fitting.of(motion, reference_anatomy())
    np.testing.assert_allclose(fitting.motion.root_translation, motion.root_translation, atol=0.01)
    np.testing.assert_array_equal(fitting.moved(fitting.motion).motion.rotations, motion.rotations)


def test_what_was_made_for_a_kind_a_height_and_a_softness_is_looked_after_apart():
    dog = make_sample("dog", 0.3, rigged=True)
    anatomy = Anatomy.of(replace(dog, rig=None), rig_handles(dog))
    stages = {stage.name: stage for stage in STAGES}
    turns = np.tile(np.eye(3), (20, 30, 1, 1))
    shifts = np.zeros((20, 30, 3))
    shifts[:, HANDLE_NAMES.index("spine3")] = [0, 0.3, 0]
    sunk = np.tile([0, -0.2, 0], (20, 1))
    plain = HandleMotion(shifts, turns, sunk, turns[:, 0])
    for kind, height, soft in itertools.product((False, True), repeat=3):
        motion = replace(plain, own_kind=kind, own_height=height, soft=soft)
        fitting = Fitting.of(motion, anatomy)
        applied = [stages[name].applies(fitting, anatomy) for name in ("tail", "front", "level")]
        assert applied == [kind, kind, not kind]
        loose = stages["attach"](fitting, anatomy).translations[:, HANDLE_NAMES.index("spine3")]
        assert np.linalg.norm(loose, axis=1).max() == pytest.approx((0.3 if soft else 0.05) * anatomy.scale, rel=1e-3)
        low = fit_motion(motion, anatomy, Stages(smooth=False, feet=False, floor=False, support=False))
        assert (low.root_translation[:, 1].max() < -0.1 * anatomy.scale) == height  # others stand as the reference does
    own = plain.of_own_body()
    assert own.own_kind and own.own_height and own.soft and not own.of_own_body(False).soft
