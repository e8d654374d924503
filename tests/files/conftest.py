import pytest
from gltf_files import textured_glb

from bunraku.files.registry import load_character


@pytest.fixture
def thing(tmp_path):
    """A character with a rig, a texture and all else that a GLB may hold."""
    path = tmp_path / "thing.glb"
    path.write_bytes(textured_glb())
    return load_character(path)
