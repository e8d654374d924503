"""Let a network find skirt and hair on a mesh and move them (MMDMC, section 4).

The dancer has no rig and no physics: her skirt is found by its shape and swings by what was learned. The same motion
with apparel that follows the body stands beside it.

    python examples/07_apparel.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np

import bunraku

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "outputs")
folder.mkdir(parents=True, exist_ok=True)

dancer = bunraku.sample_character("dancer")
stiff = bunraku.animate(dancer, "turns around", seconds=1, steps=10, seed=2)
swinging = bunraku.transfer(stiff.character, stiff, apparel="learn")
path = swinging.save(folder / "dancer-swings.glb")
print(f"wrote {path}")

# Check: a part of her moves by itself and the rest does not, and nothing flies off.
apart = np.linalg.norm(swinging.vertices() - bunraku.transfer(dancer, stiff).vertices(), axis=2).max(axis=0)
moved = np.mean(apart > 0.01 * dancer.height)
print(f"{moved:.0%} of the vertices move by themselves, by {apart.max() / dancer.height:.0%} of the height at most")
assert 0.02 < moved < 0.8 and apart.max() < 0.5 * dancer.height
