import { BufferAttribute, BufferGeometry, Group, MeshBasicMaterial, SkinnedMesh, Skeleton, Bone, Vector3 } from "three";
import { expect, it } from "vitest";
import { packMask, parseWorn, Surface } from "../src/brush";
import type { Model } from "../src/model";

/** A sheet of squares of 0.1 at a depth, each square with corners of its own, as at a seam. */
function sheet(depth: number): number[] {
  const places: number[] = [];
  for (let x = 0; x < 10; x += 1) {
    for (let y = 0; y < 10; y += 1) {
      const corner = (dx: number, dy: number): number[] => [(x + dx) / 10, (y + dy) / 10, depth];
      places.push(...corner(0, 0), ...corner(1, 0), ...corner(1, 1), ...corner(0, 0), ...corner(1, 1), ...corner(0, 1));
    }
  }
  return places;
}

function model(places: number[]): Model {
  const geometry = new BufferGeometry();
  const count = places.length / 3;
  geometry.setAttribute("position", new BufferAttribute(Float32Array.from(places), 3));
  geometry.setAttribute("skinIndex", new BufferAttribute(new Uint16Array(count * 4), 4));
  geometry.setAttribute("skinWeight", new BufferAttribute(Float32Array.from({ length: count * 4 }, (_, at) => (at % 4 ? 0 : 1)), 4));
  const skin = new SkinnedMesh(geometry, new MeshBasicMaterial());
  skin.bind(new Skeleton([new Bone()]));
  return {
    key: "", group: new Group(), bones: [], places: [], skins: [skin], plain: new Map(), primitives: new Map([[skin, "0:0"]]), bare: new Map(),
    springs: null,
  };
}

it("paints the sheet that it meets, across seams, and not the one behind it", () => {
  const places = [...sheet(0.1), ...sheet(0)];
  const rows = Uint32Array.from({ length: places.length / 3 }, (_, row) => row);
  const surface = new Surface(model(places), { mask: new Uint8Array(rows.length), rows: new Map([["0:0", rows]]) });
  const hit = surface.hit(new Vector3(0.52, 0.47, 1), new Vector3(0, 0, -1));
  expect(hit?.point.z).toBeCloseTo(0.1);
  const found = hit ? surface.within(hit, 0.2) : [];
  expect(found.length).toBeGreaterThan(30);
  for (const vertex of found) {
    const [x, y, z] = places.slice(vertex * 3, vertex * 3 + 3) as [number, number, number];
    expect(z).toBe(0.1);
    expect(Math.hypot(x - 0.52, y - 0.47)).toBeLessThan(0.2);
  }
  expect(surface.hit(new Vector3(2, 0.5, 1), new Vector3(0, 0, -1))).toBeNull();
});

it("says of which part a vertex is", () => {
  const header = new TextEncoder().encode('{"vertices":2,"parts":[],"numbered":true}   ');
  const data = new Uint8Array([66, 78, 82, 77, header.length, 0, 0, 0, ...header, 0, 0, 0, 0, 0, 0, 44, 1]);
  expect([...(parseWorn(data.buffer).numbers ?? [])]).toEqual([0, 300]);
});

it("packs a mask as the server reads it", () => {
  const mask = Uint8Array.from([1, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1]);
  expect([...packMask(mask)]).toEqual([1, 6, 0, 0]);
  const header = new TextEncoder().encode('{"vertices":11,"parts":[{"mesh":2,"primitive":1,"rows":2}]} ');
  const data = new Uint8Array([66, 78, 82, 77, header.length, 0, 0, 0, ...header, 1, 6, 0, 0, 7, 0, 0, 0, 9, 0, 0, 0]);
  const found = parseWorn(data.buffer);
  expect([...found.mask]).toEqual([...mask]);
  expect([...(found.rows.get("2:1") ?? [])]).toEqual([7, 9]);
  expect(() => parseWorn(new Uint8Array(40).buffer)).toThrow("no mask");
});
