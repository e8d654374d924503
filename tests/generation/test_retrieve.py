"""Examples: their pack, retrieval, and attention to them."""

from dataclasses import replace

import numpy as np
import pytest

from bunraku.core.body.joint_rotations import skeleton_from_handles
from bunraku.core.body.layout import JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.files import weights_file
from bunraku.core.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.errors import WeightsError
from bunraku.generation.extractor import ExtractorConfig
from bunraku.generation.features import FeatureStatistics, body_handle_motion, decode, encode, mirror
from bunraku.generation.pack import (
    HANGS,
    Example,
    ExamplePack,
    fingerprint,
    head_up,
    load_examples,
    read_pack,
    said_by,
    stand_well,
    unpacked_stretch,
)
from bunraku.generation.retrieve import ExampleBank, mirrored_cues, retrieve, take_of
from bunraku.language.captions import mirror_words
from bunraku.language.lexicon import said_cues
from bunraku.language.parse import clause_of
from bunraku_lab.datasets.motions.clips import packed_stretch, write_pack
from bunraku_lab.evaluation.motion.metrics import posed_positions


def test_a_packed_stretch_is_the_same_to_half_a_millimetre_and_two_milliradians():
    random = np.random.default_rng(0)
    root = np.cumsum(random.normal(0, 0.02, (80, 3)), axis=0)
    rotations = matrix_from_axis_angle(np.cumsum(random.normal(0, 0.03, (80, 22, 3)), axis=0))
    data = packed_stretch(root, rotations)
    found_root, found = unpacked_stretch(data, 80)
    assert np.abs(found_root - root).max() <= 0.00026
    assert np.linalg.norm(axis_angle_from_matrix(found.swapaxes(-1, -2) @ rotations), axis=-1).max() < 0.003
    assert len(data) < 80 * 150


def test_bytes_of_another_length_or_none_at_all_are_refused():
    data = packed_stretch(np.zeros((5, 3)), np.broadcast_to(np.eye(3), (5, 22, 3, 3)))
    for bad, frames in ((data, 6), (data, 4), (data, 0), (data, 10**9), (b"", 5), (b"nonsense", 5)):
        with pytest.raises(WeightsError, match="damaged"):
            unpacked_stretch(bad, frames)


def test_what_the_denoiser_sees_of_an_example_is_what_it_sees_of_the_clip():
    random = np.random.default_rng(1)
    turns = np.zeros((30, 22, 3))
    turns[:, [0, 4, 16, 18]] = np.cumsum(random.normal(0, 0.05, (30, 4, 3)), axis=0)
    skeleton = Skeleton(JOINT_NAMES, np.asarray(JOINT_PARENTS), reference_body().skeleton.offsets)
    root = np.cumsum(random.normal(0, 0.02, (30, 3)), axis=0) + [0, 0.9, 0]
    clip = body_handle_motion(SkeletalMotion(skeleton, matrix_from_axis_angle(turns), root, 20.0))
    found = skeleton_from_handles(clip)
    example = Example("clip", ("a person moves",), 30)
    data = (packed_stretch(found.root_translation, found.rotations),)
    pack = ExamplePack((example,), data, np.zeros(1, int), np.ones((2, 1, 1)), np.ones((2, 1, 1)), "")
    seen, meant = (posed_positions(decode(values))[:, :22] for values in (pack.features(0), encode(clip)))
    assert np.linalg.norm(seen - meant, axis=-1).max() < 0.03


def test_a_file_gives_back_what_was_written(pack, tmp_path):
    path = write_pack(tmp_path / "examples.safetensors", pack, {"licences": {"CC0": 2}})
    found = read_pack(path)
    assert found.examples == pack.examples and found.data == pack.data and found.ranker == "none"
    np.testing.assert_allclose(found.texts, pack.texts)
    np.testing.assert_allclose(found.motions, pack.motions)
    np.testing.assert_array_equal(found.owners, pack.owners)


def test_tables_that_disagree_are_refused(pack, tmp_path):
    for change in (
        {"owners": np.array([0, 0, 7])}, {"data": pack.data[:1]}, {"motions": pack.motions[:, :1]},
    ):  # fmt: skip
        path = write_pack(tmp_path / "broken.safetensors", replace(pack, **change), {})
        with pytest.raises(WeightsError, match=r"broken\.safetensors"):
            read_pack(path)


