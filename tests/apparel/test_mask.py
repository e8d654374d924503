"""Which vertices are apparel by an artist's mask."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.apparel.mask import apparel_mask, artist_mask_file, read_artist_mask
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
