"""Random damage to a file of each format: what is not read is refused in one sentence."""

import gzip
from pathlib import Path

import pytest
import trimesh
from gltf_files import CUBE, CUBE_FACES, made_up_handles, made_up_motion, textured_glb
from hostile import damaged, outcomes
from mmd_bytes import plank, pmd, pmx
from test_bvh import SMALL

from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.errors import BunrakuError
from bunraku.files import load_character, load_fbx_motion, read_motion

DATA = Path(__file__).parent / "data"


def load_and_save(path):
    character = load_character(path)
    handles, motion = made_up_handles(character, 4), made_up_motion(character, 3, 4)
    Animation(character, handles, motion).save(path.with_name("out.glb"))


def load_both(path):
    failures = []
    for read in (load_character, load_fbx_motion):
        try:
            read(path)
        except BunrakuError as error:
            failures.append(error)
    if failures:
        raise failures[0]


def npz(folder):
    cube = Character("cube", CUBE, CUBE_FACES)
    return Animation(cube, made_up_handles(cube), made_up_motion(cube)).save(folder / "good.npz").read_bytes()


def ball(suffix):
    def make(folder):
        trimesh.creation.icosphere(subdivisions=1).export(folder / f"good.{suffix}")
        return (folder / f"good.{suffix}").read_bytes()

    return make


CASES = {
    "glb": (lambda folder: textured_glb(), load_and_save, {"count": 200, "most": 5}),
    "obj": (ball("obj"), load_character, {"count": 100, "most": 4, "seed": 1, "cut": 0.33}),
    "ply": (ball("ply"), load_character, {"count": 100, "most": 4, "seed": 1, "cut": 0.33}),
    "stl": (ball("stl"), load_character, {"count": 50, "most": 4, "seed": 1, "cut": 0.33}),
    "fbx": (lambda folder: gzip.decompress((DATA / "boxman_y_up_m.fbx.gz").read_bytes()), load_both,
            {"count": 20, "first": 27}),
    "npz": (npz, read_motion, {"count": 100, "most": 1}),
    "bvh": (lambda folder: SMALL.encode(), read_motion, {"count": 300}),
    "pmx": (lambda folder: pmx(plank()), load_character, {"count": 80, "first": 8, "cut": 0.5}),
    "pmd": (lambda folder: pmd(plank()), load_character, {"count": 80, "first": 8, "cut": 0.5}),
}  # fmt: skip


@pytest.mark.parametrize("suffix", CASES)
def test_damage_leaves_a_result_or_one_sentence(tmp_path, suffix):
    make, read, damage = CASES[suffix]
    found = outcomes(tmp_path / f"bad.{suffix}", damaged(make(tmp_path), **damage), read)
    assert suffix != "glb" or found == {"read", "refused"}
