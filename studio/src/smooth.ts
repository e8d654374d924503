// Normals for a mesh that has none: smooth where faces meet at a small angle, an edge where they do not.

import { BufferAttribute, type BufferGeometry } from "three";

/** Faces that meet at more than this stay apart [rad]; chosen by eye on the six samples and a box. */
const CREASE = (50 * Math.PI) / 180;
const MOST_FACES = 400_000; // above this every edge is smoothed: looking for creases would take over a second

/** Of each vertex the first one at the same place, to a millionth of the mesh's reach. */
function welded(places: Float32Array, count: number): Uint32Array {
  const first = new Map<string, number>();
  const grain = 1e6 / (places.reduce((most, value) => Math.max(most, Math.abs(value)), 0) || 1);
  const cell = (at: number): number => Math.round((places[at] ?? 0) * grain);
  return Uint32Array.from({ length: count }, (_, vertex) => {
    const key = `${cell(vertex * 3)},${cell(vertex * 3 + 1)},${cell(vertex * 3 + 2)}`;
    const known = first.get(key) ?? vertex;
    first.set(key, known);
    return known;
  });
}

/**
 * Give a geometry normals. Vertices keep their numbers; where a crease runs through one, copies of it are added behind
 * all others, and `userData.copies` says of which vertex each is.
 */
export function smooth(geometry: BufferGeometry): void {
  const position = geometry.getAttribute("position");
  const { count } = position;
  const places = Float32Array.from({ length: count * 3 }, (_, at) => position.getComponent(Math.floor(at / 3), at % 3));
  const corners = geometry.index
    ? Uint32Array.from({ length: geometry.index.count }, (_, at) => geometry.index?.getX(at) ?? 0)
    : Uint32Array.from({ length: count }, (_, at) => at);
  const points = welded(places, count);
  const faces = Math.floor(corners.length / 3);
  const flat = new Float32Array(faces * 3); // as long as twice its area
  const unit = new Float32Array(faces * 3);
  for (let face = 0; face < faces; face += 1) {
    const [a, b, c] = [0, 1, 2].map((one) => (corners[face * 3 + one] as number) * 3) as [number, number, number];
    const u = [0, 1, 2].map((axis) => (places[b + axis] as number) - (places[a + axis] as number)) as [number, number, number];
    const v = [0, 1, 2].map((axis) => (places[c + axis] as number) - (places[a + axis] as number)) as [number, number, number];
    const normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]] as const;
    const length = Math.hypot(...normal) || 1;
    normal.forEach((value, axis) => {
      flat[face * 3 + axis] = value;
      unit[face * 3 + axis] = value / length;
    });
  }
  // Corners that share a normal: those of a point whose faces are joined by edges without a crease.
  const parent = Uint32Array.from({ length: faces * 3 }, (_, corner) => corner);
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
    const [from, to] = [points[corners[corner] as number] as number, points[corners[next] as number] as number];
    const edge = Math.min(from, to) * count + Math.max(from, to);
    const other = open.get(edge);
    if (other === undefined) {
      open.set(edge, corner);
      continue;
    }
    const [one, two] = [Math.floor(corner / 3) * 3, Math.floor(other / 3) * 3];
    const turn = [0, 1, 2].reduce((sum, axis) => sum + (unit[one + axis] as number) * (unit[two + axis] as number), 0);
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
    const face = Math.floor(corner / 3) * 3;
    for (let axis = 0; axis < 3; axis += 1) {
      sums[at + axis] = (sums[at + axis] as number) + (flat[face + axis] as number);
    }
  }
  const owner = new Int32Array(count).fill(-1); // the group whose normal a vertex has
  const copies: number[] = [];
  const groups: number[] = [];
  const copied = new Map<string, number>();
  for (let corner = 0; corner < faces * 3; corner += 1) {
    const vertex = corners[corner] as number;
    const group = top(corner);
    if (owner[vertex] === -1) {
      owner[vertex] = group;
    }
    if (owner[vertex] !== group) {
      const key = `${vertex}:${group}`;
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
  [...owner, ...groups].forEach((group, vertex) => {
    const at = Math.max(group, 0) * 3;
    const length = Math.hypot(sums[at] ?? 0, sums[at + 1] ?? 0, sums[at + 2] ?? 0);
    for (let axis = 0; axis < 3; axis += 1) {
      normals[vertex * 3 + axis] = length > 0 ? (sums[at + axis] as number) / length : axis === 1 ? 1 : 0;
    }
  });
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
