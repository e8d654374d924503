"""The node pack for ComfyUI: written by the command line, loaded from its folder, at work against a studio. ComfyUI
itself is not there: its nodes are called as its graph calls them, by the names that the pack gives.
"""

import importlib.util
import sys

import pytest

from bunraku import save_character
from bunraku.cli import main
from bunraku.io.play import load_animation
from bunraku.samples import sample_character


def loaded(folder):
    spec = importlib.util.spec_from_file_location("custom_nodes_bunraku", folder / "__init__.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_sentence_from_the_node_to_a_moving_character(studio, tmp_path, monkeypatch):
    folder = tmp_path / "bunraku"
    assert main(["comfyui-nodes", "-o", str(folder)]) == 0
    assert main(["comfyui-nodes", "-o", str(folder)]) == 0  # the same pack is no reason to stop
    before = set(sys.modules)
    pack = loaded(folder)
    assert not {"torch", "bpy", "bunraku"} & (set(sys.modules) - before)
    node = pack.NODE_CLASS_MAPPINGS["BunrakuAnimate"]
    asked = node.INPUT_TYPES()["required"]
    given = {name: what[1]["default"] if len(what) > 1 else what[0][0] for name, what in asked.items()}
    mesh = save_character(sample_character("mushroom"), tmp_path / "mushroom.glb")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="with its token"):
        node().animate(**{**given, "model_file": str(mesh)})
    given |= {"model_file": str(mesh), "sentence": "waves", "seconds": 1.0, "format": "fbx", "address": studio.address}
    (path,) = getattr(node(), node.FUNCTION)(**given)
    assert len(node.RETURN_TYPES) == 1 and load_animation(path, 0, 30).vertices().std(axis=0).max() > 0
    with pytest.raises(ValueError, match="type what the character does"):
        node().animate(**{**given, "sentence": " "})
    (folder / "__init__.py").write_text("mine")
    assert main(["comfyui-nodes", "-o", str(folder)]) == 2
