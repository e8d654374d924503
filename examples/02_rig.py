"""Look at the handles that Bunraku gives a character, and save them as a skin without motion.

python examples/02_rig.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np

import bunraku
from bunraku.core.body.layout import HANDLE_NAMES

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "outputs")
folder.mkdir(parents=True, exist_ok=True)

character = bunraku.sample_character("dog")
handles = bunraku.rig(character)
for name, position, share in zip(HANDLE_NAMES, handles.positions, handles.weights.mean(axis=0), strict=True):
    print(f"{name:<16} at {np.round(position, 2)}, holds {share:.1%} of the vertices")
path = bunraku.save_character(character, folder / "dog-rigged.glb", handles)
print(f"wrote {path}")

# Check: each vertex is shared out whole, and the file brings the skin back.
assert np.allclose(handles.weights.sum(axis=1), 1, atol=1e-3)
rig = bunraku.load_character(path).rig
assert rig is not None and rig.names == HANDLE_NAMES
