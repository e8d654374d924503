// A character that never stops: what it is told, where it is steered, what it looks at and reaches for, and the poses that
// come of it. They are fetched a second at a time; what is told is drawn from the next poses on that are not shown yet.

import { signal } from "@preact/signals";
import { request, ServerError } from "./api";
import { parseClip, type Clip } from "./clip";
import { say } from "./state";
import type { Character, Vec3 } from "./types";
import type { Viewer } from "./viewer";

const WINDOW = 1; // [s] that are fetched at once
const LEFT = 0.7; // [s] that are left when more is fetched
const BEHIND = 3; // [s] that are kept of what was shown, for a camera that follows smoothly
const LEAD = { least: 0.08, most: 0.6, spare: 1.25 }; // [s] that are still shown after something is told, and its share of how long answers take
const BLEND = 6; // poses over which a late answer is gone over to
const OFTEN = 180; // milliseconds between two looks, and between two turns of a stick
const HEADINGS = 32; // directions that are told apart
const STICK = { least: 0.25, fast: 0.85 }; // how far a stick is moved to walk, and to run
const IDLE = "stands still";
const KEPT = "bunraku-keys";

/** What keys play: "walk" and "run" what arrows do without and with Shift, the others their number. */
export type Keys = { walk: string; run: string; numbers: string[] };
const SHIPPED: Keys = {
  walk: "walks forward",
  run: "runs forward",
  numbers: ["waves with the right hand", "jumps", "dances", "bows", "kicks with the right foot"],
};

function readKeys(): Keys {
  try {
    const found = JSON.parse(localStorage.getItem(KEPT) ?? "{}") as Partial<Keys>;
    const text = (value: unknown, otherwise: string): string => (typeof value === "string" && value.trim() ? value.slice(0, 200) : otherwise);
    const numbers = Array.isArray(found.numbers) ? found.numbers.slice(0, 9).map((one) => text(one, "waves")) : SHIPPED.numbers;
    return { walk: text(found.walk, SHIPPED.walk), run: text(found.run, SHIPPED.run), numbers };
  } catch {
    return SHIPPED;
  }
}

export const keys = signal<Keys>(readKeys());

export function putKeys(values: Keys): void {
  keys.value = values;
  localStorage.setItem(KEPT, JSON.stringify(values));
}

/** What it was told last, while it lives. */
export const living = signal<{ owner: string; version: number; said: string } | null>(null);

interface Told {
  sentence: string;
  direction: [number, number] | null;
  look: Vec3 | null;
  reach: Vec3 | null;
}

/** Poses as they come, and what is told of the next ones. */
class Stream {
  readonly clip: Clip = { fps: 20, frames: 0, joints: 0, seconds: 0, translations: new Float32Array(), rotations: new Float32Array(), root: 0, apparel: null };
  /** What is shown [s], from the first pose on. */
  time = 0;
  session = "";
  readonly said: string[] = [];
  /** From when something is said to when it is shown [ms], the last time; and seconds in which nothing came. */
  waited = 0;
  starved = 0;
  private base = 0; // the number of the clip's first pose
  private told: Told = { sentence: IDLE, direction: null, look: null, reach: null };
  private changed = false; // something was told that was not asked for yet
  private asking = false;
  private took = 0.3; // [s] that answers take
  private spoken: { at: number; pose: number } | null = null;
  private stopped = false;
  private readonly held = new Set<string>();
  private steering = { heading: -1, fast: false, at: 0 };
  private pressed: boolean[] = [];
  private pointed: { look: Vec3 | null; reach: Vec3 | null } | null = null; // what is not told yet
  private looked = 0;

  constructor(readonly owner: Character) {}

  /** The number of the pose after the last one that is there. */
  private get end(): number {
    return this.base + this.clip.frames;
  }

  say(sentence: string): void {
    this.told.sentence = sentence;
    this.changed = true;
    this.spoken = { at: performance.now(), pose: Infinity };
    living.value = { owner: this.owner.id, version: this.owner.version, said: sentence };
  }

  stop(): void {
    this.stopped = true;
  }

  /** Look at a point, or reach for it; null for neither. */
  point(look: Vec3 | null, reach: Vec3 | null): void {
    this.pointed = { look, reach };
  }

