"""How long the page's script takes for springs of hair and clothes, a frame, in Chromium.

    python benchmarks/page_springs.py [--bones 100] [--links 4] [--colliders 4]

Springs in chains of `links` hang on a body that turns and goes; each meets all colliders. A frame is a step of a
sixtieth of a second and the matrices of all bones, as `studio/src/springs.ts` and three.js do it; drawing is not in it.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

STUDIO = Path(__file__).resolve().parents[1] / "studio"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
WARM = 300  # frames in which the browser compiles what is called often


def main() -> None:
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--bones", type=int, default=100)
    parser.add_argument("--links", type=int, default=4)
    parser.add_argument("--colliders", type=int, default=4)
    parser.add_argument("--frames", type=int, default=3000)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        script = Path(folder) / "springs.js"
        packer = ["node_modules/.bin/rolldown", "tests/springs.time.ts", "--platform", "browser"]
        subprocess.run([*packer, "--format", "iife", "-o", str(script)], cwd=STUDIO, check=True, capture_output=True)
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page()
        page.add_script_tag(content=script.read_text())
        count = WARM + asked.frames
        taken = np.array(page.evaluate(f"time({asked.bones}, {asked.links}, {asked.colliders}, {count})"))[WARM:]
        browser.close()
    print(f"{asked.bones} spring bones, {asked.colliders} colliders: mean {taken.mean():.3f} ms a frame, median "
          f"{np.median(taken):.3f}, 99 % under {np.percentile(taken, 99):.3f}")  # fmt: skip


if __name__ == "__main__":
    main()