def test_examples_of_another_ranker_and_none_at_all(pack, tmp_path, monkeypatch):
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path))
    assert load_examples() is None
    (tmp_path / "ranker.safetensors").write_bytes(b"weights")
    write_pack(tmp_path / "examples.safetensors", pack, {})
    with pytest.raises(WeightsError, match="another ranker"):
        load_examples()
    own = replace(pack, ranker=fingerprint(tmp_path / "ranker.safetensors"))
    write_pack(tmp_path / "examples.safetensors", own, {})
    assert load_examples().examples == pack.examples


def test_in_which_shipped_stretches_a_person_stands_is_stored_as_it_is_found_today():
    path = weights_file("examples.safetensors")
    if not path.is_file():
        pytest.skip("the shipped weights are not there")
    pack = read_pack(path)
    assert pack.stand == stand_well(replace(pack, stand=None)) and 0 < len(pack.idles) < len(pack.stand)


def test_what_a_mirrored_example_says():
    for text in ("waves with the left hand", "turns right and kicks with the left leg", "steps to the left"):
        assert mirrored_cues(said_by((text,)).cues) == said_cues(mirror_words(text))


AXES = np.eye(4)


def names(pack, sentence, vector):
    return [(pack.examples[one.number].name, one.mirrored) for one in retrieve(pack, clause_of(sentence), vector).found]


def test_the_nearest_that_does_the_same_is_found(pack):
    assert names(pack, "someone is waving", AXES[0]) == [("wave", False)]
    assert names(pack, "someone kicks", AXES[1]) == [("kick", False)]


def test_another_side_is_the_mirror_image(pack):
    between = (AXES[0] + AXES[2]) / 2**0.5  # as near to the wave as to its mirror image
    assert names(pack, "someone waves with the left hand", between) == [("wave", False)]
    assert names(pack, "someone waves with the right hand", between) == [("wave", True)]


def test_what_does_something_else_is_no_example_however_near(pack):
    assert names(pack, "a person sits down", 0.8 * AXES[0] + 0.6 * AXES[3]) == []
    assert names(pack, "a person walks, jumps and waves with the left hand", 0.8 * AXES[0] + 0.6 * AXES[3]) == []


def test_what_no_example_does_is_shown_by_what_is_nearest_to_it(pack):
    near = 0.8 * AXES[0] + 0.6 * AXES[3]
    clause = replace(clause_of("someone is waving"), actions=("peace sign",))
    result = retrieve(pack, clause, near)
    assert ([one.number for one in result.found], result.instead) == ([0], ("wave",))
    said = said_by(pack.examples[0].texts)._replace(actions=frozenset(("peace sign",)))
    result = retrieve(replace(pack, readings=[said, pack.said[1]]), clause, near)
    assert ([one.number for one in result.found], result.instead) == ([0], ())


def test_what_only_the_reader_names_is_shown_by_its_own_gesture_and_not_by_a_hand_on_a_thing(pack):
    names = ("gesture_drive_a_car_7", "gesture_handle_8")
    examples = tuple(replace(example, name=name) for example, name in zip(pack.examples, names, strict=True))
    clause = replace(clause_of("a person drives a car"), actions=("drive a car",))
    (found,) = retrieve(replace(pack, examples=examples, readings=None), clause, AXES[3]).found
    assert (found.number, found.detail) == (0, None)
    clause = replace(clause, actions=("open door",))  # which the lexicon's phrases say, too
    (found,) = retrieve(replace(pack, examples=examples, readings=None), clause, AXES[3]).found
    assert (found.number, found.detail) == (1, clause.detail)


def test_a_sentence_without_a_known_action_takes_what_is_near(pack):
    assert names(pack, "hello", 0.8 * AXES[0] + 0.6 * AXES[3]) == [("wave", False)]
    assert names(pack, "hello", 0.5 * AXES[0]) == []


def test_what_is_far_is_no_example(pack):
    assert names(pack, "someone is waving", 0.5 * AXES[0] + 0.75**0.5 * AXES[1]) == []


