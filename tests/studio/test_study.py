"""The blind study: made without a trace, shown in a balanced order, evaluated with known answers."""

import itertools
import json

import numpy as np
import pytest
from scipy.stats import friedmanchisquare

from bunraku.cli import main
from bunraku.core.animation import Animation
from bunraku.core.motion import HandleMotion
from bunraku.errors import FormatError, OptionError
from bunraku.formats.gltf.container.open import open_document
from bunraku.io.play import load_animation
from bunraku.pipelines.animate import rig
from bunraku.samples import sample_character
from bunraku.studio.study.answers import FROZEN, QUESTIONS, load_answers, load_study
from bunraku.studio.study.make import Line, make_study, read_lines
from bunraku.studio.study.show import Session, placed, trial_order
from bunraku_lab.evaluation.study.ranks import left_out, outcome

METHODS = ("ours", "mdm-sr", "mdm-sfr")


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    character = sample_character("mushroom")
    handles = rig(character)
    for shift, method in enumerate(METHODS):
        (folder / method).mkdir()
        for number in (1, 2, 3):
            frames = 20 + shift
            path = np.zeros((frames, 3))
            path[:, 2] = np.linspace(0, number + shift, frames)
            motion = HandleMotion(
                np.zeros((frames, 30, 3)), np.broadcast_to(np.eye(3), (frames, 30, 3, 3)), path,
                np.broadcast_to(np.eye(3), (frames, 3, 3)),
            )  # fmt: skip
            Animation(character, handles, motion).save(folder / method / f"{number}.glb", name=f"secret {method}")
    lines = [Line("mushroom.glb", prompt) for prompt in ("walks", "runs", "hops")]
    return make_study({method: folder / method for method in METHODS}, lines, folder / "study")


def test_a_study_has_every_trial_and_two_checks(study):
    found = load_study(study)
    assert len(found.trials) == 5 and found.compared == sorted(METHODS)
    assert sum(found.is_check(trial["id"]) for trial in found.trials) == 2
    assert list(found.methods.values()).count(FROZEN) == 1
    for trial in found.trials:
        assert len(trial["clips"]) == 3 and all((study / "clips" / f"{clip}.glb").is_file() for clip in trial["clips"])


def test_clips_tell_nothing_of_their_makers(study):
    found = load_study(study)
    trees, lengths = [], []
    for clip in found.methods:
        path = study / "clips" / f"{clip}.glb"
        data = path.read_bytes()
        tree = open_document(path, data).tree
        assert tree["asset"] == {"version": "2.0"}
        for word in (*METHODS, "secret", "bunraku", "left_wrist", "mushroom"):
            assert word.encode() not in data
        trees.append((len(tree["skins"][0]["joints"]), sorted(tree), len(tree["nodes"])))
        lengths.append(len(load_animation(path, 0, 20.0).motion))
    assert len(set(map(str, trees))) == 1 and set(lengths) == {20}
    assert not set(json.loads((study / "study.json").read_text())["trials"][0]) & {"method", "methods"}


def test_clips_move_as_they_did_and_the_frozen_one_does_not(study):
    found = load_study(study)
    for clip, method in found.methods.items():
        vertices = load_animation(study / "clips" / f"{clip}.glb", 0, 20.0).vertices([0, 10])
        way = float(np.abs(vertices[1] - vertices[0]).max())
        assert (way < 1e-6) == (method == FROZEN)


@pytest.mark.parametrize("count", [3, 4, 5, 8])
def test_orders_are_latin_squares(count):
    rows = np.array([trial_order(person, count) for person in range(count)])
    whole = list(range(count))
    assert all(sorted(row) == whole for row in rows) and all(sorted(column) == whole for column in rows.T)
    if count % 2 == 0:  # each follows each other once
        pairs = [pair for row in rows.tolist() for pair in itertools.pairwise(row)]
        assert len(set(pairs)) == count * (count - 1)


def test_each_clip_stands_at_each_place_equally_often():
    rows = [tuple(placed(person, trial, 3)) for person in range(6) for trial in range(3)]
    assert set(rows) == set(itertools.permutations(range(3))) and len(set(map(rows.count, rows))) == 1


def answered(session, person, score):
    """A participant who ranks by a score of the method, for all trials."""
    found = session.next("")
    name = found["participant"]
    while "trial" in found:
        clips = found["trial"]["clips"]
        order = sorted(clips, key=lambda clip: score(session.study.methods[clip], person))
        ranks = {question: {clip: order.index(clip) + 1 for clip in clips} for question in QUESTIONS}
        session.answer(name, found["trial"]["id"], ranks, 3.0)
        found = session.next(name)
    return name


