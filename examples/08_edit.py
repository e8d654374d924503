"""Keep a part of an animation and generate the rest (section A.3 of TapMo).

The legs go on walking; what the arms do is new.

    python examples/08_edit.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np

import bunraku

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "outputs")
folder.mkdir(parents=True, exist_ok=True)

walk = bunraku.animate(bunraku.sample_character("person"), "walks forward", seconds=2, steps=10, seed=3)
edited = bunraku.edit(walk, "waves with both hands", keep="legs, root", steps=10, seed=3)
path = edited.save(folder / "person-waves-walking.glb")
print(f"wrote {path}")

# Check: the root is the same to the last bit, and something else is not.
assert np.array_equal(edited.motion.root_translation, walk.motion.root_translation)
assert not np.allclose(edited.motion.rotations, walk.motion.rotations)
