"""Routes of the studio, and its library."""

import io
import threading
import time
import zipfile

import numpy as np
import pytest
from packed import unpacked_clip

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.body.corrections import Corrections, read_corrections
from bunraku.core.request import from_json
from bunraku.generation.library import all_clips, clip
from bunraku.language.parse import parse
from bunraku.pipelines.apply import apply_motion
from bunraku.pipelines.requests import Constraints
from bunraku.studio.forms import Part, TakeForm, read_script
from bunraku.studio.routes.reading import plain_name
from bunraku.studio.takes import DRAFT_STAGES
from bunraku.studio.wire import load_handles
from bunraku.studio.workspace import Workspace


def take(client, owner, **body):
    return client.post(f"/api/characters/{owner}/takes", json={"script": [{"text": "walks", "seconds": 2}], **body})


def test_about_tells_what_it_reads_and_writes(client):
    about = client.get("/api/about").json()
    assert {".glb", ".pmx", ".vrm", ".stl"} <= set(about["reads"]["characters"]) and ".bvh" in about["reads"]["motions"]
    assert {"glb", "bvh", "vrma", "npz"} <= set(about["writes"]) and "dragon" in about["samples"]


def test_a_take_is_queued_and_told(client, ready):
    answer = take(client, ready, seeds=[3, 4, 5, 6])
    assert answer.status_code == 202 and len(answer.json()["takes"]) == 4
    records = client.get(f"/api/characters/{ready}/takes").json()["takes"]
    assert [one["seed"] for one in records] == [3, 4, 5, 6] and {one["state"] for one in records} == {"waiting"}
    (job,) = client.get("/api/jobs").json()["jobs"]
    assert job["state"] == "waiting" and job["about"]["takes"] == answer.json()["takes"] and "params" not in job
    assert client.delete(f"/api/jobs/{job['id']}").json()["state"] == "cancelled"
    assert client.get(f"/api/characters/{ready}/takes").json()["takes"] == []


@pytest.mark.parametrize(
    ("body", "part"),
    [
        ({"script": []}, "type what the character does"),
        ({"script": "walks"}, "script must be a list"),
        ({"script": [{"text": "walks", "seconds": 500}]}, "seconds must be from 0.5 to 120"),
        ({"script": [{"text": "walks", "seconds": "long"}]}, "seconds must be a number"),
        ({"script": [{"text": "blorg zint", "seconds": 2}]}, "no movement is understood"),
        ({"script": [{"text": "x" * 1001, "seconds": 2}]}, "more than 1000 characters"),
        ({"script": [{"text": "x", "seconds": 2, "clip": "no-such"}]}, "no clip 'no-such'"),
        ({"seeds": [-1]}, "seeds are whole numbers"),
        ({"seeds": [0.5]}, "seeds are whole numbers"),
        ({"seeds": list(range(9))}, "more than 8 entries"),
        ({"steps": 0}, "steps must be from 1"),
        ({"steps": True}, "steps must be a number"),
        ({"guidance": 21}, "guidance must be from 0 to 20"),
        ({"apparel": "silk"}, "apparel is one of rigid, simulate, chains, learn"),
        ({"apparel": "learn", "stiffness": 0}, "stiffness must be from 0.001 to 1000"),
        ({"after": "../../x"}, "no such take"),
        ({"path": [[0]]}, "two numbers"),
        ({"path": [[0, 1e9]]}, "must be from -500 to 500"),
        ({"pins": [{"part": "left_hand", "time": 1, "position": [0, 1]}]}, "three numbers"),
        ({"pins": [{"part": "left_hand", "time": 1, "position": [0, 1, 2], "rotation": [1]}]}, "matrix of three"),
    ],
)
def test_what_cannot_be_is_refused_with_a_sentence(client, ready, body, part):
    answer = take(client, ready, **body)
    assert answer.status_code in (400, 404), answer.json()
    assert part in answer.json()["error"]
    assert (
        client.get("/api/jobs").json()["jobs"] == []
        and client.get(f"/api/characters/{ready}/takes").json()["takes"] == []
    )