def test_answers_are_ranked_and_checked(study, capsys):
    session = Session(study)
    liked = {"ours": 0, "mdm-sr": 1, "mdm-sfr": 2, FROZEN: 9}
    for person in range(5):
        answered(session, person, lambda method, _: liked[method])
    careless = answered(session, 5, lambda method, _: -liked[method])  # the frozen one first
    found = load_study(study)
    answers = load_answers(found)
    assert len(answers) == 30 and list(left_out(found, answers)) == [careless]
    result = outcome(found, answers)
    assert result.people == 5 and result.comparisons == 15
    ranks = result.ranks["overall"]
    assert [ranks[method].mean for method in METHODS] == [1, 2, 3] and ranks["ours"].firsts == 1
    assert (ranks["ours"].low, ranks["ours"].high) == (1, 1)
    assert result.p_values["text"] == pytest.approx(friedmanchisquare([1] * 5, [2] * 5, [3] * 5).pvalue)
    assert main(["evaluate", "study", str(study)]) == 0
    said = capsys.readouterr().out
    assert "5 people, 15 comparisons" in said and "ours     1.00 (1.00 to 1.00)" in said and careless in said


def test_who_turns_a_repeated_trial_round_is_left_out(tmp_path, study):
    found = load_study(study)
    ((again, first),) = found.repeats.items()
    lines = []
    for trial in (first, again):
        clips = sorted(found.trial(trial)["clips"], key=lambda clip: found.methods[clip], reverse=trial == again)
        ranks = {question: {clip: index + 1 for index, clip in enumerate(clips)} for question in QUESTIONS}
        lines.append(json.dumps({"participant": "p0", "trial": trial, "ranks": ranks}))
    for name in ("study.json", "key.json"):
        (tmp_path / name).write_text((study / name).read_text())
    (tmp_path / "answers.jsonl").write_text("\n".join(lines) + "\n" + '{"cut')
    again_found = load_study(tmp_path)
    assert "the other way round" in left_out(again_found, load_answers(again_found))["p0"]


def test_answers_that_are_none_are_refused(study):
    session = Session(study)
    found = session.next("")
    name, trial = found["participant"], found["trial"]
    whole = {question: {clip: index + 1 for index, clip in enumerate(trial["clips"])} for question in QUESTIONS}
    same = {question: dict.fromkeys(trial["clips"], 1) for question in QUESTIONS}
    for ranks in ({}, same, {"overall": whole["overall"]}, None, {question: [1, 2, 3] for question in QUESTIONS}):
        with pytest.raises(OptionError):
            session.answer(name, trial["id"], ranks, 1)
    with pytest.raises(OptionError, match="no such participant"):
        session.answer("../x", trial["id"], whole, 1)
    session.answer(name, trial["id"], whole, 1)
    with pytest.raises(OptionError, match="answered already"):
        session.answer(name, trial["id"], whole, 1)


def test_lines_that_are_none(tmp_path):
    path = tmp_path / "lines.txt"
    for text in ("walks", "../x.glb: walks", "# nothing", "a.glb:"):
        path.write_text(text)
        with pytest.raises(FormatError):
            read_lines(path)
    path.write_text("# three\na.glb: walks: fast\n\nb.glb: runs\n")
    assert read_lines(path) == [Line("a.glb", "walks: fast"), Line("b.glb", "runs")]


def test_the_routes_show_it_and_tell_no_method(study, tmp_path):
    pytest.importorskip("httpx2", reason="Starlette's test client needs httpx2")
    from starlette.testclient import TestClient

    from bunraku.studio.server.app import studio_app
    from bunraku.studio.server.safety import Keys

    app = studio_app(tmp_path / "folder", Keys(token="secret"), study, warm=False)
    with TestClient(app, base_url="http://localhost:1", headers={"authorization": "Bearer secret"}) as client:
        found = client.get("/api/study").json()
        assert not any(method in json.dumps(found) for method in METHODS)
        clip = client.get(f"/api/study/clips/{found['trial']['clips'][0]}")
        assert clip.content[:4] == b"glTF"
        assert client.get("/api/study/clips/..%2fkey.json").status_code in (400, 404)
        assert client.get("/api/about").json()["study"] is True
