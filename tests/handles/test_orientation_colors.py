"""Where the colours of a mesh say that it faces."""

import numpy as np
import pytest

from bunraku.geometry.axes import AXES, ORIENTATIONS, upright_rotation
from bunraku.handles.orientation_colors import front_scores, variety
from bunraku.handles.orientation_evidence import combined, told
from bunraku_lab.synthetic.samples.isosurface import grid_surface

EQUAL = np.full(24, 1 / 24)


def ball():
    """A grey ball with a light eye and a dark mouth where it looks along +Z."""
    grid = np.indices((21, 21, 21)) - 10.0
    vertices, faces = grid_surface(np.linalg.norm(grid, axis=0) - 8.3, 1.0, np.full(3, -10.0))
    colors = np.full((len(vertices), 3), 120, np.uint8)
    ahead = vertices[:, 2] > 6
    colors[ahead & (vertices[:, 1] > 1)] = 255
    colors[ahead & (vertices[:, 1] < -1)] = 20
    return vertices, faces, colors


def test_a_painted_face_is_in_front():
    vertices, faces, colors = ball()
    seen = variety(vertices, faces, colors)
    assert AXES[int(seen.argmax())] == "+z"
    assert seen[AXES.index("-z")] < 1e-6  # the back is grey all over: no variance, by hand
    assert AXES[int(variety(vertices, faces[:, ::-1], colors).argmax())] == "+z"  # inside out
    chances = combined(EQUAL, vertices, paint=(faces, colors))
    of_up = {front: chances[ORIENTATIONS.index(("+y", front))] for front in ("+z", "-z", "+x", "-x")}
    assert max(of_up, key=of_up.get) == "+z" and of_up["+z"] > 4 * of_up["-z"]


def test_one_colour_tells_nothing():
    vertices, faces, colors = ball()
    plain = np.full_like(colors, 77)
    assert np.allclose(front_scores(variety(vertices, faces, plain)), 1)
    without, with_it = (told(vertices, None, paint)[0] for paint in (None, (faces, plain)))
    assert np.allclose(with_it - without, np.log(0.25))  # the same of all


@pytest.mark.parametrize("axes", ORIENTATIONS[::5])
def test_turning_the_mesh_turns_what_its_colours_tell(axes):
    vertices, faces, colors = ball()
    turn = upright_rotation(*axes)
    seen = variety(vertices @ turn, faces, colors)  # now it stands and faces as `axes` say
    assert AXES[int(seen.argmax())] == axes[1]
