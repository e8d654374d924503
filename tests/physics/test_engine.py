"""An installation without MuJoCo says so before any work."""

import sys

import pytest

from bunraku.errors import MissingExtraError
from bunraku.physics.engine import check_engine
from bunraku.pipelines.requests.apparel import Apparel


def test_what_simulates_is_asked_for_before_the_work(monkeypatch):
    check_engine("x")
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.setattr("bunraku.physics.engine.find_spec", lambda name: None)
    for motion in ("simulate", "chains"):
        with pytest.raises(MissingExtraError, match=rf"{motion}.*bunraku\[physics\]"):
            Apparel(motion).check("--")
    for motion in ("none", "learn", "auto"):
        Apparel(motion).check("--")
