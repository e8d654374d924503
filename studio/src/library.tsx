// The clip library: clips by words and kind, moving on the character that is shown, to be played or dragged onto the timeline.

import { effect, signal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { addClip, playClip } from "./actions";
import { bytes, get, send } from "./api";
import { parseClip } from "./clip";
import { attempt, character, ended, say } from "./state";
import { FRAMES, HIGH, Thumbs, WIDE } from "./thumbs";
import type { Character, LibraryClip } from "./types";

/** What a clip that is dragged carries. */
export const DRAGGED = "application/x-bunraku-clip";

const all = signal<LibraryClip[]>([]);
const found = signal<LibraryClip[]>([]);
const words = signal("");
const kind = signal("");
const touched = signal<LibraryClip | null>(null);

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

// How clips look on a character: strips of moments, drawn once and kept by the browser.
let thumbs: Thumbs | null = null;
let owner = "";
const pictures = new Map<string, ImageBitmap | HTMLCanvasElement>();
const seen = new Map<string, HTMLCanvasElement>();
let resting: HTMLCanvasElement | null = null; // the character before its clips are drawn
const TOGETHER = 12; // clips that are asked for at once: few, so that the first pictures come soon
const STILL = 2; // the moment that a card shows which nobody points at
let lively = "";
let timer = 0;
let filling = false;

function show(name: string, frame = STILL): void {
  const paper = seen.get(name)?.getContext("2d");
  const picture = pictures.get(name);
  paper?.clearRect(0, 0, WIDE, HIGH);
  if (paper && picture) {
    paper.drawImage(picture, frame * WIDE, 0, WIDE, HIGH, 0, 0, WIDE, HIGH);
  } else if (paper && resting) {
    paper.globalAlpha = 0.3; // until it is drawn
    paper.drawImage(resting, 0, 0);
    paper.globalAlpha = 1;
  }
}

const shelf = (): Promise<Cache | null> => (globalThis.caches ? caches.open("bunraku-pictures").catch(() => null) : Promise.resolve(null));
const place = (key: string, name: string): string => `/pictures/${key}/${name}`;

/** Draw what is seen and has no picture yet: as it was kept, or from its clip. */
async function fill(one: Character): Promise<void> {
  const key = owner;
  const kept = await shelf();
  const missing: string[] = [];
  for (const name of [...seen.keys()].filter((each) => !pictures.has(each))) {
    const known = await kept?.match(place(key, name));
    const picture = known && (await createImageBitmap(await known.blob()).catch(() => null));
    if (key !== owner) {
      return;
    }
    if (picture) {
      pictures.set(name, picture);
      show(name);
    } else {
      missing.push(name);
    }
  }
  const names = missing.slice(0, TOGETHER);
  if (!names.length) {
    return;
  }
  const made = await send<{ job: string | null }>("POST", `/characters/${one.id}/clips`, { clips: names });
  if (made.job) {
    await ended(made.job);
  }
  for (const name of names) {
    const clip = parseClip(await bytes(`/characters/${one.id}/clips/${name}?v=${one.version}`));
    const strip = key === owner ? thumbs?.strip(clip) : null;
    if (!strip) {
      return; // another character came meanwhile
    }
    pictures.set(name, strip);
    show(name);
    strip.toBlob((data) => void (data && kept?.put(place(key, name), new Response(data)).catch(() => undefined)), "image/webp", 0.85);
  }
  if (missing.length > names.length) {
    soon();
  }
}

function soon(): void {
  clearTimeout(timer);
  timer = window.setTimeout(() => {
    const one = character.value;
    if (filling) {
      soon();
    } else if (one?.state === "ready" && thumbs && `${one.id}:${one.version}` === owner) {
      filling = true;
      void attempt(() => fill(one)).then(() => (filling = false));
    }
  }, 60);
}

async function wear(one: Character): Promise<void> {
  const key = `${one.id}:${one.version}`;
  if (key === owner || !thumbs) {
    return;
  }
  pictures.clear();
  const data = await bytes(`/characters/${one.id}/mesh.glb?skin=handles`);
  await thumbs.show(key, data, one.bounds);
  owner = key;
  resting = thumbs.picture(0.08);
  [...seen.keys()].forEach((name) => show(name));
  soon();
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
    };
  }, [clip.name, watch]);
  const point = (): void => {
    touched.value = clip;
    lively = clip.name;
  };
  const leave = (): void => {
    lively = "";
    show(clip.name);
  };
  return (
    <li
      class="clip"
      draggable
      onDragStart={(event) => event.dataTransfer?.setData(DRAGGED, clip.name)}
      onPointerEnter={point}
      onPointerLeave={leave}
      onFocusIn={point}
      onFocusOut={leave}
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
    const moving = setInterval(() => lively && show(lively, Math.floor(performance.now() / 180) % FRAMES), 90);
    return () => {
      clearInterval(moving);
      stop();
      thumbs?.forget();
      resting = null;
      owner = "";
      pictures.clear();
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
          {found.value.length ? "Press one to play it, or drag it onto the timeline." : "no clip is found; type it as a sentence below"}
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
