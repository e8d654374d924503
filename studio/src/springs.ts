// Springs of bones as VRM 1.0 moves them (VRMC_springBone): in steps of a sixtieth of a second each tail goes on as it went,
// is drawn towards where it rests and downwards, keeps its distance to its head, and is pushed out of colliders. They stand
// in the extras of a GLB (src/bunraku/files/gltf/vrm.py). All is kept in flat arrays: nothing is allocated
// from frame to frame.

import type { Bone } from "three";

type Numbers = readonly number[];

export interface SpringDocument {
  springs: {
    name?: string;
    joints: { node: number; hitRadius?: number; stiffness?: number; gravityPower?: number; gravityDir?: Numbers; dragForce?: number }[];
    colliderGroups?: number[];
  }[];
  colliders?: { node: number; shape: { sphere?: Ball; capsule?: Ball & { tail?: Numbers } } }[];
  colliderGroups?: { colliders: number[] }[];
}

interface Ball {
  offset?: Numbers;
  radius?: number;
}

const STEP = 1 / 60;
const MOST_STEPS = 4; // of one frame: who comes back after a pause is not simulated through all of it
const JUMP = 0.5; // [m] of a bone within a frame: what was swinging starts anew

interface Link {
  bone: number;
  above: number; // the bone that it hangs on, -1 for none
  axis: [number, number, number]; // to its tail at rest [m], and how long that is
  length: number;
  stiffness: number;
  drag: number;
  fall: [number, number, number];
  radius: number;
  colliders: number[];
}

interface Collider {
  bone: number;
  from: [number, number, number];
  to: [number, number, number];
  radius: number;
}

export class Springs {
  /** Factors on all. */
  stiffness = 1;
  gravity = 1;
  readonly links: Link[] = [];
  private readonly colliders: Collider[] = [];
  private readonly held: number[] = []; // bones that others move, from which links and colliders hang
  private readonly place: Float64Array;
  private readonly turn: Float64Array;
  private readonly rest: Float64Array;
  private readonly tail: Float64Array;
  private readonly before: Float64Array;
  private readonly ends: Float64Array; // of colliders, now
  private left = 0;
  private fresh = true;

  /**
   * @param bones those of the skin
   * @param boneOf which of them a node of the document is, -1 for none
   */
  constructor(
    private readonly bones: readonly Bone[],
    boneOf: (node: number) => number,
    told: SpringDocument,
  ) {
    const count = bones.length;
    this.place = new Float64Array(count * 3);
    this.turn = new Float64Array(count * 4);
    this.rest = new Float64Array(count * 3);
    bones.forEach((bone, number) => bone.position.toArray(this.rest, number * 3));
    const number = new Map(bones.map((bone, at) => [bone, at]));
    const groups = told.colliderGroups ?? [];
    const swinging = new Set<number>();
    for (const spring of told.springs) {
      const reached = [...new Set((spring.colliderGroups ?? []).flatMap((group) => groups[group]?.colliders ?? []))];
      spring.joints.slice(0, -1).forEach((joint, at) => {
        const [bone, next] = [boneOf(joint.node), boneOf(spring.joints[at + 1]?.node ?? -1)];
        const one = bones[bone];
        const child = bones[next];
        if (!one || !child || child.parent !== one) {
          return;
        }
        const axis = child.position.toArray() as [number, number, number];
        const power = joint.gravityPower ?? 0;
        const down = joint.gravityDir ?? [0, -1, 0];
        swinging.add(bone);
        this.links.push({
          bone,
          above: number.get(one.parent as Bone) ?? -1,
          axis,
          length: Math.max(Math.hypot(...axis), 1e-6),
          stiffness: joint.stiffness ?? 1,
          drag: Math.min(Math.max(joint.dragForce ?? 0.5, 0), 1),
          fall: [power * (down[0] ?? 0), power * (down[1] ?? -1), power * (down[2] ?? 0)],
          radius: joint.hitRadius ?? 0,
          colliders: reached,
        });
      });
    }
    for (const { node, shape } of told.colliders ?? []) {
      const body = shape.capsule ?? shape.sphere ?? {};
      const from = [...(body.offset ?? [0, 0, 0])] as [number, number, number];
      const to = [...(shape.capsule?.tail ?? from)] as [number, number, number];
      this.colliders.push({ bone: boneOf(node), from, to, radius: body.radius ?? 0 });
    }
    const watched = [...this.links.map((link) => link.above), ...this.colliders.map((one) => one.bone)];
    this.held = [...new Set(watched)].filter((bone) => bone >= 0 && !swinging.has(bone));
    this.tail = new Float64Array(this.links.length * 3);
    this.before = new Float64Array(this.links.length * 3);
    this.ends = new Float64Array(this.colliders.length * 6);
  }

