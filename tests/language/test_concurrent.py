import numpy as np
import pytest

from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.parts import PARTS
from bunraku.body.reference import reference_body
from bunraku.diffusion.generation.composition import PartTrack
from bunraku.diffusion.generation.generate import generate_motions
from bunraku.language.parse import clause_of, clauses_of
from bunraku.nn.checkpoints import shipped_checkpoint

ARMS = np.isin(np.arange(30), PARTS["arms"])


@pytest.mark.parametrize(
    ("sentence", "body", "gesture", "part"),
    [
        (
            "a person walks while waving with the left hand",
            "a person walks",
            "a person is waving with the left hand",
            "arms",
        ),
        ("a person walks and waves", "a person walks", "a person waves", "arms"),
        ("she waves while she walks backward", "she walks backward", "she waves", "arms"),
        ("run and clap", "run", "clap", "arms"),
        ("a man is slowly walking while he nods", "a man is slowly walking", "he nods", "head"),
        ("walks forward and shakes the head", "walks forward", "shakes the head", "head"),
        ("walks forward, waving", "walks forward", "waving", "arms"),
        ("the robot marches, and waves", "the robot marches", "the robot waves", "arms"),
        ("a man walks with the hands on his hips", "a man walks", "the hands on his hips", "arms"),
        ("a man lunges, hands on hips", "a man lunges", "hands on hips", "arms"),
        ("a man performs a lunge, hands on hips", "a man performs a lunge", "hands on hips", "arms"),
        ("walks, while raising the right arm", "walks", "raising the right arm", "right arm"),
    ],
)
def test_legs_and_gestures_are_told_apart(sentence, body, gesture, part):
    found = clause_of(sentence)
    assert [voice.text for voice in found.voices] == [body, gesture]
    assert np.flatnonzero(PartTrack.of(0, [found]).handles).tolist() == sorted(
        handle for name in part.split(" and ") for handle in PARTS[name]
    )


@pytest.mark.parametrize(
    ("sentence", "body", "gesture"),
    [
        ("walks while talking on the phone", "walks", "talking on the phone"),
        ("a person sits and reads a book", "a person sits", "a person reads a book"),
        ("a man walks and shrugs", "a man walks", "a man shrugs"),
    ],
)
def test_gestures_move_arms_and_head(sentence, body, gesture):
    found = clause_of(sentence)
    assert [voice.text for voice in found.voices] == [body, gesture]
    assert np.flatnonzero(PartTrack.of(0, [found]).handles).tolist() == sorted({*PARTS["arms"], *PARTS["head"]})


@pytest.mark.parametrize(
    "sentence",
    [
        "a person walks", "waves", "walks and turns left", "a person walks with swinging arms", "claps and waves",
        "kicks while waving",
        "walks and stumbles", "walks while climbing a ladder",
        "lifts a box and walks", "walks and waves and claps", "shakes a rug and walks", "and", "walks while", "",
    ],
)  # fmt: skip
def test_other_sentences_have_one_voice(sentence):
    found = clause_of(sentence)
    assert found.voices == () and found.body.text == sentence and found.meanwhile is None


def test_a_twin_owns_its_handles_and_nothing_else():
    twin = PartTrack.of(2, [clause_of("walks"), clause_of("walks and waves")])
    assert (
        twin is not None
        and (twin.motion, twin.sentences) == (2, ("walks", "waves"))
        and np.array_equal(twin.handles, ARMS)
    )
    assert PartTrack.of(0, [clause_of("walks")]) is None
    features = twin.follow(np.zeros((3, 271)), np.ones((3, 271)))
    assert features.sum(1).tolist() == [9.0 * ARMS.sum()] * 3 and features[:, :10].sum() == 0
    assert (twin.adapt(np.zeros((3, 30, 3)), np.ones((3, 30, 3)))[:, :, 0] > 0).tolist() == [ARMS.tolist()] * 3


@pytest.mark.skipif(not shipped_checkpoint("diffusion").is_file(), reason="the shipped weights are not there")
def test_the_legs_walk_on_while_the_hand_waves():
    walk = generate_motions([clauses_of([("a person walks forward", 3.0)])], seeds=4)[0]
    other, both = generate_motions(
        [
            clauses_of([one])
            for one in (("a person jumps", 3.0), ("a person walks forward while waving with the right hand", 3.0))
        ],
        seeds=[1, 4],
    )
    rest = [index for index in range(30) if not ARMS[index]]
    assert np.allclose(both.root_translation, walk.root_translation, atol=1e-3)
    assert np.allclose(both.rotations[:, rest], walk.rotations[:, rest], atol=1e-2)
    positions = reference_body().handles.positions
    posed = both.transforms(positions)
    joints = np.einsum("nkab,kb->nka", posed[..., :3], positions) + posed[..., 3]
    wrist, shoulder = (joints[:, HANDLE_NAMES.index(name), 1] for name in ("right_wrist", "right_shoulder"))
    assert (wrist > shoulder - 0.1).mean() > 0.8
    assert np.allclose(
        other.rotations, generate_motions([clauses_of([("a person jumps", 3.0)])], seeds=1)[0].rotations, atol=1e-2
    )


@pytest.mark.skipif(not shipped_checkpoint("diffusion").is_file(), reason="the shipped weights are not there")
def test_a_loop_of_two_voices_closes():
    (loop,) = generate_motions([clauses_of([("walks while waving with the left hand", 2.0)])], seeds=3, loop=True)
    assert np.array_equal(loop.rotations[0], loop.rotations[-1]) and np.array_equal(
        loop.translations[0], loop.translations[-1]
    )
    assert np.linalg.norm(loop.root_translation[-1] - loop.root_translation[0]) > 1.0
