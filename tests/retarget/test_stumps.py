"""Arms without hands: what ends in a fist that no handle tells apart must not sink into the ground either."""

from dataclasses import replace

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.body.reference import handle_positions
from bunraku.core.character import Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.handles.from_rig import rig_handles
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.synthetic.samples import make_sample


def clubbed():
    """The sample person with arms that reach far below its feet when they hang, and no hands."""
    person = make_sample("person", 0.5, rigged=True)
    weights = rig_handles(person).weights.copy()
    vertices = person.vertices.copy()
    for side in ("left", "right"):
        elbow, *hand = (HANDLE_NAMES.index(f"{side}_{part}") for part in ("elbow", "wrist", "fingers"))
        weights[:, elbow] += weights[:, hand].sum(axis=1)
        weights[:, hand] = 0
        wide = abs(float(vertices[weights[:, elbow] > 0.5, 0].mean()))
        far = np.abs(vertices[:, 0]) > wide
        vertices[far, 0] += 1.5 * (vertices[far, 0] - np.sign(vertices[far, 0]) * wide)
    character = replace(person, vertices=vertices, rig=None, source=None)
    return character, Handles(handle_positions(vertices, weights, character.areas), weights)


def test_an_arm_without_a_hand_does_not_sink():
    character, handles = clubbed()
    anatomy = Anatomy.of(character, handles)
    assert len(anatomy.stumps) == 2 and not anatomy.arms
    frames = 30
    rotations = np.tile(np.eye(3), (frames, HANDLE_COUNT, 1, 1))
    down = np.sin(np.linspace(0, np.pi, frames))
    for side, sign in (("left", -1), ("right", 1)):
        for part in ("shoulder", "elbow", "wrist", "fingers"):
            angle = sign * np.radians(85) * down[:, None] * [0, 0, 1.0]
            rotations[:, HANDLE_NAMES.index(f"{side}_{part}")] = matrix_from_axis_angle(angle)
    still = np.zeros((frames, 3))
    motion = HandleMotion(np.zeros((frames, HANDLE_COUNT, 3)), rotations, still, np.tile(np.eye(3), (frames, 1, 1)))

    def lowest(stages):
        fitted = fit_motion(motion, anatomy, stages)
        return float(skin(vertices, weights, fitted.transforms(handles.positions))[..., 1].min())

    seen = character.surface
    vertices, weights = character.vertices[seen], handles.weights[seen]
    assert lowest(Stages(floor=False)) < anatomy.floor - 0.1 * character.height
    assert lowest(Stages()) > anatomy.floor - 0.02 * character.height