def test_a_pace_that_was_not_asked_for_and_the_floor_in_place_of_a_chair_are_no_example(pack):
    def named(*texts):
        return replace(pack, examples=(replace(pack.examples[0], texts=texts), pack.examples[1]))

    assert names(named("a person throws a quick punch"), "someone punches", AXES[0]) == [("wave", False)]
    slow = named("a person waves slowly with the left hand", "waves")
    assert names(slow, "someone is waving", AXES[0]) == []
    assert names(slow, "someone is waving slowly", AXES[0]) == [("wave", False)]
    up = named("a person gets up from the floor", "stands up")
    assert names(up, "someone gets up from a chair", AXES[0]) == []
    assert names(up, "someone gets up", AXES[0]) == [("wave", False)]


def test_plain_walks_take_only_what_is_near(pack):
    walk = replace(pack, examples=(replace(pack.examples[0], texts=("a person walks", "walk")), pack.examples[1]))
    for cosine, found in ((0.75, []), (0.85, [("wave", False)])):
        near = cosine * AXES[0] + (1 - cosine**2) ** 0.5 * AXES[1]
        assert names(walk, "somebody walks", near) == found
        assert names(pack, "somebody waves", near) == [("wave", False)]


def test_where_a_gesture_made_by_code_is_nearest_only_what_is_about_as_near_is_offered(pack):
    near = 0.75 * AXES[0] + 0.66 * AXES[1]
    both = replace(pack, examples=(pack.examples[0], replace(pack.examples[1], texts=("waves",))))
    assert names(both, "someone is waving", (AXES[0] + AXES[1]) / 2**0.5) == [("wave", False), ("kick", False)]
    assert len(names(both, "someone is waving", near)) == 2
    made = replace(both, examples=(replace(both.examples[0], name="gesture_wave_1"), both.examples[1]))
    assert names(made, "someone is waving", near) == [("gesture_wave_1", False)]
    assert len(names(made, "someone is waving", (AXES[0] + AXES[1]) / 2**0.5)) == 2
    other = replace(both, examples=(both.examples[0], replace(both.examples[1], name="gesture_wave_1")))
    assert ("wave", False) in names(other, "someone is waving", near)


def test_an_example_of_another_action_is_not_taken_however_near(pack):
    sits = replace(pack, examples=(replace(pack.examples[0], texts=("does sit-ups",)), pack.examples[1]))
    assert names(sits, "a person sits down", AXES[0]) == []
    made = replace(sits, examples=(replace(sits.examples[0], name="gesture_sit-up_1"), pack.examples[1]))
    assert names(made, "a person sits down", AXES[0]) == []
    assert names(made, "someone does sit-ups", AXES[0]) == [("gesture_sit-up_1", False)]


def named(pack, name, *texts):
    return replace(pack, examples=(replace(pack.examples[0], name=name, texts=texts), pack.examples[1]))


def test_a_gesture_made_by_code_is_mirrored_only_where_a_side_is_said(pack):
    between = (AXES[0] + AXES[2]) / 2**0.5
    made = named(pack, "gesture_wave_1", "a person waves with the left hand", "waves")
    assert names(made, "someone is waving", between) == [("gesture_wave_1", False)]
    assert names(made, "someone waves with the right hand", between) == [("gesture_wave_1", True)]


def test_who_is_on_the_floor_does_not_get_up_from_a_chair(pack):
    chair = named(pack, "chair", "stands up from a chair")
    assert names(chair, "a person stands up from the floor", AXES[0]) == []
    assert names(chair, "a person stands up", AXES[0]) == [("chair", False)]


def test_what_is_shown_once_is_done_as_often_as_is_counted(pack):
    (one,) = retrieve(pack, clause_of("someone kicks twice with the right leg"), AXES[1]).found
    assert one.number == 1 and one.times == 2
    assert retrieve(pack, clause_of("someone kicks with the right leg"), AXES[1]).found[0].times == 1
    assert names(pack, "someone waves twice with the left hand", AXES[0]) == []  # that goes on, as often as it likes
    assert names(pack, "someone kicks nine times with the right leg", AXES[1]) == []
    twice = replace(pack.examples[1], texts=("a person kicks twice with the right leg",))
    counted = replace(pack, examples=(pack.examples[0], twice))
    (one,) = retrieve(counted, clause_of("someone kicks twice with the right leg"), AXES[1]).found
    assert one.times == 1
    assert names(counted, "someone kicks three times with the right leg", AXES[1]) == []


