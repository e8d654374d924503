// Reads PMX files with mmd-parser, which is not ours, and prints what it found: bones, rigid bodies and joints.
//
// node mmd_parse.mjs MODULES FILE...     with MODULES a node_modules that has mmd-parser

import fs from 'node:fs';
import path from 'node:path';
import { createRequire } from 'node:module';

const require = createRequire(path.join(path.resolve(process.argv[2]), 'here.js'));
const { Parser } = require('mmd-parser');
const found = process.argv.slice(3).map((file) => {
  const data = fs.readFileSync(file);
  const model = new Parser().parsePmx(data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength), false);
  return {
    vertices: model.metadata.vertexCount,
    faces: model.metadata.faceCount,
    bones: model.bones.map((bone) => ({ name: bone.name, parent: bone.parentIndex, position: bone.position })),
    bodies: model.rigidBodies.map((body) => ({ name: body.name, bone: body.boneIndex, mass: body.weight, type: body.type, position: body.position })),
    joints: (model.constraints ?? []).map((joint) => ({
      name: joint.name, bodies: [joint.rigidBodyIndex1, joint.rigidBodyIndex2], position: joint.position,
      low: joint.rotationLimitation1 ?? joint.rotationConstraint1, high: joint.rotationLimitation2 ?? joint.rotationConstraint2,
    })),
  };
});
process.stdout.write(JSON.stringify(found));
