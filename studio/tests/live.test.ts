// A character that never stops, against a studio that answers as the real one does, in a time of the test's own.

import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { Vector3 } from "three";
import { begin, finish, stream } from "../src/live";
import { wentTo } from "../src/clip";
import type { Character } from "../src/types";
import type { Viewer } from "../src/viewer";

const FPS = 20;
const view = { time: 0, camera: { position: new Vector3(0, 2, 5) }, controls: { target: new Vector3(0, 1, 0) } } as unknown as Viewer;
let given = 0;
let delay = (): number => 200;
let asked: Record<string, unknown>[] = [];

/** Poses that know their number: the root of each is as far along x. */
function packed(first: number, count: number): ArrayBuffer {
  const header = new TextEncoder().encode(JSON.stringify({ frames: count, joints: 1, fps: FPS }).padEnd(60));
  const out = new ArrayBuffer(8 + 60 + count * 28);
  new Uint8Array(out).set(new TextEncoder().encode("BNRC"));
  new DataView(out).setUint32(4, 60, true);
  new Uint8Array(out).set(header, 8);
  const values = new Float32Array(out, 68);
  for (let pose = 0; pose < count; pose += 1) {
    values[pose * 3] = first + pose;
    values[count * 3 + pose * 4 + 3] = 1;
  }
  return out;
}

beforeEach(() => {
  vi.useFakeTimers();
  given = 0;
  asked = [];
  vi.stubGlobal("fetch", async (_: string, options: RequestInit) => {
    const body = JSON.parse(String(options.body)) as { start?: number; seconds: number };
    asked.push(body);
    await new Promise((resolve) => setTimeout(resolve, delay()));
    const first = body.start ?? given;
    expect(first).toBeLessThanOrEqual(given); // what was not given yet cannot be drawn anew
    given = first + body.seconds * FPS;
    return new Response(packed(first, body.seconds * FPS), { headers: { "x-bunraku-session": "one", "x-bunraku-first": String(first) } });
  });
  begin({ id: "a", version: 1 } as Character);
});

afterEach(() => {
  finish();
  vi.unstubAllGlobals();
  vi.useRealTimers();
});

/** Let time pass as a screen of 60 pictures a second does. */
async function play(seconds: number, each: () => void = () => undefined): Promise<void> {
  for (let frame = 0; frame < seconds * 60; frame += 1) {
    stream?.step(view, 1 / 60);
    each();
    await vi.advanceTimersByTimeAsync(1000 / 60);
  }
}

test("it goes on without a gap, and what is kept stays as much", async () => {
  let most = 0;
  await play(90, () => (most = Math.max(most, stream?.clip.frames ?? 0)));
  expect(stream?.starved).toBe(0);
  expect(stream?.time).toBeGreaterThan(88);
  expect(most).toBeLessThan(120);
  expect(wentTo(stream?.clip as never, undefined, view.time)[0]).toBeCloseTo((stream?.time ?? 0) * FPS, -1);
});

test("what is said shows within half a second, also where answers are late", async () => {
  await play(3);
  for (const [slow, most] of [[200, 500], [60, 300], [450, 700]] as const) {
    delay = () => slow;
    stream?.say("waves");
    await play(2);
    stream?.say("jumps");
    await play(2);
    expect(stream?.waited).toBeGreaterThan(slow);
    expect(stream?.waited).toBeLessThan(most);
  }
  expect(stream?.starved).toBe(0);
  expect(stream?.said).toEqual(["waves", "jumps", "waves", "jumps", "waves", "jumps"]);
  delay = () => 200;
});

test("arrows steer as the camera sees it, and stop it when they are let go", async () => {
  await play(1);
  stream?.key("ArrowRight", true);
  await play(1);
  const last = asked.at(-1) as { direction: number[]; sentence: string };
  expect(last.direction.map((one) => Math.round(one * 100) / 100 + 0)).toEqual([1, 0]);
  expect(asked.some((one) => one["sentence"] === "walks forward")).toBe(true);
  stream?.key("ArrowRight", false);
  await play(1);
  expect(asked.at(-1)?.["direction"]).toBeNull();
  expect(asked.filter((one) => one["sentence"]).at(-1)?.["sentence"]).toBe("stands still");
});

test("a pointer that moves all the time is told now and then, and its last place is told", async () => {
  await play(1);
  const before = asked.length;
  let number = 0;
  await play(2, () => stream?.point([(number += 1), 1, 1], null));
  expect(asked.length - before).toBeLessThan(14);
  await play(0.5);
  expect((asked.at(-1)?.["look"] as number[])[0]).toBe(number);
});