def test_bodies_have_a_bound(client, ready):
    answer = client.post(f"/api/characters/{ready}/takes", content=b" " * (5 << 20))
    assert answer.status_code == 400 and "4,096 KiB" in answer.json()["error"]


def test_fifty_jobs_wait_and_too_many_are_refused(client, ready):
    for number in range(64):
        assert take(client, ready, seeds=[number]).status_code == 202
    refused = take(client, ready, seeds=[99])
    assert refused.status_code == 429 and "64 jobs are waiting" in refused.json()["error"]
    assert len(client.get(f"/api/characters/{ready}/takes").json()["takes"]) == 64  # none without a job


def test_uploads_have_a_bound_before_and_while_they_come(client, tmp_path):
    told = client.post("/api/characters?name=a.glb", content=b"x", headers={"content-length": str(300 << 20)})
    assert told.status_code == 413 and "200" in told.json()["error"]

    def endless():
        for _ in range(201):
            yield bytes(1 << 20)

    grown = client.post("/api/characters?name=a.glb", content=endless())
    assert grown.status_code == 413
    assert client.get("/api/characters").json()["characters"] == []
    assert list((tmp_path / "folder" / "characters").iterdir()) == []


def test_an_empty_file_leaves_nothing(client):
    answer = client.post("/api/characters?name=a.glb", content=b"")
    assert answer.status_code == 400 and "empty" in answer.json()["error"]
    assert client.get("/api/characters").json()["characters"] == []


@pytest.mark.parametrize(
    ("name", "title", "suffix"),
    [
        ("dragon.glb", "dragon", ".glb"),
        ("../../etc/passwd.GLB", "passwd", ".glb"),
        ("C:\\Users\\me\\a b.Vrm", "a b", ".vrm"),
        ("初音ミク.pmx", "初音ミク", ".pmx"),
        ("..", "character", ""),
        ("\x00<script>.glb", "script", ".glb"),
        ("x" * 500 + ".stl", "x" * 80, ".stl"),
        ("a.b/c", "c", ""),
    ],
)
def test_a_clients_name_is_only_a_title(name, title, suffix):
    assert plain_name(name) == (title, suffix)


def test_the_clients_path_is_used_nowhere(client, tmp_path):
    answer = client.post("/api/characters", params={"name": "../../../../evil.glb"}, content=b"glTF")
    assert answer.status_code == 202 and answer.json()["character"]["file"] == "source/evil.glb"
    assert not list(tmp_path.glob("evil*")) and not list(tmp_path.parent.glob("evil*"))


def packed(**files):
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        for name, content in files.items():
            archive.writestr(name.replace("__", "/"), content)
    return data.getvalue()


def test_a_zip_is_a_character_with_its_textures(client, tmp_path):
    data = packed(**{"model__tex__skin.png": b"png", "model__girl.pmx": b"PMX ", "model__readme.txt": b"no"})
    made = client.post("/api/characters?name=girl.zip", content=data).json()["character"]
    assert made["file"] == "source/model/girl.pmx"
    folder = tmp_path / "folder" / "characters" / made["id"] / "source"
    found = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    assert found == ["model/girl.pmx", "model/tex/skin.png"]


@pytest.mark.parametrize(
    ("data", "part"),
    [
        (b"PK\x03\x04 no", "damaged"),
        (packed(**{"..__..__evil.glb": b"x"}), "outside its folder"),
        (packed(**{"a.txt": b"x"}), "no character in it"),
    ],
)
def test_zips_that_are_refused(client, tmp_path, data, part):
    answer = client.post("/api/characters?name=a.zip", content=data)
    assert answer.status_code == 400 and part in answer.json()["error"]
    assert client.get("/api/characters").json()["characters"] == [] and not list(tmp_path.rglob("evil*"))


