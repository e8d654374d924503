"""Animate a character with a sentence, and save it as a GLB.

python examples/01_animate.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np

import bunraku

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "outputs")
folder.mkdir(parents=True, exist_ok=True)

# Any mesh does: character = bunraku.load_character("dragon.glb")
character = bunraku.sample_character("person")
animation = bunraku.animate(character, "a person walks forward", seconds=2, seed=1)
path = animation.save(folder / "person-walks.glb")
print(f"wrote {path}")

# Check: the posed vertices are an array, one frame after the other, and they move by more than a tenth of the height.
vertices = animation.vertices()
assert vertices.shape == (len(animation.motion), *character.vertices.shape)
assert np.isfinite(vertices).all()
assert np.linalg.norm(vertices[-1] - vertices[0], axis=1).max() > 0.1 * character.height
