// A take's clip: what the joints of a skin do (src/bunraku/studio/clips.py), and its pose at any time.

import { Quaternion, Vector3, type Bone } from "three";

export interface Clip {
  fps: number;
  frames: number;
  joints: number;
  seconds: number;
  translations: Float32Array;
  rotations: Float32Array;
}

export function parseClip(data: ArrayBuffer): Clip {
  const view = new DataView(data);
  const magic = String.fromCharCode(...new Uint8Array(data, 0, 4));
  if (magic !== "BNRC") {
    throw new Error("this is no clip of Bunraku");
  }
  const length = view.getUint32(4, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 8, length))) as {
    frames: number;
    joints: number;
    fps: number;
  };
  const count = header.frames * header.joints;
  const translations = new Float32Array(data, 8 + length, count * 3);
  const rotations = new Float32Array(data, 8 + length + count * 12, count * 4);
  return { ...header, seconds: Math.max(header.frames - 1, 1) / header.fps, translations, rotations };
}

const here = new Vector3();
const there = new Vector3();
const one = new Quaternion();
const other = new Quaternion();

/** Put joints where the clip has them at a time [s]. */
export function poseBones(clip: Clip, bones: readonly Bone[], time: number): void {
  const place = Math.min(Math.max(time * clip.fps, 0), clip.frames - 1);
  const frame = Math.floor(place);
  const next = Math.min(frame + 1, clip.frames - 1);
  const share = place - frame;
  const count = Math.min(clip.joints, bones.length);
  for (let joint = 0; joint < count; joint += 1) {
    const bone = bones[joint];
    if (!bone) {
      continue;
    }
    here.fromArray(clip.translations, (frame * clip.joints + joint) * 3);
    there.fromArray(clip.translations, (next * clip.joints + joint) * 3);
    one.fromArray(clip.rotations, (frame * clip.joints + joint) * 4);
    other.fromArray(clip.rotations, (next * clip.joints + joint) * 4);
    bone.position.lerpVectors(here, there, share);
    bone.quaternion.slerpQuaternions(one, other, share);
  }
}

/** Where the root is over the ground at a time [s], smoothed over half a second, for a camera that follows. */
export function rootAt(clip: Clip, time: number): [number, number] {
  const reach = Math.max(1, Math.round(clip.fps * 0.5));
  const middle = Math.min(Math.max(Math.round(time * clip.fps), 0), clip.frames - 1);
  let x = 0;
  let z = 0;
  let total = 0;
  for (let frame = middle - reach; frame <= middle + reach; frame += 1) {
    const inside = Math.min(Math.max(frame, 0), clip.frames - 1);
    const weight = reach + 1 - Math.abs(frame - middle);
    x += weight * (clip.translations[inside * clip.joints * 3] ?? 0);
    z += weight * (clip.translations[inside * clip.joints * 3 + 2] ?? 0);
    total += weight;
  }
  return [x / total, z / total];
}
