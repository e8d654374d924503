"""Human motions as handle motions: heights, rolled limbs, turns on the spot."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import heading, matrix_from_axis_angle, matrix_y
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.core.skinning import skin
from bunraku.errors import FormatError
from bunraku_lab.datasets.motions.build import (
    MotionArchive,
    add_turns,
    build_motions,
    floor_height,
    handle_motion_of_body,
    level_feet,
    posture_fault,
    rolled_limbs,
    split_of,
    standing_foot_pitch,
    subject_pitches,
)
from bunraku_lab.datasets.motions.clips import load_clip, write_clip


def bend(frames, seed=0):
    """A body that bends its joints by smooth random angles while it drifts."""
    rng = np.random.default_rng(seed)
    wave = np.sin(np.linspace(0, 3, frames))[:, None, None] * rng.normal(0, 0.4, (1, JOINT_COUNT, 3))
    return Rotation.from_rotvec(wave.reshape(-1, 3)).as_quat().reshape(frames, JOINT_COUNT, 4)


def write_archive(folder, lengths):
    """An archive as it travels: per channel, first differences of round(8192 wxyz), int16 in two byte planes."""
    body = reference_body()
    takes = [bend(n, i) for i, n in enumerate(lengths)]
    planes = []
    for quaternions in takes:
        whole = np.round(quaternions[..., [3, 0, 1, 2]].reshape(len(quaternions), -1) * 8192).astype(np.int32)
        deltas = np.diff(whole, axis=0, prepend=0).astype("<i2")
        planes.append(np.ascontiguousarray(deltas.T)[..., None].view(np.uint8).transpose(2, 0, 1))
    names = [f"cmu_01_{i:02d}" for i in range(len(lengths))]
    total = sum(lengths)
    root = np.zeros((total, 3), np.float32) + [0, body.joints[0, 1], 0]
    np.savez(
        folder / "motions.npz", dq=np.concatenate(planes, axis=2), root=root.astype(np.float32),
        offsets=np.tile(body.skeleton.offsets, (len(lengths), 1, 1)), rest=body.joints, off=np.cumsum([0, *lengths]),
        names=np.array(names), joints=np.array(JOINT_NAMES), parents=np.array(JOINT_PARENTS),
    )  # fmt: skip
    clips = {
        name: {
            "texts": ["a person bends"],
            "source": "here",
            "licence": "CC0",
            "flags": ["partial take"] if i == 0 else [],
        }
        for i, name in enumerate(names)
    }
    (folder / "motions.json").write_text(json.dumps({"fps": 20, "clips": clips}))
    return takes


def test_archive_gives_back_the_rotations(tmp_path):
    takes = write_archive(tmp_path, [12, 30])
    archive = MotionArchive.open(tmp_path)
    for index, quaternions in enumerate(takes):
        want = Rotation.from_quat(quaternions.reshape(-1, 4)).as_matrix().reshape(-1, JOINT_COUNT, 3, 3)
        np.testing.assert_allclose(archive.motion(index).rotations, want, atol=5e-4)


def test_handle_motion_replays_the_posed_body():
    body = reference_body()
    rotations = Rotation.from_quat(bend(40).reshape(-1, 4)).as_matrix().reshape(40, JOINT_COUNT, 3, 3)
    motion = SkeletalMotion(
        body.skeleton, rotations, np.tile(body.joints[0], (40, 1)) + np.linspace(0, 1, 40)[:, None] * [1, 0, 2]
    )
    handles = handle_motion_of_body(motion)
    posed = body.pose(motion)
    replayed = skin(body.vertices, body.handle_weights, handles.transforms(body.handles.positions))
    posed[..., 1] -= np.quantile(posed[..., 1].min(axis=1), 0.05)  # the conversion sets the body on the ground
    assert np.linalg.norm(replayed - posed, axis=-1).mean() < 0.004 * body.character().height
    tail = slice(28, 30)
    np.testing.assert_allclose(handles.translations[:, tail], 0, atol=1e-6)


def test_building_resumes_and_keeps_what_is_done(tmp_path):
    write_archive(tmp_path, [12, 30, 25])
    seen = []
    index = build_motions(tmp_path, tmp_path / "out", jobs=1, progress=lambda stage, share: seen.append((stage, share)))
    clips = json.loads(index.read_text())["clips"]
    assert [clips[f"cmu_01_{i:02d}"]["frames"] for i in range(3)] == [12, 30, 25]
    assert clips["cmu_01_00"]["weight"] == 0.5 and clips["cmu_01_01"]["weight"] == 1.0
    assert seen[-1] == ("converting motions", 1.0)
    first, second = (tmp_path / "out" / f"cmu_01_{i:02d}.npz" for i in range(2))
    stamp = first.stat().st_mtime_ns
    second.unlink()
    build_motions(tmp_path, tmp_path / "out", jobs=1)
    assert first.stat().st_mtime_ns == stamp and len(load_clip(second)) == 30
    assert not list((tmp_path / "out").glob(".*"))


@pytest.mark.parametrize("damage", ["missing", "cut", "other"])
def test_a_broken_archive_is_one_sentence(tmp_path, damage):
    write_archive(tmp_path, [12])
    path = tmp_path / "motions.npz"
    if damage == "missing":
        path.unlink()
    elif damage == "cut":
        path.write_bytes(path.read_bytes()[:500])
    else:
        np.savez(path, joints=np.array(["a"]), names=np.array(["b"]))
    with pytest.raises(FormatError, match="motions.npz"):
        MotionArchive.open(tmp_path)


def test_splits_are_fixed():
    names = [f"clip_{i}" for i in range(3000)]
    share = sum(split_of(name) == "test" for name in names) / len(names)
    assert 0.04 < share < 0.08
    assert [split_of(name) for name in ("cmu_16_11", "cmu_16_12", "snu_spiral_walk_normal07")] == [
        "train",
        "train",
        "train",
    ]


def test_a_subject_with_sloping_feet_is_levelled():
    body = reference_body()
    rotations = np.tile(np.eye(3), (30, JOINT_COUNT, 1, 1))
    for joint in (7, 8):
        rotations[:, joint] = Rotation.from_euler("x", 20, degrees=True).as_matrix()  # toes 20 degrees down
    motion = SkeletalMotion(body.skeleton, rotations, np.tile(body.joints[0], (30, 1)))
    slope = standing_foot_pitch(motion)
    assert np.degrees(slope) == pytest.approx(-20, abs=0.1)
    slopes = subject_pitches([(f"cmu_07_{i:02d}", slope) for i in range(3)])
    assert standing_foot_pitch(level_feet(motion, "cmu_07_09", slopes)) == pytest.approx(0, abs=1e-3)
    assert level_feet(motion, "cmu_08_09", slopes) is motion


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs the /proc of Linux")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_a_build_that_is_stopped_leaves_no_process_and_keeps_what_is_done(tmp_path, how):
    write_archive(tmp_path, [300] * 16)
    out = tmp_path / "out"
    words = ["data", "motions", "--source", str(tmp_path), "-o", str(out), "--jobs", "2"]
    run = subprocess.Popen([sys.executable, "-m", "bunraku", *words], stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 120
    while not list(out.glob("*.npz")):
        assert run.poll() is None and time.monotonic() < end
        time.sleep(0.05)
    children = Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
    assert len(children) >= 2
    run.send_signal(how)
    before = time.monotonic()
    run.wait(60)
    while any(_runs(child) for child in children):
        assert time.monotonic() - before < 60
        time.sleep(0.02)
    if how == signal.SIGINT:
        assert run.returncode == 130
        assert [line for line in run.stderr.read().splitlines() if "measuring" not in line] == ["bunraku: interrupted"]
    done = list(out.glob("*.npz"))
    assert 0 < len(done) < 16
    stamps = {path: path.stat().st_mtime_ns for path in done}
    assert len(json.loads(build_motions(tmp_path, out, jobs=2).read_text())["clips"]) == 16
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())


def _runs(process):
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


FPS = 20.0


def steps(frames, jump=None):
    """The lowest point of somebody who walks, and who jumps half a metre high for half a second where asked."""
    lowest = 0.01 * np.abs(np.sin(np.arange(frames)))
    if jump is not None:
        lowest[jump : jump + 10] += 0.5 * np.sin(np.linspace(0, np.pi, 10))
    return lowest


def test_what_hovers_comes_down_and_what_jumps_stays_up():
    lowest = steps(200, jump=100)
    drift = np.linspace(0.0, 0.12, 200)
    settled = lowest + drift - floor_height(lowest + drift, FPS)
    assert np.abs(np.delete(settled, np.arange(96, 114))).max() < 0.03
    assert settled[100:110].max() == pytest.approx(0.5, abs=0.04)


@pytest.mark.parametrize(
    ("texts", "height", "lowest", "words"),
    [
        (["a person sits on a chair"], -0.15, 0.0, "no seat"),
        (["a person sits on a chair"], -0.4, 0.0, None),
        (["someone sits on a high stool"], -0.05, 0.0, None),
        (["a person lies on the back"], -0.1, 0.0, "lies"),
        (["a person walks"], 0.0, 0.2, "nothing is near the ground in 100 %"),
        (["a person climbs a ladder"], 0.0, 0.8, None),
        (["a person walks"], 0.0, 0.0, None),
    ],
)
def test_postures_that_cannot_be_are_named(texts, height, lowest, words):
    fault = posture_fault(texts, np.full(40, height), np.full(40, lowest))
    assert (fault is None) if words is None else (words in fault)


J = {name: index for index, name in enumerate(JOINT_NAMES)}


def squats(rolled: bool) -> SkeletalMotion:
    """Someone whose knees bend up to 90 degrees; the right leg's bones may be rolled by half a turn about
    themselves.
    """
    bend = np.deg2rad(90) * np.sin(np.linspace(0, np.pi, 40))
    rotations = np.tile(np.eye(3), (40, len(JOINT_NAMES), 1, 1))
    for side in ("left", "right"):
        rotations[:, J[f"{side}_hip"]] = matrix_from_axis_angle(np.stack([-0.5 * bend, 0 * bend, 0 * bend], axis=1))
        rotations[:, J[f"{side}_knee"]] = matrix_from_axis_angle(np.stack([bend, 0 * bend, 0 * bend], axis=1))
    if rolled:
        down = reference_body().skeleton.offsets[J["right_ankle"]]
        down = down / np.linalg.norm(down)
        half = 2 * np.outer(down, down) - np.eye(3)  # about the shin
        rotations[:, J["right_hip"]] = rotations[:, J["right_hip"]] @ half
        rotations[:, J["right_knee"]] = half @ rotations[:, J["right_knee"]] @ half
    return SkeletalMotion(reference_body().skeleton, rotations, np.zeros((40, 3)), 20.0)


def test_a_rolled_leg_is_found_and_only_that():
    assert rolled_limbs(squats(False)) == []
    assert rolled_limbs(squats(True)) == ["right_knee"]


def walker(degrees, frames=160, radius=0.0):
    """Stands for 40 frames, turns within 40, stands again; or walks a circle while turning."""
    angle = np.radians(degrees) * np.clip((np.arange(frames) - 40) / 40, 0, 1)
    path = radius * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    still = np.broadcast_to(np.eye(3), (frames, 30, 3, 3))
    return HandleMotion(np.zeros((frames, 30, 3)), still, path, matrix_y(angle), 20.0)


def test_turns_join_the_index_with_their_direction(tmp_path):
    clips = {}
    for name, degrees, text in (
        ("a", 170, "walk"),
        ("b", -170, "a person walks"),
        ("c", 170, "salsa dance"),
        ("d", 40, "walk"),
    ):
        write_clip(tmp_path / f"{name}.npz", walker(degrees))
        clips[name] = {"texts": [text], "split": "train", "frames": 160, "weight": 1.0}
    (tmp_path / "index.json").write_text(json.dumps({"clips": clips}))
    assert add_turns(tmp_path) == ["turn_a", "turn_b"]
    index = json.loads((tmp_path / "index.json").read_text())["clips"]
    assert index["turn_a"]["texts"] == ["a person turns around to the left"]
    assert index["turn_b"]["texts"] == ["a person turns around to the right"]
    turn = load_clip(tmp_path / "turn_a.npz")
    assert len(turn) == index["turn_a"]["frames"] < 90
    assert np.ptp(heading(turn.root_rotation)) > 2.5


def test_an_index_cannot_name_a_file_outside_its_folder(tmp_path):
    (tmp_path / "index.json").write_text(json.dumps({"clips": {"../outside": {"texts": ["walk"], "split": "train"}}}))
    with pytest.raises(FormatError, match="not a plain name"):
        add_turns(tmp_path)
