"""Requests: what goes with what, and the JSON form that pages, projects and workers exchange."""

import json

import numpy as np
import pytest

from bunraku.core.travel import GroundPath
from bunraku.errors import OptionError
from bunraku.pipelines.requests import (
    CONSTRAINTS,
    Apparel,
    Constraints,
    Follow,
    InPlace,
    Keep,
    Loop,
    Pose,
    Request,
    Sampling,
    TransferRequest,
)
from bunraku.retarget.fit import Stages
from bunraku.retarget.pins import Pin

PATH = GroundPath(((0.0, 0.0), (1.0, 2.0)), (0.0, 2.5))
PIN = Pin("left_hand", 1.0, (0.1, 1.4, 0.2), np.diag([1.0, -1.0, -1.0]), 0.5)


def sent(request):
    """A request as another process reads it."""
    return Request.from_json(json.loads(json.dumps(request.to_json())))


@pytest.mark.parametrize(
    "asked",
    [
        Request("walks"),
        Request(
            "geht:4; springt", Sampling(3.5, 2**40, 7, 0.0, 16), Constraints([PATH, PIN, PIN]), Apparel("learn", 2.0),
            Stages(smooth=False, shape=True), "rig", True,
        ),
        Request("walks", constraints=Constraints([Loop(), InPlace()])),
        Request("walks", constraints=Constraints([Follow("take-7"), InPlace()])),
        Request("waves", constraints=Constraints([Keep(("legs",), (1.0, 2.0)), Pose(1.5), Pose(2.0, "a", 0.5), PIN])),
        Request("walks", apparel=Apparel("mask.npy", 1000.0)),
    ],
)  # fmt: skip
def test_a_request_comes_back_from_its_json_form(asked):
    assert sent(asked).to_json() == asked.to_json()


def test_a_constraint_comes_back_as_what_it_was():
    again = sent(Request("walks", constraints=Constraints([PATH, PIN]))).constraints
    assert again.path == PATH and again.path.times == (0.0, 2.5)
    (pin,) = again.pins
    np.testing.assert_array_equal(pin.rotation, PIN.rotation)
    assert (pin.part, pin.time, pin.position, pin.hold) == (PIN.part, PIN.time, PIN.position, PIN.hold)
    kept = sent(Request("waves", constraints=Constraints([Keep(("legs", "tail")), Pose(1.0)]))).constraints
    assert kept.keep == Keep(("legs", "tail")) and kept.poses == [Pose(1.0)]


@pytest.mark.parametrize(
    ("constraints", "apparel", "part"),
    [
        ([Loop(), Follow("a")], "none", "loop and after do not go together"),
        ([PATH, Loop()], "none", "none of loop, after and in_place"),
        ([PATH, Follow("a")], "none", "none of loop"),
        ([InPlace(), PATH], "none", "none of loop"),
        ([PATH], "simulate", "moved by handles"),
        ([PIN], "simulate", "moved by handles"),
        ([Loop()], "simulate", "simulated apparel starts from the rest pose"),
        ([Loop()], "learn", "moving apparel starts from the rest pose"),
        ([Follow("a")], "auto", "moving apparel"),
        ([Loop(), Loop()], "none", "asked for twice"),
        ([PATH, PATH], "none", "asked for twice"),
        ([PIN] * 101, "none", "at most 100 pins"),
        ([Keep(("legs",))], "none", "'keep' is for clips that are edited"),
        ([Pose(1.0)], "none", "'pose' is for clips that are edited"),
    ],
)
def test_what_does_not_go_together(constraints, apparel, part):
    asked = Request("walks", constraints=Constraints(constraints), apparel=Apparel(apparel))
    with pytest.raises(OptionError, match=part):
        asked.check()


def test_messages_of_the_command_line_name_its_options():
    with pytest.raises(OptionError, match="none of --loop, --after and --in-place"):
        Request("walks", constraints=Constraints([PATH, InPlace()])).check("--")
    with pytest.raises(OptionError, match="neither --loop nor --after"):
        Request("walks", constraints=Constraints([Loop()]), apparel=Apparel("learn")).check("--")
    with pytest.raises(OptionError, match="^--candidates must be"):
        Request("walks", Sampling(candidates=0)).check("--")


def test_what_goes_together():
    for constraints in ([Loop(), InPlace()], [Follow("a"), InPlace()], [PATH, PIN, PIN], []):
        Request("walks", constraints=Constraints(constraints)).check()
    Request("walks", apparel=Apparel("simulate")).check()
    with pytest.raises(OptionError, match="leave --handles out"):
        Request("walks", apparel=Apparel("simulate"), handles="rig").check("--")
    with pytest.raises(OptionError, match="'loop' is for clips that are made anew"):
        Request("walks", constraints=Constraints([Loop()])).check(clip=True)


