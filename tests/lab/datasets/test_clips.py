"""Training motions on disk: the bundle, sources, and captions by time."""

import json
import lzma
from importlib import resources

import numpy as np
import pytest
import torch

from bunraku.cli.app import main
from bunraku.core.body.joint_rotations import skeleton_from_handles
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import HandleMotion, SkeletalMotion, Skeleton
from bunraku.core.nn.checkpoints import load_checkpoint, save_checkpoint
from bunraku.errors import FormatError
from bunraku.generation.features import body_handle_motion
from bunraku_lab.datasets.motions.build import between_held_poses, checked
from bunraku_lab.datasets.motions.clips import (
    KIND,
    Stretch,
    credit_lines,
    load_watched,
    pack_motion,
    subject_of,
    unpack_motion,
    write_bundle,
    write_clip,
    write_index,
)
from bunraku_lab.training.rows.banks import load_mesh_bank
from bunraku_lab.training.rows.clips import load_clips


def person(frames=50, seed=0):
    """A person whose 22 joints all sway, each at a rhythm of its own, and who walks away turning."""
    random = np.random.default_rng(seed)
    time = np.arange(frames)[:, None, None] / 20
    angles = 0.4 * np.sin(time * random.uniform(2, 6, (1, 22, 3)) + random.uniform(0, 6, (1, 22, 3)))
    angles[:, 0] = 0
    angles[:, 0, 1] = np.linspace(0, 5, frames)  # past half a turn
    root = reference_body().skeleton.positions[0] + np.linspace(0, 1, frames)[:, None] * [1.0, 0.0, 3.0]
    skeleton = Skeleton(JOINT_NAMES, np.asarray(JOINT_PARENTS), reference_body().skeleton.offsets)
    return body_handle_motion(SkeletalMotion(skeleton, matrix_from_axis_angle(angles), root, 20.0))


def apart(one, other):
    """Largest distance between where two motions put the handles [m]."""
    rest = reference_body().handles.positions
    positions = [
        (motion.transforms(rest)[..., :3] @ rest[None, :, :, None])[..., 0] + motion.transforms(rest)[..., 3]
        for motion in (one, other)
    ]
    return float(np.linalg.norm(positions[0] - positions[1], axis=-1).max())


@pytest.fixture
def folder(tmp_path):
    """Two people to train on, one to validate and one to test with, and a dog."""
    out = tmp_path / "motions"
    out.mkdir()
    index = {}
    for number, split in enumerate(("train", "train", "val", "test")):
        write_clip(out / f"sway_{number}.npz", person(50 + number, number))
        index[f"sway_{number}"] = {"texts": ["a person sways"], "split": split, "frames": 50 + number, "weight": 0.5}
    index["sway_0"]["stretches"] = [{"start": 0, "stop": 20, "texts": ["a person sways and walks"]}]
    write_clip(out / "dog.npz", person(30, 9))
    index["dog"] = {"species": "dog", "character": "dog", "split": "train", "frames": 30, "action": "walk"}
    write_index(out, index)
    return out


@pytest.fixture
def bank(tmp_path):
    path = tmp_path / "bank.npz"
    random = np.random.default_rng(0)
    names = ["dog", "dog~1", "person", "cat"]
    np.savez(
        path, features=random.normal(size=(4, 12)).astype(np.float32), names=names,
        split=["train", "train", "train", "test"], humanoid=[False, False, True, False],
    )  # fmt: skip
    return path


def test_a_motion_comes_back():
    """All handles to the step they are kept in; or as the body's joints put them, to that step along three limbs."""
    motion = person()
    joints = body_handle_motion(skeleton_from_handles(motion, rounds=1))
    for form, want in (("handles", motion), ("skeleton", joints)):
        back = unpack_motion(pack_motion(motion, form), len(motion), form)
        assert apart(want, back) < 0.006 and back.fps == 20
    assert len(pack_motion(motion, "skeleton")) < 0.5 * len(pack_motion(motion, "handles"))


