import { expect, test } from "vitest";
import { EMPTY } from "../src/schema";
import { blocksOf, fromFile, readPath, scriptOf, wrongWith } from "../src/script";
import type { Doc, Take } from "../src/types";

const take = (values: Partial<Take>): Take => ({
  id: "a", character: "b", created: 0, state: "done", error: "", how: "animate", star: false, seed: 0, script: [], ...values,
});
const walk = take({ how: "transfer", script: [{ text: "walk.bvh", seconds: 0 }], seconds: 7.05 });

test("a take has its own sentences", () => {
  const script = [{ text: "walks", seconds: 4 }, { text: "jumps", seconds: 2 }];
  expect(scriptOf(take({ script }))).toEqual(script);
  expect(scriptOf(null)).toEqual(EMPTY.script);
});

test("a motion of a file shows its name and its length", () => {
  const doc: Doc = { ...EMPTY, take: "a", script: scriptOf(walk) };
  expect(doc.script).toEqual([{ text: "", seconds: 7.05 }]);
  expect(blocksOf(doc, walk)).toEqual([{ text: "walk.bvh", from: 0, seconds: 7.05, number: null, clip: false }]);
});

test("what is typed over a motion of a file is a sentence again", () => {
  const doc: Doc = { ...EMPTY, script: [{ text: "jumps", seconds: 3 }] };
  expect(fromFile(walk, doc)).toBe(false);
  expect(blocksOf(doc, walk)).toEqual([{ text: "jumps", from: 0, seconds: 3, number: 0, clip: false }]);
});

test("blocks stand one after the other", () => {
  const script = [{ text: "walks", seconds: 4 }, { text: "jumps", seconds: 2 }, { text: "waves", seconds: 3 }];
  expect(blocksOf({ ...EMPTY, script }, null).map(({ from, number }) => [from, number])).toEqual([[0, 0], [4, 1], [6, 2]]);
});

test("what cannot be made is said in the words of the page", () => {
  expect(wrongWith([{ text: " ", seconds: 2 }])).toContain("type what the character does");
  expect(wrongWith([{ text: "x".repeat(1064), seconds: 2 }])).toContain("1,064 letters, at most 1,000");
  expect(wrongWith([{ text: "walks", seconds: 2 }])).toBe("");
});

test("a clip of the library needs no sentence, and is named in its block", () => {
  const script = [{ text: "", seconds: 2, clip: "bow" }];
  expect(wrongWith(script)).toBe("");
  expect(scriptOf(take({ script }))).toEqual(script);
  expect(blocksOf({ ...EMPTY, script }, null)).toEqual([{ text: "bow", from: 0, seconds: 2, number: 0, clip: true }]);
});

test("a path is read of its text, whole or not at all", () => {
  expect(readPath("0,0 1,2  -3,2.5")).toEqual([[0, 0], [1, 2], [-3, 2.5]]);
  for (const text of ["", "1,2", "0,0 1", "0,0 a,b", "0,0 1,2,3", "0,0 1,9999"]) {
    expect(readPath(text)).toEqual([]);
  }
});