def test_all_doors_give_the_length_that_fits_and_the_one_that_is_asked_for():
    from bunraku.cli.shared import check_sequence
    from bunraku.language.parse import parse
    from bunraku.studio.forms import Part, TakeForm

    for prompt, expected in (("jumps; walks:4", 6.6), ("walks", 6.0), ("bows, then jumps", 5.1)):
        json = Request.from_json({"sentence": prompt})
        read = (parse(prompt), Request(prompt).parsed, json.parsed, check_sequence(prompt, None, False))
        read += tuple(TakeForm(script=(part,)).request().parsed for part in (Part(prompt), Part(prompt, 9, fits=True)))
        assert [sentence.seconds for sentence in read] == pytest.approx([expected] * len(read))
    assert Request("jumps", Sampling(9)).parsed.seconds == 9
    along = Constraints([GroundPath(((0, 0), (0, 3)))])
    assert Request("jumps", constraints=along).parsed.seconds == 6


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"wheels": 1}, "the request has no 'wheels'"),
        ({"sentence": 3}, "sentence must be a text"),
        ({"sentence": "a" * 10_001}, "more than 10000 characters"),
        ({"sampling": {"seconds": 36_001}}, "seconds must be from 0.5 to 36000"),
        ({"sampling": {"seed": -1}}, "seed must be from 0"),
        ({"sampling": {"steps": 1001}}, "steps must be from 1 to 1000"),
        ({"sampling": {"guidance": float("inf")}}, "finite"),
        ({"sampling": {"candidates": 17}}, "candidates must be from 1 to 16"),
        ({"sampling": {"candidates": 1.5}}, "whole number"),
        ({"apparel": {"motion": "silk"}}, "apparel moves by"),
        ({"apparel": {"stiffness": 0}}, "stiffness must be from 0.001 to 1000"),
        ({"stages": {"magic": True}}, "stages has no 'magic'"),
        ({"stages": {"feet": 1}}, "true or false"),
        ({"handles": "guess"}, "handles is one of predict, rig"),
        ({"force": "yes"}, "true or false"),
        ({"constraints": {}}, "must be a list"),
        ({"constraints": [1]}, "a constraint is an object with a kind"),
        ({"constraints": [{"kind": "wish"}]}, "a constraint is an object with a kind"),
        ({"constraints": [{"kind": "loop", "twice": 1}]}, "the loop has no 'twice'"),
        ({"constraints": [{"kind": "after", "clip": 3}]}, "clip must be a text"),
        ({"constraints": [{"kind": "path", "points": [[0, 0]]}]}, "a path has 2 to 200 points"),
        ({"constraints": [{"kind": "path", "points": [[0, 0, 0], [1, 1, 1]]}]}, "two numbers"),
        ({"constraints": [{"kind": "path", "points": [[0, 0]] * 2000}]}, "more than 1000 entries"),
        ({"constraints": [{"kind": "pin", "part": "nose", "time": 0, "position": [0, 0, 0]}]}, "cannot be pinned"),
        ({"constraints": [{"kind": "pin", "part": "left_hand", "time": 0, "position": [0, 0]}]}, "three numbers"),
        ({"constraints": [{"kind": "loop"}, {"kind": "after", "clip": "a"}]}, "do not go together"),
    ],
)
def test_a_form_that_is_none_is_one_sentence(change, part):
    with pytest.raises(OptionError, match=part) as told:
        Request.from_json({"sentence": "walks", **change})
    assert "\n" not in str(told.value) and len(str(told.value)) < 300


def test_every_kind_of_constraint_has_a_class_that_says_so():
    import importlib

    for kind, where in CONSTRAINTS.items():
        module, name = where.split(":")
        assert getattr(importlib.import_module(module), name).kind == kind


def test_what_is_an_array_has_no_form():
    from bunraku.core.body.reference import reference_body

    with pytest.raises(OptionError, match="how they are made"):
        Request("walks", handles=reference_body().handles).to_json()
    with pytest.raises(OptionError, match="only named"):
        Constraints([Follow("a")]).after  # noqa: B018 -- it is read


@pytest.mark.parametrize(
    ("how", "part"),
    [
        ({"onto": "wheels"}, "'handles', 'rig' or 'auto'"),
        ({"fps": 0}, "from 1 to 240"),
        ({"fps": 241}, "from 1 to 240"),
        ({"handles": "guess"}, "'predict' or 'rig'"),
        ({"onto": "handles", "apparel": Apparel("simulate")}, "leave out onto handles"),
    ],
)
def test_transfers_that_cannot_be(how, part):
    with pytest.raises(OptionError, match=part):
        TransferRequest(**how).check()


def test_requests_of_one_pass_differ_in_sentence_and_seed_alone():
    from bunraku.pipelines.animator import _common

    same = [Request("walks"), Request("runs", Sampling(seed=4)), Request("waves").with_seed(7)]
    assert _common(same) is same[0]
    assert _common([Request("walks", stages=Stages(feet=False)), Request("runs", stages=Stages(feet=False))])
    for other in (
        Request("runs", Sampling(seconds=3)), Request("runs", constraints=Constraints([Loop()])),
        Request("runs", apparel=Apparel("learn")), Request("runs", handles="rig"), Request("runs", stages=Stages()),
    ):  # fmt: skip
        with pytest.raises(OptionError, match="differ in sentence and seed alone"):
            _common([Request("walks"), other])
    with pytest.raises(OptionError, match="nothing to generate"):
        _common([])
