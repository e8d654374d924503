"""Generating, editing, finishing and overlaying motion."""

from __future__ import annotations

import shutil
import subprocess
import sys

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from bunraku.core.body.layout import HANDLE_NAMES, PARTS, kept_handles
from bunraku.core.body.reference import reference_body
from bunraku.core.files import PACKAGE_WEIGHTS
from bunraku.core.motion import HandleMotion
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.core.travel import follow, placed_at, put_back
from bunraku.errors import MotionError, OptionError, WeightsError
from bunraku.generation.composition import overlaid, straightened, turned_as_asked
from bunraku.generation.features import FEATURE_SIZE, body_handle_motion, decode, encode
from bunraku.generation.generate import adapt, continue_motion, edit_motion, generate_motions, span_frames
from bunraku.gestures.catalogue import gestures
from bunraku.gestures.limb_gesture import limb_gesture
from bunraku.gestures.play import gesture_motion
from bunraku.language.parse import clause_of, clauses_of
from bunraku.language.posing import posing_of
from bunraku_lab.evaluation.motion.metrics import posed_positions


@pytest.fixture
def make(denoiser, tmp_path):
    from bunraku_lab.nn.denoiser import save_denoiser

    def make(name="diffusion", **how):
        notes = {"characters": how.pop("characters", 0)}
        model = denoiser(text_encoder="all-MiniLM-L6-v2", text_size=384, pooled_size=384, **how)
        model.motion_out.weight.mul_(0.1)
        return save_denoiser(tmp_path / f"{name}.safetensors", model, notes, half=False)

    return make


def generate_motion(prompt, seconds, seed=0, **how):
    return generate_motions([clauses_of([(prompt, seconds)])], seeds=seed, **how)[0]


def same(a, b):
    return (
        np.array_equal(a.rotations, b.rotations)
        and np.array_equal(a.root_translation, b.root_translation)
        and np.array_equal(a.translations, b.translations)
    )


@pytest.mark.parametrize(("seconds", "frames"), [(0.5, 10), (2, 40), (3.02, 60), (6, 120)])
def test_lengths(make, seconds, frames):
    motion = generate_motion("walks", seconds, steps=2, checkpoint=make())
    assert len(motion) == frames and motion.fps == 20 and motion.translations.shape == (frames, 30, 3)
    np.testing.assert_allclose(motion.root_translation[0, [0, 2]], 0, atol=1e-6)


def test_the_shipped_weights_are_found_and_kept(make, monkeypatch, tmp_path):
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path))
    with pytest.raises(WeightsError, match="missing"):
        generate_motion("walks", 1, steps=1)
    shutil.copy(PACKAGE_WEIGHTS / "reader.safetensors", tmp_path)
    path = make()
    first = generate_motion("a person walks.", 1, steps=2, seed=3)
    assert same(first, generate_motion(" a  person walks", 1, steps=2, seed=3)) and same(
        first, generate_motion("a person walks", 1, steps=2, seed=3, checkpoint=path)
    )
    for how in ({"seed": 4}, {"steps": 3}, {"guidance": 6.0}):
        assert not same(first, generate_motion("a person walks", 1, **{"steps": 2, "seed": 3, **how}))
    assert not same(first, generate_motion("a person jumps", 1, steps=2, seed=3))
    make(seed=1)
    assert not same(first, generate_motion("a person walks", 1, steps=2, seed=3))  # new weights in the same place


def test_the_mesh_feature_counts_only_where_training_knew_it(make):
    mesh = np.ones(12, np.float32)
    for characters in (0, 7):
        path = make(f"with{characters}", characters=characters)
        alone, meshed = (
            generate_motion("walks", 1, steps=2, mesh_feature=feature, checkpoint=path) for feature in (None, mesh)
        )
        assert same(alone, meshed) == (characters == 0)
    with pytest.raises(OptionError, match="12 finite"):
        generate_motion("walks", 1, steps=2, mesh_feature=mesh * np.nan, checkpoint=path)


def test_the_adaptation_moves_local_translations_only(make):
    motion = generate_motion("walks", 1, steps=1, checkpoint=make())
    offsets = np.random.default_rng(0).normal(size=motion.translations.shape).astype(np.float32)
    adapted = adapt(motion, offsets)
    np.testing.assert_allclose(adapted.translations[:, 1:], (motion.translations + offsets)[:, 1:], atol=1e-6)
    assert not adapted.translations[:, 0].any() and np.array_equal(adapted.rotations, motion.rotations)
    assert adapt(motion, np.zeros_like(offsets)) is motion


