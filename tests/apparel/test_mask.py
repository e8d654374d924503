"""Which vertices are apparel: the artist's mask, and what hangs."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from bunraku.apparel.hanging import _fused_skirt, hanging_mask
from bunraku.apparel.mask import apparel_mask, artist_mask_file, read_artist_mask
from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES
from bunraku.core.character import Character
from bunraku.errors import FormatError
from bunraku.files import load_character
from bunraku.files.mmd.write import save_pmx
from bunraku_lab.synthetic.wardrobe import wardrobe_character


@pytest.fixture(scope="module")
def doll() -> Character:
    return wardrobe_character(3)


@pytest.fixture
def loaded(doll, tmp_path) -> Character:
    return load_character(save_pmx(doll, tmp_path / "doll.pmx"))


def test_a_mask_beside_the_file_replaces_that_of_physics(loaded, tmp_path):
    own = apparel_mask(loaded)
    assert own is not None and own.any() and artist_mask_file(loaded) is None
    drawn = np.arange(len(loaded.vertices)) % 3 == 0
    np.save(tmp_path / "doll.apparel.npy", drawn)
    assert artist_mask_file(loaded) == tmp_path / "doll.apparel.npy"
    np.testing.assert_array_equal(apparel_mask(loaded), drawn)


def test_text_lists_vertices(loaded, tmp_path):
    (tmp_path / "doll.apparel.txt").write_text("5\n0\n17\n")
    mask = apparel_mask(loaded)
    assert mask is not None and np.flatnonzero(mask).tolist() == [0, 5, 17]


def test_red_paint_counts_whatever_the_order_of_vertices(loaded, tmp_path):
    used = np.flatnonzero(loaded.surface)
    red = loaded.vertices[:, 1] < np.median(loaded.vertices[:, 1])
    order = np.random.default_rng(0).permutation(len(loaded.vertices))
    index = np.argsort(order)
    shades = np.where(red[:, None], [230, 20, 20], [200, 190, 60])[order]
    lines = ["ply", "format ascii 1.0", f"element vertex {len(order)}", *(f"property float {axis}" for axis in "xyz")]
    lines += [*(f"property uchar {shade}" for shade in ("red", "green", "blue")), f"element face {len(loaded.faces)}"]
    lines += ["property list uchar int vertex_indices", "end_header"]
    lines += [
        f"{x:.7f} {y:.7f} {z:.7f} {r} {g} {b}"
        for (x, y, z), (r, g, b) in zip(loaded.vertices[order], shades, strict=True)
    ]
    lines += [f"3 {a} {b} {c}" for a, b, c in index[loaded.faces]]
    (tmp_path / "doll.apparel.ply").write_text("\n".join(lines))
    mask = apparel_mask(loaded)
    assert mask is not None
    twins = len(used) - len(
        np.unique(loaded.vertices[used].round(5), axis=0)
    )  # seams on the border of the paint may go either way
    assert (mask[used] != red[used]).sum() <= twins and mask[used].any()


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("m.npy", None, "vertices"),
        ("m.txt", b"1\n99999999\n", "does not have"),
        ("m.txt", b"-1\n", "does not have"),
        ("m.txt", b"skirt\n", "vertex numbers"),
        ("m.txt", b"9" * 400, "does not have|vertex numbers"),
        ("m.npy", b"\x93NUMPY rubbish", "broken"),
        ("m.csv", b"1", "save one of these"),
    ],
)
def test_bad_masks(doll, tmp_path, name, content, problem):
    path = tmp_path / name
    if content is None:
        np.save(path, np.zeros(3))
    else:
        path.write_bytes(content)
    with pytest.raises(FormatError, match=problem):
        read_artist_mask(path, doll)


def test_a_painted_mesh_of_another_shape_is_refused(doll, tmp_path):
    other = tmp_path / "m.ply"
    other.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face "
        "1\n"
        "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    with pytest.raises(FormatError, match="paint"):
        read_artist_mask(other, doll)


def test_no_pickle_is_opened(doll, tmp_path):
    path = tmp_path / "m.npy"
    np.save(path, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(FormatError):
        read_artist_mask(path, doll)


Mesh = tuple[np.ndarray, np.ndarray]
SEGMENTS = 24


def _tube(rings: list[tuple[float, float]], x: float = 0.0, z: float = 0.0) -> Mesh:
    """A surface of revolution about a vertical line, by radius and height of each ring [m]."""
    turn = np.linspace(0, 2 * np.pi, SEGMENTS, endpoint=False)
    points = [np.stack([x + r * np.sin(turn), np.full(SEGMENTS, y), z + r * np.cos(turn)], axis=1) for r, y in rings]
    faces = []
    for row in range(len(rings) - 1):
        a = SEGMENTS * row + np.arange(SEGMENTS)
        b = SEGMENTS * row + (np.arange(SEGMENTS) + 1) % SEGMENTS
        faces += [np.stack([a, b, a + SEGMENTS], axis=1), np.stack([b, b + SEGMENTS, a + SEGMENTS], axis=1)]
    return np.concatenate(points), np.concatenate(faces)


def _person(*worn: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces, joints, weights, and the number of the part of each vertex: legs, trunk, head, and what is
    worn.
    """
    joints = np.zeros((JOINT_COUNT, 3))
    places = {"pelvis": (0, 0.9, 0), "spine1": (0, 1.02, 0), "left_hip": (0.1, 0.85, 0), "right_hip": (-0.1, 0.85, 0),
              "left_knee": (0.1, 0.45, 0), "right_knee": (-0.1, 0.45, 0), "head": (0, 1.4, 0)}  # fmt: skip
    joints[:, 1] = 1.2
    for name, place in places.items():
        joints[JOINT_NAMES.index(name)] = place
    body = [_tube([(0.07, 0.8), (0.06, 0.4), (0.05, 0.0)], x) for x in (0.1, -0.1)]
    body += [_tube([(0.15, 0.82), (0.15, 1.3)]), _tube([(0.05, 1.38), (0.1, 1.5), (0.02, 1.6)])]
    vertices, faces, number = [], [], []
    for place, (points, corners) in enumerate([*body, *worn]):
        faces.append(corners + sum(len(one) for one in vertices))
        vertices.append(points)
        number.append(np.full(len(points), place))
    every = np.concatenate(vertices)
    weights = np.zeros((len(every), JOINT_COUNT))
    head = every[:, 1] > 1.38
    weights[~head, 0], weights[head, JOINT_NAMES.index("head")] = 1, 1
    return every, np.concatenate(faces), joints, weights, np.concatenate(number)


