"""A folder that is broken, full or shut: nothing goes, what there is is shown, and all of it is said."""

import json
import os

import pytest
from conftest import as_somebody, no_space

from bunraku.studio.store import Store
from bunraku.studio.workspace.workspace import Workspace

CUT = '{"name": "mine", "file": "source/mi'


def character(client, state="ready"):
    """A character by its record and its mesh."""
    store = client.app.state.studio.store
    settings = {"up": "auto", "front": "auto", "unit": "auto", "handles": "predict"}
    record = store.new("characters", {"name": "mine", "file": "source/mine.glb", "state": state, "settings": settings})
    folder = store.folder_of("characters", record["id"])
    (folder / "source").mkdir()
    (folder / "source" / "mine.glb").write_bytes(b"glTF all my work")
    return record["id"], folder


@pytest.mark.parametrize(
    "record",
    [
        CUT, "", "[]", "{}", '{"name": 5, "state": "ready"}', "[" * 100_000, " " * (5 << 20), "\x00\x01", '{"a":NaN}',
        '{"name":"a","state":"ready","file":"source/mine.glb","settings":{"up":5}}',
    ],
)  # fmt: skip
def test_a_record_that_cannot_be_read_takes_nothing_with_it(app_client, record, caplog):
    with app_client() as client:
        name, folder = character(client)
    (folder / "record.json").write_text(record)
    with app_client() as client:
        about = client.get("/api/about").json()
    aside = folder.parents[1] / "set-aside" / f"character-{name}"
    assert (aside / "source" / "mine.glb").read_bytes() == b"glTF all my work"
    assert (aside / "record.json").read_text() == record
    assert about["characters"] == [] and [name in text and "mine.glb" in text for text in about["set_aside"]] == [True]
    assert name in caplog.text and "kept in" in caplog.text
    with app_client() as client:  # and it is said at the next start too
        assert client.get("/api/about").json()["set_aside"] == about["set_aside"]


def test_a_folder_whose_record_is_missing_is_kept_aside(app_client):
    with app_client() as client:
        name, folder = character(client)
    (folder / "record.json").unlink()
    with app_client() as client:
        assert client.get("/api/about").json()["characters"] == []
    aside = folder.parents[1] / "set-aside" / f"character-{name}"
    assert (aside / "source" / "mine.glb").read_bytes() == b"glTF all my work"


def test_what_was_given_up_and_what_was_never_begun_goes(app_client):
    with app_client() as client:
        name, folder = character(client)
        assert client.delete(f"/api/characters/{name}").status_code == 200
        (folder.parent / "0123456789abcdef").mkdir()
    with app_client() as client:
        about = client.get("/api/about").json()
    assert about["characters"] == about["set_aside"] == [] and list(folder.parent.iterdir()) == []


@pytest.mark.parametrize("wrong", [{"ends": 5}, {"ends": [{"part": 1}]}, {"height": "tall"}, {"axes": []}])
def test_a_character_of_which_only_what_was_found_is_wrong_is_opened_again(app_client, wrong):
    with app_client() as client:
        name, folder = character(client)
    record = json.loads((folder / "record.json").read_text())
    (folder / "record.json").write_text(json.dumps({**record, **wrong}))
    with app_client() as client:
        state = client.app.state.studio
        assert state.store.get("characters", name)["state"] == "unclear"
        assert not wrong.keys() & state.store.get("characters", name).keys()
        state.jobs.start = lambda: None  # what is queued stays queued
        state.start()
        (job,) = client.get("/api/jobs").json()["jobs"]
        assert job["about"]["opens"] == name and state.store.get("characters", name)["state"] == "opening"


def test_deleting_needs_no_space_and_makes_some(app_client):
    with app_client() as client:
        name, folder = character(client)
        other, _ = character(client)
        with no_space():
            assert client.delete(f"/api/characters/{name}").status_code == 200
            assert [one["id"] for one in client.get("/api/characters").json()["characters"]] == [other]
            assert client.patch(f"/api/characters/{name}", json={"deleted": False}).status_code == 200  # taken back
            refused = client.post("/api/projects", json={"view": {}})
            assert refused.status_code == 507 and "free some space" in refused.json()["error"]
            assert "takes nothing more" in client.get("/api/about").json()["trouble"]
            assert client.delete(f"/api/characters/{name}").status_code == 200
            assert not folder.exists()  # now that the disk is known to be full
        assert client.post("/api/projects", json={"view": {}}).status_code == 201
        assert client.get("/api/about").json()["trouble"] == ""


