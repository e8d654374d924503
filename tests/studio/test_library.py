"""Clips of the library in the studio: found, shown on a character, and played among sentences."""

import numpy as np
import pytest

from bunraku.anatomy.anatomy import Anatomy
from bunraku.clips import all_clips, clip
from bunraku.pipelines.apply import apply_motion
from bunraku.pipelines.requests.constraints import Constraints
from bunraku.studio.tasks.making import DRAFT_STAGES
from bunraku.studio.workspace.clips import load_handles, unpacked_clip
from bunraku.studio.workspace.workspace import Workspace


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


def test_a_script_with_a_clip_that_is_none_is_refused(client, ready):
    script = [{"text": "x", "seconds": 2, "clip": "no-such"}]
    refused = client.post(f"/api/characters/{ready}/takes", json={"script": script})
    assert refused.status_code == 400 and "no clip 'no-such'" in refused.json()["error"]


def test_a_preview_is_the_clip_on_the_character(studio):
    owner = studio.get("/api/characters")["characters"][0]["id"]
    made = studio.post(f"/api/characters/{owner}/clips", {"clips": ["bow", "wave"]})
    studio.done(made["job"])
    assert studio.post(f"/api/characters/{owner}/clips", {"clips": ["bow"]}) == {"job": None}
    _, data = studio.ask("GET", f"/api/characters/{owner}/clips/bow")
    fps, _, rotations = unpacked_clip(data)
    character, handles = Workspace(str(studio.folder)).character(owner)
    fitted = apply_motion(clip("bow").motion(), Anatomy.of(character, handles), Constraints(), DRAFT_STAGES).motion
    assert fps == 10 and abs(len(rotations) / fps - clip("bow").seconds) < 0.2
    from bunraku.geometry.rotations import matrix_from_quaternion

    np.testing.assert_allclose(matrix_from_quaternion(rotations[::4, 0]), fitted.root_rotation[::8], atol=1e-4)


def take_of(studio, made):
    studio.done(made["job"])
    folder = studio.folder / "takes" / made["takes"][0]
    owner = studio.get("/api/takes/" + made["takes"][0])["character"]
    character, handles = Workspace(str(studio.folder)).character(owner)
    from bunraku.studio.workspace.clips import load_take

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