  /** Tell where the pointer is, not at each of its steps. */
  private look(): void {
    const now = performance.now();
    if (this.pointed && (Boolean(this.pointed.reach) !== Boolean(this.told.reach) || now - this.looked > OFTEN)) {
      Object.assign(this.told, this.pointed);
      this.looked = now;
      this.pointed = null;
      this.changed = true;
    }
  }

  /** A key goes down or up; whether it is one of ours. */
  key(name: string, down: boolean): boolean {
    const key = { w: "ArrowUp", a: "ArrowLeft", s: "ArrowDown", d: "ArrowRight" }[name.toLowerCase()] ?? name;
    if (key.startsWith("Arrow") || key === "Shift") {
      this.held[down ? "add" : "delete"](key);
      return key !== "Shift";
    }
    const sentence = keys.value.numbers[Number(key) - 1];
    if (down && sentence) {
      this.say(sentence);
    }
    return Boolean(sentence);
  }

  release(): void {
    this.held.clear();
  }

  /** Let time pass [s]. */
  step(view: Viewer, seconds: number): void {
    const last = (this.end - 1) / this.clip.fps;
    const next = this.time + seconds;
    if (this.clip.frames) {
      this.starved += Math.max(next - last, 0);
      this.time = Math.min(next, last);
    }
    if (this.spoken && this.time * this.clip.fps >= this.spoken.pose) {
      this.waited = performance.now() - this.spoken.at;
      this.spoken = null;
    }
    this.look();
    this.steer(view);
    const left = last - this.time;
    if (!this.asking && !this.stopped && (this.changed || !this.clip.frames || left < LEFT)) {
      void this.ask();
    }
    view.time = this.time - this.base / this.clip.fps;
  }

  /** Where keys or a stick point, as the camera sees it. */
  private steer(view: Viewer): void {
    const pad = navigator.getGamepads?.().find((one) => one) ?? null;
    pad?.buttons.slice(0, 9).forEach((button, number) => {
      if (button.pressed && !this.pressed[number]) {
        this.key(String(number + 1), true);
      }
      this.pressed[number] = button.pressed;
    });
    const on = (name: string): number => (this.held.has(name) ? 1 : 0);
    let [x, y] = [on("ArrowRight") - on("ArrowLeft"), on("ArrowUp") - on("ArrowDown")];
    let fast = this.held.has("Shift");
    const [sx, sy] = [pad?.axes[0] ?? 0, -(pad?.axes[1] ?? 0)];
    const far = Math.hypot(sx, sy);
    if (far > STICK.least) {
      [x, y, fast] = [sx, sy, far > STICK.fast];
    }
    let heading = -1;
    if (x || y) {
      const ahead = view.controls.target.clone().sub(view.camera.position).setY(0).normalize();
      const angle = Math.atan2(ahead.x * y - ahead.z * x, ahead.z * y + ahead.x * x);
      heading = (Math.round((angle / (2 * Math.PI)) * HEADINGS) + HEADINGS) % HEADINGS;
    }
    const before = this.steering;
    const now = performance.now();
    if ((heading === before.heading && (fast === before.fast || heading < 0)) || now - before.at < OFTEN) {
      return;
    }
    this.steering = { heading, fast, at: now };
    const angle = (heading / HEADINGS) * 2 * Math.PI;
    this.told.direction = heading < 0 ? null : [Math.sin(angle), Math.cos(angle)];
    if (heading < 0) {
      this.say(IDLE);
    } else if (before.heading < 0 || fast !== before.fast) {
      this.say(fast ? keys.value.run : keys.value.walk);
    }
    this.changed = true;
  }