  /** All hangs as it does at rest when it is moved next. */
  reset(): void {
    this.fresh = true;
  }

  /** Let the links swing for a time [s]. What others move has its place already; links get their rotations. */
  swing(seconds: number): void {
    this.look();
    if (this.fresh) {
      this.hang();
      this.fresh = false;
    }
    this.left = Math.min(this.left + seconds, MOST_STEPS * STEP);
    while (this.left >= STEP - 1e-9) {
      this.left -= STEP;
      this.step(STEP);
    }
    this.pose();
  }

  /** Where the bones are that others move. */
  private look(): void {
    const { place, turn } = this;
    for (const bone of this.held) {
      const matrix = this.bones[bone]?.matrixWorld.elements;
      if (!matrix) {
        continue;
      }
      const at = bone * 3;
      const far = Math.abs((matrix[12] ?? 0) - (place[at] ?? 0)) + Math.abs((matrix[14] ?? 0) - (place[at + 2] ?? 0));
      this.fresh ||= far > JUMP;
      place[at] = matrix[12] ?? 0;
      place[at + 1] = matrix[13] ?? 0;
      place[at + 2] = matrix[14] ?? 0;
      quaternion(matrix, turn, bone * 4);
    }
    this.colliders.forEach(({ bone, from, to }, number) => {
      if (bone >= 0) {
        rotated(turn, bone * 4, from, spot);
        for (let axis = 0; axis < 3; axis += 1) {
          this.ends[number * 6 + axis] = (place[bone * 3 + axis] ?? 0) + (spot[axis] ?? 0);
        }
        rotated(turn, bone * 4, to, spot);
        for (let axis = 0; axis < 3; axis += 1) {
          this.ends[number * 6 + 3 + axis] = (place[bone * 3 + axis] ?? 0) + (spot[axis] ?? 0);
        }
      }
    });
  }

  /** Put a link's head where what it hangs on has it, turned with that. */
  private follow(link: Link): void {
    const { place, turn, rest } = this;
    const to = link.bone * 3;
    const at = link.bone * 4;
    if (link.above < 0) {
      place.set(rest.subarray(to, to + 3), to);
      turn.set(STILL, at);
      return;
    }
    spot[0] = rest[to] ?? 0;
    spot[1] = rest[to + 1] ?? 0;
    spot[2] = rest[to + 2] ?? 0;
    rotated(turn, link.above * 4, spot, spot);
    for (let axis = 0; axis < 3; axis += 1) {
      place[to + axis] = (place[link.above * 3 + axis] ?? 0) + (spot[axis] ?? 0);
    }
    for (let part = 0; part < 4; part += 1) {
      turn[at + part] = turn[link.above * 4 + part] ?? 0;
    }
  }

  private hang(): void {
    this.links.forEach((link, number) => {
      this.follow(link);
      rotated(this.turn, link.bone * 4, link.axis, spot);
      for (let axis = 0; axis < 3; axis += 1) {
        const tail = (this.place[link.bone * 3 + axis] ?? 0) + (spot[axis] ?? 0);
        this.tail[number * 3 + axis] = tail;
        this.before[number * 3 + axis] = tail;
      }
    });
  }

