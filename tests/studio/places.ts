// For checks without a browser: where the page's own code puts the vertices of a mesh at some times of a clip, as JSON.
//
//     node places.mjs MESH.glb CLIP.bin SECONDS ...

import { readFileSync } from "node:fs";
import { parseClip } from "../../studio/src/clip";
import { loadModel, pose } from "../../studio/src/model";

Object.assign(globalThis, { self: globalThis });
const [, , mesh, clip, ...times] = process.argv;
const bytes = (name: string): ArrayBuffer => Uint8Array.from(readFileSync(name)).buffer;

const model = await loadModel("", bytes(mesh as string));
const shown = parseClip(bytes(clip as string));
const out = times.map((time) => {
  pose(model, shown, Number(time));
  return model.skins.flatMap((skin) => {
    const spot = skin.position.clone();
    const count = skin.geometry.getAttribute("position")?.count ?? 0;
    return Array.from({ length: count }, (_, vertex) => {
      skin.getVertexPosition(vertex, spot);
      return spot.applyMatrix4(skin.matrixWorld).toArray();
    });
  });
});
console.log(JSON.stringify(out));
