"""Files of blocks, made with trimesh, animated, written and read back."""

import json

import numpy as np
import pytest
import trimesh

from bunraku.body.layout import HANDLE_NAMES
from bunraku.cli import main
from bunraku.errors import WeightsError
from bunraku.nn.checkpoints import shipped_checkpoint
from bunraku_lab.evaluation.handles.block_files import block_joints

BOXES = {
    "torso": ((-0.25, 0.7, -0.12), (0.25, 1.3, 0.12)),
    "head": ((-0.2, 1.3, -0.2), (0.2, 1.7, 0.2)),
    "arm-left": ((0.25, 0.6, -0.08), (0.42, 1.28, 0.08)),
    "arm-right": ((-0.42, 0.6, -0.08), (-0.25, 1.28, 0.08)),
    "leg-left": ((0.01, 0, -0.1), (0.22, 0.7, 0.1)),
    "leg-right": ((-0.22, 0, -0.1), (-0.01, 0.7, 0.1)),
}


def test_what_one_handle_moves_is_one_piece():
    hip, spine, head = (HANDLE_NAMES.index(name) for name in ("left_hip", "spine2", "head"))
    label, joints = block_joints(np.array([spine, head, hip, hip, spine]), len(HANDLE_NAMES))
    assert label[0] == label[4] and label[2] == label[3] and len(set(label)) == 3
    assert set(joints) == {(label[1], label[0]), (label[2], label[0])}


def test_a_figure_of_blocks_is_measured_and_a_ball_is_none(tmp_path, capsys):
    try:
        for name in ("handles", "orientation", "diffusion"):
            shipped_checkpoint(name)
    except WeightsError:
        pytest.skip("needs the shipped weights")
    scene = trimesh.Scene()
    for name, (low, high) in BOXES.items():
        box = trimesh.creation.box(bounds=(low, high))
        scene.add_geometry(box, node_name=name, geom_name=name)
    scene.export(tmp_path / "man.glb")
    trimesh.creation.icosphere(2).export(tmp_path / "ball.glb")
    status = main(
        ["evaluate", "blocks", str(tmp_path / "man.glb"), str(tmp_path / "ball.glb"), "--seconds", "1", "--json"]
    )
    man, ball = json.loads(capsys.readouterr().out)
    assert status == 0 and man["blocks"] == 6 and man["shear"] < 1e-4 and man["gap"] < 0.01
    assert ball["blocks"] == 0
