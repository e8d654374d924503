"""Evidence for the orientation of a character: colours, shape, and how both are weighed."""

import numpy as np
import pytest

from bunraku.anatomy.handles.orientation_evidence import (
    ColorEvidence,
    Combination,
    GroundEvidence,
    MirrorEvidence,
    NameEvidence,
    RestEvidence,
    ShapeView,
    gathered,
    has_rule,
    kind_weights,
)
from bunraku.core.geometry.axes import AXES, ORIENTATIONS, axis_vector, upright_rotation
from bunraku.core.geometry.surface import surface_points
from bunraku_lab.synthetic.fields import grid_surface

EQUAL = np.full(24, 1 / 24)
variety, front_scores = ColorEvidence().variety, ColorEvidence().front_scores
rest = RestEvidence().rest
ground_fit, asymmetries = GroundEvidence().fit, MirrorEvidence().asymmetries


def combined(network, vertices=None, prior=None, surface=None, bones=None, paint=None):
    """Probabilities by all evidence."""
    combination, view = Combination(), ShapeView(vertices, surface, paint)
    return combination(network, gathered(view), 1.0 if vertices is None else combination.worth(vertices), prior, bones)


def evidence_of_file(vertices):
    """Log-odds by the ground and by the mirror plane."""
    return sum(evidence.log_odds(ShapeView(vertices)) for evidence in (GroundEvidence(), MirrorEvidence()))


def evidence_of_surface(points, normals):
    """Log-odds by what a shape would rest on."""
    return RestEvidence().log_odds(ShapeView(surface=(points, normals)))


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
    without, with_it = (gathered(ShapeView(vertices, None, paint)) for paint in (None, (faces, plain)))
    assert np.allclose(with_it - without, np.log(0.25))  # the same of all


@pytest.mark.parametrize("axes", ORIENTATIONS[::5])
def test_turning_the_mesh_turns_what_its_colours_tell(axes):
    vertices, faces, colors = ball()
    turn = upright_rotation(*axes)
    seen = variety(vertices @ turn, faces, colors)  # now it stands and faces as `axes` say
    assert AXES[int(seen.argmax())] == axes[1]


CUBE = np.array([[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6], [0, 4, 5], [0, 5, 1],
                 [1, 5, 6], [1, 6, 2], [2, 6, 7], [2, 7, 3], [3, 7, 4], [3, 4, 0]])  # fmt: skip


def box(low, high):
    """Corners of a box with outward faces `CUBE`."""
    (x, y, z), (u, v, w) = low, high
    return np.array([(x, y, z), (x, v, z), (u, v, z), (u, y, z), (x, y, w), (x, v, w), (u, v, w), (u, y, w)], float)


def statue():
    """A head that looks along +Z on a neck, on a plinth, as points and normals."""
    boxes = [box((-0.5, 0, -0.5), (0.5, 0.2, 0.5)), box((-0.1, 0.2, -0.1), (0.1, 1, 0.1))]
    boxes += [box((-0.15, 1, -0.1), (0.15, 1.3, 0.4))]
    faces = np.concatenate([CUBE + 8 * n for n in range(3)])
    points, normals = surface_points(np.concatenate(boxes), faces, 4000)
    return points, normals


def test_what_stands_on_a_plinth_rests_on_it():
    points, normals = statue()
    found = rest(points, normals)
    up = AXES.index("+y")
    assert found[up, 0] > np.log(0.15) and found[up, 1] > 0.99 and found[up, 2] > 0.9
    others = np.delete(found, up, axis=0)
    assert others[:, 2].max() < 0.7 and found[AXES.index("-y"), 1] > 0.5  # upside down it stands on its head