def test_the_limb_that_is_meant_counts_more_than_the_way_of_its_movement(pack):
    assert names(pack, "someone kicks a ball to the left with the right foot", AXES[1]) == [("kick", False)]
    assert names(pack, "someone kicks a ball to the left with the left foot", AXES[1]) == []
    assert names(pack, "someone kicks a ball to the left", AXES[1]) == []


def test_a_hook_is_rather_a_hook_than_another_punch(pack):
    texts = ("a person throws a punch with the left hand", "a person throws a left hook")
    punches = tuple(replace(example, texts=(said,)) for example, said in zip(pack.examples, texts, strict=True))
    near = (AXES[0] + AXES[1]) / 2**0.5
    assert names(replace(pack, examples=punches), "someone throws a left hook", near)[0] == ("kick", False)


def test_what_is_high_is_no_example_of_what_is_low(pack):
    high = named(pack, "high", "a person kicks high with the left foot")
    assert names(high, "a person does a low kick", AXES[0]) == []
    assert names(high, "a person kicks", AXES[0])


def test_examples_that_show_more_or_something_else_come_last(pack):
    texts = ("a person runs and kicks", "a person runs", "a person running comes to a halt and sets off again")
    extra = [replace(pack.examples[0], name=f"{n}", texts=(text, "runs")) for n, text in enumerate(texts)]
    size = len(extra)
    many = replace(
        pack, examples=tuple(extra), data=pack.data[:1] * size, owners=np.arange(size),
        texts=np.repeat(pack.texts[:, :1], size, axis=1), motions=np.repeat(pack.motions[:, :1], size, axis=1),
    )  # fmt: skip
    assert names(many, "someone is running", AXES[0])[0][0] == "1"
    assert names(many, "someone runs, halts and sets off again", AXES[0])[0][0] == "2"


def test_a_part_of_what_is_done_counts(pack):
    near = 0.85 * AXES[0] + (1 - 0.85**2) ** 0.5 * AXES[3]
    assert names(pack, "a person waves and nods", near) == [("wave", False)]
    texts = ("a person waves and nods", "a person waves")
    both = tuple(replace(example, texts=(said,)) for example, said in zip(pack.examples, texts, strict=True))
    nearer = 0.71 * AXES[0] + 0.7 * AXES[1]  # but another does the very action
    assert names(replace(pack, examples=both), "someone waves", nearer)[0] == ("kick", False)
    assert not retrieve(pack, clause_of("a person waves and nods"), near).found[0].close
    assert retrieve(pack, clause_of("someone waves"), AXES[0]).found[0].close


@pytest.fixture
def statistics(pack):
    return FeatureStatistics.measure([pack.features(index) for index in range(2)])


@pytest.fixture
def bank(pack, encoder, statistics):
    torch = pytest.importorskip("torch", reason="networks are made with PyTorch")
    from bunraku_lab.nn.text import Extractor, running_extractor

    torch.manual_seed(3)
    sizes = {"width": 16, "layers": 1, "heads": 2, "feedforward": 16, "embedding": 4, "text_size": 8, "pooled_size": 8}
    ranker = running_extractor(Extractor(ExtractorConfig(**sizes, text_encoder="words")))
    return ExampleBank(pack, ranker, encoder, statistics, count=2)


def test_the_nearest_by_vectors_alone_each_once_on_the_nearer_side(bank):
    assert bank.nearest(AXES[0]) == [(0, False), (1, False)]
    assert bank.nearest(AXES[3])[0] == (1, True)
    assert bank.nearest((AXES[2] + 0.5 * AXES[1]) / 1.25**0.5) == [(0, True), (1, False)]