  private async ask(): Promise<void> {
    this.asking = true;
    const { fps } = this.clip;
    const told = { ...this.told };
    const now = performance.now();
    const lead = Math.min(Math.max(LEAD.spare * this.took, LEAD.least), LEAD.most);
    const start = Math.min(Math.ceil((this.time + lead) * fps), this.end);
    const from = this.session && this.changed ? { start } : {};
    const spoken = this.spoken;
    this.changed = false;
    this.told.sentence = "";
    const body = JSON.stringify({ session: this.session, ...told, ...from, seconds: WINDOW });
    try {
      const answer = await request(`/characters/${this.owner.id}/live`, { method: "POST", body });
      const clip = parseClip(await answer.arrayBuffer());
      this.session = answer.headers.get("x-bunraku-session") ?? "";
      const first = Number(answer.headers.get("x-bunraku-first"));
      this.splice(first, clip);
      if (told.sentence && told.sentence !== IDLE && this.said.at(-1) !== told.sentence) {
        this.said.push(told.sentence);
      }
      const took = (performance.now() - now) / 1000;
      this.took = Math.max(took, this.took + 0.2 * (took - this.took));
      if (spoken && spoken === this.spoken) {
        spoken.pose = Math.max(first + 1, Math.ceil(this.time * fps));
      }
    } catch (error) {
      if (error instanceof ServerError && error.message.includes("session has ended")) {
        Object.assign(this, { session: "", base: 0, time: 0 }); // the studio was started anew: so does the character
        this.clip.frames = 0;
        this.told.sentence = told.sentence || IDLE;
      } else {
        const refused = error instanceof ServerError && error.status === 400 && !error.message.includes("ask again");
        if (refused && living.value) {
          living.value = { ...living.value, said: this.said.at(-1) ?? IDLE };
        } else {
          this.told.sentence ||= told.sentence;
          this.changed = true;
        }
        say(error instanceof Error ? error.message : String(error), true);
        await new Promise((resolve) => setTimeout(resolve, 500));
      }
    }
    this.asking = false;
  }

  /** Put poses in place of those from number `first` on; those that are seen already are gone over from softly. */
  private splice(first: number, next: Clip): void {
    const { clip } = this;
    const now = Math.ceil(this.time * clip.fps);
    const from = this.clip.frames ? Math.max(this.base, Math.min(now - Math.round(BEHIND * clip.fps), first)) : first;
    const frames = first + next.frames - from;
    const late = now >= first ? now : Infinity;
    for (const [name, width] of [["translations", 3], ["rotations", 4]] as const) {
      const size = next.joints * width;
      const values = new Float32Array(frames * size);
      values.set(clip[name].subarray((from - this.base) * size, (first - this.base) * size));
      values.set(next[name], (first - from) * size);
      for (let pose = late; pose < Math.min(late + BLEND, this.end, first + next.frames); pose += 1) {
        mix(values, (pose - from) * size, clip[name], (pose - this.base) * size, size, width, (pose - late + 1) / (BLEND + 1));
      }
      clip[name] = values;
    }
    Object.assign(clip, { fps: next.fps, joints: next.joints, root: next.root, frames, seconds: (frames - 1) / next.fps });
    this.base = from;
  }

  /** The number of the pose after the last that was shown. */
  get stopAt(): number {
    return Math.floor(this.time * this.clip.fps) + 1;
  }
}

/** Go from old values to those that stand there, by a share; of quaternions the short way. */
function mix(values: Float32Array, at: number, old: Float32Array, place: number, size: number, width: number, share: number): void {
  for (let one = 0; one < size; one += width) {
    let dot = 0;
    for (let axis = 0; axis < width; axis += 1) {
      dot += (values[at + one + axis] ?? 0) * (old[place + one + axis] ?? 0);
    }
    const sign = width === 4 && dot < 0 ? -1 : 1;
    let long = 0;
    for (let axis = 0; axis < width; axis += 1) {
      const value = share * (values[at + one + axis] ?? 0) + (1 - share) * sign * (old[place + one + axis] ?? 0);
      values[at + one + axis] = value;
      long += value * value;
    }
    for (let axis = 0; width === 4 && axis < width; axis += 1) {
      values[at + one + axis] = (values[at + one + axis] ?? 0) / Math.sqrt(long || 1);
    }
  }
}

export let stream: Stream | null = null;

/** Let a character live from now on. */
export function begin(owner: Character): void {
  stream = new Stream(owner);
  living.value = { owner: owner.id, version: owner.version, said: IDLE };
}

/** It lives no more; what it was, for what was played to be kept. */
export function finish(): Stream | null {
  const before = stream;
  before?.stop();
  stream = null;
  living.value = null;
  return before;
}
