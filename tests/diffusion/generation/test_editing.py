import numpy as np
import pytest

from bunraku.body.parts import kept_handles
from bunraku.core.motion import HandleMotion
from bunraku.core.travel import follow, placed_at, put_back
from bunraku.diffusion.features import encode
from bunraku.diffusion.generation.editing import continue_motion, edit_motion, span_frames
from bunraku.diffusion.generation.generate import generate_motion, generate_motions
from bunraku.errors import MotionError, OptionError
from bunraku.language.parse import clause_of, clauses_of
from bunraku_lab.evaluation.motion.seams import posed_positions

ARRAYS = ("translations", "rotations", "root_translation", "root_rotation")


@pytest.fixture(scope="module")
def checkpoint(denoiser, tmp_path_factory):
    from bunraku_lab.nn.diffusion.checkpoint import save_denoiser

    model = denoiser(text_encoder="all-MiniLM-L6-v2", text_size=384, pooled_size=384)
    model.motion_out.weight.mul_(0.1)
    model.adaptation_out.weight.mul_(0.01)
    model.std[:3], model.mean[[4, 8]] = 0.5, 1.0
    return save_denoiser(tmp_path_factory.mktemp("weights") / "diffusion.safetensors", model, half=False)


@pytest.fixture(scope="module")
def clip(checkpoint):
    return generate_motion("a person walks", 8, steps=3, checkpoint=checkpoint, seed=5)


def same(one, other, handles=slice(None), frames=slice(None)):
    return all(
        np.array_equal(getattr(one, name)[frames][:, handles], getattr(other, name)[frames][:, handles])
        for name in ARRAYS[:2]
    )


@pytest.mark.parametrize("keep", ["legs", "left arm", "upper body", "head, left_wrist", "root"])
def test_kept_handles_come_back_bit_for_bit(clip, checkpoint, keep):
    found = edit_motion(clip, clause_of("waves"), keep=keep, steps=3, checkpoint=checkpoint)
    handles = kept_handles(keep)
    assert same(found, clip, handles) and len(found) == len(clip)
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
    assert same(found, clip, frames=outside) and not same(found, clip, frames=~outside)
    assert all(np.array_equal(getattr(found, name)[outside], getattr(clip, name)[outside]) for name in ARRAYS[2:])
    if outside[0] and outside[-1]:  # the path arrives where the rest goes on
        last = frames[1] - 1
        np.testing.assert_allclose(found.root_translation[last, [0, 2]], clip.root_translation[last, [0, 2]], atol=2e-3)


def test_a_span_and_handles_together(clip, checkpoint):
    found = edit_motion(clip, clause_of("jumps"), span=(2, 4), keep="legs", steps=3, checkpoint=checkpoint)
    assert (
        same(found, clip, kept_handles("legs"))
        and same(found, clip, frames=slice(0, 40))
        and same(found, clip, frames=slice(80, None))
    )
    assert not same(found, clip, frames=slice(40, 80))


def test_a_span_joins_more_smoothly_than_what_would_be_there_without_the_rest(clip, checkpoint):
    free = generate_motion("jumps", 8, checkpoint=checkpoint, seed=9)
    pasted = put_back(free, clip, np.zeros(30, bool), 40, 80, fade=0)
    made = edit_motion(clip, clause_of("jumps"), span=(2, 4), checkpoint=checkpoint, seed=9)
    jump = [np.abs(np.diff(encode(motion)[[39, 40]][:, 10:], axis=0)).mean() for motion in (pasted, made)]
    usual = [np.median(np.abs(np.diff(encode(motion)[:, 10:], axis=0)).mean(axis=1)) for motion in (clip, free)]
    assert jump[1] < 0.9 * min(usual) and jump[0] > 1.05 * max(usual)  # no more than from any frame to the next


def test_the_same_seed_gives_the_same_edit(clip, checkpoint):
    one, again, other = (
        edit_motion(clip, clause_of("waves"), keep="legs", steps=2, seed=seed, checkpoint=checkpoint)
        for seed in (1, 1, 2)
    )
    assert same(one, again) and not same(one, other)


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
        [clauses_of([("walks", 2.0)]), clauses_of([("walks", 1.0), ("runs", 6.0)])],
        loop=True,
        steps=3,
        checkpoint=checkpoint,
    )
    assert len(one) == 41 and len(long) == 141
    for motion in (one, long):
        assert same(motion, motion.take(np.array([len(motion) - 1] + [0] * (len(motion) - 1))), frames=slice(0, 1))
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
