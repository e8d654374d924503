// Opens a VRM with three-vrm as a web page would, turns its bones, and lets its springs swing.
//
// node three_vrm.mjs MODULES < JOBS     with MODULES a node_modules that has three and @pixiv/three-vrm, and JOBS JSON:
//   [{"vrm": ..., "bones": [name, ...], "turns": FILE, "root": FILE, "frames": N, "fps": F, "watch": [name, ...], "out": FILE}]
//
// TURNS holds the quaternions xyzw of the bones in each frame, ROOT where the first of them is, both little-endian 32-bit
// floats; OUT gets where the watched bones are in the world in each frame, and OUT.json what of the avatar was found.

import fs from 'node:fs';
import path from 'node:path';
import { pathToFileURL } from 'node:url';

globalThis.self = globalThis;
const folder = path.resolve(process.argv[2]);
const THREE = await import(pathToFileURL(path.join(folder, 'three/build/three.module.js')));
const { GLTFLoader } = await import(pathToFileURL(path.join(folder, 'three/examples/jsm/loaders/GLTFLoader.js')));
const { VRMLoaderPlugin } = await import(pathToFileURL(path.join(folder, '@pixiv/three-vrm/lib/three-vrm.module.js')));

const noTextures = () => ({ name: 'no textures', loadTexture: () => Promise.resolve(new THREE.Texture()) });
const floats = (file) => { const data = fs.readFileSync(file); return new Float32Array(data.buffer, data.byteOffset, data.length / 4); };
const SUBSTEPS = 2; // 60 a second, for which VRM's numbers are meant

for (const job of JSON.parse(fs.readFileSync(0, 'utf8'))) {
  const data = fs.readFileSync(job.vrm);
  const loader = new GLTFLoader().register((parser) => new VRMLoaderPlugin(parser)).register(noTextures);
  const gltf = await loader.parseAsync(data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength), '');
  const vrm = gltf.userData.vrm;
  vrm.humanoid.autoUpdateHumanBones = false;
  const named = (name) => vrm.scene.getObjectByName(THREE.PropertyBinding.sanitizeNodeName(name));
  const bones = job.bones.map(named);
  const watch = job.watch.map(named);
  const turns = floats(job.turns);
  const root = floats(job.root);
  const out = new Float32Array(job.frames * watch.length * 3);
  const place = new THREE.Vector3();
  const from = new THREE.Quaternion(), to = new THREE.Quaternion();
  const pose = (frame, share) => {
    const next = Math.min(frame + 1, job.frames - 1);
    bones.forEach((bone, number) => {
      from.fromArray(turns, 4 * (frame * bones.length + number));
      to.fromArray(turns, 4 * (next * bones.length + number));
      bone.quaternion.copy(from.slerp(to, share));
    });
    bones[0].position.fromArray(root, 3 * frame).lerp(place.fromArray(root, 3 * next), share);
  };
  pose(0, 0);
  vrm.scene.updateMatrixWorld(true);
  if (vrm.springBoneManager) vrm.springBoneManager.reset();
  for (let frame = 0; frame < job.frames; frame++) {
    if (frame) {
      for (let part = 1; part <= SUBSTEPS; part++) {
        pose(frame - 1, part / SUBSTEPS);
        vrm.scene.updateMatrixWorld(true);
        vrm.update(1 / job.fps / SUBSTEPS);
      }
    }
    vrm.scene.updateMatrixWorld(true);
    watch.forEach((bone, number) => bone.getWorldPosition(place).toArray(out, 3 * (frame * watch.length + number)));
  }
  fs.writeFileSync(job.out, out);
  const springs = vrm.springBoneManager ? vrm.springBoneManager.joints.size : 0;
  const bonesFound = Object.keys(vrm.humanoid.humanBones).length;
  fs.writeFileSync(`${job.out}.json`, JSON.stringify({ springs, bones: bonesFound }));
}
