import { BufferAttribute, BufferGeometry, IcosahedronGeometry } from "three";
import { expect, test } from "vitest";
import { copiesOf, smooth } from "../src/smooth";

/** A box of eight vertices. */
function box(): BufferGeometry {
  const geometry = new BufferGeometry();
  const places = Array.from({ length: 8 }, (_, at) => [at & 1, (at >> 1) & 1, at >> 2]).flat();
  geometry.setAttribute("position", new BufferAttribute(Float32Array.from(places), 3));
  geometry.setIndex([0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4, 2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5]);
  return geometry;
}

test("a box keeps its edges, and its vertices keep their numbers", () => {
  const geometry = box();
  const before = Array.from(geometry.getAttribute("position").array);
  smooth(geometry);
  expect(Array.from(geometry.getAttribute("position").array).slice(0, 24)).toEqual(before);
  expect(copiesOf(geometry).length).toBe(16); // three normals at each of eight corners
  const normals = Array.from(geometry.getAttribute("normal").array).map(Math.abs);
  expect(normals.filter((one) => one === 1).length).toBe(24);
});

test("a ball is round: its normals point away from its middle", () => {
  const geometry = new IcosahedronGeometry(1, 3);
  geometry.deleteAttribute("normal");
  smooth(geometry);
  const place = geometry.getAttribute("position");
  const normal = geometry.getAttribute("normal");
  for (let vertex = 0; vertex < place.count; vertex += 1) {
    const along = place.getX(vertex) * normal.getX(vertex) + place.getY(vertex) * normal.getY(vertex) + place.getZ(vertex) * normal.getZ(vertex);
    expect(along).toBeGreaterThan(0.98);
  }
  expect(copiesOf(geometry).length).toBe(0);
});
