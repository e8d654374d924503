"""Human motion on creatures: crawling, flying and snakes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bunraku
from bunraku.anatomy.anatomy import Anatomy, reference_anatomy
from bunraku.anatomy.joints import attach_joints
from bunraku.anatomy.legs import BodyPlan, check_plans
from bunraku.anatomy.names.bone_names import handle_of_joints
from bunraku.core.animation import Animation
from bunraku.core.body.layout import HANDLE_NAMES, JOINT_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_from_axis_angle, matrix_y, rotation_between
from bunraku.core.motion import HandleMotion, SkeletalMotion, Skeleton, line_up, local_rotations
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError
from bunraku.files.samples import sample_character
from bunraku.pipelines.to_reference import creature_motion
from bunraku.retarget.creatures import find_limbs, find_stance
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.locomotion import BEATS, HOVER, ROLLS, moved_so, wing_swing
from bunraku.retarget.rig_parts import RigParts
from bunraku_lab.evaluation.transfer.quadrupeds import captured_animal
from bunraku_lab.synthetic.families import EVALUATION_SEED, code_made_character
from bunraku_lab.synthetic.samples import make_sample

BARE = Stages(feet=False, floor=False, smooth=False, ground=False, hands=False)
SWING = 0.4


@pytest.fixture(scope="module")
def dog():
    return make_sample("dog", rigged=True)


def dog_skeleton(dog) -> Skeleton:
    rig = dog.rig
    offsets = rig.positions.copy()
    offsets[1:] -= rig.positions[rig.parents[1:]]
    return Skeleton(rig.names, rig.parents, offsets)


def trot(dog, frames: int = 31, fps: float = 30.0, heading: float = 0.0, flat: bool = False) -> SkeletalMotion:
    """Diagonal legs swing by SWING about the hips and shoulders; the dog goes ahead at 1 m/s."""
    skeleton = dog_skeleton(dog)
    names, parents = skeleton.names, skeleton.parents
    angles = np.zeros((frames, len(names), 3))
    phase = 2 * np.pi * np.arange(frames) / 20
    for name, sign in (("LeftArm", 1), ("RightArm", -1), ("LeftUpLeg", -1), ("RightUpLeg", 1)):
        angles[:, names.index(name), 0] = sign * SWING * np.sin(phase)
    angles[:, 0, 1] = heading
    world = np.array(matrix_from_axis_angle(angles))
    for joint in range(1, len(names)):
        world[:, joint] = world[:, parents[joint]] @ world[:, joint]
    ahead = matrix_y(np.array(heading)) @ [0, 0, 1.0]
    path = skeleton.positions[0] + np.arange(frames)[:, None] / fps * ahead
    if flat:  # all bones of the rest pose along +X, as captured animals come
        rest = skeleton.positions.astype(np.float64)
        axes = np.tile(np.eye(3), (len(names), 1, 1))
        for joint in range(len(names)):
            below = np.flatnonzero(parents == joint)
            bone = rest[below[0]] - rest[joint] if len(below) else axes[parents[joint]][:, 0]
            axes[joint] = rotation_between(np.array([1.0, 0, 0]), bone)
        offsets = skeleton.offsets.astype(np.float64)
        offsets[1:] = np.einsum("jba,jb->ja", axes[parents[1:]], offsets[1:])
        skeleton, world = Skeleton(names, parents, offsets), world @ axes
    return SkeletalMotion(skeleton, local_rotations(world, parents), path, fps)


def person(flat_crawl: bool = False) -> SkeletalMotion:
    """The reference body swinging its legs, or on its hands and knees."""
    body = reference_body()
    angles = np.zeros((12, 22, 3))
    root = np.tile(body.joints[0], (12, 1))
    if flat_crawl:
        angles[:, 0, 0] = np.pi / 2
        for side in ("left", "right"):
            angles[:, JOINT_NAMES.index(f"{side}_hip"), 0] = -np.pi / 2
            angles[:, JOINT_NAMES.index(f"{side}_knee"), 0] = np.pi / 2
        angles[:, JOINT_NAMES.index("left_shoulder"), 1] = -np.pi / 2
        angles[:, JOINT_NAMES.index("right_shoulder"), 1] = np.pi / 2
    else:
        angles[:, JOINT_NAMES.index("left_hip"), 0] = np.linspace(-0.5, 0.5, 12)
    return SkeletalMotion(body.skeleton, matrix_from_axis_angle(angles), root, 20.0)


def limb(animation, dog, handle_name: str) -> np.ndarray:
    """Where the mesh of a lower leg is from the mesh of the upper one in each frame, shape (N, 3)."""
    parts = RigParts.of(dog)
    vertices = animation.vertices()
    upper, lower = (HANDLE_NAMES.index(name) for name in handle_name.split(">"))
    weights = parts.handles.weights * dog.areas[:, None]
    position = [np.einsum("v,nvi->ni", weights[:, some] / weights[:, some].sum(), vertices) for some in (upper, lower)]
    return position[1] - position[0]


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_four_legs_under_a_level_trunk_are_seen_in_the_rest_pose_or_in_the_clip(dog, flat, heading):
    found = creature_motion(trot(dog, frames=40, heading=heading, flat=flat), fps=30.0)
    assert found is not None and found.plan.kind == "four legs" and found.plan.tail and not found.plan.upright
    turn = found.motion.root_rotation[0] @ [0, 0, 1.0]
    assert turn == pytest.approx([np.sin(heading), 0, np.cos(heading)], abs=0.05)


def test_people_are_no_animals_even_on_hands_and_knees():
    assert creature_motion(person()) is None
    assert creature_motion(person(flat_crawl=True)) is None


@pytest.mark.parametrize("onto", ["rig", "handles"])
@pytest.mark.parametrize("flat", [False, True])
def test_legs_swing_about_the_rest_pose_of_the_target(dog, onto, flat):
    motion = trot(dog, frames=41, flat=flat)  # two whole cycles, so that the mean of the clip is how the dog stands
    kept = {} if onto == "rig" else {"handles": RigParts.of(dog).handles}
    result = bunraku.transfer(dog, motion, onto=onto, stages=BARE, **kept)
    rest = limb(result, replace(dog), "left_hip>left_knee")[[0, 10, 20]]
    for frame, ahead in ((5, -1), (15, 1)):
        got = limb(result, dog, "left_hip>left_knee")[frame]
        want = matrix_from_axis_angle(np.array([ahead * SWING, 0, 0])) @ rest[0]
        angle = np.degrees(np.arccos(got @ want / np.linalg.norm(got) / np.linalg.norm(want)))
        assert angle < 6
    ahead = np.diff(result.vertices().mean(axis=1), axis=0).mean(axis=0) * 30
    assert ahead[2] == pytest.approx(1.0, rel=0.1) and abs(ahead[0]) < 0.05


def test_the_predicted_handles_of_a_dog_keep_all_feet_down_and_the_trunk_level(dog):
    bare = sample_character("dog")
    result = bunraku.transfer(bare, trot(dog, frames=41, flat=True))
    assert isinstance(result, bunraku.Animation) and result.reference is not None and result.reference.own_kind
    vertices = result.vertices()
    rise = 0.5 * (1 - np.cos(SWING))  # of legs half a metre long that swing together, and so of the source itself
    low = vertices[..., 1].min(axis=1)
    assert low.max() < rise + 0.01 * bare.height and low.min() > -0.01 * bare.height
    head = result.character.vertices[:, 1].argmax()
    assert vertices[:, head, 1].min() > 0.8 * bare.height  # nothing stands on its front paws


def test_what_cannot_be_is_refused_with_what_is_missing(dog):
    body = reference_body()
    with pytest.raises(CharacterError, match=r"four legs.*no front legs that reach the ground"):
        bunraku.transfer(body.character(), trot(dog))
    fish = BodyPlan(hind=0, front=0, upright=False, arms=True, wings=False, tail=True)
    four = BodyPlan(hind=2, front=2, upright=False, arms=True, wings=False, tail=True)
    with pytest.raises(CharacterError, match=r"dog: .*without legs.*4 legs"):
        check_plans(fish, four, "dog")
    with pytest.raises(CharacterError, match=r"tuna: .*no legs"):
        check_plans(four, fish, "tuna")
    check_plans(four, four, "dog")
    check_plans(fish, fish, "tuna")


def test_a_clip_written_as_a_captured_skeleton_has_the_same_paws(dog):
    """The skeleton of the evaluation moves its joints as the rig's bones move, whatever its rest pose is."""
    rig = bunraku.transfer(dog, trot(dog, frames=21), onto="rig", stages=BARE)
    assert isinstance(rig, bunraku.RigAnimation)
    parts, bones = RigParts.of(dog), rig.world()[1]
    plain = captured_animal(rig, parts, flat=False)
    flat = captured_animal(rig, parts, flat=True)
    for one in (plain, flat):
        for name, bone in (("LeftForeArm", "LeftForeArm"), ("RightFoot", "RightFoot"), ("Head", "Head")):
            joint = one.motion.skeleton.names.index(name)
            assert one.motion.world()[1][:, joint] == pytest.approx(bones[:, dog.rig.names.index(bone)], abs=1e-4)
    assert np.abs(np.linalg.norm(flat.motion.skeleton.offsets[:, 1:], axis=1)).min() < 1e-6  # bones along +X


