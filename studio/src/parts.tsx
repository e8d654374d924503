// Hair, clothes and what is held or worn, in colours with their names; a click on one changes its kind.

import { effect, signal } from "@preact/signals";
import { Color, type Ray } from "three";
import { bytes } from "./api";
import { parseWorn, Surface } from "./brush";
import type { Model, Tint } from "./model";
import { BARE, kindColour } from "./skeleton";
import { attempt, character, colouring, correcting } from "./state";
import type { Body, Character, Vec3, Worn } from "./types";

export const KINDS = ["body", "arm", "leg", "head", "tail", "wing", "hair", "skirt", "cape", "sleeve", "accessory", "prop", "ground"];
const LIT = 0.35; // how far the colour of a part that is pointed at goes to white; by eye on the sample dancer

/** Which part each vertex is of, for a character with these parts. */
export const numbered = signal<{ key: string; worn: Worn } | null>(null);
/** A part that was clicked: its number in `dress`, or -1 on the body, its name in corrections, and where on the stage. */
export const picked = signal<{ number: number; at: Vec3; left: number; top: number } | null>(null);
/** The part whose row is pointed at. */
export const touched = signal<Body["parts"][number] | null>(null);

const keyOf = (one: Character): string => `${one.id}:${JSON.stringify(one.dress)}`; // they are found after it is open
let asked = "";
effect(() => {
  const one = character.value;
  const wanted = one?.state === "ready" && one.dress && (correcting.value || colouring.value === "parts") ? keyOf(one) : "";
  if (one && wanted && wanted !== asked) {
    asked = wanted;
    void attempt(async () => {
      const worn = parseWorn(await bytes(`/characters/${one.id}/mask`));
      if (asked === wanted) {
        numbered.value = { key: wanted, worn };
      }
    });
  }
});

/** The colours of parts by their kinds, where it is known which vertices they are. */
export function tintOf(one: Character): Tint | null {
  const now = numbered.value;
  const numbers = now?.key === keyOf(one) ? now.worn.numbers : undefined;
  if (!now || !numbers) {
    return null;
  }
  const lit = picked.value?.number ?? (one.dress ?? []).indexOf(touched.value as Body["parts"][number]);
  const colours = [BARE, ...(one.dress ?? []).map((part) => kindColour(part.kind))].map((each, number) =>
    number === lit + 1 && lit >= 0 ? each.clone().lerp(new Color(0xffffff), LIT) : each,
  );
  return { rows: now.worn.rows, of: (vertex) => colours[numbers[vertex] ?? 0] ?? BARE };
}

let surface: { model: Model; worn: Worn; surface: Surface } | null = null;

/** The part that a ray meets was clicked there on the stage. */
export function pick(model: Model, ray: Ray, left: number, top: number): void {
  const one = character.value;
  const now = numbered.value;
  picked.value = null;
  if (!one || one.state !== "ready" || !now?.worn.numbers || now.key !== keyOf(one)) {
    return;
  }
  if (surface?.model !== model || surface.worn !== now.worn) {
    surface = { model, worn: now.worn, surface: new Surface(model, now.worn) };
  }
  const hit = surface.surface.hit(ray.origin, ray.direction);
  if (hit) {
    const number = (now.worn.numbers[surface.surface.vertex(hit)] ?? 0) - 1;
    const at = one.dress?.[number]?.at ?? (hit.point.toArray().map((value) => Number(value.toFixed(4))) as Vec3);
    picked.value = { number, at, left, top };
  }
}

export function Swatch({ kind }: { kind: string }) {
  return (
    <svg width="10" height="10" aria-hidden="true">
      <circle cx="5" cy="5" r="5" fill={`#${kindColour(kind).getHexString()}`} />
    </svg>
  );
}

/** The names of some kinds in their colours, and how much there is of each. */
export function Legend({ counts }: { counts: Map<string, string> }) {
  return (
    <ul class="kinds">
      {[...counts].map(([kind, count]) => (
        <li key={kind}>
          <Swatch kind={kind} /> {count} {kind}
        </li>
      ))}
    </ul>
  );
}

/** Which parts there are. */
export function Parts({ one }: { one: Character }) {
  const areas = new Map<string, number>();
  one.dress?.forEach((part) => areas.set(part.kind, (areas.get(part.kind) ?? 0) + part.area));
  const rest = Math.max(0, 1 - [...areas.values()].reduce((sum, area) => sum + area, 0));
  return <Legend counts={new Map([...areas, ["body", rest] as const].map(([kind, area]) => [kind, `${Math.round(100 * area)} %`]))} />;
}

/** What the part that was clicked can be, beside where it was clicked. */
export function Picked({ say }: { say: (at: Vec3, kind: string) => void }) {
  const one = character.value;
  const now = picked.value;
  if (!one || !now || !correcting.value) {
    return null;
  }
  const kind = one.dress?.[now.number]?.kind ?? "body";
  const place = { left: `min(${now.left}px, 100% - 200px)`, top: `max(8px, min(${now.top}px, 100% - 250px))` }; // within the stage
  return (
    <div class="picked" role="group" aria-label="the part that was clicked" style={place}>
      <p>
        <Swatch kind={kind} /> {kind}: it is rather
      </p>
      {KINDS.filter((each) => each !== kind).map((each) => (
        <button
          key={each}
          onClick={() => {
            picked.value = null;
            say(now.at, each);
          }}
        >
          <Swatch kind={each} /> {each}
        </button>
      ))}
    </div>
  );
}
