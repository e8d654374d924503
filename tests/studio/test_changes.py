"""What pages ask for now and then, and the view that each tab has of its own."""

import http.client
import time

import pytest

from bunraku.studio.changes import MOST, Changes


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


@pytest.mark.parametrize("after", ["9" * 5000, "9" * 16, "-1", "1.5", "x", "", "²", "٣"])
def test_numbers_that_are_none(client, after):
    answer = client.get("/api/changes", params={"after": after})
    assert answer.status_code == 400 and "whole number" in answer.json()["error"]


def test_twelve_tabs_and_three_hundred_lines_get_their_answers(studio):
    """Nothing of a page holds a line: each asks and is answered, so a browser's six lines to a host are enough."""
    host, port = studio.base.removeprefix("http://").split(":")
    head = {"authorization": f"Bearer {studio.token}", "host": f"localhost:{port}"}
    lines = [http.client.HTTPConnection(host, int(port), timeout=60) for _ in range(300)]
    longest = 0.0
    for _ in range(2):
        for line in lines:
            start = time.monotonic()
            line.request("GET", "/api/changes", headers=head)
            answer = line.getresponse()
            answer.read()
            longest = max(longest, time.monotonic() - start)
            assert answer.status == 200
    for line in lines:
        line.close()
    print(f"longest answer: {1000 * longest:.0f} ms")
    assert longest < 5


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
    monkeypatch.setattr("bunraku.studio.routes.files.MOST_PROJECTS", 3)
    names = [client.post("/api/projects", json={"view": {"seed": seed}}).json()["id"] for seed in range(3)]
    client.put(f"/api/projects/{names[0]}", json={"view": {"seed": 9}})
    client.post("/api/projects", json={"view": {}})
    left = [one["id"] for one in client.get("/api/projects").json()["projects"]]
    assert len(left) == 3 and names[0] in left and names[1] not in left
