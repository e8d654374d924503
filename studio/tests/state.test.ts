import { beforeEach, expect, test, vi } from "vitest";
import { EMPTY } from "../src/schema";
import * as state from "../src/state";
import type { Take } from "../src/types";

beforeEach(() => {
  vi.restoreAllMocks();
  sessionStorage.clear();
  state.doc.value = EMPTY;
});

test("quick changes of one name are one step, others steps of their own", async () => {
  for (const text of ["w", "wa", "wal"]) {
    state.change("type", { script: [{ text, seconds: 4 }] });
  }
  state.change("", { seed: 5 });
  state.change("", { seed: 6 });
  await state.undo();
  expect(state.doc.value.seed).toBe(5);
  await state.undo();
  await state.undo();
  expect(state.doc.value.script).toEqual(EMPTY.script);
  await state.redo();
  expect(state.doc.value.script[0]?.text).toBe("wal");
});

test("a change after an undo forgets what was undone", async () => {
  state.change("", { seed: 1 });
  await state.undo();
  expect(state.canRedo.value).not.toBeNull();
  state.change("", { seed: 2 });
  expect(state.canRedo.value).toBeNull();
});

test("undoing a take takes back the words, the path and the mode that led to it", async () => {
  state.doc.value = { ...EMPTY, take: "a", script: [{ text: "walks", seconds: 4 }] };
  const before = state.doc.value;
  state.change("type", { script: [{ text: "jumps", seconds: 4 }] });
  state.change("select a span", { span: [1, 2], path: [[0, 0], [0, 1]] }, { changing: true });
  const made = vi.fn(async () => undefined);
  state.settled("generate", { take: "b" }, { comparing: true }, made);
  await state.undo();
  expect(state.doc.value).toEqual(before);
  expect([state.changing.value, state.comparing.value]).toEqual([false, false]);
  await state.redo();
  expect([state.doc.value.take, state.doc.value.script[0]?.text, state.changing.value]).toEqual(["b", "jumps", true]);
  expect(made.mock.calls).toEqual([[false], [true]]);
});

test("what is retracted leaves no step behind", async () => {
  state.change("", { seed: 1 });
  state.change("choose a character", { character: "broken" });
  state.retract("choose a character");
  expect([state.doc.value.character, state.doc.value.seed]).toEqual([null, 1]);
  await state.undo();
  expect(state.doc.value.seed).toBe(0);
});

test("an undo that fails is said and the page goes on", async () => {
  state.remember({ name: "star", undo: () => Promise.reject(new Error("the disk is full")), redo: () => undefined });
  await state.undo();
  expect(state.notice.value).toEqual({ text: "the disk is full", bad: true });
});

test("takes of the character, newest first, without those that are given up", () => {
  const take = (id: string, created: number, values: Partial<Take> = {}): Take => ({
    id, created, character: "c", state: "done", error: "", how: "animate", star: false, seed: 0, script: [], ...values,
  });
  state.doc.value = { ...EMPTY, character: "c" };
  state.takes.value = [take("a", 1), take("b", 2), take("d", 3, { deleted: true }), take("e", 4, { character: "f" })];
  expect(state.ownTakes.value.map((one) => one.id)).toEqual(["b", "a"]);
});

test("a character is shown with its newest take that is done", () => {
  const take = (id: string, created: number, values: Partial<Take> = {}): Take => ({
    id, created, character: "c", state: "done", error: "", how: "animate", star: false, seed: 0, script: [], ...values,
  });
  const failed = take("d", 4, { state: "failed" });
  expect(state.newest([take("a", 1), take("b", 2), failed, take("e", 5, { deleted: true })], "c")?.id).toBe("b");
  expect(state.newest([failed], "c")?.id).toBe("d");
  expect(state.newest([take("a", 1)], "other")).toBeNull();
});

/** A server of projects, as src/bunraku/studio/routes/files.py answers, behind `fetch`. */
function projects(): Map<string, { view: unknown; revision: number }> {
  const kept = new Map<string, { view: unknown; revision: number }>();
  globalThis.fetch = (async (path: string, { method, body }: { method: string; body: string }) => {
    const { view, revision } = JSON.parse(body) as { view: unknown; revision?: number };
    const id = method === "POST" ? `p${kept.size}` : (path.split("/").pop() ?? "");
    const old = kept.get(id);
    if (method === "PUT" && !old) {
      return new Response('{"error": "gone"}', { status: 404 });
    }
    if (old && old.revision !== revision) {
      return new Response('{"error": "newer"}', { status: 409 });
    }
    const record = { view, revision: old ? old.revision + 1 : 0 };
    kept.set(id, record);
    return new Response(JSON.stringify({ id, ...record }), { status: 200 });
  }) as unknown as typeof fetch;
  return kept;
}

test("a tab keeps its view in a project of its own, and takes another where one was faster", async () => {
  const kept = projects();
  const seeds = (): unknown[] => [...kept.values()].map((one) => (one.view as { seed: number }).seed);
  await Promise.all([state.keep({ ...EMPTY, seed: 1 }), state.keep({ ...EMPTY, seed: 2 })]);
  expect(seeds()).toEqual([2]);
  expect(sessionStorage.getItem("bunraku-project")).toBe("p0");
  const mine = kept.get("p0");
  kept.set("p0", { view: { seed: 50 }, revision: (mine?.revision ?? 0) + 1 }); // another tab
  await state.keep({ ...EMPTY, seed: 3 });
  expect(seeds()).toEqual([50, 3]);
  kept.delete("p1");
  await state.keep({ ...EMPTY, seed: 4 });
  expect(seeds()).toEqual([50, 4]);
});

test("a new tab starts from what was kept last, and a reloaded one from its own", () => {
  const all = [
    { id: "a", revision: 0, saved: 5, view: { seed: 1 } },
    { id: "b", revision: 0, saved: 9, view: { seed: 2 } },
    { id: "c", revision: 0, saved: 7, view: { seed: 3 } },
  ];
  expect(state.viewOf(all, null)).toEqual({ view: { seed: 2 }, project: null });
  expect(state.viewOf(all, "a")).toEqual({ view: { seed: 1 }, project: all[0] });
  expect(state.viewOf([], "a")).toEqual({ view: undefined, project: null });
});
