"""Make the pictures of docs/engines: the file that `bunraku animate --for PROGRAM` writes, as three.js opens it.

    python tools/make_engine_pictures.py [PROGRAM ...]

Needs Chromium, the package playwright, and `npm ci` in studio/. Each picture has at most 300 kB.
"""

from __future__ import annotations

import json
import re
import sys
import tempfile
from io import BytesIO
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "studio"))

from browser import chromium  # noqa: E402
from PIL import Image  # noqa: E402

from bunraku.cli import main as bunraku  # noqa: E402

OUT = ROOT / "docs" / "engines"
MODULES = ROOT / "studio" / "node_modules" / "three"
MOST = 300_000
WIDE, HIGH = 960, 360
SEEN = {  # the sample, and its prompts
    "unity": ("person", ["idle", "walks forward", "Attack=kicks with the right leg"]),
    "unreal": ("person", ["walks forward", "runs", "waves"]),
    "godot": ("person", ["idle", "walks forward", "jumps"]),
    "blender": ("dragon", ["walks forward", "flies", "roars"]),
    "three": ("mushroom", ["walks forward", "dances", "jumps"]),
    "vrchat": ("dancer", ["waves", "dances", "bows"]),
}

PAGE = """<!doctype html><meta charset="utf-8">
<style>body { margin: 0; background: #e9e7e3; font: 15px system-ui, sans-serif; color: #222 }
p { position: absolute; margin: 0; text-align: center; width: 320px; bottom: 10px }
h1 { position: absolute; left: 14px; top: 8px; margin: 0; font-size: 15px; font-weight: 600 }</style>
<script type="importmap">{"imports": {"three": "/three/build/three.module.js"}}</script>
<canvas id="view" width="960" height="360"></canvas><h1></h1>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "/three/examples/jsm/loaders/GLTFLoader.js";
import { FBXLoader } from "/three/examples/jsm/loaders/FBXLoader.js";
window.shown = async (files, title) => {
  const canvas = document.getElementById("view");
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
  renderer.setSize(960, 360, false);
  renderer.setScissorTest(true);
  document.querySelector("h1").textContent = title;
  const found = [];
  let column = 0;
  for (const file of files) {
    const loaded = await (file.endsWith(".fbx") ? new FBXLoader() : new GLTFLoader()).loadAsync(file);
    const model = loaded.scene ?? loaded;
    for (const clip of loaded.animations) {
      const scene = new THREE.Scene();
      scene.background = new THREE.Color(0xe9e7e3);
      scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8078, 2), model);
      const sun = new THREE.DirectionalLight(0xffffff, 2);
      sun.position.set(1, 2, 1.5);
      scene.add(sun);
      const bones = [];
      model.traverse((one) => {
        if (one.isBone) bones.push(one);
        if (one.isMesh) one.frustumCulled = false;
      });
      const mixer = new THREE.AnimationMixer(model);
      mixer.clipAction(clip).play();
      mixer.setTime(clip.duration * 0.4);
      model.updateMatrixWorld(true);
      const box = new THREE.Box3();
      model.traverse((one) => {
        if (one.isSkinnedMesh) {
          one.computeBoundingBox();
          box.union(one.boundingBox.clone().applyMatrix4(one.matrixWorld));
        }
      });
      const size = box.getSize(new THREE.Vector3());
      const middle = box.getCenter(new THREE.Vector3());
      const reach = Math.max(size.x, size.y, size.z);
      const helper = new THREE.SkeletonHelper(model);
      helper.material.depthTest = false;
      helper.material.linewidth = 2;
      scene.add(helper);
      helper.updateMatrixWorld(true);
      const camera = new THREE.PerspectiveCamera(26, 320 / 310, reach / 100, reach * 30);
      camera.position.set(0.55, 0.2, 1).normalize().multiplyScalar(reach * 2.9).add(middle);
      camera.lookAt(middle);
      renderer.setViewport(column * 320, 40, 320, 310);
      renderer.setScissor(column * 320, 40, 320, 310);
      renderer.render(scene, camera);
      scene.remove(model);
      mixer.stopAllAction();
      const said = document.createElement("p");
      said.style.left = `${column * 320}px`;
      said.textContent = `${clip.name} · ${clip.duration.toFixed(1)} s`;
      document.body.append(said);
      found.push({ clip: clip.name, seconds: clip.duration, bones: bones.map((one) => one.name) });
      column += 1;
    }
  }
  return found;
};
</script>"""


def served(files: dict[str, bytes]) -> Any:
    """Answers a page that asks for three.js or one of some files."""

    def answer(route: Any) -> None:
        path = re.sub(r"^https?://[^/]+", "", route.request.url).partition("?")[0]
        if path == "/":
            route.fulfill(body=PAGE, content_type="text/html")
        elif path.startswith("/three/"):
            route.fulfill(path=MODULES / path.removeprefix("/three/"), content_type="text/javascript")
        elif path[1:] in files:
            route.fulfill(body=files[path[1:]], content_type="application/octet-stream")
        else:
            route.fulfill(status=404)

    return answer


def make(browser: Any, program: str) -> None:
    """The picture of a program's file."""
    sample, prompts = SEEN[program]
    with tempfile.TemporaryDirectory() as folder:
        assert bunraku(["samples", sample, "-o", folder]) == 0
        mesh = Path(folder) / f"{sample}.glb"
        asked = ["animate", str(mesh), *prompts, "--seconds", "2", "--for", program]
        before = set(Path(folder).iterdir())
        assert bunraku([*asked, "-o", f"{folder}/moves{'.fbx' if program in FBX else '.glb'}"]) == 0
        written = sorted(path for path in set(Path(folder).iterdir()) - before if path.suffix in (".fbx", ".glb"))
        files = {path.name: path.read_bytes() for path in written}
        page = browser.new_page(viewport={"width": WIDE, "height": HIGH})
        page.route("**/*", served(files))
        page.goto("http://localhost/")
        page.wait_for_function("() => typeof window.shown === 'function'")
        title = ", ".join(files)
        found = page.evaluate("([files, title]) => window.shown(files, title)", [list(files), title])
        picture = Image.open(BytesIO(page.screenshot())).convert("RGB")
        page.close()
    path = OUT / f"{program}.png"
    picture.quantize(255, dither=Image.Dither.NONE).save(path, optimize=True)
    assert path.stat().st_size <= MOST, f"{path} has {path.stat().st_size} bytes"
    print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1e3:.0f} kB")
    print(json.dumps([{**one, "bones": f"{len(one['bones'])}: {', '.join(one['bones'][:4])}"} for one in found]))


FBX = ("unity", "unreal", "vrchat")


def main(names: list[str]) -> None:
    """Make them all, or those that are named."""
    with chromium() as browser:
        for name in names or SEEN:
            make(browser, name)


if __name__ == "__main__":
    main(sys.argv[1:])
