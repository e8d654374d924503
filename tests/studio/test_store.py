"""What the studio stores and tells, and whom it lets in."""

import asyncio
import contextlib
import json
import os

import pytest
import uvicorn
from uvicorn.server import ServerState

from bunraku.errors import FormatError, OptionError
from bunraku.studio.jobs import MOST, Changes
from bunraku.studio.server.app import POLICY
from bunraku.studio.server.lines import Line
from bunraku.studio.server.serve import held_folder
from bunraku.studio.store import NotThere, Store

CHARACTER = {
    "name": "one", "file": "source/one.glb", "state": "ready",
    "settings": {"up": "auto", "front": "auto", "unit": "auto", "handles": "predict"},
}  # fmt: skip


def take(store, text="walks"):
    """The record of a take that waits, of a new character."""
    owner = store.new("characters", CHARACTER)["id"]
    return {"character": owner, "state": "waiting", "script": [{"text": text, "seconds": 2}]}


def test_what_is_kept_is_found_again(tmp_path):
    one = Store(tmp_path / "deep" / "folder")
    made = one.new("takes", take(one, "läuft"))
    one.change("takes", made["id"], star=True)
    again = Store(tmp_path / "deep" / "folder")
    assert again.get("takes", made["id"])["script"][0]["text"] == "läuft" and again.get("takes", made["id"])["star"]
    assert [record["id"] for record in again.all("takes")] == [made["id"]]


@pytest.mark.parametrize(("kind", "key"), [("takes", "id"), ("characters", "character")])
def test_what_was_given_up_is_gone_after_a_restart_and_takes_go_with_their_character(tmp_path, kind, key):
    one = Store(tmp_path)
    made = one.new("takes", take(one))
    one.change(kind, made[key], deleted=True)
    assert one.all("takes") == []
    one.change(kind, made[key], deleted=False)
    assert len(one.all("takes")) == 1
    one.change(kind, made[key], deleted=True)
    assert Store(tmp_path).all("takes") == [] and not (tmp_path / "takes" / made["id"]).exists()


@pytest.mark.parametrize("name", ["../../etc", "..", "", "a" * 16 + "/", "0" * 15, "0" * 16, None, 3])
def test_names_that_it_did_not_give_are_nothing(tmp_path, name):
    with pytest.raises(NotThere):
        Store(tmp_path).folder_of("characters", name)


def test_broken_records_are_left_out(tmp_path):
    one = Store(tmp_path)
    good, broken = one.new("takes", take(one)), one.new("takes", take(one))
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


def test_a_character_that_cannot_be_read_keeps_its_takes(tmp_path):
    one = Store(tmp_path)
    broken = one.new("takes", take(one))
    (tmp_path / "characters" / broken["character"] / "record.json").write_text('{"half')
    Store(tmp_path)
    Store(tmp_path)
    assert (tmp_path / "takes" / broken["id"] / "record.json").exists()


def test_memory_holds_nothing_that_a_record_cannot(tmp_path):
    one = Store(tmp_path)
    made = one.new("takes", take(one, "walk\ud800"))
    assert one.change("takes", made["id"], title="\udc80")["title"] == "\ufffd"
    with pytest.raises(ValueError):
        one.note("takes", made["id"], height=float("nan"))
    assert "height" not in one.get("takes", made["id"]) and json.dumps(one.all("takes")).encode()


def test_one_studio_has_a_folder(tmp_path):
    pytest.importorskip("fcntl", reason="Windows has no such locks")
    with held_folder(tmp_path / "folder", "http://localhost:1/"):
        said = f"process {os.getpid()} at http://localhost:1/"
        with pytest.raises(OptionError, match=said), held_folder(tmp_path / "folder", "http://localhost:2/"):
            pass
    with held_folder(tmp_path / "folder", "http://localhost:3/"):
        pass


@pytest.mark.parametrize(
    "sent", [b"", b"GET / HTTP/1.1\r\nhost: x\r\n", b"POST / HTTP/1.1\r\ncontent-length: 9\r\n\r\n1"]
)
def test_a_line_that_is_left_half_open_is_closed(sent):
    async def app(scope, receive, send):
        while (await receive()).get("more_body"):
            pass

    async def ask():
        config = uvicorn.Config(app, http=Line, timeout_keep_alive=1, lifespan="off", log_level="critical")
        config.load()
        loop = asyncio.get_running_loop()
        server = await loop.create_server(lambda: Line(config, ServerState(), {}), "127.0.0.1", 0)
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
        writer.write(sent)
        with contextlib.suppress(ConnectionResetError):
            await asyncio.wait_for(reader.read(), 10)
        writer.close()
        server.close()

    asyncio.run(ask())