def flapping(seconds: float = 2.0) -> bunraku.Animation:
    """The sample dragon on the spot, beating its wings."""
    parts = RigParts.of(make_sample("dragon", rigged=True))
    count = round(20 * seconds)
    turns = np.tile(np.eye(3), (count, 30, 1, 1))
    still = HandleMotion(np.zeros((count, 30, 3)), turns, np.zeros((count, 3)), turns[:, 0], 20.0).of_own_body()
    flown = moved_so(still, "fly", slice(0, count), Anatomy.of(parts.character, parts.handles))
    body = replace(parts.character, rig=None)
    fitted = fit_motion(flown, Anatomy.of(body, parts.handles), Stages(smooth=False))
    return bunraku.Animation(body, parts.handles, replace(fitted, root_translation=np.zeros((count, 3))))


def test_what_flies_goes_onto_wings_in_the_air_and_onto_nothing_else(dog):
    source = flapping()
    found = creature_motion(source, fps=20.0)
    assert found is not None and found.flies
    parts = RigParts.of(code_made_character("bird", EVALUATION_SEED + 2))
    assert parts.anatomy.plan.wings
    result = bunraku.transfer(replace(parts.character, rig=None), source, handles=parts.handles, fps=20.0)
    vertices = result.vertices()
    assert vertices[..., 1].min() > parts.character.vertices[:, 1].min() + 0.15 * parts.character.height
    wing = parts.handles.weights[:, HANDLE_NAMES.index("left_wing")] > 0.5
    trunk = parts.handles.weights[:, 0] > 0.5
    beat = vertices[:, wing, 1].mean(axis=1) - vertices[:, trunk, 1].mean(axis=1)
    assert np.ptp(beat) > 0.05 * parts.character.height
    with pytest.raises(CharacterError, match="a flight, and no wings"):
        bunraku.transfer(replace(dog, rig=None), source, handles=RigParts.of(dog).handles)


