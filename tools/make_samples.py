"""Make the sample characters that the package ships: src/bunraku/samples/NAME.glb.

python tools/make_samples.py
"""

from __future__ import annotations

import sys
from pathlib import Path

from bunraku.samples import sample_names
from bunraku_lab.synthetic.samples import write_sample

TARGET = Path(__file__).resolve().parents[1] / "src" / "bunraku" / "samples"


def main() -> int:
    """Write all samples and say how large they are together."""
    paths = [write_sample(name, TARGET / f"{name}.glb") for name in sample_names()]
    print(f"{len(paths)} samples, {sum(path.stat().st_size for path in paths) / 1e6:.2f} MB in {TARGET}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
