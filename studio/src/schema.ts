// What comes from elsewhere, checked: a view that was kept, a project's, a link's. The server checks the same (src/bunraku/studio/records.py);
// tests/studio/views.json holds both to the same answers.

import type { Apparel, Doc, Pin, Pose, Sentence, Vec3 } from "./types";

/** What a page that was never used holds. */
export const EMPTY: Doc = {
  character: null,
  take: null,
  script: [{ text: "walks forward, then waves with the left hand", seconds: 6, fits: true }],
  sentence: 0,
  seed: 0,
  count: 1,
  loop: false,
  inPlace: false,
  apparel: "rigid",
  stiffness: 1,
  gravity: 1,
  live: false,
  guidance: null,
  steps: null,
  pins: [],
  poses: [],
  path: [],
  span: null,
  keep: [],
  rig: "handles",
};

export const MOST_LETTERS = 1000;
const MOST_PARTS = 20;
const MOST_ENTRIES = 1000;
const LONGEST_TEXT = 10_000;
const APPAREL: readonly string[] = ["rigid", "simulate", "chains", "learn"];
const PINNED: readonly string[] = ["left_hand", "right_hand", "left_foot", "right_foot"];

type Read<T> = (value: unknown) => T | undefined;

const object = (value: unknown): Record<string, unknown> | undefined =>
  typeof value === "object" && value !== null && !Array.isArray(value) ? (value as Record<string, unknown>) : undefined;

const number =
  (low: number, high: number, whole = false): Read<number> =>
  (value) =>
    typeof value === "number" && value >= low && value <= high && (!whole || Number.isInteger(value)) ? value : undefined;

const text =
  (most = LONGEST_TEXT): Read<string> =>
  (value) =>
    typeof value === "string" && value.length <= most ? value : undefined;

const flag: Read<boolean> = (value) => (typeof value === "boolean" ? value : undefined);

const choice =
  <T extends string | number>(known: readonly unknown[]): Read<T> =>
  (value) =>
    known.includes(value) ? (value as T) : undefined;

const orNull =
  <T>(read: Read<T>): Read<T | null> =>
  (value) =>
    value === null ? null : read(value);

const list =
  <T>(read: Read<T>, least = 0, most = MOST_ENTRIES): Read<T[]> =>
  (value) => {
    if (!Array.isArray(value) || value.length < least || value.length > most) {
      return undefined;
    }
    const found = value.map(read);
    return found.some((one) => one === undefined) ? undefined : (found as T[]);
  };

/** An object of these keys; those that `needed` does not name may be missing, and take what stands in `otherwise`. */
const record =
  <T extends object>(reads: { [Key in keyof T]: Read<T[Key]> }, otherwise: Partial<T> = {}): Read<T> =>
  (value) => {
    const given = object(value);
    if (!given || Object.keys(given).some((key) => !(key in reads))) {
      return undefined;
    }
    const found: Record<string, unknown> = {};
    for (const [key, read] of Object.entries(reads) as [string, Read<unknown>][]) {
      const one = key in given ? read(given[key]) : (otherwise as Record<string, unknown>)[key];
      if (one === undefined) {
        return undefined;
      }
      found[key] = one;
    }
    return found as T;
  };

const time = number(0, 120);
const coordinate = number(-500, 500);
const anywhere = number(-1e300, 1e300);
const sentence: Read<Sentence> = (value) => {
  const found = record<Required<Sentence>>(
    { text: text(), seconds: number(0.5, 120), clip: text(80), fits: flag },
    { clip: "", fits: false },
  )(value);
  return found && { text: found.text, seconds: found.seconds, ...(found.clip && { clip: found.clip }), ...(found.fits && { fits: true }) };
};
const script: Read<Sentence[]> = list(sentence, 1, MOST_PARTS);
const point = list(coordinate, 2, 2) as Read<[number, number]>;
const pin = record<Pin>(
  { part: choice<string>(PINNED), time, position: list(anywhere, 3, 3) as Read<Vec3>, hold: time },
  { hold: 0 },
);
const pose: Read<Pose> = (value) => {
  const found = record<{ time: number; take: string | null; at: number | null }>(
    { time, take: orNull(text()), at: orNull(time) },
    { take: null, at: null },
  )(value);
  return found && { time: found.time, take: found.take ?? "", at: found.at ?? found.time };
};

const FIELDS: { [Key in keyof Doc]: Read<Doc[Key]> } = {
  character: orNull(text()),
  take: orNull(text()),
  script,
  sentence: number(0, MOST_PARTS - 1, true),
  seed: number(0, 2 ** 53 - 1, true),
  count: choice<1 | 4>([1, 4]),
  loop: flag,
  inPlace: flag,
  apparel: choice<Apparel>(APPAREL),
  stiffness: number(0.001, 1000),
  gravity: number(0, 10),
  live: flag,
  guidance: orNull(number(0, 20)),
  steps: orNull(number(1, 1000, true)),
  pins: list(pin),
  poses: list(pose),
  path: list(point),
  span: orNull(list(time, 2, 2) as Read<[number, number]>),
  keep: list(text()),
  rig: choice<"handles" | "own">(["handles", "own"]),
};

/** What can be shown of a view: what cannot is left out. */
export function readView(value: unknown): Partial<Doc> {
  const given = object(value) ?? {};
  const found: Partial<Record<keyof Doc, unknown>> = {};
  for (const key of Object.keys(FIELDS) as (keyof Doc)[]) {
    const one = key in given ? FIELDS[key](given[key]) : undefined;
    if (one !== undefined) {
      found[key] = one;
    }
  }
  return found as Partial<Doc>;
}

/** A whole document of a view: what it lacks is as in a page that was never used, and its sentence is one that there is. */
export function readDoc(value: unknown): Doc {
  const found = { ...EMPTY, ...readView(value) };
  return { ...found, sentence: Math.min(found.sentence, found.script.length - 1) };
}

/** What a link says: on which character what is done, and how it is drawn. */
export interface Replay extends Pick<Doc, "script" | "seed" | "steps" | "guidance" | "loop" | "inPlace" | "path" | "apparel" | "stiffness" | "gravity" | "rig"> {
  character: string;
}

/** The text of a link. */
export function writeReplay(replay: Replay): string {
  const raw = btoa(String.fromCharCode(...new TextEncoder().encode(JSON.stringify(replay))));
  return raw.replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
}

/** What a link asks for; an error where it asks for nothing that can be done. */
export function readReplay(link: string): Replay {
  let value: unknown;
  try {
    const raw = atob(link.slice(0, 100_000).replaceAll("-", "+").replaceAll("_", "/"));
    value = JSON.parse(new TextDecoder().decode(Uint8Array.from(raw, (letter) => letter.charCodeAt(0))));
  } catch {
    throw new Error("the link is broken; copy it again, whole");
  }
  const given = object(value) ?? {};
  const found = record<Replay>(
    {
      character: text(80), script, seed: FIELDS.seed, steps: FIELDS.steps, guidance: FIELDS.guidance, loop: flag,
      inPlace: flag, path: FIELDS.path, apparel: FIELDS.apparel, stiffness: FIELDS.stiffness, gravity: FIELDS.gravity, rig: FIELDS.rig,
    },
    { apparel: "rigid", stiffness: 1, gravity: 1, path: [], rig: "handles" },
  )(given);
  if (!found || found.script.some((part) => part.text.length > MOST_LETTERS)) {
    throw new Error("the link asks for what cannot be; copy it again from the studio");
  }
  return found;
}