def test_it_starts_on_a_full_disk_shows_what_there_is_and_says_so(app_client):
    with app_client() as client:
        name, _ = character(client, "opening")
    with no_space(), app_client() as client:
        about = client.get("/api/about").json()
        assert "takes nothing more" in about["trouble"] and "free some space" in about["trouble"]
        assert [(one["id"], one["state"]) for one in about["characters"]] == [(name, "interrupted")]
        assert client.delete(f"/api/characters/{name}").status_code == 200


def test_given_up_things_make_room_for_what_is_written(tmp_path):
    one = Store(tmp_path)
    old = one.new("projects", {"view": {}})
    one.change("projects", old["id"], deleted=True)
    with no_space(), pytest.raises(Exception, match="file too large"):
        one.new("projects", {"view": {}})
    assert not (tmp_path / "projects" / old["id"]).exists()


def test_what_the_disk_refused_is_written_when_it_takes_it(tmp_path):
    one = Store(tmp_path)
    made = one.new("projects", {"view": {}})
    with no_space():
        assert one.note("projects", made["id"], view={"seed": 3})["view"] == {"seed": 3}
    assert one.get("projects", made["id"])["view"] == {"seed": 3} and Store(tmp_path).all("projects")[0]["view"] == {}
    one.new("projects", {"view": {}})
    assert Store(tmp_path).get("projects", made["id"])["view"] == {"seed": 3}


def test_a_take_ends_where_the_disk_fills_up_under_the_server(own_studio):
    """The worker's files are written whole, the server's record of them is not."""
    one = own_studio()
    owner = one.sample("mushroom")["id"]
    made = one.animate(owner, "walks", seconds=1, steps=1, draft=False)
    with no_space(one.process.pid):
        assert one.ended(made["job"])["state"] == "done"
        assert one.get(f"/api/takes/{made['takes'][0]}")["state"] == "done"
        assert "takes nothing more" in one.get("/api/about")["trouble"]
    next_one = one.animate(owner, "walks", seconds=1, steps=1, draft=False)
    one.done(next_one["job"])  # the queue goes on
    worker = one.get("/api/about")["worker"]["process"]
    last = one.animate(owner, "walks", seconds=2, steps=50, draft=False)
    with no_space(one.process.pid), no_space(worker):
        ended = one.ended(last["job"])
        assert ended["state"] == "failed" and "free some space" in ended["error"]
        assert one.get(f"/api/takes/{last['takes'][0]}")["state"] == "failed"
    one.stop()
    full = own_studio(folder=one.folder, limit=lambda: no_space_from_now(4000))
    assert owner in [each["id"] for each in full.get("/api/about")["characters"]]
    assert full.ask("GET", f"/api/takes/{made['takes'][0]}/clip")[1][:4] == b"BNRC"
    assert "the studio's folder takes nothing more" in full.log.read_text()
    assert full.ask("DELETE", f"/api/takes/{made['takes'][0]}")[0] == 200


def no_space_from_now(most):
    """No file of this process may have more bytes; its log may have a few."""
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))


def test_a_folder_that_can_only_be_read_is_shown(own_studio):
    one = own_studio()
    owner = one.sample("mushroom")["id"]
    one.stop()
    for folder, _, _ in os.walk(one.folder):
        os.chmod(folder, 0o555)
    try:
        shut = own_studio(folder=one.folder, limit=as_somebody)
        about = shut.get("/api/about")
        assert owner in [each["id"] for each in about["characters"]] and "permission denied" in about["trouble"]
        assert shut.ask("GET", f"/api/characters/{owner}/mesh.glb")[1][:4] == b"glTF"
        for method, path, body in (
            ("DELETE", f"/api/characters/{owner}", None),
            ("POST", f"/api/characters/{owner}/takes", {"script": [{"text": "walks", "seconds": 2}]}),
            ("POST", "/api/projects", {"view": {}}),
        ):
            status, said = shut.ask(method, path, body)
            assert status == 507 and "permission denied" in said["error"]
        assert owner in [each["id"] for each in shut.get("/api/about")["characters"]]
    finally:
        for folder, _, _ in os.walk(one.folder):
            os.chmod(folder, 0o755)


def test_the_worker_needs_no_record_that_was_given_up(tmp_path):
    with pytest.raises(Exception, match="open its file again"):
        Workspace(str(tmp_path)).character("0" * 16)