def test_values_are_in_network_units_with_the_vector_of_their_own_sentence(bank, pack, encoder, statistics):
    text = encoder.encode(["kicks hard", "waves"])
    found = bank(text, [{"wave"}, {"kick"}])
    assert found.lengths.tolist() == [[30, 0], [40, 0]]
    assert found.values.shape == (2, 2, 40, 271) and found.pooled.shape == (2, 2, 8)
    kick = statistics.normalise(pack.features(1))
    own = found.values[0, 0, :30]
    side = min((kick, statistics.normalise(mirror(pack.features(1)))), key=lambda one: np.abs(one - own).max())
    np.testing.assert_allclose(own, side, atol=0.02)
    said = "a person kicks with the right leg" if side is kick else "a person kicks with the left leg"
    np.testing.assert_allclose(found.pooled[0, 0], encoder.encode([said]).pooled[0])
    assert not found.values[0, 1].any() and not found.values[0, 0, 30:].any()


def test_takes():
    names = ("cmu_13_29_jacks@40", "cmu_13_29@0#12", "snu_WalkSad05@0", "snu_WalkSad11", "hdm_kick", "turn_cmu_02_01")
    found = [take_of(name) for name in names]
    assert found == ["cmu_13_29", "cmu_13_29", "snu_WalkSad", "snu_WalkSad", "hdm_kick", "cmu_02_01"]


def test_the_sampler_retrieves_for_the_sentence_from_the_shipped_examples(running):
    """Motions of a network that attends to examples differ from those that it makes where none is usable."""
    from bunraku.generation.retrieve import example_bank
    from bunraku.generation.sampler import Solver
    from bunraku.language.encoders import text_encoder
    from bunraku_lab.evaluation.motion.samples import sample

    name = "all-MiniLM-L6-v2+cues"
    encoder = text_encoder(name)
    sizes = {"text_encoder": name, "text_size": encoder.token_size, "pooled_size": encoder.pooled_size}
    model = running(examples=2, **sizes)
    text = encoder.encode(["a person does a cartwheel"])
    statistics = FeatureStatistics(model.mean, model.std)
    bank = example_bank(model.config, statistics)
    assert example_bank(model.config, statistics) is bank
    found = bank(text)
    assert found.values.shape[:2] == (1, 2) and (found.lengths > 0).all()
    one = sample(model, text, 40, Solver(2), seed=1).values
    assert np.array_equal(one, sample(model, text, 40, Solver(2), seed=1).values)
    model.layers[1].examples.leave.matrix[:] = 0
    assert np.abs(one - sample(model, text, 40, Solver(2), seed=1).values).max() > 1e-3


def test_a_gesture_shows_the_action_of_its_name_whatever_the_lexicon_finds_in_its_sentences():
    assert said_by(("takes aim with a rifle",)).actions == {"shoot"}
    example = Example("gesture_aim_rifle_121", ("takes aim with a rifle",), 20)
    assert said_by(example.texts, example.gesture).actions == {"aim rifle"}
    assert Example("own_aim#1", (), 20).gesture == Example("gesture_standing", (), 20).gesture == ""


def test_what_the_pack_holds_of_its_sentences_is_what_is_read_in_them():
    """But for actions, which people read."""
    pack = read_pack(weights_file("examples.safetensors"))
    for index in np.random.default_rng(0).choice(len(pack.examples), 40, replace=False).tolist():
        said = said_by(pack.examples[index].texts)
        assert pack.said[index][1:3] == said[1:3], (
            f"{pack.examples[index].name}: sentences are read otherwise now; write the pack again with 'bunraku data "
            "examples --add-to shipped -o src/bunraku/weights/examples.safetensors'"
        )


def test_heads_of_captured_people_do_not_hang_for_good():
    """Of some people the markers say that the head hangs by 45 degrees while they walk; a nod on top of it stays."""
    nod = np.radians(20) * np.sin(np.linspace(0, 4 * np.pi, 41))
    turns = np.zeros((41, 22, 3))
    turns[:, JOINT_NAMES.index("neck"), 0], turns[:, JOINT_NAMES.index("head"), 0] = 0.2, np.radians(45) - 0.2 + nod
    raised = head_up(matrix_from_axis_angle(turns))
    held = axis_angle_from_matrix(raised[:, JOINT_NAMES.index("neck")] @ raised[:, JOINT_NAMES.index("head")])
    np.testing.assert_allclose(held[:, 0], HANGS + nod, atol=1e-6)
    level = matrix_from_axis_angle(np.where(np.arange(3) == 0, 0.0, turns))
    np.testing.assert_allclose(head_up(level), level, atol=1e-6)