def test_a_zip_that_unpacks_to_too_much(client, monkeypatch):
    monkeypatch.setattr("bunraku.studio.routes.reading.MOST_UNPACKED", 1000)
    answer = client.post("/api/characters?name=a.zip", content=packed(**{"a.glb": bytes(100_000)}))
    assert answer.status_code == 400 and "unpacks to too much" in answer.json()["error"]


def test_deleting_is_taken_back(client, ready):
    name = take(client, ready).json()["takes"][0]
    client.delete(f"/api/takes/{name}")
    assert client.get(f"/api/characters/{ready}/takes").json()["takes"] == []
    client.patch(f"/api/takes/{name}", json={"deleted": False, "star": True, "title": "best"})
    (back,) = client.get(f"/api/characters/{ready}/takes").json()["takes"]
    assert back["star"] and back["title"] == "best"


def test_axes_that_cannot_be(client, ready):
    answer = client.patch(f"/api/characters/{ready}", json={"up": "+z", "front": "-z"})
    assert answer.status_code == 400 and "same axis" in answer.json()["error"]
    assert client.patch(f"/api/characters/{ready}", json={"unit": "feet"}).status_code == 400


def test_a_body_is_corrected_by_a_file_beside_it(client, ready):
    state = client.app.state.studio
    file = state.store.folder_of("characters", ready) / "source" / "one.body.toml"
    file.parent.mkdir()
    address = f"/api/characters/{ready}/body"
    answer = client.put(address, json={"joints": {"knee": [0, 0, 0]}})
    assert answer.status_code == 400 and "there is no joint 'knee'" in answer.json()["error"] and not file.exists()
    said = {"front": "-z", "joints": {"left_knee": [0.1, 0.5, 0]}, "part": [{"kind": "prop", "at": [[0, 1, 0]]}]}
    job = client.put(address, json=said).json()["job"]
    assert read_corrections(file.with_name("one.glb")) == from_json(Corrections, said)
    assert "wait for it" in client.delete(address).json()["error"]
    client.delete(f"/api/jobs/{job}")
    assert client.delete(address).status_code == 202 and not file.exists()


def test_a_character_is_turned_before_the_takes_that_wait(client, ready):
    made, turned = take(client, ready).json()["job"], {"json": {"up": "+z", "front": "-y"}}
    opened = client.patch(f"/api/characters/{ready}", **turned).json()["job"]
    assert list(client.app.state.studio.jobs._waiting) == [opened, made]
    answer = client.patch(f"/api/characters/{ready}", json={"up": "-z"})
    assert answer.status_code == 400 and "wait for it" in answer.json()["error"]
    assert client.patch(f"/api/characters/{ready}", json={"name": "two"}).json()["name"] == "two"


def test_what_is_understood_comes_with_places(client):
    found = client.post("/api/understand", json={"text": "walks forward zorply"}).json()
    assert found["ok"] and len(found["nearest"]) == 3
    assert found["unknown"] == [{"word": "zorply", "start": 14, "stop": 20}]


def test_projects_keep_how_the_page_stood(client):
    made = client.post("/api/projects", json={"view": {"seed": 3}}).json()
    client.put(f"/api/projects/{made['id']}", json={"view": {"seed": 4}})
    assert client.get(f"/api/projects/{made['id']}").json()["view"] == {"seed": 4}
    assert client.get("/api/about").json()["projects"][0]["view"] == {"seed": 4}
    client.delete(f"/api/projects/{made['id']}")
    assert client.get(f"/api/projects/{made['id']}").status_code == 404


def test_changes_need_something_kept(client, ready):
    state = client.app.state.studio
    one = state.new_takes(ready, 1, how="animate", script=[{"text": "walks", "seconds": 2}], seeds=[0])[0]["id"]
    ask = lambda **body: client.post(f"/api/takes/{one}/change", json=body)  # noqa: E731
    assert "not finished" in ask(prompt="waves", keep=["legs"]).json()["error"]
    state.store.change("takes", one, state="done", skin="handles")
    assert "nothing is kept" in ask(prompt="waves").json()["error"]
    assert "type what is done instead" in ask().json()["error"]
    assert ask(prompt="waves", keep=["wheels"]).status_code == 400
    assert "a span is two seconds" in ask(prompt="waves", span=[1]).json()["error"]
    assert ask(prompt="waves", keep=["legs"], span=[0.5, 1.5], poses=[{"time": 1}]).status_code == 202
    assert ask(pins=[{"part": "left_hand", "time": 1, "position": [0, 1, 0]}]).status_code == 202
    assert ask(apparel="silk").status_code == 400