  private step(dt: number): void {
    const { tail, before, place } = this;
    for (let number = 0; number < this.links.length; number += 1) {
      const link = this.links[number] as Link;
      this.follow(link);
      rotated(this.turn, link.bone * 4, link.axis, aim);
      const keep = 1 - link.drag;
      const back = (this.stiffness * link.stiffness * dt) / link.length;
      const down = this.gravity * dt;
      const head = link.bone * 3;
      const at = number * 3;
      for (let axis = 0; axis < 3; axis += 1) {
        const here = tail[at + axis] ?? 0;
        next[axis] = here + keep * (here - (before[at + axis] ?? 0)) + back * (aim[axis] ?? 0) + down * (link.fall[axis] ?? 0);
        before[at + axis] = here;
      }
      this.reach(link, head);
      for (const collider of link.colliders) {
        if (this.pushed(link, collider)) {
          this.reach(link, head);
        }
      }
      tail[at] = next[0] ?? 0;
      tail[at + 1] = next[1] ?? 0;
      tail[at + 2] = next[2] ?? 0;
      for (let axis = 0; axis < 3; axis += 1) {
        next[axis] = ((next[axis] ?? 0) - (place[head + axis] ?? 0)) / link.length;
        aim[axis] = (aim[axis] ?? 0) / link.length;
      }
      turnFrom(aim, next, this.turn, link.bone * 4);
    }
  }

  /** Bring `next` to a link's length from its head. */
  private reach(link: Link, head: number): void {
    const [x, y, z] = [this.place[head] ?? 0, this.place[head + 1] ?? 0, this.place[head + 2] ?? 0];
    const [dx, dy, dz] = [(next[0] ?? 0) - x, (next[1] ?? 0) - y, (next[2] ?? 0) - z];
    const scale = link.length / Math.max(Math.hypot(dx, dy, dz), 1e-9);
    next[0] = x + dx * scale;
    next[1] = y + dy * scale;
    next[2] = z + dz * scale;
  }

  /** Take `next` out of a collider; whether it was in it. */
  private pushed(link: Link, number: number): boolean {
    const collider = this.colliders[number];
    if (!collider || collider.bone < 0) {
      return false;
    }
    const at = number * 6;
    const { ends } = this;
    const [ax, ay, az] = [ends[at] ?? 0, ends[at + 1] ?? 0, ends[at + 2] ?? 0];
    const [bx, by, bz] = [(ends[at + 3] ?? 0) - ax, (ends[at + 4] ?? 0) - ay, (ends[at + 5] ?? 0) - az];
    let [dx, dy, dz] = [(next[0] ?? 0) - ax, (next[1] ?? 0) - ay, (next[2] ?? 0) - az];
    const long = bx * bx + by * by + bz * bz;
    const share = long > 0 ? Math.min(Math.max((dx * bx + dy * by + dz * bz) / long, 0), 1) : 0;
    dx -= share * bx;
    dy -= share * by;
    dz -= share * bz;
    const away = Math.hypot(dx, dy, dz);
    const wanted = collider.radius + link.radius;
    if (away >= wanted || away < 1e-9) {
      return false;
    }
    const more = (wanted - away) / away;
    next[0] = (next[0] ?? 0) + more * dx;
    next[1] = (next[1] ?? 0) + more * dy;
    next[2] = (next[2] ?? 0) + more * dz;
    return true;
  }

  /** Give the bones the rotations in their parents. */
  private pose(): void {
    const { turn } = this;
    for (const link of this.links) {
      const bone = this.bones[link.bone];
      const at = link.bone * 4;
      if (link.above < 0) {
        bone?.quaternion.fromArray(turn, at);
        continue;
      }
      const up = link.above * 4;
      const [x, y, z, w] = [-(turn[up] ?? 0), -(turn[up + 1] ?? 0), -(turn[up + 2] ?? 0), turn[up + 3] ?? 1];
      const [a, b, c, d] = [turn[at] ?? 0, turn[at + 1] ?? 0, turn[at + 2] ?? 0, turn[at + 3] ?? 1];
      bone?.quaternion.set(
        w * a + x * d + y * c - z * b,
        w * b - x * c + y * d + z * a,
        w * c + x * b - y * a + z * d,
        w * d - x * a - y * b - z * c,
      );
    }
  }
}

