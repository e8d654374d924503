"""HumanML3D: vectors written by an encoder of the test's own come back as the motion they were made of."""

import io

import numpy as np
import pytest
from motion_files import about_y, humanml3d_vectors, walk_about

from bunraku.body.layout import JOINT_NAMES
from bunraku.errors import BunrakuError, FormatError, MotionError
from bunraku.formats.arrays.humanml3d import positions_of_vectors, read_texts
from bunraku.io.motions import load_motion


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_vectors_give_back_the_joints(tmp_path, seed):
    positions = walk_about(81, seed=seed).world()[1]
    vectors, heading = humanml3d_vectors(positions)
    assert vectors.shape == (80, 263)
    np.save(tmp_path / "000001.npy", vectors)
    motion = load_motion(tmp_path / "000001.npy")
    assert motion.skeleton.names == JOINT_NAMES and motion.fps == 20 and len(motion) == 80
    start = positions[0, 0] * [1, 0, 1]  # vectors forget where the motion began and which way it faced
    want = about_y(-heading).apply((positions[:-1] - start).reshape(-1, 3)).reshape(80, 22, 3)
    assert np.abs(motion.world()[1] - want).max() < 1e-4


def test_positions_are_read_as_they_are(tmp_path):
    positions = walk_about(30).world()[1]
    np.save(tmp_path / "000002.npy", positions)
    assert np.abs(load_motion(tmp_path / "000002.npy").world()[1] - positions).max() < 1e-4


def test_a_turn_to_the_left_is_one():
    """One step of a quarter turn: the stored number is half the angle, of the turn that takes the heading off."""
    vectors = np.zeros((2, 263))
    vectors[0, 0] = -np.pi / 4
    vectors[:, 4:7] = [0, 1, 1]  # the first joint is ahead
    assert np.allclose(positions_of_vectors(vectors)[:, 1], [[0, 1, 1], [1, 1, 0]], atol=1e-6)


def test_captions_with_spans(tmp_path):
    (tmp_path / "a.txt").write_text(
        "a man kicks.#a/DET man/NOUN kick/VERB#0.0#0.0\nhe  walks#he/PRON "
        "walk/VERB#1.5#3.0\nbare\n\n#x#0#0\nodd#x#nan#0.0\nback#x#5#2\n"
    )
    found = [(caption.text, caption.start, caption.end) for caption in read_texts(tmp_path / "a.txt")]
    assert found == [("a man kicks.", 0, 0), ("he walks", 1.5, 3), ("bare", 0, 0), ("odd", 0, 0), ("back", 0, 0)]
    (tmp_path / "b.txt").write_text("\n##\n")
    with pytest.raises(FormatError, match=r"b\.txt: there is no caption"):
        read_texts(tmp_path / "b.txt")
    (tmp_path / "c.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FormatError, match="UTF-8"):
        read_texts(tmp_path / "c.txt")


def test_files_that_are_broken_or_mean_harm(tmp_path):
    path = tmp_path / "bad.npy"

    def refused(array, match, **options):
        np.save(path, array, **options)
        with pytest.raises((FormatError, MotionError), match=rf"bad\.npy: .*{match}"):
            load_motion(path)

    refused(np.zeros((4, 262)), r"shape \(N, 263\)")
    refused(np.zeros((0, 263)), "shape")
    refused(np.zeros(263), "shape")
    refused(np.full((4, 263), np.nan), "not numbers")
    refused(np.full((4, 22, 3), np.inf), "not numbers")
    refused(np.array([{"a": 1}], dtype=object), "pickled objects", allow_pickle=True)
    refused(np.array(["a", "b"]), "not plain numbers")
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (10**12, 263)})
    path.write_bytes(header.getvalue() + bytes(100))
    with pytest.raises(FormatError, match="cut short"):
        load_motion(path)
    np.save(path, np.zeros((4, 22, 3), np.float32))
    whole = path.read_bytes()
    for length in range(1, len(whole), 37):
        path.write_bytes(whole[:length])
        with pytest.raises(BunrakuError, match=r"bad\.npy"):
            load_motion(path)


def test_hours_of_frames_are_refused_at_once(tmp_path):
    path = tmp_path / "long.npy"
    np.save(path, np.zeros((300_000, 22, 3), np.float32))
    with pytest.raises(FormatError, match="300,000 frames"):
        load_motion(path)