def test_two_legs_under_a_level_trunk_go_from_stance_to_stance_and_onto_people_by_the_reference_body():
    parts = RigParts.of(code_made_character("dinosaur", EVALUATION_SEED))
    count, body = 30, replace(parts.character, rig=None)
    angles = np.zeros((count, 30, 3))
    swing = SWING * np.sin(2 * np.pi * np.arange(count) / 15)
    for name, sign in (("left", 1), ("right", -1)):
        for part in ("hip", "knee", "ankle", "foot"):
            angles[:, HANDLE_NAMES.index(f"{name}_{part}"), 0] = sign * swing
    turns, still = matrix_from_axis_angle(angles), np.zeros((count, 3))
    turns, moves = attach_joints(turns, parts.handles.positions, parts.joints)
    motion = HandleMotion(moves, turns, still, np.tile(np.eye(3), (count, 1, 1)), 20.0)
    source = bunraku.Animation(body, parts.handles, motion)
    found = creature_motion(source, fps=20.0)
    assert found is not None and found.plan.kind == "two legs" and found.person is not None and not found.flies
    same = bunraku.transfer(body, source, handles=parts.handles, fps=20.0, stages=BARE)
    away = same.vertices() - source.vertices()
    lift = away[0].mean(axis=0)  # the lowest point of the source is on the ground there
    assert np.abs(lift[[0, 2]]).max() < 1e-3
    assert np.linalg.norm(away - lift, axis=-1).mean() < 0.01 * body.height
    person = reference_body()
    moved = bunraku.transfer(person.character(), source, handles=person.handles, fps=20.0)
    assert moved.reference is found.person or not moved.reference.own_kind


