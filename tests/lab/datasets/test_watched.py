import json

import pytest

from bunraku.errors import FormatError
from bunraku_lab.datasets.motions.watched import load_watched


def write(folder, clips):
    (folder / "captions_watched.json").write_text(json.dumps({"note": "", "clips": clips}))


def test_stretches_come_in_frames_with_plain_sentences(tmp_path):
    row = {"start": 0.5, "end": 4.0, "texts": ["A person  walks.", "walking", "walk"], "ok": True, "note": ""}
    write(tmp_path, {"one": [row, {**row, "start": 4.0, "end": 9.0, "ok": False, "note": "frozen"}], "unknown": [row]})
    found = load_watched(tmp_path, {"one": 150})
    assert list(found) == ["one"]
    first, second = found["one"]
    assert (first.start, first.stop, first.texts, first.fault) == (10, 80, ("a person walks", "walking", "walk"), None)
    assert (second.start, second.stop) == (80, 150) and "frozen" in second.fault


def test_without_the_file_there_are_none_and_a_broken_one_is_named(tmp_path):
    assert load_watched(tmp_path, {"one": 10}) == {}
    (tmp_path / "captions_watched.json").write_text("[1")
    with pytest.raises(FormatError, match=r"captions_watched\.json.*copy it again"):
        load_watched(tmp_path, {"one": 10})
