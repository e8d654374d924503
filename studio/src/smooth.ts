// Normals for a mesh that has none: smooth where faces meet at a small angle, an edge where they do not.

import { BufferAttribute, Vector3, type BufferGeometry } from "three";

/** Faces that meet at more than this stay apart [rad]; chosen by eye on the six samples and a box. */
const CREASE = (50 * Math.PI) / 180;
const MOST_FACES = 400_000; // above this every edge is smoothed: looking for creases would take over a second

/** Of each vertex the first one at the same place, to a millionth of the mesh's reach. */
function welded(places: Float32Array, count: number): Uint32Array {
  const grain = 1e6 / (places.reduce((most, value) => Math.max(most, Math.abs(value)), 0) || 1);
  const cells = Int32Array.from(places, (value) => Math.round(value * grain));
  const mask = 2 ** Math.ceil(Math.log2(2 * count + 1)) - 1;
  const table = new Int32Array(mask + 1).fill(-1); // open addressing: keys of text take a second of 50,000 vertices
  return Uint32Array.from({ length: count }, (_, vertex) => {
    const [x, y, z] = [cells[vertex * 3]!, cells[vertex * 3 + 1]!, cells[vertex * 3 + 2]!];
    let slot = (Math.imul(x, 73856093) ^ Math.imul(y, 19349663) ^ Math.imul(z, 83492791)) & mask;
    for (let other = table[slot]!; other >= 0; slot = (slot + 1) & mask, other = table[slot]!) {
      if (cells[other * 3] === x && cells[other * 3 + 1] === y && cells[other * 3 + 2] === z) {
        return other;
      }
    }
    return (table[slot] = vertex);
  });
}

/**
 * Give a geometry normals. Vertices keep their numbers; where a crease runs through one, copies of it are added behind
 * all others, and `userData.copies` says of which vertex each is.
 */
export function smooth(geometry: BufferGeometry): void {
  const position = geometry.getAttribute("position");
  const { count } = position;
  const places = new Float32Array(count * 3);
  const spot = new Vector3();
  for (let vertex = 0; vertex < count; vertex += 1) {
    spot.fromBufferAttribute(position, vertex).toArray(places, vertex * 3);
  }
  const corners = geometry.index ? new Uint32Array(geometry.index.array) : new Uint32Array(count).map((_, at) => at);
  const points = welded(places, count);
  const faces = Math.floor(corners.length / 3);
  const flat = new Float32Array(faces * 3); // as long as twice its area
  const unit = new Float32Array(faces * 3);
  const [u, v] = [new Vector3(), new Vector3()];
  for (let corner = 0; corner < faces * 3; corner += 3) {
    spot.fromArray(places, corners[corner]! * 3);
    u.fromArray(places, corners[corner + 1]! * 3).sub(spot);
    v.fromArray(places, corners[corner + 2]! * 3).sub(spot);
    u.cross(v).toArray(flat, corner);
    u.normalize().toArray(unit, corner);
  }
  // Corners that share a normal: those of a point whose faces are joined by edges without a crease.
  const parent = new Uint32Array(faces * 3).map((_, corner) => corner);
  const top = (corner: number): number => {
    let at = corner;
    while (parent[at] !== at) {
      parent[at] = parent[parent[at] as number] as number;
      at = parent[at] as number;
    }
    return at;
  };
  const open = new Map<number, number>(); // an edge, and the corner at its start in the face that was met first
  const cosine = faces > MOST_FACES ? -2 : Math.cos(CREASE);
  for (let corner = 0; corner < faces * 3; corner += 1) {
    const next = corner % 3 === 2 ? corner - 2 : corner + 1;
    const from = points[corners[corner]!]!;
    const to = points[corners[next]!]!;
    const edge = Math.min(from, to) * count + Math.max(from, to);
    const other = open.get(edge);
    if (other === undefined) {
      open.set(edge, corner);
      continue;
    }
    const turn = u.fromArray(unit, corner - (corner % 3)).dot(v.fromArray(unit, other - (other % 3)));
    if (turn >= cosine) {
      const after = other % 3 === 2 ? other - 2 : other + 1;
      const same = points[corners[other] as number] === from;
      parent[top(corner)] = top(same ? other : after);
      parent[top(next)] = top(same ? after : other);
    }
  }
  const sums = new Float32Array(faces * 9);
  for (let corner = 0; corner < faces * 3; corner += 1) {
    const at = top(corner) * 3;
    u.fromArray(sums, at).add(v.fromArray(flat, corner - (corner % 3))).toArray(sums, at);
  }
  const owner = new Int32Array(count).fill(-1); // the group whose normal a vertex has
  const copies: number[] = [];
  const groups: number[] = [];
  const copied = new Map<number, number>();
  for (let corner = 0; corner < faces * 3; corner += 1) {
    const vertex = corners[corner] as number;
    const group = top(corner);
    if (owner[vertex] === -1) {
      owner[vertex] = group;
    }
    if (owner[vertex] !== group) {
      const key = vertex * faces * 3 + group;
      const known = copied.get(key) ?? count + copies.length;
      if (known === count + copies.length) {
        copied.set(key, known);
        copies.push(vertex);
        groups.push(group);
      }
      corners[corner] = known;
    }
  }
  if (copies.length) {
    for (const [name, values] of Object.entries(geometry.attributes)) {
      geometry.setAttribute(name, lengthened(values as BufferAttribute, copies));
    }
    for (const morphs of Object.values(geometry.morphAttributes)) {
      morphs.forEach((values, number) => (morphs[number] = lengthened(values as BufferAttribute, copies)));
    }
    geometry.setIndex(new BufferAttribute(corners, 1));
  }
  const normals = new Float32Array((count + copies.length) * 3);
  for (let vertex = 0; vertex < count + copies.length; vertex += 1) {
    const group = vertex < count ? owner[vertex]! : groups[vertex - count]!;
    u.fromArray(sums, Math.max(group, 0) * 3);
    (u.lengthSq() > 0 ? u.normalize() : u.set(0, 1, 0)).toArray(normals, vertex * 3);
  }
  geometry.setAttribute("normal", new BufferAttribute(normals, 3));
  geometry.userData["copies"] = Uint32Array.from(copies);
}

/** Values with those of some vertices once more behind them. */
function lengthened(values: BufferAttribute, copies: number[]): BufferAttribute {
  const { itemSize: size, normalized, count } = values;
  const Numbers = values.array.constructor as new (length: number) => typeof values.array;
  const out = new BufferAttribute(new Numbers((count + copies.length) * size), size, normalized);
  for (let vertex = 0; vertex < count + copies.length; vertex += 1) {
    for (let part = 0; part < size; part += 1) {
      out.setComponent(vertex, part, values.getComponent(vertex < count ? vertex : (copies[vertex - count] as number), part));
    }
  }
  return out;
}

/** Which vertices were copied along creases, in the order of their copies. */
export const copiesOf = (geometry: BufferGeometry): Uint32Array => (geometry.userData["copies"] as Uint32Array | undefined) ?? new Uint32Array();