def test_a_clip_that_ends_amid_a_stride_has_the_same_stance_on_both_sides(dog):
    whole, cut = (
        trot(dog, frames=41, flat=True),
        trot(dog, frames=11, flat=True),
    )  # half a cycle: legs on one side ahead
    stances = []
    for motion in (whole, cut):
        parts = handle_of_joints(motion.skeleton.names, motion.skeleton.parents)
        limbs = find_limbs(parts, motion.skeleton.parents)
        assert limbs is not None
        stances.append((find_stance(motion, limbs, parts), limbs))
    for stance, limbs in stances:
        assert stance is not None
        for left, right in (limbs.hind, limbs.front):
            for one, other in zip(left, right, strict=True):
                mirrored = stance.positions[other] * [-1, 1, 1]
                np.testing.assert_allclose(stance.positions[one], mirrored, atol=0.01)
    np.testing.assert_allclose(stances[0][0].positions, stances[1][0].positions, atol=0.03)


def sitting(dog, frames: int = 90) -> SkeletalMotion:
    """The dog sits for two thirds of a clip, its rump down, and stands up: its spine is no steeper than that of a body
    that stands may be, and the rest pose has all bones along +X.
    """
    motion = trot(dog, frames=frames, flat=True)
    names, parents = motion.skeleton.names, motion.skeleton.parents
    world = motion.world()[0].astype(np.float64)
    sits = np.radians(np.clip((62 - np.arange(frames)) / 8, 0, 1))[:, None]
    tip, fold = (np.array(matrix_from_axis_angle(angle * sits * [1.0, 0, 0])) for angle in (-26, -36))
    out = tip[:, None] @ world
    for joint in range(1, len(names)):
        line = [names[above] for above in line_up(joint, parents)]
        if {"LeftArm", "RightArm"} & set(line):
            out[:, joint] = world[:, joint]  # upright under the chest
        elif {"LeftUpLeg", "RightUpLeg"} & set(line):
            out[:, joint] = (fold if "UpLeg" in names[joint] else np.swapaxes(fold, -1, -2)) @ world[:, joint]
    return SkeletalMotion(motion.skeleton, local_rotations(out, parents), motion.root_translation, motion.fps)


