// Opens FBX files with three.js as a web page would, but for textures, and writes joints, weights and where everything
// is at some times.
//
// node three_fbx.mjs THREE < JOBS     with THREE the folder of the package, and JOBS JSON: [{"fbx": ..., "times": [s, ...], "out": ...}]
//
// OUT.json lists joints with their parents, clips, meshes and how many vertices and weights there are; OUT gets 64-bit
// floats in metres: heads (J, 3), rest (V, 3), weights as (vertex, joint, share), and for each clip and time heads
// (J, 3), turns (J, 3, 3), vertices (V, 3). Vertices are the corners of all triangles, meshes sorted by their names.

import fs from 'node:fs';
import path from 'node:path';
import { pathToFileURL } from 'node:url';

globalThis.self = globalThis;
globalThis.window = globalThis;
const folder = path.resolve(process.argv[2]);
const THREE = await import(pathToFileURL(path.join(folder, 'build/three.module.js')));
const { FBXLoader } = await import(pathToFileURL(path.join(folder, 'examples/jsm/loaders/FBXLoader.js')));
THREE.TextureLoader.prototype.load = () => new THREE.Texture();

const place = new THREE.Vector3();
for (const job of JSON.parse(fs.readFileSync(0, 'utf8'))) {
  const data = fs.readFileSync(job.fbx);
  const scene = new FBXLoader().parse(data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength), '');
  scene.scale.multiplyScalar((scene.userData.unitScaleFactor ?? 1) / 100); // to metres
  scene.updateMatrixWorld(true);
  const joints = [], meshes = [];
  scene.traverse((thing) => {
    if (thing.isBone) joints.push(thing);
    if (thing.isMesh) meshes.push(thing);
  });
  meshes.sort((one, other) => (one.name < other.name ? -1 : 1));
  const out = [], weights = [];
  const heads = () => joints.forEach((joint) => out.push(...place.setFromMatrixPosition(joint.matrixWorld).toArray()));
  heads();
  let first = 0;
  for (const mesh of meshes) {
    const { position, skinIndex, skinWeight } = mesh.geometry.attributes;
    for (let vertex = 0; vertex < position.count; vertex++) {
      out.push(...place.fromBufferAttribute(position, vertex).applyMatrix4(mesh.matrixWorld).toArray());
      for (let k = 0; mesh.isSkinnedMesh && k < 4; k++) {
        const share = skinWeight.getComponent(vertex, k);
        if (share > 0) weights.push(first + vertex, joints.indexOf(mesh.skeleton.bones[skinIndex.getComponent(vertex, k)]), share);
      }
    }
    first += position.count;
  }
  for (const value of weights) out.push(value);
  const mixer = new THREE.AnimationMixer(scene);
  for (const clip of scene.animations) {
    mixer.stopAllAction();
    const action = mixer.clipAction(clip);
    action.setLoop(THREE.LoopOnce);
    action.clampWhenFinished = true; // the last frame is no first one
    action.reset().play();
    for (const time of job.times) {
      mixer.setTime(time);
      scene.updateMatrixWorld(true);
      heads();
      for (const joint of joints) {
        const m = new THREE.Matrix4().extractRotation(joint.matrixWorld).elements;
        for (let row = 0; row < 3; row++) out.push(m[row], m[4 + row], m[8 + row]);
      }
      for (const mesh of meshes) {
        for (let vertex = 0; vertex < mesh.geometry.attributes.position.count; vertex++) {
          out.push(...mesh.getVertexPosition(vertex, place).applyMatrix4(mesh.matrixWorld).toArray());
        }
      }
    }
  }
  fs.writeFileSync(job.out, Float64Array.from(out));
  fs.writeFileSync(`${job.out}.json`, JSON.stringify({
    joints: joints.map((joint) => [joint.name, joint.parent?.isBone ? joints.indexOf(joint.parent) : -1]),
    vertices: first, weights: weights.length / 3, clips: scene.animations.map((clip) => clip.name),
    materials: [...new Set(meshes.flatMap((mesh) => [mesh.material].flat().map((one) => one.name)))].sort(),
  }));
}
