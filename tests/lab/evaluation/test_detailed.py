"""The list of detailed people: that no training of handles sees them, and where they come from."""

import os
from pathlib import Path

import pytest

from bunraku_lab.datasets.characters.build import HELD_OUT
from bunraku_lab.evaluation.handles.detailed import ARCHIVE, AVATARS, WARDROBE, detailed_subjects

DATA = Path(os.environ.get("BUNRAKU_DATA", "runs/data"))


def test_there_are_twenty_and_those_of_the_archive_are_held_out():
    assert len(ARCHIVE) + len(AVATARS) + len(WARDROBE) == len({*ARCHIVE, *AVATARS, *WARDROBE}) == 20
    assert set(ARCHIVE) < set(HELD_OUT)


def test_files_that_are_not_there_are_left_out(tmp_path):
    (tmp_path / "valid").mkdir()
    (tmp_path / f"{ARCHIVE[-1]}.glb").write_bytes(b"")
    (tmp_path / "Other.pmx").write_bytes(b"")
    (tmp_path / AVATARS[1]).write_bytes(b"")
    assert list(detailed_subjects(tmp_path, tmp_path))[:2] == [ARCHIVE[-1], "Gene"]
    assert list(detailed_subjects()) == [f"wardrobe/{seed}" for seed in WARDROBE]


def test_a_person_of_the_wardrobe_has_the_truth_of_its_rig():
    one = detailed_subjects()[f"wardrobe/{WARDROBE[0]}"]()
    assert one.humanoid and one.character.rig is None
    assert one.truth.weights.shape == (len(one.character.vertices), len(one.truth.joints))


@pytest.mark.skipif(not (DATA / "apparel").is_dir(), reason="the avatars are not there")
def test_avatars_are_found_in_a_folder_of_them():
    loads = detailed_subjects(avatars=DATA / "apparel")
    assert len(loads) == len(AVATARS) + len(WARDROBE)
    assert loads["Gene"]().humanoid
