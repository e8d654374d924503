"""A few hundred broken files, and proof that the fuzzer would see what it looks for."""

import fuzz
import pytest

from bunraku.files import load_character
from bunraku.pipelines.to_reference import load_motion


def test_no_broken_file_does_harm():
    found = fuzz.run(0, 300)
    assert found["files"] == 300
    assert {fault: found[fault] for fault in fuzz.FAULTS} == dict.fromkeys(fuzz.FAULTS, 0)


def test_no_broken_project_does_harm():
    found = fuzz.run(0, 60, corpus=fuzz.projects())
    assert found["files"] == 60
    assert {fault: found[fault] for fault in fuzz.FAULTS} == dict.fromkeys(fuzz.FAULTS, 0)


@pytest.mark.parametrize("name", [name for name, _ in fuzz.seeds()])
def test_the_files_are_good_before_they_are_broken(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(dict(fuzz.seeds())[name])
    read = load_motion if path.suffix in (".bvh", ".npy", ".npz") else load_character
    assert read(path) is not None


def test_a_seed_is_always_the_same_file():
    corpus = fuzz.seeds()
    assert [fuzz.broken(seed, corpus) for seed in range(20)] == [fuzz.broken(seed, fuzz.seeds()) for seed in range(20)]
    assert len({fuzz.broken(seed, corpus)[1] for seed in range(20)}) > 15


def _raise(path):
    raise ZeroDivisionError


def _spin(path):
    while True:
        pass


def _hoard(path):
    return bytearray(350_000_000)


def _stray(path):
    return (path.parent.parent / "secret.bin").read_bytes()


@pytest.mark.parametrize(
    ("reader", "fault"), [(_raise, "foreign"), (_spin, "slow"), (_hoard, "large"), (_stray, "outside")]
)
def test_each_fault_is_seen(tmp_path, monkeypatch, reader, fault):
    fuzz.run(0, 0)  # watches what is opened
    path = tmp_path / "files" / "thing.glb"
    path.parent.mkdir()
    path.write_bytes(b"glTF")
    (tmp_path / "secret.bin").write_bytes(b"1")
    monkeypatch.setattr(fuzz, "load_character", reader)
    if fault == "slow":  # the others keep the whole time: a slow machine takes as long to hoard
        monkeypatch.setattr(fuzz, "SECONDS", 0.5)
    assert fuzz.check(path) == {fault}
