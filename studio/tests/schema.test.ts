import { expect, test } from "vitest";
import views from "../../tests/studio/views.json";
import { EMPTY, readDoc, readReplay, readView, writeReplay } from "../src/schema";
import type { Doc } from "../src/types";

const cases = views as unknown as { kept: Partial<Doc>[]; refused: Record<string, unknown>[] };

test.each(cases.kept.map((one) => [JSON.stringify(one), one] as const))("kept: %s", (_, view) => {
  expect(readView(view)).toEqual(view);
});

test.each(cases.refused.map((one) => [JSON.stringify(one), one] as const))("left out: %s", (_, view) => {
  expect(readView(view)).toEqual({});
  expect(readDoc(view)).toEqual(EMPTY);
  expect(readDoc({ ...view, loop: true, guidance: 2 })).toMatchObject({ guidance: 2 });
});

test.each([null, undefined, 5, "text", [], [[]], true])("no view at all: %s", (value) => {
  expect(readDoc(value)).toEqual(EMPTY);
});

test("the chosen sentence is one that there is", () => {
  expect(readDoc({ script: [{ text: "walks", seconds: 2 }], sentence: 7 }).sentence).toBe(0);
});

const LINK = {
  character: "läufer", script: [{ text: "läuft", seconds: 2 }], seed: 3, steps: 5, guidance: 2, loop: false,
  inPlace: true, path: [[0, 1]] as [number, number][], apparel: "rigid" as const, stiffness: 1, gravity: 1, rig: "handles" as const,
};

test("a link comes back as it went", () => {
  expect(readReplay(writeReplay(LINK))).toEqual(LINK);
});

test.each([
  ["script", 5], ["script", []], ["path", "abc"], ["seed", 1.5], ["steps", "many"], ["inPlace", "no"], ["character", {}],
  ["script", [{ text: "x".repeat(1001), seconds: 2 }]], ["wheels", 4],
])("a link that asks for what cannot be: %s %j", (key, value) => {
  expect(() => readReplay(writeReplay({ ...LINK, [key]: value }))).toThrow("cannot be");
});

test.each(["", "%%%", "bm90IGpzb24", "WzFd", "bnVsbA"])("a link that is broken: %s", (text) => {
  expect(() => readReplay(text)).toThrow("link");
});
