import { Vector3 } from "three";
import { expect, test } from "vitest";
import { wentTo } from "../src/clip";

test("a character far from the origin has gone as far as its root", () => {
  const translations = new Float32Array([-48, 10, -139, -47, 10, -139, -46, 10, -138]);
  const clip = { fps: 1, frames: 3, joints: 1, seconds: 2, translations, rotations: new Float32Array(12), root: 0, apparel: null };
  const [x, z] = wentTo(clip, new Vector3(-48, 10, -139), 1);
  expect([x, z]).toEqual([1, 0.25]);
});
