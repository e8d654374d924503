"""Joints where handles meet."""

import numpy as np
import trimesh

from bunraku.anatomy.joints import find_joints
from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.character import Character, Handles

SHOULDER, ELBOW = HANDLE_NAMES.index("left_shoulder"), HANDLE_NAMES.index("left_elbow")


def pieces(trace):
    """Two pieces of an arm that touch at x = 0.5, and a head far above with a trace of both."""
    boxes = [trimesh.creation.box((0.5, 0.1, 0.1)).subdivide().subdivide() for _ in range(2)]
    head = trimesh.creation.box((0.4, 0.4, 0.4)).subdivide().apply_translation((0, 1, 0))
    for number, box in enumerate(boxes):
        box.apply_translation((0.25 + 0.5 * number, 0, 0))
    whole = trimesh.util.concatenate([*boxes, head])
    weights = np.zeros((len(whole.vertices), HANDLE_COUNT), np.float32)
    first, second = len(boxes[0].vertices), 2 * len(boxes[0].vertices)
    weights[:first, SHOULDER], weights[first:second, ELBOW] = 1, 1
    weights[second:, [SHOULDER, ELBOW]] = trace
    weights[second:, HANDLE_NAMES.index("head")] = 1 - 2 * trace
    character = Character("arm", whole.vertices.astype(np.float32), whole.faces)
    mass = weights * character.areas[:, None]
    positions = (mass.T @ character.vertices) / np.maximum(mass.sum(axis=0), 1e-12)[:, None]
    return character, Handles(positions.astype(np.float32), weights)


def test_pieces_meet_where_they_are_nearest():
    for trace in (0.0, 0.02):  # a trace of both anywhere else is no joint
        joint = find_joints(*pieces(trace)).positions[ELBOW]
        assert np.abs(joint - [0.5, 0, 0]).max() < 0.07


def test_a_trace_of_an_arm_on_what_lies_elsewhere_is_no_elbow():
    character, handles = pieces(0.2)  # as much as parts that blend have
    joint = find_joints(character, handles).positions[ELBOW]
    assert np.abs(joint - [0.5, 0, 0]).max() < 0.1
