"""Requests: limits of numbers, and the JSON form."""

import json
import re
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pytest

from bunraku.core import request
from bunraku.core.request import MOST_ENTRIES, MOST_LETTERS, from_json, to_json
from bunraku.errors import OptionError


@dataclass(frozen=True)
class Inner:
    low: float = 0.0
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outer:
    count: int
    place: tuple[float, float] = (0.0, 1.0)
    kind: Literal["one", "two"] = "one"
    share: float | None = None
    inner: Inner = field(default_factory=Inner)
    matrix: np.ndarray | None = None
    on: bool = False


def test_what_goes_out_comes_back():
    whole = Outer(3, (0.5, 2.0), "two", 1e-3, Inner(1.5, ("a", "ü")), np.eye(2), True)
    again = from_json(Outer, json.loads(json.dumps(to_json(whole))))
    np.testing.assert_array_equal(again.matrix, np.eye(2))
    assert [getattr(again, name) for name in ("count", "place", "kind", "share", "inner", "on")] == [
        3, (0.5, 2.0), "two", 1e-3, Inner(1.5, ("a", "ü")), True,
    ]  # fmt: skip
    assert from_json(Outer, {"count": 2.0}) == Outer(2) and isinstance(from_json(Outer, {"count": 2.0}).count, int)


@pytest.mark.parametrize(
    ("data", "part"),
    [
        ([], "must be an object"),
        (None, "must be an object, not null"),
        ({}, "needs 'count'"),
        ({"count": 1, "wheels": 4}, "has no 'wheels'"),
        ({"count": True}, "count must be a number"),
        ({"count": "1"}, "count must be a number"),
        ({"count": 1.5}, "whole number"),
        ({"count": 10**400}, "finite"),
        ({"count": 1, "share": float("nan")}, "finite"),
        ({"count": 1, "share": float("inf")}, "finite"),
        ({"count": 1, "place": [1]}, "place must be two numbers, not 1"),
        ({"count": 1, "place": 3}, "place must be a list"),
        ({"count": 1, "place": [1, None]}, "place must be a number, not null"),
        ({"count": 1, "kind": "three"}, "kind is one of one, two"),
        ({"count": 1, "kind": True}, "kind is one of"),
        ({"count": 1, "kind": []}, "kind is one of"),
        ({"count": 1, "on": 1}, "on must be true or false"),
        ({"count": 1, "inner": {"names": [3]}}, "names must be a text"),
        ({"count": 1, "inner": {"names": ["a"] * (MOST_ENTRIES + 1)}}, "entries"),
        ({"count": 1, "inner": {"names": ["a" * (MOST_LETTERS + 1)]}}, "characters"),
        ({"count": 1, "matrix": [[1], [1, 2]]}, "rows"),
        ({"count": 1, "matrix": [["a"]]}, "rows"),
        ({"count": 1, "matrix": [[float("nan")]]}, "finite"),
        ({"count": 1, "matrix": [[0.0] * (MOST_ENTRIES + 1)]}, "rows"),
    ],
)
def test_what_is_none_is_one_sentence(data, part):
    with pytest.raises(OptionError, match=part) as told:
        from_json(Outer, data)
    assert "\n" not in str(told.value) and len(str(told.value)) < 300


def test_what_has_no_form_says_so():
    with pytest.raises(OptionError, match="has no form in JSON"):
        to_json(Outer(1, matrix=object()))


LIMITS = [name for name in vars(request) if isinstance(getattr(request, name), request.Limit)]


@pytest.mark.parametrize("name", LIMITS)
def test_a_limit_holds_at_both_ends_and_for_what_is_no_number(name):
    limit = getattr(request, name)
    for value in (limit.low, limit.high, None):
        limit.check(value)
    for value in (limit.low - 1, limit.high * 2 + 1, float("nan"), float("inf"), -float("inf")):
        with pytest.raises(OptionError, match="^--" + re.escape(f"it must be from {limit.low:g} to")):
            limit.check(value, "--it")
