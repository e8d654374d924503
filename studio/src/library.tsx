// The clip library: clips by words and kind, moving on the character that is shown, to be played or dragged onto the timeline.

import { effect, signal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { addClip, playClip } from "./actions";
import { bytes, get, send } from "./api";
import { parseClip, type Clip } from "./clip";
import { attempt, character, ended, say } from "./state";
import { HIGH, Thumbs, WIDE } from "./thumbs";
import type { Character, LibraryClip } from "./types";

/** What a clip that is dragged carries. */
export const DRAGGED = "application/x-bunraku-clip";

const all = signal<LibraryClip[]>([]);
const found = signal<LibraryClip[]>([]);
const words = signal("");
const kind = signal("");
const touched = signal<LibraryClip | null>(null);
const still = matchMedia("(prefers-reduced-motion: reduce)").matches;

export const clipOf = (name: string): LibraryClip | undefined => all.value.find((one) => one.name === name);

/** All clips, fetched once. */
export async function knowClips(): Promise<void> {
  if (!all.value.length) {
    all.value = (await get<{ clips: LibraryClip[] }>("/clips")).clips;
    if (!words.value.trim() && !kind.value) {
      found.value = all.value; // what was asked for meanwhile stays
    }
  }
}

let asked = 0;
async function look(): Promise<void> {
  const number = (asked += 1);
  const query = new URLSearchParams({ q: words.value, ...(kind.value ? { tag: kind.value } : {}) });
  const answer = words.value.trim() || kind.value ? (await get<{ clips: LibraryClip[] }>(`/clips?${query}`)).clips : all.value;
  if (number === asked) {
    found.value = answer;
  }
}

// How clips look on a character, as far as they are known.
let thumbs: Thumbs | null = null;
let owner = "";
const known = new Map<string, Clip>();
const seen = new Map<string, HTMLCanvasElement>();
const KEPT = 120;
let timer = 0;

function show(name: string): void {
  const canvas = seen.get(name);
  const clip = known.get(name);
  if (canvas && clip) {
    thumbs?.cards.set(name, { canvas, clip });
  }
}

/** Fetch what is seen and not known yet. */
async function fill(one: Character): Promise<void> {
  const names = [...seen.keys()].filter((name) => !known.has(name)).slice(0, 48);
  if (!names.length) {
    return;
  }
  const key = owner;
  const made = await send<{ job: string | null }>("POST", `/characters/${one.id}/clips`, { clips: names });
  if (made.job) {
    await ended(made.job);
  }
  await Promise.all(
    names.map(async (name) => {
      const clip = parseClip(await bytes(`/characters/${one.id}/clips/${name}?v=${one.version}`));
      if (key === owner) {
        known.set(name, clip);
        show(name);
      }
    }),
  );
  for (const name of [...known.keys()].slice(0, -KEPT)) {
    if (!seen.has(name)) {
      known.delete(name);
    }
  }
}

function soon(): void {
  clearTimeout(timer);
  timer = window.setTimeout(() => {
    const one = character.value;
    if (one?.state === "ready" && thumbs) {
      void attempt(() => fill(one));
    }
  }, 40);
}

async function wear(one: Character): Promise<void> {
  const key = `${one.id}:${one.version}`;
  if (key === owner || !thumbs) {
    return;
  }
  owner = key;
  known.clear();
  const data = await bytes(`/characters/${one.id}/mesh.glb?skin=handles`);
  if (key === owner) {
    await thumbs.show(key, data, one.bounds);
    for (const name of seen.keys()) {
      show(name); // clips may have come before the mesh
    }
    soon();
  }
}

function Card({ clip, watch }: { clip: LibraryClip; watch: IntersectionObserver | null }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  useEffect(() => {
    const here = canvas.current;
    if (!here || !watch) {
      return undefined;
    }
    here.dataset["clip"] = clip.name;
    watch.observe(here);
    return () => {
      watch.unobserve(here);
      seen.delete(clip.name);
      thumbs?.cards.delete(clip.name);
    };
  }, [clip.name, watch]);
  const lively = (): void => {
    touched.value = clip;
    if (thumbs) {
      thumbs.lively = clip.name;
    }
  };
  return (
    <li
      class="clip"
      draggable
      onDragStart={(event) => event.dataTransfer?.setData(DRAGGED, clip.name)}
      onPointerEnter={lively}
      onFocusIn={lively}
    >
      <button class="card" id={`clip-${clip.name}`} title={clip.sentence} onClick={() => void playClip(clip)}>
        <canvas ref={canvas} width={WIDE} height={HIGH} aria-hidden="true" />
        <span>{clip.name.replaceAll("-", " ")}</span>
        <small>
          {clip.seconds.toFixed(1)} s{clip.loops ? " · loop" : ""}
        </small>
      </button>
      <button
        class="icon"
        aria-label={`add ${clip.name} to the timeline`}
        title="add to the timeline"
        onClick={() => {
          addClip(clip);
          say(`${clip.name} is in the timeline: Animate makes it`);
        }}
      >
        +
      </button>
    </li>
  );
}

export function Library() {
  const list = useRef<HTMLUListElement>(null);
  const watch = useRef<IntersectionObserver | null>(null);
  if (!watch.current && typeof IntersectionObserver === "function") {
    watch.current = new IntersectionObserver((entries) => {
      for (const { target, isIntersecting } of entries) {
        const canvas = target as HTMLCanvasElement;
        const name = canvas.dataset["clip"] ?? "";
        if (isIntersecting) {
          seen.set(name, canvas);
          show(name);
        } else {
          seen.delete(name);
          thumbs?.cards.delete(name);
        }
      }
      soon();
    });
  }
  useEffect(() => {
    thumbs ??= new Thumbs();
    owner = "";
    void attempt(knowClips);
    const stop = effect(() => {
      const one = character.value;
      if (one?.state === "ready") {
        void attempt(() => wear(one));
      }
    });
    let frame = 0;
    const tick = (now: number): void => {
      frame = requestAnimationFrame(tick);
      if (!document.hidden) {
        thumbs?.draw(now, still);
      }
    };
    frame = requestAnimationFrame(tick);
    return () => {
      cancelAnimationFrame(frame);
      stop();
      thumbs?.forget();
      owner = "";
      known.clear();
    };
  }, []);
  const kinds = [...new Set(all.value.map((one) => one.tags[0] ?? ""))];
  const credit = touched.value;
  return (
    <section class="library" aria-label="clips">
      <div class="panel">
        <div class="find">
          <input
            type="search"
            id="clip-words"
            value={words.value}
            placeholder={`search ${all.value.length || ""} clips`}
            aria-label="search clips"
            onInput={(event) => {
              words.value = event.currentTarget.value;
              void attempt(look);
            }}
            onKeyDown={(event) => {
              const first = found.value[0];
              if (event.key === "Enter" && first) {
                void playClip(first);
              }
            }}
          />
          <select
            aria-label="kind"
            value={kind.value}
            onChange={(event) => {
              kind.value = event.currentTarget.value;
              void attempt(look);
            }}
          >
            <option value="">all kinds</option>
            {kinds.map((one) => (
              <option key={one}>{one}</option>
            ))}
          </select>
        </div>
        <p class="hint" role="status">
          {found.value.length ? "Click plays one; drag it, or +, onto the timeline." : "no clip is found; type it as a sentence below"}
        </p>
        <ul class="cards" ref={list}>
          {found.value.map((clip) => (
            <Card key={clip.name} clip={clip} watch={watch.current} />
          ))}
        </ul>
      </div>
      {credit && (
        <p class="hint credit">
          {credit.name}: {credit.credit}; {credit.terms}
        </p>
      )}
    </section>
  );
}