def test_the_latest_of_each_thing_is_told_once_in_order():
    one = Changes()
    start = one.since(0)["event"]
    for number in range(50):
        one.tell("job", {"id": "a", "done": number})
    one.tell("take", {"id": "a"})
    one.tell("job", {"id": "b"})
    one.tell("job", {"id": "a", "done": 50})
    found = one.since(start)
    assert found["changes"] == [["take", {"id": "a"}], ["job", {"id": "b"}], ["job", {"id": "a", "done": 50}]]
    assert one.since(found["event"]) == {"event": found["event"], "missed": False, "changes": []}
    one.tell("gone", {"kind": "takes", "id": "a"})
    assert one.since(found["event"])["changes"] == [["gone", {"kind": "takes", "id": "a"}]]


def test_what_is_forgotten_or_was_never_given_is_asked_for_anew():
    one = Changes()
    for number in range(MOST + 10):
        one.tell("take", {"id": str(number)})
    assert one.since(3)["missed"] and not one.since(10)["missed"] and len(one.since(10)["changes"]) == MOST
    assert one.since(MOST + 11)["missed"]


def test_two_tabs_do_not_overwrite_each_others_view(client):
    made = client.post("/api/projects", json={"view": {"seed": 1}}).json()
    keep = lambda seed, revision: client.put(  # noqa: E731
        f"/api/projects/{made['id']}", json={"view": {"seed": seed}, "revision": revision}
    )
    assert keep(2, made["revision"]).json()["revision"] == made["revision"] + 1
    refused = keep(3, made["revision"])  # another tab that has the same project, a duplicate say
    assert refused.status_code == 409 and refused.json()["kind"] == "Newer"
    assert client.get(f"/api/projects/{made['id']}").json()["view"] == {"seed": 2}
    assert keep(4, made["revision"] + 1).status_code == 200


def test_views_do_not_pile_up(client, monkeypatch):
    monkeypatch.setattr("bunraku.studio.routes.general.MOST_PROJECTS", 3)
    names = [client.post("/api/projects", json={"view": {"seed": seed}}).json()["id"] for seed in range(3)]
    client.put(f"/api/projects/{names[0]}", json={"view": {"seed": 9}})
    client.post("/api/projects", json={"view": {}})
    left = [one["id"] for one in client.get("/api/projects").json()["projects"]]
    assert len(left) == 3 and names[0] in left and names[1] not in left


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"authorization": ""}, 401),
        ({"authorization": "Bearer other"}, 401),
        ({"authorization": "Basic secret"}, 401),
        ({"origin": "http://localhost:8734"}, 200),
        ({"origin": "http://evil.example"}, 403),
        ({"origin": "http://localhost:1"}, 403),
        ({"origin": "null"}, 403),
        ({"host": "evil.example:8734"}, 403),
        ({"host": "127.0.0.1:8734"}, 200),
        ({"host": "localhost.evil.example"}, 403),
        ({"sec-fetch-site": "cross-site"}, 403),
        ({"sec-fetch-site": "same-origin"}, 200),
    ],
)
def test_who_is_let_in(client, headers, status):
    answer = client.get("/api/jobs", headers=headers)
    assert answer.status_code == status
    if status != 200:
        assert set(answer.json()) == {"error", "kind"} and answer.json()["error"][-1] != "."


def test_the_page_needs_no_token_and_may_load_nothing_from_elsewhere(client):
    page = client.get("/", headers={"authorization": ""})
    assert page.status_code == 200 and "<script" in page.text
    policy = page.headers["content-security-policy"]
    assert policy == POLICY and "http" not in policy and "unsafe" not in policy and "*" not in policy
    assert page.headers["x-content-type-options"] == "nosniff" and page.headers["referrer-policy"] == "no-referrer"
    assert "http://" not in page.text and "https://" not in page.text


def test_files_outside_of_the_page_are_not_served(client):
    for path in ("/../app.py", "/%2e%2e/app.py", "/..%2fapp.py", "/static/../../errors.py"):
        assert client.get(path).status_code in (403, 404)


def test_a_password_gives_the_token_and_a_wrong_one_does_not(client):
    client.app.state.keys.__dict__["password"] = "long enough"
    headers = {"authorization": ""}
    wrong = client.post("/api/login", json={"password": "guess"}, headers=headers)
    assert wrong.status_code == 401
    early = client.post("/api/login", json={"password": "long enough"}, headers=headers)
    assert early.status_code == 429 and "wait 1 seconds" in early.json()["error"]
    client.app.state.tries.clear()
    right = client.post("/api/login", json={"password": "long enough"}, headers=headers)
    assert right.json() == {"token": "secret"}
    long = client.post("/api/login", content=b" " * 5000, headers=headers)
    assert long.status_code == 400 and "4 KiB" in long.json()["error"]


def test_without_a_password_nobody_logs_in(client):
    assert client.post("/api/login", json={"password": ""}).status_code == 401
