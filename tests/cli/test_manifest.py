"""What may be written over: what the command line wrote itself, as it left it."""

import os

import pytest

from bunraku.cli.manifest import MANIFEST, check_free, note_begun, note_done, note_written, unfinished
from bunraku.errors import FormatError


def test_what_was_made_of_the_same_is_done(tmp_path):
    one, two = tmp_path / "one.glb", tmp_path / "two.glb"
    marks = {one: "a", two: "b"}
    assert unfinished(marks) == [one, two]
    note_begun(marks)
    one.write_bytes(b"one")
    note_done(one, "a")
    two.write_bytes(b"half noted")  # the run was stopped before it could note the second
    assert unfinished(marks) == [two]
    note_done(two, "b")
    assert unfinished(marks) == []
    two.unlink()
    assert unfinished(marks) == [two]


@pytest.mark.parametrize("change", ["mark", "contents", "time", "ledger"])
def test_what_is_not_as_it_was_left_is_kept(tmp_path, change):
    path, mark = tmp_path / "one.glb", "a"
    path.write_bytes(b"one")
    note_done(path, mark)
    if change == "mark":
        mark = "b"
    elif change == "contents":
        path.write_bytes(b"another")
    elif change == "time":
        os.utime(path, ns=(1, 1))
    else:
        (tmp_path / MANIFEST).unlink()
    with pytest.raises(FormatError, match="--overwrite"):
        unfinished({path: mark})
    assert unfinished({path: mark}, overwrite=True) == [path]


def test_a_ledger_that_was_cut_off_goes_on(tmp_path):
    one, two = tmp_path / "one.glb", tmp_path / "two.glb"
    for path in (one, two):
        path.write_bytes(path.name.encode())
    note_done(one, "a")
    with (tmp_path / MANIFEST).open("a") as file:
        file.write('["two.glb", "b", [1, 2')
    note_done(two, "b")
    (tmp_path / MANIFEST).open("ab").write(b'[1]\n"\xff"\nnull\n["x", 1, 2]\n')
    assert unfinished({one: "a", two: "b"}) == []


def test_folders_are_results_too(tmp_path):
    folder = tmp_path / "frames"
    folder.mkdir()
    check_free([folder], overwrite=False)  # empty, so nothing is lost
    (folder / "frames_0000.obj").write_text("v 0 0 0")
    with pytest.raises(FormatError, match="frames"):
        check_free([folder], overwrite=False)
    note_written([folder])
    check_free([folder], overwrite=False)
    (folder / "mine.obj").write_text("v 1 1 1")
    with pytest.raises(FormatError, match="frames"):
        check_free([folder], overwrite=False)


def test_a_glb_says_itself_who_wrote_it(tmp_path, glb):
    path = tmp_path / "thing.glb"
    path.write_bytes(glb().replace(b'{"version": "2.0"}', b'{"generator":"x","version": "2.0"}'))
    with pytest.raises(FormatError):
        check_free([path], overwrite=False)
    tree = b'{"asset": {"generator": "bunraku"}}'
    path.write_bytes(b"glTF" + bytes(8) + len(tree).to_bytes(4, "little") + b"JSON" + tree)
    check_free([path], overwrite=False)
    with pytest.raises(FormatError):
        check_free([path], overwrite=False, ours=False)
    note_written([path])
    assert not (tmp_path / MANIFEST).exists()  # it needs none
