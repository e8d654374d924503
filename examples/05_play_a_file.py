"""Play the clip of a GLB file, for example one that Bunraku wrote, and work with its vertices.

python examples/05_play_a_file.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np

import bunraku
from bunraku.files import load_animation

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "outputs")
folder.mkdir(parents=True, exist_ok=True)

made = bunraku.animate(bunraku.sample_character("dragon"), "turns around", seconds=2, steps=10, seed=5)
path = made.save(folder / "dragon-turns.glb", fps=20)
played = load_animation(path, fps=20)
print(f"{path}: {len(played.motion)} frames of {len(played.character.vertices)} vertices")

# Check: the file plays what was made, but for the four influences a vertex that files keep.
error = np.linalg.norm(played.vertices() - made.vertices(), axis=2)
print(f"mean difference {error.mean() / made.character.height:.3%} of the height")
assert error.mean() < 1e-3 * made.character.height