const STILL = [0, 0, 0, 1];
const spot = [0, 0, 0];
const aim = [0, 0, 0];
const next = [0, 0, 0];

type Values = ArrayLike<number>;

/** A vector turned by the quaternion at a place; `out` may be the vector. */
function rotated(turns: Float64Array, at: number, vector: Values, out: number[]): void {
  const [x, y, z, w] = [turns[at] ?? 0, turns[at + 1] ?? 0, turns[at + 2] ?? 0, turns[at + 3] ?? 1];
  const [a, b, c] = [vector[0] ?? 0, vector[1] ?? 0, vector[2] ?? 0];
  const tx = 2 * (y * c - z * b);
  const ty = 2 * (z * a - x * c);
  const tz = 2 * (x * b - y * a);
  out[0] = a + w * tx + y * tz - z * ty;
  out[1] = b + w * ty + z * tx - x * tz;
  out[2] = c + w * tz + x * ty - y * tx;
}

/** Turn what stands at a place by the shortest rotation from one unit vector to another. */
function turnFrom(from: Values, to: Values, turns: Float64Array, at: number): void {
  const [a, b, c] = [from[0] ?? 0, from[1] ?? 0, from[2] ?? 0];
  const [d, e, f] = [to[0] ?? 0, to[1] ?? 0, to[2] ?? 0];
  const cosine = a * d + b * e + c * f;
  if (cosine < -0.999999) {
    return; // right back: which way round cannot be told, and the next step brings it out of there
  }
  let [x, y, z, w] = [b * f - c * e, c * d - a * f, a * e - b * d, 1 + cosine];
  const size = 1 / Math.hypot(x, y, z, w);
  x *= size;
  y *= size;
  z *= size;
  w *= size;
  const [p, q, r, s] = [turns[at] ?? 0, turns[at + 1] ?? 0, turns[at + 2] ?? 0, turns[at + 3] ?? 1];
  turns[at] = w * p + x * s + y * r - z * q;
  turns[at + 1] = w * q - x * r + y * s + z * p;
  turns[at + 2] = w * r + x * q - y * p + z * s;
  turns[at + 3] = w * s - x * p - y * q - z * r;
}

/** The rotation of a matrix of three.js, whose columns may be scaled. */
function quaternion(m: Values, out: Float64Array, at: number): void {
  const scale = 1 / Math.max(Math.hypot(m[0] ?? 0, m[1] ?? 0, m[2] ?? 0), 1e-12);
  const [a, b, c] = [(m[0] ?? 0) * scale, (m[1] ?? 0) * scale, (m[2] ?? 0) * scale];
  const [d, e, f] = [(m[4] ?? 0) * scale, (m[5] ?? 0) * scale, (m[6] ?? 0) * scale];
  const [g, h, i] = [(m[8] ?? 0) * scale, (m[9] ?? 0) * scale, (m[10] ?? 0) * scale];
  const trace = a + e + i;
  let [x, y, z, w] = [0, 0, 0, 1];
  if (trace > 0) {
    const s = 0.5 / Math.sqrt(trace + 1);
    [x, y, z, w] = [(f - h) * s, (g - c) * s, (b - d) * s, 0.25 / s];
  } else if (a > e && a > i) {
    const s = 2 * Math.sqrt(1 + a - e - i);
    [x, y, z, w] = [0.25 * s, (d + b) / s, (g + c) / s, (f - h) / s];
  } else if (e > i) {
    const s = 2 * Math.sqrt(1 + e - a - i);
    [x, y, z, w] = [(d + b) / s, 0.25 * s, (h + f) / s, (g - c) / s];
  } else {
    const s = 2 * Math.sqrt(1 + i - a - e);
    [x, y, z, w] = [(g + c) / s, (h + f) / s, 0.25 * s, (b - d) / s];
  }
  out[at] = x;
  out[at + 1] = y;
  out[at + 2] = z;
  out[at + 3] = w;
}
