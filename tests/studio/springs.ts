// For checks without a browser: where the page's own springs take the bones of a GLB, as JSON.
//
//     node springs.mjs MESH.glb POSES.json        POSES: quaternions xyzw and places of the first bone, a frame each
//
// 60 frames a second; each frame gives where all bones are.

import { readFileSync } from "node:fs";
import { loadModel, swing } from "../../studio/src/model";

Object.assign(globalThis, { self: globalThis });
const [, , mesh, poses] = process.argv;
const model = await loadModel("", Uint8Array.from(readFileSync(mesh as string)).buffer, true);
const frames = JSON.parse(readFileSync(poses as string, "utf8")) as { turn: number[]; place: number[] }[];
const out = frames.map(({ turn, place }, frame) => {
  const [first] = model.bones;
  first?.quaternion.fromArray(turn);
  first?.position.fromArray(place);
  model.group.updateMatrixWorld(true);
  swing(model, frame ? 1 / 60 : 0);
  return model.bones.map((bone) => bone.getWorldPosition(bone.position.clone()).toArray());
});
console.log(JSON.stringify(out));
