// What `benchmarks/page_springs.py` times in a browser: bones in chains that hang on a body that turns and goes, with colliders on it.

import { Bone, Group } from "three";
import { Springs, type SpringDocument } from "../src/springs";

/** Milliseconds of script that each of so many frames takes: springs, and the matrices of all bones. */
function time(bones: number, links: number, colliders: number, frames: number): number[] {
  const all: Bone[] = [new Bone()];
  const [body] = all as [Bone];
  const group = new Group();
  group.add(body);
  const told: SpringDocument = { springs: [], colliders: [], colliderGroups: [{ colliders: [] }] };
  for (let chain = 0; chain * links < bones; chain += 1) {
    const joints = [];
    let above = body;
    for (let link = 0; link <= links; link += 1) {
      const bone = new Bone();
      const angle = (2 * Math.PI * chain * links) / bones;
      bone.position.set(link ? 0.02 * Math.cos(angle) : 0.15 * Math.cos(angle), link ? -0.1 : 0, link ? 0.02 * Math.sin(angle) : 0.15 * Math.sin(angle));
      above.add(bone);
      joints.push({ node: all.length, stiffness: 0.5, dragForce: 0.2, gravityPower: 0.1, gravityDir: [0, -1, 0], hitRadius: 0.02 });
      all.push(bone);
      above = bone;
    }
    told.springs.push({ joints, colliderGroups: [0] });
  }
  for (let number = 0; number < colliders; number += 1) {
    const x = 0.1 * Math.cos(number);
    told.colliders?.push({ node: 0, shape: { capsule: { offset: [x, -0.1, 0], tail: [x, -0.5, 0.05], radius: 0.07 } } });
    told.colliderGroups?.[0]?.colliders.push(number);
  }
  const springs = new Springs(all, (node) => node, told);
  if (springs.links.length !== bones) {
    throw new Error(`${springs.links.length} links, not ${bones}`);
  }
  const out: number[] = [];
  for (let frame = 0; frame < frames; frame += 1) {
    body.rotation.set(0.2 * Math.sin(frame / 9), 0.6 * Math.sin(frame / 20), 0);
    body.position.set(0.3 * Math.sin(frame / 30), 1, 0);
    const start = performance.now();
    group.updateMatrixWorld(true);
    springs.swing(1 / 60);
    group.updateMatrixWorld(true);
    out.push(performance.now() - start);
  }
  return out;
}

Object.assign(globalThis, { time });
