// A take's clip: what the joints of a skin do (src/bunraku/studio/wire.py), and its pose at any time.

import { Quaternion, Vector3, type Bone } from "three";

export interface Clip {
  fps: number;
  frames: number;
  joints: number;
  seconds: number;
  translations: Float32Array;
  rotations: Float32Array;
  /** The joint that the camera follows. */
  root: number;
  apparel: Apparel | null;
}

/** How vertices leave their skin: for each primitive of the mesh which do, and in each frame where to, before the skin. */
export interface Apparel {
  unit: number; // metres of a displacement of 1
  parts: { mesh: number; primitive: number; rows: Uint32Array; moves: Int16Array }[];
}

interface Header {
  frames: number;
  joints: number;
  fps: number;
  root?: number;
  unit?: number;
  parts?: { mesh: number; primitive: number; rows: number }[];
}

export function parseClip(data: ArrayBuffer): Clip {
  const view = new DataView(data);
  const magic = String.fromCharCode(...new Uint8Array(data, 0, 4));
  if (magic !== "BNRC") {
    throw new Error("this is no clip of Bunraku");
  }
  const length = view.getUint32(4, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 8, length))) as Header;
  const count = header.frames * header.joints;
  const translations = new Float32Array(data, 8 + length, count * 3);
  const rotations = new Float32Array(data, 8 + length + count * 12, count * 4);
  return {
    frames: header.frames,
    joints: header.joints,
    fps: header.fps,
    root: header.root ?? 0,
    seconds: Math.max(header.frames - 1, 1) / header.fps,
    translations,
    rotations,
    apparel: header.unit ? parseApparel(data, 8 + length + count * 28, header, header.unit) : null,
  };
}

function parseApparel(data: ArrayBuffer, start: number, header: Header, unit: number): Apparel {
  let at = start;
  const parts = (header.parts ?? []).map(({ mesh, primitive, rows }) => {
    const count = header.frames * rows * 3;
    const part = {
      mesh,
      primitive,
      rows: new Uint32Array(data, at, rows),
      moves: new Int16Array(data, at + rows * 4, count),
    };
    at += rows * 4 + (count + (count % 2)) * 2;
    return part;
  });
  return { unit, parts };
}

/** The frames around a time [s], and the share of the later one. */
export function between(clip: Clip, time: number): { frame: number; next: number; share: number } {
  const place = Math.min(Math.max(time * clip.fps, 0), clip.frames - 1);
  const frame = Math.floor(place);
  return { frame, next: Math.min(frame + 1, clip.frames - 1), share: place - frame };
}

const here = new Vector3();
const there = new Vector3();
const one = new Quaternion();
const other = new Quaternion();

/** Put joints where the clip has them at a time [s]. */
export function poseBones(clip: Clip, bones: readonly Bone[], time: number): void {
  const { frame, next, share } = between(clip, time);
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

/** How far the root is over the ground from its place at rest at a time [s], smoothed over half a second, for a camera that
 * follows.
 */
export function wentTo(clip: Clip, rest: Vector3 | undefined, time: number): [number, number] {
  const reach = Math.max(1, Math.round(clip.fps * 0.5));
  const middle = Math.min(Math.max(Math.round(time * clip.fps), 0), clip.frames - 1);
  let x = 0;
  let z = 0;
  let total = 0;
  for (let frame = middle - reach; frame <= middle + reach; frame += 1) {
    const inside = Math.min(Math.max(frame, 0), clip.frames - 1);
    const weight = reach + 1 - Math.abs(frame - middle);
    x += weight * (clip.translations[(inside * clip.joints + clip.root) * 3] ?? 0);
    z += weight * (clip.translations[(inside * clip.joints + clip.root) * 3 + 2] ?? 0);
    total += weight;
  }
  return [x / total - (rest?.x ?? 0), z / total - (rest?.z ?? 0)];
}