def _marked(likely: float, *worn: Mesh) -> list[float]:
    """The share of each thing worn that is marked, where a network says the same of all of it."""
    vertices, faces, joints, weights, number = _person(*worn)
    said = np.where(number >= 4, likely, 0.0)
    mask, _ = hanging_mask(vertices, faces, joints, weights, np.ones(len(vertices)), said, said > 1 / 3)
    assert not mask[number < 4].any()
    return [float(mask[number == 4 + place].mean()) for place in range(len(worn))]


SKIRT = _tube([(0.17, 0.95), (0.2, 0.8), (0.25, 0.65), (0.3, 0.5)])


@pytest.mark.parametrize("likely", [0.0, 0.2, 0.4])
def test_a_skirt_is_taken_whole(likely: float) -> None:
    assert _marked(likely, SKIRT) == [1.0]


def test_a_skirt_that_ends_above_the_pelvis_is_taken() -> None:
    """Guessed joints may lie lower than they should: the pelvis of a witch in a wide dress."""
    vertices, faces, joints, weights, number = _person(_tube([(0.17, 0.95), (0.2, 0.8), (0.25, 0.75)]))
    joints[JOINT_NAMES.index("pelvis"), 1] = 0.7
    mask, _ = hanging_mask(vertices, faces, joints, weights, np.ones(len(vertices)), number == 4, number == 4)
    assert mask[(number == 4) & (vertices[:, 1] < 0.8)].all()


def test_trousers_are_not() -> None:
    """Two legs that are joined at the hips, and go round one leg each, however likely they are."""
    left = _tube([(0.1, 0.81), (0.09, 0.5), (0.09, 0.1)], 0.1)
    right = _tube([(0.1, 0.81), (0.09, 0.5), (0.09, 0.1)], -0.1)
    points = np.concatenate([left[0], right[0]])
    faces = np.concatenate([left[1], right[1] + len(left[0]), [[0, 1, len(left[0])], [0, len(left[0]) + 1, 1]]])
    (share,) = _marked(0.45, (points, faces))
    assert share == 0


