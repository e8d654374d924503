"""Training rows: clips, rare events, joined clips, sentences of stretches."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.errors import FormatError
from bunraku.generation.features import ROOT_SIZE, FeatureStatistics, decode, mirror
from bunraku_lab.description.captions import creature_variants
from bunraku_lab.description.phrases import Phrase
from bunraku_lab.training.rows.clip_rows import ENOUGH, ClipSet, EventPool, Mixture, link
from bunraku_lab.training.rows.clips import TrainingClip, load_clips, stretch_variants


def entry(features, text, split="train"):
    return {"features": features, "texts": [text], "split": split}


@pytest.fixture
def clips(features):
    found = {
        "wave": entry(features("left_elbow"), "a person waves with the left hand"),
        "kick": entry(features("right_knee", frames=90), "kick"),
        "walk": entry(features("spine1", frames=37), "walk"),
    }
    statistics = FeatureStatistics.measure([clip["features"] for clip in found.values()])
    return lambda **how: ClipSet(found, statistics, frames=120, mixture=Mixture(**how))


def activity(values, statistics, handle):
    start = ROOT_SIZE + 9 * (HANDLE_NAMES.index(handle) - 1)
    return float(statistics.restore(values)[:, start + 3 : start + 9].std(0).max())


def test_a_batch_is_a_function_of_its_seed_and_number(clips):
    in_order, any_order = clips(), clips()
    first = [in_order.batch(3, number, 6, 0.3) for number in range(6)]
    for number in (5, 0, 3):
        again = any_order.batch(3, number, 6, 0.3)
        np.testing.assert_array_equal(again.values, first[number].values)
        assert again.sentences == first[number].sentences and (again.lengths == first[number].lengths).all()
    other = clips().batch(4, 0, 6, 0.3)
    assert other.sentences != first[0].sentences or other.values.shape != first[0].values.shape


def test_a_mirrored_motion_gets_the_mirrored_words(clips):
    found, random, sides = clips(), np.random.default_rng(0), set()
    for _ in range(60):
        values, sentence, mesh, _clips = found.draw(random)
        assert mesh is None
        if "hand" in sentence:
            left, right = (activity(values, found.statistics, f"{side}_elbow") for side in ("left", "right"))
            side = "left" if left > right else "right"
            sides.add(side)
            assert side in sentence and max(left, right) > 5 * min(left, right)
    assert sides == {"left", "right"}


def test_clips_that_loop_are_lengthened_without_a_jump(clips):
    found, random = clips(), np.random.default_rng(1)
    longest = 0
    for _ in range(40):
        values = found.draw(random).values
        longest = max(longest, len(values))
        clip = max(np.abs(np.diff(one.values, axis=0)).max() for one in found.clips)
        assert np.abs(np.diff(values, axis=0)).max() < 1.05 * clip
    assert longest == 120


def test_folders_are_read_by_split_and_faults_are_named(swings):
    clips = load_clips(swings)
    assert (
        len(clips) == 12
        and clips["waves_0"]["features"].shape == (60, 271)
        and clips["waves_0"]["texts"] == ["the figure waves"]
    )
    assert sorted(load_clips(swings, splits={"test"})) == ["bows_2", "kicks_2", "nods_2", "waves_2"]
    (swings / "bows_0.npz").write_bytes((swings / "bows_0.npz").read_bytes()[:300])
    with pytest.raises(FormatError, match=r"bows_0\.npz.*bunraku data motions"):
        load_clips(swings)
    index = json.loads((swings / "index.json").read_text())
    index["clips"]["../secret"] = {"texts": ["x"]}
    (swings / "index.json").write_text(json.dumps(index))
    with pytest.raises(FormatError, match="plain name"):
        load_clips(swings)
    (swings / "index.json").write_text("[1")
    with pytest.raises(FormatError, match="missing or damaged"):
        load_clips(swings)


@pytest.fixture
def zoo(features, tmp_path):
    """People who wave and walk; a horse that gallops, walks and eats, twice, and a crow that flies."""
    found = {
        "wave": entry(features("left_elbow"), "a person waves with the left hand"),
        "walk": entry(features("spine1", frames=70), "walk"),
        "rest": entry(features("head", frames=70, height=0.05), "idle"),
        "crow_fly": entry(features("left_wing", frames=40), "a crow flies")
        | {"species": "crow", "action": "fly", "character": "birds/Crow"},
    }
    for number, (action, part) in enumerate((("gallop", "left_knee"), ("walk", "left_ankle"), ("eat", "head"))):
        for name in ("Horse", "Pony") if action == "walk" else ("Horse",):
            entries = entry(features(part, frames=30 + 3 * number), f"a horse does {action}")
            found[f"{name}_{action}"] = entries | {"species": "horse", "action": action, "character": f"animals/{name}"}
    statistics = FeatureStatistics.measure([clip["features"] for clip in found.values()])
    return lambda **how: ClipSet(found, statistics, frames=120, mixture=Mixture(**{"borrowed": 0.0, **how}))


def test_creatures_are_a_share_of_the_draws_evenly_over_species_and_actions(zoo):
    found = zoo(creatures=0.4)
    chance = dict(zip((clip.name for clip in found.clips), found.probability, strict=True))
    assert sum(chance.values()) == pytest.approx(1)
    assert sum(chance[name] for name in chance if name.startswith(("Horse", "Pony", "crow"))) == pytest.approx(0.4)
    assert chance["crow_fly"] == chance["Horse_gallop"] == chance["Horse_eat"] == pytest.approx(0.1)
    assert chance["Horse_walk"] == chance["Pony_walk"] == pytest.approx(0.05)


def test_rows_carry_the_mesh_and_the_words_of_their_creature(zoo):
    found, random = zoo(computed=0.0, creatures=0.5), np.random.default_rng(0)
    horses = {sentence for action in ("gallop", "walk", "eat") for sentence in creature_variants("horse", action)}
    horses |= {f"a horse does {action}" for action in ("gallop", "walk", "eat")}
    meshes = set()
    for _ in range(150):
        _values, sentence, mesh, _clips = found.draw(random)
        meshes.add(mesh)
        if mesh is None:
            assert not any(word in sentence for word in ("horse", "pony", "crow", "creature"))
        elif mesh.startswith("animals"):
            assert sentence in horses
        else:
            assert (
                sentence in creature_variants("crow", "fly")
                or sentence == "a crow flies"
                or sentence.startswith("a crow")
            )
    assert meshes == {None, "animals/Horse", "animals/Pony", "birds/Crow"}
    batch = found.batch(0, 0, 12)
    assert len(batch.meshes) == len(batch.sentences) == 12 and set(batch.meshes) <= meshes
    assert found.fixed(8).meshes.count(None) == 3


def test_creatures_are_joined_with_themselves_only(zoo):
    found, random, seen = zoo(computed=0.0, creatures=0.6), np.random.default_rng(3), set()
    for _ in range(150):
        row = found.draw(random, compose=1.0)
        horse = any(
            word in row.sentence for word in ("gallop", "graz", "nibbl", "munch", "eat", "feed", "horse", "pony")
        )
        person = any(word in row.sentence for word in ("wav", "hand", "idle", "still"))
        assert not (horse and person), row.sentence
        if row.mesh == "animals/Horse":
            seen.add(row.sentence)
        assert row.mesh != "birds/Crow" or "then" not in row.sentence
    assert any("gallop" in one and "then" in one for one in seen)


def test_a_creature_may_do_what_only_people_show(zoo):
    found, random = zoo(computed=0.0, borrowed=1.0, creatures=0.3), np.random.default_rng(4)
    rows = [found.draw(random) for _ in range(200)]
    waves = [row for row in rows if "wav" in row.sentence and row.mesh]
    assert any(word in row.sentence for row in waves for word in ("horse", "crow")) and any(
        row.sentence.startswith("a person") for row in waves
    )
    # a walk is something that a horse shows by itself, so only the crow can borrow it
    walk = next(clip for clip in found.clips if clip.name == "walk").values
    borrowed = {row.mesh for row in rows if any(np.array_equal(row.values, one) for one in (walk, mirror(walk)))}
    assert borrowed == {"birds/Crow"}


def walker(frames, turn):
    """Features of a root that goes ahead for a while, then turns by so many radians within a second."""
    from bunraku.generation.features import FEATURE_SIZE

    values = np.zeros((frames, FEATURE_SIZE), np.float32)
    values[:, 4], values[:, 8] = 1, 1
    values[:, ROOT_SIZE + 3 :: 9], values[:, ROOT_SIZE + 7 :: 9] = 1, 1
    values[:50, 2] = 1.0
    values[60:80, 0] = turn
    return values


def test_computed_words_are_true_of_the_row_and_of_its_mirror_image():
    found = {
        "left": entry(walker(100, 1.7), "a person plays basketball"),
        "bull": entry(walker(100, -1.7), "x") | {"species": "bull", "action": "walk", "character": "animals/Bull"},
    }
    statistics = FeatureStatistics.measure([clip["features"] for clip in found.values()])
    clips, random = (
        ClipSet(found, statistics, frames=100, mixture=Mixture(computed=1.0, borrowed=0.0, creatures=0.5)),
        np.random.default_rng(0),
    )
    told = {None: 0, "animals/Bull": 0}
    for _ in range(120):
        values, sentence, mesh, _clips = clips.draw(random)
        rate = statistics.restore(values)[:, 0]
        sides = {side for side, sign in (("left", 1), ("right", -1)) if (sign * rate).max() > 1}
        if "left" in sentence or "right" in sentence:
            assert sides and {side for side in ("left", "right") if side in sentence} <= sides, sentence
            told[mesh] += 1
            assert mesh or "bull" not in sentence
        if len(values) == 100 and "turn" in sentence:
            assert sentence.index("turn") > max(sentence.find("forward"), sentence.find("ahead"))
    assert min(told.values()) > 10


def test_captions_by_time_make_stretches_and_what_is_done_once_is_not_looped(swings, features):
    index = json.loads((swings / "index.json").read_text())
    entry = index["clips"]["waves_0"]
    entry["stretches"] = [
        {"start": 0, "stop": 25, "texts": ["a person raises an arm and then lowers it", "raise arm"]},
        {"start": 25, "stop": 60, "texts": ["a person waves", "wave"], "asked": ["make him wave with the left hand"]},
        {"start": 40, "stop": 60, "texts": ["a person is frozen"], "fault": "frozen"},
    ]
    (swings / "index.json").write_text(json.dumps(index))
    clips = load_clips(swings)
    assert {name for name in clips if name.startswith("waves_0")} == {"waves_0@0", "waves_0@25"}
    assert clips["waves_0@0"]["features"].shape == (25, 271) and clips["waves_0@0"]["next"] == "waves_0@25"
    assert clips["waves_0@25"]["texts"] == ["a person waves", "wave"] and "next" not in clips["waves_0@25"]
    statistics = FeatureStatistics.measure([clip["features"] for clip in clips.values()])
    found = {clip.name: clip for clip in ClipSet(clips, statistics, "train").clips}
    assert found["waves_0@0"].loop is None  # "then" is not true of a motion that is played twice
    assert found["waves_0@0"].actions == ("raise arm",) and found["waves_0@25"].actions == ("wave",)
    assert "make him wave with the left hand" in found["waves_0@25"].sentences()
    assert "make him wave with the right hand" in found["waves_0@25"].sentences(mirrored=True)


def test_who_lies_is_not_straightened_by_what_cuts_off_faults_of_capture(features):
    standing = features("left_elbow", frames=40)
    units = FeatureStatistics.measure([standing])
    lying = standing.copy()
    lying[:, 4:10] = [1, 0, 0, 0, 0, -1]  # on the back: y points to -z
    lying[20, 1] = 500.0
    clip = TrainingClip.prepare("lying", {"features": lying, "texts": ["a person lies"]}, units, 196)
    np.testing.assert_allclose(units.restore(clip.values)[:, 4:10], lying[:, 4:10], atol=1e-5)
    assert np.abs(clip.values[20, 1]) == 8.0


def test_sitting_down_is_not_done_again_whatever_the_longest_caption_says(features):
    wave = features("left_elbow", frames=60, period=20)
    units = FeatureStatistics.measure([wave])
    texts = ["a person bends the knees and lowers onto a chair", "sit down"]
    assert TrainingClip.prepare("sit", {"features": wave, "texts": texts, "watched": True}, units, 196).loop is None
    assert TrainingClip.prepare("wave", {"features": wave, "texts": ["waves"], "watched": True}, units, 196).loop


def test_rare_actions_are_drawn_as_often_as_common_ones():
    """Forty clips of walking and four of kneeling: with a balance of 0 each action has half of the draws, and no clip
    more of them than is allowed.
    """
    rest = np.random.default_rng(0).normal(size=(60, 271)).astype(np.float32)
    entry = {"features": rest, "split": "train", "watched": True}
    found = {f"walk_{index}": entry | {"texts": ["a person walks forward"]} for index in range(40)}
    found |= {f"kneel_{index}": entry | {"texts": ["a person kneels"]} for index in range(4)}
    statistics = FeatureStatistics.measure([rest])
    shares = {}
    for balance in (0.0, 0.5, 1.0):
        clips = ClipSet(found, statistics, mixture=Mixture(balance=balance))
        shares[balance] = clips.probability[[clip.name.startswith("kneel") for clip in clips.clips]].sum()
    assert shares[0.0] == pytest.approx(0.5) and shares[0.0] > shares[0.5] > shares[1.0]
    many = found | {f"walk_{index}": found["walk_0"] for index in range(40, 400)}
    many = {name: one for name, one in many.items() if name not in ("kneel_1", "kneel_2", "kneel_3")}
    clips = ClipSet(many, statistics, mixture=Mixture(balance=0.0, most_drawn=20))
    assert clips.probability.max() == pytest.approx(20 / (400 + 20))


def turn(side, start=5):
    return Phrase("turn", (f"{{turn}} {side}",), start, start + 20)


@pytest.fixture
def pool(features):
    """A hundred turns to either side, one jump, walks of which one goes backwards, and a creature."""
    values = features("spine1", frames=60)
    statistics = FeatureStatistics.measure([values])
    clip = TrainingClip.prepare("a", {"features": values, "texts": ["a person moves"]}, statistics, 60)
    way = Phrase("go", ("{walk} forward",), 0, 30, manner=("forward",))
    back = Phrase("go", ("{walk} backwards",), 0, 30, manner=("backwards", "slowly"))
    told = [[turn("left"), turn("right")]] * 50 + [[Phrase("jump", ("{jump}",), 3, 20), way], [back], [turn("left")]]
    clips = [replace(clip, name=str(number)) for number in range(52)] + [replace(clip, name="52", species="dog")]
    return EventPool(clips, lambda clip: told[int(clip.name)], lambda clip: decode(clip.values), 60)


def test_the_rare_is_drawn_more_often_than_it_is_there(pool):
    """By the root of how often it is there, up to a bound: 1 of sqrt(40) + 2 instead of 1 of 102."""
    random = np.random.default_rng(0)
    drawn = [pool.draw(random)[1].texts[0] for _ in range(2000)]
    expected = 1 / (ENOUGH**0.5 + 2)
    assert abs(drawn.count("{jump}") / 2000 - expected) < 0.03
    assert min(drawn.count("{turn} left"), drawn.count("{turn} right")) > 500


def order(sentence, words):
    """The words of a sentence in the order in which they happen: what comes "after" comes first."""
    positions = sorted((re.search(word, sentence).start(), word) for word in words)
    found = [word for _, word in positions]
    late = re.search(r"\w+ (?:\w+ )*?after (?!that)", sentence)
    return found[::-1] if late and not sentence.startswith("after") else found


def test_sentences_of_two_and_three_parts_keep_their_order():
    random = np.random.default_rng(0)
    for phrases, words in (
        (("{walk} ahead", "{wave}"), ["walk", "wav"]),
        (("{sit} down", "{stand} up", "{run} away"), ["sit", "stand", "run"]),
    ):
        made = {link(phrases, random) for _ in range(400)}
        assert len(made) > 40
        for sentence in made:
            assert "{" not in sentence and sentence == " ".join(sentence.split())
            assert order(sentence, words) == words, sentence
        for word in ("then", "before", "after", "first"):
            assert any(word in sentence for sentence in made)


TEXTS = ("someone walks fast and turns left", "a brisk walk with a left turn", "walk fast, turn left")


def test_variants_keep_what_is_written_and_change_the_subject():
    found = stretch_variants(TEXTS)
    assert set(TEXTS) <= set(found) and "a person walks fast, turns left" in found
    others = [text for text in found if text.endswith("walks fast and turns left")]
    assert len(others) == 2 and others[0] != others[1]
    mirrored = stretch_variants(TEXTS, (), True)
    assert len(mirrored) == len(found) and all("right" in text and "left" not in text for text in mirrored)