def test_a_ball_rests_on_nothing():
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(3000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = rest(normals * 3, normals)
    assert np.ptp(found[:, 0]) < 1.5 and found[:, 2].max() < 0.3
    assert np.isfinite(rest(np.zeros((5, 3)), normals[:5])).all()


def test_turning_the_shape_turns_what_it_tells():
    points, normals = statue()
    told = evidence_of_surface(points, normals)
    assert ORIENTATIONS[int(told.argmax())][0] == "+y"
    for up, front in ORIENTATIONS[::5]:
        turn = upright_rotation(up, front)
        again = evidence_of_surface(points @ turn, normals @ turn)
        assert ORIENTATIONS[int(again.argmax())][0] == up
        assert np.sort(again) == pytest.approx(np.sort(told), abs=1e-6)
    assert np.ptp(told) <= np.log(115) + 1e-6


def test_bones_are_a_witness_like_others():
    back, usual = ORIENTATIONS.index(("+y", "-z")), ORIENTATIONS.index(("+y", "+z"))
    network = np.full(24, 0.01 / 22)
    network[[back, usual]] = 0.49, 0.5
    assert combined(network, bones=("+y", "-z"))[back] > 0.95
    network[[back, usual]] = 0.003, 0.987  # names may be swapped: the shape is asked too
    assert 0.05 < combined(network, bones=("+y", "-z"))[usual] < 0.95
    alone = combined(EQUAL, bones=("+y", "-z"))  # and then the other front is meant, no side
    assert alone[back] > 0.9 and alone[usual] > 5 * alone[ORIENTATIONS.index(("+y", "+x"))]
    assert axis_vector("-z")[2] == -1


@pytest.mark.parametrize("axes", ORIENTATIONS[::5])
def test_what_is_named_a_nose_is_ahead_of_its_head_and_a_tail_behind(axes):
    turn = upright_rotation(*axes)
    places = {"Head": (0, 0.8, 0), "Nose": (0, 0.8, 0.2), "tail.001": (0, 0.3, -0.3), "Cube": (0, 0.5, 0)}
    same_up = [number for number, (up, _) in enumerate(ORIENTATIONS) if up == axes[0]]
    for names in (["Head", "Nose"], ["tail.001"], list(places), ["Cube"]):
        named = names, np.array([places[name] for name in names]) @ turn
        told = NameEvidence().log_odds(ShapeView(body() @ turn, named=named))[same_up]
        if names == ["Cube"]:
            assert np.ptp(told) == 0
        else:
            assert ORIENTATIONS[same_up[int(told.argmax())]] == axes and np.sort(told)[-2] < told.max() - 3


UP = AXES.index("+y")


def body(seed=0):
    """Points that mirror each other across x = 0 and nowhere else, with the lowest at y = 0 and z around 0."""
    half = np.random.default_rng(seed).uniform([0, 0, -0.3], [0.5, 1, 0.3], (300, 3)) ** np.array([1, 1.5, 1])
    half = np.nan_to_num(half, nan=0.1)
    half[0, 1] = 0
    return np.concatenate([half, half * [-1, 1, 1]]).astype(np.float32)


def test_the_ground_is_under_what_stands_on_it():
    points = body()
    fits = ground_fit(points)
    assert fits.argmax() == UP and fits[UP] > 0.8 and np.delete(fits, UP).max() < 0.01
    assert ground_fit(points * 1000) == pytest.approx(fits, abs=1e-5)
    hanging = ground_fit(points - np.float32([0, 1, 0]) * points[:, 1].max())
    assert hanging.argmax() == AXES.index("-y")
    for up, front in ORIENTATIONS[::5]:
        assert ground_fit(points @ upright_rotation(up, front).astype(np.float32)).argmax() == AXES.index(up)


def test_the_ground_says_nothing_of_what_stands_nowhere():
    points = body()
    middle = points - (points.min(axis=0) + points.max(axis=0)) / 2
    corner = points - points.min(axis=0)
    far = points + np.float32([5, 7, -9])
    flat = np.zeros((5, 3), np.float32) + np.float32([3, 3, 3])
    for moved in (middle, corner, far, flat):
        fits = ground_fit(moved)
        assert np.isfinite(fits).all() and np.ptp(fits) < 0.05


def test_left_and_right_mirror_each_other():
    points = body()
    found = asymmetries(points)
    assert found[0] < 1e-6 and found[1:].min() > 0.01
    assert asymmetries(points + np.float32([40, 0, 0]))[0] < 1e-4
    assert asymmetries(points[:, [1, 0, 2]])[1] < 1e-6
    angle = np.linspace(0, 2 * np.pi, 361)[:-1]
    cone = np.stack([np.cos(angle), np.linspace(0, 1, 360) * 0 + 1, np.sin(angle)], 1).astype(np.float32)
    cone = np.concatenate([cone * (1 - level) * [1, 0, 1] + [0, level, 0] for level in (0.0, 0.3, 0.6)])
    round_about = asymmetries(cone.astype(np.float32))
    assert max(round_about[0], round_about[2]) < 1e-3 and round_about[1] > 0.01  # it may face any way


def test_a_front_lies_in_the_mirror_plane():
    logs = evidence_of_file(body() - np.float32([0, 0.5, 0]))  # hovering: the ground is silent
    sideways = [n for n, (up, front) in enumerate(ORIENTATIONS) if "x" in (up[1], front[1])]
    others = [n for n in range(24) if n not in sideways]
    assert logs[others].min() > logs[sideways].max() + 5


def test_no_witness_is_believed_beyond_its_doubt():
    sure = np.zeros(24)
    sure[5] = 1
    ratio = combined(sure).max() / combined(sure).min()
    assert ratio == pytest.approx(((0.95 + 0.05 / 24) / (0.05 / 24)) ** Combination.network_counts)
    logs = evidence_of_file(body())
    assert np.ptp(logs) <= np.log(195) + np.log(298) + 1e-6


def test_planes_that_hardly_differ_say_little():
    """A lion in mid-step: the odds between its planes are those of their ratio."""
    points = body()
    stride = points + 0.06 * np.random.default_rng(1).normal(size=points.shape).astype(np.float32)
    found = asymmetries(stride)
    assert found.min() > 0.01
    clear, unclear = (
        np.ptp(evidence_of_file(some - np.float32([0, 0.5, 0]))[[0, 5, 10, 15, 20]]) for some in (points, stride)
    )
    assert unclear < clear


def test_few_vertices_tell_little():
    """The same verdict of the network is worth less of a tetrahedron than of a body, and copies of corners are none."""
    network = np.where(np.arange(24) == 20, 0.9, 0.1 / 23)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1.5, 0], [0, 0, 1]], np.float32)
    of_few = combined(network, corners)
    assert 1 / 24 < of_few[20] < 0.3
    np.testing.assert_allclose(combined(network, np.repeat(corners, 500, axis=0)), of_few, rtol=1e-6)
    dense = np.random.default_rng(0).uniform(0, 1, (3000, 3)).astype(np.float32)
    assert combined(network, dense)[20] > 0.7


