"""What stands beside a character: ground, stray pieces, other characters."""

import numpy as np
import pytest
import trimesh

from bunraku.anatomy.scene import find_scene, separated
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import HandleMotion
from bunraku.errors import OptionError
from bunraku.files import load_animation, save_clips, with_still
from bunraku_lab.synthetic.samples import make_sample


def box(low, high):
    made = trimesh.creation.box(bounds=(low, high))
    return made.vertices, made.faces


def ball(center, radius):
    made = trimesh.creation.icosphere(1, radius)
    return made.vertices + center, made.faces


def beside(body, *others):
    """A body with other meshes in one file."""
    meshes = [(body.vertices, body.faces), *others]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [own + start for (_, own), start in zip(meshes, starts, strict=False)]
    return Character("scene", np.concatenate([own for own, _ in meshes]), np.concatenate(faces))


def around(body, *things):
    """Boxes below a body: how far each reaches beyond it, its bottom and its top, in heights of the body."""
    low, high, height = body.vertices.min(axis=0), body.vertices.max(axis=0), body.height
    wide = np.array([1, 0, 1]) * height
    return [
        box(low * [1, 0, 1] - wide * more + [0, low[1] + bottom * height, 0],
            high * [1, 0, 1] + wide * more + [0, low[1] + top * height, 0])
        for more, bottom, top in things
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["person", "dog", "robot"])
@pytest.mark.parametrize(
    "things", [[(0.3, -0.03, 0.0)], [(0.3, -0.01, 0.02)], [(0.05, -0.8, 0.0)], [(0.3, -0.2, -0.1), (0.1, -0.1, 0.0)]],
    ids=["plate", "plate that feet sink into", "column", "steps"],
)  # fmt: skip
def test_the_ground_below_a_body_is_no_part_of_it(name, things):
    body = make_sample(name, 0.5)
    scene = find_scene(beside(body, *around(body, *things)))
    assert len(scene.characters) == 1 and not scene.strays.any()
    assert scene.ground.tolist() == [False] * len(body.vertices) + [True] * 8 * len(things)


def test_stray_pieces_and_pieces_that_belong_to_the_body():
    body = make_sample("person", 0.5)
    low, height = body.vertices[:, 1].min(), body.height
    eyes = [ball([side * 0.05 * height, low - 0.3 * height, 0], 0.02 * height) for side in (-1, 1)]
    scene = find_scene(beside(body, *eyes))
    assert (
        scene.strays.sum() == sum(len(vertices) for vertices, _ in eyes)
        and not scene.strays[: len(body.vertices)].any()
    )
    hooves = [box([x, low - 0.15 * height, -0.1], [x + 0.1, low - 0.1 * height, 0.1]) for x in (-0.4, 0.3)]
    assert find_scene(beside(body, *hooves)).characters[0].all()
    halo = ball([0, body.vertices[:, 1].max() + 0.08 * height, 0], 0.06 * height)
    assert find_scene(beside(body, halo)).characters[0].all() and not find_scene(body).lines


def test_one_of_two_characters_moves(tmp_path):
    body = make_sample("person", 0.5)
    other = body.vertices + [np.ptp(body.vertices[:, 0]) + 0.1, 0, 0]
    both = beside(body, (other, body.faces))
    first, second = (separated(both, number) for number in (1, 2))
    assert "2 characters" in first[1][0] and "--character" in first[1][0]
    assert (first[0].beside != second[0].beside).all() and separated(first[0])[0] is first[0]
    assert separated(both, 2)[0] is second[0] and separated(body)[0] is body  # so clips go into one file
    with pytest.raises(OptionError, match="no character 3"):
        separated(both, 3)
    handles = Handles(both.vertices[:2], np.eye(1, 2).repeat(len(both.vertices), axis=0))
    turns = matrix_from_axis_angle(np.array([[0, 0.1 * frame, 0] for frame in range(5)]))
    still = np.zeros((5, 2, 3)), np.tile(np.eye(3), (5, 2, 1, 1))
    motion = HandleMotion(*still, np.arange(15).reshape(5, 3) * 0.1, turns, 20.0)
    moved = Animation(second[0], handles, motion)
    posed, stays = moved.vertices(), second[0].beside
    assert np.abs(posed[:, stays] - both.vertices[stays]).max() == 0 and np.ptp(posed[:, ~stays], axis=0).min() > 0.3
    assert isinstance(with_still(moved), RigAnimation)
    for number, path in enumerate(("one.glb", "clips.glb")):
        path = tmp_path / path
        moved.save(path) if number == 0 else save_clips({"a": moved, "b": moved}, path)
        assert np.abs(load_animation(path, 0, 20.0).vertices() - posed).max() < 1e-5
