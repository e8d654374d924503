"""Make the picture of docs/files.md: `python tools/make_rest_pose_pictures.py`.

One sample character in five rest poses with the handles that the shipped weights find, and below each the same frames
of the same motions. Takes a minute on a laptop and needs no data.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.pipelines.animate import rig
from bunraku.render import contact_sheet, render_animation, render_still
from bunraku.retarget.fit import fit_motion
from bunraku_lab.evaluation.handles.rest_poses import REST_POSES, posed_limbs
from bunraku_lab.evaluation.handles.subjects import subject
from bunraku_lab.synthetic.samples import make_sample
from bunraku_lab.synthetic.stock_motions import stock_motion

OUT = Path(__file__).parents[1] / "docs/pictures/rest-poses.png"
FRAMES = (("dance", 0.75), ("walk", 0.25), ("kick", 0.5))  # motion and moment [s]
SIZE = (200, 230)


def main() -> None:
    one = subject(make_sample("person", rigged=True), "person")
    poses = (*REST_POSES, "crouching")
    rows: list[list[np.ndarray]] = [[] for _ in range(1 + len(FRAMES))]
    for pose in poses:
        character = Character("person", posed_limbs(one.truth, pose), one.character.faces, colors=one.character.colors)
        handles = rig(character)
        anatomy = Anatomy.of(character, handles)
        rows[0].append(render_still(character, handles, size=SIZE))
        for row, (name, moment) in zip(rows[1:], FRAMES, strict=True):
            animation = Animation(character, handles, fit_motion(stock_motion(name, 2.0), anatomy))
            row.extend(render_animation(animation, size=SIZE, times=np.array([moment])))
    labels = [f"rest pose: {pose}" for pose in poses] + [name for name, _ in FRAMES for _ in poses]
    contact_sheet([picture for row in rows for picture in row], labels, OUT, columns=len(poses))
    print(OUT)


if __name__ == "__main__":
    main()
