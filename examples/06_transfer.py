"""Put a motion that exists on a character: a BVH file in, a GLB out.

The BVH is made here, so that the example needs no other file; one of your own works the same.

    python examples/06_transfer.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np

import bunraku

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "outputs")
folder.mkdir(parents=True, exist_ok=True)

person = bunraku.animate(bunraku.sample_character("person"), "walks forward", seconds=2, steps=10, seed=1)
motion = bunraku.load_motion(person.save(folder / "walk.bvh"))

robot = bunraku.sample_character("robot")
animation = bunraku.transfer(robot, motion)
path = animation.save(folder / "robot-walk.glb")
print(f"wrote {path}")

# Check: the robot goes where the person went, as far for its size.
centres = [made.vertices().mean(axis=1) for made in (person, animation)]
went = [centre[-1] - centre[0] for centre in centres]
sizes = [np.linalg.norm(step[[0, 2]]) / size.height for step, size in zip(went, (person.character, robot), strict=True)]
print(f"travel in heights: person {sizes[0]:.2f}, robot {sizes[1]:.2f}")
assert abs(sizes[1] / sizes[0] - 1) < 0.25
