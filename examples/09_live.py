"""A character that never stops, and does what it is told while it moves.

python examples/09_live.py [FOLDER]
"""

import sys
from itertools import islice
from pathlib import Path

import bunraku

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "outputs")
folder.mkdir(parents=True, exist_ok=True)

live = bunraku.live(bunraku.sample_character("person"), "walks forward", seed=3)
for _pose in islice(live, 60):  # three seconds, at 20 poses a second; a game would draw each
    pass
live.go((1, 0))  # towards +X
for _pose in islice(live, 80):
    pass
live.say("waves with the right hand")
for _pose in islice(live, 60):
    pass
played = live.played()
print(f"wrote {played.save(folder / 'person-live.glb')}")

# Check: it went forward, then to the side, and no frame leaps.
path = played.motion.root_translation
assert len(played.motion) == 200 and path[59, 2] > 1 and path[139, 0] - path[70, 0] > 1
assert abs(path[1:] - path[:-1]).max() < 0.2