def test_a_take_is_dressed_anew_and_what_comes_of_it_stays_dressed(client, ready):
    state = client.app.state.studio
    asked = {"apparel": "rigid", "in_place": True}
    one = state.new_takes(ready, 1, how="animate", script=[{"text": "walks", "seconds": 2}], seeds=[7], asked=asked)
    name = one[0]["id"]
    state.store.change("takes", name, state="done", skin="handles", stiffness=None)
    made = client.post(f"/api/takes/{name}/change", json={"apparel": "learn", "stiffness": 3}).json()
    record = client.get(f"/api/takes/{made['takes'][0]}").json()
    assert (record["how"], record["parent"], record["seed"]) == ("dress", name, 7)
    assert record["asked"] == {"apparel": "learn", "stiffness": 3, "gravity": 1.0, "in_place": True}
    params = state.jobs.get(made["job"])["params"]
    assert (params["parent"], params["apparel"], params["stiffness"], params["in_place"]) == (name, "learn", 3, True)
    state.store.change("takes", name, stiffness=3.0)  # as the worker tells it of a dressed one
    bent = client.post(
        f"/api/takes/{name}/change", json={"pins": [{"part": "left_hand", "time": 1, "position": [0, 1, 0]}]}
    ).json()
    params = state.jobs.get(bent["job"])["params"]
    assert (params["apparel"], params["stiffness"]) == ("learn", 3.0)


@pytest.mark.parametrize("stiffness", ["soft", "0", "nan"])
def test_the_stiffness_of_an_address_is_checked(client, ready, stiffness):
    answer = client.post(
        f"/api/characters/{ready}/transfer?name=a.bvh&apparel=learn&stiffness={stiffness}", content=b"x"
    )
    assert answer.status_code == 400 and "stiffness must be" in answer.json()["error"]
    assert client.get(f"/api/characters/{ready}/takes").json()["takes"] == []


def test_a_sequence_typed_as_one_text_is_that_of_the_command_line():
    typed = "walks:4; jumps:2; waves:3"
    found = TakeForm(script=(Part(typed, 5),)).request()
    assert found.sampling.seconds == 9 and found.parsed.clauses == parse(typed).clauses
    assert read_script([Part("walks; jumps:2", 5)]) == (Part("walks", 5), Part("jumps", 2))


def test_a_sequence_typed_as_one_text_makes_a_take_of_its_parts(client, ready):
    parts = [{"text": "walks", "seconds": 4}, {"text": "jumps", "seconds": 2}, {"text": "waves", "seconds": 3}]
    made = take(client, ready, script=[{"text": "walks:4; jumps:2; waves:3", "seconds": 5}]).json()
    assert made["script"] == parts
    assert client.get(f"/api/takes/{made['takes'][0]}").json()["script"] == parts


def test_who_asks_does_not_wait_for_the_disk(client, ready):
    """While the disk takes nothing, requests that write wait for it, and all others are answered."""
    state, found = client.app.state.studio, []
    script = {"script": [{"text": "walks", "seconds": 2}]}
    writers = [
        threading.Thread(target=client.patch, args=(f"/api/characters/{ready}",), kwargs={"json": {"name": "other"}}),
        threading.Thread(target=client.post, args=(f"/api/characters/{ready}/takes",), kwargs={"json": script}),
        threading.Thread(target=client.post, args=("/api/projects",), kwargs={"json": {"view": {}}}),
    ]
    asked = threading.Thread(target=lambda: found.append(client.get("/api/about").json()), daemon=True)
    with state.store._lock:  # which who writes has until the disk has taken it
        for one in writers:
            one.daemon = True
            one.start()
        time.sleep(0.5)
        asked.start()
        asked.join(30)
        assert found and found[0]["characters"][0]["name"] == "one"
    for one in writers:
        one.join(30)
    assert client.get("/api/about").json()["characters"][0]["name"] == "other"
    assert len(client.get("/api/jobs").json()["jobs"]) == 1


