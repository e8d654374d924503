// The mask of hair and clothes on a mesh (src/bunraku/studio/dressing.py), and a brush that paints it: what lies
// within a radius of where it touches, along the surface, so that a skirt is painted and not the leg below it.

import { Vector3 } from "three";
import type { Model } from "./model";
import { copiesOf } from "./smooth";
import type { Worn } from "./types";

export function parseWorn(data: ArrayBuffer): Worn {
  const view = new DataView(data);
  if (String.fromCharCode(...new Uint8Array(data, 0, 4)) !== "BNRM") {
    throw new Error("this is no mask of Bunraku");
  }
  const length = view.getUint32(4, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 8, length))) as {
    vertices: number;
    parts: { mesh: number; primitive: number; rows: number }[];
    numbered?: boolean;
  };
  let at = 8 + length;
  const bits = new Uint8Array(data, at, bytesOf(header.vertices));
  const mask = Uint8Array.from({ length: header.vertices }, (_, vertex) => ((bits[vertex >> 3] ?? 0) >> (vertex & 7)) & 1);
  at += bits.length;
  const rows = new Map<string, Uint32Array>();
  for (const part of header.parts) {
    rows.set(`${part.mesh}:${part.primitive}`, new Uint32Array(data, at, part.rows));
    at += part.rows * 4;
  }
  return header.numbered ? { mask, rows, numbers: new Uint16Array(data, at, header.vertices) } : { mask, rows };
}

const bytesOf = (count: number): number => 4 * Math.ceil(count / 32);

/** The mask as the server takes it: a bit for each vertex, lowest first, padded to four bytes. */
export function packMask(mask: Uint8Array): Uint8Array<ArrayBuffer> {
  const bits = new Uint8Array(bytesOf(mask.length));
  mask.forEach((one, vertex) => {
    bits[vertex >> 3] = (bits[vertex >> 3] ?? 0) | ((one ? 1 : 0) << (vertex & 7));
  });
  return bits;
}

export interface Hit {
  point: Vector3;
  triangle: number;
}

/** The surface of a model as it stands now, for rays and for ways along it. */
export class Surface {
  /** Where each row is [m]. */
  private readonly places: Float32Array;
  private readonly vertices: Uint32Array;
  private readonly triangles: Uint32Array;
  /** Of each row which point it is: rows that lie on one another are one, so that seams do not stop the brush. */
  private readonly points: Uint32Array;
  private readonly members: number[][] = [];
  private readonly beside: Set<number>[] = [];

  constructor(model: Model, worn: Worn) {
    const places: number[] = [];
    const vertices: number[] = [];
    const triangles: number[] = [];
    const spot = new Vector3();
    for (const skin of model.skins) {
      const geometry = model.bare.get(skin) ?? skin.geometry;
      const copies = copiesOf(geometry);
      const count = geometry.getAttribute("position").count - copies.length;
      const own = worn.rows.get(model.primitives.get(skin) ?? "");
      if (!own || own.length !== count) {
        continue;
      }
      const start = vertices.length;
      for (let row = 0; row < count; row += 1) {
        skin.getVertexPosition(row, spot).applyMatrix4(skin.matrixWorld);
        places.push(spot.x, spot.y, spot.z);
        vertices.push(own[row] ?? 0);
      }
      const { index } = geometry;
      const corners = index ? index.count : count; // copies are only reached by an index
      for (let corner = 0; corner < corners; corner += 1) {
        const row = index ? index.getX(corner) : corner;
        triangles.push(start + (row < count ? row : (copies[row - count] ?? 0)));
      }
    }
    this.places = Float32Array.from(places);
    this.vertices = Uint32Array.from(vertices);
    this.triangles = Uint32Array.from(triangles);
    const known = new Map<string, number>();
    this.points = this.vertices.map((_, row) => {
      const key = [0, 1, 2].map((axis) => Math.round((this.places[row * 3 + axis] ?? 0) * 1e5)).join();
      const point = known.get(key) ?? known.size;
      known.set(key, point);
      (this.members[point] ??= []).push(row);
      return point;
    });
    this.members.forEach(() => this.beside.push(new Set()));
    for (let corner = 0; corner < this.triangles.length; corner += 3) {
      const [a, b, c] = [0, 1, 2].map((one) => this.points[this.triangles[corner + one] ?? 0] ?? 0) as [number, number, number];
      this.beside[a]?.add(b).add(c);
      this.beside[b]?.add(a).add(c);
      this.beside[c]?.add(a).add(b);
    }
  }

