import json

import pytest

from bunraku.errors import FormatError
from bunraku.studio.store import NotThere, Store


def take(text="walks"):
    """The record of a take that waits."""
    return {"character": "0" * 16, "state": "waiting", "script": [{"text": text, "seconds": 2}]}


def test_what_is_kept_is_found_again(tmp_path):
    one = Store(tmp_path / "deep" / "folder")
    made = one.new("takes", take("läuft"))
    one.change("takes", made["id"], star=True)
    again = Store(tmp_path / "deep" / "folder")
    assert again.get("takes", made["id"])["script"][0]["text"] == "läuft" and again.get("takes", made["id"])["star"]
    assert [record["id"] for record in again.all("takes")] == [made["id"]]


def test_what_was_given_up_is_gone_after_a_restart(tmp_path):
    one = Store(tmp_path)
    made = one.new("takes", {})
    one.change("takes", made["id"], deleted=True)
    assert one.all("takes") == []
    one.change("takes", made["id"], deleted=False)
    assert len(one.all("takes")) == 1
    one.change("takes", made["id"], deleted=True)
    assert Store(tmp_path).all("takes") == [] and not (tmp_path / "takes" / made["id"]).exists()


@pytest.mark.parametrize("name", ["../../etc", "..", "", "a" * 16 + "/", "0" * 15, "0" * 16, None, 3])
def test_names_that_it_did_not_give_are_nothing(tmp_path, name):
    with pytest.raises(NotThere):
        Store(tmp_path).folder_of("characters", name)


def test_broken_records_are_left_out(tmp_path):
    one = Store(tmp_path)
    good, broken = one.new("takes", take()), one.new("takes", take())
    (tmp_path / "takes" / broken["id"] / "record.json").write_text('{"half')
    (tmp_path / "takes" / "0123456789abcdef").mkdir()
    (tmp_path / "takes" / "notes.txt").write_text("mine")
    assert [record["id"] for record in Store(tmp_path).all("takes")] == [good["id"]]
    assert (tmp_path / "takes" / "notes.txt").read_text() == "mine"


def test_a_record_that_cannot_be_written_changes_nothing(tmp_path):
    one = Store(tmp_path)
    made = one.new("takes", {"star": False})
    with pytest.raises(FormatError, match="too large"):
        one.change("takes", made["id"], star=True, junk="x" * (5 << 20))
    assert one.get("takes", made["id"])["star"] is False
    assert json.loads((tmp_path / "takes" / made["id"] / "record.json").read_text())["star"] is False
