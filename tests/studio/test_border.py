"""What comes from elsewhere: project files, views, requests, ZIPs; refused with one sentence, or put right."""

import io
import json
import tracemalloc
import zipfile
import zlib
from pathlib import Path

import pytest

from bunraku.core.request import DEEPEST, MOST_BYTES, MOST_VALUES, read_json
from bunraku.errors import OptionError
from bunraku.studio.records import read_view

VIEWS = json.loads((Path(__file__).parent / "views.json").read_text(encoding="utf-8"))
SAMPLE = Path(__file__).parents[2] / "src" / "bunraku" / "studio" / "sample.bunraku"


def project(about, **files):
    """A project file; `about` is an object, or bytes as they are."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("project.json", about if isinstance(about, bytes) else json.dumps(about))
        for name, content in files.items():
            archive.writestr(name.replace("__", "/"), content)
    return data.getvalue()


def sample(change=lambda about: None):
    """The sample's project, changed in what it says of itself."""
    with zipfile.ZipFile(SAMPLE) as archive:
        about = json.loads(archive.read("project.json"))
        files = {name: archive.read(name) for name in archive.namelist() if name != "project.json"}
    change(about)
    return project(about, **files)


def send(client, data):
    return client.post("/api/project-files?name=x.bunraku", content=data)


def refused(client, answer, part=""):
    said = answer.json()
    assert answer.status_code == 400 and part in said["error"], said
    assert "fault of Bunraku" not in said["error"] and said["error"].count(". ") == 0
    assert client.get("/api/characters").json()["characters"] == [] and client.get("/api/about").json()["takes"] == []


@pytest.mark.parametrize("view", VIEWS["kept"], ids=json.dumps)
def test_views_that_a_page_can_show(client, view):
    assert client.post("/api/projects", json={"view": view}).json()["view"] == view
    assert read_view(view) == view


@pytest.mark.parametrize("view", VIEWS["refused"], ids=json.dumps)
def test_views_that_a_page_cannot_show(client, ready, view):
    refused = client.post("/api/projects", json={"view": view})
    assert refused.status_code == 400 and set(refused.json()) == {"error", "kind"}
    made = client.post("/api/projects", json={"view": {"loop": True}}).json()
    assert client.put(f"/api/projects/{made['id']}", json={"view": view}).status_code == 400
    assert client.post(f"/api/characters/{ready}/project", json={"view": view}).status_code == 400
    store = client.app.state.studio.store
    store.change("projects", made["id"], view={"guidance": 2, **view})  # as an earlier version kept it
    (shown,) = client.get("/api/about").json()["projects"]
    assert shown["view"] == ({} if "guidance" in view else {"guidance": 2})
    assert client.get(f"/api/projects/{made['id']}").json()["view"] == shown["view"]


@pytest.mark.parametrize(
    "text",
    [
        b'{"version":1,"takes":[' + b"[]," * 20_000_000 + b"[]]}",
        b"[" * 3_000_000 + b"]" * 3_000_000,
        b'{"a":' * 100_000 + b"1" + b"}" * 100_000,
        b'{"version":1,"takes":[' + b"[]," * 1_000_000 + b"[]]}",
        b'{"version":1,"takes":[' + b"1," * 2_000_000 + b"1]}",
    ],
    ids=["60 MB of lists", "deep lists", "deep objects", "3 MB of lists", "4 MB of numbers"],
)
def test_a_project_whose_json_is_huge_or_deep_costs_nothing(client, text):
    data = project(text)
    del text
    tracemalloc.start()
    try:
        answer = send(client, data)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    print(f"{len(data) >> 10} kB: {peak / 1e6:.1f} MB")
    refused(client, answer)
    assert peak < 60e6


