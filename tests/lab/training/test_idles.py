"""Who only stands and who stands with busy hands are told apart; who bends or kneels is neither."""

import pytest

from bunraku.diffusion.features import encode
from bunraku.gestures.catalogue import STANDING, gestures
from bunraku.gestures.play import gesture_motion
from bunraku.retarget.body_motion import body_handle_motion
from bunraku_lab.training.idles import BUSY, IDLE, idling


def found(name, bounds):
    one = STANDING if name == "standing" else next(one for one in gestures() if one.name == name)
    clip = {"features": encode(body_handle_motion(gesture_motion(one)))}
    return [clip for clip, _ in idling({name: clip}, bounds)]


@pytest.mark.parametrize(
    ("name", "idle", "busy"),
    [("standing", True, False), ("clap", False, True), ("conduct", False, True), ("both knees", False, False)],
)
def test_each_is_what_it_is(name, idle, busy):
    assert found(name, IDLE) == [name] * idle
    assert found(name, BUSY) == [name] * busy