  /** Where a ray first meets the surface, from either side. */
  hit(origin: Vector3, direction: Vector3): Hit | null {
    const { places, triangles } = this;
    let nearest = Infinity;
    let found = -1;
    const [ox, oy, oz, dx, dy, dz] = [...origin.toArray(), ...direction.toArray()] as [number, number, number, number, number, number];
    for (let corner = 0; corner < triangles.length; corner += 3) {
      const a = (triangles[corner] ?? 0) * 3;
      const b = (triangles[corner + 1] ?? 0) * 3;
      const c = (triangles[corner + 2] ?? 0) * 3;
      const [ax, ay, az] = [places[a] ?? 0, places[a + 1] ?? 0, places[a + 2] ?? 0];
      const [ux, uy, uz] = [(places[b] ?? 0) - ax, (places[b + 1] ?? 0) - ay, (places[b + 2] ?? 0) - az];
      const [vx, vy, vz] = [(places[c] ?? 0) - ax, (places[c + 1] ?? 0) - ay, (places[c + 2] ?? 0) - az];
      const px = dy * vz - dz * vy;
      const py = dz * vx - dx * vz;
      const pz = dx * vy - dy * vx;
      const size = ux * px + uy * py + uz * pz;
      if (Math.abs(size) < 1e-14) {
        continue;
      }
      const [sx, sy, sz] = [ox - ax, oy - ay, oz - az];
      const one = (sx * px + sy * py + sz * pz) / size;
      const [qx, qy, qz] = [sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux];
      const other = (dx * qx + dy * qy + dz * qz) / size;
      const far = (vx * qx + vy * qy + vz * qz) / size;
      if (one >= 0 && other >= 0 && one + other <= 1 && far > 1e-6 && far < nearest) {
        nearest = far;
        found = corner;
      }
    }
    return found < 0 ? null : { point: direction.clone().multiplyScalar(nearest).add(origin), triangle: found };
  }

  /** The vertex of the character nearest to where the surface was met. */
  vertex({ point, triangle }: Hit): number {
    const far = (row: number): number =>
      Math.hypot(...[point.x, point.y, point.z].map((value, axis) => (this.places[row * 3 + axis] ?? 0) - value));
    const rows = [0, 1, 2].map((one) => this.triangles[triangle + one] ?? 0);
    return this.vertices[rows.reduce((one, other) => (far(one) < far(other) ? one : other))] ?? 0;
  }

  /** The vertices of the character within a radius [m] of where the surface was met, along it. */
  within({ point, triangle }: Hit, radius: number): number[] {
    const far = (one: number): number => {
      const row = (this.members[one]?.[0] ?? 0) * 3;
      return Math.hypot((this.places[row] ?? 0) - point.x, (this.places[row + 1] ?? 0) - point.y, (this.places[row + 2] ?? 0) - point.z);
    };
    const corners = [0, 1, 2].map((one) => this.points[this.triangles[triangle + one] ?? 0] ?? 0);
    const nearest = corners.reduce((one, other) => (far(one) < far(other) ? one : other));
    const seen = new Set<number>([nearest, ...corners.filter((one) => far(one) <= radius)]);
    const waiting = [...seen];
    for (let one = waiting.pop(); one !== undefined; one = waiting.pop()) {
      for (const other of this.beside[one] ?? []) {
        if (!seen.has(other) && far(other) <= radius) {
          seen.add(other);
          waiting.push(other);
        }
      }
    }
    return [...seen].flatMap((one) => (this.members[one] ?? []).map((row) => this.vertices[row] ?? 0));
  }
}
