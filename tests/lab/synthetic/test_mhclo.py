import numpy as np
import pytest

from bunraku.errors import CharacterError, FormatError
from bunraku_lab.synthetic.dressed.mhclo import fit, fit_weights, read_mhclo

# A base of five vertices; distances of 2, 4 and 5 between the vertices that the scales name.
BASE = np.array([[0, 0, 0], [2, 0, 0], [0, 4, 0], [0, 0, 5], [1, 1, 1]], float)
OBJ = "# basemesh hm08\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1 4/1\n"
MHCLO = """# This is a clothes file for MakeHuman
uuid 566dbd52-71d1-4d76-a799-0474a5a384db
basemesh hm08
tag Hats
tag Female
name little hat
obj_file hat.obj
x_scale 0 1 2.0
z_scale 0 3 5.0
y_scale 0 2 4.0
z_depth 50
verts 0
material hat.mhmat
    0     1     2 0.50000 0.25000 0.25000 0.10000 0.20000 0.30000
1
    1     2     3 1.20000 -0.10000 -0.10000 0.00000 0.00000 0.00000
    4     4     4 1.00000 0.00000 0.00000 -1.00000 0.00000 0.00000

delete_verts
0 2 - 3
"""


def written(folder, mhclo=MHCLO, obj=OBJ):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "hat.mhclo").write_text(mhclo)
    if obj is not None:
        (folder / "hat.obj").write_text(obj)
    return folder / "hat.mhclo"


def test_vertices_follow_three_base_vertices_and_their_scaled_offset(tmp_path):
    hat = read_mhclo(written(tmp_path))
    assert (hat.name, hat.tags, len(hat)) == ("little hat", ("Hats", "Female"), 4)
    assert hat.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert hat.deleted.tolist() == [0, 2, 3]
    expected = [[0.5 + 0.1, 1.0 + 0.2, 0.3], [2, 0, 0], [2.4, -0.4, -0.5], [0, 1, 1]]
    np.testing.assert_allclose(fit(hat, BASE), expected, atol=1e-12)
    # Twice as wide, three times as high: base vertices and offsets grow with the axes.
    np.testing.assert_allclose(fit(hat, BASE * [2, 3, 1]), np.array(expected) * [2, 3, 1], atol=1e-12)
    # In metres instead of decimetres.
    np.testing.assert_allclose(fit(hat, BASE * 0.1), np.array(expected) * 0.1, atol=1e-12)


def test_without_scales_offsets_are_in_the_unit_of_the_base_mesh(tmp_path):
    lines = [line for line in MHCLO.splitlines() if "_scale" not in line]
    hat = read_mhclo(written(tmp_path, "\n".join(lines)))
    np.testing.assert_allclose(fit(hat, BASE, unit=1.0)[0], [0.6, 1.2, 0.3])
    np.testing.assert_allclose(fit(hat, BASE)[3], [0.9, 1, 1])


def test_weights_are_carried(tmp_path):
    hat = read_mhclo(written(tmp_path))
    weights = fit_weights(hat, np.eye(5))
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    assert weights.min() >= 0
    np.testing.assert_allclose(weights[0], [0.5, 0.25, 0.25, 0, 0])
    np.testing.assert_allclose(weights[2], [0, 1, 0, 0, 0])  # negative shares count as none


@pytest.mark.parametrize(
    ("change", "to", "says"),
    [
        ("obj_file hat.obj", "obj_file ../hat.obj", "no file in its folder"),
        ("obj_file hat.obj", "obj_file /etc/passwd", "no file in its folder"),
        ("obj_file hat.obj", "obj_file other.obj", "no such file"),
        ("    4     4     4 1", "    4     x     4 1", "line 17"),
        ("    4     4     4 1", "    4     4 1", "line 17"),
        ("    4     4     4 1.00000", "    4     4     4 1.50000", "sum to 1"),
        ("    4     4     4 1.00000", "    4     4     4 nan", "sum to 1"),
        ("    4     4     4 1", "    4     4     -4 1", "line 17"),
        ("    4     4     4 1", "    4     4     99999999 1", "line 17"),
        ("x_scale 0 1 2.0", "x_scale 0 1", "line 8"),
        ("x_scale 0 1 2.0", "x_scale 0 1 0", "greater than 0"),
        ("0 2 - 3", "0 2 - - 3", "line 20"),
        ("1\n    1     2     3", "    1     2     3", "do not belong together"),
        ("verts 0", "vertices", "binds no vertices"),
    ],
)
def test_broken_files_say_what_is_wrong(tmp_path, change, to, says):
    assert change in MHCLO
    path = written(tmp_path / "hat", MHCLO.replace(change, to))
    (tmp_path / "hat.obj").write_text(OBJ)
    with pytest.raises(FormatError, match=says):
        read_mhclo(path)


def test_links_out_of_the_folder_are_refused(tmp_path):
    path = written(tmp_path / "inside", obj=None)
    (tmp_path / "elsewhere.obj").write_text(OBJ)
    (tmp_path / "inside" / "hat.obj").symlink_to(tmp_path / "elsewhere.obj")
    with pytest.raises(FormatError, match="no file in its folder"):
        read_mhclo(path)


def test_a_million_long_spans_cost_little(tmp_path):
    hat = read_mhclo(written(tmp_path, MHCLO + "0 - 400000\n" * 20000))
    assert len(hat.deleted) == 400001


def test_a_body_that_is_too_small_is_refused(tmp_path):
    hat = read_mhclo(written(tmp_path))
    with pytest.raises(CharacterError, match="vertex 4 but the body has 4"):
        fit(hat, BASE[:4])
