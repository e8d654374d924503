// Opens GLBs with three.js as a web page would, but for textures, and writes where their vertices are at some times.
//
// node three_play.mjs THREE < JOBS     with THREE the folder of the package, and JOBS JSON: [{"glb": ..., "times": [s, ...], "out": ..., "clip": N}]
//
// OUT gets little-endian 32-bit floats: for each time, for each mesh, x, y and z of each vertex in the world; OUT.json lists the meshes.

import fs from 'node:fs';
import path from 'node:path';
import { pathToFileURL } from 'node:url';

globalThis.self = globalThis;
const folder = path.resolve(process.argv[2]);
// the loader imports "three" by its name, so it must come from the same folder
const THREE = await import(pathToFileURL(path.join(folder, 'build/three.module.js')));
const { GLTFLoader } = await import(pathToFileURL(path.join(folder, 'examples/jsm/loaders/GLTFLoader.js')));

const noTextures = () => ({ name: 'no textures', loadTexture: () => Promise.resolve(new THREE.Texture()) });

for (const job of JSON.parse(fs.readFileSync(0, 'utf8'))) {
  const data = fs.readFileSync(job.glb);
  const loader = new GLTFLoader().register(noTextures);
  const gltf = await loader.parseAsync(data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength), '');
  const known = gltf.parser.associations;
  const meshes = [];
  gltf.scene.traverse((thing) => { if (thing.isMesh) meshes.push(thing); });
  const mixer = new THREE.AnimationMixer(gltf.scene);
  for (const clip of gltf.animations.slice(job.clip ?? 0, (job.clip ?? 0) + 1)) {
    const action = mixer.clipAction(clip);
    action.setLoop(THREE.LoopOnce);
    action.clampWhenFinished = true; // the last frame is no first one
    action.play();
  }
  const count = meshes.reduce((sum, mesh) => sum + mesh.geometry.attributes.position.count, 0);
  const out = new Float32Array(job.times.length * count * 3);
  const place = new THREE.Vector3();
  let at = 0;
  for (const time of job.times) {
    mixer.setTime(time);
    gltf.scene.updateMatrixWorld(true);
    for (const mesh of meshes) {
      for (let vertex = 0; vertex < mesh.geometry.attributes.position.count; vertex++) {
        mesh.getVertexPosition(vertex, place).applyMatrix4(mesh.matrixWorld).toArray(out, at); // morphed, then skinned
        at += 3;
      }
    }
  }
  fs.writeFileSync(job.out, out);
  const list = meshes.map((mesh) => {
    const own = known.get(mesh) ?? {};
    const node = own.nodes ?? (known.get(mesh.parent) ?? {}).nodes; // several primitives hang on a group
    return { node, primitive: own.primitives ?? 0, count: mesh.geometry.attributes.position.count };
  });
  fs.writeFileSync(`${job.out}.json`, JSON.stringify(list));
}
