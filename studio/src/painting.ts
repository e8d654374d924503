// Painting what of a character is hair and clothes: strokes, undo, and what the server keeps of them.

import { signal } from "@preact/signals";
import type { Ray } from "three";
import { bytes, poked } from "./api";
import { packMask, parseWorn, Surface } from "./brush";
import type { Model } from "./model";
import { attempt, brush, character, painting, remember } from "./state";
import type { Worn } from "./types";

/** What is painted, or being painted; the number changes whenever the mask does. */
export const worn = signal<{ owner: string; worn: Worn; strokes: number } | null>(null);
let surface: { model: Model; worn: Worn; surface: Surface } | null = null;
let before: Uint8Array | null = null; // the mask as it was when the stroke began
let own = false; // whether somebody painted it, as far as this page knows

function shown(): void {
  if (worn.value) {
    worn.value = { ...worn.value, strokes: worn.value.strokes + 1 };
  }
}

/** Begin to paint the character that is shown. */
export async function startPainting(): Promise<void> {
  const owner = character.value;
  if (!owner) {
    return;
  }
  await attempt(async () => {
    worn.value = { owner: owner.id, worn: parseWorn(await bytes(`/characters/${owner.id}/mask`)), strokes: 0 };
    own = Boolean(owner.painted);
    painting.value = true;
  });
}

export function endPainting(): void {
  painting.value = false;
  surface = null;
}

let keeping: Promise<unknown> = Promise.resolve(); // masks reach the server in the order in which they were painted

/** Keep a mask; null takes back what is found without one. */
function keep(owner: string, mask: Uint8Array | null): Promise<unknown> {
  const path = `/characters/${owner}/mask`;
  const options = mask ? { method: "PUT", body: packMask(mask) } : { method: "DELETE" };
  keeping = keeping.catch(() => undefined).then(() => bytes(path, options));
  return keeping.then(poked);
}

/** Show a mask and keep it. */
async function put(owner: string, mask: Uint8Array | null): Promise<void> {
  own = Boolean(mask);
  if (mask && worn.value?.owner === owner) {
    worn.value.worn.mask.set(mask);
    shown();
  }
  await keep(owner, mask);
  if (!mask && worn.value?.owner === owner) {
    worn.value = { ...worn.value, worn: parseWorn(await bytes(`/characters/${owner}/mask`)) };
    shown();
  }
}

/** A step that undo takes back, from a mask that was painted or found to another. */
async function step(name: string, after: Uint8Array | null, old: Uint8Array, painted: boolean): Promise<void> {
  const owner = worn.value?.owner ?? "";
  const back = painted ? old : null;
  remember({ name, undo: () => put(owner, back), redo: () => put(owner, after) });
  await attempt(() => put(owner, after));
}

function surfaceOf(model: Model): Surface | null {
  const now = worn.value?.worn;
  if (!now) {
    return null;
  }
  if (surface?.model !== model || surface.worn !== now) {
    surface = { model, worn: now, surface: new Surface(model, now) };
  }
  return surface.surface;
}

/** Touch the model with the brush along a ray; whether it is met. */
export function touch(model: Model, ray: Ray, size: number): boolean {
  const now = worn.value?.worn;
  const found = surfaceOf(model);
  const hit = found?.hit(ray.origin, ray.direction);
  if (!now || !found || !hit) {
    return false;
  }
  before ??= now.mask.slice();
  for (const vertex of found.within(hit, brush.value.size * size)) {
    now.mask[vertex] = brush.value.add ? 1 : 0;
  }
  shown();
  return true;
}

/** The brush is lifted: what it painted is kept. */
export async function lift(): Promise<void> {
  const old = before;
  before = null;
  const now = worn.value?.worn.mask;
  if (old && now && old.some((one, vertex) => one !== now[vertex])) {
    await step(brush.value.add ? "paint hair and clothes" : "wipe hair and clothes", now.slice(), old, own);
  }
}

/** Take back what is found without anybody's painting. */
export async function asFound(): Promise<void> {
  const now = worn.value?.worn.mask;
  if (now) {
    await step("hair and clothes as they are found", null, now.slice(), true);
  }
}