def test_bad_input_is_refused_before_anything_is_loaded(tmp_path):
    nowhere = tmp_path / "none.safetensors"
    for prompt in ("", "  ", "...", "x" * 10_000):
        with pytest.raises(OptionError, match="prompt"):
            generate_motion(prompt, 6, checkpoint=nowhere)
    for how in (
        {"steps": 0},
        {"steps": 1001},
        {"guidance": -1.0},
        {"guidance": float("nan")},
        {"seconds": 0.0},
        {"seconds": float("inf")},
    ):
        with pytest.raises(OptionError):
            generate_motion("walks", **{"seconds": 1.0, **how}, checkpoint=nowhere)
    with pytest.raises(WeightsError, match=r"none\.safetensors"):
        generate_motion("walks", 6, checkpoint=nowhere)


def threads():
    return {one["filepath"]: one["num_threads"] for one in threadpool_info()}


def test_progress_and_threads(make):
    generate_motion("walks", 1, steps=1, checkpoint=make())  # loads what has threads
    before, calls = threads(), []
    generate_motion("walks", 5, steps=4, checkpoint=make(), progress=lambda name, share: calls.append((name, share)))
    shares = [share for _, share in calls]
    assert (
        {name for name, _ in calls} == {"generate"} and shares[0] == 0 and shares[-1] == 1 and shares == sorted(shares)
    )
    assert threads() == before


