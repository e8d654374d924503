"""What comes from elsewhere: project files, views, requests, ZIPs; refused with one sentence, or put right."""

import io
import json
import tracemalloc
import zipfile
import zlib
from dataclasses import is_dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args, get_origin, get_type_hints

import pytest

from bunraku.core.request import DEEPEST, MOST_BYTES, MOST_VALUES, Limit, parse_json, read_json
from bunraku.errors import OptionError
from bunraku.studio.records import View, _CharacterFacts, _TakeFacts, read_view

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
        (b"{" * (DEEPEST + 1), "not JSON"),
        (b"[" * (DEEPEST + 1) + b"]" * (DEEPEST + 1), "nested more than"),
        (b"[" + b"1," * MOST_VALUES + b"1]", "values"),
        (b" " * (MOST_BYTES + 1), "4 MiB"),
        (b'["\\"]', "not JSON"),
        (b'"' * 100_001, "not JSON"),
        (b'"' + b'\\"' * 500_000, "not JSON"),
        (b"[NaN]", "not JSON"),
        ('{"a": 1}'.encode("utf-16"), "not JSON"),
        (b"1" * 5000, "not JSON"),
    ],
)
def test_json_is_bounded_before_it_is_parsed(data, part):
    with pytest.raises(OptionError, match=part):
        read_json(data, "it")


def test_texts_that_no_file_takes_are_repaired():
    assert parse_json(b'{"\\udc80": ["walk\\ud800", "\\ud83d\\ude00", "\\\\ud800"]}') == {
        "\ufffd": ["walk\ufffd", "\U0001f600", "\\ud800"]
    }


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
        ("take", {"seconds": 1e8}),
        ("take", {"seconds": 1e5, "frames": 2_000_000}),
        ("take", {"seconds": 30_000}),
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


def numbers(kind, name=""):
    """The type of each number that a dataclass takes from outside, by its name, with those of the classes inside."""
    for field, hint in get_type_hints(kind, include_extras=True).items():
        yield from numbers_of(hint, f"{name}{field}")


def numbers_of(hint, name):
    if get_origin(hint) is Annotated:
        assert isinstance(hint.__metadata__[0], Limit), name
    elif is_dataclass(hint):
        yield from numbers(hint, f"{name}.")
    elif hint in (int, float):
        yield name
    elif get_origin(hint) is not Literal:
        for inner in get_args(hint):
            yield from numbers_of(inner, name)


@pytest.mark.parametrize("kind", [_CharacterFacts, _TakeFacts, View], ids=lambda kind: kind.__name__)
def test_every_number_from_outside_has_a_bound(kind):
    assert list(numbers(kind)) == []


def test_files_that_many_takes_name_are_stored_once(client):
    def many(about):
        about["takes"] *= 30

    refused(client, send(client, sample(many)), "stored in the same files")


def test_a_project_with_bytes_missing_in_front_is_damaged(client):
    refused(client, send(client, sample()[70_000:]), "the file is damaged")


def test_a_view_of_a_project_is_put_right(client):
    for wrong in VIEWS["refused"]:
        if "loop" not in wrong:
            view = {"loop": False, **wrong, "wheels": 4}
            made = send(client, sample(lambda about, view=view: about.update(view=view))).json()
            assert made["view"] == {"loop": False}
    assert send(client, sample(lambda about: about.update(view="abc"))).json()["view"] == {}


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
    refused(client, client.post("/api/characters?name=a.zip", content=broken), "the file is damaged")
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
