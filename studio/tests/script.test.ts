import { expect, test } from "vitest";
import { EMPTY } from "../src/schema";
import { blocksOf, fromFile, scriptOf, wrongWith } from "../src/script";
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
  expect(blocksOf(doc, walk)).toEqual([{ text: "walk.bvh", from: 0, seconds: 7.05, number: null }]);
});

test("what is typed over a motion of a file is a sentence again", () => {
  const doc: Doc = { ...EMPTY, script: [{ text: "jumps", seconds: 3 }] };
  expect(fromFile(walk, doc)).toBe(false);
  expect(blocksOf(doc, walk)).toEqual([{ text: "jumps", from: 0, seconds: 3, number: 0 }]);
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