@pytest.mark.skipif(not shipped_checkpoint("diffusion").is_file(), reason="the shipped weights are not there")
def test_the_networks_run_without_torch():
    code = (
        "import sys; from bunraku.generation.networks import Networks; Networks().denoiser; "
        "from bunraku.generation.generate import generate_motions; from bunraku.language.parse import clauses_of; "
        "generate_motions([clauses_of([('a person walks', 1)])], steps=2, candidates=2); "
        "assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)  # importing it takes two seconds


ARRAYS = ("translations", "rotations", "root_translation", "root_rotation")


@pytest.fixture(scope="module")
def checkpoint(denoiser, tmp_path_factory):
    from bunraku_lab.nn.denoiser import save_denoiser

    model = denoiser(text_encoder="all-MiniLM-L6-v2", text_size=384, pooled_size=384)
    model.motion_out.weight.mul_(0.1)
    model.adaptation_out.weight.mul_(0.01)
    model.std[:3], model.mean[[4, 8]] = 0.5, 1.0
    return save_denoiser(tmp_path_factory.mktemp("weights") / "diffusion.safetensors", model, half=False)


@pytest.fixture(scope="module")
def clip(checkpoint):
    return generate_motion("a person walks", 8, steps=3, checkpoint=checkpoint, seed=5)


def same_frames(one, other, handles=slice(None), frames=slice(None)):
    return all(
        np.array_equal(getattr(one, name)[frames][:, handles], getattr(other, name)[frames][:, handles])
        for name in ARRAYS[:2]
    )


@pytest.mark.parametrize("keep", ["legs", "left arm", "upper body", "head, left_wrist", "root"])
def test_kept_handles_come_back_bit_for_bit(clip, checkpoint, keep):
    found = edit_motion(clip, clause_of("waves"), keep=keep, steps=3, checkpoint=checkpoint)
    handles = kept_handles(keep)
    assert same_frames(found, clip, handles) and len(found) == len(clip)
    assert np.abs(found.rotations[:, ~handles] - clip.rotations[:, ~handles])[:, 1:].max() > 0.1
    paths = [np.array_equal(getattr(found, name), getattr(clip, name)) for name in ARRAYS[2:]]
    assert paths == [bool(handles[0])] * 2


@pytest.mark.parametrize(
    ("span", "frames"),
    [((2.0, 4.0), (40, 80)), ((0.0, 1.0), (0, 20)), ((5.0, 9.0), (100, 160)), ((3.0, 3.1), (60, 62))],
)
def test_frames_outside_a_span_come_back_bit_for_bit(clip, checkpoint, span, frames):
    found = edit_motion(clip, clause_of("jumps"), span=span, steps=3, checkpoint=checkpoint)
    outside = np.ones(len(clip), bool)
    outside[slice(*frames)] = False
    assert same_frames(found, clip, frames=outside) and not same_frames(found, clip, frames=~outside)
    assert all(np.array_equal(getattr(found, name)[outside], getattr(clip, name)[outside]) for name in ARRAYS[2:])
    if outside[0] and outside[-1]:  # the path arrives where the rest goes on
        last = frames[1] - 1
        np.testing.assert_allclose(found.root_translation[last, [0, 2]], clip.root_translation[last, [0, 2]], atol=2e-3)


def test_a_span_joins_more_smoothly_than_what_would_be_there_without_the_rest(clip, checkpoint):
    free = generate_motion("jumps", 8, checkpoint=checkpoint, seed=9)
    pasted = put_back(free, clip, np.zeros(30, bool), 40, 80, fade=0)
    made = edit_motion(clip, clause_of("jumps"), span=(2, 4), checkpoint=checkpoint, seed=9)
    jump = [np.abs(np.diff(encode(motion)[[39, 40]][:, 10:], axis=0)).mean() for motion in (pasted, made)]
    usual = [np.median(np.abs(np.diff(encode(motion)[:, 10:], axis=0)).mean(axis=1)) for motion in (clip, free)]
    assert jump[1] < 0.9 * min(usual) and jump[0] > 1.05 * max(usual)  # no more than from any frame to the next


def test_a_continuation_starts_in_the_last_pose(clip, checkpoint):
    found = continue_motion(clip, clauses_of([("jumps", 2.0), ("runs", 1.5)]), steps=3, checkpoint=checkpoint)
    assert len(found) == 70
    for name in ARRAYS:
        assert np.array_equal(getattr(found, name)[0], getattr(clip, name)[-1])
    one = continue_motion(clip.take(slice(0, 1)), clauses_of([("jumps", 1.0)]), steps=2, checkpoint=checkpoint)
    assert len(one) == 20 and np.array_equal(one.rotations[0], clip.rotations[0])


def test_following_moves_a_motion_to_the_end_of_another(clip):
    late = clip.take(slice(50, 110))
    found = follow(late, clip)
    for name in ARRAYS:
        assert np.array_equal(getattr(found, name)[0], getattr(clip, name)[-1])
    before, after = (
        np.linalg.norm(np.diff(motion.root_translation[20:, [0, 2]], axis=0), axis=-1) for motion in (late, found)
    )
    np.testing.assert_allclose(before, after, atol=1e-5)  # moved as a whole, so no foot slides


def test_differences_at_the_edges_fade_out():
    still = HandleMotion(
        np.zeros((30, 30, 3)), np.tile(np.eye(3), (30, 30, 1, 1)), np.zeros((30, 3)), np.tile(np.eye(3), (30, 1, 1))
    )
    away = np.zeros((30, 30, 3))
    away[:, 4] = 0.2
    made = HandleMotion(away, still.rotations, still.root_translation + [0.5, 0.1, 0], still.root_rotation)
    found = put_back(made, still, np.zeros(30, bool), 5, 25)
    assert np.abs(np.diff(found.translations[:, 4], axis=0)).max() < 0.05 and found.translations[
        15, 4, 0
    ] == pytest.approx(0.2)
    assert np.abs(np.diff(found.root_translation, axis=0)).max() < 0.2
    assert (
        found.root_translation[15, 1] == pytest.approx(0.1)
        and not found.translations[:5].any()
        and not found.translations[25:].any()
    )


def test_loops_close(checkpoint):
    one, long = generate_motions(
        [clauses_of([("walks", 2.0)]), clauses_of([("walks", 1.0), ("runs", 6.0)])], loop=True, steps=3,
        checkpoint=checkpoint,
    )  # fmt: skip
    assert len(one) == 41 and len(long) == 141
    for motion in (one, long):
        assert same_frames(
            motion, motion.take(np.array([len(motion) - 1] + [0] * (len(motion) - 1))), frames=slice(0, 1)
        )
        back = posed_positions(placed_at(motion, len(motion) - 1, motion, 0))[-1]
        assert np.linalg.norm(posed_positions(motion)[0] - back, axis=-1).mean() < 1e-4
        np.testing.assert_allclose(motion.root_rotation[-1], motion.root_rotation[0], atol=1e-4)


def test_a_batch_has_the_motions_of_its_prompts_alone(checkpoint):
    scripts = [clauses_of(one) for one in ([("walks", 1.0)], [("jumps", 4.0)], [("walks", 2.0), ("waves", 2.5)])]
    found = generate_motions(scripts, seeds=[7, 8, 9], steps=3, checkpoint=checkpoint)
    assert [len(motion) for motion in found] == [20, 80, 90]
    for motion, script, seed in zip(found, scripts, (7, 8, 9), strict=True):
        alone = generate_motions([script], seeds=seed, steps=3, checkpoint=checkpoint)[0]
        np.testing.assert_allclose(posed_positions(motion), posed_positions(alone), atol=2e-3)
    assert generate_motions([], checkpoint=checkpoint) == []


def test_bad_edits_are_refused(clip, checkpoint):
    how = {"steps": 1, "checkpoint": checkpoint}
    with pytest.raises(OptionError, match="nothing is kept"):
        edit_motion(clip, clause_of("waves"), **how)
    with pytest.raises(OptionError, match="nothing is kept"):
        edit_motion(clip, clause_of("waves"), span=(0, 8), **how)
    with pytest.raises(MotionError, match="20 frames a second"):
        edit_motion(
            HandleMotion(*(getattr(clip, name) for name in ARRAYS), fps=30), clause_of("waves"), keep="legs", **how
        )
    for span in ((3, 2), (-1, 2), (8, 9), (float("nan"), 2), (1.0, 1.001)):
        with pytest.raises(OptionError, match="span"):
            span_frames(span, 160, 20)
    with pytest.raises(OptionError, match="2 motions need as many seeds"):
        generate_motions([clauses_of([("a", 1)]), clauses_of([("b", 1)])], seeds=[1], **how)


FPS = 20
TIME = np.arange(200) / FPS


def features(channel, values):
    out = np.zeros((len(values), FEATURE_SIZE), np.float32)
    out[:, channel] = values
    return out


def heading(values):
    return float(np.degrees(values[:, 0].sum() / FPS))


def test_forward_holds_its_course_and_keeps_its_sway():
    """A drift of 3 degrees a second goes, hips that turn to and fro with each stride stay."""
    sway = 0.5 * np.sin(2 * np.pi * 1.2 * TIME)
    drifting = features(0, np.radians(3.0) + sway)
    after = straightened(drifting, [(clause_of("a person walks forward"), 200)], FPS)
    assert heading(drifting) > 25 and abs(heading(after)) < 6  # half a stride at each end
    assert np.corrcoef(after[20:-20, 0], sway[20:-20])[0, 1] > 0.99


def test_only_the_sentence_that_says_forward_is_straightened():
    turning = features(0, np.full(200, np.radians(9.0)))
    script = [(clause_of("a person walks in a circle"), 100), (clause_of("a person walks forward"), 100)]
    after = straightened(turning, script, FPS)
    assert heading(after[:100]) == pytest.approx(45, abs=0.5) and abs(heading(after[100:])) < 1


@pytest.mark.parametrize(
    ("sentence", "before", "after"),
    [
        ("a person turns around", 110, 150),  # 180 less 40, and 10 inside
        ("a person turns around", -120, -150),
        ("a person turns around", 300, 210),
        ("a person turns left", 100, 100),
        ("a person turns left", 45, 60),
        ("a person turns left", -60, -60),  # the wrong way is not repaired here
        ("a person turns around", 60, 60),  # nor is less than two thirds
        ("a person walks", 60, 60),
        ("a person walks and turns left", 1, 90),  # the course of a person who goes on is bent
    ],
)
def test_a_turn_that_nearly_goes_as_far_as_asked_does(sentence, before, after):
    turning = features(0, np.full(60, np.radians(before) / 3))
    assert heading(turned_as_asked(turning, [(clause_of(sentence), 60)], FPS)) == pytest.approx(after, abs=0.5)


def march_features(gesture, frames=40):
    return encode(body_handle_motion(gesture_motion(gesture)))[:frames]


@pytest.fixture(scope="module")
def march():
    return march_features(next(one for one in gestures() if one.name == "march in place"))


def limbs(predicate):
    return march_features(limb_gesture(posing_of(predicate)))


def places(values, handles):
    """World positions of handles, shape (N, H, 3)."""
    motion, rest = decode(values), reference_body().handles.positions.astype(float)
    local = (rest + motion.translations)[:, handles] - rest[0]
    turned = np.einsum("nij,nkj->nki", motion.root_rotation, local)
    return turned + rest[0] + motion.root_translation[:, None]


def test_arms_go_with_the_chest_and_legs_go_on(march):
    made = overlaid(march, limbs("stands with the arms stretched out to the sides"), ["arms"])
    legs = list(PARTS["legs"][1:])
    assert np.abs(places(made, legs) - places(march, legs)).max() < 1e-4
    wrists = [HANDLE_NAMES.index(f"{side}_wrist") for side in ("left", "right")]
    left, right = np.moveaxis(places(made, wrists), 1, 0)
    assert (left[:, 0] - right[:, 0] > 1.2).all()
    shoulders = [HANDLE_NAMES.index(f"{side}_shoulder") for side in ("left", "right")]
    length = np.linalg.norm(places(made, wrists) - places(made, shoulders), axis=2)
    assert length.max() - length.min() < 0.05


def test_a_trunk_that_leans_takes_head_and_arms_along(march):
    made = overlaid(march, limbs("stands leaning far to the left"), ["upper body"])
    for name in ("head", "left_shoulder", "right_shoulder"):
        handle = [HANDLE_NAMES.index(name)]
        assert (places(made, handle) - places(march, handle))[..., 0].mean() > 0.08
