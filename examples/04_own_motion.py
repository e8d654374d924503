"""Drive the handles yourself, without a sentence: Eq. 3 of the paper.

The left arm, and nothing else, swings up and down about the shoulder.

    python examples/04_own_motion.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np

import bunraku
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.geometry.rotations import matrix_from_axis_angle

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "outputs")
folder.mkdir(parents=True, exist_ok=True)

character = bunraku.sample_character("person")
handles = bunraku.rig(character)
arm = [HANDLE_NAMES.index(name) for name in ("left_shoulder", "left_elbow", "left_wrist", "left_fingers")]

frames, count = 40, len(HANDLE_NAMES)
angle = 0.9 * np.sin(np.linspace(0, 2 * np.pi, frames))
turn = matrix_from_axis_angle(np.stack([0 * angle, 0 * angle, angle], axis=1))  # about +Z, shape (frames, 3, 3)
rotations = np.tile(np.eye(3), (frames, count, 1, 1))
translations = np.zeros((frames, count, 3))
for handle in arm:
    lever = handles.positions[handle] - handles.positions[arm[0]]  # the whole arm turns about the shoulder
    rotations[:, handle] = turn
    translations[:, handle] = turn @ lever - lever
motion = bunraku.HandleMotion(
    translations, rotations, np.zeros((frames, 3)), np.tile(np.eye(3), (frames, 1, 1)), fps=20
)
animation = bunraku.Animation(character, handles, motion)
path = animation.save(folder / "person-arm.glb")
print(f"wrote {path}")

# Check: what belongs to the arm moves, what has no share in it stays.
travel = np.linalg.norm(animation.vertices() - character.vertices, axis=2).max(axis=0)
share = handles.weights[:, arm].sum(axis=1)
assert travel[share > 0.95].min() > 0
assert travel[share < 1e-6].max(initial=0) < 1e-4
assert travel.max() > 0.2 * character.height
