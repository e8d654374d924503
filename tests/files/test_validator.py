"""Every GLB that is written passes the Khronos validator; skipped where node or the validator is missing."""

import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, Maker, made_up_handles, made_up_motion, textured_glb
from motion_files import walk_about

from bunraku.core.animation import Animation, PointAnimation, RigAnimation
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.files import load_character, save_character
from bunraku.files.gltf.read import rotated

HERE = Path(__file__).parent
MODULES = Path(os.environ.get("BUNRAKU_GLTF_VALIDATOR", HERE / "validator")) / "node_modules"
needs_validator = pytest.mark.skipif(
    not shutil.which("node") or not (MODULES / "gltf-validator").is_dir(),
    reason="needs node, and `npm install` in tests/files/validator (or BUNRAKU_GLTF_VALIDATOR)",
)


def errors(paths):
    """What the validator finds wrong, by file name."""
    command = ["node", str(HERE / "validator" / "validate.js"), *map(str, paths)]
    reports = json.loads(
        subprocess.run(command, capture_output=True, check=True, env={**os.environ, "NODE_PATH": str(MODULES)}).stdout
    )
    assert len(reports) == len(paths)
    return {
        Path(name).name: [m for m in report["messages"] if m[0] in "01"]
        for name, report in reports.items()
        if report["errors"] or report["warnings"]
    }


def awkward_glb():
    """What the validator would find fault with if it were carried over as it is."""
    maker = Maker()
    normals = np.zeros_like(CUBE)
    normals[1] = np.nan
    uv = np.full((8, 2), np.inf, np.float32)
    attributes = {
        "POSITION": maker.add(CUBE, min=[0, 0, 0], max=[9, 9, 9]),
        "NORMAL": maker.add(normals),
        "TEXCOORD_0": maker.add(uv),
        "COLOR_0": maker.add(np.full((8, 3), 7, np.uint8), normalized=True),
    }
    attributes["TANGENT"] = maker.add(np.zeros((8, 4), np.float32))
    primitive = {
        "attributes": attributes,
        "indices": maker.add(CUBE_FACES.reshape(-1).astype(np.uint8)),
        "extensions": {"MADE_up": {"view": 3}},
    }
    # The validator warns of degenerate UVs and the like as hints only, so errors and warnings must both be none.
    return maker.glb(
        nodes=[{"mesh": 0, "scale": [-1, 2, 1]}, {"camera": 0}],
        meshes=[{"primitives": [primitive]}],
        cameras=[{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}],
        extensions={"VRM": {"firstPerson": 1}},
        extensionsUsed=["VRM", "MADE_up"],
    )


@needs_validator
def test_what_is_written_is_valid(tmp_path):
    for name, data in (("textured", textured_glb()), ("awkward", awkward_glb())):
        (tmp_path / f"{name}.glb").write_bytes(data)
    (tmp_path / "quad.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nf 1/1 2/2 3/1 4/2\nf 1/2 3/2 4/2\n"
    )
    characters = [load_character(tmp_path / name) for name in ("textured.glb", "awkward.glb", "quad.obj")]
    characters.append(Character("plain", CUBE, CUBE_FACES, colors=np.full((8, 3), 90)))
    written = []
    for number, character in enumerate(characters):
        handles = made_up_handles(character)
        written.append(
            Animation(character, handles, made_up_motion(character)).save(tmp_path / f"animated{number}.glb", fps=30)
        )
        written.append(
            Animation(character, handles, made_up_motion(character, frames=1)).save(tmp_path / f"one_frame{number}.glb")
        )
        written += [
            save_character(character, tmp_path / f"rigged{number}.glb", handles),
            save_character(character, tmp_path / f"plain{number}.glb"),
        ]
        offsets = (
            0.1
            * np.sin(np.arange(24))[:, None, None]
            * character.vertices
            * (np.arange(len(character.vertices)) % 3 > 0)[:, None]
        )
        moved = PointAnimation(Animation(character, handles, made_up_motion(character)), offsets)
        written += [moved.save(tmp_path / f"{shapes}{number}.glb", shapes=shapes) for shapes in ("mixed", "keys")]
    written.append(
        walk_about(frames=5).save(tmp_path / "walk.vrma").rename(tmp_path / "walk.glb")
    )  # its extension is unknown, which is no fault
    assert errors(written) == {}


@needs_validator
def test_rigs_that_are_written_are_valid(tmp_path):
    (tmp_path / "textured.glb").write_bytes(textured_glb())
    textured = load_character(tmp_path / "textured.glb")
    written = []
    for number, character in enumerate(
        (
            textured,
            rotated(textured, "+z", "-y"),
            replace(textured, source=None, avatar=None),
            reference_body().character(),
        )
    ):
        bones = len(character.rig.names)
        turns = matrix_from_axis_angle(np.random.default_rng(0).normal(size=(4, bones, 3)))
        written.append(
            RigAnimation(character, turns, np.zeros((4, bones, 3))).save(tmp_path / f"rig{number}.glb", fps=30)
        )
    assert errors(written) == {}