def test_a_captured_dog_that_sits_first_stands_as_it_does_later(dog):
    motion = sitting(dog)
    parts = handle_of_joints(motion.skeleton.names, motion.skeleton.parents)
    limbs = find_limbs(parts, motion.skeleton.parents)
    chest = parts.tolist().index(HANDLE_NAMES.index("spine3"))
    angles = []
    for clip in (motion, trot(dog, frames=41, flat=True)):
        ahead = find_stance(clip, limbs, parts).positions[chest]
        angles.append(np.degrees(np.arctan2(ahead[1], ahead[2])))
    assert angles[0] == pytest.approx(angles[1], abs=3)
    moved = bunraku.transfer(dog, motion, onto="rig", stages=BARE)
    bones = moved.world()[1]
    names = dog.rig.names
    trunk = bones[:, names.index("Neck")] - bones[:, 0]
    slope = np.degrees(np.arctan2(trunk[:, 1], np.hypot(trunk[:, 0], trunk[:, 2])))
    rest = dog.rig.positions[names.index("Neck")] - dog.rig.positions[0]
    assert slope[-10:].mean() == pytest.approx(np.degrees(np.arctan2(rest[1], rest[2])), abs=4)
    assert slope[:30].mean() > slope[-10:].mean() + 15  # it sits first


FRAMES = 60
EVERY = slice(0, FRAMES)


def still() -> HandleMotion:
    turns = np.tile(np.eye(3), (FRAMES, 30, 1, 1))
    return HandleMotion(np.zeros((FRAMES, 30, 3)), turns, np.zeros((FRAMES, 3)), turns[:, 0], 20.0).of_own_body()


@pytest.fixture(scope="module")
def dragon():
    return RigParts.of(make_sample("dragon", rigged=True))


@pytest.fixture(scope="module")
def snake():
    return RigParts.of(code_made_character("snake", EVALUATION_SEED))


def part(parts, motion: HandleMotion, name: str) -> np.ndarray:
    """Where a part's middle is in each frame [m], shape (N, 3)."""
    weight = parts.handles.weights[:, HANDLE_NAMES.index(name)]
    held = weight > 0.5 * weight.max()
    world = motion.transforms(parts.handles.positions)
    return skin(parts.character.vertices[held], parts.handles.weights[held], world).mean(axis=1)


def test_what_flies_is_lifted_and_beats_its_wings_together(dragon):
    assert dragon.anatomy.plan.wings
    flown = moved_so(still(), "fly", EVERY, Anatomy.of(dragon.character, dragon.handles))
    root = float(reference_body().handles.positions[0, 1])
    assert flown.root_translation[:, 1].mean() == pytest.approx(HOVER * root, rel=0.1)
    assert wing_swing(still()) == 0 and wing_swing(flown) > BEATS
    fitted = fit_motion(flown, Anatomy.of(dragon.character, dragon.handles), Stages(smooth=False))
    heights = dragon.character.vertices[:, 1].min(), fitted.root_translation[:, 1].min()
    assert heights[1] > 0.2 * dragon.character.height
    left, right = (part(dragon, fitted, f"{side}_wing")[:, 1] for side in ("left", "right"))
    trunk = part(dragon, fitted, "spine3")[:, 1]
    assert np.ptp(left - trunk) > 0.1 * dragon.character.height
    assert np.corrcoef(left - trunk, right - trunk)[0, 1] > 0.95


def test_what_flies_does_not_fall_over(dragon):
    falls = np.linspace(0, 2.5, FRAMES)[:, None] * np.array([0, 0, 1.0])
    motion = replace(turned(matrix_from_axis_angle(falls), "left_wing"), root_rotation=matrix_from_axis_angle(falls))
    flown = moved_so(motion, "fly", EVERY, Anatomy.of(dragon.character, dragon.handles))
    up = flown.root_rotation[:, 1, 1]  # of the body's own up
    assert np.arccos(up.min()) < ROLLS + 0.02


def test_flight_ends_where_a_clause_ends(dragon):
    part_of_it = moved_so(still(), "fly", slice(0, 30), Anatomy.of(dragon.character, dragon.handles))
    heights = part_of_it.root_translation[:, 1]
    assert heights[:20].min() > 0.3 and heights[-10:].max() < 1e-6
    np.testing.assert_allclose(part_of_it.rotations[-5:], still().rotations[-5:], atol=1e-6)


