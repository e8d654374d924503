import pytest

from bunraku.core.request import limits
from bunraku.errors import OptionError


@pytest.mark.parametrize("name", [name for name in limits.__all__ if name != "Limit"])
def test_a_limit_holds_at_both_ends_and_for_what_is_no_number(name):
    limit = getattr(limits, name)
    for value in (limit.low, limit.high, None):
        limit.check(value)
    for value in (limit.low - 1, limit.high * 2 + 1, float("nan"), float("inf"), -float("inf")):
        with pytest.raises(OptionError, match=f"^--it must be from {limit.low:g} to"):
            limit.check(value, "--it")
