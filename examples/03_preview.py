"""Draw an animation without a window: a video and a contact sheet.

python examples/03_preview.py [FOLDER]
"""

import sys
from pathlib import Path

import bunraku
from bunraku.render import save_preview

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "outputs")
folder.mkdir(parents=True, exist_ok=True)

animation = bunraku.animate(bunraku.sample_character("mushroom"), "jumps up and down", seconds=2, steps=10, seed=3)
for name, options in (
    ("mushroom.mp4", {"size": (320, 240)}),
    ("mushroom.png", {"frames": 6, "title": "jumps up and down"}),
):
    path = save_preview(animation, folder / name, **options)
    print(f"wrote {path}")

# Check: the files begin as such files do.
assert (folder / "mushroom.mp4").read_bytes()[4:8] == b"ftyp"
assert (folder / "mushroom.png").read_bytes().startswith(b"\x89PNG")