@pytest.mark.parametrize(
    ("data", "part"),
    [
        (b"{" * (DEEPEST + 1), "no JSON"),
        (b"[" * (DEEPEST + 1) + b"]" * (DEEPEST + 1), "nested more than"),
        (b"[" + b"1," * MOST_VALUES + b"1]", "values"),
        (b" " * (MOST_BYTES + 1), "4 MiB"),
        (b'["\\"]', "no JSON"),
        (b'"' * 100_001, "no JSON"),
        (b'"' + b'\\"' * 500_000, "no JSON"),
        (b"[NaN]", "no JSON"),
        ('{"a": 1}'.encode("utf-16"), "no JSON"),
        (b"1" * 5000, "no JSON"),
    ],
)
def test_json_is_bounded_before_it_is_parsed(data, part):
    with pytest.raises(OptionError, match=part):
        read_json(data, "it")


def test_a_project_as_it_should_be_is_opened(client):
    made = send(client, sample()).json()
    assert client.get(f"/api/characters/{made['character']}").json()["state"] == "ready" and made["takes"]


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        ("character", {"ends": 5}),
        ("character", {"ends": [{"part": "left_hand", "handle": "x", "point": [0, 0, 0]}]}),
        ("character", {"positions": "abc"}),
        ("character", {"roles": [None]}),
        ("character", {"height": "tall"}),
        ("character", {"axes": 3}),
        ("character", {"bounds": [[0, 0, 0]]}),
        ("character", {"clips": 5}),
        ("character", {"file": "../../x.glb"}),
        ("character", {"file": "mesh.glb"}),
        ("character", {"name": None}),
        ("take", {"script": 5}),
        ("take", {"script": [5]}),
        ("take", {"script": []}),
        ("take", {"how": "transfer", "script": [5]}),
        ("take", {"how": "transfer", "asked": 5}),
        ("take", {"asked": {"pins": [None]}}),
        ("take", {"asked": {"path": "abc"}}),
        ("take", {"how": "edit", "asked": {"pins": [None]}}),
        ("take", {"fps": 0}),
        ("take", {"clip": "../../../x"}),
        ("take", {"was": "another"}),
        ("", {"character": []}),
        ("", {"character": 5}),
        ("", {"takes": 5}),
        ("", {"takes": [5]}),
        ("", {"version": 2}),
        ("", {"version": None}),
    ],
    ids=str,
)
def test_projects_that_say_what_cannot_be(client, kind, changes):
    def change(about):
        {"": about, "character": about["character"], "take": about["takes"][0]}[kind].update(changes)

    refused(client, send(client, sample(change)), "x.bunraku")


def test_a_view_of_a_project_is_put_right(client):
    for wrong in VIEWS["refused"]:
        if "loop" not in wrong:
            view = {"loop": False, **wrong, "wheels": 4}
            made = send(client, sample(lambda about, view=view: about.update(view=view))).json()
            assert made["view"] == {"loop": False}
    assert send(client, sample(lambda about: about.update(view="abc"))).json()["view"] == {}


@pytest.mark.parametrize(
    ("body", "part"),
    [
        ({"script": 5}, "script must be a list"),
        ({"script": [5]}, "script must be an object"),
        ({"path": "abc"}, "path must be a list"),
        ({"pins": [None]}, "pin must be an object"),
        ({"pins": 5}, "pins must be a list"),
        ({"steps": 3.7}, "whole number"),
        ({"seeds": [1e20]}, "seeds are whole numbers"),
        ({"script": [{"text": "", "seconds": 2}]}, "type what the character does"),
        ({"script": [{"text": " ; ", "seconds": 2}]}, "type what the character does"),
        ({"script": [{"text": "walks", "seconds": 2}, {"text": "\n", "seconds": 2}]}, "type what the character does"),
        ({"script": [{"text": "walks;" * 30, "seconds": 100}]}, "more than 20 entries"),
        ({"script": [{"text": "walks", "seconds": 100}, {"text": "waves", "seconds": 100}]}, "at most 120 seconds"),
        ({"wheels": 4}, "has no 'wheels'"),
    ],
)  # fmt: skip
def test_takes_that_cannot_be_asked_for(client, ready, body, part):
    answer = client.post(
        f"/api/characters/{ready}/takes", json={"script": [{"text": "walks", "seconds": 2}], **body}
    )  # fmt: skip
    assert answer.status_code == 400 and part in answer.json()["error"], answer.json()
    assert "--" not in answer.json()["error"] and client.get("/api/jobs").json()["jobs"] == []