def test_training_reads_a_bundle_as_it_reads_the_folder(folder, bank, tmp_path):
    path = tmp_path / "bundle.safetensors"
    facts = write_bundle(folder, path, bank)
    assert facts.clips == 4 and facts.frames == 50 + 51 + 52 + 30 and facts.bytes == path.stat().st_size
    whole, packed = load_clips(folder, splits={"train", "val"}), load_clips(path)
    assert sorted(packed) == sorted(whole) == ["dog", "sway_0@0", "sway_1", "sway_2"]
    for name, entry in whole.items():
        other = packed[name]
        assert all(other[key] == value for key, value in entry.items() if key != "features")
        if name == "dog":  # people lose what is no joint
            assert np.abs(other["features"] - entry["features"])[:, 3:].max() < 0.01
            assert np.abs(other["features"] - entry["features"])[:, :3].max() < 0.1  # speeds: 20 times a step
    one, other = load_mesh_bank(bank, 12), load_mesh_bank(path, 12)
    assert torch.allclose(one.features, other.features, atol=2e-3) and len(other) == 3
    assert {name: rows.tolist() for name, rows in other.rows.items()} == {"dog": [0, 1], "person": [2]}
    assert other.humanoid.tolist() == [2]


def test_damaged_bundles_are_named(folder, bank, tmp_path):
    path = tmp_path / "bundle.safetensors"
    write_bundle(folder, path, bank)
    state, config = load_checkpoint(path, KIND)
    clips = json.loads(lzma.decompress(np.asarray(state["index"]).tobytes()))

    def index(changed):
        return {"index": torch.from_numpy(np.frombuffer(lzma.compress(json.dumps(changed).encode()), np.uint8).copy())}

    def entries(**changes):
        return index({name: {**entry, **changes} for name, entry in clips.items()})

    noise = torch.from_numpy(np.random.default_rng(0).integers(0, 256, len(state["data"]), dtype=np.uint8))
    bomb = torch.from_numpy(np.frombuffer(lzma.compress(bytes(80 << 20)), np.uint8).copy())
    bad = {
        "longer than it is": entries(frames=400),
        "shorter than it is": entries(frames=3),
        "endless": entries(frames=10**9),
        "no length": entries(frames="many"),
        "another form": entries(form="cloth"),
        "stretches of nothing": entries(stretches=[{"stop": 20}]),
        "no entries": index([1, 2]),
        "one too few": index(dict(list(clips.items())[1:])),
        "noise": {"data": noise},
        "a bomb": {"index": bomb},
        "negative": {"sizes": -state["sizes"]},
        "sizes": {"sizes": state["sizes"] * 2},
    }
    for what, changes in bad.items():
        save_checkpoint(path, state | changes, config, KIND)
        with pytest.raises(FormatError, match=r"bundle\.safetensors") as caught:
            load_clips(path)
        assert "\n" not in str(caught.value) and "again" in str(caught.value), what
    save_checkpoint(path, state, {"meshes": 3}, KIND)
    with pytest.raises(FormatError, match="damaged"):
        load_mesh_bank(path, 12)
    for words in (b"", b"{}", b"\x80\x04K."):
        path.write_bytes(words)
        with pytest.raises(FormatError, match=r"bundle\.safetensors"):
            load_clips(path)
    save_checkpoint(path, state, config, "diffusion")
    with pytest.raises(FormatError, match="'motion-bundle' is needed"):
        load_clips(path)


def test_the_command_says_what_it_costs(folder, bank, tmp_path, capsys):
    out = tmp_path / "bundle.safetensors"
    assert main(["data", "bundle", "--data", str(folder), "--mesh-bank", str(bank), "-o", str(out)]) == 0
    said = capsys.readouterr().out
    assert "wrote 4 clips" in said and "MiB" in said
    assert main(["data", "bundle", "--data", str(tmp_path / "none"), "-o", str(out)]) == 2
    assert main(["data", "bundle", "--data", str(folder), "-o", str(tmp_path / "bundle.npz")]) == 2