def test_a_lying_glb_is_turned_if_the_mesh_says_so():
    lying = ORIENTATIONS.index(("+z", "-y"))
    seen = np.full(24, 0.02 / 23)
    seen[lying] = 0.98
    points = body() @ upright_rotation("+z", "-y").astype(np.float32)
    middle = points - (points.min(axis=0) + points.max(axis=0)) / 2
    assert combined(seen, points, kind_weights(".glb"))[lying] > 0.95
    assert combined(seen, middle, kind_weights(".obj"))[lying] > 0.5  # few files lie
    doubtful = np.full(24, 0.8 / 23)
    doubtful[lying] = 0.2
    assert combined(doubtful, None, kind_weights(".glb")).argmax() == ORIENTATIONS.index(("+y", "+z"))
    assert combined(seen, None, kind_weights(".glb", moved=True))[lying] < 0.5  # somebody has animated it as it stands


def test_the_network_alone_never_overrules_a_skin():
    for number in range(24):
        seen = np.zeros(24)
        seen[number] = 1
        found = combined(seen, None, kind_weights(".glb", moved=True))
        assert found.argmax() == ORIENTATIONS.index(("+y", "+z")) or found.max() < 0.85


def test_kinds_of_files_have_habits():
    for suffix in ("", ".obj", ".ply", ".stl", ".glb", ".fbx"):
        for moved in (False, True):
            weights = kind_weights(suffix, moved)
            assert weights.sum() == pytest.approx(1) and weights.min() > 0
    usual = {suffix: ORIENTATIONS[kind_weights(suffix).argmax()] for suffix in (".obj", ".stl", ".ply", ".glb")}
    assert usual == {".obj": ("+y", "+z"), ".stl": ("+z", "-y"), ".ply": ("+z", "-y"), ".glb": ("+y", "+z")}
    assert kind_weights(".glb", moved=True).max() > 0.9 > kind_weights(".glb").max()
    assert has_rule(".glb") and has_rule(".fbx") and not has_rule(".stl") and not has_rule("")