@pytest.mark.parametrize("body", [{"star": "no"}, {"deleted": 1}, {"title": 5}, {"title": "x" * 81}, {"seed": 3}])
def test_changes_of_a_take_that_cannot_be(client, ready, body):
    state = client.app.state.studio
    one = state.new_takes(ready, 1, how="animate", script=[{"text": "walks", "seconds": 2}], seeds=[0])[0]["id"]
    assert client.patch(f"/api/takes/{one}", json=body).status_code == 400
    assert client.get(f"/api/takes/{one}").json()["star"] is False


def damaged(data, name):
    """The same ZIP with the stream of an entry broken in its middle, which its directory does not show."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entry = archive.getinfo(name)
    start = entry.header_offset + 30 + len(name)
    middle = start + entry.compress_size // 2
    return data[:middle] + bytes(8) + b"\xff" * 8 + data[middle + 16 :]


def test_a_zip_with_a_damaged_stream_is_refused(client, tmp_path):
    noise = bytes((number * number * 7919) >> 5 & 255 for number in range(40_000))
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("one.glb", noise)
    broken = damaged(data.getvalue(), "one.glb")
    with pytest.raises((zlib.error, zipfile.BadZipFile)), zipfile.ZipFile(io.BytesIO(broken)) as archive:
        archive.read("one.glb")
    refused(client, client.post("/api/characters?name=a.zip", content=broken), "the ZIP is broken")
    assert list((tmp_path / "folder" / "characters").iterdir()) == []
    with zipfile.ZipFile(SAMPLE) as archive:
        names = archive.namelist()
    for name in names:
        refused(client, send(client, damaged(SAMPLE.read_bytes(), name)), "x.bunraku")


def test_a_zip_of_very_many_entries_is_refused_before_its_directory_is_read(client):
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        for number in range(9000):
            archive.writestr(f"{number}{'x' * 300}.png", b"")
    refused(client, client.post("/api/characters?name=a.zip", content=data.getvalue()), "too many files")
    lying = bytearray(data.getvalue())
    lying[-14:-10] = b"\x01\x00\x01\x00"  # says that it has one
    refused(client, client.post("/api/characters?name=a.zip", content=bytes(lying)), "directory is too large")


def test_copies_of_exports_do_not_pile_up(client, ready):
    state = client.app.state.studio
    one = state.new_takes(ready, 1, how="animate", script=[{"text": "walks", "seconds": 2}], seeds=[0])[0]["id"]
    state.store.change("takes", one, state="done")
    for _ in range(10):
        made = client.post(f"/api/takes/{one}/exports", json={"format": "glb"}).json()
        job = state.jobs.get(made["job"])
        state.jobs._waiting.clear()
        state.jobs._end(job, "done", {})
    left = list((state.store.folder / "exports").iterdir())
    assert len(left) <= 4 and made["export"] in [path.name for path in left]


@pytest.mark.parametrize("state", ["waiting", "draft"])
def test_a_take_that_is_cancelled_goes(client, ready, state):
    made = client.post(f"/api/characters/{ready}/takes", json={"script": [{"text": "walks", "seconds": 2}]}).json()
    studio = client.app.state.studio
    studio.store.change("takes", made["takes"][0], state=state)
    client.delete(f"/api/jobs/{made['job']}")
    assert client.get(f"/api/characters/{ready}/takes").json()["takes"] == []


def test_the_page_and_the_server_know_the_same_fields():
    """The names of a view, in the page's source and in the server's dataclass."""
    from dataclasses import fields

    from bunraku.studio.records import View

    source = (Path(__file__).parents[2] / "studio" / "src" / "schema.ts").read_text(encoding="utf-8")
    block = source.partition("const FIELDS")[2].partition("{\n")[2].partition("\n};")[0]
    names = [line.strip().split(":")[0].rstrip(",") for line in block.splitlines() if line.startswith("  ")]
    assert names == [field.name for field in fields(View)]