def test_a_wave_runs_along_what_slithers_and_it_gets_ahead(snake):
    moved = moved_so(still(), "slither", EVERY, Anatomy.of(snake.character, snake.handles))
    length = np.ptp(snake.character.vertices[:, 2])
    assert moved.root_translation[-1, 2] > 0.5 and np.abs(moved.root_translation[:, 1]).max() < 1e-6
    fitted = fit_motion(moved, Anatomy.of(snake.character, snake.handles), Stages(smooth=False))
    tail, head = (part(snake, fitted, name)[:, 0] for name in ("tail", "head"))
    assert np.ptp(tail) > 0.03 * length and np.ptp(part(snake, fitted, "tail")[:, 1]) < 0.02 * length
    assert np.abs(np.correlate(tail - tail.mean(), head - head.mean(), "same")).argmax() != FRAMES // 2  # one follows


def test_what_swims_is_level_and_travels_by_its_length(snake):
    """A person lies on the front to swim, and a fish does not stand on its nose for that."""
    body = Anatomy.of(snake.character, snake.handles)
    prone = matrix_from_axis_angle(np.tile([1.5, 0, 0], (FRAMES, 1)))
    moved = moved_so(
        replace(turned(prone.transpose(0, 2, 1), "neck", "head"), root_rotation=prone), "swim", EVERY, body
    )
    assert np.degrees(np.arcsin(np.abs(moved.root_rotation[:, 1, 2].mean()))) < 5  # its tail is flat
    fitted = fit_motion(moved, body, Stages(smooth=False))
    length = np.ptp(snake.character.vertices[:, 2])
    travelled = fitted.root_translation[-1, 2] - fitted.root_translation[0, 2]
    assert 0.5 * length < travelled / (FRAMES / moved.fps) < 0.7 * length
    posed = part(snake, fitted, "head") - part(snake, fitted, "tail")
    assert np.degrees(np.abs(np.arctan2(posed[:, 1], posed[:, 2]).mean())) < 15


def test_what_travels_far_enough_keeps_its_way(snake):
    turned = replace(still(), root_rotation=np.tile(matrix_y(np.array(np.pi / 2)), (FRAMES, 1, 1)))
    path = np.linspace([0, 0, 0], [40.0, 0, 0], FRAMES)
    moved = moved_so(
        replace(turned, root_translation=path), "slither", EVERY, Anatomy.of(snake.character, snake.handles)
    )
    np.testing.assert_allclose(moved.root_translation[:, [0, 1]], path[:, [0, 1]], atol=1e-6)
    assert 0 < np.abs(moved.root_translation[:, 2]).max() < 1.5  # it sways with the wave


def lows(parts, motion: HandleMotion) -> np.ndarray:
    """Height of the lowest vertex over that at rest, over the height, shape (N,)."""
    animation = Animation(parts.character, parts.handles, motion)
    return (animation.vertices()[..., 1].min(axis=1) - parts.character.vertices[:, 1].min()) / parts.character.height


def lifted(height: float, where: slice) -> HandleMotion:
    """The whole body higher in some frames, in heights of the root."""
    path = np.zeros((FRAMES, 3))
    path[where, 1] = height * reference_body().handles.positions[0, 1]
    return replace(still(), root_translation=path)


def turned(turn: np.ndarray, *names: str) -> HandleMotion:
    """Parts turned in all frames."""
    rotations = still().rotations.copy()
    rotations[:, [HANDLE_NAMES.index(name) for name in names]] = turn[..., None, :, :]
    return replace(still(), rotations=rotations)