def test_subjects():
    names = ("cmu_07_11", "accad_f_A01_Stand", "accad_m1_Walk2", "accad_m2_E5", "snu_WalkSad05", "nobody_knows7")
    assert [subject_of(name) for name in names] == [
        "cmu_07", "accad_f", "accad_m1", "accad_m2", "snu_WalkSad", "nobody_knows",
    ]  # fmt: skip


def test_each_source_is_credited_once():
    lines = credit_lines(["g1_Dance", "accad_f_A01", "accad_m2_E1", "cmu_01_01", "turn_cmu_01_01", "nobody_knows"])
    assert len(lines) == 3 and lines[0].startswith("CMU Graphics Lab")
    assert lines[1].startswith("Open Motion Project") and lines[1].endswith("Licence: CC BY 3.0 Unported.")


def test_the_card_credits_its_sources_as_the_table_does():
    card = resources.files("bunraku").joinpath("weights", "diffusion.md").read_text(encoding="utf-8")
    named = card.partition("## Credits")[2]
    said = [" ".join(part.split()) for part in named.split("\n- ")[1:]]
    known = credit_lines(
        ["cmu_", "hdm_", "snu_", "dm_", "fair_", "m2m_", "kk_", "qc_", "accad_f_", "g1_", "idle_", "style_", "gdq_"]
    )
    assert said == known


def take(angles, way=0.0):
    """A take whose left elbow is bent by these angles [degrees]."""
    vectors = np.zeros((len(angles), HANDLE_COUNT, 3))
    vectors[:, HANDLE_NAMES.index("left_elbow"), 2] = np.radians(angles)
    zeros = np.zeros((len(angles), 3), np.float32)
    return HandleMotion(
        np.zeros((len(angles), HANDLE_COUNT, 3), np.float32), matrix_from_axis_angle(vectors).astype(np.float32),
        zeros, np.tile(np.eye(3, dtype=np.float32), (len(angles), 1, 1)), 20.0,
    )  # fmt: skip


def test_what_is_held_at_the_ends_of_a_take_is_left_out():
    angles = np.concatenate([np.zeros(40), 60 * np.sin(np.linspace(0, 9, 60)) + 40, np.full(30, 80.0)])
    motion = take(angles)
    start, stop = between_held_poses(motion)
    assert 30 <= start <= 40 and 100 <= stop <= 110
    stretch = Stretch(0, 80, ("a person bends an arm",), asked=("bend your arm",))
    assert checked(stretch, motion, np.zeros(130), (start, stop)) == {
        "start": start, "stop": 80, "texts": ["a person bends an arm"], "asked": ["bend your arm"],
    }  # fmt: skip
    still = checked(Stretch(0, 30, ("stands",)), motion, np.zeros(130), (start, stop))
    assert still["fault"] == "nothing but a pose that is held"
    assert between_held_poses(take(np.zeros(50))) == (45, 5)


def write(folder, clips):
    (folder / "captions_watched.json").write_text(json.dumps({"note": "", "clips": clips}))


def test_stretches_come_in_frames_with_plain_sentences(tmp_path):
    row = {"start": 0.5, "end": 4.0, "texts": ["A person  walks.", "walking", "walk"], "ok": True, "note": ""}
    write(tmp_path, {"one": [row, {**row, "start": 4.0, "end": 9.0, "ok": False, "note": "frozen"}], "unknown": [row]})
    found = load_watched(tmp_path, {"one": 150})
    assert list(found) == ["one"]
    first, second = found["one"]
    assert (first.start, first.stop, first.texts, first.fault) == (10, 80, ("a person walks", "walking", "walk"), None)
    assert (second.start, second.stop) == (80, 150) and "frozen" in second.fault


def test_without_the_file_there_are_none_and_a_broken_one_is_named(tmp_path):
    assert load_watched(tmp_path, {"one": 10}) == {}
    (tmp_path / "captions_watched.json").write_text("[1")
    with pytest.raises(FormatError, match=r"captions_watched\.json.*copy it again"):
        load_watched(tmp_path, {"one": 10})
