import pytest

from bunraku.cli.options import parse_path, parse_pin
from bunraku.errors import OptionError


def test_a_pin():
    pin = parse_pin("left_hand@2.5=0.3,1.4,-0.2")
    assert (pin.part, pin.time, pin.position, pin.hold) == ("left_hand", 2.5, (0.3, 1.4, -0.2), 0)
    assert parse_pin("right-foot@1+0.5=0,0,0").hold == 0.5


def test_a_path():
    assert parse_path("") is None
    assert parse_path("0,0 1,2 3,2").points == ((0, 0), (1, 2), (3, 2))
    assert parse_path("0,0@0 1,2@2.5").times == (0, 2.5)


@pytest.mark.parametrize(
    "text", ["left_hand", "left_hand@x=1,2,3", "left_hand@1=1,2", "@1=1,2,3", "left_hand@1=1,2,nan"]
)
def test_pins_that_are_none(text):
    with pytest.raises(OptionError, match="--pin is a part"):
        parse_pin(text)


@pytest.mark.parametrize("text", ["0", "0,0 1", "0,0 1,x", "0,0@0 1,1", "0,0 1,inf"])
def test_paths_that_are_none(text):
    with pytest.raises(OptionError, match="--path is points"):
        parse_path(text)