def test_who_stays_on_the_ground_does_not_hover(dragon):
    hovers = lifted(0.8, EVERY)
    assert lows(dragon, fit_motion(hovers, Anatomy.of(dragon.character, dragon.handles))).min() > 0.2  # it could fly
    grounded = moved_so(hovers, "stay", EVERY, Anatomy.of(dragon.character, dragon.handles))
    assert np.abs(lows(dragon, fit_motion(grounded, Anatomy.of(dragon.character, dragon.handles)))).max() < 0.01


@pytest.mark.parametrize(("way", "kept"), [("stay", True), ("run", False), ("step", False)])
def test_a_jump_stays_a_jump_and_a_walk_has_none(dragon, way, kept):
    jump = lifted(0.5, slice(20, 34))  # 0.7 s
    moved = moved_so(jump, way, EVERY, Anatomy.of(dragon.character, dragon.handles))
    high = lows(dragon, fit_motion(moved, Anatomy.of(dragon.character, dragon.handles), Stages(smooth=False))).max()
    assert (high > 0.15) == kept


def squeezed(legs: float) -> Anatomy:
    """The reference body on shorter legs."""
    body = reference_anatomy()
    hips = body.handles.positions[0, 1]

    def put(points: np.ndarray) -> np.ndarray:
        x, y, z = points.T
        return np.stack([x, np.where(y > hips, y - (1 - legs) * hips, legs * y), z], axis=1).astype(np.float32)

    character = replace(body.character, vertices=put(body.character.vertices))
    return Anatomy.of(character, replace(body.handles, positions=put(body.handles.positions)))


def test_a_body_on_short_legs_leaps_by_its_own_height():
    jump = replace(lifted(0.3, slice(20, 34)), own_height=False)
    heights = []
    for body in (reference_anatomy(), squeezed(0.3)):
        fitted = fit_motion(jump, body, Stages(smooth=False))
        heights.append(Animation(body.character, body.handles, fitted).vertices()[..., 1].min(axis=1).max())
        heights[-1] /= body.character.height
    assert heights[1] > 0.7 * heights[0]


def test_a_tail_that_a_tilted_trunk_holds_up_is_lowered(dragon):
    tilt = matrix_from_axis_angle(np.array([np.radians(50), 0, 0]))
    leans = replace(still(), root_rotation=np.tile(tilt, (FRAMES, 1, 1)))
    body = Anatomy.of(dragon.character, dragon.handles)
    tips = [part(dragon, fit_motion(leans, body, Stages(tail=on)), "tail_tip")[:, 1].mean() for on in (False, True)]
    assert tips[1] < tips[0] - 0.03 * dragon.character.height


def test_a_snake_lies_on_the_ground_whatever_was_drawn(snake):
    bow = matrix_from_axis_angle(np.sin(np.linspace(0, np.pi, FRAMES))[:, None] * np.array([1.0, 0, 0]))
    motion = turned(bow, "spine1", "spine2", "spine3", "neck", "head", "face", "head_top")
    motion = replace(motion, root_rotation=matrix_from_axis_angle(np.tile([0.4, 0, 0.2], (FRAMES, 1))))
    fitted = fit_motion(motion, Anatomy.of(snake.character, snake.handles))
    tail = part(snake, fitted, "tail")[:, 1]
    moved = fit_motion(
        moved_so(motion, "lie", EVERY, Anatomy.of(snake.character, snake.handles)),
        Anatomy.of(snake.character, snake.handles),
    )
    lies = part(snake, moved, "tail")[:, 1]
    height = snake.character.height
    assert np.ptp(tail) > 0.2 * height and np.ptp(lies) < 0.2 * np.ptp(tail)
    assert np.abs(lows(snake, moved)).max() < 0.02


def test_a_snake_raises_its_head(snake):
    up = matrix_from_axis_angle(np.array([-0.6, 0, 0]))
    motion = turned(up, "neck", "head", "face", "head_top")
    moved = moved_so(motion, "lie", EVERY, Anatomy.of(snake.character, snake.handles))
    np.testing.assert_allclose(moved.rotations, motion.rotations, atol=1e-6)