def test_clips_are_found_with_their_credits(client):
    found = client.get("/api/clips", params={"q": "waves hello"}).json()["clips"]
    assert found[0]["name"] == "wave-hello" and all(one["credit"] and one["terms"] for one in found)
    assert len(client.get("/api/clips").json()["clips"]) == len(all_clips())
    music = client.get("/api/clips", params={"tag": "music"}).json()["clips"]
    assert "violin" in [one["name"] for one in music] and len(music) < 20
    assert client.get("/api/clips", params={"q": "x" * 1001}).status_code == 400
    said = client.post("/api/understand", json={"text": "somebody applauds"}).json()
    assert said["clips"][0] == "clap"


@pytest.mark.parametrize(
    "body",
    [{}, {"clips": []}, {"clips": ["no-such"]}, {"clips": [5]}, {"clips": ["../../x"]}, {"clips": ["wave"] * 49}],
)
def test_what_cannot_be_shown_is_refused(client, ready, body):
    assert client.post(f"/api/characters/{ready}/clips", json=body).status_code == 400
    assert client.get(f"/api/characters/{ready}/clips/..%2Frecord.json").status_code in (400, 404)


def test_a_moment_of_work_goes_first_and_is_not_kept(client, ready):
    jobs = client.app.state.studio.jobs
    slow = client.post(f"/api/characters/{ready}/takes", json={"script": [{"text": "walks", "seconds": 2}]}).json()
    quick = client.post(f"/api/characters/{ready}/clips", json={"clips": ["wave"]}).json()
    assert list(jobs._waiting) == [quick["job"], slow["job"]]
    assert [one["id"] for one in client.app.state.studio.store.all("jobs")] == [slow["job"]]


def test_a_preview_is_the_clip_on_the_character(studio):
    owner = studio.get("/api/characters")["characters"][0]["id"]
    studio.wait(studio.post(f"/api/characters/{owner}/clips", {"clips": ["bow", "wave"]}))
    assert studio.post(f"/api/characters/{owner}/clips", {"clips": ["bow"]}) == {"job": None}
    _, data = studio.ask("GET", f"/api/characters/{owner}/clips/bow")
    fps, _, rotations = unpacked_clip(data)
    character, handles = Workspace(str(studio.folder)).character(owner)
    fitted = apply_motion(clip("bow").motion(), Anatomy.of(character, handles), Constraints(), DRAFT_STAGES).motion
    assert fps == 10 and abs(len(rotations) / fps - clip("bow").seconds) < 0.2
    from bunraku.core.geometry.rotations import matrix_from_quaternion

    np.testing.assert_allclose(matrix_from_quaternion(rotations[::4, 0]), fitted.root_rotation[::8], atol=1e-4)


def take_of(studio, made):
    studio.done(made["job"])
    folder = studio.folder / "takes" / made["takes"][0]
    owner = studio.get("/api/takes/" + made["takes"][0])["character"]
    character, handles = Workspace(str(studio.folder)).character(owner)
    from bunraku.studio.wire import load_take

    assert load_handles(studio.folder / "characters" / owner / "handles.npz")
    return load_take(folder / "motion.npz", character, handles)