def test_long_hair_is_hair_and_a_face_is_none() -> None:
    tail = _tube([(0.02, 1.55), (0.04, 1.3), (0.04, 0.9), (0.01, 0.7)], z=-0.18)
    chin = _tube([(0.02, 1.5), (0.03, 1.42), (0.01, 1.36)], z=0.09)
    assert _marked(0.1, tail, chin) == [1.0, 0.0]


@pytest.mark.parametrize("shape", ["legs", "arms"])
def test_skin_that_reaches_the_skull_is_no_hair(shape: str) -> None:
    """A loose piece from the neck down of which a network says a little, as of hair; it goes round limbs."""
    neck = _tube([(0.06, 1.46), (0.06, 1.2), (0.16, 1.1)])
    if shape == "legs":
        limbs = [_tube([(0.085, 0.8), (0.075, 0.5), (0.065, 0.1)], x) for x in (0.1, -0.1)]
    else:
        limbs = [_tube([(0.04, 0.0), (0.04, 0.15), (0.04, 0.3)]) for _ in range(2)]
        limbs = [(one[0][:, [1, 0, 2]] * [side, 1, 1] + [0.15 * side, 1.2, 0], one[1])
                 for one, side in zip(limbs, (1, -1), strict=True)]  # fmt: skip
    points = np.concatenate([neck[0], *(one[0] for one in limbs)])
    first = len(neck[0])
    faces = np.concatenate([neck[1], *(one[1] + first + place * len(one[0]) for place, one in enumerate(limbs))])
    sewn = [[48, first, first + 1], [48, first + len(limbs[0][0]), first + len(limbs[0][0]) + 1]]
    vertices, corners, joints, weights, number = _person((points, np.concatenate([faces, sewn])))
    for side, out in (("left", 1), ("right", -1)):
        joints[JOINT_NAMES.index(f"{side}_shoulder")] = out * 0.15, 1.2, 0
        joints[JOINT_NAMES.index(f"{side}_elbow")] = out * 0.45, 1.2, 0
    skin = number == 4
    areas = np.where(skin, 0.2, 1.0)  # less than a third of the surface, as where clothes hide the rest
    mask, hair = hanging_mask(vertices, corners, joints, weights, areas, 0.1 * skin, np.zeros(len(vertices), bool))
    assert not hair.any() and not mask.any()


def _at(x: float, y: float, z: float, half: tuple[float, float, float]) -> Mesh:
    """A closed box about a place."""
    box = trimesh.creation.box(2 * np.array(half)).subdivide().subdivide()
    return np.asarray(box.vertices) + [x, y, z], np.asarray(box.faces)


def test_a_belts_end_and_a_shirt_stay_and_a_tail_does_not() -> None:
    """A short piece at the side of a hip, a tube about the trunk that ends at the hips, and a rod behind the pelvis."""
    end = _at(0.2, 0.8, 0.05, (0.01, 0.06, 0.01))
    shirt = _tube([(0.17, 1.25), (0.18, 1.0), (0.18, 0.84)])
    tail = _at(0.0, 0.85, -0.35, (0.02, 0.02, 0.12))
    assert _marked(0.9, end, shirt, tail) == [0.0, 0.0, 1.0]


@pytest.mark.parametrize("notched", [False, True])
def test_a_skirt_of_one_surface_with_the_body(notched: bool) -> None:
    """It is found down to its hem; what goes in between the legs, as legs that a cape joins behind do, is none."""
    _, _, joints, _, _ = _person(SKIRT)
    heights = np.linspace(0.8, 0.5, 16)
    outer = [(0.2 + 0.1 * (0.8 - y) / 0.3, y) for y in heights]
    points, faces = _tube([(0.02, 1.6), (0.1, 1.5), (0.15, 1.3), (0.15, 0.95), *outer, (0.02, 0.5)])
    skirt = points[:, 1] < 0.81
    front = skirt & (np.abs(np.arctan2(points[:, 0], points[:, 2])) < 0.6)
    if notched:
        points[front] *= [0.25, 1, 0.25]
    every = np.ones(len(points), bool)
    found = _fused_skirt(points, faces, every, np.full(len(points), 0.45), joints, 1.6)
    assert not found.any() if notched else found[skirt].mean() > 0.9 and not found[points[:, 1] > 0.96].any()
    assert not _fused_skirt(points, faces, every, np.full(len(points), 0.1), joints, 1.6).any()
