import json
from dataclasses import replace

import numpy as np
import pytest

from bunraku.body.from_handles import skeleton_from_handles
from bunraku.body.layout import JOINT_NAMES, JOINT_PARENTS
from bunraku.body.reference import reference_body
from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.diffusion.examples.pack import (
    Example,
    ExamplePack,
    fingerprint,
    load_examples,
    packed_stretch,
    read_pack,
    said_by,
    said_path,
    stand_well,
    unpacked_stretch,
    write_pack,
)
from bunraku.diffusion.features import decode, encode
from bunraku.errors import WeightsError
from bunraku.formats.files import weights_file
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from bunraku.language.captions.phrases import mirror_words
from bunraku.language.lexicon.cues import said_cues
from bunraku.retarget.body_motion import body_handle_motion
from bunraku_lab.evaluation.motion.seams import posed_positions


def test_a_packed_stretch_is_the_same_to_half_a_millimetre_and_a_milliradian():
    random = np.random.default_rng(0)
    root = np.cumsum(random.normal(0, 0.02, (80, 3)), axis=0)
    rotations = matrix_from_axis_angle(np.cumsum(random.normal(0, 0.03, (80, 22, 3)), axis=0))
    data = packed_stretch(root, rotations)
    found_root, found = unpacked_stretch(data, 80)
    assert np.abs(found_root - root).max() <= 0.00026
    assert np.linalg.norm(axis_angle_from_matrix(found.swapaxes(-1, -2) @ rotations), axis=-1).max() < 0.0015
    assert len(data) < 80 * 150


def test_bytes_of_another_length_or_none_at_all_are_refused():
    data = packed_stretch(np.zeros((5, 3)), np.broadcast_to(np.eye(3), (5, 22, 3, 3)))
    for bad, frames in ((data, 6), (data, 4), (data, 0), (data, 10**9), (b"", 5), (b"nonsense", 5)):
        with pytest.raises(WeightsError, match="damaged"):
            unpacked_stretch(bad, frames)


def test_what_the_denoiser_sees_of_an_example_is_what_it_sees_of_the_clip():
    random = np.random.default_rng(1)
    turns = np.zeros((30, 22, 3))
    turns[:, [0, 4, 16, 18]] = np.cumsum(random.normal(0, 0.05, (30, 4, 3)), axis=0)
    skeleton = Skeleton(JOINT_NAMES, np.asarray(JOINT_PARENTS), reference_body().skeleton.offsets)
    root = np.cumsum(random.normal(0, 0.02, (30, 3)), axis=0) + [0, 0.9, 0]
    clip = body_handle_motion(SkeletalMotion(skeleton, matrix_from_axis_angle(turns), root, 20.0))
    found = skeleton_from_handles(clip)
    example = Example("clip", ("a person moves",), 30)
    data = (packed_stretch(found.root_translation, found.rotations),)
    pack = ExamplePack((example,), data, np.zeros(1, int), np.ones((2, 1, 1)), np.ones((2, 1, 1)), "")
    seen, meant = (posed_positions(decode(values))[:, :22] for values in (pack.features(0), encode(clip)))
    assert np.linalg.norm(seen - meant, axis=-1).max() < 0.03


def test_a_file_gives_back_what_was_written(pack, tmp_path):
    path = write_pack(tmp_path / "examples.safetensors", pack, {"licences": {"CC0": 2}})
    found = read_pack(path)
    assert found.examples == pack.examples and found.data == pack.data and found.ranker == "none"
    np.testing.assert_allclose(found.texts, pack.texts)
    np.testing.assert_allclose(found.motions, pack.motions)
    np.testing.assert_array_equal(found.owners, pack.owners)


def test_tables_that_disagree_are_refused(pack, tmp_path):
    for change in (
        {"owners": np.array([0, 0, 7])}, {"data": pack.data[:1]}, {"motions": pack.motions[:, :1]},
    ):  # fmt: skip
        path = write_pack(tmp_path / "broken.safetensors", replace(pack, **change), {})
        with pytest.raises(WeightsError, match=r"broken\.safetensors"):
            read_pack(path)


def test_examples_of_another_ranker_and_none_at_all(pack, tmp_path, monkeypatch):
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path))
    assert load_examples() is None
    (tmp_path / "ranker.safetensors").write_bytes(b"weights")
    write_pack(tmp_path / "examples.safetensors", pack, {})
    with pytest.raises(WeightsError, match="another ranker"):
        load_examples()
    own = replace(pack, ranker=fingerprint(tmp_path / "ranker.safetensors"))
    write_pack(tmp_path / "examples.safetensors", own, {})
    assert load_examples().examples == pack.examples


def test_what_the_shipped_examples_say_is_stored_as_it_is_read_today():
    path = weights_file("examples.safetensors")
    if not path.is_file():
        pytest.skip("the shipped weights are not there")
    pack = read_pack(path)
    assert len(pack.stored) == len(pack.examples), "write it anew: pack.write_said(path, read_pack(path))"
    for index, one in enumerate(pack.examples):
        assert pack.said(index) == said_by(one.texts), one.texts
        told = frozenset().union(*(said_cues(mirror_words(text)) for text in one.texts))
        assert pack.said(index).mirrored_cues == told, one.texts
    assert pack.stored_standing == stand_well(pack) and 0 < len(pack.idles) < len(pack.stored_standing)


def test_what_is_stored_is_left_alone_where_the_sentences_or_the_lexicon_are_others(pack, tmp_path):
    path = write_pack(tmp_path / "examples.safetensors", pack, {})
    said = read_pack(path).said(0)
    assert read_pack(path).stored and said == pack.said(0) and "left arm" in said.cues and said.actions == {"wave"}
    table = json.loads(said_path(path).read_text())
    for change in ({"of": "0" * 16}, None):
        if change is None:
            said_path(path).unlink()
        else:
            said_path(path).write_text(json.dumps(table | change))
        assert not read_pack(path).stored and read_pack(path).said(0) == said
    for bad in (
        "", "[", "3", json.dumps(table | {"rows": [["", 1, ""]] * 2}), json.dumps(table | {"rows": []}),
        *(json.dumps(table | {"stand": bad}) for bad in ([2], [-1], ["0"], [True], 1)),
    ):  # fmt: skip
        said_path(path).write_text(bad)
        with pytest.raises(WeightsError, match=r"examples\.json"):
            read_pack(path)