def test_clips_and_sentences_follow_each_other(studio):
    owner = studio.get("/api/characters")["characters"][0]["id"]
    script = [
        {"text": "runs", "seconds": 2, "clip": "run"},
        {"text": "jumps", "seconds": 2},
        {"text": "bows", "seconds": 3.8, "clip": "bow"},
    ]
    made = studio.post(f"/api/characters/{owner}/takes", {"script": script, "seeds": [0], "steps": 4, "candidates": 1})
    assert made["script"] == script
    take = take_of(studio, made)
    motion = take.motion
    assert len(motion) == 156
    step = np.linalg.norm(np.diff(motion.root_translation[:, [0, 2]], axis=0), axis=1) * 20
    size = take.character.height / 1.7
    assert step[5:35].mean() > 1.5 * size  # it runs
    assert step[120:].mean() < 0.3 * size  # it bows where it is
    turned = np.einsum("nkij,nkij->nk", motion.rotations[1:], motion.rotations[:-1])
    angle = np.degrees(np.arccos(np.clip((turned - 1) / 2, -1, 1)))
    seams = angle[[39, 40, 79, 80]].max()
    assert seams < 60 and seams <= 1.5 * np.quantile(angle, 0.999)  # no jump where they meet


def test_a_clip_that_loops_ends_where_it_begins(studio):
    owner = studio.get("/api/characters")["characters"][0]["id"]
    script = [{"text": "runs", "seconds": 3, "clip": "run"}]
    body = {"script": script, "loop": True, "in_place": True}
    motion = take_of(studio, studio.post(f"/api/characters/{owner}/takes", body)).motion
    inner = np.abs(np.diff(motion.rotations, axis=0)).max(axis=(1, 2, 3)).max()
    assert np.abs(motion.rotations[0] - motion.rotations[-1]).max() <= 1.2 * inner


def test_a_take_is_mirrored_and_cut(studio):
    owner = studio.get("/api/characters")["characters"][0]["id"]
    script = [{"text": "salutes", "seconds": 2.5, "clip": "salute"}]
    made = studio.post(f"/api/characters/{owner}/takes", {"script": script})
    motion, name = take_of(studio, made).motion, made["takes"][0]
    mirrored = studio.post(f"/api/takes/{name}/change", {"mirror": True})
    other = take_of(studio, mirrored).motion
    turned = [np.linalg.norm(one.rotations - one.rotations[:1], axis=(2, 3)).max(axis=0) for one in (motion, other)]
    left, right = 18, 19  # elbows
    assert turned[0][right] > 2 * turned[0][left] and turned[1][left] > 2 * turned[1][right]
    cut = take_of(studio, studio.post(f"/api/takes/{name}/change", {"trim": [0.5, 1.5]})).motion
    np.testing.assert_array_equal(cut.rotations, motion.rotations[10:30])
    for trim in ([1, 1], [2, 1], [-1, 1], [0], "all"):
        assert studio.ask("POST", f"/api/takes/{name}/change", {"trim": trim})[0] == 400
    gone = studio.post(f"/api/takes/{name}/change", {"trim": [100, 110]})
    assert "nothing is left" in studio.ended(gone["job"])["error"]


def test_a_character_has_a_picture_when_the_page_drew_one(client, ready):
    webp = b"RIFF\x00\x00\x00\x00WEBPVP8 "
    client.app.state.studio.note("characters", ready, state="opening")  # turned a moment after it was drawn
    assert client.put(f"/api/characters/{ready}/picture", content=webp).json()["picture"] == 1
    answer = client.get(f"/api/characters/{ready}/picture")
    assert answer.content == webp and answer.headers["content-type"] == "image/webp"
    for data, status in ((b"<svg onload=alert(1)>", 400), (b"\x89PNG" + bytes(200_000), 413), (b"", 400)):
        assert client.put(f"/api/characters/{ready}/picture", content=data).status_code == status


def test_what_nobody_waits_for_goes_last(client, ready):
    state = client.app.state.studio
    state.find_out(ready)
    made = client.post(f"/api/characters/{ready}/takes", json={"script": [{"text": "walks", "seconds": 2}]}).json()
    assert list(state.jobs._waiting) == [made["job"]] and len(state.jobs._later) == 1
    (later,) = state.jobs._later
    assert client.delete(f"/api/jobs/{later}").json()["state"] == "cancelled" and not state.jobs._later
